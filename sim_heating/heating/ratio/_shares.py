"""The heating ratio that a fit says, anywhere: r = r_declared + sum_k b_k theta_k, with its bound.

b = r_declared for ratio.scale, 1 for ratio.d0, dx_i, dx_i dx_j for the derivatives; see heating/ratio/lookup.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.parameters import RATIO, SECOND_ORDER
from sim_heating.heating.ratio.lookup import table_ratios_at
from sim_heating.heating.ratio.table import RatioTable


def basis(names: Sequence[str], x: FloatArray, reference: FloatArray, declared: FloatArray) -> FloatArray:
    """(sample, k) what each ratio parameter is multiplied with along a path.

    x         : (sample, 5) ratio variables;  reference : (5,) what derivatives are about
    declared  : (sample,) ratio of the declared table, 0 without one
    """
    dx = x - reference
    second = [dx[:, i] * dx[:, j] for i, j in SECOND_ORDER]
    columns = dict(zip((p.name for p in RATIO), (declared, np.ones(len(x)), *dx.T, *second), strict=True))
    return np.stack([columns[name] for name in names], axis=1)


def declared_ratio(table: RatioTable | None, x: FloatArray) -> FloatArray:
    """(sample,) ratio of a declared table, 0 without one."""
    return np.zeros(len(x)) if table is None else table_ratios_at(table, x)


def declared_sigma(table: RatioTable | None, x: FloatArray) -> FloatArray | None:
    """(sample,) standard deviation of a declared table; None where it states none."""
    if table is None or table.sigma is None:
        return None
    return table_ratios_at(replace(table, ratio=table.sigma), x)


def estimated_ratio(
    names: Sequence[str],
    values: FloatArray,
    covariance: FloatArray,
    reference: FloatArray,
    table: RatioTable | None,
    x: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """(sample,) ratio at conditions x (sample, 5), and its standard deviation, from ratio parameters by their names."""
    declared = declared_ratio(table, x)
    B = basis(names, x, reference, declared)
    variance = np.sum((B @ covariance) * B, axis=1)
    return declared + B @ values, np.sqrt(np.maximum(variance, 0.0))
