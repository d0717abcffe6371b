"""Every number that a person types has a plausible range; one in another unit is answered with what to write."""

from __future__ import annotations

import importlib
import pkgutil
import typing
from collections.abc import Iterator
from typing import Any

import pytest
from pydantic.fields import FieldInfo

import sim_heating
from sim_heating.base.errors import InputError
from sim_heating.base.files import Declared, check
from sim_heating.base.limits import QUANTITIES, UNITS, quantity
from sim_heating.inputs.scenario import Truth
from sim_heating.inputs.vehicle_files import ControlPointFile
from sim_heating.thermal.stack import Material
from sim_heating.trajectory.spec import TrajectorySpec

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
)  # fmt: skip
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
)  # fmt: skip
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
)  # fmt: skip
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
