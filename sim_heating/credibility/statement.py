"""The credibility statement of a result: the level of each factor, the evidence behind it, and what is missing."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from sim_heating.base.errors import InputError
from sim_heating.base.files.text import first_of
from sim_heating.credibility.evidence import Evidence, shipped_evidence
from sim_heating.credibility.facts.contributors import Uncertainty
from sim_heating.credibility.facts.sources import DeclaredInput
from sim_heating.credibility.facts.topics import CORE
from sim_heating.credibility.reviews import Reviewed, evidence_of, reviews_in
from sim_heating.credibility.rules import REVIEW, Factor, rules
from sim_heating.credibility.validation.own_cases import all_cases
from sim_heating.credibility.validation.region import Extrapolation, Samples, ValidationCase, extrapolation

FORMAT = "credibility-statement/1"
LARGEST_ERROR_K = 1.0
"""Numerical error of a result that its verification allows [K]."""
LARGEST_SHARE = 0.1
"""RMSE of a prediction over the measured rise up to which a data set supports the prediction [-]."""
SIGMAS = 2.0


@dataclass(frozen=True)
class Answer:
    """Whether something holds, and the figures that say so; `text` alone where nobody looked."""

    holds: bool
    text: str


NOT_LOOKED_AT = Answer(False, "not evaluated for this result")
NO_READINGS = Answer(True, "no readings of its own")


def greatest_error_K(errors_K: Iterable[float | None]) -> float | None:
    """The greatest of some estimated errors [K]; None where one was not estimated."""
    errors = list(errors_K)
    return None if None in errors else max(e for e in errors if e is not None)


@dataclass(frozen=True)
class Facts:
    """What is known about a result, from which its evidence follows.

    kind         : `run`, `prediction`, `estimate`, `closed loop`, `study`, `campaign`, `design` or `link`
    topics       : of the equations that it uses
    model        : what its model is built from;  conditions : what its flight conditions come from
    files        : what it was made from -> digest
    samples      : conditions of its control points
    mesh_error_K : greatest estimated error of the mesh [K]; None where one was not estimated
    sigma        : whether a standard deviation of the heating is declared or estimated
    uncertainty  : of the main quantity
    consistent   : whether residuals are those of noise;  holds : whether the conclusion does within two sigma
    varied       : whether it holds with all inputs varied together, or on data that were not fitted
    own_share    : whether its own readings are missed by a small part of their rise, where it has any
    own_noise    : whether they are missed by no more than noise
    folder       : where signed reviews lie;  reviewed : digest that they have to name
    """

    kind: str
    topics: frozenset[str]
    model: tuple[DeclaredInput, ...]
    conditions: tuple[DeclaredInput, ...]
    files: Mapping[str, str]
    samples: tuple[Samples, ...]
    mesh_error_K: float | None = None
    sigma: bool = False
    uncertainty: Uncertainty | None = None
    consistent: Answer = NOT_LOOKED_AT
    holds: Answer = NOT_LOOKED_AT
    varied: Answer = NOT_LOOKED_AT
    own_share: Answer = NO_READINGS
    own_noise: Answer = NO_READINGS
    folder: Path | None = None
    reviewed: str = ""


@dataclass(frozen=True)
class Assessment:
    """Level of one factor.

    level   : 0 to 4; None where it was not assessed
    reason  : the rule that is met, and the findings for the next one
    missing : names of the evidence that the next level needs
    """

    factor: Factor
    level: int | None
    reason: str
    missing: tuple[str, ...]


@dataclass(frozen=True)
class Statement:
    """The credibility of a result.

    findings : name of evidence -> whether it is there, and the figures
    problems : of files of cases and reviews that could not be read, one line each
    """

    facts: Facts
    assessments: tuple[Assessment, ...]
    findings: Mapping[str, Answer]
    region: Extrapolation
    reviews: tuple[Reviewed, ...] = ()
    evidence: Evidence = field(default_factory=shipped_evidence)
    problems: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return f"<{summary_line(self.assessments, self.region.short)}>"

    @property
    def uncovered(self) -> tuple[str, ...]:
        """Topics that the result uses and no verification row covers, or whose rows are not all within their limits."""
        none = [t for t in sorted(self.facts.topics) if t not in self.evidence.topics]
        return tuple(
            none + [t for t in sorted(self.facts.topics) if t in self.evidence.topics.keys() - self.evidence.verified]
        )

    @property
    def judged(self) -> tuple[DeclaredInput, ...]:
        """Inputs that are estimates of confidence C."""
        return tuple(i for i in (*self.facts.model, *self.facts.conditions) if i.worst == "C")

    def as_json(self) -> dict[str, Any]:
        """The block `credibility` of a result file."""
        u, topics = self.facts.uncertainty, self.evidence.topics
        used = {t: vars(topics[t]) for t in sorted(self.facts.topics) if t in topics}
        return {
            "format": FORMAT,
            "basis": rules().basis,
            "summary": summary_line(self.assessments, self.region.short),
            "factors": _factors_json(self.assessments),
            "evidence": {n: {"met": f.holds, "finding": f.text} for n, f in self.findings.items()},
            "verification": {
                "topics": used,
                "uncovered": list(self.uncovered),
                "date": self.evidence.date,
                "digest": self.evidence.digest,
            },
            "region": {
                "inside": self.region.inside,
                "outside": {
                    n: {"below": low, "above": high, "share_of_time": time_share}
                    for n, (low, high, time_share) in self.region.outside.items()
                },
                "data_sets": dict(self.region.share_by_case),
            },
            "confidence_C": [{"input": i.name, "source": i.source} for i in self.judged],
            "uncertainty": None
            if u is None
            else {
                "quantity": u.quantity,
                "unit": u.unit,
                "value": u.value,
                "sigma": u.sigma,
                "method": u.method,
                "contributions": {n: {"sigma": c, "share": u.share(n)} for n, c in u.contributions.items()},
            },
            "files": dict(self.facts.files),
            "reviews": [{**r.review.model_dump(mode="json"), "counts": r.counts} for r in self.reviews],
            "reviewable": self.facts.reviewed,
            "problems": list(self.problems),
        }


def summary_line(assessments: Sequence[Assessment], region: str) -> str:
    """A statement in one line, for a terminal.

    region : where the result lies against measured data, in a few words
    """
    levels = [f"{a.factor.title.lower()} {a.level}" for a in assessments if a.level is not None]
    people = [a.factor.title.lower() for a in assessments if a.level is None]
    absent = f"; not assessed: {', '.join(people)}" if people else ""
    sentence = f"{region[0].upper()}{region[1:]}"
    return f"Credibility (self-assessment, levels 0 to 4): {', '.join(levels)}{absent}. {sentence}."


def _factors_json(assessments: Sequence[Assessment]) -> dict[str, Any]:
    return {a.factor.name: {"level": a.level, "reason": a.reason, "missing": list(a.missing)} for a in assessments}


def with_reviews(block: Mapping[str, Any], reviews: Sequence[Reviewed]) -> dict[str, Any]:
    """A statement of a result file with further signed reviews.

    block : as `Statement.as_json` made it
    """
    before = [r for r in block["reviews"] if r["counts"]]
    there = frozenset(n for n, e in block["evidence"].items() if e["met"]) | evidence_of(reviews)
    there |= {f"{REVIEW}{r['factor']}.{n}" for r in before for n in range(1, r["level"] + 1)}
    assessments = assessments_of(there, {n: e["finding"] for n, e in block["evidence"].items()})
    added = [{**r.review.model_dump(mode="json"), "counts": r.counts} for r in reviews]
    sentence = block["summary"].rpartition(". ")[2].rstrip(".")
    return {
        **block,
        "summary": summary_line(assessments, sentence),
        "factors": _factors_json(assessments),
        "reviews": [*block["reviews"], *added],
    }


def assess(
    facts: Facts,
    cases: Sequence[ValidationCase] | None = None,
    evidence: Evidence | None = None,
    reviews: Sequence[Reviewed] | None = None,
) -> Statement:
    """The statement of a result.

    cases    : measured data sets; by default those of the project and of the user
    evidence : verification rows and counted statistics; by default those of the package
    reviews  : signed reviews; by default those in the folder of the facts
    returns  : the statement; a damaged file of cases or reviews is among its problems, and the result is not lost
    """
    evidence = evidence or shipped_evidence()
    problems: list[str] = []
    if cases is None:
        try:
            cases = all_cases()
        except InputError as error:
            problems, cases = [*problems, *error.problems], evidence.cases
    if reviews is None:
        try:
            reviews = reviews_in(facts.folder, facts.reviewed)
        except InputError as error:
            problems, reviews = [*problems, *error.problems], ()
    signed = tuple(reviews)
    region = extrapolation(facts.samples, cases)
    answers = findings(facts, evidence, cases, region)
    there = frozenset(n for n, answer in answers.items() if answer.holds) | evidence_of(signed)
    assessments = assessments_of(there, {n: f.text for n, f in answers.items()})
    return Statement(facts, assessments, answers, region, signed, evidence, tuple(problems))


def assessments_of(there: frozenset[str], texts: Mapping[str, str]) -> tuple[Assessment, ...]:
    """Level of every factor.

    there : names of the evidence that is there;  texts : figures of evidence, by name
    """
    assessments = []
    for factor in rules().factors:
        level, missing = factor.level(there), factor.missing(there)
        if factor.by_people and level == 0:
            assessments.append(Assessment(factor, None, "needs people; no signed review that counts", missing))
            continue
        lacking = "; ".join(texts[n] for n in missing if n in texts)
        reviewed = any(n.startswith("review.") for n in missing)
        next_level = f" Next level: {lacking}." if lacking else " Next level: a signed review." if reviewed else ""
        assessments.append(Assessment(factor, level, factor.rule(level) + next_level, missing))
    return tuple(assessments)


def findings(
    facts: Facts, evidence: Evidence, cases: Sequence[ValidationCase], region: Extrapolation
) -> dict[str, Answer]:
    """Evidence of a result by name, signed reviews aside."""
    return {
        **_data_findings(facts),
        **_verification_findings(facts, evidence),
        **_validation_findings(facts, cases, region),
        **_input_findings(facts),
        **_uncertainty_findings(facts, evidence),
        **_robustness_findings(facts),
    }


def _data_findings(facts: Facts) -> dict[str, Answer]:
    silent = [i for i in facts.model if not i.source]
    unrated = [i for i in facts.model if i.worst is None]
    judged = [i.name for i in facts.model if i.worst == "C"]
    return {
        "data.sources": _none_of(silent, "source", facts.model),
        "data.confidences": _none_of(unrated, "confidence", facts.model),
        "data.no_estimates": Answer(
            bool(facts.model) and not unrated and not judged, f"estimates of confidence C: {_some(judged) or 'none'}"
        ),
    }


def _none_of(lacking: Sequence[DeclaredInput], key: str, inputs: Sequence[DeclaredInput]) -> Answer:
    """Whether no input lacks a key, `source` or `confidence`; else which ones do, and where the key has to stand."""
    names = [f"{i.name} ({i.location.format(key=key)})" if i.location else i.name for i in lacking]
    text = f"without a {key}: {_some(names)}" if names else f"none of {len(inputs)} inputs is without a {key}"
    return Answer(bool(inputs) and not names, text)


def _some(names: Sequence[str], most: int = 4) -> str:
    """The first of some names, and how many more there are."""
    return first_of(list(dict.fromkeys(names)), most)


def _verification_findings(facts: Facts, evidence: Evidence) -> dict[str, Answer]:
    topics, verified = evidence.topics, evidence.verified
    core = [t for t in CORE if t in verified]
    rows = sum(topics[t].rows for t in facts.topics & topics.keys())
    uncovered = sorted(facts.topics - verified)
    error = facts.mesh_error_K
    error_text = (
        "the numerical error was not estimated" if error is None else f"estimated error of the mesh {error:.2g} K"
    )
    return {
        "verification.core": Answer(len(core) == len(CORE), f"verified: {', '.join(core) or 'none'}"),
        "verification.used": Answer(
            bool(facts.topics) and not uncovered,
            f"{rows} rows; no row covers {_some(uncovered)}" if uncovered else f"{rows} rows cover all that is used",
        ),
        "verification.error": Answer(error is not None and error <= LARGEST_ERROR_K, error_text),
    }


def _validation_findings(facts: Facts, cases: Sequence[ValidationCase], region: Extrapolation) -> dict[str, Answer]:
    kinds = {s.kind for s in facts.samples}
    names = [c.name for c in cases if c.kind in kinds]
    error = region.error
    return {
        "validation.kind": Answer(bool(names), f"measured data sets of this kind: {_some(names) or 'none'}"),
        "validation.half": Answer(bool(names) and region.inside >= 0.5, region.words),
        "validation.whole": Answer(bool(names) and region.inside >= 1.0, region.words),
        "validation.error": Answer(
            error is not None and error <= LARGEST_SHARE,
            "no measured data set covers it"
            if error is None
            else f"predictions there err by up to {error:.0%} of the measured rise",
        ),
        "validation.own_share": facts.own_share,
        "validation.own_noise": facts.own_noise,
    }


def _input_findings(facts: Facts) -> dict[str, Answer]:
    silent = [i for i in facts.conditions if not i.source]
    weak = [i.name for i in facts.conditions if not i.measured or i.worst not in ("A", "B")]
    return {
        "inputs.identified": Answer(bool(facts.files), f"{len(facts.files)} digests"),
        "inputs.sources": _none_of(silent, "source", facts.conditions),
        "inputs.measured": Answer(
            bool(facts.conditions) and not weak,
            f"not measured with confidence A or B: {_some(weak)}" if weak else "measured, confidence A or B",
        ),
    }


def _uncertainty_findings(facts: Facts, evidence: Evidence) -> dict[str, Answer]:
    u = facts.uncertainty
    claims = [c for c in evidence.claims if c.of == facts.kind]
    unmet = [c.claim for c in claims if not c.met]
    text = f"not met: {'; '.join(unmet)}" if unmet else "; ".join(f"{c.claim}: {c.value:.3g}" for c in claims)
    declared = "the heating has a standard deviation" if facts.sigma else "the heating has no sigma"
    stated = "no standard deviation of the main quantity"
    if u is not None:
        stated = f"{u.quantity}: sigma {u.sigma:.3g} {u.unit}".rstrip()
    counted = Answer(not unmet, text)
    if not claims:
        counted = Answer(False, f"bounds of a {facts.kind} were not counted against known truths")
    return {
        "uncertainty.declared": Answer(facts.sigma, declared),
        "uncertainty.stated": Answer(u is not None, stated),
        "uncertainty.counted": counted,
        "uncertainty.consistent": facts.consistent,
    }


def _robustness_findings(facts: Facts) -> dict[str, Answer]:
    u = facts.uncertainty
    dominant = "" if u is None else u.dominant
    text = f"{dominant}, {u.share(dominant):.0%} of the variance" if u and dominant else "no dominant input is known"
    return {
        "robustness.dominant": Answer(bool(dominant), text),
        "robustness.holds": facts.holds,
        "robustness.varied": facts.varied,
    }
