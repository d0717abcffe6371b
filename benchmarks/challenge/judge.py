"""How visible a deviation is, and which effects resemble it, by linear estimates.

Readings are taken as linear in scale, slopes and the size of a deviation, and weighted with each thermocouple's noise
floor, what the model does not know besides (world.py) being further noise, correlated; marches have steps of a second
and a third of the elements: enough for differences. A rival explains a deviation where chi-square + k log n, with k its
parameters, is less than 10 above that of the truth. Its parameters are the best of some draws and of some changes of
the best draw: a rival that a full fit brings close may be missed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from benchmarks.challenge.case import COARSE_S, Case
from benchmarks.challenge.deviation import NOTHING, Deviation
from benchmarks.challenge.form import Drawn, Family, Unsuitable, draw
from benchmarks.challenge.point import SLOPES
from benchmarks.challenge.recorder import floor_K, used

FloatArray = NDArray[np.float64]
Generator = np.random.Generator

DRAWS, CHANGES = 5, 5
"""Draws of a rival's parameters, and changes of the best of them."""
NEAR = 0.5
"""Part of the chi-square of `none` that the best draw may leave for its parameters to be changed."""
BIC = 10.0
"""Difference of BIC below which two explanations cannot be distinguished."""


@dataclass(frozen=True)
class Bench:
    """A case as recorded, at the fitted samples of its used thermocouples.

    t, fit  : (sample,) times and which are fitted
    unknown : (reading, mode) responses over the floors to one standard deviation of each error that the model of the
              record has besides the noise; None where it has none
    """

    case: Case
    t: FloatArray
    fit: NDArray[np.bool_]
    unknown: FloatArray | None = None

    @cached_property
    def floors(self) -> FloatArray:
        """Noise floor of each used thermocouple [K]."""
        sensors = self.case.point.sensors
        return np.array([floor_K(sensors[i]) for i in used(sensors)])

    def over_floors(self, K: FloatArray) -> FloatArray:
        """(reading,) of (sample, sensor) temperatures, over the floors; 0 of what is lost."""
        return np.nan_to_num((K[self.fit][:, used(self.case.point.sensors)] / self.floors).T.ravel())

    @cached_property
    def _modes(self) -> tuple[FloatArray, FloatArray]:
        """Orthonormal modes of the unknown errors, and by how much a reading along each is shortened."""
        U, size, _ = np.linalg.svd(np.asarray(self.unknown), full_matrices=False)
        return U, 1.0 - 1.0 / np.sqrt(1.0 + size**2)

    def stacked(self, K: FloatArray) -> FloatArray:
        """(reading,) of (sample, sensor) temperatures, over noise: C^(-1/2) times them over the floors, C = 1 + G G^T.

        G : `unknown`; floors alone where there is none
        """
        v = self.over_floors(K)
        if self.unknown is None:
            return v
        U, shorter = self._modes
        return np.asarray(v - U @ (shorter * (U.T @ v)))

    @cached_property
    def plain_K(self) -> FloatArray:
        """(sample, sensor) readings of the recorded flight without deviation."""
        return self.case.at(COARSE_S).indicated(self.t)

    @cached_property
    def basis(self) -> FloatArray:
        """(reading, 6) orthonormal directions of scale and slopes."""
        history, ratio = self.case.at(COARSE_S), self.case.ratio
        columns = [history.indicated(self.t, scale=ratio.scale + 0.01) - self.plain_K]
        for i, share in enumerate(SLOPES):
            d = ratio.d.copy()
            d[i] += share * self.case.r_0
            columns.append(history.indicated(self.t, d=d) - self.plain_K)
        J = np.column_stack([self.stacked(c) for c in columns])
        size = np.linalg.norm(J, axis=0)
        return np.asarray(np.linalg.qr(J[:, size > 1e-6] / size[size > 1e-6])[0])

    def readings_K(self, drawn: Sequence[Drawn], true: bool = True) -> FloatArray:
        """(sample, sensor) readings with deviations, of the true flight or of the recorded one."""
        history = self.case.at(COARSE_S, true)
        deviation = sum((d.deviation(history) for d in drawn), NOTHING)
        return finished(self.t, history.indicated(self.t, deviation), deviation)

    def change(self, drawn: Sequence[Drawn], true: bool = True) -> FloatArray:
        """(reading,) change by deviations, over the floors."""
        return self.stacked(self.readings_K(drawn, true) - self.plain_K)

    def beyond_scale(self, change: FloatArray) -> float:
        """Chi-square of a change after least squares with the scale alone."""
        first = self.basis[:, 0]
        left = change - first * float(first @ change)
        return float(left @ left)

    def remainder(self, change: FloatArray, *others: FloatArray) -> FloatArray:
        """(reading,) of a change after least squares with scale and slopes, and the sizes of others."""
        Q = self.basis
        left = change - Q @ (Q.T @ change)
        for other in others:
            beyond = other - Q @ (Q.T @ other)
            size = float(np.linalg.norm(beyond))
            if size > 1e-9:
                Q = np.column_stack((Q, beyond / size))
                left = left - Q[:, -1] * float(Q[:, -1] @ left)
        return np.asarray(left)


