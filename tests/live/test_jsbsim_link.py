"""A JSBSim that runs in a process of its own is a source by its own UDP socket."""

from __future__ import annotations

import asyncio

import pytest

from tests.support.paths import ROOT


def test_a_running_jsbsim_is_followed_by_its_own_socket():
    pytest.importorskip("jsbsim")
    import importlib.util

    spec = importlib.util.spec_from_file_location("live_jsbsim", ROOT / "examples" / "live_jsbsim.py")
    example = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(example)
    last = asyncio.run(example.follow(5.0))
    assert last.link.state == "ended"
    assert last.link.damaged == 0
    assert last.time_s == pytest.approx(5.0, abs=0.3)
    assert last.conditions["altitude_m"] == pytest.approx(240000.0 * 0.3048, rel=0.01)
    assert last.conditions["velocity_m_s"] == pytest.approx(6096.0, rel=0.01)
    assert last.points["V09T9527"].surface_K > 300.0  # it began at 290 K and is heated
