"""Whether a change of the program leaves every number it computes as it was: run before, run after, compare.

    python -m tools.same_results run BEFORE --repository ../old --python ../old/.venv/bin/python
    python -m tools.same_results run AFTER
    python -m tools.same_results compare BEFORE AFTER --renames renames.toml

`run` executes a fixed list of commands of the program, each in a separate process, and keeps what they write.
`compare` compares every array and every number in two such folders (`tools/compare_results.py`). Nothing here
imports the package: only its commands and the files that they write are used, so that modules may move in between.
"""

from __future__ import annotations

import json
import os
import platform
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import click
import fmpy
import numpy as np

from tools.compare_results import RUN, compare_folders, load_renames

HERE = Path(__file__).resolve().parents[1]
LONGEST_S = 1800.0
"""A command that takes longer is ended and recorded as failed [s]."""
WORKERS = ("--workers", "2")
"""Results do not depend on the number of processes; two also covers the way through Dask."""
CLI = ("-m", "sim_heating")
FRAMES = ("-m", "tools.same_results", "frames")
PRACTICE, RECORDS = "scenarios/records/practice", "scenarios/records"
ABSENT = ("No module named", "No such command")
"""What an interpreter or the command line answers where an invocation does not exist."""


@dataclass(frozen=True)
class Command:
    """One command of the list.

    name        : folder below OUT that its results go to
    invocations : arguments of the interpreter; the first invocation that exists is taken
    environment : variables set for this command alone
    own         : run by this file's interpreter in this file's checkout, not by the version under test

    In arguments and variables `{out}` is the command's own folder for results, `{root}` is OUT, `{repository}` the
    checkout under test.
    """

    name: str
    invocations: tuple[tuple[str, ...], ...]
    environment: Mapping[str, str] = field(default_factory=dict)
    own: bool = False


def _cli(name: str, *arguments: str, out: str = "{out}", **environment: str) -> Command:
    """A command of the program that takes --out."""
    return Command(name, ((*CLI, *arguments, "--out", out),), environment)


def _estimate(name: str, *arguments: str) -> Command:
    return _cli(f"estimate_{name}", "estimate", *arguments)


STACK_PARAMETERS = (
    "ratio.scale,ratio.d_alpha,ratio.d_alpha2,effect.transition.log10_re_onset,effect.transition.alpha_sens,"
    "effect.transition.width,effect.transition.factor,stack.coating.thickness_factor,stack.rsi.conductivity_factor,"
    "clock.skew,sensor.LS_bond.bias"
)
BOARD_PARAMETERS = "stack.emissivity_factor,stack.rsi.conductivity_factor,stack.rsi.heat_capacity_factor,back.h_W_m2K"
SYNTHETIC, REVISED = "{root}/synthesize_popu_mach20/out/V09T9527", "{root}/update_tables/out/orbiter"
EFFECTS = {"SIM_HEATING_EFFECTS": "{repository}/examples/effects"}

