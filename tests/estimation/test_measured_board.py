"""The ceramic-fibre board under a lamp: what its stand, the gas and its moisture explain, and heat found in depth."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from benchmarks.kaowool import BOARD, CONVECTION, EARLY_S, GAS_STARTS, VAPOUR, bare, physical, tried
from sim_heating.inputs.record import Record, load_record
from sim_heating.simulation.predict import predict
from tests.support.deposited_heat import DEPTH_BINS, TIME_BIN_S, Slab, deposited_heat, response
from tests.support.quick_fit import Model, quick_fit


@cache
def board() -> Record:
    return load_record(BOARD)


@cache
def in_gas() -> Model:
    return quick_fit(board(), [CONVECTION], GAS_STARTS)


def rmse(residual_K: np.ndarray, until_s: float = np.inf) -> np.ndarray:
    return np.sqrt(np.mean(residual_K[:, board().time_s <= until_s] ** 2, axis=1))


def test_stand_and_convection_lower_the_error_at_every_depth() -> None:
    plain, stand = rmse(predict(bare(board())).residual_K), rmse(predict(board()).residual_K)
    assert np.all(stand < plain)
    assert np.all(rmse(in_gas().residual_K) < 0.25 * plain)


def test_the_deeper_joints_are_warmer_early_than_conduction_makes_them() -> None:
    t = board().time_s
    early = (t > 60.0) & (t < EARLY_S)
    assert np.all(np.mean(in_gas().residual_K[2, early]) > 5.0)


@pytest.mark.thorough
def test_vapour_brings_part_of_that_heat() -> None:
    moist = tried(board(), VAPOUR).residual_K
    assert np.all(rmse(moist, EARLY_S) < rmse(in_gas().residual_K, EARLY_S))


def test_physical_conductivity_passes_the_published_points() -> None:
    published = np.array(board().declared.materials["kaowool-pm"].conductivity_W_mK)[1:]
    T, k = np.array(physical(board(), k=True).declared.materials["kaowool-pm"].conductivity_W_mK).T
    np.testing.assert_allclose(np.interp(published[:, 0], T, k), published[:, 1], rtol=0.02)


# Heat in depth -------------------------------------------------------------------------------------------------------


def slab(count: int) -> Slab:
    """A board at rest, with thermocouples at 6, 12 and 18 mm."""
    depth = np.linspace(0.0, 0.028, 57)
    return Slab(depth, np.full((count, 57), 300.0), np.full((count, 56), 0.05), 2.7e5, (12, 24, 36), np.zeros(count))


def test_heat_deposited_everywhere_warms_an_insulated_wall_evenly() -> None:
    everywhere = response(slab(41), 8, 41).sum(axis=0)
    for k in range(3):
        assert everywhere[0, k, 3] == pytest.approx(3.0 / 2.7e5)  # W/m3 s over J/(m3 K)
        assert everywhere[0, k, 40] == pytest.approx(TIME_BIN_S / 2.7e5)
        assert everywhere[7, k, int(7 * TIME_BIN_S)] == 0.0


def test_deposited_heat_is_found_where_and_when_it_was_given() -> None:
    wall, count = slab(71), 71
    time = np.arange(0.5 * TIME_BIN_S, count - 1, TIME_BIN_S)
    depth = (np.arange(DEPTH_BINS) + 0.5) * 0.028 / DEPTH_BINS
    true = 1e5 * np.exp(-0.5 * ((depth[:, np.newaxis] - 0.011) / 3e-3) ** 2 - 0.5 * ((time - 30.0) / 10.0) ** 2)
    clean = np.einsum("ij,ijkt->kt", true, response(wall, len(time), count))
    noisy = clean + np.random.default_rng(3).normal(0.0, 0.5, clean.shape)
    found = deposited_heat(wall, noisy, np.full(3, 0.5))
    place, when = np.unravel_index(np.argmax(found.source_W_m3), true.shape)
    assert found.depth_m[place] == pytest.approx(0.011, abs=3e-3)
    assert found.time_s[when] == pytest.approx(30.0, abs=10.0)
    assert np.sum(found.source_W_m3) == pytest.approx(np.sum(true), rel=0.25)
    assert np.sqrt(np.mean(found.left_K**2)) == pytest.approx(0.5, rel=0.1)
