"""Coverage of 95 % bands on flights that no fit has seen, and their width over that of a prediction by the true model.

    python -m benchmarks coverage
    python -m benchmarks.coverage --vehicles 6 --declared rightly      # a few, between full runs

A vehicle has a point of `challenge` whose wall and table are other than declared: emittance, coating and insulation by
the standard deviations that every wall has, magnitude and derivatives within the sigma of the table. Its flights have
errors of the kinds of `challenge/world.py`, of one size for all of them and drawn again for each: splines or arcs of
the heating, clock, duration, velocity, angle of attack, density. Three flights are fitted, wall, magnitude and
derivatives with their priors and with the error of the model. One more is predicted, as `predict --bands --member` does
it, and flown FLOWN times with other errors, none of which any fit has seen. Sizes are declared rightly, a third as
large, or not at all. The true model knows wall, table and the sizes of the errors, and none of the errors.

On STS-96: each tile as `predict --bands` has it, and each from the other three, as the last run of
`tile_left_out` has it. Finished vehicles are kept in out/coverage: an interrupted run is resumed from there.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import click
import numpy as np

from benchmarks import tile_left_out
from benchmarks.challenge import recorder as recording
from benchmarks.challenge.case import FINE_S, Case, make_case
from benchmarks.challenge.deviation import Deviation
from benchmarks.challenge.flight import draw_flight
from benchmarks.challenge.judge import finished
from benchmarks.challenge.point import DERIVATIVES, FELTS, FLAPS, TILES, Point, Ratio, draw_point, draw_ratio, times
from benchmarks.challenge.record import Made, write
from benchmarks.challenge.world import DECLARED, DENSITY_M, World, draw_world
from benchmarks.measure import RESULTS, Figure, kept, save, table
from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import Conditions
from sim_heating.base.parameters import MODEL
from sim_heating.closure.prior.model_error import OtherFlight, SmoothFlightError, stated_error
from sim_heating.closure.prior.table import table_prior, undeclared_derivatives
from sim_heating.credibility.facts.contributors import dispersed_temperatures
from sim_heating.estimation.fit import estimate
from sim_heating.estimation.inference.observability import default_names
from sim_heating.estimation.problem import joint_reference
from sim_heating.estimation.report.estimate_file import NAME, write_estimate
from sim_heating.estimation.report.report import estimate_contents
from sim_heating.inputs.points import conditions_of_record, point_of_record
from sim_heating.inputs.record import FlightUncertainty, Record, load_record
from sim_heating.march.history import sensed_temperatures, values_at
from sim_heating.march.point import PointModel
from sim_heating.planning.bands import Member, predict_with_band, read_member
from sim_heating.simulation.predict import Prediction, reading_noise_K

Generator = np.random.Generator

SEED = 20261128
VEHICLES = {"rightly": 20, "small": 4, "not": 4}
"""How many vehicles declare the sizes of their errors in each way."""
FITTED, FLOWN = 3, 16
"""Flights of a vehicle that are fitted, and how often the one that is predicted is flown."""
EVERY = 4
"""Of how many samples of a recorder one is kept: slow errors have as many in either case."""
EMITTANCE = "stack.emissivity_factor"
WALL = {
    EMITTANCE: None,
    "stack.coating.thickness_factor": (0, "thickness"),
    "stack.coating.conductivity_factor": (0, "conductivity_W_mK"),
    "stack.coating.heat_capacity_factor": (0, "specific_heat_J_kgK"),
    "stack.rsi.conductivity_factor": (1, "conductivity_W_mK"),
    "stack.rsi.heat_capacity_factor": (1, "specific_heat_J_kgK"),
}
"""What of a wall is other than declared: number of the layer, and key of its material."""
MOST_SIGMAS = 2.0
"""Largest distance of a wall from the declared one in standard deviations."""
SMALL_STEP, Z95 = 0.02, 1.959964
LEAST, MOST, WIDEST = 0.93, 0.97, 1.3
"""Coverage of a band, and its width over that of the true model's."""
LEAST_OF_TILES = 0.85
LEDGER = Path("out") / "coverage"
ATTEMPTS = 40


