"""Elementary functions for kernels in plain arithmetic, the same bits on every machine, compiler and host; and one test
of all lanes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sim_heating.base.kernels.block import LANES
from sim_heating.base.kernels.jit import WHOLE, inlined, power_of_two, split

LN2_HIGH, LN2_LOW, LOG2_E = 6.93147180369123816490e-01, 1.90821492927058770002e-10, 1.4426950408889634
LARGEST_EXPONENT = 708.0
TERMS = 14
"""Taylor terms of exp on |x| < ln(2)/2: the first one left out is below 1e-17."""
LOG10_2_HIGH, LOG10_2_LOW, LOG10_E = 0.3010299955494702, 1.1451100898021838e-10, 0.4342944819032518
SQRT_HALF = 0.7071067811865476
SMALLEST = 2.0**-1022
LOG_TERMS = 10
"""Terms of log(m) = 2 (s + s^3/3 + ...), s = (m - 1) / (m + 1), behind the first, on |s| < 0.172: the first one left
out is below 1e-18."""


@inlined
def exp(x: float) -> float:
    """exp(x), within 2 units in the last place; held at the ends of -708 to 708, so never 0 and never infinite.

    No branch and no call: lanes go together.
    """
    x = min(max(x, -LARGEST_EXPONENT), LARGEST_EXPONENT)
    k = (x * LOG2_E + WHOLE) - WHOLE
    r = (x - k * LN2_HIGH) - k * LN2_LOW
    total = 1.0
    for n in range(TERMS, 0, -1):
        total = 1.0 + total * (r * (1.0 / n))
    return total * power_of_two(k)


@inlined
def log10(x: float) -> float:
    """log10(x) of a finite number, within 2 units in the last place; below 2^-1022 that of 2^-1022.

    No branch and no call: lanes go together.
    """
    m, k = split(max(x, SMALLEST))
    small = 1.0 if m < SQRT_HALF else 0.0
    m, k = m + small * m, k - small
    s = (m - 1.0) / (m + 1.0)
    square = s * s
    total = 0.0
    for n in range(LOG_TERMS, 0, -1):
        total = square * (1.0 / (2 * n + 1) + total)
    return k * LOG10_2_HIGH + (k * LOG10_2_LOW + (2.0 * LOG10_E) * (s + s * total))


@inlined
def logistic(x: float) -> float:
    """1 / (1 + exp(-x)): 0 far below, 1 far above."""
    return 1.0 / (1.0 + exp(-x))


@inlined
def lanes_outside(B: NDArray[np.float64], x: int, low: int, high: int) -> int:
    """Number of pairs of lanes in which the row at B[x] is not from the row at B[low] to below that at B[high].

    A lane is paired with the one half a row away, and nothing branches: that compiles to a few vector instructions, and
    neither eight lanes one by one nor a test with `and` does.
    """
    half, outside = LANES // 2, 0
    for lane in range(half):
        a, b = B[x + lane], B[x + half + lane]
        here = (a >= B[low + lane]) & (a < B[high + lane])
        there = (b >= B[low + half + lane]) & (b < B[high + half + lane])
        outside += 0 if here & there else 1
    return outside
