"""Charts and sortable tables of pages: what is embedded, and what a reader does with them in a real browser."""

from __future__ import annotations

import hashlib
import json
import re
from itertools import accumulate
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim_heating.base.report.chart import Chart, Curve, Panel, Span, chart_data, decimated, script_json
from sim_heating.base.report.page import Page, Section, page_html, write_page
from sim_heating.base.report.table import Column, Table
from tests.support.browser import needs_browser
from tests.support.chromium import Browser
from tests.support.paths import ROOT

VENDOR = ROOT / "sim_heating" / "base" / "report" / "vendor"
HOSTILE = "</script><b>\u2028'\"&amp;"


def test_the_library_in_the_package_is_the_one_that_its_note_names():
    note = (VENDOR / "README.md").read_text()
    for name in ("uPlot.iife.min.js", "uPlot.min.css"):
        assert f"{hashlib.sha256((VENDOR / name).read_bytes()).hexdigest()}  {name}" in note


def test_a_decimated_curve_keeps_its_extremes_in_every_interval():
    t = np.linspace(0.0, 1000.0, 50_000)
    y = np.sin(t / 30.0)
    y[31_234] = 9.0  # a spike of one sample
    kept = decimated(t, y, 200)
    assert len(kept) <= 2 * 200 + 2
    assert {0, len(t) - 1, 31_234} <= set(kept)
    interval = np.minimum((t / 5.0).astype(int), 199)
    for i in range(200):
        assert np.ptp(y[interval == i]) <= np.ptp(y[kept[interval[kept] == i]])


@given(st.lists(st.one_of(st.floats(-1e3, 1e3), st.just(np.nan)), max_size=60), st.integers(1, 20))
def test_a_decimated_curve_has_the_ends_and_the_range_of_the_whole(values, intervals):
    y = np.array(values, dtype=float)
    t = np.arange(len(y), dtype=float)
    kept, finite = decimated(t, y, intervals), np.flatnonzero(np.isfinite(y))
    assert np.all(np.diff(kept) > 0)
    if len(finite):
        assert {finite[0], finite[-1]} <= set(kept)
        assert (np.nanmin(y), np.nanmax(y)) == (np.nanmin(y[kept]), np.nanmax(y[kept]))


def test_embedded_values_are_those_of_the_curve_to_a_fraction_of_its_range():
    t = np.array([0.0, 0.5, 1.25, 2.0])
    y = np.array([300.0, np.nan, 1300.123456, 900.0])
    data, note = chart_data(Chart("", [Panel("temperature, K", [Curve("surface", t, y, "tab:red")])]), 100)
    ((curve,), (times,)) = data["panels"][0]["curves"], data["times"]
    assert note == ""
    np.testing.assert_allclose(times["step"] * np.cumsum(times["y"]), t, atol=1e-3)
    found = curve["step"] * np.array(list(accumulate(v for v in curve["y"] if v is not None)))
    np.testing.assert_allclose(found, [300.0, 1300.123456, 900.0], atol=1000.0 / 20_000)
    assert curve["y"][1] is None


def test_a_page_states_that_a_curve_was_decimated():
    t = np.linspace(0.0, 100.0, 20_000)
    chart = Chart("", [Panel("K", [Curve("surface", t, t, "k")])])
    assert "Curves of more than 1400 samples (up to 20000)" in page_html(Page("", "", [Section("", charts=[chart])]))


def test_no_text_ends_the_element_of_the_data_of_a_chart():
    text = script_json({"label": HOSTILE})
    assert not re.search("[<>&\u2028]", text)
    assert json.loads(text) == {"label": HOSTILE}


