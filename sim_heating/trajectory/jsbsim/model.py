"""The 6-DOF model that JSBSim loads, made from a vehicle's aerodynamic data.

JSBSim reads files. They are written for every flight and not stored in the vehicle's directory: the numbers are defined
once (aero.toml and its tables, which the 3-DOF entry reads too), and mass and centre of gravity change with the
scenario. The attitude control, logic and not data, is a JSBSim system file of the vehicle and is copied.

Below the lowest Mach number of the tables lift and drag become those of aero/low_speed.csv, as in the 3-DOF entry: a
polar in trim, so that deflections have moments there and no forces; moments stay those of the lowest Mach number.

Source: Berndt (2004), "JSBSim: An Open Source Flight Dynamics Model in C++", AIAA 2004-4923.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.errors import InputError
from sim_heating.base.files.xml import read_xml
from sim_heating.base.kernels.axis import cells_of
from sim_heating.trajectory.aero import COEFFICIENTS, Aero, Damping, Grid, Lateral, Surface
from sim_heating.trajectory.trimmed_aero import low_speed_rows

MODEL = "vehicle"
POLAR_ALPHA_DEG = 20.0
"""Angle of attack above which the polar is constant [deg]."""
POLAR_STEP_DEG = 2.0
CONTROL = "attitude_control.xml"
LARGEST_CONTROL_BYTES = 2**20
"""JSBSim takes minutes for a table of some megabytes."""
INDENT = " " * 4
SLUG_FT2_KG_M2 = 1.3558179483
"""JSBSim's own conversion from kg m2 is 9e-5 low."""

BASIC_VARIABLES = ("aero/alpha-deg", "velocities/mach")
ELEVON_VARIABLES = ("aero/alpha-deg", "fcs/elevon-pos-deg", "velocities/mach")
BODYFLAP_VARIABLES = ("aero/alpha-deg", "fcs/bodyflap-pos-deg", "velocities/mach")


def control_path(vehicle_dir: Path) -> Path:
    """The attitude control of a vehicle, a system file of JSBSim."""
    return Path(vehicle_dir) / "jsbsim" / CONTROL


def write_aircraft(aero: Aero, vehicle_dir: Path, folder: Path) -> str:
    """Write the vehicle for JSBSim, in [kg], [m] and [deg], into a folder, for `set_aircraft_path`; returns the name
    for `load_model`.

    aero        : aerodynamics with the mass and centre of gravity to be flown
    vehicle_dir : its `jsbsim/attitude_control.xml` is copied
    raises      : InputError where the vehicle has no attitude control, or JSBSim cannot read it

    Source: Berndt (2004), as at the head.
    """
    control = control_path(vehicle_dir)
    if not control.is_file():
        raise InputError(f"{control}: not found; a vehicle that JSBSim flies needs its attitude control there")
    content = read_xml(control, "system", LARGEST_CONTROL_BYTES)
    systems = Path(folder) / MODEL / "Systems"
    systems.mkdir(parents=True)
    (systems / CONTROL).write_bytes(content)
    from_rest = with_low_speed(aero, low_speed_rows(vehicle_dir, aero.basic.mach[0]))
    (systems.parent / f"{MODEL}.xml").write_text(aircraft_xml(from_rest), encoding="utf-8")
    return MODEL


def with_low_speed(aero: Aero, low_speed: FloatArray) -> Aero:
    """Coefficients [-] extended below their lowest Mach number by a polar in trim; unchanged without a polar.

    low_speed : (rows, 5) mach, CL_0, CL_alpha [1/deg], CD_0, K
    """
    if len(low_speed) == 0:
        return aero
    basic = _polar_below(_finer_in_alpha(aero.basic), low_speed)
    elevon, bodyflap = (_forceless_below(grid, float(low_speed[-1, 0])) for grid in (aero.elevon, aero.bodyflap))
    return replace(aero, basic=basic, elevon=elevon, bodyflap=bodyflap)


def _finer_in_alpha(grid: Grid) -> Grid:
    """A table refined at the low alphas, where the drag of a polar is curved."""
    # JSBSim interpolates linearly, which would overestimate the drag between widely spaced alphas.
    alpha = np.union1d(grid.alpha_deg, np.arange(0.0, POLAR_ALPHA_DEG + 1.0, POLAR_STEP_DEG))
    i = cells_of(grid.alpha_deg, alpha)
    fraction = ((alpha - grid.alpha_deg[i]) / np.diff(grid.alpha_deg)[i])[None, :, None, None]
    values = (1.0 - fraction) * grid.values[:, i] + fraction * grid.values[:, i + 1]
    return Grid(grid.mach, alpha, grid.deflection_deg, values)


