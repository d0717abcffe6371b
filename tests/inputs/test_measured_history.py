"""A measured history of a [[compare]] is read by names with units as well."""

from __future__ import annotations

import numpy as np
import pytest

from sim_heating.base.errors import InputError
from sim_heating.inputs.scenario import Compare, _history_table, _measured_history


def test_a_history_in_minutes_and_fahrenheit_is_one_in_seconds_and_kelvin(tmp_path):
    (tmp_path / "h.csv").write_text("Time (min),Temperature (deg F),sigma (deg F)\n0,80.33,9\n1,,9\n2,440.33,18\n")
    table = _history_table(tmp_path / "h.csv")
    assert table["time_s"] == pytest.approx([0.0, 120.0])
    assert table["temperature_K"] == pytest.approx([300.0, 500.0])
    assert table["sigma_K"] == pytest.approx([5.0, 10.0])


def test_a_history_in_columns_of_its_own_is_read_as_it_is(tmp_path):
    (tmp_path / "h.csv").write_text("time_s,temperature_K,sigma_K\n0,300,5\n60,400,5\n")
    assert _history_table(tmp_path / "h.csv")["temperature_K"] == pytest.approx(np.array([300.0, 400.0]))


@pytest.mark.parametrize("head", ["time_s,temperature_K,sigma_K", "Time (s),Temperature (K),sigma (K)"])
def test_an_error_below_0_is_refused_with_its_row(tmp_path, head):
    (tmp_path / "h.csv").write_text(f"{head}\n0,300,5\n60,400,-5\n")
    compare = Compare(control_point="STS96_468", file="h.csv", label="measured")
    with pytest.raises(InputError, match=r"h.csv, row 3, column sigma.*: -5 is not a standard deviation"):
        _measured_history(compare, tmp_path / "h.csv")
