"""Bounds with other instruments on a given flight, and without some of the thermocouples."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from sim_heating.base.arrays import FloatArray
from sim_heating.base.parameters import CLOCK_SKEW, PRESSURE_FACTOR
from sim_heating.estimation.design.information import Experiment
from sim_heating.estimation.design.planned_flight import Instruments, PlannedFlight, Planner
from sim_heating.thermal.sampling import RateInManoeuvres
from sim_heating.thermal.stack import Sensor, Stack

BITS = (8, 10, 12)
RATES_HZ = (1.0, 5.0, RateInManoeuvres(manoeuvres_hz=10.0, elsewhere_hz=1.0), 10.0)
CLOCKS_S = (1.0, 0.5, 0.1, 0.01)
"""Standard deviations of the clock's skew."""
PRESSURE_KNOWN = 0.02
"""Relative standard deviation of a measured surface pressure."""
DEEPER_M = 0.004
"""Depth of an extra thermocouple below the coating."""
BONDLINE_RANGE_K = [255.0, 477.0]
NEAR_M = 0.0005
"""Distance between thermocouples below which one adds no information to the other."""


@dataclass(frozen=True, eq=False)
class InstrumentVariant:
    """Bounds with other instruments: kind of the change, the change itself, (wanted,) bounds."""

    kind: str
    change: str
    sigma: FloatArray


def instrumentation(
    planner: Planner, flown: PlannedFlight, names: tuple[str, ...], priors: dict[str, float]
) -> list[InstrumentVariant]:
    """Bounds on the wanted parameters with the declared instruments, which come first, and with others.

    The others are those that the scenario states; where it states none, words, clocks, rates and places of this module.
    """
    declared = planner.experiment(flown, names, priors)
    others = (
        _stated(planner, flown, names, priors)
        if planner.compared
        else (*_variants_without_march(declared), *_variants_with_march(planner, flown, names, priors))
    )
    every = [("declared", "as declared", declared), *others]
    return [InstrumentVariant(kind, change, e.sigma(planner.targets)) for kind, change, e in every]


def _stated(
    planner: Planner, flown: PlannedFlight, names: tuple[str, ...], priors: dict[str, float]
) -> Iterator[tuple[str, str, Experiment]]:
    """The sets of instruments that the scenario states."""
    for of_set, instruments in planner.compared:
        yield "stated", of_set.name, planner.experiment(flown, names, priors | of_set.prior, instruments)


def _variants_without_march(declared: Experiment) -> Iterator[tuple[str, str, Experiment]]:
    """Changes that need no other march: words, clock, pressure, fewer thermocouples."""
    for bits in BITS:
        yield "word", f"{bits} bits", declared.with_bits(bits)
    if CLOCK_SKEW.name in declared.names:
        for sigma in CLOCKS_S:
            yield "clock", f"within {sigma:g} s", declared.with_priors({CLOCK_SKEW.name: sigma})
    if PRESSURE_FACTOR.name in declared.names:
        yield (
            "pressure",
            f"measured to {PRESSURE_KNOWN:.0%}",
            declared.with_priors({PRESSURE_FACTOR.name: PRESSURE_KNOWN}),
        )
    sensors = [c.sensor.name for c in declared.channels]
    for name in sensors if len(sensors) > 1 else []:
        yield "without", name, declared.without([name])
    outermost = min(declared.channels, key=lambda c: c.sensor.depth_m).sensor.name
    if len(sensors) > 2:
        yield "without", f"all but {outermost}", declared.without([n for n in sensors if n != outermost])


def _variants_with_march(
    planner: Planner, flown: PlannedFlight, names: tuple[str, ...], priors: dict[str, float]
) -> Iterator[tuple[str, str, Experiment]]:
    """Changes that need another march: sample rates, and thermocouples at other depths."""
    sensors = planner.instruments.sensors
    for rate in RATES_HZ:
        change = str(rate) if isinstance(rate, RateInManoeuvres) else f"{rate:g} Hz"
        yield "rate", change, planner.experiment(flown, names, priors, Instruments(sensors, rate))
    for position, extra in extra_sensors(planner.point.construction.stack, sensors):
        instruments = Instruments((*sensors, extra), planner.instruments.rate_hz)
        yield "extra sensor", position, planner.experiment(flown, names, priors, instruments)


def extra_sensors(stack: Stack, sensors: Sequence[Sensor]) -> Iterator[tuple[str, Sensor]]:
    """Thermocouples in the insulation and at the bondline where a stack has none, recorded like the outermost one.

    stack   : with a coating as its first layer;  sensors : those that it has
    returns : place in words, sensor
    """
    like = min(sensors, key=lambda s: s.depth_m)
    deeper = stack.layer[0].thickness_m + DEEPER_M
    depths = {f"{1e3 * DEEPER_M:g} mm below the coating": (deeper, like.range_K)}
    depths["bondline"] = (stack.bondline_m, BONDLINE_RANGE_K if like.range_K else None)
    for position, (depth, span) in depths.items():
        if depth < stack.bondline_m + NEAR_M and all(abs(depth - s.depth_m) > NEAR_M for s in sensors):
            update = {"name": position, "column": f"extra_{1e6 * depth:.0f}_K", "depth_m": depth, "range_K": span}
            yield position, like.model_copy(update=update)
