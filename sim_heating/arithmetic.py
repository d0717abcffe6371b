"""Elementary functions for kernels in plain arithmetic: the same bits on every machine, compiler and host."""

from __future__ import annotations

from sim_heating.jit import WHOLE, inlined, power_of_two

LN2_HIGH, LN2_LOW, LOG2_E = 6.93147180369123816490e-01, 1.90821492927058770002e-10, 1.4426950408889634
LARGEST_EXPONENT = 708.0
TERMS = 14
"""Taylor terms of exp on |x| < ln(2)/2: the first one left out is below 1e-17."""


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
def logistic(x: float) -> float:
    """1 / (1 + exp(-x)): 0 far below, 1 far above."""
    return 1.0 / (1.0 + exp(-x))
