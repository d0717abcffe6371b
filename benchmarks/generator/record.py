"""One record from a seed: the case, the effect, the measurement, the files and the answer."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.challenge.deviation import NOTHING, Deviation
from benchmarks.challenge.form import Drawn, Unsuitable, draw
from benchmarks.challenge.point import DERIVATIVES, VARIABLES
from benchmarks.challenge.recorder import Recorder, floor_K, measure, used, within
from benchmarks.generator.case import FORMATS, Case, draw_case
from benchmarks.generator.families import FAMILIES
from benchmarks.generator.measure import add_words, draw_recorder, draw_segments, unit_noise
from benchmarks.generator.point import KINDS
from benchmarks.generator.rivals import accepted, rivals
from benchmarks.generator.visibility import Bench, Seen, bench, see
from sim_heating.base.files import output_directory, toml_text, write_csv, write_text_atomic

FloatArray = NDArray[np.float64]
Generator = np.random.Generator

ATTEMPTS = 60
"""Draws of flight, wall and form before a seed is given up."""

LIMITS = (2.0, 80.0)
"""Range of the residual over the noise floor, where the effect acts."""


@dataclass(frozen=True)
class Made:
    """A record in memory.

    indicated_K, measured_K : (sample, sensor) true readings before noise, and those of the file
    fit, holdout            : (sample,) masks
    """

    name: str
    case: Case
    effect: Drawn
    deviation: Deviation
    recorder: Recorder
    segments: dict[str, list[list[float]]] | None
    indicated_K: FloatArray
    measured_K: FloatArray
    seen: Seen | None
    answer: dict[str, Any]


def make(seed: int, number: int, effect: str) -> Made:
    """Record `number` of a seed with an effect of this name ("none" for none)."""
    for attempt in range(ATTEMPTS):
        try:
            made = _attempt(np.random.default_rng([seed, number, attempt]), f"g{number:04d}", effect)
        except Unsuitable:
            continue
        if made is not None:
            return made
    raise RuntimeError(f"seed {seed}, record {number}, {effect}: nothing visible in {ATTEMPTS} draws")


def _attempt(rng: Generator, name: str, effect: str) -> Made | None:
    """A record, or None where this draw cannot show its effect within physical bounds."""
    family = FAMILIES[effect]
    kind = str(rng.choice(family.points or KINDS))
    sensors = int(rng.integers(family.least_sensors, 6))
    case = draw_case(rng, kind, sensors, family.needs)
    if np.min(case.ratio(NOTHING, case.point.ratio.scale, case.point.ratio.d)) <= 0.0:
        return None
    recorder = draw_recorder(rng, float(case.time_s[-1]))
    segments = draw_segments(rng, float(case.time_s[-1]), case.flight.manoeuvres)
    t = recorder.time_s
    holdout = within(t, segments["holdout"]) if segments else np.zeros(len(t), dtype=bool)
    fit = (within(t, segments["fit"]) if segments else np.ones(len(t), dtype=bool)) & ~holdout
    plain = case.indicated(t)
    add_words(rng, case.point.sensors, np.max(plain, axis=0) + 40.0)
    _hold_back(rng, case.point.sensors)
    drawn = draw(rng, family, case)
    deviation, seen, indicated = NOTHING, None, plain
    left: dict[str, float] = {}
    if effect != "none":
        on = bench(case, t, fit)
        found = _made_visible(rng, on, drawn)
        if found is None:
            return None
        drawn, seen = found
        deviation, left = drawn.deviation(case), rivals(rng, on, effect, seen)
        indicated = case.indicated(t, deviation)
    measured = measure(rng, recorder, case.point.sensors, indicated, unit_noise)
    if np.nanmax(indicated) > 1850.0 or any(np.isnan(measured[fit, i]).all() for i in range(measured.shape[1])):
        return None
    made = Made(name, case, drawn, deviation, recorder, segments, indicated, measured, seen, {})
    made.answer.update(_answer(made, fit, holdout) | _judged(effect, left))
    return made


def _hold_back(rng: Generator, sensors: Sequence[dict[str, Any]]) -> None:
    """One in-depth sensor of four or five may be excluded from the fit."""
    if len(sensors) > 3 and rng.random() < 0.25:
        sensors[int(rng.integers(1, len(sensors) - 1))]["used"] = False


def _made_visible(rng: Generator, on: Bench, drawn: Drawn) -> tuple[Drawn, Seen] | None:
    """The effect with its magnitude changed until its residual is near a drawn multiple of the noise floor."""
    target = float(np.exp(rng.uniform(*np.log(drawn.family.residual))))
    ratio = on.case.point.ratio
    for _ in range(6):
        deviation = drawn.deviation(on.case)
        if np.min(on.case.ratio(deviation, ratio.scale, ratio.d)) < 0.02 * on.case.r_0:
            drawn = drawn.scaled(0.5)
            continue
        seen = see(on, deviation)
        over = seen.residual_over_floor
        if LIMITS[0] <= over <= LIMITS[1] and 0.7 < over / target < 1.5:
            return drawn, seen
        changed = drawn.scaled(float(np.clip(target / max(over, 1e-3), 0.25, 4.0)))
        if changed.parameters == drawn.parameters:
            return (drawn, seen) if LIMITS[0] <= over <= LIMITS[1] else None
        drawn = changed
    return None


def _judged(effect: str, left: dict[str, float]) -> dict[str, Any]:
    names = accepted(effect, left)
    return {"accepted": names, "separable": names == [effect], "rivals": left}


def _answer(made: Made, fit: NDArray[np.bool_], holdout: NDArray[np.bool_]) -> dict[str, Any]:
    """The entry of a record in answers.toml."""
    case, ratio = made.case, made.case.point.ratio
    fitted = used(case.point.sensors)
    declared = case.indicated(made.recorder.time_s, scale=0.0, d=np.zeros(5))
    errors = {"scale": ratio.scale} | dict(zip(DERIVATIVES, ratio.d.tolist(), strict=True))
    reference = dict(zip(VARIABLES, ratio.reference.tolist(), strict=True))
    residual = made.measured_K - made.indicated_K

    def rmse(error: FloatArray) -> dict[str, float]:
        parts = {"fit": error[fit][:, fitted], "holdout": error[holdout][:, fitted]}
        return {k: round(float(np.sqrt(np.nanmean(v**2))), 4) for k, v in parts.items() if np.isfinite(v).any()}

    n = [int(np.isfinite(made.measured_K[fit, i]).sum()) for i in fitted]
    floors = [floor_K(case.point.sensors[i]) for i in fitted]
    answer: dict[str, Any] = {
        "effect": made.effect.family.name,
        "form": made.effect.form,
        "parameters": made.effect.parameters,
        "control_point": case.point.name,
        "kind": case.point.kind,
        "manoeuvres": [[k, start, end] for k, start, end in case.flight.manoeuvres],
        "true_errors": errors,
        "reference_condition": reference,
        "r_table_mean": float(f"{case.r_0:.6g}"),
        "noise_floor_K": round(float(np.sqrt(np.average(np.square(floors), weights=n))), 4),
        "noise_colour": [made.recorder.colour, made.recorder.colour_s],
        "sensors": [s["name"] for s in case.point.sensors],
        "used": [s["used"] for s in case.point.sensors],
        "predicted_rmse_K": rmse(made.measured_K - declared),
        "true_rmse_K": rmse(residual),
    }
    if made.seen is not None:
        answer |= {
            "visibility_K": round(made.seen.visibility_K, 4),
            "residual_rmse_K": round(made.seen.residual_K, 4),
            "residual_over_floor": round(made.seen.residual_over_floor, 3),
        }
    return answer


def write(made: Made, out: Path) -> None:
    """Write the record as a directory of its name in `out`."""
    case, sensors = made.case, made.case.point.sensors
    readings = {s["column"]: made.measured_K[:, i] for i, s in enumerate(sensors)}
    named = case.heating["reference"]
    with output_directory(out / made.name, "generator") as folder:
        write_text_atomic(folder / "record.toml", toml_text(declaration(made)))
        write_csv(folder / "conditions.csv", case.recorded, FORMATS)
        formats = {"time_s": ".1f"} | dict.fromkeys(readings, ".3f")
        write_csv(folder / "thermocouples.csv", {"time_s": made.recorder.time_s} | readings, formats)
        header = {"source": "random"} | ({} if named == "columns" else {"reference": named})
        write_csv(folder / "ratio_table.csv", case.point.ratio.columns, ".10g", header)


def declaration(made: Made) -> dict[str, Any]:
    """record.toml of a record."""
    point = made.case.point
    declared: dict[str, Any] = {
        "format": "flight-record/1",
        "title": f"Random entry over {point.name}, {made.name}",
        "vehicle": "random",
        "control_point": point.name,
        "measured": False,
        "conditions": {"file": "conditions.csv"},
        "thermocouples": {"file": "thermocouples.csv", "sensor": point.sensors},
        "stack": point.stack,
        "materials": point.materials,
        "heating": made.case.heating,
    }
    return declared | ({"segments": made.segments} if made.segments else {})


def make_and_write(task: tuple[int, int, str, Path]) -> tuple[str, dict[str, Any], float]:
    """Seed, number, effect and place of a record to its name, its answer and the time it took [s]."""
    seed, number, effect, out = task
    start = time.perf_counter()
    made = make(seed, number, effect)
    write(made, out)
    return made.name, made.answer, time.perf_counter() - start
