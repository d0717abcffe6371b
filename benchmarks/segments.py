"""Bounds of consecutive segments over repetitions: after lost readings, after a gap, and from an explicit start.

Each repetition flies a practice flight with another history of the heating ratio: the table's times a factor that is
random every minute where nothing is measured, and constant where something is. The readings have their noise and words.
The error of each segment's ratio over its sigma is counted, and chi-square of all segments with their covariance.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from multiprocessing import get_context

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from benchmarks.measure import Figure, save
from sim_heating.estimation.record_fit import StartMaker
from sim_heating.estimation.starts import STARTS
from sim_heating.estimation.trend import Trend, trend
from sim_heating.inputs.record import Record, load_record
from sim_heating.inputs.sensor_model import measure
from sim_heating.simulation.predict import predict
from tests.support.tile import PRACTICE

FloatArray = NDArray[np.float64]

REPETITIONS, BATCH, PROCESSES = 200, 25, 2
LENGTH_S = 20.0
MEASURED_S = ((450.0, 550.0), (610.0, 710.0))
"""Times that are measured [s]; the factor on the ratio is constant over each."""
AFTER_S = MEASURED_S[-1][1] + LENGTH_S
LEAST_COVERAGE = 0.92
"""0.95 less two standard errors of REPETITIONS; bounds are wider than they need be where nothing was measured."""
SPREAD = 0.5
"""Standard deviation of the logarithm of the factor on the ratio [-] where nothing is measured."""
MEASURED = (0.5, 1.6)
"""Range of the factor where something is measured [-]: more is beyond the range of the recorder's word."""
EVERY_S = 60.0
"""Time between the random values of the factor where nothing is measured [s]."""
CASES: dict[str, StartMaker | None] = {
    "record begins late": None,
    "profile start": partial(STARTS["profile"], time_s=MEASURED_S[0][0]),
    "circuit start": partial(STARTS["circuit"], time_s=MEASURED_S[0][0]),
    "filter start": partial(STARTS["filter"], time_s=MEASURED_S[0][0]),
}
"""First start by case; readings before it are lost in the first case alone."""


@cache
def practice_flight() -> Record:
    """The practice flight whose conditions, wall and sensors all repetitions have."""
    record = load_record(PRACTICE / "p06").with_fit([list(span) for span in MEASURED_S])
    # what comes after the last segment costs time and changes nothing
    flown, kept = record.conditions, record.time_s <= MEASURED_S[-1][1]
    columns = {name: column[kept] for name, column in record.thermocouples.items()}
    return replace(record, conditions=flown.at(flown.time_s[flown.time_s <= AFTER_S]), thermocouples=columns)


def true_factor(time_s: FloatArray, rng: np.random.Generator, lost: bool) -> FloatArray:
    """(time,) factor on the ratio [-]: constant over what is measured, random every minute elsewhere.

    lost : whether nothing was measured before the first segments; else the factor is 1 until then
    """
    times, values = [], []
    for t in np.arange(0.0, time_s[-1], EVERY_S):
        if not any(a - EVERY_S < t < b + EVERY_S for a, b in MEASURED_S):
            times.append(t)
            values.append(rng.normal(0.0, SPREAD) if lost else 0.0)
    for span in MEASURED_S:
        times += list(span)
        values += 2 * [np.log(rng.uniform(*MEASURED))]
    times.append(0.5 * (MEASURED_S[0][1] + MEASURED_S[1][0]))
    values.append(rng.normal(0.0, SPREAD))
    order = np.argsort(times)
    return np.exp(np.interp(time_s, np.array(times)[order], np.array(values)[order]))


def flown(rng: np.random.Generator, lost: bool) -> tuple[Record, FloatArray, FloatArray]:
    """A record of one repetition, and the times [s] and heating ratio [-] of its flight."""
    record = practice_flight()
    conditions, t = record.conditions, record.time_s
    factor = true_factor(conditions.time_s, rng, lost)
    heated = conditions.with_columns(h_ref_kg_m2_s=conditions["h_ref_kg_m2_s"] * factor)
    true = predict(replace(record, conditions=heated)).history
    kept = t >= (MEASURED_S[0][0] if lost else 0.0)
    columns = {
        s.column: np.where(kept, measure(s, T, rng), np.nan)
        for s, T in zip(record.sensors, true.sensors_K, strict=True)
    }
    return replace(record, thermocouples={"time_s": t, **columns}), conditions.time_s, factor


