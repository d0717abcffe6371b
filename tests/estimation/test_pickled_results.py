"""Results and plug-ins go to other processes and come back as they were."""

from __future__ import annotations

import multiprocessing
import pickle
from concurrent.futures import ProcessPoolExecutor

import numpy as np
import pytest

import sim_heating as sh
from tests.support.paths import ROOT

TILE = ROOT / "tests" / "data" / "records" / "tile"
FRAME = {
    "time_s": 0.0, "altitude_m": 74e3, "velocity_m_s": 6800.0, "alpha_deg": 40.0, "beta_deg": 0.0, "elevon_deg": 1.0,
    "bodyflap_deg": 15.0, "rho_kg_m3": 4.6e-5,
}  # fmt: skip


def test_a_plug_in_flies_on_from_where_it_was_pickled():
    plugin = sh.HeatingPlugin(sh.load_vehicle("orbiter"), ["V09T9527"])
    plugin.reset(FRAME)
    for i in range(1, 121):
        plugin.step(FRAME | {"time_s": i / 60.0})
    other = pickle.loads(pickle.dumps(plugin))
    for flown in (plugin, other):
        for i in range(121, 301):
            flown.step(FRAME | {"time_s": i / 60.0})
    assert other.surface_K == plugin.surface_K
    assert other.sensors_K == plugin.sensors_K


@pytest.mark.thorough
def test_records_are_estimated_by_a_pool_of_processes():
    records = [sh.load_record(TILE), sh.load_record(TILE)]
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        first, second = pool.map(sh.estimate, records)
    here = sh.estimate(records[0])
    assert first.parameters == second.parameters == here.parameters
    vector = np.array([value for value, _ in here.parameters.values()])
    assert first.problem.evaluate(vector).log_likelihood == here.problem.evaluate(vector).log_likelihood
