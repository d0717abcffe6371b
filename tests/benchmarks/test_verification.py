"""A sample of `python -m benchmarks verification`, and the page of its rows."""

from __future__ import annotations

import json
import math

import pytest

from benchmarks.measure import RESULTS
from benchmarks.verification import LEAST_ROWS
from tests.support.paths import ROOT
from tests.support.verification import (
    atmosphere,
    conduction,
    effects,
    flights,
    gas,
    heating,
    inside,
    sensors,
    surface,
    trim,
    wall_steps,
)
from tests.support.verification.row import Row, number, text_table

SAMPLE = (
    atmosphere.states, atmosphere.transport, gas.published, gas.viscosity, gas.perfect_gas,
    gas.partition_functions, surface.lumped, sensors.rows, wall_steps.laminar_rows, wall_steps.published_rows,
    conduction.nafems_on_coarse_meshes,
    effects.rows, flights.rows, trim.rows, wall_steps.turbulent_rows, heating.rows, inside.rows,
)  # fmt: skip


@pytest.mark.sample(11)
@pytest.mark.parametrize("part", SAMPLE, ids=lambda part: f"{part.__module__.rpartition('.')[2]}.{part.__name__}")
def test_errors_are_within_their_limits(part):
    rows = part()
    assert all(row.kept for row in rows), text_table([row for row in rows if not row.kept])


def test_a_value_that_is_not_a_number_is_an_error_beyond_its_limit():
    assert not Row("", 1.0, math.nan, 1.0, "K", "", "").kept


def test_the_page_has_every_row_of_the_results():
    rows = json.loads((RESULTS / "verification.json").read_text())["rows"]
    page = (ROOT / "docs" / "evidence" / "verification.md").read_text()
    assert len(rows) >= LEAST_ROWS
    assert len({row["reference"] for row in rows}) == len(rows)
    assert all(number(row["got"]) in page for row in rows)
