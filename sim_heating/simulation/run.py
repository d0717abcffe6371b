"""Fly a scenario and predict the temperatures: trajectory, heating, march, comparison, files."""

from __future__ import annotations

import os
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import RATIO_VARIABLES, Conditions
from sim_heating.base.errors import InputError, error_context, failure_context
from sim_heating.base.files import display_path, output_directory, suggestion, write_csv, write_json
from sim_heating.base.files.package import package_version
from sim_heating.base.files.text import write_bytes_atomic
from sim_heating.base.progress import Progress, no_progress
from sim_heating.credibility.facts.of_flight import facts_of_flight
from sim_heating.credibility.statement import Facts, Statement, assess
from sim_heating.heating.ratio.lookup import table_ratios_at
from sim_heating.heating.reference.models import beyond_range
from sim_heating.inputs.points import conditions_behind_walls, mean_condition, point_of_vehicle
from sim_heating.inputs.record import pooled_rmse_K
from sim_heating.inputs.scenario import MeasuredHistory, Scenario, load_scenario
from sim_heating.inputs.vehicle import ControlPoint
from sim_heating.march.history import PointHistory, march_points, point_summary, table_excursions
from sim_heating.march.point import PointModel
from sim_heating.simulation.hdf5_times import without_times
from sim_heating.simulation.plugin import HeatingPlugin
from sim_heating.simulation.results import histories_dataset, run_table, write_heating_csv, write_temperatures_csv
from sim_heating.trajectory import entry3dof, recorded
from sim_heating.trajectory.flight import Flight, OnFrame, VehicleData, Window, check_samples
from sim_heating.trajectory.spec import TrajectorySpec

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

    from sim_heating.base.report.page import Page


def fly_fmu(
    spec: TrajectorySpec, vehicle: VehicleData, *, on_frame: OnFrame | None = None, progress: Progress | None = None
) -> Flight:
    """`trajectory.fmu.flight.fly`, imported when it is used: FMPy and pint are slow to import."""
    from sim_heating.trajectory.fmu import require_fmpy

    require_fmpy()
    from sim_heating.trajectory.fmu import flight as fmu

    return fmu.fly(spec, vehicle, on_frame=on_frame, progress=progress)


def fly_jsbsim(
    spec: TrajectorySpec, vehicle: VehicleData, *, on_frame: OnFrame | None = None, progress: Progress | None = None
) -> Flight:
    """`trajectory.jsbsim.entry.fly`, imported when it is used: not every platform has JSBSim."""
    from sim_heating.trajectory.jsbsim import entry

    return entry.fly(spec, vehicle, on_frame=on_frame, progress=progress)


SOURCES = {"jsbsim": fly_jsbsim, "entry-3dof": entry3dof.fly, "recorded": recorded.fly, "fmu": fly_fmu}

MANOEUVRE_VARIABLE = {
    "popu": "alpha_deg",
    "elevon-pulse": "elevon_deg",
    "elevon-sweep": "elevon_deg",
    "bodyflap-pulse": "bodyflap_deg",
    "bodyflap-sweep": "bodyflap_deg",
    "sideslip-doublet": "beta_deg",
    "jet-firing": "jets",
}
"""Column of the conditions that a manoeuvre varies."""
SUMMARY, CONDITIONS, HISTORIES = "summary.json", "conditions.csv", "flight.nc"
OF_POINT = TABLE, HEATING = "temperatures.csv", "heating.csv"
"""Files of each control point."""
TRAJECTORY, TEMPERATURES, HEAT, COMPARED = "trajectory.png", "temperatures.png", "heating.png", "compared.png"
PAGE = "report.html"
FLIGHT_FRACTION = 0.7
"""Fraction of the time of a run that its flight takes."""
PLOTTED_POINTS = 3
"""Control points drawn for one manoeuvre: those whose surface temperature responds most."""
RESPONSE_S = 5.0
"""Time after a manoeuvre in which a surface still responds to it [s]."""
PLOTTED_RESPONSE_K = 2.0
"""A surface with a smaller response [K] is drawn only where none has a larger one."""


@dataclass(frozen=True)
class PointResult:
    """One control point of a flown scenario."""

    model: PointModel
    conditions: Conditions
    history: PointHistory


