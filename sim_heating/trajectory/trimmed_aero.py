"""Trimmed lift and drag of a vehicle from Mach 0 up, as compiled kernels on one flat block.

At every call the elevon trims the pitching moment about the centre of gravity to zero, exactly: the tables are linear
between nodes, and so is their sum. CN, CA, Cm are those of `aero.Aero`, bilinear in Mach and alpha. Below the tables'
lowest Mach number the parabolic polar of aero/low_speed.csv takes over, CL = CL_0 + CL_alpha alpha,
CD = CD_0 + K CL^2, blended linearly from its highest Mach number.

Source: docs/theory/equations.md, equations 35 and 36.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.errors import InputError
from sim_heating.base.files import read_csv_columns
from sim_heating.base.kernels.axis import cell_of
from sim_heating.base.kernels.jit import njit
from sim_heating.trajectory.aero import Aero, Grid
from sim_heating.trajectory.guidance import clip

ARM, CM_SHIFT, SHIFT_LOW, SHIFT_HIGH, ELEVON_LOW, ELEVON_HIGH = range(6)
"""First numbers of a flight's block: (x_cg - x_ref) / c, flight-found Cm, its Mach numbers, elevon travel [deg]."""

(MACHS, ALPHAS, FLAPS, ELEVONS, LOWS, AT_ALPHA, AT_FLAP, AT_ELEVON, AT_LOW, AT_CELLS, AT_MACH) = range(11)
"""Head of a vehicle's aerodynamic block: numbers of Mach, alpha, body-flap, elevon and low-speed points, and where
alpha, body-flap and elevon axes, low-speed rows and cells begin; the Mach axis follows the head. All tables use
the Mach and alpha points of each of them. One cell for each (mach, alpha), alpha fastest, holds CN, CA, Cm of the basic
table, of each body-flap node and of each elevon node; a low-speed row is mach, CL_0, CL_alpha 1/deg, CD_0, K."""


class TableCell(NamedTuple):
    """The four grid points around a Mach number and an angle of attack: positions of their values, and weights."""

    c00: int
    c01: int
    c10: int
    c11: int
    w00: float
    w01: float
    w10: float
    w11: float


@njit
def bracket_scan(block: FloatArray, start: int, points: int, x: float) -> tuple[int, float]:
    """Interval of x on a short rising axis inside a block and its position within, 0 to 1 [-]; held at the ends."""
    if points == 1:
        return 0, 0.0
    cell = cell_of(block, start, points, x)
    i = start + cell
    return cell, clip((x - block[i]) / (block[i + 1] - block[i]), 0.0, 1.0)


@njit
def table_cell(aero: FloatArray, mach: float, alpha_deg: float) -> TableCell:
    """Positions and bilinear weights [-] of the grid points around a Mach number [-] and an angle [deg]; constant at
    the ends.

    Source: docs/theory/equations.md, equation 36.
    """
    machs, alphas = int(aero[MACHS]), int(aero[ALPHAS])
    width = 3 * (1 + int(aero[FLAPS]) + int(aero[ELEVONS]))
    i, u = bracket_scan(aero, AT_MACH, machs, mach)
    j, v = bracket_scan(aero, int(aero[AT_ALPHA]), alphas, alpha_deg)
    corner = int(aero[AT_CELLS]) + (i * alphas + j) * width
    right, up = (width if alphas > 1 else 0), (alphas * width if machs > 1 else 0)
    return TableCell(
        corner,
        corner + right,
        corner + up,
        corner + up + right,
        (1.0 - u) * (1.0 - v),
        (1.0 - u) * v,
        u * (1.0 - v),
        u * v,
    )


@njit
def cell_value(aero: FloatArray, p: TableCell, k: int) -> float:
    """Number k of the cells, a coefficient [-], bilinear between the grid points.

    Source: docs/theory/equations.md, equation 36.
    """
    return p.w00 * aero[p.c00 + k] + p.w01 * aero[p.c01 + k] + p.w10 * aero[p.c10 + k] + p.w11 * aero[p.c11 + k]


@njit
def moment_at_node(aero: FloatArray, p: TableCell, moment: float, arm: float, node: int) -> float:
    """moment + dCm + arm dCN [-] with the elevon at a node of its table.

    Source: docs/theory/equations.md, equation 36.
    """
    k = 3 + 3 * int(aero[FLAPS]) + 3 * node
    return moment + cell_value(aero, p, k + 2) + arm * cell_value(aero, p, k)


