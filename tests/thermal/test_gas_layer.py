"""A layer of gas conducts and radiates between its two faces, in the march, in its sensitivities and in a plug-in."""

from __future__ import annotations

import numpy as np
import pytest

from sim_heating.heating import flight_variables
from sim_heating.march.linearised import LinearMarch, Track
from sim_heating.march.mesh_choice import choose_meshes
from sim_heating.march.point import PointModel
from sim_heating.thermal.mesh import build_mesh, halve_elements
from sim_heating.thermal.stack import Sensor, material_problems, sensor_problems
from tests.support.verification.inside import gas_layer, gas_layer_K
from tests.support.walls import flight, heat


@pytest.mark.sample(1)
@pytest.mark.parametrize("conductivity", [20.0, 1800.0])
def test_faces_of_a_gas_layer_radiate_at_each_other(conductivity):
    w = gas_layer(conductivity_W_mK=conductivity)
    _, out = heat(w, flight([0.0, 4e4], q_add_W_m2=6e4), (w.stack.thickness_m,), nodes=14)
    np.testing.assert_allclose(out[-1, [0, 2]], gas_layer_K(6e4, conductivity), rtol=0.0, atol=0.01)


def test_emittance_of_a_face_is_stated_or_that_of_the_neighbour():
    w = gas_layer(emissivity_inner=0.5)
    assert w.faces_exchange(1) == pytest.approx(1.0 / (1.0 / 0.8 + 1.0 / 0.5 - 1.0))
    bare = w.materials["plate"].model_copy(update={"emissivity": [[300.0, 0.8], [900.0, 0.6]]})
    ((location, rule),) = material_problems(w.stack, w.materials | {"plate": bare})
    assert location == ("stack", "layer", 1, "emissivity_outer")
    assert "the emittance of `plate` changes with temperature; add it" in rule


def test_a_gas_layer_lies_between_two_solid_ones():
    w = gas_layer()
    open_stack = w.stack.model_copy(update={"layer": w.stack.layer[:2]})
    ((location, rule),) = material_problems(open_stack, w.materials)
    assert location == ("stack", "layer", 1, "material")
    assert "between two solid ones" in rule
    solid = w.stack.layer[0].model_copy(update={"emissivity_inner": 0.5})
    ((location, rule),) = material_problems(
        w.stack.model_copy(update={"layer": [solid, *w.stack.layer[1:]]}), w.materials
    )
    assert location == ("stack", "layer", 0, "emissivity_inner")
    assert "this one is solid" in rule


def test_a_gas_layer_stays_one_element():
    w = gas_layer()
    mesh = build_mesh(w, np.array([0.002]), 40)
    assert np.sum(mesh.layer == 1) == np.sum(halve_elements(mesh).layer == 1) == 1
    assert halve_elements(mesh).nodes == 2 * (mesh.nodes - 1)


def test_no_thermocouple_stands_in_the_gas():
    w = gas_layer()
    ((location, rule),) = sensor_problems(
        w.stack, [Sensor(name="T", column="T_K", depth_m=0.005, noise_sigma_K=1.0)], w.materials
    )
    assert location == (0, "depth_m")
    assert "within a layer of gas; give the depth of a face, 0.002 or 0.012" in rule


def test_sensitivities_know_of_the_radiation_between_faces():
    w, name, step = gas_layer(), "stack.emissivity_factor", 1e-3
    flown = flight(np.linspace(0.0, 600.0, 301), q_add_W_m2=6e4)
    model = PointModel("wall", w, (w.stack.thickness_m,), nodes=14)
    mesh = choose_meshes([model])[0][0]
    time_s = flown[0, :, flight_variables.time_s]
    track = Track(model, mesh, (name,), time_s)
    exact = LinearMarch([track], time_s, flown).march()[0].sensitivity[0, -1, 0]
    ends = [
        heat(w, flown, model.depths_m, nodes=14, parameters={name: 1.0 + side * step})[1][-1, -1]
        for side in (1.0, -1.0)
    ]
    assert exact == pytest.approx((ends[0] - ends[1]) / (2.0 * step), rel=1e-4)
