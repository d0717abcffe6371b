"""close-loop on records of another program: rates of correct findings and of false alarms.

Records of `benchmarks/generator`, with undeclared effects in forms that mostly differ from the library's, and without
any. Named correctly: the first effect that is named is the one put in. Separable: no rival explains the record as well,
by the generator's own estimate; otherwise a rival counts as correct too. Errors after are compared with those of the
truth itself, which are noise, and, where they are larger, with those of a fit that is given the effect put in. Finished
records are kept in out/closure_benchmark: an interrupted run is resumed from there.
"""

from __future__ import annotations

import json
import os
import tempfile
import time
import tomllib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np
from scipy.stats import beta

from benchmarks.generator.families import FAMILIES
from benchmarks.generator.record import make_and_write
from benchmarks.measure import Figure, save, table
from sim_heating.base.files import toml_text
from sim_heating.base.parallel.batches import Job, run_batches
from sim_heating.inputs.record import load_record

if TYPE_CHECKING:
    from sim_heating.closure.search.search import SearchResult

SEED = 2026
EFFECTS, NULLS = 315, 210
"""Records with an effect, each effect in turn, and without."""
MAX_RATIO = 1.1
"""Ratio of RMSE after to that of the truth itself, which is noise, up to which the record counts as explained."""
LEDGER = Path("out") / "closure_benchmark"
NAMES = tuple(name for name in FAMILIES if name != "none")
UNKNOWN = "unknown"


def jobs() -> list[Job]:
    """Every record, those without an effect spread evenly: the finished part is representative at any time."""
    turn = np.random.default_rng([SEED, 0]).permutation(len(NAMES))
    wanted = [(k / EFFECTS, SEED, k, NAMES[turn[k % len(NAMES)]]) for k in range(EFFECTS)]
    wanted += [(k / NULLS, SEED + 1, k, "none") for k in range(NULLS)]
    return [Job(f"{effect}-{number:04d}.json", (seed, number, effect)) for _, seed, number, effect in sorted(wanted)]


