"""Splines in place of a vehicle's tables, because an optimiser needs second derivatives.

Density and speed of sound over altitude, trimmed lift and drag over Mach and alpha, and for each limited control point
the temperature of a wall that stores no heat over altitude, speed and alpha: cubic splines through values that the
package's own functions give. They only steer the optimiser; the temperatures of the result are marched.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import Conditions
from sim_heating.heating.atmosphere import G0_M_S2, standard_speed_of_sound, us76
from sim_heating.inputs.points import conditions_at_point
from sim_heating.march.history import march_points
from sim_heating.march.point import PointModel
from sim_heating.planning.optimal import dynamics as od
from sim_heating.planning.optimal.collocation import ca
from sim_heating.planning.optimal.spec import OptimalStudy
from sim_heating.thermal.frame import NOT_CONTROLLED_K
from sim_heating.thermal.stack import Construction, Layer
from sim_heating.trajectory import point_mass as pm
from sim_heating.trajectory.entry3dof import Entry
from sim_heating.trajectory.flight import ROW, conditions_from_rows
from sim_heating.trajectory.spec import TrajectorySpec
from sim_heating.trajectory.trimmed_aero import lift_drag_kernel

ALTITUDE_STEP_M, HIGHEST_M = 1000.0, 150e3
MACHS = np.concatenate((np.arange(0.5, 12.0, 0.5), [12.0, 14.0, 17.0, 20.0, 25.0, 30.0, 40.0]))
ALPHA_STEP_DEG = 2.5
WALL_ALTITUDE_STEP_M, WALL_SPEED_STEP_M_S = 3000.0, 350.0
THIN_WALL_M = 1e-5
"""Thickness of a wall that reaches its equilibrium temperature within a fraction of a second where it is hot [m]."""
NODE_S, WALL_STEP_S = 20.0, 2.0
"""Time [s] from one node of the grid to the next, and the step of the march between them."""
PLANET = od.Planet(pm.WGS84_RADIUS_M, pm.WGS84_MU_M3_S2, pm.WGS84_ROTATION_RAD_S)
"""Rotating sphere with the equatorial radius of WGS84."""


@dataclass(frozen=True)
class Aerodynamics:
    """Trimmed aerodynamics of a vehicle, with the body flap on its schedule."""

    entry: Entry
    area_m2: float
    mass_kg: float

    def at(self, mach: float, alpha_deg: float, speed_m_s: float) -> tuple[float, float, float, float, float]:
        """CL, CD, CA, elevon and body flap [deg]."""
        flap = pm.flap_kernel(self.entry.flight, mach, speed_m_s, 0.0)
        CL, CD, CA, elevon = lift_drag_kernel(mach, alpha_deg, flap, 0.0, self.entry.flight, self.entry.tables)
        return CL, CD, CA, elevon, flap


def aerodynamics(study: OptimalStudy) -> Aerodynamics:
    """Aerodynamics of the study's vehicle as in the built-in 3-DOF entry."""
    file = study.declared
    spec = TrajectorySpec(source="entry-3dof", initial=file.initial, vehicle=file.state)
    entry = Entry(spec, study.vehicle.directory)
    return Aerodynamics(entry, float(entry.flight[pm.AREA]), float(entry.flight[pm.MASS]))


def conditions_along(
    study: OptimalStudy, aero: Aerodynamics, time_s: FloatArray, states: FloatArray, controls: FloatArray
) -> Conditions:
    """Flight conditions along a motion.

    time_s   : (time,) [s]
    states   : (6, time) as dynamics.py orders them;  controls : (2, time) angle of attack and bank [deg]
    """
    h, V, alpha = states[od.ALTITUDE], states[od.SPEED], controls[od.ALPHA]
    rho = us76(h)[2]
    mach = V / standard_speed_of_sound(h)
    flown = np.array([aero.at(*at) for at in zip(mach.tolist(), alpha.tolist(), V.tolist(), strict=True)])
    drag_g = 0.5 * rho * V**2 * aero.area_m2 / aero.mass_kg / G0_M_S2
    angles = {
        "gamma_deg": od.GAMMA,
        "heading_deg": od.HEADING,
        "latitude_deg": od.LATITUDE,
        "longitude_deg": od.LONGITUDE,
    }
    columns = {
        "time_s": time_s,
        "altitude_m": h,
        "velocity_m_s": V,
        "alpha_deg": alpha,
        "beta_deg": 0.0,
        "elevon_deg": flown[:, 3],
        "bodyflap_deg": flown[:, 4],
        "rho_kg_m3": rho,
        "jets": 0.0,
        "bank_deg": controls[od.BANK],
        **{name: np.degrees(states[row]) for name, row in angles.items()},
        "axial_accel_g": drag_g * flown[:, 2],
    }
    rows = np.column_stack([np.broadcast_to(columns[name], time_s.shape) for name in ROW])
    return conditions_from_rows(rows, study.vehicle.reference_length_m)


