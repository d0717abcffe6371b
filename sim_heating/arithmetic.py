"""Elementary functions for kernels in plain arithmetic: the same bits on every machine, compiler and host."""

from __future__ import annotations

from sim_heating.jit import njit

LN2_HIGH, LN2_LOW = 6.93147180369123816490e-01, 1.90821492927058770002e-10
LARGEST_EXPONENT = 709.0
TERMS = 14
"""Taylor terms of exp on |x| < ln(2)/2: the first one left out is below 1e-17."""


@njit
def exp(x: float) -> float:
    """exp(x), within 2 units in the last place; held at the ends of -709 to 709, so never 0 and never infinite."""
    x = min(max(x, -LARGEST_EXPONENT), LARGEST_EXPONENT)
    k = int(x * 1.4426950408889634 + (0.5 if x >= 0.0 else -0.5))
    r = (x - k * LN2_HIGH) - k * LN2_LOW
    total = 1.0
    for n in range(TERMS, 0, -1):
        total = 1.0 + total * r / n
    base, power, n = (2.0 if k >= 0 else 0.5), 1.0, (k if k >= 0 else -k)
    while n > 0:
        if n % 2 == 1:
            power *= base
        base *= base
        n //= 2
    return total * power


@njit
def logistic(x: float) -> float:
    """1 / (1 + exp(-x)): 0 far below, 1 far above."""
    return 1.0 / (1.0 + exp(-x))
