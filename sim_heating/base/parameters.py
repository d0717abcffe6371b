"""Parameters that can be estimated, changed or exported: dotted name, unit, prior, bounds and a line of description."""

from __future__ import annotations

import math
from dataclasses import dataclass
from numbers import Real

from sim_heating.base.conditions import RATIO_VARIABLES
from sim_heating.base.errors import InputError

EFFECT_PREFIX = "effect."
"""Parameters of effects are named `effect.NAME.PARAMETER`."""
SHORT_NAMES = ("alpha", "beta", "logre", "elevon", "bodyflap")
"""The ratio variables as spelt in parameter names."""
UNITS = ("deg", "deg", "1", "deg", "deg")


@dataclass(frozen=True)
class Parameter:
    """One parameter.

    name  : dotted name for a model (`ratio.d_alpha`), plain within an effect (`log10_re_onset`)
    unit  : contract unit, "1" where it has none
    value : nominal value, and mean of the prior
    sigma : standard deviation of the prior; infinite for a flat one
    lower, upper : bounds
    text  : description in one line
    raises : InputError where one is of another kind
    """

    name: str
    unit: str
    value: float
    sigma: float = math.inf
    lower: float = -math.inf
    upper: float = math.inf
    text: str = ""

    def __post_init__(self) -> None:
        texts = all(isinstance(t, str) for t in (self.name, self.unit, self.text))
        if not (texts and all(map(is_number, (self.value, self.sigma, self.lower, self.upper)))):
            raise InputError(f"{self!r}: name, unit and text are texts, the others numbers")


def is_number(value: object) -> bool:
    """Whether a value is a real number, which a bool is not."""
    return isinstance(value, Real) and not isinstance(value, bool)


def derivative_unit(*units: str) -> str:
    """Unit of a derivative against variables of these units: 1/deg, 1/deg2, 1."""
    angles = sum(u == "deg" for u in units)
    return {0: "1", 1: "1/deg", 2: "1/deg2"}[angles]


def _second_order_name(i: int, j: int) -> str:
    return f"ratio.d_{SHORT_NAMES[i]}2" if i == j else f"ratio.d_{SHORT_NAMES[i]}_{SHORT_NAMES[j]}"


SECOND_ORDER = tuple((i, j) for i in range(len(SHORT_NAMES)) for j in range(i, len(SHORT_NAMES)))
"""Pairs of variables of the second-order terms, in the order of the kernel."""

RATIO = (
    Parameter("ratio.scale", "1", 0.0, text="relative error of the tabulated ratio"),
    Parameter("ratio.d0", "1", 0.0, text="ratio at the reference condition where there is no table"),
    *(
        Parameter(f"ratio.d_{s}", derivative_unit(u), 0.0, text=f"derivative of the ratio against {v}")
        for s, u, v in zip(SHORT_NAMES, UNITS, RATIO_VARIABLES, strict=True)
    ),
    *(
        Parameter(
            _second_order_name(i, j), derivative_unit(UNITS[i], UNITS[j]), 0.0, text="second-order term, no factor 1/2"
        )
        for i, j in SECOND_ORDER
    ),
)
"""Parameters of the linear heating model, in the order of the kernel's parameter vector."""

STACK_PREFIX = "stack."
STACK = (
    Parameter("stack.coating.thickness_factor", "1", 1.0, 0.3, 1e-3, 10.0, "first layer, over the declared thickness"),
    Parameter("stack.coating.conductivity_factor", "1", 1.0, 0.3, 1e-3, 10.0, "first layer, over the declared table"),
    Parameter("stack.coating.heat_capacity_factor", "1", 1.0, 0.3, 1e-3, 10.0, "first layer, over the declared table"),
    Parameter("stack.rsi.conductivity_factor", "1", 1.0, 0.18, 1e-3, 10.0, "second layer, over the declared table"),
    Parameter("stack.rsi.heat_capacity_factor", "1", 1.0, 0.1, 1e-3, 10.0, "second layer, over the declared table"),
    Parameter(
        "stack.rsi.conductivity_slope", "1/K", 0.0, 2e-4, -9e-4, 1.2e-3, "of the second layer's factor, at 700 K"
    ),
    Parameter("stack.rsi.conductivity_decade", "1", 0.0, 0.1, -0.4, 0.3, "of the same factor a decade of p, at 1 kPa"),
    Parameter("stack.rsi.heat_capacity_slope", "1/K", 0.0, 2e-4, -9e-4, 1.2e-3, "of the factor on it, at 700 K"),
    Parameter("stack.emissivity_factor", "1", 1.0, 0.035, 0.0, 1.5, "surface emittance over the declared table"),
    Parameter("stack.rsi.radiative_conductivity", "W/(m K)", 0.0, 0.05, -1.0, 10.0, "at 1000 K, grows with T^3"),
    Parameter("stack.rsi.radiation_from_K", "K", 0.0, 200.0, 0.0, 3000.0, "up to there declared conductivity has it"),
    Parameter("stack.moisture.latent_J_kg", "J/kg", 0.0, 2e4, 0.0, 3e6, "heat taken up as moisture boils"),
    Parameter("stack.moisture.boil_K", "K", 373.0, 20.0, 200.0, 1000.0, "temperature at which it boils"),
    Parameter("stack.moisture.deposit_J_kg", "J/kg", 0.0, 2e4, 0.0, 3e6, "heat given off where vapour condenses"),
    Parameter("stack.moisture.condense_K", "K", 330.0, 20.0, 200.0, 1000.0, "temperature at which it condenses"),
    Parameter("stack.moisture.width_K", "K", 8.0, 4.0, 0.5, 200.0, "width of either in temperature"),
    Parameter("stack.moisture.vapour_W_m", "W/m", 0.0, 2.0, 0.0, 200.0, "conductivity of its vapour, up to boiling"),
    Parameter("stack.gap.fraction", "1", 0.0, 0.1, 0.0, 0.95, "part of the film spent along a gap"),
    Parameter("stack.gap.depth_m", "m", 0.005, 0.005, 1e-4, 0.5, "depth over which it falls by e"),
    Parameter("stack.contact_factor", "1", 1.0, 0.5, 1e-3, 100.0, "contact resistances, over the declared ones"),
    Parameter("back.h_W_m2K", "W/(m2 K)", 0.0, 10.0, 0.0, 1e4, "film coefficient behind the wall"),
    Parameter("back.T_K", "K", 300.0, 30.0, 1.0, 2000.0, "temperature behind the wall"),
    Parameter("back.emissivity", "1", 0.0, 0.3, 0.0, 1.0, "effective emittance behind the wall"),
)
"""Parameters of the thermal model; `back.*` start from what the stack declares."""

