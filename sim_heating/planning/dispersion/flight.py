"""Many dispersed 3-DOF flights of one planned entry, and the conditions at control points along them; compiled.

A flight is a TrajectorySpec with its numbers changed (`entry_with_deviations`), so that it can be flown by this module,
by the 3-DOF entry, or in six degrees of freedom. Guidance, schedules and body flap are those planned: deviations are
met by the bank and the elevon.

The file follows one flight (deviations, atmosphere, names of the inputs), then the sampler that flies many, then the
kernels: one integrates the flights, two derive the conditions of all control points along them, two find extremes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from sim_heating.base.arrays import FloatArray, IntArray
from sim_heating.base.conditions import FRAME
from sim_heating.base.errors import InputError
from sim_heating.base.kernels.block import H_REF, N_CONDITIONS, P_SURFACE, SURROUNDINGS, TIME, UPSTREAM
from sim_heating.base.kernels.jit import njit
from sim_heating.base.kernels.operations import pointer
from sim_heating.heating.atmosphere import HIGHEST_M
from sim_heating.heating.interface import upstream_enthalpy
from sim_heating.planning.dispersion.spec import DispersedInput
from sim_heating.simulation.plugin_kernel import PointConstants, derive_conditions
from sim_heating.trajectory import guidance as gd
from sim_heating.trajectory import manoeuvres as mv
from sim_heating.trajectory import point_mass as pm
from sim_heating.trajectory.aero import Aero, load_aero
from sim_heating.trajectory.entry3dof import DEEPEST_M, flight_block, initial_numbers
from sim_heating.trajectory.flight import ROW
from sim_heating.trajectory.spec import Guidance, TrajectorySpec
from sim_heating.trajectory.trimmed_aero import AT_CELLS, ELEVON_HIGH, ELEVON_LOW, aero_block, low_speed_rows

AERO_FACTORS = ("aero.CN", "aero.CA")
"""Inputs that are factors on the aerodynamic block; no number of a TrajectorySpec holds them."""


# One flight ----------------------------------------------------------------------------------------------------------


def planned_entry(spec: TrajectorySpec, vehicle_dir: Path) -> TrajectorySpec:
    """The base entry with everything planned written out: schedules, mass, centre of gravity, pitching moment."""
    guidance = gd.resolve_guidance(spec.guidance, vehicle_dir)
    state = spec.vehicle
    aero = load_aero(vehicle_dir).with_changes(
        mass_kg=state.mass_kg, cg_fraction=state.cg_fraction, cm_shift=state.cm_shift
    )
    # The schedule of the planned vehicle: in flight the deviations are unknown, and the elevon trims them.
    flap = state.bodyflap_deg or aero.bodyflap_schedule(guidance.alpha_deg, guidance.alpha_against)
    planned = {
        "mass_kg": aero.mass_kg,
        "cg_fraction": aero.cg_fraction,
        "cm_shift": aero.cm_shift,
        "bodyflap_deg": flap,
    }
    schedule = {"alpha_deg": guidance.alpha_deg, "alpha_against": guidance.alpha_against}
    return spec.model_copy(
        update={
            "vehicle": state.model_copy(update=planned),
            "guidance": spec.guidance.model_copy(update=schedule),
        }
    )


def entry_with_deviations(
    base: TrajectorySpec,
    inputs: Sequence[DispersedInput],
    deviations: Mapping[str, float],
    profiles: Sequence[AirProfiles] | None = None,
) -> TrajectorySpec:
    """A planned entry with deviations by the label of their input, in its unit; AERO_FACTORS are left out.

    profiles : density factors and winds that the inputs disperse, where many flights share them
    """
    flown = {name: value for name, value in deviations.items() if name not in AERO_FACTORS}
    assert base.initial is not None  # a built-in entry has one
    initial = {key: getattr(base.initial, key) + value for key, value in _below(flown, "entry.").items()}
    vehicle = {key: getattr(base.vehicle, key) + value for key, value in _below(flown, "vehicle.").items()}
    vehicle["cm_shift"] = base.vehicle.cm_shift + flown.get("aero.Cm", 0.0)
    guidance = {
        key: tuple((x, y + value) for x, y in base.guidance.alpha_deg or ())
        for key, value in _below(flown, "guidance.").items()
    }
    return base.model_copy(
        update={
            "initial": base.initial.model_copy(update=initial),
            "vehicle": base.vehicle.model_copy(update=vehicle),
            "guidance": base.guidance.model_copy(update=guidance),
            "dispersions": base.dispersions.model_copy(
                update=_atmosphere(air_profiles(base, inputs) if profiles is None else profiles, flown)
            ),
        }
    )


def _below(deviations: Mapping[str, float], prefix: str) -> dict[str, float]:
    """Deviations whose names begin with a prefix, without it."""
    return {n.removeprefix(prefix): v for n, v in deviations.items() if n.startswith(prefix)}


class AirProfiles(NamedTuple):
    """A density factor or a wind over altitude: as planned, and the profiles of the inputs that disperse it.

    name, key  : of the inputs, and of `Dispersions`
    relative   : whether a profile is a part of the planned value, as of the density, or an amount, as of a wind
    altitude_m : all altitudes that any of them names
    planned    : at these altitudes;  added : one array an input, for a deviation of 1
    """

    name: str
    key: str
    relative: bool
    altitude_m: list[float]
    planned: FloatArray
    added: list[FloatArray]


def air_profiles(base: TrajectorySpec, inputs: Sequence[DispersedInput]) -> list[AirProfiles]:
    """Density factors and winds that the inputs disperse."""
    profiles_of_air = []
    for name, key, neutral in (
        ("air.density", "density_factor", 1.0),
        ("air.wind_north_m_s", "wind_north_m_s", 0.0),
        ("air.wind_east_m_s", "wind_east_m_s", 0.0),
    ):
        profiles = [np.array(i.over) for i in inputs if i.name == name]
        if not profiles:
            continue
        planned = np.array(getattr(base.dispersions, key) or ((0.0, neutral),))
        z = np.unique(np.concatenate([planned[:, 0], *(p[:, 0] for p in profiles)]))
        added = [np.interp(z, *profile.T) for profile in profiles]
        profiles_of_air.append(AirProfiles(name, key, neutral == 1.0, z.tolist(), np.interp(z, *planned.T), added))
    return profiles_of_air


def _atmosphere(profiles: Sequence[AirProfiles], deviations: Mapping[str, float]) -> dict[str, Any]:
    """Density factors and winds over altitude of one flight."""
    changed: dict[str, Any] = {}
    for p in profiles:
        added = sum(deviations.get(f"{p.name}#{k}", 0.0) * profile for k, profile in enumerate(p.added))
        # Density deviates relatively, a wind by an amount.
        value = p.planned * (1.0 + added) if p.relative else p.planned + added
        changed[p.key] = tuple(zip(p.altitude_m, value.tolist(), strict=True))
    return changed


def input_labels(inputs: Sequence[DispersedInput]) -> list[str]:
    """A unique label for each input: several profiles of one name become `air.density#0`, `air.density#1`."""
    count: dict[str, int] = {}
    labels = []
    for i in inputs:
        k = count.get(i.name, 0)
        count[i.name] = k + 1
        labels.append(f"{i.name}#{k}" if i.over is not None else i.name)
    return labels


# Many flights --------------------------------------------------------------------------------------------------------


class SampledFlights(NamedTuple):
    """Kept frames of many flights.

    rows         : (flight, frame, len(ROW))
    frame_counts : (flight,) frames of each that are filled
    outcome      : (flight,) COMPLETED, NOT_STOPPED or LEFT_ATMOSPHERE
    end_s        : (flight,) time of the last step [s]
    untrimmed_s  : (flight,) time with the elevon at an end of its travel [s]
    """

    rows: FloatArray
    frame_counts: IntArray
    outcome: IntArray
    end_s: FloatArray
    untrimmed_s: FloatArray

    def chosen(self, flights: IntArray) -> SampledFlights:
        """Some of the flights, by their numbers."""
        rows, counts, outcome, end_s, untrimmed_s = self
        return SampledFlights(rows[flights], counts[flights], outcome[flights], end_s[flights], untrimmed_s[flights])


class EntryNumbers(NamedTuple):
    """What differs between flights, one row a flight, as `fly_kernel` takes it.

    initial  : numbers of the initial state
    vehicle  : flight blocks: mass, reference lengths, schedules, atmosphere
    guidance : guidance blocks
    factors  : (flight, 2) on CN and CA [-]
    """

    initial: FloatArray
    vehicle: FloatArray
    guidance: FloatArray
    factors: FloatArray


@dataclass(frozen=True)
class EntrySampler:
    """Flies dispersed entries; it holds everything that they share.

    base, guidance, aero : the planned entry
    tables, script       : its aerodynamic block and its manoeuvres, as the kernels take them
    dt_s                 : step of the flight [s];  every : steps from one kept frame to the next
    frames               : largest number of kept frames of a flight
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
        """Interval between kept frames [s]."""
        return self.dt_s * self.every

    def fly(self, inputs: Sequence[DispersedInput], deviations: Sequence[Mapping[str, float]]) -> SampledFlights:
        """Fly once for each set of deviations, given by the labels of the inputs."""
        profiles = air_profiles(self.base, inputs)
        specs = [entry_with_deviations(self.base, inputs, d, profiles) for d in deviations]
        count = len(specs)
        entries = EntryNumbers(
            np.array([initial_numbers(s.initial) for s in specs if s.initial is not None]),
            np.array([flight_block(s, self._aero(s), self.guidance) for s in specs]),
            np.array([self._guidance_block(s) for s in specs]),
            np.array([[1.0 + d.get(name, 0.0) for name in AERO_FACTORS] for d in deviations]),
        )
        flights = SampledFlights(
            np.empty((count, self.frames, len(ROW))),
            np.zeros(count, dtype=np.int64),
            np.zeros(count, dtype=np.int64),
            np.zeros(count),
            np.zeros(count),
        )
        fly_kernel(entries, self.script, self.tables, self.dt_s, self.every, flights)
        return flights

    def _aero(self, spec: TrajectorySpec) -> Aero:
        state = spec.vehicle
        return replace(
            self.aero,
            mass_kg=float(state.mass_kg or 0.0),
            cg_fraction=float(state.cg_fraction or 0.0),
            cm_shift=float(state.cm_shift),
        )

    def _guidance_block(self, spec: TrajectorySpec) -> FloatArray:
        guidance = self.guidance.model_copy(update={"alpha_deg": spec.guidance.alpha_deg})
        return gd.guidance_block(guidance, spec.initial.bank_deg if spec.initial is not None else 0.0)


