"""Files of a closed loop: closure.json, residual_heating.csv, and report.html for a review.

closure.json is the format "closure-report/2"; further keys are `estimated` (all parameters of the last fit), `residual`
and `residual_after` (size and bandwidth of the residual heating, residuals that no heating explains), `evidence`,
`curve` (the variable that an unexplained residual follows; curve.csv has it with its band), `data_faults` (errors of
the record itself), `false_alarm` and `warnings`.

The chance of a false alarm, an effect named where nothing is missing, is counted over records made without an effect
(closure_calibration.json) and stated in every report.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

from sim_heating.base.errors import or_left_out
from sim_heating.base.files import finite_or_none, write_json
from sim_heating.base.files.package import package_version
from sim_heating.base.parameters import EFFECT_PREFIX
from sim_heating.base.report.page import Page, Picture, Section, sections_of, write_page
from sim_heating.base.report.table import Column, Table
from sim_heating.closure.clues.correlation import flight_variables
from sim_heating.closure.clues.residual_heating import NAME as HEATING_NAME
from sim_heating.closure.clues.residual_heating import write_residual_heating
from sim_heating.closure.curves import NAME as CURVE_NAME
from sim_heating.closure.curves import curve_words, write_curve
from sim_heating.closure.report import plots
from sim_heating.closure.result import (
    NAME,
    NONE,
    PAGE,
    PARTLY,
    UNKNOWN,
    Closure,
    JointClosure,
    ParameterEstimate,
    Statement,
)
from sim_heating.closure.verdict.adequacy import p_value_text
from sim_heating.closure.verdict.policy import POLICY
from sim_heating.credibility.section import credibility_section
from sim_heating.estimation.report.ratio_plot import derivatives_about
from sim_heating.estimation.report.remarks import further_warnings


def finding_json(
    told: Closure | JointClosure, closures: Sequence[Closure], errors: Mapping[str, Any], noise_floor_K: float
) -> dict[str, Any]:
    """The first keys of closure.json, of one record or of several: data, errors, finding and candidates.

    told   : what is told;  closures : of its records, each by itself
    errors : `predicted`, `before` and `after` over all records
    """
    effects = [e.as_json() for e in told.effects]
    return {
        "format": "closure-report/2",
        "records": [str(c.record.directory) for c in closures],
        "sensors": list(dict.fromkeys(s.name for c in closures for s in c.record.used_sensors)),
        **errors,
        "noise_floor_K": finite_or_none(noise_floor_K),
        "reference_condition": closures[0].reference_condition,
        "effect": effects[0],
        "effects": [e for e in effects if e["name"] not in (NONE, UNKNOWN)],
        **told.statement.as_json(),
        "candidates": [c.as_json() for c in sorted(told.candidates, key=lambda c: c.delta_bic)],
    }


def closure_json(closure: Closure) -> dict[str, Any]:
    """The contents of closure.json."""
    stages = {"predicted": closure.predicted, "before": closure.before, "after": closure.after}
    errors = {name: None if stage is None else stage.segment_errors() for name, stage in stages.items()}
    return {
        **finding_json(closure, [closure], errors, closure.noise_floor_K),
        "residual_heating": HEATING_NAME,
        "curve": None if closure.curve is None else {"file": CURVE_NAME, "variable": closure.curve.variable},
        "estimated": {n: p.as_json() for n, p in closure.parameters.items()},
        "residual": closure.residual.as_json(),
        "residual_after": None if closure.residual_after is None else closure.residual_after.as_json(),
        "evidence": {**closure.evidence.as_json(), "proposal": closure.evidence.proposal()},
        "data_faults": [asdict(f) for f in closure.faults],
        "false_alarm": closure.false_alarm,
        "samples": dict(closure.samples),
        "warnings": list(closure.warnings),
        "remarks": [remark.model_dump() for remark in closure.remarks],
        "program": f"sim-heating {package_version()}",
        "credibility": closure.credibility.as_json(),
    }


def write_closure(closure: Closure, folder: Path) -> None:
    """Write the files of a closure into an existing folder."""
    write_json(folder / NAME, closure_json(closure))
    or_left_out(lambda: write_residual_heating(folder / HEATING_NAME, closure.residual), None, HEATING_NAME)
    if (curve := closure.curve) is not None:
        or_left_out(lambda: write_curve(folder / CURVE_NAME, curve), None, CURVE_NAME)
    write_page(folder / PAGE, lambda: closure_page(closure))


# The page ------------------------------------------------------------------------------------------------------------


def closure_page(closure: Closure) -> Page:
    """The report as a page."""
    record = closure.record
    title = record.declared.title or record.declared.control_point
    kind = "measured" if record.declared.measured else "synthetic"
    subtitle = f"Record {record.name}, control point {record.declared.control_point}, {kind} data"
    warnings = [*(f.message for f in closure.faults), *further_warnings(closure.warnings, closure.remarks)]
    sections = sections_of(
        {
            "Not an aerothermal effect": lambda: not_effects_section(closure.statement),
            "What would tell them apart": lambda: tell_apart_section(closure.statement),
            "Errors": lambda: _errors_section(closure),
            "Does it explain the record?": lambda: _adequacy_section(closure),
            "Measured against predicted": lambda: _comparison_section(closure),
            "Estimated parameters": lambda: _parameters_section(closure),
            "Candidates": lambda: _candidates_section(closure),
            "Better, and may not be named": lambda: _barred_section(closure),
            "Residual as heating": lambda: _heating_section(closure),
            "Evidence": lambda: _evidence_section(closure),
            "Residuals that no heating explains": lambda: _sensors_section(closure),
            "Credibility": lambda: credibility_section(closure.credibility.as_json()),
        }
    )
    return Page(title, subtitle, sections, _headline(closure), warnings)


def closures_table(rows: Sequence[Mapping[str, Any]], pages: Sequence[str | None] = ()) -> Table:
    """Effects found in records and the errors before and after, a row a record; a page sorts and filters them.

    rows  : as `closure.batch.summary_row` gives them, or the name of a record and why it `failed`
    pages : of each record, the address of its own page
    """
    errors = {
        "before, fit": "before_fit_rmse_K",
        "after, fit": "after_fit_rmse_K",
        "before, held out": "before_holdout_rmse_K",
        "after, held out": "after_holdout_rmse_K",
        "noise floor": "noise_floor_K",
    }
    columns = [Column("record"), Column("finding", is_text=True)]
    columns += [Column("prob.", "probability", ".2f"), Column("p-value", "p_value", ".2g")]
    columns += [Column(head, key, ".2f", "K") for head, key in errors.items()]
    cells = [
        [r["record"], "failed", *[""] * (len(columns) - 2)]
        if "failed" in r
        else [
            r["record"],
            _finding_text(r),
            r["probability"],
            p_value_cell(r["p_value"]),
            *(_error_cell(r, key) for key in errors.values()),
        ]
        for r in rows
    ]
    return Table("What the declared models lack", columns, cells, sortable=True, choices=["finding"], links=pages)


def _error_cell(row: Mapping[str, Any], key: str) -> float | None:
    """An error of a row; none after where nothing was added to the model."""
    return None if key.startswith("after_") and row["finding"] == NONE else row[key]


def _finding_text(row: Mapping[str, Any]) -> str:
    """The finding of a row; faults of the record's data come first, as an effect is no finding then."""
    finding = f"{row['finding']}: {row['named']}" if row["named"] else row["finding"]
    faults = ", ".join(dict.fromkeys(row["data_faults"]))
    return f"{faults} ({finding})" if faults else finding


