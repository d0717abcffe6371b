"""Thermocouples that are other than declared: swapped, in another unit, stuck, clipped, drifting, misplaced, broken."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.challenge.record import make_and_write
from sim_heating.base.errors import RunError
from sim_heating.base.parameters import Parameter
from sim_heating.closure.search.changes.record_change import fit_changes
from sim_heating.closure.search.changes.sensor_changes import sensor_changes
from sim_heating.closure.search.search import search_effects
from sim_heating.closure.search.trials.change import RecordChange
from sim_heating.closure.search.trials.trial_fit import TrialFit, base_trial
from sim_heating.estimation.fit import estimate
from sim_heating.estimation.inference.likelihood import scores
from sim_heating.inputs.record import Record, load_record
from sim_heating.inputs.sensor_model import SensorErrors
from sim_heating.simulation.predict import predict
from tests.support.paths import PRACTICE
from tests.support.walls import practice_record


def shortened(record: Record) -> Record:
    """The record up to 900 s, the last 150 s of which are held out."""
    segments = record.declared.segments.model_copy(update={"fit": [[200.0, 750.0]], "holdout": [[750.5, 900.0]]})
    return replace(record, declared=record.declared.model_copy(update={"segments": segments}))


TILE = shortened(practice_record("p06")[0])
"""Flown without an effect; thermocouples under the coating and on the skin."""
SURFACE, BOND = TILE.sensors
READ = {s.name: TILE.thermocouples[s.column] for s in TILE.sensors}
TIME_S = TILE.time_s
DRIFT_K_S = 5e-3


def with_readings(words: bool = False, **read: np.ndarray) -> Record:
    """The record with other readings of some sensors; without recorder words, whose spans need not hold them."""
    columns = {s.column: read[s.name] for s in TILE.sensors if s.name in read}
    record = replace(TILE, thermocouples={**TILE.thermocouples, **columns})
    return record if words else with_sensors(record, {s.name: {"bits": None, "range_K": None} for s in TILE.sensors})


def with_sensors(record: Record, changed: dict[str, dict[str, object]]) -> Record:
    sensors = [s.model_copy(update=changed.get(s.name, {})) for s in record.sensors]
    thermocouples = record.declared.thermocouples.model_copy(update={"sensor": sensors})
    return replace(record, declared=record.declared.model_copy(update={"thermocouples": thermocouples}))


def found_in(record: Record) -> list[TrialFit]:
    base = base_trial(estimate([record]))
    return fit_changes(base, sensor_changes(base))


def stuck() -> np.ndarray:
    at = int(np.searchsorted(TIME_S, 230.0))
    return np.where(TIME_S < 230.0, READ["LS_surface"], READ["LS_surface"][at])


@pytest.mark.sample(1)
@pytest.mark.parametrize(
    ("record", "what"),
    [
        (with_readings(LS_surface=READ["LS_bond"], LS_bond=READ["LS_surface"]), "LS_surface and LS_bond swapped"),
        (with_readings(LS_surface=READ["LS_surface"] - 273.15), "LS_surface in degC, read as K"),
        (
            with_readings(LS_surface=READ["LS_surface"] + 273.15, LS_bond=READ["LS_bond"] + 273.15),
            "all thermocouples in K, read as degC",
        ),
        (with_readings(words=True, LS_surface=stuck()), "LS_surface stuck at"),
        (
            with_readings(words=True, LS_surface=np.minimum(READ["LS_surface"], 1092.0)),
            "LS_surface clipped at 1092 K, which is no declared end of its range",
        ),
        (with_readings(words=True, LS_bond=READ["LS_bond"] + 15.0 * np.sin(TIME_S / 97.0)), "LS_bond broken"),
    ],
    ids=lambda x: x if isinstance(x, str) else "",
)
def test_a_wrong_thermocouple_is_recognised(record, what):
    found = found_in(record)
    assert what in found[0].change.describe(found[0].value)
    assert found[0].delta_bic < found[1].delta_bic - 100.0 if len(found) > 1 else found[0].delta_bic < -100.0


@pytest.mark.thorough
def test_a_drift_is_recognised_with_its_rate():
    best = found_in(with_readings(words=True, LS_bond=READ["LS_bond"] + DRIFT_K_S * (TIME_S - TIME_S[0])))[0]
    assert best.change.what == "drift of LS_bond"
    assert best.value == pytest.approx(DRIFT_K_S, abs=4.0 * best.sigma)


@pytest.mark.thorough
@pytest.mark.parametrize("sensor", [SURFACE, BOND], ids=lambda s: s.name)
def test_a_depth_that_is_declared_wrong_by_two_millimetres_is_recognised(sensor):
    wrong_m = 2e-3 if sensor is SURFACE else -2e-3
    best = found_in(with_sensors(TILE, {sensor.name: {"depth_m": sensor.depth_m + wrong_m}}))[0]
    assert best.change.what == f"depth of {sensor.name}"
    assert best.value == pytest.approx(-wrong_m, abs=3e-4)  # through a layer of adhesive, nearly isothermal


@pytest.mark.sample(1)
@pytest.mark.parametrize("name", ["p06", "p08"])
def test_a_record_with_sound_thermocouples_has_no_other_ones(name):
    record = load_record(PRACTICE / name)
    assert all(f.delta_bic > -5.0 for f in found_in(record))


@pytest.mark.thorough
def test_an_unknown_effect_is_no_broken_thermocouple():
    unknown = load_record(PRACTICE / "p02")  # a sine of the heating ratio: 90 times the noise
    base = base_trial(estimate([unknown]))
    assert not [c.what for c in sensor_changes(base) if "broken" in c.what or "swapped" in c.what]


@pytest.mark.thorough
def test_a_ripple_faster_than_a_heating_can_be_resolved_breaks_no_thermocouple():
    ripple = 12.0 * np.sin(2.0 * np.pi * TIME_S / 11.0)
    base = base_trial(estimate([with_readings(words=True, LS_surface=READ["LS_surface"] + ripple)]))
    assert base.excess_chi2 > 10.0
    assert not [c.what for c in sensor_changes(base) if "broken" in c.what]


@pytest.mark.thorough
def test_a_wall_that_is_other_than_declared_breaks_no_thermocouple():
    apart = (TIME_S - TIME_S[0]) * (TIME_S[-1] - TIME_S) / np.ptp(TIME_S) ** 2  # as a heat capacity of the skin
    base = base_trial(estimate([with_readings(words=True, LS_bond=READ["LS_bond"] + 100.0 * apart)]))
    assert base.excess_chi2 > 5.0
    assert not [c.what for c in sensor_changes(base) if "broken" in c.what]


def plug(broken: Mapping[str, np.ndarray]) -> Record:
    """The tile with four thermocouples, one above the other, whose readings have errors in K."""
    depths_m, rng = (3.8e-4, 8e-3, 16e-3, BOND.depth_m), np.random.default_rng(4)
    sensors = [
        SURFACE.model_copy(
            update={"name": f"T{i}", "column": f"T{i}_K", "depth_m": depth_m, "bits": None, "range_K": None}
        )
        for i, depth_m in enumerate(depths_m, 1)
    ]
    thermocouples = TILE.declared.thermocouples.model_copy(update={"sensor": sensors})
    blank = {"time_s": TIME_S, **{s.column: np.full(len(TIME_S), 300.0) for s in sensors}}
    declared = TILE.declared.model_copy(update={"thermocouples": thermocouples})
    record = replace(TILE, declared=declared, thermocouples=blank)
    read = {
        s.column: T_K + rng.normal(0.0, s.noise_sigma_K, len(T_K)) + broken.get(s.name, 0.0)
        for s, T_K in zip(sensors, predict(record).indicated_K, strict=True)
    }
    return replace(record, thermocouples={"time_s": TIME_S, **read})


@pytest.mark.thorough
def test_a_jump_faster_than_heat_reaches_the_depth_is_told():
    jumping = with_readings(words=True, LS_bond=READ["LS_bond"] + 40.0 * (TIME_S > 600.0))
    described = [f.change.describe(f.value) for f in found_in(jumping) if f.change.what == "LS_bond broken"]
    assert described
    assert described[0].startswith("LS_bond broken: LS_bond jumps by +")


@pytest.mark.thorough
def test_a_gap_of_the_telemetry_and_a_declared_end_of_the_range_are_no_faults_of_a_thermocouple():
    lost = (TIME_S > 500.0) & (TIME_S < 650.0)
    gap = with_readings(words=True, LS_bond=np.where(lost, np.nan, READ["LS_bond"]))
    ends = with_sensors(
        with_readings(words=True, LS_surface=np.minimum(READ["LS_surface"], 900.0)),
        {"LS_surface": {"range_K": [255.0, 900.0]}},
    )
    for record in (gap, ends):
        found = [c.what for c in sensor_changes(base_trial(estimate([record])))]
        assert not [what for what in found if any(word in what for word in ("broken", "stuck", "clipped"))]


@pytest.mark.thorough
def test_one_broken_thermocouple_of_four_is_found_where_the_others_show_the_heating():
    best = found_in(plug({"T2": 20.0 * np.sin(TIME_S / 60.0)}))[0]
    assert best.change.what == "T2 broken"
    assert best.change.describe(best.value).startswith("T2 broken: T2 wanders by 1")


@pytest.mark.thorough
def test_two_broken_thermocouples_of_four_are_found_together():
    wandering = {"T2": 25.0 * np.sin(TIME_S / 60.0), "T3": 25.0 * np.sin(TIME_S / 37.0)}
    best = found_in(plug(wandering))[0]
    assert best.change.what in ("T2 and T3 broken", "T3 and T2 broken")
    assert best.excess_chi2 < 0.3


@pytest.mark.thorough
def test_no_cause_is_stated_beside_two_broken_thermocouples(tmp_path: Path):
    plug_with_moisture_that_migrates = (775, 35, "one", tmp_path, False)
    name, _, _ = make_and_write(plug_with_moisture_that_migrates)
    search = search_effects(load_record(tmp_path / name))
    two_broken = [h for h in search.hypotheses if h.change is not None and " and " in h.change.what]
    assert two_broken
    assert not [h.names for h in two_broken if h.added]
    assert search.conclusion.finding == "partly"


@pytest.mark.thorough
def test_readings_that_keep_still_while_no_other_sensor_moves_are_not_stuck():
    at = int(np.searchsorted(TIME_S, 300.0))
    still = {name: np.where(TIME_S < 300.0, read, read[at]) for name, read in READ.items()}
    both = with_readings(words=True, **still)
    assert not [c.what for c in sensor_changes(base_trial(estimate([both]))) if "stuck" in c.what]


@pytest.mark.thorough
def test_a_thermocouple_that_is_clipped_before_its_noise_is_recognised():
    limit_K, noise = 1040.0, np.random.default_rng(2).normal(0.0, 1.0, len(TIME_S))
    clipped = np.where(READ["LS_surface"] > limit_K, limit_K + noise, READ["LS_surface"])
    best = found_in(with_readings(LS_surface=clipped))[0]
    assert best.change.describe(best.value).startswith("LS_surface clipped at 1040 K")


@pytest.mark.thorough
def test_a_change_that_cannot_be_marched_or_compared_is_left_out_and_ends_no_search():
    def impossible(record: Record, value: float) -> Record:
        raise RunError("no such wall")

    def unread_where_held_out(record: Record, value: float) -> Record:
        lost = record.holdout_mask()
        read = {n: np.where(lost, np.nan, T) for n, T in record.thermocouples.items() if n != "time_s"}
        return replace(record, thermocouples={"time_s": record.thermocouples["time_s"], **read})

    base = base_trial(estimate([with_readings(words=True, LS_bond=READ["LS_bond"] + 10.0)]))
    own = Parameter("x", "1", 0.0, 1.0)
    tried = [
        RecordChange("wall", "impossible wall", own, impossible, str, starts=(1.0,)),
        RecordChange("wall", "another impossible wall", None, impossible, str),
        RecordChange("sensor", "unread", None, unread_where_held_out, str, known_log_likelihood=(1e3, 0.0)),
    ]
    assert fit_changes(base, tried) == []


def test_a_drift_can_be_estimated_by_its_name_and_predicted():
    drifting = with_readings(words=True, LS_bond=READ["LS_bond"] + DRIFT_K_S * (TIME_S - TIME_S[0]))
    found = estimate([drifting], ["ratio.scale", "sensor.LS_bond.drift"])
    drift, sigma = found.fit.values[1], found.bounds.sigma[1]
    sound = estimate([TILE], ["ratio.scale", "sensor.LS_bond.drift"]).fit.values[1]
    assert drift - sound == pytest.approx(DRIFT_K_S, abs=3.0 * sigma)
    plain, wrong = predict(TILE), predict(TILE, errors={"LS_bond": SensorErrors(drift_K_s=DRIFT_K_S)})
    np.testing.assert_allclose(wrong.indicated_K[1] - plain.indicated_K[1], DRIFT_K_S * TIME_S, atol=1e-9)


def clipped_at(name: str, limit_K: float, begin_s: float = 0.0, noise_K: float = 0.8) -> Record:
    """A thermocouple that is clipped before its noise and its word, whose readings begin at some time."""
    sensor = next(s for s in TILE.sensors if s.name == name)
    read = np.where(READ[name] > limit_K, limit_K, READ[name])
    read = read + np.where(read == limit_K, np.random.default_rng(4).normal(0.0, noise_K, len(read)), 0.0)
    words = sensor.range_K[0] + np.rint((read - sensor.range_K[0]) / sensor.lsb_K) * sensor.lsb_K
    return with_readings(words=True, **{name: np.where(begin_s > TIME_S, np.nan, words)})


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("name", "limit_K", "begin_s", "end_s"),
    [("LS_surface", 1040.0, 450.0, 900.0), ("LS_bond", 316.0, 200.0, 1452.0)],
    ids=["from the first reading on", "slowly, up to the last one"],
)
def test_a_thermocouple_is_recognised_as_clipped_where_its_readings_begin_or_end_so(
    name: str, limit_K: float, begin_s: float, end_s: float
) -> None:
    record = clipped_at(name, limit_K, begin_s)
    segments = record.declared.segments.model_copy(update={"fit": [[begin_s, end_s]], "holdout": [[700.0, 750.0]]})
    best = found_in(replace(record, declared=record.declared.model_copy(update={"segments": segments})))[0]
    said, _, level_K, *_ = best.change.describe(best.value).removeprefix(f"{name} ").split()
    assert said == "clipped"
    assert float(level_K) == pytest.approx(limit_K, abs=2.0)
    assert best.excess_chi2 < 0.2


@pytest.mark.thorough
def test_a_model_that_is_short_of_the_level_contradicts_a_clipped_thermocouple():
    base = base_trial(estimate([clipped_at("LS_surface", 1040.0)]))
    (change,) = [c for c in sensor_changes(base) if "clipped" in c.what]
    readings = fit_changes(base, [change])[0].problem.samples(base.fit.values)[0].channel.intervals
    clipped = readings.select(np.isinf(readings.upper_K))
    beyond, short = (np.full(len(clipped.lower_K), 1040.0 + by_K) for by_K in (20.0, -20.0))
    assert scores(clipped, beyond, 1.0)[0] == pytest.approx(0.0, abs=1e-6)
    assert scores(clipped, short, 1.0)[0] < -1e3
