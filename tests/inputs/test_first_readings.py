"""A record that begins hot and declares a cold wall is reported, by the reading and its time."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sim_heating.cli import main
from sim_heating.inputs.first_readings import declared_reading_K, other_start
from sim_heating.inputs.record import Record, load_record
from tests.support.paths import PRACTICE


def begun_at(record: Record, time_s: float) -> Record:
    """The record from a time of the flight on, as it is written by a link that came up then."""
    later = record.time_s >= time_s
    flown = record.conditions.at(record.conditions.time_s[record.conditions.time_s >= time_s])
    return replace(record, conditions=flown, thermocouples={n: v[later] for n, v in record.thermocouples.items()})


@pytest.mark.parametrize("name", [f"p{k:02d}" for k in range(1, 11)])
def test_a_flight_from_entry_interface_on_begins_as_declared(name: str) -> None:
    assert other_start(load_record(PRACTICE / name)) is None


def test_a_record_of_the_later_flight_begins_hot() -> None:
    record = begun_at(load_record(PRACTICE / "p06"), 650.0)
    found = other_start(record)
    assert found is not None
    assert found.is_hot
    assert found.time_s == pytest.approx(650.0, abs=1.0)
    assert found.reading_K > 800.0
    assert found.declared_K == pytest.approx(record.declared.stack.initial_K)
    assert "--start lost:700" in found.in_words


def test_a_declared_profile_is_compared_where_the_sensor_is() -> None:
    record = begun_at(load_record(PRACTICE / "p06"), 650.0)
    read = {s.depth_m: record.thermocouples[s.column] for s in record.used_sensors}
    rows = sorted([x, float(T[np.isfinite(T)][0])] for x, T in read.items())
    stack = record.declared.stack.model_copy(update={"initial": "profile", "initial_profile": rows})
    declared = replace(record, declared=record.declared.model_copy(update={"stack": stack}))
    assert other_start(declared) is None
    assert declared_reading_K(declared, record.used_sensors[0]) == pytest.approx(rows[0][1])


@pytest.mark.parametrize(
    ("file", "change", "told"),
    [
        ("record.toml", lambda text: text.replace("initial_K = 294.2", "initial_K = 529.6"), "begins cold"),
        ("thermocouples.csv", lambda text: in_rankine(text), "begins hot"),
    ],
)
def test_a_start_or_readings_in_rankine_are_told(
    file: str, change: Callable[[str], str], told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    record = Path(shutil.copytree(PRACTICE / "p06", tmp_path / "p06"))
    text = (record / "record.toml").read_text()
    (record / "record.toml").write_text(re.sub(r"(?m)^(bits|range_K) = .*\n", "", text))  # words of no recorder
    (record / file).write_text(change((record / file).read_text()))
    assert main(["validate", str(record)]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert f"p06 {told}: sensor LS_surface first reads" in said
    assert "the declared start is" in said


def in_rankine(text: str) -> str:
    """A table of readings in K with readings in degR under the same names."""
    head, *rows = text.splitlines()
    cells = [row.split(",") for row in rows]
    scaled = [[t, *(str(1.8 * float(T)) if T else "" for T in readings)] for t, *readings in cells]
    return "\n".join([head, *map(",".join, scaled)]) + "\n"
