"""close-loop on records that nobody generated for it: `challenge`'s classes, and the project's own flights.

    python -m benchmarks closure                                   # records of exact models, all
    python -m benchmarks.closure_challenge --share 0.1             # a tenth of every class, for work between full runs
    python -m benchmarks.closure_challenge --classes null,wall     # some classes
    python -m benchmarks.closure_challenge --figures               # figures of the finished records
    python -m benchmarks closure_challenge                         # records of exact and of imperfect models, all
    python -m benchmarks.closure_challenge --world imperfect --seed 7 --share 0.1 --processes 1

Finished records are kept in out/closure_challenge, of another seed in seed_N below it: an interrupted run is resumed
from there. Statements by class, reliability, ranks and coverage: closure_study.py. What counts as right:

- effects: each thing found contains a true effect in its set of names, and each true effect is in one of the sets;
  nothing else is named. A rival that the generator's linear estimate cannot tell from the truth counts as the truth.
- a fault of wall, flight, sensor or table: an entry of not_effects of that kind, or an effect that reports the fault.
- nothing: `none`, whatever errors the model has. A form that no library has: `unknown` or `partly`.
"""

from __future__ import annotations

import json
import os
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise, permutations
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np
from scipy.stats import binomtest

from benchmarks.challenge.record import CLASS_NAMES, CLASSES, WORLDS, name_of, whole_set
from benchmarks.challenge.record import make_and_write as make_challenge
from benchmarks.measure import Figure, save, table
from sim_heating.base.errors import InputError
from sim_heating.base.parallel.batches import Job, run_batches

if TYPE_CHECKING:
    from sim_heating.closure.search.search import SearchResult

SEED = 24
FLOWN, PAPER = "flown", "paper"
SEEDS = {FLOWN: 20, PAPER: 10}
"""Seeds of the noise of the project's own flights."""
LEDGER = Path("out") / "closure_challenge"
NAMED = ("found", "one of")
SURE = 0.95
"""Probability from which on a finding is meant to be relied on."""
LARGEST_ERROR = 0.15
"""Relative error of the heating beyond which a model may not be named."""
ADEQUATE = 0.01
"""p-value of the adequacy above which a model explains the record to its noise."""
UNLISTED = ("unknown", "lacking")
"""Classes whose causes no library has."""
CLOSE = 10.0
"""Difference of BIC below which a fit that knows the truth cannot tell it from what was found."""
LIBRARY = {
    "transition": ("logistic", "intermittency"), "impingement-onset": ("ramp",), "alpha-curvature": ("quadratic",),
    "elevon-curvature": ("quadratic",), "bodyflap-curvature": ("quadratic",), "interaction": ("product",),
    "sideslip": ("magnitude", "quadratic"), "nonisothermal-wall": ("first-order",), "jet-interaction": ("gain",),
    "time-skew": ("constant",), "coating-thickness": ("factor",), "conductivity": ("factor",),
    "heat-capacity": ("insulation", "coating"), "emissivity": ("constant", "step", "slope"),
    "sensor-bias": ("offset", "gain", "both"), "sensor-lag": ("first-order",), "catalysis": ("logistic",),
    "backface-cooling": ("film", "radiation", "both"), "gap-flow": ("exponential",), "moisture": ("capacity",),
    "radiative-conduction": ("cubic", "cubic-above"),
}  # fmt: skip
"""Forms of the generator that the package has, by effect."""
REFUSED = {"finding": "refused", "alternatives": [], "probability": 0.0, "calibrated": False, "not_effects": [],
           "p_value": None, "converged": True, "effects_stated": []}  # fmt: skip
"""What is kept of a record that is not read."""
SHORT = 3
"""Names that cannot be distinguished, in one set of a statement at most."""
BINS = (0.0, 0.5, 0.7, 0.8, 0.9, 0.95, 0.99, 1.0)
"""Limits of the probabilities that are counted together."""


# Making and closing --------------------------------------------------------------------------------------------------