COMMANDS = (
    # flights: every source of a trajectory; with the plug-in alongside JSBSim; compared with measured tiles
    *(
        _cli(f"run_{name}", "run", f"scenarios/{name}.toml")
        for name in (
            "popu_mach20", "entry_3dof", "capsule", "sts96", "recorded_sts107", "nominal", "all_manoeuvres",
        )
    ),
    _cli("run_sts2", "run", "benchmarks/flights/sts2.toml"),
    _cli("synthesize_popu_mach20", "synthesize", "scenarios/popu_mach20.toml"),
    _cli("synthesize_sts4", "synthesize", "benchmarks/flights/sts4.toml"),
    _cli("synthesize_entry_3dof", "synthesize", "scenarios/entry_3dof.toml"),
    _cli("synthesize_shock_passage", "synthesize", "examples/shock_passage.toml", **EFFECTS),
    # predictions along records
    _cli("predict_practice", "predict", *(f"{PRACTICE}/p{i:02d}" for i in range(1, 11))),
    _cli("predict_measured", "predict", *(f"{RECORDS}/sts96_{n}" for n in (468, 480, 597, 730))),
    _cli("predict_board", "predict", f"{RECORDS}/kaowool_board"),
    # estimates
    _estimate("default", f"{PRACTICE}/p06"),
    _estimate("stack_clock", f"{PRACTICE}/p04", "--parameters", STACK_PARAMETERS, "--reference", "alpha_deg=40"),
    _estimate("board", f"{RECORDS}/kaowool_board", "--parameters", BOARD_PARAMETERS),
    _estimate("measured", f"{RECORDS}/sts96_480"),
    _estimate("segments", f"{PRACTICE}/p01", "--segments", "60"),
    _estimate("process_noise", f"{PRACTICE}/p08", "--process-noise", "0.1"),
    _estimate("process_noise_found", f"{PRACTICE}/p08", "--process-noise", "estimated"),
    _estimate("ratio_noise", f"{PRACTICE}/p08", "--ratio-noise", "0.02,30"),
    _estimate("ratio_noise_found", f"{PRACTICE}/p02", "--ratio-noise", "estimated"),
    _estimate("joint", f"{PRACTICE}/p06", f"{PRACTICE}/p04"),
    _estimate("start_circuit", f"{PRACTICE}/p06", "--fit", "650,877", "--start", "circuit:650"),
    _estimate("start_filter", f"{PRACTICE}/p06", "--fit", "650,877", "--start", "filter:650"),
    _estimate("start_profile", SYNTHETIC, "--fit", "724,848", "--start", "profile:724"),
    # from the last of them into the tables
    _cli("update_tables", "update-tables", "{root}/estimate_start_profile/out", "--vehicle", "aircraft_data/orbiter"),
    _cli("predict_vehicle", "predict", SYNTHETIC, "--vehicle", REVISED),
    # closing the loop: ten practice records in two processes, one in one process, measured ones, a user-defined effect
    _cli("close_loop_practice", "close-loop", PRACTICE, *WORKERS),
    _cli("close_loop_one", "close-loop", f"{PRACTICE}/p08"),
    _cli("close_loop_measured", "close-loop", f"{RECORDS}/sts96_480"),
    _cli("close_loop_board", "close-loop", f"{RECORDS}/kaowool_board"),
    _cli("close_loop_user_effect", "close-loop", "{root}/synthesize_shock_passage/out", **EFFECTS),
    # planning
    _cli("design_popu", "design", "scenarios/design_popu.toml", "--evaluations", "8", "--repetitions", "4"),
    _cli("design_flap", "design", "scenarios/design_flap.toml", "--evaluations", "4"),
    _cli("plan_envelope", "plan", "scenarios/studies/small_envelope.toml", *WORKERS),
    _cli("plan_axes", "plan", "{root}/inputs/axes.toml", "--vehicle", REVISED, *WORKERS),
    _cli("plan_dispersion", "plan", "scenarios/studies/dispersed_small.toml", *WORKERS),
    _cli("plan_dispersion_inputs", "plan", "{root}/inputs/dispersion.toml", *WORKERS),
    _cli("plan_optimal", "plan", "{root}/inputs/optimal.toml", *WORKERS),
    # FMUs: exported, simulated by FMPy, flown as a trajectory
    _cli("fmu_heating", "fmu", "export", "orbiter", out="{out}/heating.fmu"),
    _cli(
        "fmu_heating_fmi2", "fmu", "export", "capsule", "--fmi", "2", "--reference", "columns", out="{out}/heating.fmu"
    ),
    _cli("fmu_entry", "fmu", "trajectory", "scenarios/entry_3dof.toml", out="{out}/entry.fmu"),
    *(
        Command(f"{name}_frames", ((*FRAMES, f"{{root}}/{name}/out/{fmu}", "{out}/frames.npz", *inputs),), own=True)
        for name, fmu, inputs in (
            ("fmu_heating", "heating.fmu", ("--record", f"{{repository}}/{PRACTICE}/p06")),
            ("fmu_heating_fmi2", "heating.fmu", ("--record", f"{{repository}}/{PRACTICE}/p06")),
            ("fmu_entry", "entry.fmu", ()),
        )
    ),
    _cli("run_fmu", "run", "{root}/inputs/flown_fmu.toml", "--root", "{root}"),
    # tables made of their sources, records made of measured histories: module commands that may have become others
    Command(
        "ratio_tables",
        tuple(
            (*how, "{out}/orbiter", "{out}/capsule")
            for how in (
                ("-m", "sim_heating.ratio_sources"), (*CLI, "ratio-tables"),
            )
        ),
    ),
    Command(
        "compared_records",
        tuple(
            (*how, "scenarios/sts96_iss.toml", *out)
            for how, out in (
                (("-m", "sim_heating.compared_records"), ("{out}",)),
                ((*CLI, "measured-records"), ("--out", "{out}")),
            )
        ),
    ),
    Command(
        "validate",
        (
            (
                *CLI, "validate", "aircraft_data/orbiter", "aircraft_data/capsule", "scenarios/sts2.toml",
                f"{PRACTICE}/p04", f"{RECORDS}/sts96_480", "aircraft_data/orbiter/ratio_tables/BODYFLAP.csv",
            ),
        ),
    ),
)  # fmt: skip