# Vehicles and flights ------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Flown:
    """A flight along one recorded trajectory, with errors of its own.

    measured_K : (sample, sensor) readings;  surface_K : (sample,) true temperature of the surface
    """

    world: World
    measured_K: FloatArray
    surface_K: FloatArray


@dataclass
class Vehicle:
    """A point with its truth, which flies.

    wall  : factor of the true over the declared wall by name;  ratio : of the table with its errors
    first : the errors of its first flight, whose sizes all flights have
    """

    point: Point
    wall: dict[str, float]
    every: int
    cp_J_kgK: float | None
    declared: str
    ratio: Ratio | None = None
    first: World | None = None

    @classmethod
    def drawn(cls, rng: Generator, declared: str) -> Vehicle:
        """A vehicle without a flight."""
        point = draw_point(rng, str(rng.choice((*TILES, *FLAPS, *FELTS))))
        wall = {n: 1.0 + MODEL[n].sigma * float(np.clip(rng.normal(), -MOST_SIGMAS, MOST_SIGMAS)) for n in WALL}
        cp = float(rng.choice([1004.5, 1010.0])) if rng.random() < 0.4 else None
        return cls(point, wall, int(rng.choice([2, 1])), cp, declared)

    def fly(self, rng: Generator, folder: Path, times_flown: int) -> list[Flown]:
        """One trajectory, flown several times; the first time is the record in a folder.

        What is recorded is the same each time, and what was flown differs from it by the errors.
        """
        for _ in range(ATTEMPTS):
            flight = draw_flight(rng, ["popu"])
            case = make_case(flight, self.point, partial(self._ratio, rng), self.every, self.cp_J_kgK, False)
            recorder = recording.draw_recorder(rng, float(case.recorded["time_s"][-1]), flight.manoeuvres)
            recorder = replace(recorder, time_s=recorder.time_s[::EVERY])
            flown = [self._flown(rng, case, recorder) for _ in range(times_flown)]
            if all(f is not None for f in flown):
                break
        else:
            raise RuntimeError(f"{folder}: no flight within the ranges of its sensors")
        found = [f for f in flown if f is not None]
        every = np.ones(len(recorder.time_s), dtype=bool)
        first = found[0].measured_K
        write(
            Made(folder.name, case, (), recorder, None, first, first, every, ~every, {}, found[0].world), folder.parent
        )
        return found

    def _flown(self, rng: Generator, case: Case, recorder: recording.Recorder) -> Flown | None:
        """A flight along a recorded trajectory; None where its readings leave the ranges of the sensors."""
        world, sensors, t = self._world(rng, case), self.point.sensors, recorder.time_s
        true = replace(case, flown=world.recorded(case).recorded)
        history = true.at(FINE_S, true=True)
        deviation = world.deviation(history) + self._deviation()
        indicated = history.indicated(t, deviation)
        if self.first is None:
            recording.draw_words(rng, sensors, 1.2 * np.max(indicated, axis=0))
            self.first = world
        if not np.all(np.isfinite(indicated)) or np.any(indicated > [s["range_K"][1] for s in sensors]):
            return None
        measured = finished(t, recording.measure(rng, recorder, sensors, indicated), deviation)
        return Flown(world, measured, np.interp(t, history.t, history.temperatures(deviation)[:, 0]))

    def _ratio(self, rng: Generator, reference: FloatArray) -> Ratio:
        self.ratio = self.ratio or draw_ratio(rng, self.point.name, reference)
        return self.ratio

    def _world(self, rng: Generator, case: Case) -> World:
        """Errors of a flight: those of the first one drawn again."""
        if self.first is None:
            world = replace(draw_world(rng, case, "null", 0), spike=(0.0, 0.0), declared=self.declared)
            for i, calibration in world.polynomials.items():
                self.point.sensors[i]["calibration"] = calibration
            return world
        first, last_s, h = self.first, float(case.flown["time_s"][-1]), case.flown["altitude_m"]
        flight = {n: (sigma, sigma * rng.normal()) for n, (sigma, _) in first.flight.items()}
        world = replace(first, flight=flight, drift_s=(first.drift_s[0], first.drift_s[0] * rng.normal()))
        if first.heating:
            knots = np.arange(0.0, last_s + first.knots[1], first.knots[1])
            world = replace(world, knots=knots, values=first.relative * rng.normal(size=len(knots)))
        if len(first.altitudes):
            apart = float(first.altitudes[1] - first.altitudes[0])
            altitudes = np.arange(float(np.min(h)), float(np.max(h)) + DENSITY_M[1], apart)
            layer = first.flight["density_relative"][0] * rng.normal(size=len(altitudes))
            world = replace(world, altitudes=altitudes, layer=layer)
        return replace(world, drop_outs=int(rng.integers(1, 10**6)) if first.drop_outs else 0)

    def _deviation(self) -> Deviation:
        return Deviation(eps_factor=self.wall[EMITTANCE], walls=(self._change_wall,))

    def _change_wall(self, stack: dict[str, Any], materials: dict[str, Any]) -> None:
        for name, place in WALL.items():
            if place is None:
                continue
            layer, key = stack["layer"][place[0]], place[1]
            if key == "thickness":
                layer["thickness_m"] *= self.wall[name]
            else:
                of_layer = materials[layer["material"]]
                of_layer[key] = times(of_layer[key], self.wall[name])


