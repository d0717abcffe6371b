"""Statements of close-loop by class, their reliability, ranks of parameters and coverage of intervals, from rows of
closure_challenge.py.

- Statements: of each class and world how many are right, undecided, missed, wrong, and wrong and `found`.
- Reliability: the probability of a finding is fitted to all classes but one (closure_calibration.py) and compared with
  how often the findings of this one are right. Findings on models with an error have no stated probability; this one
  stands in for it, and is marked as such.
- Ranks: where a cause is right and has a form of the library, Phi((truth - value) / sigma) of each of its parameters,
  and of scale and slopes. Over many records ranks of right intervals are uniform (Talts et al. 2018, arXiv:1804.06788,
  here with normal posteriors in place of samples).
- Coverage: how often the truth lies within 1.96 sigma; for the size of the model's error how often the true one is
  below the limit that is stated with 95 %.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from scipy.stats import kstest, norm

from benchmarks.challenge.point import DERIVATIVES, VARIABLES
from benchmarks.challenge.record import NOTHING_TRUE
from benchmarks.closure_challenge import (
    NAMED,
    beside,
    explains,
    in_library,
    is_right,
    is_statement,
    limits,
    share_of,
    things,
    truth_of,
    verdict,
)
from benchmarks.measure import Figure

Row = Mapping[str, Any]

VERDICTS = ("right", "undecided", "missed", "wrong")
SURE = 0.9
"""Probability from which on a statement is called sure."""
LEAST_EVIDENCE = 5.0
"""Log evidence of the true form over none, under the true noise, from which on a cause ought to be stated."""
SEVERAL = ("three", "rivals")
WITHIN = 1.96
BINS = (0.0, 0.5, 0.7, 0.8, 0.9, 0.95, 1.0)
FEWEST = 12
"""Statements below which no probability is fitted to them."""
ONSETS = ("log10_re_onset", "alpha_onset_deg", "catalysis_K", "change_s")
LAGS = ("lag_s", "tau_s", "skew_s")
WIDTHS = ("width", "catalysis_width_K", "decay_s")
GROUPS = {"onsets": ONSETS, "lags": LAGS, "widths": WIDTHS}
ELSEWHERE = ("emissivity_slope", "start_s", "boil_K")
"""Parameters that the two programs define differently."""
CURVED = ("alpha-curvature", "elevon-curvature", "bodyflap-curvature", "interaction", "impingement-onset")
"""Effects beside which a slope of the ratio depends on the condition that it is taken at."""


def world_of(row: Row) -> str:
    """`exact` or `imperfect`."""
    return str(row.get("world", "exact"))


def group_of(row: Row) -> str:
    """World and class."""
    return f"{world_of(row)} {row['class']}"


# Statements ----------------------------------------------------------------------------------------------------------


def statements(rows: Sequence[Row]) -> dict[str, dict[str, int]]:
    """World and class -> how many there are, by verdict, wrong and `found`, and refused."""
    found: dict[str, dict[str, int]] = {}
    for group in dict.fromkeys(map(group_of, rows)):
        some = [r for r in rows if group_of(r) == group]
        verdicts = [verdict(r) for r in some]
        found[group] = {"records": len(some)} | {v: verdicts.count(v) for v in VERDICTS}
        found[group]["wrong and found"] = sum(
            v == "wrong" and r["finding"] == "found" for r, v in zip(some, verdicts, strict=True)
        )
        found[group]["refused"] = sum(r["finding"] == "refused" for r in some)
    return found


def is_named(row: Row) -> bool:
    """Whether a cause is stated."""
    return row["finding"] in NAMED and bool(things(row))


def is_visible(row: Row, key: str = "log_evidence") -> bool:
    """Whether each true cause has at least LEAST_EVIDENCE over none under the true noise.

    key : of the evidence in a row; `log_evidence_unknown_times` where nobody knows when arcs of a trajectory end
    """
    worth = row.get(key, [])
    return bool(worth) and min(worth) >= LEAST_EVIDENCE


def names_all(row: Row) -> bool:
    """Whether every true cause is in what is stated, and nothing else is."""
    return row["finding"] in NAMED and explains(things(row), truth_of(row))


def tells_all(row: Row) -> bool:
    """Whether every true cause is in what is stated or resembled, and nothing else is."""
    partly = row["finding"] == "partly" and bool(row["alternatives"])
    return names_all(row) or (partly and explains(things({**row, "finding": "one of"}), truth_of(row)))


def probability_of(row: Row) -> float:
    """The calibrated probability that is stated; else that of the other classes, NaN where there is none."""
    return float(row["probability"] if row.get("calibrated") else row.get("of_other_classes", math.nan))


def study_figures(rows: Sequence[Row]) -> list[Figure]:
    """The figures with their goals."""
    judged = with_probabilities(rows)

    def of(*classes: str, world: str | None = None) -> list[Row]:
        return [r for r in judged if r["class"] in classes and world in (None, world_of(r))]

    def wrong_found(row: Row) -> bool:
        return row["finding"] == "found" and not is_right(row)

    def sure_and_wrong(row: Row) -> bool:
        return is_statement(row) and probability_of(row) >= SURE and not is_right(row)

    one = [r for r in of("one") if is_visible(r)]
    several = [r for r in of(*SEVERAL) if is_visible(r)]
    lacking, nulls = of("lacking", "unknown"), of(*NOTHING_TRUE, world="imperfect")
    figures = [
        *share_of("nulls with model error: a cause is named", nulls, is_named, 0.02, False),
        *share_of("nulls without: a cause is named", of("null", world="exact"), is_named, 0.01, False),
        *share_of("nulls with model error: none", nulls, is_right, 0.0),
    ]
    for world in ("exact", "imperfect"):
        some = [r for r in one if world_of(r) == world]
        figures += share_of(f"one cause worth {LEAST_EVIDENCE:g} or more, {world}: stated", some, names_all, 0.85)
        figures += share_of(f"the same, {world}: stated or resembled", some, tells_all, 0.85)
    blind = [r for r in of("one", world="imperfect") if is_visible(r, "log_evidence_unknown_times")]
    figures += share_of("worth as much where the times of arcs are not known: stated", blind, names_all, 0.85)
    figures += [
        *share_of(f"the same, both: wrong at {SURE} or more", one, sure_and_wrong, 0.02, False),
        *share_of("the same, both: wrong and `found`", one, wrong_found, 0.02, False),
        *share_of("three causes, each worth as much: all stated", several, names_all, 0.85),
        *share_of("three causes: wrong and `found`", several, wrong_found, 0.03, False),
        *share_of(f"cause that no library has: another at {SURE} or more", lacking, sure_and_wrong, 0.03, False),
        *share_of("cause that no library has: `found` with another", lacking, wrong_found, 0.03, False),
        *share_of("contradicts itself", judged, lambda r: bool(r.get("contradictions")), 0.0, False),
    ]
    errors = calibration_errors(judged)
    for name, (error, count) in errors.items():
        figures.append(Figure(f"expected calibration error, {name}", error, "", 0.05, note=f"{count} findings"))
    return [*figures, *_coverage_figures(judged)]


# Reliability ---------------------------------------------------------------------------------------------------------


def with_probabilities(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """The rows, those of findings with the probability that the other classes give."""
    from benchmarks.closure_calibration import left_out  # which uses the verdicts as well

    plain = [dict(r) | {"group": group_of(r), "index": i} for i, r in enumerate(rows)]
    some = [r for r in plain if is_statement(r) and "rival" in r]
    groups = {r["group"] for r in some}
    if len(some) < FEWEST or len(groups) < 2 or len({is_right(r) for r in some}) < 2:
        return plain
    given = {r["index"]: r["probability"] for r in left_out(some, "group")}
    return [r | ({"of_other_classes": given[r["index"]]} if r["index"] in given else {}) for r in plain]


def reliability_by_class(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Of each class the probability of its findings as the others give it, as stated, and how often they are right."""
    judged = [r for r in with_probabilities(rows) if "of_other_classes" in r]
    found = []
    for group in dict.fromkeys(r["group"] for r in judged):
        some = [r for r in judged if r["group"] == group]
        hits = sum(map(is_right, some))
        told = [r["probability"] for r in some if r.get("calibrated")]
        found.append({
            "class": group, "findings": len(some), "right": hits / len(some), "limits": limits(hits, len(some)),
            "by the others": float(np.mean([r["of_other_classes"] for r in some])),
            "as stated": float(np.mean(told)) if told else None, "stated": len(told),
        })  # fmt: skip
    return found


