"""What close-loop leaves in a folder: closure.json, residual_heating.csv, and report.html for a review.

closure.json is the format "closure-report/1"; beside its keys stand `estimated` (all parameters of the last fit),
`residual` (size and bandwidth of the residual heating, what no heating explains), `evidence`, `verdicts` on the record
itself, `false_alarm` and `warnings`.

How often an effect is named where there is none: counted over records made without one, and said in every report.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from scipy.stats import beta

from sim_heating.base.conditions import RATIO_VARIABLES
from sim_heating.base.files import read_json, write_json
from sim_heating.base.files.package import PACKAGE, package_version
from sim_heating.base.report.page import Page, Picture, Section, write_page
from sim_heating.base.report.table import Column, Table
from sim_heating.closure.clues.correlation import ResidualEvidence, flight_variables
from sim_heating.closure.clues.residual_heating import NAME as HEATING_NAME
from sim_heating.closure.clues.residual_heating import ResidualHeating, write_residual_heating
from sim_heating.closure.plots import (
    comparison_figure,
    heating_figure,
    hysteresis_figure,
    ranking_figure,
    variables_figure,
)
from sim_heating.closure.record_checks import DataFault
from sim_heating.inputs.record import Record
from sim_heating.simulation.predict import Prediction

NAME, PAGE = "closure.json", "report.html"
FILES = (NAME, PAGE, HEATING_NAME)
NONE, UNKNOWN = "none", "unknown"


@dataclass(frozen=True)
class ParameterEstimate:
    """A parameter with its bound; `declared` is where the fit started from, None where that says nothing."""

    value: float
    sigma: float
    unit: str
    declared: float | None = None


@dataclass(frozen=True)
class Finding:
    """What was found: an effect, "none" or "unknown"; `parameters` by their names within the effect; `sensor` is the
    thermocouple that it is of, where it is of one."""

    name: str
    posterior: float
    parameters: Mapping[str, ParameterEstimate]
    sensor: str | None = None

    @property
    def title(self) -> str:
        """The effect, and what it is of."""
        return f"{self.name} of {self.sensor}" if self.sensor else self.name

    def numbers(self) -> dict[str, Any]:
        """For closure.json."""
        of = {} if self.sensor is None else {"sensor": {"value": self.sensor, "sigma": None, "unit": ""}}
        parameters = of | {n: _plain(p) for n, p in self.parameters.items()}
        return {"name": self.name, "posterior": self.posterior, "parameters": parameters}


@dataclass(frozen=True)
class CandidateScore:
    """One candidate: BIC minus that of none, errors of the plain march; holdout None where there is none; its
    probability by all that was weighed."""

    name: str
    delta_bic: float
    fit_rmse_K: float
    holdout_rmse_K: float | None
    posterior: float

    def numbers(self) -> dict[str, Any]:
        """For closure.json."""
        return {n: value for n, value in asdict(self).items() if n != "posterior"}


@dataclass(frozen=True, eq=False)
class Closure:
    """Everything that a report tells of one record.

    predicted, before, after : the declared tables, the derivatives fitted, the effects added; `after` is `before` where
                               nothing was added
    noise_floor_K : of the used sensors over the fit segments;  reference : what the derivatives are about
    effects       : what was found, in the order in which it was added; one of "none" or "unknown" where nothing was
    candidates    : of the first pass, "none" included
    parameters    : everything estimated in the last fit, by dotted names
    residual, residual_after : what the derivatives leave, and what the effects leave, as heating
    evidence      : of the first residual
    verdicts      : what is wrong with the record itself
    false_alarm   : chance of an effect being named where there is none, and what it is calibrated on
    """

    record: Record
    predicted: Prediction
    before: Prediction
    after: Prediction
    noise_floor_K: float
    reference: Sequence[float]
    effects: Sequence[Finding]
    candidates: Sequence[CandidateScore]
    parameters: Mapping[str, ParameterEstimate]
    residual: ResidualHeating
    residual_after: ResidualHeating | None
    evidence: ResidualEvidence
    verdicts: Sequence[DataFault] = ()
    false_alarm: str = ""
    warnings: Sequence[str] = ()

    @property
    def named(self) -> str:
        """Names of what was found, in words."""
        return " + ".join(e.name for e in self.effects)

    @property
    def added(self) -> bool:
        """Whether the model was changed."""
        return self.effects[0].name not in (NONE, UNKNOWN)


def closure_json(found: Closure) -> dict[str, Any]:
    """The contents of closure.json."""
    effects = [e.numbers() for e in found.effects]
    several = {"effects": effects} if len(effects) > 1 else {}
    return {
        "format": "closure-report/1",
        "records": [str(found.record.directory)],
        "sensors": [s.name for s in found.record.used_sensors],
        "predicted": found.predicted.segment_errors(),
        "before": found.before.segment_errors(),
        "after": found.after.segment_errors(),
        "noise_floor_K": _finite(found.noise_floor_K),
        "reference_condition": dict(zip(RATIO_VARIABLES, map(float, found.reference), strict=True)),
        "effect": effects[0],
        **several,
        "candidates": [c.numbers() for c in sorted(found.candidates, key=lambda c: c.delta_bic)],
        "residual_heating": HEATING_NAME,
        "estimated": {n: _plain(p) for n, p in found.parameters.items()},
        "residual": found.residual.numbers(),
        "residual_after": None if found.residual_after is None else found.residual_after.numbers(),
        "evidence": {**found.evidence.numbers(), "proposal": found.evidence.proposal()},
        "verdicts": [{"kind": v.kind, "words": v.words} for v in found.verdicts],
        "false_alarm": found.false_alarm,
        "warnings": list(found.warnings),
        "program": f"sim-heating {package_version()}",
    }  # fmt: skip


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _plain(p: ParameterEstimate) -> dict[str, Any]:
    return {"value": float(p.value), "sigma": _finite(p.sigma), "unit": p.unit}


def write_closure(found: Closure, folder: Path) -> None:
    """The files of a closure into a folder that is there."""
    write_json(folder / NAME, closure_json(found))
    write_residual_heating(folder / HEATING_NAME, found.residual)
    write_page(folder / PAGE, closure_page(found))


# The page ------------------------------------------------------------------------------------------------------------


def closure_page(found: Closure) -> Page:
    """The report as a page."""
    record = found.record
    title = record.declared.title or record.declared.control_point
    kind = "measured" if record.declared.measured else "synthetic"
    subtitle = f"Record {record.name}, control point {record.declared.control_point}, {kind} data"
    warnings = [*(v.words for v in found.verdicts), *found.warnings]
    sections = [
        _errors(found), _comparison(found), _effects(found), _candidates(found), _heating(found), _evidence(found),
        _beyond(found),
    ]  # fmt: skip
    return Page(title, subtitle, sections, _headline(found), warnings)


def closures_table(rows: Sequence[Mapping[str, Any]]) -> Table:
    """Effects found in records and the errors before and after, a row a record.

    rows : as `batch.summary_row` gives them, or the name of a record and why it `failed`
    """
    errors = {
        "before, fit": "before_fit_rmse_K", "after, fit": "after_fit_rmse_K",
        "before, held out": "before_holdout_rmse_K", "after, held out": "after_holdout_rmse_K",
        "noise floor": "noise_floor_K",
    }  # fmt: skip
    columns = [Column("record"), Column("found", is_text=True), Column("posterior", format=".3f")]
    columns += [Column(head, key, ".2f", "K") for head, key in errors.items()]
    cells = [
        [r["record"], "failed", *[""] * (len(columns) - 2)]
        if "failed" in r
        else [r["record"], _found_text(r), r["posterior"], *(r[key] for key in errors.values())]
        for r in rows
    ]
    return Table("What the declared models lack", columns, cells)


def _found_text(row: Mapping[str, Any]) -> str:
    """What a row names; faults of the record's data come first, as an effect is no finding then."""
    effects, faults = " + ".join(row["effects"]), ", ".join(dict.fromkeys(row["doubts"]))
    return f"{faults} ({effects})" if faults else effects


