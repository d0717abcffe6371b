"""The commands `sim-heating update-tables`, `ratio-tables` and `measured-records`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

import sim_heating as sh
from sim_heating.base.errors import InputError
from sim_heating.cli import console
from sim_heating.cli.output import report_files, report_results

if TYPE_CHECKING:
    from sim_heating.heating.ratio.table import RatioTable


@click.command("update-tables")
@click.argument("fit", type=console.PATH, required=False)
@click.option("--vehicle", required=True, help="name or directory of the vehicle whose table is revised")
@click.option("--out", callback=console.optional_directory, help="put a copy of the vehicle there and revise that")
@click.option(
    "--record",
    "records",
    type=console.PATH,
    multiple=True,
    help="the estimate's records, where they are not at the paths in it",
)
@click.option("--point", help="the control point, where the estimate has several")
@click.option("--check", "checked", type=console.PATH, multiple=True, help="another record to predict before and after")
@click.option("--accept-partly", is_flag=True, help="take what a closed loop only resembles as its cause")
@click.option("--dry-run", is_flag=True, help="show what would change and write nothing")
@click.option("--revert", metavar="POINT", help="put table and effects of this point back to the parent revision")
@console.ROOT
def update_tables(
    fit: Path | None,
    vehicle: str,
    out: Path | None,
    records: tuple[Path, ...],
    point: str | None,
    checked: tuple[Path, ...],
    accept_partly: bool,
    dry_run: bool,
    revert: str | None,
    root: Path | None,
) -> None:
    """Write derivatives and effects of an estimate (FIT: an estimate.json or its directory) into the vehicle."""
    from sim_heating.closure.revise import report
    from sim_heating.closure.revise.revisions import point_path, revision_path

    if fit is None:
        _revert_table(vehicle, revert, out is not None or dry_run, root)
        return
    if revert is not None:
        raise InputError(f"--revert {revert}: takes no FIT; leave out {fit}")
    with console.progress_line("update-tables") as progress:
        updated = report.update_tables(
            fit,
            vehicle,
            out,
            records=records,
            point=point,
            checks=checked,
            dry_run=dry_run,
            accept_partly=accept_partly,
            root=root,
            progress=progress,
        )
    for section in report.update_report(updated):
        if isinstance(section, str):
            console.CONSOLE.print(section)
        else:
            console.print_table(section)
    directory, revision = updated.vehicle, updated.revision
    if directory is None or revision is None:
        console.CONSOLE.print("Dry run: nothing was written")
        report_results({"revision": None, "nodes_changed": updated.nodes_changed, "errors_K": updated.errors_K})
        return
    why = revision_path(directory, revision.control_point, revision.revision, "json")
    picture = " and .png" if why.with_suffix(".png").is_file() else ""
    effects = f" and {point_path(directory, revision.control_point)}" if revision.effects else ""
    line = f"Wrote {directory / revision.table}{effects}, revision {revision.revision}; why: {why}{picture}"
    console.CONSOLE.print(line, soft_wrap=True)
    report_files(None, [directory / revision.table, why])
    report_results(why)


def _revert_table(vehicle: str, point: str | None, has_other_options: bool, root: Path | None) -> None:
    from sim_heating.closure.revise.revisions import revert, revising
    from sim_heating.closure.revise.update import check_target
    from sim_heating.inputs.vehicle import checked_directory

    check_target(vehicle, None)
    if point is None:
        raise InputError("update-tables: give FIT, an estimate.json or its directory, or --revert POINT")
    if has_other_options:
        raise InputError(f"--revert {point}: takes no other option; leave out --out and --dry-run")
    directory = checked_directory(vehicle, root)
    with console.progress_line("update-tables") as progress, revising(directory, progress):
        undone, now = revert(directory, point)
    console.CONSOLE.print(f"{point}: revision {undone} undone; revision {now} is in force, byte for byte")
    report_results({"control_point": point, "undone": undone, "revision": now})


@click.command("ratio-tables")
@click.argument("vehicles", nargs=-1, required=True)
@console.FORCE
@console.ROOT
def ratio_tables(vehicles: tuple[str, ...], root: Path | None) -> None:
    """Build the heating-ratio tables of VEHICLES from the descriptions in their folders `ratio_sources`.

    VEHICLES are directories, or names of vehicles. A description, ratio_sources/NAME.toml, states the nodes of the
    table, the ratio over angle of attack (numbers, theory, or a wind-tunnel file), factors in the other variables,
    and the standard deviation. Computations read ratio_tables/POINT.csv: run this after every edit of a description.
    A table that flight data revised is not overwritten. A vehicle with one description a point, to begin with:
    `sim-heating new vehicle`.

    \b
      sim-heating ratio-tables my_vehicles/pod
    """
    from sim_heating.base.files import display_path
    from sim_heating.inputs.ratio_sources import write_tables

    for vehicle in vehicles:
        paths = write_tables(vehicle, root=root)
        report_files(None, paths)
        for path in paths:
            console.CONSOLE.print(display_path(path), soft_wrap=True)


@click.command("measured-records")
@click.argument("scenario", type=console.PATH)
@console.OUT
@console.ROOT
def measured_records(scenario: Path, out: Path, root: Path | None) -> None:
    """Make flight records of measured histories along the simulated flight of a SCENARIO.

    For temperatures that were measured, or published, without the trajectory of their flight: the scenario's flight
    stands in for it. Each history is a [[compare]] of the scenario,

    \b
      [[compare]]
      control_point = "STS96_480"     # of the vehicle, with one thermocouple
      file = "tile_480.csv"           # time_s, temperature_K, sigma_K; relative to the vehicle, or to the scenario
      label = "tile 480"
      fit_s = [[600.0, 1540.0]]       # optional: times to fit

    and becomes DIR/sts96_480, for `predict`, `estimate` and `close-loop`. With temperatures on a record that exists,
    `sim-heating new record --like RECORD` is shorter.

    \b
      sim-heating measured-records scenarios/sts96_iss.toml --out records
    """
    from sim_heating.base.files import display_path, files_written
    from sim_heating.simulation.measured_records import write_compared_records

    paths = write_compared_records(sh.load_scenario(scenario, root=root), out)
    report_files(out, files_written(out))
    report_results({"records": paths})
    for path in paths:
        console.CONSOLE.print(display_path(path), soft_wrap=True)


@click.command("table")
@click.argument("source")
@click.option(
    "--out", type=console.PATH, help="file to write; its suffix is its format; without it the table is described"
)
@click.option("--vehicle", help="with body points: the vehicle whose control points get tables; --out is then a folder")
@click.option(
    "--farthest",
    type=console.NumberRange(min=0.0),
    default=0.5,
    show_default=True,
    help="with --vehicle: most distance of a body point, m",
)
@console.FORCE
@console.ROOT
def table(source: str, out: Path | None, vehicle: str | None, farthest: float, root: Path | None) -> None:
    """Take a heating-ratio table from one file format to another.

    SOURCE is a file, or VEHICLE/POINT. Formats go by the suffix: .csv, .dml (DAVE-ML, ANSI/AIAA S-119), .nc (netCDF),
    and for output .xml: a system of JSBSim, which gives the radiative-equilibrium temperature of VEHICLE/POINT in any
    script. With --vehicle, SOURCE is a CSV file of body points as a flow solver writes it, and --out a folder.

    \b
      sim-heating table orbiter/BODYFLAP --out bodyflap.dml
      sim-heating table bodyflap.dml --out bodyflap.csv
      sim-heating table cfd.csv --vehicle capsule --out tables
      sim-heating table orbiter/aero --out aero.dml             # CN, CA, Cm of a vehicle
      sim-heating table aero.dml --out my_vehicle/aero          # and back, as its CSV files
    """
    from sim_heating.base.files import display_path
    from sim_heating.heating.exchange.ratio_formats import write_table

    if vehicle is not None:
        _tables_of_body_points(Path(source), vehicle, out, farthest, root)
        return
    name, _, point_name = source.rpartition("/")
    if Path(source).is_file() or Path(source).suffix:
        name = ""  # SOURCE is no point of a vehicle
    if out is None:
        _describe_table(source, _table_of(source, name, point_name, root))
        return
    if name and point_name == "aero":
        _export_aero(name, out, root)
        return
    if out.name == "aero":
        _import_aero(source, out)
        return
    read = _table_of(source, name, point_name, root)
    _require_no_file(out, "name")
    if out.suffix.lower() != ".xml":
        write_table(out, read)
    elif name:
        _write_jsbsim_system(name, point_name, out, root)
    else:
        raise InputError(f"{source}: a system of JSBSim needs the wall of a point; give VEHICLE/POINT as the source")
    report_files(None, [out])
    console.CONSOLE.print(f"Wrote {display_path(out)}", soft_wrap=True)


def _table_of(source: str, vehicle: str, point_name: str, root: Path | None) -> RatioTable:
    """The table of a file; of a vehicle's point where that is named."""
    from sim_heating.heating.exchange.ratio_formats import read_table

    return sh.load_vehicle(vehicle, root=root).control_point(point_name).ratio if vehicle else read_table(source)


