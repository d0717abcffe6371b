"""What is impossible is refused; what is possible and unusual is accepted and told in a line, also with --json."""

from __future__ import annotations

import json
import math
import re
import shutil
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from sim_heating.base.errors import InputError, UnusualWarning
from sim_heating.base.files import check, read_csv_columns, write_csv
from sim_heating.base.limits import QUANTITIES, UNITS, USUAL, numbers_in, quantity
from sim_heating.cli import main
from sim_heating.cli.path_check import check_path
from sim_heating.heating.recorded.plausible import standing_out
from sim_heating.inputs.record import load_record
from sim_heating.inputs.vehicle import load_vehicle
from sim_heating.live.filtering.plausible import FrameRemarks
from sim_heating.live.types import Frame
from sim_heating.planning.study import load_study
from sim_heating.thermal.stack import Material
from sim_heating.trajectory.spec import TrajectorySpec
from tests.support.paths import PRACTICE, RECORDS, ROOT, SCENARIOS

FOAM = {
    "density_kg_m3": 60.0,
    "specific_heat_J_kgK": [[200.0, 700.0], [400.0, 900.0], [600.0, 1000.0]],
    "conductivity_W_mK": [[200.0, 0.03], [400.0, 0.05], [600.0, 0.09]],
}
ENTRY = {
    "altitude_m": 120e3, "velocity_m_s": 7500.0, "gamma_deg": -1.2, "heading_deg": 60.0, "latitude_deg": 0.0,
}  # fmt: skip


def told(act: Callable[[], object]) -> list[str]:
    """The lines that an act tells."""
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        act()
    return [str(w.message) for w in found if issubclass(w.category, UnusualWarning)]


@pytest.fixture
def record(tmp_path: Path) -> Path:
    return Path(shutil.copytree(PRACTICE / "p06", tmp_path / "record"))


def change(path: Path, column: str, act: Callable[[np.ndarray], np.ndarray]) -> None:
    """Change a column of a CSV file."""
    names = path.read_text().partition("\n")[0].split(",")
    columns = dict(read_csv_columns(path, [column], allow_empty=names).columns)
    write_csv(path, columns | {column: act(columns[column])})


def one_row(row: int, value: float) -> Callable[[np.ndarray], np.ndarray]:
    return lambda v: np.where(np.arange(len(v)) == row, value, v)


# Impossible ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("column", "act", "line"),
    [
        ("velocity_m_s", lambda v: v * np.pi / 180.0, "column velocity_m_s: 134.5 m/s at 1.219e+05 m need 6.1"),
        ("time_s", lambda t: t * 1e3, "column time_s"),
        ("h_ref_kg_m2_s", lambda h: h + 273.0, "is not a film coefficient in kg/(m2 s) (0 to 100)"),
        ("H_r_J_kg", one_row(300, 1e9), "row 302, column H_r_J_kg: 1e+09 is not a recovery enthalpy in J/kg"),
        ("H_r_J_kg", lambda H: H * 60.0, "column H_r_J_kg"),
        ("altitude_m", one_row(400, 90e3), "row 402, column altitude_m: 90000 stands out"),
    ],
)
def test_a_column_that_no_flight_has_is_refused(record: Path, column: str, act: Callable, line: str) -> None:
    change(record / "conditions.csv", column, act)
    with pytest.raises(InputError) as error:
        load_record(record)
    assert line in str(error.value)


def test_a_clock_in_ms_is_refused_by_the_length_of_the_path(tmp_path: Path) -> None:
    """300 s around 80 km, in which drag says little: in ms it would be 50 times around the Earth."""
    flown = read_csv_columns(PRACTICE / "p06" / "conditions.csv", ["time_s"]).columns
    part = slice(100, 400)
    columns = {name: values[part] for name, values in flown.items() if name not in ("h_ref_kg_m2_s", "H_r_J_kg")}
    from sim_heating.trajectory.recorded import read_conditions

    write_csv(tmp_path / "c.csv", columns | {"time_s": 1e3 * columns["time_s"]})
    with pytest.raises(InputError, match="times around the Earth; the time is not in s"):
        read_conditions(tmp_path / "c.csv", 32.8)


