"""Temperatures of the next minutes on each future, with what the estimate leaves open, and when to stop a manoeuvre.

From the estimate at the present, of temperatures T, parameters p and ratio disturbance d, the march is linearised along
the future (march/linearised.py):

    T(t) = m(t) + X(t) z,   z ~ N(0, 1),     X = [dT/dp C, dT/dT_0 L],   C C^T = cov p,   L L^T = cov(T, d | p)

dT/dp begins with the sensitivities that the filter carries. A ratio that wanders is taken to stay where it is, from now
on with the variance that it has in the long run: sigma is then rather too large than too small. So is the smooth error
of the heating that a link may state (docs/theory/model_error.md, equation 1), which lasts longer than most horizons.
The probability that a limit is passed is that of the normal z for which m + X z passes it at any step; the effects that
a model lacks are not in it.

    ahead = LookAhead(estimator.source, limits, Futures.of_scenario(scenario, estimator.source.columns))
    ahead.predict(estimator.estimates(), frame)["V09T9527"].knock_off_by_s
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import NamedTuple

import numpy as np
from scipy.special import ndtr
from scipy.stats import norm, qmc

from sim_heating.base.arrays import FloatArray
from sim_heating.base.errors import InputError, RunError, error_context
from sim_heating.base.files import display_path
from sim_heating.base.kernels.block import LANES, N_CONDITIONS, P_SURFACE
from sim_heating.base.parallel.threads import one_thread
from sim_heating.base.parameters import SENSOR_PREFIX
from sim_heating.estimation.filter.lane_models import PackedModel
from sim_heating.estimation.filter.online import PointEstimate
from sim_heating.live.ahead.futures import Course, Future, Futures, held
from sim_heating.live.filtering.estimates import LiveEstimate
from sim_heating.live.filtering.estimator import LiveEstimator
from sim_heating.live.filtering.points import ConditionsOfFrame, LivePoint
from sim_heating.live.spec import Link
from sim_heating.live.state import AheadState, KnockOff
from sim_heating.live.types import Frame
from sim_heating.march.linearised import RATIO_ITSELF, LinearMarch, Track

LONGEST_STEP_S, GROWTH, FIRST_STEP_S = 5.0, 0.06, 1.0
"""Steps of the march [s]: 1 s at first, then 6 % of the time from now, at most 5 s; 1 s throughout a manoeuvre.
Against steps of 0.25 s on the POPU at Mach 20, 16 points: 0.4 K in 60 s; in 600 s 0.7 K of a peak, 3 K where boundary
layers turn turbulent within a step."""
SHOWN = 60
"""Times of a future that a state has, at most, apart from the peak."""
LEAST_SIGMA_K, DIRECTIONS = 0.02, 8
"""Directions of the covariance of the temperatures that are carried on: those with at least so large a standard
deviation [K], and at most so many."""
CERTAIN, DRAWS, INSTANTS = 1e-4, 2048, 32
"""Between this probability and 1 less it, that of passing a limit at any time is counted over so many draws (a Sobol
sequence, always the same) at so many instants; elsewhere it is that at the worst instant."""
SPENT = 0.25
"""Largest part of the time of a link that its look-ahead takes [-]; predictions are rarer where one takes long."""
INFORMED = 0.2
"""Standard deviation of a heating ratio, over itself, from which on it is not known well enough to say whether a
manoeuvre has to be stopped [-]: before the first readings the prior alone would say so."""
OLD_S = 10.0
"""Flight time after which a prediction is not shown any more [s], beside three times that between predictions."""
RESOLUTION_S = 0.25
"""How well the latest time to stop a manoeuvre is found [s]."""


class Predicted(NamedTuple):
    """Surface and bondline on one future.

    time_s : (time,) [s];  mean_K, sigma_K : (2, time) [K];  loading_K : (2, time, direction) of unit normals [K]
    """

    time_s: FloatArray
    mean_K: FloatArray
    sigma_K: FloatArray
    loading_K: FloatArray

    @staticmethod
    def of(time_s: FloatArray, mean_K: FloatArray, loading_K: FloatArray) -> Predicted:
        """With the standard deviations of the loading."""
        return Predicted(time_s, mean_K, np.sqrt(np.einsum("itk,itk->it", loading_K, loading_K)), loading_K)


@dataclass(frozen=True)
class PointAhead:
    """What is ahead of a control point.

    futures        : by name, those of live.state.FUTURES that are known
    knock_off      : whether the planned manoeuvre has to be stopped; `unknown` without a manoeuvre or limits, and while
                     the heating ratio is not known to 20 %
    knock_off_by_s : latest flight time [s] at which stopping it keeps the limits; None unless `knock_off` is "by"
    """

    futures: dict[str, AheadState]
    knock_off: KnockOff = "unknown"
    knock_off_by_s: float | None = None


class LookAhead:
    """Predictions of all control points of a link.

    source    : the control points, and what a frame is for them
    limits    : `surface_K` and `bondline_K` [K] of each control point by name; those that it has
    futures   : the flights of a scenario; None for the present conditions held alone
    horizon_s : how far ahead [s]
    keep      : probability with which stopping a manoeuvre keeps the limits
    ratio_sigma : standard deviation in the long run of a ratio that wanders [-]
    heating_error : relative error of the heating ratio, one standard deviation [-]; of its laminar part alone in
                turbulent flow
    raises    : InputError for a horizon or probability out of range
    """

    def __init__(
        self,
        source: ConditionsOfFrame,
        limits: Mapping[str, Mapping[str, float]],
        futures: Futures | None = None,
        horizon_s: float = 60.0,
        keep: float = 0.95,
        ratio_sigma: float = 0.0,
        heating_error: float = 0.0,
    ) -> None:
        if not 1.0 <= horizon_s <= 3600.0:
            raise InputError(f"look-ahead: horizon_s {horizon_s:g}; give 1 to 3600 s")
        if not 0.5 < keep < 1.0:
            raise InputError(f"look-ahead: keep {keep:g}; give a probability above 0.5 and below 1")
        self.source, self.futures = source, futures
        self.horizon_s, self.keep, self.errors = horizon_s, keep, _RatioErrors(ratio_sigma, heating_error)
        names = ("surface_K", "bondline_K")
        self.limits = [
            np.array([limits.get(p.name, {}).get(n, math.inf) for n in names], dtype=float) for p in source.points
        ]
        self._together: list[_Lanes] = []
        self._alone: dict[int, _Lanes] = {}

    def predict(self, estimates: Mapping[str, LiveEstimate], frame: Frame) -> dict[str, PointAhead]:
        """What is ahead of each control point.

        estimates : by name, at the time of the frame
        frame     : the present conditions
        returns   : by name; a future is left out where a temperature on it is not a number
        raises    : InputError for conditions out of range
        """
        points = self.source.points
        now = [estimates[p.name].state for p in points]
        futures: dict[str, Future]
        futures = {"held": held(self.source.columns, frame)} if self.futures is None else self.futures.after(frame)
        ahead = []
        with one_thread():
            predicted = self._march_all(now, frame, futures)
            for i in range(len(points)):
                states = {
                    n: self._state(p, self.limits[i])
                    for n, of_future in predicted.items()
                    if (p := of_future[i]) is not None
                }
                ahead.append(PointAhead(states, *self._knock_off(i, now[i], frame, futures.get("planned"), states)))
        return {p.name: a for p, a in zip(points, ahead, strict=True)}

    def warm_up(self, now: Sequence[PointEstimate]) -> None:
        """Pack the points and compile, or read from the cache, all that a prediction runs: none has to wait for it."""
        still = np.zeros((len(now), 2, N_CONDITIONS))
        still[..., P_SURFACE] = 1000.0
        for k, lanes in enumerate(self._packed(now)):
            lanes.begin(now[k * LANES : (k + 1) * LANES])
            lanes.march(np.array([0.0, 1.0]), still[k * LANES : (k + 1) * LANES])

    def _packed(self, now: Sequence[PointEstimate]) -> list[_Lanes]:
        points = self.source.points
        if not self._together or not all(lanes.fit(now[k * LANES :]) for k, lanes in enumerate(self._together)):
            self._together = [
                _Lanes(points[k : k + LANES], now[k : k + LANES], list(range(LANES))[: len(points) - k], self.errors)
                for k in range(0, len(points), LANES)
            ]
        return self._together

    def _march_all(
        self, now: Sequence[PointEstimate], frame: Frame, futures: Mapping[str, Future]
    ) -> dict[str, list[Predicted | None]]:
        grids = {n: self._steps(frame.time_s, [f]) for n, f in futures.items()}
        histories = {n: self.source.histories(f.at(grids[n])) for n, f in futures.items()}
        by_future: dict[str, list[Predicted | None]] = {n: [] for n in futures}
        for k, lanes in enumerate(self._packed(now)):
            group = slice(k * LANES, (k + 1) * LANES)
            lanes.begin(now[group])
            for n in futures:
                by_future[n] += lanes.march(grids[n], histories[n][group])
        return by_future

    def _planned_manoeuvres(self, futures: Sequence[Future]) -> list[tuple[float, float]]:
        """Start and end [s] of the manoeuvres of courses on the planned flight, each with a step behind it."""
        if self.futures is None:
            return []
        courses = [getattr(f, "planned", f) for f in futures]
        planned = [c for c in courses if isinstance(c, Course) and c.path is self.futures.planned]
        return [(w.start_s, w.end_s + FIRST_STEP_S) for c in planned for w in self.futures.manoeuvres(c)]

    def _steps(self, begin_s: float, futures: Sequence[Future]) -> FloatArray:
        """Steps of the march [s]: growing with the time from now, short in manoeuvres, one at each corner."""
        end = begin_s + self.horizon_s
        t, steps = begin_s, [begin_s]
        fine = self._planned_manoeuvres(futures)
        while t < end - 1e-9:
            dt = min(max(FIRST_STEP_S, GROWTH * (t - begin_s)), LONGEST_STEP_S)
            for start, stop in fine:
                if start - dt < t < stop:
                    dt = FIRST_STEP_S if t >= start - 1e-9 else min(dt, max(start - t, FIRST_STEP_S))
            t = min(t + dt, end)
            steps.append(t)
        corners = [c for f in futures for c in f.corners_s if begin_s < c < end]
        every = np.unique([*steps, *corners])
        far = np.concatenate([[True], np.diff(every) > 0.02])  # two corners at nearly one time are one
        far[-1] = True
        if len(every) > 2 and every[-1] - every[-2] <= 0.02:
            far[-2] = False
        return every[far]

    def _state(self, p: Predicted, limits: FloatArray) -> AheadState:
        """One future as it is published."""
        margin = np.min(limits[:, np.newaxis] - p.mean_K)
        limited = bool(np.any(np.isfinite(limits)))
        peak = int(np.argmax(p.mean_K[0]))
        count = len(p.time_s)
        shown = np.unique(np.append(np.round(np.linspace(0, count - 1, min(SHOWN, count))).astype(int), peak))
        sigma = p.sigma_K[:, shown]
        return AheadState(
            self.horizon_s,
            p.time_s[shown].tolist(),
            p.mean_K[0, shown].tolist(),
            sigma[0].tolist(),
            p.mean_K[1, shown].tolist(),
            sigma[1].tolist(),
            float(p.mean_K[0, peak]),
            float(p.time_s[peak]),
            float(margin) if limited else None,
            passing_probability(p, limits) if limited else None,
        )

    # Stopping a manoeuvre --------------------------------------------------------------------------------------------

    def _knock_off(
        self, i: int, now: PointEstimate, frame: Frame, planned: Future | None, states: Mapping[str, AheadState]
    ) -> tuple[KnockOff, float | None]:
        """Whether the planned manoeuvre has to be stopped at point i to keep its limits, and by when [s]."""
        passes = {name: s.probability for name, s in states.items() if s.probability is not None}
        if self.futures is None or not isinstance(planned, Course) or "planned" not in passes:
            return "unknown", None
        if passes["planned"] <= 1.0 - self.keep:
            return "never needed", None
        if not now.ratio_sigma <= INFORMED * abs(now.ratio):
            return "unknown", None
        if passes.get("nominal", math.inf) > 1.0 - self.keep:
            return "too late", None
        last = max((w.end_s for w in self.futures.manoeuvres(planned)), default=frame.time_s)
        return "by", self._latest_stop(i, now, frame, planned, min(last, frame.time_s + self.horizon_s))

    def _latest_stop(self, i: int, now: PointEstimate, frame: Frame, planned: Course, last_s: float) -> float:
        """Latest time [s] at which stopping the manoeuvre keeps the limits of a point, known that stopping now does.

        Eight times are tried at once, then eight between the latest that keeps them and the one after it.
        """
        low, high = frame.time_s, max(last_s, frame.time_s)
        while high - low > RESOLUTION_S:
            tried = np.linspace(low, high, LANES + 2)
            keeps = np.flatnonzero(self.stop_probabilities(i, now, frame, planned, tried[1:-1]) <= 1.0 - self.keep)
            k = 0 if len(keeps) == 0 else int(keeps[-1]) + 1
            low, high = float(tried[k]), float(tried[k + 1])
        return low

    def stop_probabilities(
        self, i: int, now: PointEstimate, frame: Frame, planned: Course, stops_s: FloatArray
    ) -> FloatArray:
        """(stop,) probability that a limit of a point is passed where the manoeuvre is stopped at given times [s].

        i : number of the point;  stops_s : (stop,) up to LANES times
        """
        assert self.futures is not None
        courses = [self.futures.stopped(planned, frame, float(s)) for s in stops_s]
        courses += [courses[-1]] * (LANES - len(courses))
        if i not in self._alone or not self._alone[i].fit([now]):
            self._alone[i] = _Lanes([self.source.points[i]] * LANES, [now] * LANES, list(range(LANES)), self.errors)
        lanes, time_s = self._alone[i], self._steps(frame.time_s, courses)
        histories = np.stack([self.source.histories(c.at(time_s))[i] for c in courses])
        lanes.begin([now] * LANES)
        predicted = lanes.march(time_s, histories)[: len(stops_s)]
        return np.array([1.0 if p is None else passing_probability(p, self.limits[i]) for p in predicted])


class AheadOfLink:
    """The look-ahead of a link, taken again as its flight goes on.

    link   : whose [ahead] says how
    estimator : of the link
    limits : temperature limits [K] of each control point by name
    latest : what is ahead of each control point by name, from the last prediction
    problem : why there is none, in a line

    The scenario is flown when it is made; where that fails, the present conditions held are the only future.
    """

    def __init__(self, link: Link, estimator: LiveEstimator, limits: Mapping[str, Mapping[str, float]]) -> None:
        self.link, self.estimator = link, estimator
        self.latest: dict[str, PointAhead] = {}
        self.problem = ""
        self._at_s, self._not_before_s = -math.inf, -math.inf
        settings, futures = link.declared.ahead, None
        try:
            with error_context(f"{display_path(link.path)}, [ahead]"):
                if link.scenario is not None:
                    futures = Futures.of_scenario(link.scenario, estimator.source.columns)
        except (InputError, RunError) as error:
            self.problem = f"{str(error).splitlines()[0]}; the look-ahead has the present conditions alone"
        self._ahead = LookAhead(
            estimator.source, limits, futures, settings.horizon_s, settings.keep, link.declared.estimate.wander,
            settings.heating_error,
        )  # fmt: skip
        self._ahead.warm_up([e for f in estimator.stepper.filters for e in f.estimates()])

    def due(self, time_s: float | None) -> bool:
        """Whether a flight time [s] calls for a prediction, and time is left for one."""
        every = self.link.declared.ahead.every_s
        return time_s is not None and abs(time_s - self._at_s) >= every and time.monotonic() >= self._not_before_s

    def take(self, frame: Frame | None) -> None:
        """Predict from the estimate at the time of a frame; `problem` says in a line why that failed."""
        estimates, begin = self.estimator.estimates(), time.monotonic()
        if frame is None or not estimates:
            return
        self._at_s = frame.time_s
        try:
            self.latest = self._ahead.predict(estimates, frame)
        except (InputError, RunError) as error:
            self.latest, self.problem = {}, f"look-ahead: {str(error).splitlines()[0]}"
        now = time.monotonic()
        self._not_before_s = now + (1.0 / SPENT - 1.0) * (now - begin)

    def of(self, point: str) -> PointAhead:
        """What is ahead of a control point; no future before the first prediction, nor where the last one is old."""
        now_s, oldest_s = self.estimator.time_s, OLD_S + 3.0 * self.link.declared.ahead.every_s
        if now_s is None or abs(now_s - self._at_s) > oldest_s:
            return PointAhead({})
        return self.latest.get(point, PointAhead({}))


@dataclass(frozen=True)
class _RatioErrors:
    """Errors of the heating ratio from now on.

    wander  : standard deviation in the long run of one that wanders [-];  heating : relative, of the ratio itself [-]
    """

    wander: float
    heating: float

    def act_on(self, estimate: PointEstimate) -> bool:
        """Whether the march of an estimate needs a column for its ratio."""
        return self.heating > 0.0 or _wanders(estimate)

    def sigma(self, estimate: PointEstimate) -> float:
        """Standard deviation of the ratio beside what the estimate leaves open [-]."""
        unknown = max(self.wander**2 - estimate.disturbance_sigma**2, 0.0) if _wanders(estimate) else 0.0
        size = self.heating * abs(estimate.ratio) if self.heating > 0.0 and math.isfinite(estimate.ratio) else 0.0
        return math.hypot(math.sqrt(unknown), size)


class _Lanes:
    """Up to LANES points, or futures of one point, that are marched together with their sensitivities."""

    def __init__(
        self, points: Sequence[LivePoint], now: Sequence[PointEstimate], flights: Sequence[int], errors: _RatioErrors
    ) -> None:
        self._errors = errors
        self._own = [[n for n in e.names if not n.startswith(SENSOR_PREFIX)] for e in now]
        self._has_ratio = [errors.act_on(e) for e in now]
        tracks = [
            Track(
                p.model,
                p.mesh,
                (*names, *([RATIO_ITSELF] * has_ratio)),
                np.zeros(0),
                (0, p.mesh.bondline),
                flight=flight,
                initial_columns=np.zeros((p.mesh.nodes, 1)),
            )
            for p, names, has_ratio, flight in zip(points, self._own, self._has_ratio, flights, strict=True)
        ]
        self._march = LinearMarch(tracks, np.array([0.0, 1.0]), np.zeros((len(tracks), 2, N_CONDITIONS)))
        self._tracks: list[Track] = tracks
        packed = {
            (id(t.model), t.names): PackedModel.of(t.model, tuple(names))
            for t, names in zip(tracks, self._own, strict=True)
        }
        self._packed = [packed[id(t.model), t.names] for t in tracks]
        self._roots: list[tuple[FloatArray, FloatArray]] = []
        self._now: list[PointEstimate] = []

    def fit(self, now: Sequence[PointEstimate]) -> bool:
        """Whether the lanes have a column for all that is open in estimates: the ratio may begin to wander."""
        return all(has or not self._errors.act_on(e) for has, e in zip(self._has_ratio, now, strict=False))

    def begin(self, now: Sequence[PointEstimate]) -> None:
        """Take over estimates: parameters, temperatures, and what of them is open."""
        tracks: list[Track] = []
        self._roots, self._now = [], list(now)
        begun_of: dict[int, tuple[Track, tuple[FloatArray, FloatArray]]] = {}
        for track, names, has_ratio, estimate in zip(self._march.tracks, self._own, self._has_ratio, now, strict=True):
            if id(estimate) not in begun_of:
                C, L = _root(estimate.covariance), _root(estimate.state_covariance, LEAST_SIGMA_K, DIRECTIONS)
                m, S = len(names), estimate.sensitivity[:-1]
                named = np.concatenate([S[:, :m], np.zeros((len(S), int(has_ratio)))], axis=1)
                first = np.concatenate([S[:, m:], L[:-1]], axis=1)
                filled = first if first.shape[1] else np.zeros((len(S), 1))
                begun = replace(track, initial_K=estimate.temperature_K, named_columns=named, initial_columns=filled)
                begun_of[id(estimate)] = begun, (C, L)
            begun, roots = begun_of[id(estimate)]
            tracks.append(replace(begun, flight=track.flight))
            self._roots.append(roots)
        self._tracks = tracks
        for i, (packed, estimate) in enumerate(zip(self._packed, now, strict=True)):
            at, d = estimate.values.tolist(), estimate.disturbance
            self._march.set_values(i, partial(packed.values, at, d))

    def march(self, time_s: FloatArray, histories: FloatArray) -> list[Predicted | None]:
        """Each lane along its conditions; None where a temperature is not a number.

        time_s : steps [s];  histories : (lane, time, condition)
        """
        self._march.move([replace(t, sample_s=time_s) for t in self._tracks], time_s, histories)
        marched = self._march.attempt()
        return [
            None if f is None else Predicted.of(time_s, f.temperature_K, self._loading(i, f.sensitivity))
            for i, f in enumerate(marched)
        ]

    def _loading(self, i: int, X: FloatArray) -> FloatArray:
        """(2, time, direction) temperatures over unit normals [K]."""
        (C, L), estimate, m = self._roots[i], self._now[i], len(self._own[i])
        ratio = X[..., m] if self._has_ratio[i] else None
        others = X[..., m + int(self._has_ratio[i]) :]
        sensors = len(estimate.names) - m
        of_p = np.concatenate([X[..., :m], others[..., :sensors]], axis=-1)
        of_T = others[..., sensors : sensors + L.shape[1]]
        if ratio is None:
            return np.concatenate([of_p @ C, of_T], axis=-1)
        of_p = of_p + ratio[..., np.newaxis] * estimate.sensitivity[-1]
        of_T = of_T + ratio[..., np.newaxis] * L[-1]
        return np.concatenate([of_p @ C, of_T, self._errors.sigma(estimate) * ratio[..., np.newaxis]], axis=-1)


def _wanders(estimate: PointEstimate) -> bool:
    """Whether the heating ratio of an estimate has a disturbance."""
    return bool(estimate.state_covariance[-1, -1] > 0.0 or np.any(estimate.sensitivity[-1]))


def _root(covariance: FloatArray, least: float = 0.0, most: int | None = None) -> FloatArray:
    """(n, direction) root X of a covariance, X X^T; directions of a standard deviation above `least`, the largest ones.

    covariance : (n, n), in units that may differ by many decades; a root that is not finite where it is not
    """
    if not np.all(np.isfinite(covariance)):
        return np.full((len(covariance), 1), np.nan)
    scale = np.sqrt(np.maximum(np.diag(covariance), 0.0)) if least == 0.0 else np.ones(len(covariance))
    scale = np.where(scale > 0.0, scale, 1.0)
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    root = scale[:, np.newaxis] * vectors * np.sqrt(np.maximum(values, 0.0))
    kept = values > max(least**2, 0.0)
    root = root[:, kept][:, ::-1]
    return root if most is None else root[:, :most]


@lru_cache(maxsize=32)
def _draws(directions: int) -> FloatArray:
    """(direction, draw) unit normals, always the same."""
    sequence = qmc.Sobol(directions, scramble=True, seed=1).random(DRAWS)
    return np.ascontiguousarray(norm.ppf(np.clip(sequence, 1e-12, 1.0 - 1e-12)).T)


def passing_probability(predicted: Predicted, limits: FloatArray) -> float:
    """Probability that surface or bondline passes its limit at any time.

    limits : (2,) [K]; infinite where there is none
    """
    apart = limits[:, np.newaxis] - predicted.mean_K
    u = apart / np.maximum(predicted.sigma_K, 1e-30)
    worst = float(ndtr(-np.min(u)))
    if not CERTAIN < worst < 1.0 - CERTAIN:
        return worst
    # the nearest instants first: between two of them the loading hardly turns
    order = np.argsort(u, axis=None)[: 4 * INSTANTS]
    order = order[u.ravel()[order] < 5.0]
    chosen = order[np.unique(np.round(np.linspace(0, len(order) - 1, min(INSTANTS, len(order)))).astype(int))]
    X = predicted.loading_K.reshape(-1, predicted.loading_K.shape[-1])[chosen]
    passed = np.any(X @ _draws(X.shape[1]) > apart.ravel()[chosen][:, np.newaxis], axis=0)
    return max(worst, float(np.mean(passed)))
