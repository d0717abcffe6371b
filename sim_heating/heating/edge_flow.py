"""What declared transition and declared recombination read of the flow at a control point, along a flight or a frame.

    turbulent_ratio    turbulent over laminar heating ratio of the point's tables [-]
    log10_re_theta_m   log10 of Re_theta / M_e [-] of the laminar boundary layer
    dissociation_J_kg  heat of dissociation of the flow at its edge [J/kg]

The edge of the boundary layer is that of the point's recovery enthalpy (heating/reference/recovery.py): Newtonian
pressure, u_e = V |cos(angle)|. The laminar momentum thickness is Eckert's,

    Re_theta = 0.664 sqrt(rho* mu* u_e x) / mu_e / sqrt(3),    M_e = u_e / a_e,

with sqrt(3) for flow that diverges as over a cone. A control surface is wetted by the boundary layer that has run along
the surface ahead of it: its criterion is that of the surface without deflection. M_e is at least 1 and, on a surface
from which a shock is detached, that of the steepest one with an attached shock. Atoms are those of equilibrium air at
the edge, or at the stagnation point, whose flow wets a blunt body, all of them or the oxygen alone; they remain as they
are from there on (frozen).
Equations: docs/theory/equations_reference_heating.md, equations 33 to 35.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal, NamedTuple, get_args

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import RATIO_VARIABLES, Conditions
from sim_heating.base.kernels.jit import njit
from sim_heating.base.kernels.operations import pointer
from sim_heating.heating.effects import EffectUse
from sim_heating.heating.effects.recombination import HEAT_OF_OXYGEN, RECOMBINATION
from sim_heating.heating.effects.transition import BY_RE_THETA as BY_RE_THETA_VALUE
from sim_heating.heating.effects.transition import TRANSITION
from sim_heating.heating.ratio.lookup import pack_table, table_ratio
from sim_heating.heating.ratio.table import RatioTable
from sim_heating.heating.reference.flat_plate import DIVERGING_LAMINAR, reference_enthalpy, windward_edge
from sim_heating.heating.reference.gas import (
    air_dissociation_kernel,
    dissociation_in_cell,
    enthalpy_in_cell,
    pressure_cell,
    sound_in_cell,
    state_in_cell,
)
from sim_heating.heating.reference.recovery import EDGE_LAMINAR, EDGE_TURBULENT, Recovery
from sim_heating.heating.reference.stagnation import SLOWEST_M_S, stagnation_kernel

FLOW_COLUMNS = ("turbulent_ratio", "log10_re_theta_m", "dissociation_J_kg")
"""Columns of the conditions that follow from declared transition and recombination."""
LAMINAR_AT, TURBULENT_AT, LARGEST, BY_RE_THETA, ATOMS, LOG_LENGTH, KIND, ANGLE, BY_ELEVON, BY_BODYFLAP = range(10)
FLOW_WIDTH = 10
"""Places in the numbers of a point: its tables in the flat array (-1 without), the largest ratio of the laminar one [-]
(1 without), whether Re_theta / M_e is asked for, of which flow the atoms are, log10 of the running length in m; its
recovery, local angle [deg], elevon and body-flap factor [-]."""
Atoms = Literal["none", "edge", "stagnation", "edge-oxygen", "stagnation-oxygen"]
"""Flow whose atoms reach the wall."""
NO_ATOMS, OF_EDGE, OF_STAGNATION, EDGE_OXYGEN, STAGNATION_OXYGEN = 0.0, 1.0, 2.0, 3.0, 4.0
ATOMS_OF: dict[Atoms, float] = dict(
    zip(get_args(Atoms), (NO_ATOMS, OF_EDGE, OF_STAGNATION, EDGE_OXYGEN, STAGNATION_OXYGEN), strict=True)
)
MOMENTUM_C = 0.664
"""Of Blasius: Re_theta = 0.664 sqrt(Re_x)."""
WALL_K = 1100.0
"""Wall temperature of the laminar boundary layer [K], that of the lower-surface estimate."""


STEEPEST_DEG = 57.5
"""Half-angle [deg] of the steepest cone with an attached shock, gamma 1.4, in the limit of high Mach numbers: on a
steeper surface the flow at the edge is subsonic, and Re_theta / M_e is no measure of its boundary layer (NACA Report
1135, 1953, charts of cones)."""
SONIC = 1.0
"""Least edge Mach number [-] of the criterion. Where the flow is subsonic, as on a blunt nose, published criteria are
ones of Re_theta alone (Anderson, Passive Nosetip Technology Program, SAMSO-TR-74-86)."""


@dataclass(frozen=True)
class EdgeFlow:
    """What a point asks of the flow at its edge.

    recovery           : of the point, with the angle of its surface
    running_length_m   : from the origin of the boundary layer [m]
    re_theta           : whether its transition has a criterion in Re_theta / M_e
    atoms              : flow whose atoms reach its wall
    laminar            : its ratio table, with which thin air is bridged
    turbulent          : its turbulent ratio table, where transition is declared
    """

    recovery: Recovery = field(default_factory=Recovery)
    running_length_m: float = 1.0
    re_theta: bool = False
    atoms: Atoms = "none"
    laminar: RatioTable | None = None
    turbulent: RatioTable | None = None

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns of the conditions that it adds: a ratio [-], log10 of a Reynolds number [1/m], an enthalpy [J/kg]."""
        requested = (self.turbulent is not None, self.re_theta, self.atoms != "none")
        return tuple(name for name, is_requested in zip(FLOW_COLUMNS, requested, strict=True) if is_requested)


