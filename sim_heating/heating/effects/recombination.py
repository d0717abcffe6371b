"""Finite-rate recombination of oxygen and nitrogen atoms at the wall: heating below that of a fully catalytic wall.

    f = 1 - [(1 - phi_O) h_O + (1 - phi_N) h_N] / (H_r - h_w)
    phi = rho_w k_w / (rho_w k_w + h_m),    k_w = gamma sqrt(R_u T_w / (2 pi M)),    gamma = A exp(-T_A / T_w)

h_O and h_N are the heats of dissociation that the flow brings to the wall as atoms, frozen through the boundary layer;
h_w is the enthalpy of frozen air at the wall: the flux film (H_r - h_w) falls by film times the heat that is not given
up, whatever the wall's temperature. h_m = Le^(2/3) film is its coefficient of mass transfer, film the fully catalytic
one of the point. Oxygen dissociates first: h_O is up to 3.59 MJ/kg of the heat of dissociation, that of all its atoms,
and h_N the rest.
Source: Goulard, Jet Propulsion 28 (1958) 737; phi = 0 is frozen flow at a noncatalytic wall, of which Fay and Riddell
(1958) print the limit of a cold wall, 1 - h_D / h_0;
derived in docs/reference/effects.md, equations 25 to 28.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import Conditions
from sim_heating.base.kernels import block
from sim_heating.base.kernels.elementary import exp
from sim_heating.base.kernels.jit import njit
from sim_heating.base.parameters import Parameter
from sim_heating.heating.atmosphere import MOLAR_GAS_CONSTANT
from sim_heating.heating.effects import Effect, SearchStart, flight
from sim_heating.heating.reference.gas import MOLAR_MASS_N2_O2, R_TABLE, frozen_enthalpy

RECOMBINATION = "recombination"
"""Name of the effect."""
O_FACTOR, O_ACTIVATION, N_FACTOR, N_ACTIVATION, HIGHEST, EFFICIENCY = range(6)
OXYGEN, NITROGEN = 0.21, 0.79
"""Mole fractions of O2 and N2 in undissociated air, those of the gas table."""
MOLAR_MASS_O, MOLAR_MASS_N = 15.999, 14.007
"""[kg/kmol]."""
FORMATION_O, FORMATION_N = 246.790e6, 470.818e6
"""Heats of formation of the atoms at 0 K [J/kmol], those of the gas table (heating/data/equilibrium_air.csv)."""
HEAT_OF_OXYGEN = 2.0 * OXYGEN * FORMATION_O / MOLAR_MASS_N2_O2
HEAT_OF_NITROGEN = 2.0 * NITROGEN * FORMATION_N / MOLAR_MASS_N2_O2
"""Heats of dissociation of all oxygen and of all nitrogen of air [J/kg]: 3.59e6 and 25.8e6."""
LEAST_DRIVING = 0.1
"""Least H_r - h_w, as a share of H_r [-]."""
LEWIS_2_3 = 1.4 ** (2.0 / 3.0)
"""Le^(2/3) [-] with the Lewis number 1.4 of atoms in air (Fay and Riddell 1958)."""
SPEED_O = math.sqrt(MOLAR_GAS_CONSTANT / (2.0 * math.pi * MOLAR_MASS_O))
SPEED_N = math.sqrt(MOLAR_GAS_CONSTANT / (2.0 * math.pi * MOLAR_MASS_N))
"""Speed at which atoms strike the wall, a quarter of their mean speed, over sqrt(T_w) [m/(s K^(1/2))]."""


@njit
def film_found(B: FloatArray, c: int) -> float:
    """Film coefficient [kg/(m2 s)] that an effect which multiplies the ratio finds, r h_ref of
    docs/reference/effects.md, equation 26.

    B, c : block of the lane group, and where the conditions of its lane and stage begin
    """
    lane = (c - block.C_STAGES * block.LANES) // block.N_CONDITIONS % block.LANES
    return B[block.RATIO_FOUND * block.LANES + lane] * B[c + flight.h_ref_kg_m2_s]


@njit
def atoms_left(rate: float, h_m: float) -> float:
    """Part of the atoms brought to the wall that do not recombine there, 1 - phi = h_m / (rho_w k_w + h_m) [-].

    rate : of recombination, rho_w k_w, with the density of the gas at the wall and the speed at which atoms strike it,
           times the part of them that recombines [kg/(m2 s)]
    h_m  : coefficient of mass transfer [kg/(m2 s)], above 0
    Source: Goulard (1958); docs/reference/effects.md, equation 26.
    """
    return h_m / (rate + h_m)


@njit
def recombination_factor(B: FloatArray, c: int, p: int, wall_K: float) -> float:
    """Factor of finite-rate recombination on the heating ratio [-], 1 - h_D / (H_r - h_w) (noncatalytic) to 1.

        f = 1 - [(1 - phi_O) h_O + (1 - phi_N) h_N] / (H_r - h_w)

    B       : block of the lane group; B[c] flight conditions with h_D, H_r [J/kg], p_surface [Pa], B[p] the parameters
    wall_K  : wall temperature T_w [K], above 0; gamma stays as it is at `highest_K` above that
    returns : factor [-]; 1 where the flow has no atoms, or no film

    gamma is at most 1. H_r - h_w counts as a tenth of H_r at least: at a wall near H_r there is no flux to divide.
    Source: Goulard (1958), Scott (1980); docs/reference/effects.md, equations 25 to 28.
    """
    h_D, film = B[c + flight.dissociation_J_kg], film_found(B, c)
    if h_D <= 0.0 or film <= 0.0:
        return 1.0
    h_O = min(h_D, HEAT_OF_OXYGEN)
    h_N = h_D - h_O
    moles = 1.0 + (OXYGEN / HEAT_OF_OXYGEN) * h_O + (NITROGEN / HEAT_OF_NITROGEN) * h_N
    H_r, root = B[c + flight.H_r_J_kg], math.sqrt(wall_K)
    per_driving = 1.0 / max(H_r - frozen_enthalpy(wall_K), LEAST_DRIVING * H_r)
    # rho_w T_w^(1/2), so that no division waits for another one
    flux = B[c + flight.p_surface_Pa] / (moles * R_TABLE * root)
    h_m, inverse = LEWIS_2_3 * film, -1.0 / min(wall_K, B[p + HIGHEST])
    gamma_O = min(B[p + EFFICIENCY] * B[p + O_FACTOR] * exp(B[p + O_ACTIVATION] * inverse), 1.0)
    gamma_N = min(B[p + EFFICIENCY] * B[p + N_FACTOR] * exp(B[p + N_ACTIVATION] * inverse), 1.0)
    carried = h_O * atoms_left(gamma_O * SPEED_O * flux, h_m) + h_N * atoms_left(gamma_N * SPEED_N * flux, h_m)
    return 1.0 - carried * per_driving


def search_starts(flown: Conditions) -> Sequence[SearchStart]:
    """None [-]: it is declared data; what a record shows beyond it is searched for as `catalysis`."""
    return []


EFFECT = Effect(
    name=RECOMBINATION,
    mode="multiply",
    parameters=(
        Parameter("gamma_O_factor", "1", 16.0, 0.0, 0.0, 1e9, "oxygen: A of gamma = A exp(-T_A / T_w)"),
        Parameter("gamma_O_activation_K", "K", 10271.0, 0.0, 0.0, 1e5, "oxygen: T_A"),
        Parameter("gamma_N_factor", "1", 0.0734, 0.0, 0.0, 1e9, "nitrogen: A"),
        Parameter("gamma_N_activation_K", "K", 2219.0, 0.0, 0.0, 1e5, "nitrogen: T_A"),
        Parameter("highest_K", "K", 1650.0, 0.0, 200.0, 5000.0, "temperature above which gamma stays as it is there"),
        Parameter("efficiency", "1", 1.0, 0.5, 0.0, 1e3, "gamma over that of its law; 0: a noncatalytic wall"),
    ),
    kernel=recombination_factor,
    needs_wall=True,
    reads_ratio=True,
    search_starts=search_starts,
    physics="Atoms that do not recombine at the wall carry their heat of dissociation away with the flow.",
    source="Goulard, Jet Propulsion 28 (1958) 737; coefficients of the tiles' coating: Scott, AIAA 80-1477 (1980)",
)
