"""One record from seed, class and number: the flight, the truth, the measurement, the files and the answer."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.challenge import faults
from benchmarks.challenge import recorder as recording
from benchmarks.challenge.case import FINE_S, FORMATS, Case, make_case
from benchmarks.challenge.deviation import NOTHING
from benchmarks.challenge.files import toml_text, write_csv
from benchmarks.challenge.flight import draw_flight
from benchmarks.challenge.form import VISIBLE, Drawn, Family, Unsuitable, draw
from benchmarks.challenge.judge import Bench, accepted, count, finished, log_evidence, over_floor
from benchmarks.challenge.lacking import LACKING
from benchmarks.challenge.on_ratio import ON_RATIO
from benchmarks.challenge.on_wall import ON_WALL
from benchmarks.challenge.point import DERIVATIVES, OWN, POINTS, VARIABLES, draw_point, draw_ratio
from benchmarks.challenge.recorder import Recorder, floor_K, used, within
from benchmarks.challenge.world import World, draw_world

FloatArray = NDArray[np.float64]
Generator = np.random.Generator

EFFECTS: tuple[Family, ...] = (*ON_RATIO, *ON_WALL)
FAULTS = faults.FAULTS | LACKING
"""What no name of an effect covers, by class of record."""
CLASSES = {
    "one": 240,
    "two": 60,
    "three": 20,
    "null": 120,
    "wall": 60,
    "flight": 50,
    "sensor": 60,
    "table": 20,
    "unknown": 30,
}
"""Classes of records whose model is exact but for the deviation, and how many of each there are in the whole set."""
IMPERFECT = {
    "error": 60,
    "null": 200,
    "one": 240,
    "two": 60,
    "three": 60,
    "rivals": 60,
    "wall": 60,
    "flight": 60,
    "sensor": 60,
    "recorder": 60,
    "table": 20,
    "unknown": 60,
    "lacking": 80,
}
"""The same of records whose model has errors besides (world.py)."""
CLASS_NAMES = (*CLASSES, *(name for name in IMPERFECT if name not in CLASSES))
WORLDS = {"exact": CLASSES, "imperfect": IMPERFECT}
RIVALS = (
    ("time-skew", "sensor-lag", "nonisothermal-wall"),
    ("coating-thickness", "heat-capacity", "emissivity", "conductivity"),
    ("transition", "impingement-onset", "catalysis"),
    ("alpha-curvature", "elevon-curvature", "bodyflap-curvature", "interaction"),
)
"""Effects that resemble each other: lags, what lies over the insulation and its properties, steps, curvatures. Of class
`rivals` a record has one of each of three."""
NULLS = ("white", "coloured", "jittered", "coarse", "table", "gaps")
NOTHING_TRUE = ("null", "error")
"""Classes of records with nothing in them."""
KINDS = ("wall", "flight", "sensor", "table")
"""Classes whose truth is reported as not an effect."""
ATTEMPTS = 80
LEAST = 1.9
"""Below it a deviation of the usual size is drawn again."""
SMALL, SMALL_CHI2 = 0.12, (15.0, 80.0)
"""Share of the records whose deviation is small, and its chi-square."""
IMPERFECT_CHI2 = (16.0, 500.0)
"""Chi-square of a deviation over the true noise, where the model has errors besides."""
PHASES = 5
"""Places of its knots over which the covariance of a heating's error is averaged, where these are not known."""
LEAST_EVIDENCE = 5.0
"""Least log evidence of each of several deviations, where the model has errors besides."""
SEEN_CHI2 = 300.0
"""Least chi-square of an error in a derivative of the table, after a refit of the scale alone."""
TABLE_SIGMA = 0.03
"""Sigma of the table over the ratio, where its derivatives are off by several of them."""


