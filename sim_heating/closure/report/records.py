"""Files of a joint closed loop: closure.json, records.csv with what each record adds, and report.html for a review.

closure.json is the format "closure-report/2" over all records: errors are pooled, `reference_condition` is that of the
first record and `residual_heating` null. Further keys are `by_record` (the finding of each record by itself, what it
adds to the joint one, its own values, errors and reference condition), `common_cost` (what common parameters, priors
and forms add to the score), `common_parameters` (whose one value of each parameter of the cause is: of all records, of
a point, or of a record), and `estimated` with labels `name@owner`.
"""

from __future__ import annotations

from dataclasses import asdict, replace
from functools import partial
from itertools import starmap
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from sim_heating.base.files import finite_or_none, write_csv, write_json
from sim_heating.base.files.package import package_version
from sim_heating.base.files.text import listed
from sim_heating.base.parameters import AT
from sim_heating.base.report.chart import Chart
from sim_heating.base.report.figure import add_grid_and_title, legend_above, new_figure
from sim_heating.base.report.page import Page, Picture, Section, sections_of, write_page
from sim_heating.base.report.table import Column, Table
from sim_heating.closure.report.record import finding_json, not_effects_section, p_value_cell, tell_apart_section
from sim_heating.closure.result import NAME, PAGE, RECORDS, Closure, JointClosure, finding_alone
from sim_heating.closure.search.evidence import Evidence
from sim_heating.closure.search.joint_model import RECORD
from sim_heating.closure.search.trials.told_error import flight_as_json
from sim_heating.closure.verdict.policy import POLICY
from sim_heating.credibility.section import credibility_section
from sim_heating.estimation.report.plots import AFTER, BEFORE, FITTED, fit_chart, shade_holdout
from sim_heating.simulation.predict import Prediction

# Files ----------------------------------------------------------------------------------------------------------------


def _pooled_predictions(joint: JointClosure) -> dict[str, Any] | None:
    """Errors of the declared models; None where one of them lacks a heating ratio."""
    predicted = [c.predicted for c in joint.closures if c.predicted is not None]
    return joint.pooled(predicted) if len(predicted) == len(joint.closures) else None


def _pooled_floor_K(joint: JointClosure) -> float:
    """Noise floor of the fitted samples of all records [K]."""
    floors = [(c.noise_floor_K, int(np.count_nonzero(c.record.fit_mask()))) for c in joint.closures]
    return float(np.sqrt(sum(n * k**2 for k, n in floors) / sum(n for _, n in floors)))


def joint_closure_json(joint: JointClosure) -> dict[str, Any]:
    """The contents of closure.json."""
    best = joint.search.best
    by_record = zip(joint.closures, joint.search.evidence, joint.after, strict=True)
    flights = {n: flight_as_json(e) for n, e in joint.flights.items()}
    errors = {
        "predicted": _pooled_predictions(joint),
        "before": joint.pooled([c.before for c in joint.closures]),
        "after": joint.pooled(joint.after),
    }
    return {
        **finding_json(joint, joint.closures, errors, _pooled_floor_K(joint)),
        "residual_heating": None,
        "by_record": list(starmap(_record_json, by_record)),
        "model_error": {"flights": flights} if flights else None,
        "common_cost": best.common,
        "common_parameters": {} if best.model is None else dict(best.model.levels),
        "estimated": {n: p.as_json() for n, p in joint.parameters.items()},
        "remarks": joint.remarks(),
        "warnings": list(joint.warnings),
        "program": f"sim-heating {package_version()}",
        "credibility": joint.credibility.as_json(),
    }


def _record_json(closure: Closure, e: Evidence, prediction: Prediction) -> dict[str, Any]:
    """One record in closure.json; scores are differences of BIC, below 0 where they speak for the cause."""
    return {
        "record": closure.record.name,
        "control_point": closure.record.declared.control_point,
        "closure": f"{closure.record.name}/closure.json",
        "finding": closure.statement.finding,
        "alternatives": [list(names) for names in closure.statement.alternatives],
        "verdict": e.verdict,
        "has_cause": e.member,
        "delta_score": -e.for_cause,
        "delta_score_rival": None if e.over_rival is None else e.over_rival - e.for_cause,
        "agreement_p": e.agreement,
        "data_faults": [asdict(f) for f in closure.faults],
        "own_values": {n: {"value": v, "sigma": finite_or_none(s)} for n, (v, s) in e.own.items()},
        "reference_condition": closure.reference_condition,
        "before": closure.before.segment_errors(),
        "after": prediction.segment_errors(),
        "noise_floor_K": finite_or_none(closure.noise_floor_K),
    }


def write_joint_closure(joint: JointClosure, folder: Path) -> None:
    """Write the files of a joint closure into an existing folder."""
    write_json(folder / NAME, joint_closure_json(joint))
    write_csv(folder / RECORDS, evidence_table(joint).columns_by_key())
    write_page(folder / PAGE, lambda: joint_page(joint))


