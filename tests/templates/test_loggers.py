"""Files as loggers write them: each kind is read to what the file states, or refused with an option that then works."""

from __future__ import annotations

import json
import re
import time
import warnings
from collections.abc import Callable, Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from benchmarks.layouts import GOAL_READ, outcomes, share_read
from sim_heating.base.errors import InputError
from sim_heating.cli import main
from sim_heating.cli.path_check import descriptions
from sim_heating.heating.recorded.layout import read_fields
from sim_heating.inputs.record import load_record
from sim_heating.templates.loggers.layout_file import read_layout, write_layout
from sim_heating.templates.loggers.readings import far_off
from sim_heating.templates.measured_csv import FLUX, TEMPERATURE, TIME, UNUSED, MeasuredCsv, read_measured_csv
from tests.support.verification.loggers import LOGGERS, READ
from tests.templates.test_new_record import refused, run


@pytest.fixture(autouse=True)
def in_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.chdir(tmp_path)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def span_s(found: MeasuredCsv) -> float:
    t = found.of_kind(TIME)[0].si
    return float(t[-1] - t[0])


def range_K(found: MeasuredCsv, sensor: int = 0) -> tuple[float, float]:
    T = found.of_kind(TEMPERATURE)[sensor].si
    return float(np.nanmin(T)), float(np.nanmax(T))


@pytest.mark.parametrize("name", READ)
def test_a_logger_s_file_is_read_to_what_it_states(name: str) -> None:
    found = read_measured_csv(LOGGERS / name)
    assert (span_s(found), *range_K(found)) == pytest.approx(READ[name], abs=1e-4)


ASKED = {
    "hh_mm.csv": ("`10:45` may be hours and minutes or minutes and seconds; state --time-unit hh:mm",
    {"time_unit": "hh:mm"},
                  3600.0, 293.15),
    "int_thousand_comma_quoted.csv": ("`1,100` may be 1100 or 1.100; state the decimal sign, --decimal . for 1100",
                                      {"decimal": "."}, 120.0, 866.4833),
    "held_clock.csv": ("row 3, column time: does not come after the row above, but has its time; state "
    "--repeated spread",
                       {"repeated": "first"}, 120.0, 293.16),
    "duplicate_times.csv": ("or --repeated first (keep the first), or give --period", {"repeated": "spread"},
    120.0, 293.21),
}  # fmt: skip
"""File -> what is asked, the answer, the span [s] and the first reading [K] that follow."""


@pytest.mark.parametrize("name", ASKED)
def test_what_two_layouts_fit_is_asked_with_the_option_that_answers(name: str) -> None:
    said, answer, span, first_K = ASKED[name]
    with pytest.raises(InputError) as refusal:
        read_measured_csv(LOGGERS / name)
    assert said in str(refusal.value)
    assert "\n" not in str(refusal.value)
    found = read_measured_csv(LOGGERS / name, **answer)  # type: ignore[arg-type]
    assert span_s(found) == pytest.approx(span)
    assert found.of_kind(TEMPERATURE)[0].si[0] == pytest.approx(first_K, abs=1e-3)


def test_thousands_are_decided_where_other_cells_decide_them() -> None:
    """`1,100` alone is 1100 or 1.100; a decimal point, or whole numbers below a thousand in its column, show which."""
    for cells in (("1,100", "1,103"), ("980", "1,000")):
        rows("Time (s);TC1 (C)", [f"{2 * k};{c}" for k, c in enumerate(cells)])
        with pytest.raises(InputError, match=r"state the decimal sign, --decimal \. for 1[01]00"):
            read_measured_csv(Path("t.csv"))
    rows("Time (s);TC1 (C)", ["0.0;1,100", "2.0;1,103"])
    assert read_measured_csv(Path("t.csv")).of_kind(TEMPERATURE)[0].values.tolist() == [1100.0, 1103.0]
    for sign in ",.":
        rows("Time (s);TC1 (C)", [f"{2 * k};{c}" for k, c in enumerate(("970", "980", "990", f"1{sign}000"))])
        assert read_measured_csv(Path("t.csv")).of_kind(TEMPERATURE)[0].values.tolist() == [970.0, 980.0, 990.0, 1000.0]


def test_rows_of_a_coarse_clock_are_spread_until_its_next_time() -> None:
    spread = read_measured_csv(LOGGERS / "duplicate_times.csv", repeated="spread").of_kind(TIME)[0].si
    assert spread[:5].tolist() == [0.0, 2.0, 4.0, 6.0, 8.0]


def test_a_held_clock_takes_a_period_in_its_place() -> None:
    assert span_s(read_measured_csv(LOGGERS / "held_clock.csv", period_s=2.0)) == 2.0 * (
        len((LOGGERS / "held_clock.csv").read_text().split()) - 2
    )


def test_heat_fluxes_have_the_unit_of_their_file() -> None:
    btu, watt = (read_measured_csv(LOGGERS / f"{n}_flux.csv").of_kind(FLUX)[0].si.max() for n in ("btu", "w_m-2"))
    assert btu == pytest.approx(18000.0, rel=1e-4)
    assert watt == pytest.approx(900.0)


def test_sensors_of_one_file_have_their_own_readings() -> None:
    mixed = read_measured_csv(LOGGERS / "mixed_tabs_blanks.dat").of_kind(TEMPERATURE)
    assert [c.si[0] for c in mixed] == [293.15, 343.15, 393.15, 493.15]
    in_turn = read_measured_csv(LOGGERS / "multi_rate.csv").of_kind(TEMPERATURE)
    assert [int(np.isfinite(c.si).sum()) for c in in_turn] == [61, 60, 60]
    campbell = read_measured_csv(LOGGERS / "toa5.dat").of_kind(TEMPERATURE)
    assert [c.name for c in campbell] == ["TC1_Avg", "TC2_Avg"]
    assert [int(np.isnan(c.si).sum()) for c in campbell] == [1, 0]
    by_row = read_measured_csv(LOGGERS / "long_format.csv").of_kind(TEMPERATURE)
    assert [(c.name, len(c.si)) for c in by_row] == [("TC1", 61), ("TC2", 61)]


def test_a_serial_monitor_names_no_columns_and_the_refusal_names_those_it_has() -> None:
    arguments = ("--layer", "copper 3 mm", "--lamp", "unknown", "--out", "a")
    assert "name one, --temperature COLUMN, of column2, column3" in refused(
        "new", "record", "--csv", LOGGERS / "arduino_monitor.txt", *arguments
    )
    stated = ("--temperature", "column2", "--temperature-unit", "C", "--depth", "column2=back")
    assert run("new", "record", "--csv", LOGGERS / "arduino_monitor.txt", *stated, *arguments).exit_code == 0
    assert load_record("a").time_s[-1] == 120.0


# Units ---------------------------------------------------------------------------------------------------------------


def rows(head: str, cells: list[str]) -> Path:
    Path("t.csv").write_text("\n".join([head, *cells]) + "\n", encoding="utf-8")
    return Path("t.csv")


PLAIN = ["0,20.5", "2,21.5", "4,22.5"]


@pytest.mark.parametrize("unit", ["counts", "xyz", "Ohm", "deg", "type K"])
@pytest.mark.parametrize("form", ["TC1 [{}]", "TC1 ({})", '"TC1, {}"', "TC1/{}"])
def test_a_unit_that_is_no_temperature_is_refused_with_the_option(unit: str, form: str) -> None:
    path = rows(f"Time (s),{form.format(unit)}", PLAIN)
    if "/" in form and " " in unit:
        return  # a blank ends what a slash begins
    with pytest.raises(
        InputError, match="is not a unit of temperature that is known; state it, --temperature-unit degC"
    ):
        read_measured_csv(path)
    assert read_measured_csv(path, temperature_unit="degC").of_kind(TEMPERATURE)[0].si[0] == 293.65


PRINTED_MV = {"B": (1000.0, 4.834), "E": (500.0, 37.005), "J": (500.0, 27.393), "K": (1000.0, 41.276),
              "N": (1000.0, 36.256), "R": (1000.0, 10.506), "S": (1000.0, 9.587), "T": (100.0, 4.279)}  # fmt: skip
"""Temperature [degC] and emf [mV] of the printed tables of ITS-90, for a junction at 0 degC."""


@pytest.mark.parametrize("letter", sorted(PRINTED_MV))
def test_an_emf_is_the_temperature_of_its_printed_table(letter: str) -> None:
    T_C, emf_mV = PRINTED_MV[letter]
    path = rows("Time (s),TC1 (mV)", [f"{t},{emf_mV}" for t in (0, 2, 4)])
    measured = read_measured_csv(path, thermocouple=letter, reference_junction="0degC")
    microvolt_K = {"B": 0.06, "R": 0.05, "S": 0.05}.get(letter, 0.02)  # half of the last printed digit, over the slope
    assert measured.of_kind(TEMPERATURE)[0].si[0] == pytest.approx(T_C + 273.15, abs=microvolt_K)


def test_the_emf_of_the_reference_junction_is_added() -> None:
    """At 25 degC the tables print 1.000 mV for type K, and 5.096 mV at 124.3 degC."""
    cells = ["0,4.096,25.0", "2,4096e-3,298.15", "4,4.096,25.0"]
    at_25 = read_measured_csv(rows("Time (s),TC1 (mV),ref", cells), thermocouple="K", reference_junction="25 degC")
    assert at_25.of_kind(TEMPERATURE)[0].si[0] == pytest.approx(124.3 + 273.15, abs=0.05)
    in_column = rows("Time (s),TC1 (V),ref (K)", ["0,0.004096,298.15", "2,0.004096,299.15", "4,0.004096,298.15"])
    measured = read_measured_csv(in_column, thermocouple="K", reference_junction="ref")
    T_K = measured.of_kind(TEMPERATURE)[0].si
    assert T_K[0] == at_25.of_kind(TEMPERATURE)[0].si[0]
    assert T_K[1] - T_K[0] == pytest.approx(40.6 / 41.4, rel=0.02)  # slopes of type K at 25 and 124 degC, uV/K
    assert [c.reason for c in measured.columns if c.name == "ref"] == ["reference junction"]


def test_an_emf_without_its_thermocouple_is_refused_with_the_option() -> None:
    path = rows("Time (s),TC1 (mV)", ["0,0.1", "2,0.2", "4,60.0"])
    with pytest.raises(InputError, match=r"`mV` is not .* state it, --thermocouple K --reference-junction 25degC"):
        read_measured_csv(path)
    with pytest.raises(InputError, match="add --reference-junction"):
        read_measured_csv(path, thermocouple="K")
    with pytest.raises(InputError, match=r"t\.csv, column TC1, row 4: 60 mV is no emf of type K .* --lost=60"):
        read_measured_csv(path, thermocouple="K", reference_junction="25degC")
    measured = read_measured_csv(path, thermocouple="K", reference_junction="25degC", lost=[60.0])
    assert np.isnan(measured.of_kind(TEMPERATURE)[0].si[2])
    with pytest.raises(InputError, match=r"no column .* states a voltage"):
        read_measured_csv(rows("Time (s),TC1 (C)", PLAIN), thermocouple="K", reference_junction="25degC")


