"""At rest on the runway a vehicle takes the temperature of air and ground, not that of space."""

from __future__ import annotations

import numpy as np
import pytest

from sim_heating.base.conditions import Conditions
from sim_heating.base.errors import InputError
from sim_heating.heating.surroundings import surroundings_kernel
from sim_heating.inputs.points import conditions_at_point
from sim_heating.inputs.vehicle import load_vehicle
from sim_heating.simulation.plugin import HeatingPlugin
from tests.support.verification.at_rest import POINTS, RUNWAY, rows


@pytest.mark.thorough
def test_the_orbiter_at_rest_settles_at_air_and_sky():
    for row in rows():
        assert row.kept, row


def test_the_sky_is_cold_and_the_ground_is_as_the_air():
    assert surroundings_kernel(288.15, 101325.0, 1.0) == pytest.approx(288.15)
    assert surroundings_kernel(288.15, 101325.0, 0.0) == pytest.approx(
        (5.31e-13 / 5.670374419e-8 * 288.15**6) ** 0.25, rel=1e-4
    )
    assert surroundings_kernel(200.0, 1e-3, 1.0) == pytest.approx(255.0)
    assert surroundings_kernel(200.0, 1e-3, 0.0) < 20.0


def test_plug_in_and_run_have_the_same_surroundings():
    vehicle = load_vehicle("orbiter")
    flown = Conditions({n: np.full(2, v) for n, v in RUNWAY.items()} | {
        "time_s": np.array([0.0, 10.0]), "mach": np.zeros(2), "log10_re": np.zeros(2), "T_inf_K": np.full(2, 288.15),
        "p_inf_Pa": np.full(2, 101325.0),
    })  # fmt: skip
    at = conditions_at_point(vehicle, vehicle.control_point("LOWER_MID"), flown)
    assert at["T_surroundings_K"][0] == pytest.approx(288.15, abs=0.1)
    assert at["still_air_W_m2K43"][0] == pytest.approx(1.31)


def test_a_frame_may_state_its_surroundings():
    plugin = HeatingPlugin(load_vehicle("orbiter"), POINTS[:2])
    surfaces = []
    for sky_K in (400.0, None):
        frame = RUNWAY | ({} if sky_K is None else {"T_surroundings_K": sky_K})
        plugin.reset(frame | {"time_s": 0.0})
        plugin.step(frame | {"time_s": 10.0})
        surfaces.append(plugin.surface_K["LEE_UPPER"])
    assert surfaces[0] > surfaces[1] + 10.0
    with pytest.raises(InputError, match="T_surroundings_K"):
        plugin.step(RUNWAY | {"time_s": 20.0, "T_surroundings_K": -3.0})
