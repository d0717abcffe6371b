"""First-order lag of a history: of a heating ratio, of a thermocouple, of the pressure in a porous insulation.

    tau dy/dt = x - y

The update over a step is exact for an x that is linear in time over it, so that time constants far below the step need
no substeps. docs/theory/equations.md, equation 8.
"""

from __future__ import annotations

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.kernels.elementary import exp
from sim_heating.base.kernels.jit import force_inline, njit


@force_inline
def lag_step(y_0: float, x_0: float, x_1: float, steps: float) -> float:
    """Lagging value at the end of a step in which the value that it follows goes linearly from x_0 to x_1.

        y_1 = x_1 - b + (y_0 - x_0 + b) exp(-s),    s = dt / tau,  b = (x_1 - x_0) / s

    y_0     : lagging value at the start of the step
    steps   : s, length of the step over the time constant [-], above 0

    Source: docs/theory/equations.md, equation 8.
    """
    behind = (x_1 - x_0) / steps
    return x_1 - behind + (y_0 - x_0 + behind) * exp(-steps)


@njit
def lag_columns(time_s: FloatArray, x: FloatArray, tau_s: float, at_rest: bool) -> FloatArray:
    """Histories behind a first-order lag, each column by itself.

    time_s  : (time,) increasing [s]
    x       : (time, column) histories, linear between the times
    tau_s   : time constant [s]; 0 for no lag
    at_rest : whether y = x at the first time; else y starts as behind a ramp of the first interval's slope
    returns : (time, column)

    Source: docs/theory/equations.md, equation 8.
    """
    y = x.copy()
    if tau_s <= 0.0 or len(time_s) < 2:
        return y
    for k in range(x.shape[1]):
        if not at_rest:
            y[0, k] -= tau_s * (x[1, k] - x[0, k]) / (time_s[1] - time_s[0])
        for i in range(1, len(time_s)):
            y[i, k] = lag_step(y[i - 1, k], x[i - 1, k], x[i, k], (time_s[i] - time_s[i - 1]) / tau_s)
    return y


@njit
def lag_per_constant(time_s: FloatArray, x: FloatArray, y: FloatArray, tau_s: float, at_rest: bool) -> FloatArray:
    """Derivative of a lagging history to its time constant.

        dy_1 = -m + exp(-s) (dy_0 + m + s (y_0 - x_0 + b) / tau),    m = (x_1 - x_0) / dt

    time_s  : (time,) increasing [s];  x : (time,) the history that it follows
    y       : (time,) the lagging history, of lag_columns
    tau_s   : time constant [s], 0 included;  at_rest : as of lag_columns
    returns : (time,) dy/dtau [unit of x over s]; without a lag -dx/dt, as for a shift in time

    The update of docs/theory/equations.md, equation 8, differentiated.
    """
    out = np.zeros_like(x)
    if not at_rest and len(x) > 1:
        out[0] = -(x[1] - x[0]) / (time_s[1] - time_s[0])
    for i in range(1, len(time_s)):
        dt = time_s[i] - time_s[i - 1]
        slope = (x[i] - x[i - 1]) / dt
        out[i] = -slope
        if tau_s > 0.0:
            steps = dt / tau_s
            behind = y[i - 1] - x[i - 1] + tau_s * slope
            out[i] += exp(-steps) * (out[i - 1] + slope + steps / tau_s * behind)
    return out
