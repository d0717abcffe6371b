"""Elementary functions for kernels in plain arithmetic, with equal bits on every machine, compiler and host; and a test
of all lanes at once.

The C library's exp and log10 differ in the last bit between platforms, and a call keeps a loop from being vectorised.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sim_heating.base.kernels.block import LANES
from sim_heating.base.kernels.jit import force_inline
from sim_heating.base.kernels.operations import WHOLE, power_of_two, split

LN2_HIGH, LN2_LOW, LOG2_E = 6.93147180369123816490e-01, 1.90821492927058770002e-10, 1.4426950408889634
LN_10 = 2.302585092994046
LARGEST_EXPONENT = 708.0
TAYLOR = tuple(1.0 / math.factorial(n) for n in range(15))
"""Taylor coefficients of exp, 1 / n! [-], for |x| < ln(2)/2: the first omitted term is below 1e-18."""
LOG10_2_HIGH, LOG10_2_LOW, LOG10_E = 0.3010299955494702, 1.1451100898021838e-10, 0.4342944819032518
SQRT_HALF = 0.7071067811865476
SMALLEST = 2.0**-1022
LOG_TERMS = 10
"""Terms of log(m) = 2 (s + s^3/3 + ...), s = (m - 1) / (m + 1), after the first, on |s| < 0.172: the first omitted
one is below 1e-18."""


@force_inline
def exp(x: float) -> float:
    """Exponential exp(x) of a number [-], within 2 units in the last place.

    x = k ln 2 + r with |r| < ln(2)/2, ln 2 in two parts (Cody and Waite 1980); exp(r) by 14 Taylor terms.
    Arguments are limited to -708 to 708, so that the result is never 0 and never infinite.
    No branch and no call: a loop over lanes vectorises.
    """
    x = min(max(x, -LARGEST_EXPONENT), LARGEST_EXPONENT)
    # Adding and subtracting WHOLE rounds to a whole number without a call.
    k = (x * LOG2_E + WHOLE) - WHOLE
    r = (x - k * LN2_HIGH) - k * LN2_LOW
    # In pairs and pairs of pairs (Estrin 1960): a call waits for a third of the additions of Horner's scheme.
    square = r * r
    fourth = square * square
    low = (TAYLOR[2] + TAYLOR[3] * r) + (TAYLOR[4] + TAYLOR[5] * r) * square
    middle = (TAYLOR[6] + TAYLOR[7] * r) + (TAYLOR[8] + TAYLOR[9] * r) * square
    high = (TAYLOR[10] + TAYLOR[11] * r) + (TAYLOR[12] + TAYLOR[13] * r + TAYLOR[14] * square) * square
    total = 1.0 + (r + square * (low + (middle + high * fourth) * fourth))
    return total * power_of_two(k)


@force_inline
def log10(x: float) -> float:
    """Decimal logarithm log10(x) of a finite number [-], within 4 units in the last place; constant below 2^-1022.

    x = 2^k m with m from sqrt(1/2) to sqrt(2); log(m) = 2 (s + s^3/3 + s^5/5 + ...), s = (m - 1) / (m + 1), 11 terms.
    The logarithm of 2 is added in two parts (Cody and Waite 1980). No branch and no call: a loop over lanes vectorises.
    """
    m, k = split(max(x, SMALLEST))
    # Mantissas below sqrt(1/2) are doubled: s is then at most 0.172 on either side, and 11 terms are enough.
    small = 1.0 if m < SQRT_HALF else 0.0
    m, k = m + small * m, k - small
    s = (m - 1.0) / (m + 1.0)
    square = s * s
    total = 0.0
    for n in range(LOG_TERMS, 0, -1):
        total = square * (1.0 / (2 * n + 1) + total)
    # The small parts are summed before the large one, which costs the least rounding.
    return k * LOG10_2_HIGH + (k * LOG10_2_LOW + (2.0 * LOG10_E) * (s + s * total))


@force_inline
def logistic(x: float) -> float:
    """Logistic function 1 / (1 + exp(-x)) [-]: 0 far below, 1 far above; S of docs/theory/equations.md, equation 19."""
    return 1.0 / (1.0 + exp(-x))


@force_inline
def lanes_outside(B: NDArray[np.float64], x: int, low: int, high: int) -> int:
    """Number of pairs of lanes with a value outside its bounds, low <= x < high.

    B            : block of a lane group
    x, low, high : where the rows of values and bounds begin, all three in one unit
    returns      : 0 where every lane is inside; a value that is not a number counts as outside

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