@dataclass(frozen=True)
class Made:
    """A record in memory.

    indicated_K, measured_K : (sample, sensor) readings without noise and word, and those of the file
    fit, holdout            : (sample,) masks
    """

    name: str
    case: Case
    drawn: tuple[Drawn, ...]
    recorder: Recorder
    segments: dict[str, list[list[float]]] | None
    indicated_K: FloatArray
    measured_K: FloatArray
    fit: NDArray[np.bool_]
    holdout: NDArray[np.bool_]
    answer: dict[str, Any]
    world: World | None = None


def name_of(number: int, of_class: str, imperfect: bool) -> str:
    """Name of a record."""
    return f"{'imperfect-' if imperfect else ''}{of_class}-{number:03d}"


def make(seed: int, number: int, of_class: str, imperfect: bool = False) -> Made:
    """Record `number` of a class. It depends on these alone.

    imperfect : whether its model has errors besides what the class is about
    """
    families = _families(seed, number, of_class)
    for attempt in range(ATTEMPTS):
        rng = np.random.default_rng([seed, CLASS_NAMES.index(of_class), number, attempt, *([1] if imperfect else [])])
        try:
            made = _attempt(rng, name_of(number, of_class, imperfect), of_class, number, families, imperfect)
        except Unsuitable:
            continue
        if made is not None:
            return made
    raise RuntimeError(
        f"seed {seed}, {of_class} {number}, {[f.name for f in families]}: not visible in {ATTEMPTS} draws"
    )


def _families(seed: int, number: int, of_class: str) -> list[Family]:
    """The families of a record, all those of a class in turn; several are drawn from those not at odds."""
    rng = np.random.default_rng([seed, CLASS_NAMES.index(of_class), 10**6])
    if of_class in NOTHING_TRUE:
        return []
    pool = FAULTS.get(of_class, EFFECTS)
    first = pool[rng.permutation(len(pool))[number % len(pool)]]
    if of_class == "rivals":
        pool = tuple(f for f in pool if any(f.name in names for names in RIVALS))
        first = pool[rng.permutation(len(pool))[number % len(pool)]]
    wanted = {"two": 2, "three": 3, "rivals": 3}.get(of_class, 1)
    rng = np.random.default_rng([seed, CLASS_NAMES.index(of_class), 10**6, number])
    found = [first]
    for i in rng.permutation(len(pool)):
        shared = set.intersection(*({*(f.points or POINTS)} for f in [*found, pool[i]]))
        alike = of_class == "rivals" and any({pool[i].name, f.name} <= {*names} for f in found for names in RIVALS)
        if len(found) < wanted and pool[i] not in found and shared and not alike:
            found.append(pool[i])
    return found


