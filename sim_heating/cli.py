"""The command `sim-heating`: what it reads, what it writes, and one clear line where it cannot."""

from __future__ import annotations

import signal
import sys
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import click
import numpy as np
from rich.table import Table
from rich.text import Text

from sim_heating.cli_closure import close_loop
from sim_heating.cli_design import design
from sim_heating.cli_estimate import estimate
from sim_heating.cli_fmu import fmu
from sim_heating.cli_plan import plan
from sim_heating.cli_tables import update_tables
from sim_heating.console import CONSOLE, ERRORS, OUT, PATH
from sim_heating.console import progress_line as _progress
from sim_heating.console import tell_files as _tell_files
from sim_heating.errors import InputError, RunError
from sim_heating.files import require_place
from sim_heating.results import package_version


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(package_version(), prog_name="sim-heating")
def cli() -> None:
    """Aerodynamic heating beside a flight simulator: temperatures from a trajectory, and back."""
    from sim_heating.effects import own_files

    own_files()  # a folder that is none is refused by all commands alike, whether they use effects or not


for command in (close_loop, design, estimate, fmu, plan, update_tables):
    cli.add_command(command)


@cli.command()
@click.argument("scenario", type=PATH)
@OUT
def run(scenario: Path, out: Path) -> None:
    """Fly a scenario: trajectory, heating, temperatures, plots."""
    from sim_heating.run import files_of, rmse_by_point, run_scenario, summary, write_run
    from sim_heating.scenario import load_scenario

    loaded = load_scenario(scenario)
    require_place(out, files_of(loaded))
    with _progress(loaded.title) as progress:
        result = run_scenario(loaded, progress=progress)
        names = write_run(result, out, progress=progress)
    found = summary(result)
    CONSOLE.print(_run_table(loaded.title, found, rmse_by_point(result)))
    _tell_run(found)
    _tell_files(out, names)


def _run_table(title: str, found: dict[str, Any], rmse: dict[str, float]) -> Table:
    table = Table(title=title, title_justify="left")
    heads = ("control point", "peak surface", "at", "margin", "peak bondline", "margin")
    for head in (*heads, *(("RMSE against measured",) if rmse else ())):
        table.add_column(head, justify="left" if head == heads[0] else "right", no_wrap=True)
    for name, point in found["control_points"].items():
        cells = [
            name,
            f"{point['peak_surface_K']:.0f} K",
            f"{point['peak_surface_s']:.0f} s",
            _margin(point["surface_margin_K"]),
            f"{point['peak_bondline_K']:.0f} K",
            _margin(point["bondline_margin_K"]),
        ]
        table.add_row(*cells, *([f"{rmse[name]:.1f} K" if name in rmse else ""] if rmse else []))
    return table


def _margin(kelvin: float | None) -> Text:
    if kelvin is None:
        return Text("-")
    return Text(f"{kelvin:+.0f} K", style="" if kelvin >= 0.0 else "red")


def _tell_run(found: dict[str, Any]) -> None:
    """What was odd about a run: manoeuvres not flown, tables left, the plug-in apart from the march."""
    for event in found["events"]:
        if event["what"].endswith("was not reached"):
            CONSOLE.print(Text.assemble((event["what"], "red"), ": it was not flown"))
    _tell_oddities(found["control_points"])
    apart = found["plugin_apart_K"]
    if apart:
        CONSOLE.print(f"Plug-in beside the host against the march: {max(apart.values()):.2f} K apart at most")


def _tell_oddities(points: dict[str, Any]) -> None:
    """Conditions outside tables and negative ratios, by control point or record."""
    outside: dict[str, list[str]] = {}
    for name, point in points.items():
        for o in point["outside_table"]:
            outside.setdefault(o["variable"], []).append(name)
        if point["negative_ratio_s"] > 0.0:
            CONSOLE.print(f"{name}: the heating ratio was negative for {point['negative_ratio_s']:.0f} s")
    for variable, names in outside.items():
        every = [o for n in names for o in points[n]["outside_table"] if o["variable"] == variable]
        longest, farthest = max(o["duration_s"] for o in every), max(o["farthest"] for o in every)
        where = ", ".join(names[:4]) + (f" and {len(names) - 4} more" if len(names) > 4 else "")
        CONSOLE.print(
            f"{variable} lay outside the ratio tables of {where}, up to {longest:.0f} s and {farthest:.3g} beyond; the "
            "edge value was held (details in summary.json)"
        )


@cli.command()
@click.argument("scenario", type=PATH)
@OUT
def synthesize(scenario: Path, out: Path) -> None:
    """Fly a scenario and write it as flight records, with the sensor model applied."""
    from sim_heating.scenario import load_scenario
    from sim_heating.synthesize import files_of, write_records
    from sim_heating.synthesize import synthesize as fly_and_measure

    loaded = load_scenario(scenario)
    if not any(loaded.vehicle.control_point(name).sensors for name in loaded.names):
        raise InputError(f"{scenario}: none of its control points has a sensor; choose one that has")
    require_place(out, files_of(loaded))
    with _progress(loaded.title) as progress:
        records = fly_and_measure(loaded, progress=progress)
        names = write_records(loaded, records, out)
    samples = sum(int(np.sum(np.isfinite(r.temperatures_K()))) for r in records.values())
    count = f"{len(records)} record" + ("s" if len(records) > 1 else "")
    CONSOLE.print(f"{count}, {samples} readings, seed {loaded.declared.measurements.seed}")
    _tell_files(out, names)


