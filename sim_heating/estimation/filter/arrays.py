"""Arrays of the compiled filter: over the lanes of a march, over the readings, and work space for one step.

Symbols are those of docs/theory/filter.md, equations 1 to 14: state z (node temperatures [K], then the ratio
disturbance d [-]), covariance P, sensitivities s, rows R.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sim_heating.base.arrays import FloatArray, IntArray


class Readings(NamedTuple):
    """Readings of all lanes, (lane, reading) in order of time: y = gain T(x) + bias + noise.

    number       : (lane,) number of readings
    time_s       : time of each [s];  node : node that is read
    gain, bias   : of the sensor [-], [K];  variance : of its noise [K2]
    lower, upper : interval in which the noisy value lay [K], equal where nothing was rounded, NaN where nothing is read
    direct       : (lane, reading, parameter, 3) direct terms a0, a1, a2 of docs/theory/filter.md, equation 12
    """

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
    """Filter state of all lanes, in addition to the temperatures in their block.

    P        : (lane, node + 1, node + 1) covariance of z [K2], [K], [-]
    S        : (lane, node + 1, parameter) sensitivities of z [K over the parameter's unit]
    d        : (lane,) mean of the heating-ratio disturbance [-]
    diverged : (lane,) step at which the lane diverged, 0 where it did not
    """

    P: FloatArray
    S: FloatArray
    d: FloatArray
    diverged: IntArray


class Noise(NamedTuple):
    """Process noise of all lanes.

    nodes       : (lane, node) density of the white noise of each node [K2/s]
    decay_1_s   : (lane,) reciprocal correlation time of the ratio disturbance [1/s], 0 for a random walk
    density_1_s : (lane,) density of the noise that drives it [1/s]
    """

    nodes: FloatArray
    decay_1_s: FloatArray
    density_1_s: FloatArray


class SmootherHistory(NamedTuple):
    """What a smoother reads of a filtered march, of size 0 where no smoother follows.

    mean       : (lane, time, node + 1) z after the readings of each step
    covariance : (lane, time, node + 1, node + 1) its covariance
    transition : (lane, step, node + 1, node + 1) derivative of z after a step and its readings against z before it
    rows       : (lane, reading, node + 1) of each innovation against z at the start of its step
    """

    mean: FloatArray
    covariance: FloatArray
    transition: FloatArray
    rows: FloatArray


class FrozenGains(NamedTuple):
    """Covariances of one step of each lane, before its readings were taken, for frozen gains.

    after_s           : (lane,) time after which the covariances serve for later steps [s]
    number            : (lane,) readings of that step, -1 before the first
    node, x           : (lane, reading) their nodes and fractions of the step
    covariance, cross : covariances of the readings with each other and with z [K2];  P : that of z
    """

    after_s: FloatArray
    number: IntArray
    node: IntArray
    x: FloatArray
    covariance: FloatArray
    cross: FloatArray
    P: FloatArray


class Workspace(NamedTuple):
    """Work space of a propagation, each (node, column): derivatives of temperatures at middle stage and end of a step.

    end, middle         : columns at the end (on entry: at the start) and at the middle stage
    e, f, star, e_middle : heat content, net heat, right-hand side, heat content at the middle stage
    reduced              : (node,) of the tridiagonal elimination
    """

    end: FloatArray
    middle: FloatArray
    e: FloatArray
    f: FloatArray
    star: FloatArray
    e_middle: FloatArray
    reduced: FloatArray


class StepReadings(NamedTuple):
    """Readings of one step before they are taken, in the order of time.

    x, mean, rate     : (reading,) fraction of the step [-], temperature [K], its rate [K/s]
    covariance, cross : (reading, reading) with each other; (reading, node + 1) with z at the end of the step [K2]
    S                 : (reading, parameter) sensitivities of the temperatures read
    rows, projected   : (reading, node + 1) rows R against z at the start of the step; R L, one number for each column
                        of the factor of the covariance there [K], later cov(z, T) g / S
    weight, inverse   : (reading,) g^2 / S, by which its cov(z, T) cov(z, T)' is taken from P, and 1 / S [1/K2]; 0 where
                        not used
    scratch, column   : work space for one number of each reading, or of each column of the factor; for a column of S
    """

    x: FloatArray
    mean: FloatArray
    rate: FloatArray
    covariance: FloatArray
    cross: FloatArray
    S: FloatArray
    rows: FloatArray
    projected: FloatArray
    weight: FloatArray
    inverse: FloatArray
    scratch: FloatArray
    column: FloatArray


class FilterArrays(NamedTuple):
    """All arrays of a filter: inputs, state, outputs for a smoother, and work space.

    readings, state, noise : readings, filter state (updated) and noise of the process, of all lanes
    gains, history         : frozen gains;  history for a smoother
    work                   : work space of a pass
    batch                  : readings of one step
    z, transition          : (node + 1,) state of a lane;  (node + 1, node + 1) transition of its step
    L                      : (node + 1, node + 1) factor of its covariance, a column of it in each row
    """

    readings: Readings
    state: State
    noise: Noise
    gains: FrozenGains
    history: SmootherHistory
    work: Workspace
    batch: StepReadings
    z: FloatArray
    transition: FloatArray
    L: FloatArray


class LaneStep(NamedTuple):
    """One step of one lane, as the parts of the filter take it.

    lane, nodes  : number of the lane and of its nodes
    dt, decay    : length of the step [s];  exp(-dt / correlation time) of the ratio disturbance [-]
    first, number : number of the first reading in the step, and of readings in it
    rank         : number of columns of the factor of the covariance; 0 where gains are frozen and it is not propagated
    keep         : whether rows and transition are kept for a smoother
    """

    lane: int
    nodes: int
    dt: float
    decay: float
    first: int
    number: int
    rank: int
    keep: bool


class MarchOutput(NamedTuple):
    """Output of a march with a history added to the heating ratio.

    temperature_K : (lane, time, node) [K];  read_K : (lane, reading) temperatures read [K]
    transition    : (lane, step, node, node + 1) derivatives [Phi, Gamma] of the steps
    rows          : (lane, reading, node + 1) derivatives of the temperatures read
    """

    temperature_K: FloatArray
    read_K: FloatArray
    transition: FloatArray
    rows: FloatArray


class Blocks(NamedTuple):
    """Blocks of the perturbed lanes at start (assembled with 1 s for the time step), middle stage and end of a step."""

    start: FloatArray
    middle: FloatArray
    end: FloatArray


def workspace(n: int, columns: int) -> Workspace:
    """Work space for the propagation of columns, all zero.

    n : nodes;  columns : number of columns, each the derivative of the node temperatures [K] against one quantity

    The propagation is docs/theory/equations_march.md, equations 7 and 8.
    """
    end, middle, e, f, star, e_middle = np.zeros((6, n, columns))
    return Workspace(end, middle, e, f, star, e_middle, np.zeros(n))


def step_readings(readings: int, size: int, parameters: int) -> StepReadings:
    """Room for the readings of one step, all zero.

    readings : most readings in a step;  size : of the state z;  parameters : number of sensitivities

    Holds temperatures [K], covariances [K2] and rows of docs/theory/filter.md, equations 5 to 7.
    """
    x, mean, rate, weight, inverse = np.zeros((5, readings))
    cross, rows, projected = np.zeros((3, readings, size))
    square, slopes = np.zeros((readings, readings)), np.zeros((readings, parameters))
    work = (np.zeros(max(readings, size)), np.zeros(size))
    return StepReadings(x, mean, rate, square, cross, slopes, rows, projected, weight, inverse, *work)


def frozen_gains(after_s: FloatArray, readings: int, size: int) -> FrozenGains:
    """Store for frozen gains, still empty.

    after_s  : (lane,) time after which gains are frozen [s];  readings : most readings in a step;  size : of the state
               z

    Holds the covariances of docs/theory/filter.md, equation 6.
    """
    lanes = len(after_s)
    node, x = np.zeros((lanes, readings), dtype=np.int64), np.zeros((lanes, readings))
    covariance, cross = np.zeros((lanes, readings, readings)), np.zeros((lanes, readings, size))
    return FrozenGains(
        after_s, np.full(lanes, -1, dtype=np.int64), node, x, covariance, cross, np.zeros((lanes, size, size))
    )
