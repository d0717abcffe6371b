"""Files of one truth in many layouts of loggers: how many are read right, refused, and read wrongly.

python -m benchmarks layouts, or python -m benchmarks.layouts [--files N] [--seed N]

A plate of two thermocouples, 61 readings 2 s apart, is written in random layouts: separators x decimal and thousands
signs x spellings and places of units x layouts of the clock x its offset x codes of lost samples x what stands before,
beside and behind the data. A file is read right where every time, counted from the first, and every reading is that of
the truth to the digits in the file, and every lost sample is lost. Nothing may be read wrongly.
"""

from __future__ import annotations

import math
import random
import tempfile
import warnings
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path

import click
import numpy as np

from benchmarks.measure import Figure, save, table
from sim_heating.base.arrays import FloatArray
from sim_heating.base.errors import InputError
from sim_heating.templates.measured_csv import TEMPERATURE, TIME, read_measured_csv

COUNT, SEED = 5000, 0
ROWS, STEP_S = 61, 2.0
GOAL_READ = 0.9
SPELLINGS = {
    "degC": ["C", "degC", "deg C", "deg. C", "Deg C", "°C", "ºC", "℃", "Celsius", "DEG C", "*C", "degrees C"],
    "degF": ["F", "degF", "deg F", "deg. F", "°F", "Fahrenheit", "Deg F"],
    "K": ["K", "Kelvin", "kelvin", "deg K", "°K"],
    "degR": ["degR", "deg R", "°R", "Rankine", "R"],
}
FROM_K: dict[str, Callable[[FloatArray], FloatArray]] = {
    "degC": lambda T: T - 273.15,
    "degF": lambda T: (T - 273.15) * 1.8 + 32.0,
    "K": lambda T: T,
    "degR": lambda T: T * 1.8,
}
TO_K: dict[str, Callable[[float], float]] = {
    "degC": lambda T: T + 273.15,
    "degF": lambda T: (T - 32.0) / 1.8 + 273.15,
    "K": lambda T: T,
    "degR": lambda T: T / 1.8,
}
NO_TEMPERATURE = ["mV", "counts", "Ohm", "xyz", "deg", "W"]
"""Units that a file may state of a thermocouple, by which it holds no temperatures: these are to be refused."""
FAULTS = ("two numbers", "two signs", "letters amid digits")
"""A cell that is no number in any layout: the file is to be refused, and no sample lost in silence."""
LOST = ["", "NaN", "NAN", "Open TC", "-9999", "9.9E+37", "9.90000000E+37", "---", "OL", "n/a"]


@dataclass
class Truth:
    """What a file states: time from the first row [s], temperatures [K] with NaN for lost samples."""

    time_s: FloatArray
    T_K: FloatArray


@dataclass
class Mutant:
    """A file in a random layout, and what it is made of."""

    raw: bytes
    truth: Truth
    traits: dict[str, str] = field(default_factory=dict)


def plate(rng: random.Random) -> FloatArray:
    """(61, 2) temperatures of two thermocouples in a plate under a lamp [K], from a room or from a hot start."""
    start, rise = rng.choice([(293.15, 100.0), (293.15, 600.0), (290.0, 1400.0), (800.0, 500.0)])
    t = STEP_S * np.arange(ROWS)
    shape = np.clip((t - 10.0) / 70.0, 0.0, 1.0) - 0.3 * np.clip((t - 85.0) / 40.0, 0.0, 1.0)
    noise = np.random.default_rng(rng.randrange(2**32)).normal(0.0, 0.05, (ROWS, 2))
    return start + np.column_stack((rise * shape, 0.8 * rise * shape)) + noise


def number(value: float, decimals: int, decimal: str, thousands: str) -> str:
    """A number with the signs of a layout."""
    text = f"{value:,.{decimals}f}"
    return text.replace(",", "\0").replace(".", decimal).replace("\0", thousands)


