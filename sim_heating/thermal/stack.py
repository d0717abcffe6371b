"""The construction of a heated wall as declared in a file: materials, layers, stack, sensors.

One schema for flight records and vehicle directories. Lengths in m from the outer surface, temperatures in K,
pressures in Pa.
Property tables are linear between their points and constant beyond the ends; in pressure linear in log10(p).

Source: docs/theory/equations.md, equations 1 and 18.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Discriminator, Field, Tag, field_validator, model_validator

from sim_heating.base import files
from sim_heating.base.arrays import FloatArray
from sim_heating.base.errors import tell
from sim_heating.base.files import COLDEST_K, Declared, LocatedError, Location, celsius_rule
from sim_heating.base.files.toml import remarks_of
from sim_heating.base.limits import HOTTEST_K, QUANTITIES, usual_remark
from sim_heating.thermal.sampling import RATE_TEXT, SampleRate, require_span, word_step

Table = list[list[float]]
"""[[T_K, value], ...]"""

THICKEST_M = 5.0
"""Thickness above which a value is taken to be in millimetres [m]."""

TOO_HOT = f"too hot for a wall; give K, at most {HOTTEST_K:g}"

LIGHTEST_KG_M3, LIGHT_KG_M3, LIGHT_CONDUCTIVITY_W_MK = 3.0, 25.0, 0.3
"""Density of the lightest solids, aerogels, and of foams and batting, which conduct little: [kg/m3], [W/(m K)]. Every
density in g/cm3 lies below the second one."""

DENSE_KG_M3, DENSE_CONDUCTS_W_MK = 1000.0, 5e-3
"""Every solid of this density conducts more than the second one [W/(m K)] above 100 K: the least known is 0.05."""
CONDUCTED_W_M2_KKG, WARM_K = 2.0, 200.0
"""Conductivity over density [W m2/(K kg)] that no material exceeds from this temperature on: diamond has 1.4."""

FOAM_KG_M3, FOAM_CONDUCTS_W_MK = 400.0, 5.0
"""Density [kg/m3] below which, and conductivity [W/(m K)] above which, hardly any material has both."""
DENSE_J_M3K, LIGHT_J_KGK, ROOM_K = (0.7e6, 6.5e6), (400.0, 3000.0), 250.0
"""Heat capacity of dense solids by volume (plastics 1.5e6, nickel 6e6), of light ones by mass; from which T."""
DENSE_LEAST_W_MK, LIGHT_MOST_W_MK, COOL_K = 0.1, (0.05, 1.5e-3), 600.0
"""Least conductivity of dense solids; most of light ones, a + b density; below COOL_K, where radiation adds little."""
LIGHT_LAYER_M, METAL_LAYER_M, THIN_LAYER_M, METAL_W_MK = (5e-4, 0.15), (2e-4, 0.03), (4e-5, 4e-3), 3.0
"""Thickness [m] of felts to thick tiles, of skins to blocks, of paints to bonds; k from which it is the second."""
NOT_METAL_EMITS = 0.3
"""Emissivity below which a surface is of bright metal; one of a poor conductor is above."""
FIRST_K, LAST_K, AIR_PA = (50.0, 500.0), (300.0, 4500.0), (5e4, 2.5e5)
"""Ranges of the first and the last temperature of a property [K], and of the last pressure [Pa], near that of 1 atm."""
STANDS_OUT = 3.0
"""Factor by which a node of a property is over, or under, both of its neighbours where it stands out."""
LEAST, MOST = 1e-9, 1e9
"""Limits of any property or thickness in its SI unit. A value outside them is in another unit."""


def _is_table(value: Any) -> str:
    return "at pressures" if isinstance(value, (dict, PressureTable)) else "in temperature"


def _pair_problems(table: Table, columns: str) -> list[tuple[Location, str]]:
    """Problems of [[x, value], ...] that hold for any table: shape and increasing first entry."""
    if not table:
        return [((), f"the table is empty; give [[{columns}], ...], one row for a constant")]
    odd: list[tuple[Location, str]] = [
        ((i,), f"{row} is not a pair [{columns}]") for i, row in enumerate(table) if len(row) != 2
    ]
    if odd:
        return odd
    steps = pairwise(table)
    return [
        ((i + 1, 0), f"{b[0]:g} does not come after {a[0]:g}; sort the rows and remove repeated ones")
        for i, (a, b) in enumerate(steps)
        if b[0] <= a[0]
    ]


def _property_problems(table: Table, name: str, largest: float = MOST) -> list[tuple[Location, str]]:
    """Problems of a table [[T_K, value], ...] of a positive property."""
    problems = _pair_problems(table, "T_K, value")
    if problems:
        return problems
    rule = "K is below absolute zero; give K, not Celsius"
    cold: list[tuple[Location, str]] = [((i, 0), f"{row[0]:g} {rule}") for i, row in enumerate(table) if row[0] < 0.0]
    limits = f"above 0, up to {largest:g}" if largest < MOST else "above 0"
    bad: list[tuple[Location, str]] = [
        ((i, 1), f"{row[1]:g} is not {name} (must be {limits})")
        for i, row in enumerate(table)
        if not LEAST <= row[1] <= min(largest, MOST)
    ]
    return cold + bad + _hot_problems(table)


def _hot_problems(table: Table) -> list[tuple[Location, str]]:
    """A problem where the last, and so the highest, temperature of a table is above HOTTEST_K."""
    last = len(table) - 1
    return [((last, 0), f"{table[last][0]:g} K is {TOO_HOT}")] if table[last][0] > HOTTEST_K else []


def _raise_located(problems: Sequence[tuple[Location, str]]) -> None:
    files.raise_located(problems)


def _axis_problems(key: str, values: list[float]) -> list[tuple[Location, str]]:
    if not values:
        return [((key,), "the axis is empty; give at least one value")]
    problems: list[tuple[Location, str]] = [
        ((key, i + 1), f"{b:g} does not come after {a:g}; an axis increases")
        for i, (a, b) in enumerate(pairwise(values))
        if b <= a
    ]
    lowest_ok = values[0] > 0.0 if key == "p_Pa" else values[0] >= 0.0
    return problems if lowest_ok else [*problems, ((key, 0), f"{values[0]:g} must be above 0")]


class PressureTable(Declared):
    """Conductivity in temperature and pressure: k[T][p] [W/(m K)], linear in T and in log10(p).

    How it is interpolated: docs/theory/equations_thermal_step.md, equation 10.
    """

    quantities: ClassVar = {"k": "conductivity_W_mK"}

    p_Pa: list[float] = Field(description="increasing pressures above 0")
    T_K: list[float] = Field(description="increasing temperatures")
    k: Table = Field(description="one row per T_K, one column per p_Pa, W/(m K)")

    @model_validator(mode="after")
    def _check(self) -> PressureTable:
        problems = _axis_problems("p_Pa", self.p_Pa) + _axis_problems("T_K", self.T_K)
        if len(self.k) != len(self.T_K):
            problems.append((("k",), f"has {len(self.k)} rows against {len(self.T_K)} values of T_K; one row per T_K"))
        for i, row in enumerate(self.k):
            if len(row) != len(self.p_Pa):
                rule = f"has {len(row)} values against {len(self.p_Pa)} of p_Pa; one column per p_Pa"
                problems.append((("k", i), rule))
            problems += [
                (("k", i, j), f"{value:g} is not a conductivity (must be above 0)")
                for j, value in enumerate(row)
                if not LEAST <= value <= MOST
            ]
        _raise_located(problems)
        return self


def _conductivity_remark(rho_kg_m3: float, least: float, most: float) -> str:
    """What is unusual about conductivities [W/(m K)] of a cool material at its density; empty where nothing is."""
    at, highest = f"is unusual at {rho_kg_m3:g} kg/m3", LIGHT_MOST_W_MK[0] + LIGHT_MOST_W_MK[1] * rho_kg_m3
    if rho_kg_m3 >= DENSE_KG_M3 and least < DENSE_LEAST_W_MK:
        return f"{least:.3g} W/(m K) {at} ({DENSE_LEAST_W_MK:g} and more); check both"
    if rho_kg_m3 < FOAM_KG_M3 and most > highest:
        return f"{most:.3g} W/(m K) {at} (up to {highest:.3g}); check both"
    return ""


class Material(Declared):
    """A material of a layer: density [kg/m3], specific heat [J/(kg K)], conductivity [W/(m K)], emissivity [-].

    Only the outermost layer, and faces of a gas layer, need an emissivity. `conductivity_sigma` and
    `heat_capacity_sigma` are relative standard deviations from one part to another, that of the heat capacity with
    density. `source` and `confidence` are kept with the values. The limits of a solid are not those of a gas: a layer
    of gas, such as a gap, declares kind = "gas".

    kind     : "solid", or "gas" for a layer of gas
    apparent : whether the specific heat holds the latent heat of a change of phase, as a peak over a few kelvins
    """

    quantities: ClassVar = {
        "emissivity": ("T_K", "emissivity"),
        "specific_heat_J_kgK": ("T_K", "specific_heat_J_kgK"),
        "conductivity_W_mK": ("T_K", "conductivity_W_mK"),
    }

    kind: Literal["solid", "gas"] = "solid"
    density_kg_m3: float = Field(gt=0.0, le=MOST, description="density in kg/m3, above 0")
    emissivity: Table | None = Field(default=None, description="[[T_K, value], ...], value above 0, up to 1")
    specific_heat_J_kgK: Table = Field(description="[[T_K, value], ...] in J/(kg K)")
    apparent: bool = Field(default=False, description="whether the specific heat holds a latent heat as a peak")
    conductivity_W_mK: Annotated[
        Annotated[Table, Tag("in temperature")] | Annotated[PressureTable, Tag("at pressures")],
        Discriminator(_is_table),
    ] = Field(description="[[T_K, value], ...] or { p_Pa, T_K, k } in W/(m K)")
    conductivity_sigma: float | None = Field(default=None, gt=0.0, le=1.0, description="relative, above 0, up to 1")
    heat_capacity_sigma: float | None = Field(default=None, gt=0.0, le=1.0, description="relative, above 0, up to 1")
    max_use_K: float | None = Field(
        default=None, gt=COLDEST_K, le=HOTTEST_K, description="highest temperature of use in K"
    )
    source: str | None = None
    confidence: str | None = None
    note: str | None = None

    @field_validator("emissivity")
    @classmethod
    def _check_emissivity(cls, table: Table | None) -> Table | None:
        if table is not None:
            _raise_located(_property_problems(table, "an emissivity", largest=1.0))
        return table

    @field_validator("specific_heat_J_kgK")
    @classmethod
    def _check_specific_heat(cls, table: Table) -> Table:
        _raise_located(_property_problems(table, "a specific heat"))
        return table

    @field_validator("conductivity_W_mK")
    @classmethod
    def _check_conductivity(cls, table: Table | PressureTable) -> Table | PressureTable:
        if not isinstance(table, PressureTable):
            _raise_located(_property_problems(table, "a conductivity"))
        return table

    def implausible(self) -> list[tuple[Location, str]]:
        """Properties ([kg/m3], [J/(kg K)], [W/(m K)], [-]) that no material has, and those that only a gas has."""
        problems = [*self._density_problems(), *self._heat_problems()]
        return super().implausible() or problems or self._conductivity_problems()

    def unusual(self) -> list[tuple[Location, str]]:
        """Properties ([kg/m3], [J/(kg K)], [W/(m K)], [-]) that few materials have, and nodes of a table that stand
        out of their neighbours."""
        remarks = super().unusual()
        if self.kind == "gas":
            return [(location, text) for location, text in remarks if location[0] == "emissivity"]
        if not self.apparent:
            remarks += self._specific_heat_remarks()
        _, T_K, k = self.conductivity_grid()
        warm = np.flatnonzero(T_K >= COLDEST_K)
        remarks += [
            (("conductivity_W_mK",), f"at {T_K[warm[i]]:g} K {text}; check it")
            for column in k[warm].T
            for i, text in nodes_that_stand_out(column.tolist())
        ][:1]
        largest = float(np.max(k))
        if self.density_kg_m3 < FOAM_KG_M3 and largest > FOAM_CONDUCTS_W_MK:
            text = f"{largest:g} W/(m K) is unusual at {self.density_kg_m3:g} kg/m3"
            remarks.append((("conductivity_W_mK",), f"{text} (foams and felts have below {FOAM_CONDUCTS_W_MK:g})"))
        remarks += self._density_remarks(T_K, k) + self._axis_remarks()
        return remarks + self._emissivity_remarks(largest)

    def _specific_heat_remarks(self) -> list[tuple[Location, str]]:
        """The first specific heat [J/(kg K)] that few materials have, or the nodes that stand out of their table."""
        heats = [(i, value) for i, (T_K, value) in enumerate(self.specific_heat_J_kgK) if T_K >= COLDEST_K]
        far = [(i, text) for i, v in heats if (text := usual_remark("specific_heat_from_100_K", v)) is not None]
        lines = far[:1] or [
            (heats[k][0], f"{text}; a peak of latent heat declares apparent = true")
            for k, text in nodes_that_stand_out([value for _, value in heats])
        ]
        return [(("specific_heat_J_kgK", i, 1), text) for i, text in lines]

    def _emissivity_remarks(self, largest_W_mK: float) -> list[tuple[Location, str]]:
        """Emissivities [-] that stand out of their table, and the first one of a bright metal where the conductivity is
        none of a metal."""
        if self.emissivity is None:
            return []
        values = [value for _, value in self.emissivity]
        bright = [i for i, value in enumerate(values) if value < NOT_METAL_EMITS and largest_W_mK < METAL_W_MK]
        rule = f"is unusual where k is {largest_W_mK:.3g} W/(m K), of no bright metal"
        lines = [(i, f"{text}; check it") for i, text in nodes_that_stand_out(values)]
        lines += [(i, f"{values[i]:g} {rule}") for i in bright[:1]]
        return [(("emissivity", i, 1), text) for i, text in lines]

    def _density_remarks(self, T_K: FloatArray, k: FloatArray) -> list[tuple[Location, str]]:
        """Heat capacity and conductivity that few solids of this density have."""
        rho = self.density_kg_m3
        remarks: list[tuple[Location, str]] = []
        low, high = (v / rho for v in DENSE_J_M3K) if rho >= DENSE_KG_M3 else LIGHT_J_KGK
        heats = [(i, c) for i, (T, c) in enumerate(self.specific_heat_J_kgK) if T >= ROOM_K and not low <= c <= high]
        if heats and not self.apparent:
            i, c = heats[0]
            text = f"{c:.4g} J/(kg K) is unusual at {rho:g} kg/m3 ({low:.3g} to {high:.3g}); check both"
            remarks.append((("specific_heat_J_kgK", i, 1), text))
        cool = k[(T_K <= COOL_K) & (T_K >= COLDEST_K)]
        if cool.size and (text := _conductivity_remark(rho, float(np.min(cool)), float(np.max(cool)))):
            remarks.append((("conductivity_W_mK",), text))
        return remarks

    def _axis_remarks(self) -> list[tuple[Location, str]]:
        """Tables over temperatures or pressures that walls do not have."""
        k = self.conductivity_W_mK
        axes = {
            "specific_heat_J_kgK": pairs(self.specific_heat_J_kgK)[0],
            "conductivity_W_mK": self.conductivity_grid()[1],
        }
        remarks: list[tuple[Location, str]] = [
            ((name,), f"is over {T[0]:g} to {T[-1]:g} K, and walls have some 200 to 2000 K; check its temperatures")
            for name, T in axes.items()
            if len(T) > 1 and not (FIRST_K[0] <= T[0] <= FIRST_K[1] and LAST_K[0] <= T[-1] <= LAST_K[1])
        ]
        if isinstance(k, PressureTable) and len(k.p_Pa) > 1 and not AIR_PA[0] <= k.p_Pa[-1] <= AIR_PA[1]:
            text = (
                f"is over {k.p_Pa[0]:g} to {k.p_Pa[-1]:g} Pa, and air has 101325 Pa at sea level; check its pressures"
            )
            remarks.append((("conductivity_W_mK",), text))
        return remarks

    def _density_problems(self) -> list[tuple[Location, str]]:
        """A density that neither a solid nor, with the conductivity of this one, a light solid has."""
        if self.kind == "gas" or self.density_kg_m3 >= LIGHT_KG_M3:
            return []
        k = float(np.min(self.conductivity_grid()[2]))
        if self.density_kg_m3 >= LIGHTEST_KG_M3 and k <= LIGHT_CONDUCTIVITY_W_MK:
            return []
        question = QUANTITIES["density_kg_m3"].suggestion(self.density_kg_m3)
        rule = f"is no density of a solid that conducts {k:.3g} W/(m K) or more{question}"
        return [(("density_kg_m3",), f'{self.density_kg_m3:g} {rule}; a layer of gas declares kind = "gas"')]

    def _heat_problems(self) -> list[tuple[Location, str]]:
        """A specific heat that none has except near absolute zero."""
        heat_range = QUANTITIES["specific_heat_from_100_K"]
        return [
            (("specific_heat_J_kgK", i, 1), text)
            for i, (T_K, value) in enumerate(self.specific_heat_J_kgK)
            if T_K >= COLDEST_K and (text := heat_range.problem(value)) is not None
        ]

    def _conductivity_problems(self) -> list[tuple[Location, str]]:
        """A conductivity that no material of this density has."""
        _, T_K, k = self.conductivity_grid()
        rho = self.density_kg_m3
        text, highest = "", CONDUCTED_W_M2_KKG * max(rho, LIGHT_KG_M3)
        if self.kind == "solid" and rho >= DENSE_KG_M3 and np.any(bad := k[T_K >= COLDEST_K] < DENSE_CONDUCTS_W_MK):
            text = f"{k[T_K >= COLDEST_K][bad][0]:g} is no conductivity in W/(m K) of a solid"
        elif np.any(bad := k[T_K >= WARM_K] > highest):
            text = f"{k[T_K >= WARM_K][bad][0]:g} is no conductivity in W/(m K) of a material"
        hint = "correct one of them; milliwatts and kilowatts differ from W by a factor of 1000"
        return [(("conductivity_W_mK",), f"{text} of {rho:g} kg/m3; {hint}")] if text else []

    def conductivity_grid(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Conductivity on its grid of pressures and temperatures.

        returns : (p,) pressures [Pa], (T,) temperatures [K], (T, p) conductivity [W/(m K)]; where it does not depend on
                  pressure one column, at 1 Pa

        Interpolated as in docs/theory/equations_thermal_step.md, equation 10.
        """
        table = self.conductivity_W_mK
        if isinstance(table, PressureTable):
            return np.array(table.p_Pa), np.array(table.T_K), np.array(table.k)
        T_K, k = pairs(table)
        # Any pressure would do: a single column is constant in pressure.
        return np.array([1.0]), T_K, k[:, np.newaxis]