def _headline(closure: Closure) -> tuple[str, str]:
    """The outcome, and one line on it."""
    before, after = closure.before.segment_errors(), closure.after.segment_errors()
    errors = _change("fitted", before["fit"], after["fit"]) + _change("held out", before["holdout"], after["holdout"])
    finding, certainty = closure.statement.in_words(), closure.statement.certainty()
    if closure.faults:
        line = f"{closure.faults[0].message} The search states: {finding[0].lower()}{finding[1:]}. {certainty}"
        return f"No aerothermal finding: {closure.faults[0].kind}", line
    if closure.statement.finding == UNKNOWN:
        return finding, " ".join([certainty, *closure.evidence.proposal()[:1]])
    return finding, f"{certainty} {errors}"


def _change(samples: str, first: Mapping[str, float] | None, last: Mapping[str, float] | None) -> str:
    """RMSE over fitted or held-out data, before and after."""
    if first is None or last is None:
        return ""
    if first is last or first["rmse_K"] == last["rmse_K"]:
        return f"RMSE over {samples} data: {first['rmse_K']:.2f} K. "
    return f"RMSE over {samples} data: {first['rmse_K']:.2f} K before, {last['rmse_K']:.2f} K after. "


def not_effects_section(statement: Statement) -> list[Section]:
    """Causes that are no aerothermal effect, in words."""
    causes = [f"{c.kind}: {c.what}" for c in statement.not_effects]
    return [Section("Not an aerothermal effect", points=causes)] if causes else []


