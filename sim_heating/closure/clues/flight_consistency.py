"""Flight conditions checked against themselves, before any fit.

Columns of a flight are not independent of each other. Relations between them, each along the descent:

    gas            p = rho R T
    hydrostatics   d ln p / dz = -rho g / p
    Mach number    V = M sqrt(1.4 p / rho)
    Reynolds       10^log10_re = rho V L / mu(T), with one length L
    enthalpy       H_r - cp T = r V^2 / 2, where it is a column, r smooth in the angle of attack
    path           dz/dt = V sin gamma, where the path angle is a column
    drag           -dV/dt - g sin gamma = rho V^2 / 2 (CD S / m), CD S / m smooth in angle of attack and deflections
    axial force    axial_accel_g g0 = rho V^2 / 2 (CA S / m), likewise, where it is a column

The first five are one number along the flight. Drag and axial force are fitted by a quadratic in the angle of attack
and lines in deflections and velocity. Fits are robust (Huber's weights), so that the greater part of a flight judges
the rest. What counts is the deviation of a part of the flight in units of the scatter of the whole, to which noise and
resolution of velocity and altitude are added, all estimated from the columns: shears of the atmosphere and a coarse
recorder widen it. A deviation that is common to the whole flight, such as a density that is wrong by one factor, is in
no relation and is not found here.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from sim_heating.base.arrays import BoolArray, FloatArray
from sim_heating.base.conditions import Conditions
from sim_heating.heating.atmosphere import CP_AIR, G0_M_S2, GAMMA, R_AIR, gravity, sutherland_viscosity

SLOWEST_M_S = 2000.0
"""Velocity [m/s] below which coefficients change with Mach number, and winds count."""
HALF_WINDOW_S = 8.0
"""Half of the spans of time and altitude over which derivatives are taken."""
SIGMAS = 6.0
"""Scatters of the whole flight that a deviation has to exceed, for longer than this [s]."""
FEWEST = 60
"""Samples that a relation is judged with."""


@dataclass(frozen=True)
class Discrepancy:
    """A part of a flight whose conditions contradict each other.

    relation       : name of the relation, such as "drag"
    begin_s, end_s : when [s];  lowest_m, highest_m : altitudes [m] between which
    size           : median deviation, in the unit of the relation: over the value expected [-], or [deg] for the path
    sigmas         : over the scatter of the whole flight [-]
    message        : in one line
    """

    relation: str
    begin_s: float
    end_s: float
    lowest_m: float
    highest_m: float
    size: float
    sigmas: float
    message: str


@dataclass(frozen=True, eq=False)
class _Relation:
    """Deviations of a relation along a flight.

    name, words : of it;  deviation : (time,) [-] or [deg];  judged : (time,) where it holds
    least       : smallest deviation that counts, for models of it are approximate;  unit : of the deviation
    noise       : (time,) standard deviation from noise and resolution of the columns, in that unit
    """

    name: str
    words: str
    deviation: FloatArray
    judged: BoolArray
    least: float
    unit: str = "%"
    noise: FloatArray | float = 0.0


def flight_discrepancies(conditions: Conditions) -> list[Discrepancy]:
    """Parts of a flight whose conditions contradict each other, the clearest first; none for a ground test.

    conditions : flight conditions with the columns of `conditions.STATE`; `gamma_deg`, `axial_accel_g` and `H_r_J_kg`
                 are judged where they are columns
    """
    fast = conditions["velocity_m_s"] > SLOWEST_M_S
    if np.count_nonzero(fast) < FEWEST:
        return []
    flown = _evenly(conditions)
    discrepancies = [d for relation in RELATIONS for d in _parts(flown, relation(flown))]
    return sorted(discrepancies, key=lambda d: -d.sigmas)


def misfit_of_motion(conditions: Conditions) -> float:
    """How badly the motion of a flight follows from the forces on it: minus twice a log likelihood, but for a constant.

        sum of n ln(mean square of the deviations + e^2)   over drag, axial force and path,

    normal deviations of unknown variance, n the number of times that their errors last in the flight, e the accuracy of
    the relation. 0 for a ground test. A difference between two versions of one flight is a difference in BIC.
    """
    if np.count_nonzero(conditions["velocity_m_s"] > SLOWEST_M_S) < FEWEST:
        return 0.0
    flown, total = _evenly(conditions), 0.0
    for relation in (r(flown) for r in MOTION):
        if relation is not None and np.count_nonzero(relation.judged) >= FEWEST:
            accuracy = relation.least / SIGMAS
            weight = 1.0 / (1.0 + (relation.noise / accuracy) ** 2) * np.ones(len(flown))
            square = float(np.mean((weight * relation.deviation**2)[relation.judged]))
            lasting = np.count_nonzero(relation.judged) * float(flown.time_s[1] - flown.time_s[0]) / LASTING_S
            total += float(lasting * np.log(square / accuracy**2 + 1.0))
    return total


def contradictions_of_motion(stated: Conditions, changed: Conditions) -> list[Discrepancy]:
    """Parts of a changed flight whose motion does not follow from the forces, where it does in the stated flight, or
    does so better; the clearest first, none for a ground test.

    stated, changed : flight conditions at the same times. Deviations of both are in units of the scatter of the stated
                      ones: a change that is wrong everywhere would widen its own
    """
    if np.count_nonzero(changed["velocity_m_s"] > SLOWEST_M_S) < FEWEST:
        return []
    before, after, discrepancies = _evenly(stated), _evenly(changed), list[Discrepancy]()
    for relation in MOTION:
        was, becomes = relation(before), relation(after)
        if was is not None and becomes is not None and np.count_nonzero(was.judged) >= FEWEST:
            scatter = _scatter(was)
            largest = max((d.sigmas for d in _parts(before, was, scatter)), default=SIGMAS)
            discrepancies += [d for d in _parts(after, becomes, scatter) if d.sigmas > largest]
    return sorted(discrepancies, key=lambda d: -d.sigmas)


def _evenly(conditions: Conditions) -> Conditions:
    """Conditions at even times, at the median interval of the samples but not below `step_s`."""
    step_s = 1.0  # least interval [s] of the samples that are judged
    t = conditions.time_s
    return conditions.at(np.arange(t[0], t[-1], max(float(np.median(np.diff(t))), step_s)))


def _scatter(relation: _Relation) -> FloatArray:
    """(time,) standard deviation of a relation that is judged by some samples: its scatter along the flight, noise and
    accuracy."""
    spread = 1.4826 * float(np.median(np.abs(relation.deviation[relation.judged])))
    return np.maximum(np.hypot(spread, relation.noise) * np.ones_like(relation.deviation), relation.least / SIGMAS)


def _parts(flown: Conditions, relation: _Relation | None, scatter: FloatArray | None = None) -> list[Discrepancy]:
    """Parts of a flight that deviate from a relation; scatter : (time,) of it, by default its own."""
    longest_noise_s = 4.0
    if relation is None or np.count_nonzero(relation.judged) < FEWEST:
        return []
    t, judged = flown.time_s, relation.judged
    sigmas = np.where(judged, relation.deviation / (_scatter(relation) if scatter is None else scatter), 0.0)
    sign = _bridged(np.sign(sigmas) * (np.abs(sigmas) > SIGMAS), t)
    ends = np.flatnonzero(np.diff(sign, prepend=0.0, append=0.0) != 0.0)
    spans = [slice(first, after) for first, after in pairwise(ends) if sign[first] != 0.0]
    return [_discrepancy(flown, relation, sigmas, s) for s in spans if t[s.stop - 1] - t[s.start] > longest_noise_s]


def _bridged(sign: FloatArray, t: FloatArray) -> FloatArray:
    """(time,) signs of deviations, those that return to the same within a window in one part."""
    at = np.flatnonzero(sign)
    for i, j in pairwise(at):
        if sign[i] == sign[j] and t[j] - t[i] <= 2.0 * HALF_WINDOW_S:
            sign[i:j] = sign[i]
    return sign


def _discrepancy(flown: Conditions, relation: _Relation, sigmas: FloatArray, span: slice) -> Discrepancy:
    """What a part of a flight deviates by, in words."""
    t, z = flown.time_s[span], flown["altitude_m"][span] / 1e3
    size, count = float(np.median(relation.deviation[span])), float(np.median(np.abs(sigmas[span])))
    amount = f"{100.0 * abs(size):.0f} %" if relation.unit == "%" else f"{abs(size):.2g} {relation.unit}"
    message = (
        f"{relation.words} {amount} {'above' if size > 0.0 else 'below'} the rest of the flight from {t[0]:.0f} to "
        f"{t[-1]:.0f} s, {z.min():.1f} to {z.max():.1f} km ({count:.0f} sigma)"
    )
    ends = (float(t[0]), float(t[-1]), 1e3 * float(z.min()), 1e3 * float(z.max()))
    return Discrepancy(relation.name, *ends, size, count, message)


# The relations -------------------------------------------------------------------------------------------------------


def _low(flown: Conditions) -> BoolArray:
    """(time,) where air has one molar mass, and its density and pressure are known."""
    highest_m = 80e3  # altitude [m] above which the mean molar mass of air changes, and drag with rarefaction
    positive = (flown["p_inf_Pa"] > 0.0) & (flown["rho_kg_m3"] > 0.0) & (flown["T_inf_K"] > 0.0)
    return np.asarray((flown["altitude_m"] < highest_m) & positive)


def _hypersonic(flown: Conditions) -> BoolArray:
    """(time,) fast flight within the continuum."""
    return np.asarray(_low(flown) & (flown["velocity_m_s"] > SLOWEST_M_S))


def _ratio(numerator: FloatArray, denominator: FloatArray, judged: BoolArray) -> FloatArray:
    """Relative deviation of a ratio from its median over the judged samples; 0 elsewhere."""
    ratio = np.ones_like(numerator)
    np.divide(numerator, denominator, out=ratio, where=judged & (denominator > 0.0) & (numerator > 0.0))
    return np.where(judged, ratio / np.median(ratio[judged]) - 1.0, 0.0) if np.any(judged) else np.zeros_like(numerator)


def _gas(flown: Conditions) -> _Relation:
    judged = _low(flown)
    deviation = _ratio(flown["rho_kg_m3"] * R_AIR * flown["T_inf_K"], flown["p_inf_Pa"], judged)
    return _Relation("gas", "rho R T over the pressure is", deviation, judged, 0.01)


def _hydrostatics(flown: Conditions) -> _Relation | None:
    """Logarithm of the pressure over spans of altitude, against the weight of the air in them."""
    half_window_m = 1500.0
    judged = _low(flown)
    z_all = flown["altitude_m"]
    z, p, rho = z_all[judged], flown["p_inf_Pa"][judged], flown["rho_kg_m3"][judged]
    if len(z) < FEWEST or np.ptp(z) < 8.0 * half_window_m:
        return None
    order = np.argsort(z, kind="stable")
    level = np.arange(z[order[0]], z[order[-1]], 0.1 * half_window_m)
    log_p, weight = (np.interp(level, z[order], v[order]) for v in (np.log(p), rho * _gravity(z) / p))
    column = np.concatenate(([0.0], np.cumsum(0.5 * (weight[1:] + weight[:-1]) * np.diff(level))))
    ends = np.clip(z + half_window_m, None, level[-1]), np.clip(z - half_window_m, level[0], None)
    fell, weighed = (np.interp(ends[1], level, v) - np.interp(ends[0], level, v) for v in (log_p, -column))
    deviation = np.zeros(len(flown))
    deviation[judged] = np.divide(fell, weighed, out=np.ones_like(fell), where=weighed > 0.0) - 1.0
    words, noise = "the fall of pressure over the weight of the air is", _noise(z_all) / half_window_m
    return _Relation("hydrostatics", words, deviation, judged, 0.05, noise=noise)


def _gravity(z_m: FloatArray) -> FloatArray:
    """(time,) acceleration of gravity [m/s2]."""
    return np.array([gravity(float(z)) for z in z_m])


def _mach(flown: Conditions) -> _Relation:
    judged = _low(flown)
    sound = np.sqrt(GAMMA * np.divide(flown["p_inf_Pa"], flown["rho_kg_m3"], out=np.ones(len(flown)), where=judged))
    deviation = _ratio(flown["velocity_m_s"], flown["mach"] * sound, judged)
    words = "velocity over Mach number and speed of sound is"
    return _Relation("Mach number", words, deviation, judged, 0.01, noise=_of_speed(flown))


def _reynolds(flown: Conditions) -> _Relation:
    judged = _low(flown)
    mu = np.ones(len(flown))
    mu[judged] = sutherland_viscosity(flown["T_inf_K"][judged])
    deviation = _ratio(flown["rho_kg_m3"] * flown["velocity_m_s"], 10.0 ** flown["log10_re"] * mu, judged)
    words = "rho V over Reynolds number and viscosity is"
    return _Relation("Reynolds number", words, deviation, judged, 0.02, noise=_of_speed(flown))


def _enthalpy(flown: Conditions) -> _Relation | None:
    if "H_r_J_kg" not in flown:
        return None
    judged = _hypersonic(flown)
    kinetic = 0.5 * flown["velocity_m_s"] ** 2
    deviation, noise = _from_smooth(flown, flown["H_r_J_kg"] - CP_AIR * flown["T_inf_K"], kinetic, judged)
    words, noise = "recovery enthalpy over V^2/2 is", np.hypot(noise, 2.0 * _of_speed(flown))
    return _Relation("enthalpy", words, deviation, judged, 0.02, noise=noise)


def _path(flown: Conditions) -> _Relation | None:
    """Angle of the path from altitude and velocity, less that of the column."""
    if "gamma_deg" not in flown:
        return None
    judged = _hypersonic(flown)
    V = np.maximum(flown["velocity_m_s"], 1.0)
    sine = np.clip(_slope(flown["altitude_m"], flown) / V, -1.0, 1.0)
    deviation = np.degrees(np.arcsin(sine)) - _smoothed(flown["gamma_deg"], flown)
    words = "the path angle of altitude and velocity less that stated is"
    return _Relation("path", words, deviation, judged, 0.1, "deg", np.degrees(_slope_noise("altitude_m", flown) / V))


def _drag(flown: Conditions) -> _Relation:
    least_drag_m_s2 = 0.5  # drag below which nothing is reported [m/s2]
    V, z = np.maximum(flown["velocity_m_s"], 1.0), flown["altitude_m"]
    sinking = _smoothed(_gravity(z) * np.gradient(z, flown.time_s) / V, flown)
    drag = -_slope(V, flown) - sinking
    q = 0.5 * flown["rho_kg_m3"] * V**2
    judged = _hypersonic(flown) & (drag > least_drag_m_s2)
    deviation, model = _from_smooth(flown, drag, q, judged, smooth=True)
    noise = np.divide(_slope_noise("velocity_m_s", flown), drag, out=np.zeros(len(drag)), where=judged)
    words = "deceleration over dynamic pressure is"
    return _Relation("drag", words, deviation, judged, 0.05, noise=np.hypot(noise, model))


def _axial(flown: Conditions) -> _Relation | None:
    least_sensed_m_s2 = 0.05  # axial acceleration below which nothing is reported [m/s2]
    if "axial_accel_g" not in flown:
        return None
    q = 0.5 * flown["rho_kg_m3"] * flown["velocity_m_s"] ** 2
    acceleration = G0_M_S2 * flown["axial_accel_g"]
    judged = _hypersonic(flown) & (acceleration > least_sensed_m_s2)
    deviation, noise = _from_smooth(flown, acceleration, q, judged)
    words, noise = "axial acceleration over dynamic pressure is", np.hypot(noise, 2.0 * _of_speed(flown))
    return _Relation("axial force", words, deviation, judged, 0.1, noise=noise)


RELATIONS: tuple[Callable[[Conditions], _Relation | None], ...] = (
    _gas,
    _hydrostatics,
    _mach,
    _reynolds,
    _enthalpy,
    _path,
    _drag,
    _axial,
)
"""Relations between the columns of a flight."""


MOTION = (_path, _drag, _axial)
"""Those of the motion with the forces: a density may be wrong with the temperature or with the pressure, so that the
relations of the gas do not judge it."""


# Numerics ------------------------------------------------------------------------------------------------------------


def _kernel(flown: Conditions) -> FloatArray:
    """Weights of the mean that a derivative through a line over a window is of the true one: a parabola."""
    half = max(round(HALF_WINDOW_S / float(flown.time_s[1] - flown.time_s[0])), 2)
    k = np.arange(-half, half + 1)
    weight = np.concatenate(([0.0], np.cumsum(-k[:-1].astype(float)), [0.0]))
    # the line's slope weighs differences of neighbours; half of each goes to either of its samples
    weight = 0.5 * (weight[:-1] + weight[1:])
    return np.asarray(np.abs(weight) / np.sum(np.abs(weight)))


def _smoothed(values: FloatArray, flown: Conditions) -> FloatArray:
    """(time,) mean over the window of derivatives."""
    weight = _kernel(flown)
    padded = np.pad(values, len(weight) // 2, mode="edge")
    return np.convolve(padded, weight[::-1], mode="valid")


def _slope(values: FloatArray, flown: Conditions) -> FloatArray:
    """(time,) derivative in time through a line over a window."""
    return _smoothed(np.gradient(values, flown.time_s), flown)


def _noise(values: FloatArray) -> float:
    """Standard deviation of the noise of a column, from its second differences and its resolution.

    The resolution is the least difference of two neighbours; within it a column errs evenly.
    """
    steps = np.abs(np.diff(values))
    changes = steps[steps > 0.0]
    resolution = float(changes.min()) if changes.size else 0.0
    white = 1.4826 * float(np.median(np.abs(np.diff(values, 2)))) / np.sqrt(6.0)
    return float(np.hypot(white, resolution / np.sqrt(12.0)))


def _slope_noise(name: str, flown: Conditions) -> float:
    """Standard deviation of the slope of a column, as if its noise were the same along half a window."""
    return _noise(flown[name]) / HALF_WINDOW_S


def _of_speed(flown: Conditions) -> FloatArray:
    """(time,) noise of the velocity over the velocity."""
    return np.asarray(_noise(flown["velocity_m_s"]) / np.maximum(flown["velocity_m_s"], 1.0))


def _from_smooth(
    flown: Conditions, force: FloatArray, scale: FloatArray, judged: BoolArray, *, smooth: bool = False
) -> tuple[FloatArray, FloatArray]:
    """Relative deviation of a force from a smooth coefficient times its scale, and its standard deviation.

    The coefficient is quadratic in the angle of attack and linear in deflections and velocity. Where few samples say
    what it is, as at an angle that is flown in one manoeuvre alone, its own error counts: that of a fit to errors which
    stay the same for some time.
    smooth  : whether the force is a mean over the window of derivatives, as its model then has to be
    returns : (time,) and (time,), 0 where the force is not judged
    """
    huber_sigmas = 1.345  # scatters beyond which Huber's weights fall; 95 % efficient for normal errors (Huber 1964)
    rounds = 20  # iterations of a robust fit
    deviation, noise = np.zeros(len(flown)), np.zeros(len(flown))
    if np.count_nonzero(judged) < FEWEST:
        return deviation, noise
    alpha = flown["alpha_deg"] - np.median(flown["alpha_deg"][judged])
    speed = flown["velocity_m_s"] / np.median(flown["velocity_m_s"][judged]) - 1.0
    terms = [np.ones(len(flown)), alpha, alpha**2, flown["elevon_deg"], flown["bodyflap_deg"], speed]
    columns = np.column_stack([_smoothed(scale * v, flown) if smooth else scale * v for v in terms])
    y = force[judged]
    # relative errors; the columns are scaled for a well-conditioned fit
    A = columns[judged] / y[:, np.newaxis]
    A /= np.maximum(np.max(np.abs(A), axis=0), np.finfo(float).tiny)
    weight = np.ones(len(y))
    for _ in range(rounds):
        fit = np.linalg.lstsq(A * np.sqrt(weight)[:, np.newaxis], np.sqrt(weight), rcond=None)[0]
        residual = 1.0 - A @ fit
        spread = max(1.4826 * float(np.median(np.abs(residual))), 1e-9)
        weight = np.minimum(1.0, huber_sigmas * spread / np.maximum(np.abs(residual), 1e-12))
    leverage = np.einsum("ij,jk,ik->i", A, np.linalg.pinv(A.T @ (A * weight[:, np.newaxis])), A)
    lasting = LASTING_S / float(flown.time_s[1] - flown.time_s[0])
    deviation[judged] = np.divide(residual, A @ fit, out=np.zeros(len(y)), where=A @ fit > 0.0)
    noise[judged] = spread * np.sqrt(lasting * leverage)
    return deviation, noise


LASTING_S = 60.0
"""Time [s] for which errors of the atmosphere and of an aerodynamic model stay the same."""
