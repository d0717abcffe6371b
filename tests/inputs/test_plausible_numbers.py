"""Every number that a person types has a plausible range; one in another unit is answered with what to write."""

from __future__ import annotations

import importlib
import pkgutil
import shutil
import typing
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic.fields import FieldInfo

import sim_heating
from sim_heating.base.errors import InputError
from sim_heating.base.files import Declared, check
from sim_heating.base.limits import QUANTITIES, UNITS, quantity
from sim_heating.heating.ratio.table import RatioTable, read_ratio_table, write_ratio_table
from sim_heating.inputs.ratio_sources import build_tables
from sim_heating.inputs.scenario import Truth, load_scenario
from sim_heating.inputs.vehicle import load_vehicle
from sim_heating.inputs.vehicle_files import ControlPointFile
from sim_heating.simulation.run import fly_scenario
from sim_heating.simulation.scenario_check import check_scenario
from sim_heating.thermal.stack import Material, Sensor
from sim_heating.trajectory.aero import load_aero
from sim_heating.trajectory.spec import TrajectorySpec

ROOT = Path(sim_heating.__file__).parents[1]
VEHICLE = ROOT / "aircraft_data" / "orbiter"

ENTRY = {
    "altitude_m": 120e3, "velocity_m_s": 7500.0, "gamma_deg": -1.2, "heading_deg": 60.0, "latitude_deg": 0.0,
}  # fmt: skip
TILE = {
    "density_kg_m3": 144.0,
    "specific_heat_J_kgK": [[300.0, 700.0]],
    "conductivity_W_mK": [[300.0, 0.05]],
    "emissivity": [[300.0, 0.85]],
}


def models() -> Iterator[type[Declared]]:
    """All models of declared files."""
    for module in pkgutil.walk_packages(sim_heating.__path__, "sim_heating."):
        if not module.name.endswith("__main__") and "." in module.name.removeprefix("sim_heating."):
            importlib.import_module(module.name)
    pending = [Declared]
    while pending:
        pending += (below := pending.pop().__subclasses__())
        yield from below


def holds_numbers(annotation: Any) -> bool:
    """Whether an annotation is a float, or lists or a union with one."""
    return annotation is float or any(holds_numbers(part) for part in typing.get_args(annotation))


def unit_of(name: str) -> str | None:
    return next((unit for unit in UNITS if name.endswith(unit)), None)


def named_quantities(model: type[Declared], name: str, field: FieldInfo) -> list[str]:
    """Names of the quantities of a field; names of fields that hold one are replaced by all that they may hold."""
    declared = model.quantities.get(name, name)
    columns = [c for c in ((declared,) if isinstance(declared, str) else declared or ()) if c is not None]
    return [c for c in columns if c not in model.model_fields or c == name]


def test_every_number_with_a_unit_has_a_finite_range_in_every_declared_file():
    checked = 0
    for model in models():
        for name, field in model.model_fields.items():
            if not holds_numbers(field.annotation) or unit_of(name) is None:
                continue
            for named in named_quantities(model, name, field):
                known = quantity(named)
                assert known is not None, f"{model.__name__}.{name}: `{named}` has no range"
                assert abs(known.lowest) < 1e13, f"{model.__name__}.{name}"
                assert abs(known.highest) < 1e13, f"{model.__name__}.{name}"
                checked += 1
    assert checked > 150


def test_a_model_names_only_quantities_that_exist_or_fields_that_name_one():
    for model in models():
        for name, declared in model.quantities.items():
            assert name in model.model_fields, f"{model.__name__} has no field {name}"
            for column in (declared,) if isinstance(declared, str) else declared or ():
                if column is not None and column not in model.model_fields:
                    assert quantity(column) is not None, f"{model.__name__}.{name}: {column}"


@pytest.mark.parametrize("name", [*QUANTITIES, *UNITS])
def test_what_a_message_suggests_is_itself_within_the_range(name):
    known = quantity(name)
    for wrong in (known.lowest - 1.0, known.lowest / 1e3, known.highest * 1e3, known.highest * 10.0):
        for size in known.slips.values():
            if known.problem(wrong) and f"write {wrong * size:.10g}" in known.problem(wrong):
                assert known.problem(wrong * size) is None