def _attempt(
    rng: Generator, name: str, of_class: str, number: int, families: Sequence[Family], imperfect: bool
) -> Made | None:
    """A record, or None where this draw cannot show what it is about."""
    null = NULLS[number % len(NULLS)] if of_class == "null" else ""
    case = _draw_case(rng, of_class, null, families)
    end_s = float(case.recorded["time_s"][-1])
    recorder = recording.draw_recorder(rng, end_s, case.flight.manoeuvres)
    if null == "coloured" or (of_class == "one" and rng.random() < 0.08):
        recorder = recording.coloured(rng, recorder)
    if null == "jittered":
        recorder = recording.jittered(rng, recorder)
    if null == "gaps":
        recorder = replace(recorder, lost=0.05, gaps_s=[[0.0, round(0.45 * end_s, 1)], [0.7 * end_s, 0.72 * end_s]])
    segments = recording.draw_segments(rng, recorder, end_s, case.flight.manoeuvres)
    t = recorder.time_s
    holdout = within(t, segments["holdout"]) if segments else np.zeros(len(t), dtype=bool)
    fit = (within(t, segments["fit"]) if segments else np.ones(len(t), dtype=bool)) & ~holdout
    fit &= ~within(t, recorder.gaps_s)
    recording.draw_words(rng, case.point.sensors, np.max(case.at(1.0).indicated(t), axis=0))
    if null == "coarse":
        for sensor in case.point.sensors:
            sensor["range_K"] = [255.0, 2400.0 if sensor["range_K"][1] > 900.0 else 1200.0]
    bench, world = Bench(case, t, fit), None
    if imperfect:
        world = draw_world(rng, case, of_class, number)
        bench = replace(bench, unknown=world.unknown(bench))
    found = _draw_visible(rng, bench, families, imperfect)
    if found is None:
        return None
    bench, drawn, seen = found
    if world is not None and drawn:
        blind = replace(bench, unknown=world.unknown(bench, phases=PHASES))
        left_of_each = _remainders(blind, [blind.change([d]) for d in drawn])
        seen["log_evidence_unknown_times"] = [
            round(log_evidence(float(left @ left), count(d)), 1) for left, d in zip(left_of_each, drawn, strict=True)
        ]
    judged = _judged(rng, bench, drawn, of_class) if imperfect else {}
    deviation_of = [d.deviation for d in drawn]
    if world is not None:
        deviation_of.append(world.deviation)
        for i, calibration in world.polynomials.items():
            case.point.sensors[i]["calibration"] = calibration
        bench = replace(bench, case=world.recorded(bench.case))
    history = bench.case.at(FINE_S, true=True)
    deviation = sum((of(history) for of in deviation_of), NOTHING)
    indicated = history.indicated(recording.sample_times(rng, recorder), deviation)
    measured = finished(t, recording.measure(rng, recorder, case.point.sensors, indicated), deviation)
    if not np.all(np.isfinite(indicated)) or not np.isfinite(measured[fit]).any(axis=0).all():
        return None
    if of_class != "sensor" and np.any(indicated > [s["range_K"][1] for s in case.point.sensors]):
        return None
    made = Made(
        name,
        bench.case,
        tuple(drawn),
        recorder,
        segments,
        finished(t, indicated, deviation),
        measured,
        fit,
        holdout,
        {},
        world,
    )
    judged = judged or _judged(rng, bench, drawn, of_class)
    made.answer.update(_answer(made, of_class, null) | seen | judged)
    return made


def _draw_case(rng: Generator, of_class: str, null: str, families: Sequence[Family]) -> Case:
    """A flight with the manoeuvres that the families need, over a point that shows them."""
    needs = sorted({kind for family in families for kind in family.needs})
    shown = [p for p in POINTS if all(p in (f.points or POINTS) for f in families)]
    if not needs and rng.random() < 0.8:
        needs = [str(rng.choice(["popu", "bodyflap"]))]
    flight = draw_flight(rng, needs)
    point = draw_point(rng, str(rng.choice(shown)))
    every = int(rng.choice([2, 2, 2, 1]))
    cp = float(rng.choice([1004.5, 1004.5, 1010.0])) if rng.random() < 0.4 else None
    jets = "jets" in needs or any(kind == "jets" for kind, *_ in flight.manoeuvres) or bool(rng.random() < 0.3)
    share = TABLE_SIGMA if of_class == "table" else None
    case = make_case(flight, point, lambda x: draw_ratio(rng, point.name, x, null == "table", share), every, cp, jets)
    history = case.at(1.0)
    if np.min(history.true_ratio[history.hot]) <= 0.0 or np.max(history.temperatures()) > 1700.0:
        raise Unsuitable
    return case


def _draw_visible(
    rng: Generator, bench: Bench, families: Sequence[Family], imperfect: bool
) -> tuple[Bench, list[Drawn], dict[str, Any]] | None:
    """Deviations of the size drawn, each after a refit of scale and slopes and of the others' sizes."""
    drawn: list[Drawn] = []
    small = not imperfect and len(families) == 1 and bool(rng.random() < SMALL)
    for family in families:
        one = draw(rng, family, bench.case)
        bench = replace(bench, case=one.recorded(bench.case))
        if family.magnitude:
            sized = _sized(rng, bench, one, IMPERFECT_CHI2 if imperfect else SMALL_CHI2 if small else None)
            if sized is None:
                return None
            bench, one = sized
        drawn.append(one)
    if not families:
        return bench, drawn, {}
    changes = [bench.change([d]) for d in drawn]
    seen = []
    for i, left in enumerate(_remainders(bench, changes)):
        seen.append((over_floor(left), float(left @ left)))
        worth = log_evidence(seen[-1][1], count(drawn[i]))
        if len(families) > 1 and (worth < LEAST_EVIDENCE if imperfect else seen[-1][0] < LEAST):
            return None
        if families[i].is_slope and bench.beyond_scale(changes[i]) < (IMPERFECT_CHI2[0] if imperfect else SEEN_CHI2):
            return None
    return (
        bench,
        drawn,
        {
            "size": "small" if small and families[0].magnitude else "usual",
            "residual_over_floor": [round(over, 3) for over, _ in seen],
            "chi_square": [round(chi2, 1) for _, chi2 in seen],
            "log_evidence": [round(log_evidence(chi2, count(d)), 1) for (_, chi2), d in zip(seen, drawn, strict=True)],
        },
    )


