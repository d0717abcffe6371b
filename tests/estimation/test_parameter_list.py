"""The list of parameters: all that exist, each with its bound from a record, as a fit then finds it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sim_heating.cli import main
from sim_heating.estimation.inference.identifiability import covariance
from sim_heating.estimation.inference.observability import default_names
from sim_heating.estimation.parameter_list import (
    ParameterList,
    contents,
    parameter_list,
    parameter_tables,
    scenario_parameters,
)
from sim_heating.estimation.problem import FitProblem, joint_reference
from sim_heating.inputs.record import load_record
from sim_heating.inputs.scenario import load_scenario
from tests.support.json_output import run_json
from tests.support.paths import BOARD, PRACTICE, SCENARIOS, TILE

COATING = "stack.coating.thickness_factor"


@pytest.fixture(scope="module")
def listed() -> ParameterList:
    return parameter_list(PRACTICE / "p06")


def test_stated_bound_is_that_with_the_default_heating() -> None:
    record = load_record(TILE)
    names = ["ratio.scale", "ratio.d_alpha", "ratio.d_logre", COATING]
    problem = FitProblem([record], names, joint_reference([record]))
    bound = np.sqrt(covariance(problem.evaluate(np.array([0.0, 0.0, 0.0, 1.0])).information)[3, 3])
    # the list has the clock among its parameters, for which samples within 5 s of the ends are left out
    assert parameter_list(record)[COATING].sigma_with_heating == pytest.approx(bound, rel=0.1)


def test_a_parameter_is_confounded_with_what_acts_alike(listed: ParameterList) -> None:
    near = dict(listed[COATING].confounded_with)
    assert near["stack.coating.heat_capacity_factor"] > 0.95  # a thin coating is a heat capacity to a slow heating
    assert listed[COATING].identified == "with others known"
    emittance = dict(listed["ratio.scale"].confounded_with)
    assert emittance["stack.emissivity_factor"] < -0.95  # a hot wall radiates what it takes in


def test_each_further_unknown_makes_a_bound_larger(listed: ParameterList) -> None:
    for p in listed.parameters:
        if p.sigma_alone is not None:
            assert p.sigma_with_heating is not None
            assert p.sigma_with_all is not None
            assert p.sigma_alone <= 1.0001 * p.sigma_with_heating <= 1.0002 * p.sigma_with_all


def test_what_cannot_be_identified_states_why(listed: ParameterList) -> None:
    assert listed["stack.moisture.boil_K"].identified == "no"
    assert "no reading depends on it" in listed["stack.moisture.boil_K"].reason  # nothing boils that is not there


def test_lamp_test_lists_its_layers_and_one_line_for_what_it_lacks() -> None:
    lamp = parameter_list(BOARD)
    assert lamp["ratio.d0"].identified == "no"
    assert "h_ref is 0 throughout" in lamp["ratio.d0"].reason
    tables = {t.title: t for t in parameter_tables([lamp])}
    (row,) = tables["Heating ratio"].rows
    assert row[0] == "ratio.d0 to ratio.d_logre2, all 10"
    own = [p for p in lamp.parameters if p.belongs_to.startswith("layer ")]
    assert not any(p.name.startswith("stack.rsi.") or "insulation" in p.belongs_to for p in own)
    conductivity = lamp["stack.rsi.conductivity_factor"]  # the role is still a name of it
    assert conductivity.name == f"stack.{conductivity.belongs_to.split()[1].strip(',')}.conductivity_factor"


def test_undeclared_noise_is_that_of_the_readings_not_the_misfit() -> None:
    """p08 lacks an effect: the misfit of its declared model is several times the noise of its readings."""
    declared = load_record(PRACTICE / "p08")
    silent = declared.with_sensors([s.model_copy(update={"noise_sigma_K": None}) for s in declared.sensors])
    known, found = parameter_list(declared), parameter_list(silent)
    assert found["ratio.d_alpha"].sigma_alone == pytest.approx(known["ratio.d_alpha"].sigma_alone, rel=0.3)


def test_a_layer_is_found_by_its_own_name_and_by_its_role(listed: ParameterList) -> None:
    assert listed["stack.li900.conductivity_factor"] is listed["stack.rsi.conductivity_factor"]
    assert listed["stack.rsi.conductivity_factor"].belongs_to == "layer li900, the insulation"
    with pytest.raises(KeyError):
        listed["stack.li901.conductivity_factor"]


def test_every_listed_name_can_be_estimated(listed: ParameterList) -> None:
    record = load_record(PRACTICE / "p06")
    names = [p.name for p in listed.parameters]
    assert len(names) == len(set(names))
    problem = FitProblem([record], names, joint_reference([record]))
    for unknown, p in zip(sorted(problem.unknowns, key=lambda u: names.index(u.label)), listed.parameters, strict=True):
        assert (unknown.parameter.unit, unknown.parameter.value) == (p.unit, p.nominal)
        assert (unknown.parameter.lower, unknown.parameter.upper) == (p.lower, p.upper)


def test_a_scenario_lists_what_its_control_points_have_in_common_once() -> None:
    lists = scenario_parameters(load_scenario(SCENARIOS / "entry_3dof.toml"), effects=["transition"])
    titles = [table.title for table in parameter_tables(lists)]
    assert titles.count(f"Heating ratio: all {len(lists)} control points") == 1
    assert any(title.startswith("Effect transition") for title in titles)
    assert all(p.identified is None for found in lists for p in found.parameters)


@pytest.mark.thorough
def test_the_command_writes_what_it_prints(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = run_json(capsys, "parameters", str(BOARD), "--out", str(tmp_path / "out"))
    written = json.loads((tmp_path / "out" / "parameters.json").read_text())
    assert found["results"] == written
    rows = (tmp_path / "out" / "parameters.csv").read_text().splitlines()
    assert len(rows) == 1 + len(written["lists"][0]["parameters"])
    assert written["lists"] == contents([parameter_list(BOARD)])["lists"]


def test_a_point_of_a_record_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["parameters", str(BOARD), "--point", "A"]) == 2
    assert "is for scenarios" in capsys.readouterr().err


def test_vehicle_without_control_surfaces_has_no_derivative_to_them() -> None:
    """Neither of a scenario nor of a record; a surface that moved, or that the table knows, has its derivatives."""
    flown = load_record(PRACTICE / "p06")
    still = flown.conditions.with_columns(
        elevon_deg=0.0 * flown.conditions.time_s, bodyflap_deg=0.0 * flown.conditions.time_s
    )
    capsule = replace(flown, conditions=still, ratio_table=None)
    names = [p.name for p in parameter_list(capsule).parameters]
    assert "ratio.d_alpha" in names
    assert not [n for n in names if "elevon" in n or "bodyflap" in n]
    assert default_names([capsule]) == ("ratio.d0", "ratio.d_alpha", "ratio.d_beta", "ratio.d_logre")
    (of_face,) = [
        p for p in scenario_parameters(load_scenario(SCENARIOS / "capsule.toml")) if p.control_point == "FACE"
    ]
    assert not [p.name for p in of_face.parameters if "elevon" in p.name or "bodyflap" in p.name]
    assert "ratio.d_elevon" in default_names([replace(flown, conditions=still)])
    assert "ratio.d_elevon" in default_names([replace(flown, ratio_table=None)])
