"""The commands `sim-heating fmu export` and `sim-heating fmu trajectory`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import sim_heating as sh
from sim_heating.base.errors import InputError, error_context
from sim_heating.cli.console import COMPILING, CONSOLE, FORCE, PATH, ROOT, HelpfulGroup, comma_list, progress_line
from sim_heating.cli.output import report_files, report_results

if TYPE_CHECKING:
    from sim_heating.inputs.scenario import Scenario
    from sim_heating.inputs.vehicle import Vehicle
    from sim_heating.simulation.fmu_export.parts.image import Image


def _archive(option: str, suffix: str, text: str, required: bool = False) -> Callable[..., Callable[..., None]]:
    """An option for a file to write, of this suffix; one that cannot be written is refused before any work."""

    def check(_: click.Context, __: click.Parameter, value: Path | None) -> Path | None:
        from sim_heating.base.files import require_exclusive
        from sim_heating.base.files.paths import portable_problem
        from sim_heating.base.files.text import abbreviated
        from sim_heating.simulation.fmu_export.parts.archive import require_replaceable

        if value is None:
            return None
        if value.suffix != suffix:
            raise InputError(f"{option} {value}: name a file that ends in {suffix}")
        if (problem := portable_problem(value.name)) is not None:
            raise InputError(f"{option} {abbreviated(str(value))}: {problem}")
        if value.is_dir():
            raise InputError(f"{option} {value}: is a directory; name a file that ends in {suffix}")
        with error_context(option):
            require_replaceable(value)
        require_exclusive(value.parent)
        return value

    return click.option(
        option, required=required, type=PATH, callback=check, help=f"{text}, a file that ends in {suffix}"
    )


def _native_platform() -> str:
    from sim_heating.simulation.fmu_export.export import native_platform

    return native_platform()


FMI = click.option(
    "--fmi", type=click.Choice(["2", "3"]), default="3", show_default=True, help="version of the standard"
)
PLATFORMS = click.option(
    "--platforms",
    default=_native_platform,
    show_default="that of this machine",
    callback=comma_list,
    help="linux, linux-arm64, windows, macos, macos-arm64, separated by commas; those of other machines need ziglang",
)


@click.group(cls=HelpfulGroup)
def fmu() -> None:
    """Models as FMUs that need no Python where they run."""


@fmu.command("export")
@click.argument("vehicle")
@FORCE
@_archive("--out", ".fmu", "the FMU")
@_archive("--ssp", ".ssp", "the heating with the trajectory that drives it, as one system (SSP 1.0, FMI 2)")
@click.option("--trajectory", type=PATH, help='with --ssp: scenario with source = "entry-3dof", whose trajectory it is')
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
    out: Path | None,
    ssp: Path | None,
    trajectory: Path | None,
    points: tuple[str, ...] | None,
    fmi: str,
    platforms: tuple[str, ...],
    reference: str,
    input_timing: str,
    root: Path | None,
) -> None:
    """The heating plug-in of a vehicle as a co-simulation FMU, or with a trajectory as a system of two FMUs."""
    from sim_heating.simulation.fmu_export.export import targets_of

    _require_what_to_write(out, ssp, trajectory, reference)
    if out is None and _is_given("fmi") and fmi != "2":
        raise InputError("--fmi 3: the FMUs of a system are FMI 2.0; leave it out, or also give --out FILE.fmu")
    if out is not None:
        targets_of(platforms, int(fmi))
    loaded, results = sh.load_vehicle(vehicle, root=root), {}
    if ssp is not None and trajectory is not None:
        results["system"] = _export_system(loaded, ssp, trajectory, points, platforms, input_timing, root)
    if out is not None:
        with progress_line("fmu export") as progress:
            progress(0.1, COMPILING)
            image = sh.export_fmu(
                loaded,
                out,
                points,
                fmi=int(fmi),
                platforms=platforms,
                columns=reference == "columns",
                input_timing=input_timing,
                progress=progress,
            )
        results |= _print_export(out, image, fmi, platforms, _names(loaded, points))
    report_results(results)


def _is_given(option: str) -> bool:
    """Whether an option of the running command was given, and is not at its default."""
    source = click.get_current_context().get_parameter_source(option)
    return source is not click.core.ParameterSource.DEFAULT


def _require_what_to_write(out: Path | None, ssp: Path | None, trajectory: Path | None, reference: str) -> None:
    """raises : InputError for options of `fmu export` that do not go together"""
    if out is None and ssp is None:
        raise InputError("fmu export: give --out FILE.fmu, --ssp FILE.ssp, or both")
    if ssp is not None and trajectory is None:
        raise InputError(
            '--ssp: also give --trajectory SCENARIO.toml, a scenario with source = "entry-3dof" that drives the heating'
        )
    if ssp is None and trajectory is not None:
        raise InputError("--trajectory: goes with --ssp FILE.ssp; for the trajectory alone use `fmu trajectory`")
    if ssp is not None and reference == "columns":
        raise InputError("--reference columns: no trajectory gives h_ref and H_r; leave it out with --ssp")


def _export_system(
    vehicle: Vehicle,
    out: Path,
    scenario: Path,
    points: tuple[str, ...] | None,
    platforms: tuple[str, ...],
    input_timing: str,
    root: Path | None,
) -> dict[str, Any]:
    """Write the heating of a vehicle and the trajectory of a scenario as one system; what --json states of it."""
    from sim_heating.base.files import display_path
    from sim_heating.simulation.fmu_export.entry import require_entry_source
    from sim_heating.simulation.fmu_export.export import targets_of
    from sim_heating.simulation.fmu_export.ssp import FMI

    flown = _scenario_of(scenario, vehicle, root)
    with error_context(f"{display_path(scenario)}, [trajectory]"):
        require_entry_source(flown.declared.trajectory)
    if flown.vehicle.directory.resolve() != vehicle.directory.resolve():
        other = flown.vehicle.name
        raise InputError(
            f"{display_path(scenario)}: flies `{other}`, not `{vehicle.name}`; export the heating of `{other}`"
        )
    targets_of(platforms, FMI)
    with progress_line("fmu export") as progress:
        progress(0.1, COMPILING)
        system = sh.export_ssp(
            vehicle,
            flown.declared.trajectory,
            out,
            points,
            title=flown.title,
            platforms=platforms,
            input_timing=input_timing,
            progress=progress,
        )
    about = f"SSP 1.0, 2 FMUs (FMI {FMI}.0), {len(system.connections)} connections, {', '.join(platforms)}"
    end = f"the scenario ends at {system.stop_s:.6g} s"
    CONSOLE.print(f"Wrote {out}: {about}, {out.stat().st_size / 1e6:.2f} MB; {end}", soft_wrap=True)
    report_files(None, [out])
    return {
        "ssp": "1.0",
        "fmi": f"{FMI}.0",
        "connections": system.connections,
        "platforms": platforms,
        "stop_time_s": system.stop_s,
        "bytes": out.stat().st_size,
        "control_points": _names(vehicle, points),
    }


def _scenario_of(path: Path, vehicle: Vehicle, root: Path | None) -> Scenario:
    """A scenario; its vehicle may lie anywhere where it is the one that the command names."""
    from sim_heating.base.files import read_toml
    from sim_heating.inputs.scenario import ScenarioFile, make_scenario

    declared = read_toml(path, ScenarioFile)
    if (path.parent / declared.vehicle).resolve() == vehicle.directory.resolve():
        return make_scenario(path, declared, vehicle, root=root)
    return sh.load_scenario(path, root=root)


def _names(vehicle: Vehicle, points: tuple[str, ...] | None) -> list[str]:
    return list(vehicle.control_points) if points is None else list(points)


@fmu.command("trajectory")
@click.argument("scenario", type=PATH)
@FORCE
@_archive("--out", ".fmu", "the FMU", required=True)
@FMI
@PLATFORMS
@ROOT
def trajectory(scenario: Path, out: Path, fmi: str, platforms: tuple[str, ...], root: Path | None) -> None:
    """The built-in 3-DOF entry of a scenario as a co-simulation FMU."""
    from sim_heating.base.files import display_path
    from sim_heating.simulation.fmu_export.entry import export_entry, require_entry_source
    from sim_heating.simulation.fmu_export.export import targets_of

    loaded = sh.load_scenario(scenario, root=root)
    spec, vehicle = loaded.declared.trajectory, loaded.vehicle.directory
    with error_context(f"{display_path(scenario)}, [trajectory]"):
        require_entry_source(spec)
    targets_of(platforms, int(fmi))
    with progress_line("fmu trajectory") as progress:
        progress(0.1, COMPILING)
        image = export_entry(
            spec, vehicle, out, title=loaded.title, fmi=int(fmi), platforms=platforms, progress=progress
        )
    report_results(_print_export(out, image, fmi, platforms))


def _print_export(
    out: Path, image: Image, fmi: str, platforms: tuple[str, ...], points: list[str] | None = None
) -> dict[str, Any]:
    """Print version, control points, platforms and size of an FMU that was written; what --json states of it."""
    from sim_heating.simulation.fmu_export.parts.description import variables_of

    count = sum(1 for _ in variables_of(image, int(fmi)))
    content = "" if points is None else f"{len(points)} control points, "
    about = f"FMI {fmi}.0, {content}{count} variables, {', '.join(platforms)}, {out.stat().st_size / 1e6:.2f} MB"
    CONSOLE.print(f"Wrote {out}: {about}", soft_wrap=True)
    report_files(None, [out])
    results = {"fmi": f"{fmi}.0", "variables": count, "platforms": platforms, "bytes": out.stat().st_size}
    return results if points is None else results | {"control_points": points}
