"""The heating plug-in: a vehicle's control points stepped frame by frame beside a flight simulator.

A host gives what it knows well, the columns of conditions.FRAME; temperature, Mach and Reynolds number, reference
heating and surface pressures are derived here, in the same compiled call that advances all points. Within a frame
the conditions run linearly from the last frame's values to this one's: a frame's values are those at its end.

    plugin = HeatingPlugin(load_vehicle("orbiter"))
    plugin.reset(frame)                    # temperatures of the stacks, conditions of the first frame
    plugin.step(frame)                     # dt is the difference of the frames' times
    plugin.surface_K["V09T9527"]
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sim_heating.atmosphere import derive_kernel
from sim_heating.conditions import FRAME, FloatArray
from sim_heating.effects import EffectUse
from sim_heating.errors import InputError, RunError
from sim_heating.jit import njit
from sim_heating.layout import (
    ALPHA,
    BETA,
    BODYFLAP,
    ELEVON,
    FAILED,
    H_REF,
    JETS,
    LANES,
    LOG10_RE,
    MACH,
    N_CONDITIONS,
    NEGATIVE,
    OUTSIDE,
    P_SURFACE,
    RECOVERY_ENTHALPY,
    TIME,
)
from sim_heating.march import BLOCK_START, advance_groups, begin_groups
from sim_heating.points import point_of_vehicle
from sim_heating.reference_heating.models import reference_kernel, reference_model
from sim_heating.reference_heating.stagnation import COLD_WALL_K
from sim_heating.resolution import pack
from sim_heating.surface_pressure import pressure_below_rise, stagnation_pressure_coefficient
from sim_heating.vehicle import Vehicle

IntArray = NDArray[np.int64]

F_TIME, F_ALTITUDE, F_VELOCITY, F_ALPHA, F_BETA, F_ELEVON, F_BODYFLAP, F_RHO, F_JETS = range(len(FRAME))
CODE, LENGTH, RADIUS, LONGEST_STEP, SHORTEST_STEP, STARTED, SPIKES, LAST_SPIKE, NOW, RHO_NOW, Z_NOW, LAST = range(12)
"""Places in the host array: reference model, reference length [m], nose radius [m], longest and shortest thermal step
[s], whether there was a frame before, what is counted, time, density and altitude of the last frame, and from LAST on
the frame that the temperatures are at."""
PRESSURE_WIDTH = 4
"""Numbers of a pressure model; a point's array holds them and its running length [m]."""

PLAUSIBLE = {
    "altitude_m": (-5e3, 2e6),
    "velocity_m_s": (0.0, 2e4),
    "alpha_deg": (-180.0, 180.0),
    "beta_deg": (-90.0, 90.0),
    "elevon_deg": (-90.0, 90.0),
    "bodyflap_deg": (-90.0, 90.0),
    "rho_kg_m3": (0.0, 100.0),
    "jets": (0.0, 1.0),
}
"""Ranges outside which a host's value is refused."""
_LOWEST = np.array([-1e300] + [PLAUSIBLE[n][0] for n in FRAME[1:]])
_HIGHEST = np.array([1e300] + [PLAUSIBLE[n][1] for n in FRAME[1:]])
GOOD, CLOCK, STUCK = -1, -2, -3
"""Outcomes of a frame; 0 and above name the column that cannot be."""
LONGEST_FRAME_S = 60.0
"""A longer step forward is a jump of the host's clock, not a frame."""
CLOCK_ROUNDING_S = 1e-9
"""Three frames of 1/60 s are 0.05 s, whatever the difference of their rounded times."""
SPIKE = 0.5
"""Change of ln(rho) from frame to frame, over that which the change of altitude explains, that is flagged as a
spike."""
SCALE_HEIGHT_M = 5000.0
"""Smallest scale height of the atmosphere below 120 km, for the density change that altitude explains."""


