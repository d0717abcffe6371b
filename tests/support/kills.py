"""Commands that write, killed at their file operations: what readers then see, and what is left.

A forked child runs the writing part of a command and kills itself (SIGKILL) just before its n-th operation on a file
below the folder of results: opening for writing, renaming, removing, creating or removing a directory. Then a reader
comes, which must find the results of before or those of after, whole; then the same command runs again, and must leave
exactly what it leaves where nothing was killed.
"""

from __future__ import annotations

import os
import shutil
import signal
import sys
import tempfile
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import xarray as xr

import sim_heating as sh
from sim_heating.base.files import MARKER, file_digest, results_digest, settle_below
from sim_heating.base.files.package import data_folders
from sim_heating.simulation.fmu_export.ssp import export_ssp

POINT = "V09T9527"
SCENARIO = f"""
format = "scenario/1"
title = "A POPU in a glide"
vehicle = "orbiter"
control_points = ["{POINT}"]
[trajectory]
source = "entry-3dof"
[trajectory.initial]
altitude_m = 74000.0
velocity_m_s = {{velocity_m_s}}
gamma_deg = -0.1
heading_deg = 60.0
latitude_deg = 10.0
[trajectory.stop]
time_s = 120.0
[[trajectory.manoeuvre]]
kind = "popu"
at_time_s = 60.0
down_deg = 5.0
up_deg = 5.0
[truth]
parameters = {{{{ "ratio.scale" = -0.2 }}}}
"""
STUDY = f"""
format = "study/1"
title = "Twelve dispersed entries"
vehicle = "orbiter"
control_points = ["{POINT}"]
scenario = "{{scenario}}"
[dispersion]
flights = 12
scrambles = 3
quantiles = [0.5]
[[dispersion.input]]
name = "stack.emissivity_factor"
sigma = 0.02
"""
TASKS = {"batches", "flights", "fits", "finished", "tables", "joint", "closed"}
"""Folders of a study and a campaign with what is finished of them."""
VELOCITIES_M_S = {"before": 6500.0, "after": 6800.0}


# Killing ------------------------------------------------------------------------------------------------------------

Action = Callable[[], object]


def operations(action: Action, root: Path) -> list[str]:
    """File operations below a folder of an action that runs to its end in a child process."""
    status, found = _forked(action, root, None)
    if status != 0:
        raise RuntimeError("the action failed")
    return found


def killed(action: Action, root: Path, number: int) -> bool:
    """Run an action in a child process that is killed before its file operation of this number; False where it ended.

    number : 0 is the first
    """
    return _forked(action, root, number)[0] == -signal.SIGKILL


def _forked(action: Action, root: Path, kill_at: int | None) -> tuple[int, list[str]]:
    reading, writing = os.pipe()
    sys.stdout.flush()
    sys.stderr.flush()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of threads, none of which is needed in the child
        child = os.fork()
    if child == 0:
        os.close(reading)
        _run_in_child(action, os.path.realpath(root), kill_at, writing)
    os.close(writing)
    with os.fdopen(reading, encoding="utf-8") as stream:
        found = stream.read().splitlines()
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), found


def _run_in_child(action: Action, root: str, kill_at: int | None, report: int) -> None:
    status, count, busy = 1, 0, False

    def watch(event: str, arguments: tuple[Any, ...]) -> None:
        nonlocal count, busy
        if busy or event not in WATCHED or not (event != "open" or _writes(arguments)):
            return
        busy = True
        path = _path_of(event, arguments)
        busy = False
        if path != root and not path.startswith(root + os.sep):
            return
        if count == kill_at:
            os.kill(os.getpid(), signal.SIGKILL)
        count += 1
        os.write(report, f"{event} {os.path.relpath(path, root)}\n".encode())

    try:
        null = os.open(os.devnull, os.O_RDWR)
        for stream in (1, 2):
            os.dup2(null, stream)
        sys.addaudithook(watch)
        action()
        status = 0
    finally:
        os._exit(status)


WATCHED = {"open": 0, "os.rename": 0, "os.remove": 0, "os.mkdir": 0, "os.rmdir": 0, "os.chmod": 0, "os.link": 1}
"""Audit event -> which of its arguments is the path."""
DIRECTORY = {"os.remove": 1, "os.mkdir": 2, "os.rmdir": 1}
"""Audit event -> which of its arguments is the directory that a relative path starts from."""


def _writes(arguments: tuple[Any, ...]) -> bool:
    return bool((arguments[2] or 0) & (os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC))


