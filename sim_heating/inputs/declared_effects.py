"""Declared transition and declared recombination of atoms, as keys of a record and of a vehicle, and as effects.

    [heating.transition]             of a record; [transition] of a vehicle or a control point
    log10_re_onset = 6.8             onset at alpha_0_deg, or
    re_theta_over_m_e = 300.0        onset in Re_theta / M_e of the laminar boundary layer
    log10_re_onset_sigma = 0.15      every number may have its sigma, under its own name with `_sigma`
    alpha_sens = 0.0                 fall of the onset with angle of attack [1/deg]
    alpha_0_deg = 40.0
    width = 0.03                     of the rise in log10
    hysteresis = 0.0                 by how much it turns laminar again below its onset, in log10
    ratio_table_turbulent = "ratio_table_turbulent.csv"    or factor = 4.2, turbulent over laminar

    [heating.catalysis]              of a record; [catalysis] of a control point, [catalysis.MATERIAL] of a vehicle
    wall = "finite-rate"             or "fully-catalytic" (the tables as they are), "noncatalytic"
    atoms = "edge-oxygen"            of equilibrium air at the point's edge, or "stagnation-oxygen" at the stagnation
                                     point; "edge", "stagnation": nitrogen as well
    gamma_O = { factor = 16.0, activation_K = 10271.0 }    gamma = factor exp(-activation_K / T_w)
    gamma_N = { factor = 0.0734, activation_K = 2219.0 }
    highest_K = 1650.0               above it gamma stays as it is there
    source = "..."

Equations: docs/reference/effects.md, equations 23 to 28.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import Any, ClassVar, Literal

from pydantic import Field, model_validator

from sim_heating.base.errors import InputError
from sim_heating.base.files import Declared, LocatedError, Location, raise_located, suggestion
from sim_heating.heating.edge_flow import Atoms
from sim_heating.heating.effects import EffectUse, use
from sim_heating.heating.effects.recombination import RECOMBINATION
from sim_heating.heating.effects.transition import TRANSITION
from sim_heating.heating.interface import Interface, InterfaceFlow
from sim_heating.heating.ratio.table import RatioTable
from sim_heating.heating.reference.recovery import RecoveryName
from sim_heating.thermal.stack import Stack

Wall = Literal["finite-rate", "fully-catalytic", "noncatalytic"]
SIGMA = "_sigma"
"""What the name of a number's standard deviation adds to its own."""


class InterfaceDeclaration(Declared):
    """Declared interface: a step of wall temperature upstream, at which the material of the wall changes."""

    upstream: str = Field(min_length=1, description="control point upstream of the step, or the name of `stack`")
    step_m: float = Field(ge=0.0, description="running length of the step from the leading edge in m")
    point_m: float = Field(gt=0.0, description="running length of the control point in m")
    footprint_m: float = Field(gt=0.0, description="length along the flow over which the heating is averaged in m")
    flow: InterfaceFlow = Field(description='"laminar", "turbulent" or "declared transition"')
    stack: Stack | None = Field(default=None, description="wall upstream that is no control point, heated alike")
    source: str = ""

    @model_validator(mode="after")
    def _check_lengths(self) -> InterfaceDeclaration:
        if not self.step_m < self.point_m:
            raise LocatedError((("point_m",), f"{self.point_m:g} is not behind step_m, {self.step_m:g}"))
        return self

    @property
    def interface(self) -> Interface:
        """The interface that it declares."""
        return Interface(self.step_m, self.point_m, self.footprint_m, self.flow)


