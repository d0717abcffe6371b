"""Heat at the surface: the balance of its fluxes, what the wall stores of them, and the heat load."""

from __future__ import annotations

import numpy as np
import pytest

from sim_heating.base.conditions import Conditions
from sim_heating.heating.effects import use
from sim_heating.inputs.points import conditions_of_record
from sim_heating.march.ensemble import Ensemble, condition_history
from sim_heating.march.history import PointHistory, march_points
from sim_heating.march.mesh_choice import choose_meshes
from sim_heating.thermal.faces import SIGMA
from tests.support.verification.inside import back_losses
from tests.support.walls import heat_content, practice_model, practice_record

LAMP_W_M2 = 2.0e4
FADING = use("emissivity", {"emissivity_factor": 0.7, "change_s": 500.0, "duration_s": 20.0})


def heated(**changes: object) -> tuple[PointHistory, Conditions]:
    """A practice flight under a lamp as well, and its conditions."""
    record = practice_record("p06")[0]
    flown = conditions_of_record(record)
    lamp = LAMP_W_M2 * np.clip((flown.time_s - 200.0) / 100.0, 0.0, 1.0)
    flown = flown.with_columns(q_add_W_m2=lamp)
    return march_points([practice_model("p06", **changes)], [flown])[0], flown


@pytest.mark.parametrize("effects", [(), (FADING,)], ids=["declared", "emittance that changes"])
def test_heat_that_reaches_a_surface_leaves_it_or_enters_the_wall(effects):
    """Each flux by its own law: convected by the film, radiated by the emittance."""
    history, flown = heated(effects=effects)
    model, heat = practice_model("p06", effects=effects), history.heat
    film = history.ratio * flown["h_ref_kg_m2_s"]
    convected = film * (flown["H_r_J_kg"] - model.wall_enthalpy * history.surface_K)
    np.testing.assert_allclose(heat.convected_W_m2, convected, atol=1.0)
    np.testing.assert_allclose(heat.added_W_m2, flown["q_add_W_m2"])
    points = np.array(model.construction.layer_materials()[0].emissivity)
    factor = 1.0 - 0.3 / (1.0 + np.exp(-(history.time_s - 500.0) / 20.0)) if effects else 1.0
    radiated = factor * np.interp(history.surface_K, *points.T) * SIGMA * history.surface_K**4
    np.testing.assert_allclose(heat.radiated_W_m2, radiated, rtol=1e-6)
    left = convected - radiated - heat.conducted_W_m2 + heat.added_W_m2
    assert np.max(np.abs(left)) < 1e-4 * np.max(convected)


def test_wall_stores_what_is_conducted_into_it():
    record, model = practice_record("p06")[0], practice_model("p06")
    flown = conditions_of_record(record)
    heat = march_points([model], [flown])[0].heat
    ensemble = Ensemble([model], [choose_meshes([model], 1.0)[0][0]])
    before = heat_content(ensemble)
    ensemble.march(flown.time_s, condition_history(flown)[np.newaxis])
    conducted = np.trapezoid(heat.conducted_W_m2, flown.time_s)
    assert heat_content(ensemble) - before == pytest.approx(conducted, rel=5e-3)


def test_heat_load_is_what_is_convected_and_nothing_under_a_lamp_alone():
    record, model = practice_record("p06")[0], practice_model("p06")
    flown = conditions_of_record(record)
    heat = march_points([model], [flown])[0].heat
    assert heat.heat_load_J_m2[-1] == pytest.approx(np.trapezoid(heat.convected_W_m2, flown.time_s))
    assert heat.heat_load_J_m2[0] == 0.0
    still = flown.with_columns(h_ref_kg_m2_s=np.zeros(len(flown)), q_add_W_m2=np.full(len(flown), LAMP_W_M2))
    lamp = march_points([model], [still])[0].heat
    assert np.max(np.abs(lamp.heat_load_J_m2)) < 1e-3 * LAMP_W_M2
    np.testing.assert_allclose(lamp.conducted_W_m2 + lamp.radiated_W_m2, LAMP_W_M2, rtol=1e-9)


def test_what_is_conducted_in_steadily_leaves_at_the_back():
    for row in back_losses():
        assert row.kept, row