def finished(t: FloatArray, K: FloatArray, deviation: Deviation) -> FloatArray:
    """Readings with what happens to them after the recorder."""
    for change in deviation.after:
        K = change(t, K)
    return K


def over_floor(left: FloatArray) -> float:
    """RMS of a remainder where it exceeds two floors; 0 below ten samples."""
    acts = np.abs(left) > 2.0
    return float(np.sqrt(np.mean(left[acts] ** 2))) if np.count_nonzero(acts) >= 10 else 0.0


def log_evidence(chi_square: float, parameters: int) -> float:
    """Logarithm of the evidence of a true form over that of none, by a linear estimate.

        ln B = (chi^2 - k ln(1 + chi^2)) / 2

    chi_square : of the deviation after a refit of scale and slopes, over the true noise
    parameters : k, each of which a prior as wide as its effect is long has (Kass and Raftery 1995, J. Am. Stat. Assoc.
                 90, 773: the Laplace approximation with such priors)
    """
    return 0.5 * (chi_square - parameters * float(np.log1p(chi_square)))


def count(drawn: Drawn) -> int:
    """Parameters of a form that a fit would have to find."""
    return sum(isinstance(v, float) for v in drawn.parameters.values())


def accepted(
    rng: Generator,
    bench: Bench,
    change: FloatArray,
    others: Sequence[FloatArray],
    own: int,
    names: Sequence[str],
    families: Sequence[Family],
) -> dict[str, float]:
    """Rivals by name, with their BIC above that of the truth, where it is less than BIC; `none` may be one.

    own   : parameters of the truth
    names : of the truth, which are no rivals
    """
    left = bench.remainder(change, *others)
    square, log_n = float(left @ left), float(np.log(len(left)))
    found = {"none": square - own * log_n}
    for family in families:
        if family.name in names:
            continue
        best = _closest(rng, bench, family, left, others)
        if best is not None:
            found[family.name] = best[0] + (count(best[1]) - own) * log_n
    return {name: round(value, 1) for name, value in found.items() if value < BIC}


def _closest(
    rng: Generator, bench: Bench, family: Family, left: FloatArray, others: Sequence[FloatArray]
) -> tuple[float, Drawn] | None:
    """The least chi-square that a family leaves, and its parameters."""
    best: tuple[float, Drawn] | None = None
    for turn in range(DRAWS + CHANGES):
        try:
            if turn < DRAWS:
                drawn = draw(rng, family, bench.case, family.forms[turn % len(family.forms)])
            elif best is None or best[0] > NEAR * float(left @ left):
                break
            else:
                drawn = best[1].nearby(rng, 0.08)
            signal = bench.remainder(bench.change([drawn], true=False), *others)
        except Unsuitable:
            continue
        size = float(signal @ signal)
        if not np.isfinite(size) or size < 1e-9:
            continue
        rest = float(left @ left) - float(left @ signal) ** 2 / size
        if best is None or rest < best[0]:
            best = (rest, drawn)
    return best
