"""A sample of `python -m benchmarks reliability`: brokers, full file systems, clocks, damaged results, signals."""

from __future__ import annotations

import sys

import pytest

from benchmarks.reliability.flights import full_disks, hostile_topics, set_clocks, set_stamps
from benchmarks.reliability.killed_links import killed_links
from benchmarks.reliability.results import damaged_results
from benchmarks.reliability.signals import commands, signals

pytestmark = [
    pytest.mark.thorough,
    pytest.mark.skipif(sys.platform != "linux", reason="file systems, clocks and sessions of Linux"),
]


def test_hostile_payloads_of_a_broker_take_nothing_from_the_flight() -> None:
    pytest.importorskip("amqtt.broker")
    found = hostile_topics(100, seed=1)
    assert found.pop("payloads") == 100
    assert set(found.values()) == {0}, found


def test_a_file_system_that_fills_up_costs_what_had_no_room_which_is_told() -> None:
    found = full_disks(2, seed=1)
    del found["flights"], found["messages"]
    assert set(found.values()) == {0}, found


@pytest.mark.parametrize("act", [set_clocks, set_stamps])
def test_a_clock_that_is_set_takes_nothing_from_a_flight(act) -> None:
    found = act(5, 1)
    assert {n: c for n, c in found.items() if n != "moves" and "went back" not in n and c} == {}


@pytest.mark.filterwarnings("default:.*, which `.*` had not written:UserWarning")  # what --force replaces is reported
def test_damaged_results_are_made_again_or_refused_by_name() -> None:
    counted, faults = damaged_results(3, seed=1)
    assert sum(counted.values()) == 3
    assert faults == []


def test_a_killed_link_is_gone_on_with() -> None:
    found = killed_links(2, seed=1)
    assert found.pop("kills") == 2
    assert set(found.values()) == {0}, found


def test_signals_leave_the_status_the_object_and_nothing_else() -> None:
    for name in ("run", "new effect"):
        assert signals(name, commands()[name], count=1, seed=1) == []
