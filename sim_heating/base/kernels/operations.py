"""Operations that kernels use and numba does not know, as the interpreter runs them; compiler.py has compiled ones."""

from __future__ import annotations

import math

WHOLE = 1.5 * 2.0**52
"""Added to a number below 2^51 in size it leaves no digits behind the point; its last bits are then the integer."""


def pointer(array):
    """Data of a contiguous array as a kernel takes it: a C pointer when compiled, a flat view when interpreted.

    An exported library passes pointers as well. Indices into a pointer are never counted from its end, unlike those
    into an array: kernels on pointers vectorise across lanes and kernels on arrays do not. A pointer does not keep its
    array: whoever calls the kernel has to.
    """
    return array.reshape(-1)


def power_of_two(k: float) -> float:
    """2^k [-] of a whole number k from -1022 to 1023, given as a float; compiled, its bits are put together."""
    return math.ldexp(1.0, int(k)) if k == k else k


def split(x: float) -> tuple[float, float]:
    """m [-] from 0.5 to below 1 and k with x = m 2^k, for a normal x above 0; compiled, its bits are taken apart."""
    m, k = math.frexp(x)
    return m, float(k)


def call_dispatcher(dispatcher, code, B, c, p, wall_K):
    """dispatcher(code, B, c, p, wall_K) [-]: the effect of a code, through the address of its dispatcher.

    wall_K : wall temperature [K];  code, B, c, p : as in heating/effects/compiled.py

    Interpreted, the dispatcher is the function itself. Passing an address to a kernel costs nothing; passing a function
    object costs 35 us a call.
    """
    return dispatcher(code, B, c, p, wall_K)


def call_effect(kernel, B, c, p, wall_K):
    """kernel(B, c, p, wall_K) [-]: an effect through the address of its kernel when compiled; wall_K [K]."""
    return kernel(B, c, p, wall_K)


def call_step(step, B, J, table, dispatcher, dt):
    """Call step(B, J, table, dispatcher, dt) through its address when compiled, as a function when interpreted; dt [s].

    The large compiled step is made once this way; a loop that called it by name would compile it into itself again.
    """
    step(B, J, table, dispatcher, dt)