def tell_apart_section(statement: Statement) -> list[Section]:
    """What would tell the alternatives apart, with expected odds."""
    lines = statement.would_tell()
    if not lines:
        return []
    text = (
        f"Expected odds between the alternatives after one more {statement.experiment} like this one, with the change "
        "named: the same conditions, instruments and noise, and no other error of the model. Odds below "
        f"{POLICY.odds_apart:g} to 1 tell nothing apart."
    )
    return [Section("What would tell them apart", [text], points=lines)]


def _adequacy_section(closure: Closure) -> list[Section]:
    """Reduced chi-squares of the model with what was found, by sensor and by time."""
    adequacy = closure.statement.adequacy
    if adequacy is None:
        return []
    rows: list[list[Any]] = [["fitted samples", adequacy.chi2_fit]]
    if adequacy.chi2_holdout is not None:
        rows.append(["segments held out", adequacy.chi2_holdout])
    rows += [[f"sensor {n}", v] for n, v in adequacy.by_sensor.items()]
    rows += [[n, v] for n, v in adequacy.by_phase.items()]
    resembled = closure.statement.finding == PARTLY
    whose = f"With {closure.statement.named}, which is not stated as the cause. " if resembled else ""
    exact, p = closure.statement.model_error is None, p_value_text(adequacy.p_value)
    residuals = "Residuals" if exact else "Readings less what those before them say, by the model with its error,"
    below = (
        ""
        if exact or adequacy.chi2_fit >= 1.0
        else ", and below 1 where the noise is smaller than stated or changes slowly"
    )
    reference = "synthetic records, fitted with their true effect," if exact else "records made with this model"
    text = (
        f"{whose}{residuals} over what noise and rounding give. For the true model the reduced chi-square is 1 in "
        f"every row{below}. The autocorrelation of neighbouring residuals is {adequacy.lag1:.2f}. The p-value, {p}, is "
        f"the share of {reference} that deviate more."
    )
    return [
        Section(
            "Does it explain the record?",
            [text],
            tables=[Table("", ["", Column("reduced chi-square", format=".2f")], rows)],
        )
    ]


def _errors_section(closure: Closure) -> Section:
    stages = [] if closure.predicted is None else [("Declared model, nothing fitted", closure.predicted)]
    stages.append(("Declared model fitted (before)", closure.before))
    if closure.compared:
        stages.append((f"With {closure.fitted_with} (after)", closure.after))
    rows = []
    for label, prediction in stages:
        errors = prediction.segment_errors()
        rows.append([label, *(cell for segment in ("fit", "holdout") for cell in _error_cells(errors[segment]))])
    columns: list[Column | str] = [
        "",
        Column("RMSE fitted, K", "fit_rmse_K", ".2f"),
        Column("largest, K", "fit_max_abs_K", ".1f"),
        Column("samples", "fit_n", ".0f"),
        Column("RMSE held out, K", "holdout_rmse_K", ".2f"),
        Column("largest, K", "holdout_max_abs_K", ".1f"),
        Column("samples", "holdout_n", ".0f"),
    ]
    caption = (
        f"Noise floor, from sensor noise and quantisation: {closure.noise_floor_K:.2f} K. Errors are those of the "
        "plain march, with no measurement assimilated. Held-out samples entered no fit; they were used only to rank "
        "the candidates."
    )
    return Section("Errors", tables=[Table(caption, columns, rows, strong=[len(rows) - 1])])


