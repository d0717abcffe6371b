"""What the uncertainty of a predicted temperature comes from: each declared standard deviation, marched once.

The point is marched again with every uncertain parameter one standard deviation from its value, all in one ensemble on
the mesh of the prediction; the change of the highest surface temperature is the contribution of the parameter.
Contributions count as independent, and as linear. Uncertain are

    the heating ratio      its declared sigma at the hottest time, as a factor on the table
    the wall               emittance, and conductivity, heat capacity and thickness of coating and insulation
    declared effects       the parameters that have a sigma, such as the onset of a transition

The standard deviations of the wall are those of `sim_heating.base.parameters`, the same that an estimate takes as
priors.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import RATIO_VARIABLES, Conditions
from sim_heating.base.errors import InputError, RunError
from sim_heating.base.parameters import EFFECT_PREFIX, MODEL
from sim_heating.heating.ratio.uncertainty import declared_ratio, declared_sigma
from sim_heating.march.ensemble import Ensemble, histories
from sim_heating.march.history import PointHistory
from sim_heating.march.mesh_choice import meshes_on_flights
from sim_heating.march.point import PointModel

WALL = (
    "stack.emissivity_factor",
    "stack.coating.thickness_factor",
    "stack.coating.conductivity_factor",
    "stack.coating.heat_capacity_factor",
    "stack.rsi.conductivity_factor",
    "stack.rsi.heat_capacity_factor",
)
"""Parameters of every wall that have a standard deviation."""
SCALE = "ratio.scale"
FEW_K = 1e-3
"""A smaller change of the temperature [K] is none."""


@dataclass(frozen=True)
class Uncertainty:
    """Standard deviation of the main quantity of a result, and what it comes from.

    quantity      : what it is of, in words;  unit : of value and sigma
    value, sigma  : of the quantity; value None where only its uncertainty is known
    contributions : input -> standard deviation that comes from it, in the unit; the largest first
    method        : how they were found, in words
    """

    quantity: str
    unit: str
    value: float | None
    sigma: float
    contributions: Mapping[str, float]
    method: str

    @property
    def dominant(self) -> str:
        """The input with the largest contribution; empty where there is none."""
        return next(iter(self.contributions), "")

    def share(self, name: str) -> float:
        """Part of the variance that comes from an input [-]."""
        total = sum(c**2 for c in self.contributions.values())
        return self.contributions[name] ** 2 / total if total > 0.0 else 0.0


def combined(
    quantity: str, unit: str, value: float | None, contributions: Mapping[str, float], method: str
) -> Uncertainty:
    """Uncertainty by independent contributions, the largest first."""
    ordered = dict(sorted(((n, abs(c)) for n, c in contributions.items()), key=lambda item: -item[1]))
    return Uncertainty(quantity, unit, value, math.sqrt(sum(c**2 for c in ordered.values())), ordered, method)


def declares_sigma(model: PointModel, flown: Conditions) -> bool:
    """Whether the heating of a point has a declared standard deviation: that of its ratio table."""
    return declared_sigma(model.ratio, _variables(flown)[:1]) is not None


def peak_uncertainty(
    model: PointModel, flown: Conditions, hottest_s: float, longest_step_s: float = 1.0
) -> Uncertainty | None:
    """Uncertainty of the highest surface temperature of a point [K]; None where nothing has a standard deviation.

    flown     : conditions with the reference heating of the point
    hottest_s : time of the highest surface temperature [s]; the sigma of the ratio table is that of its conditions
    """
    varied = dict(varied_models(model, flown, int(np.argmin(np.abs(flown.time_s - hottest_s)))))
    try:
        marched = dispersed_temperatures(model, flown, [(m, flown) for m in varied.values()], longest_step_s)
    except RunError:  # with a perturbed parameter a step did not converge
        return None
    peaks = np.max(marched[:, 0], axis=1)
    changes = {name: float(peaks[i] - peaks[0]) for i, name in enumerate(varied, start=1)}
    kept = {name: change for name, change in changes.items() if abs(change) > FEW_K}
    if not kept:
        return None
    method = "each declared standard deviation marched once; independent and linear"
    return combined(f"highest surface temperature of {model.name}", "K", float(peaks[0]), kept, method)


def band_uncertainty(history: PointHistory) -> Uncertainty | None:
    """Uncertainty of the highest surface temperature of a point [K] by the sources of its band; None without a band."""
    if history.band is None:
        return None
    quantity = f"highest surface temperature of {history.name}"
    highest_K = float(np.nanmax(history.surface_K))
    return combined(quantity, "K", highest_K, history.band.sources, "the 95 % band; independent and linear")


def dispersed_temperatures(
    model: PointModel,
    flown: Conditions,
    variants: Sequence[tuple[PointModel, Conditions]],
    longest_step_s: float = 1.0,
) -> FloatArray:
    """Temperatures of a point and of its variants, side by side on the mesh of the point.

    flown    : conditions of the point;  variants : models and conditions on the same times
    returns  : (1 + variant, channel, time) of the surface, the bondline and the sensors' places [K]
    raises   : RunError where a step did not converge
    """
    models, flights = zip((model, flown), *variants, strict=True)
    mesh = meshes_on_flights([model], [flown], longest_step_s)[0][0]
    ensemble = Ensemble(models, [mesh] * len(models), longest_step_s)
    out = ensemble.march(flown.time_s, histories(flights), keep=ensemble.outputs())
    return np.ascontiguousarray(out.T).reshape(len(models), -1, len(flown.time_s))


def _variables(flown: Conditions) -> FloatArray:
    if not all(name in flown for name in RATIO_VARIABLES):
        return np.zeros((len(flown), len(RATIO_VARIABLES)))
    return np.stack([flown[name] for name in RATIO_VARIABLES], axis=1)


def varied_models(
    model: PointModel, flown: Conditions, hottest: int, effect_step: float = 1.0
) -> Iterator[tuple[str, PointModel]]:
    """Models with one parameter a standard deviation from its value, by the name of the parameter.

    hottest     : sample of the flight for which the sigma of the ratio table is taken
    effect_step : standard deviations by which a parameter of an effect is off [-]
    """
    at = _variables(flown)[hottest : hottest + 1]
    sigma = declared_sigma(model.ratio, at)
    ratio = declared_ratio(model.ratio, at)
    if sigma is not None and ratio[0] > 0.0:
        yield SCALE, _changed(model, SCALE, float(sigma[0] / ratio[0]))
    for name in WALL:
        yield name, _changed(model, name, MODEL[name].sigma)
    for i, used in enumerate(model.effects):
        for k, p in enumerate(used.definitions):
            if not 0.0 < p.sigma < math.inf:
                continue
            value = used.values[k] + effect_step * p.sigma
            value = value if value <= p.upper else used.values[k] - effect_step * p.sigma
            values = (*used.values[:k], max(value, p.lower), *used.values[k + 1 :])
            effects = (*model.effects[:i], replace(used, values=values), *model.effects[i + 1 :])
            try:
                yield f"{EFFECT_PREFIX}{used.effect.name}.{p.name}", replace(model, effects=effects)
            except InputError:  # a value that the model cannot have
                continue


def _changed(model: PointModel, name: str, sigma: float) -> PointModel:
    p, index = MODEL[name], model.places[name]
    now = float(model.values[index])
    aliases = {n for n in model.parameters if model.places[n] == index}
    others = {n: v for n, v in model.parameters.items() if n not in aliases}
    value = now + sigma if now + sigma <= p.upper else now - sigma
    return replace(model, parameters={**others, name: max(value, p.lower)})
