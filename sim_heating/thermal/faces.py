"""Heat that enters the wall from outside, at its surface, at its back and in gaps; eight lanes at once, compiled.

At the surface, at the back, and at every node along a gap that hot gas flows in
(docs/theory/equations_thermal_step.md, equations 14 to 16):

    source_0     = (1 - f) film (H_r - H_w(T)) + q_add - eps(T) sigma (T^4 - T_sur^4),
    source_(n-1) = -h_b (T - T_b) - eps_b sigma (T^4 - T_b^4),
    source_i    += f w_i film (H_r - H_w(T_i)),      f the part of the film that is spent there, sum of w_i = 1.
"""

from __future__ import annotations

from sim_heating.base.arrays import FloatArray, IntArray
from sim_heating.base.kernels import block
from sim_heating.base.kernels.block import LANES
from sim_heating.base.kernels.elementary import LN_10, exp, lanes_outside, log10
from sim_heating.base.kernels.jit import force_inline, inline_always, njit
from sim_heating.heating.film import emittance_factor, ratio_with_effects
from sim_heating.thermal.assembly import BIN_K, BINS, FAR, property_bin

SIGMA = 5.670374419e-8
"""Stefan-Boltzmann constant [W/(m2 K4)], CODATA 2018."""
AIR_HEAD = 4
"""Numbers before the bins of an enthalpy of air: log10 of its first pressure [Pa], columns in a decade, its last place,
just below the last column [-], number of columns."""
WALL_DIFFERENCE_K = 2.0**-10
"""Half the step [K] of the difference in an effect's dependence on the wall temperature. It has to be so small against
the width of any effect that the mean of both sides is the value between them to rounding (1e-12 for recombination), and
so large that the slope is good to 1e-9."""
COLDEST_K = 1.0
"""Floor of every iterate [K], and of the wall temperature that effects take. A NaN is set to it as well, and is
reported as a failure since its update is NaN too."""


@inline_always
def _film_and_slope(
    B: FloatArray, J: IntArray, dispatcher, lane: int, stage: int, wall: float, keeps_slope: bool
) -> tuple[float, float]:
    """Film coefficient [kg/(m2 s)] of a lane whose effects depend on the wall temperature, and its slope against it.

    keeps_slope : whether the slope of the ratio is that of the lane's last iterate
    """
    h_ref = B[block.C_STAGES * LANES + (stage * LANES + lane) * block.N_CONDITIONS + block.H_REF]
    h_ref *= B[(block.STEP_FACTOR + stage) * LANES + lane]
    r = B[(block.R_BASE + stage) * LANES + lane]
    first, end = J[block.FIRST_AT_WALL + lane], J[block.N_EFFECTS + lane]
    at_wall, slope = 0.0, B[block.WALL_SLOPE * LANES + lane]
    if not keeps_slope:
        above = ratio_with_effects(B, J, dispatcher, lane, stage, r, wall + WALL_DIFFERENCE_K, first, end)
        below = ratio_with_effects(B, J, dispatcher, lane, stage, r, wall - WALL_DIFFERENCE_K, first, end)
        at_wall, slope = 0.5 * (above + below), (above - below) * (0.5 / WALL_DIFFERENCE_K)
    # The state of a lag has to be left at the wall's own temperature.
    if keeps_slope or J[block.LAG_SLOT + lane] != block.NONE:
        at_wall = ratio_with_effects(B, J, dispatcher, lane, stage, r, wall, first, end)
    if B[block.ACTIVE * LANES + lane] > 0.0:  # a lane that has converged keeps its own, however long others iterate
        B[(block.FILM + stage) * LANES + lane], B[block.WALL_SLOPE * LANES + lane] = h_ref * at_wall, slope
    return h_ref * at_wall, h_ref * slope


@inline_always
def _factor_and_slope(
    B: FloatArray, J: IntArray, dispatcher, lane: int, stage: int, wall: float
) -> tuple[float, float]:
    """Factor of the effects on the emittance of a lane [-], and its slope against the wall temperature [1/K]."""
    above = emittance_factor(B, J, dispatcher, lane, stage, wall + WALL_DIFFERENCE_K)
    below = emittance_factor(B, J, dispatcher, lane, stage, wall - WALL_DIFFERENCE_K)
    return 0.5 * (above + below), (above - below) * (0.5 / WALL_DIFFERENCE_K)


