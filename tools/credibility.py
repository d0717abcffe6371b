"""Evidence of the credibility statement: verification rows by topic, counted claims, measured data sets.

    python -m tools.credibility     # writes sim_heating/credibility/evidence.json from benchmarks/results

It predicts the measured records with their declared models, nothing fitted, and computes nothing else: run it after
other benchmarks have changed their results. tests/credibility/test_evidence.py compares the file with them.
"""

from __future__ import annotations

import json
import re
import subprocess
from collections.abc import Mapping
from typing import Any

import click

from benchmarks.measure import RESULTS, Figure, table
from sim_heating.base.files import text_digest, write_json
from sim_heating.credibility.evidence import EVIDENCE, case_as_json, shipped_evidence
from sim_heating.credibility.rules import rules
from sim_heating.credibility.section import RANGES
from sim_heating.credibility.validation.own_cases import case_of_record
from sim_heating.simulation.predict import Prediction, predict
from tools.page import markdown_table

ROOT = RESULTS.parents[1]
RECORDS = ("sts96_468", "sts96_480", "sts96_597", "sts96_730", "kaowool_board")
"""Measured data sets of the project, below scenarios/records."""
TOPICS = {
    "conduction": (r"Conduction", r""),
    "surface balance": (r"Surface", r""),
    "mesh and steps": (r"Mesh and steps as chosen|Method", r"mesh|order|largest error|heat that entered"),
    "whole stack": (r"Whole stack", r"tile stack"),
    "ratio table": (r"Whole stack", r"tile stack"),
    "sensitivities": (r"Method", r"derivative of a thermocouple"),
    "estimates": (r"Whole stack", r"estimate of"),
    "contact resistance": (r"Conduction", r"contact"),
    "conductivity at pressures": (r"Conduction", r"porous"),
    "venting": (r"Behind and within a wall", r"vents"),
    "back face": (r"Behind and within a wall", r"behind"),
    "equilibrium air": (r"Equilibrium air", r""),
    "atmosphere": (r"Atmosphere", r""),
    "surface pressure": (r"Reference heating", r"surface pressure"),
    "reference sutton-graves": (r"Reference heating", r"(?i)sutton-graves"),
    "reference detra-kemp-riddell": (r"Reference heating", r"Detra"),
    "reference fay-riddell": (r"Reference heating", r"(?i)fay-riddell"),
    "reference swept-cylinder": (r"Reference heating", r"swept-cylinder"),
    "reference eckert-laminar": (r"Reference heating", r"(laminar plate|dissipation, laminar).*(film|C_h)"),
    "reference eckert-turbulent": (r"Reference heating", r"(turbulent plate|dissipation, turbulent)"),
    "recovery edge-laminar": (r"Reference heating", r"(recovery enthalpy|adiabatic|laminar plate).*(, laminar|factor)"),
    "recovery edge-turbulent": (r"Reference heating", r"(recovery enthalpy|adiabatic).*, turbulent"),
    "recovery attachment-line": (r"Reference heating", r"insulated leading edge"),
    "effect transition": (r"Transition", r"^transition|^Re_theta"),
    "effect recombination": (r"Transition", r"^recombination|^noncatalytic"),
    "effect moisture": (r"Conduction", r"dried"),
    "thermocouple lag": (r"Sensors", r"tau"),
    "recorder words": (r"Sensors", r"bits"),
    "trajectory entry-3dof": (r"Trajectories", r""),
    "optimal entry": (r"Optimal entry", r""),
    "trim": (r"Trim", r""),
}
"""Topic -> patterns of the subject and of the name of its verification rows. Effects are topics by their names."""


CLAIMS = (
    ("estimate", "estimator_null", r"95% bounds that hold, mesh corrected", "records of another program"),
    ("estimate", "estimator_statistics", r"^(popu|flap|coating|skew): .*coverage", "repeated noise"),
    ("closed loop", "closure_challenge_null", r"0.95 or more: right$|false findings", "records without an effect"),
    ("closed loop", "closure_challenge_share", r"0.95 or more: right$", "records with effects"),
)
"""Kind of result, result file, pattern of its figures, and what was counted: the statistical promises."""


def claims() -> list[dict[str, Any]]:
    """Statistical promises with the figures that were counted."""
    return [
        _claim(of, f"{figure['what']} ({records})", figure, file)
        for of, file, pattern, records in CLAIMS
        for figure in _result(file)["figures"]
        if re.search(pattern, figure["what"])
    ]


def command_of(file: str) -> str:
    """Command that writes a result file, named without its folder and ending."""
    command = {
        "closure_challenge_null": ".closure_challenge --classes null",
        "closure_challenge_share": ".closure_challenge --share 0.2",
    }.get(file, f" {file}")
    return f"python -m benchmarks{command}"