def _headline(found: Closure) -> tuple[str, str]:
    before, after = found.before.segment_errors(), found.after.segment_errors()
    told = _change("fitted", before["fit"], after["fit"]) + _change("held out", before["holdout"], after["holdout"])
    if found.verdicts:
        return f"No aerothermal finding: {found.verdicts[0].kind}", found.verdicts[0].words
    if found.added:
        sure = f"Posterior {found.effects[0].posterior:.3f} against all candidates, none included. "
        return f"Found: {found.named}", sure + told
    if found.effects[0].name == UNKNOWN:
        return "Something is missing that no candidate explains", " ".join(found.evidence.proposal()[:1])
    return "The declared model and its derivatives explain the record", told


def _change(what: str, before: Mapping[str, float] | None, after: Mapping[str, float] | None) -> str:
    if before is None or after is None:
        return ""
    if before is after or before["rmse_K"] == after["rmse_K"]:
        return f"RMSE over {what} data: {before['rmse_K']:.2f} K. "
    return f"RMSE over {what} data: {before['rmse_K']:.2f} K before, {after['rmse_K']:.2f} K after. "


def _errors(found: Closure) -> Section:
    rows = []
    stages = [("Declared tables, nothing fitted", found.predicted), ("Derivatives fitted (before)", found.before)]
    if found.added:
        stages.append((f"With {found.named} (after)", found.after))
    for label, prediction in stages:
        e = prediction.segment_errors()
        rows.append([label, *(t for part in ("fit", "holdout") for t in _cells(e[part]))])
    heads = ["", "RMSE fitted, K", "largest, K", "samples", "RMSE held out, K", "largest, K", "samples"]
    floor = f"Noise floor, from sensor noise and quantisation: {found.noise_floor_K:.2f} K. "
    caption = (
        f"{floor}Errors are those of the plain march, no measurement assimilated. Held-out samples were fitted by "
        "nothing; that candidates were weighed on them too is all the use that was made of them."
    )
    return Section("Errors", tables=[Table(caption, heads, rows, strong=[len(rows) - 1])])