def calibration_errors(judged: Sequence[Row]) -> dict[str, tuple[float, int]]:
    """Expected calibration error of stated probabilities, and of those from other classes, with the findings they are
    of: the mean over findings of |mean probability - share right| of their bin."""
    chosen: dict[str, list[tuple[float, bool]]] = {
        "as stated": [(r["probability"], is_right(r)) for r in judged if is_statement(r) and r.get("calibrated")],
        "by other classes": [(r["of_other_classes"], is_right(r)) for r in judged if "of_other_classes" in r],
    }
    found = {}
    for name, pairs in chosen.items():
        if not pairs:
            continue
        p, right = np.array([p for p, _ in pairs]), np.array([r for _, r in pairs], dtype=float)
        at = np.clip(np.digitize(p, BINS[1:-1]), 0, len(BINS) - 2)
        parts = [(np.sum(at == k), p[at == k], right[at == k]) for k in range(len(BINS) - 1) if np.any(at == k)]
        error = sum(n * abs(float(np.mean(a) - np.mean(b))) for n, a, b in parts) / len(p)
        found[name] = (float(error), len(p))
    return found


# Ranks and coverage --------------------------------------------------------------------------------------------------


def estimates(row: Row) -> Iterator[tuple[str, float, float, float]]:
    """Name, truth, value and sigma of each parameter that the truth and the report have in common, where the cause is
    right and its form is one of the library."""
    of_library = in_library(row) or row["class"] in NOTHING_TRUE
    if not (is_right(row) and of_library and is_statement(row)):
        return
    stated = {e["name"]: e["parameters"] for e in row.get("effects_stated", [])}
    for name, truth in zip(row.get("effects", []), row.get("parameters", []), strict=False):
        for key, p in stated.get(name, {}).items():
            if isinstance(truth.get(key), float) and p["sigma"] and key not in ELSEWHERE:
                yield f"{name}.{key}", truth[key], p["value"], p["sigma"]
    yield from _of_ratio(row)