def edge_flow(
    effects: Sequence[EffectUse],
    recovery: Recovery,
    running_length_m: float | None,
    atoms: Atoms,
    tables: Sequence[RatioTable | None],
) -> EdgeFlow:
    """What the effects of a point ask of the flow at its edge.

    recovery, running_length_m : of the point, the length [m]
    atoms                      : flow whose atoms reach the wall, where the point has recombination
    tables                     : laminar ratio table, and the turbulent one where there is one
    """
    names = {used.effect.name for used in effects}
    by_re_theta = any(used.effect.name == TRANSITION and used.values[BY_RE_THETA_VALUE] > 0.0 for used in effects)
    laminar, turbulent = (*tables, None, None)[:2]
    # Without transition a turbulent table does nothing.
    turning = turbulent if TRANSITION in names and laminar is not None else None
    of_atoms: Atoms = atoms if RECOMBINATION in names else "none"
    return EdgeFlow(recovery, running_length_m or 1.0, by_re_theta, of_atoms, laminar, turning)


def pack_flows(flows: Sequence[EdgeFlow]) -> tuple[FloatArray, FloatArray]:
    """Numbers (point, FLOW_WIDTH) of points as `edge_flow_kernel` takes them, and the flat array of their tables.

    flows   : of the points
    returns : numbers in the units of their places, angles in [deg]; tables as `pack_table` makes them, a 0 behind them
    The ratio of the two tables is turbulent over laminar (docs/reference/effects.md, equation 23).
    """
    numbers, tables, end = np.full((len(flows), FLOW_WIDTH), -1.0), [], 0
    for row, flow in zip(numbers, flows, strict=True):
        for column, table in ((LAMINAR_AT, flow.laminar), (TURBULENT_AT, flow.turbulent)):
            if table is not None:
                tables.append(pack_table(table))
                row[column], end = end, end + len(tables[-1])
        largest = 1.0 if flow.laminar is None else float(np.max(flow.laminar.ratio))
        row[LARGEST:] = (
            largest,
            float(flow.re_theta),
            ATOMS_OF[flow.atoms],
            math.log10(flow.running_length_m),
            *flow.recovery.parameters(),
        )
    return numbers, np.concatenate([*tables, np.zeros(1)])


class SurfaceEdge(NamedTuple):
    """Flow at the edge of a windward surface.

    angle_deg         : of the surface against the flow [deg]; NaN stands for no edge
    log10_re_theta_m  : log10 of Re_theta / M_e [-] of its laminar boundary layer at a running length of 1 m; 0 where it
                        was not asked for
    dissociation_J_kg : heat of dissociation at the edge [J/kg]
    """

    angle_deg: float
    log10_re_theta_m: float
    dissociation_J_kg: float


NO_EDGE = SurfaceEdge(math.nan, 0.0, 0.0)
"""To begin with, at every time."""


@njit
def surface_edge(
    state: tuple[float, float, float, float], velocity_m_s: float, angle_deg: float, complete: bool
) -> SurfaceEdge:
    """Flow at the edge of a surface.

        Re_theta = 0.664 sqrt(rho* mu* u_e x) / mu_e / sqrt(3),    M_e = u_e / a_e, at least 1

    state        : stagnation pressure [Pa], enthalpy [J/kg] and density [kg/m3], free-stream pressure [Pa]
    velocity_m_s : free-stream speed [m/s];  angle_deg : of the surface against the flow [deg]
    complete     : whether the laminar boundary layer is asked for, on a cone-like surface with a wall at WALL_K

    rho*, mu* are at Eckert's reference enthalpy. Beyond 57.5 deg M_e stays what it is there, and the criterion falls to
    0 where the flow meets the surface squarely. One cell of the pressure serves all of it.
    Source: Eckert 1956; docs/theory/equations_reference_heating.md, equations 15, 18, 33 and 34.
    """
    p_e, h_e, u_e = windward_edge(state[3], state[0], state[1], velocity_m_s, angle_deg)
    i, w = pressure_cell(p_e)
    _, mu_e, T_e = state_in_cell(h_e, p_e, i, w)
    dissociation = dissociation_in_cell(T_e, i, w)
    if not complete:
        return SurfaceEdge(angle_deg, 0.0, dissociation)
    rho, mu, _ = state_in_cell(reference_enthalpy(h_e, enthalpy_in_cell(WALL_K, i, w), u_e, False), p_e, i, w)
    mach = u_e / sound_in_cell(h_e, i, w)
    if angle_deg > STEEPEST_DEG:
        p, h, u = windward_edge(state[3], state[0], state[1], velocity_m_s, STEEPEST_DEG)
        i, w = pressure_cell(p)
        mach = u / sound_in_cell(h, i, w)
    re_theta = MOMENTUM_C * math.sqrt(rho * mu * u_e) / (mu_e * DIVERGING_LAMINAR)
    return SurfaceEdge(angle_deg, math.log10(re_theta / max(mach, SONIC)), dissociation)