def _remainders(bench: Bench, changes: Sequence[FloatArray]) -> list[FloatArray]:
    """(reading,) of each change after a refit of scale and slopes and of the others' sizes."""
    return [bench.remainder(c, *(o for o in changes if o is not c)) for c in changes]


def _sized(
    rng: Generator, bench: Bench, one: Drawn, chi_square: tuple[float, float] | None
) -> tuple[Bench, Drawn] | None:
    """A deviation with its magnitude changed until it is near a drawn visibility.

    chi_square : limits of its chi-square; None for VISIBLE
    """
    target = float(np.exp(rng.uniform(*np.log(VISIBLE if chi_square is None else chi_square))))
    flown = replace(bench.case, recorded=bench.case.flown)
    for _ in range(7):
        bench = replace(bench, case=one.recorded(flown))
        left = bench.remainder(bench.change([one]))
        got = over_floor(left) if chi_square is None else float(left @ left)
        if not np.isfinite(got):
            return None
        ratio = (target / max(got, 1e-3)) ** (1.0 if chi_square is None else 0.5)
        if 0.75 < ratio < 1.4:
            return bench, one
        changed = one.scaled(float(np.clip(ratio, 0.25, 4.0)))
        if changed.parameters == one.parameters:
            enough = LEAST if chi_square is None else chi_square[0]
            return (bench, one) if got >= enough and chi_square != SMALL_CHI2 else None
        one = changed
    return None


def _judged(rng: Generator, bench: Bench, drawn: Sequence[Drawn], of_class: str) -> dict[str, Any]:
    """The effects of the truth, and what cannot be distinguished from each by a linear estimate."""
    changes = [bench.change([d]) for d in drawn]
    truth = [] if of_class in FAULTS else [d.family.name for d in drawn]
    slots = []
    for i, d in enumerate(drawn):
        others = [c for j, c in enumerate(changes) if j != i]
        names = [x.family.name for x in drawn]
        near = accepted(rng, bench, changes[i], others, count(d), names, EFFECTS)
        own = [d.family.name, *filter(None, [d.family.same.get(d.form)])] if truth else list(d.family.effects)
        slots.append([*own, *(n for n in near if n not in own)])
    separable = bool(truth) and all(len(names) == 1 for names in slots)
    return {"effects": truth, "accepted": slots, "separable": separable}


