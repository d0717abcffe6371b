"""Reference heating by name: film coefficient h_ref [kg/(m2 s)] and recovery enthalpy H_r [J/kg] of a flight.

One compiled kernel evaluates a frame of a host and, in a loop, a whole flight. A heating ratio is defined over one of
these models and reduced with one recovery enthalpy; the header of its table names both.
Equations: docs/theory/equations_reference_heating.md, section 3 and section 5.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import NamedTuple, cast

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import Conditions
from sim_heating.base.errors import InputError
from sim_heating.base.files import raise_problems, suggestion
from sim_heating.base.kernels.jit import njit
from sim_heating.heating.atmosphere import CP_AIR
from sim_heating.heating.reference.cylinder import line_angle, swept_cylinder_film
from sim_heating.heating.reference.flat_plate import eckert_kernel
from sim_heating.heating.reference.low_speed import CORRELATION_M_S, correlation_share
from sim_heating.heating.reference.rarefied import DENSE, NORMAL_DEG, bridged_film, free_molecular_film
from sim_heating.heating.reference.recovery import (
    ATTACHMENT_LINE,
    TOTAL,
    Recovery,
    RecoveryName,
    point_angle,
    point_recovery,
)
from sim_heating.heating.reference.stagnation import (
    COLD_WALL_K,
    NO_LEWIS,
    SLOWEST_M_S,
    detra_kemp_riddell_kernel,
    fay_riddell_of_state,
    stagnation_kernel,
    sutton_graves_kernel,
)

NONE, COLUMNS, SUTTON_GRAVES, DETRA_KEMP_RIDDELL, FAY_RIDDELL, ECKERT_LAMINAR, ECKERT_TURBULENT, SWEPT_CYLINDER = range(
    8
)


_TOTAL = Recovery("total")


@dataclass(frozen=True)
class ReferenceModel:
    """One reference heating: its name in files, its number in the kernel and the conditions that it reads.

    name     : as in a record's `heating.reference` and in a ratio table's header
    code     : number of the model in `reference_kernel`
    title    : short description with the publication
    needs    : columns of the conditions that it reads
    on_plate : True where it also needs a running length [m]
    recovery : enthalpy that a ratio over it is reduced with where nothing else is stated; the Eckert models are a
               surface at the angle of attack with its boundary layer, the cylinder is an attachment line with its sweep
    holds_m_s : lowest and highest speed [m/s] at which the published form holds; Fay-Riddell replaces a correlation
               below the lowest, every form is continued above the highest, which `beyond_range` reports
    """

    name: str
    code: int
    title: str
    needs: tuple[str, ...] = ("rho_kg_m3", "velocity_m_s", "T_inf_K")
    on_plate: bool = False
    recovery: Recovery = _TOTAL
    holds_m_s: tuple[float, float] = (0.0, np.inf)


_PLATE = ("rho_kg_m3", "velocity_m_s", "T_inf_K", "alpha_deg")
_ALL = (
    ReferenceModel("none", NONE, "h_ref = 0: only the added flux heats", ("velocity_m_s", "T_inf_K")),
    ReferenceModel("columns", COLUMNS, "columns h_ref_kg_m2_s and H_r_J_kg as given", ("h_ref_kg_m2_s", "H_r_J_kg")),
    ReferenceModel(
        "sutton-graves", SUTTON_GRAVES, "sphere, Sutton & Graves, NASA TR R-376 (1971)",
        holds_m_s=(CORRELATION_M_S, 15000.0),
    ),
    ReferenceModel(
        "detra-kemp-riddell", DETRA_KEMP_RIDDELL, "sphere, Detra, Kemp & Riddell (1957)",
        holds_m_s=(CORRELATION_M_S, 8000.0),
    ),
    ReferenceModel(
        "fay-riddell", FAY_RIDDELL, "sphere, equilibrium air, Fay & Riddell (1958), Lewis number 1",
        holds_m_s=(0.0, 8000.0),
    ),
    ReferenceModel(
        "eckert-laminar", ECKERT_LAMINAR, "windward flat plate, Eckert (1956), laminar", _PLATE, True,
        Recovery("edge-laminar"), (0.0, 8000.0),
    ),
    ReferenceModel(
        "eckert-turbulent", ECKERT_TURBULENT, "windward flat plate, Eckert (1956), turbulent", _PLATE, True,
        Recovery("edge-turbulent"), (0.0, 8000.0),
    ),
    ReferenceModel(
        "swept-cylinder", SWEPT_CYLINDER, "stagnation line of a swept cylinder, Fay & Riddell (1958), laminar", _PLATE,
        recovery=Recovery("attachment-line"), holds_m_s=(0.0, 8000.0),
    ),
)  # fmt: skip

REFERENCE_MODELS: Mapping[str, ReferenceModel] = MappingProxyType({model.name: model for model in _ALL})
"""Every reference heating by the name that files use."""


class HeatingColumns(NamedTuple):
    """Reference heating of a point along a flight, (time,) each, under the names of the columns of its conditions.

    h_ref_kg_m2_s : reference film coefficient [kg/(m2 s)]
    H_r_J_kg      : recovery enthalpy [J/kg]
    H_r_rise_J_kg : rise of the recovery enthalpy from laminar to fully turbulent flow [J/kg]
    """

    h_ref_kg_m2_s: FloatArray
    H_r_J_kg: FloatArray
    H_r_rise_J_kg: FloatArray


def reference_model(name: str) -> ReferenceModel:
    """Reference heating model of a name: film coefficient [kg/(m2 s)] and recovery enthalpy [J/kg].

    name    : a key of REFERENCE_MODELS
    raises  : InputError for an unknown name, with the nearest known one
    """
    if name in REFERENCE_MODELS:
        return REFERENCE_MODELS[name]
    hint = suggestion(str(name), REFERENCE_MODELS, cutoff=0.4)
    raise InputError(f"heating.reference: unknown reference heating `{name}`{hint}")


def recovery_name(stated: str | None, reference: str | None) -> RecoveryName:
    """Name of the recovery enthalpy [J/kg] that a ratio is reduced with.

    stated    : a key of RECOVERIES, None where none is stated
    reference : name of the reference heating that the ratio is over, None where unknown
    returns   : what is stated, else that of the reference heating, else `total`
    """
    if stated is not None:
        return cast(RecoveryName, stated)
    model = REFERENCE_MODELS.get(reference or "")
    return "total" if model is None else model.recovery.kind


@njit
def total_enthalpy_kernel(velocity_m_s: float, T_inf_K: float) -> float:
    """Total enthalpy H_0 = V^2/2 + cp T_inf [J/kg], cp = 1004.5 [J/(kg K)], zero at 0 K.

    velocity_m_s, T_inf_K : free-stream speed [m/s] and temperature [K]
    It is the recovery enthalpy of a point without a known edge (heating/reference/recovery.py).
    Source: docs/theory/equations_reference_heating.md, equation 9.
    """
    return 0.5 * velocity_m_s * velocity_m_s + CP_AIR * T_inf_K


@njit
def reference_film_kernel(
    code: int,
    rho_kg_m3: float,
    velocity_m_s: float,
    T_inf_K: float,
    alpha_deg: float,
    nose_radius_m: float,
    running_length_m: float,
    wall_temperature_K: float,
    state: tuple[float, float, float, float],
    sweep_deg: float = 0.0,
) -> float:
    """Continuum film coefficient h_ref [kg/(m2 s)] of one flight condition whose stagnation state is known.

    state : result of `stagnation_kernel` at this density, temperature and speed (at least SLOWEST_M_S); a frame
            computes it once, for the film coefficient and for the surface pressures
    The other arguments are those of `reference_kernel`.
    Source: docs/theory/equations_reference_heating.md, equations 9 to 18 and 31 to 33, by model.
    """
    if code in (NONE, COLUMNS):
        return 0.0
    V = max(velocity_m_s, SLOWEST_M_S)
    if code in (ECKERT_LAMINAR, ECKERT_TURBULENT):
        turbulent = code == ECKERT_TURBULENT
        return eckert_kernel(rho_kg_m3, V, T_inf_K, alpha_deg, running_length_m, wall_temperature_K, turbulent, False)
    if code == SWEPT_CYLINDER:
        return swept_cylinder_film(rho_kg_m3, V, T_inf_K, alpha_deg, sweep_deg, nose_radius_m, wall_temperature_K)
    weight = 0.0 if code == FAY_RIDDELL else correlation_share(V)
    film = 0.0
    if weight < 1.0:
        film = fay_riddell_of_state(state, V, T_inf_K, nose_radius_m, wall_temperature_K, NO_LEWIS)
    if weight > 0.0:
        if code == SUTTON_GRAVES:
            correlation = sutton_graves_kernel(rho_kg_m3, V, T_inf_K, nose_radius_m)
        else:
            correlation = detra_kemp_riddell_kernel(rho_kg_m3, V, T_inf_K, nose_radius_m)
        film += weight * (correlation - film)
    return film


@njit
def surface_angle(
    code: int,
    alpha_deg: float,
    elevon_deg: float,
    bodyflap_deg: float,
    sweep_deg: float,
    numbers: FloatArray,
    first: int,
) -> float:
    """Angle [deg] at which the molecules of thin air meet the surface of a point, 0 to 90 or above.

    code, sweep_deg                     : number of the reference heating; sweep of its cylinder [deg]
    alpha_deg, elevon_deg, bodyflap_deg : angle of attack and deflections [deg]
    numbers, first                      : array that holds `Recovery.parameters()` from this place on

    A point with an edge has its angle. One without an edge states none: it counts as normal to the flow, over a swept
    cylinder as its stagnation line. A lee surface counts as along the flow, where the thermal motion alone brings
    molecules: in air that is not thin collisions bring them behind a body too, which free-molecular flow leaves empty.
    Source: docs/theory/equations_reference_heating.md, equation 32a.
    """
    if numbers[first] == ATTACHMENT_LINE:
        return line_angle(alpha_deg, numbers[first + 1])
    if numbers[first] != TOTAL:
        return max(point_angle(alpha_deg, elevon_deg, bodyflap_deg, numbers, first), 0.0)
    return line_angle(alpha_deg, sweep_deg) if code == SWEPT_CYLINDER else NORMAL_DEG


@njit
def is_dense(rho_kg_m3: float, velocity_m_s: float, sine: float, film: float) -> bool:
    """Whether the bridging takes nothing off a film [kg/(m2 s)], by rho V sin(angle), a lower bound of h_fm.

    rho_kg_m3, velocity_m_s, sine : free stream [kg/m3], [m/s]; of the angle of the surface [-]
    Source: docs/theory/equations_reference_heating.md, equation 32.
    """
    return rho_kg_m3 * velocity_m_s * sine > DENSE * film


@njit
def reference_kernel(
    code: int,
    rho_kg_m3: float,
    velocity_m_s: float,
    T_inf_K: float,
    alpha_deg: float,
    nose_radius_m: float,
    running_length_m: float,
    wall_temperature_K: float,
    sweep_deg: float = 0.0,
) -> tuple[float, float]:
    """Continuum film coefficient h_ref [kg/(m2 s)] and total enthalpy H_0 [J/kg] of one flight condition.

    code               : `ReferenceModel.code`; NONE and COLUMNS give h_ref = 0
    rho_kg_m3, velocity_m_s, T_inf_K : free-stream density [kg/m3], speed [m/s], temperature [K]
    alpha_deg          : angle of attack [deg];  running_length_m : [m], of the Eckert models; alpha of the cylinder too
    nose_radius_m      : of the reference sphere or cylinder [m], read by the other models
    wall_temperature_K : of the reference wall [K], 300 by definition; read by Fay-Riddell and Eckert (the two
                         correlations have theirs built in)
    sweep_deg          : of the cylinder at alpha 0 [deg]
    Density, temperature, radius and length above 0; nothing is checked here.
    Source: docs/theory/equations_reference_heating.md, equations 9 to 18 and 31 to 33, by model.
    """
    H_0 = total_enthalpy_kernel(velocity_m_s, T_inf_K)
    # These two read no density, and without one there is no stagnation state.
    if code in (NONE, COLUMNS):
        return 0.0, H_0
    state = stagnation_kernel(rho_kg_m3, max(velocity_m_s, SLOWEST_M_S), T_inf_K)
    h_ref = reference_film_kernel(
        code,
        rho_kg_m3,
        velocity_m_s,
        T_inf_K,
        alpha_deg,
        nose_radius_m,
        running_length_m,
        wall_temperature_K,
        state,
        sweep_deg,
    )
    return h_ref, H_0


@njit
def _reference_loop(
    code: int,
    rho: FloatArray,
    V: FloatArray,
    T_inf: FloatArray,
    alpha_deg: FloatArray,
    geometry: tuple[float, float, float, float],
    h_ref: FloatArray,
    H_0: FloatArray,
) -> None:
    radius, length, T_w, sweep = geometry
    for i in range(len(V)):
        h_ref[i], H_0[i] = reference_kernel(code, rho[i], V[i], T_inf[i], alpha_deg[i], radius, length, T_w, sweep)


@njit
def _bridge_loop(
    code: int,
    rho: FloatArray,
    V: FloatArray,
    T_inf: FloatArray,
    turned: FloatArray,
    sweep_deg: float,
    numbers: FloatArray,
    ratio: FloatArray,
    H_r: FloatArray,
    h_ref: FloatArray,
) -> None:
    for i in range(len(V)):
        speed = max(V[i], SLOWEST_M_S)
        angle = surface_angle(code, turned[0, i], turned[1, i], turned[2, i], sweep_deg, numbers, 0)
        molecules = free_molecular_film(rho[i], speed, T_inf[i], angle, H_r[i])
        h_ref[i] = bridged_film(h_ref[i], molecules, ratio[i])


def _check_geometry(model: ReferenceModel, nose_radius_m: float, running_length_m: float | None, T_w_K: float) -> None:
    lengths = {"heating.nose_radius_m": nose_radius_m, "wall_temperature_K": T_w_K}
    if model.on_plate:
        if running_length_m is None:
            raise InputError(f"heating.running_length_m: `{model.name}` needs a length from the leading edge")
        lengths["heating.running_length_m"] = running_length_m
    bad = {key: value for key, value in lengths.items() if not 0.0 < value < np.inf}
    problems = [f"{key}: {value} (must be finite and above 0)" for key, value in bad.items()]
    raise_problems(problems)


def _check_columns(model: ReferenceModel, recovery: Recovery, conditions: Conditions) -> None:
    needed = dict.fromkeys(model.needs, f"reference heating `{model.name}`")
    needed |= {name: f"recovery `{recovery.kind}`" for name in recovery.needs if name not in needed}
    missing = [name for name in needed if name not in conditions]
    if missing:
        raise InputError(f"conditions: column {missing[0]} is missing; {needed[missing[0]]} needs it")
    for name in {"rho_kg_m3", "T_inf_K"} & set(model.needs):
        bad = np.flatnonzero(conditions[name] <= 0.0)
        if bad.size:
            value = conditions[name][bad[0]]
            raise InputError(f"conditions, row {bad[0] + 1}, column {name}: {value} (must be above 0)")


def reference_heating(
    name: str,
    conditions: Conditions,
    *,
    nose_radius_m: float = 0.3048,
    running_length_m: float | None = None,
    wall_temperature_K: float = COLD_WALL_K,
    recovery: Recovery | None = None,
    sweep_deg: float = 0.0,
    ratio: FloatArray | None = None,
) -> HeatingColumns:
    """Reference film coefficient and recovery enthalpy along a flight.

    name               : a key of REFERENCE_MODELS
    conditions         : with velocity_m_s, T_inf_K, rho_kg_m3 and, for the Eckert models, alpha_deg; `columns` reads
                         h_ref_kg_m2_s and H_r_J_kg instead
    nose_radius_m      : of the reference sphere [m]
    running_length_m   : of the Eckert models [m]
    wall_temperature_K : of the reference wall [K]; 300, the definition, unless a table states another
    sweep_deg          : of the reference cylinder at alpha 0 [deg], 0 to below 90
    recovery           : of the point; by default that of the reference: the total enthalpy, the adiabatic wall of an
                         Eckert model at the angle of attack, or that of the cylinder. Columns are those of the point
                         and taken as given
    ratio              : (time,) heating ratio of the point in continuum flow [-], with which thin air is bridged; by
                         default 1, that of the reference itself
    returns            : h_ref, H_r and its rise in turbulent flow
    raises             : InputError for an unknown name, a missing column, a density, temperature or length not above 0

    Stagnation heating holds from rest to free-molecular flow: below 2 km/s Fay-Riddell takes over from a correlation,
    thin air is bridged at the point (Matting 1971), to free-molecular flow at the angle of its surface. Columns are
    never bridged. `ReferenceModel` states the speeds, `beyond_range` what a flight does outside of them.
    Source: docs/theory/equations_reference_heating.md, equations 9 to 19, 31, 32 and 32a (Sutton and Graves 1971;
    Detra et al. 1957; Fay and Riddell 1958; Eckert 1956; Matting 1971).
    """
    model = reference_model(name)
    of_point = replace(model.recovery, sweep_deg=sweep_deg) if recovery is None else recovery
    _check_geometry(model, nose_radius_m, running_length_m, wall_temperature_K)
    if not 0.0 <= sweep_deg < 90.0:
        raise InputError(f"heating.sweep_deg: {sweep_deg} (must be 0 or above, and below 90)")
    _check_columns(model, of_point, conditions)
    # Copies, so that a change of the result does not change the record.
    if model.code == COLUMNS:
        h_ref, H_r = conditions["h_ref_kg_m2_s"].copy(), conditions["H_r_J_kg"].copy()
        return HeatingColumns(h_ref, H_r, point_recovery(of_point, H_r, conditions)[1])
    absent = np.zeros(len(conditions))
    # The kernel has one signature; a column that the model does not read is given as zeros.
    inputs = [conditions[n] if n in model.needs else absent for n in _PLATE]
    # Copies: to numba a read-only column is another type, for which the loop would be compiled a second time.
    rho, V, T_inf, alpha = (np.array(a, dtype=float) for a in inputs)
    h_ref, H_0 = np.empty(len(conditions)), np.empty(len(conditions))
    geometry = (float(nose_radius_m), float(running_length_m or 1.0), float(wall_temperature_K), float(sweep_deg))
    _reference_loop(model.code, rho, V, T_inf, alpha, geometry, h_ref, H_0)
    H_r, rise = point_recovery(of_point, H_0, conditions)
    if model.code != NONE:
        names = ("alpha_deg", "elevon_deg", "bodyflap_deg")
        read = {*model.needs, *of_point.needs}
        turned = np.array([conditions[n] if n in read else absent for n in names])
        ratios = np.ones(len(conditions)) if ratio is None else np.array(ratio, dtype=float)
        _bridge_loop(model.code, rho, V, T_inf, turned, float(sweep_deg), of_point.parameters(), ratios, H_r, h_ref)
    return HeatingColumns(h_ref, H_r, rise)


def beyond_range(name: str, conditions: Conditions) -> str | None:
    """One line on the part of a flight that is faster [m/s] than a reference heating holds; None where there is none.

    name       : a key of REFERENCE_MODELS
    conditions : of the flight, with velocity_m_s
    """
    fastest, speed = reference_model(name).holds_m_s[1], conditions["velocity_m_s"]
    beyond = speed > fastest
    if not np.any(beyond):
        return None
    first, highest = float(conditions.time_s[beyond][0]), float(np.max(speed))
    return (
        f"reference heating `{name}` holds to {fastest / 1e3:g} km/s; it is continued to {highest / 1e3:.2f} km/s from "
        f"{first:g} s on, and radiation of the shock layer is not modelled"
    )
