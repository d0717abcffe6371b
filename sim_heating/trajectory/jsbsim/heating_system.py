"""The heating ratio of a point as a table of JSBSim, in a system that gives the radiative-equilibrium temperature.

    r h_ref (H_r - H_w(T)) = eps(T) sigma (T^4 - T_sur^4)
    H_r = H_0 - (1 - r_e) u_e^2 / 2,   H_0 = V^2/2 + cp T_inf

u_e is the speed at the edge of the point's boundary layer, r_e the recovery factor there; a point without an edge has
H_r = H_0. The system stands in any aircraft, `<system file="NAME"/>`, and reads speed, altitude, density, angle of
attack and sideslip of JSBSim, and its own properties heating/elevon-deg and heating/bodyflap-deg, which a script or
another system sets. Temperature and Reynolds number are derived from altitude and density: JSBSim's temperature is
constant above 86 km. h_ref is a table of the reference model in speed and density at the temperatures of the standard
atmosphere.

The balance is solved by Newton's method in STEPS functions, from above: no conduction, so the temperature of a thin
insulated skin, which leads that of a tile by some seconds.

Source: JSBSim 1.3, FGTable (nested tableData, axes row, column, table, axis4, axis5) and FGFunction; surface balance:
docs/theory/equations.md; recovery enthalpy: docs/theory/equations_reference_heating.md, equations 18, 19 and 33a.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import ArrayLike

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import RATIO_VARIABLES, Conditions
from sim_heating.base.errors import InputError
from sim_heating.heating.atmosphere import CP_AIR, sutherland_viscosity, us76
from sim_heating.heating.ratio.table import RatioTable
from sim_heating.heating.reference.gas import wall_enthalpy_grid
from sim_heating.heating.reference.models import reference_heating, reference_model
from sim_heating.heating.reference.recovery import Recovery, recovery_factor
from sim_heating.heating.reference.stagnation import SLOWEST_M_S
from sim_heating.thermal.faces import SIGMA

AXES = ("row", "column", "table", "axis4", "axis5")
"""Axes of a table of JSBSim, from the innermost."""
STEPS = 12
"""Newton steps; from the radiation temperature of a cold wall, 8 reach 0.01 K."""
ALPHA, BETA = "aero/alpha-deg", "aero/beta-deg"
ELEVON, BODYFLAP = "heating/elevon-deg", "heating/bodyflap-deg"
"""Properties of the angles [deg] that heating depends on."""
COLDEST_K, HOTTEST_K = 50.0, 4000.0
"""Wall temperatures [K] between which the balance is solved."""
WALL_PRESSURE_PA = 2000.0
"""Pressure of the air at the wall [Pa] for its enthalpy, of which dissociation depends on it above 2000 K."""
M_FT, KG_M3_SLUG_FT3 = 0.3048, 515.3788184
SPEEDS_M_S = np.concatenate([np.linspace(50.0, 2000.0, 27), np.linspace(2125.0, 12000.0, 80)])
ALTITUDES_M = np.linspace(0.0, 130e3, 131)
"""Nodes of the tables of the reference heating and of the air."""


def _listed(rows: Sequence[Sequence[float]]) -> str:
    return "\n" + "\n".join(" ".join(map(repr, map(float, row))) for row in rows) + "\n"


def _line(x: ArrayLike, y: ArrayLike) -> str:
    return _listed(np.column_stack([np.asarray(x, dtype=float), np.asarray(y, dtype=float)]).tolist())


def _square(rows: FloatArray, columns: FloatArray, values: FloatArray) -> str:
    """Text of a table in two variables: the nodes of the columns, then a row each."""
    head = " ".join(map(repr, columns.tolist()))
    return "\n" + head + _listed(np.column_stack([rows, values]).tolist())


def nd_table(axes: Sequence[FloatArray], values: FloatArray, properties: Sequence[str]) -> ET.Element:
    """A table [-] of JSBSim in as many variables ([deg], [-]) as have several nodes; a number where none has.

    axes       : increasing nodes of each variable;  values : one axis a variable
    properties : of JSBSim, one a variable
    """
    varying = [i for i, axis in enumerate(axes) if len(axis) > 1]
    table = values.reshape([len(axes[i]) for i in varying])
    if not varying:
        number = ET.Element("value")
        number.text = repr(float(table))
        return number
    element = ET.Element("table")
    # A table of one variable has no columns.
    for i, axis in zip(varying, AXES, strict=False):
        ET.SubElement(element, "independentVar", lookup=axis).text = properties[i]
    nodes = [np.asarray(axes[i], dtype=float) for i in varying]
    _nest(element, nodes, table)
    return element


def _nest(parent: ET.Element, nodes: Sequence[FloatArray], values: FloatArray) -> None:
    """Add tableData: the last variable outermost, rows and columns innermost."""
    if len(nodes) == 1:
        ET.SubElement(parent, "tableData").text = _line(nodes[0], values)
        return
    if len(nodes) == 2:
        ET.SubElement(parent, "tableData").text = _square(nodes[0], nodes[1], values)
        return
    for i, node in enumerate(nodes[-1].tolist()):
        if len(nodes) == 3:
            text = _square(nodes[0], nodes[1], values[..., i])
            ET.SubElement(parent, "tableData", breakPoint=repr(node)).text = text
        else:
            _nest(ET.SubElement(parent, "tableData", breakPoint=repr(node)), nodes[:-1], values[..., i])


def _function(channel: ET.Element, name: str, content: ET.Element) -> str:
    """Add a function that sets a property; its name."""
    block = ET.SubElement(channel, "fcs_function", name=name)
    ET.SubElement(block, "function").append(content)
    ET.SubElement(block, "output").text = name
    return name


def _of(operator: str, *arguments: Any) -> ET.Element:
    """An operation of JSBSim on properties (texts), numbers and operations."""
    element = ET.Element(operator)
    for a in arguments:
        if isinstance(a, ET.Element):
            element.append(a)
        else:
            ET.SubElement(element, "property" if isinstance(a, str) else "value").text = (
                a if isinstance(a, str) else repr(a)
            )
    return element


def _in_one(x: ArrayLike, y: ArrayLike, variable: str) -> ET.Element:
    return nd_table([np.asarray(x, dtype=float)], np.asarray(y, dtype=float), [variable])


def _cosine(angle_deg: ET.Element | str) -> ET.Element:
    return _of("cos", _of("product", math.pi / 180.0, angle_deg))


def _recovery_enthalpy(recovery: Recovery, speed: str, air_K: str) -> ET.Element:
    """Recovery enthalpy of a point [J/kg] from properties of speed [m/s], air temperature [K] and angles [deg]."""
    total = _of("sum", _of("product", 0.5, speed, speed), _of("product", CP_AIR, air_K))
    if recovery.kind == "total":
        return total
    if recovery.of_surface:
        turned = (_of("product", recovery.elevon_factor, ELEVON), _of("product", recovery.bodyflap_factor, BODYFLAP))
        edge = _of("product", speed, _of("abs", _cosine(_of("sum", ALPHA, recovery.local_angle_deg, *turned))))
        edge = _of("max", edge, SLOWEST_M_S)
    else:
        edge = _of("product", math.sin(math.radians(recovery.sweep_deg)), speed, _cosine(ALPHA))
    missing = 0.5 * (1.0 - recovery_factor(recovery.kind == "edge-turbulent"))
    return _of("difference", total, _of("product", missing, _of("pow", edge, 2.0)))


def jsbsim_system_text(
    name: str,
    table: RatioTable,
    *,
    reference: str,
    nose_radius_m: float,
    reference_length_m: float,
    emissivity: Sequence[Sequence[float]],
    wall_enthalpy: str | float | Mapping[str, float],
    surroundings_K: float = 0.0,
    recovery: Recovery | None = None,
    where: str = "",
) -> str:
    """The text of a system of JSBSim that gives heating ratio, film coefficient and equilibrium temperature of a point.

    name               : of the point, in the names of its properties, heating/NAME/...
    table              : its heating ratio, over `reference`
    reference          : a reference heating that depends on speed and density alone
    nose_radius_m      : of the reference [m];  reference_length_m : of the Reynolds number [m]
    emissivity         : [[T, value], ...] of the outer layer [K], [-]
    wall_enthalpy      : as `wall_enthalpy_grid` takes it
    surroundings_K     : temperature that the surface radiates to [K]
    recovery           : enthalpy that the point's ratio is reduced with; by default the total enthalpy. Of
                         `edge-laminar` the rise in turbulent flow is left out, as the turbulent table is
    where              : the table in messages
    raises             : InputError for another reference
    """
    model = reference_model(reference)
    if not set(model.needs) <= {"velocity_m_s", "T_inf_K", "rho_kg_m3"} or reference in ("columns", "none"):
        raise InputError(
            f"{where or name}: the reference `{reference}` is not one of speed and density alone; JSBSim "
            "has no other: use fay-riddell, sutton-graves or detra-kemp-riddell"
        )
    root = ET.Element("system", name=f"heating of {name}")
    root.append(ET.Comment(f" Radiative equilibrium of {name}: no conduction, no effects, laminar table. "))
    for control in (ELEVON, BODYFLAP):
        ET.SubElement(root, "property", value="0").text = control
    channel = ET.SubElement(root, "channel", name=f"heating of {name}")
    at = f"heating/{name}"

    speed = _function(channel, f"{at}/velocity-m_s", _of("product", "velocities/vt-fps", M_FT))
    air = _of("product", "atmosphere/rho-slugs_ft3", KG_M3_SLUG_FT3)
    density = _function(channel, f"{at}/density-kg_m3", _of("max", air, 1e-12))
    log_rho = _function(channel, f"{at}/log10-density", _of("log10", density))
    altitude = _function(channel, f"{at}/altitude-m", _of("product", "position/geod-alt-ft", M_FT))
    T_inf, _, rho = us76(ALTITUDES_M)
    air_K = _function(channel, f"{at}/air-K", _in_one(ALTITUDES_M, T_inf, altitude))
    viscosity = _in_one(ALTITUDES_M, sutherland_viscosity(T_inf), altitude)
    reynolds = _of("quotient", _of("product", density, speed, reference_length_m), viscosity)
    log_re = _function(channel, f"{at}/log10-reynolds", _of("log10", _of("max", reynolds, 1e-3)))

    variables = dict(zip(RATIO_VARIABLES, (ALPHA, BETA, log_re, ELEVON, BODYFLAP), strict=True))
    ratio = _function(channel, f"{at}/ratio", nd_table(table.axes, table.ratio, list(variables.values())))
    film = _film_table(reference, nose_radius_m, rho, T_inf)
    h_ref = nd_table([SPEEDS_M_S, np.log10(rho)[::-1]], film[:, ::-1], [speed, log_rho])
    h_ref = _of("product", h_ref, _of("sqrt", density))
    h = _function(channel, f"{at}/film-kg_m2_s", _of("product", ratio, h_ref))
    H_r = _function(channel, f"{at}/recovery-J_kg", _recovery_enthalpy(recovery or Recovery(), speed, air_K))

    wall_K = np.linspace(COLDEST_K, HOTTEST_K, 159)
    H_w = wall_enthalpy_grid(wall_enthalpy, wall_K, [WALL_PRESSURE_PA])[:, 0]
    T, eps = np.asarray(emissivity, dtype=float).T
    least = float(eps.min())
    back = float(surroundings_K) ** 4
    arriving = _of("sum", _of("quotient", _of("product", h, H_r), least * SIGMA), back)
    start = _of("pow", _of("max", arriving, COLDEST_K**4), 0.25)
    last = _function(channel, f"{at}/step-0-K", _of("min", start, HOTTEST_K))
    for step in range(1, STEPS + 1):
        emitted = _of("product", SIGMA, _in_one(T, eps, last))
        excess = _of(
            "difference",
            _of("product", emitted, _of("difference", _of("pow", last, 4.0), back)),
            _of("product", h, _of("difference", H_r, _in_one(wall_K, H_w, last))),
        )
        emitted = _of("product", 4.0, SIGMA, _in_one(T, eps, last), _of("pow", last, 3.0))
        slope = _of("sum", emitted, _of("product", _of("max", h, 0.0), _in_one(wall_K, np.gradient(H_w, wall_K), last)))
        reached = _of("difference", last, _of("quotient", excess, slope))
        name_of_step = f"{at}/equilibrium-K" if step == STEPS else f"{at}/step-{step}-K"
        last = _function(channel, name_of_step, _of("min", _of("max", reached, COLDEST_K), HOTTEST_K))
    flux = _of("product", h, _of("difference", H_r, _in_one(wall_K, H_w, last)))
    _function(channel, f"{at}/convective-W_m2", flux)
    ET.indent(root)
    return f'<?xml version="1.0"?>\n{ET.tostring(root, encoding="unicode")}\n'


def _conditions(speed: FloatArray, rho: FloatArray, T_inf: FloatArray) -> Conditions:
    names = {"velocity_m_s": speed, "rho_kg_m3": rho, "T_inf_K": T_inf}
    zero = np.zeros(len(speed))
    return Conditions(
        {
            "time_s": np.arange(len(speed), dtype=float),
            "alpha_deg": zero,
            "beta_deg": zero,
            "elevon_deg": zero,
            "bodyflap_deg": zero,
            **names,
        }
    )


def _film_table(reference: str, nose_radius_m: float, rho: FloatArray, T_inf: FloatArray) -> FloatArray:
    """h_ref over the root of density, at the nodes of speed and altitude."""
    V, density, T = (a.ravel() for a in np.broadcast_arrays(SPEEDS_M_S[:, None], rho, T_inf))
    heating = reference_heating(reference, _conditions(V, density, T), nose_radius_m=nose_radius_m)
    return (heating.h_ref_kg_m2_s / np.sqrt(density)).reshape(len(SPEEDS_M_S), len(rho))
