"""Gap flow: hot gas enters gaps and gives its heat off in depth."""

from __future__ import annotations

from collections.abc import Sequence

from sim_heating.conditions import Conditions
from sim_heating.effects import Effect
from sim_heating.parameters import Parameter


def starts(flown: Conditions) -> Sequence[dict[str, float]]:
    """A little of it, over several depths."""
    return [{"gap_fraction": 0.02, "gap_depth_m": d} for d in (0.003, 0.01, 0.03)]


EFFECT = Effect(
    name="gap-flow",
    mode="model",
    parameters=(
        Parameter("gap_fraction", "1", 0.05, 0.1, 0.0, 0.95, "part of the film spent along a gap"),
        Parameter("gap_depth_m", "m", 0.005, 0.005, 1e-4, 0.5, "depth over which it falls by e"),
    ),
    places=("stack.gap.fraction", "stack.gap.depth_m"),
    starts=starts,
    physics="Gas driven through gaps by pressure gradients heats their sides, each depth by its own temperature.",
    source="Gap heating of the Shuttle tiles, NASA CP-2283 (1983)",
)
