"""Flight conditions that follow from those that a file states: speed, air, Mach and Reynolds number.

    V    = M sqrt(gamma R T)                    from a Mach number, where there is no speed
    rho  = 2 q / V^2,  else  p / (R T)          from dynamic pressure, else from pressure and temperature
    T    = p / (rho R)                          below 86 km
    rho, T, p of a sounding, else of the US Standard Atmosphere 1976, at the altitude
    M    = V / sqrt(gamma R T),  log10 Re = log10(rho V L / mu(T))

What a file states is never replaced. The air of the standard atmosphere is not that of the day: density and temperature
that come from it are named apart, since they lower the confidence of the conditions.

Sources: US Standard Atmosphere 1976, eqs. 18, 19, 42, 50, 51; docs/theory/equations_reference_heating.md, 1 to 3.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.heating import atmosphere
from sim_heating.heating.recorded.fields import GEOPOTENTIAL, REYNOLDS, SOUND
from sim_heating.heating.recorded.sounding import Sounding

AIR = ("T_inf_K", "p_inf_Pa", "rho_kg_m3")
FREE_STREAM = ("T_inf_K", "p_inf_Pa", "mach", "log10_re")
METRE = 1.0
"""Reference length of a Reynolds number where none is stated [m]: the number is that of a metre."""
STANDARD = "the standard atmosphere at altitude_m"


@dataclass(frozen=True)
class DerivedConditions:
    """Conditions with what follows from them.

    columns  : name -> (row,) in the unit that the name ends in
    notes    : one line for each derivation
    of_model : columns of the air that are of the standard atmosphere, and not of the day
    """

    columns: dict[str, FloatArray]
    notes: tuple[str, ...]
    of_model: tuple[str, ...]


def derived_conditions(
    stated: Mapping[str, FloatArray],
    *,
    length_m: float | None = None,
    sounding: Sounding | None = None,
    requested: Collection[str] = (*AIR, "velocity_m_s", "mach", "log10_re"),
) -> DerivedConditions:
    """Conditions with the columns that follow from those of a file.

    stated    : name -> (row,) in the unit that the name ends in; `reynolds` [-], `sound_m_s` [m/s] and
                `geopotential_m` [m] may be among them
    length_m  : reference length of the Reynolds number [m]; None for that of a metre
    sounding  : air of the day; what it does not reach is of the standard atmosphere
    requested : columns to derive; what follows from nothing stays absent
    Source    : US Standard Atmosphere 1976, eqs. 42, 50, 51; docs/theory/equations_reference_heating.md, 1 to 3.
    """
    c = dict(stated)
    notes = _add_other_forms(c)
    air = _Air(c, sounding)
    if "velocity_m_s" in requested:
        _add_speed(c, notes, air)
    if "rho_kg_m3" in requested:
        _add_density(c, notes, air)
    _add_free_stream(c, notes, air, requested, length_m)
    columns = {name: values for name, values in c.items() if name not in (REYNOLDS, SOUND, GEOPOTENTIAL)}
    return DerivedConditions(columns, (*notes, *air.notes), tuple(n for n in AIR if n in air.of_model))


class _Air:
    """Temperature, pressure and density at the altitudes of a flight: of a sounding, above and below it standard."""

    def __init__(self, conditions: Mapping[str, FloatArray], sounding: Sounding | None) -> None:
        self.conditions, self.sounding = conditions, sounding
        self.of_model: set[str] = set()
        self.notes: list[str] = []
        self._columns: dict[str, FloatArray] = {}

    @property
    def is_known(self) -> bool:
        """Whether there is an altitude, or the temperature itself."""
        return "altitude_m" in self.conditions or "T_inf_K" in self.conditions

    def __getitem__(self, name: str) -> FloatArray:
        if name in self.conditions:
            return self.conditions[name]
        if not self._columns:
            z = self.conditions["altitude_m"]
            self._columns = dict(zip(AIR, atmosphere.us76(z), strict=True))
            if self.sounding is not None:
                self._columns, notes = self.sounding.at(z, self._columns)
                self.notes += notes
        if self.sounding is None or not np.all(self.sounding.reaches(self.conditions["altitude_m"])):
            self.of_model.add(name)
        return self._columns[name]

    def named(self, name: str) -> str:
        """`, name of SOURCE` for a note; nothing where the file states it."""
        return "" if name in self.conditions else f", {name} of {self.source}"

    @property
    def source(self) -> str:
        """What the air is taken from, in words."""
        return STANDARD if self.sounding is None else self.sounding.title


def _add_other_forms(c: dict[str, FloatArray]) -> list[str]:
    """Altitude [m] and log10 Re [-] from the geopotential height and the Reynolds number; notes of what was added."""
    notes = []
    if GEOPOTENTIAL in c and "altitude_m" not in c:
        c["altitude_m"] = np.array([atmosphere.geometric(float(h)) for h in c[GEOPOTENTIAL]])
        notes.append("altitude_m from the geopotential height")
    if REYNOLDS in c and "log10_re" not in c:
        c["log10_re"] = np.log10(np.maximum(c[REYNOLDS], atmosphere.SLOWEST_RE))
        notes.append("log10_re from the Reynolds number, of the reference length of the file")
    return notes


def _add_speed(c: dict[str, FloatArray], notes: list[str], air: _Air) -> None:
    """Speed [m/s] from the Mach number, where it is absent."""
    if "velocity_m_s" in c or "mach" not in c:
        return
    if SOUND in c:
        c["velocity_m_s"] = c["mach"] * c[SOUND]
        notes.append("velocity_m_s from mach and the speed of sound")
    elif air.is_known:
        c["velocity_m_s"] = c["mach"] * np.sqrt(atmosphere.GAMMA * atmosphere.R_AIR * air["T_inf_K"])
        notes.append(f"velocity_m_s from mach{air.named('T_inf_K')}")


def _is_positive(c: Mapping[str, FloatArray], name: str) -> bool:
    """Whether a column is there, and positive in all rows."""
    return name in c and bool(np.all(c[name] > 0.0))


def _add_density(c: dict[str, FloatArray], notes: list[str], air: _Air) -> None:
    """Density [kg/m3] of dynamic pressure, of pressure and temperature, or of the air at the altitude."""
    if "rho_kg_m3" in c:
        return
    q = "q_Pa" if "q_Pa" in c else "qbar_Pa"
    if q in c and _is_positive(c, "velocity_m_s"):
        c["rho_kg_m3"] = 2.0 * c[q] / c["velocity_m_s"] ** 2
        notes.append(f"rho_kg_m3 from {q} and velocity_m_s")
    elif "T_inf_K" in c and _is_positive(c, "p_inf_Pa"):
        c["rho_kg_m3"] = c["p_inf_Pa"] / (atmosphere.R_AIR * c["T_inf_K"])
        notes.append("rho_kg_m3 from p_inf_Pa and T_inf_K")
    elif "altitude_m" in c and _is_positive(c, "p_inf_Pa"):
        c["rho_kg_m3"] = c["p_inf_Pa"] / (atmosphere.R_AIR * air["T_inf_K"])
        notes.append(f"rho_kg_m3 from p_inf_Pa{air.named('T_inf_K')}")
    elif "altitude_m" in c:
        c["rho_kg_m3"] = air["rho_kg_m3"]
        notes.append(f"rho_kg_m3 of {air.source}")


def _add_air(c: dict[str, FloatArray], notes: list[str], air: _Air, absent: Collection[str]) -> None:
    """Temperature [K] and pressure [Pa] by the gas law, where one of them is absent, or of the air of the day."""
    if "T_inf_K" in absent:
        low = np.all(c["altitude_m"] <= atmosphere.UPPER_BASE_M) and _is_positive(c, "p_inf_Pa")
        c["T_inf_K"] = c["p_inf_Pa"] / (c["rho_kg_m3"] * atmosphere.R_AIR) if low else air["T_inf_K"]
        notes.append("T_inf_K from p_inf_Pa and rho_kg_m3" if low else f"T_inf_K of {air.source}")
    if "p_inf_Pa" in absent:
        c["p_inf_Pa"] = c["rho_kg_m3"] * atmosphere.R_AIR * c["T_inf_K"]
        notes.append("p_inf_Pa from rho_kg_m3 and T_inf_K")


def _add_similarity(c: dict[str, FloatArray], absent: Collection[str], length_m: float) -> None:
    """Mach number [-] and log10 of the Reynolds number [-] on a length [m], where absent."""
    if "mach" in absent:
        c["mach"] = c["velocity_m_s"] / (
            c[SOUND] if SOUND in c else np.sqrt(atmosphere.GAMMA * atmosphere.R_AIR * c["T_inf_K"])
        )
    if "log10_re" in absent:
        re = c["rho_kg_m3"] * c["velocity_m_s"] * length_m / atmosphere.sutherland_viscosity(c["T_inf_K"])
        c["log10_re"] = np.log10(np.maximum(re, atmosphere.SLOWEST_RE))


def _add_free_stream(
    c: dict[str, FloatArray], notes: list[str], air: _Air, requested: Collection[str], length_m: float | None
) -> None:
    """Temperature [K], pressure [Pa], Mach number [-] and log10 Re [-], as far as absent."""
    absent = [name for name in FREE_STREAM if name not in c and name in requested]
    if not absent or not {"altitude_m", "velocity_m_s", "rho_kg_m3"} <= set(c):
        return
    length = METRE if length_m is None else length_m
    if {"T_inf_K", "p_inf_Pa"} <= set(absent) and air.sounding is None:
        standard = atmosphere.free_stream(c["altitude_m"], c["velocity_m_s"], c["rho_kg_m3"], length)
        c |= {name: standard[name] for name in absent}
        air.of_model.add("T_inf_K")
        notes.append(f"T_inf_K of {STANDARD}, p_inf_Pa from it and rho_kg_m3")
    else:
        _add_air(c, notes, air, absent)
        _add_similarity(c, absent, length)
    notes += _notes_of_similarity(absent, length_m)


def _notes_of_similarity(absent: Collection[str], length_m: float | None) -> list[str]:
    per = "per metre" if length_m is None else f"of the reference length {length_m:g} m"
    of_column = {
        "mach": "mach from velocity_m_s and the speed of sound",
        "log10_re": f"log10_re {per} from rho_kg_m3, velocity_m_s and T_inf_K",
    }
    return [note for name, note in of_column.items() if name in absent]