# The page -------------------------------------------------------------------------------------------------------------


def joint_page(joint: JointClosure) -> Page:
    """The report as a page."""
    points = dict.fromkeys(c.record.declared.control_point for c in joint.closures)
    plural = "s" if len(points) > 1 else ""
    subtitle = f"Records {listed(joint.names)}, control point{plural} {listed(list(points))}"
    sections = sections_of(
        {
            "Not an aerothermal effect": lambda: not_effects_section(joint.statement),
            "What each record adds": lambda: _evidence_section(joint),
            "Residuals side by side": lambda: _residuals_section(joint),
            "What would tell them apart": lambda: tell_apart_section(joint.statement),
            "Errors": lambda: _errors_section(joint),
            "Does it explain the records?": lambda: _adequacy_section(joint),
            "Parameters": lambda: _values_section(joint),
            "Causes fitted to all records": lambda: _candidates_section(joint),
            "Credibility": lambda: credibility_section(joint.credibility.as_json()),
        }
    )
    before, after = (joint.pooled(p)["fit"] for p in ([c.before for c in joint.closures], joint.after))
    errors = f"RMSE over fitted data: {before['rmse_K']:.2f} K before, {after['rmse_K']:.2f} K after."
    return Page(
        f"{len(joint.closures)} records, jointly",
        subtitle,
        sections,
        (joint.in_words(), f"{joint.certainty()} {errors}"),
        [*joint.remarks(), *joint.warnings],
    )


def evidence_table(joint: JointClosure) -> Table:
    """What each record adds: its own finding, and its part of the joint scores."""
    best, rival = joint.search.best, joint.search.rival
    against = "the next one" if rival is None else " + ".join(rival.names)
    columns: list[Column | str] = [
        "record",
        Column("point", is_text=True),
        Column("by itself", "alone", is_text=True),
        Column("for the cause", "for_cause", "+.1f"),
        Column(f"over {against}", "over_rival", "+.1f"),
        Column("agrees, p", "agreement_p", ".2g"),
        Column("verdict", is_text=True),
    ]
    rows: list[list[Any]] = [
        [e.record, e.point, finding_alone(e), e.for_cause, e.over_rival, e.agreement, e.verdict]
        for e in joint.search.evidence
    ]
    if best.model is not None:
        # of a record without the cause the score in the sum is that of its own explanation
        over = None if rival is None else rival.score - best.score
        common = None if rival is None else rival.common - best.common
        rows.append(["common", "", "", -best.common, common, None, ""])
        rows.append(["together", "", joint.named, -best.score, over, None, ""])
    cause = " + ".join(best.names) or "none"
    return Table(f"What each record adds: {cause}", columns, rows, strong=[len(rows) - 1])


def _evidence_section(joint: JointClosure) -> Section:
    text = [
        "Differences of BIC with the segments held out, above 0 where a record speaks for the cause, and where it "
        f"speaks for it rather than for the next one; {POLICY.min_gain:g} is what a finding needs. `common` is what "
        "parameters in common, priors and the number of forms cost. A record that has not got the cause is judged with "
        "the values of the others, and counts in the sum with what it shows by itself. The p-value is that of values "
        "of its own as far from the common ones.",
    ]
    return Section("What each record adds", text, tables=[evidence_table(joint)])


def _residuals_section(joint: JointClosure) -> Section:
    """Residuals of the records side by side, derivatives fitted and with the cause."""
    charts: list[Chart] = []
    picture = Picture(partial(residuals_figure, joint), "Measured minus predicted, by record; held-out spans shaded.")
    for closure, after in zip(joint.closures, joint.after, strict=True):
        curves = _curves(joint, closure, after)
        chart = fit_chart(closure.record, curves, picture, temperatures=False)
        charts.append(replace(chart, pictured=not charts))  # one picture shows them all
    return Section("Residuals side by side", charts=charts)


def _curves(joint: JointClosure, closure: Closure, prediction: Prediction) -> list[tuple[Prediction, str, str]]:
    """What a record is compared with: prediction, colour and words of each."""
    curves = [(closure.before, BEFORE, FITTED)]
    cause = " + ".join(joint.search.compared.names)
    return curves if prediction is closure.before else [*curves, (prediction, AFTER, f"with {cause}")]


