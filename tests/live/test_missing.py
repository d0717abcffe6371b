"""When the sequential test fires: candidates weighed in another process, while the link goes on."""

from __future__ import annotations

import multiprocessing
import time
from itertools import pairwise
from pathlib import Path

import pytest

from sim_heating.base.files import read_json
from sim_heating.live.engine import LinkEngine
from sim_heating.live.recording.journal import NAME, Journal
from sim_heating.live.results.files import RESULT, write_results
from sim_heating.live.spec import Link, make_link
from sim_heating.live.state import State
from sim_heating.live.watch.missing import MOST_DEATHS
from tests.live.links import messages_of, part_of_record
from tests.support.few_candidates import weighing_among
from tests.support.paths import PRACTICE

FEW = ("conductivity", "heat-capacity", "coating-thickness", "emissivity", "time-skew")
DIED = "the process that weighs candidates died; the link goes on"


@pytest.fixture(scope="module")
def cold(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two minutes of a flight whose wall conducts otherwise than its record declares."""
    return part_of_record(PRACTICE / "p09", 0.0, 120.0, tmp_path_factory.mktemp("records") / "cold")


def followed(record: Path, folder: Path) -> LinkEngine:
    """The engine of a link that the record was streamed into as fast as it goes."""
    data = {"format": "link/1", "records": [str(record)], "source": [{"kind": "replay", "speed": 0.0}]}
    made: Link = make_link(data, record.parent / "link.toml")
    journal = Journal(folder / NAME, made.declared.model_dump(mode="json", exclude_unset=True), made.path)
    engine = LinkEngine(made, journal)
    for message in messages_of(made):
        engine.take(message)
        engine.advance()
    assert engine.test.alarm is not None
    return engine


def state_when(engine: LinkEngine, shown, within_s: float = 900.0) -> State:
    """The first state that shows something. The other process gives way to all that is at work: it may take minutes."""
    end = time.monotonic() + within_s
    while not shown(state := engine.state()):
        assert time.monotonic() < end, state.missing
        time.sleep(0.2)
    return state


@pytest.mark.thorough
def test_an_alarm_has_its_candidates_weighed_in_another_process(cold, tmp_path, monkeypatch):
    """Among a few; `python -m benchmarks practice` closes the whole record among all, and lists what is found."""
    weighing_among(monkeypatch, *FEW)
    engine = followed(cold, tmp_path)
    try:
        assert "candidates are being weighed" in engine.state().missing.text
        state = state_when(engine, lambda s: s.missing.candidates)
    finally:
        engine.stop()
    engine.journal.close(is_end=True)
    write_results(engine, state, tmp_path)
    missing = read_json(tmp_path / RESULT)["state"]["missing"]
    (candidate,) = missing["candidates"]
    assert "conductivity" in candidate["what"]  # the answer of the record
    assert 0.5 < candidate["probability"] <= 1.0
    assert f"probability {candidate['probability']:.2f}" in missing["text"]


@pytest.mark.thorough
def test_a_process_that_dies_is_one_remark_and_another_one_weighs(cold, tmp_path):
    engine = followed(cold, tmp_path)
    try:
        for _ in range(MOST_DEATHS):
            assert "candidates are being weighed" in engine.state().missing.text
            (process,) = multiprocessing.active_children()
            process.kill()
            process.join()
            state_when(engine, lambda s: not engine.weighing.busy or multiprocessing.active_children())
        last = state_when(engine, lambda s: "died 3 times" in s.missing.text)
    finally:
        engine.stop()
        engine.journal.close(is_end=True)
    assert [line for line in last.link.messages if line.startswith(DIED)] == [f"{DIED} (3 times)"]
    assert last.points
    assert not engine.weighing.busy


@pytest.mark.thorough
def test_record_grown_since_the_alarm_is_weighed_again(tmp_path, monkeypatch):
    """Among few candidates; when it is weighed does not depend on how many there are."""
    weighing_among(monkeypatch, "conductivity", "emissivity")
    record = part_of_record(PRACTICE / "p09", 0.0, 240.0, tmp_path / "longer")
    data = {"format": "link/1", "records": [str(record)], "source": [{"kind": "replay", "speed": 0.0}]}
    made = make_link(data, record.parent / "link.toml")
    journal = Journal(tmp_path / NAME, made.declared.model_dump(mode="json", exclude_unset=True), made.path)
    engine = LinkEngine(made, journal)
    ends: list[str] = []
    try:
        for message in messages_of(made):
            engine.take(message)
            engine.advance()
            before = engine.weighing.last
            if engine.weigh():  # the flight waits for it here: until a state is of it, which ends at any moment
                state = state_when(engine, lambda s, before=before: engine.weighing.last is not before)
                ends.append(state.missing.text)
    finally:
        engine.stop()
        journal.close(is_end=True)
    assert engine.test.alarm is not None
    until = [float(text.rpartition("on the record up to ")[2].partition(" s")[0]) for text in ends]
    alarm_s = engine.test.alarm.time_s
    assert len(until) >= 2
    assert until[1] - alarm_s >= 60.0 - 1.0
    assert all(b - alarm_s >= 2.0 * (a - alarm_s) - 1.0 for a, b in pairwise(until[1:]))


@pytest.mark.thorough
def test_a_step_at_the_surface_alone_is_no_drift_of_the_thermocouple_there(tmp_path):
    record = part_of_record(PRACTICE / "p04", 1000.0, 1215.0, tmp_path / "step")
    data = {"format": "link/1", "records": [str(record)], "source": [{"kind": "replay", "speed": 0.0}]}
    engine = LinkEngine(make_link(data, record.parent / "link.toml"))
    try:
        for message in messages_of(engine.link):
            engine.take(message)
            engine.advance()
        state = engine.state()
    finally:
        engine.stop()
    assert state.missing.alarm
    assert state.removed == []
    assert "undecided whether" in state.missing.text
    assert any("LS_surface" in line and "undecided" in line for line in state.link.messages)
