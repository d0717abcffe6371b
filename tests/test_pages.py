"""Pages of the documentation: what they link to exists, and a reader finds every page from the front page."""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import click
import pytest

import sim_heating as sh
from sim_heating.cli import cli
from tests.support.paths import ROOT

DOCS = ROOT / "docs"
PAGES = sorted(p for p in DOCS.rglob("*.md") if "_build" not in p.parts)
TOP = [ROOT / name for name in ("README.md", "CHANGELOG.md", "CONTRIBUTING.md", "paper.md") if (ROOT / name).is_file()]
LINK = re.compile(r"\]\(([^)\s]+)\)")
WEB = re.compile(r"[a-z]+:")
FENCE = re.compile(r"^```.*?^```", re.MULTILINE | re.DOTALL)


def prose(page: Path) -> str:
    """Text of a page without blocks of code."""
    return FENCE.sub("", page.read_text())


def anchors(page: Path) -> set[str]:
    """Anchors of a page: its headings, as forges and the site form them."""
    found: set[str] = set()
    for heading in re.findall(r"^#+ +(.+?)\s*$", prose(page), re.MULTILINE):
        text = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading)
        found.add(re.sub(r"[^\w\- ]", "", text.lower()).replace(" ", "-"))
    return found


def links(page: Path) -> Iterator[tuple[str, Path, str]]:
    """Relative links of a page: as written, the file, and the anchor."""
    for link in LINK.findall(prose(page)):
        if not WEB.match(link):
            path, _, anchor = link.partition("#")
            yield link, (page.parent / path).resolve() if path else page, anchor


@pytest.mark.parametrize("page", [*TOP, *PAGES], ids=lambda p: p.relative_to(ROOT).as_posix())
def test_links_of_a_page_lead_somewhere(page: Path):
    for link, target, anchor in links(page):
        assert target.exists(), f"{link}: no such file"
        assert not anchor or anchor in anchors(target), f"{link}: no such heading"


QUESTIONS = {
    "how do I install it": "pip install",
    "what does exit status 2 mean": "2: the input is wrong",
    "how do I make a record of my own CSV": "# A record from your own temperatures",
    "how do I make a vehicle": "sim-heating new vehicle",
    "how do I fly a scenario": "sim-heating run",
    "how do I estimate a derivative": "sim-heating estimate",
    "how do I find what a model lacks": "sim-heating close-loop",
    "what does partly mean": "**partly**",
    "what is a p-value": "**p-value**",
    "is a share a probability": "No probability.",
    "what is the noise floor": "**noise floor**",
    "how do I write an estimate into tables": "sim-heating update-tables",
    "how wide is a prediction": "--bands",
    "how do I disperse an entry": "[dispersion]",
    "how do I limit the load of an optimal entry": "normal_load_g",
    "how do I export an FMU": "sim-heating fmu export",
    "how do I follow a flight live": "sim-heating live",
    "how do I use a sampler": "to_problem()",
    "how do I repeat a result": "sim-heating reproduce",
    "how do I use tables of another program": "DAVE-ML",
}
"""Questions of a user, fixed beforehand, and words of their answers."""


@pytest.mark.parametrize("question", QUESTIONS)
def test_a_question_is_answered_within_two_links_of_the_front_page(question: str):
    within = {DOCS / "index.md"}
    for _ in range(2):
        within |= {target for page in set(within) for _, target, _ in links(page) if target in PAGES}
    assert any(QUESTIONS[question] in page.read_text() for page in within)


HOW_TO_WORDS = 1200


@pytest.mark.parametrize("page", sorted((DOCS / "how_to").glob("*.md")), ids=lambda p: p.stem)
def test_a_guide_is_short(page: Path):
    assert len(page.read_text().split()) <= HOW_TO_WORDS


def test_pictures_are_shown_on_a_page():
    shown = {target for page in (*TOP, *PAGES) for _, target, _ in links(page)}
    pictures = set((DOCS / "images").glob("*.png"))
    assert sorted(p.name for p in pictures - shown) == []


def test_every_page_is_in_the_list_of_its_folder():
    """The front page lists the folders; the lists of links are the table of contents of the site."""
    listed = {target for page in PAGES if page.stem in ("index", "README") for _, target, _ in links(page)}
    everything = {*PAGES, *(DOCS / "notebooks").glob("*.ipynb")} - {DOCS / "index.md"}
    assert sorted(p.relative_to(DOCS).as_posix() for p in everything - listed) == []


def test_the_reference_describes_every_public_name():
    page = (DOCS / "reference" / "api.md").read_text()
    described = " ".join(re.findall(r"<!-- autodoc: (.*?) -->", page)).split()
    assert sorted(described) == sorted(set(sh.__all__) - {"__version__"})


def commands_shown() -> Iterator[tuple[str, list[str]]]:
    """Commands that pages show in blocks: the page, and the words of each."""
    for page in (*TOP, *PAGES):
        for line in re.findall(r"^(?:    |)(?:\.venv/bin/|\$ )?(sim-heating [^\n]*)$", page.read_text(), re.MULTILINE):
            with suppress(ValueError):  # an apostrophe in a sentence
                yield page.relative_to(ROOT).as_posix(), shlex.split(line.replace("|", " "), comments=True)[1:]


def test_commands_and_options_that_pages_show_exist():
    wrong = []
    for page, given in commands_shown():
        command: click.Command | None = cli
        words = list(given)
        context = click.Context(cli)
        while isinstance(command, click.Group) and words and not words[0].startswith("-"):
            inner = command.make_context("group", words, resilient_parsing=True)  # which may add a default command
            first, *words = [*inner._protected_args, *inner.args]
            command = command.get_command(inner, first)
        if command is None:
            wrong.append(f"{page}: sim-heating {' '.join(given)}: no such command")
            continue
        known = {name for p in command.get_params(context) for name in (*p.opts, *p.secondary_opts)} | {"--help"}
        wrong += [f"{page}: {given[0]} {w}" for w in words if w.startswith("--") and w.partition("=")[0] not in known]
    assert not wrong, "\n".join(wrong)


def test_notebooks_are_kept_without_outputs():
    for path in (DOCS / "notebooks").glob("*.ipynb"):
        cells = json.loads(path.read_text())["cells"]
        assert not any(cell.get("outputs") or cell.get("execution_count") for cell in cells), path.name
