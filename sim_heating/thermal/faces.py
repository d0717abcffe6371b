"""Heat that enters the wall from outside, at its surface, at its back and in gaps; for eight lanes at once, compiled.

At the surface, at the back, and at every node along a gap that hot gas flows in:

    source_0     = (1 - f) film (H_r - H_w(T)) + q_add - eps(T) sigma (T^4 - T_sur^4),
    source_(n-1) = -h_b (T - T_b) - eps_b sigma (T^4 - T_b^4),
    source_i    += f w_i film (H_r - H_w(T_i)),      f the part of the film that is spent there, sum of w_i = 1.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sim_heating.jit import folded, njit
from sim_heating.layout import (
    ADDED,
    BACK_EPS,
    BACK_H,
    BACK_NODE,
    BACK_T,
    C_STAGES,
    EMISSIVITY_TABLE,
    ENTHALPY_TABLE,
    FACTOR_EPS,
    FILM,
    GAP,
    GAPS,
    H_REF,
    HEAD_ROWS,
    LANES,
    N_CONDITIONS,
    N_EMITTING,
    N_NODES,
    N_PRESSURES,
    NODE_ROWS,
    PCOL,
    PFRAC,
    R_BASE,
    RECOVERY,
    SLOPE,
    SOURCE,
    SURFACE_SHARE,
    SURROUNDINGS4,
    WALL_EFFECTS,
    T,
)
from sim_heating.surface_heating import emittance_factor, with_effects
from sim_heating.thermal.assembly import BIN_K, property_bin

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

SIGMA = 5.670374419e-8
"""Stefan-Boltzmann constant [W/(m2 K4)], CODATA 2018."""
WALL_DIFFERENCE_K = 0.01
"""Half the step over which an effect's dependence on the wall temperature is differenced, for the matrix only: a
sensitivity to 1e-9 wants it small against the width of any effect."""


@folded
def _film(B: FloatArray, J: IntArray, chain, lane: int, stage: int, wall: float) -> tuple[float, float]:  # type: ignore[no-untyped-def]
    """Film coefficient of a lane whose effects ask for the wall temperature, and its slope against it."""
    h_ref = B[C_STAGES * LANES + (stage * LANES + lane) * N_CONDITIONS + H_REF]
    r = B[(R_BASE + stage) * LANES + lane]
    above = with_effects(B, J, chain, lane, stage, r, wall + WALL_DIFFERENCE_K)
    below = with_effects(B, J, chain, lane, stage, r, wall - WALL_DIFFERENCE_K)
    slope = (above - below) * (0.5 / WALL_DIFFERENCE_K)
    return h_ref * with_effects(B, J, chain, lane, stage, r, wall), h_ref * slope


@folded
def _factor(B: FloatArray, J: IntArray, chain, lane: int, stage: int, wall: float) -> tuple[float, float]:  # type: ignore[no-untyped-def]
    """What effects make of the emittance of a lane, and its slope against the wall temperature."""
    above = emittance_factor(B, J, chain, lane, stage, wall + WALL_DIFFERENCE_K)
    below = emittance_factor(B, J, chain, lane, stage, wall - WALL_DIFFERENCE_K)
    return emittance_factor(B, J, chain, lane, stage, wall), (above - below) * (0.5 / WALL_DIFFERENCE_K)


@njit
def _wall_enthalpy(
    B: FloatArray, J: IntArray, table: FloatArray, lane: int, stage: int, T_K: float
) -> tuple[float, float]:
    """Enthalpy of air [J/kg] at a temperature and the pressure of a stage, and its specific heat [J/(kg K)]."""
    j = property_bin(T_K)
    f = B[(PFRAC + stage) * LANES + lane]
    row = J[ENTHALPY_TABLE + lane] + 2 * (j * J[N_PRESSURES + lane] + int(B[(PCOL + stage) * LANES + lane]))
    cp = table[row + 1] + f * (table[row + 3] - table[row + 1])
    return table[row] + f * (table[row + 2] - table[row]) + (T_K - BIN_K * j) * cp, cp


@njit
def _emissivity(table: FloatArray, first: int, wall: float) -> tuple[float, float]:
    """Emittance and its slope [1/K]: linear between the points of the table, constant beyond its ends.

    The points are kept as they are, without bins: radiation feels a corner that is cut.
    """
    n = int(table[first])
    T_K, eps = first + 1, first + 1 + n
    if n == 1 or not wall > table[T_K]:
        return table[eps], 0.0
    if wall >= table[T_K + n - 1]:
        return table[eps + n - 1], 0.0
    i = 0
    while wall >= table[T_K + i + 1]:
        i += 1
    slope = (table[eps + i + 1] - table[eps + i]) / (table[T_K + i + 1] - table[T_K + i])
    return table[eps + i] + slope * (wall - table[T_K + i]), slope


@njit
def evaluate_faces(B: FloatArray, J: IntArray, table: FloatArray, chain, stage: int) -> None:  # type: ignore[no-untyped-def]
    """All heat from outside, and its slopes, at the temperatures present."""
    evaluate_surface(B, J, table, chain, stage)
    evaluate_back(B, J)
    if J[GAPS] == 1:
        _evaluate_gaps(B, J, table, stage)


@folded
def _evaluate_gaps(B: FloatArray, J: IntArray, table: FloatArray, stage: int) -> None:
    """Heat that hot gas brings to the nodes along a gap, each by its own temperature; the film is the surface's."""
    for i in range(J[N_NODES]):
        a = (HEAD_ROWS + i * NODE_ROWS) * LANES
        for lane in range(LANES):
            part = B[a + GAP * LANES + lane]
            source, slope = 0.0, 0.0
            if part > 0.0:
                H_w, cp_w = _wall_enthalpy(B, J, table, lane, stage, B[a + T * LANES + lane])
                film = part * B[(FILM + stage) * LANES + lane]
                source, slope = film * (B[(RECOVERY + stage) * LANES + lane] - H_w), -film * cp_w
            face = i == 0 or i == J[BACK_NODE + lane]
            B[a + SOURCE * LANES + lane] = source + (B[a + SOURCE * LANES + lane] if face else 0.0)
            B[a + SLOPE * LANES + lane] = slope + (B[a + SLOPE * LANES + lane] if face else 0.0)


