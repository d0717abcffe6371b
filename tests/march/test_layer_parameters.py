"""Parameters of a layer by the name that its file gives it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sim_heating.base.errors import InputError
from sim_heating.inputs.points import conditions_of_record, point_of_record
from sim_heating.inputs.record import Record
from sim_heating.march.history import march_points
from sim_heating.march.point import PointModel
from sim_heating.thermal.stack import Construction
from tests.support.walls import practice_record

TILE = practice_record("p06")[0]
"""Layers rcg, li900, rtv, sip, rtv, al2024; sensors under the coating and on the skin."""


def named(record: Record, **names: str) -> Record:
    """The record with other names of layers, by their number from the outside."""
    stack = record.declared.stack
    layers = [layer.model_copy(update={"name": names.get(f"_{i}")}) for i, layer in enumerate(stack.layer)]
    stack = stack.model_copy(update={"layer": layers})
    return replace(record, declared=record.declared.model_copy(update={"stack": stack}))


def temperatures(model: PointModel, *changes: dict[str, float]) -> list[np.ndarray]:
    """(sensor, time) temperatures [K] with each set of parameters, along the flight of the tile."""
    models = [model.with_parameters(values) for values in changes]
    return [h.sensors_K for h in march_points(models, [conditions_of_record(TILE)] * len(models))]


def test_insulation_and_coating_have_the_parameters_of_their_roles():
    model = point_of_record(TILE)
    for own, role in (("rcg", "coating"), ("li900", "rsi")):
        for what in ("conductivity_factor", "heat_capacity_factor"):
            by_name = model.with_parameters({f"stack.{own}.{what}": 1.3})
            assert by_name.value(f"stack.{role}.{what}") == 1.3
            np.testing.assert_array_equal(by_name.values, model.with_parameters({f"stack.{role}.{what}": 1.3}).values)


def test_the_last_value_counts_whichever_name_it_has():
    changed = point_of_record(TILE).with_parameters({"stack.rsi.conductivity_factor": 0.8})
    assert (
        changed.with_parameters({"stack.li900.conductivity_factor": 1.3}).value("stack.rsi.conductivity_factor") == 1.3
    )


def test_a_thicker_skin_and_one_of_more_heat_capacity_keep_the_bondline_cool_alike():
    model = point_of_record(TILE)
    declared, thick, dense = temperatures(
        model, {}, {"stack.al2024.thickness_factor": 1.2}, {"stack.al2024.heat_capacity_factor": 1.2}
    )
    assert np.min(thick[1] - declared[1]) < -3.0
    np.testing.assert_allclose(thick, dense, atol=0.01)  # aluminium is as good as isothermal


def test_a_sensor_within_a_tile_keeps_its_depth_where_the_tile_is_thicker():
    factor, stack = 1.2, TILE.declared.stack
    model = replace(point_of_record(TILE), depths_m=(0.00038, 0.02, TILE.sensors[1].depth_m))
    grown = (factor - 1.0) * stack.layer[1].thickness_m
    layers = [*stack.layer]
    layers[1] = layers[1].model_copy(update={"thickness_m": factor * layers[1].thickness_m})
    declared = Construction(stack=stack.model_copy(update={"layer": layers}), materials=TILE.declared.materials)
    thicker = replace(model, construction=declared, depths_m=(*model.depths_m[:2], model.depths_m[2] + grown))
    (found,), (expected,) = temperatures(model, {"stack.li900.thickness_factor": factor}), temperatures(thicker, {})
    np.testing.assert_allclose(found, expected, atol=1.0)  # two meshes of this accuracy
    assert model.definition("stack.li900.thickness_factor").lower == pytest.approx((0.02 - 0.00038) / 0.0459, abs=2e-3)


def test_layers_of_one_material_change_together_and_apart_where_they_are_named():
    what = "conductivity_factor"
    both, upper, lower = (
        temperatures(point_of_record(record), {}, {name: 0.2})
        for record, name in (
            (TILE, f"stack.rtv.{what}"),
            (named(TILE, _2="bond", _4="glue"), f"stack.bond.{what}"),
            (named(TILE, _2="bond", _4="glue"), f"stack.glue.{what}"),
        )
    )
    changes = [np.ptp(changed - nominal) for nominal, changed in (both, upper, lower)]
    assert min(changes) > 0.0
    assert changes[0] == pytest.approx(changes[1] + changes[2], rel=0.1)


@pytest.mark.parametrize(
    ("names", "name", "text"),
    [
        (
            {},
            "stack.copper.conductivity_factor",
            "there is no layer `copper`; its layers are rcg, li900, rtv, sip, al2024",
        ),
        ({}, "stack.al2024.density_factor", "unknown parameter `stack.al2024.density_factor`"),
        ({"_5": "rsi"}, "stack.rsi.conductivity_factor", "give the first another `name` in [[stack.layer]]"),
    ],
)
def test_a_name_without_a_layer_is_refused(names, name, text):
    with pytest.raises(InputError, match="stack") as refused:
        point_of_record(named(TILE, **names)).definition(name)
    assert text in str(refused.value)


def test_a_derivative_of_the_ratio_may_be_negative():
    assert point_of_record(TILE).definition("ratio.d_beta").lower == -np.inf


def test_scatter_that_a_file_declares_is_the_prior():
    stack, materials = TILE.declared.stack, dict(TILE.declared.materials)
    materials["sip"] = materials["sip"].model_copy(update={"conductivity_sigma": 0.3})
    layers = [*stack.layer[:-1], stack.layer[-1].model_copy(update={"thickness_sigma_m": 1e-4})]
    declared = Construction(stack=stack.model_copy(update={"layer": layers}), materials=materials)
    model = replace(point_of_record(TILE), construction=declared)
    assert model.definition("stack.sip.conductivity_factor").sigma == 0.3
    assert model.definition("stack.al2024.thickness_factor").sigma == pytest.approx(1e-4 / layers[-1].thickness_m)
    assert model.definition("stack.rtv.thickness_factor").sigma == 0.1  # a stated default
    assert model.definition("stack.rsi.conductivity_factor").sigma == 0.18