def jobs(classes: Sequence[str], share: float, worlds: Sequence[str] = ("exact",), seed: int = SEED) -> list[Job]:
    """A share of every class, spread evenly; the first part of the run is representative at any time."""
    wanted = []
    for world in worlds:
        sizes = {c: WORLDS[world][c] for c in classes if c in WORLDS[world]}
        for c, k in whole_set(sum(sizes.values()), tuple(sizes), world) if sizes else ():
            if k < max(share * sizes[c], 1):
                name = name_of(k, c, world != "exact")
                wanted.append(((k + 0.5) / sizes[c], Job(f"{name}.json", (c, k, world != "exact", seed))))
    for c in SEEDS if "exact" in worlds else ():
        if c not in classes:
            continue
        count = max(round(share * SEEDS[c]), 1)
        few = [name for name in flown_names(c) if int(name.rpartition("-")[2]) <= count]
        wanted += [((i + 0.5) / len(few), Job(f"{name}.json", (c, name, False, seed))) for i, name in enumerate(few)]
    return [job for _, job in sorted(wanted, key=lambda w: (w[0], w[1].id))]


def flown_names(of_class: str) -> list[str]:
    """Names of the project's own flights as records, which are made first where they are not there."""
    folder = LEDGER / of_class
    if not (folder / "answers.toml").is_file():
        from benchmarks.challenge.flown import write_all

        click.echo("flying the scenarios")
        write_all(of_class, SEEDS[of_class], folder)
    return sorted(_answers(folder), key=lambda name: (name.rpartition("-")[2], name))


def _answers(folder: Path) -> dict[str, Any]:
    import tomllib

    return tomllib.loads((folder / "answers.toml").read_text())


