"""The commands `sim-heating run`, `synthesize`, `predict` and `demo`."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import sim_heating as sh
from sim_heating.base.errors import InputError, RunError, error_context
from sim_heating.cli import console

if TYPE_CHECKING:
    from sim_heating.base.report.table import Table
    from sim_heating.heating.edge_flow import EdgeFlow
    from sim_heating.inputs.record import Record
    from sim_heating.inputs.scenario import Scenario
    from sim_heating.inputs.vehicle import Vehicle
    from sim_heating.march.point import PointModel
    from sim_heating.planning.bands import Member
    from sim_heating.simulation.predict import Prediction

SHOWN_NAMES = 4
"""Control points that a line names; of the others it gives the number."""


BANDS = click.option("--bands", is_flag=True, help="95 % bands of the temperatures, by all that is uncertain")
MEMBERS = click.option(
    "--member",
    "members",
    type=(console.PATH, console.NumberRange(min=0.0, max=1e6, min_open=True)),
    multiple=True,
    metavar="ESTIMATE WEIGHT",
    help="an estimate.json that the bands take values and covariance from, or next_flight.toml of a campaign, with its "
    "weight; repeat for several",
)


def _members(members: tuple[tuple[Path, float], ...], bands: bool, root: Path | None) -> Sequence[Member]:
    """Members of the bands, none without bands; raises InputError for a member without bands."""
    if not bands:
        if members:
            raise InputError("--member: is for --bands; add that option")
        return ()
    from sim_heating.planning.bands import DECLARED, read_member

    return tuple(read_member(path, weight, root) for path, weight in members) or DECLARED


def _models(loaded: Sequence[Record], revised: Vehicle | None) -> list[tuple[PointModel, EdgeFlow | None]]:
    """Model and flow of each record: with the tables and effects of a vehicle, else as the record declares them."""
    from sim_heating.inputs.points import point_of_record, point_with_vehicle_table

    if revised is not None:
        return [point_with_vehicle_table(record, revised) for record in loaded]
    for record in loaded:
        record.require_ratio()
    return [(point_of_record(record), None) for record in loaded]


@click.command()
@click.argument("scenario", type=console.PATH)
@console.OUT
@BANDS
@MEMBERS
@click.option(
    "--plot-points",
    callback=console.comma_list,
    metavar="POINT,...",
    help="control points that are drawn, separated by commas; default: all",
)
@console.ROOT
def run(
    scenario: Path,
    out: Path,
    bands: bool,
    members: tuple[tuple[Path, float], ...],
    plot_points: tuple[str, ...] | None,
    root: Path | None,
) -> None:
    """Fly a scenario: trajectory, heating, temperatures, plots."""
    from sim_heating.base.files import require_writable
    from sim_heating.simulation.results import limits_in_words, run_table
    from sim_heating.simulation.run import files_of, require_points, rmse_by_point, summary

    loaded = sh.load_scenario(scenario, root=root)
    of_bands = _members(members, bands, root)
    if plot_points is not None:
        require_points(plot_points, loaded.names, "--plot-points")
    require_writable(out, "run", expected=files_of(loaded), inputs=loaded.files)
    with console.progress_line(loaded.title) as progress:
        result = sh.run(loaded, progress=progress)
        if bands:
            from sim_heating.planning.bands import with_bands

            progress(0.9, "marching what is uncertain")
            result = with_bands(result, of_bands)
        names = sh.write_run(result, out, points=plot_points, progress=progress)
    contents = summary(result)
    _print_with_margins(run_table(loaded.title, contents, rmse_by_point(result)))
    console.CONSOLE.print(limits_in_words(contents))
    _print_run_warnings(contents)
    console.print_outputs(out, names, "summary.json")


def _print_with_margins(table: Table) -> None:
    """Print a table with negative margins in red."""
    margins = ["margin" in column.head for column in table.layout]
    console.print_table(table, lambda i, k: "red" if margins[k] and (table.rows[i][k] or 0.0) < 0.0 else "")


def _print_run_warnings(contents: dict[str, Any]) -> None:
    """Print manoeuvres not flown, conditions outside tables, and the difference of the plug-in from the march.

    contents : summary of a run
    """
    from sim_heating.march.history import rising_bondlines
    from sim_heating.trajectory.manoeuvres import NOT_FLOWN

    for event in contents["events"]:
        if event["what"].endswith(NOT_FLOWN):
            console.print_warning(event["what"])
    _print_range_warnings(contents["control_points"])
    for line in rising_bondlines(contents["control_points"], SHOWN_NAMES):
        console.CONSOLE.print(line)
    if contents["beyond_reference"]:
        console.print_warning(contents["beyond_reference"])
    for label, c in contents["compared"].items():
        if c["table_sigmas"] is not None:
            console.CONSOLE.print(
                f"{label}: measured over predicted flux {c['flux_ratio']:.2f} where it is hot, "
                f"{c['table_sigmas']:+.1f} sigma of its ratio table"
            )
    difference = contents["plugin_apart_K"]
    if difference:
        console.CONSOLE.print(
            f"Plug-in alongside the host: surface temperatures within {max(difference.values()):.2f} K of the march"
        )


def _print_prediction_warnings(summaries: dict[str, Any]) -> None:
    _print_range_warnings(summaries)
    for name, contents in summaries.items():
        if contents["beyond_reference"]:
            console.print_warning(f"{name}: {contents['beyond_reference']}")


def _print_range_warnings(points: dict[str, Any]) -> None:
    """Print conditions outside tables and negative heating ratios, by control point or record."""
    from sim_heating.march.history import range_lines

    for line in range_lines(points, SHOWN_NAMES):
        console.print_warning(line)


@click.command()
@click.argument("scenario", type=console.PATH)
@console.OUT
@console.ROOT
def synthesize(scenario: Path, out: Path, root: Path | None) -> None:
    """Fly a scenario and write it as flight records, with the sensor model applied."""
    import numpy as np

    from sim_heating.base.files import require_writable
    from sim_heating.simulation.synthesize import files_of

    loaded = sh.load_scenario(scenario, root=root)
    if not any(loaded.vehicle.control_point(name).sensors for name in loaded.names):
        raise InputError(f"{scenario}: none of its control points has a sensor; choose one that has")
    require_writable(out, "synthesize", expected=files_of(loaded), inputs=loaded.files)
    with console.progress_line(loaded.title) as progress:
        records = sh.synthesize(loaded, progress=progress)
        names = sh.write_records(loaded, records, out)
    samples = sum(int(np.sum(np.isfinite(r.temperatures_K()))) for r in records.values())
    count = f"{len(records)} record" + ("s" if len(records) > 1 else "")
    seed = loaded.declared.measurements.seed
    console.CONSOLE.print(f"{count}, {samples} readings, seed {seed}")
    console.print_outputs(out, names, {"records": sorted(records), "readings": samples, "seed": seed})


@click.command()
@console.OUT
def demo(out: Path) -> None:
    """The main job: a JSBSim entry through a Mach-20 POPU, its thermocouple data, and a comparison with STS-96."""
    from sim_heating.base.files import require_writable
    from sim_heating.simulation import run, synthesize
    from sim_heating.simulation.results import limits_in_words, rmse_table, run_table

    popu, sts96 = (sh.load_scenario(_scenario_folder() / f"{name}.toml") for name in ("popu_mach20", "sts96"))
    popu = with_installed_source(popu)
    for folder, scenario, module in (("popu", popu, run), ("records", popu, synthesize), ("sts96", sts96, run)):
        command = module.__name__.rpartition(".")[2]
        require_writable(out / folder, command, expected=module.files_of(scenario), inputs=scenario.files)
    with _process(_run_and_write, sts96.path, out / "sts96") as compared, console.progress_line("demo") as progress:
        flown = run.run(popu, progress=lambda f, text: progress(0.6 * f, f"POPU {text}"))
        names = [f"popu/{n}" for n in run.write_run(flown, out / "popu")]
        progress(0.6, "measuring the same flight")
        records = synthesize.synthesize(popu, flight=flown.flight)
        names += [f"records/{n}" for n in synthesize.write_records(popu, records, out / "records")]
        progress(0.8, "STS-96 entry to landing, in another process")
        rmse_K, sts96_names = compared()
    names += [f"sts96/{n}" for n in sts96_names]
    contents = run.summary(flown)
    _print_with_margins(run_table(popu.title, contents, {}))
    console.CONSOLE.print(limits_in_words(contents))
    console.print_table(rmse_table(sts96.title, rmse_K))
    _print_run_warnings(contents)
    console.print_outputs(out, names, {"popu": contents, "sts96": {"rmse_K": rmse_K}})


def with_installed_source(scenario: Scenario) -> Scenario:
    """A scenario as it is, or in three degrees of freedom where it needs JSBSim, which is not installed here."""
    from dataclasses import replace
    from importlib.util import find_spec

    declared = scenario.declared
    if declared.trajectory.source != "jsbsim" or find_spec("jsbsim") is not None:
        return scenario
    console.print_warning("JSBSim is not installed: the entry is flown in three degrees of freedom")
    trajectory = declared.trajectory.model_copy(update={"source": "entry-3dof"})
    return replace(scenario, declared=declared.model_copy(update={"trajectory": trajectory}))


@contextmanager
def _process(function: Callable[..., Any], *arguments: Any) -> Iterator[Callable[[], Any]]:
    """Call a function in a process that ends with the block; yields a function that waits for the result.

    raises : what the function raised, where its result is asked for; RunError where the process was killed
    """
    from multiprocessing import get_context

    from sim_heating.base.progress import signals_deferred

    def result() -> Any:
        try:
            value = receiver.recv()
        except EOFError:
            raise RunError("another process of the command was killed; run it again") from None
        if isinstance(value, Exception):
            raise value
        return value

    spawned = get_context("spawn")
    receiver, sender = spawned.Pipe(duplex=False)
    process = spawned.Process(target=_send_result, args=(sender, function, *arguments))
    try:
        with signals_deferred():
            process.start()
            sender.close()
        yield result
    except BaseException:
        if process.pid is not None:
            process.terminate()
        raise
    finally:
        if process.pid is not None:
            process.join()
        receiver.close()


def _send_result(sender: Any, function: Callable[..., Any], *arguments: Any) -> None:
    """What a process does for `_process`; a signal ends it silently, after what is half-written is removed."""
    from sim_heating.base.progress import EndingSignals

    EndingSignals().install()
    with suppress(KeyboardInterrupt):
        try:
            sender.send(function(*arguments))
        except Exception as error:
            sender.send(error)


def _run_and_write(scenario: Path, out: Path) -> tuple[dict[str, float], list[str]]:
    """Run a scenario, write its files; RMSE [K] against measured histories by control point, and names of files."""
    from sim_heating.simulation.run import rmse_by_point

    result = sh.run(sh.load_scenario(scenario))
    return rmse_by_point(result), sh.write_run(result, out)


def _scenario_folder() -> Path:
    """The project's scenarios: of a checkout, of the installed package, or of the current directory."""
    from sim_heating.base.files.package import data_folders

    for folder in (*data_folders("scenarios"), Path("scenarios")):
        if (folder / "popu_mach20.toml").is_file():
            return folder
    raise InputError("scenarios: not found here; run the demo in a checkout of the project")


