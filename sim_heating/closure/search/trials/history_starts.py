"""Starts of candidates from the heating history that the readings ask for.

What a candidate gains is predicted at starts where it has no effect yet, by its sensitivities there. Where what is
missing multiplies the heating, that prediction knows little of where an onset lies and how steep it is. The heating
history that explains the readings (residual_heating.py) knows: its ratio y(t) is compared with

    r(t) = r_table(t) (1 + s) + sum_i d_i (x_i(t) - x_i0),    y(t) = r(t) m(t)    or    y(t) = r(t) + a(t),

m or a being the effect with all its parameters, s and d_i the magnitude and derivatives of the model with the priors of
its table. This is a least-squares problem without a march, some hundred knots long, which is solved from many starts.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.optimize import least_squares

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import RATIO_VARIABLES
from sim_heating.base.errors import InputError, RunError
from sim_heating.base.parallel.processes import in_processes
from sim_heating.base.parallel.threads import one_thread
from sim_heating.base.parameters import CLOCK_SKEW, EFFECT_PREFIX, Parameter
from sim_heating.closure.clues.residual_heating import residual_heating
from sim_heating.closure.search.trials.candidates import Candidate, Form
from sim_heating.closure.search.trials.trial_fit import TrialFit, fitted_values, problem_with, start_values
from sim_heating.closure.verdict.policy import EFFORT
from sim_heating.heating.effects import EffectUse
from sim_heating.heating.effects.compiled import EffectAlong
from sim_heating.heating.ratio.uncertainty import basis, declared_ratio
from sim_heating.march.ensemble import condition_history

FITTED = ("ratio.scale", *(f"ratio.d_{name}" for name in ("alpha", "beta", "logre", "elevon", "bodyflap")))
"""Magnitude and first derivatives, which are adjusted to the history."""


@dataclass(frozen=True, eq=False)
class HeatingHistory:
    """The heating ratio that explains the readings, and what a model of it needs.

    y, sigma   : (knot,) ratio before effects that multiply it, and its standard deviation [-]
    tabulated  : (knot,) ratio of the declared table [-]
    columns    : (knot, parameter) derivative of the ratio by each parameter, in the unit of the ratio over its own
    rows       : (knot, condition) flight conditions as kernels read them;  wall_K : (knot,) wall temperature [K]
    parameters : of the base's magnitude and derivatives, with their priors
    """

    y: FloatArray
    sigma: FloatArray
    tabulated: FloatArray
    columns: FloatArray
    rows: FloatArray
    wall_K: FloatArray
    parameters: tuple[Parameter, ...]

    def along(self, used: EffectUse) -> EffectAlong:
        """An effect along the history."""
        return EffectAlong(used, self.rows, self.wall_K)


def heating_history(base: TrialFit, neutral: Candidate) -> HeatingHistory | None:
    """The heating history of a record, as a model with one effect at its neutral values sees it.

    base    : the declared model;  neutral : a candidate that has no effect at its start
    returns : None where the model cannot be marched, has no tabulated heating, or none that is fitted
    """
    smoothing_error = 0.03  # error of a smoothed history where heating jumps, over the heating itself [-]
    parameters = tuple(p for p in base.problem.parameters if p.name in FITTED)
    if not parameters:
        return None
    problem = problem_with(base, neutral)
    record_fit = problem.record_fits[0]
    tabulated_alone = dict.fromkeys([*(p.name for p in parameters), CLOCK_SKEW.name], 0.0)
    at = start_values(problem, {**fitted_values(base), **tabulated_alone, **neutral.start})
    try:
        missing = residual_heating(problem, at)
    except (InputError, RunError):
        return None
    inside = missing.fitted
    t = missing.time_s[inside]
    flown = record_fit.conditions.at(t)
    x = np.column_stack([flown[name] for name in RATIO_VARIABLES])
    tabulated = declared_ratio(record_fit.model.ratio, x)
    y = tabulated + missing.delta_ratio[inside]
    if len(t) == 0 or not np.all(np.isfinite(y)):
        return None
    sigma = np.hypot(missing.sigma[inside], smoothing_error * np.abs(y))
    wall = np.interp(t, missing.march_s, missing.input.temperature_K[:, 0])
    columns = basis([p.name for p in parameters], x, np.array(base.problem.reference), tabulated)
    return HeatingHistory(y, sigma, tabulated, columns, condition_history(flown), wall, parameters)


def history_starts(base: TrialFit, tried: Sequence[Candidate]) -> list[Candidate]:
    """Candidates with the starts that fit the heating history best, some for each form of an effect on the heating.

    base  : the declared model, without any effect but the declared ones;  tried : all candidates
    """
    declared = {used.effect.name for used in base.record_fit.record.declared.heating.effects}
    histories: dict[str, HeatingHistory | None] = {}
    forms: dict[tuple[str, Form], list[Candidate]] = {}
    for c in filter(_is_suitable, tried):
        forms.setdefault((c.name, c.form), []).append(c)
    suitable: list[tuple[HeatingHistory, list[Candidate]]] = []
    with one_thread():
        for (name, _), of_form in forms.items():
            key = name if name in declared else ""
            if key not in histories:
                histories[key] = heating_history(base, of_form[0])
            history = histories[key]
            if history is not None:
                suitable.append((history, of_form))
        starts_by_form = in_processes([partial(_best_starts, *s) for s in suitable])
    return [replace(of_form[k], start=start, active=of_form[k].names)
            for (_, of_form), starts in zip(suitable, starts_by_form, strict=True) for k, start in starts]  # fmt: skip


def _is_suitable(c: Candidate) -> bool:
    """Whether a candidate is one effect on the heating without memory, neutral at its start, with a place to find."""
    if len(c.uses) != 1 or c.uses[0].effect.mode not in ("multiply", "add") or c.uses[0].effect.lags:
        return False
    used = c.uses[0]
    values = used.by_name
    magnitudes = {n.rpartition(".")[2] for n in c.active}
    return (
        0 < len(magnitudes) < len(c.names)
        and magnitudes <= set(used.effect.neutral)
        and not used.effect.reads_ratio
        and not values.get("hysteresis", 0.0)
    )


def _best_starts(history: HeatingHistory, of_form: Sequence[Candidate]) -> list[tuple[int, dict[str, float]]]:
    """Indices of the candidates of one form that fit the history best, with the starts that do."""
    most_solved = 4  # starts of a form from which the least-squares problem is solved
    misfits = [_linear_misfit(history, c) for c in of_form]
    linear = sorted(range(len(of_form)), key=lambda k: misfits[k])[:most_solved]
    solved = sorted(((*_solved(history, of_form[k]), k) for k in linear), key=lambda s: s[0])
    kept: list[tuple[int, dict[str, float]]] = []
    for _, start, k in solved:
        if all(_apart(of_form[k], start, other) for _, other in kept):
            kept.append((k, start))
    return kept[: EFFORT.starts]


def _linear_misfit(history: HeatingHistory, c: Candidate) -> float:
    """Weighted sum of squares that the effect leaves at its start, with its magnitudes and the base's parameters free;
    where magnitudes and derivatives multiply each other, to first order."""
    used, values = c.uses[0], np.array(c.uses[0].values)
    effect = used.effect
    names = [p.name for p in effect.parameters]
    moved = np.tile(values, (1 + len(c.active), 1))
    for row, name in enumerate(c.active, start=1):
        k = names.index(name.rpartition(".")[2])
        moved[row, k] += effect.parameters[k].sigma or 1.0
    acting = history.along(used).at(moved)
    changes = (acting[1:] - acting[0]) * (history.tabulated if effect.mode == "multiply" else 1.0)
    J = np.column_stack([history.columns, changes.T]) / history.sigma[:, np.newaxis]
    residual = (history.y - history.tabulated) / history.sigma
    prior = np.zeros((len(history.parameters), J.shape[1]))
    prior[:, : len(history.parameters)] = np.diag([1.0 / p.sigma for p in history.parameters])
    system, right = np.vstack([J, prior]), np.append(residual, np.zeros(len(prior)))
    step = np.linalg.lstsq(system, right, rcond=None)[0]
    return float(np.sum((right - system @ step) ** 2))


def _solved(history: HeatingHistory, c: Candidate) -> tuple[float, dict[str, float]]:
    """Misfit and values of the parameters at the solution of the least-squares problem from a candidate's start."""
    evaluations = 60
    # step of a difference against a parameter of an effect, over its sigma or its value [-]: root of the rounding
    step = 2.0**-26
    used = c.uses[0]
    definitions = {f"{EFFECT_PREFIX}{used.effect.name}.{p.name}": p for p in used.definitions}
    free = [definitions[n] for n in c.names]
    columns = [[p.name for p in used.effect.parameters].index(p.name) for p in free]
    unit = np.array([*(p.sigma if np.isfinite(p.sigma) else 1.0 for p in history.parameters),
                     *(p.sigma or 1.0 for p in free)])  # fmt: skip
    count, base_columns = len(history.parameters), history.columns
    has_prior = np.array([float(np.isfinite(p.sigma)) for p in history.parameters])

    effect_along, multiplies = history.along(used), used.effect.mode == "multiply"

    def residuals(moved: FloatArray) -> FloatArray:
        """(set, residual) of sets of parameters; an effect is evaluated once for sets that differ in the base alone."""
        values = np.tile(np.array(used.values), (len(moved), 1))
        values[:, columns] = (moved * unit)[:, count:]
        differs = np.any(moved[:, count:] != moved[0, count:], axis=1)
        differs[0] = True
        acting = effect_along.at(values[differs])[np.cumsum(differs) * differs - differs]
        r = history.tabulated + np.array([base_columns @ (z * unit)[:count] for z in moved])
        modelled = r * acting if multiplies else r + acting
        return np.hstack([(modelled - history.y) / history.sigma, has_prior * moved[:, :count]])

    def jacobian(z: FloatArray) -> FloatArray:
        """Forward differences, to the other side at a bound, all in one call of the compiled effect."""
        h = np.where(z >= 0.0, step, -step) * np.maximum(np.abs(z), 1.0)
        h = np.where((z + h < lower) | (z + h > upper), -h, h)
        moved = np.vstack([z, z + np.diag(h)])
        at_moved = residuals(moved)
        return ((at_moved[1:] - at_moved[0]) / (np.diag(moved[1:]) - z)[:, np.newaxis]).T

    lower = np.append(np.full(count, -np.inf), [p.lower for p in free]) / unit
    upper = np.append(np.full(count, np.inf), [p.upper for p in free]) / unit
    first = np.append(np.zeros(count), [c.start[n] for n in c.names]) / unit
    # away from neutral, where places have no influence yet
    for k, name in enumerate(c.names, start=count):
        if name in c.active:
            first[k] += 1.0
    inside = np.clip(first, lower + 1e-6, upper - 1e-6)
    done = least_squares(
        lambda z: residuals(z[np.newaxis])[0],
        inside,
        jacobian,
        bounds=(lower, upper),
        x_scale=1.0,
        max_nfev=evaluations,
    )
    at = dict(zip([*(p.name for p in history.parameters), *c.names], map(float, done.x * unit), strict=True))
    return float(2.0 * done.cost), at


def _apart(c: Candidate, start: Mapping[str, float], other: Mapping[str, float]) -> bool:
    """Whether two starts of a candidate's form differ by more than a tenth of a parameter's sigma."""
    used = c.uses[0]
    unit = {f"{EFFECT_PREFIX}{used.effect.name}.{p.name}": p.sigma or 1.0 for p in used.definitions}
    return any(abs(start[n] - other[n]) > 0.1 * unit[n] for n in c.names)