def test_a_layout_keeps_the_thermocouple_of_its_recorder(tmp_path: Path) -> None:
    path = rows("Time (s),TC1 (mV)", ["0,0.1", "2,0.2", "4,0.4"])
    first = read_measured_csv(path, thermocouple="S", reference_junction="25degC")
    write_layout(tmp_path / "layout.toml", first.stated, path.name, {})
    second = read_measured_csv(path, layout=read_layout(tmp_path / "layout.toml"))
    np.testing.assert_array_equal(second.of_kind(TEMPERATURE)[0].si, first.of_kind(TEMPERATURE)[0].si)


def test_a_time_that_is_not_read_is_refused_and_no_counter_takes_its_place() -> None:
    path = rows("Scan,Time,TC1 (C)", [f"{i},T+{2 * i},20.5" for i in range(5)])
    with pytest.raises(InputError, match=r"row 2, column Time: `T\+0` is in no layout of a time that is read"):
        read_measured_csv(path)
    with pytest.raises(InputError, match="no column is a time"):
        read_measured_csv(rows("Scan,TC1 (C)", PLAIN))


def test_what_is_assumed_without_a_unit_is_a_warning_to_programs_and_in_quiet(
    capsys: pytest.CaptureFixture[str],
) -> None:
    rows("Time,TC", PLAIN)
    plate = ["new", "record", "--csv", "t.csv", "--layer", "copper 3 mm", "--lamp", "unknown", "--depth", "TC=back"]
    said = "t.csv, column Time: no unit is stated: s assumed (--time-unit)"
    warnings.simplefilter("always")
    assert main([*plate, "--out", "a", "--quiet"]) == 0
    assert said in capsys.readouterr().err
    assert main([*plate, "--out", "b", "--json"]) == 0
    assert said in json.loads(capsys.readouterr().out)["warnings"]


@pytest.mark.parametrize(
    ("unit", "steps_s"), [("ms", 1e-3), ("min", 60.0), ("h", 3600.0)]
)  # fmt: skip
def test_times_that_nobody_logs_in_s_are_asked_for(unit: str, steps_s: float) -> None:
    path = rows("Time,TC1 (C)", [f"{20000 * i},20.5" for i in range(4)])
    with pytest.raises(InputError, match="states no unit, and steps of 20000 are hardly s; state it, --time-unit ms"):
        read_measured_csv(path)
    assert span_s(read_measured_csv(path, time_unit=unit)) == pytest.approx(60000.0 * steps_s)


# Clocks --------------------------------------------------------------------------------------------------------------

START = datetime(2024, 5, 3, 10, 45)
STAMPS = [START + timedelta(seconds=2.0 * k) for k in range(61)]
CLOCKS = {
    "h:m:s:ms": "%m/%d/%Y %H:%M:%S:237", "ISO": "%Y-%m-%dT%H:%M:%SZ", "ISO basic": "%Y%m%dT%H%M%S",
    "one number": "%Y%m%d%H%M%S", "AM and PM": "%m/%d/%y %I:%M:%S %p", "two digits": "%d.%m.%y %H:%M:%S",
    "month": "%d-%b-%Y %H:%M:%S", "IRIG": "124:%H:%M:%S.5", "apostrophe": "'%y-%m-%d %H:%M:%S", "clock": "%H:%M:%S",
    "two columns": "%d/%m/%Y,%H:%M:%S", "zone": "%Y-%m-%d %H:%M:%S UTC",
}  # fmt: skip


@pytest.mark.parametrize("layout", CLOCKS)
def test_a_clock_is_read_whatever_its_layout(layout: str) -> None:
    head = "Date,Time,TC1 (C)" if layout == "two columns" else "Time,TC1 (C)"
    found = read_measured_csv(rows(head, [f"{s.strftime(CLOCKS[layout])},20.5" for s in STAMPS]))
    assert span_s(found) == 120.0


def test_days_of_a_spreadsheet_are_days() -> None:
    found = read_measured_csv(
        rows("Date,TC1 (C)", [f"{45415.447916667 + 2.0 * k / 86400.0:.9f},20.5" for k in range(61)])
    )
    assert span_s(found) == pytest.approx(120.0, abs=1e-3)


def test_the_order_of_day_and_month_holds_for_all_rows_or_is_asked() -> None:
    days = [(START + timedelta(days=k / 6.0)).strftime("%d/%m/%Y %H:%M") for k in range(20)]
    path = rows("Time,TC1 (C)", [f"{d},20.5" for d in days])
    with pytest.raises(InputError, match=r"`03/05/2024 10:45` may be read .* --dates day-first or --dates month-first"):
        read_measured_csv(path)
    assert span_s(read_measured_csv(path, dates="day-first")) == pytest.approx(19 * 14400.0)
    bad = rows("Time,TC1 (C)", ["13/05/2024 10:00,20.5", "05/14/2024 10:00,20.5", "13/05/2024 10:02,20.5"])
    with pytest.raises(InputError, match="has no order of day and month that all dates have"):
        read_measured_csv(bad)


def test_a_time_of_day_without_colons_is_asked_for() -> None:
    path = rows("Time,TC1 (C)", [f"{s:%H%M%S},20.5" for s in STAMPS])
    with pytest.raises(InputError, match="`104500` may be a time of day or seconds; state --time-unit hhmmss"):
        read_measured_csv(path)
    assert span_s(read_measured_csv(path, time_unit="hhmmss")) == 120.0


def test_a_time_of_start_or_a_duration_beside_the_time_is_not_it() -> None:
    path = rows("Start time,Time (s),Duration,TC1 (C)", [f"10:45:00,{2 * k},00:{2 * k:02d},20.5" for k in range(20)])
    found = read_measured_csv(path)
    assert (found.of_kind(TIME)[0].name, span_s(found)) == ("Time", 38.0)


def test_an_hour_that_a_clock_loses_or_repeats_is_told() -> None:
    autumn = [START + timedelta(seconds=2.0 * k - (3600.0 if k > 30 else 0.0)) for k in range(61)]
    with pytest.raises(InputError, match="as where summer time ends: write UTC offsets"):
        read_measured_csv(rows("Time,TC1 (C)", [f"{s:%Y-%m-%d %H:%M:%S},20.5" for s in autumn]))
    spring = [START + timedelta(seconds=2.0 * k + (3600.0 if k > 30 else 0.0)) for k in range(61)]
    with pytest.warns(UserWarning, match="row 33, column Time: the clock jumps by an hour"):
        read_measured_csv(rows("Time,TC1 (C)", [f"{s:%Y-%m-%d %H:%M:%S},20.5" for s in spring]))


@pytest.mark.skipif(not hasattr(time, "tzset"), reason="the time zone of a process is set on Unix alone")
def test_times_do_not_depend_on_the_time_zone_of_the_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    """All clocks, on days at which summer time begins or ends somewhere, in text and in a workbook."""
    changes = [datetime(2024, 3, 10, 1, 59), datetime(2024, 3, 31, 1, 59), datetime(2024, 11, 3, 1, 59)]
    for k, start in enumerate(changes):
        stamps = [start + timedelta(seconds=2.0 * i) for i in range(61)]
        Path(f"{k}.csv").write_text("Time,TC1 (C)\n" + "".join(f"{s:%Y-%m-%d %H:%M:%S},20.5\n" for s in stamps))
        pd.DataFrame({"Time": stamps, "TC1 (C)": 20.5}).to_excel(f"{k}.xlsx", index=False)
    files = [*(LOGGERS / name for name in READ), *sorted(Path().glob("[0-9].*"))]
    found = {}
    for zone in ("UTC", "America/New_York", "Asia/Kathmandu"):
        with monkeypatch.context() as environment:
            environment.setenv("TZ", zone)
            time.tzset()
            read = [read_measured_csv(f) for f in files]
        found[zone] = [(r.of_kind(TIME)[0].si.tolist(), r.zero_s) for r in read]
    time.tzset()
    assert [times[-1] for times, _ in found["UTC"][-6:]] == [120.0] * 6
    assert found["UTC"] == found["America/New_York"] == found["Asia/Kathmandu"]


def test_the_flux_of_another_file_is_on_the_clock_of_the_readings() -> None:
    rows("Time,TC1 (C)", [f"{s:%Y-%m-%d %H:%M:%S},20.5" for s in STAMPS])
    late = [START + timedelta(seconds=2.0 * k - 10.0) for k in range(80)]
    lines = [f"{s:%Y-%m-%d %H:%M:%S},{20 if s >= START + timedelta(seconds=20) else 0}" for s in late]
    Path("lamp.csv").write_text("\n".join(["Time,Flux (kW/m2)", *lines]))
    arguments = ("--layer", "copper 3 mm", "--depth", "TC1=back", "--emissivity", "0.9", "--out", "a")
    assert run("new", "record", "--csv", "t.csv", "--lamp", "lamp.csv", *arguments).exit_code == 0
    flown = load_record("a").conditions
    assert flown.time_s[0] == -10.0
    assert flown.time_s[np.argmax(flown["q_add_W_m2"] > 0.0)] == 20.0
    Path("lamp.csv").write_text("time_s,flux_W_m2\n0,1\n500,1\n")
    assert "are of different clocks" in refused("new", "record", "--csv", "t.csv", "--lamp", "lamp.csv", *arguments)


# Readings that are none ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("code", ["999", "9999.9", "-999.9", "99999"])
def test_a_row_of_nines_far_off_its_neighbours_is_a_lost_sample(code: str) -> None:
    rows("Time (s),TC1 (C)", [f"{2 * k},{code if k == 7 else f'{20.0 + k:.2f}'}" for k in range(61)])
    with pytest.warns(UserWarning, match=rf"row 9, column TC1: {code} .*left out"):
        found = read_measured_csv(Path("t.csv"))
    assert np.flatnonzero(np.isnan(found.of_kind(TEMPERATURE)[0].values)).tolist() == [7]


def test_a_counter_by_name_with_temperatures_in_its_cells_holds_temperatures() -> None:
    rows(
        "Reading,Sample,Start Time",
        [f"{k + 1},{20.0 + k:.1f} °C,{s:%m/%d/%Y %I:%M:%S %p}" for k, s in enumerate(STAMPS)],
    )
    found = read_measured_csv(Path("t.csv"))
    assert (span_s(found), *range_K(found)) == pytest.approx((120.0, 293.15, 353.15))


def test_readings_that_begin_at_320_are_of_no_room_and_their_unit_is_asked() -> None:
    rows("Time (s),TC1", [f"{2 * k},{320.0 + k}" for k in range(61)])
    with pytest.raises(
        InputError, match="column TC1: begins at 322, in no unit that is known; state it, --temperature"
    ):
        read_measured_csv(Path("t.csv"))


def test_readings_that_are_stated_as_lost_are_lost_samples() -> None:
    path = rows("Time (s),TC1 (C)", ["0,20", "2,777", "4,21", "6,9.9E37", "8,22"])
    T = read_measured_csv(path, lost=(777.0,)).of_kind(TEMPERATURE)[0].si
    assert np.isnan(T).tolist() == [False, True, False, True, False]


