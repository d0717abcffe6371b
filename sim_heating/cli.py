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

from sim_heating.cli_closure import close_loop
from sim_heating.cli_design import design
from sim_heating.cli_fmu import fmu
from sim_heating.cli_plan import plan
from sim_heating.cli_tables import update_tables
from sim_heating.console import CONSOLE, ERRORS, OUT, PATH
from sim_heating.console import parameter_names as _names
from sim_heating.console import progress_line as _progress
from sim_heating.console import tell_files as _tell_files
from sim_heating.errors import InputError, RunError
from sim_heating.results import package_version


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(package_version(), prog_name="sim-heating")
def cli() -> None:
    """Aerodynamic heating beside a flight simulator: temperatures from a trajectory, and back."""


for command in (close_loop, design, fmu, plan, update_tables):
    cli.add_command(command)


@cli.command()
@click.argument("scenario", type=PATH)
@OUT
def run(scenario: Path, out: Path) -> None:
    """Fly a scenario: trajectory, heating, temperatures, plots."""
    from sim_heating.run import rmse_by_point, run_scenario, summary, write_run
    from sim_heating.scenario import load_scenario

    loaded = load_scenario(scenario)
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


def _margin(kelvin: float | None) -> str:
    if kelvin is None:
        return "-"
    return f"{kelvin:+.0f} K" if kelvin >= 0.0 else f"[red]{kelvin:+.0f} K[/red]"


def _tell_run(found: dict[str, Any]) -> None:
    """What was odd about a run: manoeuvres not flown, tables left, the plug-in apart from the march."""
    for event in found["events"]:
        if event["what"].endswith("was not reached"):
            CONSOLE.print(f"[red]{event['what']}[/red]: it was not flown")
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
    from sim_heating.synthesize import synthesize as fly_and_measure
    from sim_heating.synthesize import write_records

    loaded = load_scenario(scenario)
    with _progress(loaded.title) as progress:
        records = fly_and_measure(loaded, progress=progress)
        if not records:
            raise InputError(f"{scenario}: none of its control points has a sensor; choose one that has")
        names = write_records(loaded, records, out)
    samples = sum(int(np.sum(np.isfinite(r.temperatures_K()))) for r in records.values())
    count = f"{len(records)} record" + ("s" if len(records) > 1 else "")
    CONSOLE.print(f"{count}, {samples} readings, seed {loaded.declared.measurements.seed}")
    _tell_files(out, names)


@cli.command()
@OUT
def demo(out: Path) -> None:
    """The main job: a JSBSim entry through a Mach-20 POPU, its thermocouple data, and a comparison with STS-96."""
    from sim_heating.run import run_scenario, summary, write_run
    from sim_heating.scenario import load_scenario
    from sim_heating.synthesize import synthesize as fly_and_measure
    from sim_heating.synthesize import write_records

    popu, sts96 = (load_scenario(_scenario_folder() / f"{name}.toml") for name in ("popu_mach20", "sts96"))
    spawned = get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=spawned) as beside, _progress("demo") as progress:
        compared = beside.submit(_run_and_write, sts96.path, out / "sts96")
        flown = run_scenario(popu, progress=lambda f, text: progress(0.6 * f, f"POPU {text}"))
        names = [f"popu/{n}" for n in write_run(flown, out / "popu")]
        progress(0.6, "measuring the same flight")
        records = fly_and_measure(popu, flight=flown.flight)
        names += [f"records/{n}" for n in write_records(popu, records, out / "records")]
        progress(0.8, "STS-96 entry to landing, in another process")
        rmse, more = compared.result()
    names += [f"sts96/{n}" for n in more]
    found = summary(flown)
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
    from sim_heating.predict import predict as predict_record
    from sim_heating.predict import summary, write_prediction
    from sim_heating.record import load_record
    from sim_heating.vehicle import load_vehicle

    loaded = [load_record(path) for path in records]
    revised = None if vehicle is None else load_vehicle(vehicle)
    names = [record.name for record in loaded]
    if len(set(names)) < len(names):
        raise InputError(f"records: two of them are named {max(set(names), key=names.count)}; rename one")
    table = Table(title="Declared model against measurement", title_justify="left")
    for head in ("record", "control point", "RMSE, fit", "RMSE, holdout", "noise floor"):
        table.add_column(head, justify="left" if head in ("record", "control point") else "right")
    models = [None if revised is None else point_with_table_of(record, revised) for record in loaded]
    predictions = []
    with _progress("predict") as progress:
        for i, record in enumerate(loaded):
            progress(i / len(loaded), f"marching {record.name}")
            predictions.append(predict_record(record, models[i]))
        for prediction in predictions:
            write_prediction(prediction, out if len(loaded) == 1 else out / prediction.record.name)
    summaries = {p.record.name: summary(p) for p in predictions}
    for record in loaded:
        table.add_row(record.name, record.declared.control_point, *_errors(summaries[record.name]))
    CONSOLE.print(table)
    _tell_oddities(summaries)
    CONSOLE.print(f"Wrote {out}: temperatures.csv, summary.json, prediction.png for each record", highlight=False)


