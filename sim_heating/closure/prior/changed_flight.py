"""The conditions of a record with another density, velocity, angle of attack or clock, and all that follows from them.

Whatever follows from a changed column changes with it: Reynolds and Mach number, free-stream and surface pressure, and
the reference heating. Where the record names its reference heating, film coefficient and recovery enthalpy are computed
from the changed columns by `conditions_of_record`. Where they are columns,

    h_ref ~ rho^1/2 V,    H_r changes as H_0 - (1 - r) u_e^2 / 2 does,

laminar stagnation heating (Sutton & Graves, NASA TR R-376, 1971) and the recovery of the point. The rise of the surface
pressure goes with the dynamic pressure, and with the angle of attack as that of modified Newtonian flow where it has
done so along the flight.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sim_heating.base.arrays import BoolArray, FloatArray
from sim_heating.base.conditions import Conditions
from sim_heating.heating.reference.models import reference_heating
from sim_heating.heating.surface_pressure import FractionOfStagnation, surface_pressure
from sim_heating.inputs.record import Record

ANGLES = ("alpha_deg", "beta_deg", "elevon_deg", "bodyflap_deg")
"""Columns of angles, which a trajectory that is merged with them, and with the jets, may be earlier or later than."""


def heated_part(flown: Conditions) -> BoolArray:
    """(time,) whether laminar heating, rho^1/2 V^3, is a good part of its largest."""
    heated_share = 0.15  # part of the largest heating of a cold wall above which a flight counts as heated
    heating = np.sqrt(flown["rho_kg_m3"]) * flown["velocity_m_s"] ** 3
    return np.asarray(heating >= heated_share * heating.max())


def shift_conditions(record: Record, later_s: FloatArray | float) -> Record:
    """The record with the conditions of a flight that was later by some seconds.

    Before its first row and after its last one the shifted flight has the values of that row: samples stay the same,
    so that likelihoods can be compared.
    """
    flown = record.conditions
    at = np.clip(flown.time_s - later_s, flown.time_s[0], flown.time_s[-1])
    moved = {name: np.interp(at, flown.time_s, values) for name, values in flown.columns.items() if name != "time_s"}
    return replace(record, conditions=flown.with_columns(**moved))


def shift_trajectory(record: Record, later_s: float) -> Record:
    """The record with velocity, altitude and air of a flight that was later by some seconds, and the angles stated."""
    flown, shifted = record.conditions, shift_conditions(record, later_s)
    kept = {name: flown[name] for name in (*ANGLES, "jets") if name in flown}
    turned = _changed(shifted, {"alpha_deg": kept.pop("alpha_deg")})
    return replace(turned, conditions=turned.conditions.with_columns(**kept))


def with_density(record: Record, factor: FloatArray | float) -> Record:
    """The record with its density times a factor, at the temperature of the air."""
    flown = record.conditions
    columns = {"rho_kg_m3": flown["rho_kg_m3"] * factor, "p_inf_Pa": flown["p_inf_Pa"] * factor}
    return _changed(record, columns)


def with_velocity(record: Record, factor: FloatArray | float) -> Record:
    """The record with its velocity times a factor."""
    flown = record.conditions
    return _changed(record, {"velocity_m_s": flown["velocity_m_s"] * factor, "mach": flown["mach"] * factor})


def with_alpha(record: Record, bias_deg: float) -> Record:
    """The record with its angle of attack larger by some degrees."""
    return _changed(record, {"alpha_deg": record.conditions["alpha_deg"] + bias_deg})


def with_sharper_alpha(record: Record, width_s: float) -> Record:
    """The record with the angle of attack whose mean over some seconds is the stated one.

    width_s : standard deviation of the weights of the mean, a Gaussian [s]

        a_0 = a,   a_(k+1) = a_k + (a - G a_k)

    by `sharpenings` iterations, which amplify noise that much at most, and give back what the mean leaves of an angle.
    Source: van Cittert, "Zum Einfluss der Spaltbreite auf die Intensitaetsverteilung in Spektrallinien II", 1931.
    """
    sharpenings, step_s = 12, 0.5  # iterations that undo a mean, and the step of the times that it is taken at [s]
    flown = record.conditions
    if width_s <= 0.0:
        return record
    at_s = np.arange(flown.time_s[0], flown.time_s[-1] + step_s, step_s)
    stated = np.interp(at_s, flown.time_s, flown["alpha_deg"])
    half = int(4.0 * width_s / step_s) + 1
    weight = np.exp(-0.5 * (np.arange(-half, half + 1) * step_s / width_s) ** 2)
    weight /= weight.sum()
    sharper = stated
    for _ in range(sharpenings):
        sharper = sharper + stated - np.convolve(np.pad(sharper, half, mode="edge"), weight, mode="valid")
    return _changed(record, {"alpha_deg": flown["alpha_deg"] + np.interp(flown.time_s, at_s, sharper - stated)})


def _changed(record: Record, columns: dict[str, FloatArray]) -> Record:
    """The record with changed columns of density, velocity or angle of attack, and all that follows from them."""
    before, flown = record.conditions, record.conditions.with_columns(**columns)
    density, speed = (_over(flown[name], before[name]) for name in ("rho_kg_m3", "velocity_m_s"))
    following: dict[str, FloatArray] = {"log10_re": flown["log10_re"] + np.log10(density * speed)}
    if "q_Pa" in flown:
        following["q_Pa"] = flown["q_Pa"] * density * speed**2
    if "p_surface_Pa" in flown:
        following["p_surface_Pa"] = _surface_pressure(before, flown, density * speed**2)
    if record.declared.heating.reference == "columns":
        recovery = record.declared.heating.recovery_of_point
        # "none" has no film coefficient, only the recovery enthalpy of the point
        H_r = [reference_heating("none", c, recovery=recovery)[1] for c in (before, flown)]
        following["H_r_J_kg"] = flown["H_r_J_kg"] + H_r[1] - H_r[0]
        following["h_ref_kg_m2_s"] = flown["h_ref_kg_m2_s"] * np.sqrt(density) * speed
    return replace(record, conditions=flown.with_columns(**following))


def _over(values: FloatArray, reference: FloatArray) -> FloatArray:
    """Ratio of two columns, 1 where the second is 0."""
    return np.divide(values, reference, out=np.ones_like(values), where=reference != 0.0)


def _surface_pressure(stated: Conditions, flown: Conditions, pressure: FloatArray) -> FloatArray:
    """Surface pressure [Pa] in changed conditions: its rise goes with the dynamic pressure.

    pressure : (time,) changed over stated dynamic pressure [-]

        p = p_inf + q cp_max sin^2 theta,   theta - alpha constant for a windward surface

    The pressure coefficient of the stagnation point, cp_max, changes by less than 2 % for each km/s.
    """
    rise, turned = (stated["p_surface_Pa"] - stated["p_inf_Pa"]) * pressure, flown["alpha_deg"] - stated["alpha_deg"]
    if np.any(turned):
        stagnation = FractionOfStagnation(model="fraction-of-stagnation", fraction=1.0)
        largest = surface_pressure(stagnation, stated) - stated["p_inf_Pa"]
        fraction = np.divide(rise, largest, out=np.zeros_like(rise), where=(largest > 0.0) & (rise > 0.0))
        angle, heated = np.degrees(np.arcsin(np.sqrt(np.minimum(fraction, 1.0)))), heated_part(stated)
        # a windward surface follows the angle of attack; the pressure of a leeward one does not
        if np.std((angle - stated["alpha_deg"])[heated]) < 0.5 * np.std(stated["alpha_deg"][heated]):
            rise = largest * np.sin(np.radians(np.clip(angle + turned, 0.0, 90.0))) ** 2
    return np.asarray(flown["p_inf_Pa"] + rise)