@pytest.mark.parametrize(
    "cell", ["21,5 kelvin 30", "n/a 30", "NaN 30", "null 30", "--- 30", "OL 30", "OVER 30", "Open TC 30"]
)
def test_a_cell_of_several_values_is_no_lost_sample(cell: str) -> None:
    path = rows("Time (s);TC1", [f"{2 * k};{300 + k},5 kelvin" for k in range(20)] + [f"40;{cell}", "42;320,5 kelvin"])
    with pytest.raises(InputError, match=f"row 22, column TC1: `{cell}` is no number in the layout"):
        read_measured_csv(path)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        (
            "max31855_fault_2048.csv",
            "rows 22, 32, column TC1: 2048 lies far off its neighbours and is a code of recorders",
        ),
        (
            "benchlink_open.csv",
            r"rows 22, 23, 24, 25, column Chan 101: 9.9e\+37 is the overload of a recorder: left out",
        ),
        ("sentinel_9999.csv", "rows 22, 23, 24, column TC1: -9999 is no temperature and taken for the code"),
    ],
)
def test_the_code_of_a_recorder_is_told_by_the_rows_of_the_user_s_file(name: str, said: str) -> None:
    with pytest.warns(UserWarning, match=rf"{name}, {said}"):
        read_measured_csv(LOGGERS / name)


def test_drop_outs_are_left_out_and_another_single_reading_is_named_and_stays() -> None:
    hot = [f"{2 * k},{0 if k in (30, 31, 40) else 220 + k + (140 if k == 50 else 0)}" for k in range(61)]
    path = rows("Time (s),TC1 (C)", hot)
    with pytest.warns(UserWarning) as told:  # noqa: PT030 two of them
        T = read_measured_csv(path).of_kind(TEMPERATURE)[0].si
    said = [str(w.message) for w in told]
    assert "t.csv, rows 32, 33, 42, column TC1: 0 lies far off its neighbours and is a code" in said[0]
    assert (
        "t.csv, row 52, column TC1: 410 C lies far off its neighbours and stays; leave it out by --lost=410" in said[1]
    )
    assert np.flatnonzero(np.isnan(T)).tolist() == [30, 31, 40]
    assert np.isnan(read_measured_csv(path, lost=(410.0,)).of_kind(TEMPERATURE)[0].si[50])


def test_a_run_of_a_fault_is_left_out_and_a_start_at_0_degC_is_not() -> None:
    open_input = rows("Time (s),TC1 (C)", [f"{2 * k},{2048 if 20 <= k < 30 else 20.0 + k}" for k in range(61)])
    assert int(np.isnan(read_measured_csv(open_input).of_kind(TEMPERATURE)[0].si).sum()) == 10
    ice = rows("Time (s),TC1 (C)", [f"{2 * k},{max(0, 40 * (k - 9))}" for k in range(30)])
    assert not np.isnan(read_measured_csv(ice).of_kind(TEMPERATURE)[0].si).any()


def test_a_unit_in_a_column_of_its_own_is_that_of_the_readings() -> None:
    by_row = rows("time_s,channel,value,unit", [f"{2 * (k // 2)},TC{k % 2},{68.0 + 9 * k},F" for k in range(20)])
    assert [c.si[0] for c in read_measured_csv(by_row).of_kind(TEMPERATURE)] == [293.15, 298.15]


@pytest.mark.parametrize("seed", range(20))
def test_a_heated_plate_with_noise_has_no_reading_far_off(seed: int) -> None:
    """A step of the lamp, a hold, a fall, noise of 0.5 K and rounding: nothing of it is an outlier."""
    t = np.arange(0.0, 300.0, 2.0)
    T = 20.0 + np.clip((t - 20.0) * 4.0, 0.0, 400.0) * np.where(t < 200.0, 1.0, np.exp(-(t - 200.0) / 5.0))
    assert not far_off(np.round(T + np.random.default_rng(seed).normal(0.0, 0.5, len(t)), 1)).any()


def test_a_sensor_that_burnt_out_is_kept() -> None:
    path = rows("Time (s),TC1 (C),TC2 (C)", [f"{2 * k},20.5,{21.5 if k < 15 else ''}" for k in range(61)])
    assert int(np.isfinite(read_measured_csv(path).of_kind(TEMPERATURE)[1].si).sum()) == 15


def test_readings_in_another_unit_are_refused_by_the_row_of_the_user_s_file() -> None:
    path = rows("Time (s),TC1 (K)", PLAIN)
    with pytest.raises(InputError, match=r"t.csv, row 2, column TC1: 20.5 K is 20.5 K and no temperature of a wall"):
        read_measured_csv(path)


# Layouts -------------------------------------------------------------------------------------------------------------

T_C = 20.0 + np.clip(2.0 * np.arange(61) - 10.0, 0.0, 60.0) * 1.7
RECORDERS = {
    "HOBO, new": "#,Date-Time (EDT),\"Ch: 1 - Temperature   (°C)\",Button Down\n"
    + "".join(f"{i},{s:%m/%d/%Y %H:%M:%S},{T:.2f},\n" for i, (s, T) in enumerate(zip(STAMPS, T_C, strict=True)))
    + "62,05/03/2024 10:47:03,,Logged\n",
    "Hioki": '"File name","AUTO0001.MEM"\n"Trigger Time","\'24-05-03 10:45:00"\n"CH","CH1-1"\n"Time(s)","CH1-1[°C]"\n'
    + "".join(f"{2.0 * i:.4E},{T:.4E}\n" for i, T in enumerate(T_C)),
    "PicoLog 6": ',"TC-08: Ch1 Last (°C)"\n'
    + "".join(f"{s.isoformat()}+01:00,{T:.2f}\n" for s, T in zip(STAMPS, T_C, strict=True)),
    "PicoLog 5": "Time\tTC1\nSeconds\tDegC\n" + "".join(f"{2 * i}\t{T:.2f}\n" for i, T in enumerate(T_C)),
    "BenchLink 3": "Scan,Time,101 <Plate> (C),Alarm 101\n"
    + "".join(f"{i},{s:%m/%d/%Y %H:%M:%S}:512,{T:.2f},0\n" for i, (s, T) in enumerate(zip(STAMPS, T_C, strict=True))),
    "Graphtec": "Model,GL840\nNumber,Date&Time,ms,CH1\nNO.,Time,ms,degC\n"
    + "".join(f"{i},{s:%Y/%m/%d %H:%M:%S},0,+ {T:.2f}\n" for i, (s, T) in enumerate(zip(STAMPS, T_C, strict=True))),
    "serial monitor": "".join(f"{s:%H:%M:%S}.512 -> T1: {T:.2f} C\n" for s, T in zip(STAMPS, T_C, strict=True)),
    "Switzerland": "Time (s);TC1 (C)\n" + "".join(f"{2 * i};{T:.2f}\n" for i, T in enumerate(T_C)).replace(".", ","),
}  # fmt: skip


@pytest.mark.parametrize("recorder", RECORDERS)
def test_the_layout_of_a_recorder_is_read(recorder: str) -> None:
    Path("t.csv").write_text(RECORDERS[recorder], encoding="utf-8")
    found = read_measured_csv(Path("t.csv"))
    assert (span_s(found), *range_K(found)) == pytest.approx((120.0, 293.15, 395.15))
    assert len(found.rows) == 61


def test_tables_with_types_are_read_as_text_is() -> None:
    table = pd.DataFrame({"time": pd.to_datetime(STAMPS), "TC1 [degC]": T_C})
    table.to_parquet("a.parquet")
    table.set_index("time").to_parquet("b.parquet")
    table.to_excel("a.xlsx", index=False, startrow=2)
    nptdms = pytest.importorskip("nptdms")
    with nptdms.TdmsWriter("a.tdms") as stream:
        steps = {"wf_increment": 2.0, "unit_string": "degC"}
        stream.write_segment([nptdms.ChannelObject("run", "TC1", T_C, properties=steps)])
    for name in ("a.parquet", "b.parquet", "a.xlsx", "a.tdms"):
        found = read_measured_csv(Path(name))
        assert (span_s(found), *range_K(found)) == pytest.approx((120.0, 293.15, 395.15)), name


def test_an_old_workbook_is_read_as_a_new_one_is() -> None:
    found = read_measured_csv(LOGGERS / "excel97.xls")
    assert found.zero_s == datetime(2024, 5, 3, 10, 45, tzinfo=UTC).timestamp()


def second_segment(text: str, names: str = "TC1\tTC2", x0: int = 0) -> str:
    """The segment of an LVM file once more, begun ten minutes later."""
    later = text[text.index("Channels") :].replace("14:41:45.51", "14:51:45.51").replace("TC1\tTC2", names)
    return re.sub(r"(?m)^(\d+)\.0+(?=\t\d)", lambda m: f"{int(m[1]) + x0}.0", later)


def test_segments_of_an_lvm_file_follow_by_their_dates_and_times() -> None:
    text = (LOGGERS / "labview.lvm").read_text()
    Path("a.lvm").write_text(text + second_segment(text))
    both = read_measured_csv(Path("a.lvm"))
    assert span_s(both) == pytest.approx(720.0)
    assert len(both.rows) == 2 * 61
    alone = read_measured_csv(Path("a.lvm"), sheet="2")
    assert (span_s(alone), range_K(alone)) == (120.0, pytest.approx(range_K(both)))


def test_segments_whose_times_go_on_count_from_the_first() -> None:
    text = (LOGGERS / "labview.lvm").read_text()
    Path("a.lvm").write_text(text + second_segment(text, x0=600))
    assert span_s(read_measured_csv(Path("a.lvm"))) == pytest.approx(720.0)


def test_channels_of_an_lvm_file_with_times_of_their_own_share_a_column() -> None:
    multi = re.sub(r"(?m)^(\d+\.0+)\t([\d.]+)\t([\d.]+)", r"\1\t\2\t\1\t\3", (LOGGERS / "labview.lvm").read_text())
    multi = multi.replace("X_Columns\tOne", "X_Columns\tMulti").replace("TC1\tTC2", "TC1\tX_Value\tTC2")
    multi = re.sub(r"(?m)^((?:Date|Time|Y_Unit_Label)\t[^\t\n]+)\t(?=[^\t\n]+)", r"\1\t\t", multi)
    Path("a.lvm").write_text(multi)
    assert (span_s(read_measured_csv(Path("a.lvm"))), len(read_measured_csv(Path("a.lvm")).rows)) == (120.0, 61)
    Path("a.lvm").write_text(multi.replace("\t14:41:45.51\t\t14:41:45.51", "\t14:41:45.51\t\t14:41:46.51"))
    apart = read_measured_csv(Path("a.lvm"))  # a second later
    assert (span_s(apart), len(apart.rows)) == (pytest.approx(121.0), 2 * 61)


@pytest.mark.parametrize("delta", ["2.000000\t2.000000", "2.000000\t4.000000"])
def test_times_that_only_the_header_of_an_lvm_file_states(delta: str) -> None:
    text = re.sub(r"(?m)^\d+\.0+(?=\t\d)", "", (LOGGERS / "labview.lvm").read_text())
    text = text.replace("X_Columns\tOne", "X_Columns\tNo").replace("2.000000\t2.000000", delta)
    Path("a.lvm").write_text(text)
    found = read_measured_csv(Path("a.lvm"))
    assert span_s(found) == 60.0 * float(delta.split("\t")[1])


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            lambda text: text + text[text.index("Channels") :],
            "before the one above ends; choose one segment",
        ),
        (lambda text: text + second_segment(text, "TC1\tTC3"), "differ; choose one segment, --sheet 1"),
        (lambda text: text + second_segment(text, x0=900), "state different times; choose one segment, --sheet 1"),
        (lambda text: text[: text.rindex("***End_of_Header***")], "header of the LabVIEW file does not end"),
    ],
)
def test_an_lvm_file_of_another_form_is_refused_in_one_line(change: Callable[[str], str], said: str) -> None:
    text = (LOGGERS / "labview.lvm").read_text()
    Path("a.lvm").write_text(change(text))
    with pytest.raises(InputError, match=said) as refusal:
        read_measured_csv(Path("a.lvm"))
    assert "\n" not in str(refusal.value)