@dataclass(frozen=True, repr=False)
class RunResult:
    """Results of a run: the flight of a scenario and the temperatures along it.

    scenario       : what was flown
    flight         : conditions, manoeuvres and events of the trajectory
    points         : conditions and temperatures by control point, in the scenario's order
    plugin_apart_K : largest difference of surface temperature between the plug-in alongside the host and the march, by
                     control point [K]; None where the plug-in did not run
    """

    scenario: Scenario
    flight: Flight
    points: dict[str, PointResult]
    plugin_apart_K: dict[str, float] | None = None

    def __repr__(self) -> str:
        hottest = max(self.points.values(), key=lambda p: float(np.max(p.history.surface_K)))
        peak = float(np.max(hottest.history.surface_K))
        return f"<RunResult {self.scenario.title!r}: {len(self.points)} control points, peak {peak:.0f} K>"

    def to_xarray(self) -> xr.Dataset:
        """Conditions, temperatures and heating ratios as one data set: the content of `flight.nc`."""
        vehicle = self.scenario.vehicle
        sensors = {name: vehicle.control_point(name).sensors for name in self.points}
        about = {"title": self.scenario.title, "vehicle": vehicle.name, "vehicle_revision": vehicle.revision}
        histories = [p.history for p in self.points.values()]
        film = {
            name: np.array([self.points[h.name].conditions[name] for h in histories])
            for name in ("h_ref_kg_m2_s", "H_r_J_kg")
        }
        return histories_dataset(self.flight.conditions, histories, sensors, self.limits, about, film)

    def facts(self) -> Facts:
        """Facts from which the credibility of the result follows."""
        points = self.points.values()
        models, flights, histories = ([getattr(p, n) for p in points] for n in ("model", "conditions", "history"))
        return facts_of_flight(self.scenario, models, flights, histories, self.limits)

    @cached_property
    def credibility(self) -> Statement:
        """What supports the result, factor by factor."""
        return assess(self.facts())

    @property
    def limits(self) -> dict[str, dict[str, float | None]]:
        """Limits `surface_K` and `bondline_K` [K] by control point; None where the vehicle declares none."""
        by_point = {name: self.scenario.vehicle.control_point(name).limits for name in self.points}
        return {
            name: {"surface_K": declared.surface_K, "bondline_K": declared.bondline_K}
            for name, declared in by_point.items()
        }

    def histories(self, points: Sequence[str] | None = None) -> list[PointHistory]:
        """Histories of control points, by default of all.

        points : names
        raises : InputError with the nearest name for a point that was not flown
        """
        names = list(self.points) if points is None else list(points)
        require_points(names, self.points)
        return [self.points[name].history for name in names]

    def plot(self, points: Sequence[str] | None = None) -> Figure:
        """Surface and bondline temperatures of control points against time.

        points : names, by default of all;  raises : InputError with the nearest name for one that was not flown
        """
        from sim_heating.simulation.report.plots import draw_temperatures  # matplotlib is slow to import

        histories, limits = self.histories(points), self.limits
        return draw_temperatures(None, self.scenario.title, histories, self.flight.windows, limits)

    def plot_heating(self, points: Sequence[str] | None = None) -> Figure:
        """Convected, radiated and conducted heat flux and heat load of control points against time.

        points : names, by default of all;  raises : InputError with the nearest name for one that was not flown
        """
        from sim_heating.simulation.report.plots import draw_heating  # matplotlib is slow to import

        return draw_heating(None, self.scenario.title, self.histories(points), self.flight.windows)


def require_points(names: Sequence[str], flown: Collection[str], option: str = "points") -> None:
    """Check names of control points.

    raises : InputError with the nearest name for one that is not among those flown, and for no name
    """
    if not names:
        raise InputError(f"{option}: no control point is named; name one of {', '.join(flown)}")
    for name in names:
        if name not in flown:
            raise InputError(f"{option}: `{name}` is not a control point of this flight{suggestion(name, flown)}")