@dataclass(frozen=True)
class AtmosphereSplines:
    """Splines over altitude [m]: natural logarithm of density [kg/m3], speed of sound [m/s]."""

    ln_density: Any
    sound: Any


def atmosphere_splines() -> AtmosphereSplines:
    """US76 as splines."""
    z = np.arange(0.0, HIGHEST_M + 1.0, ALTITUDE_STEP_M)
    # Logarithm of the density, which is nearly linear in altitude and stays positive between the nodes.
    rho = us76(z)[2]
    return AtmosphereSplines(_spline("ln_density", [z], np.log(rho)), _spline("sound", [z], standard_speed_of_sound(z)))


def lift_drag(study: OptimalStudy, aero: Aerodynamics) -> Any:
    """(mach, alpha) -> CL, CD as a spline."""
    alpha = _alphas(study)
    speed = MACHS * 300.0
    values = np.array(
        [[aero.at(float(m), float(a), float(v))[:2] for a in alpha] for m, v in zip(MACHS, speed, strict=True)]
    )
    return _spline("lift_drag", [MACHS, alpha], np.moveaxis(values, 2, 0))


def wall_temperatures(study: OptimalStudy, aero: Aerodynamics, models: Sequence[PointModel]) -> Any:
    """(altitude, speed, alpha) -> temperature of each point's surface in equilibrium with its heating [kK], a spline.

    The points' own models are marched with a wall too thin to store heat through all nodes of the grid, each node a
    neighbour of the one before.
    """
    file = study.declared
    h = _nodes(0.7 * file.end.altitude_m, file.initial.altitude_m * 1.05, WALL_ALTITUDE_STEP_M)
    V = _nodes(0.6 * file.end.velocity_m_s, file.initial.velocity_m_s * 1.08, WALL_SPEED_STEP_M_S)
    alpha = _alphas(study)
    # One march through all nodes of the grid: from neighbour to neighbour the wall has little to change and is in
    # equilibrium at each node. Errors of the steps between do not matter: every step ends in equilibrium.
    order = _neighbours(len(h), len(V), len(alpha))
    nodes = np.array([g.ravel()[order] for g in np.meshgrid(h, V, alpha, indexing="ij")])
    count = nodes.shape[1]
    states, controls = np.zeros((od.STATES, count)), np.zeros((2, count))
    states[od.ALTITUDE], states[od.SPEED], controls[od.ALPHA] = nodes
    time = np.linspace(0.0, NODE_S * (count - 1), count)
    grid = conditions_along(study, aero, time, states, controls)
    flights = [conditions_at_point(study.vehicle, p.point, grid) for p in study.points]
    walls = march_points(
        [_on_thin_wall(m) for m in models], flights, longest_step_s=WALL_STEP_S, tolerance_K=NOT_CONTROLLED_K
    )
    flat = np.empty((len(models), len(order)))
    flat[:, order] = [w.surface_K / 1e3 for w in walls]
    return _spline("wall", [h, V, alpha], flat.reshape(len(models), len(h), len(V), len(alpha)))


def _neighbours(rows: int, columns: int, layers: int) -> NDArray[np.int64]:
    """Flat indices of the nodes of a grid, in an order in which each node is a neighbour of the one before."""
    flat = np.arange(rows * columns * layers).reshape(rows, columns, layers)
    flat[::2] = flat[::2, ::-1]
    lines = flat.reshape(-1, layers)
    lines[::2] = lines[::2, ::-1]
    return lines.ravel()


def _on_thin_wall(model: PointModel) -> PointModel:
    """The surface of a point on a wall that neither stores nor conducts heat."""
    stack = model.construction.stack
    layer = Layer(material=stack.layer[0].material, thickness_m=THIN_WALL_M)
    bare = stack.model_copy(update={"layer": [layer], "initial_profile": None, "initial_K": 300.0, "back": "adiabatic"})
    construction = Construction(stack=bare, materials=model.construction.materials)
    return replace(model, construction=construction, depths_m=(), lags_s=(), nodes=3)


def _alphas(study: OptimalStudy) -> FloatArray:
    low, high = study.declared.alpha_limits_deg
    return _nodes(low, high, ALPHA_STEP_DEG)


def _nodes(low: float, high: float, step: float) -> FloatArray:
    """Equidistant nodes from low to high with a spacing of `step` at most; four or more, for a cubic."""
    return np.linspace(low, high, max(int(np.ceil((high - low) / step)) + 1, 4))


def _spline(name: str, axes: list[FloatArray], values: FloatArray) -> Any:
    """Cubic spline through values ([output,] *axes)."""
    outputs = values if values.ndim > len(axes) else values[np.newaxis]
    return ca.interpolant(name, "bspline", [a.tolist() for a in axes], outputs.ravel(order="F"))