def _claim(of: str, claim: str, figure: Mapping[str, Any], file: str) -> dict[str, Any]:
    return {"of": of, "claim": claim, "value": round(figure["value"], 4), "bound": round(figure["target"], 4),
            "at_least": figure["at_least"],
            "command": command_of(file), "file": f"benchmarks/results/{file}.json",
            "key": figure["what"]}  # fmt: skip


def _result(name: str) -> dict[str, Any]:
    return dict(json.loads((RESULTS / f"{name}.json").read_text(encoding="utf-8")))


def topics() -> dict[str, dict[str, int]]:
    """Verification rows by topic, and how many are within their limits."""
    rows = _result("verification")["rows"]
    found = {}
    for topic, (subject, name) in TOPICS.items():
        own = [r for r in rows if re.search(subject, r["subject"]) and re.search(name, r["reference"])]
        found[topic] = {"rows": len(own), "within": sum(abs(r["error"]) <= r["limit"] for r in own)}
    return found


def rows_digest() -> str:
    """Digest of what the verification rows are and which are within their limits, not of their last digits."""
    rows = _result("verification")["rows"]
    lines = [f"{r['subject']}|{r['reference']}|{r['limit']:.3g}|{abs(r['error']) <= r['limit']}" for r in rows]
    return text_digest("\n".join(lines))


def _date(name: str) -> str:
    """Date on which a result file was last committed, in UTC."""
    command = ["git", "log", "-1", "--format=%cs", "--", f"benchmarks/results/{name}.json"]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout.strip()


def case_of(predicted: Prediction) -> dict[str, Any]:
    """A measured data set as evidence.json has it."""
    return case_as_json(case_of_record(predicted.record, predicted.residual_K))


def evidence(date: str) -> dict[str, Any]:
    """Content of evidence.json.

    date : of the verification rows
    """
    cases = [case_of(predict(ROOT / "scenarios" / "records" / name)) for name in RECORDS]
    return {
        "format": "credibility-evidence/1",
        "made_by": "python -m tools.credibility",
        "verification": {"file": "benchmarks/results/verification.json", "digest": rows_digest(), "date": date,
                         "topics": topics()},
        "claims": claims(),
        "cases": cases,
    }  # fmt: skip


def main() -> None:
    """Write evidence.json and print its counts."""
    found = evidence(_date("verification"))
    write_json(EVIDENCE, found)
    click.echo(table(counted(found)))


def counted(found: Mapping[str, Any]) -> list[Figure]:
    """How many topics have verification rows, and the errors of the measured data sets."""
    counts = found["verification"]["topics"]
    figures = [Figure("topics with verification rows", float(sum(t["rows"] > 0 for t in counts.values())), "")]
    figures.append(
        Figure("topics with a row beyond its limit", sum(t["rows"] != t["within"] for t in counts.values()), "", 0.0)
    )
    figures += [Figure(f"{c['name']}: RMSE of the declared prediction", c["rmse_K"], "K") for c in found["cases"]]
    return figures


def table_of(marked: str) -> str | None:
    """Table of a marked part of a page, `credibility, PART`; None for another benchmark."""
    name, _, part = marked.partition(", ")
    return {"rules": _rules, "cases": _cases, "region": _region}[part]() if name == "credibility" else None


def _rules() -> str:
    """Every factor with the rule of each level."""
    rows: list[list[object]] = []
    for factor in rules().factors:
        rows.append([f"**{factor.title}**", "", f"{factor.about[0].upper()}{factor.about[1:]}"])
        rows += [["", level, factor.rule(level)] for level in range(len(factor.levels) + 1)]
    return markdown_table(["factor", "level", "rule"], rows)


def _cases() -> str:
    """Measured data sets with the errors of their predictions."""
    heads = ["data set", "what", "readings", "RMSE, K", "largest error, K", "rise, K", "RMSE over rise"]
    rows = [
        [f"`{c.name}`", c.title.partition(":")[0], c.n, f"{c.rmse_K:.1f}", f"{c.max_abs_K:.0f}", f"{c.rise_K:.0f}",
         f"{c.rmse_K / c.rise_K:.0%}"]
        for c in shipped_evidence().cases
    ]  # fmt: skip
    return markdown_table(heads, rows)


def _region() -> str:
    """Conditions that each data set covers, by range of Mach numbers."""
    heads = ["data set", "Mach", "alpha, deg", "log10 Re", "wall, K", "RMSE there, K"]
    rows = [
        [f"`{c.name}`", *(_ends(b.limits.get(n), form) for n, form in RANGES), f"{b.rmse_K:.0f}"]
        for c in shipped_evidence().cases
        for b in c.bands
    ]
    return markdown_table(heads, rows)


def _ends(ends: tuple[float, float] | None, form: str) -> str:
    return "" if ends is None else f"{ends[0]:{form}} to {ends[1]:{form}}"


if __name__ == "__main__":
    main()
