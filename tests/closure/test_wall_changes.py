"""Walls that are other than declared: the thickness or a property of a layer, another material."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from sim_heating.closure.search.changes.record_change import fit_changes, with_own_corrections
from sim_heating.closure.search.changes.wall_changes import (
    contact_changes,
    layer_changes,
    material_changes,
    wall_changes,
    with_contact,
)
from sim_heating.closure.search.trials.trial_fit import TrialFit, base_trial, declared_fit, thin_record
from sim_heating.estimation.fit import estimate
from sim_heating.inputs.points import conditions_of_record, point_of_record
from sim_heating.inputs.record import Record
from sim_heating.inputs.vehicle import library_materials
from sim_heating.march.history import march_points
from sim_heating.march.mesh_choice import choose_meshes
from tests.closure.test_close_loop import simulated_record
from tests.support.verification.inside import gas_layer
from tests.support.walls import practice_record

TILE = practice_record("p06")[0]
"""Layers rcg, li900, rtv, sip, rtv, al2024, flown without an effect; sensors under the coating and on the skin."""
SKIN = 5


def declared_with(record: Record, layer: int | None = None, material: str = "", **changes: Any) -> Record:
    """A record whose file declares another layer, or another material, than it was flown with."""
    stack, materials = record.declared.stack, dict(record.declared.materials)
    layers = list(stack.layer)
    if layer is not None:
        layers[layer] = layers[layer].model_copy(update=changes)
    else:
        materials[material] = materials[material].model_copy(update=changes)
    stack = stack.model_copy(update={"layer": layers})
    return replace(record, declared=record.declared.model_copy(update={"stack": stack, "materials": materials}))


def base_of(record: Record) -> TrialFit:
    return base_trial(estimate([record]))


def test_every_layer_may_differ_except_in_what_an_effect_is_named_after():
    changes = {c.parameter.name for c in layer_changes(TILE) if c.parameter is not None}
    assert {"stack.al2024.thickness_factor", "stack.sip.conductivity_factor", "stack.li900.thickness_factor"} < changes
    assert not {"stack.li900.conductivity_factor", "stack.rcg.thickness_factor"} & changes


@pytest.mark.sample(1)
@pytest.mark.parametrize("change", layer_changes(TILE), ids=lambda c: c.what)
def test_a_changed_record_is_the_model_with_the_parameter(change):
    model = point_of_record(TILE).with_parameters({change.parameter.name: 1.3})
    flown = conditions_of_record(TILE)
    a, b = march_points([model, point_of_record(change.apply(TILE, 1.3))], [flown, flown])
    np.testing.assert_allclose(a.sensors_K, b.sensors_K, atol=0.1)  # two meshes


@pytest.mark.thorough
def test_a_skin_that_is_declared_too_thick_is_recognised():
    thickness_m = 1.2 * TILE.declared.stack.layer[SKIN].thickness_m
    found = fit_changes(base_of(declared_with(TILE, SKIN, thickness_m=thickness_m)), wall_changes(TILE))
    likely = {f.change.what for f in found if f.delta_bic < found[0].delta_bic + 10.0}
    assert likely == {"thickness of layer al2024", "heat capacity (density times specific heat) of layer al2024"}
    assert found[0].value == pytest.approx(1.0 / 1.2, abs=4.0 * found[0].sigma)


@pytest.mark.thorough
def test_layers_that_came_apart_are_recognised_by_the_resistance_between_them():
    resistance = 0.1
    record = simulated_record(with_contact(TILE, resistance, number=1), [])
    apart = with_contact(record, 0.0, number=1)
    declared = apart.declared.stack.layer[1]
    assert (declared.name or declared.material, declared.contact_m2K_W) == ("li900", 0.0)
    before = declared_fit(apart)
    base = base_trial(before)
    found = with_own_corrections(before, base, fit_changes(base, wall_changes(apart)))
    assert found[0].change.what == "contact between layer li900 and layer rtv"
    assert found[0].value == pytest.approx(resistance, abs=4.0 * found[0].sigma)
    assert found[0].sigma < 0.03 * resistance
    assert found[0].excess_chi2 < 0.1


def test_a_contact_is_an_element_more_and_leaves_the_mesh_of_the_layers_as_it_is():
    thin = thin_record(TILE, 20)
    whole, apart = (choose_meshes([point_of_record(r)])[0][0] for r in (thin, with_contact(thin, 0.01, number=1)))
    np.testing.assert_array_equal(apart.length_m[apart.layer >= 0], whole.length_m)
    flown = conditions_of_record(thin)
    a, b = march_points([point_of_record(r) for r in (thin, with_contact(thin, 1e-9, number=1))], [flown, flown])
    np.testing.assert_allclose(a.sensors_K, b.sensors_K, atol=1e-4)


def test_a_declared_contact_may_be_another_one_and_is_never_negative():
    declared = declared_with(TILE, 1, contact_m2K_W=4e-4)
    own = next(c.parameter for c in contact_changes(declared) if "li900 and" in c.what)
    assert own.value == 4e-4
    assert 0.0 < own.lower < 1e-5
    change = next(c for c in contact_changes(TILE) if "li900 and" in c.what)
    assert (change.parameter.value, change.parameter.lower) == (0.0, 0.0)
    assert change.describe(0.03) == "contact between layer li900 and layer rtv: 0.03 m2 K/W, declared none"


@pytest.mark.thorough
def test_another_material_is_recognised_among_those_of_the_library():
    flown = TILE.declared.materials["li900"]
    record = declared_with(TILE, material="li900", **dict(library_materials()["li2200"]))
    record.declared.materials["tile"] = flown  # of the record's own materials one that no layer is declared of
    found = fit_changes(base_of(record), material_changes(record))
    assert found[0].change.describe(found[0].value) == "layer li900 behaves as tile"
    assert found[0].excess_chi2 < 0.3  # 0.1 with the mesh correction of this wall in place of the declared one
    assert found[1].delta_bic > found[0].delta_bic + 1000.0


@pytest.mark.thorough
def test_a_clean_record_has_no_other_wall():
    assert min(f.delta_bic for f in fit_changes(base_of(TILE), wall_changes(TILE))) > -5.0


def test_materials_of_the_library_stand_in_for_those_of_their_class():
    offered = {c.what for c in material_changes(TILE)}
    assert {"layer li900 behaves as li2200", "layer al2024 behaves as ti-6al-4v"} < offered
    assert not {"layer al2024 behaves as li2200", "layer li900 behaves as li900"} & offered
    change = next(c for c in material_changes(TILE) if c.what == "layer li900 behaves as li2200")
    changed = change.apply(TILE, 0.0)
    assert changed.construction.layer_materials()[1] == library_materials()["li2200"]
    assert changed.construction.layer_materials()[2:] == TILE.construction.layer_materials()[2:]


def test_every_change_of_a_wall_with_a_layer_of_gas_is_a_wall():
    """Two plates and the air between them: no contact at its faces, and their emittance with another plate, too."""
    wall = gas_layer()
    declared = TILE.declared.model_copy(update={"stack": wall.stack, "materials": wall.materials})
    record = replace(TILE, declared=declared).with_sensors([TILE.sensors[0].model_copy(update={"depth_m": 0.0})])
    changes = wall_changes(record)
    assert not {c.what for c in changes if "contact" in c.what or "behaves as air" in c.what or "air behaves" in c.what}
    for change in changes:
        changed = change.apply(record, 0.0 if change.parameter is None else 1.1 * change.parameter.value).construction
        assert changed.gas_layers == wall.gas_layers
        assert changed.faces_exchange(1) == pytest.approx(wall.faces_exchange(1))
    assert {"layer back plate behaves as al2024"} < {c.what for c in changes}


def test_changes_of_the_wall_describe_themselves():
    texts = [c.describe(1.2) for c in wall_changes(TILE)]
    assert "layer al2024 20 % thicker than declared" in texts
    assert "conductivity of layer sip 20 % above the declared one" in texts