@folded
def evaluate_surface(B: FloatArray, J: IntArray, table: FloatArray, chain, stage: int) -> None:  # type: ignore[no-untyped-def]
    """Heat that enters at the surface [W/m2] and its slope against the surface temperature [W/(m2 K)]."""
    a = HEAD_ROWS * LANES
    for lane in range(LANES):
        wall = B[a + T * LANES + lane]
        factor = B[FACTOR_EPS * LANES + lane]
        eps, eps_slope = _emissivity(table, J[EMISSIVITY_TABLE + lane], wall)
        if J[N_EMITTING + lane] > 0:
            more, more_slope = _factor(B, J, chain, lane, stage, wall)
            eps, eps_slope = eps * more, eps_slope * more + eps * more_slope
        H_w, cp_w = _wall_enthalpy(B, J, table, lane, stage, wall)
        film, film_slope = B[(FILM + stage) * LANES + lane], 0.0
        if J[WALL_EFFECTS + lane] > 0:
            film, film_slope = _film(B, J, chain, lane, stage, wall)
        film, film_slope = film * B[SURFACE_SHARE * LANES + lane], film_slope * B[SURFACE_SHARE * LANES + lane]
        driving = B[(RECOVERY + stage) * LANES + lane] - H_w
        cube = wall * wall * wall
        excess = cube * wall - B[SURROUNDINGS4 * LANES + lane]
        radiated = factor * eps * SIGMA * excess
        B[a + SOURCE * LANES + lane] = film * driving + B[(ADDED + stage) * LANES + lane] - radiated
        radiated = factor * SIGMA * (4.0 * eps * cube + eps_slope * excess)
        B[a + SLOPE * LANES + lane] = film_slope * driving - film * cp_w - radiated


@folded
def evaluate_back(B: FloatArray, J: IntArray) -> None:
    """Heat that enters at the back face [W/m2] and its slope against the temperature there [W/(m2 K)]."""
    for lane in range(LANES):
        a = (HEAD_ROWS + J[BACK_NODE + lane] * NODE_ROWS) * LANES
        inner, ambient = B[a + T * LANES + lane], B[BACK_T * LANES + lane]
        emitted = SIGMA * B[BACK_EPS * LANES + lane]
        h_b = B[BACK_H * LANES + lane]
        cube, square = inner * inner * inner, ambient * ambient
        B[a + SOURCE * LANES + lane] = -h_b * (inner - ambient) - emitted * (cube * inner - square * square)
        B[a + SLOPE * LANES + lane] = -h_b - 4.0 * emitted * cube
