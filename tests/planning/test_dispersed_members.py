"""Dispersions of a set of estimates that the evidence cannot tell apart: one member a flight, drawn by its weight."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from sim_heating import cli
from sim_heating.estimation.report.estimate_file import read_estimate, write_estimate
from sim_heating.inputs.points import conditions_at_point
from sim_heating.planning.bands import spreads
from sim_heating.planning.dispersion.entry import SOBOL, Batch, DispersedEntry
from sim_heating.planning.dispersion.input_checks import check_inputs
from sim_heating.planning.study import load_study
from sim_heating.trajectory.flight import conditions_from_rows
from tests.support.paths import ROOT, SCENARIOS
from tests.support.studies import pod_dispersion

pytest.importorskip("pyarrow", reason="dispersions need pyarrow: pip install 'sim-heating[plan]'")

POINT = "V07T9975"
FLIGHTS = 64
SCALES = {"hot": 0.06, "cold": 0.05}
STUDY = pod_dispersion("Two estimates of one pod", FLIGHTS)


def study_with(tmp_path: Path, weights: dict[str, float], inputs: str = "") -> Path:
    """A study whose members are estimates of `ratio.scale` and `ratio.d_alpha` at POINT, by these weights."""
    shipped = read_estimate(ROOT / "docs" / "reference" / "formats" / "examples" / "estimate.json")
    members = ""
    for name, weight in weights.items():
        parameters = dict(shipped.parameters)
        parameters["ratio.scale"] = parameters["ratio.scale"].model_copy(update={"value": SCALES[name]})
        moved = {"control_point": POINT, "records": [str(SCENARIOS / "records" / "practice" / "p06")], "inputs": {}}
        write_estimate(tmp_path / f"{name}.json", shipped.model_copy(update=moved | {"parameters": parameters}))
        members += f'[[dispersion.member]]\nestimate = "{name}.json"\nweight = {weight}\n'
    path = tmp_path / "study.toml"
    path.write_text(STUDY + members + inputs)
    return path


def entry_with(tmp_path: Path, weights: dict[str, float], inputs: str = "") -> DispersedEntry:
    return DispersedEntry(load_study(study_with(tmp_path, weights, inputs)))


@pytest.mark.thorough
def test_flights_draw_their_member_by_its_weight(tmp_path: Path) -> None:
    """Three of four have the hotter one; what the vehicle declares elsewhere is hit by neither."""
    entry = entry_with(tmp_path, {"hot": 3.0, "cold": 1.0})
    flown = entry.fly(Batch(SOBOL, 0, FLIGHTS))
    hot = flown["member"] == 0.0
    assert np.count_nonzero(hot) == 48
    peaks = flown[f"surface_K.{POINT}"]
    planned = entry.planned_peaks[:, 0, 0]
    assert planned[0] > planned[1]
    assert np.mean(peaks[hot]) == pytest.approx(planned[0], abs=0.1 * (planned[0] - planned[1]))
    assert np.mean(peaks[~hot]) == pytest.approx(planned[1], abs=0.1 * (planned[0] - planned[1]))
    assert np.ptp(flown["surface_K.WING_LE"]) == 0.0


@pytest.mark.thorough
def test_draws_of_an_estimate_have_the_sigma_that_its_band_has(tmp_path: Path) -> None:
    entry = entry_with(tmp_path, {"hot": 1.0})
    flown = entry.fly(Batch(SOBOL, 0, FLIGHTS))
    vehicle, point = entry.study.vehicle, entry.points[0].point
    rows = entry.planned.rows[0, : entry.planned.frame_counts[0]]
    path = conditions_at_point(vehicle, point, conditions_from_rows(rows, vehicle.reference_length_m))
    only = entry.members.each[0]
    band = spreads(only.declared[0], path, only.member, heating=None, with_table=False)[0]
    assert np.std(flown[f"surface_K.{POINT}"]) == pytest.approx(band.sources["estimate"], rel=0.1)


@pytest.mark.thorough
def test_an_estimate_stands_in_place_of_the_studys_own_input(tmp_path: Path) -> None:
    own = '[[dispersion.input]]\nname = "ratio.scale"\nsigma = 0.0001\n'
    entry = entry_with(tmp_path, {"hot": 1.0}, own)
    assert [[place.point for place in places] for places in entry.marches[0].places] == [[1]]
    check_inputs(entry)


@pytest.mark.thorough
def test_page_and_study_json_state_members_weights_and_draws(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    study, out = study_with(tmp_path, {"hot": 3.0, "cold": 1.0}), tmp_path / "out"
    assert cli.main(["plan", str(study), "--workers", "1", "--out", str(out)]) == 0
    dispersion = json.loads((out / "study.json").read_text())["dispersion"]
    assert dispersion["members"] == [
        {"estimate": "hot.json", "control_point": POINT, "weight": 3.0, "share": 0.75, "flights": 48},
        {"estimate": "cold.json", "control_point": POINT, "weight": 1.0, "share": 0.25, "flights": 16},
    ]
    assert "members" in dispersion["inputs"]
    cells = re.findall(r"<td[^>]*>([^<]*)</td>", (out / "report.html").read_text())
    at = cells.index("hot.json")
    assert cells[at : at + 5] == ["hot.json", POINT, "3", "75 %", "48"]
    assert "hot.json" in capsys.readouterr().out
    scatter = dispersion["peaks"][0]["first_order"]["variance_share"]["members"]
    assert scatter == pytest.approx(1.0, abs=1e-6)


def test_a_member_that_is_not_there_is_refused_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    (tmp_path / "study.toml").write_text(STUDY + '[[dispersion.member]]\nestimate = "gone.json"\n')
    assert cli.main(["plan", str(tmp_path / "study.toml"), "--out", str(tmp_path / "out")]) == 2
    errors = [line for line in capsys.readouterr().err.splitlines() if line.startswith("error:")]
    assert len(errors) == 1
    assert "study.toml, [[dispersion.member]] 1: `estimate`: the file" in errors[0]