def _errors(found: dict[str, Any]) -> list[str]:
    cells = [f"{found[k]['rmse_K']:.2f} K" if found[k] else "-" for k in ("fit", "holdout")]
    floor = found["noise_floor_K"]
    return [*cells, "-" if floor is None else f"{floor:.2f} K"]


def _condition(_: click.Context, __: click.Parameter, value: str | None) -> dict[str, float]:
    """`alpha_deg=40,...` as a condition."""
    from sim_heating.conditions import RATIO_VARIABLES
    from sim_heating.files import suggestion

    found = {}
    for item in (value or "").split(","):
        if not item.strip():
            continue
        name, _equals, number = (part.strip() for part in item.partition("="))
        if name not in RATIO_VARIABLES:
            raise InputError(f"--reference: `{name}` is no ratio variable. {suggestion(name, RATIO_VARIABLES)}")
        try:
            found[name] = float(number)
        except ValueError:
            raise InputError(f"--reference: {name}: `{number}` is not a number; write {name}=40") from None
        if not np.isfinite(found[name]):
            raise InputError(f"--reference: {name}: `{number}` is not a finite number; write {name}=40")
    return found


def _fit_segments(_: click.Context, __: click.Parameter, value: tuple[str, ...]) -> list[list[float]]:
    """`640,760`, as often as there are segments."""
    found = []
    for item in value:
        try:
            start, end = (float(part) for part in item.split(","))
        except ValueError:
            raise InputError(f"--fit: `{item}` is not a segment; write --fit 640,760 (start and end in s)") from None
        if not start < end:
            raise InputError(f"--fit: {item}: the start must lie before the end")
        found.append([start, end])
    return found


def _start(_: click.Context, __: click.Parameter, value: str) -> Any:
    """`declared`, or `circuit:650` and the like: how a fit starts, as a maker of starts."""
    from sim_heating.estimation.initial import STARTS
    from sim_heating.files import suggestion

    if value == "declared":
        return None
    kind, _colon, at = value.partition(":")
    if kind not in STARTS:
        raise InputError(f"--start: `{kind}` is no way to start. {suggestion(kind, ['declared', *STARTS])}")
    try:
        time_s = float(at)
    except ValueError:
        raise InputError(f"--start: `{at}` is not a time in s; write {kind}:650") from None
    return lambda record, model, mesh: STARTS[kind](record, model, mesh, time_s)


def _process_noise(nodes: str | None, ratio: str | None) -> Any:
    """What `--process-noise` and `--ratio-noise` say; None where neither is given."""
    from sim_heating.estimation.process_noise import CORRELATION, FIRST_GUESS, NODE, RATIO, ProcessNoise

    if nodes is None and ratio is None:
        return None
    q, sigma, tau, looked_for = 0.0, 0.0, ProcessNoise().ratio_correlation_s, []
    if nodes == ESTIMATED:
        q, looked_for = FIRST_GUESS[NODE], [NODE]
    elif nodes is not None:
        q = _level(nodes, f"--process-noise {nodes}: give K/sqrt(s), as 0.2, or `{ESTIMATED}`")
    if ratio is not None:
        first, _comma, time_s = ratio.partition(",")
        hint = f"--ratio-noise {ratio}: give sigma and correlation time in s, as 0.01,30, or `{ESTIMATED}`"
        if first == ESTIMATED:
            sigma, looked_for = FIRST_GUESS[RATIO], [*looked_for, RATIO]
        else:
            sigma = _level(first, hint)
        if time_s:
            tau = _level(time_s, hint)
        elif first == ESTIMATED:
            looked_for.append(CORRELATION)
        if tau == 0.0 or not (time_s or first == ESTIMATED):
            raise InputError(hint)
    return ProcessNoise(q, sigma, tau, tuple(looked_for))


ESTIMATED = "estimated"
"""Of a level of noise that is to be found."""


def _level(text: str, hint: str) -> float:
    """A number that is not negative."""
    try:
        found = float(text)
    except ValueError:
        raise InputError(hint) from None
    if not 0.0 <= found < float("inf"):
        raise InputError(hint)
    return found


