"""Catalysis: a hotter wall is more catalytic, and a flow of higher enthalpy has more atoms to recombine."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import Conditions
from sim_heating.base.kernels.elementary import logistic
from sim_heating.base.kernels.jit import njit
from sim_heating.base.parameters import Parameter
from sim_heating.heating.effects import Effect, SearchStart, flight

STEP, MIDDLE_K, WIDTH_K, FLOW_STEP, MIDDLE_J_KG, WIDTH_J_KG, FALL, FALL_K = range(8)


@njit
def catalysis_factor(B: FloatArray, c: int, p: int, wall_K: float) -> float:
    """Factor of catalysis on the heating ratio [-].

        f = 1 + step S((T_w - T_c) / width_T) (1 - fall S((T_w - T_f) / width_T)) + flow_step S((H_r - H_c) / width_H)

    B       : block of the lane group; B[c] flight conditions with H_r [J/kg], B[p] the parameters of EFFECT
    wall_K  : wall temperature T_w [K]
    returns : factor [-]; below 1 where a step is negative

    S(x) = 1 / (1 + exp(-x)). An empirical rise, without chemistry; T_c [K] and H_c [J/kg] are where half of it is
    reached. Above T_f [K] the part `fall` of the rise is lost again: recombination on silica decreases where it is
    very hot. Source: the rise, Scott in NASA CP-2283; the fall, Deutschmann, Riedel and Warnatz, J. Heat
    Transfer 117 (1995) 495; the form, docs/reference/effects.md, equation 5.
    """
    hot = B[p + STEP] * logistic((wall_K - B[p + MIDDLE_K]) / B[p + WIDTH_K])
    if B[p + FALL] != 0.0:
        hot *= 1.0 - B[p + FALL] * logistic((wall_K - B[p + FALL_K]) / B[p + WIDTH_K])
    return 1.0 + hot + B[p + FLOW_STEP] * logistic((B[c + flight.H_r_J_kg] - B[p + MIDDLE_J_KG]) / B[p + WIDTH_J_KG])


def search_starts(flown: Conditions) -> Sequence[SearchStart]:
    """Search starts for catalysis (docs/reference/effects.md, equation 5), with no rise yet.

    flown   : conditions of the flight, whose highest recovery enthalpy [J/kg] sets the scale of the second kind
    returns : rises at wall temperatures of 500 to 1300 [K], or at 0.3 to 0.9 of that enthalpy, sharp and gradual; rises
              most of which is lost again 250 [K] above
    """
    hot = ("catalysis_step", "catalysis_K", "catalysis_width_K")
    hot_and_lost = (*hot, "fall_fraction", "fall_K")
    flow = ("flow_step", "flow_J_kg", "flow_width_J_kg")
    greatest = float(np.max(flown["H_r_J_kg"]))
    return [
        *(
            SearchStart(hot, {"catalysis_K": T, "catalysis_width_K": width})
            for T in (500.0, 700.0, 900.0, 1100.0, 1300.0)
            for width in (60.0, 200.0)
        ),
        *(
            SearchStart(
                hot_and_lost, {"catalysis_K": T, "catalysis_width_K": 60.0, "fall_fraction": 0.8, "fall_K": T + 250.0}
            )
            for T in (500.0, 700.0, 900.0, 1100.0, 1300.0)
        ),
        *(
            SearchStart(flow, {"flow_J_kg": fraction * greatest, "flow_width_J_kg": width})
            for fraction in (0.3, 0.5, 0.7, 0.9)
            for width in (1e6, 3e6)
        ),
    ]


EFFECT = Effect(
    name="catalysis",
    mode="multiply",
    parameters=(
        Parameter("catalysis_step", "1", 0.2, 0.2, -0.9, 3.0, "relative rise of the ratio from cold to hot wall"),
        Parameter("catalysis_K", "K", 1100.0, 150.0, 300.0, 2500.0, "wall temperature of half the rise"),
        Parameter("catalysis_width_K", "K", 60.0, 40.0, 1.0, 1000.0, "width of the rise"),
        Parameter("flow_step", "1", 0.0, 0.2, -0.9, 3.0, "relative rise from low to high enthalpy of the flow"),
        Parameter("flow_J_kg", "J/kg", 1.5e7, 5e6, 1e5, 1e8, "recovery enthalpy of half that rise"),
        Parameter("flow_width_J_kg", "J/kg", 2e6, 1e6, 1e4, 1e8, "width of that rise"),
        Parameter(
            "fall_fraction", "1", 0.0, 0.5, 0.0, 1.0, "part of the first rise that is lost again on a hotter wall"
        ),
        Parameter("fall_K", "K", 1500.0, 150.0, 300.0, 2500.0, "wall temperature at which half of that is lost"),
    ),
    kernel=catalysis_factor,
    needs_wall=True,
    neutral={"catalysis_step": 0.0, "flow_step": 0.0},
    search_starts=search_starts,
    # Recombination is worth the heat of dissociation, up to 0.6 of the recovery enthalpy in an entry from orbit: from
    # none to all of it the heating rises by 1.5, from all to none it falls by 0.6.
    search_bounds={
        "catalysis_step": (-0.6, 1.5),
        "catalysis_width_K": (5.0, 400.0),
        "flow_step": (-0.6, 1.5),
        "flow_width_J_kg": (2e5, 1e7),
    },
    physics="Recombination of atoms at the wall grows with its temperature and gives up the energy of dissociation; on "
    "a still hotter wall it may decrease again.",
    source="Scott, 'Effects of nonequilibrium and wall catalysis on Shuttle heat transfer', in NASA CP-2283; its "
    "decrease: Deutschmann, Riedel & Warnatz, J. Heat Transfer 117 (1995) 495",
)
