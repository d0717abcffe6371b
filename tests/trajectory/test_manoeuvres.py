"""Scripted manoeuvres: shapes as declared, started at their trigger, always within rate and limits."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import TypeAdapter, ValidationError

from sim_heating.trajectory.manoeuvres import CLOSED, JETS_HOLD, OPEN, ManoeuvreScript, polygon
from sim_heating.trajectory.spec import Manoeuvre, Popu, TrajectorySpec

READ = TypeAdapter(Manoeuvre).validate_python


def flown(*manoeuvres, rate_hz=50.0, end_s=120.0, speed=lambda t: 7000.0 - 5.0 * t):
    """Time and offsets (frames, 6) of a script along a speed history, Mach being speed / 300."""
    script = ManoeuvreScript([READ(m) for m in manoeuvres])
    time = np.arange(0.0, end_s, 1.0 / rate_hz)
    return time, np.array([script.offsets(t, speed(t), speed(t) / 300.0) for t in time]), script


def test_a_popu_pushes_over_and_pulls_up_by_its_amplitudes_at_its_rate():
    _, out, script = flown({"kind": "popu", "at_time_s": 10.0, "down_deg": 5.0, "up_deg": 5.0, "rate_deg_s": 1.0})
    alpha = 40.0 + out[:, 0]
    assert (alpha.min(), alpha.max(), alpha[-1]) == (35.0, 45.0, 40.0)
    assert np.abs(np.diff(alpha)).max() == pytest.approx(1.0 / 50.0)
    assert np.argmin(alpha) < np.argmax(alpha)
    window = script.windows()[0]
    assert (window.kind, window.start_s, window.end_s) == ("popu", 10.0, 10.0 + 5.0 + 2.0 + 10.0 + 2.0 + 5.0)


def test_a_popu_holds_both_angles_for_the_declared_time():
    popu = {"kind": "popu", "at_time_s": 5.0, "hold_s": 3.0, "hold_up_s": 25.0, "first": "up"}
    _, out, _ = flown(popu)
    held = {angle: np.count_nonzero(np.abs(out[:, 0] - angle) < 1e-9) / 50.0 for angle in (-5.0, 5.0)}
    assert held[-5.0] == pytest.approx(3.0, abs=0.03)
    assert held[5.0] == pytest.approx(25.0, abs=0.03)
    assert np.argmax(out[:, 0]) < np.argmin(out[:, 0])  # the pull-up first, as on STS-4


def test_a_pull_up_alone_is_a_popu_without_a_pushover():
    assert polygon(Popu(kind="popu", at_mach=12.0, down_deg=0.0, up_deg=6.0, rate_deg_s=2.0, first="up")) == [
        (0.0, 0.0), (3.0, 6.0), (5.0, 6.0), (8.0, 0.0), (10.0, 0.0),
    ]  # fmt: skip


@pytest.mark.parametrize("rate_hz", [2.0, 7.3, 60.0])
def test_a_velocity_trigger_fires_at_exactly_its_velocity_whatever_the_frame_rate(rate_hz):
    _, _, script = flown({"kind": "popu", "at_velocity_m_s": 6873.21}, rate_hz=rate_hz)
    start = script.windows()[0].start_s
    assert 7000.0 - 5.0 * start == pytest.approx(6873.21, abs=1e-9)


def test_a_mach_trigger_waits_for_mach_to_fall():
    """Above 90 km the true Mach number rises through 20 before it falls through it."""
    mach = lambda t: 18.0 + 0.2 * t if t < 50.0 else 28.0 - 0.2 * (t - 50.0)  # noqa: E731
    _, _, script = flown({"kind": "popu", "at_mach": 20.0}, speed=lambda t: 300.0 * mach(t))
    assert script.windows()[0].start_s == pytest.approx(90.0)


def test_a_trigger_that_is_never_met_is_reported_at_the_end():
    _, _, script = flown({"kind": "popu", "at_mach": 2.0})
    assert script.windows(120.0) == []
    assert script.events(120.0) == [(120.0, "popu at Mach 2: trigger never met; manoeuvre not flown")]


def test_manoeuvres_on_one_channel_wait_for_each_other():
    popu = {"kind": "popu", "at_time_s": 10.0}
    _, out, script = flown(popu, popu | {"at_time_s": 12.0})
    first, second = script.windows()
    assert second.start_s == first.end_s
    assert np.abs(out[:, 0]).max() == 5.0


def test_manoeuvres_on_different_channels_run_together():
    _, out, script = flown(
        {"kind": "popu", "at_time_s": 10.0}, {"kind": "bodyflap-pulse", "at_time_s": 10.0, "amplitude_deg": 8.0}
    )
    assert [w.start_s for w in script.windows()] == [10.0, 10.0]
    assert np.any((out[:, 0] != 0.0) & (out[:, 3] != 0.0))


def test_a_pulse_train_has_its_count_and_alternates():
    pulse = {"kind": "elevon-pulse", "at_time_s": 1.0, "amplitude_deg": 4.0, "count": 4, "alternate": True}
    _, out, _ = flown(pulse)
    peaks = out[np.flatnonzero(np.diff(np.abs(out[:, 2]) == 4.0, prepend=False)), 2]
    assert peaks[::2].tolist() == [4.0, -4.0, 4.0, -4.0]


def test_a_sweep_passes_from_one_deflection_to_the_other_at_its_rate():
    sweep = {"kind": "bodyflap-sweep", "at_time_s": 0.0, "from_deg": -6.0, "to_deg": 8.0, "rate_deg_s": 0.5}
    _, out, _ = flown(sweep)
    assert (out[:, 3].min(), out[:, 3].max()) == (pytest.approx(-6.0), pytest.approx(8.0))
    assert np.abs(np.diff(out[:, 3])).max() == pytest.approx(0.01)


def test_a_manoeuvre_of_no_amplitude_moves_nothing():
    nothing = {"kind": "popu", "at_time_s": 0.0, "down_deg": 0.0, "up_deg": 0.0, "hold_s": 0.0}
    _, out, script = flown(nothing, {"kind": "elevon-sweep", "at_time_s": 0.0, "to_deg": 0.0})
    assert not np.any(out[:, :5])
    assert [w.end_s - w.start_s for w in script.windows()] == [0.0, 0.0]


def test_a_sideslip_doublet_has_no_net_sideslip():
    time, out, _ = flown({"kind": "sideslip-doublet", "at_time_s": 5.0, "amplitude_deg": 2.0})
    assert np.trapezoid(out[:, 1], time) == pytest.approx(0.0, abs=1e-9)
    assert np.abs(out[:, 1]).max() == 2.0


def test_jets_fire_for_as_long_as_declared():
    firing = {"kind": "jet-firing", "at_time_s": 5.0, "on_s": 3.0, "off_s": 2.0, "count": 3, "level": 0.8}
    time, out, _ = flown(firing)
    impulse = np.trapezoid(out[:, 4], time)
    assert impulse == pytest.approx(3 * 0.8 * (3.0 + 0.1), rel=1e-2)


@pytest.mark.parametrize(
    ("manoeuvre", "pitch"),
    [
        ({"kind": "popu"}, CLOSED),
        ({"kind": "bodyflap-pulse", "amplitude_deg": 5.0}, CLOSED),
        ({"kind": "elevon-pulse", "amplitude_deg": 5.0}, JETS_HOLD),
        ({"kind": "elevon-sweep", "to_deg": 5.0, "alpha": "free"}, OPEN),
    ],
)
def test_the_pitch_loop_is_closed_frozen_or_open_as_declared(manoeuvre, pitch):
    _, out, _ = flown(manoeuvre | {"at_time_s": 10.0})
    assert out[:, 5].max() == pitch
    assert out[0, 5] == out[-1, 5] == CLOSED


SHAPES = st.one_of(
    st.fixed_dictionaries({
        "kind": st.just("popu"), "down_deg": st.floats(0.0, 8.0), "up_deg": st.floats(0.0, 8.0),
        "rate_deg_s": st.floats(0.3, 2.0), "hold_s": st.floats(0.0, 8.0), "first": st.sampled_from(["down", "up"]),
    }),
    st.fixed_dictionaries({
        "kind": st.sampled_from(["elevon-pulse", "bodyflap-pulse"]), "amplitude_deg": st.floats(-6.0, 6.0),
        "rate_deg_s": st.floats(0.5, 10.0), "count": st.integers(1, 4), "alternate": st.booleans(),
    }),
    st.fixed_dictionaries({
        "kind": st.sampled_from(["elevon-sweep", "bodyflap-sweep"]), "from_deg": st.floats(-5.0, 5.0),
        "to_deg": st.floats(-5.0, 5.0), "rate_deg_s": st.floats(0.3, 3.0),
    }),
    st.fixed_dictionaries({"kind": st.just("sideslip-doublet"), "amplitude_deg": st.floats(-3.0, 3.0)}),
)  # fmt: skip
TRIGGERS = st.one_of(
    st.fixed_dictionaries({"at_time_s": st.floats(0.0, 100.0)}),
    st.fixed_dictionaries({"at_velocity_m_s": st.floats(6500.0, 6999.0)}),
    st.fixed_dictionaries({"at_mach": st.floats(21.5, 23.0)}),
)
SCRIPTS = st.lists(st.builds(lambda a, b: a | b, SHAPES, TRIGGERS), min_size=1, max_size=4)


@pytest.mark.thorough
@settings(max_examples=60, deadline=None)
@given(SCRIPTS, st.sampled_from([4.0, 20.0, 60.0]))
def test_offsets_stay_within_amplitude_and_rate_for_any_script(manoeuvres, rate_hz):
    _, out, script = flown(*manoeuvres, rate_hz=rate_hz, end_s=200.0)
    for channel, kinds in ((0, ("popu",)), (1, ("side",)), (2, ("elevon",)), (3, ("bodyflap",))):
        own = [m for m in script.manoeuvres if m.kind.startswith(kinds)]
        largest = max((abs(v) for m in own for _, v in polygon(m)), default=0.0)
        fastest = max((m.rate_deg_s for m in own), default=0.0)
        assert np.abs(out[:, channel]).max() <= largest + 1e-12
        # A trigger between two frames is caught up with in the frame after it: two frames of motion at most.
        assert np.abs(np.diff(out[:, channel])).max() <= 2.0 * fastest / rate_hz + 1e-9


@settings(max_examples=60, deadline=None)
@given(SHAPES)
def test_every_manoeuvre_begins_and_ends_at_no_offset_and_time_goes_on(manoeuvre):
    points = np.array(polygon(READ(manoeuvre | {"at_time_s": 0.0})))
    assert points[0].tolist() == [0.0, 0.0]
    assert points[-1, 1] == 0.0
    assert np.all(np.diff(points[:, 0]) > 0.0)


@pytest.mark.parametrize(
    ("manoeuvre", "expected"),
    [
        ({"kind": "popu"}, "exactly one of at_velocity_m_s, at_mach, at_time_s, not none"),
        ({"kind": "popu", "at_mach": 20.0, "at_time_s": 3.0}, "not at_mach and at_time_s"),
        ({"kind": "popu", "at_mach": 20.0, "rate_deg_s": 0.0}, "rate_deg_s"),
        ({"kind": "popu", "at_mach": 20.0, "amplitude": 5.0}, "amplitude"),
        ({"kind": "loop", "at_mach": 20.0}, "kind"),
        ({"kind": "elevon-pulse", "at_mach": 20.0, "amplitude_deg": float("nan")}, "amplitude_deg"),
    ],
)
def test_a_manoeuvre_that_cannot_be_flown_is_refused(manoeuvre, expected):
    initial = {"altitude_m": 1.2e5, "velocity_m_s": 7400.0, "gamma_deg": -1.2, "heading_deg": 60.0, "latitude_deg": 0.0}
    with pytest.raises(ValidationError, match=expected):
        TrajectorySpec(source="entry-3dof", initial=initial, manoeuvre=[manoeuvre])