def record_chart(name: str, start_s: float = 200.0) -> Chart:
    """A chart with measured and two predicted histories, residuals, and a held-out span."""
    t = start_s + np.linspace(0.0, 1000.0, 1500)
    truth = 600.0 + 400.0 * np.sin(t / 300.0)
    read = truth + np.random.default_rng(1).normal(0.0, 2.0, t.size)
    curves = [Curve("measured", t, read, "0.35", points=True), Curve("declared", t, truth + 9.0, "tab:orange")]
    residuals = [Curve("declared", t, read - truth - 9.0, "tab:orange", points=True)]
    panels = [
        Panel("temperature, K", curves),
        Panel("residual, K", residuals, 0.6, zero=True, limits=(-12.0, 4.0)),
    ]
    return Chart(name, panels, "A caption.", (start_s + 50.0, start_s + 900.0), [Span(500.0, 600.0, "held out")])


def fleet() -> Table:
    """Records with what was found in them; one has no error."""
    columns = [Column("record"), Column("finding", is_text=True), Column("RMSE", format=".2f", unit="K")]
    columns.append(Column("estimate", is_text=True))
    rows = [
        [f"p{i}", "transition" if i % 3 else "none", None if i == 4 else float((7 * i) % 12), f"{0.5 - i * i:g} +- 0.1"]
        for i in range(12)
    ]
    return Table(
        "Fleet", columns, rows, sortable=True, choices=["finding"], links=[f"p{i}/report.html" for i in range(12)]
    )


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A page with one chart, two records side by side, and a fleet."""
    sections = [
        Section("One", charts=[record_chart(HOSTILE)]),
        Section("Side by side", charts=[record_chart("p01"), record_chart("p02", 230.0)]),
        Section("Fleet", tables=[fleet()]),
    ]
    path = tmp_path_factory.mktemp("page") / "report.html"
    write_page(path, lambda: Page(HOSTILE, "charts and a fleet", sections))
    return path


ROWS = "[...document.querySelectorAll('tbody tr')]"
SHOWN = f"{ROWS}.filter((r) => r.offsetParent).map((r) => r.cells[0].textContent)"
RESET = "[...document.querySelectorAll('button')].filter((b) => b.textContent === 'Reset zoom')"
DISABLED = f"{RESET}.map((b) => b.disabled)"
CLICK_SORT = "[...document.querySelectorAll('th button')].find((b) => b.textContent === '{}').click()"
KEYS = "[...document.querySelectorAll('.key')].filter((k) => k.textContent.startsWith('declared'))"
PLACE = "(({x, y, width, height}) => [x, y, width, height])(document.querySelector('.u-over').getBoundingClientRect())"
CHOOSE = (
    "(() => {{ const e = document.querySelector('.tools {}'); e.value = '{}'; e.dispatchEvent(new Event('{}')) }})()"
)
PICTURES = "[...document.querySelectorAll('figure.chart img')].map((i) => Boolean(i.offsetParent))"


@needs_browser
def test_a_reader_zooms_sorts_filters_and_prints(page, tmp_path):
    """One browser for all: starting it takes longer than what is tested."""
    with Browser() as browser:
        shown = browser.open(page)
        assert shown.evaluate("document.documentElement.dataset.charts") == "3"
        assert shown.evaluate("document.querySelectorAll('canvas').length") == 6
        assert shown.evaluate(PICTURES) == [False] * 3
        assert shown.evaluate("document.querySelector('h1').textContent") == HOSTILE.replace("\u2028", "\\u2028")
        _zoom(shown)
        _hide_a_curve(shown)
        _sort_and_filter(shown)
        shown.resize(390)
        _zoom_by_two_fingers(shown)
        assert shown.evaluate("document.documentElement.scrollWidth") <= 390
        shown.call("Emulation.setEmulatedMedia", media="print")
        assert shown.evaluate(PICTURES) == [True] * 3
        assert len(shown.evaluate(SHOWN)) == 12  # although some are filtered out on the screen
        assert not shown.evaluate("[...document.querySelectorAll('canvas, .tools')].some((c) => c.offsetParent)")
        shown.pdf(tmp_path / "page.pdf")
        assert (tmp_path / "page.pdf").read_bytes().startswith(b"%PDF")
        assert shown.complaints() == []
        without = browser.open(page, scripts=False)
        assert without.evaluate("document.querySelectorAll('canvas').length") == 0
        # with scripts switched off, the protocol's own expressions still run
        assert without.evaluate(PICTURES) == [True] * 3
        assert len(without.evaluate(SHOWN)) == 12


def _zoom(shown):
    """By the mouse, with the other charts of the same time; back; by keys."""
    assert shown.evaluate(DISABLED) == [True] * 3
    x, y, width, height = shown.evaluate(PLACE)
    shown.drag(x + 0.4 * width, y + 0.5 * height, x + 0.6 * width)
    settle(shown)
    assert shown.evaluate(DISABLED) == [False] * 3
    shown.move(x + 0.5 * width, y + 0.5 * height)
    settle(shown)
    clocks = shown.evaluate("[...document.querySelectorAll('output')].map((o) => o.textContent)")
    times = [float(re.fullmatch(r"time (\S+) s", text)[1]) for text in clocks]
    assert times == pytest.approx([675.0] * 3, abs=1.0)  # the middle of the view, to a pixel, in every chart
    assert re.fullmatch(r"\d+\.\d+", shown.evaluate("document.querySelector('.key b').textContent"))
    shown.evaluate(f"{RESET}[1].click()")
    settle(shown)
    assert shown.evaluate(DISABLED) == [True] * 3
    shown.evaluate("document.querySelector('.plot').focus()")
    shown.press("+")
    settle(shown)
    assert shown.evaluate(DISABLED) == [False] * 3
    shown.press("0")
    settle(shown)
    assert shown.evaluate(DISABLED) == [True] * 3


def _zoom_by_two_fingers(shown):
    shown.evaluate("document.querySelector('.u-over').scrollIntoView({block: 'center'})")
    settle(shown)
    x, y, width, height = shown.evaluate(PLACE)
    for kind, apart in (("touchStart", 0.2), ("touchMove", 0.4), ("touchMove", 0.8)):
        fingers = [{"x": x + (0.5 + k * apart / 2) * width, "y": y + height / 2, "id": k} for k in (-1, 1)]
        shown.call("Input.dispatchTouchEvent", type=kind, touchPoints=fingers)
    shown.call("Input.dispatchTouchEvent", type="touchEnd", touchPoints=[])
    settle(shown)
    assert shown.evaluate(DISABLED) == [False] * 3
    shown.evaluate(f"{RESET}[0].click()")


def _hide_a_curve(shown):
    pressed = f"{KEYS}.map((k) => k.ariaPressed)"
    assert shown.evaluate(pressed) == ["true"] * 6
    shown.evaluate(f"{KEYS}[0].click()")
    assert shown.evaluate(pressed) == ["false"] * 6  # residuals and the other records with it


def _sort_and_filter(shown):
    table = fleet()
    ordered = sorted((r for r in table.rows if r[2] is not None), key=lambda r: r[2])
    shown.evaluate(CLICK_SORT.format("RMSE"))
    assert shown.evaluate(SHOWN) == [*(r[0] for r in ordered), "p4"]
    shown.evaluate(CLICK_SORT.format("RMSE"))
    assert shown.evaluate(SHOWN) == [*(r[0] for r in ordered[::-1]), "p4"]  # what is missing stays last
    shown.evaluate(CLICK_SORT.format("estimate"))
    assert shown.evaluate(SHOWN) == [r[0] for r in table.rows[::-1]]  # by the number that the text begins with
    shown.evaluate(CLICK_SORT.format("record"))
    assert shown.evaluate(SHOWN) == [r[0] for r in table.rows]  # p2 before p10
    assert shown.evaluate("document.querySelector('th').ariaSort") == "ascending"
    shown.evaluate(CHOOSE.format("select", "none", "change"))
    assert shown.evaluate(SHOWN) == ["p0", "p3", "p6", "p9"]
    shown.evaluate(CHOOSE.format("input", "P6", "input"))
    assert shown.evaluate(SHOWN) == ["p6"]
    assert shown.evaluate("document.querySelector('.tools [role=status]').textContent") == "1 of 12 rows"
    assert shown.evaluate("document.querySelector('td a').getAttribute('href')") == "./p0/report.html"


def settle(shown):
    """Wait until the browser has drawn."""
    shown.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
