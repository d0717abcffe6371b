"""The commands `sim-heating update-tables`, `ratio-tables` and `measured-records`."""

from __future__ import annotations

from pathlib import Path

import click

from sim_heating.base.errors import InputError
from sim_heating.cli.console import CONSOLE, FORCE, OUT, PATH, ROOT, optional_directory, print_table, progress_line
from sim_heating.cli.output import report_files, report_results


@click.command("update-tables")
@click.argument("fit", type=PATH, required=False)
@click.option("--vehicle", required=True, help="name or directory of the vehicle whose table is revised")
@click.option("--out", callback=optional_directory, help="put a copy of the vehicle there and revise that")
@click.option(
    "--record",
    "records",
    type=PATH,
    multiple=True,
    help="the estimate's records, where they are not at the paths in it",
)
@click.option("--point", help="the control point, where the estimate has several")
@click.option("--check", "checked", type=PATH, multiple=True, help="another record to predict before and after")
@click.option("--accept-partly", is_flag=True, help="take what a closed loop only resembles as its cause")
@click.option("--dry-run", is_flag=True, help="show what would change and write nothing")
@click.option("--revert", metavar="POINT", help="put table and effects of this point back to the parent revision")
@ROOT
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
    with progress_line("update-tables") as progress:
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
    for part in report.update_report(updated):
        if isinstance(part, str):
            CONSOLE.print(part)
        else:
            print_table(part)
    place, made = updated.vehicle, updated.revision
    if place is None or made is None:
        CONSOLE.print("Dry run: nothing was written")
        report_results({"revision": None, "nodes_changed": updated.nodes_changed, "errors_K": updated.errors_K})
        return
    why = revision_path(place, made.control_point, made.revision, "json")
    picture = " and .png" if why.with_suffix(".png").is_file() else ""
    effects = f" and {point_path(place, made.control_point)}" if made.effects else ""
    line = f"Wrote {place / made.table}{effects}, revision {made.revision}; why: {why}{picture}"
    CONSOLE.print(line, soft_wrap=True)
    report_files(None, [place / made.table, why])
    report_results(why)


def _revert_table(vehicle: str, point: str | None, more: bool, root: Path | None) -> None:
    from sim_heating.closure.revise.revisions import revert, revising
    from sim_heating.closure.revise.update import check_target
    from sim_heating.inputs.vehicle import load_vehicle, vehicle_directory

    check_target(vehicle, None)
    if point is None:
        raise InputError("update-tables: give FIT, an estimate.json or its directory, or --revert POINT")
    if more:
        raise InputError(f"--revert {point}: takes no other option; leave out --out and --dry-run")
    with progress_line("update-tables") as progress, revising(vehicle_directory(vehicle), progress):
        undone, now = revert(load_vehicle(vehicle, root=root), point)
    CONSOLE.print(f"{point}: revision {undone} undone; revision {now} is in force, byte for byte")
    report_results({"control_point": point, "undone": undone, "revision": now})


@click.command("ratio-tables")
@click.argument("vehicles", nargs=-1, required=True)
@FORCE
@ROOT
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
            CONSOLE.print(display_path(path), soft_wrap=True)


@click.command("measured-records")
@click.argument("scenario", type=PATH)
@OUT
@ROOT
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
    from sim_heating.inputs.scenario import load_scenario
    from sim_heating.simulation.measured_records import write_compared_records

    paths = write_compared_records(load_scenario(scenario, root=root), out)
    report_files(out, files_written(out))
    report_results({"records": paths})
    for path in paths:
        CONSOLE.print(display_path(path), soft_wrap=True)
