"""Heating ratio of a fit at any condition, r = r_table + sum_k b_k theta_k, with its standard deviation.

b = r_table for ratio.scale, 1 for ratio.d0, dx_i, dx_i dx_j for the derivatives (docs/equations.md, equation 9).
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
    """Derivative of the heating ratio with respect to each ratio parameter, along a path.

    names     : (k,) names of ratio parameters, such as `ratio.d_alpha`
    x         : (sample, 5) alpha, beta [deg], log10 Re [-], elevon, body flap [deg]
    reference : (5,) condition that the derivatives are about, in the same units
    declared  : (sample,) ratio of the declared table [-], 0 without one
    returns   : (sample, k) r_table, 1, dx_i or dx_i dx_j; [-], [deg] or their products
    raises    : KeyError for a name that is not a ratio parameter
    Source: docs/equations.md, equation 9.
    """
    dx = x - reference
    second = [dx[:, i] * dx[:, j] for i, j in SECOND_ORDER]
    # RATIO lists scale, d0, first and second derivatives in this order; `strict` fails where the lists differ.
    columns = dict(zip((p.name for p in RATIO), (declared, np.ones(len(x)), *dx.T, *second), strict=True))
    return np.stack([columns[name] for name in names], axis=1)


def declared_ratio(table: RatioTable | None, x: FloatArray) -> FloatArray:
    """Heating ratio of a declared table along a path; 0 without a table.

    x       : (sample, 5) alpha, beta [deg], log10 Re [-], elevon, body flap [deg]
    returns : (sample,) ratio [-] (docs/equations.md, equation 7)
    """
    return np.zeros(len(x)) if table is None else table_ratios_at(table, x)


def declared_sigma(table: RatioTable | None, x: FloatArray) -> FloatArray | None:
    """Standard deviation of a declared table along a path; None where the table states none.

    x       : (sample, 5) alpha, beta [deg], log10 Re [-], elevon, body flap [deg]
    returns : (sample,) sigma [-], interpolated like the ratio (docs/equations.md, equation 7), as for errors that are
              fully correlated within a cell
    """
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
    """Heating ratio and its standard deviation at given conditions, from estimated ratio parameters.

        r = r_table + b' theta,   sigma^2 = b' P b

    names, values : (k,) parameters theta in the units of their names
    covariance    : (k, k) P of the estimate
    reference     : (5,) condition that the derivatives are about;  table : the declared table or None
    x             : (sample, 5) alpha, beta [deg], log10 Re [-], elevon, body flap [deg]
    returns       : (sample,) ratio [-] and (sample,) sigma [-]; the table's own sigma is not part of it
    Source: docs/equations.md, equation 9.
    """
    declared = declared_ratio(table, x)
    B = basis(names, x, reference, declared)
    # The diagonal of B P B' only: the whole matrix would be (sample, sample).
    variance = np.sum((B @ covariance) * B, axis=1)
    return declared + B @ values, np.sqrt(np.maximum(variance, 0.0))
