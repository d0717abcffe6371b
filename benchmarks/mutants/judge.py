"""Mutants run one after the other in a process that may die, and what became of each.

Good outcomes: `accepted`, with results that are finite everywhere; `refused`, by an InputError whose lines each name a
file of the case; `failed`, by a RunError of one line that names one too. Everything else is a fault: another
exception, a warning, a number that is not finite, a process that dies, more than 10 s of processor time, a changed
input, files left behind.
"""

from __future__ import annotations

import csv
import hashlib
import io
import json
import multiprocessing
import os
import random
import re
import resource
import shutil
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from fnmatch import fnmatch
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from benchmarks.mutants.damage import Damage, damage
from benchmarks.mutants.subjects import OUT, Command, Subject, available, choose, command_text, execute

LONGEST_S = 10.0
"""Processor time that a command may take [s]; wall time is that of a busy machine."""
PATIENCE_S = 180.0
"""Wall time after which a process that computes nothing counts as hung [s]; a command that may compute for longer has
three times that."""
LONGEST_LINE = 700
GOOD = ("accepted", "told", "refused", "failed")
"""What may follow: done, done with a warning of one line, refused in a line, failed in a line."""
MAY_BE_EMPTY = ("thermocouples.csv",)
"""Tables in which an empty cell is a lost sample."""


@dataclass(frozen=True)
class Result:
    """What became of one mutant.

    number   : of the mutant;  format : of its subject;  file : that was damaged
    kind, what, quantity, factor : of the damage
    command  : as typed;  outcome : one of GOOD, or the name of a fault
    message  : last line of the program, or of the fault
    seconds  : processor time
    """

    number: int
    format: str
    file: str
    kind: str
    what: str
    quantity: str
    factor: float
    command: str
    outcome: str
    message: str
    seconds: float


def mutant(home: Path, seed: int, number: int) -> tuple[Subject, Command, str, Damage]:
    """The mutant of a number: subject, command, damaged file and damage; the same for one seed and one set of files."""
    rng = random.Random(f"{seed}:{number}")
    subject, command = choose(available(home), rng)
    files = sorted({p.relative_to(home).as_posix() for glob in subject.damaged for p in home.glob(glob) if p.is_file()})
    file = rng.choice([f for f in files if not f.endswith((".png", ".html"))])
    return subject, command, file, damage(file, (home / file).read_bytes(), rng)


def _result(
    drawn: tuple[Subject, Command, str, Damage], number: int, outcome: str, message: str, seconds: float
) -> Result:
    """What became of a mutant, as `mutant` drew it."""
    subject, command, file, done = drawn
    return Result(
        number, subject.format, file, done.kind, done.what, done.quantity, done.factor, command_text(command),
        outcome, message, seconds,
    )  # fmt: skip


def write_mutant(home: Path, folder: Path, subject: Subject, file: str, done: Damage) -> None:
    """The files of a subject with one damaged, in a new folder."""
    folder.mkdir(parents=True)
    for name in subject.inputs:
        source = home / name
        (shutil.copytree if source.is_dir() else shutil.copy)(source, folder / name)
    (folder / file).write_bytes(done.content)


def run_numbers(
    home: Path, seed: int, numbers: Iterable[int], faults: Path | None = None, longest_s: float = LONGEST_S
) -> Iterator[Result]:
    """Run mutants in a second process, a new one wherever it dies.

    home      : the whole files
    faults    : where mutants that show a fault are kept, each in a folder with its reproduction
    longest_s : processor time that a command may take; where it is longer than LONGEST_S, the process does not run the
                commands on whole files first, and includes the loading of kernels
    """
    context = multiprocessing.get_context("spawn")
    waiting = list(numbers)[::-1]
    while waiting:
        with tempfile.TemporaryDirectory(prefix="mutants_") as work:
            here, there = context.Pipe()
            process = context.Process(target=_serve, args=(there, str(home), seed, work, longest_s), daemon=False)
            process.start()
            there.close()
            if not _is_ready(here):
                raise RuntimeError(f"the commands fail on whole files:\n{_tail(work)}")
            try:
                while waiting:
                    here.send(waiting[-1])
                    result = _answer(here, process, home, seed, waiting[-1], work, max(PATIENCE_S, 3.0 * longest_s))
                    waiting.pop()
                    if result.outcome not in GOOD and faults is not None:
                        keep(faults, home, seed, result)
                    yield result
                    if result.outcome in ("died", "hung", "too long"):
                        break
                else:
                    here.send(None)
            finally:
                here.close()
                process.join(PATIENCE_S if not waiting else 0.1)
                if process.is_alive():
                    process.kill()
                    process.join()