@dataclass(frozen=True)
class Comparison:
    """A measured history, the prediction of its control point, and the residual at its samples [K].

    table_sigma : (sample,) standard deviation of the point's ratio table over its ratio [-]; None where it states none
    """

    measured: MeasuredHistory
    history: PointHistory
    residual_K: FloatArray
    table_sigma: FloatArray | None = None

    @property
    def flux(self) -> dict[str, float | None]:
        """Radiated flux measured over predicted at the peak of heating, and its distance from 1 in the table's sigmas.

        flux_ratio   : mean of T^4 measured over that predicted, where the predicted T^4 is above half its highest [-]
        table_sigma  : root mean square of the table's relative sigma there [-]
        table_sigmas : (flux_ratio - 1) / table_sigma [-]
        A wall in near equilibrium radiates what it takes up, so that its T^4 stands for the heating ratio.
        """
        predicted = (self.measured.temperature_K - self.residual_K) ** 4
        hot = predicted > 0.5 * np.max(predicted, initial=0.0)
        if not np.any(hot):
            return {"flux_ratio": None, "table_sigma": None, "table_sigmas": None}
        ratio = float(np.mean(self.measured.temperature_K[hot] ** 4) / np.mean(predicted[hot]))
        if self.table_sigma is None:
            return {"flux_ratio": ratio, "table_sigma": None, "table_sigmas": None}
        sigma = float(np.sqrt(np.mean(self.table_sigma[hot] ** 2)))
        return {"flux_ratio": ratio, "table_sigma": sigma, "table_sigmas": (ratio - 1.0) / sigma}

    @property
    def statistics(self) -> dict[str, float | int]:
        """rmse_K, max_abs_K and n over the samples within the flight."""
        errors = pooled_rmse_K(self.residual_K)
        return {"rmse_K": float("nan"), "max_abs_K": float("nan"), "n": 0} if errors is None else errors


def fly_scenario(scenario: Scenario, *, progress: Progress = no_progress, on_frame: OnFrame | None = None) -> Flight:
    """Fly the trajectory of a scenario with its source; what its numbers make impossible, and a flight that fails, is
    reported with its file."""
    spec = scenario.declared.trajectory
    with failure_context(display_path(scenario.path)):
        flight = SOURCES[spec.source](spec, scenario.vehicle, on_frame=on_frame, progress=progress)
        if spec.source != "recorded":
            with error_context("[trajectory]"):
                check_samples(flight, spec.sample_s)
    return flight


def models_of(
    scenario: Scenario, flown: Conditions, *, truth: bool = False
) -> tuple[list[PointModel], list[Conditions]]:
    """Models and conditions of a scenario's control points; with `truth` those of its [truth].

    Its schedules of the temperatures around and behind the walls are linear in time, and constant beyond their ends.
    """
    parameters = scenario.declared.truth.parameters if truth else {}
    reference = mean_condition(flown)
    points = [scenario.vehicle.control_point(name) for name in scenario.names]
    models = [
        point_of_vehicle(scenario.vehicle, p, parameters, scenario.effects(p.name, truth=truth), reference)
        for p in points
    ]
    scheduled = {name: np.interp(flown.time_s, *rows.T) for name, rows in scenario.declared.heating.schedules.items()}
    flown = flown.with_columns(**scheduled)
    marched = {model.name: model for model in models}
    step_s = scenario.declared.heating.longest_step_s
    flights = conditions_behind_walls(scenario.vehicle, points, flown, marched, step_s)
    return models, [_without_idle_back(p, c) for p, c in zip(points, flights, strict=True)]


def _without_idle_back(point: ControlPoint, conditions: Conditions) -> Conditions:
    """Conditions of a point, without the temperature behind a back face that is adiabatic."""
    if point.construction.stack.back != "adiabatic" or "T_back_K" not in conditions:
        return conditions
    return Conditions({name: values for name, values in conditions.columns.items() if name != "T_back_K"})


