"""A link from its source to its state: a recorded flight replayed, killed and gone on with, and closed as a record."""

from __future__ import annotations

import asyncio
import json
import os
import re
import signal
import socket
import time
import warnings
from pathlib import Path

import numpy as np
import pytest

from sim_heating.base.progress import SAME_REQUEST_S
from sim_heating.inputs.record import Record, load_record
from sim_heating.live.engine import LinkEngine
from sim_heating.live.recording.journal import NAME, Journal
from sim_heating.live.recording.to_record import link_of, to_record
from sim_heating.live.run import Stop, _ending_signals, run, run_link
from sim_heating.live.spec import Link, make_link
from sim_heating.live.state import State, plain, state_json
from sim_heating.live.types import Message
from tests.live.links import FRAME, free_port, json_lines, link, messages_of, part_of_record
from tests.support.paths import ROOT

RECORD = ROOT / "scenarios" / "records" / "practice" / "p06"


@pytest.fixture(scope="module")
def short(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """200 s of a practice record, from the middle of the flight."""
    return part_of_record(RECORD, 500.0, 700.0, tmp_path_factory.mktemp("records") / "short")


@pytest.fixture(scope="module")
def moving(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """100 s of a practice record, with a manoeuvre."""
    return part_of_record(RECORD, 840.0, 940.0, tmp_path_factory.mktemp("records") / "moving")


def replaying(record: Path, **keys) -> Link:
    data = {"format": "link/1", "records": [str(record)], "source": [{"kind": "replay", "speed": 0.0}], **keys}
    return make_link(data, record.parent / "link.toml")


def contents(made: Link) -> dict:
    return made.declared.model_dump(mode="json", exclude_unset=True)


def journal_of(made: Link, folder: Path) -> Journal:
    return Journal(folder / NAME, contents(made), made.path)


def points_of(state: State) -> str:
    return json.dumps(plain(state.points))


@pytest.fixture(scope="module")
def followed(short: Path) -> State:
    """The last state of the replay."""
    return run(LinkEngine(replaying(short)))


def test_a_replayed_record_gives_an_estimate_with_its_bounds(followed: State, short: Path):
    (point,) = followed.points.values()
    record = load_record(short)
    assert followed.link.state == "ended"
    assert followed.time_s == record.conditions.time_s[-1]
    surface = point.sensors["LS_surface"]
    assert surface.measured_s == record.time_s[-1]
    assert abs(surface.measured_K - surface.predicted_K) < 5.0 * surface.sigma_K
    assert 0.0 < point.parameters["ratio.scale"].sigma < 0.1
    assert point.ratio == pytest.approx(point.ratio_declared * (1.0 + point.parameters["ratio.scale"].value), rel=0.05)
    assert json.loads(state_json(followed))["points"]["LS"]["surface_K"] == point.surface_K


def test_what_came_closes_as_the_record_that_was_sent(short: Path, tmp_path: Path):
    made = replaying(short)
    own = journal_of(made, tmp_path / "link")
    for message in messages_of(made):
        own.append(message.body)
    own.close(is_end=True)
    assert link_of(tmp_path / "link").names == ("LS",)
    (found,), notes = to_record(tmp_path / "link", tmp_path / "record")[0].values(), []
    sent, read = load_record(short), load_record(tmp_path / "record")
    assert notes == []
    assert same(sent, read)
    assert same(sent, found)
    assert read.declared.stack.initial == "profile"  # it was hot when the link came up


def same(a: Record, b: Record) -> bool:
    flown = all(np.array_equal(a.conditions[n], b.conditions[n]) for n in a.conditions.names)
    read = all(np.array_equal(a.thermocouples[n], b.thermocouples[n], equal_nan=True) for n in a.thermocouples)
    return flown and read and a.declared.stack.layer == b.declared.stack.layer


@pytest.mark.thorough
def test_killed_link_goes_on_from_its_journal_with_the_same_bits(short: Path, tmp_path, followed: State):
    made = replaying(short)
    engine = LinkEngine(made, journal_of(made, tmp_path))
    for message in messages_of(made)[:120]:
        engine.take(message)
        engine.advance()
    engine.journal.close(is_end=False)  # as after a kill: without its end
    again = LinkEngine(made, journal_of(made, tmp_path))
    assert again.journal.is_resumed
    state = run(again, resume=True)
    again.journal.close(is_end=True)
    assert again.remarks.lines()[0] == "goes on from a journal of 120 messages"
    assert points_of(state) == points_of(followed)


@pytest.mark.thorough
def test_messages_out_of_order_within_the_lateness_give_the_same_bits(short: Path, followed: State):
    engine = LinkEngine(replaying(short))
    rng = np.random.default_rng(1)
    messages = messages_of(engine.link)
    late = np.argsort(np.arange(len(messages)) + rng.uniform(0.0, 1.9, len(messages)), kind="stable")
    first = messages[:5]  # the first frame has to come first
    for message in [*first, *(messages[k] for k in late if k >= 5)]:
        engine.take(message)
        engine.advance()
    engine.end()
    state = engine.state()
    assert state.link.late > 10
    assert state.link.too_late == 0
    assert points_of(state) == points_of(followed)


@pytest.mark.thorough
def test_doubled_damaged_and_lost_samples_are_counted_and_told(short: Path, followed: State):
    engine = LinkEngine(replaying(short))
    for k, message in enumerate(messages_of(engine.link)):
        engine.take(message)
        if k % 10 == 0:
            engine.take(message)
            engine.take(Message(0.0, b"?", {}, damaged="? is not JSON"))
        engine.advance()
    engine.end()
    state = engine.state()
    assert state.link.doubled >= 20
    assert state.link.damaged == 21
    assert any("is not JSON (21 times)" in line for line in state.link.messages)
    assert points_of(state) == points_of(followed)


def sensor_apart(messages: list[Message], field: str, by_s: float, since_s: float) -> list[Message]:
    """The messages with one field sent by itself, stamped by a clock that jumps."""
    found = []
    for message in messages:
        time_s = float(message.values["time_s"])
        if field not in message.values or time_s < since_s:
            found.append(message)
            continue
        rest = {name: value for name, value in message.values.items() if name != field}
        own = {"time_s": time_s + by_s, field: message.values[field]}
        found += [Message(message.arrived_s, json.dumps(v).encode(), v) for v in (rest, own)]
    return found


@pytest.mark.thorough
def test_thermocouple_whose_clock_goes_back_is_removed_with_a_reason(moving: Path):
    engine = LinkEngine(replaying(moving))
    sensor = next(s for s in engine.link.points[0].sensors if s.used)
    for message in sensor_apart(messages_of(engine.link), sensor.column, -2.0, 900.0):
        engine.take(message)
        engine.advance()
    state = engine.state()
    (removed,) = state.removed
    assert (removed.sensor, removed.since_s) == (sensor.name, 898.0)
    assert "its clock went back" in removed.why
    (point,) = state.points.values()
    assert not point.sensors[sensor.name].used


@pytest.mark.thorough
@pytest.mark.sample(1)
@pytest.mark.parametrize(("by_s", "use"), [(-3.0, "are not used"), (-2.0, "are used by their times")])
def test_thermocouple_clock_that_goes_back_in_steady_flight_is_told(short: Path, by_s, use):
    # words of a recorder that come again are the same ones: that they come later than before tells
    engine = LinkEngine(replaying(short))
    sensor = next(s for s in engine.link.points[0].sensors if s.used)
    for message in sensor_apart(messages_of(engine.link), sensor.column, by_s, 600.0):
        engine.take(message)
        engine.advance()
    (told,) = [m for m in engine.state().link.messages if "its clock went back, or it is sent late" in m]
    assert f"readings of {sensor.name} after 599 s" in told
    assert use in told


@pytest.mark.thorough
def test_newest_conditions_are_those_of_a_clock_that_went_back(short: Path):
    engine = LinkEngine(replaying(short))
    for message in messages_of(engine.link):
        t = float(message.values["time_s"])
        body = {**message.values, "time_s": t if t < 600.0 else t - 60.0}
        engine.take(Message(message.arrived_s, json.dumps(body).encode(), body))
        engine.advance()
        if t == 610.0:
            assert engine.state().conditions["velocity_m_s"] == body["velocity_m_s"]


@pytest.mark.thorough
def test_one_reading_far_off_is_left_out_and_told(moving: Path):
    engine = LinkEngine(replaying(moving))
    sensor = next(s for s in engine.link.points[0].sensors if s.used)
    for message in messages_of(engine.link):
        values = dict(message.values)
        if values["time_s"] == 912.0:
            values[sensor.column] = float(values[sensor.column]) - 60.0
        engine.take(Message(message.arrived_s, json.dumps(values).encode(), values))
        engine.advance()
    state = engine.state()
    (told,) = [line for line in state.link.messages if "left out" in line]
    assert re.search(rf"1 reading of {sensor.name} at 912\.0 s left out: (5|6)\d K from the prediction", told)
    assert state.removed == []
    assert not state.missing.alarm


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["p06", "p07"])
def test_steep_heating_without_an_effect_leaves_out_no_reading(name):
    engine = LinkEngine(replaying(RECORD.parent / name))
    for message in messages_of(engine.link):
        engine.take(message)
        engine.advance()
    assert [line for line in engine.remarks.lines() if "left out" in line] == []


@pytest.mark.thorough
def test_a_link_is_waiting_then_live_then_stalled():
    port = free_port()
    made = link({"kind": "json-lines", "port": port}, output={"rate_Hz": 10.0})
    engine = LinkEngine(made)
    states: list[State] = []

    async def main() -> None:
        stop = Stop()
        task = asyncio.create_task(run_link(engine, on_state=states.append, stop=stop))
        await asyncio.sleep(0.5)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as own:
            for k in range(20):
                own.sendto(json_lines([FRAME | {"time_s": k / 10.0}]), ("127.0.0.1", port))
                await asyncio.sleep(0.05)
        await asyncio.sleep(2.0)
        stop.set()
        await task

    asyncio.run(main())
    phases = list(dict.fromkeys(s.link.state for s in states))
    assert phases == ["waiting", "live", "stalled", "ended"]
    assert engine.counts["frames"] == 20
    assert max(s.link.frames_Hz for s in states) > 5.0
    live = [s.wall_s for s in states if s.link.state == "live"]
    stalled = next(s for s in states if s.link.state == "stalled")
    assert stalled.wall_s - live[-1] < 1.0  # states go on while nothing comes
    assert stalled.link.since_s < 2.0


def test_a_problem_of_a_source_ends_the_link_with_its_line(tmp_path):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        made = link({"kind": "json-lines", "port": other.getsockname()[1]})
        begun = time.monotonic()
        with pytest.raises(ValueError, match="is in use"):
            run(LinkEngine(made))
        assert time.monotonic() - begun < 60.0


@pytest.mark.skipif(os.name != "posix", reason="signals of Unix")
def test_a_second_request_ends_a_link_whose_estimate_is_still_at_work() -> None:
    async def ask(*, begins: bool) -> list[bool]:
        stop = Stop()
        stop.has_begun = begins
        with _ending_signals(stop), warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of what a second request does
            for _ in range(3):
                signal.raise_signal(signal.SIGINT)
                await asyncio.sleep(0.6 * SAME_REQUEST_S)
                seen.append(stop.is_set())
        return seen

    for begins, answered in ((False, 0), (True, 2)):
        seen: list[bool] = []
        with pytest.raises(KeyboardInterrupt):
            asyncio.run(ask(begins=begins))
        assert seen == [True] * answered, "the first request lets it end by itself, one at once after it is the same"