def nodes_that_stand_out(values: Sequence[float]) -> list[tuple[int, str]]:
    """The node of a table of a positive property that is most off its neighbours, with what is unusual about it.

    values : at increasing temperatures [K]
    returns : [] or one (index, text); an inner node is over or under both neighbours by STANDS_OUT, an end one by its
              square
    """
    logs = np.log(np.asarray(values, dtype=np.float64))
    if len(logs) < 2:
        return []
    steps = np.diff(logs)
    inner = np.where(steps[:-1] * steps[1:] < 0.0, np.minimum(np.abs(steps[:-1]), np.abs(steps[1:])), 0.0)
    off = np.concatenate(([0.5 * abs(steps[0])], inner, [0.5 * abs(steps[-1])]))
    worst = int(np.argmax(off))
    if off[worst] <= np.log(STANDS_OUT):
        return []
    neighbour = values[worst - 1 if worst else 1]
    return [(worst, f"{values[worst]:g} stands out beside {neighbour:g} of the node next to it")]


def pairs(table: Table) -> tuple[FloatArray, FloatArray]:
    """The two columns of [[x, value], ...] as contiguous float64 arrays, each in the unit of its table ([K], [J/(kg
    K)] ...)."""
    both = np.array(table, dtype=np.float64)
    return np.ascontiguousarray(both[:, 0]), np.ascontiguousarray(both[:, 1])


