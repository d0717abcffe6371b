"""Result files carry units, agree with each other, and open in other programs."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from matplotlib.figure import Figure

from sim_heating.base.errors import InputError
from sim_heating.inputs.record import load_record
from sim_heating.inputs.scenario import load_scenario
from sim_heating.simulation.report.charts import shades
from sim_heating.simulation.report.plots import draw_heating, draw_temperatures
from sim_heating.simulation.results import run_table
from sim_heating.simulation.run import PointResult, RunResult, run, with_reference_heating, write_run
from tests.support.browser import assert_fits, needs_browser
from tests.support.gliding import gliding
from tests.support.paths import BOARD, PRACTICE

SCENARIO = (
    gliding(60.0, "V09T9527", "LEE_UPPER")
    + """
[[trajectory.manoeuvre]]
kind = "elevon-pulse"
at_time_s = 20.0
amplitude_deg = 3.0
"""
)


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> RunResult:
    file = tmp_path_factory.mktemp("scenario") / "glide.toml"
    file.write_text(SCENARIO)
    return run(load_scenario(file))


@pytest.fixture(scope="module")
def out(result: RunResult, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("results") / "out"
    write_run(result, folder)
    return folder


def test_every_variable_of_the_netcdf_file_has_a_unit(out: Path) -> None:
    with xr.open_dataset(out / "flight.nc", decode_timedelta=False) as data:
        assert {name for name in data.data_vars if "units" not in data[name].attrs} == set()
        assert data["surface_K"].units == "K"
        assert data["rho_kg_m3"].units == "kg m-3"
        assert data.attrs["vehicle"] == "orbiter"


def test_netcdf_and_csv_hold_the_same_temperatures(out: Path) -> None:
    table = pd.read_csv(out / "V09T9527" / "temperatures.csv")
    with xr.open_dataset(out / "flight.nc", decode_timedelta=False) as data:
        point = data.sel(control_point="V09T9527")
        np.testing.assert_allclose(table["time_s"], data["time"])
        np.testing.assert_allclose(table["surface_K"], point["surface_K"], rtol=0.0, atol=5.1e-5)  # 4 decimals
        np.testing.assert_allclose(table["V07T9531_K"], data["sensor_K"].sel(sensor="V07T9531"), rtol=0.0, atol=5.1e-5)


def test_temperatures_csv_has_the_contract_s_columns_in_order(out: Path) -> None:
    columns = pd.read_csv(out / "V09T9527" / "temperatures.csv").columns.tolist()
    sensors = ["V09T9527_K", "V07T9528_K", "V07T9529_K", "V07T9530_K", "V07T9531_K"]
    assert columns == ["time_s", "surface_K", "bondline_K", *sensors]


def test_the_summary_agrees_with_the_histories(out: Path, result: RunResult) -> None:
    point = json.loads((out / "summary.json").read_text())["control_points"]["V09T9527"]
    table = pd.read_csv(out / "V09T9527" / "temperatures.csv")
    assert point["peak_surface_K"] == pytest.approx(table["surface_K"].max(), abs=1e-4)
    assert point["peak_surface_s"] == table["time_s"][table["surface_K"].idxmax()]
    limit = result.scenario.vehicle.control_point("V09T9527").limits.surface_K
    assert point["surface_margin_K"] == pytest.approx(limit - point["peak_surface_K"])


def test_heating_csv_and_netcdf_hold_fluxes_heat_load_and_margins(out: Path, result: RunResult) -> None:
    table = pd.read_csv(out / "V09T9527" / "heating.csv")
    fluxes = ["convected_W_m2", "radiated_W_m2", "conducted_W_m2", "added_W_m2", "back_W_m2", "heat_load_J_m2"]
    assert table.columns.tolist() == ["time_s", "ratio", *fluxes, "surface_margin_K", "bondline_margin_K"]
    limits = result.scenario.vehicle.control_point("V09T9527").limits
    with xr.open_dataset(out / "flight.nc", decode_timedelta=False) as data:
        point = data.sel(control_point="V09T9527")
        for name in (*fluxes, "surface_margin_K", "bondline_margin_K"):
            np.testing.assert_allclose(table[name], point[name], rtol=1e-6)
        assert point["surface_limit_K"] == limits.surface_K
        np.testing.assert_allclose(point["bondline_margin_K"], limits.bondline_K - point["bondline_K"])
        assert (data["convected_W_m2"].units, data["heat_load_J_m2"].units) == ("W m-2", "J m-2")
    summary = json.loads((out / "summary.json").read_text())["control_points"]["V09T9527"]
    assert summary["heat_load_J_m2"] == pytest.approx(table["heat_load_J_m2"].iloc[-1], rel=1e-6)
    assert summary["peak_convected_W_m2"] == pytest.approx(table["convected_W_m2"].max(), rel=1e-6)


def test_a_reader_chooses_the_points_of_a_picture(result: RunResult) -> None:
    labels = [[line.get_text() for line in a.get_legend().get_texts()] for a in result.plot(["LEE_UPPER"]).axes]
    assert all(any("limit" in text for text in panel) for panel in labels)
    assert all("LEE_UPPER" in text for panel in labels for text in panel)
    (heating,) = result.plot_heating(["V09T9527"]).legends[0].get_texts()
    assert re.fullmatch(r"V09T9527  [\d.]+ kW/m2, [\d.]+ MJ/m2", heating.get_text())
    with pytest.raises(InputError, match="`V09T9528` is not a control point of this flight; did you mean `V09T9527`"):
        result.plot(["V09T9528"])


@pytest.mark.sample(1)
@pytest.mark.parametrize("draw", [draw_temperatures, draw_heating])
def test_panels_and_legends_of_many_points_cover_none_of_each_other(
    draw: Callable[..., Figure], result: RunResult
) -> None:
    history = result.points["V09T9527"].history
    title = "Thirty points with a title that is as wide as the figure is, which is hardly ever so"
    figure = draw(None, title, [replace(history, name=f"V09T{9500 + k}") for k in range(30)], [])
    panels = [a.get_window_extent() for a in figure.axes]
    legends = [a.get_legend() for a in figure.axes if a.get_legend()] + figure.legends
    boxes = [legend.get_window_extent() for legend in legends]
    assert sum(len(legend.get_texts()) for legend in legends) >= 30
    assert all(box.height > 0.5 * figure.bbox.height / len(panels) for box in panels)
    assert all(figure.bbox.containsx(x) for box in boxes for x in (box.x0, box.x1))
    assert all(figure.bbox.containsy(y) for box in boxes for y in (box.y0, box.y1))
    apart = [*panels, *boxes, figure._suptitle.get_window_extent()]
    assert not any(a.overlaps(b) for i, a in enumerate(apart) for b in apart[:i])


def test_a_manoeuvre_is_drawn_at_the_rate_of_the_simulation(result: RunResult) -> None:
    (window,), moved, sampled = result.flight.windows, result.flight.at_frame_rate(), result.flight.conditions
    within = (moved.time_s >= window.start_s) & (moved.time_s <= window.end_s)
    rate_hz = result.scenario.declared.trajectory.rate_hz
    np.testing.assert_allclose(np.diff(moved.time_s[within]), 1.0 / rate_hz, rtol=1e-6)
    for name in ("alpha_deg", "elevon_deg"):
        np.testing.assert_allclose(moved.at(sampled.time_s)[name], sampled[name], atol=1e-9)
    assert np.ptp(moved["elevon_deg"][within]) == pytest.approx(3.0)


def test_the_conditions_of_a_run_can_be_flown_again_as_a_recorded_trajectory(out: Path, tmp_path: Path) -> None:
    head = SCENARIO[: SCENARIO.index("[trajectory]")]
    (tmp_path / "again.toml").write_text(f'{head}[trajectory]\nsource = "recorded"\nfile = "{out}/conditions.csv"\n')
    again = run(load_scenario(tmp_path / "again.toml", root=out))
    table = pd.read_csv(out / "V09T9527" / "temperatures.csv")
    np.testing.assert_allclose(again.points["V09T9527"].history.surface_K, table["surface_K"], rtol=0.0, atol=1e-3)


def test_each_manoeuvre_gets_its_picture(out: Path) -> None:
    pictures = sorted(p.name for p in out.glob("*.png"))
    assert pictures == ["heating.png", "manoeuvre_1_elevon-pulse.png", "temperatures.png", "trajectory.png"]
    assert all((out / p).read_bytes().startswith(b"\x89PNG") for p in pictures)


def test_the_conditions_of_a_run_hold_its_reference_heating(result: RunResult, out: Path) -> None:
    table = pd.read_csv(out / "conditions.csv")
    point = result.points["LEE_UPPER"].conditions
    np.testing.assert_allclose(table["h_ref_kg_m2_s"], point["h_ref_kg_m2_s"], rtol=1e-11)
    # the lower surface recovers the enthalpy of its edge, the lee side the total one
    np.testing.assert_allclose(table["LEE_UPPER_H_r_J_kg"], point["H_r_J_kg"], rtol=1e-11)
    assert (table["V09T9527_H_r_J_kg"] < table["LEE_UPPER_H_r_J_kg"]).all()


def test_conditions_without_a_common_film_coefficient_have_one_a_point(result: RunResult) -> None:
    def twice_as_far(point: PointResult) -> PointResult:
        h_ref = point.conditions["h_ref_kg_m2_s"] / np.sqrt(2.0)
        return replace(point, conditions=point.conditions.with_columns(h_ref_kg_m2_s=h_ref))

    points = result.points | {"LEE_UPPER": twice_as_far(result.points["LEE_UPPER"])}
    flown = with_reference_heating(replace(result, points=points))
    assert "h_ref_kg_m2_s" not in flown
    np.testing.assert_array_equal(flown["LEE_UPPER_h_ref_kg_m2_s"], points["LEE_UPPER"].conditions["h_ref_kg_m2_s"])


@needs_browser
def test_the_page_of_a_run_fits_a_screen_a_telephone_and_paper(out: Path) -> None:
    assert_fits(out / "report.html")


def test_the_page_of_a_run_has_the_histories_of_all_points_and_their_peaks(out: Path, result: RunResult) -> None:
    page = (out / "report.html").read_text()
    temperatures, heat, trajectory = (json.loads(text) for text in re.findall(r'application/json">([^<]*)<', page))
    assert {c["label"] for c in temperatures["panels"][0]["curves"]} >= set(result.points)
    assert {c["label"] for c in heat["panels"][0]["curves"]} == set(result.points)
    assert "altitude, km" in {p["label"] for p in trajectory["panels"]}
    assert [span[2] for span in trajectory["spans"]] == ["elevon pulses"]
    for name, point in result.points.items():
        (curve,) = (c for c in temperatures["panels"][0]["curves"] if c["label"] == name)
        shown = curve["step"] * np.cumsum(curve["y"])
        assert shown.max() == pytest.approx(point.history.surface_K.max(), abs=curve["step"])
        assert f"{point.history.surface_K.max():.0f} K" in page


def test_a_table_of_peaks_has_no_bondline_of_a_wall_that_is_as_hot_inside() -> None:
    """The nose cap is one layer of carbon; under a tile the bond stays cold."""
    cap = {"peak_surface_K": 1670.0, "peak_bondline_K": 1670.0, "bondline_margin_K": None}
    tile = {"peak_surface_K": 1119.0, "peak_bondline_K": 323.0, "bondline_margin_K": 127.0}
    table = run_table("", {"control_points": {"NOSECAP": cap, "V09T9527": tile}}, {})
    column = [c.key for c in table.layout].index("peak_bondline_K")
    assert [row[column] for row in table.rows] == [None, 323.0]


def test_the_page_of_a_run_tells_a_variable_outside_ratio_tables_once(out: Path) -> None:
    """As the terminal does, with the longest time and the farthest distance of all points."""
    points = json.loads((out / "summary.json").read_text())["control_points"]
    outside = [(o["variable"], name) for name, point in points.items() for o in point["outside_table"]]
    told = re.findall(r"(\w+) lay outside the ratio tables of ([^<]*), up to", (out / "report.html").read_text())
    assert len(outside) > len(told) > 0
    assert [variable for variable, _ in told] == list(dict.fromkeys(variable for variable, _ in outside))
    assert {(variable, name) for variable, names in told for name in names.split(", ")} == set(outside)


@pytest.mark.parametrize(
    ("record", "caption"),
    [(PRACTICE / "p06", "Shaded: blue fitted, grey held out."), (BOARD, "")],
    ids=["segments", "none"],
)
def test_a_caption_names_the_shades_that_a_record_has(record: Path, caption: str) -> None:
    assert shades(load_record(record)) == caption
