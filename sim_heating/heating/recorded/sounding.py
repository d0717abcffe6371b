"""The air of the day: temperature, pressure and density over altitude, of a radiosonde or of an atmosphere model.

    T linear in altitude, ln p and ln rho linear in altitude, between the levels
    rho = p / (R T) where a sounding has no density;  p = rho R T where it has no pressure

Below the lowest and above the highest level the air is that of the standard atmosphere.
Sources: US Standard Atmosphere 1976, eqs. 19 (geopotential height) and 42.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from sim_heating.base.arrays import BoolArray, FloatArray
from sim_heating.base.errors import InputError
from sim_heating.base.files import display_path
from sim_heating.heating.atmosphere import LOWEST_M, R_AIR, UPPER_BASE_M, geometric, us76
from sim_heating.heating.recorded.fields import GEOPOTENTIAL
from sim_heating.heating.recorded.layout import FlightFields, read_fields

LEAST_LEVELS = 2
EDGE_M = 100.0
"""Distance from the end levels [m] over which they are taken to hold, as a launch above the ground."""


@dataclass(frozen=True)
class Sounding:
    """Levels of the air of the day.

    path                       : of the file, for notes
    altitude_m                 : (level,) geometric altitude [m], increasing
    T_inf_K, p_inf_Pa, rho_kg_m3 : (level,) [K], [Pa], [kg/m3]
    """

    path: Path
    altitude_m: FloatArray
    T_inf_K: FloatArray
    p_inf_Pa: FloatArray
    rho_kg_m3: FloatArray

    @property
    def title(self) -> str:
        """The sounding in words."""
        low, high = self.altitude_m[[0, -1]] / 1e3
        return f"the sounding {display_path(self.path)}, {low:.3g} to {high:.3g} km"

    def reaches(self, altitude_m: ArrayLike) -> BoolArray:
        """Whether each altitude [m] lies between the lowest and the highest level."""
        z = np.asarray(altitude_m, dtype=float)
        return np.asarray((z >= self.altitude_m[0] - EDGE_M) & (z <= self.altitude_m[-1] + EDGE_M))

    def at(self, altitude_m: FloatArray, standard: Mapping[str, FloatArray]) -> tuple[dict[str, FloatArray], list[str]]:
        """Air [K], [Pa], [kg/m3] by column at altitudes [m], and notes on altitudes that the sounding does not reach.

        standard : the same columns of the standard atmosphere, which are taken there
        Source: US Standard Atmosphere 1976, eq. 42.
        """
        z, inside = np.asarray(altitude_m, dtype=float), self.reaches(altitude_m)
        measured = {
            "T_inf_K": np.interp(z, self.altitude_m, self.T_inf_K),
            "p_inf_Pa": np.exp(np.interp(z, self.altitude_m, np.log(self.p_inf_Pa))),
            "rho_kg_m3": np.exp(np.interp(z, self.altitude_m, np.log(self.rho_kg_m3))),
        }
        notes = []
        if not np.all(inside):
            top = float(self.rho_kg_m3[-1] / us76(self.altitude_m[-1])[2])
            notes.append(
                f"air above and below the sounding ({z[~inside].min() / 1e3:.3g} to {z[~inside].max() / 1e3:.3g} km) "
                f"of the standard atmosphere; at its highest level the sounding has {top:.3f} of its density"
            )
        return {name: np.where(inside, values, standard[name]) for name, values in measured.items()}, notes


def _levels(columns: dict[str, FloatArray]) -> dict[str, FloatArray]:
    """Levels in which all columns have numbers, in order of altitude, each altitude once."""
    is_complete = np.all([np.isfinite(values) for values in columns.values()], axis=0)
    _, first = np.unique(columns["altitude_m"][is_complete], return_index=True)
    return {name: values[is_complete][first] for name, values in columns.items()}


def read_sounding(path: Path) -> Sounding:
    """Read a sounding: an altitude, and two of temperature [K], pressure [Pa] and density [kg/m3], with their units.

    Read are CSV files with units in the names or in a row below them, and lists of fixed columns as of the University
    of Wyoming; PRES, HGHT (geopotential height) and TEMP are their names.
    raises : InputError, one line, for columns that are missing, levels that do not rise, air that is no air
    """
    fields = read_fields(path)
    c = dict(fields.columns)
    if GEOPOTENTIAL in c and "altitude_m" not in c:
        c["altitude_m"] = np.array([geometric(float(h)) for h in c[GEOPOTENTIAL]])
    if lacking := _lacking(fields, c):
        raise InputError(
            f"{display_path(path)}: a sounding needs {', '.join(lacking)}; write names with units, as "
            "`Altitude (km)`, `Temperature (K)`, `Pressure (hPa)`"
        )
    c = _levels({n: c[n] for n in ("altitude_m", "T_inf_K", "p_inf_Pa", "rho_kg_m3") if n in c})
    if len(c["altitude_m"]) < LEAST_LEVELS:
        rule = f"a sounding needs {LEAST_LEVELS} levels with numbers; it has {len(c['altitude_m'])}"
        raise InputError(f"{display_path(path)}: {rule}")
    if "T_inf_K" not in c:
        c["T_inf_K"] = c["p_inf_Pa"] / (R_AIR * c["rho_kg_m3"])
    c.setdefault("p_inf_Pa", R_AIR * c.get("rho_kg_m3", c["T_inf_K"]) * c["T_inf_K"])
    c.setdefault("rho_kg_m3", c["p_inf_Pa"] / (R_AIR * c["T_inf_K"]))
    _check_air(path, c)
    return Sounding(path, c["altitude_m"], c["T_inf_K"], c["p_inf_Pa"], c["rho_kg_m3"])


def _lacking(fields: FlightFields, columns: Collection[str]) -> list[str]:
    """What a file lacks to be a sounding, in words.

    columns : that it has, the geometric altitude included
    """
    lacking = [f"the unit of `{name}`" for name in fields.without_unit]
    if "altitude_m" not in {*columns, *fields.fields_without_unit}:
        lacking.append("an altitude")
    if len({"T_inf_K", "p_inf_Pa", "rho_kg_m3"} & set(columns)) < 2 and not fields.without_unit:
        lacking.append("two of temperature, pressure and density")
    return lacking


def _check_air(path: Path, c: Mapping[str, FloatArray]) -> None:
    """Refuse levels whose air is none: units of another size.

    raises : InputError with the level that is furthest off
    """
    z = c["altitude_m"]
    for name, low, high in (("T_inf_K", 100.0, 5000.0), ("p_inf_Pa", 0.0, 2e5), ("rho_kg_m3", 0.0, 3.0)):
        bad = np.flatnonzero(~((c[name] > low) & (c[name] < high)))
        if bad.size:
            rule = f"{name} is {c[name][bad[0]]:g} at {z[bad[0]]:g} m, as no air has it; check its unit"
            raise InputError(f"{display_path(path)}: {rule}")
    inside = (z >= LOWEST_M) & (z <= UPPER_BASE_M)
    if not np.any(inside):
        return
    ratio = c["rho_kg_m3"][inside] / us76(z[inside])[2]
    worst = int(np.argmax(np.abs(np.log(ratio))))
    if not 0.25 < ratio[worst] < 4.0:
        raise InputError(
            f"{display_path(path)}: the density is {ratio[worst]:.3g} of the standard atmosphere's at "
            f"{z[inside][worst]:g} m; check units of altitude, temperature and pressure"
        )