@njit
def edge_flow_kernel(
    state: tuple[float, float, float, float],
    velocity_m_s: float,
    x: FloatArray,
    numbers: FloatArray,
    first: int,
    tables: FloatArray,
    last_edge: SurfaceEdge,
) -> tuple[float, float, float, SurfaceEdge]:
    """turbulent_ratio [-], log10_re_theta_m [-], dissociation_J_kg [J/kg] of a point; 1, 0 and 0 where not asked for.

    state          : stagnation pressure [Pa], enthalpy [J/kg] and density [kg/m3], free-stream pressure [Pa], as
                     `stagnation.stagnation_kernel` gives them
    velocity_m_s   : free-stream speed [m/s]
    x              : alpha, beta [deg], log10 Re [-], elevon, body flap [deg], at its beginning
    numbers, first : array that holds the numbers of the point from this place on;  tables : both of `pack_flows`
    last_edge      : last edge with a boundary layer at the same time, or NO_EDGE; returned as the fourth, or the one of
                     this point
    Source         : docs/theory/equations_reference_heating.md, equations 33 to 35.
    """
    ratio, criterion, dissociation = 1.0, 0.0, 0.0
    if numbers[first + TURBULENT_AT] >= 0.0:
        turbulent = table_ratio(tables, int(numbers[first + TURBULENT_AT]), x, 0)
        ratio = turbulent / table_ratio(tables, int(numbers[first + LAMINAR_AT]), x, 0)
    atoms, by_re_theta = numbers[first + ATOMS], numbers[first + BY_RE_THETA] > 0.0
    has_edge, of_edge = numbers[first + KIND] in (EDGE_LAMINAR, EDGE_TURBULENT), atoms in (OF_EDGE, EDGE_OXYGEN)
    # Of the boundary layer, which has run along the surface ahead of a control surface.
    running_deg = x[0] + numbers[first + ANGLE]
    if has_edge and by_re_theta:
        # Points of one surface differ by their running length alone, and an edge is the largest part of a frame.
        if running_deg != last_edge.angle_deg:
            last_edge = surface_edge(state, velocity_m_s, running_deg, True)
        criterion = last_edge.log10_re_theta_m + 0.5 * numbers[first + LOG_LENGTH]
    if has_edge and of_edge:
        angle = running_deg + numbers[first + BY_ELEVON] * x[3] + numbers[first + BY_BODYFLAP] * x[4]
        edge = last_edge if angle == last_edge.angle_deg else surface_edge(state, velocity_m_s, angle, False)
        dissociation = edge.dissociation_J_kg
    elif atoms > NO_ATOMS:
        # Without a known edge: the flow of the stagnation point.
        dissociation = air_dissociation_kernel(state[1], state[0])
    if atoms >= EDGE_OXYGEN:
        dissociation = min(dissociation, HEAT_OF_OXYGEN)
    return ratio, criterion, dissociation, last_edge


@njit
def _flow_loop(
    rho: FloatArray,
    V: FloatArray,
    T_inf: FloatArray,
    x: FloatArray,
    numbers: FloatArray,
    tables: FloatArray,
    out: FloatArray,
) -> None:
    for i in range(len(V)):
        state = stagnation_kernel(rho[i], max(V[i], SLOWEST_M_S), T_inf[i])
        out[i, 0], out[i, 1], out[i, 2], _ = edge_flow_kernel(
            state, V[i], pointer(x[i]), pointer(numbers), 0, pointer(tables), NO_EDGE
        )


def edge_flow_columns(flow: EdgeFlow, flown: Conditions) -> dict[str, FloatArray]:
    """Columns that a point's declared transition and recombination read, along a flight.

    flow    : what the point asks for
    flown   : conditions with rho_kg_m3, velocity_m_s, T_inf_K and the five ratio variables
    returns : (time,) turbulent_ratio [-], log10_re_theta_m [-], dissociation_J_kg [J/kg], those asked for
    Source: docs/theory/equations_reference_heating.md, equations 33 to 35.
    """
    if not flow.columns:
        return {}
    numbers, tables = pack_flows([flow])
    # Copies: to numba a read-only column is another type, for which the loop would be compiled a second time.
    rho, V, T_inf = (np.array(flown[name], dtype=float) for name in ("rho_kg_m3", "velocity_m_s", "T_inf_K"))
    x = np.column_stack([flown[name] for name in RATIO_VARIABLES])
    out = np.empty((len(flown), 3))
    _flow_loop(rho, V, T_inf, np.ascontiguousarray(x), numbers[0], tables, out)
    by_column = dict(zip(FLOW_COLUMNS, out.T, strict=True))
    return {name: np.ascontiguousarray(by_column[name]) for name in flow.columns}
