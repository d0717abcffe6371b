"""A sample of `python -m benchmarks journals`: a real link in a process of its own that is killed, or sent nonsense."""

from __future__ import annotations

import os

import pytest

from benchmarks.journals import full_disk, half_open, hostile_packets, killed

pytestmark = pytest.mark.skipif(os.name != "posix", reason="SIGKILL and limits of a process")


@pytest.mark.thorough
def test_killed_link_loses_nothing_and_refuses_another_link_file():
    found = killed(1, print, seed=3)
    assert found.pop("kills") == 1
    assert found.pop("messages") > 0
    assert set(found.values()) == {0}, found


@pytest.mark.thorough
def test_hostile_packets_take_nothing_from_the_flight_between_them():
    found = hostile_packets(200, print, seed=3)
    assert found.pop("packets") == 200
    assert set(found.values()) == {0}, found


@pytest.mark.thorough
def test_half_open_connections_to_the_page_take_nothing_from_the_flight():
    found = half_open(400, 256)
    assert found.pop("messages") == 400
    assert found.pop("told") < 10_000
    assert set(found.values()) == {0}, found


@pytest.mark.thorough
def test_a_full_disk_costs_what_had_no_room_which_is_told():
    found = full_disk()
    assert 0 < found["found"] < found["messages"]
    assert (found["lost"], found["untold"], found["tracebacks"]) == (0, 0, 0)
