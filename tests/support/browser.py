"""A real browser for the pages of the program, and texts that try to run a script in it."""

from __future__ import annotations

import base64
import hashlib
import re
import subprocess
from html import unescape
from html.parser import HTMLParser
from pathlib import Path

import pytest

from sim_heating.base.report.page import CHART_SCRIPTS, SHARED_SCRIPTS, TABLE_SCRIPTS
from tests.support.chromium import CHROMIUM, Browser
from tests.support.paths import ROOT

needs_browser = pytest.mark.browser
"""Mark of a test that opens pages in Chromium: thorough, and skipped where that is not installed (conftest.py)."""

CANARY = "document.documentElement.setAttribute(`data-ran`,`{where}`)"
ATTACKS = (
    "<script>{canary}</script>",
    '"><img src=x onerror="{canary}">',
    "'><svg/onload={canary}>",
    "</title></style></script><script>{canary}</script>",
    '" onmouseover="{canary}" autofocus onfocus="{canary}" x="',
    "<a href='javascript:{canary}'>javascript:{canary}</a>",
    "<iframe srcdoc='<script>parent.{canary}</script>'></iframe>",
    "<meta http-equiv=refresh content='0;url=javascript:{canary}'><base href='https://elsewhere.invalid/'>",
    "&lt;script&gt;{canary}&lt;/script&gt; &#60;script>{canary}&#60;/script>",
    "{{ 7 * 7 }} {% include 'page.html.j2' %} ]]> --> <!--",
    "$x^$ \x1b[31m \x07 \u202etxt.exe\u202c \x9b",
)
"""Texts that run a script, or change what a page says, where a page does not escape them."""
POLICY = re.compile(r'<meta http-equiv="Content-Security-Policy"[^>]*>\n?')
EVERY_EVENT = """<script>
for (const e of document.querySelectorAll("*")) {
  for (const kind of ["click", "mouseover", "focus", "load", "error"]) e.dispatchEvent(new Event(kind));
  if (e.href && (e.protocol !== "file:" || e.hash)) e.click();
}
</script>"""
"""What a reader may do, added by a test to a page without its policy: every element is touched, every link
followed that leads to no other file."""
CONTENT = {
    "html", "head", "meta", "title", "style", "body", "main", "header", "h1", "h2", "p", "div", "strong", "nav", "a",
    "section", "ul", "li", "table", "caption", "thead", "tbody", "tr", "th", "td", "figure", "img", "figcaption",
    "footer", "noscript", "script", "span", "wbr", "code",
}  # fmt: skip
ATTRIBUTES = {
    "lang", "charset", "name", "content", "class", "id", "href", "scope", "role", "src", "alt", "http-equiv",
    "type", "data-rows", "data-choice", "data-value", "style",
}  # fmt: skip
STYLE = re.compile(r"--widest: \d+px")
"""What an element may have as its own style: the width of its picture."""

SCRIPTS = (*SHARED_SCRIPTS, *CHART_SCRIPTS, *TABLE_SCRIPTS)
"""Scripts that a page may have, in this order."""


def hostile(where: str, without: str = "") -> str:
    """A text with all attacks; its script would leave `where` in the page.

    without : characters that the field does not take
    """
    text = f"{where} " + " ".join(ATTACKS).replace("{canary}", CANARY.replace("{where}", where))
    return "".join(c for c in text if c not in without)


WIDER_THAN_THE_SCREEN = """
[...document.querySelectorAll('main *')].filter((e) => {
  const isCut = (q) => q.tagName === 'MAIN' || (getComputedStyle(q).overflowX === 'visible' && isCut(q.parentElement));
  return e.getBoundingClientRect().right > innerWidth + 0.5 && isCut(e.parentElement);
}).map((e) => `${e.tagName}: ${e.textContent.trim().slice(0, 60)}`)
"""
WITHOUT_CONTENT = """
[...document.querySelectorAll('section, tbody')].filter((e) => e.children.length < (e.tagName === 'TBODY' ? 1 : 2))
  .map((e) => e.closest('section').querySelector('h2').textContent)
"""
PRINTABLE_PX = 717
"""Width [CSS pixels] of what is printed on A4 between the browser's margins."""