class Layer(Declared):
    """One layer of a stack: material, thickness [m], and contact resistance [m2 K/W] at its inner face (0: perfect).

    name : in `stack.NAME.conductivity_factor`; that of its material where absent
    thickness_sigma_m : standard deviation of the thickness from one part to another
    emissivity_outer, emissivity_inner : emittance of the two solid faces that a layer of gas lies between [-]; that of
        the neighbouring material where absent (docs/theory/equations_thermal_step.md, equation 11a)
    """

    quantities: ClassVar = {"emissivity_outer": "emissivity", "emissivity_inner": "emissivity"}

    material: str = Field(description="name of a material")
    name: str | None = Field(default=None, min_length=1, description="name in parameters, else its material")
    thickness_m: float = Field(gt=0.0, description="thickness in m, above 0; omit a layer that is absent")
    thickness_sigma_m: float | None = Field(default=None, gt=0.0, description="its standard deviation in m, above 0")
    contact_m2K_W: float = Field(default=0.0, ge=0.0, le=MOST, description="contact resistance in m2 K/W")
    emissivity_outer: float | None = Field(
        default=None, ge=LEAST, le=1.0, description="of the outer face of a gas layer, else that of its material"
    )
    emissivity_inner: float | None = Field(
        default=None, ge=LEAST, le=1.0, description="of the inner face of a gas layer, else that of its material"
    )

    @field_validator("thickness_m")
    @classmethod
    def _check_metres(cls, thickness_m: float) -> float:
        if thickness_m < LEAST:
            raise ValueError(f"{thickness_m:g} is thinner than an atom; give m, or omit a layer that is absent")
        if thickness_m > THICKEST_M:
            raise ValueError(f"{thickness_m:g} is thicker than {THICKEST_M:g} m and looks like millimetres; give m")
        return thickness_m


