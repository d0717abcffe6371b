"""Tables of pages that are made of results which the benchmarks keep; written by `tools.page_figures`.

A table stands between `<!-- results of NAME, PART -->` and `<!-- end -->`; NAME is a file of benchmarks/results, PART a
key of TABLES. Where the file does not exist, the page says which command makes it.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import fields
from itertools import groupby
from operator import itemgetter
from typing import Any

import numpy as np

from benchmarks.end_to_end import Result, counted_of
from benchmarks.measure import RESULTS
from sim_heating.closure.verdict.policy import POLICY
from tests.support.verification.row import Row, cells
from tools.page import markdown_table

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

    def note(self, what: str) -> str:
        """Note of a figure."""
        return str(self._of[what]["note"])

    def noted(self, what: str, before: str) -> str:
        """Number that follows these words in the note of a figure; its first word where there are none."""
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
        rows.append(
            [
                entry or "nothing",
                ", ".join(_over(f.value(f"{start}{t}: RMSE after/before")) for t in TILES),
                ", ".join(f"{float(f.noted(f'{start}{t}: RMSE after/before', 'log10 Re')):.2f}" for t in TILES),
                ", ".join(f"{f.value(f'{start}{t}: onset apart from the rise'):.0f}" for t in TILES),
            ]
        )
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
        "truth",
        "fitted",
        "errors within 2 sigma (0.95 expected)",
        "median error, sigma (0.67 expected)",
        "RMSE with the tables before, of the fit, with the tables after, after from entry (medians, noise floors)",
        "tables after over fit (median, worst)",
        "same manoeuvres with other noise, after over before (median, worst)",
        "manoeuvres that were not fitted, after over before (median, worst)",
    )
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


# Campaign ------------------------------------------------------------------------------------------------------------


def campaign_points(results: Results) -> str:
    """Medians of the errors of all manoeuvres at each control point, with the tables before and after."""
    errors = results["report"]["errors"]
    rows = []
    for point in dict.fromkeys(e["control_point"] for e in errors):
        mine = [e for e in errors if e["control_point"] == point]
        medians = (float(np.median([e[k] for e in mine])) for k in ("before_K", "after_K", "noise_floor_K"))
        rows.append([point, len(mine), *(f"{m:.2f}" for m in medians)])
    return markdown_table(("control point", "manoeuvres", "tables before, K", "revised, K", "noise floor, K"), rows)


# Design, ground test, clocks, starts, resolution, covariance --------------------------------------------------------

DESIGNED = (("design_popu", "ratio.d_alpha"), ("design_flap", "ratio.d_elevon"), ("design_flap", "ratio.d_bodyflap"))
INSTRUMENTS = (
    ("10 bits", "word: 10 bits", "word: 10 bits"),
    ("12 bits", "word: 12 bits", "word: 12 bits"),
    ("5 Hz", "rate: 5 Hz", "rate: 5 Hz"),
    ("10 Hz in manoeuvres, 1 Hz elsewhere", *2 * ("rate: 10 Hz in manoeuvres, 1 Hz elsewhere",)),
    ("10 Hz", "rate: 10 Hz", "rate: 10 Hz"),
    ("clock within 0.1 s", "clock: within 0.1 s", "clock: within 0.1 s"),
    ("clock within 0.01 s", "clock: within 0.01 s", "clock: within 0.01 s"),
    ("clock within 1 s", "clock: within 1 s", "clock: within 1 s"),
    ("surface pressure measured to 2 %", "pressure: measured to 2%", "pressure: measured to 2%"),
    ("an extra thermocouple 4 mm below the coating", "", "extra sensor: 4 mm below the coating"),
    ("a thermocouple at the bondline", "extra sensor: bondline", ""),
    ("without the outermost thermocouple", "without: V09T9527", "without: BODYFLAP_surface"),
    ("without the second", "without: V07T9528", ""),
    ("without the third", "without: V07T9529", ""),
    ("without the fourth", "without: V07T9530", ""),
    ("without the fifth", "without: V07T9531", ""),
    ("the outermost alone", "without: all but V09T9527", "without: BODYFLAP_bondline"),
)
"""Row of the table, and what varies at the plug and at the body flap; nothing where that is as declared."""
NOT_IDENTIFIED = 1e3
"""Bound over the declared one above which a parameter is not identified."""


def design_instruments(results: Results) -> str:
    """Bounds with other instruments over those with the declared ones."""
    f = Figures(results)

    def cell(design: str, parameter: str, varied: str) -> str:
        if not varied:
            return "-"
        bound = f.value(f"{design}: {varied}, {parameter}")
        return "not identified" if bound > NOT_IDENTIFIED else f"{bound:.2f}"

    rows = [
        [title, *(cell(*d, plug if d[0] == "design_popu" else flap) for d in DESIGNED)]
        for title, plug, flap in INSTRUMENTS
    ]
    return markdown_table(("", "`d_alpha`, plug", "`d_elevon`, body flap", "`d_bodyflap`, body flap"), rows)


def ground_step_fluxes(results: Results) -> str:
    """Estimates and bounds of a step test by the flux absorbed."""
    f = Figures(results)
    skew = "correlation of skew and coating"
    rows = []
    for flux in (what.partition(":")[0] for what in f.names() if what.endswith(skew)):
        coating, conductivity, clock = (
            f"{flux}: sigma of {name}"
            for name in ("stack.coating.thickness_factor", "stack.rsi.conductivity_factor", "clock.skew")
        )
        rows.append(
            [
                flux,
                f"{f.noted(coating, 'hottest thermocouple')} K",
                *(f"{f.noted(w, '')} +- {f.value(w):.{n}f}" for w, n in ((coating, 3), (conductivity, 4), (clock, 3))),
                f"{f.value(f'{flux}: {skew}'):.2f}",
            ]
        )
    head = ("absorbed flux", "hottest reading", "coating factor", "conductivity factor", "skew, s", skew)
    return markdown_table(head, rows)


def skew_coatings(results: Results) -> str:
    """What a second of skew is worth in coating, and the lead at which none is left."""
    f = Figures(results)
    second = ": one second of skew"
    rows = []
    for name in (what.removesuffix(second) for what in f.names() if what.endswith(second)):
        coating, _, surface = name.partition(" at ")
        zero = f.value(f"{name}: lead at which the coating found is none")
        rows.append([coating, surface, f"{f.value(name + second):.1f} mil", f"{zero:.1f} s"])
    head = ("coating", "surface", "a second of skew is worth", "estimated coating is zero at a lead of")
    return markdown_table(head, rows)


def segments_starts(results: Results) -> str:
    """Coverage of consecutive segments by their start."""
    f = Figures(results)
    starts = {
        "record begins at 450 s": "record begins late",
        "`profile:450`": "profile start",
        "`circuit:450`": "circuit start",
        "`filter:450`": "filter start",
    }
    rows = []
    for title, start in starts.items():
        row = [title]
        for which in ("first segment", "first segment after the gap"):
            what = f"{start}, {which}: coverage of 95% bounds"
            row += [f"{f.value(what):.3f}", f.noted(what, "RMS error"), f"{f.noted(what, '; sigma')} %"]
        row.append(f"{f.value(f'{start}, all segments: coverage of 95% bounds'):.3f}")
        row.append(f"{f.value(f'{start}: chi-square of all segments jointly with p < 0.05'):.3f}")
        rows.append(row)
    head = ("", "first segment", "RMS", "sigma of the ratio", "first after the gap", "RMS", "sigma of the ratio", "all",
            "chi-square of all jointly below p = 0.05")  # fmt: skip
    return markdown_table(head, rows)


def residual_resolution(results: Results) -> str:
    """Frequency that comes back at half its amplitude, by depth and by recorder."""
    f = Figures(results)
    depths = {"at the inner face of the coating": 0, "2 mm deeper": 2, "5 mm deeper": 5}
    recorders = ("0.3 K noise", "1 K noise", "1 K noise, 8 bits over 1378 K")
    rows = [
        [title, *(f"{f.value(f'half amplitude, {mm} mm below the coating, {r}'):.2f} Hz" for r in recorders)]
        for title, mm in depths.items()
    ]
    return markdown_table(("thermocouple", *recorders), rows)


# A board under a lamp ------------------------------------------------------------------------------------------------

MECHANISMS = {
    "plain conduction, published properties, adiabatic back": "plain conduction, adiabatic back",
    "as declared, on its stand": "declared, on its stand",
    "**and convection in front**": "convection",
    "with convection, one at a time: conductivity": "conductivity",
    "heat capacity": "heat capacity",
    "emittance": "emittance",
    "flux 3.2 % less": "flux 0.968 times",
    "flux 3.2 % more": "flux 1.032 times",
    "cooling behind the stand": "cooling behind the stand",
    "contact to the stand": "contact to the stand",
    "radiation in depth": "radiation in depth",
    "gap flow": "gap flow",
    "depths of the joints, each free": "depths of the joints",
    "specific heat falling as silica fibres'": "specific heat as silica fibres'",
    "conductivity of gas, solid and radiation": "conductivity of gas, solid, radiation",
    "both of these, and a factor of conductivity": "both, and a factor of conductivity",
    "moisture boils, its vapour leaves": "moisture boils",
    "moisture boils, heat given off about a temperature": "moisture boils, given off at a temperature",
    "vapour diffuses inward": "vapour diffuses inward",
    "**conductivity of gas, solid, radiation, and vapour**": "conductivity of gas, solid, radiation; vapour",
}
"""Row of the table -> mechanism of the benchmark."""
JOINTS = ("5.72 mm", "11.44 mm", "17.16 mm")


def kaowool_mechanisms(results: Results) -> str:
    """Errors at the three joints and the values found, by what is added to plain conduction."""
    f = Figures(results)
    rows = []
    for title, mechanism in MECHANISMS.items():
        whats = [f"{mechanism}: RMSE {joint}" for joint in JOINTS]
        values = f.note(whats[0]).partition("; ")[2].removeprefix("d0 ")
        rows.append(
            [
                title,
                ", ".join(f"{f.value(w):.1f}" for w in whats),
                ", ".join(f.noted(w, "") for w in whats),
                ", ".join(f"{round(float(f.noted(w, 'mean late'))) or 0:+d}".replace("+0", "0") for w in whats),
                re.sub(r" \+- 0(?![.\d])", " (bound)", values),
            ]
        )
    head = ("model", "whole", "first 150 s", "late", "convection, then what else is found")
    return markdown_table(head, rows)


# Findings on shipped records ----------------------------------------------------------------------------------------


def findings_practice(results: Results) -> str:
    """Finding, probability and errors of each practice record, beside its true effect."""
    rows = []
    for name, r in results["rows"].items():
        if not r["true"]:
            continue
        added = r["finding"] in ("found", "one of")
        named = f"`{r['finding']}`" + (f": {r['named']}" if r["named"] else "")
        errors = [
            ", ".join(f"{r[f'{when}_{what}_rmse_K']:.2f}" for when in ("before", "after")[: 1 + added])
            for what in ("fit", "holdout")
        ]
        probability = "-" if r["probability"] is None else f"{r['probability']:.2f}"
        rows.append([name, r["true"], named, f"{probability}, {_p_value(r)}", *errors, f"{r['noise_floor_K']:.2f}"])
    head = ("record", "true effect", "finding", "probability, p-value", "RMSE before, after, K", "held out, K",
            "noise floor, K")  # fmt: skip
    return markdown_table(head, rows)


def _p_value(row: Mapping[str, Any]) -> str:
    return f"{row['p_value']:.2f}" if row["p_value"] >= POLICY.min_p_value else "below 1e-6"


# Verification -------------------------------------------------------------------------------------------------------


def verification_rows(results: Results) -> str:
    """Every row of the verification; a line with the subject's name before its rows."""
    head = ("reference", "expected", "got", "error", "limit", "where expected value and limit come from")
    lines: list[tuple[str, ...]] = []
    for subject, rows in groupby(results["rows"], itemgetter("subject")):
        lines.append((f"**{subject}**", "", "", "", "", ""))
        for row in (Row(**{f.name: r[f.name] for f in fields(Row)}) for r in rows):
            lines.append((*cells(row), f"{row.source}; limit: {row.limit_is}"))
    return markdown_table(head, lines)


TABLES: Mapping[str, Callable[[Results], str]] = {
    "verification": verification_rows,
    "sts96, tiles": sts96_tiles,
    "sts96, entries": sts96_entries,
    "end_to_end, truths": end_to_end_truths,
    "end_to_end, scenarios": end_to_end_scenarios,
    "dispersed_entry, peaks": dispersed_peaks,
    "campaign, points": campaign_points,
    "design, instruments": design_instruments,
    "ground_step, fluxes": ground_step_fluxes,
    "skew, coatings": skew_coatings,
    "segments, starts": segments_starts,
    "residual, resolution": residual_resolution,
    "kaowool, mechanisms": kaowool_mechanisms,
    "findings, practice": findings_practice,
}
"""What stands behind `results of` on a page -> the function that writes it."""