def refused(table: dict[str, Any], model: type[Declared] = TrajectorySpec) -> str:
    with pytest.raises(InputError) as error:
        check(table, model, "file.toml")
    return str(error.value)


def entry(initial: dict[str, Any] | None = None, **more: Any) -> dict[str, Any]:
    return {"source": "entry-3dof", "initial": {**ENTRY, **(initial or {})}, **more}


@pytest.mark.parametrize(
    ("table", "expected"),
    [
        (entry({"velocity_m_s": 6.9}), "`velocity_m_s`: 6.9 m/s at 120000 m is no entry; is this km/s? write 6900"),
        (entry({"altitude_m": 72.0}), "`altitude_m`: 72 m at 7500 m/s is no entry; is this km? write 72000"),
        (entry({"altitude_m": 72.0, "velocity_m_s": 6.9}), "is this km/s? write 6900"),
        (entry({"velocity_m_s": 24500.0}), "a larger one looks like ft/s"),
        (entry(stop={"velocity_m_s": 2.5}), "`velocity_m_s`: 2.5 is not a flight speed in m/s"),
        (entry(dispersions={"density_factor": [[0.0, 110.0]]}), "is this %? write 1.1"),
        (entry(dispersions={"density_factor": [[0.0, 1.1], [120.0, 0.9]]}), "is this km? write 120000"),
        (entry(guidance={"drag_m_s2": [[7.4, 1.0], [3.0, 5.0]]}), "is this km/s? write 7400"),
        (entry(guidance={"alpha_deg": [[7.4, 40.0], [3.0, 35.0]], "alpha_against": "velocity_m_s"}), "is this km/s"),
        (entry(guidance={"reversals_m_s": [5.7, 4.3]}), "`reversals_m_s`, row 1: 5.7 is not a flight speed"),
        (entry(guidance={"scale_height_m": 7.0}), "is this km? write 7000"),
        (entry(manoeuvre=[{"kind": "popu", "at_mach": 12.0, "down_deg": 60.0}]), "`down_deg`: 60 is not a change"),
        (entry(manoeuvre=[{"kind": "popu", "at_velocity_m_s": 6.096}]), "is this km/s? write 6096"),
        (entry(manoeuvre=[{"kind": "popu", "at_mach": 80.0}]), "80 is not a Mach number of a flight (0 to 60)"),
        (entry(manoeuvre=[{"kind": "popu", "at_mach": 12.0, "hold_s": 4000.0}]), "is this ms? write 4"),
        (entry(manoeuvre=[{"kind": "elevon-pulse", "at_mach": 12.0, "amplitude_deg": 90.0}]), "is not a deflection"),
    ],
)
def test_a_slip_of_the_unit_in_a_trajectory_is_answered_with_what_to_write(table, expected):
    assert expected in refused(table)


@pytest.mark.parametrize(
    "table",
    [
        entry({"altitude_m": 72.0, "velocity_m_s": 100.0, "gamma_deg": 0.0}),  # a glider over the runway
        entry({"altitude_m": 13.7e3, "velocity_m_s": 245.0}),  # dropped from a carrier aircraft
        entry({"altitude_m": 100e3, "velocity_m_s": 0.5, "gamma_deg": -90.0}),  # from the top of a vertical ascent
        entry({"altitude_m": 3000.0, "velocity_m_s": 10.0}),  # dropped from a helicopter
        entry(
            {"velocity_m_s": 11.1e3}, manoeuvre=[{"kind": "popu", "at_mach": 40.0, "down_deg": 30.0}]
        ),  # lunar return
        entry(dispersions={"density_factor": [[0.0, 0.4]]}),
        entry(dispersions={"density_factor": [[0.0, 1e-30]]}),  # a vacuum
        entry(dispersions={"density_factor": [[120.0, 1.1]]}),  # constant, at whatever altitude
        entry(dispersions={"wind_east_m_s": [[0.0, 5.0], [1000.0, 12.0]]}),
        entry(stop={"altitude_m": 0.0, "mach": 0.3}),
    ],
)
def test_a_flight_that_somebody_may_want_is_accepted(table):
    check(table, TrajectorySpec, "file.toml")


