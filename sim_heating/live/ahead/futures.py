"""Flight conditions that may come: the nominal flight, the present conditions held, a planned manoeuvre, and a stop.

A scenario is flown once without its manoeuvres and once with them. The present place on either is where that flight has
the present velocity; of several such places, the one nearest in altitude. From there on its conditions are followed:

    density        rho(t) = rho_flight(t) rho_now / rho_flight(now)
    altitude, ...  z(t)   = z_flight(t) + z_now - z_flight(now)
    angles, jets   a difference from the flight goes to 0, at the rate of the manoeuvre that commands the angle
    trim           the elevon, and the body flap: what a manoeuvre does to them goes to 0 together with the angles; what
                   they differ from the planned flight by stays, since it is a difference of aerodynamics

Stopping a manoeuvre at a time is the planned flight until then, and the nominal flight followed from there.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import SURFACES, Conditions
from sim_heating.base.errors import InputError, RunError
from sim_heating.base.files import suggestion
from sim_heating.inputs.scenario import Scenario
from sim_heating.live.types import Frame
from sim_heating.simulation.run import fly_scenario
from sim_heating.trajectory.flight import Window
from sim_heating.trajectory.manoeuvres import commanded_variable, polygon

COMMANDED = ("alpha_deg", "beta_deg", "jets")
"""Columns that return to those of the flight wholly."""
SHARES = ("rho_kg_m3", "p_inf_Pa", "q_Pa", "qbar_Pa")
"""Columns whose ratio to those of the flight stays, in place of the difference."""
USUAL_RATE = {"alpha_deg": 1.0, "beta_deg": 0.5, "jets": 10.0}
"""Rates of return [deg/s], [1/s] of what no manoeuvre of the scenario commands."""
SHORTEST_RETURN_S = 0.1
"""Time [s] that a return takes at least: conditions do not jump."""


class FlownPath:
    """Conditions of a flight by time.

    columns : (time,) by name, `time_s` [s] and `velocity_m_s` among them
    """

    def __init__(self, columns: Mapping[str, FloatArray]) -> None:
        self.columns = dict(columns)
        self.time_s = self.columns["time_s"]

    def at(self, time_s: FloatArray) -> dict[str, FloatArray]:
        """(time,) conditions at times of the flight [s]; those of its ends beyond them."""
        return {n: np.interp(time_s, self.time_s, column) for n, column in self.columns.items()}

    def matching_time_s(self, now: Mapping[str, float]) -> float:
        """Time of the flight [s] at which it has the velocity of a frame; the nearest in altitude of several.

        now : columns of the frame

        Where the flight never has it, that at which its velocity is nearest.
        """
        speed = self.columns["velocity_m_s"] - now["velocity_m_s"]
        before, after = speed[:-1], speed[1:]
        k = np.flatnonzero((before >= 0.0) != (after >= 0.0))
        if len(k) == 0:
            return float(self.time_s[np.argmin(np.abs(speed))])
        crossings_s = self.time_s[k] + before[k] / (before[k] - after[k]) * np.diff(self.time_s)[k]
        if len(crossings_s) == 1 or "altitude_m" not in self.columns:
            return float(crossings_s[0])
        altitude = np.interp(crossings_s, self.time_s, self.columns["altitude_m"])
        return float(crossings_s[np.argmin(np.abs(altitude - now["altitude_m"]))])


@dataclass(frozen=True)
class Course:
    """Conditions from a time on.

    path     : followed from `path_s` [s] on;  begin_s : present time [s]
    stays    : difference from the path, or the ratio to it, that stays, by column
    returns  : difference that goes to 0, and the time [s] in which it does
    """

    path: FlownPath
    path_s: float
    begin_s: float
    stays: Mapping[str, float]
    returns: Mapping[str, tuple[float, float]]

    def at(self, time_s: FloatArray) -> dict[str, FloatArray]:
        """(time,) conditions at times [s] not before the present."""
        since = np.asarray(time_s, dtype=float) - self.begin_s
        conditions = self.path.at(self.path_s + since)
        for name, value in self.stays.items():
            conditions[name] = conditions[name] * value if name in SHARES else conditions[name] + value
        for name, (value, over_s) in self.returns.items():
            conditions[name] = conditions[name] + value * np.clip(1.0 - since / over_s, 0.0, 1.0)
        return {**conditions, "time_s": np.asarray(time_s, dtype=float)}

    @property
    def corners_s(self) -> list[float]:
        """Times [s] at which a return ends."""
        return sorted({self.begin_s + over_s for value, over_s in self.returns.values() if value != 0.0})


class Stopped:
    """The planned flight until a time, then the nominal one.

    stop_s : when the manoeuvre is stopped [s]
    """

    def __init__(self, futures: Futures, planned: Course, trim: Mapping[str, float], stop_s: float) -> None:
        self.planned, self.stop_s = planned, stop_s
        there = {n: float(v[0]) for n, v in planned.at(np.array([stop_s])).items()}
        self.after = futures.follow(futures.nominal, Frame(stop_s, there), trim)

    def at(self, time_s: FloatArray) -> dict[str, FloatArray]:
        """(time,) conditions at times [s] not before the present."""
        time_s = np.asarray(time_s, dtype=float)
        before, after = self.planned.at(time_s), self.after.at(np.maximum(time_s, self.stop_s))
        return {n: np.where(time_s <= self.stop_s, before[n], after[n]) for n in before} | {"time_s": time_s}

    @property
    def corners_s(self) -> list[float]:
        """Times [s] at which the manoeuvre stops, and the return ends."""
        return [self.stop_s, *self.after.corners_s]


class Held:
    """The conditions of a frame, held."""

    corners_s: Sequence[float] = ()

    def __init__(self, frame: Frame, columns: Sequence[str]) -> None:
        self.values = {n: frame.values[n] for n in columns}

    def at(self, time_s: FloatArray) -> dict[str, FloatArray]:
        """(time,) conditions at times [s]."""
        time_s = np.asarray(time_s, dtype=float)
        return {**{n: np.full(len(time_s), v) for n, v in self.values.items()}, "time_s": time_s}


Future = Course | Stopped | Held


class Futures:
    """What may be flown after a frame of a link.

    columns : that a frame has to have (ConditionsOfFrame.columns)
    nominal, planned : the flight without manoeuvres and with them
    windows : of the manoeuvres on the planned flight [s];  rates : of return by column [deg/s], [1/s]
    raises  : InputError for a column that the flight does not have
    """

    def __init__(
        self,
        columns: Sequence[str],
        nominal: FlownPath,
        planned: FlownPath,
        windows: Sequence[Window],
        rates: Mapping[str, float] | None = None,
    ) -> None:
        self.columns = tuple(columns)
        if absent := [n for n in self.columns if n not in nominal.columns]:
            raise InputError(f"look-ahead: the flight has no `{absent[0]}`{suggestion(absent[0], nominal.columns)}")
        if "velocity_m_s" not in self.columns:
            raise InputError("look-ahead: frames have no `velocity_m_s`, by which the place on a flight is found")
        keep = dict.fromkeys(("time_s", "velocity_m_s", "altitude_m", *columns, "jets"))
        self.nominal, self.planned = (
            FlownPath({n: p.columns[n] for n in keep if n in p.columns}) for p in (nominal, planned)
        )
        self.windows = tuple(windows)
        self.rates = {**USUAL_RATE, **(rates or {})}

    @classmethod
    def of_scenario(cls, scenario: Scenario, columns: Sequence[str]) -> Futures:
        """Fly a scenario without its manoeuvres and with them.

        A scenario for JSBSim is flown with the built-in entry in three degrees of freedom, where the vehicle has the
        tables for it: it takes a tenth of the time, and altitudes agree within 100 m.
        raises : InputError, RunError as a run of the scenario, or for a column that its flight does not have
        """
        manoeuvres = scenario.declared.trajectory.manoeuvre
        planned = _fly(scenario, manoeuvres)
        nominal = _fly(scenario, ()) if manoeuvres else planned
        rates: dict[str, float] = {}
        for m in manoeuvres:
            slopes = [abs((b[1] - a[1]) / (b[0] - a[0])) for a, b in pairwise(polygon(m)) if b[0] > a[0]]
            if max(slopes, default=0.0) > 0.0:
                rates[commanded_variable(m)] = max(slopes)
        flown = [FlownPath(f.columns) for f in (nominal[0], planned[0])]
        return cls(columns, flown[0], flown[1], planned[1], rates)

    def trim(self, frame: Frame) -> dict[str, float]:
        """Differences of the control surfaces from the planned flight, which stay [deg]."""
        there = self.planned.at(np.array([self.planned.matching_time_s(frame.values)]))
        return {
            n: frame.values[n] - float(there[n][0])
            for n in SURFACES
            if n in self.columns and n in frame.values and n not in self.rates
        }

    def follow(self, path: FlownPath, frame: Frame, trim: Mapping[str, float]) -> Course:
        """Conditions that follow a flight from a frame on.

        trim : differences of the control surfaces that stay [deg]
        """
        begin = path.matching_time_s(frame.values)
        used = {*frame.values, "jets"} - {"time_s"}
        with_rate = {*COMMANDED, *(self.rates.keys() & {*SURFACES})}
        stays, returns, others = dict(trim), {}, []
        for name, values in path.at(np.array([begin])).items():
            if name not in used:
                continue
            planned = float(values[0])
            difference = frame.values.get(name, 0.0) - planned
            if name in with_rate:
                returns[name] = (difference, max(abs(difference) / self.rates[name], SHORTEST_RETURN_S))
            elif name in SURFACES:
                others.append((name, difference - trim.get(name, 0.0)))
            else:
                is_ratio = name in SHARES and planned > 0.0
                stays[name] = frame.values[name] / planned if is_ratio else difference
        longest = max((over for value, over in returns.values() if value != 0.0), default=SHORTEST_RETURN_S)
        returns |= {name: (difference, longest) for name, difference in others}
        return Course(path, begin, frame.time_s, stays, returns)

    def after(self, frame: Frame) -> dict[str, Future]:
        """The futures of a frame by their names; without a manoeuvre in the scenario there is none planned."""
        trim = self.trim(frame)
        futures: dict[str, Future] = {
            "nominal": self.follow(self.nominal, frame, trim),
            "held": held(self.columns, frame),
        }
        if self.windows:
            futures["planned"] = self.follow(self.planned, frame, trim)
        return futures

    def stopped(self, planned: Course, frame: Frame, stop_s: float) -> Stopped:
        """The planned future of a frame, its manoeuvre stopped at a time [s]."""
        return Stopped(self, planned, self.trim(frame), stop_s)

    def manoeuvres(self, planned: Course) -> list[Window]:
        """Windows of the manoeuvres from the present of a course on, in its times [s]."""
        shift = planned.begin_s - planned.path_s
        moved = [replace(w, start_s=w.start_s + shift, end_s=w.end_s + shift) for w in self.windows]
        return [w for w in moved if w.end_s > planned.begin_s]


def held(columns: Sequence[str], frame: Frame) -> Held:
    """The conditions of a frame held; of the columns, those that it has."""
    return Held(frame, [n for n in columns if n in frame.values] + [n for n in ("jets",) if n in frame.values])


def _fly(scenario: Scenario, manoeuvres: Sequence[object]) -> tuple[Conditions, list[Window]]:
    spec = scenario.declared.trajectory.model_copy(update={"manoeuvre": tuple(manoeuvres)})
    sources = ("entry-3dof", "jsbsim") if spec.source == "jsbsim" else (spec.source,)
    for source in sources:
        trajectory = spec.model_copy(update={"source": source})
        declared = scenario.declared.model_copy(update={"trajectory": trajectory})
        try:
            flown = fly_scenario(replace(scenario, declared=declared))
            return flown.conditions, flown.windows
        except (InputError, RunError):
            if source == sources[-1]:
                raise
    raise AssertionError
