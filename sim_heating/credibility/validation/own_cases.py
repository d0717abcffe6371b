"""Validation cases of a user: files NAME.json in a folder `validation`.

The folder is `validation` in the working directory, or the one that SIM_HEATING_VALIDATION names. A file is written by
`sim-heating credibility add` and carries the digest of its content: one that was changed since is not read.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from sim_heating.base.arrays import BoolArray, FloatArray
from sim_heating.base.conditions import Conditions
from sim_heating.base.errors import InputError
from sim_heating.base.files import DIGEST, digest_matches, display_path, read_json, suggestion, with_digest, write_json
from sim_heating.credibility.evidence import case_as_json, case_from_json, shipped_evidence
from sim_heating.credibility.validation.region import FLIGHT, GROUND, STILL_M_S, Samples, ValidationCase, bands_of
from sim_heating.inputs.record import Record, pooled_rmse_K, record_digest

FOLDER = "validation"
ENVIRONMENT = "SIM_HEATING_VALIDATION"
"""Environment variable that names the folder."""
FORMAT = "validation-case/1"


def validation_folder() -> Path:
    """The folder of the user's cases; it need not exist."""
    return Path(os.environ.get(ENVIRONMENT) or FOLDER)


def own_cases() -> tuple[ValidationCase, ...]:
    """The user's cases, by name.

    raises : InputError where a file is damaged, or was changed after it was written
    """
    folder = validation_folder()
    return tuple(_read_case(p) for p in sorted(folder.glob("*.json"))) if folder.is_dir() else ()


def all_cases() -> tuple[ValidationCase, ...]:
    """The data sets of the project, and those of the user."""
    return (*shipped_evidence().cases, *own_cases())


def _read_case(path: Path) -> ValidationCase:
    data, name = read_json(path), display_path(path)
    if data.get("format") != FORMAT:
        raise InputError(f'{name}: `format` is not "{FORMAT}"; move the file out of the folder of validation cases')
    if not digest_matches(data):
        raise InputError(f"{name}: was changed after it was written; add the record again: sim-heating credibility add")
    try:
        return case_from_json({k: v for k, v in data.items() if k not in ("format", "program", DIGEST)}, of_user=True)
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{name}: is no validation case of this version ({error}); add the record again") from None


def write_case(case: ValidationCase, program: str, *, replace: bool = False) -> Path:
    """Write a user's case; returns its file.

    replace : whether a case of this name may be replaced
    raises  : InputError where there is one and it may not, or the project itself has a data set of this name
    """
    if any(c.name == case.name for c in shipped_evidence().cases):
        raise InputError(f"{case.name}: the project has this data set already; rename the record's directory")
    path = validation_folder() / f"{case.name}.json"
    if path.exists() and not replace:
        raise InputError(f"{display_path(path)}: exists; replace it with --force, or rename the record's directory")
    path.parent.mkdir(parents=True, exist_ok=True)
    write_json(path, with_digest({"format": FORMAT, **case_as_json(case), "program": program}))
    return path


def remove_case(name: str) -> Path:
    """Remove a user's case; returns the file that was removed.

    raises : InputError with the nearest name where there is none
    """
    path = validation_folder() / f"{name}.json"
    if Path(name).name != name or not path.is_file():
        names = [p.stem for p in sorted(validation_folder().glob("*.json"))]
        hint = suggestion(name, names, otherwise=f"; known: {', '.join(names) or 'none'}")
        raise InputError(f"{name}: is no validation case of yours{hint}")
    path.unlink()
    return path


def case_of_record(record: Record, residual_K: FloatArray) -> ValidationCase:
    """A measured record as validation case.

    residual_K : (sensor, sample) measured less predicted by the declared model [K]
    raises     : InputError where the record is not measured, or has no reading within its conditions
    """
    declared = record.declared
    if not declared.measured:
        raise InputError(f"{record.name}: is synthetic (`measured = false`); only measurements validate a model")
    used = [i for i, sensor in enumerate(record.sensors) if sensor.used]
    errors = pooled_rmse_K(residual_K[used])
    if errors is None:
        raise InputError(f"{record.name}: no reading lies within the conditions; nothing can be compared")
    read, samples = wall_readings(record)
    readings, compared = record.temperatures_K()[used], residual_K[np.ix_(np.array(used), np.flatnonzero(read))]
    described = (record.name, declared.title, samples.kind, declared.vehicle, declared.control_point, declared.source)
    measured = (float(errors["rmse_K"]), float(errors["max_abs_K"]), int(errors["n"]))
    range_K = float(np.nanmax(readings) - np.nanmin(readings))
    return ValidationCase(*described, record_digest(record), *measured, range_K, bands_of(samples, compared))


def wall_readings(record: Record) -> tuple[BoolArray, Samples]:
    """Which samples of a record have a wall temperature, (sample,), and the conditions there.

    The wall temperature is the reading of the outermost used thermocouple within the conditions.
    """
    outermost = min(record.used_sensors or record.sensors, key=lambda s: s.depth_m)
    wall_K, t, flown = record.thermocouples[outermost.column], record.time_s, record.conditions
    read = np.isfinite(wall_K) & (t >= flown.time_s[0]) & (t <= flown.time_s[-1])
    if not np.any(read):
        return read, Samples(FLIGHT, {}, np.zeros(0))
    return read, samples_of(flown.at(t[read]), wall_K[read])


def samples_of(flown: Conditions, wall_K: FloatArray) -> Samples:
    """Conditions of a control point for the region.

    flown  : conditions; without a speed, or at rest, it is a ground test
    wall_K : (time,) wall temperature [K] at their times
    """
    values = {"wall_K": np.asarray(wall_K, dtype=float)}
    if "velocity_m_s" not in flown or float(np.max(flown["velocity_m_s"])) < STILL_M_S:
        return Samples(GROUND, values, flown.duration_s)
    return Samples(FLIGHT, {n: flown[n] for n in ("mach", "alpha_deg", "log10_re")} | values, flown.duration_s)