def _is_ready(here: Connection) -> bool:
    try:
        return bool(here.recv())
    except EOFError:
        return False


def _tail(work: str) -> str:
    """The last lines that the second process printed."""
    return (Path(work) / "output").read_text(errors="replace")[-1500:]


def _answer(here: Connection, process: Any, home: Path, seed: int, number: int, work: str, patience_s: float) -> Result:
    """The result of a mutant, also where its process dies or hangs."""
    try:
        if here.poll(patience_s):
            found = here.recv()
            assert isinstance(found, Result)
            return found
        outcome, message = "hung", f"no answer within {patience_s:g} s"
        process.kill()
    except (EOFError, ConnectionError):
        process.join()
        too_long = process.exitcode == -24  # SIGXCPU
        outcome = "too long" if too_long else "died"
        message = f"{LONGEST_S:g} s of processor time" if too_long else f"exit code {process.exitcode}: {_tail(work)}"
    return _result(mutant(home, seed, number), number, outcome, message, LONGEST_S)


def _serve(connection: Connection, home: str, seed: int, work: str, longest_s: float) -> None:
    """Run the mutants whose numbers arrive, in this process, which has nothing else to do."""
    output = Path(work) / "output"
    with output.open("wb", buffering=0) as stream:
        os.dup2(stream.fileno(), 1)  # also what libraries print without Python
        os.dup2(stream.fileno(), 2)
        temporary = Path(work) / "tmp"
        temporary.mkdir()
        os.environ["TMPDIR"] = tempfile.tempdir = str(temporary)
        os.environ["MPLBACKEND"] = "Agg"
        if longest_s <= LONGEST_S:
            _warm_up(Path(home), Path(work))
        connection.send(True)
        while (number := connection.recv()) is not None:
            connection.send(_judge(Path(home), seed, number, Path(work), output, longest_s))
        connection.close()


def _warm_up(home: Path, work: Path) -> None:
    """Every command once on whole files, so that imports and kernels are loaded before times count."""
    for k, subject in enumerate(available(home)):
        for i, command in enumerate((*subject.checks, *subject.computes)):
            folder = work / f"whole{k}_{i}"
            whole = Damage("", "", b"")
            file = next(p.relative_to(home).as_posix() for glob in subject.damaged for p in home.glob(glob))
            write_mutant(home, folder, subject, file, Damage(whole.kind, whole.what, (home / file).read_bytes()))
            status = execute(command, folder)
            if status != 0 and "closure.json" not in command_text(command):
                raise RuntimeError(f"{command_text(command)} fails on whole files of {subject.format} ({status})")
            shutil.rmtree(folder)


