"""Influence of a clock on a coating: the fitted thickness where the thermocouple has an undeclared lead or lag.

The founding paper found that a lead of a second makes the coating of a tile negative. A factor of the thickness cannot
be negative: the leads at which it nears zero are fitted, and the last two are extrapolated linearly to the lead at
zero.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.measure import Figure, save
from sim_heating.base.parameters import CLOCK_SKEW, COMMON_LAG, MODEL
from sim_heating.base.report.figure import new_figure, save_figure
from sim_heating.estimation.fit import FitResult, estimate
from tests.support.tile import NOISE_8_BIT, Tile, record

PICTURE = Path(__file__).parent.parent / "docs" / "images" / "skew_coating.png"
COATINGS_MIL = (10.0, 15.0, 20.0)
SURFACES_K = (700.0, 1100.0, 1300.0)
COATING = "stack.coating.thickness_factor"
NAMES = ("ratio.d0", "ratio.d_alpha", COATING)
FLAT = {COATING: replace(MODEL[COATING], sigma=math.inf)}
COLORS = ("tab:blue", "tab:orange", "tab:green")
DOUBLETS_S = (40.0, 20.0)
LAGS_S = (-0.25, 0.25, 0.5)
THIN = 0.12
"""Thickness factor below which leads are not taken further."""
PARTS = (0.5, 0.8, 0.95, 1.1, 1.25, 1.4)
"""Leads tried, over the lead at which a straight line through small skews is zero."""


@dataclass(frozen=True, eq=False)
class Curve:
    """Skews [s] in increasing order, the factor fitted at each, and the residual's RMS [K]."""

    tile: Tile
    skew_s: np.ndarray
    factor: np.ndarray
    rms_K: np.ndarray

    @property
    def mil_per_s(self) -> float:
        """Thickness per second of skew, about zero skew."""
        near = np.isin(self.skew_s, LAGS_S[:2])
        return float(self.tile.coating_mil * np.ptp(self.factor[near]) / np.ptp(self.skew_s[near]))

    @property
    def zero_s(self) -> float:
        """Lead [s] at which the thickness is zero, by the line through the two longest leads."""
        (a, b), (fa, fb) = self.skew_s[:2], self.factor[:2]
        return float(-(a - fa * (b - a) / (fb - fa)))


def fitted_factor(tile: Tile) -> tuple[float, float]:
    """Thickness factor of a fit without skew, and the RMS [K] of its residual."""
    fit = estimate([record(tile)], NAMES, priors=FLAT)
    residual = fit.after[0].residual_K[0][fit.after[0].record.fit_mask()]
    return float(fit.fit.values[fit.labels.index(COATING)]), float(np.sqrt(np.mean(residual**2)))


def curve(tile: Tile) -> Curve:
    """Factors from half a second of lag to the lead at which the coating all but vanishes."""
    found = {s: fitted_factor(replace(tile, skew_s=s)) for s in LAGS_S}
    found[0.0] = (1.0, 0.0)
    straight = (LAGS_S[1] - LAGS_S[0]) / (found[LAGS_S[1]][0] - found[LAGS_S[0]][0])
    for part in PARTS:
        lead = part * straight
        found[-lead] = fitted_factor(replace(tile, skew_s=-lead))
        if found[-lead][0] < THIN:
            break
    skews = sorted(found)
    if found[skews[0]][0] <= 2.0 * MODEL[COATING].lower:  # on its bound: no point of the curve
        skews = skews[1:]
    return Curve(tile, np.array(skews), *np.array([found[s] for s in skews]).T)


def both_estimated() -> FitResult:
    """Skew and coating together, with their priors, from a noisy record with an 8-bit word."""
    return estimate([record(replace(NOISE_8_BIT, skew_s=0.3))], (*NAMES, CLOCK_SKEW.name))


def lag_and_skew(period_s: float) -> FitResult:
    """A lag of 2 s estimated with a skew, both without prior, from a noisy record of a doublet of a period [s]."""
    tile = replace(NOISE_8_BIT, tau_s=2.0, period_s=period_s)
    bounded = (replace(CLOCK_SKEW, lower=-5.0, upper=5.0), replace(COMMON_LAG, upper=10.0))
    flat = {p.name: replace(p, sigma=math.inf) for p in bounded}
    return estimate([record(tile)], ("ratio.d0", "ratio.d_alpha", *flat), priors=flat)


def draw(path: Path, curves: list[Curve]) -> None:
    """A panel a temperature: fitted coating against skew, extrapolated to zero thickness."""
    figure, axes = new_figure(11.0, 4.2, 1, len(SURFACES_K), sharey=True)
    for a, surface in zip(axes, SURFACES_K, strict=True):
        for c, color in zip((c for c in curves if c.tile.surface_K == surface), COLORS, strict=True):
            mil, zero = c.tile.coating_mil, -c.zero_s
            a.plot(
                c.skew_s, mil * c.factor, "o-", color=color, markersize=3, label=f"{mil:g} mil: none at {zero:.2f} s"
            )
            a.plot([zero, c.skew_s[0]], [0.0, mil * c.factor[0]], "--", color=color)
            a.plot(zero, 0.0, "x", color=color)
        a.axhline(0.0, color="0.3", linewidth=0.8)
        a.set_xlabel("skew, s (thermocouple leads < 0 < lags)")
        a.set_title(f"surface at {surface:g} K", fontsize=10)
        a.legend(fontsize=8, loc="upper left")
    axes[0].set_ylabel("coating found, mil")
    save_figure(figure, path, "Coating that a fit finds where the thermocouple's clock is skewed", axes)


def run() -> list[Figure]:
    """The curves of all coatings and temperatures, then skew and coating together."""
    curves = [curve(Tile(coating_mil=mil, surface_K=K)) for K in SURFACES_K for mil in COATINGS_MIL]
    draw(PICTURE, curves)
    figures = []
    for c in curves:
        name = f"{c.tile.coating_mil:g} mil at {c.tile.surface_K:g} K"
        figures.append(Figure(f"{name}: lead at which the coating found is none", c.zero_s, "s"))
        note = f"residual RMS at the longest lead {c.rms_K[0]:.2f} K"
        figures.append(Figure(f"{name}: one second of skew", c.mil_per_s, "mil", note=note))
    fit = both_estimated()
    i, j = fit.labels.index(COATING), fit.labels.index(CLOCK_SKEW.name)
    value, sigma = fit.fit.values[j], fit.bounds.sigma[j]
    note = (
        f"skew {value:.2f} +- {sigma:.2f} s for 0.30, factor {fit.fit.values[i]:.2f} +- {fit.bounds.sigma[i]:.2f} for 1"
    )
    figures.append(Figure("both with priors: correlation of coating and skew", fit.correlation[i, j], "", note=note))
    for period_s in DOUBLETS_S:
        fit = lag_and_skew(period_s)
        i, j = (fit.labels.index(p.name) for p in (CLOCK_SKEW, COMMON_LAG))
        note = f"lag {fit.fit.values[j]:.2f} s for 2, correlation with the skew {fit.correlation[i, j]:.2f}"
        figures.append(Figure(f"{period_s:g} s doublet: sigma of the lag", fit.bounds.sigma[j], "s", note=note))
    save("skew", figures)
    return figures