def clock_cells(kind: str, rng: random.Random, decimal: str) -> tuple[list[str], list[list[str]], str]:
    """Names, cells by column, and the unit that the name or a row states, of a layout of the clock."""
    t = STEP_S * np.arange(ROWS)
    start = datetime(
        2024,
        rng.choice([2, 5, 8, 12]),
        rng.choice([3, 7, 16, 28]),
        rng.choice([0, 9, 11, 14]),
        rng.randrange(60),
        rng.randrange(60),
    )
    stamps = [start + timedelta(seconds=float(x)) for x in t]
    title = rng.choice(["Time", "Timestamp", "Date Time", "time"])
    if kind == "s":
        zero = rng.choice([0.0, 10.0, 3600.5])
        return (
            [rng.choice(["Time", "time", "Elapsed time"])],
            [[number(x + zero, 1, decimal, "") for x in t]],
            rng.choice(["s", "sec", "seconds"]),
        )
    if kind == "ms":
        zero = rng.choice([0, 3011])
        return ["Time"], [[str(int(1000 * x) + zero) for x in t]], rng.choice(["ms", "msec", "milliseconds"])
    if kind == "millis":
        return ["millis"], [[str(int(1000 * x) + 3011) for x in t]], ""
    if kind == "min":
        return ["Time"], [[number(x / 60.0, 6, decimal, "") for x in t]], rng.choice(["min", "minutes"])
    if kind == "no unit":
        return ["Time"], [[number(x, 1, decimal, "") for x in t]], ""
    if kind == "unix s":
        return ["timestamp"], [[str(1714700000 + int(x)) for x in t]], ""
    if kind == "unix ms":
        return ["timestamp"], [[str(1714700000000 + int(1000 * x)) for x in t]], ""
    if kind == "day number":
        return ["Time"], [[number(45415.447916667 + x / 86400.0, 9, decimal, "") for x in t]], ""
    if kind == "clock":
        return ["Time"], [[s.strftime("%H:%M:%S") for s in stamps]], ""
    if kind == "clock ms":
        return ["Time"], [[s.strftime("%H:%M:%S") + f"{decimal}250" for s in stamps]], ""
    if kind == "midnight":
        late = [datetime(2024, 5, 3, 23, 59, 10) + timedelta(seconds=float(x)) for x in t]
        return ["Time"], [[s.strftime("%H:%M:%S") for s in late]], ""
    if kind == "h:m:s:ms":
        return [title], [[s.strftime("%m/%d/%Y %H:%M:%S:237") for s in stamps]], ""
    if kind == "iso":
        return (
            [title],
            [
                [s.strftime(rng_form) for s in stamps]
                for rng_form in [rng.choice(["%Y-%m-%dT%H:%M:%S", "%Y-%m-%d %H:%M:%S", "%Y/%m/%d %H:%M:%S"])]
            ],
            "",
        )
    if kind == "iso basic":
        return [title], [[s.strftime("%Y%m%dT%H%M%S") for s in stamps]], ""
    if kind == "iso offset":
        hours = rng.choice([-7, 0, 2])
        return [title], [[s.replace(tzinfo=timezone(timedelta(hours=hours))).isoformat() for s in stamps]], ""
    if kind == "offset changes":
        rows = []
        for k, s in enumerate(stamps):
            zone = timezone(timedelta(hours=2 if k < 30 else 1))
            rows.append((s.replace(tzinfo=UTC)).astimezone(zone).isoformat())
        return [title], [rows], ""
    if kind == "german":
        return (
            [rng.choice(["Zeit", "Datum", "Zeitstempel Datum"])],
            [[s.strftime("%d.%m.%Y %H:%M:%S") for s in stamps]],
            "",
        )
    if kind == "am pm":
        return (
            [title],
            [
                [s.strftime(rng_form) for s in stamps]
                for rng_form in [rng.choice(["%m/%d/%Y %I:%M:%S %p", "%m/%d/%y %I:%M:%S %p"])]
            ],
            "",
        )
    if kind == "day first":
        return [title], [[s.strftime("%d/%m/%Y %H:%M:%S") for s in stamps]], ""
    if kind == "month end":
        late = [datetime(2024, 1, 31, 23, 59, 20) + timedelta(seconds=float(x)) for x in t]
        form = rng.choice(["%d/%m/%Y %H:%M:%S", "%m/%d/%Y %H:%M:%S", "%d-%m-%y %H:%M:%S"])
        return [title], [[s.strftime(form) for s in late]], ""
    if kind == "two columns":
        return (
            ["Date", "Time"],
            [[s.strftime("%d/%m/%Y") for s in stamps], [s.strftime("%H:%M:%S") for s in stamps]],
            "",
        )
    if kind == "named month":
        return [title], [[s.strftime("%d-%b-%Y %H:%M:%S") for s in stamps]], ""
    if kind == "mm:ss":
        return ["Time"], [[f"{int(x) // 60:02d}:{int(x) % 60:02d}{decimal}5" for x in t]], ""
    raise ValueError(kind)


