"""Short segments in turn: a trend of the ratio is found within the bounds of its segments, lost samples or not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2, combine_pvalues

from benchmarks.segments import LENGTH_S, practice_flight, repeat
from sim_heating.base.conditions import RATIO_VARIABLES
from sim_heating.base.errors import InputError
from sim_heating.estimation.fit import estimate
from sim_heating.estimation.problem import FitProblem, joint_reference
from sim_heating.estimation.report.plots import ratio_limits
from sim_heating.estimation.trend import Trend, trend
from sim_heating.estimation.unknown_heating import after_unknown_heating, temperatures_at
from sim_heating.heating.ratio.lookup import table_ratios_at
from sim_heating.inputs.points import point_of_record
from sim_heating.inputs.record import Record
from sim_heating.inputs.sensor_model import measure
from sim_heating.march.ensemble import condition_history
from sim_heating.simulation.predict import predict
from tests.support.walls import practice_record

SLOPE = 0.004
"""Derivative of the ratio against log10 Re that is put in."""
FIT_S = (450.0, 950.0)


def remade(truth: dict[str, float], seed: int = 1, jets_gain: float = 0.0) -> Record:
    """A practice flight, segments from 450 to 950 s, with readings of the program's own, noise and words included.

    jets_gain : relative spike of the derived density, and so of h_ref, while jets fire; the wall feels none of it
    """
    record = practice_record("p06")[0]
    segments = record.declared.segments.model_copy(update={"fit": [list(FIT_S)], "holdout": []})
    record = replace(record, declared=record.declared.model_copy(update={"segments": segments}))
    model = replace(point_of_record(record, truth), reference=(40.0, 0.0, 6.3, 2.0, 7.0))
    flown = record.conditions
    if jets_gain > 0.0:  # pitch jets fire while the nose is pulled up
        flown = flown.with_columns(jets=1.0 * (flown["alpha_deg"] > 42.0))
        record = replace(record, conditions=flown)
    true_flight = flown.with_columns(h_ref_kg_m2_s=flown["h_ref_kg_m2_s"] / (1.0 + jets_gain * flown["jets"]))
    true = predict(replace(record, conditions=true_flight), model)
    rng = np.random.default_rng(seed)
    columns = {s.column: measure(s, T, rng) for s, T in zip(record.sensors, true.history.sensors_K, strict=True)}
    return replace(record, thermocouples={"time_s": record.time_s, **columns})


def chi_square(found: Trend) -> float:
    """Of the segments' ratios about the truth."""
    conditions = np.array([s.condition for s in found.segments])
    assert found.record.ratio_table is not None
    true = table_ratios_at(found.record.ratio_table, conditions) + SLOPE * (conditions[:, 2] - 6.3)
    return float(np.sum([((s.ratio - t) / s.sigma) ** 2 for s, t in zip(found.segments, true, strict=True)]))


@pytest.mark.sample(1)
@pytest.mark.parametrize("lost", [False, True], ids=["whole", "with-gaps"])
def test_trend_in_reynolds_number_is_recovered_within_its_bounds(lost):
    record = remade({"ratio.d_logre": SLOPE})
    if lost:
        t = record.time_s
        gone = ((t > 600.0) & (t < 640.0)) | (np.random.default_rng(2).random(len(t)) < 0.2)
        columns = {k: np.where(gone & (k != "time_s"), np.nan, v) for k, v in record.thermocouples.items()}
        record = replace(record, thermocouples=columns)
    found = trend(record, 20.0)
    n = len(found.segments)
    assert n + len(found.left_out) == 25
    assert n >= (23 if lost else 25)
    low, high = chi2.ppf([0.001, 0.999], n)
    assert low < chi_square(found) < high


@pytest.mark.thorough
def test_jet_spikes_mislead_unless_the_jets_are_a_regressor():
    record = remade({"ratio.d_alpha": 3e-4}, jets_gain=0.5)
    names, about = ["ratio.scale", "ratio.d_alpha"], {"alpha_deg": 40.0}
    plain = estimate([record], names, reference=about)
    with_jets = estimate([record], [*names, "effect.jet-interaction.jet_gain"], reference=about)
    error = [abs(f.fit.values[1] - 3e-4) for f in (plain, with_jets)]
    assert error[1] < 3.0 * with_jets.bounds.sigma[1]
    assert error[0] > 10.0 * with_jets.bounds.sigma[1]
    assert with_jets.fit.values[2] == pytest.approx(1.0 / 1.5 - 1.0, abs=3.0 * with_jets.bounds.sigma[2])


