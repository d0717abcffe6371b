"""Pages that other people open: whatever the names in it are, nothing of them runs in a browser."""

from __future__ import annotations

import base64
import html
import io
import re
import shutil
import subprocess
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest
from rich.text import Text

from sim_heating.base.errors import printable
from sim_heating.base.report.chart import Chart, Curve, Panel, Span
from sim_heating.base.report.figure import DPI, add_grid_and_title, new_figure, save_figure
from sim_heating.base.report.page import Page, Picture, SavedPicture, Section, page_html
from sim_heating.base.report.table import Column, Table
from sim_heating.cli.console import PlainConsole
from tests.support.browser import (
    CANARY,
    EVERY_EVENT,
    POLICY,
    assert_fits,
    assert_harmless,
    hostile,
    needs_browser,
    shown,
)
from tests.support.chromium import Browser

pytestmark = pytest.mark.filterwarnings("ignore:constrained_layout not applied")  # texts longer than the picture


def page() -> Page:
    """A page with hostile texts in all its places."""
    figure, (axes,) = new_figure(4.0, 3.0, 1)
    axes.set_xlabel(hostile("axis"))
    add_grid_and_title(figure, hostile("title-of-a-picture"), np.array([axes]))
    column = Column(hostile("head"), hostile("key"), is_text=True)
    table = Table(hostile("caption"), [column, "number"], [[hostile("cell"), 1.0]])
    sorted_table = replace(table, sortable=True, choices=[hostile("head")], links=[hostile("javascript:link")])
    curve = Curve(hostile("curve"), np.arange(9.0), np.arange(9.0), "tab:blue")
    panel = Panel(hostile("panel"), [curve])
    spans = [Span(1.0, 2.0, hostile("span"))]
    chart = Chart(hostile("chart"), [panel], hostile("chart-caption"), spans=spans, time=hostile("time"))
    section = Section(
        hostile("section"), [hostile("text")], [hostile("point")], [table, sorted_table],
        [Picture(figure, hostile("alternative"))], [chart],
    )  # fmt: skip
    conclusion = (hostile("conclusion"), hostile("explanation"))
    return Page(hostile("title"), hostile("subtitle"), [section], conclusion, [hostile("warning")])


@needs_browser
def test_nothing_in_a_page_runs_though_every_text_of_it_is_hostile(tmp_path):
    assert_harmless(page_html(page()), tmp_path)


@needs_browser
def test_the_policy_of_a_page_stops_a_script_that_would_run_without_it(tmp_path):
    """What protects a reader if an escape were ever missing; and that the canary of these tests sings."""
    script = f"<script>{CANARY.replace('{where}', 'injected')}</script>"
    whole = page_html(Page("a page", "", [])).replace("</body>", f"{script}</body>")
    (tmp_path / "protected.html").write_text(whole)
    (tmp_path / "unprotected.html").write_text(POLICY.sub("", whole))
    assert "data-ran" not in re.split("<script", shown(tmp_path / "protected.html"))[0]
    assert 'data-ran="injected"' in shown(tmp_path / "unprotected.html")
    link = f'<a href="javascript:{CANARY.replace("{where}", "followed")}">x</a>'
    empty = POLICY.sub("", page_html(Page("", "", [])))
    (tmp_path / "link.html").write_text(empty.replace("</body>", link + EVERY_EVENT))
    assert 'data-ran="followed"' in shown(tmp_path / "link.html")


def test_a_reader_sees_the_texts_as_they_were_written():
    text = html.unescape(re.sub("</?code>", "`", page_html(page())).replace("<wbr>", ""))
    for where in ("title", "subtitle", "section", "text", "point", "caption", "cell", "head", "warning", "conclusion"):
        assert printable(hostile(where)) in text


def test_names_that_a_message_marks_by_backticks_are_set_as_code():
    text = "unknown key `surfce_K`; did you mean `stack.coating.heat_capacity_factor`"
    picture = Picture(new_figure(4, 3, 1)[0], text)
    section = Section(text, [text], [text], [Table(text, [text, "b"], [[text, 1.0]])], [picture])
    found = page_html(Page(text, text, [section], (text, text), [text])).replace("<wbr>", "").partition("<body>")[2]
    seen = re.sub('alt="[^"]*"', "", found)  # of which a reader sees nothing
    assert "`" not in seen
    assert seen.count("did you mean <code>stack.coating.heat_capacity_factor</code>") == 13


def test_a_picture_with_hostile_texts_is_a_picture():
    (picture,) = page().sections[0].pictures
    svg = ElementTree.fromstring(base64.b64decode(picture.data_url.partition(",")[2]))
    assert {e.tag.rpartition("}")[2] for e in svg.iter()}.isdisjoint({"script", "foreignObject", "a", "image"})