class BackFace(Declared):
    """A back face that convects and radiates to T_K: q = h (T - T_K) + emissivity sigma (T^4 - T_K^4) [W/m2].

    Natural convection adds natural_h_W_m2K |T - T_K|^natural_exponent (p / 101325 Pa)^(2 natural_exponent) to h.
    docs/theory/equations_thermal_step.md, equations 15 and 15a.
    """

    quantities: ClassVar = {"emissivity": "effective_emissivity", "T_K": "T_back_K"}

    h_W_m2K: float = Field(default=0.0, ge=0.0, le=MOST, description="film coefficient in W/(m2 K)")
    natural_h_W_m2K: float = Field(
        default=0.0, ge=0.0, le=100.0, description="film of natural convection at 1 K and sea level in W/(m2 K)"
    )
    natural_exponent: float = Field(default=1.0 / 3.0, ge=0.0, le=1.0, description="its exponent, 1/3 or 1/4")
    T_K: float = Field(ge=0.0, le=HOTTEST_K, description="temperature behind the wall in K")
    emissivity: float = Field(default=0.0, ge=0.0, le=1.0, description="0 to 1")


def _is_back(value: Any) -> str:
    return "cooled" if isinstance(value, (dict, BackFace)) else "adiabatic"


class Stack(Declared):
    """Layers from the outermost inward, with the initial temperature and the surroundings of the two faces.

    initial : "uniform" at `initial_K`, or "profile" as `initial_profile`
    """

    quantities: ClassVar = {"initial_profile": ("depth_m", "T_K")}

    nodes: int | None = Field(default=None, ge=3, le=10_000, description="a hint, 14 to 100 as a rule")
    surroundings_K: float = Field(default=0.0, ge=0.0, le=HOTTEST_K, description="temperature radiated to in K")
    venting_tau_s: float = Field(
        default=0.0, ge=0.0, description="time constant of the pressure in the insulation in s"
    )
    initial: Literal["uniform", "profile"] = "uniform"
    initial_K: float | None = Field(default=None, le=HOTTEST_K, description="temperature in K")
    initial_profile: Table | None = Field(default=None, description="[[x_m, T_K], ...]")
    back: Annotated[
        Annotated[Literal["adiabatic"], Tag("adiabatic")] | Annotated[BackFace, Tag("cooled")], Discriminator(_is_back)
    ] = Field(description='"adiabatic" or { h_W_m2K, T_K, emissivity }')
    layer: list[Layer] = Field(min_length=1, description="[[stack.layer]], outermost first")

    @field_validator("initial_K")
    @classmethod
    def _check_initial(cls, initial_K: float | None) -> float | None:
        if initial_K is not None and initial_K < COLDEST_K:
            raise ValueError(f"{initial_K:g} {celsius_rule()}")
        return initial_K

    @field_validator("initial_profile")
    @classmethod
    def _check_profile(cls, table: Table | None) -> Table | None:
        if table is not None:
            problems = _pair_problems(table, "x_m, T_K")
            if not problems:
                problems = [
                    ((i, 1), f"{T_K:g} {celsius_rule() if T_K < COLDEST_K else f'K is {TOO_HOT}'}")
                    for i, (_, T_K) in enumerate(table)
                    if not COLDEST_K <= T_K <= HOTTEST_K
                ]
            _raise_located(problems)
        return table

    @model_validator(mode="after")
    def _check(self) -> Stack:
        _raise_located([*self._initial_problems(), *self._profile_depth_problems(), *self._contact_problems()])
        return self

    def _initial_problems(self) -> list[tuple[Location, str]]:
        needed = "initial_K" if self.initial == "uniform" else "initial_profile"
        problems: list[tuple[Location, str]] = []
        if getattr(self, needed) is None:
            problems.append((("initial",), f'"{self.initial}" needs `{needed}`; add it'))
        if self.initial == "uniform" and self.initial_profile is not None:
            problems.append((("initial_profile",), 'is given with initial = "uniform"; set initial = "profile"'))
        return problems

    def _profile_depth_problems(self) -> list[tuple[Location, str]]:
        rows = self.initial_profile or []
        return [
            (("initial_profile", i, 0), f"{row[0]:g} m is outside the stack (0 to {self.thickness_m:g} m)")
            for i, row in enumerate(rows)
            if not self.holds(row[0])
        ]

    def _contact_problems(self) -> list[tuple[Location, str]]:
        if self.layer[-1].contact_m2K_W == 0.0:
            return []
        last = len(self.layer) - 1
        return [(("layer", last, "contact_m2K_W"), "the last layer touches no other at its inner face; remove it")]

    @property
    def layer_names(self) -> tuple[str, ...]:
        """Name of each layer, outermost first: its own, else that of its material."""
        return tuple(layer.name or layer.material for layer in self.layer)

    @property
    def thickness_m(self) -> float:
        """Thickness of the whole stack [m]; contacts have none."""
        return float(sum(layer.thickness_m for layer in self.layer))

    @property
    def interfaces_m(self) -> FloatArray:
        """(layer + 1,) depths of the faces of the layers from the outer surface [m], 0 and the thickness included."""
        return np.concatenate(([0.0], np.cumsum([layer.thickness_m for layer in self.layer])))

    @property
    def bondline_m(self) -> float:
        """Depth of the bondline [m]: the outer face of the last layer; 0 in a stack of one layer."""
        return float(self.interfaces_m[-2])

    def holds(self, depth_m: float) -> bool:
        """Whether a depth [m] lies in the stack, its faces included, to a billionth of the thickness."""
        # Thicknesses in a file sum up to a depth in the same file only to rounding.
        slack = 1e-9 * self.thickness_m
        return -slack <= depth_m <= self.thickness_m + slack


