"""A vehicle directory from length, mass, nose radius and the layers of its control points, that flies as it is."""

from __future__ import annotations

import math
import os
import re
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sim_heating.base import files
from sim_heating.base.errors import InputError
from sim_heating.base.files.paths import portable_problem
from sim_heating.base.files.schema import schema_line
from sim_heating.base.files.text import abbreviated
from sim_heating.inputs.ratio_sources import write_tables
from sim_heating.inputs.vehicle import Vehicle, load_vehicle, vehicle_directory
from sim_heating.inputs.vehicle_files import NAME
from sim_heating.simulation.scenario_check import check_vehicle
from sim_heating.templates.materials import LayerInput, layer_input
from sim_heating.templates.record import shown_at
from sim_heating.templates.render import render, render_toml

GLIDES_FROM = 0.6
"""Lift over drag from which a vehicle is guided as the Orbiter is, else as the capsule."""
GLIDER, CAPSULE = "orbiter", "capsule"
NOSE_RATIO, OTHER_RATIO = 1.0, 0.3
"""Heating ratios that are taken at the nose, and elsewhere, where none is given [-]."""
NOSE_SIGMA, OTHER_SIGMA = 0.1, 0.4
"""Their relative standard deviations [-]."""
HOTTEST_USE_K = 1500.0
"""Limit of a surface whose material states none [K]."""
MACH = (1.2, 30.0)
"""Nodes of the aerodynamic tables; the coefficients do not depend on Mach number between them."""
GYRATION = (0.35, 0.3, 0.3)
"""Radii of gyration over span, length and length [-]."""
DEFLECTIONS_DEG = (-20.0, 0.0, 20.0)
FLAP_CM_DEG, FLAP_CN_DEG = -0.0015, 0.004
"""Pitching moment and normal force of a degree of elevon or body flap, of the class of the Orbiter's [1/deg]."""


@dataclass(frozen=True)
class PointInput:
    """A control point as a person stated it.

    x_over_L : distance from the nose over the length [-]
    ratio    : heating ratio, or None for a usual one [-]
    """

    name: str
    layers: tuple[LayerInput, ...]
    x_over_L: float = 0.0
    ratio: float | None = None


@dataclass(frozen=True)
class VehicleInput:
    """A vehicle as a person stated it.

    surfaces : whether it has an elevon and a body flap
    alpha_deg, drag_coefficient, lift_to_drag : angle of attack in which it flies, CD and L/D there
    """

    points: Sequence[PointInput]
    length_m: float
    nose_radius_m: float
    mass_kg: float
    area_m2: float
    title: str = ""
    surfaces: bool = False
    alpha_deg: float = 20.0
    drag_coefficient: float = 1.3
    lift_to_drag: float = 0.3
    reference: str = "sutton-graves"


def point_inputs(points: Sequence[str], x_over_L: Mapping[str, str], ratios: Mapping[str, str]) -> list[PointInput]:
    """Control points of options: `NAME=LAYER / LAYER`, `NAME=0.3` of x over L, `NAME=0.5` of the ratio.

    raises : InputError, one line, for what cannot be read
    """
    inputs: list[PointInput] = []
    for text in points:
        name, stack = _name_and_stack(text)
        position = 0.0 if not inputs and name not in x_over_L else _number(x_over_L, name, "--place", 0.0, 1.0)
        ratio = None if name not in ratios else _number(ratios, name, "--ratio", 0.0, 300.0)
        inputs.append(PointInput(name, stack, position, ratio))
    names = [p.name for p in inputs]
    if (twice := files.repeated_name(names)) is not None:
        raise InputError(f"--point {twice}: is given twice; leave one out")
    for option, values in (("--place", x_over_L), ("--ratio", ratios)):
        for name in values:
            if name not in names:
                raise InputError(f"{option} {name}: there is no --point {name}; known: {', '.join(names)}")
    return inputs


def _name_and_stack(text: str) -> tuple[str, tuple[LayerInput, ...]]:
    """Name and layers of an option `--point NAME=LAYER / LAYER`."""
    name, equals, layers = map(str.strip, text.partition("="))
    if not (equals and layers and re.fullmatch(NAME, name)):
        example = '--point NOSE="LI-900 50 mm / al2024 2 mm"'
        raise InputError(f"--point {text}: write {example}; a name has letters, digits and _")
    if (problem := portable_problem(name)) is not None:
        raise InputError(f"--point {text}: {name} {problem}")
    return name, tuple(layer_input(layer, f"--point {name}") for layer in layers.split(" / "))


def _number(values: Mapping[str, str], name: str, option: str, low: float, high: float) -> float:
    if name not in values:
        raise InputError(
            f"{option}: is missing for {name}; give its distance from the nose over the length, {name}=0.3"
        )
    try:
        value = files.plain_number(values[name])
    except ValueError:
        value = math.nan
    if not low <= value <= high:
        raise InputError(
            f"{option} {name}={values[name]}: write a number from {low:g} to {high:g}, {option} {name}=0.3"
        )
    return value