def test_a_terminal_obeys_no_text_of_an_input_file():
    output = io.StringIO()
    console = PlainConsole(file=output, force_terminal=True, soft_wrap=True, width=10_000)
    console.print("a\x1b]0;owned\x07 b\x9b31m [bold]c[/] \u202etxt.exe")
    assert output.getvalue() == "a\\x1b]0;owned\\x07 b\\x9b31m [bold]c[/] \\u202etxt.exe\n"
    assert printable("two\nlines\tand é, 温度, a\u200bb") == "two\nlines\tand é, 温度, a\u200bb"
    assert Text(printable("\x00")).plain == "\\x00"


def wide_page() -> Page:
    """A table of more columns than a telephone shows, with long names and estimates, and a picture with small type."""
    figure, (axes,) = new_figure(9.5, 3.0, 1)
    add_grid_and_title(figure, "picture", np.array([axes]))
    names = ["scale", "d_alpha", "d_beta", "d_logre", "d_elevon", "d_bodyflap"]
    columns = ["flight", *(Column(n, is_text=True) for n in names), "RMSE", "noise floor"]
    rows = [["stack.coating.heat_capacity_factor", *["0.0004897 +- 6.9e-05"] * 6, "1.39 K", "1.36 K"]] * 80
    table = Table("", columns, rows, sortable=True)
    return Page("wide", "a page", [Section("Fits", ["Estimates."], tables=[table], pictures=[Picture(figure, "one")])])


@needs_browser
def test_a_page_that_is_wider_than_a_telephone_scrolls_within_itself_and_is_whole_on_paper(tmp_path):
    path = tmp_path / "report.html"
    path.write_text(page_html(wide_page()))
    assert_fits(path)
    with Browser() as browser:
        opened = browser.open(path, 390)
        wide = "[...document.querySelectorAll('.table, figure')].map((e) => e.scrollWidth > e.clientWidth)"
        assert opened.evaluate(wide) == [True, True]


@needs_browser
def test_a_small_picture_is_not_blown_up_and_a_telephone_is_told_that_one_goes_on(tmp_path):
    figure, (axes,) = new_figure(4.0, 3.0, 1)
    save_figure(figure, tmp_path / "small.png", "small", np.array([axes]))
    path = tmp_path / "report.html"
    path.write_text(page_html(Page("", "", [Section("", pictures=[SavedPicture(tmp_path / "small.png", "small")])])))
    width = "document.querySelector('figure > img').getBoundingClientRect().width"
    hint = "getComputedStyle(document.querySelector('figcaption'), '::after').content"
    with Browser() as browser:
        opened = browser.open(path, 1280)
        assert opened.evaluate(width) == pytest.approx(1.2 * 4.0 * DPI, abs=1.0)  # 1024 before, with coarse letters
        assert "right" not in opened.evaluate(hint)
        opened = browser.open(path, 390)
        assert opened.evaluate(width) == pytest.approx(1.2 * 4.0 * DPI, abs=1.0)
        assert "goes on to the right" in opened.evaluate(hint)


@needs_browser
@pytest.mark.skipif(shutil.which("pdftotext") is None, reason="needs pdftotext, which is not installed")
def test_the_heads_of_a_sorted_table_stand_on_each_sheet_of_paper(tmp_path):
    path = tmp_path / "report.html"
    path.write_text(page_html(wide_page()))
    with Browser() as browser:
        browser.open(path).pdf(tmp_path / "page.pdf")
    found = subprocess.run(["pdftotext", "-layout", tmp_path / "page.pdf", "-"], capture_output=True, check=True)
    sheets = found.stdout.decode().strip("\f").split("\f")
    assert len(sheets) > 2
    assert all("d_bodyflap" in sheet for sheet in sheets if "6.9e-05" in sheet)  # heads that sort are on every sheet


def test_a_long_name_breaks_between_its_parts_and_a_number_does_not_break():
    cells = ["stack.coating.heat_capacity_factor", "0.00041 +- 4.6e-05", "popu-mach20", "<b>" * 9]
    text = page_html(Page("", "", [Section("", tables=[Table("", ["name"], [[c] for c in cells])])]))
    found = re.findall("<td>(.*?)</td>", text)
    assert found[0] == "stack.<wbr>coating.<wbr>heat_<wbr>capacity_<wbr>factor"
    assert found[1:] == ['0.00041 <span class="whole">+- 4.6e-05</span>', "popu-mach20", html.escape(cells[3])]


def test_a_picture_of_many_panels_has_two_columns_with_times_below_both():
    curve = Curve("curve", np.arange(9.0), np.arange(9.0), "tab:blue")
    figure = Chart("chart", [Panel(f"panel {i}", [curve]) for i in range(11)]).figure()
    assert len(figure.axes) == 11
    assert sum(bool(a.get_xlabel()) for a in figure.axes) == 2
    width, height = figure.get_size_inches()
    assert height < 2.0 * width
