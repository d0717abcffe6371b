"""Tables of pages that are made of results which the benchmarks keep; written by `benchmarks.page_figures`.

A table stands between `<!-- results of NAME, PART -->` and `<!-- end -->`; NAME is a file of benchmarks/results, PART a
key of TABLES. Where the file does not exist, the page says which command makes it.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np

from benchmarks.end_to_end import Result, counted_of
from benchmarks.measure import RESULTS
from benchmarks.page import markdown_table

TILES = ("468", "480", "597", "730")
MISSED = 0.4
"""Error after over before that is asked of a transition that was found; above it a cell is bold."""
Results = Mapping[str, Any]


def table_of(marked: str) -> str | None:
    """The table of a marked part of a page; None for one that is not made here."""
    name, _, _ = marked.partition(", ")
    if marked not in TABLES:
        return None
    path = RESULTS / f"{name}.json"
    if not path.is_file():
        return f"Not run yet: `python -m benchmarks {name}`.\n"
    return TABLES[marked](json.loads(path.read_text(encoding="utf-8")))


# Tiles of STS-96 -----------------------------------------------------------------------------------------------------


class Figures:
    """Figures of a result by their names."""

    def __init__(self, results: Results) -> None:
        self._of = {f["what"]: f for f in results["figures"]}

    def value(self, what: str) -> float:
        """Value of a figure."""
        return float(self._of[what]["value"])

    def noted(self, what: str, before: str) -> str:
        """Number that follows these words in the note of a figure."""
        found = re.search(rf"{re.escape(before)}\s*(\S+?)(?:[,;]|\s|$)", self._of[what]["note"])
        if found is None:
            raise ValueError(f"{what!r}: no {before!r} in the note {self._of[what]['note']!r}")
        return found[1]

    def names(self) -> Iterable[str]:
        """Names in the order of the file."""
        return self._of


def sts96_tiles(results: Results) -> str:
    """Onset, factor and errors of each tile on the nominal entry."""
    f = Figures(results)

    def errors(kind: str) -> list[str]:
        cases = ("declared", "before", "after")
        return [", ".join(f"{f.value(f'STS96_{t}, {c}: RMSE, {kind}'):.1f}" for c in cases) for t in TILES]

    def found(name: str, form: str) -> list[str]:
        return [f"{f.value(f'STS96_{t}: {name}'):{form}} +- {f.noted(f'STS96_{t}: {name}', '+-')}" for t in TILES]

    apart = "onset apart from the rise"
    rows = [
        ["rise measured at, s", *(f.noted(f"STS96_{t}: {apart}", "rise at") for t in TILES)],
        [f"{apart}, s", *(f"{f.value(f'STS96_{t}: {apart}'):.1f}" for t in TILES)],
        ["onset log10 Re", *found("log10_re_onset", ".3f")],
        ["width in log10 Re", *found("width", ".3f")],
        ["turbulent over laminar", *found("factor", ".1f")],
        ["Mach there", *(f"{f.value(f'STS96_{t}: Mach at onset'):.1f}" for t in TILES)],
        ["angle of attack there, deg", *(f.noted(f"STS96_{t}: Mach at onset", "alpha") for t in TILES)],
        ["about the rise: declared, before, after", *errors("window")],
        ["**after over before**", *(_over(f.value(f"STS96_{t}: RMSE after/before")) for t in TILES)],
        ["fit segments: declared, before, after", *errors("fit")],
        ["held out: declared, before, after", *errors("holdout")],
        ["whole entry: declared, before, after", *errors("whole entry")],
    ]
    return markdown_table(("tile", *TILES), rows)


def sts96_entries(results: Results) -> str:
    """Errors and onsets of the tiles on other entries."""
    f = Figures(results)
    last = f", STS96_{TILES[0]}: RMSE after/before"
    names = [what.removesuffix(last) for what in f.names() if what.endswith(last)]
    rows = []
    for entry in ("", *names):
        start = f"{entry}, STS96_" if entry else "STS96_"
        rows.append([
            entry or "nothing",
            ", ".join(_over(f.value(f"{start}{t}: RMSE after/before")) for t in TILES),
            ", ".join(f"{float(f.noted(f'{start}{t}: RMSE after/before', 'log10 Re')):.2f}" for t in TILES),
            ", ".join(f"{f.value(f'{start}{t}: onset apart from the rise'):.0f}" for t in TILES),
        ])  # fmt: skip
    tiles = ", ".join(TILES)
    head = ("changed", f"after over before: {tiles}", "onset log10 Re", "onset apart from the rise, s")
    return markdown_table(head, rows)


def _over(ratio: float) -> str:
    return f"**{ratio:.2f}**" if ratio > MISSED else f"{ratio:.2f}"


# Scenarios to estimates ----------------------------------------------------------------------------------------------


def end_to_end_truths(results: Results) -> str:
    """Fits of all scenarios, by truth and by what was fitted."""
    truths = {"linear": "linear: scale and derivatives", "table": "table: every node off by 0.3 of its sigma"}
    ways = {"whole": "whole entry", "manoeuvre": "manoeuvre and 50 s about it"}
    rows = []
    for truth, truth_title in truths.items():
        for way, way_title in ways.items():
            mine = [r for r in _fits(results) if (r.truth, r.way) == (truth, way)]
            z = np.abs([z for r in mine for z in r.errors.values()])
            others = [v for r in mine for v in r.checked.values()]
            rows.append([
                truth_title, way_title, f"{np.mean(z <= 2.0):.2f} of {len(z)}", f"{np.median(z):.2f}",
                _medians(mine), _median_worst([r.after / r.fit for r in mine]), _median_worst([r.seed for r in mine]),
                f"{_median_worst(others)} of {len(others)}",
            ])  # fmt: skip
    head = (
        "truth", "fitted", "errors within 2 sigma (0.95 expected)", "median error, sigma (0.67 expected)",
        "RMSE with the tables before, of the fit, with the tables after, after from entry (medians, noise floors)",
        "tables after over fit (median, worst)",
        "same manoeuvres with other noise, after over before (median, worst)",
        "manoeuvres that were not fitted, after over before (median, worst)",
    )  # fmt: skip
    return markdown_table(head, rows)


def end_to_end_scenarios(results: Results) -> str:
    """Fits of each scenario: truths, points and segments together."""
    fits = _fits(results)
    rows = []
    for name in dict.fromkeys(r.scenario for r in fits):
        mine = [r for r in fits if r.scenario == name]
        rows.append([
            f"`{name}`", len(mine), *_medians(mine).split(", "), f"{max(r.after / r.fit for r in mine):.2f}",
            f"{max(r.seed for r in mine):.2f}", f"{max(v for r in mine for v in r.checked.values()):.2f}",
        ])  # fmt: skip
    head = ("scenario", "fits", "before", "fit", "after", "after from entry", "after over fit", "other noise",
            "other manoeuvres")  # fmt: skip
    return markdown_table(head, rows)


def _fits(results: Results) -> list[Result]:
    return counted_of([Result(**{**r, "left_out": tuple(r["left_out"])}) for r in results["results"]])


def _medians(fits: list[Result]) -> str:
    before, fit, after, entry = (float(np.median([getattr(r, k) for r in fits])) for k in _ERRORS)
    return f"{before:.1f}, {fit:.2f}, {after:.2f}, {entry:.2f}"


_ERRORS = ("before", "fit", "after", "from_entry")


def _median_worst(values: list[float]) -> str:
    return f"{np.median(values):.2f}, {max(values):.2f}"


# Dispersed entries ---------------------------------------------------------------------------------------------------

OFTEN = 0.01
"""Share of the flights above a limit from which on a peak is listed."""


def dispersed_peaks(results: Results) -> str:
    """Peaks whose limit more than one flight in a hundred exceeds, most often exceeded first."""
    peaks = [p for p in results["peaks"] if p["exceeded"] and p["exceeded"][0] > OFTEN]
    rows = []
    for p in sorted(peaks, key=lambda p: -p["exceeded"][0]):
        share, low, high = (100.0 * x for x in p["exceeded"])
        rare, rare_low, rare_high = p["rare_K"]
        rows.append([
            f"{p['control_point']} {p['quantity']}", f"{p['limit_K']:.0f}", f"{p['median_K']:.0f}",
            f"{rare:.0f} ({rare_low:.0f} to {rare_high:.0f})", f"{share:.1f} % ({low:.1f} to {high:.1f})",
        ])  # fmt: skip
    head = ("peak", "limit, K", "median, K", "0.999 quantile, K (bounds of 95 %)", "flights above the limit (bounds)")
    return markdown_table(head, rows)


TABLES: Mapping[str, Callable[[Results], str]] = {
    "sts96, tiles": sts96_tiles,
    "sts96, entries": sts96_entries,
    "end_to_end, truths": end_to_end_truths,
    "end_to_end, scenarios": end_to_end_scenarios,
    "dispersed_entry, peaks": dispersed_peaks,
}
"""What stands behind `results of` on a page -> the function that writes it."""