@pytest.mark.parametrize("flux", [-1e5, 1e9])
def test_a_lamp_that_none_is_is_refused(tmp_path: Path, flux: float) -> None:
    board = Path(shutil.copytree(RECORDS / "kaowool_board", tmp_path / "board"))
    change(board / "conditions.csv", "q_add_W_m2", lambda q: np.full_like(q, flux))
    with pytest.raises(InputError, match="is not a flux in W/m2 that a wall absorbs"):
        load_record(board)


# Unusual -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("column", "act", "line"),
    [
        ("H_r_J_kg", one_row(300, 1e8), "row 302, column H_r_J_kg: 1e+08 is unusual"),
        ("h_ref_kg_m2_s", lambda h: h * 10.0, "that of a sphere of 0.00302 m radius, and nose_radius_m = 0.3048"),
        ("h_ref_kg_m2_s", one_row(400, 1.0), "row 402, column h_ref_kg_m2_s: 1 stands out of the rows before"),
        ("rho_kg_m3", one_row(400, 1e-2), "row 402, column rho_kg_m3: 0.01 stands out of the rows before"),
        ("velocity_m_s", one_row(400, 3000.0), "row 402, column velocity_m_s: 3000 stands out"),
        ("altitude_m", one_row(400, 78e3), "row 402, column altitude_m: 78000 stands out"),
        ("altitude_m", lambda z: z * 0.3048, "column rho_kg_m3: is 0.0014"),
        ("time_s", lambda t: t * 10.0, "the flight slows as with 4.48e+03 kg/m2 of mass over drag area"),
        ("time_s", lambda t: t * 0.3048, "of the readings lie within the conditions; is it the same clock?"),
        ("p_surface_Pa", lambda p: p * 10.0, "column p_surface_Pa: is 3.86 of p + rho V^2"),
        ("log10_re", lambda x: x * 0.3048, "implies lengths that differ by a factor"),
        ("velocity_m_s", lambda v: np.linspace(7000.0, 7700.0, len(v)), "has risen by"),
    ],
)
def test_a_column_that_few_flights_have_is_told(record: Path, column: str, act: Callable, line: str) -> None:
    change(record / "conditions.csv", column, act)
    try:
        lines = told(lambda: load_record(record))
    except InputError as error:
        pytest.fail(f"refused: {error}")
    assert any(line in text for text in lines), "\n".join(lines)
    assert all(text.startswith(str(record)) for text in lines)


@pytest.mark.parametrize(
    ("name", "table", "line"),
    [
        ("specific_heat_J_kgK", [[200.0, 700.0], [400.0, 50137.0], [600.0, 1000.0]], "row 2, item 2: 50137 is unusual"),
        ("specific_heat_J_kgK", [[200.0, 700.0], [400.0, 864e3], [600.0, 1000.0]], "declares apparent = true"),
        ("specific_heat_J_kgK", [[200.0, 700.0], [400.0, 4000.0], [600.0, 1000.0]], "4000 stands out beside 700"),
        ("conductivity_W_mK", [[200.0, 0.03], [400.0, 93.7], [600.0, 0.09]], "at 400 K 93.7 stands out beside 0.03"),
        ("conductivity_W_mK", [[200.0, 40.0], [400.0, 50.0]], "50 W/(m K) is unusual at 60 kg/m3"),
        ("emissivity", [[200.0, 0.85], [400.0, 0.08], [600.0, 0.85]], "0.08 stands out beside 0.85"),
        ("density_kg_m3", 5.0, "`density_kg_m3`: 5 is unusual (20 to 20000: felts and foams to tungsten)"),
    ],
)
def test_a_property_that_few_materials_have_is_told(name: str, table: object, line: str) -> None:
    lines = told(lambda: check(FOAM | {name: table}, Material, "foam.toml"))
    assert any(line in text for text in lines), lines
    assert all(text.startswith("foam.toml") for text in lines)


