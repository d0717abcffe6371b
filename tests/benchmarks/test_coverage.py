"""Bands of flights that no fit has seen, on one of the vehicles of the benchmark."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.coverage import WALL, Vehicle, of_vehicle
from sim_heating.base.parameters import MODEL
from sim_heating.credibility.facts import contributors


@pytest.mark.thorough
@pytest.mark.filterwarnings("ignore")
def test_a_band_holds_the_next_flight_and_is_hardly_wider_than_the_true_models():
    """After two fitted flights; after three, on 20 vehicles: `python -m benchmarks coverage`."""
    flights = of_vehicle("rightly", 2, 6, 2)
    mean = {key: float(np.mean([f[key] for f in flights])) for key in flights[0]}
    assert mean["within"] > 0.85
    assert mean["true_within"] > 0.85
    assert 0.7 < mean["width_K"] / mean["true_width_K"] < 1.4


def test_true_walls_are_other_than_declared_by_what_every_wall_is_uncertain_by():
    assert set(WALL) == set(contributors.WALL)
    drawn = [Vehicle.drawn(np.random.default_rng(n), "rightly").wall for n in range(200)]
    for name in WALL:
        assert np.std([w[name] for w in drawn]) == pytest.approx(MODEL[name].sigma, rel=0.2)
