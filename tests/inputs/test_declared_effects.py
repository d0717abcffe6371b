"""Declared transition and recombination of a vehicle and of the records of its points."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sim_heating.base.errors import InputError
from sim_heating.cli import main
from sim_heating.closure.search.trials.candidates import candidates
from sim_heating.estimation.fit import estimate
from sim_heating.heating.effects import EffectUse
from sim_heating.inputs.points import (
    conditions_at_point,
    conditions_of_record,
    point_with_vehicle_table,
    undeclared_effects,
)
from sim_heating.inputs.record import Record, load_record, write_record
from sim_heating.inputs.scenario import load_scenario
from sim_heating.inputs.vehicle import Vehicle, load_vehicle
from sim_heating.simulation.predict import predict
from sim_heating.simulation.run import run
from tests.support.paths import PRACTICE
from tests.support.transition_glide import EARLY, POINT, SCENARIO, made


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> Record:
    return made(tmp_path_factory.mktemp("declared"))


@pytest.fixture(scope="module")
def earlier(tmp_path_factory: pytest.TempPathFactory) -> Record:
    """Its layer turns at Re_theta / M_e of 263; it declares 300 +- 50."""
    return made(tmp_path_factory.mktemp("earlier"), EARLY)


@pytest.fixture(scope="module")
def orbiter() -> Vehicle:
    return load_vehicle("orbiter")


def values(used: EffectUse) -> dict[str, float]:
    return {p.name: v for p, v in zip(used.effect.parameters, used.values, strict=True)}


def test_windward_points_turn_turbulent_by_the_vehicles_criterion_and_the_nose_does_not(orbiter: Vehicle) -> None:
    names = {n: [u.effect.name for u in p.effects] for n, p in orbiter.control_points.items()}
    assert names[POINT] == ["transition", "recombination"]
    assert names["NOSECAP"] == ["recombination"]
    assert names["V07T9975"] == []
    transition = orbiter.control_point(POINT).effects[0]
    assert 10.0 ** values(transition)["log10_re_onset"] == pytest.approx(300.0)
    prior = {p.name: p for p in transition.definitions}["log10_re_onset"]
    assert (prior.value, prior.sigma) == (pytest.approx(np.log10(300.0)), pytest.approx(50.0 / 300.0 / np.log(10.0)))


def test_a_record_carries_what_its_point_declares(record: Record, orbiter: Vehicle) -> None:
    point = orbiter.control_point(POINT)
    own, its = record.declared.heating.effects, point.effects
    assert [u.effect.name for u in own] == [u.effect.name for u in its]
    for a, b in zip(own, its, strict=True):
        assert a.values == pytest.approx(b.values, rel=1e-9)
        assert [p.sigma for p in a.definitions] == pytest.approx([p.sigma for p in b.definitions], rel=1e-9)
    assert record.turbulent is not None
    np.testing.assert_array_equal(record.turbulent.ratio, point.flow.turbulent.ratio)  # type: ignore[union-attr]


def test_a_record_sees_the_flow_that_its_point_saw(record: Record, orbiter: Vehicle) -> None:
    flown = conditions_of_record(record)
    at_point = conditions_at_point(orbiter, orbiter.control_point(POINT), record.conditions)
    for column in ("turbulent_ratio", "log10_re_theta_m", "dissociation_J_kg", "H_r_rise_J_kg"):
        assert column not in record.conditions or column == "H_r_rise_J_kg"
        np.testing.assert_allclose(flown[column], at_point[column], rtol=1e-9)
    assert np.all((flown["turbulent_ratio"] > 3.0) & (flown["turbulent_ratio"] < 8.0))


def test_the_declared_model_predicts_the_record_of_its_own_flight(record: Record) -> None:
    errors = predict(record).segment_errors()["fit"]
    assert errors["rmse_K"] < 1.1 * record.noise_floor_K()


@pytest.mark.thorough
def test_an_onset_that_differs_from_its_declaration_is_found_by_a_fit(earlier: Record) -> None:
    before = predict(earlier).segment_errors()["fit"]["rmse_K"]
    fit = estimate(earlier, ["effect.transition.log10_re_onset"])
    value, sigma = fit.parameters["effect.transition.log10_re_onset"]
    assert before > 10.0 * earlier.noise_floor_K()
    assert abs(value - 2.42) < 4.0 * sigma + 1e-3


def test_the_search_for_transition_frees_the_declared_one(record: Record) -> None:
    found = [c for c in candidates(record, conditions_of_record(record)) if c.name == "transition"]
    declared = record.declared.heating.effects[0]
    assert found[0].uses == (declared,)
    assert found[0].start["effect.transition.log10_re_onset"] == pytest.approx(np.log10(300.0))
    assert {n.rpartition(".")[2] for n in found[0].names} == {"log10_re_onset", "alpha_sens", "width", "factor"}
    onsets = [c.start["effect.transition.log10_re_onset"] for c in found]
    assert min(onsets) < 2.45 < max(onsets)


def test_recombination_is_no_candidate(record: Record) -> None:
    assert "recombination" not in {c.name for c in candidates(record, conditions_of_record(record))}


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("re_theta_over_m_e =", "re_theta_over_m =", "unknown key `re_theta_over_m`"),
        ("width = 0.03", "width = 30.0", r"`width`: 30 is not a width in log10 Re"),
        ('ratio_table_turbulent = "ratio_table_turbulent.csv"', "", "name the turbulent table, or give `factor`"),
        ("running_length_m = 19.33", "", "needs the edge of the point"),
        ("factor = 16.0", "factor = -16.0", "factor"),
        ("factor = 16.0", "factor = 1e10", r"record.toml.*catalysis.*1e\+10 is outside its bounds"),
    ],
)
def test_a_wrong_declaration_gets_a_line(record: Record, tmp_path: Path, old: str, new: str, message: str) -> None:
    for file in record.directory.iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    text = (tmp_path / "record.toml").read_text()
    if old == 'ratio_table_turbulent = "ratio_table_turbulent.csv"':
        text = "\n".join(line for line in text.splitlines() if not line.startswith(("factor =", "factor_sigma")))
    assert old in text
    (tmp_path / "record.toml").write_text(text.replace(old, new))
    with pytest.raises(InputError, match=message):
        load_record(tmp_path)


@pytest.mark.thorough
def test_a_scenario_can_leave_declared_transition_out(record: Record, tmp_path: Path) -> None:
    laminar = made(tmp_path, "[heating]\ntransition = false\n")
    assert [u.effect.name for u in laminar.declared.heating.effects] == ["recombination"]
    assert laminar.turbulent is None
    cooler = record.temperatures_K()[0, -1] - laminar.temperatures_K()[0, -1]
    assert cooler > 100.0
    assert predict(laminar).segment_errors()["fit"]["rmse_K"] < 1.1 * laminar.noise_floor_K()


@pytest.mark.thorough
def test_a_flight_may_turn_turbulent_by_the_table_where_its_record_declares_it_laminar(tmp_path: Path) -> None:
    found = made(tmp_path, "[heating]\ntransition = false\n" + EARLY)
    assert [u.effect.name for u in found.declared.heating.effects] == ["recombination"]
    assert predict(found).segment_errors()["fit"]["rmse_K"] > 50.0


def test_walls_without_declared_recombination_are_fully_catalytic_and_hotter(tmp_path: Path) -> None:
    (tmp_path / "glide.toml").write_text(SCENARIO)
    (tmp_path / "fully.toml").write_text(SCENARIO + "[heating]\ncatalysis = false\n")
    with_atoms, fully = (run(tmp_path / f"{name}.toml").points[POINT] for name in ("glide", "fully"))
    assert [u.effect.name for u in fully.model.effects] == ["transition"]
    assert np.max(fully.history.surface_K - with_atoms.history.surface_K) > 1.0


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (
            '[heating]\ntransition = false\n[[effect]]\nname = "transition"\n',
            r"`transition` = false leaves out what \[\[effect\]\] 1 declares",
        ),
        ('[heating]\ntransition = "no"\n', r"\[heating\]: `transition`"),
        (
            '[[truth.effect]]\nname = "transition"\nparameters = { by_table = 1.0 }\n',
            "does nothing at V07T9975, which declares no .transition. with `ratio_table_turbulent`",
        ),
        ('[[effect]]\nname = "recombination"\n', "does nothing at V07T9975, which declares no .catalysis."),
    ],
)
def test_a_contradiction_and_an_effect_without_its_declaration_get_a_line(
    tmp_path: Path, more: str, message: str
) -> None:
    (tmp_path / "glide.toml").write_text(SCENARIO.replace(f'["{POINT}"]', '["V07T9975"]') + more)
    with pytest.raises(InputError, match=message):
        load_scenario(tmp_path / "glide.toml")


@pytest.fixture(scope="module")
def silent(record: Record) -> Record:
    """The record without the transition and the recombination that its vehicle declares at its point."""
    heating = record.declared.heating.model_copy(update={"transition": None, "catalysis": None})
    return replace(record, declared=record.declared.model_copy(update={"heating": heating}), turbulent=None)


def test_the_vehicles_table_and_effects_predict_a_record_that_declares_none(silent: Record, orbiter: Vehicle) -> None:
    assert predict(silent).segment_errors()["fit"]["rmse_K"] > 50.0
    model, flow = point_with_vehicle_table(silent, orbiter)
    assert predict(silent, model, flow=flow).segment_errors()["fit"]["rmse_K"] < 1.1 * silent.noise_floor_K()


@pytest.mark.thorough
def test_a_record_that_declares_less_than_its_vehicle_gets_one_line(
    record: Record, silent: Record, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert undeclared_effects(record) is None
    line = undeclared_effects(silent)
    assert line is not None
    assert r"declares no [heating.transition] and no [heating.catalysis], which orbiter has at STS96_480" in line
    write_record(silent, tmp_path / "record")
    assert main(["predict", str(tmp_path / "record"), "--out", str(tmp_path / "out")]) == 0
    assert "declares no [heating.transition]" in " ".join(capsys.readouterr().out.split())
    assert line in estimate(silent, ["ratio.scale"]).warnings


def test_only_a_control_point_that_the_program_knows_is_compared(record: Record, silent: Record) -> None:
    for change in ({"control_point": "LS"}, {"vehicle": "X-15"}, {"vehicle": "../orbiter"}, {"vehicle": ""}):
        assert undeclared_effects(replace(silent, declared=silent.declared.model_copy(update=change))) is None
    for folder in sorted(PRACTICE.glob("p*")):
        assert undeclared_effects(load_record(folder)) is None
