"""Residual as heating: time for a record, and the fastest change in the ratio that a thermocouple resolves.

The flight of the practice record p06 under tests/data, its ratio raised by a tenth for 80 s; two thermocouples, 8-bit
words. The noise model is estimated as well. The resolution of a thermocouple is the frequency at which a sine in the
ratio is recovered with half its amplitude, for a noise model of a tenth of the ratio correlated over 30 s; one
thermocouple, samples of 1 s.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from benchmarks.measure import Figure, in_turn, save
from sim_heating.closure.clues.residual_heating import residual_heating
from sim_heating.estimation.filter.heating_input import unknown_input
from sim_heating.estimation.filter.march import Disturbance, FilterMarch, FilterTrack
from sim_heating.estimation.filter.smoother import smooth
from sim_heating.estimation.inference.likelihood import reading_intervals
from sim_heating.estimation.problem import FitProblem, joint_reference
from sim_heating.heating.effects import use
from sim_heating.inputs.points import conditions_of_record, point_of_record
from sim_heating.inputs.record import Record, load_record
from sim_heating.inputs.sensor_model import measure
from sim_heating.march.ensemble import condition_history
from sim_heating.march.history import march_points, values_at
from sim_heating.march.mesh_choice import pack
from sim_heating.thermal.stack import Sensor
from tests.support.filter_samples import samples_on_grid
from tests.support.problems import RECORD

ROUNDS, SEED = 7, 1
BEGIN_S, END_S, RISE = 500.0, 580.0, 0.1
DEPTHS_M = (0.0, 0.002, 0.005)
RECORDERS = {"0.3 K noise": (0.3, None), "1 K noise": (1.0, None), "1 K noise, 8 bits over 1378 K": (1.0, 8)}
RANGE_K = (255.0, 1633.0)
PART_S = (400.0, 700.0)
TENTH, CORRELATION_S = 0.1, 30.0


def raised() -> Record:
    """The record as measured with a ratio that it does not declare."""
    record = load_record(RECORD)
    conditions = conditions_of_record(record)
    t = conditions.time_s
    jets = np.clip(t - BEGIN_S, 0.0, 1.0) - np.clip(t - END_S, 0.0, 1.0)
    true = replace(point_of_record(record), effects=(use("jet-interaction", {"jet_gain": RISE}),))
    history = march_points([true], [conditions.with_columns(jets=jets)], extra_times_s=record.time_s, halvings=1)[0]
    rng, nothing = np.random.default_rng(SEED), np.zeros(len(record.time_s), dtype=bool)
    columns = {"time_s": record.time_s}
    for sensor, T in zip(record.sensors, values_at(history.time_s, history.sensors_K, record.time_s), strict=True):
        columns[sensor.column] = measure(sensor, T, rng, None, nothing)
    return replace(record, thermocouples=columns, conditions=conditions.with_columns(jets=0.0 * t))


def speed() -> list[Figure]:
    """The whole residual of a record, and one filter and smoother with a known noise model."""
    record = raised()
    problem, values = FitProblem([record], ["ratio.scale"], joint_reference([record])), np.zeros(1)
    found = residual_heating(problem, values)
    part = problem.record_fits[0]
    known = found.input.disturbance
    times = in_turn(
        {
            "all": lambda: residual_heating(problem, values),
            "known": lambda: residual_heating(problem, values, disturbance=known),
            "smoother": lambda: filtered(problem, known),
        },
        ROUNDS,
    )
    readings = sum(len(c.samples) for c in part.channels)
    note = f"{part.mesh.nodes} nodes, {len(part.time_s) - 1} steps, {readings} readings, {len(found.time_s)} knots"
    during = (found.time_s > BEGIN_S + 15.0) & (found.time_s < END_S - 15.0)
    rise = float(np.mean(found.delta_ratio[during]))
    return [
        Figure("residual heating of a record, noise model found beside", 1e3 * times.best("all"), "ms", note=note),
        Figure("the same, noise model known", 1e3 * times.best("known"), "ms"),
        Figure("Kalman filter and smoother once, noise model known", 1e3 * times.best("smoother"), "ms"),
        Figure("all over filter and smoother once", times.ratio("all", "smoother"), "-", 4.0),
        Figure("rise of the ratio recovered", rise, "1", note=f"sigma there {np.mean(found.sigma[during]):.2g}"),
        Figure("half amplitude", found.input.half_amplitude_Hz, "Hz"),
    ]


def filtered(problem: FitProblem, known: Disturbance) -> None:
    """One pass forward and back."""
    part = problem.record_fits[0]
    read = np.array([part.record.thermocouples[c.sensor.column] for c in part.channels])
    read = read[:, np.searchsorted(part.record.time_s, part.sample_s)]
    intervals = [reading_intervals(c.sensor, T) for c, T in zip(part.channels, read, strict=True)]
    nodes = [part.mesh.sensors[c.number] for c in part.channels]
    sigma = [part.sigma_K[c.number] for c in part.channels]
    samples = samples_on_grid(
        part.sample_s, nodes, np.array([o.lower_K for o in intervals]), sigma, np.array([o.upper_K for o in intervals])
    )
    track = FilterTrack(part.model, part.mesh, samples, disturbance=known)
    history = condition_history(part.conditions.at(part.time_s))[np.newaxis]
    smooth(FilterMarch([track], part.time_s, history).filter(keep=True)[0])


def resolved() -> list[Figure]:
    """Half-amplitude frequency by depth below the coating and recorder."""
    record = load_record(RECORD)
    conditions = conditions_of_record(record)
    time_s = np.arange(*PART_S)
    history = condition_history(conditions.at(time_s))[np.newaxis]
    base = point_of_record(record)
    ratio = float(np.nanmean(march_points([base], [conditions])[0].ratio))
    taken = Disturbance.gauss_markov(TENTH * ratio, CORRELATION_S)
    figures = []
    for depth in DEPTHS_M:
        model = replace(base, depths_m=(base.depths_m[0] + depth,), nodes=None)
        mesh = pack([model]).meshes[0]
        warm = march_points([model], [conditions.at(np.arange(conditions.time_s[0], PART_S[0] + 1.0))])[0]
        start = np.interp(mesh.depth_m, [0.0, mesh.depth_m[-1]], [warm.surface_K[-1], warm.bondline_K[-1]])
        for recorder, (sigma, bits) in RECORDERS.items():
            sensor = Sensor(
                name="S", column="S_K", depth_m=0.0, noise_sigma_K=sigma, bits=bits,
                range_K=None if bits is None else list(RANGE_K),
            )  # fmt: skip
            nothing = np.full((1, len(time_s) - 1), np.nan)
            bare = FilterTrack(model, mesh, samples_on_grid(time_s[1:], mesh.sensors, nothing, sigma), (), start)
            expected = unknown_input(bare, time_s, history, taken).read_K
            read = measure(sensor, expected, np.random.default_rng(SEED), None, np.zeros(len(expected), dtype=bool))
            seen = reading_intervals(sensor, read)
            low, high = seen.lower_K[np.newaxis], seen.upper_K[np.newaxis]
            samples = samples_on_grid(time_s[1:], mesh.sensors, low, sigma, high)
            found = unknown_input(replace(bare, samples=samples), time_s, history, taken)
            what = f"half amplitude, {1e3 * depth:.0f} mm below the coating, {recorder}"
            figures.append(Figure(what, found.half_amplitude_Hz, "Hz"))
    return figures


def run() -> list[Figure]:
    """Time and resolution."""
    figures = [*speed(), *resolved()]
    save("residual", figures)
    return figures
