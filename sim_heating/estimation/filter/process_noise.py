"""What a model of the process lacks, as noise on its state: how much, and which of that is to be found.

    dT_i = ... dt + q dW_i        white noise on every node, q in K s^(-1/2); as dense as the mesh
    r    = ... + d,  cov(d(t), d(t')) = sigma^2 exp(-|t - t'| / tau)        a disturbance of the heating ratio

Levels are looked for one after the other among candidates a common factor apart; a longer correlation time is tried at
the same density 2 sigma^2 / tau, which is what readings tell of most directly.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType

from sim_heating.estimation.filter.march import Disturbance

NODE, RATIO, CORRELATION = "node_K_sqrt_s", "ratio_sigma", "ratio_correlation_s"
Level = str | tuple[int, int]
"""One of the three above, or the noise of a sensor: numbers of its record and of the sensor."""


@dataclass(frozen=True)
class ProcessNoise:
    """Noise of the process; levels that are `estimated` are where their search begins.

    node_K_sqrt_s : q, white noise on every node [K s^(-1/2)]
    ratio_sigma, ratio_correlation_s : sigma [-] and tau [s] of the disturbance of the heating ratio
    """

    node_K_sqrt_s: float = 0.0
    ratio_sigma: float = 0.0
    ratio_correlation_s: float = 30.0
    estimated: tuple[str, ...] = ()

    @property
    def disturbance(self) -> Disturbance:
        """Of the heating ratio."""
        if self.ratio_sigma == 0.0:
            return Disturbance()
        return Disturbance.gauss_markov(self.ratio_sigma, self.ratio_correlation_s)

    def words(self) -> str:
        """The levels in a line."""
        parts = []
        if self.node_K_sqrt_s or NODE in self.estimated:
            parts.append(f"{self.node_K_sqrt_s:.3g} K/sqrt(s) at every node{self._how(NODE)}")
        if self.ratio_sigma or RATIO in self.estimated:
            tau = f" over {self.ratio_correlation_s:.3g} s" if self.ratio_sigma else ""
            parts.append(f"{self.ratio_sigma:.3g} of the heating ratio{tau}{self._how(RATIO)}")
        return f"Process noise: {' and '.join(parts) or 'none'}"

    def _how(self, level: str) -> str:
        return ", as the readings have it" if level in self.estimated else ""


FIRST_GUESS = {NODE: 0.05, RATIO: 0.01}
"""Where the search for a level begins."""


@dataclass(frozen=True)
class Levels:
    """Noise of the process, and that of the sensors that declare none [K], by numbers of record and sensor."""

    noise: ProcessNoise
    sigma_K: Mapping[tuple[int, int], float] = field(default_factory=lambda: MappingProxyType({}))

    def unknown(self) -> list[Level]:
        """What is looked for; a level that was found to be 0 no longer is."""
        own = [name for name in self.noise.estimated if getattr(self.noise, name) > 0.0]
        if self.noise.ratio_sigma == 0.0:
            own = [name for name in own if name != CORRELATION]
        return [*own, *self.sigma_K]

    def scaled(self, level: Level, factor: float) -> Levels:
        """With a level so many times as large."""
        noise = self.noise
        if isinstance(level, tuple):
            return replace(self, sigma_K={**self.sigma_K, level: factor * self.sigma_K[level]})
        if level == CORRELATION:
            tau, sigma = factor * noise.ratio_correlation_s, math.sqrt(factor) * noise.ratio_sigma
            return replace(self, noise=replace(noise, ratio_correlation_s=tau, ratio_sigma=sigma))
        return replace(self, noise=replace(noise, **{level: factor * getattr(noise, level)}))