@dataclass(frozen=True)
class Repetitions:
    """Errors of all repetitions of a case.

    over_sigma : (repetition, segment) error of the ratio over its sigma
    sigma      : (repetition, segment) over the ratio
    p_value    : (repetition,) of chi-square of all segments with their covariance
    """

    over_sigma: FloatArray
    sigma: FloatArray
    p_value: FloatArray


def errors(found: Trend, time_s: FloatArray, factor: FloatArray) -> FloatArray:
    """(segment,) ratio found less that flown: the declared one times the factor."""
    true = [s.declared * float(np.interp(0.5 * (s.start_s + s.end_s), time_s, factor)) for s in found.segments]
    return np.array([s.ratio for s in found.segments]) - true


def repeat(case: str, seeds: Sequence[Sequence[int]]) -> Repetitions:
    """Fly, measure and fit once for each seed."""
    rows = []
    for seed in seeds:
        record, time_s, factor = flown(np.random.default_rng(seed), lost=CASES[case] is None)
        found = trend(record, LENGTH_S, start=CASES[case])
        if found.left_out:
            raise RuntimeError(f"seed {seed}: {found.left_out[0]}")
        error = errors(found, time_s, factor)
        sigma = np.array([s.sigma for s in found.segments])
        square = float(error @ np.linalg.solve(found.covariance, error))
        rows.append((error / sigma, sigma / [s.ratio for s in found.segments], chi2.sf(square, len(error))))
    return Repetitions(*(np.array(column) for column in zip(*rows, strict=True)))


def _batch(task: tuple[str, int]) -> tuple[str, Repetitions]:
    case, number = task
    return case, repeat(case, [(list(CASES).index(case), k) for k in range(number * BATCH, (number + 1) * BATCH)])


def run() -> list[Figure]:
    """Repeat all cases in two processes."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # for the processes to come, which share two cores
    tasks = [(case, k) for case in CASES for k in range(REPETITIONS // BATCH)]
    found: dict[str, list[Repetitions]] = {case: [] for case in CASES}
    with get_context("spawn").Pool(PROCESSES) as pool:
        for case, part in pool.imap_unordered(_batch, tasks):
            found[case].append(part)
    figures: list[Figure] = []
    for case, parts in found.items():
        figures += figures_of(
            case,
            Repetitions(*(np.concatenate([getattr(p, f) for p in parts]) for f in Repetitions.__dataclass_fields__)),
        )
    save("segments", figures)
    return figures


def figures_of(case: str, found: Repetitions) -> list[Figure]:
    """Coverage of the first segment, of the first after the gap, of all, and of all jointly."""
    places = np.arange(found.over_sigma.shape[1])
    after_gap = len(places) // 2
    columns = {
        "first segment": places[:1],
        "first segment after the gap": places[after_gap : after_gap + 1],
        "all segments": places,
    }
    figures = []
    for what, k in columns.items():
        off = found.over_sigma[:, k]
        covered = float(np.mean(np.abs(off) < 1.96))
        rms, percent = np.sqrt(np.mean(off**2)), 100.0 * np.median(found.sigma[:, k])
        note = f"{off.size} ratios; RMS error {rms:.2f} sigma; sigma {percent:.2g} % of the ratio"
        at = f"{case}, {what}: coverage of 95% bounds"
        figures.append(Figure(at, covered, "", LEAST_COVERAGE, at_least=True, note=note))
    odd = float(np.mean(found.p_value < 0.05))
    note = f"{len(found.p_value)} repetitions"
    figures.append(Figure(f"{case}: chi-square of all segments jointly with p < 0.05", odd, "", 0.1, note=note))
    return figures
