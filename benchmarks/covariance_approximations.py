"""Approximations of the covariance of a Kalman filter used in practice, in dense products about a plain march.

With T, Phi and dT/dp of a march at the parameters (derivatives of its own steps), delta what the readings have added
and D its sensitivity, a step and the gain K of any covariance give

    delta <- Phi delta,   D <- Phi D,   nu = y - H (T + delta),   delta <- delta + K nu,   D <- D - K H (dT/dp + D).

    whole          P <- Phi P Phi' + Q dt at every step
    every tenth    P propagated over ten steps at once, its gain kept in between, ten readings taken as one of R / 10
    rank 6, rank 3 only the largest directions of P are kept after each step (a reduced-rank square root)
    upper nodes    P of the nodes down to the third thermocouple, the wall adiabatic behind them, deeper readings
                   omitted: the founding paper's own first approximation

All repetitions go through every line at once. No second-order effect of delta on the march is in it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sim_heating.base.kernels.block import LANES
from sim_heating.estimation.filter.march import FilterTrack
from sim_heating.estimation.filter.response import ResponseMarch
from sim_heating.march.linearised import LinearMarch, Track

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

EVERY = 10
UPPER_SENSORS = 3
"""Thermocouples whose nodes have a covariance in `upper nodes`."""

LEFT_OUT_K2 = 1e12
"""Variance of a reading that is not used [K2]."""


@dataclass(frozen=True, eq=False)
class Linear:
    """Marches of all repetitions at one parameter vector each.

    read_K : (step, run, sensor) of the march;  transition : (step, run, node, node)
    sensitivity : (step, run, node, parameter)
    """

    read_K: FloatArray
    transition: FloatArray
    sensitivity: FloatArray


@dataclass(frozen=True, eq=False)
class Case:
    """Input of the filter: readings (step, run, sensor), nodes of the sensors, covariance at the start (node, node),
    noise of the process [K2] a step and of the readings [K2]."""

    read_K: FloatArray
    sensors: IntArray
    start_K2: FloatArray
    process_K2: float
    noise_K2: float


def linear(
    points: Sequence[FilterTrack], names: tuple[str, ...], values: FloatArray, time_s: FloatArray, history: FloatArray
) -> Linear:
    """All repetitions marched at parameter vectors (run, parameter)."""
    read, transition, sensitivity = [], [], []
    for k in range(0, len(points), LANES):
        some = [
            replace(p, names=(), model=p.model.with_parameters(dict(zip(names, map(float, v), strict=True))))
            for p, v in zip(points[k : k + LANES], values[k : k + LANES], strict=True)
        ]
        nothing = [np.zeros(len(time_s) - 1)] * len(some)
        for p, found in zip(some, ResponseMarch(some, time_s, history).respond(nothing), strict=True):
            read.append(found.temperature_K[1:, list(p.mesh.sensors)])
            transition.append(found.transition[:, :, : p.mesh.nodes])
        every = [Track(p.model, p.mesh, names, time_s[1:], tuple(range(p.mesh.nodes)), p.initial_K) for p in some]
        sensitivity += [m.sensitivity.transpose(1, 0, 2) for m in LinearMarch(every, time_s, history).march()]
    return Linear(*(np.stack(x, axis=1) for x in (read, transition, sensitivity)))


Gain = tuple[FloatArray, FloatArray]
"""(run, node, sensor) gain, and (run, sensor, sensor) covariance of the innovations."""
Step = Callable[[int, FloatArray], Gain]
"""Number of a step and its transition (run, node, node) to the gain of its readings."""


def gain_of(P: FloatArray, case: Case) -> Gain:
    """Gain of a covariance (run, node, node) before the readings of a step."""
    cross = P[:, :, case.sensors]
    S = cross[:, case.sensors, :] + case.noise_K2 * np.eye(len(case.sensors))
    return np.asarray(np.linalg.solve(S, cross.transpose(0, 2, 1)).transpose(0, 2, 1), dtype=np.float64), S


def updated(P: FloatArray, case: Case, readings: int = 1) -> FloatArray:
    """Covariance after several readings of every sensor."""
    K, _ = gain_of(P, replace(case, noise_K2=case.noise_K2 / readings))
    after = P - K @ P[:, case.sensors, :]
    return 0.5 * (after + after.transpose(0, 2, 1))


def whole(case: Case, runs: int) -> Step:
    """The covariance of every step."""
    return rank(case, runs, len(case.start_K2))


def rank(case: Case, runs: int, kept: int) -> Step:
    """The largest directions of the covariance."""
    P = np.tile(case.start_K2, (runs, 1, 1))

    def step(k: int, phi: FloatArray) -> Gain:
        nonlocal P
        P = phi @ P @ phi.transpose(0, 2, 1) + case.process_K2 * np.eye(len(case.start_K2))
        if kept < len(case.start_K2):
            values, vectors = np.linalg.eigh(P)
            L = vectors[:, :, -kept:] * np.sqrt(np.maximum(values[:, np.newaxis, -kept:], 0.0))
            P = L @ L.transpose(0, 2, 1)
        latest = gain_of(P, case)
        P = updated(P, case)
        return latest

    return step


def every_tenth(case: Case, runs: int) -> Step:
    """Covariance propagated over ten steps at once."""
    n = len(case.start_K2)
    P, phi_of_all, latest = np.tile(case.start_K2, (runs, 1, 1)), np.eye(n), None

    def step(k: int, phi: FloatArray) -> Gain:
        nonlocal P, phi_of_all, latest
        phi_of_all = phi @ phi_of_all
        if latest is None or (k + 1) % EVERY == 0:
            steps = 1 if latest is None else EVERY
            P = phi_of_all @ P @ phi_of_all.transpose(0, 2, 1) + steps * case.process_K2 * np.eye(n)
            latest = gain_of(P, case)
            P, phi_of_all = updated(P, case, steps), np.eye(n)
        return latest

    return step


def upper(case: Case, runs: int) -> Step:
    """Covariance of the nodes down to a thermocouple only."""
    nodes = int(case.sensors[UPPER_SENSORS - 1]) + 1
    within = replace(case, sensors=case.sensors[:UPPER_SENSORS], start_K2=case.start_K2[:nodes, :nodes])
    inner = whole(within, runs)

    def step(k: int, phi: FloatArray) -> Gain:
        own, S_own = inner(k, phi[:, :nodes, :nodes])
        sensors = len(case.sensors)
        K, S = np.zeros((runs, len(case.start_K2), sensors)), np.tile(LEFT_OUT_K2 * np.eye(sensors), (runs, 1, 1))
        K[:, :nodes, :UPPER_SENSORS], S[:, :UPPER_SENSORS, :UPPER_SENSORS] = own, S_own
        return K, S

    return step


APPROXIMATIONS: dict[str, Callable[[Case, int], Step]] = {
    "whole, linear": whole,
    "every tenth step": every_tenth,
    "rank 6": lambda case, runs: rank(case, runs, 6),
    "rank 3": lambda case, runs: rank(case, runs, 3),
    "upper nodes": upper,
}


def filtered(found: Linear, case: Case, step: Step) -> tuple[FloatArray, FloatArray]:
    """(run, parameter) score and (run, parameter, parameter) information of the innovations."""
    runs, n, m = found.sensitivity.shape[1:]
    delta, D = np.zeros((runs, n)), np.zeros((runs, n, m))
    score, information = np.zeros((runs, m)), np.zeros((runs, m, m))
    for k, phi in enumerate(found.transition):
        delta, D = (phi @ delta[:, :, np.newaxis])[:, :, 0], phi @ D
        K, S = step(k, phi)
        own = (found.sensitivity[k] + D)[:, case.sensors]
        nu = case.read_K[k] - found.read_K[k] - delta[:, case.sensors]
        weighted = np.linalg.solve(S, own).transpose(0, 2, 1)
        score += (weighted @ nu[:, :, np.newaxis])[:, :, 0]
        information += weighted @ own
        delta = delta + (K @ nu[:, :, np.newaxis])[:, :, 0]
        D = D - K @ own
    return score, information


def fitted(
    points: Sequence[FilterTrack], case: Case, names: tuple[str, ...], how: str, time_s: FloatArray,
    history: FloatArray, iterations: int,
) -> tuple[FloatArray, FloatArray]:  # fmt: skip
    """(run, parameter) estimates and their stated sigmas, Gauss-Newton from the points' own values."""
    at = np.array([[p.model.value(n) for n in names] for p in points])
    information = np.zeros(0)
    for _ in range(iterations):
        found = linear(points, names, at, time_s, history)
        score, information = filtered(found, case, APPROXIMATIONS[how](case, len(points)))
        at = at + np.linalg.solve(information, score[:, :, np.newaxis])[:, :, 0]
    return at, np.sqrt(np.diagonal(np.linalg.inv(information), axis1=1, axis2=2))
