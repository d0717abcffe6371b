"""Flight records: reading, segments, noise floor, and records that write back equal."""

from __future__ import annotations

import math
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim_heating.base.conditions import Conditions
from sim_heating.base.errors import InputError
from sim_heating.base.files import check, csv_text, read_csv_columns, toml_text, write_csv
from sim_heating.closure.batch import record_job, record_names
from sim_heating.inputs.record import (
    Record,
    RecordFile,
    in_segments,
    load_record,
    load_records,
    make_record,
    pooled_rmse_K,
    write_record,
)
from sim_heating.thermal.stack import Sensor, Stack, construct
from tests.support.paths import DATA, PRACTICE

RECORDS = [DATA / "records" / "tile", DATA / "records" / "board", PRACTICE / "p06", PRACTICE / "p07"]


@pytest.fixture(scope="module")
def tile() -> Record:
    return load_record(DATA / "records" / "tile")


def assert_equal(a: Record, b: Record) -> None:
    assert a.declared == b.declared
    assert a.conditions.names == b.conditions.names
    for name in a.conditions.names:
        np.testing.assert_array_equal(a.conditions[name], b.conditions[name])
    for name in ("time_s", *(s.column for s in a.sensors)):
        np.testing.assert_array_equal(a.thermocouples[name], b.thermocouples[name])
    if a.ratio_table is None or b.ratio_table is None:
        assert a.ratio_table is b.ratio_table
    else:
        np.testing.assert_array_equal(a.ratio_table.ratio, b.ratio_table.ratio)
        assert a.ratio_table.header == b.ratio_table.header


@pytest.mark.parametrize("folder", RECORDS, ids=lambda p: p.name)
def test_a_record_writes_back_equal(tmp_path: Path, folder: Path) -> None:
    record = load_record(folder)
    write_record(record, tmp_path / "copy")
    assert_equal(record, load_record(tmp_path / "copy"))


def test_a_record_replaces_an_earlier_one_of_this_program(tmp_path: Path, tile: Record) -> None:
    write_record(tile, tmp_path / "copy")
    later = replace(tile, conditions=tile.conditions.with_columns(mach=20.0))
    write_record(later, tmp_path / "copy")
    assert_equal(later, load_record(tmp_path / "copy"))


def test_a_record_of_other_origin_is_not_overwritten(tile: Record, tmp_path: Path) -> None:
    (tmp_path / "record.toml").write_text("# mine\n")
    with pytest.raises(InputError, match=r"record\.toml already exists and was not written by sim-heating"):
        write_record(tile, tmp_path)


@pytest.mark.parametrize("name", ["p06", "p07"])
def test_a_practice_record_declares_the_noise_it_was_made_with(name: str) -> None:
    record = load_record(PRACTICE / name)
    truth = tomllib.loads((PRACTICE / name / "truth.toml").read_text())
    # the generator weighted its two sensors equally, the contract weights them by samples: some are lost
    equal = math.sqrt(np.mean([s.noise_sigma_K**2 + s.lsb_K**2 / 12 for s in record.used_sensors]))
    assert equal == pytest.approx(truth["noise_floor_K"], abs=0.0005)
    assert record.noise_floor_K() == pytest.approx(equal, rel=0.01)


def test_a_practice_record_holds_what_its_files_hold() -> None:
    record = load_record(PRACTICE / "p07")
    assert record.name == "p07"
    assert [s.depth_m for s in record.sensors] == [0.00048, 0.03748]
    assert record.time_s[:2].tolist() == [0.51, 1.51]
    assert record.temperatures_K()[:, 0].tolist() == [288.57, 289.89]
    assert record.conditions["H_r_J_kg"][0] == 3.023918e7
    assert record.ratio_table is not None
    assert record.ratio_table.ratio[0, 0, 0, 0, 0] == 0.049278
    assert record.construction.stack.bondline_m == pytest.approx(0.03748, abs=1e-12)


def test_an_empty_cell_is_a_lost_sample(tile: Record) -> None:
    lost = np.isnan(tile.temperatures_K())
    assert np.flatnonzero(lost[0]).tolist() == [5, 6]
    assert np.flatnonzero(lost[1]).tolist() == [9]


def test_further_columns_are_kept_and_absent_ones_are_absent(tile: Record) -> None:
    assert "axial_accel_g" in tile.conditions
    board = load_record(DATA / "records" / "board")
    assert "h_ref_kg_m2_s" not in board.conditions
    assert board.declared.measured


def test_both_ends_of_a_segment_belong_to_it() -> None:
    assert in_segments([9.99, 10.0, 20.0, 20.01], [[10.0, 20.0]]).tolist() == [False, True, True, False]