def make_and_close(task: tuple[str, int | str, bool, int]) -> bytes:
    """Make a record, or take one of the flown ones, and close its loop; truth and finding as JSON."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    of_class, which, imperfect, seed = task
    if isinstance(which, str):
        folder = LEDGER / of_class
        return json.dumps(closed(folder / which, _answers(folder)[which])).encode()
    with tempfile.TemporaryDirectory() as made:
        name, answer, _ = make_challenge((seed, which, of_class, Path(made), imperfect))
        return json.dumps(closed(Path(made) / name, answer)).encode()


def closed(directory: Path, answer: Mapping[str, Any]) -> dict[str, Any]:
    """What close-loop states of a record, next to what is true of it."""
    from sim_heating.closure.close import close_loop
    from sim_heating.closure.report.record import closure_json
    from sim_heating.inputs.record import load_record

    kept = ("class", "form", "flight", "wall", "effects", "accepted", "separable", "kind", "what", "size",
            "residual_over_floor", "chi_square", "log_evidence", "log_evidence_unknown_times", "noise_floor_K", "noise",
            "true_rmse_K", "parameters", "true_errors", "reference_condition", "mean_ratio", "world",
            "model_error")  # fmt: skip
    row = {key: answer[key] for key in kept if key in answer} | {"record": directory.name}
    begun = time.process_time()
    try:
        record = load_record(directory)
        loop = close_loop(record)
    except InputError as refusal:
        return row | REFUSED | {"message": str(refusal), "cpu_s": time.process_time() - begun}
    report = closure_json(loop.report)
    row |= stated(report) | used_for_probability(loop.search) | {"cpu_s": time.process_time() - begun}
    after = {part: e["rmse_K"] for part, e in report["after"].items() if e}
    row |= {"after_K": after, "contradictions": contradictions(report)}
    truth = row.get("true_rmse_K", {})
    if row["class"] == "one" and any(after[p] > 1.1 * truth[p] for p in after.keys() & truth.keys()):
        row["known_K"] = rmse_K(search_of_effect(loop.search, row["effects"][0]))
    if row["class"] in SEEDS and not is_right(row):
        row["bic_of_truth_above_finding"] = bic_of_truth_above(record, answer, loop.fitted.fit, loop.fitted.problem)
    return row


def rmse_K(found: SearchResult) -> dict[str, float]:
    """RMSE [K] over fit and holdout segments, refitted with the effects found."""
    from sim_heating.closure.close import refit

    fitted = refit(found)
    return {part: e["rmse_K"] for part, e in fitted.after[0].segment_errors().items() if e}


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


def stated(report: Mapping[str, Any]) -> dict[str, Any]:
    """The statements of a closure report that are judged; its posterior where no probability is calibrated."""
    adequacy, probability = report["adequacy"] or {"p_value": None}, report["probability"]
    return {
        "finding": report["finding"],
        "alternatives": report["alternatives"],
        "probability": report["effect"]["posterior"] if probability is None else probability,
        "calibrated": probability is not None,
        "not_effects": [{"kind": entry["kind"], "what": entry["what"]} for entry in report["not_effects"]],
        "p_value": adequacy["p_value"],
        "converged": report["converged"],
        **{key: report.get(key) for key in ("resembles", "samples", "barred")},
        "stated_error": report.get("model_error"),
        "effects_stated": [{"name": e["name"], "parameters": e["parameters"]} for e in report.get("effects", [])],
        "derivatives": {n: p for n, p in report.get("estimated", {}).items() if n.startswith("ratio.")},
        "reference_stated": report.get("reference_condition"),
    }


def contradictions(report: Mapping[str, Any]) -> list[str]:
    """Statements of a report that cannot both hold, a line each."""
    finding, p = report["finding"], (report["adequacy"] or {"p_value": None})["p_value"]
    before, after = report["before"], report["after"]
    named, size = finding in NAMED, report.get("model_error")
    parts = [part for part in ("fit", "holdout") if before[part] and after[part]]
    checks = {
        f"`{finding}` with p = {p}": finding in (*NAMED, "none") and p is not None and p < ADEQUATE,
        f"`{finding}` and the last fit has not converged": named and not report["converged"],
        f"`{finding}` with effects": not named and bool(report["effects"]),
        f"`{finding}` without a cause": named and not report["effects"] and not report["not_effects"],
        f"`{finding}` resembles {report['resembles']}": named and bool(report["resembles"]),
        "`none` with other errors after": finding == "none" and any(before[k] != after[k] for k in parts),
        "the cause makes the fitted errors larger": named and after["fit"]["rmse_K"] > 1.02 * before["fit"]["rmse_K"],
        "a model error above 15 % of the heating is named": named
        and size is not None
        and size["relative_heating"]["value"] > LARGEST_ERROR,
        f"probability {report['probability']}": report["probability"] is not None
        and not 0.0 <= report["probability"] <= 1.0,
        "a model that fits better is barred without a reason": any(not b["reason"] for b in report["barred"]),
    }
    return [line for line, holds in checks.items() if holds]


def used_for_probability(found: SearchResult) -> dict[str, Any]:
    """What a calibration of the probability may use; causes that are no effect, in words, by kind."""
    conclusion = found.conclusion
    causes = {h.names[0]: h.kind for h in found.hypotheses if h.kind not in ("", "effect")}
    kinds = {h.change.describe(h.changed.value): h.kind for h in found.hypotheses if h.change and h.changed}
    return {
        "rival": conclusion.rival, "explained": conclusion.explained, "disqualified": conclusion.disqualified,
        "no_effect": conclusion.best.kind not in ("", "effect"), "statistic": conclusion.best.adequacy.statistic,
        "none_statistic": found.none.adequacy.statistic, "none_p": found.none.adequacy.p_value, "kinds": causes | kinds,
        "hypotheses": [
            [" + ".join(h.names), h.score, h.excess_chi2, h.adequacy.statistic, list(h.objections), h.adequacy.p_value]
            for h in found.hypotheses[:5]
        ],
    }  # fmt: skip


def bic_of_truth_above(record: Any, answer: Mapping[str, Any], found: Any, problem: Any) -> float | None:
    """BIC of a fit that knows the form of the truth, less that of what was found; None where it cannot be fitted."""
    from sim_heating.base.errors import RunError
    from sim_heating.base.parameters import EFFECT_PREFIX
    from sim_heating.estimation.fit import estimate
    from sim_heating.estimation.inference.newton import NewtonSettings
    from sim_heating.estimation.inference.observability import default_names
    from sim_heating.heating.effects import effects, use

    first: dict[str, float] = {}
    used = []
    for name, values in zip(answer["effects"], answer.get("parameters", []), strict=True):
        if name in effects() and not any("." in key for key in values):
            used.append(use(name, values))
            first |= {f"{EFFECT_PREFIX}{name}.{key}": value for key, value in values.items()}
        else:
            first |= values
    try:
        known = estimate(
            [record], [*default_names([record]), *first], effects=used, settings=NewtonSettings(first_values=first)
        )
    except (InputError, RunError):
        return None
    log_n = float(np.log(np.count_nonzero(np.isfinite(record.temperatures_K()))))
    bics = [
        -2.0 * float(fit.log_likelihood) + len(p.unknowns) * log_n
        for fit, p in ((known.fit, known.problem), (found, problem))
    ]
    return bics[0] - bics[1]


# Judging -------------------------------------------------------------------------------------------------------------


def explains(sets: Sequence[Sequence[str]], truth: Sequence[Sequence[str]]) -> bool:
    """Whether each set has a name of a true effect of its own, and each true effect that must be named is in one.

    truth : for each true effect the names that count as right; one that holds `none` need not be named
    """
    if len(sets) > len(truth):
        return False
    for order in permutations(range(len(truth)), len(sets)):
        rest = set(range(len(truth))) - set(order)
        hit = all(set(names) & set(truth[i]) for names, i in zip(sets, order, strict=True))
        if hit and all("none" in truth[i] for i in rest):
            return True
    return False


def things(row: Mapping[str, Any]) -> list[list[str]]:
    """What is named: each set of names that cannot be distinguished; a cause that is no effect is `kind:KIND`."""
    kinds = row.get("kinds", {})

    def name(word: str) -> str:
        return word if word in LIBRARY else f"kind:{kinds.get(word, 'table')}"

    sets = [[name(word) for word in words] for words in row["alternatives"]] if row["finding"] in NAMED else []
    said = {word for words in sets for word in words}
    for kind in dict.fromkeys(f"kind:{entry['kind']}" for entry in row["not_effects"]):
        if kind not in said:
            sets.append([kind])
    return sets


def truth_of(row: Mapping[str, Any]) -> list[list[str]]:
    """For each thing that is true the names that count as right; a table's error has to be named."""
    if "kind" not in row:
        return list(row["accepted"])
    own = [name for name in row["accepted"][0] if row["class"] != "table" or name != "none"]
    return [[f"kind:{row['kind']}", *own]]