def run(
    scenario: Scenario | str | os.PathLike[str], *, flight: Flight | None = None, progress: Progress = no_progress
) -> RunResult:
    """Fly a scenario and march its control points along the flight.

    scenario : a scenario, or the path of its file
    flight   : the scenario's flight where it has been flown already; the plug-in does not fly along then
    progress : called with the fraction done, from 0 to 1, and a line of text
    returns  : conditions, temperatures and heating ratios by control point
    raises   : InputError where the scenario is wrong, RunError where the flight or a thermal step fails

    >>> import sim_heating as sh
    >>> flown = sh.run("scenarios/recorded_sts107.toml")
    >>> flown
    <RunResult 'Recorded trajectory: STS-107 early entry': 4 control points, peak 1545 K>
    >>> round(float(flown.points["V09T9527"].history.surface_K.max()))
    1181
    """
    scenario = load_scenario(scenario)
    heating = scenario.declared.heating
    # The plug-in flies along as a host would use it; the march from the conditions is the result, their difference a
    # check.
    alongside = _PluginAlongside(scenario) if heating.alongside and flight is None else None
    if flight is None:
        flight = fly_scenario(scenario, progress=partial(flying, progress), on_frame=alongside)
    progress(FLIGHT_FRACTION, "marching the control points")
    models, flights = models_of(scenario, flight.conditions)
    with failure_context(display_path(scenario.path)):
        histories = march_points(models, flights, longest_step_s=heating.longest_step_s)
    points = {m.name: PointResult(m, c, h) for m, c, h in zip(models, flights, histories, strict=True)}
    progress(0.85, "temperatures done")
    return RunResult(scenario, flight, points, None if alongside is None else alongside.differences_K(histories))


def flying(progress: Progress, fraction: float, text: str) -> None:
    """Report the progress of the flight of a scenario."""
    progress(FLIGHT_FRACTION * fraction, f"flying: {text}")


class _PluginAlongside:
    """The plug-in as a host's frame callback; it keeps the surface temperatures at the samples of the flight."""

    def __init__(self, scenario: Scenario) -> None:
        effects = {name: scenario.effects(name) for name in scenario.names}
        self.plugin = HeatingPlugin(scenario.vehicle, scenario.names, effects=effects)
        self._sample_s = scenario.declared.trajectory.sample_s
        self._times: list[float] = []
        self._surface: list[FloatArray] = []

    def __call__(self, frame: FloatArray) -> None:
        if not self._times:
            self.plugin.reset(frame)
        else:
            self.plugin.step(frame)
        time = float(frame[0])
        due = self._times[0] + len(self._times) * self._sample_s if self._times else time
        # Multiples of the interval after the first frame, as the sampler of the flight takes them.
        if abs(time - due) < 1e-6:
            self._times.append(time)
            self._surface.append(self.plugin.surface_temperatures())

    def differences_K(self, histories: list[PointHistory]) -> dict[str, float]:
        """Largest difference of surface temperature from a march [K], by control point."""
        self.plugin.check()
        time, surface = np.array(self._times), np.array(self._surface)
        # The march has frames between the samples, too.
        marched = histories[0].time_s
        common = time <= marched[-1] + 1e-6
        at = np.searchsorted(marched, time[common] - 1e-6)
        differences = (np.abs(h.surface_K[at] - surface[common, i]) for i, h in enumerate(histories))
        return {h.name: float(np.max(d)) for h, d in zip(histories, differences, strict=True)}


def compare(result: RunResult) -> list[Comparison]:
    """The measured histories of a scenario against its prediction, at their samples within the flight."""
    comparisons = []
    for measured in result.scenario.compare:
        history = result.points[measured.control_point].history
        t = measured.time_s
        in_flight = (t >= history.time_s[0]) & (t <= history.time_s[-1])
        compared = replace(
            measured,
            time_s=t[in_flight],
            temperature_K=measured.temperature_K[in_flight],
            sigma_K=measured.sigma_K[in_flight],
        )
        predicted = np.interp(compared.time_s, history.time_s, history.surface_K)
        sigma = _table_sigma(result.points[measured.control_point], compared.time_s)
        comparisons.append(Comparison(compared, history, compared.temperature_K - predicted, sigma))
    return comparisons


def _table_sigma(point: PointResult, time_s: FloatArray) -> FloatArray | None:
    """(time,) sigma of a point's ratio table over its ratio [-] at times of its flight [s]; None where it has none."""
    table = point.model.ratio
    if table is None or table.sigma is None or len(time_s) == 0:
        return None
    flown = np.column_stack([np.interp(time_s, point.conditions.time_s, point.conditions[v]) for v in RATIO_VARIABLES])
    return table_ratios_at(replace(table, ratio=table.sigma), flown) / table_ratios_at(table, flown)


def rmse_by_point(result: RunResult) -> dict[str, float]:
    """RMSE [K] of a run against its measured histories, by control point."""
    return {c.measured.control_point: float(c.statistics["rmse_K"]) for c in compare(result)}


