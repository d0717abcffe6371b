"""Moisture: latent heat taken up at a phase change in depth, and given off where vapour condenses.

With u = 1 / (1 + exp(-(T - boil) / width)) the part that has dried, the insulation takes up latent u per mass. Vapour
over moist fibres has a density that grows with temperature as u does, exponentially up to boiling; it diffuses to where
fibres are cooler and condenses there. Its heat is conducted with

    k_vapour = vapour du/dT,    vapour = D L rho_v    [W/m]

(diffusivity, latent heat, density of vapour where it dries: about 20 W/m over wet fibres at 370 K, less over merely
humid ones).
docs/reference/effects.md, equations 15 and 16; in the thermal model docs/theory/equations_thermal_step.md, equations 12
and 13.
"""

from __future__ import annotations

from collections.abc import Sequence

from sim_heating.base.conditions import Conditions
from sim_heating.heating.effects import Effect, SearchStart, model_parameter


def search_starts(flown: Conditions) -> Sequence[SearchStart]:
    """Search starts for moisture (docs/reference/effects.md, equations 15 and 16), with no latent heat yet.

    flown   : conditions of the flight, not used
    returns : boiling, boiling with condensation 40 K below, or diffusing vapour, each about 340, 373 and 420 [K]: with
              a width of 8 K, the sensitivity at a start reaches only nearby temperatures
    """
    evaporating = ("latent_J_kg", "boil_K", "width_K")
    condensing = ("latent_J_kg", "boil_K", "deposit_J_kg", "condense_K", "width_K")
    diffusing = ("vapour_W_m", "boil_K", "width_K")
    at = (340.0, 373.0, 420.0)
    return [
        *(SearchStart(names, {"boil_K": T}) for names in (evaporating, diffusing) for T in at),
        *(SearchStart(condensing, {"boil_K": T, "condense_K": T - 40.0}) for T in at),
    ]


EFFECT = Effect(
    name="moisture",
    mode="model",
    parameters=(
        model_parameter(
            "latent_J_kg",
            "stack.moisture.latent_J_kg",
            "heat taken up as it boils, per mass of insulation",
            value=5000.0,
        ),
        model_parameter("boil_K", "stack.moisture.boil_K"),
        model_parameter("deposit_J_kg", "stack.moisture.deposit_J_kg"),
        model_parameter("condense_K", "stack.moisture.condense_K"),
        model_parameter("width_K", "stack.moisture.width_K"),
        model_parameter(
            "vapour_W_m", "stack.moisture.vapour_W_m", "integral of its vapour's conductivity, up to boiling"
        ),
    ),
    neutral={"latent_J_kg": 0.0, "deposit_J_kg": 0.0, "vapour_W_m": 0.0},
    search_starts=search_starts,
    # Water boils at 250 K at 80 Pa and at 373 K at sea level, bound to fibres somewhat above; over a wider range than
    # 60 K it is another change of the heat capacity.
    search_bounds={
        "boil_K": (250.0, 500.0),
        "condense_K": (250.0, 500.0),
        "width_K": (1.0, 60.0),
        "latent_J_kg": (0.0, 1e6),
        "deposit_J_kg": (0.0, 1e6),
    },
    of_flight=("latent_J_kg", "deposit_J_kg", "vapour_W_m"),  # the water that a flight begins with
    physics="Adsorbed water boils as heat reaches it; vapour condenses in cooler depths before it leaves.",
    source="Apparent heat capacity: Voller & Swaminathan, Numer. Heat Transfer B 19 (1991) 175; vapour diffusing down "
    "its density: Philip & de Vries, Trans. Am. Geophys. Union 38 (1957) 222",
)
