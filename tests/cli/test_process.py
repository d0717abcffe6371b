"""The command as a process of its shell: signals and exit status, closed streams, users without a home, locales."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from sim_heating.base.parallel.threads import march_threads
from sim_heating.cli import main
from tests.support.gliding import gliding
from tests.support.kills import state
from tests.support.paths import PRACTICE, ROOT, TILE
from tests.support.systems import posix

pytestmark = posix
MODULE = (sys.executable, "-m", "sim_heating")
ENVIRONMENT = os.environ | {"PYTHONPATH": str(ROOT), "SIM_HEATING_AIRCRAFT_DATA": str(ROOT / "aircraft_data")}


@pytest.fixture
def workdir(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    text = gliding(20.0, "V09T9527", vehicle="orbiter").replace("A glide", "Höhe → Länge")
    (tmp_path / "short.toml").write_text(text, encoding="utf-8")
    return tmp_path


# Signals -------------------------------------------------------------------------------------------------------------

SIGNALLED = """
import ctypes, os, signal, sys, time
import sim_heating.cli
from sim_heating.base.progress import EndingSignals
def work(*_):
    {work}
class Stop:
    @staticmethod
    def main(*_, **__):
        work()
        time.sleep(30.0)
        print("still here")
sim_heating.cli.cli = Stop
from sim_heating.__main__ import main
sys.exit(main())
"""
SEND = "os.kill(os.getpid(), signal.SIGTERM)"
WORK = {
    "in Python": SEND,
    "in a callback of a C library": f"ctypes.CFUNCTYPE(None)(lambda: {SEND})()",
    "in an exec": f'exec("{SEND}")',
    "made another error": f"""
    try:
        {SEND}; time.sleep(30.0)
    except KeyboardInterrupt:
        raise RuntimeError("no compiled object yet") from None""",
}


@pytest.mark.parametrize("place", WORK)
def test_a_request_to_end_gives_status_143_wherever_it_arrives(place: str) -> None:
    code = SIGNALLED.format(work=WORK[place])
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (143, "")
    assert done.stderr == "interrupted: nothing was left half-written\n"


LOADING = """
import os, signal, sys, time
class Finder:
    @staticmethod
    def find_spec(name, *_):
        if name == "sim_heating.cli":
            try:
                os.kill(os.getpid(), signal.SIGTERM); time.sleep(30.0)
            except KeyboardInterrupt:
                raise ImportError("half loaded") from None
from sim_heating.__main__ import main
sys.meta_path.insert(0, Finder)
sys.exit(main())
"""


def test_a_request_to_end_while_a_library_is_loaded_gives_its_status() -> None:
    done = subprocess.run([sys.executable, "-c", LOADING], cwd=ROOT, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (143, "interrupted: nothing was begun\n")


ENDED = """
import atexit, os
import sim_heating.cli
class Work:
    @staticmethod
    def main(*_, **__):
        atexit.register(print, "closed")
        print("done")
class Module:
    def __del__(self):
        os.write(1, b"taken down")
held = Module()
sim_heating.cli.cli = Work
from sim_heating.__main__ import {entry}
{entry}()
"""


def test_command_ends_with_library_exit_handlers_and_no_module_teardown() -> None:
    """As other programs call it, it leaves the process as it is."""
    printed = {
        entry: subprocess.run(
            [sys.executable, "-c", ENDED.format(entry=entry)], cwd=ROOT, capture_output=True, text=True, check=True
        ).stdout
        for entry in ("run_and_exit", "main")
    }
    assert printed == {"run_and_exit": "done\nclosed\n", "main": "done\nclosed\ntaken down"}


DASK = """
import sys
from pathlib import Path
from sim_heating.base.parallel.batches import Job, run_batches
from sim_heating.base.progress import EndingSignals
if __name__ == "__main__":
    signals = EndingSignals()
    signals.install()
    try:
        run_batches([Job(str(i), i) for i in range(4)], str, Path("out"), workers=2)
    except KeyboardInterrupt:
        sys.exit(signals.exit_status)
"""


def _take_signals() -> None:
    """Default handling in a child, also where this process was started to ignore signals."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_DFL)


