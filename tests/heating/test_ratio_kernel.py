"""Heating ratio of the kernel: the table within and beyond its grid, the linear model about a reference condition."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.interpolate import RegularGridInterpolator

from sim_heating.base.conditions import RATIO_VARIABLES
from sim_heating.base.kernels.block import (
    CELL_WORK,
    D0,
    FIRST,
    LANES,
    N_CONDITIONS,
    N_PARAMETERS,
    NO_TABLE,
    OFF_AXES,
    RATIO_TABLE,
    REFERENCE,
    SCALE,
    SECOND,
    block_size,
    conditions_at,
    integers_size,
    scalar_row,
)
from sim_heating.base.parameters import SECOND_ORDER
from sim_heating.heating.ratio.lookup import (
    invalidate_cells,
    linear_ratio,
    pack_table,
    table_ratio,
    table_ratios,
    write_order,
)
from sim_heating.heating.ratio.table import RatioTable
from tests.support.walls import practice_record

compiling = settings(deadline=None)  # the first example waits for the compiler
values = st.floats(-2.0, 2.0)
points = hnp.arrays(np.float64, 5, elements=st.floats(-0.5, 1.5))
"""Five variables as fractions of the way through a table, some outside it."""


@st.composite
def tables(draw, fewest: int = 1) -> RatioTable:
    """A table of any ratios on uneven axes."""
    axes = tuple(
        draw(st.floats(-50.0, 50.0)) + np.cumsum(draw(hnp.arrays(np.float64, n, elements=st.floats(0.1, 20.0))))
        for n in draw(st.lists(st.integers(fewest, 4), min_size=5, max_size=5))
    )
    return RatioTable(axes, draw(hnp.arrays(np.float64, tuple(map(len, axes)), elements=values)))


def within(table: RatioTable, fractions: np.ndarray) -> np.ndarray:
    """The point at these fractions of the way through each axis."""
    return np.array([a[0] + f * (a[-1] - a[0]) for a, f in zip(table.axes, fractions, strict=True)])


def lookup(table: RatioTable, x: np.ndarray) -> float:
    return table_ratio(pack_table(table), 0, np.asarray(x, dtype=float), 0)


@compiling
@given(tables(fewest=2), points)
def test_table_equals_scipys_multilinear_interpolation(table, fractions):
    x = within(table, np.clip(fractions, 0.0, 1.0))
    x = np.clip(x, [a[0] for a in table.axes], [a[-1] for a in table.axes])
    assert lookup(table, x) == pytest.approx(RegularGridInterpolator(table.axes, table.ratio)(x)[0], abs=1e-11)


@compiling
@given(tables(), points)
def test_outside_the_table_the_ratio_is_the_edge_value(table, fractions):
    x = within(table, fractions)
    at_edge = np.clip(x, [a[0] for a in table.axes], [a[-1] for a in table.axes])
    assert lookup(table, x) == lookup(table, at_edge)


@compiling
@given(tables(), st.data())
def test_ratio_at_a_node_is_that_of_the_table(table, data):
    node = tuple(data.draw(st.integers(0, n - 1)) for n in table.ratio.shape)
    x = [axis[i] for axis, i in zip(table.axes, node, strict=True)]
    assert lookup(table, x) == table.ratio[node]


@compiling
@given(tables(), points)
def test_ratio_lies_between_the_lowest_and_the_highest_of_the_table(table, fractions):
    slack = 1e-12 * max(1.0, float(np.max(np.abs(table.ratio))))
    assert np.min(table.ratio) - slack <= lookup(table, within(table, fractions)) <= np.max(table.ratio) + slack


def test_declared_table_of_a_record_equals_scipy_along_its_flight():
    record, _ = practice_record("p06")
    table, packed = record.ratio_table, pack_table(record.ratio_table)
    x = np.column_stack([record.conditions[name] for name in RATIO_VARIABLES])
    x = np.clip(x, [a[0] for a in table.axes], [a[-1] for a in table.axes])
    ours = [table_ratio(packed, 0, row, 0) for row in x]
    np.testing.assert_allclose(ours, RegularGridInterpolator(table.axes, table.ratio)(x), rtol=1e-12)


@pytest.mark.thorough
@compiling
@given(tables(), st.lists(points, min_size=1, max_size=6))
def test_lookup_of_lanes_equals_that_of_one_point_also_outside_the_table(table, places):
    packed, J = pack_table(table), np.zeros(integers_size(2), dtype=np.int64)
    B = np.zeros(block_size(2))
    invalidate_cells(B)
    J[RATIO_TABLE : RATIO_TABLE + LANES] = 0
    for fractions in places:  # one after the other, so that cells are left and entered
        x = within(table, fractions)
        for lane in range(LANES):
            B[conditions_at(1, lane) :][:5] = x + 0.1 * lane * (x - x[::-1])
        table_ratios(B, J, packed, 1)
        for lane in range(LANES):
            alone = table_ratio(packed, 0, B, conditions_at(1, lane))
            assert B[scalar_row(CELL_WORK)][lane] == pytest.approx(alone, rel=1e-12, abs=1e-12)


@compiling
@given(tables(), points)
def test_variables_outside_the_table_are_counted_except_on_axes_of_one_value(table, fractions):
    packed, J, B = pack_table(table), np.zeros(integers_size(2), dtype=np.int64), np.zeros(block_size(2))
    x = within(
        table, np.where(np.abs(fractions - 1.0) < 1e-9, 1.0, fractions)
    )  # the edge itself is inside, to rounding
    expected = sum(len(a) > 1 and not a[0] <= v <= a[-1] for a, v in zip(table.axes, x, strict=True))
    for lane in range(LANES):
        B[conditions_at(1, lane) :][:5] = x
    invalidate_cells(B)
    table_ratios(B, J, packed, 1)
    assert np.all(B[scalar_row(OFF_AXES)] == expected)


def test_lane_without_a_table_has_tabulated_ratio_zero():
    J, B = np.zeros(integers_size(2), dtype=np.int64), np.ones(block_size(2))
    invalidate_cells(B)
    J[RATIO_TABLE : RATIO_TABLE + LANES] = NO_TABLE
    table_ratios(B, J, np.zeros(1), 0)
    assert np.all(B[scalar_row(CELL_WORK)] == 0.0)


# The linear model ----------------------------------------------------------------------------------------------------

CONDITIONS_FIRST = N_PARAMETERS
"""Offset of the conditions in the test's block, behind the parameters."""