def test_a_workbook_of_several_sheets_asks_which() -> None:
    table = pd.DataFrame({"Time (s)": 2.0 * np.arange(61), "TC1 [degC]": T_C})
    with pd.ExcelWriter("a.xlsx") as book:
        table.to_excel(book, sheet_name="run1", index=False)
        table.to_excel(book, sheet_name="run2", index=False)
    with pytest.raises(InputError, match=r"has 2 sheets \(run1, run2\); choose one, --sheet NAME"):
        read_measured_csv(Path("a.xlsx"))
    assert span_s(read_measured_csv(Path("a.xlsx"), sheet="run2")) == 120.0


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("Time (s);TC1 (C)\n0;20,5\n2;21,5\n4;22.5\n", "do not have one decimal sign"),
        ("Time (s),TC1 (C)\n0,20.5\n2,21.5 30.5\n4,22.5\n", "row 3, column TC1: `21.5 30.5` is no number"),
        ("Time (s);TC1 (C)\n0;20,5\n2;NaN 30\n4;22,5\n", "row 3, column TC1: `NaN 30` is no number"),
        (
            "Time (s),TC1 (C),TC2 (C)\n0,20.5\n2,21.5\n4,22.5\n",
            "row 1: 3 names (`Time (s), TC1 (C), TC2 (C)`) for 2 cells",
        ),
        ("Time (s);TC1 (C)\n0;998\n2;999\n4;1.000\n6;1.002\n", "`1.000` may be 1000 or 1.000"),
        ("Time TC1_C TC2_C\n2024-05-03 10:45:00 20.5 21.5\n2024-05-03 10:45:02 20.5 21.5\n", "3 names (`Time, TC1_C"),
        ("Time (s),TC1 (C)\n0,998\n2,999\n4,1.000\n6,1.002\n", "`1.000` may be 1000 or 1.000"),
        (
            "Time (s),TC1 (C)\n0,20.5\n2,20.5\nTime (s),TC1 (C)\n0,20.5\n2,20.5\n",
            "row 4, column Time: `Time (s)` is no time",
        ),
        (
            "Time (s),TC1 (C),TC2 (C)\n0,20,2048\n2,21,2048\n",
            "column TC2: reads 2048 throughout, as a converter in fault",
        ),
        ("Time (s),TC1 (C)\n0,(5.0)\n2,1.0\n4,2.0\n", "row 2, column TC1: `(5.0)` is no number in the layout"),
        ("Time (s),Temp,Unit\n0,20,C\n2,70,F\n", "row 3, column Unit: `F` is another unit than `C`"),
        ("Time,TC1 (C)\n0 s,20.5\n2 min,21.5\n4 s,22.5\n", "column Time"),
        (
            "Time (s),Ch1,Unit,Ch2,Unit\n0,20,C,40,%RH\n2,21,C,40,%RH\n",
            "column Ch2: `%RH` is not a unit of temperature",
        ),
    ],
)
def test_what_no_layout_fits_is_refused_with_a_cell(text: str, said: str) -> None:
    Path("t.csv").write_text(text)
    with pytest.raises(InputError) as refusal:
        read_measured_csv(Path("t.csv"))
    assert said in str(refusal.value)


def test_a_layout_is_kept_for_the_next_files_of_the_recorder() -> None:
    plate = ("--layer", "copper 3 mm", "--lamp", "unknown", "--emissivity", "0.9")
    rows("millis;T_back;T_room", [f"{2000 * k};{20.0 + k};21.0".replace(".", ",") for k in range(61)])
    first = ("--temperature", "T_back", "--temperature-unit", "C", "--lost=-1", "--depth", "T_back=back")
    made = run("new", "record", "--csv", "t.csv", *plate, *first, "--keep-layout", "rig.toml", "--out", "a")
    assert made.exit_code == 0, made.exception
    assert "First rows as read" in made.output
    rows("millis;T_back;T_room", [f"{2000 * k};{-1 if k == 7 else 60.0 + k};21.0".replace(".", ",") for k in range(61)])
    assert run("new", "record", "--csv", "t.csv", *plate, "--layout", "rig.toml", "--out", "b").exit_code == 0
    record = load_record("b")
    assert [s.column for s in record.sensors] == ["T_back_K"]
    assert record.sensors[0].depth_m == 0.003
    assert record.thermocouples["T_back_K"][0] == pytest.approx(333.15)
    assert np.flatnonzero(np.isnan(record.thermocouples["T_back_K"])).tolist() == [7]
    layout = Path("rig.toml").read_text()
    other = layout.replace('title = "', 'title = "bench, ').replace('separator = ";"', 'separator = ","')
    Path("rig.toml").write_text(other)
    assert "bench, " in str(descriptions(Path("rig.toml")))
    by_other = ("new", "record", "--csv", "t.csv", *plate, "--layout", "rig.toml", "--out", "c")
    assert "no rows of numbers" in refused(*by_other)
    Path("rig.toml").write_text(layout)
    rows("millis;T_front", ["0;20,5", "2000;20,5"])
    assert "rig.toml, [column] 1: `name`: `T_back`: there is no such column in t.csv" in refused(
        "new", "record", "--csv", "t.csv", *plate, "--layout", "rig.toml", "--out", "c"
    )
    Path("rig.toml").write_text(Path("rig.toml").read_text().replace("decimal", "decimals"))
    assert "decimals" in refused("new", "record", "--csv", "t.csv", *plate, "--layout", "rig.toml", "--out", "c")


@pytest.mark.parametrize(
    ("stated", "said"),
    [
        ('time_unit = "K"', "rig.toml: `time_unit`: `K` is not a unit of time; give one of s, ms,"),
        ('temperature_unit = "m"', "rig.toml: `temperature_unit`: `m` is not a unit of temperature; give K, degC or"),
        ('flux_unit = "K"', "rig.toml: `flux_unit`: `K` is not a unit of heat flux; give W/m2"),
        ('[[column]]\nname = "TC"\nunit = "s"', "rig.toml, [column] 1: `unit`: `s` is not a unit of temperature"),
    ],
)
def test_a_layout_whose_unit_is_none_is_refused_by_its_file_and_key(stated: str, said: str) -> None:
    Path("rig.toml").write_text(f'format = "logger-layout/1"\n{stated}\n')
    assert said in refused("validate", "rig.toml")


@pytest.mark.parametrize(
    ("stated", "said"),
    [
        ('time = "Zeit"', "rig.toml: `time`: `Zeit`: there is no such column in t.csv"),
        ('time_unit = "hh:mm"', "rig.toml: `time_unit`: `hh:mm`: `0` in t.csv, column Time is no such clock"),
        ('[[column]]\nname = "T"\nunit = "K"', "rig.toml, [column] 1: `unit`: `K`, and t.csv says degC; correct one"),
        ('[[column]]\nname = "T"\ndepth = "9mm"', "rig.toml, [column] 1: `depth`: `9mm`: lies outside the stack"),
        (
            'thermocouple = "K"\nreference_junction = "25degC"',
            "rig.toml: `thermocouple`: `K`: no column of t.csv states",
        ),
    ],
)
def test_what_a_layout_states_wrongly_is_named_by_its_key(stated: str, said: str) -> None:
    rows("Time (s),T (degC)", [f"{2 * k},{20 + k}" for k in range(61)])
    Path("rig.toml").write_text(f'format = "logger-layout/1"\n{stated}\n')
    plate = ["--layer", "copper 3 mm", "--lamp", "unknown", "--emissivity", "0.9"]
    depth = [] if "depth" in stated else ["--depth", "T=back"]
    assert said in refused("new", "record", "--csv", "t.csv", *plate, *depth, "--layout", "rig.toml", "--out", "c")


@pytest.mark.parametrize(
    ("stated", "said"),
    [
        ('time = "Zeit"', "rig.toml: `time`: `Zeit`: there is no such column in t.csv"),
        ('dates = "year-first"', "`13/05/2024 10:00` is not a date with the year first; correct `dates` in rig.toml"),
        ('[[column]]\nname = "T"\nunit = "K"', "rig.toml, [column] 1: `unit`: `K`, and t.csv says degC; correct one"),
        (
            'thermocouple = "K"\nreference_junction = "9000degC"',
            "t.csv, column emf, `reference_junction` in rig.toml: 9000 degC is outside the reference function of type",
        ),
        ('thermocouple = "K"', "rig.toml: `thermocouple`: `K`: needs the temperature of the terminals"),
    ],
)
def test_a_program_is_told_the_key_of_the_layout_that_it_read(stated: str, said: str) -> None:
    rows("Time,T (degC),emf (mV)", [f"13/05/2024 10:{k:02d},{20 + k},1.5" for k in range(9)])
    Path("rig.toml").write_text(f'format = "logger-layout/1"\n{stated}\n')
    with pytest.raises(InputError, match=re.escape(said)):
        read_measured_csv(Path("t.csv"), layout=read_layout(Path("rig.toml")))


def test_an_option_in_place_of_a_key_of_a_layout_is_named_itself() -> None:
    rows("Time (s),T (degC)", [f"{2 * k},{20 + k}" for k in range(9)])
    Path("rig.toml").write_text('format = "logger-layout/1"\ntime = "Time"\n')
    with pytest.raises(InputError, match=r"^--time Zeit: there is no such column"):
        read_measured_csv(Path("t.csv"), layout=read_layout(Path("rig.toml")), time="Zeit")
    Path("rig.toml").write_text('format = "logger-layout/1"\ntime_unit = "min"\n')
    with pytest.warns(UserWarning, match=r"`time_unit` in rig.toml says min.* Leave `time_unit` in rig.toml out"):
        read_measured_csv(Path("t.csv"), layout=read_layout(Path("rig.toml")))


def test_a_layout_keeps_depths_and_units_when_it_is_kept_again() -> None:
    rows("Time (s);T;U", [f"{2 * k};{60 + k};20" for k in range(9)])
    stated = '[[column]]\nname = "T"\ndepth = "1mm"\n'
    Path("rig.toml").write_text(f'format = "logger-layout/1"\ntemperature_unit = "degF"\n{stated}')
    read = read_measured_csv(Path("t.csv"), layout=read_layout(Path("rig.toml")))
    write_layout(Path("again.toml"), read.stated, "t.csv", {})
    (column,) = read_layout(Path("again.toml")).column
    assert (column.name, column.unit, column.depth) == ("T", "degF", "1mm")


def test_a_unit_of_a_layout_that_prevails_is_told_by_its_key(capsys: pytest.CaptureFixture[str]) -> None:
    rows("Time (s),T (degC)", [f"{2 * k},{20 + k}" for k in range(61)])
    Path("rig.toml").write_text('format = "logger-layout/1"\ntime_unit = "min"\n')
    plate = ("--layer", "copper 3 mm", "--depth", "T=back", "--lamp", "unknown", "--emissivity", "0.9")
    warnings.simplefilter("always")
    assert main(["new", "record", "--csv", "t.csv", *plate, "--layout", "rig.toml", "--out", "c", "--json"]) == 0
    (told,) = [w for w in json.loads(capsys.readouterr().out)["warnings"] if "column Time" in w]
    assert "the file says s, `time_unit` in rig.toml says min; read as min. Leave `time_unit` in rig.toml out" in told


