"""What the compiled filter works on: arrays over the lanes of a march, over the readings, and room for one step."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sim_heating.base.arrays import FloatArray, IntArray


class Readings(NamedTuple):
    """(lane, reading) in order of time; lower and upper are equal where nothing was rounded, NaN where nothing is read.
    direct : (lane, reading, parameter, 3)."""

    number: IntArray
    time_s: FloatArray
    node: IntArray
    gain: FloatArray
    bias: FloatArray
    variance: FloatArray
    lower: FloatArray
    upper: FloatArray
    direct: FloatArray


class State(NamedTuple):
    """(lane, ...) covariance of z, its sensitivities, d, and the step at which the lane diverged (0: it did not)."""

    P: FloatArray
    S: FloatArray
    d: FloatArray
    diverged: IntArray


class Noise(NamedTuple):
    """White noise of nodes [K2/s] (lane, node); of d (lane,): rate of decay [1/s] and density [1/s]."""

    nodes: FloatArray
    decay_1_s: FloatArray
    density_1_s: FloatArray


class Kept(NamedTuple):
    """What a smoother needs, empty where nothing is kept: z and its covariance after each step, the transition of each
    step with its readings taken, the row of each reading against z at the start of its step."""

    mean: FloatArray
    covariance: FloatArray
    transition: FloatArray
    rows: FloatArray


class Held(NamedTuple):
    """Of each lane: the time after which its covariances are held [s]; number, node and fraction of the readings of the
    step that they are of, their covariances with each other and with z, and that of z, before they were taken."""

    after_s: FloatArray
    number: IntArray
    node: IntArray
    x: FloatArray
    covariance: FloatArray
    cross: FloatArray
    P: FloatArray


class Columns(NamedTuple):
    """Work of a propagation: (node, column) at the end and the middle stage of a step, and what leads there."""

    end: FloatArray
    middle: FloatArray
    e: FloatArray
    f: FloatArray
    star: FloatArray
    e_middle: FloatArray
    reduced: FloatArray


class Joint(NamedTuple):
    """The readings of a step before they are taken: fraction x of the step, temperature and its rate, covariance with
    each other and with z at the end, sensitivities, rows against z at the start, cov(z at the start, T)."""

    x: FloatArray
    mean: FloatArray
    rate: FloatArray
    covariance: FloatArray
    cross: FloatArray
    S: FloatArray
    rows: FloatArray
    start: FloatArray


class Told(NamedTuple):
    """What a march with an added history tells (estimation/filter/response.py): (lane, time, node) temperatures, (lane,
    reading) those read, (lane, step, node, node + 1) derivatives of the steps, (lane, reading, node + 1) rows of the
    readings."""

    temperature_K: FloatArray
    read_K: FloatArray
    transition: FloatArray
    rows: FloatArray


class Blocks(NamedTuple):
    """Blocks of the shadows, assembled at the start (with 1 s for the time step), the middle stage and the end."""

    start: FloatArray
    middle: FloatArray
    end: FloatArray


def columns_of(n: int, columns: int) -> Columns:
    """Work for so many columns."""
    end, middle, e, f, star, e_middle = np.zeros((6, n, columns))
    return Columns(end, middle, e, f, star, e_middle, np.zeros(n))


def joint_of(readings: int, size: int, parameters: int) -> Joint:
    """Room for so many readings of one step, `size` being that of z."""
    x, mean, rate = np.zeros((3, readings))
    cross, rows, start = np.zeros((3, readings, size))
    return Joint(x, mean, rate, np.zeros((readings, readings)), cross, np.zeros((readings, parameters)), rows, start)


def held_of(after_s: FloatArray, readings: int, size: int) -> Held:
    """Nothing held yet, for lanes with so many readings in a step at most."""
    lanes = len(after_s)
    node, x = np.zeros((lanes, readings), dtype=np.int64), np.zeros((lanes, readings))
    covariance, cross = np.zeros((lanes, readings, readings)), np.zeros((lanes, readings, size))
    return Held(after_s, np.full(lanes, -1, dtype=np.int64), node, x, covariance, cross, np.zeros((lanes, size, size)))