@pytest.mark.parametrize("text", ["72000", "７２０００", "72_000", " 72000 ", "1e5"])  # noqa: RUF001
def test_a_number_in_quotes_is_no_number(text):
    assert "is not a number; write a number without quotes" in refused(entry({"altitude_m": text}))


def test_true_is_no_number():
    assert "`velocity_m_s`: true is not a number" in refused(entry({"velocity_m_s": True}))


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"specific_heat_J_kgK": [[300.0, 7e-4]]}, "`specific_heat_J_kgK`, row 1, item 2: 0.0007 is not a"),
        ({"specific_heat_J_kgK": [[300.0, 0.7]]}, "is this kJ/(kg K)? write 700"),
        ({"conductivity_W_mK": [[300.0, 5e-8]]}, "5e-08 is not a conductivity in W/(m K)"),
        ({"density_kg_m3": 0.144}, "is this g/cm3? write 144; a layer of gas declares kind"),
        ({"density_kg_m3": 0.4}, "is this g/cm3? write 400"),
        ({"density_kg_m3": 7.8, "conductivity_W_mK": [[300.0, 16.0]]}, "is this g/cm3? write 7800"),
        ({"density_kg_m3": 2.5e5}, "250000 is not a density in kg/m3"),
        ({"emissivity": [[300.0, 1e-6]]}, "is not an emissivity"),
    ],
)
def test_a_property_that_no_material_has_is_refused(changes, expected):
    assert expected in refused({**TILE, **changes}, Material)


@pytest.mark.parametrize(
    "material",
    [
        {"density_kg_m3": 10.0, "conductivity_W_mK": [[300.0, 0.04]]},  # glass wool
        {"density_kg_m3": 0.4, "kind": "gas", "specific_heat_J_kgK": [[900.0, 1120.0]]},  # hot air in a gap
        {"density_kg_m3": 22.6e3, "conductivity_W_mK": [[300.0, 87.0]], "specific_heat_J_kgK": [[300.0, 130.0]]},
        {"density_kg_m3": 2200.0, "conductivity_W_mK": [[300.0, 1950.0]]},  # pyrolytic graphite
        {"specific_heat_J_kgK": [[4.0, 0.1], [20.0, 8.0], [300.0, 900.0]]},  # aluminium down to liquid helium
        {"specific_heat_J_kgK": [[330.0, 2e3], [335.0, 7e4], [340.0, 2e3]]},  # melting wax
    ],
)
def test_a_material_that_exists_is_accepted(material):
    check({**TILE, **material}, Material, "file.toml")


def test_a_position_in_millimetres_is_answered_with_metres():
    line = refused({"position_m": [8000.0, 0.0, -2.0]}, ControlPointFile)
    assert "position_m" not in line  # nothing else of the file is given: what is missing comes first
    fields = {"position_m": quantity("position_m").problem(8000.0)}
    assert fields["position_m"] == "8000 is not a position on a vehicle in m (-200 to 200); is this mm? write 8"


def test_a_true_parameter_stays_within_the_bounds_of_the_model():
    line = refused({"parameters": {"stack.coating.thickness_factor": 1000.0}}, Truth)
    assert "stack.coating.thickness_factor: 1000 is outside its bounds 0.001 to 10" in line


# Tables and what relates one number to another -----------------------------------------------------------------------


@pytest.fixture(scope="module")
def orbiter(tmp_path_factory) -> Path:
    """A copy of the Orbiter, whose files a test damages and restores."""
    folder = tmp_path_factory.mktemp("vehicle") / "orbiter"
    shutil.copytree(VEHICLE, folder)
    return folder