@njit
def _derive_conditions(
    frame: FloatArray, host: FloatArray, points: FloatArray, lanes: IntArray, then: FloatArray
) -> None:
    """Condition vectors of all lanes (lane, condition) from one frame of the host.

    points : (point, PRESSURE_WIDTH + 1) pressure model and running length of each point
    lanes  : the point in each lane; a lane that fills a group up repeats the one before it
    """
    rho, V, alpha, beta = frame[F_RHO], frame[F_VELOCITY], frame[F_ALPHA], frame[F_BETA]
    code = int(host[CODE])
    T_inf, p_inf, mach, log10_re = derive_kernel(frame[F_ALTITUDE], V, rho, host[LENGTH])
    radius, length = host[RADIUS], -1.0
    h_ref, H_r = 0.0, 0.0
    rise = 0.5 * rho * V * V * stagnation_pressure_coefficient(mach)
    for i in range(len(lanes)):
        if i > 0 and lanes[i] == lanes[i - 1]:
            for c in range(N_CONDITIONS):
                then[i, c] = then[i - 1, c]
            continue
        point = points[lanes[i]]
        if point[PRESSURE_WIDTH] != length:
            length = point[PRESSURE_WIDTH]
            h_ref, H_r = reference_kernel(code, rho, V, T_inf, alpha, radius, length, COLD_WALL_K)
        then[i, ALPHA], then[i, BETA], then[i, LOG10_RE] = alpha, beta, log10_re
        then[i, ELEVON], then[i, BODYFLAP] = frame[F_ELEVON], frame[F_BODYFLAP]
        then[i, P_SURFACE] = pressure_below_rise(
            p_inf, rise, alpha, beta, frame[F_ELEVON], frame[F_BODYFLAP], point[0], point[1], point[2], point[3]
        )
        then[i, H_REF], then[i, RECOVERY_ENTHALPY] = h_ref, H_r
        then[i, JETS], then[i, MACH], then[i, TIME] = frame[F_JETS], mach, frame[F_TIME]


@njit
def _implausible(frame: FloatArray) -> int:
    """Place of the first value that is no number or out of range, GOOD where there is none; density must be above 0."""
    for i in range(len(frame)):
        if not _LOWEST[i] <= frame[i] <= _HIGHEST[i]:
            return i
    return GOOD if frame[F_RHO] > 0.0 else F_RHO


@njit
def _count_spike(frame: FloatArray, host: FloatArray) -> None:
    change = abs(math.log(frame[F_RHO] / host[RHO_NOW]))
    explained = abs(frame[F_ALTITUDE] - host[Z_NOW]) / SCALE_HEIGHT_M
    if change > SPIKE + explained:
        host[SPIKES] += 1.0
        host[LAST_SPIKE] = frame[F_TIME]


@njit
def plugin_frame(
    state: FloatArray, ints: IntArray, table: FloatArray, chain, begin, advance, groups: IntArray,  # type: ignore[no-untyped-def]
    points: FloatArray, lanes: IntArray, then: FloatArray, host: FloatArray, frame: FloatArray,
) -> int:  # fmt: skip
    """Check a frame, derive its conditions and advance all groups to them, or begin with them where it is the first."""
    bad = _implausible(frame)
    if bad != GOOD:
        return bad
    started = host[STARTED] > 0.0
    if started:
        passed = frame[F_TIME] - host[NOW]
        if passed == 0.0:
            return GOOD
        if not 0.0 < passed <= LONGEST_FRAME_S:
            return CLOCK
        _count_spike(frame, host)
    host[STARTED], host[NOW], host[RHO_NOW], host[Z_NOW] = 1.0, frame[F_TIME], frame[F_RHO], frame[F_ALTITUDE]
    dt = frame[F_TIME] - host[LAST + F_TIME]
    if started and dt < host[SHORTEST_STEP] - CLOCK_ROUNDING_S:
        return GOOD
    _derive_conditions(frame, host, points, lanes, then)
    if started:
        steps = math.ceil(dt / host[LONGEST_STEP] - 1e-9)
        advance_groups(state, ints, table, chain, advance, groups, then, dt, max(steps, 1))
    else:
        begin_groups(state, ints, table, chain, begin, groups, then)
    for i in range(len(frame)):
        host[LAST + i] = frame[i]
    failed = 0.0
    for g in range(len(groups)):
        for lane in range(LANES):
            failed += state[groups[g, BLOCK_START] + FAILED * LANES + lane]
    return GOOD if failed == 0.0 else STUCK


@dataclass(frozen=True)
class Flags:
    """What was odd about the frames since the reset.

    density_spikes : frames with a sudden change of density that altitude does not explain
    last_spike_s   : time of the last one [s], None where there was none
    """

    density_spikes: int
    last_spike_s: float | None