def test_what_is_held_out_is_never_fitted(tile: Record) -> None:
    fit, holdout = tile.fit_mask(), tile.holdout_mask()
    assert not np.any(fit & holdout)
    assert tile.time_s[holdout].tolist() == [100.5, 110.5, 120.5, 130.5]
    assert tile.time_s[~fit & ~holdout].tolist() == [200.5]


def test_a_record_without_segments_is_fitted_whole() -> None:
    board = load_record(DATA / "records" / "board")
    assert board.fit_mask().all()
    assert not board.holdout_mask().any()


def test_the_noise_floor_is_sigma_and_step_of_the_used_sensors(tile: Record) -> None:
    step = (1644.0 - 255.0) / 255.0
    assert tile.used_sensors[0].lsb_K == pytest.approx(step)
    assert tile.noise_floor_K() == pytest.approx(math.sqrt(1.0 + step**2 / 12.0))
    assert math.isnan(tile.noise_floor_K(np.zeros(tile.time_s.size, dtype=bool)))


def test_a_sensor_without_declared_noise_takes_the_estimated_one() -> None:
    board = load_record(DATA / "records" / "board")
    with pytest.raises(InputError, match=r"sensor joint 1: noise_sigma_K is neither declared nor estimated"):
        board.noise_floor_K()
    sigma = {"joint 1": 1.0, "joint 2": 2.0, "joint 3": 3.0}
    assert board.noise_floor_K(estimated_sigma_K=sigma) == pytest.approx(math.sqrt(14.0 / 3.0))


def test_rmse_is_pooled_over_sensors_and_lost_samples_do_not_count() -> None:
    residual = np.array([[3.0, np.nan, 100.0], [4.0, -5.0, 100.0]])
    error = pooled_rmse_K(residual, np.array([True, True, False]))
    assert error == {"rmse_K": pytest.approx(math.sqrt(50.0 / 3.0)), "max_abs_K": 5.0, "n": 3}
    assert pooled_rmse_K(residual, np.zeros(3, dtype=bool)) is None


# Parts in memory -----------------------------------------------------------------------------------------------------


def test_a_record_of_parts_is_checked_like_one_that_is_read(tile: Record) -> None:
    parts = dict(tile.thermocouples)
    assert_equal(make_record(tile.declared, tile.conditions, parts, tile.ratio_table), tile)
    celsius = parts | {"TEST_bond_K": parts["TEST_bond_K"] - 273.15}
    with pytest.raises(InputError, match=r"record/thermocouples\.csv, row 2, column TEST_bond_K: 17\.85 is below 100"):
        make_record(tile.declared, tile.conditions, celsius, tile.ratio_table)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"TEST_bond_K": [300.0]}, "column TEST_bond_K: needs one value a sample"),
        ({"TEST_bond_K": [np.inf] * 21}, "column TEST_bond_K: contains a value that is not a finite number"),
        ({"time_s": [np.nan] * 21}, "column time_s: contains a value that is not a finite number"),
    ],
)
def test_measurements_that_no_file_could_hold_are_refused(
    tile: Record, change: dict[str, list[float]], expected: str
) -> None:
    with pytest.raises(InputError) as caught:
        make_record(tile.declared, tile.conditions, {**tile.thermocouples, **change}, tile.ratio_table)
    assert expected in caught.value.problems[0]


def test_parts_that_are_missing_are_named(tile: Record) -> None:
    with pytest.raises(InputError, match="there is no column `TEST_surface_K`"):
        make_record(tile.declared, tile.conditions, {"time_s": [0.0]}, tile.ratio_table)
    with pytest.raises(InputError, match="`ratio_table` and the given table must both be present"):
        make_record(tile.declared, tile.conditions, tile.thermocouples, None)
    flown = {n: tile.conditions[n] for n in tile.conditions.names if n != "mach"}
    with pytest.raises(InputError, match="there is no column `mach`"):
        make_record(tile.declared, Conditions(flown), tile.thermocouples, tile.ratio_table)


def test_a_stack_knows_its_faces() -> None:
    layers = [{"material": "a", "thickness_m": 0.001}, {"material": "b", "thickness_m": 0.04}]
    stack = check({"initial_K": 290.0, "back": "adiabatic", "layer": layers}, Stack, "stack")
    assert stack.interfaces_m.tolist() == [0.0, 0.001, 0.041]
    assert stack.bondline_m == 0.001
    assert stack.holds(0.041)
    assert not stack.holds(0.0411)


def test_a_construction_keeps_the_materials_of_its_layers_only(tile: Record) -> None:
    materials = {**tile.declared.materials, "spare": tile.declared.materials["rcg"]}
    construction = construct(tile.declared.stack, materials, "TEST.toml")
    assert list(construction.materials) == ["rcg", "li900", "al2024"]
    assert construction.layer_materials()[1].density_kg_m3 == 144.2


