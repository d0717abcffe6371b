"""The commands `sim-heating fmu export` and `sim-heating fmu trajectory`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from sim_heating.base.errors import InputError, error_context
from sim_heating.cli.console import CONSOLE, PATH, ROOT, comma_list, progress_line
from sim_heating.cli.output import report_files, report_results

if TYPE_CHECKING:
    from sim_heating.simulation.fmu_export.image import Image


def _fmu_file(_: click.Context, __: click.Parameter, value: Path) -> Path:
    """Value of --out; a file that cannot be written is refused before any work."""
    from sim_heating.base.files import require_exclusive
    from sim_heating.simulation.fmu_export.archive import require_replaceable

    if value.suffix != ".fmu":
        raise InputError(f"--out {value}: name a file that ends in .fmu")
    if value.is_dir():
        raise InputError(f"--out {value}: is a directory; name a file that ends in .fmu")
    with error_context("--out"):
        require_replaceable(value)
    require_exclusive(value.parent)
    return value


FMU_OUT = click.option("--out", required=True, type=PATH, callback=_fmu_file, help="the FMU, a file that ends in .fmu")
FMI = click.option(
    "--fmi", type=click.Choice(["2", "3"]), default="3", show_default=True, help="version of the standard"
)
PLATFORMS = click.option(
    "--platforms",
    default="linux",
    show_default=True,
    callback=comma_list,
    help="separated by commas; platforms other than linux need ziglang",
)


@click.group()
def fmu() -> None:
    """Models as FMUs that need no Python where they run."""


@fmu.command("export")
@click.argument("vehicle")
@FMU_OUT
@click.option(
    "--control-points", "points", callback=comma_list, help="names, separated by commas; default: all of the vehicle's"
)
@FMI
@PLATFORMS
@click.option(
    "--reference",
    type=click.Choice(["vehicle", "columns"]),
    default="vehicle",
    show_default=True,
    help="source of h_ref and H_r: the vehicle's reference heating, or inputs of the FMU",
)
@click.option(
    "--input-timing",
    type=click.Choice(["held", "reached"]),
    default="held",
    show_default=True,
    help="default of the variable input_timing: inputs set before a step are values at its start, or at its end",
)
@ROOT
def export(
    vehicle: str,
    out: Path,
    points: tuple[str, ...] | None,
    fmi: str,
    platforms: tuple[str, ...],
    reference: str,
    input_timing: str,
    root: Path | None,
) -> None:
    """The heating plug-in of a vehicle as a co-simulation FMU."""
    from sim_heating.inputs.vehicle import load_vehicle
    from sim_heating.simulation.fmu_export.export import export_fmu, targets_of

    targets_of(platforms, int(fmi))
    with progress_line("fmu export") as progress:
        progress(0.1, "compiling, unless compiled before")
        loaded = load_vehicle(vehicle, root=root)
        columns = reference == "columns"
        image = export_fmu(
            loaded, out, points, fmi=int(fmi), platforms=platforms, columns=columns, input_timing=input_timing,
            progress=progress,
        )  # fmt: skip
    names = list(loaded.control_points) if points is None else list(points)
    _print_export(out, image, fmi, platforms, names)


@fmu.command("trajectory")
@click.argument("scenario", type=PATH)
@FMU_OUT
@FMI
@PLATFORMS
@ROOT
def trajectory(scenario: Path, out: Path, fmi: str, platforms: tuple[str, ...], root: Path | None) -> None:
    """The built-in 3-DOF entry of a scenario as a co-simulation FMU."""
    from sim_heating.base.files import display_path
    from sim_heating.inputs.scenario import load_scenario
    from sim_heating.simulation.fmu_export.entry import export_entry, require_entry_source
    from sim_heating.simulation.fmu_export.export import targets_of

    loaded = load_scenario(scenario, root=root)
    spec, vehicle = loaded.declared.trajectory, loaded.vehicle.directory
    with error_context(f"{display_path(scenario)}, [trajectory]"):
        require_entry_source(spec)
    targets_of(platforms, int(fmi))
    with progress_line("fmu trajectory") as progress:
        progress(0.1, "compiling, unless compiled before")
        image = export_entry(
            spec, vehicle, out, title=loaded.title, fmi=int(fmi), platforms=platforms, progress=progress
        )
    _print_export(out, image, fmi, platforms)


def _print_export(
    out: Path, image: Image, fmi: str, platforms: tuple[str, ...], points: list[str] | None = None
) -> None:
    """Print version, control points, platforms and size of an FMU that was written."""
    from sim_heating.simulation.fmu_export.description import variables_of

    count = sum(1 for _ in variables_of(image, int(fmi)))
    content = "" if points is None else f"{len(points)} control points, "
    about = f"FMI {fmi}.0, {content}{count} variables, {', '.join(platforms)}, {out.stat().st_size / 1e6:.2f} MB"
    CONSOLE.print(f"Wrote {out}: {about}", soft_wrap=True)
    report_files(None, [out])
    found = {"fmi": f"{fmi}.0", "variables": count, "platforms": platforms, "bytes": out.stat().st_size}
    report_results(found if points is None else found | {"control_points": points})
