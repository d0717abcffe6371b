"""Probability that a finding is right, from the rows of closure_challenge.py, judged on groups that it did not see.

    python -m benchmarks.closure_calibration        # of the finished records

    P(right) = 1 / (1 + exp(-b . f)),   f = 1, log(1 + rival), log10 p, explained, set, none

rival is the score of the next hypothesis over that of the finding, p the p-value of the adequacy. b maximises the
likelihood with a normal prior of PRIOR_SIGMA on all but the constant. Probabilities of a group (a class, a flight, a
wall, or a random half) come from b of all the others. Source of the form: logistic regression, Cox (1958).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import click
import numpy as np
from numpy.typing import NDArray

from benchmarks.closure_challenge import finished, is_right, is_statement, reliability
from benchmarks.measure import save

FloatArray = NDArray[np.float64]
Row = Mapping[str, Any]

FEATURES = ("constant", "log(1 + rival)", "log10 p", "explained", "set", "none")
GROUPS = ("class", "flight", "wall", "half")
PRIOR_SIGMA = 3.0
LEAST_P = 1e-6
"""Smaller p-values tell no more."""


def features(row: Row) -> FloatArray:
    """(feature,) of a finding."""
    p = 1.0 if row["p_value"] is None else max(float(row["p_value"]), LEAST_P)
    rival = min(max(float(row.get("rival") or 0.0), 0.0), 1e6)
    explained = float(np.clip(row.get("explained") or 0.0, 0.0, 1.0))
    return np.array(
        [1.0, np.log1p(rival), np.log10(p), explained, row["finding"] == "one of", row["finding"] == "none"],
        dtype=float,
    )


def fitted(rows: Sequence[Row]) -> FloatArray:
    """(feature,) coefficients of the most probable logistic model, by Newton's method."""
    F, y = np.array([features(r) for r in rows]), np.array([is_right(r) for r in rows], dtype=float)
    precision = np.diag([1e-6] + [PRIOR_SIGMA**-2] * (len(FEATURES) - 1))
    b = np.zeros(len(FEATURES))
    for _ in range(100):
        mean = _logistic(F @ b)
        hessian = F.T @ (F * (mean * (1.0 - mean))[:, np.newaxis]) + precision
        step = np.linalg.solve(hessian, F.T @ (y - mean) - precision @ b)
        b += step * min(1.0, 2.0 / max(float(np.max(np.abs(step))), 1e-12))
        if np.max(np.abs(step)) < 1e-8:
            break
    return b


def probability(b: FloatArray, row: Row) -> float:
    """That a finding is right."""
    return float(_logistic(features(row) @ b))


def _logistic(x: Any) -> Any:
    return 1.0 / (1.0 + np.exp(-np.clip(x, -40.0, 40.0)))


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


@click.command(help="Reliability of probabilities on groups that they were not fitted to.")
def main() -> None:
    """Print and save."""
    rows = [r for r in finished() if is_statement(r)]
    if not rows:
        raise click.ClickException("no finished records; run python -m benchmarks.closure_challenge first")
    b = fitted(rows)
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


if __name__ == "__main__":
    main()
