"""Meshes: a node wherever one is asked for, and nothing lost in between."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim_heating.base.errors import InputError
from sim_heating.thermal.mesh import build_mesh, fewest_nodes, halve_elements
from sim_heating.thermal.stack import Construction
from tests.support.walls import material, practice_model, wall

NO_DEPTHS = np.array([])
thicknesses = st.floats(-5.0, -0.7).map(lambda x: 10.0**x)
diffusivities = st.floats(-8.0, -4.0).map(lambda x: 10.0**x)


@st.composite
def stacks(draw) -> tuple[Construction, np.ndarray]:
    """One to five layers of any thickness and diffusivity, and up to four sensors anywhere in them."""
    layers = draw(st.lists(st.tuples(diffusivities, thicknesses), min_size=1, max_size=5))
    parts = [(material(k=a * 1e6), thickness) for a, thickness in layers]
    contact = draw(st.sampled_from([0.0, 1e-3])) if len(parts) > 1 else 0.0
    depths = draw(st.lists(st.floats(0.0, 1.0), max_size=4))
    construction = wall(*parts, contact=contact)
    return construction, np.array(depths) * construction.stack.thickness_m


def covered(construction: Construction, depths: np.ndarray, extra: int, step_s: float = 1.0):
    return build_mesh(construction, depths, fewest_nodes(construction, depths) + extra, step_s)


@given(stacks(), st.integers(0, 60), st.sampled_from([1 / 60, 1.0, 10.0]))
def test_mesh_has_the_prescribed_node_count(stack, extra, step_s):
    construction, depths = stack
    asked = fewest_nodes(construction, depths) + extra
    mesh = build_mesh(construction, depths, asked, step_s)
    assert mesh.nodes == asked == len(mesh.length_m) + 1
    assert np.all(mesh.length_m > 0.0)


@given(stacks(), st.integers(0, 60))
def test_every_layer_keeps_its_thickness(stack, extra):
    construction, depths = stack
    mesh = covered(construction, depths, extra)
    for i, layer in enumerate(construction.stack.layer):
        assert np.sum(mesh.length_m[mesh.layer == i]) == pytest.approx(layer.thickness_m, rel=1e-12)
    assert mesh.depth_m[-1] == pytest.approx(construction.stack.thickness_m, rel=1e-12)


@given(stacks(), st.integers(0, 60))
def test_interfaces_and_sensors_lie_on_nodes(stack, extra):
    construction, depths = stack
    mesh = covered(construction, depths, extra)
    closest = 1e-6 * construction.stack.thickness_m
    for depth in construction.stack.interfaces_m:
        assert np.min(np.abs(mesh.depth_m - depth)) <= closest
    np.testing.assert_allclose(mesh.depth_m[list(mesh.sensors)], depths, rtol=0.0, atol=1.001 * closest)


@given(stacks(), st.integers(0, 60))
def test_first_layer_has_two_elements_or_more(stack, extra):
    construction, depths = stack
    assert np.count_nonzero(covered(construction, depths, extra).layer == 0) >= 2


@given(stacks(), st.integers(0, 60))
def test_bondline_is_the_outer_face_of_the_last_layer_inside_a_contact(stack, extra):
    construction, depths = stack
    mesh = covered(construction, depths, extra)
    assert mesh.layer[mesh.bondline] == len(construction.stack.layer) - 1
    assert mesh.depth_m[mesh.bondline] == pytest.approx(construction.stack.bondline_m, rel=1e-12, abs=1e-15)


@given(stacks(), st.integers(0, 30))
def test_halved_mesh_halves_every_element_and_keeps_its_sensors(stack, extra):
    construction, depths = stack
    mesh = covered(construction, depths, extra)
    fine = halve_elements(mesh)
    solid = mesh.layer >= 0
    np.testing.assert_array_equal(fine.length_m[fine.layer >= 0], np.repeat(0.5 * mesh.length_m[solid], 2))
    np.testing.assert_array_equal(fine.length_m[fine.layer < 0], mesh.length_m[~solid])
    np.testing.assert_allclose(fine.depth_m[list(fine.sensors)], mesh.depth_m[list(mesh.sensors)], rtol=1e-12)
    assert fine.layer[fine.bondline] == mesh.layer[mesh.bondline]


@given(stacks())
def test_mesh_too_small_for_its_interfaces_is_refused_with_the_least_node_count(stack):
    construction, depths = stack
    fewest = fewest_nodes(construction, depths)
    with pytest.raises(InputError, match=f"use {fewest} or more"):
        build_mesh(construction, depths, fewest - 1)


def test_mesh_is_finest_at_the_surface_in_each_material():
    mesh = build_mesh(practice_model("p06").construction, NO_DEPTHS, 40)
    for layer in (0, 1):
        assert np.all(np.diff(mesh.length_m[mesh.layer == layer]) >= 0.0)
