"""Measured temperatures to the heating that the model lacks: a correction history of the heating ratio with its sigma.

The inverse heat-conduction problem as state estimation. The ratio carries a disturbance d (filter_march.Disturbance), a
first-order Gauss-Markov process of covariance sigma^2 exp(-|t| / tau), constant over a step; given all readings,
smoothing.py gives its mean and variance. What regularises is the noise model: of the density q = 2 sigma^2 / tau and
the correlation time tau, those of the largest likelihood of the innovations are taken, by a search over decades.

Bandwidth: with v the variance that is left at a time, the frequency f above which the process has just this variance,

    v / sigma^2 = 1 - (2 / pi) atan(2 pi f tau),

not above half the rate of the steps: slower changes are seen as if all known, faster ones as if none. 0 where
the readings tell nothing.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sim_heating.filter_march import Disturbance, FilterMarch, FilterTrack
from sim_heating.layout import LANES
from sim_heating.smoothing import smooth

FloatArray = NDArray[np.float64]

DENSITIES_1_S = (1e-10, 1e-3)
"""Between these the density is looked for [1/s]: below, a ratio walks 3e-4 in a quarter of an hour."""
CORRELATION_S = 30.0
"""The correlation time that the search starts from [s]; it ends between a step and the length of the march."""
FIRST_STRIDE, LAST_STRIDE = (1.0, 1.0), 0.15
"""Strides of the search in the logarithms of density and correlation time: first, and below which it ends."""


@dataclass(frozen=True, eq=False)
class UnknownInput:
    """The correction that the readings ask for.

    time_s       : (step,) middles of the steps
    delta_ratio  : (step,) what is to be added to the ratio, before effects that multiply it
    sigma        : (step,) its standard deviation given all readings
    bandwidth_Hz : (step,) frequency up to which it is resolved
    disturbance  : what the likelihood chose
    gain_log_likelihood : log likelihood above that without a disturbance
    temperature_K : (time, node) smoothed temperatures at the ends of the steps, the start first
    """

    time_s: FloatArray
    delta_ratio: FloatArray
    sigma: FloatArray
    bandwidth_Hz: FloatArray
    disturbance: Disturbance
    gain_log_likelihood: float
    temperature_K: FloatArray


def unknown_input(
    track: FilterTrack, time_s: FloatArray, histories: FloatArray, disturbance: Disturbance | None = None
) -> UnknownInput:
    """The heating-ratio history that explains a point's readings.

    track       : the point with readings and start; its own disturbance is not used
    time_s      : (time,) steps [s], of which each has one correction;  histories : (flight, time, condition)
    disturbance : the noise model of the correction; by the largest likelihood, where None
    raises      : as FilterMarch.filter
    """
    if disturbance is None:
        disturbance = likeliest(track, time_s, histories)
    march = FilterMarch([replace(track, disturbance=d) for d in (disturbance, Disturbance())], time_s, histories)
    found, without = march.filter(keep=True)
    smoothed = smooth(found)
    sigma, dt = smoothed.ratio_sigma[:-1], np.diff(time_s)
    return UnknownInput(
        0.5 * (time_s[1:] + time_s[:-1]), smoothed.ratio[:-1], sigma,
        np.minimum(bandwidth_Hz(disturbance, sigma), 0.5 / dt), disturbance,
        float(np.sum(found.log_likelihood) - np.sum(without.log_likelihood)), smoothed.temperature_K,
    )  # fmt: skip


def bandwidth_Hz(disturbance: Disturbance, sigma: FloatArray) -> FloatArray:
    """Frequency [Hz] above which the process has the variance that is left; of a random walk, q / (2 pi^2 v)."""
    left = np.maximum(sigma**2, 1e-300)
    if math.isinf(disturbance.correlation_s):
        return disturbance.density_1_s / (2.0 * np.pi**2 * left)
    stationary = 0.5 * disturbance.density_1_s * disturbance.correlation_s
    told = np.clip(1.0 - left / stationary, 0.0, 1.0 - 1e-12)
    return np.tan(0.5 * np.pi * told) / (2.0 * np.pi * disturbance.correlation_s)


def likeliest(track: FilterTrack, time_s: FloatArray, histories: FloatArray) -> Disturbance:
    """The stationary disturbance of the largest likelihood: decades of the density first, then a pattern search, each
    step of which tries the eight neighbours in one march."""
    march = FilterMarch([track] * LANES, time_s, histories)
    low = np.log([DENSITIES_1_S[0], float(np.min(np.diff(time_s)))])
    high = np.log([DENSITIES_1_S[1], float(time_s[-1] - time_s[0])])
    within = np.clip(np.log([1.0, CORRELATION_S])[1], low[1], high[1])
    tried = [np.array([density, within]) for density in np.linspace(low[0], high[0], LANES)]
    best, largest = _best(march, track, tried)
    stride = np.array(FIRST_STRIDE)
    while np.max(stride) > LAST_STRIDE:
        around = [np.array([i, j]) for i in (-1, 0, 1) for j in (-1, 0, 1) if (i, j) != (0, 0)]
        there, value = _best(march, track, [np.clip(best + stride * a, low, high) for a in around])
        if value > largest:
            best, largest = there, value
        else:
            stride = 0.5 * stride
    return _disturbance(best)


def _disturbance(logs: FloatArray) -> Disturbance:
    density, correlation_s = np.exp(logs)
    return Disturbance.gauss_markov(math.sqrt(0.5 * density * correlation_s), float(correlation_s))


def _best(march: FilterMarch, track: FilterTrack, tried: Sequence[FloatArray]) -> tuple[FloatArray, float]:
    found = march.filter([replace(track, disturbance=_disturbance(logs)) for logs in tried])
    values = [float(np.sum(f.log_likelihood)) for f in found]
    k = int(np.argmax(values))
    return tried[k], values[k]