def _error_cells(errors: Mapping[str, float] | None) -> list[float | None]:
    """RMSE, largest error, number of samples."""
    return [None, None, 0] if errors is None else [errors["rmse_K"], errors["max_abs_K"], errors["n"]]


def _comparison_section(closure: Closure) -> Section:
    chart = plots.comparison_chart(closure.predicted, closure.before, closure.after, closure.fitted_with)
    return Section("Measured against predicted", charts=[chart])


def _parameters_section(closure: Closure) -> list[Section]:
    """Estimates of what was found, then those of the model; none where nothing was estimated."""
    rows = [row for e in closure.effects for row in _estimate_rows(e.parameters, f"{e.title}: ")]
    rows += [row for c in closure.statement.not_effects for row in _estimate_rows(c.parameters, f"{c.kind}: ")]
    of_effects = len(rows)
    derivatives = {n: p for n, p in closure.parameters.items() if not n.startswith(EFFECT_PREFIX)}
    rows += _estimate_rows(derivatives)
    if not rows:
        return []
    about = derivatives_about(derivatives, closure.reference)
    exact = closure.statement.model_error is None
    bounds = "corrected for coloured residuals" if exact else "with the error of the model"
    caption = f"One standard deviation, {bounds}. {about}".rstrip()
    columns: list[Column | str] = ["", Column("value", format=".5g"), Column("sigma", format=".2g")]
    columns.append(Column("unit", is_text=True))
    table = Table(caption, columns, rows, strong=list(range(of_effects)))
    return [Section("Estimated parameters", points=[r.in_words for r in closure.remarks], tables=[table])]


def _estimate_rows(estimates: Mapping[str, ParameterEstimate], of_cause: str = "") -> list[list[Any]]:
    """Cells of each estimate; of_cause : the cause that it is of, before its name."""
    return [[of_cause + n, p.value, _sigma_cell(p), p.unit] for n, p in estimates.items()]


def _sigma_cell(p: ParameterEstimate) -> float | str:
    """A sigma, or a word where it is not finite."""
    return p.sigma if math.isfinite(p.sigma) else "not determined"


def _candidates_section(closure: Closure) -> Section:
    ranked = sorted(closure.candidates, key=lambda c: c.delta_bic)
    if not ranked:
        return Section("Candidates", ["No candidate was tried."])
    names, delta_bics = zip(*((c.name, c.delta_bic) for c in ranked), strict=True)
    marched = any(math.isfinite(c.fit_rmse_K) for c in ranked)
    rows = [
        [c.name, c.delta_bic, *((c.fit_rmse_K, c.holdout_rmse_K) if marched else ()), _share_cell(c.posterior)]
        for c in ranked
    ]
    chosen = [e.name for e in closure.effects]
    marked = [i for i, name in enumerate(names) if name in chosen]
    caption = (
        "Share: of the likelihood of all that may be named, held-out segments, priors on magnitudes and the number of "
        "forms included. It compares single causes of this list and is no probability: something else may be the cause."
    )
    columns: list[Column | str] = ["", Column("BIC - BIC of none", "delta_bic", "+.1f")]
    if marched:
        columns += [Column("RMSE fitted, K", "fit_rmse_K", ".2f"), Column("RMSE held out, K", "holdout_rmse_K", ".2f")]
    columns.append(Column("share", "posterior", ".2g"))
    table = Table(caption, columns, rows, strong=marked)
    picture = Picture(
        partial(plots.ranking_figure, names, delta_bics, chosen), "Blue: added effects. The axis is linear within 10."
    )
    text = [closure.false_alarm] if closure.false_alarm else []
    return Section("Candidates", text, tables=[table], pictures=[picture])


def _barred_section(closure: Closure) -> list[Section]:
    """Models that fit better than the one that errors after are of, and why they may not be named."""
    rows = [[" + ".join(b.names), b.delta_evidence, b.reason] for b in closure.statement.barred]
    columns: list[Column | str] = [
        "model",
        Column("log evidence above", format="+.1f"),
        Column("may not be named", is_text=True),
    ]
    model = f"that with {closure.fitted_with}" if closure.fitted_with else "the declared model"
    text = f"Log evidence, segments held out and priors included, is above {model}."
    return [Section("Better, and may not be named", tables=[Table(text, columns, rows)])] if rows else []


