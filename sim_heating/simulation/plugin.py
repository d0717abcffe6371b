"""The heating plug-in: a vehicle's control points stepped frame by frame alongside a flight simulator.

A host gives the columns of conditions.FRAME; temperature, Mach and Reynolds number, reference heating and surface
pressures are derived from them. Values of a frame, and the temperatures that the host reads after it, are those at its
end. The thermal model takes its own steps (simulation/plugin_kernel.py): one a frame where temperatures or conditions
change quickly, one every `longest_wait_s` where they do not.

    plugin = HeatingPlugin(load_vehicle("orbiter"))
    plugin.reset(frame)                    # temperatures of the stacks, conditions of the first frame
    plugin.step(frame)                     # dt is the difference of the frames' times
    plugin.surface_K["V09T9527"]
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import FRAME, SURFACES
from sim_heating.base.errors import InputError, RunError
from sim_heating.base.kernels.block import N_CONDITIONS
from sim_heating.base.limits import LIMITS, limit_message
from sim_heating.heating.atmosphere import HIGHEST_M
from sim_heating.heating.edge_flow import pack_flows
from sim_heating.heating.effects import EffectUse
from sim_heating.heating.effects.compiled import unusable_value
from sim_heating.heating.reference.models import reference_model
from sim_heating.heating.surroundings import ground_view
from sim_heating.inputs.points import point_of_vehicle, wall_enthalpy_code, wall_enthalpy_of
from sim_heating.inputs.vehicle import ControlPoint, Vehicle, numbers_upstream, walls_upstream
from sim_heating.march.ensemble import Ensemble
from sim_heating.march.mesh_choice import pack
from sim_heating.simulation import plugin_kernel as k

AROUND = "T_surroundings_K"
"""What a frame by name may state in addition to conditions.FRAME."""
NO_WALL = -1.0
"""Place of the wall upstream of a point without an interface."""


@dataclass(frozen=True)
class Flags:
    """Implausible frames since the reset.

    density_spikes : frames with a sudden change of density that altitude does not explain
    last_spike_s   : time of the last one [s]; None without one
    too_fast       : frames above the speed to which the reference heating holds
    too_high       : frames above the table of the atmosphere, 200 km, where the air is taken as at its end
    longest_frame_s : longest time from frame to frame [s]; above 1 s the flight between is assumed
    """

    density_spikes: int
    last_spike_s: float | None
    too_fast: int = 0
    too_high: int = 0
    longest_frame_s: float = 0.0


@dataclass(frozen=True)
class Snapshot:
    """All state of a plug-in at a time, for `HeatingPlugin.restore`."""

    time_s: float
    host: FloatArray
    published: FloatArray
    state: FloatArray


# The corner of a table is met within the wait unseen, at a cost that grows with the square of the wait (decision 0007).
LONGEST_WAIT_S = 0.25
"""Default of the longest time between thermal steps [s]; short, as a ratio table may have a corner ahead."""


_WARM_UP_FRAME = {
    "time_s": 0.0,
    "altitude_m": 70e3,
    "velocity_m_s": 6000.0,
    "alpha_deg": 40.0,
    "beta_deg": 0.0,
    "elevon_deg": 0.0,
    "bodyflap_deg": 0.0,
    "rho_kg_m3": 1e-4,
}
"""A frame within the tables; what it is does not matter."""


class HeatingPlugin:
    """Temperatures of a vehicle's control points alongside a host.

    control_points : names; all of the vehicle's by default
    longest_step_s : longest thermal step [s]; a longer frame is divided
    longest_wait_s : longest time between thermal steps [s]. Temperatures of the frames between are extrapolated
                     from the last step (simulation/plugin_kernel.py), within 0.02 K of a step a frame and 0.1 K of
                     `run` over an entry at 60 Hz; 0 makes a step a frame
    nodes          : nodes of each point at least; chosen for accuracy (march/mesh_choice.py) where not given. Fewer
                     cost accuracy and save time
    parameters     : dotted model parameters, the same for all points
    effects        : effects by control point, in addition to those that the vehicle declares

    Attributes: `names` of the control points; `outputs`, (control point, `surface`, `bondline` or sensor) of each of
    `temperatures()`; `ensemble`, whose state is that at `heated_s`; `constants` of the points as
    simulation/plugin_kernel.py takes them.

    >>> import sim_heating as sh
    >>> plugin = sh.HeatingPlugin(sh.load_vehicle("orbiter"), ["V09T9527"])
    >>> frame = {"time_s": 0.0, "altitude_m": 74e3, "velocity_m_s": 6800.0, "alpha_deg": 40.0, "beta_deg": 0.0,
    ...          "elevon_deg": 1.0, "bodyflap_deg": 15.0, "rho_kg_m3": 4.6e-5}
    >>> plugin.reset(frame)
    >>> for i in range(1, 601):  # ten seconds at 60 Hz
    ...     plugin.step(frame | {"time_s": i / 60.0})
    >>> round(plugin.surface_K["V09T9527"])
    908
    """

    def __init__(
        self,
        vehicle: Vehicle,
        control_points: Sequence[str] | None = None,
        *,
        longest_step_s: float = 1.0,
        longest_wait_s: float = LONGEST_WAIT_S,
        nodes: int | None = None,
        parameters: Mapping[str, float] | None = None,
        effects: Mapping[str, Sequence[EffectUse]] | None = None,
    ) -> None:
        names = list(vehicle.control_points) if control_points is None else list(control_points)
        self._made_of = partial(
            HeatingPlugin,
            vehicle,
            names,
            longest_step_s=longest_step_s,
            longest_wait_s=longest_wait_s,
            nodes=nodes,
            parameters=parameters,
            effects=effects,
        )
        self.points = [vehicle.control_point(name) for name in names]
        self.names = tuple(names)
        # A frame of a vehicle without control surfaces needs no deflections.
        self._spared = ("jets", *(s for s in SURFACES if s not in vehicle.surfaces))
        self.longest_step_s = longest_step_s
        # Walls upstream of an interface are stepped as well, and not published.
        stepped = [*self.points, *walls_upstream(vehicle, self.points)]
        models = [point_of_vehicle(vehicle, p, parameters, (effects or {}).get(p.name, ())) for p in stepped]
        if nodes is not None:
            models = [replace(model, nodes=nodes) for model in models]
        self.ensemble = e = pack(models, longest_step_s, behind=numbers_upstream(vehicle, stepped))
        self.constants = point_constants(vehicle, stepped)
        place_upstream_walls(self.constants.numbers, stepped, e)
        self._host = host_array(vehicle, longest_step_s, longest_wait_s)
        outputs = _outputs(self.points, e)
        self.outputs = tuple((point, output) for point, output, _ in outputs)
        self._published = np.zeros((k.PUBLISHED_ROWS, len(outputs)))
        self._published[k.TAU, 2 * len(names) :] = [s.tau_s for p in self.points for s in p.sensors]
        self.watch = partial(k.watch_frame, self._host, self._published)
        self._arguments = (
            e.lane_groups,
            self.constants,
            e.lanes,
            np.zeros((len(e.lanes), N_CONDITIONS)),
            np.array([offset for _, _, offset in outputs]),
            self._host,
            self._published,
        )

    # Stepping --------------------------------------------------------------------------------------------------------

    def reset(self, frame: FloatArray | Mapping[str, float]) -> None:
        """Start: initial temperatures of the stacks at the time and conditions of this frame."""
        values = self._take_surroundings(frame)
        # Checked before anything changes: after a refused frame the plug-in is as it was.
        invalid = k.implausible(values)
        if invalid != k.GOOD:
            raise InputError(_value_problem(values, invalid))
        self.ensemble.reset()
        # Constants of the vehicle precede STARTED and remain; all that changes follows it.
        self._host[k.STARTED :] = 0.0
        k.heat_points(*self._arguments, values, k.NOT_STARTED)
        self.watch(values)  # a pause, which changes nothing: compiled here, so that no step waits for it

    def warm_up(self) -> None:
        """Compile, or read from the cache, all that `reset` and `step` run; the state stays as it is.

        It takes some 20 s the first time on a machine, and below 0.1 s afterwards. A host that has to keep its rate
        from the first frame on calls it before; `reset` does the same.
        """
        before = self.snapshot()
        self.reset(_WARM_UP_FRAME)
        self.restore(before)

    def step(self, frame: FloatArray | Mapping[str, float]) -> None:
        """Advance to the time of a frame, conditions linear between thermal steps; the same time again is a pause.

        frame  : values in the order of conditions.FRAME (the fast way), or by name; by name it may state
                 T_surroundings_K, which the surface radiates to, in place of what vehicle and stack declare
        raises : InputError for a value that is NaN or out of range, and for a clock that goes back or jumps; the state
                 is unchanged. RunError where a step did not converge: reset or restore
        """
        values = self._take_surroundings(frame)
        outcome = self.watch(values)
        if outcome != k.GOOD:
            self.handle(values, outcome)

    def _take_surroundings(self, frame: FloatArray | Mapping[str, float]) -> FloatArray:
        """Values of a frame; `T_surroundings_K` of it, which an array does not have, holds until the next frame."""
        if isinstance(frame, np.ndarray):
            return _values(frame, self._spared)
        values = _values({name: value for name, value in frame.items() if name != AROUND}, self._spared)
        around, (lowest, highest, rule) = float(frame.get(AROUND, 0.0)), LIMITS[AROUND]
        if AROUND in frame and not lowest <= around <= highest:
            raise InputError(f"plug-in: `{AROUND}` {around:g} {rule}")
        self._host[k.AROUND] = around
        return values

    def handle(self, frame: FloatArray, outcome: int) -> None:
        """Take the thermal steps, or raise the error, that the outcome of `watch` for a frame asks for.

        A caller whose frames are always (len(FRAME),) float64 may call `watch(frame)`, and this where the outcome is
        not GOOD, in place of `step`.
        """
        if outcome in (k.HEAT, k.BEND):
            outcome = k.heat_points(*self._arguments, frame, outcome)
        if outcome == k.NOT_CONVERGED:
            self.check()
        if outcome != k.GOOD:
            raise InputError(self._problem(frame, outcome))

    @property
    def time_s(self) -> float:
        """Time of the last frame [s]; NaN before the first."""
        return float(self._host[k.LAST_FRAME + k.F_TIME]) if self._host[k.STARTED] else float("nan")

    @property
    def heated_s(self) -> float:
        """Time of the last thermal step [s]: that of the last frame, or up to longest_wait_s before it."""
        return float(self._host[k.THERMAL_FRAME + k.F_TIME]) if self._host[k.STARTED] else float("nan")

    @property
    def flags(self) -> Flags:
        """Implausible frames since the reset."""
        host, spikes = self._host, int(self._host[k.SPIKES])
        last_s = float(host[k.LAST_SPIKE]) if spikes else None
        return Flags(spikes, last_s, int(host[k.TOO_FAST]), int(host[k.TOO_HIGH]), float(host[k.LONGEST_FRAME]))

    def remarks(self) -> list[str]:
        """What since the reset lay outside of what the model holds for, a line each."""
        flags, lines = self.flags, []
        if flags.too_fast:
            fastest = self._host[k.FASTEST] / 1e3
            lines.append(f"{flags.too_fast} frames above {fastest:g} km/s, to which the reference heating holds")
        if flags.too_high:
            lines.append(f"{flags.too_high} frames above {HIGHEST_M / 1e3:g} km, where the atmosphere ends")
        if flags.longest_frame_s > k.LONGEST_LINE_S:
            lines.append(
                f"the longest frame has {flags.longest_frame_s:g} s: heated in parts of {k.LONGEST_PART_S:g} s, the "
                "flight between frames linear in time, ln(rho) for the density"
            )
        if flags.density_spikes:
            lines.append(f"{flags.density_spikes} sudden changes of density, the last at {flags.last_spike_s:g} s")
        counted = {"outside the ratio table": self.steps_outside, "of a ratio below 0": self.steps_negative}
        for condition, counts in counted.items():
            lines += [f"{name}: {count} thermal steps {condition}" for name, count in counts.items()]
        return lines

    def _problem(self, values: FloatArray, outcome: int) -> str:
        if outcome == k.NOT_STARTED:
            return "plug-in: step before reset; call reset with the first frame"
        if outcome != k.CLOCK:
            return _value_problem(values, outcome)
        now, then = self.time_s, values[k.F_TIME]
        if then < now:
            return f"plug-in: the clock went back from {now:g} to {then:g} s; restore a snapshot or reset"
        return f"plug-in: the clock jumped from {now:g} to {then:g} s; a frame is {k.LONGEST_FRAME_S:g} s at most"

    # Snapshots -------------------------------------------------------------------------------------------------------

    def snapshot(self) -> Snapshot:
        """All state now; `restore` goes back to it exactly."""
        return Snapshot(self.time_s, self._host.copy(), self._published.copy(), self.ensemble.snapshot())

    def restore(self, snapshot: Snapshot) -> None:
        """Go back, or forward, to a snapshot of this plug-in."""
        self.ensemble.restore(snapshot.state)
        self._host[:] = snapshot.host
        self._published[:] = snapshot.published

    def __reduce__(self) -> tuple[Callable[..., HeatingPlugin], tuple[Any, Snapshot]]:
        """Made again from its vehicle at the present state: addresses of compiled code hold in one process alone."""
        return _plugin_at, (self._made_of, self.snapshot())

    # Reading ---------------------------------------------------------------------------------------------------------

    def temperatures(self) -> FloatArray:
        """Temperatures [K] in the order of `outputs`, as a view that every step overwrites: the fast way to read."""
        return self._published[k.CURRENT]

    def surface_temperatures(self) -> FloatArray:
        """(point,) surface temperatures [K] in the order of `names`."""
        return self._published[k.CURRENT, : len(self.names)].copy()

    def bondline_temperatures(self) -> FloatArray:
        """(point,) temperatures at the outer face of the last layer [K]."""
        return self._published[k.CURRENT, len(self.names) : 2 * len(self.names)].copy()

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
        """Temperature of each sensor [K] by its name, behind its lag, without noise or quantisation."""
        first = 2 * len(self.names)
        names = [sensor for _, sensor in self.outputs[first:]]
        return dict(zip(names, self._published[k.CURRENT, first:].tolist(), strict=True))

    @property
    def steps_outside(self) -> dict[str, int]:
        """Number of thermal steps since the reset that ended outside a point's ratio table; points without one are
        omitted."""
        return _counted(self.names, self.ensemble.counters.steps_outside_table)

    @property
    def steps_negative(self) -> dict[str, int]:
        """Number of thermal steps since the reset that ended with a negative heating ratio; points without one are
        omitted."""
        return _counted(self.names, self.ensemble.counters.steps_of_negative_ratio)

    def check(self) -> None:
        """raises : RunError naming the points whose step did not converge since the reset; an effect that a user
        defined and that has no usable value at the last frame is named with its file."""
        failed = _counted(self.names, self.ensemble.counters.failures)
        if failed:
            lanes, conditions = self.ensemble.lanes.tolist(), self._arguments[3]
            for i, model in enumerate(self.ensemble.models):
                for use in model.effects if model.name in failed else ():
                    history = conditions[lanes.index(i)][np.newaxis]
                    if fault := unusable_value(use, np.array([self.time_s]), history):
                        raise RunError(f"plug-in, {model.name}: {fault}")
            raise RunError(f"plug-in, time_s {self.time_s:g}: the thermal step of {', '.join(failed)} did not converge")


def _plugin_at(make: Callable[[], HeatingPlugin], snapshot: Snapshot) -> HeatingPlugin:
    """A plug-in at a snapshot of another one that is made alike."""
    plugin = make()
    plugin.restore(snapshot)
    return plugin


def point_constants(vehicle: Vehicle, points: Sequence[ControlPoint]) -> k.PointConstants:
    """What the conditions of control points follow from, as plugin_kernel.derive_conditions takes it; a running length
    [m] that the reference heating does not use is 1."""
    on_plate = reference_model(vehicle.heating.reference).on_plate
    # Without a flat plate all points get one length, so that the kernel computes the reference heating once a frame.
    lengths = [p.running_length_m or 1.0 if on_plate else 1.0 for p in points]
    flows, tables = pack_flows([p.flow for p in points])
    cp = wall_enthalpy_code(wall_enthalpy_of(vehicle.heating.wall_enthalpy))
    pressures = [p.pressure.parameters() for p in points]
    rows = zip(pressures, lengths, flows, strict=True)
    numbers = np.array([[*p, x, *flow, NO_WALL, cp, ground_view(p[0], p[1])] for p, x, flow in rows])
    return k.PointConstants(numbers, tables)


def place_upstream_walls(numbers: FloatArray, points: Sequence[ControlPoint], ensemble: Ensemble) -> None:
    """Write where in the state of an ensemble the walls upstream of interfaces are, in the constants of its points."""
    surfaces = {p.name: o.temperature(0) for p, o in zip(points, ensemble.lane_offsets, strict=True)}
    for row, point in zip(numbers, points, strict=True):
        if point.declared.interface is not None:
            row[k.UPSTREAM_PLACE] = surfaces[point.declared.interface.upstream]


def host_array(vehicle: Vehicle, longest_step_s: float = 0.0, longest_wait_s: float = 0.0) -> FloatArray:
    """(HOST_SIZE,) host array of simulation/plugin_kernel.py before the first frame.

    longest_step_s, longest_wait_s : of the thermal model [s]; deriving conditions does not use them
    """
    host = np.zeros(k.HOST_SIZE)
    host[: k.STARTED] = (
        reference_model(vehicle.heating.reference).code,
        vehicle.reference_length_m,
        vehicle.heating.nose_radius_m or 1.0,
        vehicle.heating.sweep_deg or 0.0,
        longest_step_s,
        longest_wait_s,
        reference_model(vehicle.heating.reference).holds_m_s[1],
        float(vehicle.declared.surroundings == "by altitude"),
        0.0,
    )
    return host


def _counted(names: Sequence[str], counts: FloatArray) -> dict[str, int]:
    return {name: int(count) for name, count in zip(names, counts, strict=False) if count > 0}


def _outputs(points: Sequence[ControlPoint], ensemble: Ensemble) -> list[tuple[str, str, int]]:
    """(control point, `surface`, `bondline` or sensor, place in the state): all surfaces, all bondlines, all
    sensors."""
    packed = list(zip(points, ensemble.meshes, ensemble.lane_offsets, strict=False))
    surfaces = [(point.name, "surface", lane.temperature(0)) for point, _, lane in packed]
    bondlines = [(point.name, "bondline", lane.temperature(mesh.bondline)) for point, mesh, lane in packed]
    sensors = [
        (point.name, sensor.name, lane.temperature(node))
        for point, mesh, lane in packed
        for sensor, node in zip(point.sensors, mesh.sensors, strict=True)
    ]
    return surfaces + bondlines + sensors


def _value_problem(values: FloatArray, index: int) -> str:
    return f"plug-in, time_s {values[k.F_TIME]:g}: {FRAME[index]} {limit_message(FRAME[index], float(values[index]))}"


_SHAPE, _DTYPE = (len(FRAME),), np.dtype(np.float64)


def _values(frame: FloatArray | Mapping[str, float], spared: Sequence[str] = ("jets",)) -> FloatArray:
    """A frame as (len(FRAME),) float64; what is spared may be absent, and is 0."""
    if isinstance(frame, np.ndarray):
        if frame.shape != _SHAPE or frame.dtype != _DTYPE:
            raise InputError(f"plug-in: a frame is {len(FRAME)} float64 values: {', '.join(FRAME)}")
        return frame
    problems = [f"unknown `{name}`" for name in frame if name not in FRAME]
    problems += [f"`{name}` is missing" for name in FRAME if name not in {*frame, *spared}]
    if problems:
        raise InputError(f"plug-in: {problems[0]}; a frame has {', '.join(FRAME)}")
    return np.array([float(frame.get(name, 0.0)) for name in FRAME])
