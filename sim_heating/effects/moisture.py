"""Moisture: latent heat taken up at a phase change in depth, and given off where vapour condenses."""

from __future__ import annotations

from sim_heating.effects import Effect
from sim_heating.parameters import Parameter

EFFECT = Effect(
    name="moisture",
    mode="model",
    parameters=(
        Parameter("latent_J_kg", "J/kg", 5000.0, 2e4, 0.0, 3e6, "heat taken up as it boils, per mass of insulation"),
        Parameter("boil_K", "K", 373.0, 20.0, 200.0, 1000.0, "temperature at which it boils"),
        Parameter("deposit_J_kg", "J/kg", 0.0, 2e4, 0.0, 3e6, "heat given off where vapour condenses"),
        Parameter("condense_K", "K", 330.0, 20.0, 200.0, 1000.0, "temperature at which it condenses"),
        Parameter("width_K", "K", 8.0, 4.0, 0.5, 200.0, "width of either in temperature"),
    ),
    places=(
        "stack.moisture.latent_J_kg",
        "stack.moisture.boil_K",
        "stack.moisture.deposit_J_kg",
        "stack.moisture.condense_K",
        "stack.moisture.width_K",
    ),
    physics="Adsorbed water boils as heat reaches it; vapour condenses in cooler depths before it leaves.",
    source="Apparent-heat-capacity method, Voller & Swaminathan, Numer. Heat Transfer B 19 (1991) 175",
)