def verdict(row: Mapping[str, Any]) -> str:
    """`right`, `undecided` (unknown, partly), `missed` (none where something is) or `wrong`."""
    found, truth = things(row), truth_of(row)
    if row["finding"] == "refused":
        return "right" if row["class"] == "sensor" else "wrong"
    undecided = row["finding"] in ("unknown", "partly")
    if row["class"] in UNLISTED:
        rivals = row["class"] == "lacking" and explains(found, truth)
        right = undecided or ("none" in truth[0] and not found) or rivals
    else:
        right = not undecided and explains(found, truth)
    if right:
        return "right"
    if undecided:
        return "undecided"
    return "wrong" if found else "missed"


def is_right(row: Mapping[str, Any]) -> bool:
    """Whether a row is right."""
    return verdict(row) == "right"


def is_tie(row: Mapping[str, Any]) -> bool:
    """Whether a fit that knows the truth cannot tell it from what was found."""
    above = row.get("bic_of_truth_above_finding")
    return above is not None and above > -CLOSE


def beside(row: Mapping[str, Any]) -> bool:
    """Whether something is named that is not there."""
    names = {name for accepted in truth_of(row) for name in accepted}
    found = things(row)
    return len(found) > len(truth_of(row)) or any(not set(words) & names for words in found)


def false_aerothermal(row: Mapping[str, Any]) -> bool:
    """Whether a fault is stated as an effect that does not report it, by a model that is called adequate."""
    adequate = row["p_value"] is None or row["p_value"] > ADEQUATE
    return row["finding"] in NAMED and adequate and beside(row)


def in_library(row: Mapping[str, Any]) -> bool:
    """Whether every form of the truth is one of the package."""
    parts = [form.split("/") for form in row["form"]]
    return all(len(p) == 2 and p[1] in LIBRARY.get(p[0], ()) for p in parts)


# Figures -------------------------------------------------------------------------------------------------------------


