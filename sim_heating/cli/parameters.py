"""The command `sim-heating parameters`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

import sim_heating as sh
from sim_heating.base.errors import InputError
from sim_heating.cli import console
from sim_heating.cli.output import report_results

if TYPE_CHECKING:
    from sim_heating.estimation.parameter_list import ParameterList
    from sim_heating.inputs.scenario import Scenario

LEGEND = (
    "sigma: standard deviation that the record's readings allow, white noise, the default heating estimated as well",
    "identified: yes, even with all other parameters as uncertain as their priors; with others known, only if what "
    "acts alike is fixed; no, sigma is not below half that of the prior",
)


@click.command(epilog="Example: sim-heating parameters scenarios/records/practice/p06")
@click.argument("path", metavar="RECORD|SCENARIO", type=console.PATH)
@click.option("--out", callback=console.optional_directory, help="directory for parameters.json and parameters.csv")
@console.FORCE
@click.option(
    "--point",
    "points",
    callback=console.comma_list,
    metavar="POINT,...",
    help="of a scenario: fly it, and state what the readings of these control points identify",
)
@click.option(
    "--effect",
    "effects",
    callback=console.comma_list,
    metavar="NAME,...",
    help="also list effects that are not declared",
)
@console.ROOT
def parameters(
    path: Path,
    out: Path | None,
    points: tuple[str, ...] | None,
    effects: tuple[str, ...] | None,
    root: Path | None,
) -> None:
    """List every parameter of a flight record or scenario: unit, prior, bounds, and whether the record identifies it.

    The names are those that `estimate` and `close-loop` take after --parameters. A parameter that acts like another one
    on all readings is remarked with the correlation of their effects.
    """
    from sim_heating.estimation.parameter_list import contents, parameter_tables, write_parameters

    lists, inputs = _lists(path, points, effects or (), root)
    for table in parameter_tables(lists):
        console.print_table(table)
    if lists[0].record is not None:
        for line in LEGEND:
            console.CONSOLE.print(line)
    if out is None:
        report_results(contents(lists))
    else:
        console.print_outputs(out, write_parameters(lists, out, inputs), "parameters.json")


def _lists(
    path: Path, points: tuple[str, ...] | None, effects: tuple[str, ...], root: Path | None
) -> tuple[list[ParameterList], list[Path]]:
    """The parameters of a record or of the control points of a scenario, and the files that they are read from."""
    from sim_heating.base.files import display_path
    from sim_heating.estimation.parameter_list import scenario_parameters
    from sim_heating.inputs.record import DECLARATION

    if path.is_dir() or path.name == DECLARATION:
        if points is not None:
            raise InputError("--point: is for scenarios; a record has one control point")
        record = sh.load_record(path.parent if path.name == DECLARATION else path, root=root)
        with console.progress_line("parameters") as progress:
            return [sh.parameter_list(record, effects=effects, progress=progress)], [record.directory]
    if path.is_file() and path.suffix != ".toml":
        raise InputError(
            f"{display_path(path)}: give a flight record (a directory with {DECLARATION}) or a scenario.toml"
        )
    scenario = sh.load_scenario(path, root=root)
    if points is None:
        return scenario_parameters(scenario, effects=effects), list(scenario.files)
    return _of_points(scenario, points, effects), list(scenario.files)


def _of_points(scenario: Scenario, points: tuple[str, ...], effects: tuple[str, ...]) -> list[ParameterList]:
    """The parameters of control points, by what each does to its synthetic readings."""
    from sim_heating.simulation.run import require_points

    require_points(points, scenario.names, "--point")
    with console.progress_line("parameters") as progress:
        records = sh.synthesize(scenario, progress=lambda f, text: progress(0.8 * f, text))
        without = [name for name in points if name not in records]
        if without:
            raise InputError(f"--point: {', '.join(without)} has no thermocouple; choose a point that has")
        return [sh.parameter_list(records[name], effects=effects) for name in points]
