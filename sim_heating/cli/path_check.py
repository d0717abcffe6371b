"""Recognise a path as a record, vehicle, scenario, study, estimate or another file that people write, and check it."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sim_heating.base.conditions import RATIO_VARIABLES
from sim_heating.base.errors import InputError
from sim_heating.base.files import display_path, read_json, read_text, read_toml, read_toml_dict, suggestion
from sim_heating.heating.ratio.table import RatioTable, read_ratio_table
from sim_heating.inputs.first_readings import other_start
from sim_heating.inputs.fit_settings import FitSettings
from sim_heating.inputs.record import DECLARATION, Record, load_record
from sim_heating.inputs.scenario import load_scenario
from sim_heating.inputs.vehicle import REVIEWS, load_vehicle, vehicle_directory, vehicle_names
from sim_heating.thermal.stack import Material

VEHICLE = "vehicle.toml"
DESCRIBING = ("title", "source", "confidence", "note")
"""Keys of all formats whose texts describe: no number depends on them, but for the confidence of flight conditions."""


@dataclass(frozen=True)
class CheckedPath:
    """A path without fault.

    kind    : record, ratio table, vehicle, scenario, campaign, link, study, material, layout, reviews, settings or
              estimate
    summary : one line for a person
    notes   : lines on what is no fault and asks for attention
    """

    kind: str
    path: Path
    summary: str
    notes: Sequence[str] = ()


def check_path(path: str | os.PathLike[str], root: Path | None = None) -> CheckedPath:
    """Recognise a path by its content, and check all that it holds.

    root   : folder in which files may name others
    raises : InputError with everything that is wrong, or that the path is not recognised
    """
    target = Path(path)
    if not os.path.lexists(target):
        if target.name == str(path) and target.name in vehicle_names():
            return _vehicle(target, root)
        read_text(target)
    if os.path.isdir(target):
        return _directory(target, root)
    if target.suffix == ".toml":
        return _toml(target, root)
    if target.suffix == ".json" and "format" in read_json(target):
        return _estimate(target)
    return _csv(target, root)


def descriptions(path: str | os.PathLike[str]) -> dict[str, dict[str, str]]:
    """The texts of a path that describe, by file and key, as `control_points/NOSE.toml`: `limits.source`.

    path   : a TOML file, or a directory whose files of its own and of its folders are read; empty for another file
    raises : InputError where one of them is no TOML
    """
    target = Path(path)
    if target.name == str(path) and not os.path.lexists(target) and target.name in vehicle_names():
        target = vehicle_directory(target)
    if target.name in (DECLARATION, VEHICLE):
        target = target.parent
    files = sorted((*target.glob("*.toml"), *target.glob("*/*.toml"))) if target.is_dir() else [target]
    folder = target if target.is_dir() else target.parent
    return {
        file.relative_to(folder).as_posix(): texts
        for file in files
        if file.suffix == ".toml" and (texts := dict(_described(read_toml_dict(file), "")))
    }


def _described(value: Any, key_path: str) -> Iterator[tuple[str, str]]:
    """(key, text) of what describes in plain data."""
    if isinstance(value, list):
        for i, inner in enumerate(value, start=1):
            yield from _described(inner, f"{key_path}[{i}]")
    if isinstance(value, dict):
        for name, inner in value.items():
            key = f"{key_path}.{name}".lstrip(".")
            # the `source` of a trajectory is one of several kinds
            if name in DESCRIBING and isinstance(inner, str) and key_path != "trajectory":
                yield key, inner.strip()
            else:
                yield from _described(inner, key)


def _directory(path: Path, root: Path | None) -> CheckedPath:
    names = sorted(p.name for p in path.iterdir())
    if DECLARATION in names and VEHICLE in names:
        raise InputError(
            f"{display_path(path)}: holds both {DECLARATION} and {VEHICLE}; a directory is one or the other"
        )
    if DECLARATION in names:
        record = load_record(path, root=root)
        _check_reviews(path)
        other = other_start(record)
        return CheckedPath("record", path, describe_record(record), [] if other is None else [other.in_words])
    if VEHICLE in names:
        return _vehicle(path, root)
    contents = f"; it holds {', '.join(names[:8])}" if names else "; it is empty"
    raise InputError(f"{display_path(path)}: is neither a record ({DECLARATION}) nor a vehicle ({VEHICLE}){contents}")


def _toml(path: Path, root: Path | None) -> CheckedPath:
    if path.name in (DECLARATION, VEHICLE):
        return _directory(path.parent, root)
    data = read_toml_dict(path)
    reader = BY_FORMAT.get(str(data.get("format")))
    if reader is not None:
        return reader(path, root)
    if (vehicle := _vehicle_of(path)) is not None:
        return _vehicle(vehicle, root)
    if "density_kg_m3" in data:
        read_toml(path, Material)
        return CheckedPath("material", path, f"material {path.stem}")
    if "format" not in data and data.keys() & FitSettings.model_fields.keys():
        read_toml(path, FitSettings)
        return CheckedPath("settings", path, f"settings of a fit: {', '.join(data)}")
    raise InputError(f"{display_path(path)}: {_format_rule(data.get('format'))}")


def _vehicle_of(path: Path) -> Path | None:
    """Directory of the vehicle that a file is a part of: guidance, or a file of one of its folders; else None."""
    folders = ("aero", "control_points", "materials", "ratio_sources")
    directory = path.parent.parent if path.parent.name in folders else path.parent
    return directory if (directory / VEHICLE).is_file() else None


def _format_rule(stated: object) -> str:
    if stated is None:
        return f'key `format` is missing; a scenario begins with format = "scenario/1" (known: {", ".join(FORMATS)})'
    return f"`format`: {stated!r} is not a file of this kind{suggestion(str(stated), FORMATS)}"


def _csv(path: Path, root: Path | None) -> CheckedPath:
    text = read_text(path)
    head = next((line for line in text.splitlines() if line.strip() and not line.startswith("#")), "")
    columns = {*map(str.strip, head.split(","))}
    if "time_s" in columns and (path.parent / DECLARATION).is_file():
        return _directory(path.parent, root)
    if path.parent.name == "aero" and (vehicle := _vehicle_of(path)) is not None:
        return _vehicle(vehicle, root)
    if columns & {*RATIO_VARIABLES, "ratio"} and "time_s" not in columns:
        return CheckedPath("ratio table", path, describe_table(read_ratio_table(path)))
    kinds = "a ratio table has columns " + ", ".join((*RATIO_VARIABLES, "ratio"))
    raise InputError(f"{display_path(path)}: is not a record, vehicle, scenario or ratio table; {kinds}")


def _vehicle(path: Path, root: Path | None) -> CheckedPath:
    from sim_heating.inputs.ratio_sources import RatioSource
    from sim_heating.simulation.scenario_check import check_vehicle  # trajectories are slow to import

    vehicle = load_vehicle(path, root=root)
    check_vehicle(vehicle)
    _check_reviews(vehicle.directory)
    for source in sorted((vehicle.directory / "ratio_sources").glob("*.toml")):
        read_toml(source, RatioSource)
    return CheckedPath("vehicle", path, f"vehicle {vehicle.name}: {len(vehicle.control_points)} control points")


def _scenario(path: Path, root: Path | None) -> CheckedPath:
    from sim_heating.simulation.scenario_check import check_scenario  # trajectories are slow to import

    scenario = load_scenario(path, root=root)
    check_scenario(scenario)
    return CheckedPath("scenario", path, f"scenario {scenario.title or path.stem}")


def _campaign(path: Path, root: Path | None) -> CheckedPath:
    from sim_heating.campaign.flights import record_directories
    from sim_heating.campaign.spec import load_campaign
    from sim_heating.simulation.scenario_check import check_scenario

    campaign = load_campaign(path, root=root)
    for source in campaign.flights:
        for scenario in source.scenarios[:1]:
            check_scenario(scenario)
        for record in [] if source.records is None else record_directories(source.records):
            load_record(record, root=root)
    return CheckedPath("campaign", path, f"campaign {campaign.title}")


def _link(path: Path, root: Path | None) -> CheckedPath:
    from sim_heating.live.engine import check_estimate
    from sim_heating.live.sources import check_sources
    from sim_heating.live.sources.mapping import FieldMapping
    from sim_heating.live.spec import load_link

    link = load_link(path, root=root)
    mapping = FieldMapping(link)
    check_sources(link, mapping)
    check_estimate(link)
    return CheckedPath("link", path, f"link {link.title}: {len(link.points)} control points")


def _study(path: Path, root: Path | None) -> CheckedPath:
    from sim_heating.planning.study import load_study
    from sim_heating.simulation.scenario_check import check_scenario, check_triggers

    study = load_study(path, root=root)
    check_scenario(study.base)
    candidates = study.declared.next_flight.manoeuvre if study.declared.next_flight is not None else []
    for i, candidate in enumerate(candidates, start=1):
        spec = study.base.declared.trajectory.model_copy(update={"manoeuvre": tuple(candidate.flown)})
        check_triggers(spec, study.vehicle, f"{display_path(path)}, [next_flight.manoeuvre] {i}")
    if study.declared.dispersion is not None:
        from sim_heating.planning.dispersion.entry import DispersedEntry
        from sim_heating.planning.dispersion.input_checks import check_inputs

        check_inputs(DispersedEntry(study))
    return CheckedPath("study", path, f"study of {study.stamp}: {study.title}")


def _optimal_study(path: Path, root: Path | None) -> CheckedPath:
    from sim_heating.planning.optimal.spec import load_optimal_study

    return CheckedPath("study", path, f"study of an optimal entry: {load_optimal_study(path, root=root).title}")


def _layout(path: Path, _: Path | None = None) -> CheckedPath:
    from sim_heating.templates.loggers.layout_file import read_layout

    layout = read_layout(path)
    return CheckedPath("layout", path, f"layout of a logger: {layout.title or path.stem}")


def _reviews(path: Path, _: Path | None = None) -> CheckedPath:
    from sim_heating.credibility.reviews import ReviewFile

    return CheckedPath("reviews", path, f"{len(read_toml(path, ReviewFile).review)} signed reviews")


BY_FORMAT: dict[str, Callable[[Path, Path | None], CheckedPath]] = {
    "scenario/1": _scenario,
    "campaign/1": _campaign,
    "link/1": _link,
    "study/1": _study,
    "optimal-entry/1": _optimal_study,
    "logger-layout/1": _layout,
    "credibility/1": _reviews,
}
"""By the key `format` of a TOML file, what checks it: (file, root) -> what it is."""
FORMATS = ("flight-record/1", "vehicle/1", *BY_FORMAT)


def _check_reviews(folder: Path) -> None:
    """raises : InputError where the reviews beside a record or a vehicle cannot be read"""
    if (folder / REVIEWS).is_file():
        _reviews(folder / REVIEWS)


def _estimate(path: Path) -> CheckedPath:
    from sim_heating.estimation.report.estimate_file import read_estimate

    return CheckedPath("estimate", path, f"estimate of {', '.join(read_estimate(path).parameters)}")


def describe_record(record: Record) -> str:
    """One line on a record: control point, sensors, samples, times, layers."""
    t, layers = record.conditions.time_s, record.declared.stack.layer
    count = len(record.sensors)
    sensors = f"{count} sensor{'s' * (count != 1)} ({len(record.used_sensors)} used), {len(record.time_s)} samples"
    stack = " / ".join(layer.material for layer in layers)
    return f"record of {record.declared.control_point}: {sensors}, {t[0]:g} to {t[-1]:g} s, {stack}"


def describe_table(table: RatioTable) -> str:
    """One line on a ratio table: nodes, range, sigma."""
    shape = " x ".join(str(n) for n in table.ratio.shape)
    sigma = "with sigma" if table.sigma is not None else "without sigma"
    return f"ratio table of {shape} nodes, ratio {table.ratio.min():.4g} to {table.ratio.max():.4g}, {sigma}"