LEAST_DEPTH_M, LEAST_NOISE_K = 1e-6, 1e-5
"""Least depth of a sensor below a surface, and least noise of a thermocouple, above 0."""


class Sensor(Declared):
    """A thermocouple: its depth [m], and what its recorder does to the temperature (docs/theory/equations.md, 5).

    name : name of the sensor
    used : false: held back, never fitted, only reported
    """

    quantities: ClassVar = {"rate_hz": ("time_s", "rate_hz")}

    name: str = Field(min_length=1)
    column: str = Field(min_length=1, description="column of the measurements, ending in _K")
    depth_m: float = Field(ge=0.0, description="depth from the outer surface in m")
    noise_sigma_K: float | None = Field(default=None, ge=0.0, le=HOTTEST_K, description="random part in K")
    noise_correlation_s: float | None = Field(
        default=None, gt=0.0, description="time over which that part changes; white without"
    )
    noise_per_K: float = Field(
        default=0.0, ge=0.0, le=0.5, description="further white random part, over the indicated temperature in K"
    )
    bits: int | None = Field(default=None, ge=1, le=32, description="bits of the recorder word")
    range_K: list[float] | None = Field(default=None, description="[lowest, highest] in K")
    calibration: list[float] | None = Field(default=None, min_length=2, description="[c0, c1, ...], indicated K")
    calibration_sigma_K: float | None = Field(
        default=None, gt=0.0, le=500.0, description="error of that curve, or of the type's emf: sigma of the bias in K"
    )
    tau_s: float = Field(default=0.0, ge=0.0, description="time constant of a first-order lag in s")
    used: bool = True
    rate_hz: SampleRate | None = Field(default=None, description=RATE_TEXT)
    sample_offset_s: float = Field(default=0.0, description="time of the first sample in s")

    def implausible(self) -> list[tuple[Location, str]]:
        """A depth [m] or a noise [K] above 0 that is smaller than any sensor's, and a span of a recorder in another
        unit."""
        problems = super().implausible()
        if 0.0 < self.depth_m < LEAST_DEPTH_M:
            rule = f"is above 0 and less than {LEAST_DEPTH_M:g} m, thinner than any junction; give m, 0 at the surface"
            problems.append((("depth_m",), f"{self.depth_m:g} {rule}"))
        if 0.0 < (self.noise_sigma_K or 0.0) < LEAST_NOISE_K:
            rule = f"is above 0 and less than {LEAST_NOISE_K:g} K, as no thermocouple's; give K"
            problems.append((("noise_sigma_K",), f"{self.noise_sigma_K:g} {rule}"))
        if self.range_K is not None and self.range_K[1] < COLDEST_K:
            problems.append((("range_K", 1), f"{self.range_K[1]:g} {celsius_rule()}"))
        return problems

    @field_validator("range_K")
    @classmethod
    def _check_range(cls, range_K: list[float] | None) -> list[float] | None:
        if range_K is None:
            return None
        if len(range_K) != 2 or not range_K[0] < range_K[1]:
            raise ValueError(f"{range_K} is not [lowest, highest]; give two increasing temperatures in K")
        if range_K[1] > HOTTEST_K:
            raise LocatedError(((1,), f"{range_K[1]:g} K is {TOO_HOT}"))
        if range_K[0] < 0.0:
            raise LocatedError(((0,), f"{range_K[0]:g} K is below absolute zero; give K, not Celsius"))
        return range_K

    @field_validator("column")
    @classmethod
    def _check_column(cls, column: str) -> str:
        if column != column.strip() or column == "time_s":
            raise ValueError(f"`{column}` is not a sensor's column; name a column of the thermocouple file")
        if column.endswith(("_C", "_degC", "_F", "_degF")):
            raise ValueError(f"`{column}` ends in a unit that is not K; convert it and end its name in _K")
        return column

    @field_validator("calibration")
    @classmethod
    def _check_calibration(cls, calibration: list[float] | None) -> list[float] | None:
        if calibration is not None and not any(calibration[1:]):
            raise ValueError(f"{calibration} is constant; [0.0, 1.0] leaves the temperature as it is")
        return calibration

    @model_validator(mode="after")
    def _check(self) -> Sensor:
        require_span(self.bits, self.range_K, "range_K")
        if self.noise_per_K and self.noise_sigma_K is None:
            rule = "grows from `noise_sigma_K`, which is not declared; add it (0 where all of the noise grows)"
            raise LocatedError((("noise_per_K",), rule))
        return self

    @property
    def lsb_K(self) -> float:
        """Step of the recorder word [K], span / (2^bits - 1); 0 where nothing is quantised.

        Source: docs/theory/equations.md, section 5.
        """
        return word_step(self.bits, self.range_K)

    def growing_noise_K(self, indicated_K: FloatArray) -> FloatArray:
        """(sample,) standard deviation of the random part that grows with the indicated temperature [K].

        Independent of the part of `noise_sigma_K`: their variances add up. Source: docs/theory/equations.md, section 5.
        """
        return np.asarray(self.noise_per_K * np.abs(indicated_K))

    @property
    def bias_prior_K(self) -> tuple[float, float] | None:
        """Mean and standard deviation of what the thermocouple reads too much [K]; None where nothing states them.

        Source: docs/theory/equations.md, section 5.
        """
        return None if self.calibration_sigma_K is None else (0.0, self.calibration_sigma_K)

    def noise_floor_K(self, sigma_K: float) -> float:
        """Root mean square error of a reading [K] from random noise and the recorder word, sqrt(sigma^2 + LSB^2 / 12).

        sigma_K : standard deviation of the random noise [K]

        LSB^2 / 12 is the variance of a rounding error that is uniform over one step, as where the temperature or its
        noise moves over several steps. The word is that of docs/theory/equations.md, section 5.
        """
        return math.sqrt(sigma_K**2 + self.lsb_K**2 / 12.0)