def model_ratio(x: np.ndarray, about: np.ndarray, table: RatioTable | None = None, **parameters: float) -> float:
    """linear_ratio at x with parameters by their offset: at_3=0.1 sets the fourth."""
    B = np.zeros(N_PARAMETERS + N_CONDITIONS)
    for key, value in parameters.items():
        B[int(key.removeprefix("at_"))] = value
    B[REFERENCE : REFERENCE + 5] = about
    write_order(B, 0)
    B[CONDITIONS_FIRST : CONDITIONS_FIRST + 5] = x
    return linear_ratio(B, 0, CONDITIONS_FIRST, 0.0 if table is None else lookup(table, x))


five = hnp.arrays(np.float64, 5, elements=st.floats(-10.0, 10.0))


@pytest.mark.thorough
@compiling
@given(five, five, values)
def test_without_a_table_d0_is_the_ratio_at_the_reference(x, about, d0):
    assert model_ratio(about, about, **{f"at_{D0}": d0}) == d0
    assert model_ratio(x, about, **{f"at_{D0}": d0}) == d0


@pytest.mark.thorough
@compiling
@given(tables(), points, values)
def test_scale_multiplies_the_table_alone(table, fractions, scale):
    x = within(table, fractions)
    r = model_ratio(x, x, table, **{f"at_{SCALE}": scale})
    assert r == pytest.approx(lookup(table, x) * (1.0 + scale), rel=1e-12, abs=1e-12)


@compiling
@given(five, five, st.integers(0, 4), values)
def test_first_derivative_adds_its_product_with_the_distance_from_the_reference(x, about, i, d):
    assert model_ratio(x, about, **{f"at_{FIRST + i}": d}) == pytest.approx(d * (x[i] - about[i]), rel=1e-12)


@compiling
@given(five, five, st.integers(0, len(SECOND_ORDER) - 1), values)
def test_second_order_term_has_no_factor_one_half(x, about, k, d):
    i, j = SECOND_ORDER[k]
    expected = d * (x[i] - about[i]) * (x[j] - about[j])
    assert model_ratio(x, about, **{f"at_{SECOND + k}": d}) == pytest.approx(expected, rel=1e-12, abs=1e-300)


@pytest.mark.thorough
@compiling
@given(tables(), points, five, hnp.arrays(np.float64, REFERENCE, elements=values))
def test_all_terms_together_equal_the_formula_of_the_linear_model(table, fractions, about, p):
    x = within(table, fractions)
    d = x - about
    expected = lookup(table, x) * (1.0 + p[SCALE]) + p[D0] + p[FIRST : FIRST + 5] @ d
    expected += sum(p[SECOND + k] * d[i] * d[j] for k, (i, j) in enumerate(SECOND_ORDER))
    size = 1.0 + np.max(np.abs(d)) ** 2
    r = model_ratio(x, about, table, **{f"at_{k}": v for k, v in enumerate(p)})
    assert r == pytest.approx(expected, abs=1e-12 * size)