def _path_of(event: str, arguments: tuple[Any, ...]) -> str:
    path = arguments[WATCHED[event]]
    if isinstance(path, int):
        return ""
    path = os.fsdecode(path)
    at = arguments[DIRECTORY[event]] if event in DIRECTORY else -1
    return os.path.join(os.readlink(f"/proc/self/fd/{at}") if at >= 0 else os.getcwd(), path)


# Commands -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Case:
    """A command that writes.

    prepare : fills a folder with what is there before
    act     : writes into it
    results : folder below it that holds the results
    fresh   : whether there are no results before
    """

    prepare: Callable[[Path], object]
    act: Callable[[Path], object]
    results: str = "out"
    fresh: bool = False


@cache
def inputs() -> Path:
    """A folder with a vehicle and, for both flights, scenario, study and record."""
    home = Path(tempfile.mkdtemp(prefix="kills-"))
    orbiter = next(p for p in data_folders("aircraft_data") if p.is_dir()) / "orbiter"
    tables = (f"ratio_tables/{POINT}.csv", f"ratio_tables/{POINT}_turbulent.csv")
    for name in ("vehicle.toml", f"control_points/{POINT}.toml", *tables, "guidance.toml"):
        (home / "orbiter" / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(orbiter / name, home / "orbiter" / name)
    for name in ("materials", "aero"):
        shutil.copytree(orbiter / name, home / "orbiter" / name)
    for name, velocity in VELOCITIES_M_S.items():
        (home / f"{name}.toml").write_text(
            SCENARIO.format(velocity_m_s=velocity).replace('"orbiter"', f'"{home / "orbiter"}"')
        )
        text = STUDY.format(scenario=home / f"{name}.toml")
        (home / f"{name}_study.toml").write_text(text.replace('"orbiter"', f'"{home / "orbiter"}"'))
        scenario = sh.load_scenario(home / f"{name}.toml")
        sh.write_records(scenario, sh.synthesize(scenario), home / name)
    return home


@cache
def fit() -> Path:
    """The estimate of the second flight."""
    place = inputs() / "fit"
    sh.write_fit(sh.estimate([inputs() / "after"], ["ratio.scale"]), place)
    return place


@contextmanager
def _blank_pictures() -> Iterator[None]:
    """Pictures are written where they always are, but blank: drawing takes most of the time of a campaign."""
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    save, lay_out = Figure.savefig, ConstrainedLayoutEngine.execute

    def save_blank(_: Figure, *arguments: Any, **settings: Any) -> None:
        save(Figure(), *arguments, **settings)

    Figure.savefig = save_blank  # type: ignore[method-assign]
    ConstrainedLayoutEngine.execute = lambda *_: None  # type: ignore[method-assign]
    try:
        yield
    finally:
        Figure.savefig, ConstrainedLayoutEngine.execute = save, lay_out  # type: ignore[method-assign]


def _writers() -> Mapping[str, Callable[[str], Callable[[Path], object]]]:
    """Command -> which flight -> a function that writes its results, computed before, into a folder."""

    def run(flight: str) -> Callable[[Path], object]:
        result = sh.run(inputs() / f"{flight}.toml")
        return lambda out: sh.write_run(result, out)

    def synthesize(flight: str) -> Callable[[Path], object]:
        scenario = sh.load_scenario(inputs() / f"{flight}.toml")
        records = sh.synthesize(scenario)
        return lambda out: sh.write_records(scenario, records, out)

    def predict(flight: str) -> Callable[[Path], object]:
        prediction = sh.predict(inputs() / flight)
        return lambda out: sh.write_prediction(prediction, out)

    def estimate(flight: str) -> Callable[[Path], object]:
        fitted = sh.estimate([inputs() / flight], ["ratio.scale"])
        return lambda out: sh.write_fit(fitted, out)

    def close_loop(flight: str) -> Callable[[Path], object]:
        closed = sh.close_loop(inputs() / flight)
        return lambda out: sh.write_closed_loop(closed, out)

    def plan(flight: str) -> Callable[[Path], object]:
        return lambda out: sh.plan(inputs() / f"{flight}_study.toml", out, workers=1)

    def figures(flight: str) -> Callable[[Path], object]:
        from sim_heating.campaign.figures.paper import draw_figures, write_figures

        drawn = draw_figures([inputs() / flight], [5, 6])
        return lambda out: write_figures(drawn, out)

    def design(flight: str) -> Callable[[Path], object]:
        designed = sh.design(inputs() / f"{flight}.toml", evaluations=2)
        return lambda out: sh.write_design(designed, out)

    return {"run": run, "synthesize": synthesize, "predict": predict, "estimate": estimate, "close-loop": close_loop,
            "plan": plan, "figures": figures, "design": design}  # fmt: skip


@cache
def _writer(command: str, flight: str) -> Callable[[Path], object]:
    return _writers()[command](flight)


CAMPAIGN = """format = "campaign/1"
title = "Measurements of one manoeuvre"
vehicle = "{vehicle}"
control_points = ["{point}"]
close_loop = false
[fit]
parameters = ["ratio.scale"]
[[flight]]
{flight}
"""
"""A campaign of one point; its flight is given in the keys of [[flight]]."""


@cache
def campaign(flight: str) -> Path:
    """A campaign of the record of a flight, that others fly to fit one manoeuvre."""
    path = inputs() / f"{flight}_campaign.toml"
    path.write_text(CAMPAIGN.format(vehicle=inputs() / "orbiter", point=POINT, flight=f'records = "{flight}"'))
    return path


@cache
def readings(flight: str) -> Path:
    """Temperatures of a plate as a logger writes them."""
    path = inputs() / f"{flight}.csv"
    hotter = 1.0 if flight == "before" else 1.5
    rows = "".join(f"{t},{20.0 + hotter * t / 2.0:.1f}\n" for t in range(0, 120, 4))
    path.write_text(f"Time (s),TC1 (degC)\n{rows}")
    return path


def arguments(command: str, flight: str) -> list[str] | None:
    """Arguments of a command that is run as a whole, OUT for the folder of its results; None for another."""
    speed = f"{VELOCITIES_M_S[flight]:g}m/s"
    point = "WING_LE" if flight == "before" else "BODYFLAP"
    plate = f"--csv {readings(flight)} --depth TC1=back --lamp unknown".split()
    more = {
        "campaign": ["campaign", str(campaign(flight)), "--workers", "1"],
        "new record": ["new", "record", *plate, "--layer", "copper 3 mm"],
        "new scenario": ["new", "scenario", "--vehicle", "orbiter", "--speed", speed, "--point", point],
        "new study": ["new", "study", "envelope", "--scenario", "scenarios/entry_3dof.toml", "--point", point],
        "new effect": ["new", "effect", "shock", "--variable", "alpha_deg" if flight == "before" else "mach"],
        "new vehicle": ["new", "vehicle", "--length", "2m", "--mass", f"{VELOCITIES_M_S[flight] / 10:g}kg",
                        "--area", "3m2", "--nose-radius", "1.2m", "--point", "NOSE=copper 3 mm"],
        "examples": ["examples"],
    }  # fmt: skip
    return [*more[command], "--out", "OUT", "--quiet"] if command in more else None


@cache
def case(command: str, fresh: bool = False) -> Case:
    """A command as a case.

    fresh : into a place where nothing is yet
    """
    if command in _writers():
        before, after = (_writer(command, flight) for flight in VELOCITIES_M_S)

        def prepare(folder: Path) -> None:
            if not fresh:
                before(folder / "out")
                (folder / "out" / "notes.txt").write_text("mine")

        return Case(prepare, lambda folder: after(folder / "out"), fresh=fresh)
    if arguments(command, "before") is not None:

        def run(flight: str, folder: Path) -> None:
            from sim_heating.cli import main

            given = arguments(command, flight) or []
            with _blank_pictures():
                assert main([str(folder / "out") if a == "OUT" else a for a in given]) == 0

        return Case(
            lambda folder: None if fresh else run("before", folder), lambda folder: run("after", folder), fresh=fresh
        )
    if command == "fmu export --ssp":
        os.environ["SOURCE_DATE_EPOCH"] = "0"
        vehicle = sh.load_vehicle(inputs() / "orbiter")
        first, second = (sh.load_scenario(inputs() / f"{f}.toml").declared.trajectory for f in VELOCITIES_M_S)
        return Case(
            lambda folder: None if fresh else export_ssp(vehicle, first, folder / "out" / "a.ssp"),
            lambda folder: export_ssp(vehicle, second, folder / "out" / "a.ssp"),
            fresh=fresh,
        )
    if command == "fmu export":
        os.environ["SOURCE_DATE_EPOCH"] = "0"  # its time of generation would make equal models different files
        vehicle = sh.load_vehicle(inputs() / "orbiter")
        return Case(
            lambda folder: None if fresh else sh.export_fmu(vehicle, folder / "out" / "a.fmu", fmi=2),
            lambda folder: sh.export_fmu(vehicle, folder / "out" / "a.fmu", fmi=3),
            fresh=fresh,
        )

    def revise(folder: Path) -> object:
        return sh.update_tables(fit(), folder / "out" / "orbiter")

    fit()

    def copy_vehicle(folder: Path) -> None:
        shutil.copytree(inputs() / "orbiter", folder / "out" / "orbiter")
        if command == "revert":
            revise(folder)

    def revert(folder: Path) -> None:
        from sim_heating.cli import main

        assert main(["update-tables", "--vehicle", str(folder / "out" / "orbiter"), "--revert", POINT]) == 0

    return Case(copy_vehicle, revise if command == "update-tables" else revert, "out/orbiter")


# Sweeps -------------------------------------------------------------------------------------------------------------


def snapshot(folder: Path) -> dict[str, str]:
    """Name -> digest of all files below a folder, hidden ones too; empty where it does not exist."""
    return {p.relative_to(folder).as_posix(): file_digest(p) for p in sorted(folder.rglob("*")) if p.is_file()}


def state(folder: Path) -> dict[str, str]:
    """As `snapshot`, but netCDF, which holds the time of writing, by its values, lists of results by their truth."""
    files = snapshot(folder)
    for name in files:
        path = folder / name
        if path.name == MARKER:
            files[name] = "not whole" if results_digest(path.parent) is None else "whole"
        elif path.suffix == ".nc":
            with xr.open_dataset(path) as data:
                files[name] = data.load().to_dict().__repr__()
    return files


def readable(files: Mapping[str, str]) -> dict[str, str]:
    """The files that are results of the whole command, by `state`.

    Those of its finished tasks, which are kept whatever happens, count only where they are not whole.
    """
    return {
        name: digest
        for name, digest in files.items()
        if not TASKS & set(Path(name).parts) or (Path(name).name == MARKER and digest != "whole")
    }


def _without_remains(files: Mapping[str, str]) -> dict[str, str]:
    """The files but for those under a temporary name and locks: nobody's results, which the next writer removes."""
    return {name: digest for name, digest in files.items() if ".partial-" not in name and not name.endswith(".lock")}


def kill_and_judge(chosen: Case, numbers: Sequence[int] | None, folder: Path, most: int | None = None) -> Counter[str]:
    """Kill a case at file operations, and count what readers find and what the same command leaves then.

    numbers : of the operations; all where None
    folder  : empty, for the files
    most    : where there are more operations than this, so many of them, the first and the last among them
    """

    place = folder / "case"  # always the same: files name others relative to themselves
    place.mkdir()
    chosen.prepare(place)
    chosen.act(place)  # with modules and kernels loaded, the children do not load them again
    shutil.rmtree(place)
    place.mkdir()
    chosen.prepare(place)
    before = readable(state(place))
    prepared = shutil.copytree(place, folder / "prepared", symlinks=True)
    found = operations(lambda: chosen.act(place), place)
    after = state(place)
    counted: Counter[str] = Counter(operations=len(found))
    if numbers is None:
        numbers = range(len(found))
        if most is not None and len(found) > most:
            numbers = sorted({round(k * (len(found) - 1) / (most - 1)) for k in range(most)})
    for number in (n % len(found) for n in numbers):
        shutil.rmtree(place)
        shutil.copytree(prepared, place, symlinks=True)
        if not killed(lambda: chosen.act(place), place, number):
            counted["not killed"] += 1
            continue
        counted["kills"] += 1
        settle_below(place)
        seen = readable(_without_remains(state(place)))
        kind = "before" if seen == before else "after" if seen == readable(after) else "mixed"
        counted[f"readers find: {kind}"] += 1
        again = _forked(lambda: chosen.act(place), place, None)[0]
        # What has been done to a vehicle is refused a second time: evidence would count twice. Nothing is written then,
        # so that a lock whose owner was killed in the act of removing it stays for the next writer.
        done = chosen.results != "out" and kind == "after"
        files = state(place)
        same = files == after if again == 0 else done and _without_remains(files) == after
        counted["again: same" if same else "again: differs or refused"] += 1
    return counted


def bad(counted: Mapping[str, int]) -> int:
    """Kills after which a reader or the next command found anything but whole results."""
    return sum(counted.get(name, 0) for name in ("readers find: mixed", "again: differs or refused", "not killed"))