CLOCKS = (
    "s", "s", "s", "ms", "millis", "min", "no unit", "unix s", "unix ms", "day number", "clock", "clock ms", "midnight",
    "h:m:s:ms", "iso", "iso", "iso basic", "iso offset", "offset changes", "german", "am pm", "day first", "month end",
    "two columns", "named month", "mm:ss",
)  # fmt: skip
"""Layouts of the clock; those that are usual more than once."""


def mutant(seed: int) -> Mutant:
    """The file of a seed."""
    rng = random.Random(seed)
    separator = rng.choice([",", ",", ";", ";", "\t", "|", "  "])
    decimal = rng.choice([".", ","]) if separator != "," or rng.random() < 0.2 else "."
    unit = rng.choice(list(SPELLINGS))
    spelling = rng.choice(SPELLINGS[unit]) if rng.random() > 0.02 else rng.choice(NO_TEMPERATURE)
    kind = rng.choice(CLOCKS)
    if separator == "  " and kind not in (
        "s",
        "ms",
        "min",
        "no unit",
        "clock",
        "iso basic",
        "unix s",
        "two columns",
        "millis",
    ):
        kind = "s"
    thousands = "" if rng.random() < 0.8 or separator == "  " else {".": ",", ",": "."}[decimal]
    decimals = rng.choice([0, 1, 1, 2, 2, 2, 3])
    T = plate(rng)
    written = np.round(FROM_K[unit](T), decimals)
    place = rng.choice(
        ["[]", "()", "<>", "row", ",", "/", "_", "cells"]
        if separator not in (",", "  ")
        else ["[]", "()", "row", "_", "cells"]
    )
    if separator == "  ":
        place = rng.choice(["[]", "()", "row"])
        spelling = spelling.replace(" ", "")
    if place == "_" and spelling in ("xyz", "W"):
        spelling = "mV"  # T_xyz and T_W are names
    lost = rng.choice(["none", "none", *LOST])
    if separator == "  " and (" " in lost or not lost):
        lost = "NaN"
    heads, columns, time_unit = clock_cells(kind, rng, decimal)
    cells = [[number(float(written[i, k]), decimals, decimal, thousands) for i in range(ROWS)] for k in (0, 1)]
    gone = np.zeros((ROWS, 2), dtype=bool)
    if lost != "none":
        for i in rng.sample(range(ROWS), rng.choice([1, 4])):
            gone[i, rng.choice([0, 1])] = True
    word = lost.replace(".", decimal) if lost.startswith("9.9") else lost
    for k in (0, 1):
        cells[k] = [
            word if gone[i, k] else c + (f" {spelling}" if place == "cells" else "") for i, c in enumerate(cells[k])
        ]
    names = rng.choice(
        [
            ("TC1", "TC2"),
            ("Chan 101", "Chan 102"),
            ("Temp 1", "Temp 2"),
            ("T_front", "T_back"),
            ("Plate temperature", "Sensor B"),
        ]
    )
    if separator == "  ":
        names = tuple(n.replace(" ", "_") for n in names)  # type: ignore[assignment]
        heads = [h.replace(" ", "_") for h in heads]
    form = {"[]": "{} [{}]", "()": "{} ({})", "<>": "{} <{}>", ",": "{}, {}", "/": "{}/{}", "_": "{}_{}"}.get(
        place, "{}"
    )
    if separator == "  ":
        form = form.replace(" ", "")
    titles = [form.format(n, spelling) if place not in ("row", "cells") else n for n in names]
    brackets = form if form != "{}" else ("{} ({})" if separator != "  " else "{}({})")
    time_titles = [brackets.format(heads[0], time_unit) if time_unit and place != "row" else heads[0], *heads[1:]]
    if place == "/" and time_unit:
        time_titles[0] = f"{heads[0]}/{time_unit}"
    all_names, all_cells = [*time_titles, *titles], [*columns, *cells]
    units_row = [time_unit if place == "row" else "", *("" for _ in heads[1:]), spelling, spelling]
    beside = rng.choice(["none", "none", "counter", "humidity", "status"])
    if beside == "counter":
        all_names, all_cells, units_row = (
            [rng.choice(["#", "Scan", "Record", "No."]), *all_names],
            [[str(i + 1) for i in range(ROWS)], *all_cells],
            ["", *units_row],
        )
    if beside == "humidity":
        all_names, all_cells, units_row = (
            [*all_names, "RH (%)" if place != "row" else "RH"],
            [*all_cells, [number(45.7, 1, decimal, "")] * ROWS],
            [*units_row, "%"],
        )
    if beside == "status":
        all_names, all_cells, units_row = [*all_names, "Status"], [*all_cells, ["OK"] * ROWS], [*units_row, ""]
    quote_all = separator == "," and rng.random() < 0.2

    def line(parts: list[str]) -> str:
        if separator in (",", ";"):
            parts = [f'"{p}"' if quote_all or separator in p else p for p in parts]
        if separator == "  ":
            parts = [p if p else "-" for p in parts]
        return separator.join(parts)

    before = rng.choice(
        [
            [],
            [],
            ["Test 12"],
            ["Test 12", "copper plate; painted" if separator != ";" else "copper plate"],
            ["# logger 4711"],
        ]
    )
    fault = rng.choice(FAULTS) if rng.random() < 0.04 else ""
    if fault:
        row = rng.randrange(5, ROWS - 5)
        full = next(cell for cell in cells[1][4:] if cell)
        at = len(all_cells) - (2 if beside in ("humidity", "status") else 1)
        all_cells[at][row] = {"two numbers": f"{full} 30", "two signs": "1.2.3", "letters amid digits": "12x4"}[fault]
    rows = [line(list(r)) for r in zip(*all_cells, strict=True)]
    if rng.random() < 0.1 and separator not in ("  ",):
        rows = [r + separator for r in rows]
    behind = rng.choice([[], [], [], ["End of file"], [line(["Min", *[all_cells[-1][0]] * (len(all_cells) - 1)])]])
    text_lines = [*before, line(all_names), *([line(units_row)] if place == "row" else []), *rows, *behind]
    text = rng.choice(["\n", "\r\n"]).join(text_lines) + "\n"
    encoding = rng.choice(["utf-8", "utf-8", "utf-8-sig", "utf-16", "cp1252"])
    if encoding == "cp1252" and "℃" in text:
        encoding = "utf-8"
    truth_K: FloatArray = np.array(
        [[math.nan if gone[i, k] else TO_K[unit](float(written[i, k])) for k in (0, 1)] for i in range(ROWS)]
    )
    traits = {
        "separator": separator.replace("\t", "tab"), "decimal": decimal, "thousands": thousands,
        "unit": spelling, "place": place,
        "clock": kind, "lost": lost, "beside": beside, "before": str(len(before)),
        "behind": str(len(behind)), "encoding": encoding, "fault": fault,
    }  # fmt: skip
    return Mutant(text.encode(encoding), Truth(np.linspace(0.0, STEP_S * (ROWS - 1), ROWS), truth_K), traits)


