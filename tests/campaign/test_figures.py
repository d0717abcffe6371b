"""The founding paper's figures over a short flight: what is drawn can be read, is in the CSVs, and is the flight's."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sim_heating.base.errors import InputError, LeftOutWarning
from sim_heating.base.report.figure import mark_beyond, new_figure
from sim_heating.campaign.figures.flown_data import POPU, FlownData, LeftOut
from sim_heating.campaign.figures.histories import axial_step
from sim_heating.campaign.figures.paper import DRAWINGS, PaperFigures, draw_figures, write_figures
from sim_heating.campaign.figures.segments import reynolds_trend
from sim_heating.campaign.flights import CampaignFlight, read_flights
from sim_heating.cli import main
from sim_heating.estimation.report.plots import fit_figure
from sim_heating.inputs.record import load_record
from sim_heating.simulation.predict import predict
from tests.support.figures import named_lines, named_lines_out_of_sight, unmarked_points
from tests.support.gliding import gliding
from tests.support.paths import PRACTICE, SCENARIOS, TILE

ONSET_DEG = 37.0
TUNNEL = SCENARIOS / "records" / "tunnel_plate"
GLIDE = f"""{gliding(130.0, "V09T9527", "V07T9730", "V07T9975", altitude_m=72000.0, velocity_m_s=6420.0)}
[[trajectory.manoeuvre]]
kind = "bodyflap-sweep"
at_time_s = 30.0
from_deg = 5.0
to_deg = -12.0
rate_deg_s = 3.0
hold_s = 3.0
[[trajectory.manoeuvre]]
kind = "popu"
at_time_s = 80.0
down_deg = 5.0
up_deg = 5.0
rate_deg_s = 1.5
hold_s = 2.0
[truth]
[[truth.effect]]
name = "impingement-onset"
control_points = ["V07T9975"]
parameters = {{ alpha_onset_deg = 30.0, slope = -0.0012 }}
window = {{ name = "tunnel", variable = "alpha_deg", low = 20.0, high = 60.0 }}
[[truth.effect]]
name = "impingement-onset"
control_points = ["V07T9975"]
parameters = {{ alpha_onset_deg = {ONSET_DEG}, slope = 0.002 }}
"""
GIVEN = [1, 2, 3, 4, 5, 8, 10, 12, 13, 14, 15, 16]
"""Figures that a flap manoeuvre and a POPU near 20,000 ft/s give."""


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> CampaignFlight:
    """A glide through a flap manoeuvre and a POPU, measured."""
    path = tmp_path_factory.mktemp("glide") / "glide.toml"
    path.write_text(GLIDE)
    return read_flights([path])[0]


@pytest.fixture(scope="module")
def figures(flight: CampaignFlight) -> PaperFigures:
    """All that the glide gives."""
    return draw_figures([flight])


def test_a_flight_gives_its_figures_and_the_reason_for_each_other_one(figures: PaperFigures) -> None:
    assert [f.number for f in figures.drawn] == GIVEN
    assert set(figures.left_out) == set(DRAWINGS) - set(GIVEN)
    assert figures.left_out[6].startswith("no pushover-pullup near Mach 12")
    for figure in figures.drawn:
        title = figure.figure.get_suptitle()
        assert title.replace("\n", " ").startswith(f"Figure {figure.number}: ")


def test_what_a_legend_names_is_seen_and_what_leaves_the_axes_is_marked(figures: PaperFigures) -> None:
    for figure in figures.drawn:
        assert named_lines_out_of_sight(figure.figure) == [], figure.title
        assert unmarked_points(figure.figure) == [], figure.title


@pytest.mark.thorough
def test_the_csvs_hold_what_is_drawn(figures: PaperFigures, tmp_path: Path) -> None:
    names = write_figures(figures, tmp_path)
    found = json.loads((tmp_path / "figures.json").read_text())
    for figure in figures.drawn:
        assert set(figure.files) == set(found["figures"][str(figure.number)]["files"]) <= set(names)
        if figure.number in (1, 2, 3, 15):  # of words and places
            continue
        columns = [column for name in figure.files[1:] for column in read_columns(tmp_path / name)]
        for _, line in named_lines(figure.figure):
            y = np.asarray(line.get_ydata(), dtype=float)
            assert any(_holds(column, y) for column in columns), (figure.title, line.get_label())


def read_columns(path: Path) -> list[np.ndarray]:
    """Columns of a CSV of numbers; an empty cell is a sample that is not there."""
    return list(np.genfromtxt(path, delimiter=",", skip_header=2, names=True, unpack=True))


def _holds(column: np.ndarray, y: np.ndarray) -> bool:
    """Whether a column holds the values of a line, all of them or the first of them."""
    return len(column) >= len(y) and np.allclose(column[: len(y)], y, rtol=1e-6, equal_nan=True)


def test_the_onset_of_impingement_is_that_of_the_flight(figures: PaperFigures) -> None:
    """The wind tunnel's table rises from 30 deg; the flight's own rise was put in above 37 deg in its place."""
    found = figures.drawn[GIVEN.index(14)]
    assert found.notes[0] == "declared table: rises from 30 deg"
    text = found.notes[1].partition("onset ")[2].split()
    assert abs(float(text[0]) - ONSET_DEG) < 3.0 * float(text[2]) < 3.0
    onset, skew, coating = found.statements
    assert onset.observed
    assert not skew.observed  # this pod has no lag and the coating that it declares
    assert not coating.observed


def test_the_statements_are_counted_and_each_names_its_figure(figures: PaperFigures) -> None:
    said = figures.summary()["statements"]
    assert {s["figure"] for s in said} <= set(GIVEN)
    assert figures.count.startswith(f"{sum(s['verdict'] == 'observed' for s in said)} of {len(said)} statements")
    known = {s["statement"] for s in said}
    assert {60, 74, 80, 87, 91, 92} <= known


def test_a_step_of_the_axial_force_is_seen_at_its_angle(flight: CampaignFlight) -> None:
    record, popu = flight.records["V09T9527"], flight.manoeuvres[-1]
    flown, span = record.conditions, (popu.start_s, popu.end_s)
    smooth = axial_step(record, span)
    assert smooth is not None
    assert abs(smooth.relative) < 0.02
    turned = flown["axial_accel_g"] * (1.0 + 0.08 * (flown["alpha_deg"] > 43.0))
    step = axial_step(replace(record, conditions=flown.with_columns(axial_accel_g=turned)), span)
    assert step is not None
    assert step.relative == pytest.approx(0.08, abs=0.02)
    assert step.alpha_deg == pytest.approx(43.0, abs=1.0)


def test_jets_that_fire_are_an_input_of_a_fit(flight: CampaignFlight) -> None:
    data = FlownData([flight])
    flown = data.manoeuvre("lower", POPU, 20.0)
    assert data.jet_names(flown) == ()
    t = flown.record.conditions.time_s
    fires = np.where((t > flown.manoeuvre.start_s) & (t < flown.manoeuvre.start_s + 4.0), 1.0, 0.0)
    record = replace(flown.record, conditions=flown.record.conditions.with_columns(jets=fires))
    assert data.jet_names(replace(flown, record=record)) == ("effect.jet-interaction.jet_gain",)


@pytest.mark.thorough
def test_a_lag_in_the_tunnel_is_told_from_its_interface() -> None:
    """The truth lags by 3 s and has the coating that the record declares; the interface alone makes no such lag."""
    (found,) = draw_figures([TUNNEL], [18]).drawn
    coating, lag, interface = found.statements
    assert coating.observed
    assert lag.observed
    assert not interface.observed
    assert named_lines_out_of_sight(found.figure) == []


@pytest.mark.thorough
def test_the_trend_in_segments_is_that_of_the_table_over_either_reference(flight: CampaignFlight) -> None:
    """The truth is the declared table; over Eckert's plate table and estimate change alike."""
    both = reynolds_trend(FlownData([flight]), mach=20.0)
    assert named_lines_out_of_sight(both.figure) == []
    found = {name: np.asarray(values) for name, values in both.tables[""].items()}
    for name in ("stagnation", "eckert_turbulent"):
        error = (found[f"{name}_ratio"] - found[f"{name}_table"]) / found[f"{name}_sigma"]
        assert np.mean(np.abs(error) < 2.5) > 0.8
    assert np.all(found["eckert_turbulent_ratio"] > found["stagnation_ratio"])
    alone = reynolds_trend(FlownData([flight], reference="eckert-turbulent"), mach=20.0)
    assert len(alone.figure.axes) == 1
    assert not any(name.startswith("stagnation") for name in alone.tables[""])


