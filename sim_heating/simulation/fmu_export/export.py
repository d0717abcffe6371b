"""An FMU as a file: description, resources and a library for each platform in one archive."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from sim_heating.base.errors import InputError
from sim_heating.base.files import exclusive
from sim_heating.base.files.text import clear_partial_files, suggestion, write_bytes_atomic
from sim_heating.base.progress import Progress, no_progress
from sim_heating.inputs.vehicle import Vehicle, load_vehicle
from sim_heating.simulation.fmu_export.heating import HeatingModel, compiling_objects, heating_image, heating_units
from sim_heating.simulation.fmu_export.parts.archive import archive_bytes, require_replaceable
from sim_heating.simulation.fmu_export.parts.description import description
from sim_heating.simulation.fmu_export.parts.image import Image
from sim_heating.simulation.fmu_export.parts.library import TARGETS, CompilationUnit, Target, shared_library
from sim_heating.simulation.fmu_export.parts.sampled_maps import map_files
from sim_heating.simulation.fmu_export.traceability import Traceability


def native_platform() -> str:
    """Name of the platform of the running process; `linux` where it is none of library.TARGETS."""
    return next((name for name, target in TARGETS.items() if target.native), "linux")


def export_fmu(
    vehicle: Vehicle | str | os.PathLike[str],
    out: str | os.PathLike[str],
    control_points: Sequence[str] | None = None,
    *,
    fmi: int = 3,
    platforms: Sequence[str] | None = None,
    columns: bool = False,
    input_timing: str = "held",
    progress: Progress = no_progress,
) -> Image:
    """Write the heating plug-in of a vehicle as a co-simulation FMU.

    vehicle        : a vehicle, its name or its directory
    out            : the FMU, a file that ends in .fmu
    control_points : names; all by default
    fmi            : version, 2 or 3
    platforms      : keys of library.TARGETS; that of this machine by default
    columns        : h_ref and H_r are inputs, instead of the vehicle's reference heating
    input_timing   : "held" or "reached", the start value of the variable `input_timing` (docs/how_to/fmu.md)
    progress       : called with the fraction done and a line of text
    raises         : InputError for an unknown name, a platform without a compiler, a place that cannot be written, a
                     file in that place that is not an unmodified export

    >>> from tempfile import TemporaryDirectory
    >>> import sim_heating as sh
    >>> with TemporaryDirectory() as folder:
    ...     image = sh.export_fmu("capsule", f"{folder}/capsule.fmu", ["FACE"])
    """
    require_replaceable(out)
    platforms = platforms or [native_platform()]
    targets = targets_of(platforms, fmi)
    loaded = load_vehicle(vehicle)
    model = heating_model(loaded, control_points, targets, columns=columns, input_timing=input_timing)

    def about() -> Mapping[str, bytes]:
        return Traceability(loaded, control_points, columns=columns).files()

    write_fmu(Path(out), model.image, heating_units(model.effects), fmi, platforms, progress, about)
    return model.image


def heating_model(
    vehicle: Vehicle | str | os.PathLike[str],
    control_points: Sequence[str] | None,
    targets: Sequence[Target],
    *,
    columns: bool = False,
    input_timing: str = "held",
) -> HeatingModel:
    """The heating plug-in of a vehicle as an image; the object files for the targets are compiled meanwhile.

    raises : as export_fmu
    """
    vehicle = load_vehicle(vehicle)
    for name in control_points or ():
        vehicle.control_point(name)
    # Packing the vehicle overlaps with the compilation in a second process.
    with compiling_objects(targets):
        return heating_image(vehicle, control_points, columns=columns, input_timing=input_timing)


def targets_of(platforms: Sequence[str], fmi: int) -> list[Target]:
    """Targets by name.

    raises : InputError for an unknown name, or a platform that this version of the standard does not name
    """
    unknown = [name for name in platforms if name not in TARGETS]
    if unknown:
        raise InputError(f"fmu: unknown platform `{unknown[0]}`{suggestion(unknown[0], TARGETS)}")
    targets = [TARGETS[name] for name in platforms]
    if fmi == 2 and any(t.fmi2 is None for t in targets):
        raise InputError("fmu: FMI 2 names no 64-bit ARM platform; export for FMI 3")
    return targets


def write_fmu(
    out: Path,
    image: Image,
    units: Sequence[CompilationUnit],
    fmi: int,
    platforms: Sequence[str],
    progress: Progress = no_progress,
    about: Callable[[], Mapping[str, bytes]] | None = None,
) -> None:
    """Write an image and the libraries of its functions as an FMU.

    units, fmi, platforms, progress, about : as `fmu_bytes` takes them
    raises : InputError where `out` is a file that is not an unmodified export
    """
    require_replaceable(out)
    write_archive(out, fmu_bytes(image, units, fmi, platforms, progress, about))


def fmu_bytes(
    image: Image,
    units: Sequence[CompilationUnit],
    fmi: int,
    platforms: Sequence[str],
    progress: Progress = no_progress,
    about: Callable[[], Mapping[str, bytes]] | None = None,
) -> bytes:
    """The FMU of an image and the libraries of its functions.

    units    : as `library` takes them
    progress : called with the fraction done and a line of text
    about    : gives further files, as `Traceability.files`; called when the libraries are made, so that an effect which
               no library can hold is refused first
    """
    targets = targets_of(platforms, fmi)
    # The token follows from the content, so that equal models are recognised as equal by a host.
    token = "{" + hashlib.sha256(image.binary("")).hexdigest()[:32] + "}"
    files = {"modelDescription.xml": description(image, token, fmi), "resources/model.bin": image.binary(token)}
    if fmi == 3:
        files |= map_files(image)
    for k, (platform, target) in enumerate(zip(platforms, targets, strict=True)):
        first = "" if target.native else "; ziglang builds its C library the first time"
        progress(0.5 * (1.0 + k / len(targets)), f"library for {platform}{first}")
        folder = target.fmi2 if fmi == 2 else target.fmi3
        path = shared_library(units, target)
        files[f"binaries/{folder}/{image.name}{target.suffix}"] = path.read_bytes()
    return archive_bytes(files | ({} if about is None else dict(about())))


def write_archive(out: Path, data: bytes) -> None:
    """Write an export whole or not at all.

    raises : InputError where `out` is a file that is not an unmodified export
    """
    with exclusive(out.parent):
        # Again: another process may have put a file there meanwhile.
        require_replaceable(out)
        clear_partial_files(out.parent, out.name)
        write_bytes_atomic(out, data)