def outcome(path: Path, made: Mutant) -> tuple[str, str]:
    """`right`, `refused`, `refused rightly` of a file that states no temperatures, or `wrong`; and why."""
    path.write_bytes(made.raw)
    is_sound = not made.traits["fault"] and made.traits["unit"] not in NO_TEMPERATURE
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = read_measured_csv(path)
    except InputError as error:
        line = str(error)
        if "\n" in line:
            return "wrong", f"several lines: {line}"
        return "refused" if is_sound else "refused rightly", line
    time_s, sensors = found.of_kind(TIME)[0].si, found.of_kind(TEMPERATURE)
    if not sensors:
        return "refused" if is_sound else "refused rightly", "no column is a temperature"
    if not is_sound:
        return "wrong", f"{made.traits['fault'] or made.traits['unit']} taken for a temperature or a lost sample"
    return _compared(time_s - time_s[0], [s.si for s in sensors], made.truth)


def share_read(found: Counter[str]) -> float:
    """Share of the files with sound readings that are read right."""
    return found["right"] / max(found.total() - found["refused rightly"], 1)


def _compared(time_s: FloatArray, T_K: list[FloatArray], truth: Truth) -> tuple[str, str]:
    if len(T_K) != truth.T_K.shape[1]:
        return "wrong", f"{len(T_K)} sensors"
    if len(time_s) != len(truth.time_s):
        # rows at the ends in which all sensors are lost say nothing
        return "wrong", f"{len(time_s)} rows"
    if np.max(np.abs(time_s - truth.time_s)) > 2e-3:
        return "wrong", f"span {time_s[-1]:g} s"
    for k, T in enumerate(T_K):
        true = truth.T_K[:, k]
        if not np.array_equal(np.isnan(T), np.isnan(true)):
            return "wrong", f"sensor {k + 1}: {np.isnan(T).sum()} lost for {np.isnan(true).sum()}"
        if np.nanmax(np.abs(T - true)) > 1e-6:
            return "wrong", f"sensor {k + 1}: off by {np.nanmax(np.abs(T - true)):g} K"
    return "right", ""


