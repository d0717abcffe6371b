"""Scenarios, studies and user-defined effects to go on from, each checked before it is written."""

from __future__ import annotations

import math
import os
import re
import tempfile
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import SURFACES
from sim_heating.base.errors import InputError, error_context
from sim_heating.base.files import csv_text, display_path, exclusive, roots_of, suggestion, write_own_files
from sim_heating.base.files.paths import portable_problem, real_path
from sim_heating.base.files.text import PARTIAL, abbreviated, clear_partial_files
from sim_heating.base.kernels.block import CONDITION_COLUMNS
from sim_heating.heating.effects import effects
from sim_heating.heating.recorded.reading import OPTION, lowered_confidence
from sim_heating.heating.recorded.sounding import read_sounding
from sim_heating.inputs.scenario import load_scenario
from sim_heating.inputs.vehicle import Vehicle, load_vehicle
from sim_heating.simulation.run import fly_scenario, run
from sim_heating.simulation.scenario_check import check_scenario
from sim_heating.templates.quantities import stated_fields
from sim_heating.templates.render import render, render_toml
from sim_heating.templates.vehicle import shown_place
from sim_heating.trajectory.aero import load_aero
from sim_heating.trajectory.recorded import read_recording

COMMAND = "new"
SCENARIO, STUDY, TRAJECTORY = "scenario.toml", "study.toml", "trajectory.csv"
LIFTING = 0.6
"""Lift over drag from which an entry may be as shallow as the Orbiter's."""
SHALLOW_DEG, STEEP_DEG = -1.2, -1.5
"""Path angles of entry at 120 km of a glider, and of a capsule [deg]."""
ENTRY = {"altitude_m": 120000.0, "velocity_m_s": 7450.0}
"""Altitude and speed of an entry from a low orbit."""
HEATED_FROM = 0.05
"""Part of the largest heating from which a vehicle is heated [-]."""
LEAST_SCATTER = 0.03
"""Least standard deviation of a bell along a practice flight, weighted by its heating [-]."""
VARIABLES: dict[str, tuple[str, float, float, float, float]] = {
    "mach": ("1", 12.0, 2.0, 1.0, 30.0),
    "alpha_deg": ("deg", 38.0, 3.0, -10.0, 60.0),
    "beta_deg": ("deg", 3.0, 1.5, -20.0, 20.0),
    "log10_re": ("1", 6.0, 0.5, 2.0, 9.0),
    "elevon_deg": ("deg", 5.0, 3.0, -40.0, 40.0),
    "bodyflap_deg": ("deg", 20.0, 3.0, -20.0, 30.0),
    "time_s": ("s", 600.0, 100.0, 0.0, 1e5),
    "wall_K": ("K", 1000.0, 100.0, 200.0, 3000.0),
}
"""Variables of an effect: unit, centre, width, lowest and highest value that a file starts with."""
MANOEUVRES: dict[str, tuple[str, dict[str, Any]]] = {
    "alpha_deg": (
        "a pushover-pullup, in which angle of attack changes quickly",
        {"kind": "popu", "at_velocity_m_s": 6096.0, "down_deg": 5.0, "up_deg": 5.0},
    ),
    "beta_deg": (
        "without it the flight has no sideslip, and nothing of the effect",
        {"kind": "sideslip-doublet", "at_velocity_m_s": 5000.0, "amplitude_deg": 4.0, "rate_deg_s": 1.5, "hold_s": 8.0},
    ),
    "elevon_deg": (
        "the elevons move apart from angle of attack and speed, out and back",
        {"kind": "elevon-pulse", "at_velocity_m_s": 6000.0, "amplitude_deg": 6.0, "rate_deg_s": 3.0, "hold_s": 8.0,
         "count": 2, "pause_s": 8.0, "alternate": True},
    ),
    "bodyflap_deg": (
        "the body flap moves apart from angle of attack and speed, out and back",
        {"kind": "bodyflap-pulse", "at_velocity_m_s": 5200.0, "amplitude_deg": 8.0, "rate_deg_s": 3.0, "hold_s": 8.0},
    ),
}  # fmt: skip
"""Manoeuvres that move the variable of an effect: why, and the keys of the scenario."""


