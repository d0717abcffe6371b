"""Tables of the insulation that are off by one factor below some temperature or pressure, and by another above it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from sim_heating.closure.close import refit
from sim_heating.closure.result import ParameterEstimate
from sim_heating.closure.search.changes.property_shapes import (
    CONDUCTIVITY,
    HEAT_CAPACITY,
    PRESSURE,
    TEMPERATURE,
    shape_changes,
    with_shape,
)
from sim_heating.closure.search.changes.record_change import fit_changes
from sim_heating.closure.search.hypothesis import change_hypothesis, conclude, hypothesis, scored
from sim_heating.closure.search.ranking import SearchRound
from sim_heating.closure.search.search import SearchResult
from sim_heating.closure.search.trials.trial_fit import base_trial, declared_fit
from sim_heating.closure.statement import change_parameters
from sim_heating.inputs.record import Record
from sim_heating.thermal.mesh import layer_diffusivities
from tests.closure.test_close_loop import simulated_record
from tests.support.walls import practice_record

TILE = practice_record("p06")[0]
"""An LI-900 tile, whose conductivity has pressures, with sensors under the coating and on the skin."""


def flown_with(change: float, **shape: Any) -> Record:
    """The tile as declared, with readings of one whose table is off."""
    return replace(TILE, thermocouples=simulated_record(with_shape(TILE, change, **shape)).thermocouples)


def conductivity_ratio(span: tuple[float, float], change: float, T_K: float, p_Pa: float) -> float:
    """Changed over declared conductivity of the insulation, along the axis that the span is of."""
    axis = PRESSURE if span[1] < 10.0 else TEMPERATURE
    materials = (
        r.construction.layer_materials()[1]
        for r in (TILE, with_shape(TILE, change, effect=CONDUCTIVITY, axis=axis, span=span))
    )
    before, after = (
        np.interp(T_K, T, [np.interp(np.log10(p_Pa), np.log10(p), row) for row in k])
        for p, T, k in (m.conductivity_grid() for m in materials)
    )
    return float(after / before)


def test_a_property_is_as_declared_at_the_middle_and_off_by_its_change_from_end_to_end():
    below, above = (conductivity_ratio((600.0, 800.0), 0.2, T_K, 1e3) for T_K in (400.0, 1000.0))
    assert (below, above) == (pytest.approx(0.9), pytest.approx(1.1))
    below, above = (conductivity_ratio((2.0, 4.0), 0.2, 700.0, p_Pa) for p_Pa in (50.0, 2e4))
    assert (below, above) == (pytest.approx(0.9), pytest.approx(1.1))


@pytest.mark.parametrize("change", shape_changes(TILE)[::3], ids=lambda c: f"{c.what} {c.ends}")
def test_the_mesh_of_the_search_is_the_same_for_any_change(change):
    changed = change.apply(TILE, 0.3)
    assert layer_diffusivities(changed.construction) == pytest.approx(layer_diffusivities(TILE.construction), rel=1e-12)
    assert changed.construction.layer_materials()[2:] == TILE.construction.layer_materials()[2:]


@pytest.mark.thorough
def test_a_table_that_is_off_by_two_factors_is_recognised_by_them_and_the_last_fit_has_both():
    span = (400.0, 600.0)
    declared = flown_with(-0.3, effect=HEAT_CAPACITY, axis=TEMPERATURE, span=span)
    own = [c for c in shape_changes(declared) if c.effect == HEAT_CAPACITY]
    before = declared_fit(declared)
    base = base_trial(before)
    (found,) = fit_changes(base, own)
    assert found.excess_chi2 < 0.1
    assert found.value == pytest.approx(-0.3, rel=0.3)
    assert [end for end, _ in found.change.ends.values()] == pytest.approx(span, rel=0.2)

    none, of_change = hypothesis([base], {}), change_hypothesis(found, len(own))
    rated = scored(none, [of_change])
    result = SearchResult(declared, before, SearchRound(base, (), {}), none, tuple(rated), conclude(none, rated))
    assert result.names == (HEAT_CAPACITY,)
    last = refit(result)
    assert "stack.rsi.heat_capacity_factor" in last.labels
    factor = ParameterEstimate(1.0, 0.01, "1")
    reported = change_parameters(found, {"stack.rsi.heat_capacity_factor": factor})
    assert list(reported) == [
        "heat_capacity_change", "heat_capacity_factor", "heat_capacity_from_K", "heat_capacity_to_K",
    ]  # fmt: skip


def test_a_change_leaves_a_twentieth_of_the_property_at_least():
    for span in TEMPERATURE.spans:
        for change in TEMPERATURE.limits(span):
            least = np.min(1.0 + change * TEMPERATURE.shape(np.linspace(100.0, 2000.0, 500), span))
            assert least >= 0.05 - 1e-12