def test_a_layout_states_the_unit_of_fluxes_that_state_none() -> None:
    rows("Time (s);T (C);heat flux", [f"{2 * k};{20 + k};18" for k in range(61)])
    plate = ("--layer", "copper 3 mm", "--depth", "T=back", "--emissivity", "0.9")
    for unit, flux in (("kW/m2", 18e3), ("W/cm2", 18e4)):
        Path("rig.toml").write_text(f'format = "logger-layout/1"\nflux_unit = "{unit}"\n')
        made = run("new", "record", "--csv", "t.csv", *plate, "--layout", "rig.toml", "--out", unit[:2])
        assert made.exit_code == 0, made.exception
        assert load_record(unit[:2]).conditions["q_add_W_m2"].max() == pytest.approx(flux)


def test_what_was_read_before_stays_readable() -> None:
    """Quoted decimal commas, `sep=;`, UTF-16, seconds of 1970 without names, blanks and umlauts in the path."""
    files = {
        "quoted.csv": ('"Zeit (s)","TC1 (°C)"\n"0,0","20,55"\n"2,0","21,55"\n', "cp1252"),
        "sep.csv": ("sep=;\nTime (s);TC1 (C)\n0,0;20,55\n2,0;21,55\n", "utf-8"),
        "utf16.csv": ("Time (s)\tTC1 (°C)\n0,0\t20,55\n2,0\t21,55\n", "utf-16"),
        "ein Prüfstand.csv": ("Time (s),TC1 (°C)\n0.0,20.55\n2.0,21.55\n", "utf-8-sig"),
    }
    for name, (text, encoding) in files.items():
        Path(name).write_text(text, encoding=encoding)
        found = read_measured_csv(Path(name))
        assert (span_s(found), *range_K(found)) == pytest.approx((2.0, 293.7, 294.7)), name
    Path("unix.csv").write_text("1714700000,293.15\n1714700002,294.15\n1714700004,295.15\n")
    found = read_measured_csv(Path("unix.csv"), temperatures=("column2",), temperature_unit="K")
    assert span_s(found) == 4.0


@pytest.mark.thorough
def test_a_file_of_18611_rows_is_read_in_a_moment() -> None:
    """Each reading is converted once, however often it is asked for."""
    t = 0.05 * np.arange(18611)
    Path("t.csv").write_text("Time (s),TC1 (C)\n" + "".join(f"{x:.2f},{20.0 + 0.01 * x:.3f}\n" for x in t))
    measured = read_measured_csv(Path("t.csv"))
    assert span_s(measured) == pytest.approx(930.5)
    assert all(c.si is c.si for c in measured.columns)


@pytest.mark.thorough
def test_one_truth_in_random_layouts_is_never_read_wrongly(tmp_path: Path) -> None:
    """Sixty here; five thousand by `python -m benchmarks layouts`."""
    found, reasons = outcomes(60, 2024, tmp_path)
    assert found["wrong"] == 0, reasons
    assert share_read(found) >= GOAL_READ, reasons


CHANNEL_K = 293.15 + 0.6 * np.arange(12.0) ** 2
"""A wall that is heated, every 2 s."""


def rows_of(form: Callable[[int, float], str]) -> str:
    """Rows of a file from the number of the sample and the temperature [degC]."""
    return "".join(f"{form(i, T_K - 273.15)}\n" for i, T_K in enumerate(CHANNEL_K))


@pytest.mark.parametrize(
    ("head", "form"),
    [
        (
            '"ALMEMO 2590-4S";;;\n"Datum:";"Zeit:";"M00: TC1"\n"";"";"°C"\n',
            lambda i, T: f'"05.03.24";"10:45:{2 * i:02d}";' + f'"{T:.2f}"'.replace(".", ","),
        ),
        (
            "Vendor ,Graphtec Corporation\nModel   ,GL840\nSampling interval,2s\nTotal data points,12\n"
            "Start time,2024-03-05,10:45:00\nEnd time,2024-03-05,10:45:22\nAMP settings\nCH,Signal name,Input\n"
            "CH1,front,TEMP,TC_K,Off\nLogic/Pulse,Off\nData\nNumber,Date&Time,ms,CH1,AL1-10\nNO.,Time,ms,degC,A12345\n",
            lambda i, T: f"{i + 1},2024/03/05 10:45:{2 * i:02d},0,+ {T:.2f},LLLL",
        ),
        (
            "EL-USB-TC,Time,Celsius(°C),High Alarm,Serial Number\n",
            lambda i, T: f"{i + 1},05/03/2024 10:45:{2 * i:02d},{T:.2f}" + ",300,010012345" * (i == 0),
        ),
        ("TIME,DATE,CH1 C,DIO,TOTAL\n", lambda i, T: f"10:45:{2 * i:02d},03/05/24,{T:.2f},255,0"),
        ("Temps (s);Température (°C)\n", lambda i, T: f"{2 * i};{T:.2f}".replace(".", ",")),
        ("% rig 3\n% time[s] TC1[degC]\n", lambda i, T: f"{2 * i} {T:.2f}"),
        ('"Timestamp","TZ","1TC (degC)"\n', lambda i, T: f"2024/05/13 10:45:{2 * i:02d}.000,n,{T:.2f}"),
        ("Start: 5/13/2024\nScan #,Timestamp,101 (TC) °C\n", lambda i, T: f"{i + 1},{2 * i:.3f},{T:.2f}"),
        ("elapsed,TC1 (C)\n", lambda i, T: f"0 days 00:00:{2 * i:02d}.000000,{T:.2f}"),
        ("TC run,Time,Celsius(°C)\n", lambda i, T: f"{i + 1},13/05/2024 10:45:{2 * i:02d},{T:.2f}"),
        ("", lambda i, T: f'{{"time_s": {2 * i}, "TC1_C": {T:.2f}}}'),
        ("[", lambda i, T: f'{{"time_s": {2 * i}, "TC1_C": {T:.2f}}}{",]"[i == 11]}'),
        (
            '"Model","GX10"\n\n"Ch.","","","CH1"\n"Tag","","","wall"\n"Unit","","","°C"\n"Date","Time","ms",""\n',
            lambda i, T: f"2024/05/13,10:45:{2 * i:02d},000,{T:.2f}",
        ),
        ('TITLE = "rig"\nVARIABLES = "Time [s]"\n"TC1 [C]"\nZONE I=12, F=POINT\n', lambda i, T: f" {2 * i} {T:.4E}"),
        ("Time(s) TC1(C)\n", lambda i, T: f" {2 * i / 10:.4f}D+01 {T / 100:.6f}D+02"),
        (
            "Time,TC1 (C)\n",
            lambda i, T: (
                f"2024-366T23:59:{40 + 2 * i}Z,{T:.2f}" if i < 10 else f"2025-001T00:00:{2 * i - 20:02d}Z,{T:.2f}"
            ),
        ),
        ("Time,TC1 (C)\n", lambda i, T: f"2024:134:10:45:{2 * i:02d}.000,{T:.2f}"),
        ("ms,degC\nTime,TC1\n", lambda i, T: f"{2000 * i},{T:.2f}"),
        ("Time,TC1\nms,degC\nElapsed time,Wall front\n", lambda i, T: f"{2000 * i},{T:.2f}"),
        ("Fecha y hora;Pared (°C)\n", lambda i, T: f"13/05/2024 10:45:{2 * i:02d} a.\u00a0m.;{T:.2f}"),
        ("Time,TC1 (C)\n", lambda i, T: f"Mon May 13 10:45:{2 * i:02d} 2024,{T:.2f}"),
        ("Datum;TC1 (°C)\n", lambda i, T: f"13. Mai 2024 10:45:{2 * i:02d};{T:.2f}"),
        (
            "Date,Time,Ch1_Value,Ch1_Unit,Humid_Value,Humid_Unit\n",
            lambda i, T: f"2024/05/13,10:45:{2 * i:02d},{32.0 + 1.8 * T:.2f},Degree_F,40,%RH",
        ),
        ('"Time\n(s)","TC1\n(C)"\n', lambda i, T: f"{2 * i},{T:.2f}"),
        ("Zeit (s);Kanal 1 °C\n", lambda i, T: f"{2 * i};{T:.2f}".replace(".", ",")),
        ("Model,DL850\nRate,2\nTime (s),TC1 (C)\n", lambda i, T: f"{2 * i},{T:.2f}"),
        ("GPS week,TOW (s),TC1 (C)\n", lambda i, T: f"2314,{124050 + 2 * i},{T:.2f}"),
        ("GMT,TC1 (C)\n", lambda i, T: f"134/10:45:{2 * i:02d}.000,{T:.2f}"),
    ],
    ids=[
        "ALMEMO",
        "Graphtec with its header",
        "Lascar with constants in the first row",
        "Fluke Hydra with a total",
        "French",
        "comment of MATLAB",
        "dataTaker",
        "ExceLINX",
        "pandas spans",
        "Lascar",
        "JSON lines",
        "JSON list",
        "Yokogawa",
        "Tecplot",
        "Fortran",
        "day of the year",
        "day of the year with colons",
        "units above names",
        "remarks below units",
        "Spanish",
        "ctime",
        "German month",
        "unit behind each reading",
        "names on two lines",
        "number of a channel before its unit",
        "pairs above the names",
        "GPS time",
        "day and time with a slash",
    ],
)
@pytest.mark.filterwarnings("ignore:.*no unit is stated")
def test_more_recorders_are_read_as_they_are_written(head: str, form: Callable[[int, float], str]) -> None:
    Path("t.txt").write_text(head + rows_of(form), encoding="utf-8")
    measured = read_measured_csv(Path("t.txt"))
    (column,) = measured.of_kind(TEMPERATURE)
    np.testing.assert_allclose(column.si, CHANNEL_K, atol=0.006)
    t = measured.of_kind(TIME)[0].si
    np.testing.assert_allclose(t - t[0], 2.0 * np.arange(12.0))


@pytest.mark.parametrize("first", [739385.5, 2460443.5], ids=["of MATLAB", "Julian"])
def test_days_of_a_calendar_are_counted_from_the_first(first: float) -> None:
    Path("t.csv").write_text("day,TC1 (C)\n" + rows_of(lambda i, T: f"{first + 2 * i / 86400:.9f},{T:.2f}"))
    measured = read_measured_csv(Path("t.csv"), time="day", time_unit="day")
    np.testing.assert_allclose(measured.of_kind(TIME)[0].si, 2.0 * np.arange(12.0), atol=1e-3)
    assert measured.zero_s is None


def test_a_row_of_json_lines_that_is_no_object_is_named() -> None:
    Path("t.jsonl").write_text('{"time_s": 0, "TC1_K": 293}\n[1, 2]\n')
    with pytest.raises(InputError, match=r"^t.jsonl, row 2: no JSON object"):
        read_measured_csv(Path("t.jsonl"))


def test_columns_of_json_are_read() -> None:
    Path("t.json").write_text(json.dumps({"time_s": list(range(12)), "TC1_K": CHANNEL_K.tolist()}))
    np.testing.assert_allclose(read_measured_csv(Path("t.json")).of_kind(TEMPERATURE)[0].si, CHANNEL_K)