def write_new_scenario(
    out: str | os.PathLike[str],
    vehicle: str,
    *,
    title: str = "",
    points: Sequence[str] = (),
    recorded: Path | None = None,
    fields: Mapping[str, str] | None = None,
    atmosphere: Path | None = None,
    initial: Mapping[str, float] | None = None,
    stop_mach: float = 2.0,
    manoeuvre: bool = False,
    root: str | os.PathLike[str] | None = None,
) -> tuple[Path, list[str]]:
    """Write DIR/scenario.toml, a flight of a vehicle, checked by flying it in three degrees of freedom.

    recorded   : a file of a trajectory in place of the built-in entry
    fields     : column -> what the option --field states of it, for the file of the trajectory
    atmosphere : file of a sounding, the air of the day of that trajectory
    initial    : altitude_m, velocity_m_s, gamma_deg of the entry, where not usual ones
    stop_mach  : Mach number at which the flight ends [-]
    manoeuvre  : whether it flies a pushover-pullup
    root       : folder that the scenario may name files in
    returns    : the file, and one line for each thing that was derived or assumed
    raises     : InputError where the vehicle, a point, or the flight does not work
    """
    loaded = load_vehicle(vehicle, root=root)
    for name in points:
        loaded.control_point(name)
    flown = _Recorded() if recorded is None else _recorded(Path(out), recorded, loaded, fields or {}, atmosphere, root)
    values: dict[str, Any] = {
        "vehicle": shown_place(vehicle, Path(out)),
        "title": title or f"Entry of {loaded.name}",
        "points": list(points),
        "source": "entry-3dof" if recorded is None else "recorded",
        "file": flown.file,
        "fields": flown.fields,
        "initial": ENTRY | {"gamma_deg": entry_angle_deg(loaded)} | dict(initial or {}),
        "stop_mach": stop_mach,
        "manoeuvre": {"at_velocity_m_s": 6096.0, "deg": 3.0} if manoeuvre else None,
    }
    files = {SCENARIO: render_toml("scenario.toml.j2", "scenario", **values)}
    files |= {} if flown.text is None else {TRAJECTORY: flown.text}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of what is derived, which the notes tell
        return _write(out, files, lambda path: _check_scenario(path, root)), list(flown.notes)


@dataclass(frozen=True)
class _Recorded:
    """A recorded trajectory as a scenario names it.

    file   : relative to the scenario
    fields : contents of [trajectory.fields]
    text   : of the file, where it is written beside the scenario
    """

    file: str | None = None
    fields: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    text: str | None = None
    notes: tuple[str, ...] = ()


def _recorded(
    out: Path,
    path: Path,
    vehicle: Vehicle,
    fields: Mapping[str, str],
    atmosphere: Path | None,
    root: str | os.PathLike[str] | None,
) -> _Recorded:
    """A recorded trajectory: named where it is, or written beside the scenario in columns of the contract where it lies
    outside the folders that the scenario may read, or has the air of a sounding.

    raises : InputError, one line, with everything that the file lacks
    """
    stated = stated_fields(fields)
    sounding = None if atmosphere is None else read_sounding(atmosphere)
    flown = read_recording(
        path, vehicle.reference_length_m, vehicle.surfaces, stated, statement=OPTION, sounding=sounding
    )
    for line in flown.assumed:
        warnings.warn(f"{display_path(path)}: {line}", stacklevel=2)
    roots = roots_of(out / SCENARIO, root, vehicle.directory)
    inside = any(real_path(path).is_relative_to(folder) for folder in roots.folders)
    if inside and sounding is None:
        table = {column: declared.model_dump(exclude_none=True) for column, declared in stated.items()}
        return _Recorded(Path(os.path.relpath(path, out)).as_posix(), table, None, flown.notes)
    header = dict(flown.table.header)
    air = "" if sounding is None else f", air of the sounding {sounding.path.name}"
    header["source"] = f"{header.get('source') or f'recorded trajectory {path.name}'}{air}"
    if flown.has_model_density:
        header["confidence"] = lowered_confidence(header.get("confidence", ""))
    text = csv_text(flown.table.columns, header=header)
    note = f"{TRAJECTORY}: the trajectory in columns of conditions, beside the scenario"
    return _Recorded(TRAJECTORY, {}, text, (*flown.notes, note))


