"""The commands `run`, `synthesize`, `predict` and `demo`: fly, measure, and compare with measurements."""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import click
from rich.table import Table
from rich.text import Text

from sim_heating.base.errors import InputError
from sim_heating.cli.console import CONSOLE, OUT, PATH, print_outputs, progress_line


@click.command()
@click.argument("scenario", type=PATH)
@OUT
def run(scenario: Path, out: Path) -> None:
    """Fly a scenario: trajectory, heating, temperatures, plots."""
    from sim_heating.base.files import require_writable
    from sim_heating.inputs.scenario import load_scenario
    from sim_heating.simulation.run import files_of, rmse_by_point, run, summary, write_run

    loaded = load_scenario(scenario)
    require_writable(out, files_of(loaded))
    with progress_line(loaded.title) as progress:
        result = run(loaded, progress=progress)
        names = write_run(result, out, progress=progress)
    found = summary(result)
    CONSOLE.print(_run_table(loaded.title, found, rmse_by_point(result)))
    _tell_run(found)
    print_outputs(out, names)


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


@click.command()
@click.argument("scenario", type=PATH)
@OUT
def synthesize(scenario: Path, out: Path) -> None:
    """Fly a scenario and write it as flight records, with the sensor model applied."""
    import numpy as np

    from sim_heating.base.files import require_writable
    from sim_heating.inputs.scenario import load_scenario
    from sim_heating.simulation.synthesize import files_of, write_records
    from sim_heating.simulation.synthesize import synthesize as fly_and_measure

    loaded = load_scenario(scenario)
    if not any(loaded.vehicle.control_point(name).sensors for name in loaded.names):
        raise InputError(f"{scenario}: none of its control points has a sensor; choose one that has")
    require_writable(out, files_of(loaded))
    with progress_line(loaded.title) as progress:
        records = fly_and_measure(loaded, progress=progress)
        names = write_records(loaded, records, out)
    samples = sum(int(np.sum(np.isfinite(r.temperatures_K()))) for r in records.values())
    count = f"{len(records)} record" + ("s" if len(records) > 1 else "")
    CONSOLE.print(f"{count}, {samples} readings, seed {loaded.declared.measurements.seed}")
    print_outputs(out, names)


@click.command()
@OUT
def demo(out: Path) -> None:
    """The main job: a JSBSim entry through a Mach-20 POPU, its thermocouple data, and a comparison with STS-96."""
    from sim_heating.base.files import require_writable
    from sim_heating.inputs.scenario import load_scenario
    from sim_heating.simulation import run, synthesize

    popu, sts96 = (load_scenario(_scenario_folder() / f"{name}.toml") for name in ("popu_mach20", "sts96"))
    for home, scenario, made in (("popu", popu, run), ("records", popu, synthesize), ("sts96", sts96, run)):
        require_writable(out / home, made.files_of(scenario))
    spawned = get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=spawned) as beside, progress_line("demo") as progress:
        compared = beside.submit(_run_and_write, sts96.path, out / "sts96")
        flown = run.run(popu, progress=lambda f, text: progress(0.6 * f, f"POPU {text}"))
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
    print_outputs(out, names)


def _run_and_write(scenario: Path, out: Path) -> tuple[dict[str, float], list[str]]:
    """Run a scenario, write its files; RMSE [K] against measured histories by control point, and names of files."""
    from sim_heating.inputs.scenario import load_scenario
    from sim_heating.simulation.run import rmse_by_point, run, write_run

    result = run(load_scenario(scenario))
    return rmse_by_point(result), write_run(result, out)


def _scenario_folder() -> Path:
    """The project's scenarios: beside the package in a checkout, within it when installed, else in this directory."""
    from sim_heating.base.files.package import data_folders

    for folder in (*data_folders("scenarios"), Path("scenarios")):
        if (folder / "popu_mach20.toml").is_file():
            return folder
    raise InputError("scenarios: not found here; run the demo in a checkout of the project")


@click.command()
@click.argument("records", type=PATH, nargs=-1, required=True)
@OUT
@click.option("--vehicle", help="take ratio tables and effects of this vehicle in place of the records' own tables")
def predict(records: tuple[Path, ...], out: Path, vehicle: str | None) -> None:
    """Predict the temperatures of flight records with their declared models, nothing fitted."""
    from sim_heating.base.files import require_writable
    from sim_heating.inputs.points import point_with_table_of
    from sim_heating.inputs.record import load_record, require_distinct_records
    from sim_heating.inputs.vehicle import load_vehicle
    from sim_heating.simulation.predict import FILES, summary, write_prediction
    from sim_heating.simulation.predict import predict as predict_record

    loaded = [load_record(path) for path in records]
    revised = None if vehicle is None else load_vehicle(vehicle)
    names = [record.name for record in loaded]
    require_distinct_records(names)
    homes = [out if len(loaded) == 1 else out / name for name in names]
    for home in homes:
        require_writable(home, FILES)
    table = Table(title="Declared model against measurement", title_justify="left")
    for head in ("record", "control point", "RMSE, fit", "RMSE, holdout", "noise floor"):
        table.add_column(head, justify="left" if head in ("record", "control point") else "right")
    models = [None if revised is None else point_with_table_of(record, revised) for record in loaded]
    predictions = []
    with progress_line("predict") as progress:
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