def test_a_peak_of_latent_heat_is_declared_by_apparent_true() -> None:
    wax = FOAM | {"specific_heat_J_kgK": [[200.0, 2e3], [330.0, 2e3], [333.0, 7e4], [336.0, 2e3]]}
    assert told(lambda: check(wax, Material, "wax.toml"))
    assert not told(lambda: check(wax | {"apparent": True}, Material, "wax.toml"))


@pytest.mark.parametrize("depth_m", [0.0001, 0.00012])
def test_a_thermocouple_within_a_thin_coating_is_told(record: Path, depth_m: float) -> None:
    path = record / "record.toml"
    path.write_text(path.read_text().replace("depth_m = 0.00038", f"depth_m = {depth_m}", 1))
    (line,) = told(lambda: load_record(record))
    assert f"`depth_m`: {depth_m:g} m is unusual within a layer of 0.38 mm" in line


def test_a_deeper_sensor_that_is_hotter_than_the_surface_is_told(record: Path) -> None:
    """By the maximum principle: what is behind the wall is cooler."""
    path = record / "record.toml"
    path.write_text(re.sub(r"bits = 8\nrange_K = .*\n", "", path.read_text()))
    change(record / "thermocouples.csv", "LS_bond_K", lambda T: 290.0 + 40.0 * (T - 290.0))
    lines = told(lambda: load_record(record))
    assert any("column LS_bond_K: reads up to" in x and "nearer to the heated surface" in x for x in lines)


def test_readings_that_scatter_more_than_declared_are_told(record: Path) -> None:
    scatter = np.random.default_rng(1).normal(0.0, 25.0, 10_000)
    change(record / "thermocouples.csv", "LS_surface_K", lambda T: T + scatter[: len(T)])
    lines = told(lambda: load_record(record))
    assert any("column LS_surface_K: scatters by 2" in x and "declares noise_sigma_K" in x for x in lines)


def test_path_angles_of_a_third_of_the_path_are_told(tmp_path: Path) -> None:
    flight = Path(shutil.copytree(RECORDS / "sts96_480", tmp_path / "flight"))
    change(flight / "conditions.csv", "gamma_deg", lambda g: g * 0.3048)
    lines = told(lambda: load_record(flight))
    assert any("column gamma_deg: is 0.3" in x and "of the path that altitude, time and speed" in x for x in lines)


def test_one_path_angle_of_a_dive_is_told_with_its_row(tmp_path: Path) -> None:
    flight = Path(shutil.copytree(RECORDS / "sts96_480", tmp_path / "flight"))
    change(flight / "conditions.csv", "gamma_deg", one_row(100, -69.0))
    lines = told(lambda: load_record(flight))
    assert any("column gamma_deg: -69 stands out of the rows before and after it" in x for x in lines)


def test_a_flight_outside_the_ratio_table_is_told(record: Path) -> None:
    change(record / "conditions.csv", "alpha_deg", lambda a: a + 80.0)
    lines = told(lambda: load_record(record))
    assert any("column alpha_deg: is 97" in x and "and the ratio table has" in x for x in lines)


