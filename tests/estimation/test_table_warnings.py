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