def _share_cell(posterior: float) -> float | str:
    """A share of the likelihood, never as certain."""
    return "above 0.99" if posterior > 0.99 else "below 0.001" if posterior < 0.001 else posterior


def _heating_section(closure: Closure) -> Section:
    half_amplitude_Hz = closure.residual.input.half_amplitude_Hz
    text = [
        f"The {closure.residual.quantity} that has to be added for the measured temperatures to be explained: the "
        "inverse heat conduction problem, regularised by the noise model that the record itself makes most likely. "
        f"Changes up to {half_amplitude_Hz:.3g} Hz are recovered with more than half their size (a period of "
        f"{_period(half_amplitude_Hz)})."
    ]
    variables = flight_variables(closure.residual)
    if closure.curve is not None:
        text.append(
            f"A smooth curve explains most of it: {curve_words(closure.curve)}. {CURVE_NAME} has it with its standard "
            "deviation. It states no cause."
        )
    order = [f.shape.variable for f in closure.evidence.shape_fits]
    order += [n for n in variables if n not in order]
    over_time = plots.heating_chart(closure.residual, closure.residual_after, closure.evidence)
    over_variables = partial(plots.variables_figure, closure.residual, variables, order)
    caption = f"Missing {closure.residual.quantity} against what changed; bars: 1 sigma."
    return Section("Residual as heating", text, pictures=[Picture(over_variables, caption)], charts=[over_time])


def _period(frequency_Hz: float) -> str:
    """The period of a frequency, in words."""
    return f"{1.0 / frequency_Hz:.0f} s" if frequency_Hz > 0.0 else "none: the readings do not determine it"


def _evidence_section(closure: Closure) -> Section:
    e = closure.evidence
    correlations = Table(
        "Weighted by 1 / sigma^2. The p-value is that of a correlation as large with an unrelated history, for the one "
        "variable and lag, and over all of them.",
        [
            "variable",
            Column("lag, s", "lag_s", "+g"),
            Column("correlation", "value", "+.2f"),
            Column("effective points", "n_effective", ".0f"),
            Column("p-value", "p_value", ".2g"),
            Column("p-value, all", "p_value_all", ".2g"),
        ],
        [
            [c.variable, c.lag_s, c.value, c.n_effective, p_value_cell(c.p_value), p_value_cell(c.p_value_all)]
            for c in e.correlations
        ],
    )
    fits = Table(
        f"Best shape of each variable, and its part of the gain of the best history of any shape. The shapes amount to "
        f"{e.trials_factor:.0f} independent trials; the p-value of the best, from noise alone, is "
        f"{p_value_text(e.p_value)}.",
        [
            "shape",
            Column("size", "amplitude", "+.3g"),
            Column("sigmas", "z", ".1f"),
            Column("explains", "share", ".0%"),
        ],
        [[f.shape.describe(), f.amplitude, abs(f.z), f.share] for f in e.shape_fits[:8]],
    )
    figure = plots.hysteresis_figure(closure.residual, flight_variables(closure.residual), e)
    caption = "Residual around the manoeuvres with the widest loops: an error of the thermal model, a clock or a lag."
    pictures = [] if figure is None else [Picture(figure, caption)]
    points = [*e.proposal(), *(f"Left out: {piece} ({reason})." for piece, reason in e.left_out.items())]
    return Section("Evidence", points=points, tables=[fits, correlations], pictures=pictures)


def p_value_cell(p: float | None) -> float | str | None:
    """A p-value in a column of numbers of two digits, or its text where that has others."""
    return p if p is None or f"{p:.2g}" == p_value_text(p) else p_value_text(p)


def _sensors_section(closure: Closure) -> Section:
    text = [
        "A residual that remains with the best heating history is not due to heating at the surface: conduction, the "
        "sensor, its clock."
    ]
    return Section("Residuals that no heating explains", text, points=[s.describe() for s in closure.residual.sensors])