class Construction(Declared):
    """A stack together with the materials of its layers: all the properties of a wall that conduction needs."""

    stack: Stack
    materials: dict[str, Material] = Field(description="[materials.NAME], one table a material")

    @model_validator(mode="after")
    def _check_materials(self) -> Construction:
        _raise_located(material_problems(self.stack, self.materials))
        return self

    def unusual(self) -> list[tuple[Location, str]]:
        """Layers of a thickness [m] that few of their material have, and a wall that few vehicles have."""
        remarks = super().unusual()
        for i, (layer, material) in enumerate(zip(self.stack.layer, self.layer_materials(), strict=True)):
            kind, low, high = _usual_thickness(material)
            if material.kind == "solid" and not low <= layer.thickness_m <= high:
                text = f"{layer.thickness_m:g} m is unusual for {kind} ({low:g} to {high:g}); check its unit"
                remarks.append((("stack", "layer", i, "thickness_m"), text))
        return remarks

    def layer_materials(self) -> list[Material]:
        """The material of each layer, outermost first."""
        return [self.materials[layer.material] for layer in self.stack.layer]

    @property
    def gas_layers(self) -> tuple[int, ...]:
        """Indices of the layers of gas."""
        return tuple(i for i, material in enumerate(self.layer_materials()) if material.kind == "gas")

    def faces_exchange(self, gas: int) -> float:
        """Exchange factor of the two faces of a gas layer [-], 1 / (1/eps_o + 1/eps_i - 1).

        gas : index of the layer

        Two grey, diffuse, parallel plates: Siegel and Howell, Thermal Radiation Heat Transfer, infinite parallel plates
        (docs/theory/equations_thermal_step.md, equation 11a).
        """
        outer, inner = (face_emittance(self.stack, self.materials, gas, face) for face in FACES)
        return 1.0 / (1.0 / (outer or 1.0) + 1.0 / (inner or 1.0) - 1.0)


