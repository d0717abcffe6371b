"""Calibration of findings, from the finished records of closure_challenge.py.

    python -m benchmarks.closure_calibration            # figures and reliability
    python -m benchmarks.closure_calibration --write    # and the calibration that close-loop states, and the diagram

Adequacy: the statistics of records that lack nothing, as declared, are those of true models. Probability: its form is
that of sim_heating/closure/verdict/calibration.py; b maximises the likelihood with a normal prior of PRIOR_SIGMA on all
but the constant. Reliability is judged on groups (a class, a flight, a wall, a random half) with b of all the others.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import click
import numpy as np
from numpy.typing import NDArray

from benchmarks.closure_challenge import finished, is_right, is_statement, reliability, verdict
from benchmarks.measure import RESULTS, save
from sim_heating.base.files import read_json, write_json
from sim_heating.base.report.figure import new_figure, save_figure
from sim_heating.closure.verdict.adequacy import p_value
from sim_heating.closure.verdict.calibration import CALIBRATION, FEATURES, logistic, probability_by, true_statistics
from sim_heating.closure.verdict.calibration import features as features_of

FloatArray = NDArray[np.float64]
Row = Mapping[str, Any]

COMMAND = "python -m benchmarks.closure_calibration --write"
GROUPS = ("class", "flight", "wall", "half")
PRIOR_SIGMA = 3.0
LEAST_TRUE = 100
"""Fewest records that lack nothing from which the distribution of the statistic is taken."""
DIAGRAM = RESULTS.parents[1] / "docs" / "images" / "closure_reliability.png"


def features(row: Row) -> FloatArray:
    """(feature,) of a finding."""
    return features_of(
        row["finding"],
        row.get("rival") or 0.0,
        row["p_value"],
        row.get("explained") or 0.0,
        len(row["alternatives"]),
        row.get("disqualified", 0.0),
        row.get("no_effect", False),
    )


def statistics_of_truth(rows: Sequence[Row]) -> FloatArray:
    """(record,) statistics of the adequacy of true models, ascending: those of records that lack nothing, as declared;
    those that the package has where there are fewer than LEAST_TRUE."""
    found = [row["none_statistic"] for row in rows if row["class"] == "null" and "none_statistic" in row]
    return np.sort(np.array(found, dtype=float)) if len(found) >= LEAST_TRUE else true_statistics()


def with_p_values(rows: Sequence[Row], known: FloatArray) -> list[dict[str, Any]]:
    """The rows with p-values by these statistics of true models."""
    return [dict(r) | ({"p_value": p_value(r["statistic"], known)} if r["p_value"] is not None else {}) for r in rows]


def fitted(rows: Sequence[Row]) -> FloatArray:
    """(feature,) coefficients of the most probable logistic model, by Newton's method."""
    F, y = np.array([features(r) for r in rows]), np.array([is_right(r) for r in rows], dtype=float)
    precision = np.diag([1e-6] + [PRIOR_SIGMA**-2] * (len(FEATURES) - 1))
    b = np.zeros(len(FEATURES))
    for _ in range(100):
        mean = logistic(F @ b)
        hessian = F.T @ (F * (mean * (1.0 - mean))[:, np.newaxis]) + precision
        step = np.linalg.solve(hessian, F.T @ (y - mean) - precision @ b)
        b += step * min(1.0, 2.0 / max(float(np.max(np.abs(step))), 1e-12))
        if np.max(np.abs(step)) < 1e-8:
            break
    return b


def probability(b: FloatArray, row: Row) -> float:
    """That a finding is right."""
    return probability_by(features(row), b)


def splits(rows: Sequence[Row], by: str) -> Iterator[tuple[list[Row], list[Row]]]:
    """Rows to fit with, and rows to judge: one group at a time is left out."""
    names = [str(i % 2) if by == "half" else str(r[by]) for i, r in enumerate(rows)]
    for name in sorted(set(names)):
        inside = [r for r, n in zip(rows, names, strict=True) if n == name]
        outside = [r for r, n in zip(rows, names, strict=True) if n != name]
        if outside:
            yield outside, inside


def left_out(rows: Sequence[Row], by: str) -> list[dict[str, Any]]:
    """The rows with probabilities from groups other than their own."""
    found = []
    for others, own in splits(rows, by):
        b = fitted(others)
        found += [dict(r) | {"probability": probability(b, r)} for r in own]
    return found


def draw(tables: Mapping[str, Sequence[Mapping[str, Any]]], path: Path) -> None:
    """The reliability diagram: share of right findings against the probability stated, for each way to leave out."""
    figure, axes = new_figure(11.0, 3.4, 1, len(GROUPS), sharey=True)
    for a, by in zip(axes.flat, GROUPS, strict=True):
        a.plot([0.0, 1.0], [0.0, 1.0], color="0.6", linewidth=1.0)
        for part in tables[by]:
            low, high = part["limits"]
            a.plot([part["mean"]] * 2, [low, high], color="tab:blue", linewidth=1.2)
            a.plot(part["mean"], part["right"], "o", color="tab:blue", markersize=4.0)
            a.annotate(str(part["n"]), (part["mean"], low), textcoords="offset points", xytext=(3, -2), fontsize=7)
        a.set_title(f"left out: {'random halves' if by == 'half' else f'one {by}'}", fontsize=9)
        a.set_xlabel("probability stated")
        a.set_xlim(0.0, 1.02)
        a.set_ylim(0.0, 1.02)
    axes.flat[0].set_ylabel("share of findings that are right")
    save_figure(figure, path, "Probability of a finding, fitted to the other groups, and how often it is right", axes)


@click.command(help="Reliability of probabilities on groups that they were not fitted to.")
@click.option("--write", is_flag=True, help="the calibration that close-loop states")
def main(write: bool) -> None:
    """Print and save."""
    everything = [r for r in finished() if r["finding"] != "refused"]
    if not everything:
        raise click.ClickException("no finished records; run python -m benchmarks.closure_challenge first")
    known = statistics_of_truth(everything)
    rows = [r for r in with_p_values(everything, known) if is_statement(r)]
    b = fitted(rows)
    click.echo(f"true models: {len(known)}; findings: {len(rows)}, right {sum(map(is_right, rows))}")
    click.echo("  ".join(f"{name} {value:.3g}" for name, value in zip(FEATURES, b, strict=True)))
    tables = {by: reliability(left_out(rows, by)) for by in GROUPS}
    for by, bins in tables.items():
        click.echo(f"\nleft out: {by}")
        for part in bins:
            low, high = part["limits"]
            click.echo(
                f"{part['from']:.2f} to {part['to']:.2f}  stated {part['mean']:.3f}  right {part['right']:.3f} "
                f"of {part['n']}  95% limits {low:.3f} to {high:.3f}"
            )
    save("closure_calibration", [], {"features": FEATURES, "coefficients": b.tolist(), "reliability": tables})
    if write:
        draw(tables, DIAGRAM)
        nulls = [r for r in everything if r["class"] == "null"]
        named = sum(verdict(r) != "right" for r in nulls)
        found = {"named": named, "records": len(nulls), "true_statistics": known.tolist(),
                 "features": FEATURES, "coefficients": b.tolist()}  # fmt: skip
        write_json(CALIBRATION, read_json(CALIBRATION) | found | {"source": COMMAND})


if __name__ == "__main__":
    main()
