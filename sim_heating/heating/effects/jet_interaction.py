"""Reaction-jet firings: the heating, or the density derived from a disturbed air-data reading, follows the jets."""

from __future__ import annotations

from collections.abc import Sequence

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import Conditions
from sim_heating.base.kernels.jit import njit
from sim_heating.base.parameters import Parameter
from sim_heating.heating.effects import Effect, SearchStart, flight

GAIN = 0


@njit
def jet_factor(B: FloatArray, c: int, p: int, wall_K: float) -> float:
    """Factor of firing reaction jets on the heating ratio [-].

        f = 1 + jet_gain jets,    jets from 0 (off) to 1 (firing)

    B       : block of the lane group; B[c] flight conditions with jets [-], B[p] jet_gain [-]
    wall_K  : wall temperature [K], not used

    Source: the observation, pitch-jet spikes of STS-2 in the founding paper; the form, docs/reference/effects.md,
    equation 14.
    """
    return 1.0 + B[p + GAIN] * B[c + flight.jets]


def search_starts(flown: Conditions) -> Sequence[SearchStart]:
    """Search start for jet interaction (docs/reference/effects.md, equation 14): no dependence [-] on the jets yet."""
    return [SearchStart(("jet_gain",))]


EFFECT = Effect(
    name="jet-interaction",
    mode="multiply",
    parameters=(Parameter("jet_gain", "1", 0.1, 0.2, -1.0, 5.0, "relative rise of the ratio while a jet fires"),),
    kernel=jet_factor,
    needs=("jets",),
    neutral={"jet_gain": 0.0},
    search_starts=search_starts,
    physics="A firing jet disturbs the flow at the point, or the density that was derived from dynamic pressure.",
    source="Pitch-jet spikes of STS-2 in 'Trends in Shuttle Entry Heating from the Correlation of Flight Test ...'",
)
