"""The error of a mesh that is found beside a filter is the distance to a mesh that is eight times as fine."""

from __future__ import annotations

import numpy as np
import pytest

from sim_heating.estimation.filter.mesh_error import MeshError
from sim_heating.inputs.points import conditions_of_record
from sim_heating.march.ensemble import Ensemble, condition_history
from sim_heating.march.mesh_choice import mesh_of_nodes
from sim_heating.march.point import initial_temperatures
from sim_heating.thermal.mesh import halve_elements
from tests.support.walls import practice_model, practice_record

NAMES, NODES, STEP_S = ("p06", "p07"), 24, 2.0


@pytest.fixture(scope="module")
def marched():
    """Two points at the end of part of their flights: error beside the march, march itself, and on a fine mesh."""
    models = [practice_model(n) for n in NAMES]
    meshes = [mesh_of_nodes(m, NODES, STEP_S) for m in models]
    fine = [halve_elements(halve_elements(halve_elements(mesh))) for mesh in meshes]
    flights = [conditions_of_record(practice_record(n)[0]) for n in NAMES]
    time_s = np.arange(0.5, 700.0, STEP_S)
    histories = np.stack([condition_history(f.at(time_s)) for f in flights])
    error = MeshError(models, meshes)
    error.begin(
        models,
        [initial_temperatures(m.construction, mesh) for m, mesh in zip(models, meshes, strict=True)],
        histories[:, 0],
    )
    for k in range(1, len(time_s)):
        error.advance(histories[:, k], STEP_S)
    ends = [Ensemble(models, own) for own in (meshes, fine)]
    for ensemble in ends:
        ensemble.march(time_s, histories)
    return error, meshes, *ends


@pytest.mark.parametrize("i", range(len(NAMES)))
def test_the_error_is_the_distance_to_a_fine_mesh(marched, i):
    error, meshes, coarse, fine = marched
    true = fine.node_temperatures(i)[_at(meshes[i])] - coarse.node_temperatures(i)
    assert np.max(np.abs(true)) > 0.3  # there is something to find
    assert np.max(np.abs(error.of_nodes()[i] - true)) < 0.1 * np.max(np.abs(true))


def _at(mesh):
    """Nodes of a mesh on the one that is eight times as fine; a contact stays one element."""
    return np.concatenate([[0], np.cumsum(np.where(mesh.layer < 0, 1, 8))])


def test_a_state_that_is_written_back_goes_on_with_the_same_bits(marched):
    error, *_ = marched
    last = np.stack([condition_history(conditions_of_record(practice_record(n)[0]).at([700.0]))[0] for n in NAMES])
    kept, found = error.state.copy(), []
    for _ in range(2):
        error.state[:] = kept
        error.advance(last, STEP_S)
        found.append(error.of_nodes()[0])
    error.state[:] = kept
    np.testing.assert_array_equal(*found)
    assert not np.array_equal(found[0], error.of_nodes()[0])