def limits(hits: int, n: int) -> tuple[float, float]:
    """95 % Clopper-Pearson limits of a proportion."""
    interval = binomtest(hits, n).proportion_ci(0.95, method="exact")
    return float(interval.low), float(interval.high)


def proportion(what: str, hits: int, n: int, target: float, at_least: bool) -> Figure:
    """A proportion with its limits."""
    low, high = limits(hits, n)
    return Figure(what, hits / n, "", target, at_least, f"{hits} of {n}, 95% limits {low:.3f} to {high:.3f}")


def share_of(
    what: str, rows: Sequence[Mapping[str, Any]], hit: Any, target: float, at_least: bool = True
) -> list[Figure]:
    """A proportion among rows, where there are any."""
    return [proportion(what, sum(map(hit, rows)), len(rows), target, at_least)] if rows else []


def figures_of(rows: Sequence[dict[str, Any]]) -> list[Figure]:
    """The table of figures: findings by class, probabilities, sets, errors, time."""
    of = {c: [r for r in rows if r["class"] == c] for c in (*CLASS_NAMES, *SEEDS)}
    faults = [r for c in ("wall", "flight", "sensor") for r in of[c]]
    figures = [*_of_flown(of[FLOWN]), *_of_paper(of[PAPER]), *_of_probabilities(rows), *_of_sets(rows)]
    for of_class, target in (("one", 0.95), ("two", 0.9), ("three", None), ("table", None), ("unknown", None)):
        bound = 0.0 if target is None else target
        figures += share_of(
            f"right, {of_class}", [r for r in of[of_class] if r.get("size") != "small"], is_right, bound
        )
    figures += share_of("right, one, small", [r for r in of["one"] if r.get("size") == "small"], is_right, 0.0)
    figures += share_of("false findings, null", of["null"], lambda r: verdict(r) in ("wrong", "undecided"), 0.01, False)
    figures += share_of("right kind, wall, flight, sensor", faults, is_right, 0.6)
    honest = ("right", "undecided")
    figures += share_of("right kind or unknown, wall, flight, sensor", faults, lambda r: verdict(r) in honest, 0.9)
    figures += share_of("stated as an adequate effect, wall, flight, sensor", faults, false_aerothermal, 0.0, False)
    return [*figures, *_of_errors(of["one"]), *_of_time(rows)]


def _of_flown(rows: Sequence[dict[str, Any]]) -> list[Figure]:
    ties = [r for r in rows if not is_right(r) and is_tie(r)]
    figures = share_of(
        "sts2, sts4: right, a set with the truth, or a tie", rows, lambda r: is_right(r) or is_tie(r), 0.95
    )
    figures += share_of("sts2, sts4: of these by a tie alone", rows, lambda r: r in ties, 1.0, False)
    figures += share_of("sts2, sts4: named next to the truth and not there", rows, beside, 0.02, False)
    return figures + share_of("sts2, sts4: not converged", rows, lambda r: not r["converged"], 0.0, False)


def _of_paper(rows: Sequence[dict[str, Any]]) -> list[Figure]:
    """The pod of the founding paper: every cause in the statement, in short lists, and none that is wrong."""

    def all_stated(row: Mapping[str, Any]) -> bool:
        sets = things(row)
        short = all(len(names) <= SHORT for names in sets)
        return short and all(any({*true} & {*names} for names in sets) for true in truth_of(row))

    def wrong_found(row: Mapping[str, Any]) -> bool:
        return row["finding"] == "found" and not is_right(row)

    figures = share_of(f"paper's pod: every cause in lists of at most {SHORT}", rows, all_stated, 0.85)
    return figures + share_of("paper's pod: `found`, one wrong or one missing", rows, wrong_found, 0.0, False)


def is_statement(row: Mapping[str, Any]) -> bool:
    """Whether a report names something, or states that there is nothing."""
    return row["finding"] in (*NAMED, "none")


def is_stated(row: Mapping[str, Any]) -> bool:
    """Whether a report states something with a calibrated probability."""
    return is_statement(row) and row.get("calibrated", True)