def _answer(made: Made, of_class: str, null: str) -> dict[str, Any]:
    """The entry of a record in answers.toml, without the judgement of rivals."""
    case, ratio, sensors = made.case, made.case.ratio, made.case.point.sensors
    fitted = used(sensors)
    error = made.measured_K - made.indicated_K
    parts = {"fit": error[made.fit][:, fitted], "holdout": error[made.holdout][:, fitted]}
    n = [int(np.isfinite(made.measured_K[made.fit, i]).sum()) for i in fitted]
    floor = np.sqrt(np.average([floor_K(sensors[i]) ** 2 for i in fitted], weights=n))
    answer = {
        "class": of_class,
        "form": [f"{d.family.name}/{d.form}" for d in made.drawn] or [null or of_class],
        "flight": case.flight.name,
        "wall": case.point.name,
        "parameters": [d.parameters for d in made.drawn],
        "manoeuvres": [[kind, start, round(end, 1)] for kind, start, end in case.flight.manoeuvres],
        "true_errors": {"scale": ratio.scale} | dict(zip(DERIVATIVES, ratio.d.tolist(), strict=True)),
        "reference_condition": dict(zip(VARIABLES, ratio.reference.tolist(), strict=True)),
        "noise_floor_K": round(float(floor), 4),
        "noise": [made.recorder.colour, made.recorder.colour_s, made.recorder.jitter_s],
        "true_rmse_K": {
            k: round(float(np.sqrt(np.nanmean(v**2))), 4) for k, v in parts.items() if np.isfinite(v).any()
        },
    }
    if of_class in FAULTS:
        kind = made.drawn[0].family.kind or of_class
        answer |= ({"kind": kind} if kind in KINDS else {}) | {"what": made.drawn[0].family.name}
    answer["world"] = "exact" if made.world is None else "imperfect"
    if made.world is not None:
        answer["model_error"] = made.world.answer(case.at(FINE_S, true=True))
    answer["mean_ratio"] = round(case.r_0, 6)
    return answer


def write(made: Made, out: Path) -> None:
    """Write the record as a directory of its name in `out`."""
    case, sensors = made.case, made.case.point.sensors
    folder = out / made.name
    folder.mkdir(parents=True)
    (folder / "record.toml").write_text(toml_text(declaration(made)))
    write_csv(folder / "conditions.csv", case.recorded, FORMATS)
    readings = {s["column"]: made.measured_K[:, i] for i, s in enumerate(sensors)}
    formats = {"time_s": ".2f"} | dict.fromkeys(readings, ".3f")
    write_csv(folder / "thermocouples.csv", {"time_s": made.recorder.time_s} | readings, formats)
    head = "# source: the record's own, total recovery enthalpy\n"
    write_csv(folder / "ratio_table.csv", case.ratio.columns, {"sigma": ".4g"}, head)


def declaration(made: Made) -> dict[str, Any]:
    """record.toml of a record."""
    case, point = made.case, made.case.point
    enthalpy = "equilibrium-air" if case.cp_J_kgK is None else {"cp_J_kgK": case.cp_J_kgK}
    declared: dict[str, Any] = {
        "format": "flight-record/1",
        "title": f"Entry along {case.flight.name} over {point.name}, {made.name}",
        "vehicle": "none" if point.name in OWN else "orbiter",
        "control_point": point.name,
        "measured": False,
        "conditions": {"file": "conditions.csv"},
        "thermocouples": {"file": "thermocouples.csv", "sensor": point.sensors},
        "stack": point.stack,
        "materials": point.materials,
        "heating": {
            "reference": "columns",
            "nose_radius_m": 0.3048,
            "wall_enthalpy": enthalpy,
            "ratio_table": "ratio_table.csv",
        },
    }
    declared |= {"segments": made.segments} if made.segments else {}
    return declared if made.world is None else made.world.declare(declared, float(case.recorded["time_s"][-1]))


def whole_set(count: int, classes: Sequence[str] = tuple(CLASSES), world: str = "exact") -> list[tuple[str, int]]:
    """Classes and numbers of the first records of the set of a world, each class spread evenly over it."""
    sizes = WORLDS[world]
    spread = sorted((k / sizes[c], c, k) for c in classes for k in range(sizes[c]))
    more = count // len(spread) + 1
    return [(c, k + turn * sizes[c]) for turn in range(more) for _, c, k in spread][:count]


def make_and_write(task: tuple[int, int, str, Path, bool]) -> tuple[str, dict[str, Any], float]:
    """Seed, number, class and place of a record, and whether its model has errors, to its name, its answer and the time
    it took [s]."""
    seed, number, of_class, out, imperfect = task
    start = time.perf_counter()
    made = make(seed, number, of_class, imperfect)
    write(made, out)
    return made.name, made.answer, time.perf_counter() - start
