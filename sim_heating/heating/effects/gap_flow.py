"""Gap flow: hot gas enters gaps between tiles and heats their sides in depth, docs/effects.md, equation 10."""

from __future__ import annotations

from collections.abc import Sequence

from sim_heating.base.conditions import Conditions
from sim_heating.base.parameters import Parameter
from sim_heating.heating.effects import Effect, Try


def tries(flown: Conditions) -> Sequence[Try]:
    """Search starts for gap flow (docs/effects.md, equation 10), with no film spent in gaps yet.

    flown   : conditions of the flight, not used
    returns : depths of 0.002, 0.006 and 0.02 [m] over which the heating falls by e
    """
    return [Try(("gap_fraction", "gap_depth_m"), {"gap_depth_m": d}) for d in (0.002, 0.006, 0.02)]


EFFECT = Effect(
    name="gap-flow",
    mode="model",
    parameters=(
        Parameter("gap_fraction", "1", 0.05, 0.1, 0.0, 0.95, "part of the film spent along a gap"),
        Parameter("gap_depth_m", "m", 0.005, 0.005, 1e-4, 0.5, "depth over which it falls by e"),
    ),
    places=("stack.gap.fraction", "stack.gap.depth_m"),
    neutral={"gap_fraction": 0.0},
    tries=tries,
    physics="Gas driven through gaps by pressure gradients heats their sides, each depth by its own temperature.",
    source="Gap heating of the Shuttle tiles, NASA CP-2283 (1983)",
)
