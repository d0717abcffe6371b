"""Effects that a declared model may lack: one file each, found by being in this folder.

A file of this folder, or of a folder named in SIM_HEATING_EFFECTS (a path list), defines EFFECT = Effect(...); so does
a module that an installed package names as an entry point of the group `sim_heating.effects`. There are two kinds. An
effect on the heating or on the emittance has a kernel

    f(B, c, p, wall_K) -> float

that reads the flight conditions from B[c] on (offsets in heating/flight_variables.py) and its own parameters from B[p]
on, takes the wall temperature [K], and returns what is added to the heating ratio [-], or the factor [-] on the ratio
or the emittance. An effect of mode "model" has no kernel: its parameters stand for existing parameters of the model.

Effects act in the order of docs/reference/effects.md, equation 1: those that add, the lag, those that multiply.
"""

from sim_heating.heating import flight_variables as flight
from sim_heating.heating.effects.definition import (
    Effect,
    EffectUse,
    ModelParameter,
    SearchStart,
    Window,
    check_count,
    combined_uses,
    model_parameter,
)
from sim_heating.heating.effects.registry import add_user_effects, effect, effects, use, user_effect_files

__all__ = [
    "Effect",
    "EffectUse",
    "ModelParameter",
    "SearchStart",
    "Window",
    "add_user_effects",
    "check_count",
    "combined_uses",
    "effect",
    "effects",
    "flight",
    "model_parameter",
    "use",
    "user_effect_files",
]