@force_inline
def _air_enthalpy(h_a: float, cp_a: float, h_b: float, cp_b: float, f: float, t: float) -> tuple[float, float]:
    """Enthalpy of air [J/kg] and its specific heat [J/(kg K)] within a bin.

    f : fraction [-] between two pressure columns a and b;  t : temperature above the foot of the bin [K]
    """
    cp = cp_a + f * (cp_b - cp_a)
    return h_a + f * (h_b - h_a) + t * cp, cp


@njit
def _air_row(table: FloatArray, first: int, j: int, column: int) -> int:
    """Offset in the tables of bin j and a pressure column of the enthalpy of air whose table begins at `first`."""
    return first + AIR_HEAD + 2 * (j * int(table[first + 3]) + column)


@inline_always
def _wall_enthalpy(
    B: FloatArray, J: IntArray, table: FloatArray, lane: int, stage: int, T_K: float
) -> tuple[float, float]:
    """Enthalpy of air [J/kg] at a temperature and the pressure of a stage, and its specific heat [J/(kg K)]."""
    j, column = property_bin(T_K), B[(block.AIR_PLACE + stage) * LANES + lane]
    row = _air_row(table, J[block.ENTHALPY_TABLE + lane], j, int(column))
    f = column - int(column)
    return _air_enthalpy(table[row], table[row + 1], table[row + 2], table[row + 3], f, T_K - BIN_K * j)


@njit
def emittance_piece(table: FloatArray, first: int, wall: float) -> tuple[float, float, float, float, float]:
    """The linear piece of an emittance table that contains a temperature, constant beyond the ends of the table.

    table   : the flat tables; at `first` the number of points, then their temperatures [K], then their emittances [-]
    wall    : temperature [K]
    returns : lower and upper end of the piece [K], its foot [K], emittance at the foot [-], slope [1/K]

    The points are used as given, without bins of 5 K: the radiated heat is sensitive to a corner that is cut.
    Source: docs/theory/equations_thermal_step.md, section 2.
    """
    n = int(table[first])
    T_K, eps = first + 1, first + 1 + n
    i = 0
    # A linear search: an emittance has a few points, and the piece found is cached until the wall leaves it.
    while i < n and wall >= table[T_K + i]:
        i += 1
    low, high = -FAR if i == 0 else table[T_K + i - 1], FAR if i == n else table[T_K + i]
    foot = max(i - 1, 0)
    slope = 0.0
    if 0 < i < n:
        slope = (table[eps + i] - table[eps + i - 1]) / (high - low)
    return low, high, table[T_K + foot], table[eps + foot], slope


@njit
def emittance(table: FloatArray, first: int, wall: float) -> float:
    """Emittance [-] of the table at `first` at a wall temperature [K], linear between points and constant beyond them.

    Source: docs/theory/equations_thermal_step.md, section 2.
    """
    _, _, foot, eps, slope = emittance_piece(table, first, wall)
    return eps + slope * (wall - foot)


@inline_always
def invalidate_walls(B: FloatArray) -> None:
    """Invalidate the pieces of emittance [-] and air enthalpy [J/kg] cached for every lane, so that they are looked up
    again."""
    for lane in range(LANES):
        B[block.WALL_HIGH * LANES + lane] = -FAR


@njit
def evaluate_faces(B: FloatArray, J: IntArray, table: FloatArray, dispatcher, stage: int, keeps_slope: bool) -> None:
    """Heat from outside [W/m2] and its slope [W/(m2 K)] at surface, back and gaps, at the present temperatures.

    B           : block of the lane group; SOURCE and SLOPE of the nodes concerned change, and in lanes that iterate
                  FILM of the stage where effects depend on the wall temperature
    stage       : 0, 1 or 2; start, middle and end of a step, whose film coefficients and recovery enthalpies are used
    keeps_slope : whether the slope of such effects is that of the lane's last iterate, at a temperature close by: it
                  changes the way to the solution of a step alone, and is two thirds of what they cost

    Source: docs/theory/equations_thermal_step.md, equations 14 to 18.
    """
    evaluate_surface(B, J, table, dispatcher, stage, keeps_slope)
    evaluate_back(B, J, stage)
    if J[block.GAPS] == 1:
        _evaluate_gaps(B, J, table, stage)


