"""Files as loggers write them: the span and the range of the readings that each states."""

from __future__ import annotations

import warnings

import numpy as np

from sim_heating.templates.measured_csv import TEMPERATURE, TIME, read_measured_csv
from tests.support.paths import DATA
from tests.support.verification.row import Row

LOGGERS = DATA / "loggers"
READ = {
    "benchlink.csv": (120.0, 293.0954, 397.6490), "hobo_am_pm.csv": (600.0, 276.0389, 282.7056),
    "time_msec_suffix.csv": (120.0, 293.1, 397.65), "unix_ms.csv": (120.0, 293.095, 397.649),
    "utc_log_us_autumn.csv": (120.0, 293.15, 397.55), "dst_offset.csv": (120.0, 293.1, 397.65),
    "day_first_month_end.csv": (120.0, 293.1, 397.65), "deg_dot_C.csv": (120.0, 323.1, 427.65),
    "rankine.csv": (120.0, 293.0944, 397.65), "btu_flux.csv": (120.0, 293.0944, 397.65),
    "w_m-2_flux.csv": (120.0, 293.1, 397.65), "peak_thousand_point.csv": (180.0, 1173.15, 1308.15),
    "mixed_tabs_blanks.dat": (120.0, 293.15, 397.55), "multi_rate.csv": (90.0, 293.15, 397.55),
    "sentinel_9999.csv": (120.0, 293.095, 397.65), "benchlink_open.csv": (120.0, 293.0954, 397.649),
    "max31855_fault_2048.csv": (120.0, 293.095, 397.65), "toa5.dat": (120.0, 293.095, 397.649),
    "labview.lvm": (120.0, 293.0954, 397.6490), "boxcar.txt": (120.0, 293.1, 397.65),
    "minutes_seconds_ms.csv": (120.0, 293.15, 397.55), "iso_basic.csv": (120.0, 293.1, 397.65),
    "unit_in_cells.csv": (120.0, 293.15, 397.55), "midnight_clock.csv": (120.0, 293.15, 397.55),
    "trailer.csv": (120.0, 293.15, 397.55), "long_format.csv": (120.0, 293.1, 397.65),
    "excel97.xls": (120.0, 293.15, 395.15),
}  # fmt: skip
"""File -> span [s], lowest and highest reading of its first sensor [K]."""


def rows() -> list[Row]:
    """All of this subject."""
    found = []
    for name, (span_s, low_K, high_K) in READ.items():
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # lost codes and units that are assumed are reported
            read = read_measured_csv(LOGGERS / name)
        t, T = read.of_kind(TIME)[0].si, read.of_kind(TEMPERATURE)[0].si
        values = (
            ("span", span_s, t[-1] - t[0], "s"),
            ("coldest", low_K, np.nanmin(T), "K"),
            ("hottest", high_K, np.nanmax(T), "K"),
        )
        found += [
            Row(
                f"{name}, {what}",
                expected,
                float(got),
                1e-4,
                unit,
                "the file's cells and units, by hand",
                "digits of the value by hand",
            )
            for what, expected, got, unit in values
        ]
    return found