VEHICLE_COPIES = {"ratio_tables": ("orbiter", "capsule")}
"""Vehicles that a command changes in place: it gets copies in its own folder."""

INPUTS = HERE / "tests" / "data" / "small_inputs"
"""Studies and scenarios smaller than those of the repository, copied to OUT/inputs and read from there."""


@dataclass(frozen=True)
class Version:
    """The version that is run: its checkout, its interpreter, and OUT, all absolute."""

    repository: Path
    python: str
    root: Path

    def environment(self) -> dict[str, str]:
        """Variables of a command: the checkout is the package that is imported; pictures without a display."""
        kept = {k: v for k, v in os.environ.items() if not k.startswith("SIM_HEATING_")}
        fixed = {"PYTHONPATH": str(self.repository), "MPLBACKEND": "Agg", "COLUMNS": "200", "NO_COLOR": "1"}
        return kept | fixed

    def put_in(self, text: str, command: Command) -> str:
        """A text of a command with its places put in."""
        places = {"out": self.root / command.name / "out", "root": self.root, "repository": self.repository}
        for name, place in places.items():
            text = text.replace(f"{{{name}}}", str(place))
        return text


def run_command(command: Command, version: Version) -> dict[str, Any]:
    """Run one command, keep its output and what became of it in its folder, and return the latter."""
    folder = version.root / command.name
    (folder / "out").mkdir(parents=True)
    for vehicle in VEHICLE_COPIES.get(command.name, ()):
        shutil.copytree(version.repository / "aircraft_data" / vehicle, folder / "out" / vehicle)
    environment = version.environment() | {k: version.put_in(v, command) for k, v in command.environment.items()}
    if command.own:
        environment["PYTHONPATH"] = str(HERE)
    for invocation in command.invocations:
        arguments = [version.put_in(a, command) for a in invocation]
        python, place = (sys.executable, HERE) if command.own else (version.python, version.repository)
        begun = time.perf_counter()
        status = _execute([python, *arguments], place, environment, folder)
        wall_s = time.perf_counter() - begun
        if status == 0 or not any(text in (folder / "stderr.txt").read_text() for text in ABSENT):
            break
    result = {"arguments": arguments, "exit_status": status, "wall_s": wall_s}
    (folder / RUN).write_text(json.dumps(result, indent=1) + "\n")
    return result