@njit
def evaluate_perturbed_faces(B: FloatArray, J: IntArray, table: FloatArray, dispatcher, stage: int) -> None:
    """Heat from outside [W/m2] as of `evaluate_faces`, of lanes that were heated at their present temperatures.

    Slopes are those without effects: they are in the matrix of the unperturbed lane, and nobody reads them here. The
    film is that at the surface temperature already, so that an effect which depends on it is evaluated once and not
    four times. Source: docs/theory/equations_thermal_step.md, equations 14 to 16 and 34.
    """
    _cache_walls(B, J, table, stage)
    emitting = 0
    for lane in range(LANES):
        emitting += J[block.N_EMITTING + lane]
        eps, film = _emittance(B, lane), B[(block.FILM + stage) * LANES + lane]
        _write_surface_balance(B, lane, stage, eps, B[block.EPS_SLOPE * LANES + lane], film, 0.0)
    for lane in range(LANES if emitting > 0 else 0):
        if J[block.N_EMITTING + lane] > 0:
            wall, film = B[(block.HEAD_ROWS + block.T) * LANES + lane], B[(block.FILM + stage) * LANES + lane]
            eps = _emittance(B, lane) * emittance_factor(B, J, dispatcher, lane, stage, wall)
            _write_surface_balance(B, lane, stage, eps, B[block.EPS_SLOPE * LANES + lane], film, 0.0)
    _add_still_air(B, stage)
    evaluate_back(B, J, stage)
    if J[block.GAPS] == 1:
        _evaluate_gaps(B, J, table, stage)


@inline_always
def _evaluate_gaps(B: FloatArray, J: IntArray, table: FloatArray, stage: int) -> None:
    """Heat from hot gas at the nodes along a gap, each with its own wall enthalpy and the film of the surface."""
    for i in range(J[block.N_NODES]):
        a = (block.HEAD_ROWS + i * block.NODE_ROWS) * LANES
        for lane in range(LANES):
            gap_fraction = B[a + block.GAP * LANES + lane]
            source, slope = 0.0, 0.0
            if gap_fraction != 0.0:
                H_w, cp_w = _wall_enthalpy(B, J, table, lane, stage, B[a + block.T * LANES + lane])
                film = gap_fraction * B[(block.FILM + stage) * LANES + lane]
                source, slope = film * (B[(block.RECOVERY + stage) * LANES + lane] - H_w), -film * cp_w
            # The faces were evaluated in this call and keep their heat; other nodes still hold that of an earlier call.
            face = i == 0 or i == J[block.BACK_NODE + lane]
            B[a + block.SOURCE * LANES + lane] = source + (B[a + block.SOURCE * LANES + lane] if face else 0.0)
            B[a + block.SLOPE * LANES + lane] = slope + (B[a + block.SLOPE * LANES + lane] if face else 0.0)


@inline_always
def _cache_wall(B: FloatArray, J: IntArray, table: FloatArray, lane: int, stage: int) -> None:
    """Cache the pieces of emittance and air enthalpy that contain the surface temperature of a lane, and their ends."""
    column = int(B[(block.AIR_PLACE + stage) * LANES + lane])
    wall = B[(block.HEAD_ROWS + block.T) * LANES + lane]
    low, high, foot, eps, slope = emittance_piece(table, J[block.EMISSIVITY_TABLE + lane], wall)
    j = property_bin(wall)
    row = _air_row(table, J[block.ENTHALPY_TABLE + lane], j, column)
    B[block.WALL_LOW * LANES + lane] = low if j == 0 else max(low, BIN_K * j)
    B[block.WALL_HIGH * LANES + lane] = high if j == BINS - 1 else min(high, BIN_K * (j + 1))
    B[block.WALL_COLUMN * LANES + lane] = float(column)
    B[block.EPS_FOOT * LANES + lane], B[block.EPS_AT_FOOT * LANES + lane] = foot, eps
    B[block.EPS_SLOPE * LANES + lane] = slope
    B[block.AIR_FOOT * LANES + lane] = BIN_K * j
    for k in range(4):
        B[(block.AIR + k) * LANES + lane] = table[row + k]