class Transition(Declared):
    """Criterion of declared transition: an onset with its sigma, in one of two quantities."""

    quantities: ClassVar = {"width": "transition_width"}

    log10_re_onset: float | None = Field(default=None, description="log10 Re of half the rise at alpha_0_deg")
    log10_re_onset_sigma: float | None = Field(default=None, ge=0.0, description="its standard deviation")
    re_theta_over_m_e: float | None = Field(default=None, gt=0.0, description="Re_theta / M_e of half the rise")
    re_theta_over_m_e_sigma: float | None = Field(default=None, ge=0.0, description="its standard deviation")
    alpha_sens: float = Field(default=0.0, description="fall of the onset log10 with angle of attack in 1/deg")
    alpha_sens_sigma: float | None = Field(default=None, ge=0.0, description="its standard deviation in 1/deg")
    width: float = Field(default=0.03, gt=0.0, description="width of the rise in log10")
    width_sigma: float | None = Field(default=None, ge=0.0, description="its standard deviation")
    alpha_0_deg: float = Field(default=40.0, description="angle of attack of the onset in degrees")
    alpha_0_deg_sigma: float | None = Field(default=None, ge=0.0, description="its standard deviation in degrees")
    hysteresis: float = Field(default=0.0, ge=0.0, le=1.0, description="fall of log10 from its onset to laminar again")
    hysteresis_sigma: float | None = Field(default=None, ge=0.0, description="its standard deviation")
    spots: float = Field(default=0.0, ge=0.0, le=1.0, description="1 for the form of turbulent spots")
    source: str = ""
    confidence: str = ""
    note: str = ""

    @model_validator(mode="after")
    def _check_onset(self) -> Transition:
        onsets = [key for key in ("log10_re_onset", "re_theta_over_m_e") if getattr(self, key) is not None]
        if len(onsets) != 1:
            rule = "give one onset, `log10_re_onset` or `re_theta_over_m_e`"
            raise LocatedError(((onsets[1] if onsets else "log10_re_onset",), rule))
        problems: list[tuple[Location, str]] = [
            ((key,), f"{key.removesuffix(SIGMA)} is not given; remove its sigma, or give it")
            for key in ("log10_re_onset_sigma", "re_theta_over_m_e_sigma")
            if getattr(self, key) is not None and key.removesuffix(SIGMA) not in onsets
        ]
        raise_located(problems)
        return self

    @property
    def by_re_theta(self) -> bool:
        """Whether the onset is one of Re_theta / M_e."""
        return self.re_theta_over_m_e is not None

    def _values(self) -> tuple[dict[str, float], dict[str, float | None]]:
        """Values of the effect's parameters, and their sigma as far as declared."""
        values = {"alpha_sens": self.alpha_sens, "width": self.width, "alpha_0_deg": self.alpha_0_deg}
        sigma = {name: getattr(self, name + SIGMA) for name in values}
        # It is free in a search where its sigma is stated: no other declaration knows of it.
        sigma["hysteresis"] = self.hysteresis_sigma or 0.0
        values |= {"spots": self.spots, "hysteresis": self.hysteresis}
        if self.re_theta_over_m_e is None:
            values["log10_re_onset"] = self.log10_re_onset or 0.0
            return values, sigma | {"log10_re_onset": self.log10_re_onset_sigma}
        values |= {"log10_re_onset": math.log10(self.re_theta_over_m_e), "by_re_theta": 1.0}
        onset_sigma = self.re_theta_over_m_e_sigma
        return values, sigma | {
            "log10_re_onset": None if onset_sigma is None else onset_sigma / (self.re_theta_over_m_e * math.log(10.0))
        }

    def use(self, factor: float, by_table: bool, factor_sigma: float | None = None) -> EffectUse:
        """The effect of this criterion, with its own values and sigma as priors.

        factor, by_table : turbulent over laminar ratio, or factor on that of the tables
        factor_sigma     : standard deviation of the factor, None for that of the effect
        """
        values, sigma = self._values()
        used = use(TRANSITION, values | {"factor": factor, "by_table": float(by_table)})
        return declared_use(used, sigma | {"factor": factor_sigma})


class RecombinationLaw(Declared):
    """Recombination coefficient of one kind of atom, gamma = factor exp(-activation_K / T_w), at most 1."""

    factor: float = Field(ge=0.0, description="coefficient of an infinitely hot wall, 0 or above")
    activation_K: float = Field(default=0.0, ge=0.0, description="activation temperature in K, 0 or above")


class Catalysis(Declared):
    """Recombination of atoms at a wall: coefficients against its temperature, and the flow that the atoms are of."""

    wall: Wall = Field(default="finite-rate", description='"finite-rate", "fully-catalytic" or "noncatalytic"')
    atoms: Literal["edge", "stagnation", "edge-oxygen", "stagnation-oxygen"] = Field(
        default="edge-oxygen", description='"edge-oxygen", "edge", "stagnation-oxygen" or "stagnation"'
    )
    gamma_O: RecombinationLaw
    gamma_N: RecombinationLaw
    highest_K: float = Field(default=5000.0, ge=200.0, description="temperature above which gamma stays in K")
    source: str
    confidence: str = ""
    note: str = ""

    @model_validator(mode="after")
    def _check_effect(self) -> Catalysis:
        try:
            _ = self.effects
        except InputError as error:
            raise ValueError(str(error)) from None
        return self

    @property
    def effects(self) -> tuple[EffectUse, ...]:
        """The effect that it declares; none for a fully catalytic wall, which is that of the tables."""
        if self.wall == "fully-catalytic":
            return ()
        values = {
            "gamma_O_factor": self.gamma_O.factor,
            "gamma_O_activation_K": self.gamma_O.activation_K,
            "gamma_N_factor": self.gamma_N.factor,
            "gamma_N_activation_K": self.gamma_N.activation_K,
            "highest_K": self.highest_K,
            "efficiency": 0.0 if self.wall == "noncatalytic" else 1.0,
        }
        return (declared_use(use(RECOMBINATION, values), {}),)

    @property
    def atoms_of(self) -> Atoms:
        """Flow whose atoms reach the wall; `none` for a fully catalytic one."""
        return "none" if self.wall == "fully-catalytic" else self.atoms