def _of_probabilities(rows: Sequence[dict[str, Any]]) -> list[Figure]:
    sure = [r for r in rows if is_stated(r) and r["probability"] >= SURE]
    figures = share_of(f"stated with {SURE} or more: right", sure, is_right, 0.95)
    for of_class in (*CLASSES, *SEEDS):
        some = [r for r in sure if r["class"] == of_class]
        figures += share_of(f"stated with {SURE} or more: right, {of_class}", some, is_right, 0.0)
        if len(some) >= 40:
            low = limits(sum(map(is_right, some)), len(some))[0]
            figures.append(Figure(f"lower 95 % limit of that, {of_class}", low, "", 0.85, True))
    plain = [r for r in rows if r["class"] == "one" and r.get("separable") and r.get("size") != "small"]

    def told(row: Mapping[str, Any]) -> bool:
        return is_right(row) and row["probability"] >= SURE

    figures += share_of(f"one effect that can be told: right and stated with {SURE} or more", plain, told, 0.85)
    judged = [r for r in plain if in_library(r) and r["p_value"] is not None]
    return figures + share_of(
        "one effect in a form of the library: adequate", judged, lambda r: r["p_value"] > ADEQUATE, 0.95
    )


def _of_sets(rows: Sequence[dict[str, Any]]) -> list[Figure]:
    named = [r for r in rows if r["finding"] in NAMED]
    sizes = [len(s) for r in named for s in r["alternatives"] if len(s) > 1]
    if not named:
        return []
    figures = [
        proportion("findings that are sets", sum(r["finding"] == "one of" for r in named), len(named), 0.15, False)
    ]
    if sizes:
        figures.append(Figure("names in a set, middle", float(np.median(sizes)), "", 2.0))
        figures.append(Figure("names in a set, most", float(max(sizes)), "", 4.0))
    return figures


def _of_errors(rows: Sequence[dict[str, Any]]) -> list[Figure]:
    figures = []
    for part in ("fit", "holdout"):
        both = [
            r for r in rows
            if is_right(r) and (r["p_value"] is None or r["p_value"] > ADEQUATE)
            and part in r.get("after_K", {}) and part in r.get("true_rmse_K", {})
        ]  # fmt: skip
        if both:
            over = [r["after_K"][part] / max(r["true_rmse_K"][part], r.get("known_K", {}).get(part, 0.0)) for r in both]
            note = f"median {np.median(over):.3f}, largest {max(over):.3f}"
            what = f"RMSE after within 1.1 of a fit that knows the truth, adequate, {part}"
            figure = proportion(what, sum(o <= 1.1 for o in over), len(over), 0.95, True)
            figures.append(Figure(figure.what, figure.value, "", 0.95, True, f"{figure.note}; {note}"))
    return figures


def _of_time(rows: Sequence[dict[str, Any]]) -> list[Figure]:
    seconds = np.array([r["cpu_s"] for r in rows])
    if not len(seconds):
        return []
    return [
        Figure("processor time a record, median", float(np.median(seconds)), "s", 10.0),
        Figure("processor time a record, largest", float(seconds.max()), "s", 90.0),
    ]


