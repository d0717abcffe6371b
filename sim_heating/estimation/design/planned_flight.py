"""A planned flight: a scenario flown with designed manoeuvres, its distance from limits, and its record."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import RATIO_VARIABLES, Conditions
from sim_heating.base.errors import InputError, UnusualWarning, error_context
from sim_heating.base.files import display_path, raise_problems
from sim_heating.base.kernels.lag import lag_columns
from sim_heating.base.parameters import CLOCK_SKEW, PRESSURE_FACTOR, RECORD_PARAMETERS, SENSOR_PREFIX, SHORT_NAMES
from sim_heating.estimation.design.information import Experiment, experiment
from sim_heating.estimation.inference.observability import constant_variables
from sim_heating.estimation.record_fit import LONGEST_STEP_S, SKEW_SPAN_S, Start, march_times
from sim_heating.estimation.starts import free_start
from sim_heating.heating.ratio.table import RatioTable
from sim_heating.heating.ratio.uncertainty import CORRELATION_LENGTH, node_weights
from sim_heating.inputs.points import conditions_behind_walls, excess_behind_interface, point_of_vehicle
from sim_heating.inputs.pressure_transducer import PressureTransducer, transducer_problems
from sim_heating.inputs.record import Record, Segments, make_record
from sim_heating.inputs.scenario import Design, InstrumentSet, Scenario
from sim_heating.inputs.sensor_model import indicated_temperature, sample_times
from sim_heating.inputs.vehicle import ControlPoint
from sim_heating.march.ensemble import Ensemble, condition_history, histories
from sim_heating.march.history import march_points
from sim_heating.march.linearised import LinearMarch, Track
from sim_heating.march.mesh_choice import meshes_on_flights, pack
from sim_heating.simulation.run import SOURCES, models_of
from sim_heating.simulation.synthesize import declaration, flown_columns, ratio_table_of, turbulent_table_of
from sim_heating.thermal.sampling import Rate
from sim_heating.thermal.stack import Sensor, sensor_problems
from sim_heating.trajectory.flight import Flight, Window
from sim_heating.trajectory.spec import Manoeuvre

ESTIMATED_BY = {
    "popu": ("ratio.d_alpha",),
    "elevon-pulse": ("ratio.d_elevon",),
    "elevon-sweep": ("ratio.d_elevon",),
    "bodyflap-pulse": ("ratio.d_elevon", "ratio.d_bodyflap"),
    "bodyflap-sweep": ("ratio.d_elevon", "ratio.d_bodyflap"),
    "sideslip-doublet": ("ratio.d_beta",),
    "jet-firing": (),
}
"""Kind of manoeuvre -> parameters that it is flown to estimate."""
COATING = "stack.coating.thickness_factor"
NUISANCE = (
    "ratio.scale",
    COATING,
    "stack.rsi.conductivity_factor",
    CLOCK_SKEW.name,
    PRESSURE_FACTOR.name,
)
"""Unknowns in addition to these and to the derivatives of the point's ratio table."""
# the point mass is enough to rank designs: flown in JSBSim, the best one has a bound within half a per cent
# (docs/how_to/manoeuvre_design.md)
SEARCH_TRAJECTORY = {"source": "entry-3dof", "rate_hz": 4.0}
"""Source and rate of the trajectory during a search."""
ALLOWED_RISE_K = 5.0
"""Allowed rise by manoeuvres of a temperature that exceeds its limit without them [K]."""


@dataclass(frozen=True, eq=False)
class Instruments:
    """Thermocouples, their sample rate [Hz], None for the sensors' own, and transducers of the surface pressure."""

    sensors: tuple[Sensor, ...]
    rate_hz: Rate | None = None
    transducers: tuple[PressureTransducer, ...] = ()


@dataclass(frozen=True, eq=False)
class PlannedFlight:
    """A flight with manoeuvres.

    conditions : at the control point
    margins    : distance from each limit, in its unit, not below 0 where it is kept
    """

    manoeuvres: tuple[Manoeuvre, ...]
    flight: Flight
    conditions: Conditions
    margins: dict[str, float]

    @property
    def feasible(self) -> bool:
        """Whether all limits are kept."""
        return all(margin >= 0.0 for margin in self.margins.values())

    @property
    def exceeded_limits(self) -> list[str]:
        """One line for each limit that is exceeded."""
        lines = []
        for name, margin in self.margins.items():
            quantity, _, unit = name.rpartition("_") if "_" in name else (name, "", "")
            if margin < 0.0:
                lines.append(f"{quantity.replace('_', ' ')} exceeds its limit by {-margin:.3g} {unit}".rstrip())
        return lines


