"""Scenarios, studies and user-defined effects to go on from, each checked before it is written."""

from __future__ import annotations

import os
import re
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from sim_heating.base.conditions import SURFACES
from sim_heating.base.errors import InputError
from sim_heating.base.files import display_path, suggestion, write_own_files, write_text_atomic
from sim_heating.base.files.paths import portable_problem
from sim_heating.base.files.text import abbreviated
from sim_heating.base.kernels.block import CONDITION_COLUMNS
from sim_heating.heating.effects import effects
from sim_heating.inputs.scenario import load_scenario
from sim_heating.inputs.vehicle import Vehicle, load_vehicle
from sim_heating.simulation.scenario_check import check_scenario
from sim_heating.templates.render import render, render_toml
from sim_heating.templates.vehicle import shown_place
from sim_heating.trajectory.aero import load_aero

COMMAND = "new"
SCENARIO, STUDY = "scenario.toml", "study.toml"
LIFTING = 0.6
"""Lift over drag from which an entry may be as shallow as the Orbiter's."""
SHALLOW_DEG, STEEP_DEG = -1.2, -1.5
"""Path angles of entry at 120 km of a glider, and of a capsule [deg]."""
ENTRY = {"altitude_m": 120000.0, "velocity_m_s": 7450.0}
"""Altitude and speed of an entry from a low orbit."""
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
    initial: Mapping[str, float] | None = None,
    stop_mach: float = 2.0,
    manoeuvre: bool = False,
) -> Path:
    """Write DIR/scenario.toml, a flight of a vehicle, checked by flying it in three degrees of freedom.

    recorded  : a CSV file of a trajectory in place of the built-in entry
    initial   : altitude_m, velocity_m_s, gamma_deg of the entry, where not usual ones
    stop_mach : Mach number at which the flight ends [-]
    manoeuvre : whether it flies a pushover-pullup
    returns   : the file
    raises    : InputError where the vehicle, a point, or the flight does not work
    """
    loaded = load_vehicle(vehicle)
    for name in points:
        loaded.control_point(name)
    values: dict[str, Any] = {
        "vehicle": shown_place(vehicle, Path(out)),
        "title": title or f"Entry of {loaded.name}",
        "points": list(points),
        "source": "entry-3dof" if recorded is None else "recorded",
        "file": None if recorded is None else Path(os.path.relpath(recorded, out)).as_posix(),
        "initial": ENTRY | {"gamma_deg": entry_angle_deg(loaded)} | dict(initial or {}),
        "stop_mach": stop_mach,
        "manoeuvre": {"at_velocity_m_s": 6096.0, "deg": 3.0} if manoeuvre else None,
    }
    return _write(out, {SCENARIO: render_toml("scenario.toml.j2", "scenario", **values)}, _check_scenario)