def summary(result: RunResult) -> dict[str, object]:
    """Content of summary.json: peaks and margins by control point, events, manoeuvres, comparisons."""
    scenario, flown = result.scenario, result.flight.conditions
    points = {}
    for name, point in result.points.items():
        points[name] = point_summary(
            point.history, result.limits[name], table_excursions(point.model, point.conditions)
        )
    return {
        "format": "run-summary/1",
        "program": f"sim-heating {package_version()}",
        "scenario": scenario.title,
        "vehicle": scenario.vehicle.name,
        "revision": scenario.vehicle.revision,
        "duration_s": float(flown.time_s[-1] - flown.time_s[0]),
        "end": {name: float(flown[name][-1]) for name in ("altitude_m", "velocity_m_s", "mach")},
        "events": [{"time_s": t, "what": text} for t, text in result.flight.events],
        "manoeuvres": [vars(w) for w in result.flight.windows],
        "control_points": points,
        "beyond_reference": beyond_range(scenario.vehicle.heating.reference, flown),
        "compared": {c.measured.label: {**c.statistics, **c.flux} for c in compare(result)},
        "plugin_apart_K": result.plugin_apart_K,
        "credibility": result.credibility.as_json(),
    }


def files_of(scenario: Scenario) -> list[str]:
    """Names of all files that a run of a scenario may write."""
    folders = [""] if len(scenario.names) == 1 else [f"{name}/" for name in scenario.names]
    declared = scenario.declared.trajectory.manoeuvre
    manoeuvres = {_picture_of(i, m.kind) for i in range(1, len(declared) + 1) for m in declared}
    of_points = [f"{folder}{name}" for folder in folders for name in OF_POINT]
    of_run = [SUMMARY, CONDITIONS, HISTORIES, TRAJECTORY, TEMPERATURES, HEAT, COMPARED, PAGE]
    return [*of_run, *of_points, *sorted(manoeuvres)]


def _picture_of(number: int, kind: str) -> str:
    return f"manoeuvre_{number}_{kind}.png"


def write_run(
    result: RunResult,
    out: str | os.PathLike[str],
    *,
    points: Sequence[str] | None = None,
    progress: Progress = no_progress,
) -> list[str]:
    """Write all files of a run, all together or not at all; returns their names within the directory.

    points : control points that are drawn, by default all;  raises : InputError for one that was not flown
    """
    with output_directory(out, "run", inputs=result.scenario.files) as folder:
        write_json(folder / SUMMARY, summary(result))
        write_csv(folder / CONDITIONS, with_reference_heating(result).columns, ".12g")
        _write_tables(result, folder)
        progress(0.92, "drawing")
        _draw(result, folder, points)
        write_bytes_atomic(folder / HISTORIES, _netcdf(result.to_xarray()))
        progress(0.96, "writing the page")
        _write_page(result, folder, points)
        names = sorted(p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file())
    progress(1.0, "done")
    return names


def with_reference_heating(result: RunResult) -> Conditions:
    """The flight's conditions with h_ref and H_r of its control points.

    returns : a column each where it is the same for all points, else a column a point, such as V09T9527_H_r_J_kg: the
              film coefficient of a flat plate depends on the running length, the recovery enthalpy of an edge on the
              local angle
    """
    columns: dict[str, FloatArray] = {}
    for name in ("h_ref_kg_m2_s", "H_r_J_kg"):
        of_points = {point: p.conditions[name] for point, p in result.points.items()}
        first = next(iter(of_points.values()))
        if all(np.array_equal(other, first) for other in of_points.values()):
            columns[name] = first
        else:
            columns |= {f"{point}_{name}": values for point, values in of_points.items()}
    return result.flight.conditions.with_columns(**columns)


def _write_tables(result: RunResult, folder: Path) -> None:
    vehicle = result.scenario.vehicle
    sensors = {name: vehicle.control_point(name).sensors for name in result.points}
    for name, point in result.points.items():
        point_folder = folder if len(result.points) == 1 else folder / name
        point_folder.mkdir(exist_ok=True)
        write_temperatures_csv(point_folder / TABLE, point.history.time_s, point.history, sensors[name])
        write_heating_csv(point_folder / HEATING, point.history, result.limits[name])