def _usual_thickness(material: Material) -> tuple[str, float, float]:
    """What a material is by its density and conductivity, and the thickness [m] of layers of such materials."""
    k = float(np.max(material.conductivity_grid()[2]))
    if material.density_kg_m3 < DENSE_KG_M3:
        return "insulation", *LIGHT_LAYER_M
    return ("a metal or carbon", *METAL_LAYER_M) if k >= METAL_W_MK else ("a coating or an adhesive", *THIN_LAYER_M)


FACES = {"emissivity_outer": -1, "emissivity_inner": 1}
"""Keys of a gas layer, and the way to the neighbour whose face each is about."""


def face_emittance(stack: Stack, materials: Mapping[str, Material], gas: int, face: str) -> float | None:
    """Emittance [-] of a face of a gas layer: as the layer states it, else that of the neighbouring material.

    stack, materials : of a wall;  gas : index of the layer;  face : "emissivity_outer" or "emissivity_inner"
    returns          : None where neither states one, or that of the material changes with temperature

    What it is for: docs/theory/equations_thermal_step.md, equation 11a.
    """
    stated: float | None = getattr(stack.layer[gas], face)
    if stated is not None:
        return stated
    neighbour = materials.get(stack.layer[gas + FACES[face]].material)
    values = {value for _, value in neighbour.emissivity or []} if neighbour is not None else set()
    return values.pop() if len(values) == 1 else None