def _group(leader: int) -> list[int]:
    """Processes of a session that live, by their leader's number."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            state, _, _, session = (folder / "stat").read_text().rpartition(")")[2].split()[:4]
        except OSError:  # it has ended meanwhile
            continue
        if int(session) == leader and state != "Z":
            found.append(int(folder.name))
    return found


@pytest.mark.thorough
@pytest.mark.skipif(sys.platform != "linux", reason="the processes of a group are read from /proc")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_while_dask_starts_ends_all_processes_without_a_traceback(
    tmp_path: Path, number: signal.Signals
) -> None:
    """Ctrl-C reaches all processes of a terminal, a request to end the first one."""
    (tmp_path / "study.py").write_text(DASK)
    with subprocess.Popen(
        [sys.executable, "study.py"], cwd=tmp_path, env=ENVIRONMENT, stderr=subprocess.PIPE, start_new_session=True,
        preexec_fn=_take_signals,
    ) as process:  # fmt: skip
        while len(_group(process.pid)) < 2:  # the first worker's process
            time.sleep(0.01)
        (os.killpg if number == signal.SIGINT else os.kill)(process.pid, number)
        assert process.stderr is not None
        errors = process.stderr.read().decode()
    assert (process.returncode, errors) == (128 + number, "")
    for _ in range(300):  # processes that watch this one end a moment later
        if not (left := _group(process.pid)):
            break
        time.sleep(0.1)
    assert left == []


# Streams -------------------------------------------------------------------------------------------------------------


def run_in_shell(redirection: str, *arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Result of the command with a redirection of a POSIX shell."""
    shell = ["sh", "-c", f'"$@" {redirection}', "sh", *MODULE, *arguments]
    return subprocess.run(shell, env=ENVIRONMENT | environment, capture_output=True, text=True, check=False)


@pytest.mark.thorough
@pytest.mark.parametrize("redirection", [">&-", "<&- >&- 2>&-", "2>&1 | true"])
def test_a_command_whose_output_nobody_reads_does_its_work(workdir: Path, redirection: str) -> None:
    done = run_in_shell(f"{redirection}; echo", "run", "short.toml", "--out", "out")
    assert {p.name for p in (workdir / "out").iterdir()} >= {"summary.json", "flight.nc", "trajectory.png"}
    assert "Traceback" not in done.stderr
    assert "failed" not in done.stderr
    assert main(["validate", "out/../short.toml"]) == 0


@pytest.mark.sample(1)
@pytest.mark.parametrize("redirection", [">&-", "2>&-", "| true"])
def test_the_exit_status_does_not_depend_on_who_reads(workdir: Path, redirection: str) -> None:
    done = run_in_shell(f"{redirection}", "validate", "none.toml")
    assert done.returncode == (0 if "|" in redirection else 2)
    assert "Traceback" not in done.stderr


@pytest.mark.sample(1)
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="a system without a full device")
@pytest.mark.parametrize("arguments", [("--help",), ("validate", "short.toml")])
def test_an_output_that_is_full_is_named(workdir: Path, arguments: tuple[str, ...]) -> None:
    done = run_in_shell("> /dev/full", *arguments)
    assert (done.returncode, done.stderr) == (1, "failed: standard output: No space left on device\n")


# Surroundings --------------------------------------------------------------------------------------------------------


@pytest.mark.thorough
def test_a_terminal_without_unicode_shows_escapes(workdir: Path) -> None:
    (workdir / "short.toml").rename(workdir / "kürz.toml")
    ascii_only = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    done = run_in_shell("", "run", "kürz.toml", "--out", "Läufe", **ascii_only)
    assert done.returncode == 0, done.stderr
    assert "H\\xf6he" in done.stdout
    assert (workdir / "Läufe" / "summary.json").is_file()


@pytest.mark.thorough
@pytest.mark.skipif(sys.platform != "linux", reason="names of files are text on this system")
def test_a_record_whose_name_is_not_utf_8_is_predicted_under_that_name(workdir: Path) -> None:
    name = os.fsdecode(b"tile\xff")
    shutil.copytree(TILE, name)
    assert main(["predict", name, "--out", "out"]) == 0
    assert json.loads((workdir / "out" / "summary.json").read_text())["record"] == name


UNSHARED = ("unshare", "--user", "--map-user=54321", "--map-group=54321")


