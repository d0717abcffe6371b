"""What a closed loop says on its page and in the terminal does not contradict itself, whatever its finding."""

from __future__ import annotations

import html
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from sim_heating.base.files import read_json
from sim_heating.cli import cli
from sim_heating.inputs.record import Record, Segments, load_record, write_record
from tests.support.few_candidates import search_among
from tests.support.paths import PRACTICE

INCOMPLETE = r"residuals are [\d.]+ times as large as those of noise"
PAIRS = (
    (r"(?<!not )explains? the record to its noise", INCOMPLETE),
    (r"(?<!not )explains? the record to its noise", r"noise floors remain"),
    (r"[Uu]nknown: something is missing", r"residual is consistent with noise(?! as)"),
    (r"[Nn]one: nothing is missing", INCOMPLETE),
    (r"[Nn]one: nothing is missing", r"does not explain the record"),
    (r"[Nn]one: nothing is missing", r"No aerothermal finding"),
    (r"leaves noise alone", INCOMPLETE),
    (r"Probability that this finding is right", r"[Nn]o probability is given"),
    (r"Found: ", r"is not stated as the cause"),
    (r"Found: ", r"which the record cannot tell apart"),
    (r"[Uu]nknown: something is missing", r"RMSE over fitted data: [\d.]+ K before"),
    (r"converged; the likelihood has a kink here", r"diverged"),
)
"""Lines of which no page and no terminal may have both."""
AMONG = ("alpha-curvature", "coating-thickness", "impingement-onset")


def practice(name: str) -> Record:
    return load_record(PRACTICE / name)


def with_readings(record: Record, change: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> Record:
    """The record with other readings of its first used sensor, by their times and temperatures."""
    column = record.used_sensors[0].column
    read = change(record.time_s, record.thermocouples[column].copy())
    return replace(record, thermocouples={**record.thermocouples, column: read})


def cut(record: Record, begin_s: float, end_s: float) -> Record:
    """Part of a record, which then begins in flight."""
    t, flown = record.time_s, record.conditions
    within, rows = (t >= begin_s) & (t <= end_s), flown.time_s[(flown.time_s >= begin_s) & (flown.time_s <= end_s)]
    declared = record.declared.model_copy(update={"segments": Segments()})
    measured = {n: v[within] for n, v in record.thermocouples.items()}
    return replace(record, declared=declared, conditions=flown.at(rows), thermocouples=measured)


def spikes(t: np.ndarray, read: np.ndarray) -> np.ndarray:
    read[150:1200:150] += 70.0
    return read


def louder_when_hot(t: np.ndarray, read: np.ndarray) -> np.ndarray:
    return read + np.random.default_rng(2).normal(0.0, 1.0, len(read)) * 0.004 * np.nan_to_num(read, nan=300.0)


def slow_wave(t: np.ndarray, read: np.ndarray) -> np.ndarray:
    return read + 8.0 * np.sin(2.0 * np.pi * t / 37.0)


RECORDS: dict[str, Callable[[], Record]] = {
    "nothing is missing": lambda: practice("p06"),
    "one effect": lambda: practice("p08"),
    "no effect of the library": lambda: practice("p02"),
    "outliers": lambda: with_readings(practice("p06"), spikes),
    "noise that grows with temperature": lambda: with_readings(practice("p06"), louder_when_hot),
    "a wave that is no heating": lambda: with_readings(practice("p06"), slow_wave),
    "ten seconds": lambda: cut(practice("p06"), 0.0, 12.0),
    "a minute": lambda: cut(practice("p08"), 300.0, 360.0),
    "a hot start": lambda: cut(practice("p06"), 650.0, 1400.0),
}


def texts(folder: Path, terminal: str) -> dict[str, str]:
    """The page and the terminal as a reader has them, in one line each."""
    page = re.sub(r"<(script|style).*?</\1>", " ", (folder / "report.html").read_text(), flags=re.DOTALL)
    page = html.unescape(re.sub(r"<[^>]+>", " ", page))
    return {"page": " ".join(page.split()), "terminal": " ".join(terminal.split())}


@pytest.mark.thorough
@pytest.mark.parametrize("kind", RECORDS)
def test_no_page_and_no_terminal_contradicts_itself(kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    search_among(monkeypatch, *AMONG)
    write_record(RECORDS[kind](), tmp_path / "record")
    ran = CliRunner().invoke(cli, ["close-loop", str(tmp_path / "record"), "--out", str(tmp_path / "out")])
    assert ran.exit_code == 0, ran.output
    for where, text in texts(tmp_path / "out", ran.output).items():
        both = [pair for pair in PAIRS if all(re.search(line, text) for line in pair)]
        assert not both, f"{kind}, {where}: {both}"
    _check_numbers(read_json(tmp_path / "out" / "closure.json"))


def _check_numbers(closure: dict) -> None:
    """What the file states agrees with itself."""
    finding, effect = closure["finding"], closure["effect"]["name"]
    assert (finding == "none") == (effect == "none" and not closure["not_effects"]) or closure["not_effects"]
    assert (closure["probability"] is None) or finding in ("found", "one of", "none")
    if closure["samples"]["fit"] < 30:
        assert closure["probability"] is None
    if finding == "none":
        assert closure["before"] == closure["after"]
        assert closure["resembles"] == []
    adequacy = closure["adequacy"]
    if finding in ("found", "none") and adequacy is not None and closure["samples"]["left_out"] == {}:
        assert adequacy["chi2_fit"] < 4.0
