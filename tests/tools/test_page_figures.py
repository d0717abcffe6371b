"""Figures on pages are those of the files in benchmarks/results."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from click.testing import CliRunner

from benchmarks.measure import RESULTS
from tests.support.paths import ROOT
from tools import credibility, page_figures, page_tables, reliability_tables
from tools.page import DOCS, MARKED
from tools.page_figures import main, pages, quoted, stale_figures
from tools.page_tables import TABLES


@pytest.mark.parametrize("page", pages(), ids=lambda p: p.relative_to(ROOT).as_posix())
def test_a_page_quotes_the_results(page: Path):
    assert not (stale := stale_figures(page)), "\n".join(map(str, stale))


@pytest.mark.parametrize("page", pages(), ids=lambda p: p.relative_to(ROOT).as_posix())
def test_a_marked_table_of_a_page_is_one_that_a_benchmark_writes(page: Path):
    """A misspelt name would leave the page as it is, and nothing would check it."""
    for _, name, _ in MARKED.findall(page.read_text()):
        assert name in TABLES or name.partition(", ")[0] in ("credibility", *reliability_tables.NAMES)


@pytest.mark.parametrize("name", sorted({n.partition(", ")[0] for n in TABLES}))
def test_a_figure_that_moved_makes_its_table_stale(results, monkeypatch, name):
    """The page as it is, and a result in which every number is another one."""

    def moved(value):
        if isinstance(value, dict):
            return {k: moved(v) for k, v in value.items()}
        if isinstance(value, list):
            return [moved(v) for v in value]
        return value + 0.5 if isinstance(value, float) else value

    stored = json.loads((RESULTS / f"{name}.json").read_text())
    (results / f"{name}.json").write_text(json.dumps(moved(stored)))
    monkeypatch.setattr(page_tables, "RESULTS", results)
    for marked in (n for n in TABLES if n.partition(", ")[0] == name):
        page = next(p for p in pages() if f"<!-- results of {marked} -->" in p.read_text())
        table = re.search(rf"<!-- results of {marked} -->\n(.*?)<!-- end -->", page.read_text(), re.DOTALL)
        assert page_tables.table_of(marked) != table[1]


def statistical_promises() -> list[str]:
    """Promises of the page on validation, each with the tables and sentences that belong to it."""
    section = (DOCS / "evidence" / "validation.md").read_text().partition("## Statistical promises")[2]
    return ["**" + part for part in re.split(r"^\*\*", section, flags=re.MULTILINE)[1:]]


@pytest.mark.parametrize("promise", statistical_promises(), ids=lambda p: p[2:40])
def test_a_statistical_promise_names_its_command_and_quotes_its_results(promise: str):
    quoted_files = {m[2] for m in page_figures.MARKED.finditer(promise)}
    assert quoted_files
    assert not [f for f in quoted_files if f"`{credibility.command_of(f)}`" not in promise]


@pytest.mark.parametrize("promise", statistical_promises(), ids=lambda p: p[2:40])
def test_every_count_and_share_of_a_promise_is_quoted(promise: str):
    """What stands outside of the marks are levels, sizes of samples and options of commands, not results."""
    plain = re.sub(r"`[^`]*`", "", page_figures.MARKED.sub("", promise))
    assert not re.findall(r"\b0\.\d{3,}|\b\d+ of \d+\b", plain)


@pytest.fixture
def results(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with one result file, and one page that quotes it."""
    figures = [
        {"what": "popu: |coverage of 95% bounds - 0.95|", "value": 0.005, "note": "0.9550 of 2000"},
        {"what": "flap: |coverage of 95% bounds - 0.95|", "value": 0.002, "note": "mean error -4.4e-05"},
    ]
    (tmp_path / "trial.json").write_text(json.dumps({"figures": figures, "by_class": {"none": [3, "7 of 9"]}}))
    monkeypatch.setattr(page_figures, "RESULTS", tmp_path)
    page_figures._results.cache_clear()
    yield tmp_path
    page_figures._results.cache_clear()


@pytest.mark.parametrize(
    ("key", "spec", "text"),
    [
        ("popu: |coverage of 95% bounds - 0.95|", ".3f", "0.005"),
        ("popu: *coverage*", "*1e3 .0f", "5"),
        ("popu: *", "note 1 .3f", "0.955"),
        ("popu: *", "note 2 d", "2000"),
        ("flap: *", "note 1 .1e", "-4.4e-05"),
        ("/by_class/none/0", "d", "3"),
        ("/by_class/none/1", "text 2 d", "9"),
        ("/by_class/none/1", "", "7 of 9"),
    ],
)
def test_an_entry_is_written_as_asked(results, key, spec, text):
    assert quoted("trial", key, f" {spec}" if spec else "") == text


@pytest.mark.parametrize(
    ("name", "key", "spec", "message"),
    [
        ("trail", "popu: *", "", "no file trail.json in benchmarks/results; trial?"),
        ("trial", "*coverage*", "", "2 figures; popu: .*; flap: "),
        ("trial", "popu: coverage of 95% bounds", "", "0 figures; popu: "),
        ("trial", "/by_class/all", "", "no 'all' among none"),
        ("trial", "popu: *", " note 3 d", "has 2 numbers, not 3"),
        ("trial", "popu: *", " with two digits", "cannot read 'with two digits'"),
    ],
)
def test_what_is_not_in_the_results_is_an_error(results, name, key, spec, message):
    with pytest.raises(ValueError, match=message):
        quoted(name, key, spec)


def test_a_figure_that_went_stale_is_reported_with_its_line_and_written_again(results, monkeypatch):
    page = results / "page.md"
    page.write_text('# Page\n\nCoverage <!-- result trial "popu: *" note 1 .3f -->0.95<!-- end --> of 0.95.\n')
    monkeypatch.setattr(page_figures, "DOCS", results / "docs")
    monkeypatch.setattr(page_figures, "pages", lambda: [page])
    found = CliRunner().invoke(main)
    assert found.exit_code == 1
    assert "page.md, line 3: trial 'popu: *': the page says 0.95, the result is 0.955" in found.output
    CliRunner().invoke(main, ["--write"])
    assert "-->0.955<!-- end --> of 0.95." in page.read_text()
    assert CliRunner().invoke(main).exit_code == 0