def residuals_figure(joint: JointClosure) -> Figure:
    """Residuals of each record's used sensors [K], derivatives fitted and with the cause."""
    count = len(joint.closures)
    figure, axes = new_figure(9.5, 2.2 * count + 0.6, count)
    for a, closure, after in zip(axes, joint.closures, joint.after, strict=True):
        record = closure.record
        judged = record.fit_mask() | record.holdout_mask()
        curves = _curves(joint, closure, after)
        style = {"linestyle": "none", "marker": ".", "markersize": 2.5, "rasterized": True}
        for prediction, color, label in curves:
            for k, i in enumerate(i for i, s in enumerate(record.sensors) if s.used):
                residual_K, legend = prediction.residual_K[i], label if k == 0 else None
                a.plot(record.time_s[judged], residual_K[judged], color=color, label=legend, **style)
        a.axhline(0.0, color="0.3", linewidth=0.8)
        a.set_ylabel(f"{record.name}\nresidual, K")
        shade_holdout(a, record)
        legend_above(a)
    axes[-1].set_xlabel("time, s")
    add_grid_and_title(figure, "", axes)
    return figure


def _errors_section(joint: JointClosure) -> Section:
    columns: list[Column | str] = [
        "record",
        Column("fitted, before, K", format=".2f"),
        Column("after, K", format=".2f"),
        Column("held out, before, K", format=".2f"),
        Column("held out, after, K", format=".2f"),
        Column("noise floor, K", format=".2f"),
    ]
    rows = []
    for closure, after in zip(joint.closures, joint.after, strict=True):
        errors = [p.segment_errors()[segment] for segment in ("fit", "holdout") for p in (closure.before, after)]
        rows.append([closure.record.name, *(None if e is None else e["rmse_K"] for e in errors), closure.noise_floor_K])
    return Section("Errors", tables=[Table("RMSE of the plain march, by record.", columns, rows)])


def _adequacy_section(joint: JointClosure) -> Section:
    best = joint.search.best if joint.statement.finding in ("found", "one of", "partly") else joint.search.none
    rows = [
        [name, a.chi2_fit, a.chi2_holdout, a.lag1, p_value_cell(a.p_value)]
        for name, a in zip(joint.names, best.adequacy_by_record, strict=True)
    ]
    columns: list[Column | str] = [
        "record",
        Column("chi-square, fitted", format=".2f"),
        Column("held out", format=".2f"),
        Column("autocorrelation", format=".2f"),
        Column("p-value", format=".2g"),
    ]
    text = "Reduced chi-squares of normalised residuals, 1 for the true model; p-values as for a single record."
    return Section("Does it explain the records?", tables=[Table(text, columns, rows)])


def _values_cells(joint: JointClosure, name: str) -> list[str]:
    """A parameter as all records give it, and as each gives it by itself."""
    common = [p for label, p in joint.parameters.items() if label.partition(AT)[0] == name]
    alone = [e.own.get(name) for e in joint.search.evidence]
    in_common = "; ".join(_bound(p.value, p.sigma) for p in common) or "-"
    return [in_common, *("-" if o is None else _bound(*o) for o in alone)]


def _values_section(joint: JointClosure) -> Section:
    """The cause's parameters: in common, and as each record gives them by itself."""
    best = joint.search.best
    if best.model is None:
        return Section("Parameters", ["No cause was fitted."])
    columns: list[Column | str] = ["parameter", Column("whose", is_text=True), Column("together", is_text=True)]
    columns += [Column(f"{e.record} alone", is_text=True) for e in joint.search.evidence]
    whose = {"all": "all records", "point": "each point", RECORD: "each record"}
    if len({e.point for e in joint.search.evidence}) == 1:
        whose["point"] = whose["all"]
    only = joint.names[best.members[0]] if len(best.members) == 1 else ""
    rows = []
    for name in best.model.cause.candidate.names:
        rows.append([name, only or whose[best.model.levels[name]], *_values_cells(joint, name)])
    exact = all(c.statement.model_error is None for c in joint.closures)
    bounds = "corrected for coloured residuals" if exact else "with the error of the models"
    text = (
        f"Values with one standard deviation; those together are {bounds}. Magnitude and derivatives of the heating "
        "ratio are each record's own."
    )
    return Section("Parameters", [text], tables=[Table("", columns, rows)])


def _bound(value: float, sigma: float) -> str:
    return f"{value:.5g} +- {sigma:.2g}" if np.isfinite(sigma) else f"{value:.5g}, not determined"


def _candidates_section(joint: JointClosure) -> Section:
    levels = {" + ".join(h.names): h for h in joint.search.hypotheses}
    rows = []
    for c in sorted(joint.candidates, key=lambda c: c.delta_bic):
        h = levels.get(c.name)
        note = "" if h is None else "; ".join(h.objections)
        score = 0.0 if h is None else h.score
        rows.append([c.name, c.delta_bic, score, c.fit_rmse_K, c.holdout_rmse_K, note])
    columns: list[Column | str] = [
        "",
        Column("BIC - BIC of none", format="+.1f"),
        Column("score", format="+.1f"),
        Column("RMSE fitted, K", format=".2f"),
        Column("RMSE held out, K", format=".2f"),
        Column("may not be named", is_text=True),
    ]
    text = "The score adds segments held out, priors on magnitudes and the number of forms."
    return Section("Causes fitted to all records", tables=[Table(text, columns, rows)])
