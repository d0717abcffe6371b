"""Default parameters of a fit: those that are kept hold their bounds, and those that are left out say next to nothing.

Every manoeuvre of the scenarios of `end_to_end`, with its altered truths, is fitted with the default parameters, and
again with those that were left out because of the excursion or of the table's nodes. An error is the estimate less the
projected truth, over its sigma. What a derivative contributes is the RMS that it moves the predicted temperatures by,
about their mean, of the sensor that it moves most.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks import end_to_end
from benchmarks.measure import Figure, save
from sim_heating.estimation.fit import DEFAULT, FitResult, estimate
from sim_heating.estimation.report.report import noise_floor_K
from sim_heating.inputs.record import load_record
from sim_heating.simulation.synthesize import write_records

UNSUPPORTED = "name it to estimate it all the same"
"""End of the reason for a derivative that is left out by default and may be named."""


@dataclass(frozen=True)
class Fits:
    """A manoeuvre fitted with the default parameters, and with those left out as well.

    kept, left_out : errors over sigma of the derivatives, of the first fit and of the second
    moves    : what each that was left out contributes, over the noise floor [-]
    values   : of those, over their sigma
    rmse     : of the first fit over the second
    """

    scenario: str
    point: str
    truth: str
    start_s: float
    kept: dict[str, float]
    left_out: dict[str, float]
    moves: dict[str, float]
    values: dict[str, float]
    rmse: float


def run() -> list[Figure]:
    """Fly, fit twice, and compare."""
    with tempfile.TemporaryDirectory() as folder:
        fits = [f for name in end_to_end.POINTS for f in _of_scenario(name, Path(folder))]
    figures = [f for truth in ("linear", "table") for f in _figures(truth, [f for f in fits if f.truth == truth])]
    save("default_parameters", figures, {"fits": [vars(f) for f in fits]})
    return figures


def _figures(truth: str, fits: list[Fits]) -> Iterator[Figure]:
    kept, left_out, moves, values = (
        np.abs([v for f in fits for v in getattr(f, what).values()]) for what in ("kept", "left_out", "moves", "values")
    )
    within = end_to_end.WITHIN_SIGMAS
    yield Figure(f"{truth} truth: kept, errors within 2 sigma of {len(kept)}", float(np.mean(kept <= within)), "")
    yield Figure(
        f"{truth} truth: left out, errors within 2 sigma of {len(left_out)}", float(np.mean(left_out <= within)), ""
    )
    worst = f"largest {max(moves):.2f}"
    yield Figure(f"{truth} truth: left out, contribution (median)", float(np.median(moves)), "floors", note=worst)
    yield Figure(f"{truth} truth: left out, more than 2 sigma from 0", float(np.mean(values > within)), "")
    ratio = [f.rmse for f in fits]
    yield Figure(f"{truth} truth: RMSE without them over with (median)", float(np.median(ratio)), "",
                 note=f"worst {max(ratio):.2f}")  # fmt: skip


def _of_scenario(name: str, folder: Path) -> Iterator[Fits]:
    scenario, flight = end_to_end._flown(name)
    for truth in ("linear", "table"):
        write_records(scenario, end_to_end._measured(scenario, flight, truth), folder / truth / name)
        for point in end_to_end.POINTS[name]:
            if (name, point) in end_to_end.UNDECLARED:
                continue
            control_point = scenario.vehicle.control_point(point)
            for window in flight.windows:
                record, start = end_to_end._cut(load_record(folder / truth / name / point), window, "manoeuvre")
                first = estimate([record], starts=[start])
                unsupported = [n for n, why in first.not_estimated.items() if UNSUPPORTED in why]
                second = estimate([record], [DEFAULT, *unsupported], starts=[start]) if unsupported else first
                if not (first.fit.converged and second.fit.converged):
                    continue
                errors = [end_to_end._errors(f, record, control_point, flight, truth) for f in (first, second)]
                estimated = [n for n in unsupported if n in second.labels]
                rmse = [_rmse_K(f) for f in (first, second)]
                yield Fits(
                    name, point, truth, window.start_s,
                    {n: e for n, e in errors[0].items() if n.startswith("ratio.d_")},
                    {n: errors[1][n] for n in estimated},
                    {n: _contribution_K(second, n) / (noise_floor_K(second) or np.nan) for n in estimated},
                    {n: value / sigma for n in estimated for value, sigma in [second.parameters[n]]},
                    rmse[0] / rmse[1],
                )  # fmt: skip


def _rmse_K(fit: FitResult) -> float:
    errors = fit.after[0].segment_errors()["fit"]
    return float("nan") if errors is None else float(errors["rmse_K"])


def _contribution_K(fit: FitResult, name: str) -> float:
    k = fit.labels.index(name)
    moved = [fit.fit.values[k] * s.jacobian[:, k] for s in fit.samples()]
    return max(float(np.std(m)) for m in moved)