def entry_sampler(spec: TrajectorySpec, vehicle_dir: Path, step_s: float, sample_s: float) -> EntrySampler:
    """A sampler of an entry, flown in steps of step_s [s] with a frame kept every sample_s [s].

    raises : InputError where the trajectory is not that of the built-in 3-DOF entry
    """
    if spec.source != "entry-3dof":
        raise InputError(f'trajectory: source = "{spec.source}"; dispersed flights need source = "entry-3dof"')
    base = planned_entry(spec, vehicle_dir)
    aero = load_aero(vehicle_dir)
    every = round(sample_s / step_s)
    return EntrySampler(
        base,
        gd.resolve_guidance(base.guidance, vehicle_dir),
        aero,
        aero_block(aero, low_speed_rows(vehicle_dir, aero.basic.mach[0])),
        mv.compile_script(base.manoeuvre),
        step_s,
        every,
        int(np.ceil(spec.stop.time_s / (step_s * every))) + 1,
    )


# Kernels -------------------------------------------------------------------------------------------------------------

COMPLETED, NOT_STOPPED, LEFT_ATMOSPHERE = range(3)
"""Outcome of a flight: it met its stop; it flew on beyond the longest time; it left the atmosphere or diverged."""
_ELEVON, _FRAME = ROW.index("elevon_deg"), len(FRAME)


