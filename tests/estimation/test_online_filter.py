"""The filter taken on step by step: the batch filter's bits, and with its parameters the Kalman filter of both."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sim_heating.base.errors import InputError
from sim_heating.base.kernels.block import CONDITION_COLUMNS, LOG10_RE
from sim_heating.estimation.filter.march import Disturbance, Filtered, FilterMarch, FilterTrack, Samples
from sim_heating.estimation.filter.online import OnlineFilter, PointReadings, Prior
from sim_heating.heating.effects import use
from sim_heating.heating.ratio.lookup import table_ratios_at
from sim_heating.inputs.points import conditions_of_record, point_of_record
from sim_heating.inputs.record import load_record
from sim_heating.march.ensemble import condition_history
from sim_heating.thermal.mesh import build_mesh
from tests.support.paths import PRACTICE

FloatArray = np.ndarray
NAMES = ("ratio.scale", "ratio.d_alpha", "stack.rsi.conductivity_factor", "stack.emissivity_factor")
PRIORS = {
    name: Prior(mean, sigma)
    for name, mean, sigma in zip(NAMES, (0.05, 0.0, 1.0, 1.0), (0.2, 0.002, 0.18, 0.035), strict=True)
}
BEGIN_S, END_S = 900.0, 960.0
WANDERING = Disturbance.gauss_markov(0.01, 30.0)


def points() -> tuple[list[FilterTrack], FloatArray, FloatArray]:
    """Two points of unequal walls in a manoeuvre, their readings at fractions of the steps; steps and conditions."""
    time_s = np.arange(BEGIN_S, END_S + 0.5)
    tracks, histories = [], []
    for i, (name, nodes) in enumerate((("p09", 16), ("p08", 14))):
        record = load_record(PRACTICE / name)
        model = point_of_record(record, {"ratio.scale": 0.05})
        mesh = build_mesh(model.construction, np.array(model.depths_m), nodes)
        histories.append(condition_history(conditions_of_record(record).at(time_s)))
        T_0 = np.linspace(900.0, 450.0, mesh.nodes)
        apart = np.subtract.outer(mesh.depth_m, mesh.depth_m)
        track = FilterTrack(
            model, mesh, readings_of(i, mesh.sensors, time_s, len(NAMES)), NAMES, T_0,
            covariance_K2=100.0 * np.exp(-np.abs(apart) / 0.005), noise_K2_s=1e-3, disturbance=WANDERING, flight=i,
        )  # fmt: skip
        tracks.append(track)
    return tracks, time_s, np.stack(histories)


def readings_of(i: int, nodes: tuple[int, ...], time_s: FloatArray, m: int) -> Samples:
    rng = np.random.default_rng(i)
    t = np.repeat(np.arange(BEGIN_S + 0.3, END_S, 0.7 + 0.2 * i), len(nodes))
    node = np.tile(nodes, len(t) // len(nodes))
    read = 870.0 - 30.0 * node + rng.normal(0.0, 2.0, len(t))
    read[rng.random(len(t)) < 0.05] = np.nan
    lower, upper = (read, read) if i == 0 else (read - 1.0, read + 1.0)
    flat = np.zeros(len(t))
    return Samples(t, node, lower, upper, flat + 4.0, flat + 1.0, flat, np.zeros((len(t), m, 3)))


def together(tracks: list[FilterTrack], begin_s: float, end_s: float) -> PointReadings:
    """Readings of all points after a time and up to another, in order of time."""
    chosen = [(p.samples.time_s > begin_s) & (p.samples.time_s <= end_s) for p in tracks]
    point = np.concatenate([np.full(np.count_nonzero(c), i) for i, c in enumerate(chosen)])
    columns = [
        np.concatenate([getattr(p.samples, name)[c] for p, c in zip(tracks, chosen, strict=True)])
        for name in ("time_s", "node", "lower_K", "upper_K", "variance_K2", "gain", "bias_K", "direct")
    ]
    order = np.argsort(columns[0], kind="stable")
    return PointReadings(point[order], *(c[order] for c in columns))


def online(tracks: list[FilterTrack], histories: FloatArray, priors: dict[str, Prior] = PRIORS) -> OnlineFilter:
    found = OnlineFilter(tracks, [priors] * len(tracks))
    found.begin(BEGIN_S, histories[:, 0])
    return found


def run(o: OnlineFilter, tracks, time_s: FloatArray, histories: FloatArray, stride: int, begin: int = 1, end: int = 0):
    """March in calls of `stride` steps; innovations of all calls, one after the other."""
    found = []
    for k in range(begin, end or len(time_s), stride):
        steps = slice(k, min(k + stride, end or len(time_s)))
        given = together(tracks, time_s[k - 1], time_s[steps][-1])
        found.append(o.step(time_s[steps], histories[:, steps], given))
    return found


@pytest.fixture(scope="module")
def flown():
    return points()


@pytest.fixture(scope="module")
def batch(flown) -> list[Filtered]:
    """The batch filter over all, every node read without effect at the end so that its sensitivities are known."""
    tracks, time_s, histories = flown
    ended = [replace(p, samples=with_nodes_at_the_end(p)) for p in tracks]
    return FilterMarch(ended, time_s, histories).filter()


def with_nodes_at_the_end(p: FilterTrack) -> Samples:
    s, n = p.samples, p.mesh.nodes
    nothing, flat = np.full(n, np.nan), np.zeros(n)
    columns = (flat + END_S, np.arange(n), nothing, nothing, flat + 1.0, flat + 1.0, flat)
    own = (s.time_s, s.node, s.lower_K, s.upper_K, s.variance_K2, s.gain, s.bias_K)
    assert s.direct is not None
    return Samples(
        *(np.concatenate(pair) for pair in zip(own, columns, strict=True)),
        np.concatenate([s.direct, np.zeros((n, *s.direct.shape[1:]))]),
    )


@pytest.mark.parametrize("stride", [1, 7, 60])
def test_steps_one_by_one_or_many_at_once_are_the_batch_filter(flown, batch, stride):
    tracks, time_s, histories = flown
    o = online(tracks, histories)
    run(o, tracks, time_s, histories, stride)
    for i, (estimate, filtered) in enumerate(zip(o.estimates(), batch, strict=True)):
        np.testing.assert_array_equal(o.nominal.node_temperatures(i), filtered.temperature_K)
        np.testing.assert_array_equal(estimate.state_covariance, filtered.covariance)


def test_final_estimate_is_that_of_the_batch_filter_with_the_prior(flown, batch):
    tracks, time_s, histories = flown
    o = online(tracks, histories)
    run(o, tracks, time_s, histories, 5)
    prior = np.diag([PRIORS[name].sigma ** -2.0 for name in NAMES])
    for estimate, filtered, track in zip(o.estimates(), batch, tracks, strict=True):
        covariance = np.linalg.inv(prior + filtered.information())
        change = covariance @ filtered.score()
        mean = [PRIORS[name].mean for name in NAMES]
        sigma = np.sqrt(np.diag(covariance))
        assert np.max(np.abs(estimate.values - mean - change) / sigma) < 1e-9
        assert np.max(np.abs(estimate.covariance - covariance) / np.outer(sigma, sigma)) < 1e-9
        n = track.mesh.nodes
        S = filtered.sensitivity[-n:]
        whole = filtered.covariance[:n, :n] + S @ covariance @ S.T
        np.testing.assert_allclose(estimate.temperature_K, filtered.temperature_K + S @ change, rtol=1e-9)
        np.testing.assert_allclose(estimate.sigma_K**2, np.diag(whole), rtol=1e-9)


@pytest.mark.parametrize("remembers", [False, True], ids=["plain heating", "lag and hysteresis"])
def test_a_filter_that_went_back_goes_on_with_the_same_bits(flown, remembers):
    tracks, time_s, histories = flown
    if remembers:
        # Reynolds number rises for half a minute and falls again, past the onset and within its hysteresis
        histories = histories.copy()
        histories[:, 31:, LOG10_RE] = histories[:, 29::-1, LOG10_RE]
        uses = [
            use("transition", {"log10_re_onset": 6.42, "width": 0.02, "factor": 1.5, "hysteresis": 0.05}),
            use("nonisothermal-wall", {"lag_s": 5.0, "lag_fraction": 0.3}),
        ]
        tracks = [replace(p, model=replace(p.model, effects=(*p.model.effects, *uses))) for p in tracks]
    o, straight = online(tracks, histories), online(tracks, histories)
    run(straight, tracks, time_s, histories, 1)
    run(o, tracks, time_s, histories, 1, end=20)
    kept = o.snapshot()
    run(o, tracks, time_s, histories, 3, begin=20, end=50)
    o.linearise_again(0)
    o.restore(kept)
    run(o, tracks, time_s, histories, 1, begin=20)
    for a, b in zip(o.estimates(), straight.estimates(), strict=True):
        np.testing.assert_array_equal(a.temperature_K, b.temperature_K)
        np.testing.assert_array_equal(a.values, b.values)
        np.testing.assert_array_equal(a.covariance, b.covariance)


def test_innovations_with_running_parameters_have_their_stated_variance():
    # readings that the model itself gives, at parameters drawn from the prior
    tracks, time_s, histories = points()
    rng, chi2, count = np.random.default_rng(3), 0.0, 0
    for _ in range(6):
        drawn = [{name: rng.normal(p.mean, p.sigma) for name, p in SMALL.items()} for _ in tracks]
        told = [
            replace(p, model=p.model.with_parameters(v), covariance_K2=None, noise_K2_s=0.0, disturbance=Disturbance())
            for p, v in zip(tracks, drawn, strict=True)
        ]
        blind = [replace(p, samples=replace(p.samples, lower_K=p.samples.lower_K * np.nan)) for p in told]
        truth = FilterMarch(blind, time_s, histories).filter()
        seen = []
        for p, t in zip(told, truth, strict=True):
            read = t.predicted_K + rng.normal(0.0, 2.0, len(t.predicted_K))
            seen.append(replace(p, samples=replace(p.samples, lower_K=read, upper_K=read)))
        o = online(seen, histories, SMALL)
        for found in run(o, seen, time_s, histories, 10):
            chi2 += float(np.sum(found.innovation_K**2 / found.innovation_variance_K2))
            count += len(found.innovation_K)
    assert chi2 / count == pytest.approx(1.0, abs=4.0 * np.sqrt(2.0 / count))


SMALL = {name: Prior(p.mean, 0.1 * p.sigma) for name, p in PRIORS.items()}


def test_linearised_again_the_estimate_is_the_same_and_the_march_is_at_it(flown):
    tracks, time_s, histories = flown
    o = online(tracks, histories, SMALL)
    run(o, tracks, time_s, histories, 10)
    before = o.estimates()[0]
    assert o.linearise_again(0, moved=0.0)
    after = o.estimates()[0]
    sigma = np.sqrt(np.diag(before.covariance))
    assert np.max(np.abs(after.values - before.values) / sigma) < 1e-9
    np.testing.assert_allclose(after.temperature_K, before.temperature_K, rtol=1e-12)
    np.testing.assert_allclose(list(o.parameters(0).values()), before.values, rtol=1e-9)
    assert not o.linearise_again(0)


def test_linearised_where_it_is_the_march_goes_on_as_if_begun_there(flown):
    # no readings: the state moves with the parameters along its sensitivities, to second order
    tracks, time_s, histories = flown
    quiet = [replace(p, samples=replace(p.samples, lower_K=p.samples.lower_K * np.nan)) for p in tracks]
    small = {name: Prior(p.mean + 1e-3 * p.sigma, p.sigma) for name, p in PRIORS.items()}
    moved, straight = online(quiet, histories), online(quiet, histories, small)
    moved._information.pull[...] = 0.0
    run(moved, quiet, time_s, histories, 1, end=30)
    run(straight, quiet, time_s, histories, 1)
    for i in range(2):
        lane = moved._lane_of[i]
        moved._information.b[lane] = moved._information.prior[lane] @ [1e-3 * p.sigma for p in PRIORS.values()]
        assert moved.linearise_again(i, moved=0.0)
        moved._information.b[lane] = 0.0
    run(moved, quiet, time_s, histories, 1, begin=30)
    for i in range(2):
        apart = moved.nominal.node_temperatures(i) - straight.nominal.node_temperatures(i)
        assert np.max(np.abs(apart)) < 1e-3


def test_the_ratio_is_the_linear_one_of_the_table(flown):
    tracks, time_s, histories = flown
    o = online(tracks, histories)
    run(o, tracks, time_s, histories, 60)
    for i, linearised in ((0, False), (1, False), (0, True), (1, True)):
        if linearised:
            o.linearise_again(i, moved=0.0)
        estimate, alpha = o.estimates()[i], histories[i, -1, CONDITION_COLUMNS.index("alpha_deg")]
        scale, d_alpha = estimate.values[:2]
        model = tracks[i].model
        (table,), away = table_ratios_at(model.ratio, histories[i, -1:, :5]), alpha - model.reference[0]
        expected = table * (1.0 + scale) + d_alpha * away
        assert estimate.ratio == pytest.approx(expected + estimate.disturbance, rel=1e-9)
        declared = table * (1.0 + model.value("ratio.scale")) + model.value("ratio.d_alpha") * away
        assert estimate.ratio_declared == pytest.approx(declared, rel=1e-9)
        assert 0.0 < estimate.ratio_sigma < estimate.ratio


def test_a_prior_that_is_flat_is_refused_with_what_to_give(flown):
    tracks, _, _ = flown
    with pytest.raises(InputError, match=r"prior of `ratio.scale`.*sigma above 0 and finite"):
        OnlineFilter(tracks, [PRIORS | {"ratio.scale": Prior(0.0, np.inf)}] * 2)