def entry_angle_deg(vehicle: Vehicle) -> float:
    """A usual path angle of entry from a low orbit [deg], by the lift over drag of its aerodynamics at Mach 20."""
    try:
        aero = load_aero(vehicle.directory)
    except InputError:
        return STEEP_DEG
    CL, CD, _ = aero.coefficients(20.0, float(aero.basic.alpha_deg[len(aero.basic.alpha_deg) // 2]))
    return SHALLOW_DEG if CL / CD >= LIFTING else STEEP_DEG


def _check_scenario(path: Path) -> None:
    check_scenario(load_scenario(path))


def _write(out: str | os.PathLike[str], files: Mapping[str, str], check: Callable[[Path], None]) -> Path:
    """Write files into a directory, all or none, after the first of them was checked where it will be.

    raises : InputError where the check fails, or a file of a name exists that this program did not write
    """
    folder = Path(out)
    folder.mkdir(parents=True, exist_ok=True)
    first = next(iter(files))
    # Checked under another name in the same place, since it names files relative to itself.
    with tempfile.NamedTemporaryFile(prefix=".new-", suffix=f"-{first}", dir=folder, delete=False) as trial:
        place = Path(trial.name)
    try:
        write_text_atomic(place, files[first])
        check(place)
    except InputError as error:
        shown = (line.replace(display_path(place), display_path(folder / first)) for line in error.problems)
        raise InputError(*shown) from None
    finally:
        place.unlink(missing_ok=True)
        if not any(folder.iterdir()):
            folder.rmdir()
    write_own_files(folder, COMMAND, files)
    return folder / first


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
) -> Path:
    """Write DIR/study.toml, a study of the flight of a scenario.

    kind    : dispersion, envelope or optimal
    flights : of a dispersion, a power of two
    optimal : contents of the table [optimal]
    above   : control point -> limit of it -> why it is above the vehicle's own, for the comments of [optimal]
    returns : the file
    raises  : InputError where the scenario or a point does not work, or the flights are no power of two
    """
    if flights & (flights - 1):
        raise InputError(
            f"--flights {flights}: is no power of two, which its sequences need to be even; "
            f"give {2 ** (flights.bit_length() - 1)} or {2 ** flights.bit_length()}"
        )
    base = load_scenario(scenario)
    names = list(points) or list(base.names)
    for name in names:
        base.vehicle.control_point(name)
    own = base.declared.vehicle
    vehicle = own if not (scenario.parent / own / "vehicle.toml").is_file() else str(scenario.parent / own)
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
    return _write(out, {STUDY: render_toml(f"study_{kind}.toml.j2", "study", **values)}, _no_check)


def _no_check(path: Path) -> None:
    """A study is checked by the command, which knows planning."""


def write_new_effect(
    out: str | os.PathLike[str], name: str, *, mode: str = "multiply", variable: str = "mach", vehicle: str, point: str
) -> list[Path]:
    """Write an effect, a check of it, and a scenario whose truth has it.

    name     : of the effect, as in `shock-passage`
    variable : a column of the flight conditions, or `wall_K`, in which it is a bell
    returns  : the files: effect, scenario, check
    raises   : InputError where the name is taken or is none, or the variable is unknown
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
    flown = load_vehicle(vehicle)
    flown.control_point(point)
    if variable in SURFACES and variable not in flown.surfaces:
        raise InputError(
            f"--variable {variable}: {flown.name} has no such control surface; name another variable or --vehicle"
        )
    unit, centre, width, lower, upper = VARIABLES[variable]
    size = "rise" if mode != "emittance" else "change"
    values: dict[str, Any] = {
        "name": name, "module": module, "title": name.replace("-", " ").capitalize(), "mode": mode,
        "variable": variable, "size": size, "unit": unit, "centre": centre, "width": width,
        "lower": lower, "upper": upper,
        "spread": (upper - lower) / 4.0,
        "scatter": 0.3 if mode != "emittance" else 0.1,
        "least": -0.5, "most": 5.0 if mode != "emittance" else 0.5,
        "size_text": {"multiply": "relative rise of the heating ratio", "add": "what is added to the heating ratio",
                      "emittance": "relative change of the emittance"}[mode],
        "formula": f"{'' if mode == 'add' else '1 + '}{size} exp(-u^2 / 2)",
        "acts": {"multiply": "multiplies the heating ratio", "add": "is added to the heating ratio",
                 "emittance": "multiplies the emittance"}[mode],
        "read": "wall_K" if variable == "wall_K" else f"B[c + flight.{variable}]",
        "folder": folder.as_posix(), "vehicle": shown_place(vehicle, folder), "point": point,
        "manoeuvre": _manoeuvre(variable, vehicle),
        "gamma_deg": entry_angle_deg(flown),
        "truth": {"multiply": 0.25, "add": 0.1, "emittance": -0.2}[mode],
    }  # fmt: skip
    files = {
        f"{module}.py": render("effect.py.j2", **values),
        f"{module}.toml": render_toml("effect_scenario.toml.j2", "scenario", **values),
        f"checks/test_{module}.py": render("effect_check.py.j2", **values),
    }
    write_own_files(folder, COMMAND, files)
    return [folder / n for n in files]


def _manoeuvre(variable: str, vehicle: str) -> dict[str, Any] | None:
    """The manoeuvre of an effect's practice flight: one that moves its variable; of the Orbiter one in any case."""
    named = variable if variable in MANOEUVRES else "alpha_deg" if "orbiter" in vehicle else None
    return None if named is None else dict(zip(("why", "stated"), MANOEUVRES[named], strict=True))
