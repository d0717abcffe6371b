"""Recorded conditions: columns in another unit or place are refused; scatter, other gases and short records are not."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from sim_heating.base.conditions import SURFACES
from sim_heating.base.errors import InputError
from sim_heating.base.files import CsvTable, read_csv_columns, write_csv
from sim_heating.heating.recorded.plausible import implausible_values
from sim_heating.inputs.record import load_record
from sim_heating.trajectory.recorded import OPTIONAL, REQUIRED, read_conditions
from tests.support.paths import PRACTICE, RECORDS, SCENARIOS

Columns = dict[str, NDArray[np.float64]]
Change = Callable[[Columns], Columns]
COLUMNS = (*REQUIRED, *SURFACES, "rho_kg_m3")
"""Columns that a recording of the Orbiter needs."""
FLIGHT = read_csv_columns(PRACTICE / "p01" / "conditions.csv", COLUMNS, OPTIONAL).columns
"""A whole entry, with temperature, pressure, Mach and Reynolds number of its own."""


def table(columns: Columns) -> CsvTable:
    return CsvTable(columns, {}, Path("c.csv"), np.arange(2, len(columns["time_s"]) + 2))


def problems(**changed: NDArray[np.float64]) -> str:
    return "\n".join(implausible_values(table({**FLIGHT, **changed})))


def times(name: str, factor: float) -> Change:
    return lambda c: {name: c[name] * factor}


def swapped(a: str, b: str) -> Change:
    return lambda c: {a: c[b], b: c[a]}


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (times("time_s", 1e3), "column time_s: the flight slows as with"),
        (times("time_s", 1e3), "the clock of the flight conditions is in milliseconds, give s"),
        (times("time_s", 1e6), "column time_s"),
        (times("time_s", 1 / 60), "the time is not in s"),
        (times("time_s", 1 / 3600), "the time is not in s"),
        (times("velocity_m_s", 1e-3), "column velocity_m_s: nothing crosses"),
        (times("velocity_m_s", 1e-3), "is this km/s? write"),
        (times("altitude_m", 1e-3), "column altitude_m"),
        (times("p_inf_Pa", 0.01), "it looks like hPa, give Pa"),
        (times("p_inf_Pa", 1 / 47.88), "it looks like psf, give Pa"),
        (times("T_inf_K", 1.8), "column p_inf_Pa: p is 0.556 of rho R T"),
        (times("rho_kg_m3", 1e-3), "check units and order of p, rho and T"),
        (times("velocity_m_s", 1.944), "column mach: is"),
        (times("log10_re", np.log(10.0)), "it looks like a natural logarithm"),
        (lambda c: {"mach": c["velocity_m_s"] / 304.8}, "is V / 1000 ft/s, as the Shuttle's literature has it"),
        (lambda c: {"rho_kg_m3": np.full_like(c["time_s"], 1e-4)}, "density of an atmosphere falls with altitude"),
        (swapped("p_inf_Pa", "rho_kg_m3"), "column rho_kg_m3"),
        (swapped("mach", "log10_re"), "column log10_re"),
        (swapped("alpha_deg", "beta_deg"), "look swapped"),
        (swapped("T_inf_K", "mach"), "column T_inf_K"),
        (swapped("altitude_m", "velocity_m_s"), "column velocity_m_s"),
    ],
)
def test_a_column_in_another_unit_or_place_is_refused(change: Change, expected: str) -> None:
    assert expected in problems(**change(FLIGHT))


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda c: {"rho_kg_m3": np.full_like(c["time_s"], 1e-4)}, "the density of an atmosphere falls with altitude"),
        (lambda c: {"rho_kg_m3": c["rho_kg_m3"][::-1]}, "the density of an atmosphere falls with altitude"),
        (times("rho_kg_m3", 1e-3), "it looks like g/cm3, give kg/m3"),
        (times("rho_kg_m3", 1 / 515.379), "it looks like slug/ft3, give kg/m3"),
        (lambda c: {"mach": c["velocity_m_s"] / 661.5 * 1.944}, ""),
        (lambda c: {"mach": c["velocity_m_s"] * 3.6 / 340.0}, "column mach: is"),
    ],
)
def test_a_recorded_trajectory_needs_no_temperature_to_be_checked(
    change: Change, expected: str, tmp_path: Path
) -> None:
    given_columns = {name: FLIGHT[name] for name in COLUMNS}
    write_csv(tmp_path / "c.csv", {**given_columns, **change(FLIGHT)})
    if not expected:  # Mach by the speed of sound at sea level: wrong by a tenth, as scatter may be
        assert len(read_conditions(tmp_path / "c.csv", 32.8)) == len(FLIGHT["time_s"])
        return
    with pytest.raises(InputError) as error:
        read_conditions(tmp_path / "c.csv", 32.8)
    assert expected in str(error.value)


@given(
    noise=st.sampled_from([0.0, 0.02, 0.1]),
    first=st.integers(0, 1300),
    length=st.integers(1, 1366),
    gas=st.sampled_from([1.0, 0.66, 7.2, 14.4]),
    density=st.floats(0.3, 3.0),
    seed=st.integers(0, 2**32 - 1),
)
@settings(max_examples=60, deadline=None)
def test_scatter_other_gases_other_densities_and_short_records_are_accepted(
    noise: float, first: int, length: int, gas: float, density: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    columns = {n: v[first : first + length].copy() for n, v in FLIGHT.items()}
    columns["rho_kg_m3"] *= density
    columns["p_inf_Pa"] *= density * gas
    columns["mach"] /= np.sqrt(gas)
    columns["log10_re"] += np.log10(density)
    for name in ("rho_kg_m3", "p_inf_Pa", "T_inf_K", "mach"):
        columns[name] *= 1.0 + noise * np.clip(rng.normal(size=len(columns["time_s"])), -3.0, 3.0)
    assert implausible_values(table(columns)) == []


def test_a_pressure_that_is_rounded_to_zero_high_up_is_accepted() -> None:
    assert problems(p_inf_Pa=np.round(FLIGHT["p_inf_Pa"], 1)) == ""


def test_a_body_at_rest_in_a_laboratory_is_accepted() -> None:
    still = {n: np.full(100, v[-1]) for n, v in FLIGHT.items()}
    still |= {
        "time_s": np.arange(100.0),
        "velocity_m_s": np.zeros(100),
        "mach": np.zeros(100),
        "log10_re": np.full(100, -3.0),
    }
    assert implausible_values(table(still)) == []


def test_a_long_orbit_before_the_entry_is_accepted() -> None:
    waiting = 5400.0
    long = {n: np.concatenate([np.full(50, v[0]), v]) for n, v in FLIGHT.items()}
    long["time_s"] = np.concatenate([np.linspace(0.0, waiting, 50, endpoint=False), FLIGHT["time_s"] + waiting])
    assert implausible_values(table(long)) == []


@pytest.mark.parametrize("path", [*sorted(PRACTICE.glob("p*")), *sorted(RECORDS.glob("[ks]*"))], ids=lambda p: p.name)
def test_every_record_of_the_project_is_plausible(path: Path) -> None:
    assert len(load_record(path).conditions) > 5


def test_the_ground_track_of_sts107_is_plausible() -> None:
    assert len(read_conditions(SCENARIOS / "data" / "sts107_early_entry.csv", 32.8)) == 62


@pytest.mark.parametrize("cell", ["７２０００", "1_000", "0x10", "infinity", "1,5", "¹²", "1e400", "--1", "٣"])  # noqa: RUF001
def test_a_cell_that_other_programs_do_not_read_as_a_number_is_refused(cell: str, tmp_path: Path) -> None:
    write_csv(tmp_path / "c.csv", {name: FLIGHT[name][:5] for name in COLUMNS})
    lines = (tmp_path / "c.csv").read_text().splitlines()
    lines[2] = ",".join([lines[2].split(",")[0], f'"{cell}"', *lines[2].split(",")[2:]])
    (tmp_path / "c.csv").write_text("\n".join(lines), encoding="utf-8")
    with pytest.raises(InputError, match=r"c\.csv, row 3, column \w+: .* is not a (finite )?number"):
        read_conditions(tmp_path / "c.csv", 32.8)