def outcomes(count: int, seed: int, folder: Path) -> tuple[Counter[str], Counter[str]]:
    """Outcomes of so many files, and reasons of those that were not read, by their numbers."""
    found: Counter[str] = Counter()
    reasons: Counter[str] = Counter()
    for k in range(count):
        made = mutant(seed + k)
        what, why = outcome(folder / "file.csv", made)
        found[what] += 1
        if what == "wrong":
            reasons[f"wrong: seed {seed + k}: {made.traits}: {why}"] += 1
        elif what != "right":
            reasons[f"{what}: {made.traits['clock']}: {why.partition(': ')[2][:60] or why}"] += 1
    return found, reasons


def run(count: int = COUNT, seed: int = SEED) -> list[Figure]:
    """Read the files, and count."""
    with tempfile.TemporaryDirectory() as folder:
        found, reasons = outcomes(count, seed, Path(folder))
    wrong = [reason for reason in reasons if reason.startswith("wrong")]
    figures = [
        Figure("files of one truth, read wrongly", found["wrong"], "", 0),
        Figure("read right, of those with sound readings", share_read(found), "", GOAL_READ, at_least=True),
        Figure("of these refused in one line", found["refused"], ""),
        Figure("without sound readings, refused in one line", found["refused rightly"], ""),
    ]
    save("layouts", figures, {"count": count, "seed": seed, "wrong": wrong, "reasons": dict(reasons.most_common(40))})
    return figures


@click.command(help=__doc__)
@click.option("--files", default=COUNT, show_default=True)
@click.option("--seed", default=SEED, show_default=True)
def main(files: int, seed: int) -> None:
    """Run and print."""
    click.echo(table(run(files, seed)))


if __name__ == "__main__":
    main()
