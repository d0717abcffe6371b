"""Many dispersed 3-DOF flights of one base entry, and the conditions that they mean for control points; compiled.

A flight is a TrajectorySpec with its numbers changed (`dispersed`): what flies in compiled code here flies as well in
the 3-DOF entry or in six degrees of freedom. Guidance, schedules and body flap are those planned: what differs is met
by the bank and the elevon.

The compiled part of dispersed entries: many flights, their conditions at control points, parameters of lanes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from sim_heating.base.arrays import FloatArray, IntArray
from sim_heating.base.conditions import FRAME
from sim_heating.base.errors import InputError
from sim_heating.base.kernels.block import H_REF, LANES, N_CONDITIONS, N_PARAMETERS, P_SURFACE, PARAMETERS, Q_ADD, TIME
from sim_heating.base.kernels.jit import njit, pointer
from sim_heating.heating.atmosphere import HIGHEST_M
from sim_heating.heating.ratio.lookup import write_order
from sim_heating.planning.dispersion.spec import Input
from sim_heating.simulation.plugin_kernel import PRESSURE_WIDTH, derive_conditions
from sim_heating.thermal.elements import set_elements
from sim_heating.trajectory import guidance as gd
from sim_heating.trajectory import manoeuvres as mv
from sim_heating.trajectory import point_mass as pm
from sim_heating.trajectory.aero import Aero, load_aero
from sim_heating.trajectory.entry3dof import DEEPEST_M, flight_block, initial_numbers
from sim_heating.trajectory.flight import ROW
from sim_heating.trajectory.spec import Guidance, TrajectorySpec
from sim_heating.trajectory.trimmed_aero import AT_CELLS, ELEVON_HIGH, ELEVON_LOW, aero_block, low_speed_rows

LARGEST = 5.0
"""Standard deviations that a normal deviation stays within: one in two million lies beyond."""
_AERO_FACTORS = ("aero.CN", "aero.CA")


# One flight ---------------------------------------------------------------------------------------------------------


def planned(spec: TrajectorySpec, vehicle_dir: Path) -> TrajectorySpec:
    """The base entry with all that is planned written out: schedules, mass, centre of gravity, moment."""
    guidance = gd.resolve_guidance(spec.guidance, vehicle_dir)
    state = spec.vehicle
    aero = load_aero(vehicle_dir).with_changes(
        mass_kg=state.mass_kg, cg_fraction=state.cg_fraction, cm_shift=state.cm_shift
    )
    flap = state.bodyflap_deg or aero.bodyflap_schedule(guidance.alpha_deg, guidance.alpha_against)
    flown = {"mass_kg": aero.mass_kg, "cg_fraction": aero.cg_fraction, "cm_shift": aero.cm_shift, "bodyflap_deg": flap}
    schedule = {"alpha_deg": guidance.alpha_deg, "alpha_against": guidance.alpha_against}
    return spec.model_copy(
        update={
            "vehicle": state.model_copy(update=flown),
            "guidance": spec.guidance.model_copy(update=schedule),
        }
    )


def dispersed(base: TrajectorySpec, inputs: Sequence[Input], deviations: Mapping[str, float]) -> TrajectorySpec:
    """A planned entry with deviations by input name; `aero.CN` and `aero.CA` are no numbers of an entry and stay."""
    given = {name: value for name, value in deviations.items() if name not in _AERO_FACTORS}
    assert base.initial is not None  # a built-in entry has one
    initial = {key: getattr(base.initial, key) + value for key, value in _of("entry.", given).items()}
    vehicle = {key: getattr(base.vehicle, key) + value for key, value in _of("vehicle.", given).items()}
    vehicle["cm_shift"] = base.vehicle.cm_shift + given.get("aero.Cm", 0.0)
    guidance = {
        key: tuple((x, y + value) for x, y in base.guidance.alpha_deg or ())
        for key, value in _of("guidance.", given).items()
    }
    return base.model_copy(
        update={
            "initial": base.initial.model_copy(update=initial),
            "vehicle": base.vehicle.model_copy(update=vehicle),
            "guidance": base.guidance.model_copy(update=guidance),
            "dispersions": base.dispersions.model_copy(update=_air(base, inputs, given)),
        }
    )


def _of(prefix: str, deviations: Mapping[str, float]) -> dict[str, float]:
    return {n.removeprefix(prefix): v for n, v in deviations.items() if n.startswith(prefix)}


def _air(base: TrajectorySpec, inputs: Sequence[Input], deviations: Mapping[str, float]) -> dict[str, Any]:
    """Density factors and winds over altitude, at all altitudes that any of their profiles names."""
    changed: dict[str, Any] = {}
    for name, key, still in (
        ("air.density", "density_factor", 1.0),
        ("air.wind_north_m_s", "wind_north_m_s", 0.0),
        ("air.wind_east_m_s", "wind_east_m_s", 0.0),
    ):
        own = [(i, f"{name}#{k}") for k, i in enumerate(j for j in inputs if j.name == name)]
        if not own:
            continue
        before = np.array(getattr(base.dispersions, key) or ((0.0, still),))
        profiles = [np.array(i.over) for i, _ in own]
        z = np.unique(np.concatenate([before[:, 0], *(p[:, 0] for p in profiles)]))
        added = sum(
            deviations.get(label, 0.0) * np.interp(z, *p.T) for p, (_, label) in zip(profiles, own, strict=True)
        )
        value = np.interp(z, *before.T)
        value = value * (1.0 + added) if still == 1.0 else value + added
        changed[key] = tuple(zip(z.tolist(), value.tolist(), strict=True))
    return changed


def labels(inputs: Sequence[Input]) -> list[str]:
    """A name of its own for each input: profiles of the air may be several of one name, `air.density#0`, `#1`."""
    count: dict[str, int] = {}
    found = []
    for i in inputs:
        k = count.get(i.name, 0)
        count[i.name] = k + 1
        found.append(f"{i.name}#{k}" if i.over is not None else i.name)
    return found


# Many flights -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Fleet:
    """Everything that many flights of one base share.

    base, guidance, aero : the planned entry
    dt_s, every          : step of the flight, and how many of them from one kept frame to the next
    frames               : most kept frames of a flight
    """

    base: TrajectorySpec
    guidance: Guidance
    aero: Aero
    tables: FloatArray
    script: FloatArray
    dt_s: float
    every: int
    frames: int

    @property
    def sample_s(self) -> float:
        """From one kept frame to the next [s]."""
        return self.dt_s * self.every


def fleet(spec: TrajectorySpec, vehicle_dir: Path, step_s: float, sample_s: float) -> Fleet:
    """Flights of an entry in steps of step_s, kept every sample_s."""
    if spec.source != "entry-3dof":
        raise InputError(f'trajectory: source = "{spec.source}"; dispersed flights need source = "entry-3dof"')
    base = planned(spec, vehicle_dir)
    aero = load_aero(vehicle_dir)
    every = round(sample_s / step_s)
    return Fleet(
        base, gd.resolve_guidance(base.guidance, vehicle_dir), aero,
        aero_block(aero, low_speed_rows(vehicle_dir, aero.basic.mach[0])), mv.compile_script(base.manoeuvre),
        step_s, every, int(np.ceil(spec.stop.time_s / (step_s * every))) + 1,
    )  # fmt: skip


@dataclass(frozen=True)
class Flown:
    """Kept frames of many flights.

    rows    : (flight, frame, len(ROW));  filled : (flight,) how many frames of each
    outcome : (flight,) WHOLE, ENDLESS or GONE;  end_s : (flight,) [s];  untrimmed_s : elevon at the end of its travel
    """

    rows: FloatArray
    filled: IntArray
    outcome: IntArray
    end_s: FloatArray
    untrimmed_s: FloatArray


def fly_many(fleet: Fleet, inputs: Sequence[Input], deviations: Sequence[Mapping[str, float]]) -> Flown:
    """Fly once for each set of deviations, by label."""
    specs = [dispersed(fleet.base, inputs, d) for d in deviations]
    count = len(specs)
    initial = np.array([initial_numbers(s.initial) for s in specs if s.initial is not None])
    flights = np.array([flight_block(s, _flown_aero(fleet, s), fleet.guidance) for s in specs])
    blocks = np.array([_guidance_block(fleet, s) for s in specs])
    factors = np.array([[1.0 + d.get(name, 0.0) for name in _AERO_FACTORS] for d in deviations])
    rows = np.empty((count, fleet.frames, len(ROW)))
    filled, outcome = np.zeros(count, dtype=np.int64), np.zeros(count, dtype=np.int64)
    end_s, untrimmed_s = np.zeros(count), np.zeros(count)
    fly_kernel(
        initial, flights, blocks, fleet.script, fleet.tables, factors, fleet.dt_s, fleet.every,
        rows, filled, outcome, end_s, untrimmed_s,
    )  # fmt: skip
    return Flown(rows, filled, outcome, end_s, untrimmed_s)


def _flown_aero(fleet: Fleet, spec: TrajectorySpec) -> Aero:
    state = spec.vehicle
    return replace(
        fleet.aero,
        mass_kg=float(state.mass_kg or 0.0),
        cg_fraction=float(state.cg_fraction or 0.0),
        cm_shift=float(state.cm_shift),
    )


def _guidance_block(fleet: Fleet, spec: TrajectorySpec) -> FloatArray:
    own = fleet.guidance.model_copy(update={"alpha_deg": spec.guidance.alpha_deg})
    return gd.guidance_block(own, spec.initial.bank_deg if spec.initial is not None else 0.0)


WHOLE, ENDLESS, GONE = range(3)
"""How a flight went: to its stop; on beyond the longest time; out of the atmosphere or into no number."""
POINT_NUMBERS = PRESSURE_WIDTH + 1
"""Numbers of a point in `condition_kernel`: its pressure model and its running length [m]."""
_ELEVON, _FRAME = ROW.index("elevon_deg"), len(FRAME)


@njit
def scale_aero(aero: FloatArray, cn: float, ca: float, out: FloatArray) -> None:
    """A vehicle's aerodynamic block with all CN and CA times a factor."""
    cells = int(aero[AT_CELLS])
    for i in range(len(aero)):
        place = (i - cells) % 3
        out[i] = aero[i] * (1.0 if i < cells or place == 2 else cn if place == 0 else ca)