@njit
def trim_elevon(aero: FloatArray, p: TableCell, moment: float, arm: float) -> float:
    """Elevon [deg] at which moment + dCm + arm dCN is 0; the table's end where there is none.

    The sum falls with deflection and is linear between nodes, so halving the nodes finds it exactly.

    Source: docs/theory/equations.md, equation 36.
    """
    axis, last = int(aero[AT_ELEVON]), int(aero[ELEVONS]) - 1
    low, high, below, above = 0, last, 0.0, 0.0
    while high - low > 1:
        middle = (low + high) // 2
        at_middle = moment_at_node(aero, p, moment, arm, middle)
        if at_middle > 0.0:
            low, below = middle, at_middle
        else:
            high, above = middle, at_middle
    # Ends that halving left alone have not been evaluated.
    if low == 0:
        below = moment_at_node(aero, p, moment, arm, low)
    if high == last:
        above = moment_at_node(aero, p, moment, arm, high)
    if below <= 0.0:
        return aero[axis + low]
    if above >= 0.0:
        return aero[axis + high]
    return aero[axis + low] + below / (below - above) * (aero[axis + high] - aero[axis + low])


@njit
def trimmed_kernel(
    mach: float, alpha_deg: float, flap_deg: float, d_elevon_deg: float, flight: FloatArray, aero: FloatArray
) -> tuple[float, float, float]:
    """CN, CA [-] and elevon [deg] with the elevon in trim plus an offset [deg], within its travel.

    Source: docs/theory/equations.md, section 6.
    """
    p = table_cell(aero, mach, alpha_deg)
    flaps, elevons = int(aero[FLAPS]), int(aero[ELEVONS])
    k, w = bracket_scan(aero, int(aero[AT_FLAP]), flaps, flap_deg)
    a, b = 3 + 3 * k, 3 + 3 * min(k + 1, flaps - 1)
    cn = cell_value(aero, p, 0) + (1.0 - w) * cell_value(aero, p, a) + w * cell_value(aero, p, b)
    ca = cell_value(aero, p, 1) + (1.0 - w) * cell_value(aero, p, a + 1) + w * cell_value(aero, p, b + 1)
    cm = cell_value(aero, p, 2) + (1.0 - w) * cell_value(aero, p, a + 2) + w * cell_value(aero, p, b + 2)
    cm += flight[CM_SHIFT] * clip((mach - flight[SHIFT_LOW]) / (flight[SHIFT_HIGH] - flight[SHIFT_LOW]), 0.0, 1.0)
    low, high = flight[ELEVON_LOW], flight[ELEVON_HIGH]
    # Limited before the offset is added: a manoeuvre moves the surface from where it is, not from a trim beyond its
    # travel.
    trim = clip(trim_elevon(aero, p, cm + flight[ARM] * cn, flight[ARM]), low, high)
    elevon = clip(trim + d_elevon_deg, low, high)
    k, w = bracket_scan(aero, int(aero[AT_ELEVON]), elevons, elevon)
    first = 3 + 3 * flaps
    a, b = first + 3 * k, first + 3 * min(k + 1, elevons - 1)
    cn += (1.0 - w) * cell_value(aero, p, a) + w * cell_value(aero, p, b)
    ca += (1.0 - w) * cell_value(aero, p, a + 1) + w * cell_value(aero, p, b + 1)
    return cn, ca, elevon


@njit
def polar_kernel(mach: float, alpha_deg: float, aero: FloatArray) -> tuple[float, float]:
    """CL and CD [-] of the low-speed polar at an angle of attack [deg], its coefficients linear in Mach.

    Source: docs/theory/equations.md, equation 36.
    """
    a, last = int(aero[AT_LOW]), int(aero[AT_LOW]) + 5 * (int(aero[LOWS]) - 1)
    while a < last - 5 and mach >= aero[a + 5]:
        a += 5
    b = min(a + 5, last)
    u = clip((mach - aero[a]) / max(aero[b] - aero[a], 1e-9), 0.0, 1.0)
    v = 1.0 - u
    cl = v * aero[a + 1] + u * aero[b + 1] + (v * aero[a + 2] + u * aero[b + 2]) * alpha_deg
    return cl, v * aero[a + 3] + u * aero[b + 3] + (v * aero[a + 4] + u * aero[b + 4]) * cl * cl