# Predictions ---------------------------------------------------------------------------------------------------------


def fitted_member(folders: Sequence[Path], out: Path) -> Member:
    """The estimate of wall, magnitude and derivatives from some flights, as it is read for a prediction."""
    records = [load_record(folder) for folder in folders]
    excluded = undeclared_derivatives(records[0], default_names(records))
    names = [n for n in default_names(records) if n not in excluded]
    prior = table_prior(records[0], names, joint_reference(records))
    assert prior is not None  # every vehicle has a table
    fit = estimate(records, [*names, *WALL], priors=prior.parameters(), error_of=stated_error)
    out.mkdir(exist_ok=True)
    write_estimate(out / NAME, estimate_contents(fit))
    return read_member(out)


def half_width_K(prediction: Prediction, half_K: FloatArray) -> float:
    """Mean half width of the band of the readings of the used sensors, noise included [K].

    half_K : (sensor, sample) of the temperatures
    """
    used = [i for i, s in enumerate(prediction.record.sensors) if s.used]
    noise = reading_noise_K([prediction.record.sensors[i] for i in used])
    return float(np.nanmean(np.hypot(half_K[used], Z95 * noise[:, np.newaxis])))


def true_half_K(vehicle: Vehicle, flown: Flown, record: Record, times_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(channel, sample) half width of the band by the true model, and its mean, of surface, bondline, sensors [K]."""
    assert vehicle.ratio is not None  # it has flown
    model, conditions = true_model(vehicle, record), conditions_of_record(record)
    t = record.time_s
    flight = conditions.at(np.union1d(conditions.time_s, t[(t >= conditions.time_s[0]) & (t <= conditions.time_s[-1])]))
    variants = [(model, c) for c in (*_by_heating(flown.world, flight), *_by_flight(flown.world, record, flight))]
    T = dispersed_temperatures(model, flight, variants)
    T[:, 2:] = [sensed_temperatures(model, flight.time_s, x) for x in T[:, 2:]]
    changes = T[1:] - T[0]
    count = len(variants) - len(_by_flight(flown.world, record, flight))
    changes[:count] *= flown.world.relative / SMALL_STEP
    half = Z95 * np.sqrt(np.sum(changes**2, axis=0))
    return values_at(flight.time_s, half, times_s), values_at(flight.time_s, T[0], times_s)


def true_model(vehicle: Vehicle, record: Record) -> PointModel:
    """The point of a record with the true wall and table."""
    ratio = vehicle.ratio
    assert ratio is not None  # it has flown
    slopes = {f"ratio.{n}": float(v) for n, v in zip(DERIVATIVES, ratio.d, strict=True)}
    model = replace(point_of_record(record), reference=tuple(ratio.reference.tolist()))
    return model.with_parameters(vehicle.wall | slopes | {"ratio.scale": ratio.scale})


def _by_heating(world: World, flight: Conditions) -> list[Conditions]:
    if not world.heating:
        return []
    h = flight["h_ref_kg_m2_s"]
    return [flight.with_columns(h_ref_kg_m2_s=h * (1.0 + SMALL_STEP * s)) for s in world.shapes(flight.time_s).T]


def _by_flight(world: World, record: Record, flight: Conditions) -> list[Conditions]:
    sigmas = {name: sigma for name, (sigma, _) in world.flight.items()}
    span_s = float(record.conditions.time_s[-1])
    if world.drift_s[0]:
        sigmas["time_stretch"] = float(np.hypot(sigmas.get("time_stretch", 0.0), world.drift_s[0] / span_s))
    if not sigmas:
        return []
    scale = {"density_scale_m": float(world.altitudes[1] - world.altitudes[0])} if len(world.altitudes) else {}
    z, stated = record.conditions["altitude_m"], FlightUncertainty(**sigmas, **scale)
    knots = np.arange(z.min(), z.max() + stated.density_scale_m, stated.density_scale_m)
    other = OtherFlight(SmoothFlightError(record, stated, knots))
    return [conditions_of_record(other.record(f)).at(flight.time_s) for f in np.eye(len(other.directions))]


def coverage_of(vehicle: Vehicle, folder: Path, flights: Sequence[Flown], member: Member) -> list[dict[str, float]]:
    """Shares within the band, and widths, of one trajectory flown several times."""
    record = load_record(folder)
    prediction = predict_with_band(record, [member])
    band = prediction.history.band
    assert band is not None
    half = 0.5 * (band.high_K - band.low_K)
    true_half, true_K = true_half_K(vehicle, flights[0], record, record.time_s)
    by_truth = replace(band, low_K=true_K - true_half, high_K=true_K + true_half)
    known = np.isfinite(band.low_K[0])
    found = []
    for flown in flights:
        residual = flown.measured_K.T - prediction.indicated_K
        own = replace(prediction, residual_K=residual)
        truth = replace(
            own,
            history=replace(own.history, band=by_truth, sensors_K=true_K[2:]),
            residual_K=residual + own.history.sensors_K - true_K[2:],
        )
        surface = (flown.surface_K >= band.low_K[0]) & (flown.surface_K <= band.high_K[0])
        of_truth = np.abs(flown.surface_K - true_K[0]) <= true_half[0]
        found.append({
            "within": own.within_band or 0.0,
            "width_K": half_width_K(prediction, half[2:]),
            "surface_within": float(np.mean(surface[known])),
            "surface_width_K": float(np.nanmean(half[0])),
            "true_within": truth.within_band or 0.0,
            "true_surface_within": float(np.mean(of_truth[known])),
            "true_width_K": half_width_K(prediction, true_half[2:]),
            "true_surface_width_K": float(np.nanmean(true_half[0])),
        })  # fmt: skip
    return found


def of_vehicle(
    declared: str, number: int, times_flown: int = FLOWN, times_fitted: int = FITTED
) -> list[dict[str, float]]:
    """Coverage and widths of the flights of a vehicle that were not fitted."""
    rng = np.random.default_rng([SEED, DECLARED.index(declared), number])
    vehicle = Vehicle.drawn(rng, declared)
    with TemporaryDirectory() as name:
        fitted, predicted = [Path(name) / f"fitted_{k}" for k in range(times_fitted)], Path(name) / "predicted"
        for folder in fitted:
            vehicle.fly(rng, folder, 1)
        member = fitted_member(fitted, Path(name) / "estimate")
        flights = vehicle.fly(rng, predicted, times_flown)
        return coverage_of(vehicle, predicted, flights, member)


# Figures -------------------------------------------------------------------------------------------------------------


def flights_of(declared: str, vehicles: int) -> list[dict[str, float]]:
    """All predicted flights of some vehicles; those that are finished are read."""
    keep, found = kept(LEDGER), list[dict[str, float]]()
    for number in range(vehicles):
        found += keep(f"{declared}-{number:03d}", partial(of_vehicle, declared, number))
    return found


def figures_of(declared: str, flights: Sequence[Mapping[str, float]]) -> list[Figure]:
    """Mean coverage and pooled widths; only of sizes that are declared rightly there is a goal."""
    mean = {key: float(np.mean([f[key] for f in flights])) for key in flights[0]}
    ratio = [f["width_K"] / f["true_width_K"] for f in flights]
    head, aim = f"errors declared {declared}: ", declared == "rightly"
    note = f"{len(flights)} flights; median of the flights {np.median([f['within'] for f in flights]):.3f}"
    spread = f"by flight: median {np.median(ratio):.2f}, a tenth above {np.quantile(ratio, 0.9):.2f}"
    width = mean["width_K"] / mean["true_width_K"]
    surface = mean["surface_width_K"] / mean["true_surface_width_K"]
    known = f"by the true model {mean['true_within']:.3f}"
    return [
        Figure(f"{head}readings within the band, at least", mean["within"], "", LEAST if aim else None, True, note),
        Figure(f"{head}readings within the band, at most", mean["within"], "", MOST if aim else None, note=known),
        Figure(f"{head}width over that of the true model", width, "", WIDEST if aim else None, note=spread),
        Figure(f"{head}surface within the band, at least", mean["surface_within"], "", LEAST if aim else None, True),
        Figure(f"{head}surface within the band, at most", mean["surface_within"], "", MOST if aim else None),
        Figure(f"{head}width at the surface over that of the true model", surface, "", WIDEST if aim else None),
        Figure(f"{head}half width of the band", mean["width_K"], "K", note=f"true model {mean['true_width_K']:.1f} K"),
    ]


def of_tiles() -> list[Figure]:
    """Measured tiles by themselves, nothing fitted."""
    figures = []
    for path in tile_left_out.RECORDS:
        found = predict_with_band(load_record(path))
        band = found.history.band
        assert band is not None
        half, name = 0.5 * (band.high_K - band.low_K)[2:], found.record.declared.control_point
        note = f"mean half width {half_width_K(found, half):.0f} K"
        figures.append(
            Figure(f"{name}: readings within the band", found.within_band or 0.0, "", LEAST_OF_TILES, True, note)
        )
    return figures


def left_out() -> list[Figure]:
    """Bands of each tile from the other three, as `tile_left_out` has found them."""
    stored = json.loads((RESULTS / "tile_left_out.json").read_text())["figures"]
    found = [Figure(**{k: v for k, v in f.items() if k != "verdict"}) for f in stored if "band" in f["what"]]
    return [replace(f, what=f"{f.what}, from the other three") for f in found]


def run() -> list[Figure]:
    """All vehicles, and the tiles."""
    figures = [f for declared, count in VEHICLES.items() for f in figures_of(declared, flights_of(declared, count))]
    figures += [*of_tiles(), *left_out()]
    save("coverage", figures)
    return figures


@click.command(help="Coverage of bands on some vehicles.")
@click.option("--vehicles", type=click.IntRange(1), default=6, show_default=True)
@click.option("--declared", type=click.Choice(DECLARED), default=DECLARED[0], show_default=True)
def main(vehicles: int, declared: str) -> None:
    """Print the figures of some vehicles."""
    click.echo(table(figures_of(declared, flights_of(declared, vehicles))))


if __name__ == "__main__":
    main()
