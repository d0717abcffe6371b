"""A pressure transducer beside thermocouples: what it says of the surface pressure, and by that of the insulation."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sim_heating.base.errors import InputError
from sim_heating.base.files import check
from sim_heating.base.parameters import PRESSURE_FACTOR
from sim_heating.estimation.design.instruments import instrumentation
from sim_heating.estimation.design.planned_flight import Planner
from sim_heating.estimation.filter.process_noise import ProcessNoise
from sim_heating.estimation.fit import estimate
from sim_heating.estimation.problem import FitProblem, joint_reference
from sim_heating.inputs.pressure_transducer import PressureTransducer, measure_pressure, pressure_factor
from sim_heating.inputs.record import Record, RecordFile, load_record
from sim_heating.inputs.scenario import Scenario, load_scenario, with_design
from sim_heating.simulation.predict import predict
from sim_heating.simulation.synthesize import synthesize, write_records
from tests.support.gliding import gliding
from tests.support.paths import SCENARIOS

approx = pytest.approx
PLUG, FACTOR = "V09T9527", PRESSURE_FACTOR.name
CONDUCTIVITY = "stack.rsi.conductivity_factor"
KEYS = {"name": "P1", "column": "P1_Pa", "noise_sigma_Pa": 5.0}
FALLING_PA = np.geomspace(20.0, 4000.0, 60)
"""Pressure at the surface in an entry."""


def transducer(**keys: Any) -> PressureTransducer:
    return PressureTransducer.model_validate(KEYS | keys)


def known(instrument: PressureTransducer, read: np.ndarray) -> tuple[float, float]:
    return pressure_factor([instrument], FALLING_PA, {"P1_Pa": read})


def test_factor_and_bias_are_those_of_normal_equations() -> None:
    """f and b of y = f p + b by the inverse of the whole information, the priors of both in it."""
    rng = np.random.default_rng(1)
    read = 0.9 * FALLING_PA + 12.0 + rng.normal(0.0, 5.0, len(FALLING_PA))
    A = np.column_stack([FALLING_PA, np.ones_like(FALLING_PA)])
    M = A.T @ A / 25.0 + np.diag([PRESSURE_FACTOR.sigma**-2.0, 20.0**-2.0])
    expected = np.linalg.solve(M, A.T @ read / 25.0 + [PRESSURE_FACTOR.sigma**-2.0, 0.0])
    assert known(transducer(bias_sigma_Pa=20.0), read) == approx((expected[0], np.linalg.inv(M)[0, 0] ** 0.5))


def test_a_gain_that_is_known_to_two_per_cent_limits_the_factor() -> None:
    _, sigma = known(transducer(gain_sigma=0.02), FALLING_PA)
    assert sigma == approx(0.02, rel=0.02)
    assert pressure_factor([transducer(used=False)], FALLING_PA, {}) == approx((1.0, PRESSURE_FACTOR.sigma))


def test_errors_of_the_factor_are_those_that_are_stated() -> None:
    """Words of 8 bits, gain and bias drawn again in each of 400 flights: a sum of squares within 3 sigma of its own."""
    instrument = transducer(bias_sigma_Pa=30.0, gain_sigma=0.01, bits=8, range_Pa=[0.0, 5000.0])
    rng, z = np.random.default_rng(2), []
    for _ in range(400):
        truth = rng.normal(PRESSURE_FACTOR.value, PRESSURE_FACTOR.sigma)
        if truth > 0.0:
            mean, sigma = known(instrument, measure_pressure(instrument, truth * FALLING_PA, rng))
            z.append((mean - truth) / sigma)
    assert np.mean(np.square(z)) == approx(1.0, abs=3.0 * np.sqrt(2.0 / len(z)))


def test_lost_and_clipped_readings_say_nothing() -> None:
    instrument = transducer(bits=8, range_Pa=[0.0, 2000.0])
    read = np.where(FALLING_PA > 2000.0, 2000.0, FALLING_PA)
    lost = np.where(np.arange(len(read)) % 7 == 0, np.nan, read)
    mean, _ = known(instrument, lost)
    assert mean == approx(1.0, abs=0.01)


@pytest.fixture(scope="module")
def scenario(tmp_path_factory: pytest.TempPathFactory) -> Scenario:
    """A glide whose plug has a transducer, with a surface pressure that is 0.7 of the computed one."""
    file = tmp_path_factory.mktemp("glide") / "glide.toml"
    file.write_text(gliding(400.0, PLUG, altitude_m=66000.0) + "[truth]\np_surface_factor = 0.7\n")
    loaded = load_scenario(file)
    point = loaded.vehicle.control_point(PLUG)
    instrument = transducer(bias_sigma_Pa=10.0, gain_sigma=0.01, bits=12, range_Pa=[0.0, 4000.0])
    point = replace(point, declared=point.declared.model_copy(update={"transducer": [instrument]}))
    points = {**loaded.vehicle.control_points, PLUG: point}
    return replace(loaded, vehicle=replace(loaded.vehicle, control_points=points))


@pytest.fixture(scope="module")
def record(scenario: Scenario) -> Record:
    return synthesize(scenario)[PLUG]


def without_transducer(record: Record) -> Record:
    return replace(record, pressure_factor=(PRESSURE_FACTOR.value, PRESSURE_FACTOR.sigma))


def test_a_transducer_reads_the_true_pressure_and_a_file_keeps_it(
    scenario: Scenario, record: Record, tmp_path: Path
) -> None:
    mean, sigma = record.pressure_factor
    assert mean == approx(0.7, abs=3.0 * sigma)
    assert sigma < 0.02
    write_records(scenario, {PLUG: record}, tmp_path / "record")
    assert load_record(tmp_path / "record").pressure_factor == approx(record.pressure_factor, rel=1e-9)
    assert "p_surface_factor = 0.7" in (tmp_path / "record" / "truth.toml").read_text()


def test_what_a_transducer_reads_is_in_every_prediction(record: Record) -> None:
    """The pressure is that of the truth, and the insulation conducts as it does there."""
    deep = next(k for k, s in enumerate(record.sensors) if s.name == "V07T9529")
    known, computed = (np.nanmean(predict(r).residual_K[deep]) for r in (record, without_transducer(record)))
    assert abs(known) < 0.2 * abs(computed)


def test_the_response_to_the_pressure_is_that_of_marches_to_second_order(record: Record) -> None:
    """What a fit, linear in the logarithm of the pressure, is off from marches falls to a quarter with half the step.

    As a root mean square: about the pressures of its table, where a conductivity has a corner, it falls to a half.
    """
    problem = FitProblem([record], [FACTOR], joint_reference([record]))
    stated, at = record.pressure_factor[0], np.isin(record.time_s, problem.record_fits[0].sample_s)

    def by_fit(factor: float) -> np.ndarray:
        return np.array([s.mean_K for s in problem.samples(np.array([factor]))])

    def marched(factor: float) -> np.ndarray:
        return predict(replace(record, pressure_factor=(factor, 0.0))).indicated_K[:, at]

    off, moved = [], []
    for step in (0.1, 0.2):
        factor = stated * np.exp(step)
        change = marched(factor) - marched(stated)
        off.append(np.sqrt(np.mean((by_fit(factor) - by_fit(stated) - change) ** 2)))
        moved.append(np.sqrt(np.mean(change**2)))
    assert off[0] < 0.06 * moved[0]
    assert off[1] / off[0] == approx(4.0, rel=0.25)


@pytest.mark.thorough
def test_a_transducer_frees_the_conductivity_of_the_error_of_the_pressure(record: Record) -> None:
    """The truth has the declared conductivity. Without the transducer its factor takes what the pressure is off by."""
    names = ("ratio.scale", CONDUCTIVITY, FACTOR)
    with_it, alone = estimate(record, names), estimate(without_transducer(record), names[:2])
    found = with_it.parameters[CONDUCTIVITY]
    assert found.value == approx(1.0, abs=3.0 * found.sigma)
    assert abs(alone.parameters[CONDUCTIVITY].value - 1.0) > 3.0 * alone.parameters[CONDUCTIVITY].sigma
    unknown = estimate(without_transducer(record), names)
    assert with_it.parameters[CONDUCTIVITY].sigma < 0.7 * unknown.parameters[CONDUCTIVITY].sigma


def test_a_filter_with_process_noise_says_that_it_changes_no_pressure(record: Record) -> None:
    with pytest.raises(InputError, match="no filter with process noise changes it"):
        estimate(record, ("ratio.scale", FACTOR), process_noise=ProcessNoise())


def test_a_design_knows_the_pressure_as_its_transducer_will() -> None:
    loaded = load_scenario(SCENARIOS / "design_popu.toml")
    spec = loaded.declared.trajectory.model_copy(update={"source": "entry-3dof", "rate_hz": 4.0})
    loaded = replace(loaded, names=(PLUG,), declared=loaded.declared.model_copy(update={"trajectory": spec}))
    sets = [{"name": "with P1", "transducer": [KEYS | {"noise_sigma_Pa": 20.0, "gain_sigma": 0.02}]}]
    planner = Planner(with_design(loaded, {"instruments": sets, "parameters": ["ratio.d_alpha", CONDUCTIVITY]}))
    planned = planner.fly(loaded.declared.trajectory.manoeuvre)
    names = ("ratio.d_alpha", "ratio.scale", CONDUCTIVITY, FACTOR)
    declared, with_p1 = (v.sigma[1] for v in instrumentation(planner, planned, names, {}))
    assert with_p1 < 0.95 * declared
    ((_, instruments),) = planner.compared
    experiment = planner.experiment(planned, names, {}, instruments)
    assert experiment.unknowns[experiment.names.index(FACTOR)].sigma == approx(0.02, rel=0.1)
    twice = [{"name": "two", "transducer": [KEYS, KEYS]}]
    with pytest.raises(InputError, match=r"two: `transducer\[1\].name`: `P1` is that of another instrument"):
        Planner(with_design(loaded, {"instruments": twice}))


@pytest.mark.parametrize(
    ("keys", "problem"),
    [
        ({"column": "P1_psi"}, "`column`: `P1_psi` does not end in _Pa"),
        ({"bits": 8}, "`bits`: 8 bits need `range_Pa`"),
        ({"range_Pa": [10.0, 5.0]}, "`range_Pa`: .* is not \\[lowest, highest\\]"),
        ({"noise_sigma_Pa": 0.0}, "`noise_sigma_Pa`: 0.0 must be above 0"),
    ],
)
def test_a_transducer_that_cannot_be_is_refused_in_one_line(keys: dict[str, Any], problem: str) -> None:
    with pytest.raises(InputError, match=problem):
        check(KEYS | keys, PressureTransducer, "point.toml")


def test_a_transducer_has_a_column_of_its_own(record: Record) -> None:
    data = record.declared.model_dump(exclude_unset=True)
    data["thermocouples"]["transducer"] = [KEYS, KEYS | {"name": "P2"}]
    with pytest.raises(InputError, match=r"transducer\] 2: `column`: `P1_Pa` is that of another instrument"):
        check(data, RecordFile, "record.toml")