@click.command()
@click.argument("records", type=console.PATH, nargs=-1, required=True)
@console.OUT
@click.option("--vehicle", help="take ratio tables and effects of this vehicle in place of the records' own tables")
@click.option(
    "--without", callback=console.comma_list, help="declared `transition`, `catalysis` or both (commas): left out"
)
@BANDS
@MEMBERS
@console.ROOT
def predict(
    records: tuple[Path, ...],
    out: Path,
    vehicle: str | None,
    without: tuple[str, ...] | None,
    bands: bool,
    members: tuple[tuple[Path, float], ...],
    root: Path | None,
) -> None:
    """Predict the temperatures of flight records with their declared models, nothing fitted."""
    from sim_heating.base.files import require_writable
    from sim_heating.inputs.declared_effects import left_out
    from sim_heating.inputs.points import undeclared_effects
    from sim_heating.inputs.record import load_records
    from sim_heating.simulation.predict import FILES, summary
    from sim_heating.simulation.results import prediction_table

    loaded = load_records(records, root=root)
    inputs = [record.directory for record in loaded]
    revised = None
    if vehicle is not None:
        revised = sh.load_vehicle(vehicle, root=root)
        inputs.append(revised.directory)
    folders = [out if len(loaded) == 1 else out / record.name for record in loaded]
    require_writable(out, "predict", inputs=inputs)
    for folder in folders:
        require_writable(folder, "predict", expected=FILES, inputs=inputs)
    with error_context("--without"):
        absent = left_out(without or ())
    models = _models(loaded, revised)
    of_bands = _members(members, bands, root)

    predictions = []
    with console.progress_line("predict") as progress:
        for i, (record, (model, flow)) in enumerate(zip(loaded, models, strict=True)):
            progress(i / len(loaded), f"marching {record.name}")
            model = model.without_effects(absent)
            if bands:
                from sim_heating.planning.bands import predict_with_band

                prediction = predict_with_band(record, of_bands, model, flow)
            else:
                prediction = sh.predict(record, model, flow=flow)
            predictions.append(prediction)
        names = _write_predictions(predictions, folders, out)
    summaries = {p.record.name: summary(p) for p in predictions}
    console.print_table(prediction_table(list(summaries.values())))
    _print_prediction_warnings(summaries)
    if revised is None and not absent:
        for line in filter(None, map(undeclared_effects, loaded)):
            console.CONSOLE.print(line)
    console.print_outputs(out, map(str, names), "summary.json" if len(summaries) == 1 else {"records": summaries})


def _write_predictions(predictions: list[Prediction], folders: list[Path], out: Path) -> list[Path | str]:
    """Write each prediction into its folder, and the page of several; names of the files below `out`."""
    from sim_heating.simulation.predict import write_predictions_page

    names: list[Path | str] = []
    for prediction, folder in zip(predictions, folders, strict=True):
        names += [(folder / name).relative_to(out) for name in sh.write_prediction(prediction, folder)]
    return [*names, write_predictions_page(predictions, out)] if len(predictions) > 1 else names