@cli.command()
@click.argument("records", type=PATH, nargs=-1, required=True)
@OUT
@click.option("--parameters", callback=_names, help="dotted names, with commas; default: magnitude and derivatives")
@click.option("--reference", callback=_condition, help="alpha_deg=40,... that derivatives are about")
@click.option("--start", default="declared", callback=_start, help="declared, or circuit, profile, filter:TIME_S")
@click.option(
    "--fit",
    "fit",
    multiple=True,
    callback=_fit_segments,
    metavar="START,END",
    help="fit these times of each record, in s, in place of its own segments; may be given again",
)
@click.option(
    "--process-noise",
    "node_noise",
    metavar="K_PER_SQRT_S",
    help="Kalman filter: white noise of the model at every node, or `estimated`",
)
@click.option(
    "--ratio-noise",
    metavar="SIGMA,TIME_S",
    help="Kalman filter: a heating ratio that wanders, its sigma and correlation time, or `estimated`",
)
@click.option("--segments", type=float, help="instead: fit short segments of so many s in turn (one record)")
def estimate(
    records: tuple[Path, ...],
    out: Path,
    parameters: tuple[str, ...] | None,
    reference: dict[str, float],
    start: Any,
    fit: list[list[float]],
    node_noise: str | None,
    ratio_noise: str | None,
    segments: float | None,
) -> None:
    """Estimate heating and thermal parameters from the thermocouples of flight records, jointly, with bounds."""
    noise = _process_noise(node_noise, ratio_noise)
    if segments is not None:
        if noise is not None:
            raise InputError("--segments: short segments are fitted without noise of the process; leave one out")
        _estimate_trend(records, out, parameters, fit, segments)
        return
    from sim_heating.estimation.estimate import estimate as fit_records
    from sim_heating.estimation.report import result_of, write_fit
    from sim_heating.record import load_record

    loaded = [_with_fit(load_record(path), fit) for path in records]
    with _progress("estimate") as progress:
        starts = [start] * len(loaded)
        fitted = fit_records(
            loaded, parameters, reference=reference, starts=starts, process_noise=noise, progress=progress
        )
        progress(0.95, "writing")
        names = write_fit(fitted, out)
    found = result_of(fitted)
    table = Table(title=f"{', '.join(r.name for r in loaded)}: estimate", title_justify="left")
    for head in ("parameter", "value", "sigma", "unit"):
        table.add_column(head, justify="left" if head in ("parameter", "unit") else "right")
    for name, parameter in found.parameters.items():
        table.add_row(name, f"{parameter.value:.5g}", f"{parameter.sigma:.2g}", parameter.unit)
    CONSOLE.print(table)
    for name, why in found.not_estimated.items():
        CONSOLE.print(f"{name}: not estimated, {why}", highlight=False)
    for line in fitted.warnings:
        CONSOLE.print(f"[red]{line}[/red]", highlight=False)
    if fitted.innovations is not None:
        CONSOLE.print(fitted.innovations.levels.noise.words(), highlight=False)
    _tell_fit(found)
    _tell_files(out, names)


def _with_fit(record: Any, fit: list[list[float]]) -> Any:
    return record.with_fit(fit) if fit else record


def _estimate_trend(
    records: tuple[Path, ...], out: Path, parameters: tuple[str, ...] | None, fit: list[list[float]], length_s: float
) -> None:
    """Short segments of one record, one after the other."""
    from sim_heating.estimation.report import write_trend
    from sim_heating.estimation.sequence import trend
    from sim_heating.record import load_record

    if len(records) > 1:
        raise InputError(f"--segments: {len(records)} records; short segments are of one record, give them one by one")
    record = _with_fit(load_record(records[0]), fit)
    with _progress("estimate") as progress:
        found = trend(record, length_s, parameters, progress=progress)
        names = write_trend(found, out)
    CONSOLE.print(f"{len(found.segments)} segments of {length_s:g} s fitted, {len(found.left_out)} left out")
    for line in found.left_out[:3]:
        CONSOLE.print(f"left out: {line}", highlight=False)
    _tell_files(out, names)


def _tell_fit(found: Any) -> None:
    """Errors before and after, against the noise floor."""
    declared = (found.model_extra or {}).get("predicted", {})
    for what in ("fit", "holdout"):
        before, after = declared.get(what), getattr(found, what)
        if after is not None and before is not None:
            CONSOLE.print(
                f"RMSE, {what}: {before.rmse_K:.2f} K declared, {after.rmse_K:.2f} K fitted ({after.n} samples)"
            )
    if found.noise_floor_K is not None:
        CONSOLE.print(f"Noise floor: {found.noise_floor_K:.2f} K")


@cli.command()
@click.argument("paths", type=PATH, nargs=-1, required=True)
def validate(paths: tuple[Path, ...]) -> None:
    """Check records, scenarios, tables or vehicles; say what is wrong."""
    from sim_heating.validate import validate as check

    for path in paths:
        found = check(path)
        CONSOLE.print(f"{path}: good. {found.summary}", highlight=False, soft_wrap=True)


def _stop(*_: object) -> None:
    raise KeyboardInterrupt


def main(arguments: list[str] | None = None) -> int:
    """Run the command; 0 done, 1 a run that failed or was interrupted, 2 bad usage or input."""
    signal.signal(signal.SIGTERM, _stop)
    try:
        cli.main(arguments, prog_name="sim-heating", standalone_mode=False)
    except click.exceptions.Exit as stop:
        return stop.exit_code
    except click.ClickException as error:
        ERRORS.print(f"error: {error.format_message()}", markup=False)
        return 2
    except InputError as error:
        ERRORS.print(f"error: {error}", markup=False)
        return 2
    except RunError as error:
        ERRORS.print(f"failed: {error}", markup=False)
        return 1
    except (KeyboardInterrupt, click.Abort):
        ERRORS.print("interrupted: nothing was left half-written", markup=False)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