def _judge(home: Path, seed: int, number: int, work: Path, output: Path, longest_s: float) -> Result:
    """Run one mutant and say what became of it."""
    drawn = mutant(home, seed, number)
    subject, command, file, done = drawn
    folder = work / "case" / f"m{number}"
    write_mutant(home, folder, subject, file, done)
    before = digests(folder)
    sys.stdout.flush()
    output.open("wb").close()
    os.lseek(1, 0, os.SEEK_SET)
    os.lseek(2, 0, os.SEEK_SET)
    begun = time.process_time()
    own = resource.getrusage(resource.RUSAGE_SELF)
    limit = int(own.ru_utime + own.ru_stime + longest_s + 1.0)
    resource.setrlimit(resource.RLIMIT_CPU, (limit, resource.RLIM_INFINITY))
    status: int | None = None
    trace = ""
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        try:
            status = execute(command, folder)
        except BaseException:  # the judge of everything
            trace = traceback.format_exc()
    resource.setrlimit(resource.RLIMIT_CPU, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    sys.stdout.flush()
    sys.stderr.flush()
    seconds = time.process_time() - begun
    text = output.read_text(errors="replace")
    outcome, message = _outcome(status, text, trace, seconds > longest_s)
    told = message.splitlines() if outcome in ("refused", "failed") and not callable(command) else []
    if not all(names_a_file(line, folder) for line in told):
        outcome = "names no file"
    if outcome in GOOD:
        fault = _left_fault(status == 0, folder, subject, before, work)
        fault = fault or (_result_fault(folder / OUT) if status == 0 else "")
        outcome, message = (fault.split(":")[0], fault) if fault else (outcome, message)
    shutil.rmtree(work / "case", ignore_errors=True)
    for left in (work / "tmp").iterdir():
        shutil.rmtree(left) if left.is_dir() else left.unlink()
    return _result(drawn, number, outcome, message[-1500:], round(seconds, 3))


def _outcome(status: int | None, text: str, trace: str, too_long: bool) -> tuple[str, str]:
    """Outcome by exit status and printed text."""
    if trace or "Traceback (most recent call last)" in text:
        return "traceback", trace or text
    if "Warning: " in text:
        return "warning", next(line for line in text.splitlines() if "Warning: " in line)
    if too_long:
        return "too long", "more processor time than it may take"
    if status == 0:
        warned = [line for line in text.splitlines() if line.startswith("warning: ")]
        return ("told", warned[0]) if warned else ("accepted", "")
    mark = {1: "failed: ", 2: "error: "}.get(status or 0, "?")
    _, found, message = f"\n{text}".rpartition(f"\n{mark}")
    lines = message.rstrip("\n").splitlines() if found else []
    if not lines:
        return "no message", f"exit status {status}: {text[-300:]}"
    if any(not line.isprintable() or len(line) > LONGEST_LINE or not line.strip() for line in lines):
        return "unclear message", message
    if status == 1 and len(lines) > 1:
        return "unclear message", message
    return ("failed" if status == 1 else "refused"), "\n".join(lines)


def names_a_file(message: str, folder: Path) -> bool:
    """Whether a line names a file of the case, a folder as a path or before a colon, or the variable that does.

    A folder is often called what it holds: `is not a record` does not name the folder `record`.
    """
    below = list(folder.rglob("*"))
    files = {p.name for p in below if p.is_file()} | {"SIM_HEATING_EFFECTS"}
    folders = "|".join(re.escape(p.name) for p in below if p.is_dir())
    as_path = re.search(rf"(?<!\w)({folders})[/:`]", message) if folders else None
    return as_path is not None or any(name in message for name in files)


def _left_fault(accepted: bool, folder: Path, subject: Subject, before: dict[str, str], work: Path) -> str:
    """Inputs that changed, and files that were left where none should be; "" where there are none."""
    after = digests(folder)
    changed = [n for n, d in before.items() if after.get(n) != d and not (accepted and _matches(n, subject.may_change))]
    if changed:
        return f"changed input: {', '.join(changed[:3])}"
    new = [n for n in after if n not in before]
    expected = (f"{OUT}/*", *subject.may_change) if accepted else ()
    left = [n for n in new if not _matches(n, expected) and "__pycache__" not in n]
    left += [p.name for p in (work / "tmp").iterdir()]
    if not accepted and (folder / OUT).exists():
        left.append(OUT)
    return f"left behind: {', '.join(left[:3])}" if left else ""


def _matches(name: str, globs: Iterable[str]) -> bool:
    return any(fnmatch(name, glob) for glob in globs)


def _result_fault(out: Path) -> str:
    """The first number of the results that is not finite; "" where all are."""
    for path in sorted(out.rglob("*")):
        if path.suffix == ".json":
            try:
                json.loads(path.read_text("utf-8-sig"), parse_constant=_refuse_constant)
            except ValueError as error:
                return f"not finite: {path.name}: {error}"
        elif path.suffix == ".csv":
            lines = [line for line in path.read_text().splitlines() if not line.startswith("#")]
            for row in list(csv.reader(io.StringIO("\n".join(lines))))[1:]:
                bad = [c for c in row if c.strip().lower() in ("nan", "inf", "-inf")]
                if bad or ("" in row and path.name not in MAY_BE_EMPTY and path.name == "conditions.csv"):
                    return f"not finite: {path.name}: {row[:4]}"
    return ""


def _refuse_constant(name: str) -> None:
    raise ValueError(f"{name} in JSON")


def digests(folder: Path) -> dict[str, str]:
    """Digest of each file below a folder, by its path."""
    files = (p for p in folder.rglob("*") if p.is_file())
    return {p.relative_to(folder).as_posix(): hashlib.sha256(p.read_bytes()).hexdigest() for p in files}


def keep(faults: Path, home: Path, seed: int, result: Result) -> None:
    """Keep the files of a mutant that shows a fault, with what was done to it and how to run it again."""
    folder = faults / f"{result.outcome.replace(' ', '_')}_{seed}_{result.number}"
    shutil.rmtree(folder, ignore_errors=True)
    subject, _, file, done = mutant(home, seed, result.number)
    write_mutant(home, folder, subject, file, done)
    (folder / "FAULT.json").write_text(json.dumps({**asdict(result), "seed": seed}, indent=1))