def _gas_problems(stack: Stack, materials: Mapping[str, Material]) -> list[tuple[Location, str]]:
    """Layers of gas without two solid faces of known emittance, and emittances of faces that no gas layer has."""
    kinds = [materials[layer.material].kind if layer.material in materials else "solid" for layer in stack.layer]
    problems: list[tuple[Location, str]] = []
    for i, layer in enumerate(stack.layer):
        where: Location = ("stack", "layer", i)
        if kinds[i] == "solid":
            stated = [face for face in FACES if getattr(layer, face) is not None]
            problems += [((*where, f), "is of a layer of gas, and this one is solid; remove it") for f in stated]
        elif kinds[max(i - 1, 0) : i] + kinds[i + 1 : i + 2] != ["solid", "solid"]:
            problems.append(((*where, "material"), "a layer of gas lies between two solid ones; add the one it lacks"))
        else:
            problems += [((*where, key), rule) for key, rule in _face_problems(stack, materials, i)]
    return problems


def _face_problems(stack: Stack, materials: Mapping[str, Material], gas: int) -> Iterator[tuple[str, str]]:
    """Key and rule of what is wrong at the two faces of a layer of gas."""
    if stack.layer[gas].contact_m2K_W > 0.0 or stack.layer[gas - 1].contact_m2K_W > 0.0:
        yield "contact_m2K_W", "a layer of gas has no contact resistance at its faces; remove it"
    for face, side in FACES.items():
        if face_emittance(stack, materials, gas, face) is None:
            material = stack.layer[gas + side].material
            why = "changes with temperature" if materials[material].emissivity else "is not stated"
            rule = f"is missing: the faces of a gas layer radiate, and the emittance of `{material}` {why}; add it"
            yield face, rule


def material_problems(stack: Stack, materials: Mapping[str, Material]) -> list[tuple[Location, str]]:
    """Layers whose material is not declared, an outermost layer and faces of a gas layer without emissivity.

    stack     : layers, outermost first
    materials : declared materials by name
    returns   : (location in the file, text) of each problem; the text names the nearest declared material
    """
    problems: list[tuple[Location, str]] = []
    for i, layer in enumerate(stack.layer):
        if layer.material not in materials:
            hint = files.suggestion(layer.material, materials, otherwise=f"; add [materials.{layer.material}]")
            problems.append((("stack", "layer", i, "material"), f"unknown material `{layer.material}`{hint}"))
    outer = materials.get(stack.layer[0].material)
    if outer is not None and outer.emissivity is None:
        rule = "the outermost layer radiates; add `emissivity` = [[T_K, value], ...]"
        problems.append((("materials", stack.layer[0].material), rule))
    # The faces of an unknown material are none to ask for.
    return problems or _gas_problems(stack, materials)


THIN_M, FACE = 1e-3, 0.1
"""Thickness [m] below which a layer holds no thermocouple between its faces, as a junction and its wires have 0.1 to
0.5 mm; and the part of the thickness that is still at a face."""


def sensor_remarks(stack: Stack, sensors: Sequence[Sensor]) -> list[tuple[Location, str]]:
    """Sensors between the faces of a layer that is too thin [m] for them.

    returns : ((index of the sensor, key), text) of each
    """
    remarks: list[tuple[Location, str]] = []
    for i, sensor in enumerate(sensors):
        for top, bottom in itertools.pairwise(stack.interfaces_m):
            slack = FACE * (bottom - top)
            if bottom - top < THIN_M and top + slack < sensor.depth_m < bottom - slack:
                text = f"{sensor.depth_m:g} m is unusual within a layer of {1e3 * (bottom - top):.3g} mm"
                remarks.append(((i, "depth_m"), f"{text} (its faces are at {top:g} and {bottom:g} m); check both"))
    return remarks


def sensor_problems(
    stack: Stack, sensors: Sequence[Sensor], materials: Mapping[str, Material]
) -> list[tuple[Location, str]]:
    """Sensors at depths [m] outside the stack or within a layer of gas, and names or columns used twice.

    materials : of the layers, as far as known
    returns : ((index of the sensor, key), text) of each problem
    """
    problems: list[tuple[Location, str]] = []
    for i, sensor in enumerate(sensors):
        if not stack.holds(sensor.depth_m):
            rule = f"{sensor.depth_m:g} m is outside the stack (0 to {stack.thickness_m:g} m)"
            problems.append(((i, "depth_m"), rule))
        for k, layer in enumerate(stack.layer):
            gas = layer.material in materials and materials[layer.material].kind == "gas"
            top, bottom = stack.interfaces_m[k : k + 2]
            slack = 1e-6 * stack.thickness_m
            if gas and top + slack < sensor.depth_m < bottom - slack:
                rule = f"{sensor.depth_m:g} m is within a layer of gas; give the depth of a face, {top:g} or {bottom:g}"
                problems.append(((i, "depth_m"), rule))
        for key in ("name", "column"):
            value = getattr(sensor, key)
            if value in [getattr(other, key) for other in sensors[:i]]:
                problems.append(((i, key), f"`{value}` is that of an earlier sensor; give each sensor its own"))
    return problems


def construct(stack: Stack, materials: Mapping[str, Material], where: str = "construction") -> Construction:
    """A construction of parts that come from different files; materials that no layer uses are omitted.

    where  : name for the messages
    raises : InputError as for a file named `where`, with all problems of the parts
    """
    used = {layer.material for layer in stack.layer}
    # all of them where one is unknown, which may be misspelt
    materials_used = {n: m for n, m in materials.items() if n in used} if used <= materials.keys() else materials
    parts = {"stack": stack.model_dump(), "materials": {name: m.model_dump() for name, m in materials_used.items()}}
    construction = files.check(parts, Construction, where, tells=False)  # the files of its parts have told of each
    tell(remarks_of(construction, parts, where, below=False))
    return construction
