"""The kernels' own exp and log10: digits, ends, and the same bits compiled and interpreted."""

from __future__ import annotations

import math

import mpmath
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from sim_heating.base.kernels.elementary import LARGEST_EXPONENT, SMALLEST, exp, log10, logistic
from sim_heating.base.kernels.jit import njit


@njit
def compiled_exp(x: float) -> float:
    return exp(x)


@njit
def compiled_log10(x: float) -> float:
    return log10(x)


@njit
def compiled_logistic(x: float) -> float:
    return logistic(x)


@given(st.floats(-LARGEST_EXPONENT, LARGEST_EXPONENT))
@example(-LARGEST_EXPONENT)
@example(LARGEST_EXPONENT)
@example(0.5 * math.log(2.0))
@example(5e-324)
def test_exp_is_within_two_units_in_the_last_place(x):
    with mpmath.workdps(40):
        true = mpmath.exp(mpmath.mpf(x))
        assert abs(mpmath.mpf(compiled_exp(x)) - true) <= 2.0 * np.spacing(float(true))


@given(st.floats(SMALLEST, 1.7e308))
@example(1.0)
@example(math.nextafter(1.0, 0.0))
@example(math.nextafter(1.0, 2.0))
@example(math.sqrt(0.5))
@example(1000.0)
@example(1.15)
@example(1.3200544417791649)
def test_log10_is_within_four_units_in_the_last_place(x):
    # The worst of 150,000 drawn, most of them near 1, is 3.2 units off.
    with mpmath.workdps(40):
        true = mpmath.log10(mpmath.mpf(x))
        assert abs(mpmath.mpf(compiled_log10(x)) - true) <= 4.0 * np.spacing(abs(float(true)))


@given(st.floats(-1e308, 1.7e308))
@example(0.0)
@example(5e-324)
def test_log10_is_finite_and_has_the_same_bits_compiled_and_interpreted(x):
    assert math.isfinite(compiled_log10(x))
    assert np.float64(compiled_log10(x)).tobytes() == np.float64(log10.py_func(x)).tobytes()


@given(st.floats(allow_nan=True, allow_infinity=True))
@example(math.nan)
@example(math.inf)
@example(-math.inf)
def test_compiled_and_interpreted_give_the_same_bits(x):
    for compiled, function in ((compiled_exp, exp), (compiled_logistic, logistic)):
        assert np.float64(compiled(x)).tobytes() == np.float64(function.py_func(x)).tobytes()


def test_exp_is_never_zero_and_never_infinite():
    for x in (-math.inf, -1e300, -800.0, 800.0, math.inf):
        assert 0.0 < compiled_exp(x) < math.inf
    assert compiled_logistic(-math.inf) < 1e-300
    assert compiled_logistic(math.inf) == 1.0
    assert math.isnan(compiled_exp(math.nan))


@pytest.mark.parametrize("x", [-300.0, -1.0, 0.0, 2.5, 300.0])
def test_logistic_and_its_mirror_image_add_up_to_one(x):
    assert compiled_logistic(x) + compiled_logistic(-x) == pytest.approx(1.0, abs=1e-15)
