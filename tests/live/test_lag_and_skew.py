"""Thermocouples that lag, and a recorder's clock that is off, in a running estimate as in a batch fit."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from sim_heating.base.kernels.lag import lag_columns
from sim_heating.estimation.filter.march import FilterMarch, FilterTrack
from sim_heating.estimation.filter.online import Prior
from sim_heating.estimation.fit import estimate
from sim_heating.inputs.points import conditions_of_record, point_of_record
from sim_heating.inputs.record import Record, load_record, make_record
from sim_heating.live.filtering.estimates import LiveOptions
from sim_heating.live.filtering.estimator import LiveEstimator
from sim_heating.live.filtering.points import RecordPoints
from sim_heating.live.types import Frame, Reading, Sample
from sim_heating.march.ensemble import condition_history
from tests.support.filter_samples import samples_on_grid
from tests.support.paths import PRACTICE

TAU_S, SCALE, SKEW_S = 2.5, 0.05, 0.4
FINE = 120
"""Nodes of the wall that is flown."""
NAMES = ("ratio.scale",)
PRIORS = {"ratio.scale": Prior(0.0, 0.2), "clock.skew": Prior(0.0, 0.5)}
END_S = 330.0
SIGMA_K = 1.0


@cache
def record(tau_s: float = TAU_S) -> Record:
    """The first minutes of a practice record without an effect, whose surface thermocouple lags."""
    whole = load_record(PRACTICE / "p07")
    first, *rest = whole.sensors
    exact = {"bits": None, "range_K": None, "noise_sigma_K": SIGMA_K}
    own = [first.model_copy(update={**exact, "tau_s": tau_s}), *(s.model_copy(update=exact) for s in rest)]
    return whole.with_sensors(own)


@cache
def samples(tau_s: float = TAU_S, skew_s: float = 0.0, noise_K: float = SIGMA_K) -> tuple[Sample, ...]:
    """Frames and readings of the declared model with more heating, from its declared start on, as they come."""
    r = record(tau_s)
    t = np.arange(0.0, END_S + 0.01)
    flown = r.conditions.at(t)
    names = [n for n in flown.names if n != "time_s"]
    point = RecordPoints([r], FINE).points[0]
    nodes = point.mesh.sensors
    nothing = np.full((len(nodes), len(t) - 1), np.nan)
    model = point_of_record(r, {"ratio.scale": SCALE})
    track = FilterTrack(model, point.mesh, samples_on_grid(t[1:], nodes, nothing, 1.0), ())
    history = condition_history(conditions_of_record(r).at(t))[np.newaxis]
    T = FilterMarch([track], t, history).filter()[0].predicted_K.reshape(len(t) - 1, -1)
    for k, sensor in enumerate(point.sensors):
        T[:, k : k + 1] = lag_columns(t[1:], T[:, k : k + 1].copy(), sensor.tau_s, True)
    T = T + np.random.default_rng(0).normal(0.0, noise_K, T.shape)
    frames = [Frame(float(s), {n: float(flown[n][k]) for n in names}) for k, s in enumerate(t)]
    words = [
        Reading(float(s) + skew_s, point.name, sensor.name, float(T[k, i]))
        for k, s in enumerate(t[1:])
        for i, sensor in enumerate(point.sensors)
    ]
    return tuple(sorted((*frames, *words), key=lambda s: (s.time_s, isinstance(s, Frame))))


def follow(r: Record, given, names=NAMES) -> LiveEstimator:
    options = LiveOptions(start="declared")
    e = LiveEstimator(RecordPoints([r]), names, {n: PRIORS[n] for n in names}, options)
    for sample in given:
        e.add(sample)
        e.advance()
    return e


def found(e: LiveEstimator):
    return e.estimates()[e.names[0]]


@pytest.fixture(scope="module")
def lagging() -> LiveEstimator:
    return follow(record(), samples())


@pytest.mark.thorough
def test_a_thermocouple_that_lags_is_followed_as_it_is_declared(lagging):
    """Without its lag the ratio would be off: in a wall that heats up it takes degrees away."""
    value, sigma = found(lagging).parameters["ratio.scale"]
    assert abs(value - SCALE) < 3.0 * sigma
    ignored, sigma = found(follow(record(0.0), samples())).parameters["ratio.scale"]
    assert abs(ignored - SCALE) > 5.0 * sigma


@pytest.mark.thorough
def test_what_a_thermocouple_that_lags_shows_is_predicted(lagging):
    away = []
    e = follow(record(), [s for s in samples() if s.time_s < 200.0])
    for sample in (s for s in samples() if s.time_s >= 200.0):
        e.add(sample)
        e.advance()
        away += [(i.innovation_K / np.sqrt(i.variance_K2)) for i in e.innovations() if i.time_s > 200.0]
    assert abs(np.mean(away)) < 4.0 / np.sqrt(len(away))
    assert np.std(away) == pytest.approx(1.0, abs=0.15)
    told = found(lagging).sensors
    for word in [s for s in samples() if isinstance(s, Reading)][-2:]:
        assert abs(word.value_K - told[word.sensor].predicted_K) < 4.0 * told[word.sensor].sigma_K


@pytest.mark.thorough
@pytest.mark.parametrize("seed", range(2))
def test_with_a_lag_the_estimate_has_the_same_bits_in_any_order(lagging, seed):
    rng = np.random.default_rng(seed)
    arrive = [s.time_s + (rng.uniform(0.0, 1.9) if s.time_s > 0.0 else 0.0) for s in samples()]
    late = follow(record(), [samples()[k] for k in np.argsort(arrive, kind="stable")])
    for a, b in zip(found(late).parameters.values(), found(lagging).parameters.values(), strict=True):
        assert a == b


def flown_record(r: Record, given) -> Record:
    """The samples as a record."""
    frames, words = ([s for s in given if isinstance(s, kind)] for kind in (Frame, Reading))
    t = sorted({w.time_s for w in words if w.time_s <= END_S})
    value = {(w.time_s, w.sensor): w.value_K for w in words}
    measured = {s.column: np.array([value[x, s.name] for x in t]) for s in r.sensors}
    columns = {n: np.array([f.values[n] for f in frames]) for n in frames[0].values}
    conditions = type(r.conditions)({"time_s": np.array([f.time_s for f in frames]), **columns})
    declared = r.declared.model_copy(update={"segments": type(r.declared.segments)()})
    return make_record(
        declared, conditions, {"time_s": np.array(t), **measured}, r.ratio_table, r.declared.control_point
    )


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("tau_s", "skew_s", "names"), [(TAU_S, 0.0, NAMES), (0.0, SKEW_S, (*NAMES, "clock.skew"))], ids=["lag", "skew"]
)
def test_lag_and_skew_are_those_of_a_fit_of_the_record(tau_s, skew_s, names):
    given = samples(tau_s, skew_s)
    e = follow(record(tau_s), given, names)
    e.filter_again()
    running = found(e).parameters
    if skew_s:
        assert abs(running["clock.skew"][0] - skew_s) < 3.0 * running["clock.skew"][1]
    fit = estimate([flown_record(record(tau_s), given)], list(names)).parameters
    for name in names:
        value, sigma = running[name]
        assert abs(value - fit[name][0]) < 0.3 * fit[name][1], name
        assert sigma == pytest.approx(fit[name][1], rel=0.15), name
