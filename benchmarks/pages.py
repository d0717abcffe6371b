"""The pages of every command in a real browser: drawn, zoomed, sorted, on a phone's screen and on paper.

Each page is opened as a reader opens it, without a network. What is counted must be 0: complaints of the browser's
console, charts that are not drawn, that do not zoom or do not come back, pages that scroll sideways on a screen of
390 pixels, charts without a picture and rows that are missing on paper, tables that do not sort, charts that have no
picture where scripts are off.
"""

from __future__ import annotations

import contextlib
import io
import tempfile
from dataclasses import dataclass
from pathlib import Path

from benchmarks.measure import Figure, save
from tests.support.chromium import Browser, OpenPage

ROOT = Path(__file__).resolve().parents[1]
PRACTICE = "scenarios/records/practice"
COMMANDS = {
    "run": "run scenarios/recorded_sts107.toml",
    "synthesize": "synthesize scenarios/recorded_sts107.toml",
    "predict": f"predict {PRACTICE}/p06 {PRACTICE}/p08",
    "estimate": f"estimate {PRACTICE}/p06 {PRACTICE}/p08",
    "segments": f"estimate {PRACTICE}/p08 --segments 100",
    "close-loop": f"close-loop {PRACTICE}/p06 {PRACTICE}/p08",
    "design": "design scenarios/design_flap.toml --evaluations 4",
    "plan": "plan scenarios/studies/small_envelope.toml",
}
"""Commands that write pages, each without its --out."""
PHONE = 390
LARGEST_MB = 1.0

CHARTS = "document.querySelectorAll('figure.chart').length"
DRAWN = "document.querySelectorAll('figure.drawn canvas').length && Number(document.documentElement.dataset.charts)"
HOME = "[...document.querySelectorAll('figure.drawn')].every((f) => [...f.querySelectorAll('button')].find("
HOME += "(b) => b.textContent === 'Reset zoom').disabled)"
ZOOM = "document.querySelectorAll('.plot').forEach((p) => p.dispatchEvent(new KeyboardEvent('keydown', {{key: '{}'}})))"
UNPICTURED = "[...document.querySelectorAll('img')].filter((i) => !(i.offsetParent && i.naturalWidth)).length"
CANVASES = "[...document.querySelectorAll('canvas, .tools')].filter((c) => c.offsetParent).length"
ROWS = "document.querySelectorAll('tbody tr').length"
SHOWN = "[...document.querySelectorAll('tbody tr')].filter((r) => r.offsetParent).length"
WRONG_ORDER = """[...document.querySelectorAll('.tools')].reduce((wrong, tools) => {
  const table = document.getElementById(tools.dataset.rows), heads = [...table.tHead.rows[0].cells];
  return wrong + heads.filter((head, k) => {
    const values = () => [...table.tBodies[0].rows].map((r) => r.cells[k].dataset.value).filter((v) => v).map(Number);
    head.querySelector('button').click();
    const up = values();
    head.querySelector('button').click();
    const down = values();
    return up.some((v, i) => i && v < up[i - 1]) || down.some((v, i) => i && v > down[i - 1]);
  }).length;
}, 0)"""
FILTER = """document.querySelectorAll('.tools input').forEach((e) => {
  e.value = 'no row has this text'; e.dispatchEvent(new Event('input'));
})"""
FRAMES = "new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))"


@dataclass
class Faults:
    """What is wrong with pages, counted."""

    complaints: int = 0
    undrawn: int = 0
    zoom: int = 0
    sideways: int = 0
    paper: int = 0
    order: int = 0
    without_scripts: int = 0


def write_pages(home: Path) -> list[Path]:
    """The pages of all commands, written below a folder."""
    from sim_heating.cli import cli

    for name, command in COMMANDS.items():
        arguments = [str(ROOT / a) if a.startswith("scenarios/") else a for a in command.split()]
        with contextlib.redirect_stdout(io.StringIO()):
            cli.main([*arguments, "--out", str(home / name)], standalone_mode=False)
    return sorted(home.rglob("report.html"))


def inspect(browser: Browser, path: Path, faults: Faults) -> tuple[int, int]:
    """Use a page as a reader does and count what is wrong; the numbers of its charts and its rows."""
    page = browser.open(path)
    charts, rows = page.evaluate(CHARTS), page.evaluate(ROWS)
    if charts:
        faults.undrawn += charts - page.evaluate(DRAWN)
        faults.zoom += _zoom_faults(page)
    faults.order += page.evaluate(WRONG_ORDER)
    page.resize(PHONE)
    page.evaluate(FRAMES)
    faults.sideways += page.evaluate("document.documentElement.scrollWidth") > PHONE
    page.evaluate(FILTER)
    page.call("Emulation.setEmulatedMedia", media="print")
    faults.paper += page.evaluate(UNPICTURED) + page.evaluate(CANVASES) + rows - page.evaluate(SHOWN)
    faults.complaints += len(page.complaints())
    without = browser.open(path, scripts=False)
    faults.without_scripts += without.evaluate(UNPICTURED) + without.evaluate(CANVASES) + rows - without.evaluate(SHOWN)
    return charts, rows


def _zoom_faults(page: OpenPage) -> int:
    """Whether the charts do not begin unzoomed, do not zoom, or do not come back."""
    states = []
    for key in ("", "+", "0"):
        if key:
            page.evaluate(ZOOM.format(key))
        page.evaluate(FRAMES)
        states.append(page.evaluate(HOME))
    return int(states != [True, False, True])


def run() -> list[Figure]:
    """Write all pages, read them, and save what was found."""
    faults, charts, rows, largest_MB = Faults(), 0, 0, 0.0
    with tempfile.TemporaryDirectory() as folder, Browser() as browser:
        pages = write_pages(Path(folder))
        for path in pages:
            drawn, shown = inspect(browser, path, faults)
            charts, rows, largest_MB = charts + drawn, rows + shown, max(largest_MB, path.stat().st_size / 1e6)
    figures = [
        Figure("pages read", len(pages), ""),
        Figure("charts in them", charts, ""),
        Figure("rows of their tables", rows, ""),
        Figure("largest page", largest_MB, "MB", LARGEST_MB),
        Figure("complaints of the browser", faults.complaints, "", 0),
        Figure("charts not drawn", faults.undrawn, "", 0),
        Figure("pages whose charts do not zoom and come back", faults.zoom, "", 0),
        Figure("columns not sorted", faults.order, "", 0),
        Figure("pages that scroll sideways at 390 pixels", faults.sideways, "", 0),
        Figure("on paper: pictures or rows missing, charts left", faults.paper, "", 0),
        Figure("without scripts: pictures or rows missing", faults.without_scripts, "", 0),
    ]
    save("pages", figures)
    return figures


if __name__ == "__main__":
    run()