def of_noon(i: int, T: float, halves: str) -> str:
    """A row 12 s before noon and later, with the word of a half of the day before the time."""
    s = 43188 + 2 * i
    return f"2024/3/5 {halves.split()[s >= 43200]} {12 if s >= 43200 else 11}:{s // 60 % 60:02d}:{s % 60:02d},{T:.2f}"


@pytest.mark.parametrize("page", ["utf-8", "gb18030", "cp932", "cp949"])
def test_dates_of_east_asian_loggers_are_read(page: str) -> None:
    head, signs, halves = {
        "cp932": ("日時,温度1[℃]", "年月日時分秒", "午前 午後"),
        "cp949": ("시간,온도 (℃)", "년월일시분초", "오전 오후"),
    }.get(page, ("时间,TC1(℃)", "年月日时分秒", "上午 下午"))
    y, m, d, h, n, s = list(signs)
    forms = (
        lambda i, T: f"2024{y}03{m}05{d} 14{h}22{n}{2 * i:02d}{s},{T:.2f}",
        lambda i, T: f"2024{y}3{m}5{d}14{h}22{n}{2 * i}{s},{T:.2f}",
        lambda i, T: of_noon(i, T, halves),
    )
    for form in forms:
        Path("t.csv").write_bytes(f"{head}\n{rows_of(form)}".encode(page))
        measured = read_measured_csv(Path("t.csv"))
        np.testing.assert_allclose(measured.of_kind(TEMPERATURE)[0].si, CHANNEL_K, atol=0.006)
        np.testing.assert_allclose(measured.of_kind(TIME)[0].si, 2.0 * np.arange(12.0))


def test_objects_and_lists_in_rows_of_json_are_columns() -> None:
    """Of a value with its unit, whichever stands first, the unit is that of the value."""
    C = (CHANNEL_K - 273.15).tolist()
    texts = {
        "tc.TC1": [{"time_s": 2.0 * i, "tc": {"TC1": T, "TC2": T}} for i, T in enumerate(CHANNEL_K)],
        "tc.1": [{"time_s": 2.0 * i, "tc": [T, T]} for i, T in enumerate(CHANNEL_K)],
        "sensors.TC1.value": [
            {"time_s": 2.0 * i, "sensors": {"TC1": {"unit": "degC", "value": T}, "TC2": {"unit": "K", "value": 293.0}}}
            for i, T in enumerate(C)
        ],
    }
    for name, rows in texts.items():
        Path("t.jsonl").write_text("\n".join(map(json.dumps, rows)))
        columns = {c.name: c for c in read_measured_csv(Path("t.jsonl")).of_kind(TEMPERATURE)}
        assert len(columns) == 2
        np.testing.assert_allclose(columns[name].si, CHANNEL_K)
    Path("t.json").write_text(json.dumps({"title": "run", "data": texts["tc.TC1"]}))
    assert len(read_measured_csv(Path("t.json")).of_kind(TEMPERATURE)) == 2


@pytest.mark.filterwarnings("ignore:.*no unit is stated")
def test_tables_of_a_database_one_below_the_other_are_sensors() -> None:
    """InfluxDB writes a table for each field, each with its names; Grafana a row for each reading of a series."""
    head = "#group,false,false,true,true,false\n#datatype,string,long,dateTime:RFC3339,double,string\n"
    head += "#default,_result,,,,\n,result,table,_time,_value,_field\n"
    influx, series = [], []
    for k, sensor in enumerate(("TC0", "TC1")):
        times = [f"2024-03-05T10:45:{2 * i:02d}Z" for i in range(len(CHANNEL_K))]
        readings = list(zip(times, CHANNEL_K - 273.15 + k, strict=True))
        influx.append(head + "\n".join(f",,{k},{t},{T:.2f},{sensor}" for t, T in readings))
        series += [f'"{sensor}";"{t}";{T:.2f}' for t, T in readings]
    for text in ("\n\n".join(influx), "\n".join(['"Series";"Time";"Value"', *series])):
        Path("t.csv").write_text(text)
        columns = {c.name: c.si for c in read_measured_csv(Path("t.csv")).of_kind(TEMPERATURE)}
        np.testing.assert_allclose(columns["TC0"], CHANNEL_K, atol=0.006)
        np.testing.assert_allclose(columns["TC1"], CHANNEL_K + 1.0, atol=0.006)


def test_a_row_of_data_that_is_longer_than_the_others_is_not_lost() -> None:
    Path("t.csv").write_text("Time (s),TC1 (C)\n0,20.0,1\n2,20.1\n4,20.2\n6,20.3\n")
    with pytest.raises(InputError, match=r"t.csv, row 2: `0, 20.0, 1` does not have 2 cells as the other rows"):
        read_measured_csv(Path("t.csv"))


def test_a_list_that_differs_in_length_names_no_sensor() -> None:
    rows = [{"time_s": 2.0 * i, "TC_K": T, "events": [1] * (i % 3)} for i, T in enumerate(CHANNEL_K)]
    Path("t.jsonl").write_text("\n".join(map(json.dumps, rows)))
    assert [c.name for c in read_measured_csv(Path("t.jsonl")).of_kind(TEMPERATURE)] == ["TC"]


def test_rows_without_a_number_of_their_own_are_shown() -> None:
    Path("t.txt").write_text("ZEIT DATUM: 05.03.24\n" + rows_of(lambda i, T: f"10:45:{2 * i:02d} 00: {T:.1f} °C01: x"))
    with pytest.raises(InputError, match=r"row 13, `10:45:22, 00:, .*`, is none. Write a time and temperatures alone"):
        read_measured_csv(Path("t.txt"))


@pytest.mark.parametrize("read", [read_measured_csv, read_fields])
def test_a_damaged_line_of_json_is_named(read: Callable[[Path], object]) -> None:
    for text in ('{"time_s": 0, "T_K": 293}\n{"time_s": 1,\n', '[{"time_s": 0, "T_K": 293},\n{"time_s": 1,,}]'):
        Path("t.json").write_text(text)
        with pytest.raises(InputError, match=r"^t.json, row 2: is not JSON"):
            read(Path("t.json"))


@pytest.mark.parametrize("read", [read_measured_csv, read_fields])
@pytest.mark.parametrize(
    ("zones", "said"),
    [
        (
            "ZONE I=3, F=BLOCK\n0 1 2\n20 21 22\n",
            "row 3: `0 1 2` is not one number for each of 2 variables; export one",
        ),
        ("ZONE I=2\n0 20\n1 21\nZONE I=2\n0 20\n1 21\n", "row 5: `ZONE I=2` is not one number for each of 2"),
    ],
)
def test_a_tecplot_file_that_is_no_list_of_points_is_refused(
    read: Callable[[Path], object], zones: str, said: str
) -> None:
    Path("t.dat").write_text(f'VARIABLES = "Time (s)", "TC1 (C)"\n{zones}')
    with pytest.raises(InputError, match=re.escape(said)):
        read(Path("t.dat"))


def test_channels_that_are_named_by_numbers_are_chosen_by_them() -> None:
    rows("Time (s),101,102", [f"{2 * i},{20 + i},{21 + i}" for i in range(5)])
    measured = read_measured_csv(Path("t.csv"), temperatures=("101",), temperature_unit="degC")
    assert measured.of_kind(TEMPERATURE)[0].si[0] == 293.15


def test_a_run_of_a_code_in_a_steep_heating_is_left_out() -> None:
    rows("Time (s),TC1 (C)", [f"{2 * i},{-127 if 3 <= i < 7 else 20 + 0.6 * i**2}" for i in range(12)])
    column = read_measured_csv(Path("t.csv")).of_kind(TEMPERATURE)[0]
    assert np.flatnonzero(np.isnan(column.si)).tolist() == [3, 4, 5, 6]


def test_a_clock_without_a_layout_is_no_matter_beside_a_period() -> None:
    rows("Timecode,TC1 (C)", [f"10:45:{i:02d}:12,{20 + i}" for i in range(5)])
    with pytest.raises(InputError, match="may be hh:mm:ss:ms or dd:hh:mm:ss"):
        read_measured_csv(Path("t.csv"))
    assert span_s(read_measured_csv(Path("t.csv"), period_s=1.0)) == 4.0


def test_a_leap_second_is_asked_and_taken_by_period() -> None:
    stamps = ("2016-12-31T23:59:58Z", "2016-12-31T23:59:60Z", "2017-01-01T00:00:01Z")
    rows("Time,TC1 (C)", [f"{stamp},{20 + k}" for k, stamp in enumerate(stamps)])
    with pytest.raises(InputError, match=r"`2016-12-31T23:59:60Z` may be a leap second or midnight"):
        read_measured_csv(Path("t.csv"))
    assert span_s(read_measured_csv(Path("t.csv"), period_s=2.0)) == 4.0


def test_rows_from_the_newest_to_the_first_are_read_from_the_last() -> None:
    rows = rows_of(lambda i, T: f"2024-05-13 10:45:{2 * i:02d},{T:.2f}").splitlines()
    Path("t.csv").write_text("Date,TC1 (C)\n" + "\n".join(reversed(rows)))
    measured = read_measured_csv(Path("t.csv"))
    np.testing.assert_allclose(measured.of_kind(TEMPERATURE)[0].si, CHANNEL_K, atol=0.006)
    np.testing.assert_allclose(measured.of_kind(TIME)[0].si, 2.0 * np.arange(12.0))
    assert measured.zero_s == datetime(2024, 5, 13, 10, 45, tzinfo=UTC).timestamp()
    assert measured.line(0).endswith("row 13")
    assert "the rows run back in time: read from the last" in measured.notes


@pytest.mark.parametrize(
    ("head", "row", "said"),
    [
        (
            "Time (s),TC1 (C)",
            "{t},{y:.1f} °F",
            "row 2, column TC1 (C): `20.0 °F` has another unit than the column states, `C`",
        ),
        (
            "Time (s),TC1 (C)",
            "{t},{y:.1f}%",
            "row 2, column TC1 (C): `20.0%` has another unit than the column states, `C`",
        ),
        (
            "Time (s),TC1 (C)",
            "{t} ms,{y:.1f}",
            "row 2, column Time (s): `0 ms` has another unit than the column states, `s`",
        ),
    ],
)
def test_cells_in_another_unit_than_their_column_states_are_refused(head: str, row: str, said: str) -> None:
    Path("t.csv").write_text(f"{head}\n" + rows_of(lambda i, T: row.format(t=2 * i, y=T)), encoding="utf-8")
    with pytest.raises(InputError, match=re.escape(said)):
        read_measured_csv(Path("t.csv"))


def test_the_unit_of_the_cells_is_used_where_the_name_states_how_they_were_reduced() -> None:
    Path("t.csv").write_text("Time (s),TC1 (Avg)\n" + rows_of(lambda i, T: f"{2 * i},{32.0 + 1.8 * T:.2f} °F"))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        measured = read_measured_csv(Path("t.csv"))
    np.testing.assert_allclose(measured.of_kind(TEMPERATURE)[0].si, CHANNEL_K, atol=0.006)


def test_a_cell_too_long_for_a_table_is_refused_in_a_line() -> None:
    Path("t.csv").write_text("Time (s),TC1 (C)\n0," + 200_000 * "2" + "\n1,21\n2,22\n")
    with pytest.raises(InputError, match=r"^t.csv: cannot be read as a table"):
        read_measured_csv(Path("t.csv"))