@dataclass(frozen=True)
class Snapshot:
    """All state of a plug-in at a time, to go back to."""

    time_s: float
    host: FloatArray
    state: FloatArray


class HeatingPlugin:
    """Temperatures of a vehicle's control points beside a host.

    control_points : names; all of the vehicle's by default
    longest_step_s : longest thermal step [s]; a longer frame is divided
    shortest_step_s: 0 steps with every frame; 0.05 makes a 60 Hz host wait for every third frame, conditions linear
                     over the three, and temperatures stand until then (`heated_s`): a third of the cost
    nodes          : nodes of each point at least; chosen for accuracy (resolution.py) where not given. Fewer cost
                     accuracy and save time
    parameters     : dotted model parameters, the same for all points
    effects        : effects by control point, beside those that the vehicle declares
    """

    def __init__(
        self,
        vehicle: Vehicle,
        control_points: Sequence[str] | None = None,
        *,
        longest_step_s: float = 1.0,
        shortest_step_s: float = 0.0,
        nodes: int | None = None,
        parameters: Mapping[str, float] | None = None,
        effects: Mapping[str, Sequence[EffectUse]] | None = None,
    ) -> None:
        names = list(vehicle.control_points) if control_points is None else list(control_points)
        self.points = [vehicle.control_point(name) for name in names]
        self.names = tuple(names)
        self.longest_step_s = longest_step_s
        models = [point_of_vehicle(vehicle, p, parameters, (effects or {}).get(p.name, ())) for p in self.points]
        if nodes is not None:
            models = [replace(model, nodes=nodes) for model in models]
        self.ensemble = e = pack(models, longest_step_s)
        model = reference_model(vehicle.heating.reference)
        lengths = [p.running_length_m or 1.0 if model.on_plate else 1.0 for p in self.points]
        table = [[*p.pressure.parameters(), length] for p, length in zip(self.points, lengths, strict=True)]
        self._host = np.zeros(LAST + len(FRAME))
        self._host[:STARTED] = (
            model.code, vehicle.reference_length_m, vehicle.heating.nose_radius_m or 1.0,
            longest_step_s, shortest_step_s,
        )  # fmt: skip
        self._arguments = (
            e.state, e.ints, e.table, e.chain, e.begin_handle, e.advance_handle, e.groups,
            np.array(table, dtype=float), e.lanes, np.zeros((len(e.lanes), N_CONDITIONS)), self._host,
        )  # fmt: skip
        self._surface = np.array([p.temperature(0) for p in e.places])
        self._bondline = np.array([p.temperature(m.bondline) for p, m in zip(e.places, e.meshes, strict=True)])

    # Moving ----------------------------------------------------------------------------------------------------------

    def reset(self, frame: FloatArray | Mapping[str, float]) -> None:
        """Start anew: initial temperatures of the stacks at the time and conditions of this frame."""
        values = _values(frame)
        bad = _implausible(values)
        if bad != GOOD:
            raise InputError(_value_problem(values, bad))
        self.ensemble.reset()
        self._host[STARTED:] = 0.0
        plugin_frame(*self._arguments, values)

    def step(self, frame: FloatArray | Mapping[str, float]) -> None:
        """Advance to the time of a frame, conditions linear from the last frame's; the same time again is a pause.

        frame  : values in the order of conditions.FRAME (the fast way), or by name
        raises : InputError for a value that is no number or out of range, and for a clock that goes back or jumps;
                 the state stays as it was; RunError where a step did not converge: reset or restore
        """
        values = _values(frame)
        if self._host[STARTED] == 0.0:
            raise InputError("plug-in: step before reset; call reset with the first frame")
        outcome = plugin_frame(*self._arguments, values)
        if outcome == STUCK:
            self.check()
        if outcome != GOOD:
            raise InputError(self._problem(values, outcome))

    @property
    def time_s(self) -> float:
        """Time of the last frame [s]; not a number before the first."""
        return float(self._host[NOW]) if self._host[STARTED] else float("nan")

    @property
    def heated_s(self) -> float:
        """Time that the temperatures are at [s]: that of the last frame, or up to shortest_step_s before it."""
        return float(self._host[LAST + F_TIME]) if self._host[STARTED] else float("nan")

    @property
    def flags(self) -> Flags:
        """What was odd about the frames since the reset."""
        spikes = int(self._host[SPIKES])
        return Flags(spikes, float(self._host[LAST_SPIKE]) if spikes else None)

    def _problem(self, values: FloatArray, outcome: int) -> str:
        if outcome != CLOCK:
            return _value_problem(values, outcome)
        now, then = self.time_s, values[F_TIME]
        if then < now:
            return f"plug-in: the clock went back from {now:g} to {then:g} s; restore a snapshot or reset"
        return f"plug-in: the clock jumped from {now:g} to {then:g} s; a frame is {LONGEST_FRAME_S:g} s at most"

    # Going back ------------------------------------------------------------------------------------------------------

    def snapshot(self) -> Snapshot:
        """All state now; `restore` goes back to it exactly."""
        return Snapshot(self.time_s, self._host.copy(), self.ensemble.snapshot())

    def restore(self, snapshot: Snapshot) -> None:
        """Go back, or forward, to a snapshot of this plug-in."""
        self.ensemble.restore(snapshot.state)
        self._host[:] = snapshot.host

    # Reading ---------------------------------------------------------------------------------------------------------

    def surface_temperatures(self) -> FloatArray:
        """(point,) surface temperatures [K] in the order of `names`."""
        return self.ensemble.state[self._surface]

    def bondline_temperatures(self) -> FloatArray:
        """(point,) temperatures at the outer face of the last layer [K]."""
        return self.ensemble.state[self._bondline]

    @property
    def surface_K(self) -> dict[str, float]:
        """Surface temperature [K] by control point."""
        return dict(zip(self.names, self.surface_temperatures().tolist(), strict=True))

    @property
    def bondline_K(self) -> dict[str, float]:
        """Bondline temperature [K] by control point."""
        return dict(zip(self.names, self.bondline_temperatures().tolist(), strict=True))

    @property
    def sensors_K(self) -> dict[str, float]:
        """Temperature at each sensor [K] by the name of the sensor, without lag, noise or quantisation."""
        e = self.ensemble
        return {
            sensor.name: float(e.state[place.temperature(node)])
            for point, mesh, place in zip(self.points, e.meshes, e.places, strict=True)
            for sensor, node in zip(point.sensors, mesh.sensors, strict=True)
        }

    @property
    def frames_outside(self) -> dict[str, int]:
        """Frames in which a point's conditions lay outside its ratio table, since the reset; points with none left
        out."""
        return _counted(self.names, self.ensemble.scalars(OUTSIDE))

    @property
    def frames_negative(self) -> dict[str, int]:
        """Frames in which a point's heating ratio was negative, since the reset; points with none left out."""
        return _counted(self.names, self.ensemble.scalars(NEGATIVE))

    def check(self) -> None:
        """raises : RunError naming the points whose step did not converge since the reset."""
        failed = _counted(self.names, self.ensemble.scalars(FAILED))
        if failed:
            raise RunError(f"plug-in, time_s {self.time_s:g}: the thermal step of {', '.join(failed)} did not converge")


