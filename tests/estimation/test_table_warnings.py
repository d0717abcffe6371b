"""What an estimate says about the declared ratio table before its result is written into one."""

from __future__ import annotations

from dataclasses import replace

import pytest

from sim_heating.estimation.fit import table_warnings
from sim_heating.estimation.problem import FitProblem
from sim_heating.heating.ratio.table import RatioTable
from sim_heating.inputs.record import load_record
from tests.support.paths import PRACTICE

REFERENCE = (40.0, 0.0, 6.0, 0.0, 0.0)


@pytest.mark.parametrize("nodes", [1, 2])
def test_a_derivative_that_the_table_has_no_nodes_for_is_said(nodes: int) -> None:
    record = load_record(PRACTICE / "p06")
    whole = record.ratio_table
    assert whole is not None
    table = RatioTable((whole.axes[0][:nodes], *whole.axes[1:]), whole.ratio[:nodes], None, whole.header)
    problem = FitProblem([replace(record, ratio_table=table)], ("ratio.scale", "ratio.d_alpha"), REFERENCE)
    said = [line for line in table_warnings(problem.record_fits) if "has one node in alpha_deg" in line]
    assert len(said) == (nodes == 1)
    assert all("no revision of it can hold ratio.d_alpha" in line for line in said)


def test_records_of_a_point_that_declare_different_tables_are_said() -> None:
    """As a flight before a revision of the table and one after it."""
    record = load_record(PRACTICE / "p06")
    whole = record.ratio_table
    assert whole is not None
    revised = replace(record, label="later", ratio_table=replace(whole, ratio=1.1 * whole.ratio))
    for second, said in ((replace(record, label="later"), False), (revised, True)):
        problem = FitProblem([record, second], ("ratio.scale",), REFERENCE)
        lines = table_warnings(problem.record_fits)
        assert ("p06 and later declare different ratio tables; a common estimate is relative to each" in lines) is said
