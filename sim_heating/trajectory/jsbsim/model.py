"""The 6-DOF model that JSBSim loads, made from a vehicle's aerodynamic data.

JSBSim reads files. They are made anew for every flight and not kept in the vehicle's directory: the numbers have one
home (aero.toml and its tables, which the 3-DOF entry reads too), and mass and centre of gravity change with
the scenario. What is logic and not data, the attitude control, is a JSBSim system file of the vehicle and is copied.

Below the lowest Mach number of the tables lift and drag become those of aero/low_speed.csv, as in the 3-DOF entry: a
polar in trim, so that deflections have moments there and no forces; moments stay those of the lowest Mach number.
"""

from __future__ import annotations

import math
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.errors import InputError
from sim_heating.base.kernels.axis import cells_of
from sim_heating.trajectory.aero import COEFFICIENTS, Aero, Damping, Grid, Lateral, Surface
from sim_heating.trajectory.trimmed_aero import low_speed_rows

MODEL = "vehicle"
POLAR_ALPHA_DEG = 20.0
"""The polar is held above this angle of attack."""
POLAR_STEP_DEG = 2.0
CONTROL = "attitude_control.xml"
INDENT = " " * 4
SLUG_FT2_KG_M2 = 1.3558179483
"""JSBSim's own conversion from kg m2 is 9e-5 low."""
MACH_ROW = '<independentVar lookup="row">velocities/mach</independentVar>'

BASIC_VARIABLES = ("aero/alpha-deg", "velocities/mach")
ELEVON_VARIABLES = ("aero/alpha-deg", "fcs/elevon-pos-deg", "velocities/mach")
BODYFLAP_VARIABLES = ("aero/alpha-deg", "fcs/bodyflap-pos-deg", "velocities/mach")


def write_aircraft(aero: Aero, vehicle_dir: Path, folder: Path) -> str:
    """Write the vehicle for JSBSim into a folder; give the folder to `set_aircraft_path`, the result to `load_model`.

    aero        : aerodynamics with the mass and centre of gravity to be flown
    vehicle_dir : its `jsbsim/attitude_control.xml` is copied
    raises      : InputError where the vehicle has no attitude control
    """
    control = Path(vehicle_dir) / "jsbsim" / CONTROL
    if not control.is_file():
        raise InputError(f"{control}: not found; a vehicle that JSBSim flies needs its attitude control there")
    systems = Path(folder) / MODEL / "Systems"
    systems.mkdir(parents=True)
    shutil.copyfile(control, systems / CONTROL)
    whole = with_low_speed(aero, low_speed_rows(vehicle_dir, aero.basic.mach[0]))
    (systems.parent / f"{MODEL}.xml").write_text(aircraft_xml(whole), encoding="utf-8")
    return MODEL


def with_low_speed(aero: Aero, low_speed: FloatArray) -> Aero:
    """Tables extended below their lowest Mach number by a polar in trim; as they are where there is none.

    low_speed : (rows, 5) mach, CL_0, CL_alpha [1/deg], CD_0, K
    """
    if len(low_speed) == 0:
        return aero
    basic = _polar_below(_finer_in_alpha(aero.basic), low_speed)
    elevon, bodyflap = (_forceless_below(grid, float(low_speed[-1, 0])) for grid in (aero.elevon, aero.bodyflap))
    return replace(aero, basic=basic, elevon=elevon, bodyflap=bodyflap)


def _finer_in_alpha(grid: Grid) -> Grid:
    """The same table with more points at the low alphas, where the drag of a polar is curved."""
    alpha = np.union1d(grid.alpha_deg, np.arange(0.0, POLAR_ALPHA_DEG + 1.0, POLAR_STEP_DEG))
    i = cells_of(grid.alpha_deg, alpha)
    share = ((alpha - grid.alpha_deg[i]) / np.diff(grid.alpha_deg)[i])[None, :, None, None]
    values = (1.0 - share) * grid.values[:, i] + share * grid.values[:, i + 1]
    return Grid(grid.mach, alpha, grid.deflection_deg, values)