def _limits(point: Mapping[str, Any]) -> str:
    """Limits of a point in words; that of the bondline with the layer at whose outer face it is."""
    surface = f"limit {point['surface_K']:g} K"
    if point["bondline_K"] is None:
        return surface
    return f"{surface}, {point['bondline_K']:g} K at the outer face of {point['layers'][-1].name} (bondline)"


def _move_files(source: Path, target: Path) -> None:
    """Move all files below a directory to another one, and remove it."""
    for path in sorted(source.rglob("*")):
        if path.is_file():
            moved = target / path.relative_to(source)
            moved.parent.mkdir(parents=True, exist_ok=True)
            path.rename(moved)
    shutil.rmtree(source)


def write_new_vehicle(out: str | os.PathLike[str], design: VehicleInput) -> tuple[Vehicle, list[str]]:
    """Write a vehicle directory, named as the vehicle, and check it as a whole; its ratio tables are built.

    returns : the vehicle, and one line for each thing that was assumed
    raises  : InputError where something does not fit, or the directory holds files of others
    """
    name = Path(os.path.abspath(out)).name
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_-]*", name):
        raise InputError(f"--out {out}: its last part is the vehicle's name: letters, digits, - and _")
    if (problem := portable_problem(name)) is not None:
        raise InputError(f"--out {abbreviated(str(out))}: its last part {problem}")
    values = _values(name, design)
    texts = {
        "vehicle.toml": render_toml("vehicle/vehicle.toml.j2", "vehicle", **values),
        "aero/aero.toml": render_toml("vehicle/aero.toml.j2", "aero", **values),
        "aero/longitudinal.csv": _coefficients(design, values["alpha_deg"]),
        "guidance.toml": render_toml("vehicle/guidance.toml.j2", "guidance", **values),
        "provenance.md": render("vehicle/provenance.md.j2", **values),
    }
    texts |= {f"aero/{flap}.csv": _flap(values["alpha_deg"]) for flap in ("elevon", "bodyflap") if design.surfaces}
    for p in values["points"]:
        texts[f"control_points/{p['name']}.toml"] = render_toml("vehicle/control_point.toml.j2", "control_point", p=p)
        texts[f"ratio_sources/{p['name'].lower()}.toml"] = render_toml(
            "vehicle/ratio_source.toml.j2", "ratio_source", p=p, **values
        )
    for material, m in values["materials"].items():
        line = schema_line("material")
        texts[f"materials/{material}.toml"] = (
            f"{line}\n{files.toml_text(m.model_dump(exclude_unset=True, exclude_none=True))}"
        )
    with files.output_directory(out, "new vehicle", expected=("vehicle.toml",)) as folder:
        # a vehicle has the name of its directory, and that of results in the making is another
        unfinished = folder / name
        for file, text in texts.items():
            files.write_text_atomic(unfinished / file, text)
        with shown_at(unfinished, out):
            write_tables(unfinished, root=unfinished)
            check_vehicle(load_vehicle(unfinished, root=unfinished))
        _move_files(unfinished, folder)
    notes = [
        f"{p['name']}: {p['ratio_source']}; {_limits(p)}; thermocouple {p['sensor_place']}" for p in values["points"]
    ]
    notes.append(f"aerodynamics: {values['aero_source']}")
    notes.append(f"guidance: drag against speed as {values['guidance_of']}")
    return load_vehicle(out), notes


def _require_positive(**values: float) -> None:
    for option, value in values.items():
        if not value > 0.0:
            raise InputError(f"--{option}: must be above 0")


def _values(name: str, design: VehicleInput) -> dict[str, Any]:
    """Variables of the templates."""
    _require_positive(length=design.length_m, mass=design.mass_kg, area=design.area_m2)
    guidance_of = GLIDER if design.lift_to_drag >= GLIDES_FROM else CAPSULE
    guidance = files.read_toml_dict(vehicle_directory(guidance_of) / "guidance.toml")
    for key in ("format", "source", "confidence", "alpha_deg", "alpha_limits_deg", "alpha_against", "approach"):
        guidance.pop(key, None)
    span_m = float(f"{min(design.length_m, 2.0 * math.sqrt(design.area_m2 / math.pi)):.4g}")
    deflections = list(DEFLECTIONS_DEG) if design.surfaces else [0.0]
    alphas = _alphas_deg(design.alpha_deg)
    return {
        "name": name,
        "vehicle": name,
        "title": design.title or name,
        "length_m": design.length_m,
        "area_m2": design.area_m2,
        "mass_kg": design.mass_kg,
        "nose_radius_m": design.nose_radius_m,
        "reference": design.reference,
        "span_m": span_m,
        "inertia": [
            float(f"{design.mass_kg * (k * L) ** 2:.3g}")
            for k, L in zip(GYRATION, (span_m, design.length_m, design.length_m), strict=True)
        ],
        "surfaces": design.surfaces,
        "alpha_trim": design.alpha_deg,
        "alpha_deg": alphas,
        "elevon_deg": deflections,
        "bodyflap_deg": deflections,
        "aero_source": f"CD {design.drag_coefficient:g} at all angles of attack, lift proportional to it, L/D "
        f"{design.lift_to_drag:g} at {design.alpha_deg:g} deg: estimates",
        "guidance_of": guidance_of,
        "guidance": guidance,
        "points": [_point(p, design, alphas) for p in design.points],
        "materials": {layer.name: layer.material for p in design.points for layer in p.layers},
    }