@cli.command()
@OUT
def demo(out: Path) -> None:
    """The main job: a JSBSim entry through a Mach-20 POPU, its thermocouple data, and a comparison with STS-96."""
    from sim_heating import run, synthesize
    from sim_heating.scenario import load_scenario

    popu, sts96 = (load_scenario(_scenario_folder() / f"{name}.toml") for name in ("popu_mach20", "sts96"))
    for home, scenario, made in (("popu", popu, run), ("records", popu, synthesize), ("sts96", sts96, run)):
        require_place(out / home, made.files_of(scenario))
    spawned = get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=spawned) as beside, _progress("demo") as progress:
        compared = beside.submit(_run_and_write, sts96.path, out / "sts96")
        flown = run.run_scenario(popu, progress=lambda f, text: progress(0.6 * f, f"POPU {text}"))
        names = [f"popu/{n}" for n in run.write_run(flown, out / "popu")]
        progress(0.6, "measuring the same flight")
        records = synthesize.synthesize(popu, flight=flown.flight)
        names += [f"records/{n}" for n in synthesize.write_records(popu, records, out / "records")]
        progress(0.8, "STS-96 entry to landing, in another process")
        rmse, more = compared.result()
    names += [f"sts96/{n}" for n in more]
    found = run.summary(flown)
    CONSOLE.print(_run_table(f"{popu.title}; RMSE of '{sts96.title}'", found, rmse))
    _tell_run(found)
    _tell_files(out, names)


def _run_and_write(scenario: Path, out: Path) -> tuple[dict[str, float], list[str]]:
    """Run a scenario, write its files; RMSE [K] against measured histories by control point, and names of files."""
    from sim_heating.run import rmse_by_point, run_scenario, write_run
    from sim_heating.scenario import load_scenario

    result = run_scenario(load_scenario(scenario))
    return rmse_by_point(result), write_run(result, out)


def _scenario_folder() -> Path:
    """The project's scenarios: beside the package in a checkout, within it when installed, else in this directory."""
    package = Path(__file__).resolve().parent
    for folder in (package.parent / "scenarios", package / "scenarios", Path("scenarios")):
        if (folder / "popu_mach20.toml").is_file():
            return folder
    raise InputError("scenarios: not found here; run the demo in a checkout of the project")


@cli.command()
@click.argument("records", type=PATH, nargs=-1, required=True)
@OUT
@click.option("--vehicle", help="take ratio tables and effects of this vehicle in place of the records' own tables")
def predict(records: tuple[Path, ...], out: Path, vehicle: str | None) -> None:
    """Predict the temperatures of flight records with their declared models, nothing fitted."""
    from sim_heating.points import point_with_table_of
    from sim_heating.predict import FILES, summary, write_prediction
    from sim_heating.predict import predict as predict_record
    from sim_heating.record import load_record
    from sim_heating.vehicle import load_vehicle

    loaded = [load_record(path) for path in records]
    revised = None if vehicle is None else load_vehicle(vehicle)
    names = [record.name for record in loaded]
    if len(set(names)) < len(names):
        raise InputError(f"records: two of them are named {max(set(names), key=names.count)}; rename one")
    homes = [out if len(loaded) == 1 else out / name for name in names]
    for home in homes:
        require_place(home, FILES)
    table = Table(title="Declared model against measurement", title_justify="left")
    for head in ("record", "control point", "RMSE, fit", "RMSE, holdout", "noise floor"):
        table.add_column(head, justify="left" if head in ("record", "control point") else "right")
    models = [None if revised is None else point_with_table_of(record, revised) for record in loaded]
    predictions = []
    with _progress("predict") as progress:
        for i, record in enumerate(loaded):
            progress(i / len(loaded), f"marching {record.name}")
            predictions.append(predict_record(record, models[i]))
        for prediction, home in zip(predictions, homes, strict=True):
            write_prediction(prediction, home)
    summaries = {p.record.name: summary(p) for p in predictions}
    for record in loaded:
        table.add_row(record.name, record.declared.control_point, *_errors(summaries[record.name]))
    CONSOLE.print(table)
    _tell_oddities(summaries)
    CONSOLE.print(f"Wrote {out}: temperatures.csv, summary.json, prediction.png for each record")


def _errors(found: dict[str, Any]) -> list[str]:
    cells = [f"{found[k]['rmse_K']:.2f} K" if found[k] else "-" for k in ("fit", "holdout")]
    floor = found["noise_floor_K"]
    return [*cells, "-" if floor is None else f"{floor:.2f} K"]


@cli.command()
@click.argument("paths", type=PATH, nargs=-1, required=True)
def validate(paths: tuple[Path, ...]) -> None:
    """Check records, scenarios, tables or vehicles; say what is wrong."""
    from sim_heating.validate import validate as check

    for path in paths:
        found = check(path)
        CONSOLE.print(f"{path}: good. {found.summary}", soft_wrap=True)


def _stop(*_: object) -> None:
    raise KeyboardInterrupt


def main(arguments: list[str] | None = None) -> int:
    """Run the command; 0 done, 1 a run that failed or was interrupted, 2 bad usage or input."""
    for name in ("SIGTERM", "SIGHUP"):  # Windows has but the first; nohup ignores the second
        number = getattr(signal, name, None)
        if number is not None and signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _stop)
    try:
        cli.main(arguments, prog_name="sim-heating", standalone_mode=False)
    except click.exceptions.Exit as stop:
        return stop.exit_code
    except click.ClickException as error:
        ERRORS.print(f"error: {error.format_message()}")
        return 2
    except InputError as error:
        ERRORS.print(f"error: {error}")
        return 2
    except RunError as error:
        ERRORS.print(f"failed: {error}")
        return 1
    except OSError as error:
        ERRORS.print(f"failed: {error.filename or 'system'}: {error.strerror or error}")
        return 1
    except (KeyboardInterrupt, click.Abort):
        ERRORS.print("interrupted: nothing was left half-written")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
