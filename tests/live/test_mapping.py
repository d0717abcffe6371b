"""Fields of messages become flight conditions and temperatures by the names, units and words that a link declares."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

import numpy as np
import pytest

from sim_heating.base.errors import InputError
from sim_heating.heating.atmosphere import us76
from sim_heating.heating.recorded.fields import column_unit
from sim_heating.inputs.record import load_record
from sim_heating.live.recording.to_record import Stretch, records_of
from sim_heating.live.sources.mapping import GRACE_MESSAGES, FieldMapping
from sim_heating.live.spec import make_link
from sim_heating.live.types import Frame, Message, Reading
from tests.live.links import FRAME, PLACE, link
from tests.support.paths import RECORDS


def message(**values: float | str) -> Message:
    return Message(0.0, b"", values)


def test_fields_by_the_names_and_units_of_a_record_need_no_mapping():
    frame, reading = FieldMapping(link()).apply(message(**FRAME, V09T9527_K=1100.0))
    assert frame == Frame(0.0, {k: v for k, v in FRAME.items() if k != "time_s"})
    assert reading == Reading(0.0, "V09T9527", "V09T9527", 1100.0)


def test_units_of_a_range_become_si_units():
    mapped = link(
        time={"field": "gmt_ms", "unit": "ms", "zero": 5000.0},
        conditions={
            "altitude_m": {"field": "h", "unit": "ft"},
            "velocity_m_s": {"field": "v", "unit": "ft/s"},
            "rho_kg_m3": {"field": "rho", "unit": "slug/ft3"},
            "alpha_deg": {"field": "alpha", "unit": "rad"},
            "beta_deg": {"constant": 0.5},
        },
        sensor=[{"sensor": "V09T9527", "field": "tc", "unit": "degF"}],
    )
    values = {"gmt_ms": 6500.0, "h": 240000.0, "v": 20000.0, "rho": 1e-7, "alpha": 0.7, "elevon_deg": 1.0}
    frame, reading = FieldMapping(mapped).apply(message(**values, bodyflap_deg=10.0, tc=1500.0))
    assert frame.time_s == pytest.approx(1.5)
    assert frame.values["altitude_m"] == pytest.approx(240000.0 * 0.3048)
    assert frame.values["velocity_m_s"] == pytest.approx(6096.0)
    assert frame.values["rho_kg_m3"] == pytest.approx(515.3788184e-7)
    assert frame.values["alpha_deg"] == pytest.approx(math.degrees(0.7))
    assert frame.values["beta_deg"] == 0.5
    assert reading.value_K == pytest.approx((1500.0 - 32.0) / 1.8 + 273.15)


def test_a_unit_in_the_name_of_a_field_is_that_of_the_field():
    mapped = link(conditions={"altitude_m": "Altitude ASL (ft)", "velocity_m_s": "v_kts"})
    values = {n: v for n, v in FRAME.items() if n not in ("altitude_m", "velocity_m_s")}
    (frame,) = FieldMapping(mapped).apply(message(**values, **{"Altitude ASL (ft)": 240000.0, "v_kts": 13000.0}))
    assert frame.values["altitude_m"] == pytest.approx(240000.0 * 0.3048)
    assert frame.values["velocity_m_s"] == pytest.approx(13000.0 * 1852.0 / 3600.0)


def test_dynamic_pressure_in_place_of_density_is_the_density():
    """rho = 2 q / V^2; a field of the density need not be sent."""
    mapped = link(conditions={"q_Pa": {"field": "qbar", "unit": "psf"}})
    values = {n: v for n, v in FRAME.items() if n != "rho_kg_m3"}
    (frame,) = FieldMapping(mapped).apply(message(**values, qbar=20.0))
    assert frame.values["rho_kg_m3"] == pytest.approx(2.0 * 20.0 * 47.880259 / 6800.0**2)
    with pytest.raises(InputError, match=r"q_Pa = 957\.605 at 0 m/s gives no density; no frame at 0 s"):
        FieldMapping(mapped).apply(message(**{**values, "velocity_m_s": 0.0}, qbar=20.0))


def test_a_word_of_a_recorder_is_its_temperature():
    codes = link(sensor=[{"sensor": "V09T9527", "field": "w", "codes": True}])
    found = [FieldMapping(codes).apply(message(time_s=0.0, w=w))[0].value_K for w in (0, 255)]
    assert found == [255.0, 1533.0]  # the ends of its range
    curve = link(sensor=[{"sensor": "V09T9527", "field": "w", "unit": "degC", "calibration": [10.0, 2.0, 0.01]}])
    (reading,) = FieldMapping(curve).apply(message(time_s=0.0, w=100.0))
    assert reading.value_K == pytest.approx(10.0 + 200.0 + 100.0 + 273.15)


@pytest.mark.parametrize("word", ["", "nan", float("nan")])
def test_a_word_that_is_no_number_is_a_lost_sample(word):
    (reading,) = FieldMapping(link()).apply(message(time_s=3.0, V09T9527_K=word))
    assert math.isnan(reading.value_K)


@pytest.mark.parametrize(
    ("values", "problem"),
    [
        ({"altitude_m": 74e3}, "time field `time_s` is missing"),
        ({"time_s": "noon"}, 'field `time_s`: "noon" is not a number'),
        ({"time_s": float("inf")}, "field `time_s`: inf is not a finite number"),
        (FRAME | {"velocity_m_s": 22300.0}, "looks like ft/s; no frame at 0 s"),
        (FRAME | {"alpha_deg": "?"}, 'field `alpha_deg`: "?" is not a number; no frame at 0 s'),
        ({"time_s": 0.0, "V09T9527_K": 20.0}, "looks like Celsius"),
        ({"time_s": 0.0, "V09T9527_K": 1700.0}, "outside the recorder's 255 to 1533 K"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(values, problem):
    with pytest.raises(InputError) as refused:
        FieldMapping(link()).apply(message(**values))
    (line,) = refused.value.problems
    assert problem in line


def test_a_bad_part_of_a_message_does_not_take_the_rest_with_it():
    said: list[str] = []
    samples = FieldMapping(link()).apply(message(**FRAME | {"rho_kg_m3": -1.0}, V09T9527_K=1100.0), said.append)
    assert [type(s) for s in samples] == [Reading]
    (line,) = said
    assert "rho_kg_m3" in line


@pytest.mark.parametrize(
    ("keys", "problem"),
    [
        ({"conditions": {"altitude_m": {"field": "h", "unit": "deg"}}}, "unit `deg` does not convert to `m`"),
        ({"conditions": {"altitude_m": {"field": "h", "unit": "furlongz"}}}, "unknown unit `furlongz`"),
        ({"conditions": {"altitud_m": "h"}}, "did you mean `altitude_m`?"),
        ({"time": {"unit": "K"}}, "unit `K` does not convert to `s`"),
        ({"sensor": [{"sensor": "V09T9572", "field": "x"}]}, "did you mean `V09T9527`?"),
        ({"sensor": [{"sensor": "V09T9527", "field": "x", "unit": "m"}]}, "unit `m` does not convert to `K`"),
    ],
)
def test_a_mapping_that_cannot_be_is_refused_before_anything_comes(keys, problem):
    with pytest.raises(InputError) as refused:
        FieldMapping(link(**keys))
    assert len(refused.value.problems) == 1
    assert problem in str(refused.value)


def test_columns_that_come_in_several_messages_are_one_frame():
    mapping = FieldMapping(link())
    first = {k: FRAME[k] for k in ("time_s", "altitude_m", "velocity_m_s", "rho_kg_m3")}
    rest = {k: v for k, v in FRAME.items() if k not in first or k == "time_s"}
    assert mapping.apply(message(**first)) == []
    (frame,) = mapping.apply(message(**rest))
    assert frame.values == {k: v for k, v in FRAME.items() if k != "time_s"}
    # angles that are not sent at 1 s are those of 0 s
    assert mapping.apply(message(**first | {"time_s": 1.0, "altitude_m": 73e3})) == []
    (frame,) = mapping.apply(message(**first | {"time_s": 2.0}))
    assert (frame.time_s, frame.values["altitude_m"], frame.values["alpha_deg"]) == (1.0, 73e3, 40.0)


def test_missing_mapped_field_is_named_with_the_nearest_one_sent():
    mapping = FieldMapping(link(conditions={"alpha_deg": "alpha"}))
    for k in range(GRACE_MESSAGES):
        assert mapping.never_sent() == []
        sent = {n: v for n, v in FRAME.items() if n != "alpha_deg"} | {"alphas": 40.0, "time_s": float(k)}
        mapping.apply(message(**sent))
    assert mapping.never_sent() == ["field `alpha` (alpha_deg) is not sent; did you mean `alphas`?"]


def test_every_condition_column_has_a_unit_that_converts_to_itself():
    assert [column_unit(c) for c in ("velocity_m_s", "h_ref_kg_m2_s", "q_add_W_m2", "log10_re", "jets")] == [
        "m/s", "kg/(m2.s)", "W/m2", "", ""
    ]  # fmt: skip


# What follows from what is sent ---------------------------------------------------------------------------------------


def frames_of(mapping: FieldMapping, rows: Iterable[Mapping[str, float]]) -> list[Frame]:
    """Frames of messages of flight conditions."""
    return [s for row in rows for s in mapping.apply(message(**row)) if isinstance(s, Frame)]


def test_a_density_that_is_not_sent_is_that_of_the_standard_atmosphere():
    mapping = FieldMapping(link())
    sent = [{n: v for n, v in FRAME.items() if n != "rho_kg_m3"} | {"time_s": float(k)} for k in range(6)]
    frames = frames_of(mapping, sent)
    assert [f.time_s for f in frames] == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]  # none is lost while it is waited for
    assert {f.values["rho_kg_m3"] for f in frames} == {float(us76(74e3)[2])}
    assert all(f.has_model_density for f in frames)
    (note,) = mapping.take_notes()
    assert note.startswith("rho_kg_m3 not sent: rho_kg_m3 of the standard atmosphere at altitude_m; confidence")


@pytest.mark.parametrize("q", ["q_Pa", "qbar (psf)"])
def test_a_dynamic_pressure_gives_the_density_that_is_not_sent(q):
    mapping = FieldMapping(link())
    sent = {n: v for n, v in FRAME.items() if n != "rho_kg_m3"} | {q: 20.0}
    frames = frames_of(mapping, [sent | {"time_s": float(k)} for k in range(4)])
    pascal = 20.0 * (47.880259 if "psf" in q else 1.0)
    assert frames[-1].values["rho_kg_m3"] == pytest.approx(2.0 * pascal / 6800.0**2)
    assert not frames[-1].has_model_density


def test_air_mach_reynolds_and_surface_pressure_follow_along_a_record():
    record = load_record(RECORDS / "sts96_480")
    gone = ("T_inf_K", "p_inf_Pa", "mach", "log10_re", "p_surface_Pa")
    flown = record.conditions.columns
    rows = [{n: float(v[k]) for n, v in flown.items() if n not in gone} for k in range(0, len(record.conditions), 20)]
    followed = make_link({"format": "link/1", "records": ["../records/sts96_480"]}, PLACE)
    frames = frames_of(FieldMapping(followed), rows)
    assert len(frames) == len(rows)
    for name, limit in (("T_inf_K", 0.01), ("p_inf_Pa", 0.01), ("mach", 0.01), ("log10_re", 2e-3)):
        derived = np.array([f.values[name] for f in frames])
        assert derived == pytest.approx(flown[name][::20], rel=limit, abs=1e-4), name
    # by the median part of the rise at a stagnation point, which turns with the angle of attack
    p = np.array([f.values["p_surface_Pa"] for f in frames])
    assert np.median(p / flown["p_surface_Pa"][::20]) == pytest.approx(1.0, abs=0.1)


def test_sideslip_that_a_record_has_nowhere_is_not_needed_and_alpha_is():
    followed = make_link({"format": "link/1", "records": ["../records/sts96_480"]}, PLACE)
    flown = {n: v for n, v in load_record(RECORDS / "sts96_480").conditions.columns.items() if n != "beta_deg"}
    rows = [{n: float(v[k]) for n, v in flown.items()} for k in range(0, 100, 10)]
    mapping = FieldMapping(followed)
    assert {f.values["beta_deg"] for f in frames_of(mapping, rows)} == {0.0}
    assert "beta_deg not sent: beta_deg as in the whole record" in mapping.take_notes()
    without = FieldMapping(followed)
    assert frames_of(without, [{n: v for n, v in r.items() if n != "alpha_deg"} for r in rows * 5]) == []
    (line,) = without.never_sent()
    assert line.startswith("field `alpha_deg` (alpha_deg) is not sent")


def test_fields_are_found_by_their_names_and_units_as_in_files():
    values = {"Altitude (ft)": 240000.0, "vel_ft_s": 20000.0, "rho [slug/ft3]": 1e-7, "AoA (rad)": 0.7}
    rest = {n: FRAME[n] for n in ("beta_deg", "elevon_deg", "bodyflap_deg")}
    mapping = FieldMapping(link())
    frame, *_ = frames_of(mapping, [{"time_s": float(k)} | values | rest for k in range(4)])
    assert frame.time_s == 0.0
    assert frame.values["altitude_m"] == pytest.approx(73152.0)
    assert frame.values["velocity_m_s"] == pytest.approx(6096.0)
    assert frame.values["rho_kg_m3"] == pytest.approx(515.3788184e-7)
    assert frame.values["alpha_deg"] == pytest.approx(math.degrees(0.7))
    assert "altitude_m from `Altitude (ft)`, in ft" in mapping.take_notes()


def test_a_time_is_found_by_its_name_and_unit_where_a_link_names_none():
    values = {n: v for n, v in FRAME.items() if n != "time_s"}
    mapping = FieldMapping(link())
    frames = frames_of(mapping, [values | {"Time (ms)": 2000.0 * k} for k in range(3)])
    assert [f.time_s for f in frames] == [0.0, 2.0, 4.0]
    assert mapping.take_notes() == ["time_s from `Time (ms)`, in ms"]
    with pytest.raises(InputError, match="time field `t_s` is missing"):
        FieldMapping(link(time={"field": "t_s"})).apply(message(**values, **{"Time (ms)": 0.0}))


def test_the_time_of_jsbsim_is_in_seconds_and_another_without_a_unit_is_asked_for():
    values = {n: v for n, v in FRAME.items() if n != "time_s"}
    mapping = FieldMapping(link({"kind": "jsbsim", "transport": "udp", "port": 5501}))
    frames = frames_of(mapping, [values | {"Time": 2.0 * k} for k in range(3)])
    assert [f.time_s for f in frames] == [0.0, 2.0, 4.0]
    assert mapping.take_notes() == ["time_s from `Time`, in s"]
    with pytest.raises(InputError, match=r'missing \(name it in \[time\], as field = "time", unit = "s"\)'):
        FieldMapping(link()).apply(message(**values, time=0.0))


def test_a_field_without_a_unit_is_not_taken_and_its_name_is_said():
    mapping = FieldMapping(link())
    sent = {n: v for n, v in FRAME.items() if n != "altitude_m"} | {"alt": 240000.0}
    assert frames_of(mapping, [sent | {"time_s": float(k)} for k in range(GRACE_MESSAGES)]) == []
    (line,) = mapping.never_sent()
    assert line == (
        "field `altitude_m` (altitude_m) is not sent; `alt` states no unit: name it with its unit in [conditions]"
    )


def test_sideslip_that_is_not_sent_may_be_stated_as_a_constant():
    mapping = FieldMapping(link())
    sent = {n: v for n, v in FRAME.items() if n != "beta_deg"}
    assert frames_of(mapping, [sent | {"time_s": float(k)} for k in range(GRACE_MESSAGES)]) == []
    (line,) = mapping.never_sent()
    assert line.endswith("is not sent; state a constant in [conditions], beta_deg = { constant = 0.0 }")


def test_a_density_of_a_slower_rate_is_waited_for_and_not_derived():
    rest = {n: v for n, v in FRAME.items() if n not in ("rho_kg_m3", "time_s")}
    rows = [{"time_s": 0.1 * k, **rest, **({"rho_kg_m3": 5e-5} if k % 10 == 7 else {})} for k in range(40)]
    frames = frames_of(FieldMapping(link()), rows)
    assert {f.values["rho_kg_m3"] for f in frames} == {5e-5}
    assert [f.time_s for f in frames] == pytest.approx([0.1 * k for k in range(7, 39)])


def test_a_density_that_comes_after_all_is_used():
    mapping = FieldMapping(link())
    rest = {n: v for n, v in FRAME.items() if n != "rho_kg_m3"}
    rows = [rest | {"time_s": float(k)} | ({"rho_kg_m3": 5e-5} if k > 9 else {}) for k in range(15)]
    frames = frames_of(mapping, rows)
    assert [f.values["rho_kg_m3"] == 5e-5 for f in frames] == [k > 9 for k in range(15)]
    assert [f.has_model_density for f in frames] == [k <= 9 for k in range(15)]
    assert mapping.has_model_density  # in a part of the flight
    assert mapping.take_notes()[-1] == "`rho_kg_m3` is sent: rho_kg_m3 is no longer derived"


def test_columns_without_effect_are_kept_where_sent_and_never_needed():
    followed = make_link({"format": "link/1", "records": ["../records/sts96_480"]}, PLACE)
    flown = load_record(RECORDS / "sts96_480").conditions.columns
    rows = [{n: float(v[k]) for n, v in flown.items()} for k in range(0, 60, 10)]
    bare = [{n: v for n, v in r.items() if n not in ("gamma_deg", "qbar_Pa", "axial_accel_g")} for r in rows]
    assert [set(f.values) for f in frames_of(FieldMapping(followed), bare)] == [set(bare[0]) - {"time_s"}] * 6
    assert [set(f.values) for f in frames_of(FieldMapping(followed), rows)] == [set(rows[0]) - {"time_s"}] * 6


def test_fields_of_a_source_are_checked_with_derived_columns():
    names = [n for n in FRAME if n != "rho_kg_m3"]
    FieldMapping(link()).check_sent(names, "the packets")
    with pytest.raises(InputError) as refused:
        FieldMapping(link()).check_sent([n for n in names if n not in ("alpha_deg", "altitude_m")], "the packets")
    assert [line.split("`")[1] for line in refused.value.problems] == ["altitude_m", "alpha_deg", "rho_kg_m3"]


def test_a_record_of_a_link_without_density_has_the_confidence_of_a_model():
    followed = link(estimate={"start": "declared"})
    rows = [{n: v for n, v in FRAME.items() if n != "rho_kg_m3"} | {"time_s": float(k)} for k in range(5)]
    mapping, stretch = FieldMapping(followed), Stretch()
    for row in rows:
        stretch.add_all(mapping.apply(message(**row, V09T9527_K=600.0)))
    record = records_of(followed, stretch)["V09T9527"]
    assert record.declared.conditions.confidence == "C"
    assert record.conditions["rho_kg_m3"] == pytest.approx(us76(np.full(5, 74e3))[2])