@njit
def fly_kernel(
    initial: FloatArray, flights: FloatArray, blocks: FloatArray, script: FloatArray, tables: FloatArray,
    factors: FloatArray, dt_s: float, every: int, rows: FloatArray, filled: IntArray, outcome: IntArray,
    end_s: FloatArray, untrimmed_s: FloatArray,
) -> None:  # fmt: skip
    """All flights one after the other; arrays as in `fly_many`, outputs last."""
    manoeuvres, frames = int(script[0]), rows.shape[1]
    state, work, row = np.empty(pm.STARTED + manoeuvres), np.zeros(pm.WORK), np.empty(rows.shape[2])
    aero = np.empty(len(tables))
    for f in range(len(flights)):
        scale_aero(tables, factors[f, 0], factors[f, 1], aero)
        pm.first_state_kernel(initial[f], flights[f], blocks[f], manoeuvres, state)
        outcome[f], k = ENDLESS, 0
        while k < frames * every:
            going = pm.step_kernel(
                pointer(state),
                pointer(flights[f]),
                pointer(blocks[f]),
                pointer(script),
                pointer(aero),
                dt_s,
                pointer(work),
                pointer(row),
            )
            if not DEEPEST_M <= row[1] <= HIGHEST_M or not row[2] < np.inf:
                outcome[f] = GONE
                break
            if k % every == 0:
                rows[f, k // every] = row
                filled[f] = k // every + 1
            untrimmed_s[f] += dt_s if not flights[f, ELEVON_LOW] < row[_ELEVON] < flights[f, ELEVON_HIGH] else 0.0
            k += 1
            if not going:
                outcome[f] = WHOLE
                break
        end_s[f] = row[0]


@njit
def condition_kernel(
    rows: FloatArray, filled: IntArray, host: FloatArray, points: FloatArray, still: FloatArray, time_s: FloatArray,
    histories: FloatArray,
) -> None:  # fmt: skip
    """Conditions of all points along some flights, and behind the end of each those of its soak.

    host      : as plugin_kernel.derive_conditions reads it
    points    : (point, PRESSURE_WIDTH + 1);  still : (point, 3) h_ref, p_surface, q_add of the soak
    time_s    : (time,) frames of the flights, then soak
    histories : (point, flight, time, condition), filled
    """
    lanes = np.arange(len(points))
    then = np.zeros((len(points), N_CONDITIONS))
    for f in range(len(rows)):
        for k in range(len(time_s)):
            if k < filled[f]:
                derive_conditions(rows[f, k, :_FRAME], host, points, lanes, then)
            for p in range(len(points)):
                if k >= filled[f]:
                    then[p, H_REF], then[p, P_SURFACE], then[p, Q_ADD] = still[p, 0], still[p, 1], still[p, 2]
                then[p, TIME] = time_s[k]
                for c in range(N_CONDITIONS):
                    histories[p, f, k, c] = then[p, c]
        then[:, Q_ADD] = 0.0


@njit
def set_lanes(
    B: FloatArray, J: IntArray, layer: IntArray, length_m: FloatArray, density: FloatArray, insulation: int,
    bondline: int, stacks: FloatArray, heating: FloatArray,
) -> None:  # fmt: skip
    """Write thermal and heating parameters of each lane, (LANES, values), into the block of one control point."""
    for lane in range(LANES):
        set_elements(B, J, lane, layer, length_m, density, insulation, bondline, stacks[lane])
        p = PARAMETERS * LANES + lane * N_PARAMETERS
        for k in range(N_PARAMETERS):
            B[p + k] = heating[lane, k]
        write_order(B, p)