class Planner:
    """Flights of a scenario with designed manoeuvres, and the information of their records.

    raises : InputError where the scenario has nothing to design
    """

    def __init__(self, scenario: Scenario) -> None:
        spec = scenario.declared.trajectory
        if spec.source == "recorded":
            raise InputError(
                f"{scenario.path}: a recorded flight cannot be designed; give a source that flies manoeuvres"
            )
        if not spec.manoeuvre:
            raise InputError(f"{scenario.path}: no manoeuvre to design; add a [[trajectory.manoeuvre]]")
        self.scenario = scenario
        self.design: Design = scenario.declared.design or Design()
        self._look_at(_point(scenario, self.design))
        self.targets = _target_parameters(scenario, self.design)
        self.compared = tuple((of_set, self._instruments(of_set)) for of_set in self.design.instruments)
        named = {"parameters": self.targets, "nuisance": self.design.nuisance or (), "prior": self.design.prior}
        named |= {f"instruments `{i.name}`, prior": i.prior for i in self.design.instruments}
        for key, names in named.items():
            with error_context(f"{display_path(scenario.path)}, [design], {key}"):
                self._check_names(tuple(names))

    def _look_at(self, point: ControlPoint) -> None:
        """Take a control point as the one whose thermocouples are read."""
        self.point = point
        self.effects = (*point.effects, *self.scenario.effects(point.name))
        rate_hz, transducers = self.scenario.declared.measurements.rate_hz, tuple(point.declared.transducer)
        self.instruments = Instruments(point.sensors, rate_hz, transducers)

    def at(self, point: ControlPoint) -> Planner:
        """The planner with another control point whose thermocouples are read, and the same flights."""
        other = copy(self)
        other._look_at(point)
        return other

    def _instruments(self, of_set: InstrumentSet) -> Instruments:
        """The instruments of a set at the control point.

        raises : InputError where a sensor lies outside the wall, or two have one name
        """
        where = f"{display_path(self.scenario.path)}, [[design.instruments]] {of_set.name}"
        sensors, construction = of_set.sensors(self.point.sensors), self.point.construction
        problems = [
            f"`sensor[{i}].{key}`: {text}"
            for (i, key), text in sensor_problems(construction.stack, sensors, construction.materials)
        ]
        transducers = self.instruments.transducers if of_set.transducer is None else tuple(of_set.transducer)
        problems += [f"`transducer[{i}].{key}`: {text}" for (i, key), text in transducer_problems(transducers, sensors)]
        raise_problems([f"{where}: {line}" for line in problems])
        return Instruments(sensors, of_set.rate_hz or self.instruments.rate_hz, transducers)

    def _check_names(self, names: Sequence[str]) -> None:
        """Check that names are those of unknowns of a design."""
        model = point_of_vehicle(self.scenario.vehicle, self.point, effects=self.scenario.effects(self.point.name))
        for name in names:
            if name not in RECORD_PARAMETERS and not name.startswith((SENSOR_PREFIX, "initial.")):
                model.definition(name)

    # Flight ----------------------------------------------------------------------------------------------------------

    @cached_property
    def without_manoeuvres(self) -> Flight:
        """The flight without manoeuvres."""
        return self._fly((), searched=True)

    @cached_property
    def _peaks_without(self) -> dict[str, float]:
        return self._peaks(self.without_manoeuvres)

    def _fly(self, manoeuvres: tuple[Manoeuvre, ...], searched: bool) -> Flight:
        spec = self.scenario.declared.trajectory
        spec = spec.model_copy(update={"manoeuvre": manoeuvres, **(SEARCH_TRAJECTORY if searched else {})})
        return SOURCES[spec.source](spec, self.scenario.vehicle)

    def fly(self, manoeuvres: Sequence[Manoeuvre], searched: bool = True) -> PlannedFlight:
        """Fly manoeuvres with the 3-DOF entry, or, not `searched`, with the scenario's own source."""
        flown = tuple(manoeuvres)
        flight = self._fly(flown, searched)
        return PlannedFlight(flown, flight, self.conditions_of(flight), self._margins(flown, flight))

    def conditions_of(self, flight: Flight) -> Conditions:
        """Conditions of a flight at the control point."""
        return conditions_behind_walls(self.scenario.vehicle, [self.point], flight.conditions)[0]

    def interfaces(self, flight: Flight) -> list[dict[str, object]]:
        """Interfaces that the scenario's control points declare, with the largest predicted excess of heating [-]
        behind them along a flight, and in its manoeuvres; the largest first."""
        vehicle = self.scenario.vehicle
        points = [p for n in self.scenario.names if (p := vehicle.control_point(n)).declared.interface is not None]
        flights = conditions_behind_walls(vehicle, points, flight.conditions)
        histories = march_points([point_of_vehicle(vehicle, p) for p in points], flights) if points else []
        during = np.zeros(len(flight.conditions), dtype=bool)
        for w in flight.windows:
            during |= (flight.conditions.time_s >= w.start_s) & (flight.conditions.time_s <= w.end_s)
        rows: list[dict[str, object]] = []
        for p, flown, history in zip(points, flights, histories, strict=True):
            excess = excess_behind_interface(vehicle, p, flown, history.surface_K)
            declared = p.declared.interface
            assert declared is not None
            most = int(np.argmax(np.abs(excess)))
            rows.append(
                {
                    "control_point": p.name,
                    "upstream": declared.upstream,
                    "largest_excess": float(excess[most]),
                    "largest_at_s": float(flown.time_s[most]),
                    "largest_in_manoeuvres": float(np.max(np.abs(excess[during]), initial=0.0)),
                }
            )
        return sorted(rows, key=lambda row: -abs(float(str(row["largest_excess"]))))

    # Limits ----------------------------------------------------------------------------------------------------------

    @cached_property
    def _ensemble(self) -> Ensemble:
        return pack(models_of(self.scenario, self.without_manoeuvres.conditions)[0], LONGEST_STEP_S)

    def _peaks(self, flight: Flight) -> dict[str, float]:
        """Highest surface and bondline temperatures [K] of the control points that have limits."""
        ensemble, vehicle = self._ensemble, self.scenario.vehicle
        points = [vehicle.control_point(name) for name in self.scenario.names]
        flown = histories(conditions_behind_walls(vehicle, points, flight.conditions))
        ensemble.reset()
        nodes = [(0, mesh.bondline) for mesh in ensemble.meshes]
        faces = np.transpose([ensemble.node_offsets(i, n) for i, n in enumerate(nodes)])
        highest = np.max(ensemble.march(flight.conditions.time_s, flown, keep=np.ravel(faces)), axis=0)
        peaks = {f"{p.name} surface_K": float(peak) for p, peak in zip(points, highest, strict=False)}
        for p, peak in zip(points, highest[len(points) :], strict=True):
            if p.limits.bondline_K is not None:
                peaks[f"{p.name} bondline_K"] = float(peak)
        return peaks

    def _margins(self, manoeuvres: tuple[Manoeuvre, ...], flight: Flight) -> dict[str, float]:
        limits, flown = self.design.limits, flight.conditions
        if len(flight.windows) < len(manoeuvres):
            return {"manoeuvres reached": float(len(flight.windows) - len(manoeuvres))}
        margins = {"duration_s": limits.duration_s - max(w.end_s - w.start_s for w in flight.windows)}
        during = np.zeros(len(flown), dtype=bool)
        for w in flight.windows:
            during |= (flown.time_s >= w.start_s) & (flown.time_s <= w.end_s + self.design.after_s)
        if not np.any(during):
            every = float(np.max(np.diff(flown.time_s)))
            raise InputError(f"sample_s: a sample every {every:g} s, none of them during the manoeuvres; take more")
        for name in ("alpha_deg", "elevon_deg", "qbar_Pa"):
            low, high = getattr(limits, name)
            margins[name] = float(min(np.min(flown[name][during]) - low, high - np.max(flown[name][during])))
        # the change against the same flight without manoeuvres: altitude itself changes during any entry
        without = np.interp(
            flown.time_s, self.without_manoeuvres.conditions.time_s, self.without_manoeuvres.conditions["altitude_m"]
        )
        change = np.max(np.abs(flown["altitude_m"] - without)[during])
        margins["altitude_change_m"] = float(limits.altitude_change_m - change)
        if min(margins.values()) < 0.0:
            return margins  # a flight that exceeds these limits needs no march for its temperatures
        return margins | {name: self.limit(name) - peak for name, peak in self._peaks(flight).items()}

    def limit(self, name: str) -> float:
        """Limit of a control point's temperature, such as "V09T9527 surface_K" [K], minus the required margin.

        Where the flight without manoeuvres exceeds it: its peak plus ALLOWED_RISE_K.
        """
        point, _, quantity = name.partition(" ")
        limit = getattr(self.scenario.vehicle.control_point(point).limits, quantity)
        margin = getattr(self.design.limits, quantity.replace("_K", "_margin_K"))
        allowed = float(limit) - margin
        # a point that exceeds its limit anyway would exclude every manoeuvre
        return allowed if self._peaks_without[name] <= allowed else self._peaks_without[name] + ALLOWED_RISE_K

    def over_limit(self) -> list[str]:
        """One line for each temperature that exceeds its limit without any manoeuvre."""
        return [
            f"{name}: {peak:.0f} K without any manoeuvre, above its limit; manoeuvres may add {ALLOWED_RISE_K:g} K"
            for name, peak in self._peaks_without.items()
            if self.limit(name) == peak + ALLOWED_RISE_K
        ]

    # Information -----------------------------------------------------------------------------------------------------

    def names(self, planned: PlannedFlight) -> tuple[str, ...]:
        """Names of the unknowns: the wanted parameters, and the nuisances that the point has and the flight affects."""
        if self.design.nuisance is not None:
            return tuple(dict.fromkeys((*self.targets, *self.design.nuisance)))
        assert self.point.ratio is not None
        derivatives = [
            f"ratio.d_{s}" for s, axis in zip(SHORT_NAMES, self.point.ratio.axes, strict=True) if len(axis) > 1
        ]
        constant = constant_variables(derivatives, [self.record(planned, self.instruments)[0]])
        nuisance = [n for n in NUISANCE if n != COATING or len(self.point.construction.stack.layer) > 1]
        return tuple(dict.fromkeys((*self.targets, *(n for n in derivatives if n not in constant), *nuisance)))

    def priors(self, names: Sequence[str], planned: PlannedFlight) -> dict[str, float]:
        """Standard deviations before the flight: as declared, and of unwanted derivatives those of the table."""
        condition = _mean_condition(planned, self.design)
        table = {n: s for n, s in self._table_sigma(condition).items() if n in names and n not in self.targets}
        return table | self.design.prior

    def _table_sigma(self, condition: FloatArray) -> dict[str, float]:
        """Standard deviation of the table's own derivatives.

        Errors of the ratio with the correlation (1 - d/l)^3 (1 + 3 d/l) of heating/ratio/uncertainty.py, whose second
        derivative at 0 is -12 / l^2, have a slope of standard deviation sqrt(12) sigma / l.
        """
        ratio = self.point.ratio
        if ratio.sigma is None:
            return {}
        sigma = _at_condition(ratio, ratio.sigma, condition)
        return {
            f"ratio.d_{short}": np.sqrt(12.0) * sigma / CORRELATION_LENGTH[v]
            for short, v in zip(SHORT_NAMES, RATIO_VARIABLES, strict=True)
        }

    def mean_ratio(self, planned: PlannedFlight) -> float:
        """Tabulated heating ratio [-] at the mean condition over the times that are read."""
        return _at_condition(self.point.ratio, self.point.ratio.ratio, _mean_condition(planned, self.design))

    def record(self, planned: PlannedFlight, instruments: Instruments) -> tuple[Record, Start | None]:
        """The record of a planned flight, with the model's temperatures as readings, and the start of its march."""
        flown, design = planned.conditions, self.design
        spans = [_span(w, flown, design) for w in planned.flight.windows]
        first, last = spans[0][0], max(end for _, end in spans)
        # earlier than the first reading by the largest skew: shifted readings stay within the march
        begin = max(flown.time_s[0], first - SKEW_SPAN_S) if design.start == "profile" else float(flown.time_s[0])
        clock = sample_times(
            instruments.sensors,
            flown.time_s[0],
            flown.time_s[-1],
            rate_hz=instruments.rate_hz,
            manoeuvres_s=planned.flight.manoeuvres_s,
        )
        clock = clock[(clock >= first) & (clock <= last)]
        start, read = self._marched(flown, instruments.sensors, begin, clock)
        measured = self.point.declared.model_copy(update={"transducer": [*instruments.transducers]})
        declared = declaration(self.scenario, replace(self.point, declared=measured), instruments.sensors)
        declared = declared.model_copy(update={"segments": Segments(fit=[list(s) for s in spans])})
        columns = {s.column: indicated_temperature(s, T) for s, T in zip(instruments.sensors, read, strict=True)}
        columns |= {t.column: np.interp(clock, flown.time_s, flown["p_surface_Pa"]) for t in instruments.transducers}
        tables = ratio_table_of(self.point), turbulent_table_of(self.point)
        with warnings.catch_warnings():  # no file of a user has these columns
            warnings.simplefilter("ignore", UnusualWarning)
            record = make_record(
                declared, flown_columns(flown), {"time_s": clock, **columns}, tables[0], self.point.name, tables[1]
            )
        return record, start if design.start == "profile" else None

    def _marched(
        self, flown: Conditions, sensors: Sequence[Sensor], begin_s: float, clock: FloatArray
    ) -> tuple[Start, FloatArray]:
        """A start at a time with unknown temperatures, and (sensor, sample) temperatures [K]."""
        point = replace(self.point, sensors=tuple(sensors))
        model = point_of_vehicle(self.scenario.vehicle, point, effects=self.scenario.effects(point.name))
        mesh = meshes_on_flights([model], [flown], LONGEST_STEP_S)[0][0]
        times = march_times(flown, flown.time_s[0], float(clock[-1]))
        track = Track(model, mesh, (), np.concatenate([[begin_s], clock]), tuple(range(mesh.nodes)))
        history = condition_history(flown.at(times))[np.newaxis]
        T = LinearMarch([track], times, history).march()[0].temperature_K
        at_sensors = T[list(mesh.sensors)]
        for i, sensor in enumerate(sensors):
            at_sensors[i] = lag_columns(track.sample_s, at_sensors[i][:, np.newaxis], sensor.tau_s, False)[:, 0]
        return free_start(begin_s, T[:, 0], model, mesh), at_sensors[:, 1:]

    def experiment(
        self,
        planned: PlannedFlight,
        names: Sequence[str],
        priors: dict[str, float],
        instruments: Instruments | None = None,
    ) -> Experiment:
        """Expected information of a planned flight on its unknowns."""
        record, start = self.record(planned, instruments or self.instruments)
        return experiment(record, names, effects=self.effects, start=start).with_priors(priors)