def test_a_difference_of_temperatures_is_no_temperature() -> None:
    rows = rows_of(lambda i, T: f"{2 * i},{T:.2f},{T - 20.0:.2f},{T - 20.0:.2f}")
    Path("t.csv").write_text("Time (s),TC1 (C),TC1 rise (C),Delta T (K)\n" + rows)
    assert [c.name for c in read_measured_csv(Path("t.csv")).of_kind(TEMPERATURE)] == ["TC1"]


@pytest.mark.parametrize("name", ["TC1 (C) x10", "TC1 C*10", "TC1 [degC] \u00d7 10", "TC1 (0.1 C)"])
def test_a_factor_beside_a_unit_is_not_left_out(name: str) -> None:
    Path("t.csv").write_text(f"Time (s),{name}\n" + rows_of(lambda i, T: f"{2 * i},{10 * T:.0f}"))
    with pytest.raises(InputError, match=r"column TC1.*: `.*`.*write the numbers times their factor"):
        read_measured_csv(Path("t.csv"))


def test_the_value_at_power_on_is_left_out_of_a_steep_heating() -> None:
    rows("Time (s),TC1 (C)", [f"{2 * i},{85 if i == 0 else 20 + 25 * i}" for i in range(12)])
    column = read_measured_csv(Path("t.csv")).of_kind(TEMPERATURE)[0]
    assert np.flatnonzero(np.isnan(column.si)).tolist() == [0]


def test_a_plate_that_cools_from_85_degrees_keeps_its_first_reading() -> None:
    rows("Time (s),TC1 (C)", [f"{2 * i},{85 if i == 0 else 60 - 4 * i}" for i in range(12)])
    assert read_measured_csv(Path("t.csv")).of_kind(TEMPERATURE)[0].si[0] == 358.15


DOTTED = [(10 * 60 + 57 + i, 20 + i) for i in range(6)]


def test_hours_and_minutes_with_a_point_are_asked_and_read_as_stated() -> None:
    rows("Time,TC1 (C)", [f"{m // 60}.{m % 60:02d},{T}" for m, T in DOTTED])
    with pytest.raises(InputError, match=r"`10\.57` may be a time of day or seconds; state --time-unit hh:mm or"):
        read_measured_csv(Path("t.csv"))
    assert span_s(read_measured_csv(Path("t.csv"), time_unit="hh:mm")) == 300.0
    assert span_s(read_measured_csv(Path("t.csv"), time_unit="s")) == pytest.approx(0.45)


def test_a_time_of_three_numbers_with_points_is_no_date() -> None:
    for date in ("", "13.05.2024 "):
        rows("Zeit;TC1 (C)", [f"{date}{m // 60}.{m % 60:02d}.30;{T}" for m, T in DOTTED])
        assert span_s(read_measured_csv(Path("t.csv"))) == 300.0
    rows("Datum;Zeit;TC1 (C)", [f"13.05.2024;{m // 60}.{m % 60:02d}.30;{T}" for m, T in DOTTED])
    assert span_s(read_measured_csv(Path("t.csv"))) == 300.0
    rows("Datum;TC1 (C)", [f"{10 + k}.05.24;{T}" for k, (_, T) in enumerate(DOTTED)])
    assert span_s(read_measured_csv(Path("t.csv"))) == 5 * 86400.0


def test_a_time_with_points_that_is_none_is_named_as_the_file_has_it() -> None:
    for date in ("", "13.05.2024 "):
        rows("Zeit;TC1 (C)", [f"{date}10.{57 + k}.{99 if k == 2 else 30};{20 + k}" for k in range(3)])
        with pytest.raises(InputError, match=rf"column Zeit: `{re.escape(date)}10\.59\.99` is no time of day"):
            read_measured_csv(Path("t.csv"))


# Lists of readings ---------------------------------------------------------------------------------------------------


def almemo(i: int, T: float, label: str = "  wall") -> str:
    return f"10:45:{2 * i:02d} 00: +{T:07.2f} °C{label}\n         01: +{T + 1:07.2f} °C"


def influx(i: int, T: float) -> str:
    ns = f"{1714733100 + 2 * i}000000000"
    return f"rig,sensor=TC1,host=a value={T:.2f} {ns}\nrig,sensor=TC2,host=a value={T + 1:.2f} {ns}"


def keysight(i: int, T: float) -> str:
    return f"{T:+.8E} C,{2 * i:+.8E},101,0,{T + 1:+.8E} C,{2 * i:+.8E},102,0"


def datataker(i: int, T: float) -> str:
    return f'D,081044,"JOB1",2024/05/03,10:45:{2 * i:02d},0.000366,0;A,0,{T:.4f},{T + 1:.4f};0072;9F1C'


@pytest.mark.parametrize(
    ("head", "form", "names"),
    [
        ("DATUM:   05.03.24\n", almemo, ["00 wall", "01"]),
        ("# CONTEXT-DATABASE: rig\n", influx, ["TC1", "TC2"]),
        ("", keysight, ["CH101", "CH102"]),
        ("", datataker, ["A1", "A2"]),
    ],
    ids=["ALMEMO", "InfluxDB line protocol", "Keysight", "dataTaker fixed format"],
)
@pytest.mark.filterwarnings("ignore:.*no unit is stated")
def test_a_list_of_readings_is_a_column_for_each_sensor(
    head: str, form: Callable[[int, float], str], names: list[str]
) -> None:
    Path("t.txt").write_bytes((head + rows_of(form)).encode("cp1252"))
    stated = {"temperatures": tuple(names)} if form is datataker else {}  # it names and states nothing
    measured = read_measured_csv(Path("t.txt"), **stated)  # type: ignore[arg-type]
    np.testing.assert_allclose(measured.of_kind(TIME)[0].si, 2.0 * np.arange(12.0), atol=1e-6)
    for k, (name, column) in enumerate(zip(names, measured.of_kind(TEMPERATURE), strict=True)):
        assert column.name == name
        np.testing.assert_allclose(column.si, CHANNEL_K + k, atol=0.006)


EXTREMES = {
    "above": '"Tag","","","wall","wall"\n"Unit","","","C","C"\n"Date","Time","sec","Min","Max"\n',
    "merged": '"Tag","","","wall",""\n"Unit","","","C",""\n"Date","Time","sec","Min","Max"\n',
    "names": '"Date","Time","sec","wall Min","wall Max"\n"","","","C","C"\n',
    "below": '"Date","Time","sec","wall","wall"\n"","","","C","C"\n"","","","Min","Max"\n',
}


@pytest.mark.parametrize("head", EXTREMES)
def test_least_and_greatest_readings_of_a_channel_are_no_two_sensors(head: str) -> None:
    body = rows_of(lambda i, T: f"2024/05/13,10:45:{2 * i:02d},000,{T:.2f},{T + 1:.2f}")
    Path("t.csv").write_text(EXTREMES[head] + body)
    with pytest.raises(InputError, match=r'wall Min, wall Max are readings of .* --temperature "wall Max"'):
        read_measured_csv(Path("t.csv"))
    (column,) = read_measured_csv(Path("t.csv"), temperatures=("wall Max",), temperature_unit="degC").of_kind(
        TEMPERATURE
    )
    np.testing.assert_allclose(column.si, CHANNEL_K + 1.0, atol=0.006)


@pytest.mark.parametrize(
    "names", ["TC1_Min (C),TC1_Max (C),TC1_Avg (C)", "Min (C),Max (C),Mean (C)", "Tmin_C,Tmax_C,T_C"]
)
def test_the_average_of_a_channel_is_read_beside_its_extremes(names: str) -> None:
    Path("t.csv").write_text(f"Time (s),{names}\n" + rows_of(lambda i, T: f"{2 * i},{T - 1:.2f},{T + 1:.2f},{T:.2f}"))
    measured = read_measured_csv(Path("t.csv"))
    (column,) = measured.of_kind(TEMPERATURE)
    np.testing.assert_allclose(column.si, CHANNEL_K, atol=0.006)
    assert sum("of which another column is the reading" in c.reason for c in measured.columns) == 2


LABELLED = {
    "Channel,Reading (°C),Relative Time (s)": ("{k},{T:.2f},{t}", ["101", "102"]),
    "entity_id,state,last_changed": (
        "sensor.tc{k},{T:.2f},2024-03-05T10:45:{t:02d}.000Z",
        ["sensor.tc101", "sensor.tc102"],
    ),
}


@pytest.mark.parametrize("head", LABELLED)
@pytest.mark.filterwarnings("ignore:.*no unit is stated")
def test_numbers_of_channels_and_names_of_entities_name_sensors(head: str) -> None:
    form, names = LABELLED[head]
    rows(head, [form.format(k=k, T=T - 273.15, t=2 * i) for i, T in enumerate(CHANNEL_K) for k in (101, 102)])
    columns = read_measured_csv(Path("t.csv")).of_kind(TEMPERATURE)
    assert [c.name for c in columns] == names
    for column in columns:
        np.testing.assert_allclose(column.si, CHANNEL_K, atol=0.006)


def test_a_number_of_a_channel_is_no_temperature_beside_its_reading() -> None:
    rows(
        "Channel,Reading,Unit,Time",
        [f"101,{T - 273.15:.2f},Celsius,10:45:{2 * i:02d}" for i, T in enumerate(CHANNEL_K)],
    )
    (column,) = read_measured_csv(Path("t.csv")).of_kind(TEMPERATURE)
    np.testing.assert_allclose(column.si, CHANNEL_K, atol=0.006)


@pytest.mark.parametrize(
    ("head", "form"),
    [
        ('"report"\n("Time Step" "T (K)" "flow-time (s)")\n', lambda i, T: f"{i + 1} {T + 273.15:.6f} {2 * i}"),
        ("% Time (s)            T (K), Point: 1\n", lambda i, T: f"{2 * i:<22}{T + 273.15:.6f}"),
        ("unixtime,TC1 (C)\n", lambda i, T: f"{1709635500 + 2 * i},{T:.2f}"),
    ],
    ids=["Fluent", "COMSOL", "seconds of 1970"],
)
def test_histories_of_simulators_are_read_by_their_time(head: str, form: Callable[[int, float], str]) -> None:
    Path("t.txt").write_text(head + rows_of(form))
    measured = read_measured_csv(Path("t.txt"))
    (column,) = measured.of_kind(TEMPERATURE)
    np.testing.assert_allclose(column.si, CHANNEL_K, atol=0.006)
    np.testing.assert_allclose(measured.of_kind(TIME)[0].si, 2.0 * np.arange(12.0))


@pytest.mark.parametrize(
    "form",
    [
        lambda i, T: f"10:45:{2 * i:02d}.000 -> T1: {T:.2f} C T2: {T + 1:.2f} C",
        lambda i, T: f"[2024-05-03 10:45:{2 * i:02d}] T1 = {T:.2f} C, T2 = {T + 1:.2f} C",
    ],
)
def test_a_terminal_may_stamp_labelled_values(form: Callable[[int, float], str]) -> None:
    Path("t.txt").write_text(rows_of(form))
    measured = read_measured_csv(Path("t.txt"))
    for k, column in enumerate(measured.of_kind(TEMPERATURE)):
        assert column.name == f"T{k + 1}"
        np.testing.assert_allclose(column.si, CHANNEL_K + k, atol=0.006)
    np.testing.assert_allclose(measured.of_kind(TIME)[0].si, 2.0 * np.arange(12.0))


