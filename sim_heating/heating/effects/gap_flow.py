"""Gap flow: hot gas enters gaps between tiles and heats their sides in depth.

docs/reference/effects.md, equation 10.
"""

from __future__ import annotations

from collections.abc import Sequence

from sim_heating.base.conditions import Conditions
from sim_heating.heating.effects import Effect, SearchStart, model_parameter


def search_starts(flown: Conditions) -> Sequence[SearchStart]:
    """Search starts for gap flow (docs/reference/effects.md, equation 10), with no film spent in gaps yet.

    flown   : conditions of the flight, not used
    returns : depths of 0.002, 0.006 and 0.02 [m] over which the heating falls by e
    """
    return [SearchStart(("gap_fraction", "gap_depth_m"), {"gap_depth_m": d}) for d in (0.002, 0.006, 0.02)]


EFFECT = Effect(
    name="gap-flow",
    mode="model",
    parameters=(
        model_parameter("gap_fraction", "stack.gap.fraction", value=0.05),
        model_parameter("gap_depth_m", "stack.gap.depth_m"),
    ),
    neutral={"gap_fraction": 0.0},
    search_starts=search_starts,
    search_bounds={"gap_fraction": (0.0, 0.5)},
    physics="Gas driven through gaps by pressure gradients heats their sides, each depth by its own temperature.",
    source="Gap heating of the Shuttle tiles, NASA CP-2283 (1983)",
)
