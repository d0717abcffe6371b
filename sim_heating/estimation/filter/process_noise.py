"""Levels of process noise, which stands for the errors of the process model: given, or to be estimated.

    dT_i = ... dt + q dW_i        white noise on every node, q in K s^(-1/2); as dense as the mesh
    r    = ... + d,  cov(d(t), d(t')) = sigma^2 exp(-|t - t'| / tau)        a disturbance of the heating ratio

(docs/theory/estimation_statistics.md, equation 34.) Levels are searched one after the other among candidates a common
factor apart; a longer correlation time is tried at the same density 2 sigma^2 / tau, which readings determine most
directly.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType

from sim_heating.estimation.filter.march import Disturbance

NODE, RATIO, CORRELATION = "node_K_sqrt_s", "ratio_sigma", "ratio_correlation_s"
Level = str | tuple[int, int]
"""One of the three names above, or the noise of a sensor: numbers of its record and of the sensor."""


@dataclass(frozen=True)
class ProcessNoise:
    """Noise of the process; levels that are `estimated` are where their search begins.

    node_K_sqrt_s : q, white noise on every node [K s^(-1/2)]
    ratio_sigma, ratio_correlation_s : sigma [-] and tau [s] of the disturbance of the heating ratio
    estimated     : names of the levels that are estimated

    Source: docs/theory/estimation_statistics.md, equation 34.
    """

    node_K_sqrt_s: float = 0.0
    ratio_sigma: float = 0.0
    ratio_correlation_s: float = 30.0
    estimated: tuple[str, ...] = ()

    @property
    def disturbance(self) -> Disturbance:
        """Gauss-Markov disturbance of the heating ratio, sigma [-] and correlation time [s]; none where sigma is 0.

        Source: docs/theory/estimation_statistics.md, equation 34.
        """
        if self.ratio_sigma == 0.0:
            return Disturbance()
        return Disturbance.gauss_markov(self.ratio_sigma, self.ratio_correlation_s)

    def summary(self) -> str:
        """One line for a report: the levels, and which of them are estimated; node noise in K/sqrt(s), tau [s]."""
        parts = []
        if self.node_K_sqrt_s or NODE in self.estimated:
            parts.append(f"{self.node_K_sqrt_s:.3g} K/sqrt(s) at every node{self._how(NODE)}")
        if self.ratio_sigma or RATIO in self.estimated:
            tau = f" over {self.ratio_correlation_s:.3g} s" if self.ratio_sigma else ""
            parts.append(f"{self.ratio_sigma:.3g} of the heating ratio{tau}{self._how(RATIO)}")
        return f"Process noise: {' and '.join(parts) or 'none'}"

    def _how(self, level: str) -> str:
        return ", estimated" if level in self.estimated else ""


FIRST_GUESS = {NODE: 0.05, RATIO: 0.01}
"""Where the search for a level begins, in K s^(-1/2) and [-]."""


@dataclass(frozen=True)
class Levels:
    """Noise of the process, and noise [K] of the sensors that declare none, by numbers of record and sensor."""

    noise: ProcessNoise
    sigma_K: Mapping[tuple[int, int], float] = field(default_factory=lambda: MappingProxyType({}))

    def estimated_levels(self) -> list[Level]:
        """Levels that are to be estimated; one that was found to be 0 is no longer searched.

        The search is that of docs/theory/estimation_statistics.md, equation 35.
        """
        names = [name for name in self.noise.estimated if getattr(self.noise, name) > 0.0]
        if self.noise.ratio_sigma == 0.0:
            # without a disturbance its correlation time has no meaning
            names = [name for name in names if name != CORRELATION]
        return [*names, *self.sigma_K]

    def scaled(self, level: Level, factor: float) -> Levels:
        """Levels with one of them multiplied by a factor.

        level   : name of a level of the process [K s^-1/2], [-], [s], or numbers of record and sensor [K]
        factor  : [-], 0 only for a level that may be absent
        returns : new levels; with a correlation time multiplied by f, sigma is multiplied by sqrt(f), so that the
                  density 2 sigma^2 / tau stays

        Source: docs/theory/estimation_statistics.md, equations 34 and 35.
        """
        noise = self.noise
        if isinstance(level, tuple):
            return replace(self, sigma_K={**self.sigma_K, level: factor * self.sigma_K[level]})
        if level == CORRELATION:
            tau, sigma = factor * noise.ratio_correlation_s, math.sqrt(factor) * noise.ratio_sigma
            return replace(self, noise=replace(noise, ratio_correlation_s=tau, ratio_sigma=sigma))
        return replace(self, noise=replace(noise, **{level: factor * getattr(noise, level)}))