def _polar_below(grid: Grid, low_speed: FloatArray) -> Grid:
    """A basic table with rows of CN and CA from CL = CL_0 + CL_alpha alpha, CD = CD_0 + K CL^2.

    The polar is constant above POLAR_ALPHA_DEG; the moment is that of the lowest Mach number.
    """
    mach, CL_0, CL_alpha, CD_0, K = low_speed.T[:, :, None]
    CL = CL_0 + CL_alpha * np.minimum(grid.alpha_deg, POLAR_ALPHA_DEG)
    CD = CD_0 + K * CL * CL
    s, c = np.sin(np.radians(grid.alpha_deg)), np.cos(np.radians(grid.alpha_deg))
    rows = np.repeat(grid.values[:1], len(low_speed), axis=0)
    rows[:, :, 0, 0] = CL * c + CD * s
    rows[:, :, 0, 1] = CD * c - CL * s
    return grid._replace(mach=np.concatenate((mach[:, 0], grid.mach)), values=np.concatenate((rows, grid.values)))


def _forceless_below(grid: Grid, mach: float) -> Grid:
    """A control's table whose forces vanish towards a lower Mach number and whose moments do not."""
    if grid.mach.size == 1:
        return grid
    # The polar is that of the trimmed vehicle and already contains lift and drag of the controls; their moments still
    # have to trim it.
    row = grid.values[:1] * np.array([0.0, 0.0, 1.0])
    return grid._replace(mach=np.concatenate(([mach], grid.mach)), values=np.concatenate((row, grid.values)))


def aircraft_xml(aero: Aero) -> str:
    """The JSBSim configuration of a vehicle as text, in [kg], [m] and [deg].

    raises : InputError where a table holds a value that is not finite

    Source: Berndt (2004), as at the head.
    """
    root = _element(
        "fdm_config",
        _metrics(aero),
        _mass_balance(aero),
        _element("ground_reactions"),
        _external_reactions(aero),
        _surface_limits(aero),
        _element("system", file=Path(CONTROL).stem),
        _aerodynamics(aero),
        name=MODEL,
        version="2.0",
        release="BETA",
    )
    ElementTree.indent(root)
    return f'<?xml version="1.0"?>\n{ElementTree.tostring(root, encoding="unicode")}\n'


def _element(tag: str, *content: Element | str | float, **attributes: str) -> Element:
    """An element with child elements, or with a text; a number is written so that it reads back equal."""
    element = Element(tag, attributes)
    for item in content:
        if isinstance(item, Element):
            element.append(item)
        else:
            element.text = item if isinstance(item, str) else repr(item)
    return element


def _location(x_m: float, **name: str) -> Element:
    return _element("location", _element("x", x_m), _element("y", 0.0), _element("z", 0.0), **name, unit="M")


def _metrics(aero: Aero) -> Element:
    ref = aero.file.reference
    return _element(
        "metrics",
        _element("wingarea", ref.area_m2, unit="M2"),
        _element("wingspan", ref.span_m, unit="M"),
        _element("chord", ref.chord_m, unit="M"),
        _location(ref.moment_reference_fraction * ref.length_m, name="AERORP"),
    )


def _mass_balance(aero: Aero) -> Element:
    mass = aero.file.mass
    scale = aero.mass_kg / mass.inertia_at_kg / SLUG_FT2_KG_M2
    inertia = {"ixx": mass.Ixx_kg_m2, "iyy": mass.Iyy_kg_m2, "izz": mass.Izz_kg_m2, "ixz": mass.Ixz_kg_m2}
    return _element(
        "mass_balance",
        *(_element(axis, value * scale, unit="SLUG*FT2") for axis, value in inertia.items()),
        _element("emptywt", aero.mass_kg, unit="KG"),
        _location(aero.cg_fraction * aero.file.reference.length_m, name="CG"),
    )


def _external_reactions(aero: Aero) -> Element:
    """Jet moments about the body axes, and the force of commanded firings through the centre of gravity."""
    cg = aero.cg_fraction * aero.file.reference.length_m
    axes = {"jets-roll": (1, 0, 0), "jets-pitch": (0, 1, 0), "jets-yaw": (0, 0, 1)}
    moments = [_element("moment", _direction(*axis), name=name, frame="BODY") for name, axis in axes.items()]
    force = _element("force", _location(cg), _direction(0, 0, 1), name="jets-firing", frame="BODY")
    return _element("external_reactions", *moments, force)


def _direction(x: int, y: int, z: int) -> Element:
    return _element("direction", _element("x", x), _element("y", y), _element("z", z))


def _surface_limits(aero: Aero) -> Element:
    """Travel and rate of the surfaces as properties, for the actuators of the attitude control."""
    limits = {"elevon": aero.file.elevon, "bodyflap": aero.file.bodyflap}
    properties = [
        _element("property", f"control/{surface}-{limit}", value=repr(value))
        for surface, data in limits.items()
        for limit, value in _limit_values(data).items()
    ]
    return _element("system", *properties, name="surface_limits")


def _limit_values(surface: Surface) -> dict[str, float]:
    return {"min-deg": surface.range_deg[0], "max-deg": surface.range_deg[1], "rate-deg_s": surface.rate_deg_s}