def test_conductivity_is_one_grid_whether_or_not_it_depends_on_pressure(tile: Record) -> None:
    p_Pa, T_K, k = tile.declared.materials["li900"].conductivity_grid()
    assert (p_Pa.size, T_K.size, k.shape) == (3, 2, (2, 3))
    assert tile.declared.materials["rcg"].conductivity_grid()[2].tolist() == [[0.9], [1.4]]


# Round trips over wide input -----------------------------------------------------------------------------------------

numbers = st.floats(allow_nan=False, allow_infinity=False)
texts = st.text(st.characters(codec="utf-8"), max_size=20)
toml_values = st.recursive(
    st.one_of(st.booleans(), st.integers(), numbers, texts),
    lambda inner: st.one_of(st.lists(inner, max_size=3), st.dictionaries(texts, inner, max_size=3)),
    max_leaves=12,
)


@given(st.dictionaries(texts, toml_values, max_size=5))
def test_plain_data_reads_back_from_toml_as_it_was_written(data: dict[str, object]) -> None:
    assert tomllib.loads(toml_text(data)) == data


@settings(max_examples=50, deadline=None)
@given(values=st.lists(st.one_of(st.just(math.nan), numbers), min_size=1, max_size=20))
def test_numbers_read_back_from_csv_bit_by_bit(tmp_path_factory: pytest.TempPathFactory, values: list[float]) -> None:
    path = tmp_path_factory.mktemp("csv") / "a.csv"
    write_csv(path, {"time_s": np.arange(len(values)), "x_K": values})
    table = read_csv_columns(path, ["time_s"], allow_empty=["x_K"])
    assert table["x_K"].tobytes() == np.where(np.isnan(values), np.nan, values).tobytes()


def test_a_number_format_is_kept_to_its_column() -> None:
    text = csv_text({"time_s": [0.5], "T_K": [290.123456]}, {"T_K": ".2f"}, {"source": "a\nb"})
    assert text == "# source: a b\ntime_s,T_K\n0.5,290.12\n"


sensors = st.builds(
    dict,
    name=st.text(st.characters(codec="utf-8"), min_size=1, max_size=8),
    column=st.from_regex(r"[A-Za-z0-9_ ,\"]{0,8}x_K", fullmatch=True).filter(lambda s: s == s.strip()),
    depth_m=st.just(0.0) | st.floats(1e-6, 0.04438),
    noise_sigma_K=st.just(0.0) | st.floats(1e-5, 10.0),
    used=st.booleans(),
    sample_offset_s=st.floats(-1.0, 1.0),
)


@pytest.mark.thorough
@settings(max_examples=50, deadline=None)
@given(
    sensor=st.lists(sensors, min_size=1, max_size=3, unique_by=(lambda s: s["name"], lambda s: s["column"])),
    title=texts,
    fit=st.lists(st.tuples(st.floats(0.0, 100.0), st.floats(100.0, 200.0)).map(list), max_size=3),
)
def test_any_valid_record_writes_back_equal(
    tmp_path_factory: pytest.TempPathFactory,
    tile: Record,
    sensor: list[dict[str, object]],
    title: str,
    fit: list[list[float]],
) -> None:
    data = tile.declared.model_dump(exclude_unset=True)
    data |= {"title": title, "segments": {"fit": fit}, "thermocouples": {"sensor": sensor}}
    measured = {"time_s": tile.time_s} | {str(s["column"]): tile.time_s + 290.0 for s in sensor}
    record = make_record(check(data, RecordFile, "record.toml"), tile.conditions, measured, tile.ratio_table)
    copy = tmp_path_factory.mktemp("record") / "copy"
    write_record(record, copy)
    assert_equal(record, load_record(copy))


def test_the_keys_of_a_sensor_are_those_of_the_contract() -> None:
    sensor = check({"name": "a", "column": "a_K", "depth_m": 0, "bits": 8, "range_K": [0, 255]}, Sensor, "x")
    assert sensor.used
    assert sensor.lsb_K == 1.0


@pytest.mark.thorough
def test_records_of_one_point_are_told_apart_by_their_flights(tmp_path: Path) -> None:
    record, places = load_record(PRACTICE / "p06"), [tmp_path / folder / "p06" for folder in "ABC"]
    for place, stated in zip(places, ({}, {}, {"flight": "STS-2"}), strict=True):
        write_record(replace(record, declared=record.declared.model_copy(update=stated)), place)
    names = ["A/p06", "B/p06", "STS-2/p06"]
    assert [r.name for r in load_records(places)] == names == record_names(places)
    assert [r.name for r in load_records([places[0], PRACTICE / "p04"])] == ["p06", "p04"]
    ids = [record_job(place, tmp_path, label=name).id for place, name in zip(places, names, strict=True)]
    assert [i.rpartition("-")[0] for i in ids] == ["A_p06", "B_p06", "STS-2_p06"]
    with pytest.raises(InputError, match="two records are named B/p06; leave one out, rename one, or give each"):
        load_records([*places, places[1]])
