"""A revised table holds the fit: its ratio along the flown path, with nodes where it bends; what it cannot hold is
named."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sim_heating.base.arrays import FloatArray
from sim_heating.cli import main
from sim_heating.closure.revise.errors import held_fits
from sim_heating.closure.revise.revisions import read_history
from sim_heating.closure.revise.update import prepare_update
from sim_heating.estimation.fit import estimate
from sim_heating.estimation.report.estimate_file import Estimate, read_estimate, write_estimate
from sim_heating.estimation.report.report import estimate_contents
from sim_heating.estimation.starts import STARTS
from sim_heating.heating.ratio.lookup import table_ratios_at
from sim_heating.heating.ratio.table import RatioTable
from sim_heating.heating.ratio.uncertainty import UPDATE_REACH, basis, on_axes, posterior
from sim_heating.inputs.record import Segments, load_record
from sim_heating.inputs.vehicle import load_vehicle
from tests.closure.test_update_tables import POINT, TRUTH, contents, edit, estimate_of, flown_records

__all__ = ["flown_records"]

ONSET_DEG, SLOPE = 38.3, 0.004


def with_onset(onset_deg: float = ONSET_DEG) -> Estimate:
    """The estimate of the first flight with an onset in angle of attack in addition."""
    first = read_estimate("first.json")
    values = {"alpha_onset_deg": (onset_deg, 0.05, "deg"), "slope": (SLOPE, 1e-4, "1/deg")}
    more = {
        f"effect.impingement-onset.{n}": {"value": v, "sigma": s, "unit": unit} for n, (v, s, unit) in values.items()
    }
    effects = [{"name": "impingement-onset", "parameters": {n: v for n, (v, _, _) in values.items()}}]
    data = first.model_dump() | {"parameters": first.model_dump()["parameters"] | more, "effects": effects}
    return Estimate.model_validate(data)


def linear(x: FloatArray, about: FloatArray, declared: FloatArray, values: dict[str, float]) -> FloatArray:
    return declared + basis(tuple(values), x, about, declared) @ np.array(list(values.values()))


# The form of a fit ----------------------------------------------------------------------------------------------------


def test_a_table_is_the_linear_model_of_the_fit_along_the_path(workdir: Path) -> None:
    update = prepare_update("first.json", "./orbiter")
    path, found = update.flight.path, update.estimate
    values = {n: found.parameters[n].value for n in TRUTH}
    expected = linear(path.x, found.reference_condition.values(), path.declared, values)
    np.testing.assert_allclose(table_ratios_at(update.table, path.x), expected, rtol=2e-3)
    assert not update.laminar.nodes_added
    (held,) = held_fits(update).values()
    assert held.after_K < 1.05 * held.fit_K < 1.2 * held.noise_floor_K
    assert held.before_K > 10.0 * held.fit_K
    assert not held.not_held


def test_sigma_along_the_path_is_that_of_the_fit(workdir: Path) -> None:
    update = prepare_update("first.json", "./orbiter")
    flown = update.flight.laminar
    assert flown is not None
    of_fit = np.sqrt(np.sum((flown.basis @ flown.covariance) * flown.basis, axis=1))
    evidence = flown.on(update.table.axes)
    assert update.laminar.after.ratio.size > len(evidence.nodes)
    along = table_ratios_at(replace(update.table, ratio=update.laminar.after.sigma), flown.x)
    before = table_ratios_at(replace(update.table, ratio=update.laminar.before.sigma), flown.x)
    assert np.median(of_fit) < 0.1 * np.median(before)
    assert np.median(along) < 0.5 * np.median(before)


def test_nodes_beyond_the_reach_of_the_flight_keep_ratio_and_sigma(workdir: Path) -> None:
    update = prepare_update("first.json", "./orbiter")
    flown = update.flight.laminar
    assert flown is not None
    old, new = update.history.table, update.table
    assert old.sigma is not None
    assert new.sigma is not None
    nodes = flown.on(new.axes).nodes
    touched = new.axes[2][np.unravel_index(nodes, new.ratio.shape)[2]]
    far = np.abs(new.axes[2][:, None] - touched).min(axis=1) >= UPDATE_REACH["log10_re"]
    assert np.any(far)
    np.testing.assert_array_equal(new.ratio[:, :, far], old.ratio[:, :, far])
    np.testing.assert_array_equal(new.sigma[:, :, far], old.sigma[:, :, far])


# Nodes ----------------------------------------------------------------------------------------------------------------


def test_a_node_by_itself_changes_no_ratio_and_no_sigma() -> None:
    rng = np.random.default_rng(3)
    axes = (np.array([0.0, 20.0, 40.0]), np.array([-4.0, 4.0]), np.array([2.0, 6.0, 8.0]), np.zeros(1), np.zeros(1))
    table = RatioTable(axes, rng.random((3, 2, 3, 1, 1)), 0.1 * rng.random((3, 2, 3, 1, 1)))
    finer = on_axes(table, (np.array([0.0, 20.0, 33.3, 40.0]), axes[1], np.array([2.0, 5.5, 6.0, 8.0]), *axes[3:]))
    assert table.sigma is not None
    assert finer.sigma is not None
    assert finer.ratio.shape == (4, 2, 4, 1, 1)
    np.testing.assert_array_equal(finer.ratio[np.ix_([0, 1, 3], [0, 1], [0, 2, 3])], table.ratio)
    x = rng.uniform([-5.0, -5.0, 1.0, -1.0, -1.0], [45.0, 5.0, 9.0, 1.0, 1.0], (50, 5))
    np.testing.assert_allclose(table_ratios_at(finer, x), table_ratios_at(table, x), rtol=1e-12)
    sigmas = (table_ratios_at(replace(t, ratio=t.sigma), x) for t in (finer, table) if t.sigma is not None)
    np.testing.assert_allclose(*sigmas, rtol=1e-12)
    np.testing.assert_array_equal(posterior(finer, []).ratio, finer.ratio)


@pytest.mark.thorough
def test_an_onset_goes_into_the_table_with_a_node_where_it_is(
    workdir: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = contents(workdir / "orbiter")
    write_estimate("onset.json", with_onset())
    update = prepare_update("onset.json", "./orbiter")
    (place,) = update.laminar.nodes_added["alpha_deg"]
    assert place == pytest.approx(ONSET_DEG, abs=0.1)
    assert update.effects.text == update.effects.raw
    path, found = update.flight.path, update.estimate
    values = {n: found.parameters[n].value for n in TRUTH}
    expected = linear(path.x, found.reference_condition.values(), path.declared, values)
    expected += SLOPE * np.maximum(path.x[:, 0] - ONSET_DEG, 0.0)
    np.testing.assert_allclose(table_ratios_at(update.table, path.x), expected, rtol=5e-3)

    assert main(["update-tables", "onset.json", "--vehicle", "./orbiter"]) == 0
    printed = capsys.readouterr().out
    assert f"a node added in alpha_deg at {place:g}" in printed
    assert "effect.impingement-onset: is in the ratio table" in printed
    history = read_history(load_vehicle("./orbiter"), POINT)
    assert history.revisions[-1].nodes_added == {"alpha_deg": [place]}
    assert main(["update-tables", "second.json", "--vehicle", "./orbiter"]) == 0  # further evidence on the finer grid
    for _ in range(2):
        assert main(["update-tables", "--vehicle", "./orbiter", "--revert", POINT]) == 0
    assert contents(workdir / "orbiter") == before


# What a table cannot hold ---------------------------------------------------------------------------------------------


@pytest.mark.thorough
def test_what_the_tables_do_not_hold_is_named_with_what_it_costs(
    workdir: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # Half of the coating is declared, and the fit has a factor of 2 on it.
    edit(workdir / "first" / "record.toml", lambda text: text.replace("0.000381", "0.0001905"))
    known, record = read_estimate("first.json"), load_record("first")
    C = np.zeros((3, 3))
    C[:2, :2], C[2, 2] = known.covariance(tuple(TRUTH)), 1e-4
    values = {n: p.value for n, p in known.parameters.items()}
    write_estimate("coating.json", estimate_of(record, {**values, "stack.coating.thickness_factor": 2.0}, C))
    (held,) = held_fits(prepare_update("coating.json", "./orbiter")).values()
    assert held.fit_K < 0.5 * held.after_K
    assert not held.is_held
    lost = held.not_held["stack.coating.thickness_factor"]
    assert lost == pytest.approx(np.sqrt(held.after_K**2 - held.fit_K**2), rel=0.05)
    assert main(["update-tables", "coating.json", "--vehicle", "./orbiter"]) == 0
    lines = capsys.readouterr().out
    assert f"{held.after_K:.2f} K with the tables, {held.fit_K:.2f} K with the fit" in lines
    assert f"not in the tables: stack.coating.thickness_factor, {lost:.2f} K" in lines


@pytest.mark.thorough
def test_a_fit_from_a_start_is_compared_from_that_start(workdir: Path) -> None:
    record = load_record("first")
    declared = record.declared.model_copy(update={"segments": Segments(fit=[[85.0, 150.0]])})
    found = estimate(
        [replace(record, declared=declared)], ["ratio.scale", "ratio.d_alpha"],
        starts=[lambda r, model, mesh: STARTS["profile"](r, model, mesh, 85.0)],
    )  # fmt: skip
    fit = estimate_contents(found)
    assert fit.starts is not None
    assert fit.starts[0] is not None
    assert fit.starts[0].time_s == 85.0
    assert fit.fit is not None
    write_estimate("late.json", fit)
    (held,) = held_fits(prepare_update("late.json", "./orbiter")).values()
    assert held.fit_K == pytest.approx(fit.fit.rmse_K, rel=0.01)
    assert held.after_K < 1.15 * held.fit_K
    # Before 85 s the table is as it was, where the flight says nothing; a march from entry brings that along.
    assert held.from_entry_K > held.after_K