def _cells(errors: Mapping[str, float] | None) -> list[str]:
    if errors is None:
        return ["-", "-", "0"]
    return [f"{errors['rmse_K']:.2f}", f"{errors['max_abs_K']:.1f}", f"{errors['n']:.0f}"]


def _comparison(found: Closure) -> Section:
    caption = "Each used sensor with its residuals below (measured minus predicted); held-out spans shaded."
    return Section(
        "Measured against predicted",
        pictures=[Picture(comparison_figure(found.predicted, found.before, found.after, found.named), caption)],
    )


def _effects(found: Closure) -> Section:
    rows = [
        [f"{e.name}{f' of {e.sensor}' if e.sensor else ''}: {n}", f"{p.value:.5g}", _bound(p), p.unit]
        for e in found.effects
        for n, p in e.parameters.items()
    ]
    own = len(rows)
    rows += [[n, f"{p.value:.5g}", _bound(p), p.unit] for n, p in found.parameters.items() if not _is_effect(n)]
    reference = ", ".join(f"{n} {v:.4g}" for n, v in zip(RATIO_VARIABLES, found.reference, strict=True))
    caption = f"One standard deviation, corrected for coloured residuals. Derivatives are about {reference}."
    heads = ["", "value", "sigma", "unit"]
    return Section("Estimated parameters", tables=[Table(caption, heads, rows, strong=list(range(own)))])


def _is_effect(name: str) -> bool:
    return name.startswith("effect.")


def _bound(p: ParameterEstimate) -> str:
    return f"{p.sigma:.2g}" if math.isfinite(p.sigma) else "not told"