def _point(scenario: Scenario, design: Design) -> ControlPoint:
    points = [scenario.vehicle.control_point(n) for n in scenario.names]
    if design.control_point is not None:
        points = [scenario.vehicle.control_point(design.control_point)]
    for point in points:
        if point.sensors:
            return point
    raise InputError(f"{scenario.path}: {points[0].name} has no thermocouple; choose a control point with one")


def _target_parameters(scenario: Scenario, design: Design) -> tuple[str, ...]:
    if design.parameters is not None:
        return tuple(dict.fromkeys(design.parameters))
    names = tuple(dict.fromkeys(n for m in scenario.declared.trajectory.manoeuvre for n in ESTIMATED_BY[m.kind]))
    if not names:
        raise InputError(f"{scenario.path}, [design]: name the `parameters` that the manoeuvre is to estimate")
    return names


def _span(window: Window, flown: Conditions, design: Design) -> tuple[float, float]:
    """Times [s] that are read around a manoeuvre."""
    start = max(window.start_s - design.before_s, flown.time_s[0])
    return float(start), float(min(window.end_s + design.after_s, flown.time_s[-1]))


def _at_condition(table: RatioTable, values: FloatArray, condition: FloatArray) -> float:
    """Values at the nodes of a ratio table [-] at a (5,) condition."""
    return float((node_weights(table.axes, condition[np.newaxis]) @ values.ravel())[0])


def _mean_condition(planned: PlannedFlight, design: Design) -> FloatArray:
    """(5,) mean condition over the times that are read."""
    flown = planned.conditions
    read = np.zeros(len(flown), dtype=bool)
    for window in planned.flight.windows:
        start, end = _span(window, flown, design)
        read |= (flown.time_s >= start) & (flown.time_s <= end)
    return np.array([np.average(flown[v][read], weights=flown.duration_s[read]) for v in RATIO_VARIABLES])
