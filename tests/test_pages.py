"""Pages of the documentation: what they link to exists, and a reader finds every page from the front page."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

import sim_heating as sh
from tests.support.paths import ROOT

DOCS = ROOT / "docs"
PAGES = sorted(p for p in DOCS.rglob("*.md") if "_build" not in p.parts)
TOP = [ROOT / name for name in ("README.md", "CHANGELOG.md", "CONTRIBUTING.md") if (ROOT / name).is_file()]
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