@pytest.mark.thorough
@pytest.mark.skipif(
    shutil.which("unshare") is None or subprocess.run([*UNSHARED, "true"], capture_output=True, check=False).returncode,
    reason="no user can be made here that has no passwd entry",
)
def test_a_user_without_home_and_name_has_a_cache_that_is_found_again(workdir: Path) -> None:
    kernels = "from sim_heating.base.kernels import compiler; print(compiler.CACHE)"
    environment = [f"PYTHONPATH={ROOT}", f"TMPDIR={workdir}"]
    command = [*UNSHARED, "env", "-i", *environment, sys.executable, "-c", kernels]
    first, second = (subprocess.run(command, capture_output=True, text=True, check=False) for _ in range(2))
    assert (first.returncode, first.stderr) == (0, "")
    assert first.stdout == second.stdout
    assert Path(first.stdout.strip()).parent == workdir / "sim_heating-54321"
    shutil.rmtree(workdir / "sim_heating-54321")
    (workdir / "sim_heating-54321").mkdir(mode=0o777)
    (workdir / "sim_heating-54321").chmod(0o777)  # another user's, who could put code into it
    third = subprocess.run(command, capture_output=True, text=True, check=False)
    assert Path(third.stdout.strip()).name.startswith("sim_heating_kernels_")


