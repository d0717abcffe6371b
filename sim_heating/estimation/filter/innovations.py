"""The likelihood of a fit with noise of the process: that of the innovations of the Kalman filter.

Every sample is compared with what the filter predicts from all samples before it (estimation/filter/march.py); the
innovations are independent of each other where the noise is as assumed, so that log likelihoods, residual tests and
bounds are those of a fit without such noise, predictions m_i and their variances S_i in the place of the march and of
sensor noise:

    log L = sum_i log p(y_i | m_i(theta), S_i(theta)),    information sum_i I_i dm_i/dtheta dm_i/dtheta'.

dm/dtheta are the filter's own sensitivities, which leave out how the gain changes; the gradient of log L is complete,
by central differences over filters that are marched side by side in the lanes of a group. Levels of noise that are not
given are those of the largest likelihood with the parameters integrated out (Laplace),

    log L + g' M^-1 g / 2 - log det M / 2,    g and M gradient and information, priors included,

in turn with the parameters: at fixed values, the part of the wandering that the parameters have absorbed would not
count as noise. R. E. Maine and K. W. Iliff, "Formulation and Implementation of a Practical Algorithm for Parameter
Estimation with Process and Measurement Noise", SIAM J. Appl. Math. 41 (1981). Derived in
docs/theory/estimation_statistics.md, equations 32 to 35.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sim_heating.base.arrays import FloatArray
from sim_heating.base.errors import RunError
from sim_heating.base.kernels.block import LANES
from sim_heating.base.parallel.threads import in_threads
from sim_heating.estimation.filter.march import Filtered, FilterMarch, FilterTrack
from sim_heating.estimation.filter.process_noise import CORRELATION, Level, Levels, ProcessNoise
from sim_heating.estimation.filter.records import filter_samples, lag_offset
from sim_heating.estimation.inference.identifiability import scale
from sim_heating.estimation.inference.likelihood import likelihood
from sim_heating.estimation.inference.newton import Evaluation, Fit, NewtonSettings, StepCallback, maximise
from sim_heating.estimation.problem import FitProblem
from sim_heating.estimation.record_fit import PredictedSamples, least_sigma_K
from sim_heating.march.ensemble import condition_history
from sim_heating.march.point import PointModel

SETTINGS = NewtonSettings(min_improvement=1e-4, min_step=1e-2)
"""A hundredth of a sigma: differences of a log likelihood give a gradient no more accurately than that."""
STEP = 0.1
"""Parameters are perturbed by this part of their sigma, the others being known, for the gradient."""
FIRST_RANGES, LATER_RANGES = (60.0, 6.0, 2.0), (2.0,)
"""Largest factors on a level in successive searches, the first time and again; candidates fill the lanes of a group."""
LEVELS_CONVERGED = 0.05
"""Relative change below which levels have converged."""
MAX_ROUNDS = 6


class Innovations:
    """Likelihood of the samples of a problem against the predictions of a Kalman filter.

    problem : parameters, records and samples
    levels  : current levels of process noise and of undeclared sensor noise

    Source: docs/theory/estimation_statistics.md, equations 32 to 35.
    """

    def __init__(self, problem: FitProblem, noise: ProcessNoise) -> None:
        self.problem = problem
        undeclared = {
            (k, c.number): record_fit.sigma_K[c.number]
            for k, record_fit in enumerate(problem.record_fits)
            for c in record_fit.channels
            if c.sensor.noise_sigma_K is None
        }
        self.levels = Levels(noise, undeclared)
        self._histories = [condition_history(p.conditions.at(p.time_s))[np.newaxis] for p in problem.record_fits]
        self._without_sensitivities: dict[tuple[int, int], FilterMarch] = {}
        self._with_sensitivities: list[FilterMarch | None] = [None] * len(problem.record_fits)
        self._at_levels: list[FilterMarch | None] = [None] * len(problem.record_fits)
        self._last: tuple[bytes, Levels, list[Filtered]] | None = None

    # Likelihood ------------------------------------------------------------------------------------------------------

    def evaluate(self, vector: FloatArray) -> Evaluation:
        """Log likelihood of all samples, its complete gradient, and Gauss-Newton's information.

        vector  : (parameter,) values, each in its unit
        returns : log likelihood [-], (parameter,) gradient by central differences, (parameter, parameter) information
                  from the filter's own sensitivities; NaN log likelihood where a filter diverged

        Source: docs/theory/estimation_statistics.md, equations 32 and 33.
        """
        try:
            samples = self.samples(vector)
        except RunError:
            return self.problem.failed_evaluation()
        m = len(self.problem.unknowns)
        total, information = 0.0, np.zeros((m, m))
        for s in samples:
            scored = likelihood(s.channel.intervals, s.mean_K, s.spread_K)
            total += float(np.sum(scored.log_likelihood))
            sensitivity = s.jacobian
            information += (sensitivity.T * scored.information) @ sensitivity
        return Evaluation(total, self._gradient(vector, information), information)

    def log_likelihoods(self, vectors: FloatArray) -> FloatArray:
        """(candidate,) log likelihoods [-] of several parameter vectors, filtered side by side.

        vectors : (candidate, parameter);  returns NaN for a candidate whose filter diverged

        Source: docs/theory/estimation_statistics.md, equation 32.
        """
        chunks = [slice(i, i + LANES) for i in range(0, len(vectors), LANES)]
        jobs = [(k, c) for k in range(len(self.problem.record_fits)) for c in range(len(chunks))]
        by_job = in_threads(lambda j: self._log_likelihoods_of(*jobs[j], vectors[chunks[jobs[j][1]]]), len(jobs))
        total = np.zeros(len(vectors))
        for (_, c), of_part in zip(jobs, by_job, strict=True):
            total[chunks[c]] += of_part
        return total

    def _gradient(self, vector: FloatArray, information: FloatArray) -> FloatArray:
        """(parameter,) central differences of the log likelihood; one-sided at a bound."""
        parameters, gradient = self.problem.parameters, np.zeros(len(vector))
        precisions = np.diag(information) + np.array([p.sigma**-2.0 for p in parameters])
        moves = []
        for i, (p, precision) in enumerate(zip(parameters, precisions, strict=True)):
            if precision > 0.0:
                # large against the rounding of log L, small against its curvature
                by = STEP / np.sqrt(precision)
                moves.append((i, max(vector[i] - by, p.lower), min(vector[i] + by, p.upper)))
        perturbed = np.tile(vector, (2 * len(moves), 1))
        for row, (i, low, high) in enumerate(moves):
            perturbed[2 * row, i], perturbed[2 * row + 1, i] = low, high
        perturbed_log_likelihoods = self.log_likelihoods(perturbed)
        for row, (i, low, high) in enumerate(moves):
            gradient[i] = (perturbed_log_likelihoods[2 * row + 1] - perturbed_log_likelihoods[2 * row]) / (high - low)
        return gradient

    # Levels of noise -------------------------------------------------------------------------------------------------

    def estimate_levels(self, vector: FloatArray, *, again: bool = False) -> float:
        """Set the levels that are to be estimated to their most likely values, one after another.

        vector  : (parameter,) values about which the parameters are integrated out
        again   : search near the present levels only, within a factor of two
        returns : largest relative change of a level [-]

        Levels: node noise [K s^-1/2], sigma of the ratio [-] and its correlation time [s], sensor noise [K].
        Source: docs/theory/estimation_statistics.md, equation 35.
        """
        before = self.levels
        for level in before.estimated_levels():
            if level not in self.levels.estimated_levels():
                continue
            for width in LATER_RANGES if again else FIRST_RANGES:
                self._search(level, vector, width)
        for (k, number), sigma in self.levels.sigma_K.items():
            self.problem.record_fits[k].sigma_K[number] = sigma
        return _largest_change(before, self.levels)

    def _search(self, level: Level, vector: FloatArray, width: float) -> None:
        """Set one level to the most likely of some multiples of it, 0 among them for noise that may be absent."""
        factors = np.geomspace(1.0 / width, width, LANES - 1)
        if not isinstance(level, tuple) and level != CORRELATION:
            # a correlation time or a sensor's noise cannot be 0
            factors = np.append(0.0, factors)
        tried = [self.levels.scaled(level, float(f)) for f in factors]
        marginals = self._marginals(vector, [self._above_floor(t) for t in tried])
        if not np.any(np.isfinite(marginals)):
            return
        best = int(np.argmax(marginals))
        factor = float(factors[best])
        # no parabola over the step from 0 to the least factor: it is not one in the logarithm
        inner = factors[0] > 0.0 or best > 1
        if 0 < best < len(factors) - 1 and inner and np.all(np.isfinite(marginals[best - 1 : best + 2])):
            a, b, c = marginals[best - 1 : best + 2]
            spacing = np.log(factors[best + 1] / factors[best])
            # vertex of the parabola through the best candidate and its neighbours, in the log of the level
            factor *= float(np.exp(0.5 * spacing * (a - c) / (a - 2.0 * b + c)))
        self.levels = self._above_floor(self.levels.scaled(level, factor))

    def _above_floor(self, levels: Levels) -> Levels:
        """Levels with no sensor below the least noise of one (observation.least_sigma_K)."""
        floor = {
            (k, c.number): least_sigma_K(c.sensor) for k, p in enumerate(self.problem.record_fits) for c in p.channels
        }
        return replace(levels, sigma_K={key: max(s, floor[key]) for key, s in levels.sigma_K.items()})

    def _marginals(self, vector: FloatArray, tried: Sequence[Levels]) -> FloatArray:
        """(level,) log likelihoods, parameters about a vector integrated out; LANES of them at most."""
        by_record = in_threads(lambda k: self._filter_at_levels(k, vector, tried), len(self.problem.record_fits))
        return np.array([self._marginal(vector, of_level) for of_level in zip(*by_record, strict=True)])

    def _marginal(self, vector: FloatArray, filtered: Sequence[Filtered | None]) -> float:
        """Log likelihood of all records with the parameters integrated out; -inf where a filter diverged."""
        parameters = self.problem.parameters
        precisions = np.array([p.sigma**-2.0 for p in parameters])
        g, M = precisions * (np.array([p.value for p in parameters]) - vector), np.diag(precisions)
        total = 0.0
        for record_fit, f in zip(self.problem.record_fits, filtered, strict=True):
            if f is None:
                return -np.inf
            total += float(np.sum(f.log_likelihood))
            record_fit.add(g, f.score())
            record_fit.add(M, f.information())
        s = scale(M)
        # scaled for the determinant's sake; sum(log s) below puts the scale back
        M, g = M * np.outer(s, s), g * s
        sign, log_det = np.linalg.slogdet(M)
        if sign <= 0.0:
            return -np.inf
        return total + 0.5 * float(g @ np.linalg.solve(M, g)) - 0.5 * float(log_det) + float(np.sum(np.log(s)))

    def _filter_at_levels(self, k: int, vector: FloatArray, tried: Sequence[Levels]) -> list[Filtered | None]:
        """A record filtered with sensitivities at several levels; None where its filter diverged."""
        record_fit, march = self.problem.record_fits[k], self._at_levels[k]
        tracks = [self._track(k, vector, levels)[0] for levels in tried]
        # a group of lanes is always full
        tracks += [tracks[-1]] * (LANES - len(tracks))
        if march is None:
            march = self._at_levels[k] = FilterMarch(tracks, record_fit.time_s, self._histories[k])
        march.set_models([record_fit.model_at(vector)] * LANES)
        try:
            return list(march.filter(tracks)[: len(tried)])
        except RunError:
            # one diverged lane fails the group: one march for each finds which
            return [_filter_alone(march, t) for t in tracks[: len(tried)]]

    # Filters ---------------------------------------------------------------------------------------------------------

    def samples(self, vector: FloatArray) -> list[PredictedSamples]:
        """All channels at a parameter vector, as the filter predicts them from the samples before each.

        vector  : (parameter,)
        returns : by channel, mean_K [K], its sensitivities, and the standard deviation of the prediction [K]
        raises  : RunError where a filter diverged

        Source: docs/theory/estimation_statistics.md, equation 32.
        """
        by_record = self._filtered(vector)
        return [s for k, filtered in enumerate(by_record) for s in self._samples_of(k, filtered, vector)]

    def filtered(self, vector: FloatArray, k: int) -> tuple[FilterTrack, Filtered, NDArray[np.int64]]:
        """Filter one record and keep its whole history, as a smoother needs it.

        vector  : (parameter,);  k : number of the record
        returns : the track, the filtered states [K], and the places of its readings among those of its channels
        raises  : RunError where the filter diverged

        The smoother is that of docs/theory/filter.md, after Rauch, Tung and Striebel (1965).
        """
        record_fit = self.problem.record_fits[k]
        track, order = self._track(k, vector, self.levels, sensitive=False)
        march = FilterMarch([track], record_fit.time_s, self._histories[k])
        march.set_models([record_fit.model_at(vector)])
        return track, march.filter(keep=True)[0], order

    def _filtered(self, vector: FloatArray) -> list[Filtered]:
        """Every record filtered with sensitivities; results at the last vector are cached."""
        if self._last is None or self._last[:2] != (vector.tobytes(), self.levels):
            by_record = in_threads(lambda k: self._filter_record(k, vector), len(self.problem.record_fits))
            self._last = (vector.tobytes(), self.levels, by_record)
        return self._last[2]

    def _filter_record(self, k: int, vector: FloatArray) -> Filtered:
        record_fit, track = self.problem.record_fits[k], self._track(k, vector, self.levels)[0]
        march = self._with_sensitivities[k]
        if march is None:
            march = self._with_sensitivities[k] = FilterMarch([track], record_fit.time_s, self._histories[k])
        march.set_models([record_fit.model_at(vector)])
        return march.filter([track])[0]

    def _track(
        self, k: int, vector: FloatArray, levels: Levels, *, sensitive: bool = True
    ) -> tuple[FilterTrack, NDArray[np.int64]]:
        """A record as the filter takes it, and the places of its readings among those of the channels."""
        record_fit = self.problem.record_fits[k]
        values, time_s = record_fit.values(vector), record_fit.sample_s + record_fit.shift_s(vector)
        sigma = {c.number: levels.sigma_K.get((k, c.number), record_fit.sigma_K[c.number]) for c in record_fit.channels}
        samples, order = filter_samples(
            record_fit.channels,
            time_s,
            record_fit.mesh,
            sigma,
            values,
            record_fit.correction_K,
            record_fit.names if sensitive else (),
            lag_offset(record_fit, vector, sensitive=sensitive),
        )
        start, noise = record_fit.start, levels.noise
        columns = np.zeros((record_fit.mesh.nodes, len(record_fit.names) - len(record_fit.march_names)))
        if start is not None:
            columns[:, : start.columns.shape[1]] = start.columns
        track = FilterTrack(
            record_fit.model,
            record_fit.mesh,
            samples,
            record_fit.march_names if sensitive else (),
            record_fit.initial_K(vector),
            columns if sensitive else None,
            None if start is None else start.covariance_K2,
            noise.node_K_sqrt_s**2,
            noise.disturbance,
        )
        return track, order

    def _log_likelihoods_of(
        self, k: int, chunk: int, vectors: FloatArray, levels: Sequence[Levels] | None = None
    ) -> FloatArray:
        """(candidate,) log likelihoods of a record; NaN where its filter diverged."""
        record_fit, padding = self.problem.record_fits[k], LANES - len(vectors)
        noise = [self.levels] * len(vectors) if levels is None else list(levels)
        tracks = [self._track(k, v, n, sensitive=False)[0] for v, n in zip(vectors, noise, strict=True)]
        models = [record_fit.model_at(v) for v in vectors]
        march = self._without_sensitivities.get((k, chunk))
        if march is None:
            march = self._without_sensitivities[k, chunk] = FilterMarch(
                [tracks[0]] * LANES, record_fit.time_s, self._histories[k]
            )
        try:
            march.set_models([*models, *[models[-1]] * padding])
            filtered = march.filter([*tracks, *[tracks[-1]] * padding])
        except RunError:
            return np.array([self._log_likelihood(march, m, t) for m, t in zip(models, tracks, strict=True)])
        return np.array([float(np.sum(f.log_likelihood)) for f in filtered[: len(vectors)]])

    @staticmethod
    def _log_likelihood(march: FilterMarch, model: PointModel, track: FilterTrack) -> float:
        """Log likelihood [-] of the readings for one candidate; NaN where its filter diverged."""
        try:
            march.set_models([model] * LANES)
        except RunError:
            return float("nan")
        filtered = _filter_alone(march, track)
        return float("nan") if filtered is None else float(np.sum(filtered.log_likelihood))

    def _samples_of(self, k: int, filtered: Filtered, vector: FloatArray) -> list[PredictedSamples]:
        """The channels of a record as its filter predicts them."""
        record_fit, order = self.problem.record_fits[k], self._track(k, vector, self.levels, sensitive=False)[1]
        mean, variance = np.empty((2, len(order)))
        sensitivity = np.empty((len(order), len(record_fit.names)))
        mean[order], variance[order] = filtered.predicted_K, filtered.predicted_variance_K2
        sensitivity[order] = filtered.sensitivity
        ends = np.cumsum([len(c.samples) for c in record_fit.channels])[:-1]
        split = zip(record_fit.channels, *(np.split(x, ends) for x in (mean, sensitivity, variance)), strict=True)
        predicted = []
        for c, m, s, v in split:
            sigma = self.levels.sigma_K.get((k, c.number), record_fit.sigma_K[c.number])
            # the filter's variance includes the sensor's own noise; rounding may take the difference below 0
            spread_K = np.sqrt(np.maximum(v - c.noise_K(sigma) ** 2, 0.0))
            time_s = record_fit.sample_s[c.samples]
            predicted.append(PredictedSamples(record_fit, c, time_s, m, s, len(self.problem.unknowns), sigma, spread_K))
        return predicted


def _filter_alone(march: FilterMarch, track: FilterTrack) -> Filtered | None:
    """One track in all lanes; None where its filter diverged."""
    try:
        return march.filter([track] * LANES)[0]
    except RunError:
        return None


def _largest_change(earlier: Levels, later: Levels) -> float:
    """Largest relative change of a level; 1 for one that has become 0."""
    pairs = [(earlier.sigma_K[key], later.sigma_K[key]) for key in earlier.sigma_K]
    pairs += [(getattr(earlier.noise, n), getattr(later.noise, n)) for n in earlier.noise.estimated]
    return max((abs(b / a - 1.0) for a, b in pairs if a > 0.0), default=0.0)


def fit_innovations(
    problem: FitProblem,
    noise: ProcessNoise,
    start: FloatArray,
    on_step: StepCallback = lambda vector, log_posterior: None,
) -> tuple[Fit, Innovations]:
    """The most probable parameters with noise of the process, in turn with its levels where these are estimated.

    problem : parameters, records and samples
    noise   : levels [K s^-1/2], [-], [s], given or first guesses
    start   : (parameter,) values of a fit without process noise
    on_step : called with values and log posterior after every step
    returns : the fit, and the innovations with the levels found; six rounds of levels and parameters at most

    Source: docs/theory/estimation_statistics.md, equations 13, 32 and 35, after Maine and Iliff (1981).
    """
    innovations = Innovations(problem, noise)
    searched = bool(innovations.levels.estimated_levels())
    if searched:
        innovations.estimate_levels(start)
    fit = maximise(innovations.evaluate, problem.parameters, start, innovations.log_likelihoods, SETTINGS, on_step)
    for _ in range(MAX_ROUNDS if searched else 0):
        if not fit.converged or innovations.estimate_levels(fit.values, again=True) < LEVELS_CONVERGED:
            break
        fit = maximise(
            innovations.evaluate, problem.parameters, fit.values, innovations.log_likelihoods, SETTINGS, on_step
        )
    return fit, innovations