@contextmanager
def scaled(path: Path, name: str, factor: float, row: int | None = None) -> Iterator[None]:
    """A CSV file with a column, or one cell of it, multiplied by a factor, until the end of the block."""
    before = path.read_text()
    head = [line for line in before.splitlines() if line.startswith("#")]
    names, *rows = (line.split(",") for line in before.splitlines()[len(head) :])
    for i, cells in enumerate(rows):
        if row is None or i == row:
            cells[names.index(name)] = repr(float(cells[names.index(name)]) * factor)
    path.write_text("\n".join([*head, *(",".join(cells) for cells in [names, *rows])]) + "\n")
    try:
        yield
    finally:
        path.write_text(before)


@contextmanager
def replaced(path: Path, old: str, new: str) -> Iterator[None]:
    """A file with a text replaced, until the end of the block."""
    before = path.read_text()
    assert before.count(old) == 1
    path.write_text(before.replace(old, new))
    try:
        yield
    finally:
        path.write_text(before)


@pytest.mark.parametrize(
    ("name", "factor", "row", "expected"),
    [
        ("alpha_deg", 1e3, None, "is not an angle of attack in degrees"),
        ("alpha_deg", 1e-3, None, "closer together than 0.1"),
        ("beta_deg", 1e3, None, "is not a sideslip angle"),
        ("beta_deg", 1e-6, None, "closer together than 0.1"),
        ("log10_re", 1e3, None, "is not the base-10 logarithm"),
        ("log10_re", 1e-3, None, "closer together than 0.02"),
        ("ratio", 1e4, None, "is not a ratio of film coefficients"),
        ("ratio", 1e-6, None, "the largest ratio is"),
        ("ratio", 1e-3, 40, "off the ratios at all nodes next to it"),
        ("ratio", 200.0, 40, "off the ratios at all nodes next to it"),
        ("sigma", 1e3, None, "times the largest ratio"),
        ("sigma", 1e-6, None, "no heating is known so well"),
    ],
)
def test_a_ratio_table_in_another_unit_is_refused(orbiter, name, factor, row, expected):
    table = orbiter / "ratio_tables" / "LOWER_MID.csv"
    with scaled(table, name, factor, row), pytest.raises(InputError, match=expected):
        read_ratio_table(table)


def test_a_table_of_one_ratio_and_of_ratios_of_zero_is_accepted(tmp_path):
    for values in ([[0.0]], [[1.0]], [[1e-3], [1.0]]):
        ratio = np.array(values)[:, :, None, None, None]
        axes = (np.arange(float(len(values))), *[np.zeros(1)] * 4)
        write_ratio_table(tmp_path / "t.csv", RatioTable(axes, ratio, np.zeros_like(ratio)))
        assert np.array_equal(read_ratio_table(tmp_path / "t.csv").ratio, ratio)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("alpha_deg = [0.0, 10.0, 20.0, 25.0, 30.0, 35.0, 40.0, 45.0, 50.0]", "alpha_deg = [0.0, 1e-5, 2e-5]",
         "`alpha_deg`: the nodes are 0 to 2e-05"),
        ("log10_re = [2.0, 5.21, 5.66, 6.075, 6.236, 6.546, 6.773, 7.1, 7.44, 7.65, 8.4]", "log10_re = [2e-3, 8.4e-3]",
         "closer together than 0.02"),
        ("points = [[-4.0, 1.02], [0.0, 1.0], [4.0, 1.02]]", "points = [[-4e-6, 1.0], [4e-6, 1.0]]", "closer together"),
        ("points = [[-4.0, 1.02], [0.0, 1.0], [4.0, 1.02]]", "points = [[-4.0, 1020.0], [4.0, 1020.0]]",
         "is not a factor on a heating ratio"),
        ("points = [[-4.0, 1.02], [0.0, 1.0], [4.0, 1.02]]", "points = [[-4.0, 990.0], [4.0, 990.0]]", "rises to"),
        ("[[2.0, 0.5], [5.21, 0.2], [6.075, 0.0], [6.773, 0.0], [7.65, 0.3], [8.4, 0.5]]", "[[2.0, 500.0]]",
         "relative standard deviation"),
        ("altitude_m = 70e3, velocity_m_s = 6300.0", "altitude_m = 70, velocity_m_s = 6300.0", "write 70000"),
    ],
)  # fmt: skip
def test_a_source_of_ratios_in_another_unit_is_refused(orbiter, old, new, expected):
    with replaced(orbiter / "ratio_sources" / "windward.toml", old, new), pytest.raises(InputError, match=expected):
        build_tables(orbiter)