def _describe_table(source: str, table: RatioTable) -> None:
    nodes = [len(axis) for axis in table.axes]
    shape = " x ".join(map(str, nodes))
    console.CONSOLE.print(f"{source}: {shape} nodes, ratio {table.ratio.min():.4g} to {table.ratio.max():.4g}")
    report_results({"nodes": nodes, "header": dict(table.header)})


def _require_no_file(path: Path, other: str) -> None:
    """raises : InputError where there is a file, unless files of others are replaced"""
    from sim_heating.base.files import display_path, replaces_others

    if path.exists() and not replaces_others():
        raise InputError(f"{display_path(path)}: exists; choose another {other}, or --force replaces it")


def _import_aero(source: str, out: Path) -> None:
    """Write the aerodynamic tables of a vehicle from a DAVE-ML model."""
    from sim_heating.base.files import display_path, replaces_others
    from sim_heating.trajectory.aero_exchange import import_aero

    for path in sorted(out.glob("*.csv")):
        if not replaces_others():
            raise InputError(f"{display_path(path)}: exists; choose another folder, or --force replaces it")
    for path in import_aero(source, out):
        console.CONSOLE.print(f"Wrote {display_path(path)}", soft_wrap=True)


def _export_aero(vehicle: str, out: Path, root: Path | None) -> None:
    """Write the aerodynamics of a vehicle as DAVE-ML."""
    from sim_heating.base.files import display_path, replaces_others
    from sim_heating.trajectory.aero import load_aero
    from sim_heating.trajectory.aero_exchange import export_aero

    if out.suffix.lower() != ".dml":
        raise InputError(f"{display_path(out)}: aerodynamics are written as DAVE-ML; name a file that ends in .dml")
    if out.exists() and not replaces_others():
        raise InputError(f"{display_path(out)}: exists; choose another name, or --force replaces it")
    export_aero(load_aero(sh.load_vehicle(vehicle, root=root).directory), out)
    report_files(None, [out])
    console.CONSOLE.print(f"Wrote {display_path(out)}", soft_wrap=True)