# Files that are none -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("command", ["validate", "run", "predict", "close-loop", "estimate", "plan"])
def test_a_loop_of_links_is_refused_in_one_line(
    workdir: Path, command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (workdir / "loop").symlink_to("loop")
    assert main([command, "loop", *([] if command == "validate" else ["--out", "out"])]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("error: loop")


def run_one_after_the_other(*commands: list[str]) -> list[tuple[int, str]]:
    """Exit status and errors of several commands in one other process; this one would wait for a pipe for ever."""
    code = """
import json, sys
from sim_heating.cli import main
for command in json.loads(sys.argv[1]):
    print(f"status {main(command)}", file=sys.stderr)
"""
    command = [sys.executable, "-c", code, json.dumps(commands)]
    done = subprocess.run(command, env=ENVIRONMENT, capture_output=True, text=True, check=True)
    answers = [answer.strip() for answer in re.split(r"^(status \d+)$", done.stderr, flags=re.MULTILINE)]
    return [(int(s.split()[1]), text) for text, s in zip(answers[::2], answers[1::2], strict=False)]


def test_what_is_no_regular_file_is_not_opened(workdir: Path) -> None:
    os.mkfifo(workdir / "pipe.toml")
    expected = {"pipe.toml": "a pipe", "/dev/zero": "a device", ".": "record"}
    answers = run_one_after_the_other(*(["validate", name] for name in expected))
    assert [status for status, _ in answers] == [2, 2, 2]
    for (_, error), what in zip(answers, expected.values(), strict=True):
        assert what in error


@pytest.mark.thorough
def test_a_pipe_within_a_record_is_refused_by_all_that_read_records(workdir: Path) -> None:
    shutil.copytree(TILE, "record")
    (workdir / "record" / "conditions.csv").unlink()
    os.mkfifo(workdir / "record" / "conditions.csv")
    answers = run_one_after_the_other(["validate", "record"], ["close-loop", "record", "--out", "out"])
    assert answers == 2 * [(2, "error: record/conditions.csv: is a pipe; give a text file")]


def test_a_text_of_terabytes_is_refused_by_its_size(workdir: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with (workdir / "huge.toml").open("wb") as file:
        file.truncate(10**12)  # a hole: it takes no space
    assert main(["validate", "huge.toml"]) == 2
    assert "huge.toml: has 1000000 MB" in capsys.readouterr().err


def test_a_working_directory_that_was_removed_is_named(workdir: Path) -> None:
    (workdir / "gone").mkdir()
    shell = ["sh", "-c", 'cd gone && rmdir ../gone && "$@"', "sh", *MODULE, "validate", "x.toml"]
    done = subprocess.run(shell, env=ENVIRONMENT, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (
        2,
        "error: the working directory was removed; change to one that exists\n",
    )


@pytest.mark.thorough
def test_a_disk_that_is_full_names_the_file_and_keeps_the_earlier_result(workdir: Path) -> None:
    """A limit on the size of files acts as a full disk does: the system refuses to write on."""
    assert main(["run", "short.toml", "--out", "out"]) == 0
    before = {p.name: p.read_bytes() for p in (workdir / "out").iterdir() if p.is_file()}
    limit = "import resource, sys; resource.setrlimit(resource.RLIMIT_FSIZE, (30_000, 30_000))"
    code = f"{limit}; from sim_heating.__main__ import main; sys.exit(main())"
    command = [sys.executable, "-c", code, "run", "short.toml", "--out", "out"]
    done = subprocess.run(command, env=ENVIRONMENT, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert re.match(r"failed: out/heating\.png: cannot be written \(File too large\)", done.stderr.splitlines()[-1])
    assert {p.name: p.read_bytes() for p in (workdir / "out").iterdir() if p.is_file()} == before


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("command", "given", "least"),
    [("run", "short.toml", 5), ("synthesize", "short.toml", 5), ("predict", str(PRACTICE / "p06"), 4)],
)
def test_flight_in_a_copied_process_has_the_same_files(command: str, given: str, least: int, workdir: Path) -> None:
    """That of a shell has its flight, or its prediction, in a copy, where there are two cores; this one has neither."""
    made = subprocess.run([*MODULE, command, given, "--out", "shell"], env=ENVIRONMENT, capture_output=True)
    assert made.returncode == 0, made.stderr.decode()
    with march_threads(1):
        assert main([command, given, "--out", "here"]) == 0
    shell, here = state(workdir / "shell"), state(workdir / "here")
    assert len(shell) > least
    assert shell == here


@pytest.mark.thorough
def test_a_flight_that_ends_at_once_is_told_in_one_line(workdir: Path) -> None:
    """Where a copy of the process flies, too."""
    text = (workdir / "short.toml").read_text(encoding="utf-8")
    (workdir / "late.toml").write_text(text.replace("[trajectory]\n", "[trajectory]\nsample_s = 1000.0\n", 1))
    done = subprocess.run(
        [*MODULE, "run", "late.toml", "--out", "out"], env=ENVIRONMENT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1].startswith("error: late.toml: [trajectory]: `sample_s`: 1000 s is longer than")
    assert not (workdir / "out").exists()


EARLY = """
import builtins, os, signal, sys
# a shell's background jobs ignore the first, and those of nohup the second
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)
import sim_heating.__main__ as program
load = builtins.__import__
def stop(name, *rest, **more):
    if name == "{module}" and not program_stopped:
        program_stopped.append(name)
        os.kill(os.getpid(), signal.{number})
    return load(name, *rest, **more)
program_stopped = []
builtins.__import__ = stop
sys.argv = ["sim-heating", "run", "--json", "scenarios/popu_mach20.toml", "--out", "{out}"]
program.run_and_exit()
"""


@pytest.mark.sample(2)
@pytest.mark.parametrize("number", ["SIGINT", "SIGTERM", "SIGHUP"])
@pytest.mark.parametrize("module", ["rich.console", "click", "numpy"])
def test_a_signal_while_the_program_loads_leaves_the_object_of_json(tmp_path: Path, number: str, module: str) -> None:
    code = EARLY.format(number=number, module=module, out=tmp_path / "out")
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    answer = json.loads(done.stdout)
    assert answer["status"] == done.returncode == 128 + getattr(signal, number)
    assert answer["command"] == "run"
    assert answer["error"]["kind"] == "interrupted"
    assert not (tmp_path / "out").exists()


LEAVING = """
import threading, time
from sim_heating import Effect, Parameter, flight, njit
threading.Thread(target=time.sleep, args=(60.0,)).start()
@njit
def nothing(B, c, p, wall_K):
    return 1.0 + B[p]
EFFECT = Effect(name="leaves-a-thread", mode="multiply", kernel=nothing, needs=(), neutral={"rise": 0.0},
    parameters=(Parameter("rise", "1", 0.0, 0.3, -0.5, 5.0, "relative rise"),), physics="none", source="none")
"""


def test_a_thread_that_an_effect_leaves_does_not_hold_the_process(workdir: Path) -> None:
    (workdir / "effects").mkdir()
    (workdir / "effects" / "leaving.py").write_text(LEAVING)
    flown = '\n[[effect]]\nname = "leaves-a-thread"\nparameters = { rise = 0.1 }\n'
    (workdir / "short.toml").write_text((workdir / "short.toml").read_text() + flown)
    begun_s = time.monotonic()
    environment = ENVIRONMENT | {"SIM_HEATING_EFFECTS": str(workdir / "effects")}
    done = subprocess.run([*MODULE, "validate", "short.toml"], env=environment, capture_output=True, check=False)
    assert done.returncode == 0, done.stderr
    assert time.monotonic() - begun_s < 55.0
