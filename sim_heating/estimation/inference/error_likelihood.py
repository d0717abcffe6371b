"""Likelihood and innovations of a record whose model has an error: the algebra of inference/model_error.py."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.linalg import block_diag, solve_triangular

from sim_heating.base.arrays import BoolArray, FloatArray
from sim_heating.base.conditions import Conditions
from sim_heating.base.kernels.block import LANES
from sim_heating.estimation.inference.bounds import ChannelResiduals
from sim_heating.estimation.inference.likelihood import scores
from sim_heating.estimation.inference.model_error import (
    CorrelatedNoise,
    Correlation,
    FlightError,
    HeatingNoise,
    ModelError,
)
from sim_heating.estimation.record_fit import PredictedSamples, RecordFit
from sim_heating.inputs.points import conditions_of_record
from sim_heating.march.ensemble import condition_history
from sim_heating.march.linearised import LinearMarch

SPACING_S, MOST_KNOTS = 5.0, 400
"""Least distance of knots [s], a twelfth of the shortest correlation time, and their largest number.

The line between knots leaves out tanh(1 / 24) = 4 % of the variance of that process at its middle.
"""
STEP = 0.02
"""Relative change of the heating for the derivative of the readings [-]."""
KNOTS_A_TIME = 4.0
"""Knots of slow noise in each of its correlation times."""
FORM_ERROR, FORM_SHARE, FORM_KNOTS = 0.2, 0.25, 12
"""Standard deviation of the relative error of what a cause changes [-], its correlation time over the length of a
record [-], and the knots of it: a choice."""
SETTLED, MOST_STEPS = 1e-3, 100
"""Change of u, in its standard deviations given the readings, at which the inner iteration has converged [-], and its
most steps."""
MEMORY = 8
"""Steps that the curvature of the inner iteration is taken from."""
TOGETHER = 64
"""Readings that the filter takes at a time."""


def model_error(
    record_fit: RecordFit,
    values: FloatArray,
    sigma: float,
    correlation: Correlation,
    flight: FlightError | None = None,
    noise: HeatingNoise | None = None,
    knots_s: FloatArray | None = None,
) -> ModelError:
    """The error of a record's model with the response of its readings, about the values of a fit.

    record_fit : a record of a fit, with all samples that are ever asked for
    values     : (parameter,) of the model
    sigma, correlation : of the heating's error, s [-] and how far in time it is alike
    flight     : the error of the flight
    noise      : of the heating, from that of the conditions
    knots_s    : (knot,) of the heating's error [s]; by default evenly spaced
    raises     : RunError where the model cannot be marched

    Responses are differences of marches: with the heating, by the flow and by lamps, scaled about one knot after the
    other, and along the flights that differ. Source: docs/theory/model_error.md, equation 2.
    """
    time_s = record_fit.time_s
    flown = record_fit.conditions.at(time_s)
    knots = even_knots_s(record_fit) if knots_s is None else knots_s
    histories = [flown, *scaled_heating(flown, knots)]
    T = _marched_K(record_fit, values, [condition_history(h) for h in histories])
    moved = np.moveaxis(T[1:] - T[0], 0, -1) / STEP
    of_flight = flight_response(record_fit, values, flight)
    return ModelError(
        knots, record_fit.sample_s, moved, of_flight, flight, sigma, correlation,
        _correlated_noise(record_fit), noise, None if noise is None else _white_K(record_fit, values, noise),
    )  # fmt: skip


def even_knots_s(record_fit: RecordFit) -> FloatArray:
    """(knot,) evenly spaced knots of the error of a record's heating [s].

    Source: docs/theory/model_error.md, equation 1.
    """
    first, last = record_fit.begin_s, float(record_fit.sample_s[-1])
    return np.linspace(first, last, min(max(math.ceil((last - first) / SPACING_S) + 1, 2), MOST_KNOTS))


def scaled_heating(flown: Conditions, knots_s: FloatArray) -> list[Conditions]:
    """(knot,) conditions with the heating, by the flow and by lamps, STEP higher about one knot after the other.

    Source: docs/theory/model_error.md, equation 2.
    """
    heating = {n: flown[n] for n in ("h_ref_kg_m2_s", "q_add_W_m2") if n in flown}
    scales = (1.0 + STEP * np.interp(flown.time_s, knots_s, hat) for hat in np.eye(len(knots_s)))
    return [flown.with_columns(**{n: scale * q for n, q in heating.items()}) for scale in scales]


def flight_response(
    record_fit: RecordFit, values: FloatArray, flight: FlightError | None, about: FloatArray | float = 0.0
) -> FloatArray:
    """(sensor, sample, direction) change of readings for one standard deviation along each direction of a flight [K].

    record_fit : a record of a fit, with the conditions of the flight that the response is about
    values     : (parameter,) of the model
    about      : (direction,) of that flight, in standard deviations [-]
    raises     : RunError where the model cannot be marched

    Source: docs/theory/model_error.md, equation 2.
    """
    others = [] if flight is None else [flight.record(about + f) for f in np.eye(len(flight.directions))]
    flown = [record_fit.conditions, *map(conditions_of_record, others)]
    T = _marched_K(record_fit, values, [condition_history(c.at(record_fit.time_s)) for c in flown])
    return np.asarray(np.moveaxis(T[1:] - T[0], 0, -1))


def noise_error(record_fit: RecordFit, values: FloatArray, noise: HeatingNoise) -> ModelError:
    """The error of a record's model where only its conditions have noise, about the values of a fit.

    record_fit : a record of a fit;  values : (parameter,) of the model;  noise : of its heating
    raises     : RunError where the model cannot be marched

    Source: docs/theory/model_error.md, equation 10.
    """
    samples = len(record_fit.sample_s)
    none = np.zeros((len(record_fit.record.sensors), samples, 0))
    return ModelError(
        np.zeros(0), record_fit.sample_s, none, none, None, 0.0, Correlation(1.0),
        heating_noise=noise, white_K=_white_K(record_fit, values, noise),
    )  # fmt: skip


def _white_K(record_fit: RecordFit, values: FloatArray, noise: HeatingNoise) -> FloatArray:
    """(sensor, sample, knot) change of readings for one standard deviation of white noise of the film at each knot [K].

    A lamp has no part in it. Source: docs/theory/model_error.md, equation 10.
    """
    time_s = record_fit.time_s
    flown = record_fit.conditions.at(time_s)
    knots = noise.knots_s(record_fit.begin_s, float(record_fit.sample_s[-1]))
    sizes = noise.at_knots(knots)
    film = flown["h_ref_kg_m2_s"]
    scaled = (film * (1.0 + STEP * np.interp(time_s, knots, hat)) for hat in np.eye(len(knots)))
    histories = [flown, *(flown.with_columns(h_ref_kg_m2_s=h) for h in scaled)]
    T = _marched_K(record_fit, values, [condition_history(h) for h in histories])
    return np.asarray(np.moveaxis(T[1:] - T[0], 0, -1) / STEP * sizes)


def form_root_K(changes_K: Sequence[FloatArray], time_s: FloatArray, noise_K: FloatArray) -> FloatArray | None:
    """(sensor, sample, value) root of the covariance that the errors of the forms of causes give the readings [K].

    changes_K : by cause, (sensor, sample) what it changes [K];  time_s : (sample,) [s]
    noise_K   : (sensor,) standard deviation of a reading [K]
    returns   : directions that the readings see; None where they see none

    Source: docs/theory/model_error.md, equation 1b.
    """
    least_seen = 0.1  # of the noise of a reading, over all readings of a direction [-]
    knots_s = np.linspace(time_s[0], time_s[-1], FORM_KNOTS)
    root = Correlation(FORM_SHARE * (time_s[-1] - time_s[0]), smooth=True).root(knots_s)
    e = FORM_ERROR * np.array([np.interp(time_s, knots_s, hat) for hat in np.eye(FORM_KNOTS)]).T @ root
    columns = []
    for sensor, sigma_K in enumerate(noise_K):
        for change_K in changes_K:
            U, seen, _ = np.linalg.svd(change_K[sensor, :, np.newaxis] / sigma_K * e, full_matrices=False)
            is_seen = seen > least_seen
            part = np.zeros((*change_K.shape, np.count_nonzero(is_seen)))
            part[sensor] = sigma_K * U[:, is_seen] * seen[is_seen]
            columns.append(part)
    root_K = np.concatenate(columns, axis=-1) if columns else np.zeros(0)
    return root_K if root_K.size else None


def _correlated_noise(record_fit: RecordFit) -> dict[int, CorrelatedNoise]:
    """Noise that changes slowly, by the number of the sensor."""
    by_sensor, t = {}, record_fit.sample_s
    for channel in record_fit.channels:
        sigma, tau = channel.sensor.noise_sigma_K, channel.sensor.noise_correlation_s
        if sigma and tau:
            count = max(math.ceil((t[-1] - t[0]) / max(tau / KNOTS_A_TIME, float(np.median(np.diff(t))))), 1) + 1
            by_sensor[channel.number] = CorrelatedNoise(np.linspace(t[0], t[-1], count), sigma, tau)
    return by_sensor


def _marched_K(record_fit: RecordFit, values: FloatArray, histories: Sequence[FloatArray]) -> FloatArray:
    """(history, sensor, sample) temperatures of the thermocouples along several histories [K]."""
    track, shift, temperatures_K = record_fit.track(values, sensitive=False), record_fit.shift_s(values), []
    for begin in range(0, len(histories), LANES):
        lanes = histories[begin : begin + LANES]
        tracks = [replace(track, flight=k) for k in range(len(lanes))]
        marched = LinearMarch(tracks, record_fit.time_s, np.stack(lanes)).march([shift] * len(lanes))
        temperatures_K += [record_fit.sensed(m, values).temperature_K for m in marched]
    return np.array(temperatures_K)


@dataclass(frozen=True, eq=False)
class ScoredReadings:
    """The likelihood of the readings of one record at some predictions, the error of the model integrated out.

    log_likelihood : [-];  score : (reading,) [1/K];  weight : (reading,) information W of the readings [1/K2]
    root           : (reading, mode) G of the error along the directions that the readings see [K]; None without one
    error          : (unknown,) the most probable u [-]; empty without an error
    """

    log_likelihood: float
    score: FloatArray
    weight: FloatArray
    root: FloatArray | None = None
    error: FloatArray = field(default_factory=lambda: np.zeros(0))

    def information(self, sensitivity: FloatArray) -> FloatArray:
        """(parameter, parameter) information by the (reading, parameter) sensitivities [K over the unit].

        Source: docs/theory/model_error.md, equation 4.
        """
        weighed = sensitivity * self.weight[:, np.newaxis]
        information = weighed.T @ sensitivity
        if self.root is None:
            return information
        weighed_root, lower = self._taken_up
        lost = solve_triangular(lower, weighed_root.T @ sensitivity, lower=True)
        return np.asarray(information - lost.T @ lost)

    @cached_property
    def _taken_up(self) -> tuple[FloatArray, FloatArray]:
        """(reading, unknown) W G [1/K] and the lower root C of 1 + G' W G [-]: the error takes up C^-1 G' W.

        W of a word may be above R^-1: with the root of 1 + G' R^-1 G the information would not be that of any error.
        """
        assert self.root is not None  # asked for with an error only
        scale = np.sqrt(self.weight)[:, np.newaxis]  # the likelihood of a reading is log-concave: W is 0 or above
        scaled = self.root * scale
        lower: FloatArray = np.asarray(np.linalg.cholesky(np.eye(scaled.shape[1]) + scaled.T @ scaled))
        return scaled * scale, lower


def scored_readings(record_fit: RecordFit, means_K: Sequence[FloatArray]) -> ScoredReadings:
    """Log likelihood of the readings of a record, its score and information.

    means_K : by channel of the record, (reading,) predictions without an error [K]

    One step finds the most probable error of readings that are not rounded. Others take more: the information of a word
    depends on where in its span the prediction lies, and R^-1 is far from it where the span is several times the noise.
    Steps then follow from the gradients of those before (BFGS with limited memory; Nocedal & Wright, Numerical
    Optimization, 2nd ed., algorithm 7.4). Source: docs/theory/model_error.md, equations 3 and 4; without an error
    docs/theory/estimation_statistics.md, equations 3 to 6.
    """
    modes = record_fit.error_modes
    if modes is None or record_fit.error_root_K is None:
        return ScoredReadings(*scored(record_fit, means_K))
    G = modes.root_K
    ends = np.cumsum([len(m) for m in means_K])[:-1]

    def at(u: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        total, score, weight = scored(record_fit, [m + d for m, d in zip(means_K, np.split(G @ u, ends), strict=True)])
        return total - 0.5 * float(u @ u), score, weight

    # along the modes, in units of their scales, the sum has a curvature near that of the identity
    scale, volume = modes.scale, modes.volume
    u = np.zeros(G.shape[1])
    total, score, weight = at(u)
    if not np.isfinite(total):
        return ScoredReadings(total + volume, score, weight, G, modes.basis @ u)
    history, gradient = _Steps([], []), (G.T @ score - u) / scale
    for _ in range(MOST_STEPS):
        step = history.ascent(gradient)
        moved = u + step / scale
        there = at(moved)
        # the sum is concave in u: a shorter step raises it
        while there[0] < total and np.linalg.norm(step) > SETTLED:
            step = 0.5 * step
            moved = u + step / scale
            there = at(moved)
        u, (total, score, weight), before = moved, there, gradient
        if np.linalg.norm(step) < SETTLED:
            break
        gradient = (G.T @ score - u) / scale
        history.add(step, before - gradient)
    error = modes.all_unknowns(u, record_fit.error_root_K.T @ score)
    return ScoredReadings(total + volume, score, weight, G, error)


@dataclass(frozen=True, eq=False)
class _Steps:
    """The last steps of a maximisation, each with the decrease of the gradient over it, the latest last."""

    steps: list[FloatArray]
    decreases: list[FloatArray]

    def add(self, step: FloatArray, decrease: FloatArray) -> None:
        """One step more; nothing where the gradient does not decrease along it."""
        if step @ decrease > 0.0:
            self.steps.append(step)
            self.decreases.append(decrease)

    def ascent(self, gradient: FloatArray) -> FloatArray:
        """The next step: the gradient, times the inverse of the curvature that the last steps show."""
        pairs, taken, step = list(zip(self.steps, self.decreases, strict=True))[-MEMORY:], [], gradient
        for s, y in reversed(pairs):
            taken.append(float(s @ step) / float(s @ y))
            step = step - taken[-1] * y
        if pairs:
            s, y = pairs[-1]
            step = step * (float(s @ y) / float(y @ y))
        for (s, y), a in zip(pairs, reversed(taken), strict=True):
            step = step + s * (a - float(y @ step) / float(s @ y))
        return step


def scored(record_fit: RecordFit, means_K: Sequence[FloatArray]) -> tuple[float, FloatArray, FloatArray]:
    """Log likelihood, (reading,) scores [1/K] and weights [1/K2] of the readings of all channels.

    means_K : by channel, (reading,) predictions [K]

    Source: docs/theory/estimation_statistics.md, equations 3 to 6.
    """
    pairs = zip(record_fit.channels, means_K, strict=True)
    of_channels = [scores(c.intervals, m, c.noise_K(record_fit.sigma_K[c.number])) for c, m in pairs]
    return (
        sum(s[0] for s in of_channels),
        np.concatenate([s[1] for s in of_channels]),
        np.concatenate([s[2] for s in of_channels]),
    )


@dataclass(frozen=True, eq=False)
class ErrorState:
    """What is known of u after some readings: means (unknown, set) and covariance (unknown, unknown) [-]."""

    mean: FloatArray
    covariance: FloatArray


def innovations(
    record_fit: RecordFit,
    samples: Sequence[PredictedSamples],
    state: ErrorState | None = None,
    root_K: FloatArray | None = None,
) -> tuple[list[PredictedSamples], ErrorState | None]:
    """Predictions of the readings of one record, each from those before it, and what is then known of its error.

    record_fit : the record with its error
    samples    : its channels, predicted without an error, with readings (reading,) or of several sets (reading, set)
    state      : from readings before; None for the prior
    root_K     : (reading, unknown) of more unknowns than those of the error, which are N(0, 1) before the readings [K]
    returns    : channels with the mean and the standard deviation that the readings before give [K], the mean in the
                 shape of the readings; as they are without an error

    A rounded reading counts as one with the noise of its rounding. A reading at an end of a word's span in any set
    informs none. Source: docs/theory/model_error.md, equation 6.
    """
    G, modes, noise = record_fit.error_root_K, record_fit.error_modes, record_fit.reading_noise_K
    if G is None or modes is None:
        return list(samples), None
    is_first = state is None and root_K is None  # nothing was read before, and only what these readings see changes
    G = modes.root_K if is_first else G
    means = [s.mean_K for s in samples]
    mean_K = np.concatenate(means)
    read = np.concatenate([s.channel.intervals.centre_K for s in samples])
    shape, read = read.shape, read.reshape(len(read), -1)
    time_s = np.concatenate([record_fit.sample_s[s.channel.samples] for s in samples])
    n = G.shape[1]
    u, P = (np.zeros((n, read.shape[1])), np.eye(n)) if state is None else (state.mean, state.covariance)
    if root_K is not None:
        G = np.column_stack([G, root_K])
        u, P = np.pad(u, [(0, root_K.shape[1]), (0, 0)]), block_diag(P, np.eye(root_K.shape[1]))
    predicted, variance = np.empty(read.shape), np.empty(len(read))
    is_known = np.all(np.isfinite(read), axis=1)
    order = np.argsort(time_s, kind="stable")
    for group in np.array_split(order, max(len(order) // TOGETHER, 1)):
        informed, lost = group[is_known[group]], group[~is_known[group]]
        predicted[lost] = mean_K[lost, np.newaxis] + G[lost] @ u
        variance[lost] = np.einsum("ij,jk,ik->i", G[lost], P, G[lost])
        if len(informed) == 0:
            continue
        # the root of the readings' covariance, in the order of time, has what those before leave of each
        across = P @ G[informed].T
        lower = np.linalg.cholesky(G[informed] @ across + np.diag(noise[informed] ** 2))
        sigma_left = np.diag(lower)
        white = solve_triangular(lower, read[informed] - mean_K[informed, np.newaxis] - G[informed] @ u, lower=True)
        predicted[informed] = read[informed] - white * sigma_left[:, np.newaxis]
        variance[informed] = sigma_left**2 - noise[informed] ** 2
        gain = solve_triangular(lower, across.T, lower=True)
        u, P = u + gain.T @ white, P - gain.T @ gain
    ends = np.cumsum(list(map(len, means)))[:-1]
    means, sigmas = np.split(predicted.reshape(shape), ends), np.split(np.sqrt(np.maximum(variance, 0.0)), ends)
    channels = [replace(s, mean_K=m, predicted_sigma_K=d) for s, m, d in zip(samples, means, sigmas, strict=True)]
    if is_first:
        assert record_fit.error_root_K is not None  # its modes are those of one
        V, left = modes.basis, np.where(is_known[:, np.newaxis], read - mean_K[:, np.newaxis] - G @ u, 0.0)
        u = modes.all_unknowns(u, record_fit.error_root_K.T @ (left / noise[:, np.newaxis] ** 2))
        P = np.eye(len(V)) + V @ (P - np.eye(V.shape[1])) @ V.T
    return channels, ErrorState(u, P)


def parameter_root_K(
    fitted: Sequence[PredictedSamples], others: Sequence[PredictedSamples], covariance: FloatArray
) -> FloatArray:
    """(reading, parameter) root of the covariance that the parameters of a fit give to readings that it has not [K].

    fitted, others : channels of the fitted readings and of the others, at the values of the fit
    covariance     : (parameter, parameter) of the fit; a parameter without a finite variance stays at its value

    With another value of a parameter the fitted readings give another error of the model, which the others then have.
    Source: docs/theory/model_error.md, equation 6a.
    """
    here, there = fitted[0].record_fit, others[0].record_fit
    modes = here.error_modes
    assert modes is not None  # the caller's records have an error
    assert there.error_root_K is not None
    known = np.diag(covariance) > 0.0
    known &= np.isfinite(np.diag(covariance))
    J, J_there = (np.concatenate([s.jacobian[:, known] for s in samples]) for samples in (fitted, others))
    seen = modes.root_K.T @ (J / here.reading_noise_K[:, np.newaxis] ** 2)
    K_J = modes.basis @ (seen / modes.scale[:, np.newaxis] ** 2)
    scale = np.sqrt(np.diag(covariance)[known])
    values, vectors = np.linalg.eigh(covariance[np.ix_(known, known)] / np.outer(scale, scale))
    root = scale[:, np.newaxis] * vectors * np.sqrt(np.maximum(values, 0.0))
    return np.asarray((J_there - there.error_root_K @ K_J) @ root)


def whitened(record_fit: RecordFit, samples: Sequence[PredictedSamples], free: BoolArray) -> list[ChannelResiduals]:
    """Residuals of the channels of one record and their sensitivities, each less what the readings before it say.

    record_fit : the record with its error;  samples : its channels, predicted without an error
    free       : (parameter,) which columns of their sensitivities are kept
    returns    : by channel, residuals of unit variance where the model holds; readings at an end of a word's span and
                 lost ones are left out

    With L the lower root of the readings' covariance in the order of time, these are L^-1 (y - m) and L^-1 dm/dp:
    equation 6 of docs/theory/model_error.md, for residuals and sensitivities alike.
    """
    G, noise = record_fit.error_root_K, record_fit.reading_noise_K
    assert G is not None  # the caller's records have one
    left_K = np.concatenate([s.channel.intervals.centre_K - s.mean_K for s in samples])
    jacobian = np.concatenate([s.jacobian[:, free] for s in samples])
    time_s = np.concatenate([s.time_s for s in samples])
    channel = np.repeat(np.arange(len(samples)), [len(s.mean_K) for s in samples])
    order = np.argsort(time_s, kind="stable")
    order = order[np.isfinite(left_K[order])]
    lower = np.linalg.cholesky(G[order] @ G[order].T + np.diag(noise[order] ** 2))
    white = solve_triangular(lower, np.column_stack([left_K, jacobian])[order], lower=True)
    residuals = []
    for i, s in enumerate(samples):
        rows = channel[order] == i
        residual, sensitivity = white[rows, 0], white[rows, 1:]
        name = f"{record_fit.record.name}/{s.channel.sensor.name}"
        residuals.append(ChannelResiduals(name, time_s[order][rows], residual, np.ones(len(residual)), sensitivity))
    return residuals