def _counted(names: Sequence[str], counts: FloatArray) -> dict[str, int]:
    return {name: int(count) for name, count in zip(names, counts, strict=True) if count > 0}


def _value_problem(values: FloatArray, bad: int) -> str:
    name = FRAME[bad]
    low, high = PLAUSIBLE.get(name, (-np.inf, np.inf))
    rule = f"must be a number from {low:g} to {high:g}" + (", above 0" if name == "rho_kg_m3" else "")
    return f"plug-in, time_s {values[F_TIME]:g}: {name} is {values[bad]:g}; {rule}"


def _values(frame: FloatArray | Mapping[str, float]) -> FloatArray:
    """A frame as (len(FRAME),) float64."""
    if isinstance(frame, np.ndarray):
        if frame.shape != (len(FRAME),) or frame.dtype != np.float64:
            raise InputError(f"plug-in: a frame is {len(FRAME)} float64 values: {', '.join(FRAME)}")
        return frame
    unknown = [name for name in frame if name not in FRAME]
    missing = [name for name in FRAME if name not in frame and name != "jets"]
    if unknown or missing:
        what = f"unknown `{unknown[0]}`" if unknown else f"there is no `{missing[0]}`"
        raise InputError(f"plug-in: {what}; a frame has {', '.join(FRAME)}")
    return np.array([float(frame.get(name, 0.0)) for name in FRAME])