def test_segments_longer_than_their_data_or_of_no_length_are_refused():
    record = practice_record("p06")[0]
    lost = {k: v if k == "time_s" else np.where(v > 2000.0, v, np.nan) for k, v in record.thermocouples.items()}
    with pytest.raises(InputError, match="no segment of 20 s can be fitted"):
        trend(replace(record, thermocouples=lost), 20.0)


@pytest.mark.thorough
def test_uninformative_segment_does_not_flatten_the_others_on_the_page():
    """Where h_ref is near 0, at the end of an entry: 60 +- 250 beside ratios of 0.1."""
    found = trend(remade({}), 50.0)
    lost = replace(found.segments[-1], ratio=60.0, sigma=250.0)
    limits = ratio_limits(replace(found, segments=(*found.segments, lost)))
    assert limits == ratio_limits(found)
    assert limits is not None
    assert all(limits[0] < s.ratio < limits[1] for s in found.segments)
    assert ratio_limits(replace(found, segments=(lost,))) is None


@pytest.mark.thorough
def test_trend_on_a_coarse_mesh_is_corrected_from_segment_to_segment():
    """Ten nodes put the first segment off by 2.6 sigma where nothing is corrected."""
    record = remade({})

    def on(nodes: int) -> Trend:
        stack = record.declared.stack.model_copy(update={"nodes": nodes})
        return trend(replace(record, declared=record.declared.model_copy(update={"stack": stack})), 50.0)

    pairs = zip(on(10).segments, on(100).segments, strict=True)
    assert max(abs(coarse.ratio - fine.ratio) / fine.sigma for coarse, fine in pairs) < 1.0


@pytest.mark.thorough
@pytest.mark.parametrize("case", ["record begins late", "circuit start"])
def test_segment_bounds_hold_after_lost_readings_and_an_explicit_start(case):
    """A small count of `python -m benchmarks segments`, with seeds that it does not use."""
    found = repeat(case, [(1000, k) for k in range(6)])
    assert combine_pvalues(found.p_value).pvalue > 1e-3
    assert np.mean(np.abs(found.over_sigma) < 1.96) > 0.85  # of 60 correlated ones
    assert np.median(found.sigma) < 0.02


def test_unknown_heating_over_all_intervals_is_heating_unknown_throughout():
    """The intervals add up, and the surface forgets the earlier ones first."""
    record, end_s = practice_flight(), 450.0
    part = FitProblem([record], ["ratio.scale"], joint_reference([record])).record_fits[0]
    time = np.arange(0.0, end_s + 1.0)
    flown = part.conditions.at(time)
    T, directions = after_unknown_heating(part.model, part.mesh, part.conditions, time, None, end_s)
    changed = [
        condition_history(flown.with_columns(h_ref_kg_m2_s=flown["h_ref_kg_m2_s"] * f)) for f in (1.0, 1.05, 0.95)
    ]
    plain, more, less = temperatures_at(part.model, part.mesh, changed, time, None, end_s)
    np.testing.assert_allclose(T, plain)
    np.testing.assert_allclose(directions.sum(axis=1), (more - less) / 0.1, rtol=0.1, atol=1.0)
    surface, bondline = directions[0], directions[-1]
    assert np.argmax(surface) < np.argmax(bondline)


def test_ratio_with_a_fixed_derivative_is_that_of_the_flight():
    """The alpha derivative is known and fixed, as in the founding paper's figure 9: magnitudes follow the pushover."""
    record = remade({"ratio.d_alpha": 1e-3}).with_fit([[660.0, 760.0]])
    about = dict(zip(RATIO_VARIABLES, (40.0, 0.0, 6.3, 2.0, 7.0), strict=True))
    found = trend(record, LENGTH_S, fixed={"ratio.d_alpha": 1e-3}, reference=about)
    plain = trend(record, LENGTH_S, reference=about)

    assert max(abs(s.values[0]) / s.sigmas[0] for s in found.segments) < 3.5
    assert not found.warnings
    assert "noise does not explain the residuals" in plain.warnings[0]
    for s in found.segments:
        r = s.declared * (1.0 + s.values[0]) + 1e-3 * (s.condition[0] - 40.0)
        assert s.ratio == pytest.approx(r, rel=1e-6)
