"""States of a link as recorded flights give them, without a link: what the page and the other outputs are tried with.

The truth is the recorded readings, smoothed. The link is taken to know tables that are 8 % low: its temperatures differ
from the truth by the sensitivity near radiation equilibrium, dT / d ln r = (T - T_0) / 4, and the scale of the ratio
follows from the readings by least squares. One sensor sticks. Futures: the record itself, the present held, one that
grows 3 % hotter.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

import sim_heating as sh
from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import RATIO_VARIABLES
from sim_heating.heating.ratio.lookup import table_ratios_at
from sim_heating.inputs.record import Record
from sim_heating.live.outputs.display import Display
from sim_heating.live.state import (
    AheadState,
    Candidate,
    KnockOff,
    LinkState,
    MissingState,
    ParameterState,
    PointState,
    RemovedSensor,
    SensorState,
    State,
)
from tests.support.paths import PRACTICE

NAMES = ("p04", "p05")
PLACES_M = ((9.83, 0.0, -2.0), (29.82, 11.3, -1.8))
LIMITS = {"surface_K": 1533.0, "bondline_K": 450.0}
SMOOTHED_OVER = 9
SCALE, SCALE_PRIOR, NOISE_K, START_K = 0.08, 0.1, 4.0, 290.0
STUCK_AFTER_S, ALARM_AFTER_S, STUCK = 20.0, 40.0, ("LS", "LS_depth1")
HORIZON_S, STEP_S, STOP_S = 60.0, 2.0, 15.0
CONDITIONS = ("altitude_m", "velocity_m_s", "mach", "alpha_deg", "beta_deg", "log10_re", "elevon_deg", "bodyflap_deg")


@dataclass
class Flown:
    """Recorded flights that are told as the states of one.

    columns : conditions of the first record, (time,) each
    points  : control point -> `surface_K`, `bondline_K`, `ratio` of the table and one column a sensor, (time,) each
    popu_s  : start of the first manoeuvre [s]
    """

    display: Display
    columns: Mapping[str, FloatArray]
    points: Mapping[str, Mapping[str, FloatArray]]
    popu_s: float

    @classmethod
    def of(cls, names: Sequence[str] = NAMES) -> Flown:
        """Read records."""
        records = [sh.load_record(PRACTICE / name) for name in names]
        first = records[0].conditions
        columns = {name: first[name] for name in ("time_s", *CONDITIONS)}
        known = Display.of_records(records, "Recorded entry with a POPU")
        shown = {
            name: replace(own, position_m=at, limits=LIMITS)
            for (name, own), at in zip(known.points.items(), PLACES_M, strict=True)
        }
        points = {own.declared.control_point: _told(own, columns["time_s"]) for own in records}
        moved = np.abs(np.gradient(columns["alpha_deg"], columns["time_s"])) > 0.3
        return cls(replace(known, points=shown), columns, points, float(columns["time_s"][np.argmax(moved)]))

    def states(self, start_s: float, end_s: float, rate_hz: float = 10.0, seed: int = 1) -> Iterator[State]:
        """States from one flight time to another [s], with a reading of each sensor a second."""
        link = {name: _Point(self, name, np.random.default_rng([seed, k])) for k, name in enumerate(self.points)}
        for k, time_s in enumerate(np.arange(start_s, end_s, 1.0 / rate_hz)):
            now = float(time_s)
            stuck = now >= start_s + STUCK_AFTER_S
            points = {name: own.state(now, stuck and name == STUCK[0]) for name, own in link.items()}
            removed = [RemovedSensor(*STUCK, start_s + STUCK_AFTER_S, "stuck for 12 s")] if stuck else []
            yield State(
                k, now, now - start_s, {name: self.at(name, now) for name in CONDITIONS}, points,
                LinkState("live", 0.02, rate_hz, 1.0 * sum(len(p.sensors) for p in points.values()), 0.1, late=k // 50),
                removed, _missing(now - start_s),
            )  # fmt: skip

    def at(self, name: str, time_s: float) -> float:
        """A condition at a time."""
        return float(np.interp(time_s, self.columns["time_s"], self.columns[name]))


def _told(record: Record, time_s: FloatArray) -> dict[str, FloatArray]:
    """Smoothed readings of a record, and the ratio of its table, at the times of a flight."""
    read = record.thermocouples
    window = np.ones(SMOOTHED_OVER) / SMOOTHED_OVER
    found = {}
    for sensor in record.sensors:
        known = np.isfinite(read[sensor.column])
        values = np.interp(time_s, read["time_s"][known], read[sensor.column][known])
        padded = np.pad(values, SMOOTHED_OVER // 2, mode="edge")
        found[f"sensor {sensor.name}"] = np.convolve(padded, window, mode="valid")
    columns = list(found.values())
    at = np.column_stack([np.interp(time_s, record.conditions.time_s, record.conditions[n]) for n in RATIO_VARIABLES])
    assert record.ratio_table is not None
    ratio = table_ratios_at(record.ratio_table, at)
    return {"surface_K": columns[0], "bondline_K": columns[-1], "ratio": ratio, **found}


class _Point:
    """A control point of the link: the scale of its ratio by least squares from what was read."""

    def __init__(self, flown: Flown, name: str, random: np.random.Generator) -> None:
        self._flown, self._columns, self._random = flown, flown.points[name], random
        self._limits = flown.display.points[name].limits
        self._information, self._weighed = 1.0 / SCALE_PRIOR**2, 0.0
        self._read: dict[str, tuple[float, float]] = {}

    def _true(self, name: str, time_s: float | FloatArray) -> FloatArray:
        return np.asarray(np.interp(time_s, self._flown.columns["time_s"], self._columns[name]))

    def _estimated(self, true_K: FloatArray) -> FloatArray:
        return true_K - (true_K - START_K) / 4.0 * (SCALE - self._weighed / self._information)

    def state(self, now: float, one_is_stuck: bool) -> PointState:
        sensors = {}
        for column in self._columns:
            name = column.removeprefix("sensor ")
            if name == column:
                continue
            stuck = one_is_stuck and name == STUCK[1]
            true_K = self._true(column, now)
            slope = float(true_K - START_K) / 4.0
            read = self._read.get(name)
            if read is None or now - read[1] >= 1.0 - 1e-6:
                value = read[0] if stuck and read else float(true_K + NOISE_K * self._random.standard_normal())
                self._read[name] = read = (value, now)
                if not stuck:
                    self._information += slope**2 / NOISE_K**2
                    self._weighed += slope * (value - float(true_K) + SCALE * slope) / NOISE_K**2
            sigma_K = float(np.hypot(NOISE_K, slope / np.sqrt(self._information)))
            predicted = float(self._estimated(true_K))
            sensors[name] = SensorState(*read, predicted, sigma_K, not stuck, "stuck for 12 s" if stuck else "")
        scale, sigma = self._weighed / self._information, 1.0 / np.sqrt(self._information)
        surface, bondline = (self._true(name, now) for name in ("surface_K", "bondline_K"))
        table = float(self._true("ratio", now))
        ahead = self._ahead(now, float(sigma))
        margins = [self._limits[n] - float(self._true(n, now)) for n in self._limits]
        knock_off, by = self._knock_off(now, ahead["planned"])
        return PointState(
            float(self._estimated(surface)), 1.0 + float((surface - START_K) / 4.0 * sigma),
            float(self._estimated(bondline)), 0.2 + float((bondline - START_K) / 4.0 * sigma),
            table * (1.0 + scale), table, float(table * sigma), sensors,
            {"ratio.scale": ParameterState(float(scale), float(sigma), "-")}, self._limits, min(margins), ahead,
            by, knock_off,
        )  # fmt: skip

    def _ahead(self, now: float, sigma: float) -> dict[str, AheadState]:
        time_s = now + np.arange(0.0, HORIZON_S + 0.5 * STEP_S, STEP_S)
        growth = (time_s - now) / HORIZON_S
        found = {}
        for name in ("nominal", "held", "planned"):
            at = np.full_like(time_s, now) if name == "held" else time_s
            hotter = 1.0 + 0.03 * growth if name == "planned" else 1.0
            surface, bondline = (self._estimated(self._true(n, at)) * hotter for n in ("surface_K", "bondline_K"))
            errors = [k + (T - START_K) / 4.0 * sigma * (1.0 + growth) for k, T in ((1.0, surface), (0.2, bondline))]
            peak = int(np.argmax(surface))
            rooms = [
                (self._limits[n] - T, e)
                for n, T, e in zip(("surface_K", "bondline_K"), (surface, bondline), errors, strict=True)
                if n in self._limits
            ]
            margin = min(float(np.min(room)) for room, _ in rooms)
            chance = max(float(np.max(_passed(room / e))) for room, e in rooms)
            found[name] = AheadState(
                HORIZON_S, time_s.tolist(), surface.tolist(), errors[0].tolist(), bondline.tolist(),
                errors[1].tolist(), float(surface[peak]), float(time_s[peak]), margin, chance,
            )  # fmt: skip
        return found

    def _knock_off(self, now: float, planned: AheadState) -> tuple[KnockOff, float | None]:
        over = [
            t
            for t, T, Tb in zip(planned.time_s, planned.surface_K, planned.bondline_K, strict=True)
            if self._limits["surface_K"] < T or self._limits.get("bondline_K", np.inf) < Tb
        ]
        if not over:
            return "never needed", None
        return ("by", over[0] - STOP_S) if over[0] - STOP_S > now else ("too late", None)


def _passed(z: FloatArray) -> FloatArray:
    """Probability that a normal variable lies z standard deviations above its mean."""
    return 0.5 * (1.0 - np.tanh(0.8 * z))  # logistic form of the error function, to 0.01


def _missing(since_s: float) -> MissingState:
    statistic = 0.5 + since_s / ALARM_AFTER_S * 4.5
    if statistic < 5.0:
        return MissingState(False, statistic, 5.0, 0.01, (), "no sign of a missing effect")
    could = [Candidate("transition", 0.8), Candidate("alpha-curvature", 0.15), Candidate("unknown", 0.05)]
    return MissingState(True, statistic, 5.0, 0.01, could, "an effect is missing at OE")