@njit
def scale_aero(aero: FloatArray, cn: float, ca: float, out: FloatArray) -> None:
    """Write a vehicle's aerodynamic block with all CN and CA times a factor [-] into `out`."""
    cells = int(aero[AT_CELLS])
    for i in range(len(aero)):
        # Cells hold CN, CA, Cm in turn, behind the axes.
        coefficient = (i - cells) % 3
        out[i] = aero[i] * (1.0 if i < cells or coefficient == 2 else cn if coefficient == 0 else ca)


@njit
def fly_kernel(
    entries: EntryNumbers, script: FloatArray, tables: FloatArray, dt_s: float, every: int, flights: SampledFlights
) -> None:
    """Integrate all flights one after the other.

    script, tables : manoeuvres and aerodynamic block of the planned entry
    dt_s, every    : step of the flight [s], and steps from one kept frame to the next
    flights        : filled
    """
    manoeuvres, frames = int(script[0]), flights.rows.shape[1]
    state, work, row = np.empty(pm.STARTED + manoeuvres), np.zeros(pm.WORK), np.empty(flights.rows.shape[2])
    aero = np.empty(len(tables))
    for f in range(len(entries.vehicle)):
        vehicle, guidance = entries.vehicle[f], entries.guidance[f]
        scale_aero(tables, entries.factors[f, 0], entries.factors[f, 1], aero)
        pm.first_state_kernel(entries.initial[f], vehicle, guidance, manoeuvres, state)
        flights.outcome[f], k = NOT_STOPPED, 0
        while k < frames * every:
            going = pm.step_kernel(
                pointer(state),
                pointer(vehicle),
                pointer(guidance),
                pointer(script),
                pointer(aero),
                dt_s,
                pointer(work),
                pointer(row),
                k % every == 0,
            )
            # `not <=` catches an altitude that is NaN as well.
            if not DEEPEST_M <= row[1] <= HIGHEST_M or not row[2] < np.inf:
                flights.outcome[f] = LEFT_ATMOSPHERE
                break
            if k % every == 0:
                flights.rows[f, k // every] = row
                flights.frame_counts[f] = k // every + 1
            # a vehicle without an elevon, whose travel is 0, trims by its centre of gravity
            trimmed = vehicle[ELEVON_LOW] < row[_ELEVON] < vehicle[ELEVON_HIGH]
            has_elevon = vehicle[ELEVON_LOW] < vehicle[ELEVON_HIGH]
            flights.untrimmed_s[f] += dt_s if has_elevon and not trimmed else 0.0
            k += 1
            if not going:
                flights.outcome[f] = COMPLETED
                break
        flights.end_s[f] = row[0]


@njit
def condition_kernel(
    rows: FloatArray,
    frame_counts: IntArray,
    host: FloatArray,
    points: PointConstants,
    soak: FloatArray,
    time_s: FloatArray,
    histories: FloatArray,
) -> None:
    """Conditions of all points along some flights, and behind the end of each flight those of its soak.

    rows, frame_counts : kept frames, as SampledFlights holds them
    host, points       : as plugin_kernel.derive_conditions takes them
    soak               : (3,) h_ref [kg/(m2 s)], p_surface [Pa] and surroundings [K] of the soak
    time_s             : (time,) frames of the flights, then those of the soak [s]
    histories          : (point, flight, time, condition), filled
    """
    lanes = np.arange(len(points.numbers))
    then = np.zeros((len(points.numbers), N_CONDITIONS))
    for f in range(len(rows)):
        for k in range(len(time_s)):
            if k < frame_counts[f]:
                derive_conditions(rows[f, k, :_FRAME], host, points, lanes, then)
            for p in range(len(points.numbers)):
                if k >= frame_counts[f]:
                    then[p, H_REF], then[p, P_SURFACE], then[p, SURROUNDINGS] = soak[0], soak[1], soak[2]
                then[p, TIME] = time_s[k]
                for c in range(N_CONDITIONS):
                    histories[p, f, k, c] = then[p, c]
        then[:, SURROUNDINGS] = 0.0


@njit
def upstream_wall_kernel(outputs: FloatArray, cp_J_kgK: float, history: FloatArray) -> None:
    """Write the enthalpy of air at the wall upstream of a point's interface into the conditions of the point.

    outputs  : (time, 2 flight) surface and bondline of that wall [K], the quantities of the first flight, of the second
    cp_J_kgK : of that air [J/(kg K)], 0 for equilibrium air;  history : (flight, time, condition) of the point
    """
    for f in range(len(history)):
        for k in range(len(outputs)):
            history[f, k, UPSTREAM] = upstream_enthalpy(outputs[k, 2 * f], history[f, k, P_SURFACE], cp_J_kgK)


@njit
def peak_kernel(outputs: FloatArray, sample_counts: IntArray, peaks: FloatArray) -> None:
    """Largest numbers of one point along some flights, NaN where any of them is NaN.

    outputs       : (time, flight * quantity), the quantities of the first flight, of the second
    sample_counts : (flight,) times that belong to each;  peaks : (flight, quantity), filled
    """
    quantities = peaks.shape[1]
    for f in range(len(peaks)):
        for q in range(quantities):
            peak = outputs[0, f * quantities + q]
            for k in range(1, sample_counts[f]):
                value = outputs[k, f * quantities + q]
                peak = value if value > peak or value != value else peak
            peaks[f, q] = peak


@njit
def extent_kernel(history: FloatArray, frame_counts: IntArray, extent: FloatArray) -> None:
    """Least and largest of the first conditions along some flights, NaN where any of them is NaN.

    history : (flight, time, condition);  frame_counts : (flight,);  extent : (flight, 2, condition), filled
    """
    for f in range(len(extent)):
        for c in range(extent.shape[2]):
            least = largest = history[f, 0, c]
            for k in range(1, frame_counts[f]):
                value = history[f, k, c]
                least = value if value < least or value != value else least
                largest = value if value > largest or value != value else largest
            extent[f, 0, c], extent[f, 1, c] = least, largest