@pytest.mark.parametrize(
    ("file", "name", "factor", "expected"),
    [
        ("longitudinal.csv", "mach", 1e3, "is not a Mach number"),
        ("longitudinal.csv", "mach", 1e-3, "closer together than 0.05"),
        ("longitudinal.csv", "alpha_deg", 1e-3, "closer together than 0.1"),
        ("longitudinal.csv", "alpha_deg", 1e3, "is not an angle of attack"),
        ("longitudinal.csv", "CA", 1e3, "column CA: its largest value"),
        ("longitudinal.csv", "CA", 1e-6, "column CA: its largest value"),
        ("longitudinal.csv", "CN", 1e3, "column CN: its largest value|is not an aerodynamic coefficient"),
        ("longitudinal.csv", "CN", 1e-6, "column CN: its largest value"),
        ("longitudinal.csv", "Cm", 1e6, "is not an aerodynamic coefficient"),
        ("elevon.csv", "deflection_deg", 1e-3, "closer together than 0.1"),
        ("bodyflap.csv", "deflection_deg", 1e3, "is not a deflection in degrees"),
    ],
)
def test_aerodynamic_tables_in_another_unit_are_refused(orbiter, file, name, factor, expected):
    with scaled(orbiter / "aero" / file, name, factor), pytest.raises(InputError, match=expected):
        load_aero(orbiter)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("mass_kg = 92079.0", "mass_kg = 92.079", "`mass_kg`: 92.079 kg is"),
        ("mass_kg = 92079.0", "mass_kg = 92079000.0", "is not a mass of a vehicle in kg"),
        ("span_m = 23.79147", "span_m = 0.02379147", "more than 100 times span_m"),
        ("chord_m = 12.05992", "chord_m = 0.01205992", "more than 100 times chord_m"),
        ("area_m2 = 249.9092", "area_m2 = 0.2499092", "`area_m2`: 0.249909 m2 is no reference area"),
        ("area_m2 = 249.9092", "area_m2 = 99000.0", "`area_m2`: 99000 m2 is no reference area"),
    ],
)
def test_reference_quantities_that_no_vehicle_has_together_are_refused(orbiter, old, new, expected):
    with replaced(orbiter / "aero" / "aero.toml", old, new), pytest.raises(InputError, match=expected):
        load_aero(orbiter)


@pytest.mark.parametrize("length", ["0.03277362", "199.0 # m", "0.01"])
def test_a_reference_length_far_from_the_places_of_the_control_points_is_refused(orbiter, length):
    file = orbiter / "vehicle.toml"
    if float(length.split()[0]) > 1.0:  # six times too long: no place is impossible
        with replaced(file, "reference_length_m = 32.77362", f"reference_length_m = {length}"):
            load_vehicle(orbiter)
        return
    with (
        replaced(file, "reference_length_m = 32.77362", f"reference_length_m = {length}"),
        pytest.raises(InputError, match=r"`position_m`: .* correct one of the three"),
    ):
        load_vehicle(orbiter)


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"density_kg_m3": 2770.0, "conductivity_W_mK": [[300.0, 1.5e-4]]}, "0.00015 is no conductivity in W/(m K)"),
        ({"density_kg_m3": 1650.0, "conductivity_W_mK": [[300.0, 9e-4]]}, "of a solid of 1650 kg/m3"),
        ({"density_kg_m3": 144.0, "conductivity_W_mK": [[300.0, 0.1], [1000.0, 320.0]]}, "of a material of 144 kg/m3"),
    ],
)
def test_a_conductivity_that_no_material_of_its_density_has_is_refused(changes, expected):
    assert expected in refused({**TILE, **changes}, Material)