@pytest.mark.parametrize("row", ["25.1,26.1", "10:45:10.000 >> 25.1,26.1"])
def test_a_line_of_a_serial_monitor_without_its_time_is_not_lost(row: str) -> None:
    rows = [f"10:45:{2 * i:02d}.000 -> {20 + i}.1,{21 + i}.1" for i in range(12)]
    Path("t.txt").write_text("\n".join([*rows[:5], row, *rows[6:]]))
    with pytest.raises(InputError, match=r"t\.txt, row 6: .* does not have 3 cells as the other rows"):
        read_measured_csv(Path("t.txt"))


def test_labels_that_are_not_told_from_values_lose_no_sensor() -> None:
    Path("t.txt").write_text(rows_of(lambda i, T: f"10:45:{2 * i:02d}.000 -> T 1: {T:.2f} T 2: {T + 1:.2f}"))
    with pytest.raises(InputError):
        read_measured_csv(Path("t.txt"))


def test_seconds_of_labview_count_from_1904() -> None:
    rows("Time,TC1 (C)", [f"{3792480300 + 2 * i},{T - 273.15:.2f}" for i, T in enumerate(CHANNEL_K)])
    measured = read_measured_csv(Path("t.csv"))
    assert measured.zero_s == datetime(2024, 3, 5, 10, 45, tzinfo=UTC).timestamp()


def test_a_java_date_has_its_zone_before_the_year() -> None:
    rows(
        "t_stamp,TC1 (C)", [f"Tue Mar 05 10:45:{2 * i:02d} CET 2024,{T - 273.15:.2f}" for i, T in enumerate(CHANNEL_K)]
    )
    measured = read_measured_csv(Path("t.csv"))
    assert measured.zero_s == datetime(2024, 3, 5, 9, 45, tzinfo=UTC).timestamp()


def test_an_almemo_list_of_one_sensor_is_its_column() -> None:
    first = rows_of(lambda i, T: almemo(i, T, "  " + "<>"[i % 2]).splitlines()[0])  # marks of limits name no sensor
    Path("t.txt").write_text("ZEIT DATUM: 05.03.24\n" + first, encoding="utf-8")
    (column,) = read_measured_csv(Path("t.txt")).of_kind(TEMPERATURE)
    np.testing.assert_allclose(column.si, CHANNEL_K, atol=0.006)


@pytest.mark.parametrize(
    ("form", "change", "said"),
    [
        (almemo, lambda text: text.replace("10:45:06", "end of page\n10:45:06"), "row 8: `end of page` is no reading"),
        (almemo, lambda text: text.replace("01: +0023.40 °C", "01: +0023.40 °F"), "row 7: `01` has the unit °F, and"),
        (influx, lambda text: text.replace("TC2", "TC1"), "row 3: `value` has a second reading at one time"),
        (keysight, lambda text: text.replace(",102,0\n", ",102,0,Open\n", 3), "row 2: `Open` is no reading with unit"),
    ],
)
def test_a_line_that_is_none_of_its_list_is_named(
    form: Callable[[int, float], str], change: Callable[[str], str], said: str
) -> None:
    Path("t.txt").write_text(change("\n" + rows_of(form)), encoding="utf-8")
    with pytest.raises(InputError) as refusal:
        read_measured_csv(Path("t.txt"))
    assert said in str(refusal.value)


def test_columns_of_one_name_are_told_by_position_and_name(capsys: pytest.CaptureFixture[str]) -> None:
    warnings.simplefilter("always")
    rows("time (s),TC (C),TC (C)", [f"{2 * i},{20 + i},{20 + 0.5 * i}" for i in range(20)])
    command = ["new", "record", "--csv", "t.csv", "--layer", "copper 3 mm", "--lamp", "20kW/m2", "--out", "plate"]
    assert main(["--json", *command, "--depth", "TC=surface", "--depth", "TC 3=back"]) == 0
    told = "t.csv: columns 2 and 3 are named `TC`: `TC` and `TC 3` here, read as 2 sensors"
    assert told in json.loads(capsys.readouterr().out)["warnings"]


@pytest.mark.parametrize(
    ("unit", "reading"),
    [
        ("C", lambda i: f"{20 + 0.7 * i:.1f}"),
        ("degF", lambda i: f"{68 + 1.26 * i:.2f}"),
        ("K", lambda i: f"{293.15 + 0.7 * i:.0f}"),
    ],
    ids=["the same", "Fahrenheit", "fewer digits"],
)
def test_a_sensor_that_stands_in_a_file_twice_is_asked_for(unit: str, reading: Callable[[int], str]) -> None:
    """Its readings would count as those of two."""
    rows(
        f"time (s),TC (C),TC ({unit}),back (C)",
        [f"{2 * i},{20 + 0.7 * i:.1f},{reading(i)},{20 + i / 8}" for i in range(20)],
    )
    with pytest.raises(InputError, match=r"columns 2 and 3 are named `TC`, .* --temperature TC --temperature back$"):
        read_measured_csv(Path("t.csv"))
    read = read_measured_csv(Path("t.csv"), temperatures=("TC", "back"))
    assert [c.name for c in read.of_kind(TEMPERATURE)] == ["TC", "back"]


def test_probes_of_openfoam_are_sensors_at_their_places() -> None:
    head = "# Probe 0 (0 0 0.001)\n# Probe 1 (0 0 0.004)\n#       Probe    0    1\n#        Time\n"
    Path("T").write_text(head + "".join(f"   {0.5 * i:g}   {300 + i}   {300 + 0.5 * i:g}\n" for i in range(9)))
    read = read_measured_csv(Path("T"))
    assert (span_s(read), *range_K(read, 0), *range_K(read, 1)) == (4.0, 300.0, 308.0, 300.0, 304.0)
    assert [c.name for c in read.of_kind(TEMPERATURE)] == ["Probe 0", "Probe 1"]
    assert "0 at (0 0 0.001) m; 1 at (0 0 0.004) m" in read.layout
    Path("U").write_text(head + "   0   (1 0 0)   (2 0 0)\n")
    with pytest.raises(InputError, match=r"^U, row 5: .* is not a time and one number for each of 2 probes"):
        read_measured_csv(Path("U"))


PLATE = ("--layer", "copper 3 mm", "--emissivity", "0.9", "--out", "plate")


@pytest.mark.parametrize(
    ("column", "said"),
    [
        ("lamp (V)", "`V` is not a unit of heat flux"),
        ("lamp_V", "`V` is not a unit of heat flux"),
        ("wall (degF)", "`degF` is not a unit of heat flux"),
    ],
)
def test_a_lamp_of_another_quantity_is_refused(column: str, said: str) -> None:
    """Neither volts nor temperatures are a flux in kW/m2."""
    rows(f"time (s),TC (C),{column}", [f"{2 * i},{20 + i},{68 + i}" for i in range(9)])
    named = re.split(r" \(|_", column)[0]
    assert said in refused("new", "record", "--csv", "t.csv", *PLATE, "--depth", "TC=back", "--lamp", named)


def test_a_column_without_a_word_of_flux_is_the_lamp_where_it_is_named() -> None:
    rows("time (s),TC (C),foo", [f"{2 * i},{20 + i},{18}" for i in range(9)])
    assert run("new", "record", "--csv", "t.csv", *PLATE, "--depth", "TC=back", "--lamp", "foo").exit_code == 0
    assert np.all(load_record(Path("plate")).conditions["q_add_W_m2"] == 18e3)


def test_depths_and_lamp_are_named_as_in_the_file() -> None:
    rows("time (s),Chan 101 (C),Heat Flux (W m-2)", [f"{2 * i},{20 + i},900" for i in range(9)])
    options = ("--depth", "Chan 101 (C)=back", "--lamp", "Heat Flux (W m-2)")
    assert run("new", "record", "--csv", "t.csv", *PLATE, *options).exit_code == 0
    assert np.all(load_record(Path("plate")).conditions["q_add_W_m2"] == 900.0)


@pytest.mark.parametrize("column", ["p_surface_Pa", "sensor_psi", "surface (mbar)", "lamp_kW", "lamp (V)"])
def test_pressures_and_supplies_beside_a_thermocouple_are_no_readings_of_it(column: str) -> None:
    rows(f"time (s),TC (C),{column}", [f"{2 * i},{20 + i},{4000 + 7 * (i % 3)}" for i in range(9)])
    assert [c.name for c in read_measured_csv(Path("t.csv")).columns if c.kind != UNUSED] == ["time", "TC"]


def test_the_symbol_of_a_quantity_over_its_unit_is_a_name() -> None:
    rows("t/(s),T/(K),q/(W/m2)", [f"{2 * i},{300 + i},900" for i in range(9)])
    read = read_measured_csv(Path("t.csv"))
    assert [(c.name, c.unit) for c in read.columns] == [("t", "s"), ("T", "K"), ("q", "W/m2")]


def test_a_name_that_only_a_parser_takes_for_a_unit_states_none() -> None:
    """`uhr`, German for o'clock, is no micro-hour."""
    rows("uhr,TC (C)", [f"{2 * i},{20 + i}" for i in range(9)])
    assert span_s(read_measured_csv(Path("t.csv"), time="uhr")) == 16.0


def test_minutes_and_seconds_go_on_over_the_hour() -> None:
    """As spreadsheets show them, without hours."""
    rows("Time,TC (C)", [f"{(59 + (50 + 2 * i) // 60) % 60:02d}:{(50 + 2 * i) % 60:02d}.5,{20 + i}" for i in range(9)])
    read = read_measured_csv(Path("t.csv"))
    assert span_s(read) == 16.0
    assert read.notes == ("`Time` passes the hour once: an hour is added there",)


@pytest.mark.parametrize("blank", ["\u00a0", "\u202f"])
def test_blanks_of_thousands_separate_no_columns(blank: str) -> None:
    Path("t.csv").write_text(
        "Temps (s);TC (C)\n" + "".join(f"{2 * i};1{blank}0{10 + i},50\n" for i in range(9)), encoding="utf-8"
    )
    read = read_measured_csv(Path("t.csv"))
    assert (span_s(read), *range_K(read)) == pytest.approx((16.0, 1283.65, 1291.65))


def test_a_burnt_out_sensor_is_kept_and_one_without_a_reading_told() -> None:
    rows(
        "time (s),TC1 (C),TC2 (C),TC3 (C)",
        [f"{2 * i},{20 + i},{20 + i if i < 3 else 'Open TC'},Open TC" for i in range(30)],
    )
    with pytest.warns(UserWarning, match=r"^t\.csv, column TC3: not used, no cell holds a reading$"):
        read = read_measured_csv(Path("t.csv"))
    assert [(c.name, np.count_nonzero(np.isfinite(c.values))) for c in read.of_kind(TEMPERATURE)] == [
        ("TC1", 30),
        ("TC2", 3),
    ]


def test_the_air_of_a_flight_is_no_sensor_of_its_wall() -> None:
    rows("time_s,T_inf_K,p_surface_Pa,TC1_K", [f"{2 * i},{227 - i},{3000 + 7 * (i % 3)},{300 + i}" for i in range(9)])
    read = read_measured_csv(Path("t.csv"))
    assert [c.name for c in read.of_kind(TEMPERATURE)] == ["TC1"]
    assert [c.name for c in read_measured_csv(Path("t.csv"), temperatures=("T_inf",)).of_kind(TEMPERATURE)] == ["T_inf"]