@pytest.mark.parametrize(("velocity_m_s", "is_refused"), [(0.0, False), (7000.0, True)])
def test_an_enthalpy_that_no_flow_has_states_a_lamp(tmp_path: Path, velocity_m_s: float, is_refused: bool) -> None:
    """30 km/s has 5e8 J/kg; a lamp is stated by a film and an enthalpy far above the wall's."""
    (tmp_path / "t.csv").write_text("time_s,TC (degC)\n" + "".join(f"{t},{20 + t / 2}\n" for t in range(0, 100, 4)))
    arguments = ["new", "record", "--csv", str(tmp_path / "t.csv"), "--layer", "copper 3 mm", "--depth", "TC=back"]
    arguments += ["--lamp", "unknown", "--out", str(tmp_path / "plate"), "--quiet"]
    assert told(lambda: main(arguments)) == []
    path = tmp_path / "plate" / "record.toml"
    path.write_text(path.read_text().replace("velocity_m_s = 0", f"velocity_m_s = {velocity_m_s:g}", 1))
    if is_refused:
        with pytest.raises(InputError, match="is not a recovery enthalpy in J/kg"):
            load_record(tmp_path / "plate")
    else:
        assert told(lambda: load_record(tmp_path / "plate")) == []


def test_cold_thermocouples_in_flight_are_told(record: Path) -> None:
    """Of a calibrated sensor, whose readings may be words of the recorder; others are refused as Celsius."""
    path = record / "record.toml"
    path.write_text(path.read_text().replace("depth_m = 0.00038", "depth_m = 0.00038\ncalibration = [0.0, 1.0]", 1))
    path.write_text(path.read_text().replace("bits = 8\nrange_K = [255.0, 1366.0]\n", "", 1))
    change(record / "thermocouples.csv", "LS_surface_K", lambda T: 5.0 + 15.0 * (T - 290.0) / 1000.0)
    lines = told(lambda: load_record(record))
    assert any("thermocouples.csv, row 2, column LS_surface_K" in x and "is unusual (100 to 3000 K" in x for x in lines)


@pytest.mark.parametrize(
    ("changes", "line"),
    [
        ({"gamma_deg": -69.0}, "`gamma_deg`: -69 deg at 120000 m is unusual (entries: -25 to -0.4)"),
        ({"velocity_m_s": 2286.0}, "`velocity_m_s`: 2286 m/s at 120000 m is unusual"),
        (
            {"velocity_m_s": 129.0, "altitude_m": 8e4},
            "`velocity_m_s`: 129 m/s at 80000 m is unusual: lift carries 0.01",
        ),
        ({"altitude_m": 4.5e5}, "`altitude_m`: 450000 is unusual (-500 to 400000: the Dead Sea to a low orbit)"),
    ],
)
def test_an_entry_that_hardly_any_vehicle_flies_is_told(changes: dict[str, float], line: str) -> None:
    table = {"source": "entry-3dof", "initial": ENTRY | changes}
    lines = told(lambda: check(table, TrajectorySpec, "entry.toml"))
    assert any(line in text for text in lines), lines


@pytest.mark.parametrize(
    ("file", "old", "new", "line"),
    [
        ("li900.toml", "[810.928, 1210.0]", "[810.928, 50137.0]", "row 7, item 2: 50137 is unusual (90 to 5000"),
        ("li900.toml", "[0.0159, 0.0216, ", "[0.0159, 93.7, ", "at 394.444 K 93.7 stands out beside 0.0173"),
        ("rcg.toml", "[[300.0, 0.85]", "[[300.0, 0.02]", "`emissivity`, row 1, item 2: 0.02 is unusual"),
    ],
)  # fmt: skip
def test_a_number_of_a_material_is_told_once_by_the_file_that_holds_it(
    tmp_path: Path, file: str, old: str, new: str, line: str
) -> None:
    """LI-2200 has the tables of LI-900, which its own file does not hold."""
    vehicle = Path(shutil.copytree(ROOT / "aircraft_data" / "orbiter", tmp_path / "orbiter"))
    path = vehicle / "materials" / file
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    (remark,) = told(lambda: load_vehicle(vehicle))
    assert remark.startswith(str(path))
    assert line in remark