@force_inline
def _write_surface_balance(
    B: FloatArray, lane: int, stage: int, eps: float, eps_slope: float, film: float, film_slope: float
) -> None:
    """Heat that enters at the surface of a lane and its slope, from an emittance, a film and their slopes.

    docs/theory/equations_thermal_step.md, equations 14 and 17.
    """
    a = block.HEAD_ROWS * LANES + lane
    wall, surface_fraction = B[a + block.T * LANES], B[block.SURFACE_SHARE * LANES + lane]
    factor = B[block.FACTOR_EPS * LANES + lane]
    f = B[(block.AIR_PLACE + stage) * LANES + lane] - B[block.WALL_COLUMN * LANES + lane]
    t = wall - B[block.AIR_FOOT * LANES + lane]
    h_a, cp_a, h_b, cp_b = (
        B[block.AIR * LANES + lane],
        B[(block.AIR + 1) * LANES + lane],
        B[(block.AIR + 2) * LANES + lane],
        B[(block.AIR + 3) * LANES + lane],
    )
    H_w, cp_w = _air_enthalpy(h_a, cp_a, h_b, cp_b, f, t)
    film, film_slope = film * surface_fraction, film_slope * surface_fraction
    driving = B[(block.RECOVERY + stage) * LANES + lane] - H_w
    cube = wall * wall * wall
    excess = cube * wall - B[(block.STAGE_SURROUNDINGS4 + stage) * LANES + lane]
    radiated = factor * eps * SIGMA * excess
    B[a + block.SOURCE * LANES] = film * driving + B[(block.ADDED + stage) * LANES + lane] - radiated
    radiated = factor * SIGMA * (4.0 * eps * cube + eps_slope * excess)
    B[a + block.SLOPE * LANES] = film_slope * driving - film * cp_w - radiated


@force_inline
def _emittance(B: FloatArray, lane: int) -> float:
    """Emittance [-] of a lane's surface from the cached piece, without effects."""
    wall = B[(block.HEAD_ROWS + block.T) * LANES + lane]
    warmer = wall - B[block.EPS_FOOT * LANES + lane]
    return B[block.EPS_AT_FOOT * LANES + lane] + B[block.EPS_SLOPE * LANES + lane] * warmer


@inline_always
def _cache_walls(B: FloatArray, J: IntArray, table: FloatArray, stage: int) -> None:
    """Look up the pieces of emittance and air enthalpy of all lanes again where a lane has left its own."""
    outside = lanes_outside(B, (block.HEAD_ROWS + block.T) * LANES, block.WALL_LOW * LANES, block.WALL_HIGH * LANES)
    for lane in range(LANES):
        f = B[(block.AIR_PLACE + stage) * LANES + lane] - B[block.WALL_COLUMN * LANES + lane]
        outside += 0 if (f >= 0.0) & (f < 1.0) else 1
    # The count is of pairs of lanes and does not identify one: all eight are looked up again.
    if outside > 0:
        for lane in range(LANES):
            _cache_wall(B, J, table, lane, stage)


@inline_always
def evaluate_surface(B: FloatArray, J: IntArray, table: FloatArray, dispatcher, stage: int, keeps_slope: bool) -> None:
    """Heat that enters at the surface [W/m2] and its slope against the surface temperature [W/(m2 K)], of all lanes.

        s_0 = (1 - f) film (H_r - H_w(T)) + q_add - eps(T) sigma (T^4 - T_sur^4)

    stage : 0, 1 or 2, whose conditions are used;  dispatcher, keeps_slope : as in `evaluate_faces`

    A negative film coefficient, from a negative ratio, is not clipped.
    Source: docs/theory/equations_thermal_step.md, equations 14 and 17.
    """
    affected = 0
    for lane in range(LANES):
        affected += J[block.N_EMITTING + lane] + J[block.N_EFFECTS + lane] - J[block.FIRST_AT_WALL + lane]
    _cache_walls(B, J, table, stage)
    for lane in range(LANES):
        eps, film = _emittance(B, lane), B[(block.FILM + stage) * LANES + lane]
        _write_surface_balance(B, lane, stage, eps, B[block.EPS_SLOPE * LANES + lane], film, 0.0)
    # Evaluated without effects above, then again where there are any: the loop without calls stays vectorised.
    if affected > 0:
        for lane in range(LANES):
            _balance_with_effects(B, J, dispatcher, lane, stage, keeps_slope)
    _add_still_air(B, stage)