def entry_angle_deg(vehicle: Vehicle) -> float:
    """A usual path angle of entry from a low orbit [deg], by the lift over drag of its aerodynamics at Mach 20."""
    try:
        aero = load_aero(vehicle.directory)
    except InputError:
        return STEEP_DEG
    CL, CD, _ = aero.coefficients(20.0, float(aero.basic.alpha_deg[len(aero.basic.alpha_deg) // 2]))
    return SHALLOW_DEG if CL / CD >= LIFTING else STEEP_DEG


def _check_scenario(path: Path, root: str | os.PathLike[str] | None = None) -> None:
    check_scenario(load_scenario(path, root=root))


def _write(out: str | os.PathLike[str], files: Mapping[str, str], check: Callable[[Path], object]) -> Path:
    """Write files into a directory, all or none, after the first of them was checked where it will be.

    check  : raises InputError where the file does not work
    raises : InputError where the check fails, or a file of a name exists that this program did not write
    """
    folder = Path(out)
    with _trial(folder, files) as trial:
        check(trial)
    write_own_files(folder, COMMAND, files)
    return folder / next(iter(files))


@contextmanager
def _trial(folder: Path, files: Mapping[str, str]) -> Iterator[Path]:
    """The first file, and those beside it that it names, under other names where they will be; removed in the end.

    Files name others relative to themselves. What a killed process left of earlier ones is removed, and the directory
    where nothing was written into it.

    raises : InputError of the block, with the names that the files will have
    """
    with exclusive(folder):
        clear_partial_files(folder)
        trials: dict[str, Path] = {}
        try:
            for name in files:
                handle, created = tempfile.mkstemp(prefix=f".{PARTIAL}", suffix=f".{name}", dir=folder)
                os.close(handle)
                trials[name] = Path(created)
            for name, path in trials.items():
                text = files[name]
                for other in trials:
                    text = text.replace(f'"{other}"', f'"{trials[other].name}"')
                path.write_text(text, encoding="utf-8")
            yield next(iter(trials.values()))
        except InputError as error:
            problems = list(error.problems)
            for name, path in trials.items():
                shown = display_path(path), display_path(folder / name)
                problems = [line.replace(*shown).replace(path.name, name) for line in problems]
            raise InputError(*problems) from None
        finally:
            for path in trials.values():
                path.unlink(missing_ok=True)


def write_new_study(
    out: str | os.PathLike[str],
    kind: str,
    scenario: Path,
    *,
    title: str = "",
    points: Sequence[str] = (),
    flights: int = 128,
    optimal: Mapping[str, Any] | None = None,
    above: Mapping[str, Mapping[str, str]] | None = None,
    root: str | os.PathLike[str] | None = None,
    check: Callable[[Path], object],
) -> Path:
    """Write DIR/study.toml, a study of the flight of a scenario.

    kind    : dispersion, envelope or optimal
    flights : of a dispersion, a power of two
    optimal : contents of the table [optimal]
    above   : control point -> limit of it -> why it is above the vehicle's own, for the comments of [optimal]
    root    : folder that the scenario may name files in
    check   : called with the file before it is in the directory; raises InputError where it does not work
    returns : the file
    raises  : InputError where the scenario or a point does not work, or the flights are no power of two
    """
    if flights & (flights - 1):
        raise InputError(
            f"--flights {flights}: is no power of two, which its sequences need to be even; "
            f"give {2 ** (flights.bit_length() - 1)} or {2 ** flights.bit_length()}"
        )
    base = load_scenario(scenario, root=root)
    names = list(points) or list(base.names)
    for name in names:
        base.vehicle.control_point(name)
    declared_vehicle = base.declared.vehicle
    vehicle = (
        declared_vehicle
        if not (scenario.parent / declared_vehicle / "vehicle.toml").is_file()
        else str(scenario.parent / declared_vehicle)
    )
    values: dict[str, Any] = {
        "vehicle": shown_place(vehicle, Path(out)),
        "scenario": Path(os.path.relpath(scenario, out)).as_posix(),
        "title": title or f"{base.vehicle.name}: {kind}",
        "points": names,
        "flights": flights,
    }
    if kind == "optimal":
        values |= {"optimal": optimal, "above": above}
    values["offsets"] = [-4.0, -2.0, 0.0, 2.0]
    return _write(out, {STUDY: render_toml(f"study_{kind}.toml.j2", "study", **values)}, check)


EFFECT_MODES: Mapping[str, Mapping[str, Any]] = {
    "multiply": {
        "size": "rise",
        "size_text": "relative rise of the heating ratio",
        "formula": "1 + rise exp(-u^2 / 2)",
        "acts": "multiplies the heating ratio",
        "scatter": 0.3,
        "least": -0.5,
        "most": 5.0,
        "truth": 0.25,
    },
    "add": {
        "size": "rise",
        "size_text": "what is added to the heating ratio",
        "formula": "rise exp(-u^2 / 2)",
        "acts": "is added to the heating ratio",
        "scatter": 0.3,
        "least": -0.5,
        "most": 5.0,
        "truth": 0.1,
    },
    "emittance": {
        "size": "change",
        "size_text": "relative change of the emittance",
        "formula": "1 + change exp(-u^2 / 2)",
        "acts": "multiplies the emittance",
        "scatter": 0.1,
        "least": -0.5,
        "most": 0.5,
        "truth": -0.2,
    },
}
"""Mode of a new effect -> name, prior and bounds of its size [-], its true value, and the words of its files."""


def _of_variable(variable: str) -> dict[str, Any]:
    """Unit, centre, width and bounds of the variable of a new effect, and how its kernel reads it."""
    unit, centre, width, lower, upper = VARIABLES[variable]
    return {
        "unit": unit,
        "centre": centre,
        "width": width,
        "lower": lower,
        "upper": upper,
        "spread": (upper - lower) / 4.0,
        "read": "wall_K" if variable == "wall_K" else f"B[c + flight.{variable}]",
    }


def write_new_effect(
    out: str | os.PathLike[str],
    name: str,
    *,
    mode: str = "multiply",
    variable: str = "mach",
    vehicle: str,
    point: str,
    root: str | os.PathLike[str] | None = None,
) -> list[Path]:
    """Write an effect, a check of it, and a scenario whose truth has it.

    name     : of the effect, as in `shock-passage`
    variable : a column of the flight conditions, or `wall_K`, in which it is a bell
    root     : folder that the scenario may name files in
    returns  : the files: effect, scenario, check
    raises   : InputError where the name is taken or is none, the variable is unknown, or the practice flight of the
               vehicle would not show the effect

    The bell is centred on what the vehicle flies while it is heated, where the usual centre lies outside of it.
    """
    if not re.fullmatch(r"[a-z][a-z0-9]*(-[a-z0-9]+)*", name):
        raise InputError(f"effect {name}: write a name of small letters, digits and -, such as shock-passage")
    if (problem := portable_problem(name)) is not None:
        raise InputError(f"effect {abbreviated(name)}: {problem}")
    module = name.replace("-", "_")
    folder = Path(out)
    if name in effects() and not (folder / f"{module}.py").is_file():
        raise InputError(f"effect {name}: there is an effect of this name already; give another name")
    if variable not in VARIABLES:
        assert set(VARIABLES) - {"wall_K"} <= set(CONDITION_COLUMNS)
        raise InputError(f"--variable {variable}: is not one{suggestion(variable, VARIABLES)}")
    flown = load_vehicle(vehicle, root=root)
    with error_context("--point"):
        flown.control_point(point)
    if variable in SURFACES and variable not in flown.surfaces:
        raise InputError(
            f"--variable {variable}: {flown.name} has no such control surface; name another variable or --vehicle"
        )
    values: dict[str, Any] = {
        "name": name,
        "module": module,
        "title": name.replace("-", " ").capitalize(),
        "mode": mode,
        **EFFECT_MODES[mode],
        "variable": variable,
        **_of_variable(variable),
        "folder": folder.as_posix(),
        "vehicle": shown_place(vehicle, folder),
        "point": point,
        "manoeuvre": _manoeuvre(variable, vehicle),
        "gamma_deg": entry_angle_deg(flown),
    }
    values |= _on_practice_flight(folder, values, point, root)
    files = {
        f"{module}.py": render("effect.py.j2", **values),
        f"{module}.toml": render_toml("effect_scenario.toml.j2", "scenario", **values),
        f"checks/test_{module}.py": render("effect_check.py.j2", **values),
    }
    write_own_files(folder, COMMAND, files)
    return [folder / n for n in files]


def _on_practice_flight(
    folder: Path, values: Mapping[str, Any], point: str, root: str | os.PathLike[str] | None
) -> dict[str, float]:
    """Centre and width of the bell of a new effect, so that its practice flight shows it.

    raises : InputError where the variable hardly changes while the vehicle is heated
    """
    variable = str(values["variable"])
    flown = _practice_flight(folder, values, root)
    usual = float(values["centre"]), float(values["width"])
    limits = float(values["lower"]), float(values["upper"])
    try:
        centre, width = practice_bell(flown[variable], flown["heat"], usual, limits)
    except InputError as error:
        raise InputError(
            f"--variable {variable}: the practice flight of {values['vehicle']} has {variable} {error} while {point} "
            "is heated, which does not show the effect; name another --vehicle or --variable"
        ) from None
    return {"centre": centre, "width": width}


def practice_bell(
    x: FloatArray, heat: FloatArray, usual: tuple[float, float], limits: tuple[float, float]
) -> tuple[float, float]:
    """Centre and width of a bell in a variable that a flight shows: the usual ones where they fit what is flown.

    x, heat : (sample,) the variable, and the part of the heating of each sample [-]
    usual   : centre and width;  limits : lowest and highest centre
    raises  : InputError, the range flown in words, where the bell hardly changes along the flight
    """
    heated = x[heat >= HEATED_FROM * np.max(heat)]
    low, high = float(np.min(heated)), float(np.max(heated))
    centre, width = usual
    if not low <= centre <= high:
        centre = float(f"{min(max(float(np.median(heated)), limits[0]), limits[1]):.3g}")
    if high - low < 2.0 * width:
        width = float(f"{max((high - low) / 4.0, width / 10.0):.2g}")
    bell = np.exp(-0.5 * ((x - centre) / width) ** 2)
    mean = float(np.average(bell, weights=heat))
    if math.sqrt(float(np.average((bell - mean) ** 2, weights=heat))) < LEAST_SCATTER:
        raise InputError(f"from {low:.3g} to {high:.3g}")
    return centre, width


def _practice_flight(
    folder: Path, values: Mapping[str, Any], root: str | os.PathLike[str] | None
) -> dict[str, FloatArray]:
    """The variable of an effect along its practice flight, and `heat`, the part of the heating of each sample [-]."""
    text = render_toml("effect_scenario.toml.j2", "scenario", **values).split("[[truth.effect]]")[0]
    with _trial(folder, {f"{values['module']}.toml": text}) as trial:
        scenario = load_scenario(trial, root=root)
        if values["variable"] == "wall_K":
            result = run(scenario)
            flown = result.flight.conditions
            history = result.points[str(values["point"])].history
            wall = {"wall_K": np.interp(flown.time_s, history.time_s, history.surface_K)}
        else:
            flown = fly_scenario(scenario).conditions
            wall = {}
    heat = np.sqrt(flown["rho_kg_m3"]) * flown["velocity_m_s"] ** 3 * flown.duration_s
    return {**{n: flown[n] for n in flown.names}, **wall, "heat": heat / np.sum(heat)}


def _manoeuvre(variable: str, vehicle: str) -> dict[str, Any] | None:
    """The manoeuvre of an effect's practice flight: one that moves its variable; of the Orbiter one in any case."""
    named = variable if variable in MANOEUVRES else "alpha_deg" if "orbiter" in vehicle else None
    return None if named is None else dict(zip(("why", "stated"), MANOEUVRES[named], strict=True))