@pytest.mark.thorough
def test_a_point_that_does_not_respond_to_the_elevon_is_said_not_to(flight: CampaignFlight) -> None:
    found = draw_figures([flight], [12], points={"elevon": "V09T9527"}).drawn[0]
    assert any("no significant response" in note or "no response" in note for note in found.notes)


def test_a_flight_without_manoeuvres_gives_reasons(flight: CampaignFlight) -> None:
    still = replace(flight, manoeuvres=())
    found = draw_figures([still], [4, 5, 8, 9, 10, 12, 14])
    assert not found.drawn
    assert all("no " in reason and reason.endswith("none at all") for reason in found.left_out.values())


def test_a_figure_that_fails_costs_no_other_one(flight: CampaignFlight, monkeypatch: pytest.MonkeyPatch) -> None:
    def failing(_: FlownData) -> None:
        raise ZeroDivisionError("an empty stretch")

    monkeypatch.setitem(DRAWINGS, 2, failing)
    with pytest.warns(LeftOutWarning, match="figure 2: left out"):
        found = draw_figures([flight], [1, 2])
    assert [f.number for f in found.drawn] == [1]
    assert found.left_out == {2: "ZeroDivisionError: an empty stretch"}


def test_what_the_command_refuses_is_one_line(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    out = ["--out", str(tmp_path / "out")]
    for arguments, expected in (
        (["--only", "19"], "figure 19: there are figures 1 to 18"),
        (["--only", "5,x"], "--only: `x` is not the number of a figure"),
        (["--point", "lower"], "--point lower: write --point lower=V09T9527"),
        (["--point", "lower=NOSE"], "no flight has a record of it"),
    ):
        assert main(["figures", str(PRACTICE / "p06"), *arguments, *out]) == 2
        error = capsys.readouterr().err.splitlines()
        assert expected in error[-1]
    assert not (tmp_path / "out").exists()
    with pytest.raises(InputError, match="is not a choice"):
        draw_figures([PRACTICE / "p06"], [9], reference="both of them")


@pytest.mark.thorough
def test_figures_of_a_record_that_states_no_manoeuvre(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    arguments = ["figures", str(PRACTICE / "p06"), "--only", "1-3,5", "--point", "lower=LS", "--out", str(out)]
    assert main(arguments) == 0
    assert "Figure 5 is left out: no pushover-pullup near Mach 20" in capsys.readouterr().out
    assert sorted(p.name for p in out.glob("*.png")) == ["figure_01.png", "figure_02.png", "figure_03.png"]


def test_a_record_that_names_no_vehicle_says_so_in_its_figures() -> None:
    record = load_record(PRACTICE / "p06")
    bare = replace(record, declared=record.declared.model_copy(update={"vehicle": "", "flight": "F1"}))
    with pytest.raises(LeftOut, match=r"the records of F1 name no vehicle; add `vehicle` to one's record\.toml"):
        _ = FlownData([CampaignFlight("F1", {"LS": bare}, ())]).vehicle


def test_points_beyond_the_axes_are_marked_at_their_edge() -> None:
    figure, axes = new_figure(4.0, 3.0, 1)
    x, y = np.arange(4.0), np.array([0.0, 9.0, -9.0, 0.5])
    axes[0].plot(x, y, ".")
    axes[0].set_ylim(-1.0, 1.0)
    assert len(unmarked_points(figure)) == 2
    mark_beyond(axes[0], x, y, "k")
    assert unmarked_points(figure) == []
    assert axes[0].get_ylim() == (-1.0, 1.0)


def test_residuals_of_a_fit_beyond_their_panel_are_marked() -> None:
    """The panel is scaled by one model; the residuals of another are ten times as large."""
    small = predict(TILE)
    large = replace(small, residual_K=10.0 * small.residual_K)
    figure, _ = fit_figure(small.record, [(small, "tab:orange", "declared"), (large, "tab:blue", "fitted")])
    assert unmarked_points(figure) == []
    assert named_lines_out_of_sight(figure) == []
    assert any(line.get_marker() in "^v" for a in figure.axes for line in a.get_lines())