def _candidates(found: Closure) -> Section:
    tried = sorted(found.candidates, key=lambda c: c.delta_bic)
    if not tried:
        return Section("Candidates", ["None was tried."])
    rows = [
        [c.name, f"{c.delta_bic:+.1f}", f"{c.fit_rmse_K:.2f}", _or_dash(c.holdout_rmse_K), f"{c.posterior:.3f}"]
        for c in tried
    ]
    chosen = [e.name for e in found.effects]
    marked = [i for i, c in enumerate(tried) if c.name in chosen]
    caption = "Probabilities weigh more than BIC: segments held out, sizes that nobody would expect, numbers of forms."
    heads = ["", "BIC - BIC of none", "RMSE fitted, K", "RMSE held out, K", "probability"]
    table = Table(caption, heads, rows, strong=marked)
    figure = ranking_figure([c.name for c in tried], [c.delta_bic for c in tried], chosen)
    text = [found.false_alarm] if found.false_alarm else []
    return Section(
        "Candidates", text, tables=[table], pictures=[Picture(figure, "Blue: what was added. Linear within 10.")]
    )


def _or_dash(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


def _heating(found: Closure) -> Section:
    numbers = found.residual.numbers()
    text = [
        "What has to be added to the heating ratio for the measured temperatures to be explained: the inverse heat "
        "conduction problem, regularised by the noise model that the record itself makes most likely. Changes up to "
        f"{numbers['half_amplitude_Hz']:.3g} Hz come back at more than half their size "
        f"(a period of {_period(numbers['half_amplitude_Hz'])})."
    ]
    variables = flight_variables(found.residual)
    order = [f.shape.variable for f in found.evidence.followed]
    order += [n for n in variables if n not in order]
    pictures = [
        Picture(
            heating_figure(found.residual, found.residual_after, found.evidence), "Missing heating ratio against time."
        ),
        Picture(
            variables_figure(found.residual, variables, order),
            "Missing heating ratio against what moved; bars: 1 sigma.",
        ),
    ]
    return Section("Residual as heating", text, pictures=pictures)


def _period(frequency_Hz: float) -> str:
    return f"{1.0 / frequency_Hz:.0f} s" if frequency_Hz > 0.0 else "none: the readings tell nothing"


def _evidence(found: Closure) -> Section:
    e = found.evidence
    rows = [
        [c.variable, f"{c.lag_s:+g}", f"{c.value:+.2f}", f"{c.n_effective:.0f}", *map(_short, (c.chance, c.chance_all))]
        for c in e.correlations
    ]
    correlated = Table(
        "Weighted by 1 / sigma^2. Chance: of one as large from a history that has nothing to do with it, alone, and "
        "over all variables and lags.",
        ["variable", "lag, s", "correlation", "effective points", "chance", "chance, all looks"],
        rows,
    )
    followed = Table(
        f"Best form of each variable, of what any history would explain. The shapes make {e.looks:.0f} independent "
        f"looks; noise alone would do as well as the best with a chance of {_short(e.chance)}.",
        ["shape", "size", "sigmas", "explains"],
        [[f.shape.words(), f"{f.amplitude:+.3g}", f"{abs(f.z):.1f}", f"{f.share:.0%}"] for f in e.followed[:8]],
    )
    figure = hysteresis_figure(found.residual, flight_variables(found.residual), e)
    caption = "Residual around manoeuvres that loop most: an error of the thermal model, a clock or a lag."
    pictures = [] if figure is None else [Picture(figure, caption)]
    return Section("Evidence", points=e.proposal(), tables=[followed, correlated], pictures=pictures)


def _short(chance: float) -> str:
    return f"{chance:.2g}" if chance > 1e-6 else "below 1e-6"


def _beyond(found: Closure) -> Section:
    text = [
        "With the best heating history in place, what a sensor still shows is not heating at the surface: conduction, "
        "the sensor, its clock."
    ]
    return Section("What no heating explains", text, points=[s.words() for s in found.residual.sensors])


CALIBRATION = PACKAGE / "closure" / "closure_calibration.json"
LEVEL = 0.95


def false_alarm_statement() -> str:
    """The chance of a false alarm, and what it rests on, in a line."""
    counted = read_json(CALIBRATION)
    named, records = int(counted["named"]), int(counted["records"])
    limit = float(beta.ppf(LEVEL, named + 1, records - named))
    return (
        f"An effect was named in {named} of {records} synthetic records that had none: chance of a false alarm below "
        f"{limit:.1%} with {LEVEL:.0%} confidence on such records"
    )