def _write_jsbsim_system(vehicle: str, point_name: str, out: Path, root: Path | None) -> None:
    """Write the system of JSBSim of a control point.

    raises : InputError where its reference heating has no counterpart in JSBSim
    """
    from sim_heating.base.files import write_text_atomic
    from sim_heating.inputs.points import wall_enthalpy_of
    from sim_heating.trajectory.jsbsim.heating_system import jsbsim_system_text

    loaded = sh.load_vehicle(vehicle, root=root)
    point = loaded.control_point(point_name)
    emissivity = point.construction.layer_materials()[0].emissivity
    if emissivity is None:
        raise InputError(f"{vehicle}/{point_name}: its outermost layer has no emissivity; give it one in its material")
    text = jsbsim_system_text(
        point_name,
        point.ratio,
        reference=loaded.heating.reference,
        nose_radius_m=loaded.heating.nose_radius_m or 1.0,
        reference_length_m=loaded.reference_length_m,
        emissivity=emissivity,
        wall_enthalpy=wall_enthalpy_of(loaded.heating.wall_enthalpy),
        recovery=point.recovery,
        where=f"{vehicle}/{point_name}",
    )
    write_text_atomic(out, text)


def _tables_of_body_points(source: Path, vehicle: str, out: Path | None, farthest_m: float, root: Path | None) -> None:
    """Write the tables of the control points of a vehicle from a file of body points."""
    from sim_heating.base.files import display_path
    from sim_heating.heating.exchange.body_points import tables_of_body_points
    from sim_heating.heating.exchange.ratio_formats import write_table

    if out is None or out.suffix:
        raise InputError("table --vehicle: give --out DIR, a folder for the tables of the control points")
    loaded = sh.load_vehicle(vehicle, root=root)
    positions = {name: loaded.control_point(name).position_m for name in loaded.control_points}
    tables = tables_of_body_points(
        source,
        positions,
        loaded.reference_length_m,
        farthest_m=farthest_m,
        reference=loaded.heating.reference,
        nose_radius_m=loaded.heating.nose_radius_m,
    )
    paths = [out / f"{name}.csv" for name in tables]
    for path in paths:
        _require_no_file(path, "folder")
    out.mkdir(parents=True, exist_ok=True)
    for path, body_table in zip(paths, tables.values(), strict=True):
        write_table(path, body_table)
        console.CONSOLE.print(f"Wrote {display_path(path)}", soft_wrap=True)
    report_files(None, paths)
    far = [name for name in positions if name not in tables]
    if far:
        console.CONSOLE.print(f"No body point within {farthest_m:g} m: {', '.join(far)}", soft_wrap=True)
    report_results({"control_points": list(tables), "too_far": far})