def _alphas_deg(alpha_deg: float) -> list[float]:
    """Nodes of the angle of attack [deg], rising from 0 to twice that of the entry, or to 0 where it is negative."""
    end = math.copysign(max(2.0 * abs(alpha_deg), 10.0), alpha_deg)
    return sorted([0.0, 0.5 * end, end])


def _point(p: PointInput, design: VehicleInput, alpha_deg: Sequence[float]) -> dict[str, Any]:
    """Variables of the files of a control point."""
    outer, inner = p.layers[0], p.layers[-1]
    if outer.material.emissivity is None:
        raise InputError(
            f"--point {p.name}: the outermost layer {outer.name} has no emittance; put a coating first, such as "
            '"black-paint 0.05 mm", or name a TOML file of the material with `emissivity`'
        )
    at_nose = p.x_over_L == 0.0
    ratio = p.ratio if p.ratio is not None else NOSE_RATIO if at_nose else OTHER_RATIO
    thick = len(p.layers) > 1
    return {
        "name": p.name,
        "layers": p.layers,
        "heat_shield": outer.name,
        "x_over_L": p.x_over_L,
        "position_m": [float(f"{p.x_over_L * design.length_m:.6g}"), 0.0, 0.0],
        "ratio": min(ratio, 1.0),
        "ratio_points": [[a, ratio] for a in alpha_deg],
        "ratio_source": f"ratio {ratio:g}" + (", given" if p.ratio is not None else ", an estimate (--ratio)"),
        "ratio_sigma": NOSE_SIGMA if at_nose else OTHER_SIGMA,
        "sensor_m": outer.thickness_m,
        "sensor_place": f"at the inner face of {outer.name}" if thick else "at the back",
        "surface_K": outer.material.max_use_K or HOTTEST_USE_K,
        "bondline_K": inner.material.max_use_K if thick else None,
    }


def _coefficients(design: VehicleInput, alpha_deg: Sequence[float]) -> str:
    """Table of normal and axial force along and across the body: lift proportional to angle of attack, constant drag.

    CN = CL cos(alpha) + CD sin(alpha),    CA = CD cos(alpha) - CL sin(alpha)
    """
    lift = design.drag_coefficient * design.lift_to_drag
    rows = []
    for mach in MACH:
        for alpha in np.linspace(alpha_deg[0], alpha_deg[-1], 9):
            CL = 0.0 if design.alpha_deg == 0.0 else lift * alpha / design.alpha_deg
            s, c = math.sin(math.radians(alpha)), math.cos(math.radians(alpha))
            CN, CA = CL * c + design.drag_coefficient * s, design.drag_coefficient * c - CL * s
            rows.append((mach, float(alpha), round(CN, 5), round(CA, 5), 0.0))
    header = {
        "source": "sim-heating new vehicle: constant drag, lift proportional to angle of attack",
        "confidence": "C",
    }
    return files.csv_text(
        dict(zip(("mach", "alpha_deg", "CN", "CA", "Cm"), zip(*rows, strict=True), strict=True)), "g", header
    )


def _flap(alpha_deg: Sequence[float]) -> str:
    """Table of the increments of a control surface, linear in its deflection."""
    rows = [
        (mach, alpha, d, round(FLAP_CN_DEG * d, 5), 0.0, round(FLAP_CM_DEG * d, 5))
        for mach in MACH
        for alpha in (alpha_deg[0], alpha_deg[-1])
        for d in DEFLECTIONS_DEG
    ]
    names = ("mach", "alpha_deg", "deflection_deg", "CN", "CA", "Cm")
    header = {"source": "sim-heating new vehicle: of the class of the Orbiter's, linear", "confidence": "C"}
    return files.csv_text(dict(zip(names, zip(*rows, strict=True), strict=True)), "g", header)


def shown_place(vehicle: str, folder: Path) -> str:
    """How a file in a folder names a vehicle: a name as it is, a directory relative to the folder."""
    if (Path(vehicle) / "vehicle.toml").is_file():
        return Path(os.path.relpath(vehicle, folder)).as_posix()
    vehicle_directory(vehicle)
    return vehicle


def describe_vehicle(vehicle: Vehicle) -> str:
    """One line on a vehicle."""
    points = ", ".join(vehicle.control_points)
    return f"vehicle {vehicle.name} in {files.display_path(vehicle.directory)}: control points {points}"