def assert_fits(*pages: Path) -> None:
    """On a screen, a telephone and paper nothing of a page is cut off, and no section or table of it is empty.

    What is wider than the screen lies in something that scrolls; on paper nothing scrolls.
    """
    with Browser() as browser:
        for page in pages:
            _fits(browser, page)


def _fits(browser: Browser, page: Path) -> None:
    for width in (1280, 390):
        opened = browser.open(page, width)
        assert opened.evaluate("document.documentElement.scrollWidth") <= width, page
        assert opened.evaluate(WIDER_THAN_THE_SCREEN) == [], page
        assert opened.evaluate(WITHOUT_CONTENT) == [], page
    opened.resize(PRINTABLE_PX)
    opened.call("Emulation.setEmulatedMedia", media="print")
    assert opened.evaluate(WIDER_THAN_THE_SCREEN) == [], page
    assert not opened.evaluate("[...document.querySelectorAll('canvas, .tools')].some((e) => e.offsetParent)"), page
    assert opened.complaints() == [], page


def shown(page: Path) -> str:
    """The page as the browser has it after its scripts, as HTML."""
    assert CHROMIUM is not None
    profile = page.parent / "profile"
    command = [
        CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", f"--user-data-dir={profile}",
        "--virtual-time-budget=2000", "--dump-dom", page.as_uri(),
    ]  # fmt: skip
    done = subprocess.run(command, check=True, timeout=300, capture_output=True)
    return done.stdout.decode()


def assert_harmless(html: str, folder: Path) -> None:
    """Nothing runs on a page but its own scripts, though its policy is taken out and all its elements are touched."""
    (policy,) = POLICY.findall(html)
    elements = _Elements(html)
    for script in elements.scripts:
        digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
        assert f"sha256-{digest}" in unescape(policy)
    assert elements.scripts == [s for s in map(own_script, SCRIPTS) if s in elements.scripts]
    (folder / "unprotected.html").write_text(POLICY.sub("", html).replace("</body>", EVERY_EVENT + "</body>"))
    dom = shown(folder / "unprotected.html")
    assert re.findall(r'data-ran="([^"]*)"', dom) == []
    assert _Elements(dom).scripts == [*elements.scripts, EVERY_EVENT.split(">", 1)[1].rsplit("<", 1)[0]]
    assert elements.tags <= CONTENT
    assert elements.attributes <= ATTRIBUTES
    assert all(map(STYLE.fullmatch, elements.styles))
    assert all(re.match(r"#s\d+$|\./|data:image/(svg\+xml|png);base64,", address) for address in elements.addresses)
    assert not re.search("[\\x00-\\x08\\x0b-\\x1f\\x7f-\\x9f\\u202a-\\u202e]", html)


class _Elements(HTMLParser):
    """Elements, attributes, addresses and scripts of a page; data for its scripts are none."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.tags, self.attributes, self.addresses = set[str](), set[str](), list[str]()
        self.scripts: list[str] = []
        self.styles: list[str] = []
        self._in_script = False
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        self._in_script = tag == "script" and ("type", "application/json") not in attrs
        if self._in_script:
            self.scripts.append("")
        self.attributes |= {name for name, _ in attrs}
        self.styles += [value or "" for name, value in attrs if name == "style"]
        self.addresses += [value or "" for name, value in attrs if name in ("href", "src")]

    def handle_endtag(self, tag: str) -> None:
        self._in_script = False

    def handle_data(self, data: str) -> None:
        if self._in_script:
            self.scripts[-1] += data


def own_script(name: str) -> str:
    """A script of the package."""
    return (ROOT / "sim_heating" / "base" / "report" / name).read_text()