def make_and_close(task: tuple[int, int, str]) -> bytes:
    """Make a record and close its loop; findings and remaining errors as JSON."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from sim_heating.closure.search.search import search_effects

    with tempfile.TemporaryDirectory() as folder:
        name, answer, _ = make_and_write((*task, Path(folder)))
        answer = tomllib.loads(toml_text(answer))
        record = load_record(Path(folder) / name)
        begun = time.process_time()
        found = search_effects(record)
        after = rmse_K(found)
        seconds = time.process_time() - begun
        known_search = found if answer["effect"] not in NAMES else search_of_effect(found, answer["effect"])
        known = rmse_K(known_search) if exceeds(after, answer["true_rmse_K"]) else None
        of_truth = found.none if answer["effect"] == "none" else known_search.conclusion.best
    row = {
        "effect": answer["effect"], "form": answer["form"], "named": found.names, "cpu_s": seconds,
        "finding": found.conclusion.finding, "alternatives": found.conclusion.alternatives,
        "kind": found.conclusion.best.kind, "rival": found.conclusion.rival, "explained": found.conclusion.explained,
        "adequacy": found.conclusion.best.adequacy.as_json(), "statistic": found.conclusion.best.adequacy.statistic,
        "true_statistic": None if answer["effect"] == UNKNOWN else of_truth.adequacy.statistic,
        "accepted": answer.get("accepted", [answer["effect"]]), "separable": answer.get("separable", True),
        "residual_over_floor": answer.get("residual_over_floor"), "noise_colour": answer["noise_colour"],
        "after": after, "truth": answer["true_rmse_K"], "known": known,
        "rounds": [
            {
                "excess_chi2": found.base.excess_chi2,
                "trials": [[t.name, t.delta_bic, t.score, t.excess_chi2] for t in found.first.trials[:4]],
            }
        ],
    }  # fmt: skip
    return json.dumps(row).encode()


def rmse_K(found: SearchResult) -> dict[str, float]:
    """RMSE [K] over fit and holdout segments, refitted with the effects found."""
    from sim_heating.closure.close import refit

    fitted = refit(found)
    return {part: e["rmse_K"] for part, e in fitted.after[0].segment_errors().items() if e}


def exceeds(after: Mapping[str, float], other: Mapping[str, float]) -> bool:
    """Whether an RMSE is more than MAX_RATIO times the other over the same segments."""
    return any(after[part] > MAX_RATIO * other[part] for part in after.keys() & other.keys())


def search_of_effect(found: SearchResult, effect: str) -> SearchResult:
    """The search with the candidates of one effect alone, its best form fitted to convergence."""
    from sim_heating.closure.search.hypothesis import Conclusion, hypothesis
    from sim_heating.closure.search.refine import refine
    from sim_heating.closure.search.search import search_round
    from sim_heating.closure.search.trials.candidates import LAG_EFFECT, SENSOR_EFFECT
    from sim_heating.closure.search.trials.trial_fit import base_trial
    from sim_heating.heating.effects import effects

    others = {*effects(), SENSOR_EFFECT, LAG_EFFECT} - {effect}
    base = base_trial(found.before)
    one = search_round(base, sorted(others), lambda fraction, text: None)
    best = refine(base, one.trials, one.tried, one.predicted)[:1]
    if not best:
        return found
    known = hypothesis([best[0]], one.forms)
    return replace(found, first=one, conclusion=Conclusion("found", known, (), 0.0))


def is_correct(row: dict[str, Any]) -> bool:
    """Whether the first effect named is the one that was put in, or a rival that is not separable from it."""
    return row["named"][0] in row["accepted"]


def limits(hits: int, n: int) -> tuple[float, float]:
    """95 % Clopper-Pearson limits of a proportion."""
    low = float(beta.ppf(0.025, hits, n - hits + 1)) if hits else 0.0
    return low, float(beta.ppf(0.975, hits + 1, n - hits)) if hits < n else 1.0


def proportion(what: str, hits: int, n: int, target: float, at_least: bool) -> Figure:
    """A proportion with its limits."""
    low, high = limits(hits, n)
    return Figure(what, hits / n, "", target, at_least, f"{hits} of {n}, 95% limits {low:.3f} to {high:.3f}")


def figures_of(rows: Sequence[dict[str, Any]]) -> list[Figure]:
    """Figures of findings, false alarms, errors relative to those of the truth, and time."""
    effects = [r for r in rows if r["effect"] != "none"]
    nulls = [r for r in rows if r["effect"] == "none"]
    separable = [r for r in effects if r["separable"]]
    figures = []
    if separable:
        figures.append(
            proportion("named right, separable", sum(map(is_correct, separable)), len(separable), 0.95, True)
        )
    if effects:
        what = "named right, all; or a rival that cannot be told from it"
        figures.append(proportion(what, sum(map(is_correct, effects)), len(effects), 0.95, True))
    if nulls:
        alarms = sum(r["named"] != ["none"] for r in nulls)
        figures.append(proportion("false alarms, records without an effect", alarms, len(nulls), 0.05, False))
    named = [r for r in effects if r["effect"] != UNKNOWN]
    for part in ("fit", "holdout"):
        both = [r for r in named if part in r["after"] and part in r["truth"]]
        over = np.array([r["after"][part] / r["truth"][part] for r in both])
        if len(over):
            note = f"median {np.median(over):.3f}, 95th percentile {np.quantile(over, 0.95):.3f}, {len(over)} records"
            share = float(np.mean(over <= MAX_RATIO))
            figures.append(
                Figure(f"share with RMSE after within {MAX_RATIO} of the truth's, {part}", share, "", note=note)
            )
            near = sum(not exceeds({part: r["after"][part]}, r["known"] or r["truth"]) for r in both)
            what = f"RMSE after within {MAX_RATIO} of the truth's or of a fit that knows the effect, {part}"
            figures.append(proportion(what, near, len(both), 0.95, True))
    seconds = np.array([r["cpu_s"] for r in rows])
    note = f"largest {seconds.max():.0f} s"
    figures.append(Figure("processor time a record, median", float(np.median(seconds)), "s", note=note))
    return figures


def confusion(rows: Sequence[dict[str, Any]]) -> dict[str, dict[str, int]]:
    """Effect put in -> effect named first -> how many."""
    return {
        effect: dict(Counter(r["named"][0] for r in rows if r["effect"] == effect))
        for effect in ("none", *NAMES)
        if any(r["effect"] == effect for r in rows)
    }


def run() -> list[Figure]:
    """Make and close the records that are not finished, in two processes; then those of closure_challenge.py."""
    from benchmarks import closure_challenge  # which uses the figures of this module

    wanted = jobs()
    outcome = run_batches(wanted, make_and_close, LEDGER, workers=2, progress=lambda f, text: click.echo(text))
    failed = Figure("records that could not be closed", len(outcome.failed), "", 0, note=", ".join(outcome.failed))
    figures = figures_and_results([json.loads(path.read_text()) for path in outcome.done.values()])
    return [failed, *figures, *closure_challenge.run(worlds=("exact",))]


def figures_and_results(rows: Sequence[dict[str, Any]]) -> list[Figure]:
    """Figures of finished records, saved with confusion matrix and rows."""
    figures = figures_of(rows)
    save("closure", figures, {"seed": SEED, "confusion": confusion(rows), "records": list(rows)})
    return figures


if __name__ == "__main__":  # figures of the finished part of an interrupted run
    click.echo(table(figures_and_results([json.loads(p.read_text()) for p in sorted(LEDGER.glob("*.json"))])))