def reliability(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Share of right statements by the probability that was stated, with 95 % limits."""
    found = []
    for low, high in pairwise(BINS):
        last = high == BINS[-1]
        some = [r for r in rows if is_stated(r) and low <= r["probability"] and (r["probability"] < high or last)]
        if some:
            hits = sum(map(is_right, some))
            mean = float(np.mean([r["probability"] for r in some]))
            found.append({"from": low, "to": high, "mean": mean, "n": len(some), "right": hits / len(some),
                          "limits": limits(hits, len(some))})  # fmt: skip
    return found


def by_class(rows: Sequence[Mapping[str, Any]]) -> dict[str, dict[str, int]]:
    """Class -> verdict -> how many."""
    verdicts = ("right", "undecided", "missed", "wrong")
    counted = {c: [verdict(r) for r in rows if r["class"] == c] for c in (*CLASS_NAMES, *SEEDS)}
    return {c: {v: found.count(v) for v in verdicts} for c, found in counted.items() if found}


def ledger(seed: int = SEED) -> Path:
    """Folder of the finished records of a seed."""
    return LEDGER if seed == SEED else LEDGER / f"seed_{seed}"


def finished(seed: int = SEED, worlds: Sequence[str] = ("exact",)) -> list[dict[str, Any]]:
    """Rows of the finished records of some worlds."""
    rows = [json.loads(path.read_text()) for path in sorted(ledger(seed).glob("*.json"))]
    return [r for r in rows if r.get("world", "exact") in worlds]


def figures_and_results(
    rows: Sequence[dict[str, Any]], name: str = "closure_challenge", seed: int = SEED
) -> list[Figure]:
    """Figures of rows, saved with verdicts by class, the reliability of probabilities, and the rows."""
    from benchmarks.closure_study import study, study_figures  # which uses the verdicts of this module

    exact = [r for r in rows if r.get("world", "exact") == "exact"]
    figures = [*(figures_of(exact) if exact else []), *study_figures(rows)]
    more = {"seed": seed, "by_class": by_class(exact), "reliability": reliability(exact), "study": study(rows),
            "records": list(rows)}  # fmt: skip
    save(name, figures, more)
    return figures


def run(
    classes: Sequence[str] = (*CLASS_NAMES, *SEEDS),
    share: float = 1.0,
    worlds: Sequence[str] = tuple(WORLDS),
    seed: int = SEED,
    processes: int = 2,
) -> list[Figure]:
    """Make and close the records that are not finished."""
    wanted = jobs(classes, share, worlds, seed)
    outcome = run_batches(wanted, make_and_close, ledger(seed), workers=processes, progress=_progress)
    note = "; ".join(f"{name}: {reason}" for name, reason in outcome.failed.items())
    failed = Figure("records that could not be closed", len(outcome.failed), "", 0, note=note)
    rows = [json.loads(path.read_text()) for path in outcome.done.values()]
    return [failed, *figures_and_results(rows, results_name(classes, share, worlds), seed)]


def results_name(classes: Sequence[str], share: float, worlds: Sequence[str] = ("exact",)) -> str:
    """Name of the results: `closure_challenge`, with the worlds, `_share` and the classes where these are not all."""
    known = {c for world in worlds for c in WORLDS[world]}
    some = "" if known <= {*classes} else "_" + "_".join(classes)
    world = "" if tuple(worlds) == ("exact",) else "_" + "_".join(worlds)
    return f"closure_challenge{world}{'' if share == 1.0 else '_share'}{some}"


def _progress(fraction: float, text: str) -> None:
    click.echo(f"{fraction:6.1%}  {text}")


@click.command(help="Close the loop on the classes of `challenge` and on the project's own flights.")
@click.option("--share", type=click.FloatRange(0.0, 1.0), default=1.0, show_default=True, help="of every class")
@click.option("--classes", default="all", help=f"some of {', '.join((*CLASS_NAMES, *SEEDS))}, with commas")
@click.option("--world", type=click.Choice([*WORLDS, "both"]), default="exact", show_default=True, help="of the models")
@click.option("--seed", type=click.IntRange(0), default=SEED, show_default=True, help="of the records")
@click.option("--processes", type=click.IntRange(1), default=2, show_default=True)
@click.option("--figures", is_flag=True, help="of the finished records; none are made")
def main(share: float, classes: str, world: str, seed: int, processes: int, figures: bool) -> None:
    """Run, or print the figures of the finished part."""
    from benchmarks.closure_study import study_text

    worlds = tuple(WORLDS) if world == "both" else (world,)
    everything = (*dict.fromkeys(c for w in worlds for c in WORLDS[w]), *(SEEDS if "exact" in worlds else ()))
    chosen = everything if classes == "all" else tuple(name.strip() for name in classes.split(","))
    unknown = [name for name in chosen if name not in everything]
    if unknown:
        raise click.BadParameter(f"`{unknown[0]}` is not a class; known: {', '.join(everything)}, or all")
    if figures:
        rows = [r for r in finished(seed, worlds) if r["class"] in chosen]
        click.echo(table(figures_and_results(rows, results_name(chosen, share, worlds), seed)))
    else:
        click.echo(table(run(chosen, share, worlds, seed, processes)))
        rows = [r for r in finished(seed, worlds) if r["class"] in chosen]
    click.echo(study_text(rows))


if __name__ == "__main__":
    main()
