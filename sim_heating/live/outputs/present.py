"""The present state of a link: estimates, health, what is out of use and what the model lacks."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

from sim_heating.base.parameters import CLOCK_SKEW, SENSOR, SENSOR_PREFIX
from sim_heating.heating.atmosphere import free_stream_kernel
from sim_heating.live.ahead.look_ahead import AheadOfLink
from sim_heating.live.filtering.estimates import LiveEstimate
from sim_heating.live.filtering.estimator import LiveEstimator
from sim_heating.live.filtering.points import LivePoint
from sim_heating.live.sources.arrivals import Arrivals
from sim_heating.live.spec import Link
from sim_heating.live.state import (
    STALLED_S,
    LinkPhase,
    LinkState,
    MissingState,
    ParameterState,
    PointState,
    RemovedSensor,
    SensorState,
    State,
)
from sim_heating.live.watch.checks import Failure, SensorChecks
from sim_heating.live.watch.missing import Weighing
from sim_heating.live.watch.sequential import SequentialTest
from sim_heating.thermal.stack import Sensor

REMARKS = 12
"""Remarks that a state shows; all of them are in the summary."""


class PresentState:
    """Gives states of a link, numbered, from what its engine works with.

    link, estimator, arrivals : of the engine;  limits : temperature limits of each point by name [K]
    names    : of the estimated parameters;  remarks : gives the last lines told, so many as are asked for
    checks, test, weighing, ahead : as the engine has them

    phase : of the link, as far as messages tell
    """

    def __init__(
        self,
        link: Link,
        estimator: LiveEstimator,
        arrivals: Arrivals,
        names: Sequence[str],
        remarks: Callable[[int], list[str]],
        checks: SensorChecks,
        test: SequentialTest,
        weighing: Weighing,
        ahead: AheadOfLink,
        limits: Mapping[str, Mapping[str, float]],
    ) -> None:
        self.link, self.estimator, self.arrivals, self.remarks = link, estimator, arrivals, remarks
        self.checks, self.test, self.weighing, self.ahead = checks, test, weighing, ahead
        self.phase: LinkPhase = "waiting"
        self._limits = limits
        self._units = {(p.name, name): _unit(p, name) for p in estimator.points for name in names}
        self._started_s = time.monotonic()
        self._sequence = 0
        self._last = State(0, None, 0.0)

    def state(self) -> State:
        """The state now; states are numbered."""
        now = time.monotonic()
        self._sequence += 1
        self._last = State(
            sequence=self._sequence - 1,
            time_s=self.estimator.time_s,
            wall_s=now - self._started_s,
            conditions=self._conditions(),
            points=dict(self._points()),
            link=self.link_state(now),
            removed=self._removed(),
            missing=self._missing(),
        )
        return self._last

    def last_state(self) -> State:
        """The last state with the health of the link now; for another thread while the engine is at work."""
        now = time.monotonic()
        self._sequence += 1
        self._last = replace(
            self._last, sequence=self._sequence - 1, wall_s=now - self._started_s, link=self.link_state(now)
        )
        return self._last

    def link_state(self, now_s: float) -> LinkState:
        """Health of the link at a time of the monotonic clock [s]."""
        since = 0.0 if self.arrivals.last_message_s is None else max(now_s - self.arrivals.last_message_s, 0.0)
        phase: LinkPhase = self.phase
        if phase != "ended":
            phase = "waiting" if self.arrivals.last_message_s is None else "stalled" if since > STALLED_S else "live"
        counts = self.arrivals.counts
        return LinkState(
            state=phase,
            since_s=since if self.arrivals.last_message_s is not None else now_s - self._started_s,
            frames_Hz=self.arrivals.frames.per_s(now_s),
            readings_Hz=self.arrivals.readings.per_s(now_s),
            damaged=counts["damaged"],
            lost=counts["lost"],
            messages=self.remarks(REMARKS),
            **self._timeline_counts(),
        )

    def _timeline_counts(self) -> dict[str, Any]:
        """Counts of the estimator: late, too_late, doubled, jumps, and the largest lateness [s]."""
        counts = self.estimator.counts
        return {name: getattr(counts, name) for name in ("late", "too_late", "doubled", "jumps", "lateness_s")}

    def _conditions(self) -> Mapping[str, float]:
        frame = self.arrivals.latest_frame
        if frame is None:
            return {}
        values = dict(frame.values)
        vehicle = self.link.vehicle
        if vehicle is not None:
            z, V, rho = (values[n] for n in ("altitude_m", "velocity_m_s", "rho_kg_m3"))
            names = ("T_inf_K", "p_inf_Pa", "mach", "log10_re")
            values |= dict(zip(names, free_stream_kernel(z, V, rho, vehicle.reference_length_m), strict=True))
            values["qbar_Pa"] = 0.5 * rho * V * V
        return values

    def _points(self) -> Iterator[tuple[str, PointState]]:
        for name, estimate in self.estimator.estimates().items():
            state = estimate.state
            limits = self._limits[name]
            now = {"surface_K": estimate.surface_K, "bondline_K": estimate.bondline_K}
            yield (
                name,
                PointState(
                    surface_K=estimate.surface_K,
                    bondline_K=estimate.bondline_K,
                    surface_sigma_K=estimate.surface_sigma_K,
                    bondline_sigma_K=estimate.bondline_sigma_K,
                    ratio=state.ratio,
                    ratio_declared=state.ratio_declared,
                    ratio_sigma=state.ratio_sigma,
                    sensors=self._sensor_states(name, estimate),
                    parameters={
                        p: ParameterState(value, sigma, self._units[name, p])
                        for p, (value, sigma) in estimate.parameters.items()
                    },
                    limits=limits,
                    margin_K=min((limit - now[surface] for surface, limit in limits.items()), default=None),
                    ahead=self.ahead.of(name).futures,
                    knock_off=self.ahead.of(name).knock_off,
                    knock_off_by_s=self.ahead.of(name).knock_off_by_s,
                ),
            )

    def _sensor_states(self, point: str, estimate: LiveEstimate) -> dict[str, SensorState]:
        states = {}
        for sensor in next(p.sensors for p in self.link.points if p.name == point):
            latest = self.arrivals.latest.get((point, sensor.name))
            expected = estimate.sensors.get(sensor.name)
            states[sensor.name] = SensorState(
                None if latest is None else latest.value_K,
                None if latest is None else latest.time_s,
                None if expected is None else expected.predicted_K,
                None if expected is None else expected.sigma_K,
                not (why := self._why_out(point, sensor)),
                why,
            )
        return states

    def _why_out(self, point: str, sensor: Sensor) -> str:
        """Why a sensor does not update the estimate; "" where it does."""
        if not sensor.used:
            return "held back by its declaration"
        return next((f.why for f in self.checks.failures if (f.point, f.sensor) == (point, sensor.name)), "")

    def _removed(self) -> Sequence[RemovedSensor]:
        return [removed_sensor(failure) for failure in self.checks.failures]

    def undecided(self) -> str:
        """Which sensors look as if they failed, or as if the model were wrong, in one line; "" for none."""
        sensors = [f"{sensor} at {point} ({why})" for (point, sensor), why in self.checks.undecided.items()]
        if not sensors:
            return ""
        fails = "fails" if len(sensors) == 1 else "fail"
        return f"undecided whether {' and '.join(sensors)} {fails}, or the model lacks something there; still used"

    def _missing(self) -> MissingState:
        alarm, weighed = self.test.alarm, self.weighing.last
        text = "no sign of a missing effect"
        if alarm is not None:
            text = alarm.text
            if undecided := self.undecided():
                text = f"{text}; {undecided}"
            if weighed is not None:
                when = f"on the record up to {weighed.until_s:.0f} s: " if weighed.finding else ""
                text = f"{text}; {when}{weighed.text}"
                text += f"; weighed again: {self.weighing.problem}" if self.weighing.problem else ""
                text += "; being weighed again" if self.weighing.busy else ""
            elif self.weighing.busy:
                text = f"{text}; candidates are being weighed"
            elif self.phase == "ended":
                text = f"{text}; no candidate was weighed before the end: `close-loop` weighs them on the record"
        return MissingState(
            alarm=alarm is not None,
            statistic=self.test.statistic,
            threshold=self.test.threshold,
            false_alarms_per_hour=self.test.false_alarms_per_hour,
            candidates=() if weighed is None else weighed.candidates,
            text=text,
        )


def removed_sensor(failure: Failure) -> RemovedSensor:
    """A failed sensor, with why it is out of use."""
    kept = f"; what it read from {failure.wrong_s:.1f} s on is taken back when the link ends"
    if failure.wrong_s >= failure.from_s:
        kept = ""
    return RemovedSensor(failure.point, failure.sensor, failure.from_s, failure.why + kept)


def _unit(point: LivePoint, name: str) -> str:
    """Unit of a parameter of a control point, or of one of its sensors."""
    if name == CLOCK_SKEW.name:
        return CLOCK_SKEW.unit
    if name.startswith(SENSOR_PREFIX):
        return SENSOR[name.rpartition(".")[2]].unit
    return point.model.definition(name).unit
