"""Pages that other people open: whatever the names in it are, nothing of them runs in a browser."""

from __future__ import annotations

import base64
import html
import io
import re
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest
from rich.text import Text

from sim_heating.base.errors import printable
from sim_heating.base.report.chart import Chart, Curve, Panel, Span
from sim_heating.base.report.figure import add_grid_and_title, new_figure
from sim_heating.base.report.page import Page, Picture, Section, page_html
from sim_heating.base.report.table import Column, Table
from sim_heating.cli.console import PlainConsole
from tests.support.browser import CANARY, EVERY_EVENT, POLICY, assert_harmless, hostile, needs_browser, shown

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
    text = html.unescape(page_html(page()))
    for where in ("title", "subtitle", "section", "text", "point", "caption", "cell", "head", "warning", "conclusion"):
        assert printable(hostile(where)) in text


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