LAYER = (
    Parameter("thickness_factor", "1", 1.0, 0.1, 1e-3, 10.0, "thickness over the declared one"),
    Parameter("conductivity_factor", "1", 1.0, 0.2, 1e-3, 10.0, "conductivity over the declared table"),
    Parameter("heat_capacity_factor", "1", 1.0, 0.2, 1e-3, 10.0, "density times specific heat, over the declared ones"),
)
"""Parameters of a layer by its own name, `stack.NAME.PARAMETER`; layers of one name have them in common."""
LAYER_SLOTS = 8
"""Names of layers that a control point has parameters for, outermost first."""

NONLINEAR = (
    "stack.coating.thickness_factor",
    "stack.contact_factor",
    "back.T_K",
    "stack.moisture.boil_K",
    "stack.moisture.condense_K",
    "stack.moisture.width_K",
    "stack.gap.depth_m",
    "stack.rsi.radiation_from_K",
)
"""Parameters in which the heat balance at given temperatures is not affine; those of effects, and the thickness of any
layer, count as such."""

BOUNDARY = (
    *(p.name for p in RATIO),
    "stack.emissivity_factor",
    "back.h_W_m2K",
    "back.T_K",
    "back.emissivity",
)
"""Parameters that change the fluxes into a wall and nothing within it, as those of effects with a kernel do."""

CLOCK_SKEW = Parameter("clock.skew", "s", 0.0, 0.5, -10.0, 10.0, "recorded T(t) = true T(t - skew): above 0, it lags")
"""Skew of the thermocouple clock of a record."""

COMMON_LAG = Parameter("sensors.tau_s", "s", 0.0, 0.5, 0.0, 100.0, "added to the lag of each thermocouple, first order")
"""Time constant that all thermocouples of a record have in addition to their declared ones."""
PRESSURE_FACTOR = Parameter(
    "conditions.p_surface_factor", "1", 1.0, 0.3, 0.1, 10.0, "surface pressure over the one that is computed"
)
"""Factor on the surface pressure of a record, which the conductivity of porous insulation depends on; its prior of
30 % is that without a pressure measurement at the control point."""
RECORD_PARAMETERS = {p.name: p for p in (CLOCK_SKEW, COMMON_LAG, PRESSURE_FACTOR)}
"""Parameters of a record's readings and conditions as a whole, by name."""

SENSOR_PREFIX = "sensor."
SENSOR = {
    "bias": Parameter("bias", "K", 0.0, 5.0, -500.0, 500.0, "what a thermocouple reads too much"),
    "gain": Parameter("gain", "1", 1.0, 0.01, 0.2, 5.0, "indicated over true temperature"),
    "tau_s": Parameter("tau_s", "s", 0.0, 0.5, 0.0, 100.0, "time constant of its first-order lag"),
    "drift": Parameter("drift", "K/s", 0.0, 3e-3, -2.0, 2.0, "rate of a bias that begins with its first reading"),
}
"""Parameters of a thermocouple: `sensor.NAME.bias`, `sensor.NAME.gain`, `sensor.NAME.tau_s` and `sensor.NAME.drift`."""

MODEL = {p.name: p for p in (*RATIO, *STACK)}
"""All parameters of a control point's model by name, except those of effects, and of layers by their own names."""


def layer_parameter(name: str) -> tuple[str, Parameter] | None:
    """Name of the layer and the parameter in `stack.NAME.PARAMETER`; None where it is no name of that form."""
    stem, _, suffix = name.rpartition(".")
    parameter = next((p for p in LAYER if p.name == suffix), None)
    layer = stem.removeprefix(STACK_PREFIX)
    return None if parameter is None or layer == stem or not layer else (layer, parameter)


AT = "@"
"""Separates a parameter from its record or control point, in a fit of several."""