@inline_always
def _add_still_air(B: FloatArray, stage: int) -> None:
    """Add natural convection of all lanes at rest to the heat at the surface and its slope.

        s_0 -= C |T - T_air|^(1/3) (T - T_air)

    docs/theory/equations.md, section 4a.
    """
    for lane in range(LANES):
        c = block.C_STAGES * LANES + (stage * LANES + lane) * block.N_CONDITIONS
        # In flight, and in a record, there is none.
        if B[c + block.STILL_AIR] > 0.0:
            a = block.HEAD_ROWS * LANES + lane
            above = B[a + block.T * LANES] - B[c + block.AIR_K]
            film = B[c + block.STILL_AIR] * exp(LN_10 / 3.0 * log10(max(abs(above), 1e-30)))
            B[a + block.SOURCE * LANES] -= film * above
            B[a + block.SLOPE * LANES] -= 4.0 / 3.0 * film


@inline_always
def _balance_with_effects(B: FloatArray, J: IntArray, dispatcher, lane: int, stage: int, keeps_slope: bool) -> None:
    """Surface balance of a lane with effects on its emittance, or with effects that depend on the wall temperature."""
    # The first guess of a stage is extrapolated and may be below 0 K, where the rates of an effect are no numbers.
    wall = max(B[(block.HEAD_ROWS + block.T) * LANES + lane], COLDEST_K)
    eps, eps_slope = _emittance(B, lane), B[block.EPS_SLOPE * LANES + lane]
    if J[block.N_EMITTING + lane] > 0:
        factor, factor_slope = _factor_and_slope(B, J, dispatcher, lane, stage, wall)
        eps, eps_slope = eps * factor, eps_slope * factor + eps * factor_slope
    film, film_slope = B[(block.FILM + stage) * LANES + lane], 0.0
    if J[block.N_EFFECTS + lane] > J[block.FIRST_AT_WALL + lane]:
        film, film_slope = _film_and_slope(B, J, dispatcher, lane, stage, wall, keeps_slope)
    _write_surface_balance(B, lane, stage, eps, eps_slope, film, film_slope)


@inline_always
def evaluate_back(B: FloatArray, J: IntArray, stage: int) -> None:
    """Heat that enters at the back face [W/m2] and its slope against the temperature there [W/(m2 K)], of all lanes.

        s_b = -(h_b + h_n |T - T_b|^n) (T - T_b) - eps_b sigma (T^4 - T_b^4)

    stage : 0, 1 or 2, whose temperature behind the wall and natural film h_n are used

    An adiabatic back has h_b = h_n = 0 and eps_b = 0. Source: docs/theory/equations_thermal_step.md, equations 15 and
    18.
    """
    for lane in range(LANES):
        a = (block.HEAD_ROWS + J[block.BACK_NODE + lane] * block.NODE_ROWS) * LANES
        inner, ambient = B[a + block.T * LANES + lane], B[(block.STAGE_BACK_T + stage) * LANES + lane]
        emitted = SIGMA * B[block.BACK_EPS * LANES + lane]
        h_b = B[block.BACK_H * LANES + lane]
        cube, square = inner * inner * inner, ambient * ambient
        B[a + block.SOURCE * LANES + lane] = -h_b * (inner - ambient) - emitted * (cube * inner - square * square)
        B[a + block.SLOPE * LANES + lane] = -h_b - 4.0 * emitted * cube
    if J[block.CONVECTS] == 1:
        _add_natural_convection(B, J, stage)


@inline_always
def _add_natural_convection(B: FloatArray, J: IntArray, stage: int) -> None:
    """Add the natural convection of all lanes to the heat at the back face and its slope."""
    for lane in range(LANES):
        a = (block.HEAD_ROWS + J[block.BACK_NODE + lane] * block.NODE_ROWS) * LANES
        above = B[a + block.T * LANES + lane] - B[(block.STAGE_BACK_T + stage) * LANES + lane]
        n = B[block.NATURAL_EXPONENT * LANES + lane]
        film = B[(block.STAGE_NATURAL + stage) * LANES + lane] * exp(n * LN_10 * log10(abs(above)))
        B[a + block.SOURCE * LANES + lane] -= film * above
        B[a + block.SLOPE * LANES + lane] -= (1.0 + n) * film