def _of_ratio(row: Row) -> Iterator[tuple[str, float, float, float]]:
    """Those of scale and slopes, which with a curvature depend on the reference condition; the scale only where it does
    not change by half its sigma between that of the truth and that of the report."""
    if {*row.get("effects", [])} & {*CURVED}:
        return
    true, stated = row.get("true_errors", {}), row.get("derivatives", {})
    about, reference = row.get("reference_condition", {}), row.get("reference_stated") or {}
    pairs = zip(VARIABLES, DERIVATIVES, strict=True)
    moved = {d: reference.get(v, about[v]) - about[v] for v, d in pairs if v in about}
    for key, truth in true.items():
        p = stated.get(f"ratio.{key}")
        if p is None or not p["sigma"]:
            continue
        shift = sum(true[d] * x for d, x in moved.items()) / row["mean_ratio"]
        if key != "scale" or abs(shift) < 0.5 * p["sigma"]:
            yield f"ratio.{key}", truth, p["value"], p["sigma"]


def ranks(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Of each parameter, how many estimates, mean and scatter of the deviations over sigma, the p-value of uniform
    ranks (Kolmogorov-Smirnov), and how many 95 % intervals hold the truth."""
    deviations: dict[tuple[str, str], list[float]] = defaultdict(list)
    for row in rows:
        for name, truth, value, sigma in estimates(row):
            deviations[world_of(row), name].append((truth - value) / sigma)
    found = []
    for (world, name), z in sorted(deviations.items()):
        inside = int(np.sum(np.abs(z) <= WITHIN))
        found.append({
            "world": world, "parameter": name, "n": len(z), "mean": float(np.mean(z)),
            "scatter": float(np.sqrt(np.mean(np.square(z)))),
            "uniform": float(kstest(norm.cdf(z), "uniform").pvalue),
            "within": inside / len(z), "limits": limits(inside, len(z)),
        })  # fmt: skip
    return found


def _coverage_figures(rows: Sequence[Row]) -> list[Figure]:
    """Coverage of onsets, lags, widths, all parameters of causes, and of the size of the model's error."""
    z: dict[str, list[float]] = defaultdict(list)
    for row in rows:
        for name, truth, value, sigma in estimates(row):
            own = name.rpartition(".")[2]
            group = next((g for g, names in GROUPS.items() if own in names), "")
            whose = "scale and slopes" if name.startswith("ratio.") else "all parameters of causes"
            for g in filter(None, (group, whose)):
                z[g].append((truth - value) / sigma)
    figures = []
    for group in (*GROUPS, "all parameters of causes", "scale and slopes"):
        if z[group]:
            figures += share_of(f"95 % intervals hold the truth, {group}", [{"z": x} for x in z[group]], _inside, 0.93)
    told = [r for r in rows if r.get("stated_error") and "model_error" in r and r["model_error"]["heating"]]
    exact = [r for r in rows if r.get("stated_error") and "model_error" in r and is_exact(r["model_error"])]
    what = "called measured, and exact: 95 % limit of the error below 1 % of the heating"
    figures += share_of(what, exact, lambda r: r["stated_error"]["relative_heating"]["limit_95"] < 0.01, 0.9)
    for name, key in (("realised size", "rms_while_hot"), ("standard deviation", "relative")):
        figures += share_of(f"model error below its stated 95 % limit, {name}", told, _below(key), 0.93)
    return figures


def is_exact(error: Mapping[str, Any]) -> bool:
    """Whether neither heating nor flight nor clock of a record differ from what it states."""
    return not (error["heating"] or error["flight"] or error["drift_s"] or error["spike"])


def _inside(row: Row) -> bool:
    return abs(row["z"]) <= WITHIN


def _below(key: str) -> Callable[[Row], bool]:
    return lambda row: bool(row["model_error"][key] <= row["stated_error"]["relative_heating"]["limit_95"])


# All of it -----------------------------------------------------------------------------------------------------------


def study(rows: Sequence[Row]) -> dict[str, Any]:
    """The tables, as data."""
    return {
        "statements": statements(rows),
        "reliability_by_class": reliability_by_class(rows),
        "ranks": ranks(rows),
        "contradictions": {r["record"]: r["contradictions"] for r in rows if r.get("contradictions")},
        "refused": {r["record"]: r.get("message", "") for r in rows if r["finding"] == "refused"},
        "named_beside_the_truth": {
            r["record"]: [r["finding"], r["alternatives"], truth_of(r)]
            for r in rows
            if r["finding"] in NAMED and beside(r)
        },
    }


def study_text(rows: Sequence[Row]) -> str:
    """The tables, as text."""
    found = study(rows)
    heads = ("records", *VERDICTS, "wrong and found", "refused")
    lines = [f"{'statements':<22}" + "".join(f"{k:>16}" for k in heads)]
    for group, counts in found["statements"].items():
        lines.append(f"{group:<22}" + "".join(f"{n:>16}" for n in counts.values()))
    lines += ["", f"{'reliability':<22}{'findings':>10}{'right':>8}{'95 % limits':>16}{'by others':>11}{'stated':>8}"]
    for part in found["reliability_by_class"]:
        low, high = part["limits"]
        stated = "-" if part["as stated"] is None else f"{part['as stated']:.2f}"
        lines.append(
            f"{part['class']:<22}{part['findings']:>10}{part['right']:>8.2f}{f'{low:.2f} to {high:.2f}':>16}"
            f"{part['by the others']:>11.2f}{stated:>8}"
        )
    lines += ["", f"{'ranks':<48}{'n':>5}{'mean':>8}{'scatter':>9}{'uniform':>9}{'within':>8}"]
    for r in found["ranks"]:
        lines.append(
            f"{r['world'] + ' ' + r['parameter']:<48}{r['n']:>5}{r['mean']:>8.2f}{r['scatter']:>9.2f}"
            f"{r['uniform']:>9.3f}{r['within']:>8.2f}"
        )
    for what in ("contradictions", "refused"):
        lines += ["", what, *(f"{name}: {said}" for name, said in found[what].items())]
    return "\n".join(lines)