KEYS = {"transition": TRANSITION, "catalysis": RECOMBINATION}
"""Key of a declaration -> name of the effect that it declares."""


def left_out(keys: Iterable[str]) -> frozenset[str]:
    """Names of the effects that declarations of these keys make, `transition` or `catalysis`.

    raises : InputError for another key
    """
    for key in keys:
        if key not in KEYS:
            raise InputError(f"`{key}` is not declared heating{suggestion(key, KEYS)}")
    return frozenset(KEYS[key] for key in keys)


def transition_keys(used: EffectUse, turbulent_file: str | None, declared: Transition | None) -> dict[str, Any]:
    """Keys of [heating.transition] of a record for a transition that is declared elsewhere.

    turbulent_file : file of the turbulent table, where the effect is by one
    declared       : with its source and confidence; None where it was not declared but added
    """
    pairs = zip(used.definitions, used.values, strict=True)
    number = {p.name: (_rounded(value), _rounded(p.sigma)) for p, value in pairs}
    onset, onset_sigma = number.pop("log10_re_onset")
    by_table, by_re_theta = number.pop("by_table")[0] > 0.0, number.pop("by_re_theta")[0] > 0.0
    key = "re_theta_over_m_e" if by_re_theta else "log10_re_onset"
    if by_re_theta:
        # Fewer digits than those of the logarithm, whose rounding would show.
        onset, onset_sigma = (float(f"{x:.7g}") for x in (10.0**onset, 10.0**onset * math.log(10.0) * onset_sigma))
    keys: dict[str, Any] = {key: onset, key + SIGMA: onset_sigma}
    spots, hysteresis = number.pop("spots")[0], number.pop("hysteresis")
    if by_table:
        keys["ratio_table_turbulent"] = turbulent_file
    for name, (value, sigma) in number.items():
        keys |= {name: value, name + SIGMA: sigma}
    if any(hysteresis):
        keys |= dict(zip(("hysteresis", "hysteresis" + SIGMA), hysteresis, strict=True))
    return keys | ({"spots": spots} if spots > 0.0 else {}) | _pedigree(declared)


def catalysis_keys(used: EffectUse, atoms: Atoms, declared: Catalysis | None) -> dict[str, Any]:
    """Keys of [heating.catalysis] of a record for recombination that is declared elsewhere.

    atoms    : flow whose atoms reach the wall
    declared : with its source and confidence; None where it was not declared but added
    """
    value = {p.name: v for p, v in zip(used.effect.parameters, used.values, strict=True)}
    laws = {
        f"gamma_{atom}": {
            "factor": _rounded(value["efficiency"] * value[f"gamma_{atom}_factor"]),
            "activation_K": value[f"gamma_{atom}_activation_K"],
        }
        for atom in "ON"
    }
    return {"atoms": atoms, **laws, "highest_K": value["highest_K"], "source": "", **_pedigree(declared)}


def _pedigree(declared: Transition | Catalysis | None) -> dict[str, str]:
    """Source and confidence of a declaration, those that it states."""
    stated = {} if declared is None else {"source": declared.source, "confidence": declared.confidence}
    return {key: text for key, text in stated.items() if text}


def _rounded(value: float) -> float:
    """A number without the rounding errors of its conversion."""
    return float(f"{value:.10g}")


def turbulent_problems(table: RatioTable, laminar: RecoveryName, reference: str) -> list[str]:
    """Problem of a turbulent table whose recovery enthalpy is not that of the laminar edge turned turbulent.

    laminar   : recovery enthalpy of the laminar table
    reference : name of the reference heating, for a table that states no recovery enthalpy
    """
    problem = table.recovery_problem(turbulent_recovery(laminar), reference)
    return [] if problem is None else [problem]


def turbulent_recovery(laminar: RecoveryName) -> RecoveryName:
    """Recovery enthalpy of the turbulent table of a point, from that of its laminar one: of the same edge."""
    return "edge-turbulent" if laminar == "edge-laminar" else laminar


def declared_use(used: EffectUse, sigma: dict[str, float | None]) -> EffectUse:
    """An effect whose values are the prior means of its parameters.

    sigma : standard deviation by parameter, None or absent for that of the effect, each in the parameter's unit
    """
    definitions = tuple(
        replace(p, value=value, sigma=p.sigma if (declared_sigma := sigma.get(p.name)) is None else declared_sigma)
        for p, value in zip(used.effect.parameters, used.values, strict=True)
    )
    return replace(used, declared=definitions)