def _aerodynamics(aero: Aero) -> Element:
    tables = {
        "basic": (aero.basic, BASIC_VARIABLES),
        "elevon": (aero.elevon, ELEVON_VARIABLES),
        "bodyflap": (aero.bodyflap, BODYFLAP_VARIABLES),
    }
    functions = [
        _table_function(f"aero/{name}-{coefficient}", grid, i, variables)
        for name, (grid, variables) in tables.items()
        for i, coefficient in enumerate(COEFFICIENTS)
    ]
    names = {c: [f"aero/{n}-{c}" for n in tables] for c in COEFFICIENTS}
    cm_about_cg = _element("sum", _property("aero/elevon-Cm"), _product("aero/elevon-CN", aero.arm))
    return _element(
        "aerodynamics",
        *functions,
        _element("function", cm_about_cg, name="aero/elevon-Cm-cg"),
        _element("function", _shift_table(aero), name="aero/shift-Cm"),
        _axis("AXIAL", "aero/force-axial", _sum(names["CA"])),
        _axis("NORMAL", "aero/force-normal", _sum(names["CN"])),
        _axis("PITCH", "aero/moment-pitch", _pitch(names["Cm"], aero.file.damping), "metrics/cbarw-ft"),
        *_lateral_axes(aero.file.lateral, aero.file.damping),
    )


def _property(name: str) -> Element:
    return _element("p", name)


def _axis(axis: str, name: str, coefficient: Element, *length: str) -> Element:
    """Force qbar S C, or moment qbar S length C, along an axis."""
    scale = [_property(p) for p in ("aero/qbar-psf", "metrics/Sw-sqft", *length)]
    function = _element("function", _element("product", *scale, coefficient), name=name)
    return _element("axis", function, name=axis)


def _product(name: str, *factors: float | str) -> Element:
    rest = [_property(f) if isinstance(f, str) else _element("v", f) for f in factors]
    return _element("product", _property(name), *rest)


def _sum(names: list[str], *terms: Element) -> Element:
    return _element("sum", *(_property(n) for n in names), *terms)


def _pitch(names: list[str], damping: Damping) -> Element:
    return _sum([*names, "aero/shift-Cm"], _product("velocities/q-aero-rad_sec", "aero/ci2vel", damping.Cmq))


def _lateral_axes(lateral: Lateral, damping: Damping) -> tuple[Element, ...]:
    roll = _sum(
        [],
        _product("aero/beta-deg", lateral.Cl_beta_deg),
        _product("velocities/p-aero-rad_sec", "aero/bi2vel", damping.Clp),
    )
    yaw = _sum(
        [],
        _product("aero/beta-deg", lateral.Cn_beta_deg),
        _product("velocities/r-aero-rad_sec", "aero/bi2vel", damping.Cnr),
    )
    return (
        _axis("SIDE", "aero/force-side", _product("aero/beta-rad", lateral.CY_beta_rad)),
        _axis("ROLL", "aero/moment-roll", roll, "metrics/bw-ft"),
        _axis("YAW", "aero/moment-yaw", yaw, "metrics/bw-ft"),
    )


def _shift_table(aero: Aero) -> Element:
    low, high = aero.file.cm_shift.mach
    rows = f"\n{low!r} 0.0\n{high!r} {aero.cm_shift!r}\n"
    return _element("table", _lookup("row", "velocities/mach"), _element("tableData", rows))


def _lookup(kind: str, variable: str) -> Element:
    """The variable along the rows, columns or tables of a table."""
    return _element("independentVar", variable, lookup=kind)


def _table_function(name: str, grid: Grid, index: int, variables: tuple[str, ...]) -> Element:
    values = grid.values[..., index]
    if grid.mach.size == 1:  # the vehicle has no such surface
        return _element("function", _element("v", float(values.ravel()[0])), name=name)
    lookups = [_lookup(kind, variable) for kind, variable in zip(("row", "column", "table"), variables, strict=False)]
    if len(variables) == 2:
        data = [_element("tableData", _block(grid.alpha_deg, grid.mach, values[:, :, 0].T))]
    else:
        data = [
            _element("tableData", _block(grid.alpha_deg, grid.deflection_deg, values[i]), breakPoint=repr(mach))
            for i, mach in enumerate(grid.mach.tolist())
        ]
    return _element("function", _element("table", *lookups, *data), name=name)


def _block(rows: FloatArray, columns: FloatArray, values: FloatArray) -> str:
    """A table in JSBSim's layout, one row an alpha."""
    if not math.isfinite(float(values.sum())):
        raise InputError("aerodynamic table: a value is not finite")
    head = INDENT + " ".join(map(repr, columns.tolist()))
    body = (INDENT + " ".join(map(repr, [r, *line])) for r, line in zip(rows.tolist(), values.tolist(), strict=True))
    return "\n" + "\n".join((head, *body)) + "\n"