def test_an_entry_of_a_study_is_told_once(tmp_path: Path) -> None:
    text = (SCENARIOS / "studies" / "small_envelope.toml").read_text()
    (tmp_path / "study.toml").write_text(text.replace("gamma_deg = -1.2", "gamma_deg = -69.0"))
    (remark,) = told(lambda: load_study(tmp_path / "study.toml"))
    assert "[trajectory.initial]: `gamma_deg`: -69 deg at 121920 m is unusual" in remark


def test_what_is_told_is_in_the_object_of_json_once(record: Path, capsys: pytest.CaptureFixture[str]) -> None:
    change(record / "conditions.csv", "H_r_J_kg", one_row(300, 1e8))
    assert main(["validate", str(record), str(record), "--json"]) == 0
    captured = capsys.readouterr()
    (line,) = json.loads(captured.out)["warnings"]
    assert "row 302, column H_r_J_kg: 1e+08 is unusual" in line
    assert captured.err.count("warning: ") == 1


# What is neither -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("path", sorted(p.parent for p in RECORDS.rglob("record.toml")), ids=lambda p: p.name)
def test_nothing_is_told_of_a_shipped_record(path: Path) -> None:
    assert told(lambda: load_record(path)) == []


@pytest.mark.parametrize("name", ["orbiter", "capsule"])
def test_nothing_is_told_of_a_shipped_vehicle(name: str) -> None:
    assert told(lambda: load_vehicle(ROOT / "aircraft_data" / name)) == []


@pytest.mark.thorough
@pytest.mark.parametrize(
    "path", [*sorted(SCENARIOS.glob("*.toml")), *sorted(SCENARIOS.glob("live/*.toml")),
             *sorted(SCENARIOS.glob("studies/*.toml")), *sorted(SCENARIOS.glob("campaigns/*.toml"))],
    ids=lambda p: p.stem,
)  # fmt: skip
def test_nothing_is_told_of_a_shipped_flight_link_or_study(path: Path) -> None:
    assert told(lambda: check_path(path)) == []


def test_a_sample_that_stands_out_is_not_a_step_nor_scatter() -> None:
    t = np.arange(50.0)
    step, ramp = np.where(t < 20.0, 0.0, 100.0), 30.0 * t
    noise = 10.0 * np.random.default_rng(1).normal(size=50)
    for values in (step, ramp, noise, np.zeros(50)):
        assert not np.any(standing_out(t, values, 15.0))
    values = ramp + one_row(30, 200.0)(np.zeros(50))
    assert list(np.flatnonzero(standing_out(t, values, 15.0))) == [30]


def test_frames_of_a_link_are_looked_at_alone_and_together() -> None:
    """A speed in km/h (3.6) contradicts density and altitude over a stretch, not in one frame."""
    remarks, lines = FrameRemarks("link.toml"), []
    for k in range(100):
        state = {"altitude_m": 80e3 - 50.0 * k, "velocity_m_s": 130.0, "rho_kg_m3": 2e-5 * np.exp(k * 50.0 / 7e3)}
        lines += remarks.add(Frame(float(k), {**state, "beta_deg": 35.0 if k == 7 else 0.0}))
    assert lines[0].startswith("link.toml, frame at 7 s: beta_deg 35 is unusual (-20 to 20")
    assert any("column velocity_m_s: 130 m/s at" in line for line in lines)
    assert len(lines) == len(set(lines)) < 5


def test_every_usual_range_is_within_the_possible_one_and_has_a_source() -> None:
    for name, usual in USUAL.items():
        known = quantity(name)
        assert usual.source, name
        assert usual.lowest < usual.highest, name
        if known is not None:
            assert known.lowest <= usual.lowest, name
            assert usual.highest <= known.highest, name
    assert USUAL.keys() - QUANTITIES.keys() <= {n for n in USUAL if any(n.endswith(unit) for unit in UNITS)}


def test_an_integer_beyond_all_floating_point_numbers_is_infinite() -> None:
    assert list(numbers_in([2, 10**400, -(10**400)])) == [((0,), 2.0), ((1,), math.inf), ((2,), -math.inf)]