def _netcdf(dataset: xr.Dataset) -> bytes:
    """A dataset as a netCDF file, made in memory: the library takes no names beyond the locale's encoding, and does
    not say when a disk is full."""
    import netCDF4
    from xarray.backends import NetCDF4DataStore

    file = netCDF4.Dataset(HISTORIES, "w", memory=65536)
    dataset.dump_to_store(NetCDF4DataStore(file))
    return without_times(bytes(file.close()))


def _draw(result: RunResult, folder: Path, points: Sequence[str] | None) -> None:
    """Draw the pictures of a run: heating, trajectory, temperatures, each manoeuvre, measured against predicted.

    points : names of those that are drawn, by default all
    """
    from sim_heating.simulation.report import plots  # matplotlib is slow to import

    title, flown, windows = result.scenario.title, result.flight.conditions, result.flight.windows
    histories = result.histories(points)
    plots.draw_heating(folder / HEAT, title, histories, windows)
    plots.draw_trajectory(folder / TRAJECTORY, title, flown, windows)
    plots.draw_temperatures(folder / TEMPERATURES, title, histories, windows, result.limits)
    moved = result.flight.at_frame_rate()
    for i, window in enumerate(windows, start=1):
        chosen = _largest_responses(histories, window)
        path, varied = folder / _picture_of(i, window.kind), MANOEUVRE_VARIABLE[window.kind]
        drawn = [_outermost_sensor(result.points[h.name]) for h in chosen]
        plots.draw_manoeuvre(path, title, flown, drawn, window, varied, moved)
    compared = compare(result)
    if compared:
        panels = [
            (
                c.measured.label,
                c.history,
                c.measured.time_s,
                c.measured.temperature_K,
                c.measured.sigma_K,
                float(c.statistics["rmse_K"]),
            )
            for c in compared
        ]
        plots.draw_comparison(folder / COMPARED, title, panels)


def _write_page(result: RunResult, folder: Path, points: Sequence[str] | None) -> None:
    """Write report.html over the pictures of a run, which stand in place of its charts on paper."""
    from sim_heating.base.report.page import write_page  # matplotlib is slow to import

    write_page(folder / PAGE, lambda: _page(result, folder, points))


def _page(result: RunResult, folder: Path, points: Sequence[str] | None) -> Page:
    """The page of a run, whose pictures are in the folder."""
    from sim_heating.simulation.report.pages import MeasuredCurve, RunPictures, run_page

    contents, windows = summary(result), result.flight.windows
    compared = [
        MeasuredCurve(
            c.measured.label,
            c.history,
            c.measured.time_s,
            c.measured.temperature_K,
            c.residual_K,
            float(c.statistics["rmse_K"]),
        )
        for c in compare(result)
    ]
    manoeuvres = [folder / _picture_of(i, window.kind) for i, window in enumerate(windows, start=1)]
    pictures = RunPictures(folder / TRAJECTORY, folder / TEMPERATURES, folder / HEAT, folder / COMPARED, manoeuvres)
    peaks = run_table("", contents, rmse_by_point(result))
    return run_page(
        contents, peaks, result.flight.conditions, result.histories(points), windows, result.limits, compared, pictures
    )


def _outermost_sensor(point: PointResult) -> PointHistory:
    """The history of a point with its outermost thermocouple alone."""
    if not point.model.depths_m:
        return point.history
    outermost = int(np.argmin(point.model.depths_m))
    return replace(point.history, sensors_K=point.history.sensors_K[[outermost]])


def _largest_responses(histories: list[PointHistory], window: Window) -> list[PointHistory]:
    """The points whose surface temperature departs most from its linear trend during a manoeuvre."""

    def response_K(history: PointHistory) -> float:
        inside = (history.time_s >= window.start_s) & (history.time_s <= window.end_s + RESPONSE_S)
        t, surface = history.time_s[inside], history.surface_K[inside]
        # Less the trend of the entry, which would rank a point by how fast it heats and not by the manoeuvre.
        return float(np.ptp(surface - np.interp(t, t[[0, -1]], surface[[0, -1]]))) if len(t) > 2 else 0.0

    ordered = sorted(histories, key=response_K, reverse=True)
    return [h for h in ordered[:PLOTTED_POINTS] if response_K(h) > PLOTTED_RESPONSE_K] or ordered[:1]