def _execute(command: list[str], place: Path, environment: Mapping[str, str], folder: Path) -> int:
    """Exit status of a process whose output goes to files; -1000 where it took too long."""
    with (folder / "stdout.txt").open("w") as out, (folder / "stderr.txt").open("w") as err:
        try:
            done = subprocess.run(
                command, cwd=place, env=dict(environment), stdout=out, stderr=err, stdin=subprocess.DEVNULL,
                timeout=LONGEST_S,
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            err.write(f"ended after {LONGEST_S:g} s\n")
            return -1000
    return done.returncode


def _about(version: Version) -> dict[str, Any]:
    """What was run, where, by what."""
    shown = "import sys, numpy, scipy, numba, sim_heating as s; print(s.__file__, sys.version.split()[0])"
    shown += "; print(*(f'{m.__name__} {m.__version__}' for m in (numpy, scipy, numba)), sep=', ')"
    found = subprocess.run(
        [version.python, "-c", shown], cwd=version.repository, env=version.environment(), capture_output=True, text=True
    )
    if found.returncode != 0:
        raise click.ClickException(f"{version.python} cannot import the package: {found.stderr.strip()}")
    commit = subprocess.run(
        ["git", "describe", "--always", "--dirty"], cwd=version.repository, capture_output=True, text=True
    )
    package, libraries = found.stdout.strip().splitlines()
    return {
        "root": str(version.root), "repository": str(version.repository), "commit": commit.stdout.strip(),
        "package": package, "libraries": libraries, "machine": f"{platform.platform()}, {os.cpu_count()} cores",
    }  # fmt: skip


def _chosen(only: tuple[str, ...]) -> Iterator[Command]:
    unknown = set(only) - {c.name for c in COMMANDS}
    if unknown:
        raise click.UsageError(f"unknown: {', '.join(sorted(unknown))}; known: {', '.join(c.name for c in COMMANDS)}")
    return (c for c in COMMANDS if not only or c.name in only)


@click.group(help=__doc__)
def main() -> None:
    """Run, or compare."""


@main.command()
@click.argument("out", type=click.Path(path_type=Path))
@click.option("--python", default=sys.executable, show_default=True, help="interpreter that runs the commands")
@click.option(
    "--repository",
    type=click.Path(path_type=Path, exists=True, file_okay=False),
    default=Path(),
    show_default=True,
    help="checkout whose package, scenarios and vehicles are used",
)
@click.option("--only", multiple=True, metavar="NAME", help="run this command of the list; may be given again")
def run(out: Path, python: str, repository: Path, only: tuple[str, ...]) -> None:
    """Run the list of commands, and keep everything that they write in OUT."""
    chosen = list(_chosen(only))
    root = out.resolve()
    if root.exists() and any(root.iterdir()):
        raise click.UsageError(f"{out} is not empty")
    interpreter = str(Path(python).absolute()) if os.sep in python else python
    version = Version(repository.resolve(), interpreter, root)
    about = _about(version)
    click.echo(f"{about['package']}, {about['commit']}; {about['libraries']}")
    shutil.copytree(INPUTS, root / "inputs")
    (root / RUN).write_text(json.dumps(about, indent=1) + "\n")
    results = {}
    for command in chosen:
        results[command.name] = result = run_command(command, version)
        click.echo(f"{result['wall_s']:7.1f} s  status {result['exit_status']}  {command.name}")
    failed = [name for name, result in results.items() if result["exit_status"] != 0]
    click.echo(f"{sum(r['wall_s'] for r in results.values()):7.1f} s  {len(results)} commands")
    for name in failed:
        last = (root / name / "stderr.txt").read_text().strip().splitlines()[-1:]
        click.echo(f"status {results[name]['exit_status']}: {name}: {shlex.join(results[name]['arguments'])}: {last}")


@main.command()
@click.argument("before", type=click.Path(path_type=Path, exists=True, file_okay=False))
@click.argument("after", type=click.Path(path_type=Path, exists=True, file_okay=False))
@click.option("--renames", type=click.Path(path_type=Path, exists=True, dir_okay=False), help="names old = new (TOML)")
@click.option("--tolerance", default=0.0, show_default=True, help="largest relative difference that is let pass")
def compare(before: Path, after: Path, renames: Path | None, tolerance: float) -> None:
    """Compare every array and number of two runs; exit status 1 where one differs."""
    found = compare_folders(before, after, load_renames(renames))
    click.echo(found.report(tolerance))
    sys.exit(0 if found.same(tolerance) else 1)


@main.command(hidden=True)
@click.argument("fmu", type=click.Path(path_type=Path))
@click.argument("file", type=click.Path(path_type=Path))
@click.option("--record", type=click.Path(path_type=Path), help="flight record whose conditions are the inputs")
@click.option("--until", default=1400.0, help="end [s]")
def frames(fmu: Path, file: Path, record: Path | None, until: float) -> None:
    """Simulate an FMU with FMPy at steps of 1 s, and keep all its outputs."""
    variables = fmpy.read_model_description(str(fmu)).modelVariables
    inputs = None
    if record is not None:
        flown = np.genfromtxt(record / "conditions.csv", delimiter=",", names=True, comments="#")
        known = {v.name for v in variables if v.causality == "input"}
        names = ["time_s", *(n for n in flown.dtype.names or () if n in known)]
        inputs = np.array(flown[names].tolist(), dtype=[("time" if n == "time_s" else n, float) for n in names])
    outputs = [v.name for v in variables if v.causality == "output" and not v.shape]
    flown = fmpy.simulate_fmu(str(fmu), stop_time=until, output_interval=1.0, input=inputs, output=outputs)
    np.savez(file, **{name: flown[name] for name in flown.dtype.names})


if __name__ == "__main__":
    main()