@pytest.mark.parametrize(
    "material",
    [
        {"density_kg_m3": 9000.0, "conductivity_W_mK": [[300.0, 0.05]]},  # disordered tungsten diselenide
        {"density_kg_m3": 50.0, "conductivity_W_mK": [[300.0, 2e-5]]},  # multilayer insulation in a vacuum
        {"density_kg_m3": 3515.0, "conductivity_W_mK": [[80.0, 2e4], [300.0, 2300.0]]},  # diamond
        {"density_kg_m3": 500.0, "conductivity_W_mK": [[300.0, 150.0]]},  # foam of graphite
        {"density_kg_m3": 1100.0, "conductivity_W_mK": [[4.0, 1e-3], [300.0, 0.2]]},  # a polymer down to liquid helium
    ],
)
def test_a_conductivity_that_exists_is_accepted(material):
    check({**TILE, **material}, Material, "file.toml")


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"depth_m": 3.8e-10}, "`depth_m`: 3.8e-10 is above 0 and less than"),
        ({"depth_m": 20.0}, "is this mm? write 0.02"),
        ({"noise_sigma_K": 1.5e-6}, "`noise_sigma_K`: 1.5e-06 is above 0 and less than"),
        ({"noise_sigma_K": 1500.0}, "is not a standard deviation of a temperature"),
        ({"range_K": [0.255, 1.6], "bits": 8}, "`range_K`, row 2: 1.6 is below 100 K"),
    ],
)
def test_a_thermocouple_in_another_unit_is_refused(changes, expected):
    assert expected in refused({"name": "T1", "column": "T1_K", "depth_m": 0.001, **changes}, Sensor)


@pytest.mark.parametrize("changes", [{"depth_m": 0.0}, {"depth_m": 2e-6}, {"noise_sigma_K": 0.0}])
def test_a_thermocouple_at_the_surface_and_without_noise_is_accepted(changes):
    check({"name": "T1", "column": "T1_K", "depth_m": 0.001, **changes}, Sensor, "file.toml")


def test_an_interval_of_samples_longer_than_the_flight_names_scenario_and_key(tmp_path):
    text = (ROOT / "scenarios" / "entry_3dof.toml").read_text()
    assert "[trajectory]" in text
    lines = [line for line in text.splitlines() if not line.startswith("sample_s")]
    lines.insert(lines.index("[trajectory]") + 1, "sample_s = 68000.0")
    (tmp_path / "coarse.toml").write_text("\n".join(lines))
    scenario = load_scenario(tmp_path / "coarse.toml", root=ROOT)
    for deed in (check_scenario, fly_scenario):
        with pytest.raises(InputError, match=r"coarse\.toml.*\[trajectory\]: `sample_s`: 68000 s") as error:
            deed(scenario)
        assert len(error.value.problems) == 1


def test_what_a_check_flight_refuses_names_the_scenario(tmp_path):
    text = (ROOT / "scenarios" / "entry_3dof.toml").read_text()
    (tmp_path / "cg.toml").write_text(text + "\n[trajectory.vehicle]\ncg_fraction = 6.67e-7\n")
    scenario = load_scenario(tmp_path / "cg.toml", root=ROOT)
    with pytest.raises(InputError, match=r"cg\.toml.*cg_fraction: 6.67e-07 is outside"):
        check_scenario(scenario)


def test_a_measured_history_in_millikelvin_is_refused(tmp_path):
    scenario = ROOT / "scenarios" / "sts96.toml"
    compared = next(c.file for c in load_scenario(scenario).declared.compare)
    folder = tmp_path / "orbiter"
    shutil.copytree(VEHICLE, folder)
    text = scenario.read_text().replace('vehicle = "orbiter"', 'vehicle = "orbiter/"')
    (tmp_path / "sts96.toml").write_text(text)
    with scaled(folder / compared, "temperature_K", 1e3), pytest.raises(InputError, match="no temperature of"):
        load_scenario(tmp_path / "sts96.toml", root=tmp_path)