def _polar_below(grid: Grid, low_speed: FloatArray) -> Grid:
    """A basic table with rows of CN and CA from CL = CL_0 + CL_alpha alpha, CD = CD_0 + K CL^2.

    The polar is held above POLAR_ALPHA_DEG; the moment is that of the lowest Mach number.
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
    row = grid.values[:1] * np.array([0.0, 0.0, 1.0])
    return grid._replace(mach=np.concatenate(([mach], grid.mach)), values=np.concatenate((row, grid.values)))


def aircraft_xml(aero: Aero) -> str:
    """The JSBSim configuration of a vehicle as text."""
    parts = (
        f'<?xml version="1.0"?>\n<fdm_config name="{MODEL}" version="2.0" release="BETA">',
        _metrics(aero),
        _mass_balance(aero),
        "<ground_reactions/>",
        _external_reactions(aero),
        _surface_limits(aero),
        f'<system file="{Path(CONTROL).stem}"/>',
        _aerodynamics(aero),
        "</fdm_config>\n",
    )
    return "\n".join(parts)


def _location(name: str, x_m: float) -> str:
    label = f' name="{name}"' if name else ""
    return f'<location{label} unit="M"><x>{x_m!r}</x><y>0.0</y><z>0.0</z></location>'


def _metrics(aero: Aero) -> str:
    ref = aero.file.reference
    return "\n".join((
        "<metrics>",
        f'<wingarea unit="M2">{ref.area_m2!r}</wingarea>',
        f'<wingspan unit="M">{ref.span_m!r}</wingspan>',
        f'<chord unit="M">{ref.chord_m!r}</chord>',
        _location("AERORP", ref.moment_reference_fraction * ref.length_m),
        "</metrics>",
    ))  # fmt: skip


def _mass_balance(aero: Aero) -> str:
    mass = aero.file.mass
    scale = aero.mass_kg / mass.inertia_at_kg / SLUG_FT2_KG_M2
    inertia = {"ixx": mass.Ixx_kg_m2, "iyy": mass.Iyy_kg_m2, "izz": mass.Izz_kg_m2, "ixz": mass.Ixz_kg_m2}
    return "\n".join((
        "<mass_balance>",
        *(f'<{axis} unit="SLUG*FT2">{value * scale!r}</{axis}>' for axis, value in inertia.items()),
        f'<emptywt unit="KG">{aero.mass_kg!r}</emptywt>',
        _location("CG", aero.cg_fraction * aero.file.reference.length_m),
        "</mass_balance>",
    ))  # fmt: skip


def _external_reactions(aero: Aero) -> str:
    """Jet moments about the body axes, and the force of commanded firings through the centre of gravity."""
    cg = aero.cg_fraction * aero.file.reference.length_m
    axes = {"jets-roll": (1, 0, 0), "jets-pitch": (0, 1, 0), "jets-yaw": (0, 0, 1)}
    moments = [f'<moment name="{name}" frame="BODY">{_direction(axis)}</moment>' for name, axis in axes.items()]
    force = f'<force name="jets-firing" frame="BODY">{_location("", cg)}{_direction((0, 0, 1))}</force>'
    return "\n".join(("<external_reactions>", *moments, force, "</external_reactions>"))


def _direction(axis: tuple[int, int, int]) -> str:
    return "<direction><x>{}</x><y>{}</y><z>{}</z></direction>".format(*axis)


def _surface_limits(aero: Aero) -> str:
    """Travel and rate of the surfaces as properties, for the actuators of the attitude control."""
    limits = {"elevon": aero.file.elevon, "bodyflap": aero.file.bodyflap}
    properties = [
        f'<property value="{value!r}">control/{surface}-{what}</property>'
        for surface, data in limits.items()
        for what, value in _limit_values(data).items()
    ]
    return "\n".join(('<system name="surface_limits">', *properties, "</system>"))


def _limit_values(surface: Surface) -> dict[str, float]:
    return {"min-deg": surface.range_deg[0], "max-deg": surface.range_deg[1], "rate-deg_s": surface.rate_deg_s}


def _aerodynamics(aero: Aero) -> str:
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
    return "\n".join((
        "<aerodynamics>",
        *functions,
        _function("aero/elevon-Cm-cg", f"<sum><p>aero/elevon-Cm</p>{_product('aero/elevon-CN', aero.arm)}</sum>"),
        _function("aero/shift-Cm", _shift_table(aero)),
        _axis("AXIAL", "aero/force-axial", _sum(names["CA"])),
        _axis("NORMAL", "aero/force-normal", _sum(names["CN"])),
        _axis("PITCH", "aero/moment-pitch", _pitch(names["Cm"], aero.file.damping), "metrics/cbarw-ft"),
        *_lateral_axes(aero.file.lateral, aero.file.damping),
        "</aerodynamics>",
    ))  # fmt: skip


def _function(name: str, body: str) -> str:
    return f'<function name="{name}">{body}</function>'


def _axis(axis: str, name: str, coefficient: str, *length: str) -> str:
    """Force qbar S C, or moment qbar S length C, along an axis."""
    scale = "".join(f"<p>{r}</p>" for r in ("aero/qbar-psf", "metrics/Sw-sqft", *length))
    return f'<axis name="{axis}">{_function(name, f"<product>{scale}{coefficient}</product>")}</axis>'


def _product(name: str, *factors: float | str) -> str:
    rest = "".join(f"<p>{f}</p>" if isinstance(f, str) else f"<v>{f!r}</v>" for f in factors)
    return f"<product><p>{name}</p>{rest}</product>"


def _sum(names: list[str], *more: str) -> str:
    return "<sum>" + "".join(f"<p>{n}</p>" for n in names) + "".join(more) + "</sum>"


def _pitch(names: list[str], damping: Damping) -> str:
    return _sum([*names, "aero/shift-Cm"], _product("velocities/q-aero-rad_sec", "aero/ci2vel", damping.Cmq))


def _lateral_axes(lateral: Lateral, damping: Damping) -> tuple[str, ...]:
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


def _shift_table(aero: Aero) -> str:
    low, high = aero.file.cm_shift.mach
    rows = f"{low!r} 0.0\n{high!r} {aero.cm_shift!r}"
    return f"<table>{MACH_ROW}<tableData>\n{rows}\n</tableData></table>"


def _table_function(name: str, grid: Grid, index: int, variables: tuple[str, ...]) -> str:
    values = grid.values[..., index]
    if grid.mach.size == 1:  # the vehicle has no such surface
        return _function(name, f"<v>{float(values.ravel()[0])!r}</v>")
    lookups = zip(("row", "column", "table"), variables, strict=False)
    head = "".join(f'<independentVar lookup="{kind}">{variable}</independentVar>' for kind, variable in lookups)
    if len(variables) == 2:
        block = _block(grid.alpha_deg, grid.mach, values[:, :, 0].T)
        return _function(name, f"<table>{head}<tableData>\n{block}\n</tableData></table>")
    blocks = [
        f'<tableData breakPoint="{mach!r}">\n{_block(grid.alpha_deg, grid.deflection_deg, values[i])}\n</tableData>'
        for i, mach in enumerate(grid.mach.tolist())
    ]
    return _function(name, f"<table>{head}{''.join(blocks)}</table>")


def _block(rows: FloatArray, columns: FloatArray, values: FloatArray) -> str:
    """A table in JSBSim's layout, one row an alpha."""
    if not math.isfinite(float(values.sum())):
        raise InputError("aerodynamic table: a value is not finite")
    head = INDENT + " ".join(map(repr, columns.tolist()))
    body = (INDENT + " ".join(map(repr, [r, *line])) for r, line in zip(rows.tolist(), values.tolist(), strict=True))
    return "\n".join((head, *body))