@njit
def lift_drag_kernel(
    mach: float, alpha_deg: float, flap_deg: float, d_elevon_deg: float, flight: FloatArray, aero: FloatArray
) -> tuple[float, float, float, float]:
    """CL, CD, CA [-] and elevon [deg] in trim, over all Mach numbers.

    Source: docs/theory/equations.md, equation 36.
    """
    s, c = math.sin(math.radians(alpha_deg)), math.cos(math.radians(alpha_deg))
    cn, ca, elevon = trimmed_kernel(mach, alpha_deg, flap_deg, d_elevon_deg, flight, aero)
    cl, cd = cn * c - ca * s, cn * s + ca * c
    rows, bottom = int(aero[LOWS]), aero[AT_MACH]
    if rows > 0 and mach < bottom:
        # The polar is trimmed; between its last row and the lowest tabulated Mach number lift and drag are blended.
        cl_low, cd_low = polar_kernel(mach, alpha_deg, aero)
        top = aero[int(aero[AT_LOW]) + 5 * (rows - 1)]
        fraction = clip((mach - top) / (bottom - top), 0.0, 1.0)
        cl, cd = cl_low + fraction * (cl - cl_low), cd_low + fraction * (cd - cd_low)
    return cl, cd, cd * c - cl * s, elevon


LOW_SPEED = ("mach", "CL_0", "CL_alpha_deg", "CD_0", "K")


def low_speed_rows(vehicle_dir: Path, below_mach: float) -> FloatArray:
    """Rows of aero/low_speed.csv, Mach [-], CL_0 [-], CL_alpha [1/deg], CD_0, K [-]; (0, 5) where a vehicle has no
    such file.

    raises : InputError where mach does not rise, or reaches the Mach number where the tables begin

    Source: docs/theory/equations.md, equation 36.
    """
    path = Path(vehicle_dir) / "aero" / "low_speed.csv"
    if not path.exists():
        return np.zeros((0, len(LOW_SPEED)))
    columns = read_csv_columns(path, LOW_SPEED)
    rows = np.column_stack([columns[name] for name in LOW_SPEED])
    if np.any(np.diff(rows[:, 0]) <= 0.0) or rows[-1, 0] >= below_mach:
        raise InputError(f"{path}, column mach: must rise and stay below {below_mach:g}, where the other tables begin")
    return rows


def aero_block(aero: Aero, low_speed: FloatArray) -> FloatArray:
    """A vehicle's tables, angles [deg] and coefficients [-], in one block for the kernels, with the layout described
    at MACHS.

    Source: docs/theory/equations.md, equation 36.
    """
    # All three tables on the union of their axes, which keeps linear interpolation exact: one search for Mach and alpha
    # serves all.
    grids = (aero.basic, aero.bodyflap, aero.elevon)
    mach = np.unique(np.concatenate([g.mach for g in grids]))
    alpha = np.unique(np.concatenate([g.alpha_deg for g in grids]))
    cells = np.concatenate([resample_grid(g, mach, alpha) for g in grids], axis=2)
    flap, elevon = aero.bodyflap.deflection_deg, aero.elevon.deflection_deg
    parts = [mach, alpha, flap, elevon, low_speed.ravel(), cells.ravel()]
    starts = AT_MACH + np.cumsum([len(p) for p in parts])[:-1]
    head = [len(mach), len(alpha), len(flap), len(elevon), len(low_speed), *starts]
    return np.concatenate([np.array(head, dtype=float), *parts])


def resample_grid(grid: Grid, mach: FloatArray, alpha: FloatArray) -> FloatArray:
    """Coefficients [-] of a table on finer axes of Mach [-] and alpha [deg] that contain its own; constant beyond its
    ends.

    Source: docs/theory/equations.md, equation 36.
    """
    by_mach = np.apply_along_axis(lambda v: np.interp(mach, grid.mach, v), 0, grid.values)
    return np.apply_along_axis(lambda v: np.interp(alpha, grid.alpha_deg, v), 1, by_mach)
