"""Scenarios to estimates: flown with an altered truth, measured, estimated, written into the tables, predicted again.

Every POPU and flap scenario is flown in JSBSim once. The truth that its thermocouples see is altered in two ways:

    linear  magnitude and derivatives of the heating ratio, as [truth] in a scenario has them: the estimator's own model
    table   the ratio at every node, drawn from the table's own sigma (SHARE of it): no linear model is exact

and it is fitted in two ways: over the whole entry, and over the manoeuvre with SPAN_S to either side, from temperatures
that are estimated too (`--fit`, `--start profile`). An error is the estimate less the truth over its stated sigma; the
truth of a fit is the least-squares projection of the true less the declared ratio on what was estimated, along the
fitted samples. A variable that is not in a fit, because it did not vary or because the declared table has one node in
it, is part of the magnitude, there as in flight.

Each fit revises the tables once. The revised tables are to predict the fitted samples as the fit does; the same
manoeuvre with other noise, and manoeuvres that were not fitted (the other ones of the flight with other noise, and that
of another scenario) are to be predicted no worse than before. These are plain marches from the entry interface, errors
over the manoeuvre and 50 s about it.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import click
import numpy as np

from benchmarks.challenge.files import scenario_file
from benchmarks.measure import Figure, save
from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import RATIO_VARIABLES
from sim_heating.base.errors import InputError
from sim_heating.closure.prior.table import undeclared_derivatives
from sim_heating.closure.revise.errors import errors_before_and_after, held_fits
from sim_heating.closure.revise.update import TableUpdate, prepare_update
from sim_heating.estimation.fit import FitResult, estimate
from sim_heating.estimation.record_fit import StartMaker
from sim_heating.estimation.report.estimate_file import NAME, write_estimate
from sim_heating.estimation.report.report import estimate_contents
from sim_heating.estimation.starts import STARTS
from sim_heating.heating.ratio.lookup import table_ratios_at
from sim_heating.heating.ratio.table import RatioTable
from sim_heating.heating.ratio.uncertainty import basis, prior_covariance
from sim_heating.inputs.points import conditions_of_record, mean_condition
from sim_heating.inputs.record import Record, Segments, load_record
from sim_heating.inputs.scenario import Scenario, Truth, load_scenario
from sim_heating.inputs.vehicle import ControlPoint
from sim_heating.simulation.run import fly_scenario
from sim_heating.simulation.synthesize import synthesize, write_records
from sim_heating.trajectory.flight import Flight, Window

POINTS = {
    "popu_mach20": ("V09T9527", "V07T9975"),
    "popu_mach12": ("V09T9527", "V07T9975"),
    "popu_mach8": ("V09T9527", "V07T9975"),
    "flap_mach21": ("V07T9730", "BODYFLAP"),
    "flap_mach16": ("V07T9730", "BODYFLAP"),
    "flap_mach12": ("V07T9730", "BODYFLAP"),
    "sts2": ("V09T9527", "V07T9730"),
    "sts4": ("V07T9975", "V09T9527"),
}
"""Scenarios and the control points of each that are fitted."""
CHECKED = {
    "popu_mach20": "popu_mach12",
    "popu_mach12": "popu_mach20",
    "popu_mach8": "popu_mach20",
    "flap_mach21": "flap_mach16",
    "flap_mach16": "flap_mach12",
    "flap_mach12": "flap_mach21",
}
"""The other manoeuvre that the revised table predicts."""
ALTERED = {
    "ratio.scale": 0.15,
    "ratio.d_alpha": 4e-4,
    "ratio.d_logre": 1e-3,
    "ratio.d_elevon": 3e-4,
    "ratio.d_bodyflap": 3e-4,
}
"""The linear truth."""
SHARE = 0.3
"""Part of the table's sigma that the table truth is drawn with; with all of it some ratios would be negative."""
SPAN_S = 50.0
WITHIN_SIGMAS = 2.0
"""An error up to here [sigma] is within the bounds."""
UNDECLARED = {("sts4", "V09T9527")}
"""Control points whose scenario adds an effect that a linear fit lacks; shown, and not counted."""
FITTED_TOO = {"sts2": ("effect.coating-thickness.coating_factor",)}
"""Parameters that a scenario's own truth alters in addition to the ratio, and that are estimated with it."""
WAYS = ("whole", "manoeuvre")
OTHER_SEED = 1000
"""Added to the seed of a scenario's noise for records that are not fitted."""
HELD, FLOORS, WORSE = 1.15, 1.3, 1.05
"""What is asked of revised tables: error of the fitted samples over that of the fit and over the noise floor, and error
of what was not fitted after over before."""


@dataclass(frozen=True)
class Result:
    """One fit.

    errors         : estimate less truth over sigma, by ratio parameter
    errors are empty where the fit did not converge or its revision was refused, and left_out then gives the reason
    fit            : RMSE [K] of the fit over the noise floor, of the fitted samples
    before, after  : the same with the tables before and after, from where the fit began
    from_entry     : the same with the tables after, from the first row of the conditions
    not_held       : what of the fit the tables do not hold -> what it costs [K]
    seed           : RMSE [K] of the same manoeuvres with other noise, after over before
    checked        : manoeuvre that was not fitted -> its RMSE [K] after over before
    """

    scenario: str
    point: str
    truth: str
    way: str
    start_s: float
    errors: dict[str, float]
    fit: float
    before: float
    after: float
    from_entry: float
    not_held: dict[str, float]
    seed: float
    checked: dict[str, float]
    left_out: tuple[str, ...]

    @property
    def counted(self) -> bool:
        """Whether the fit converged and revised the tables, of a model that could be right."""
        return bool(self.errors) and (self.scenario, self.point) not in UNDECLARED


def counted_of(results: Sequence[Result]) -> list[Result]:
    """Fits that count."""
    return [r for r in results if r.counted]


def run() -> list[Figure]:
    """Fly, fit, and compare the estimates with the truth."""
    flights = {name: _flown(name) for name in POINTS}
    with tempfile.TemporaryDirectory() as folder:
        results = [r for truth in ("linear", "table") for r in _of_truth(truth, flights, Path(folder))]
    figures = [*_summaries(results), *(_line(r) for r in results)]
    save("end_to_end", figures, {"results": [vars(r) for r in results]})
    return figures


def _summaries(results: Sequence[Result]) -> Iterator[Figure]:
    for truth in ("linear", "table"):
        for way in WAYS:
            mine = [r for r in counted_of(results) if r.truth == truth and r.way == way]
            z = np.abs([z for r in mine for z in r.errors.values()])
            what = f"{truth} truth, {way}:"
            yield Figure(
                f"{what} errors within 2 sigma of {len(z)}",
                float(np.mean(z <= WITHIN_SIGMAS)),
                "",
                note="0.95 is right",
            )
            yield Figure(f"{what} median error", float(np.median(z)), "sigma", note="0.67 is right")
            yield from _of_tables(what, mine)


def _of_tables(what: str, mine: Sequence[Result]) -> Iterator[Figure]:
    """How well revised tables predict what was fitted and what was not; the worst of all fits."""
    held = [r.after / r.fit for r in mine]
    note = f"median {np.median(held):.2f}"
    yield Figure(f"{what} RMSE of the revised tables over that of the fit, worst", max(held), "", HELD, note=note)
    # A fit that is itself above the floor has a model that is not the truth; its table is judged by the fit.
    good = [r.after for r in mine if r.fit <= FLOORS / HELD]
    median = [float(np.median([getattr(r, k) for r in mine])) for k in ("before", "fit", "after", "from_entry")]
    note = "medians: before {:.1f}, fit {:.2f}, after {:.2f}, after from entry {:.2f}".format(*median)
    text = f"{what} RMSE of the revised tables where the fit is at the noise"
    if good:
        yield Figure(f"{text}, worst of {len(good)}", max(good), "floors", FLOORS, note=note)
    else:
        yield Figure(f"{text}: no fit is; median of all", median[2], "floors", note=note)
    seeds = [r.seed for r in mine]
    note = f"median {np.median(seeds):.2f}"
    yield Figure(f"{what} other noise, RMSE after over before, worst", max(seeds), "", WORSE, note=note)
    others = [(v, f"{r.scenario} {r.point} {r.start_s:.0f} s: {k}") for r in mine for k, v in r.checked.items()]
    if others:
        worst, where = max(others)
        note = f"median {np.median([v for v, _ in others]):.2f} of {len(others)}; worst {where}"
        yield Figure(f"{what} other manoeuvres, RMSE after over before, worst", worst, "", WORSE, note=note)


def _line(r: Result) -> Figure:
    what = f"{r.scenario} {r.point} at {r.start_s:.0f} s, {r.truth}, {r.way}: largest error"
    if not r.errors:
        return Figure(what, float("nan"), "sigma", note="; ".join(r.left_out))
    short = [f"{name.removeprefix('ratio.')} {z:+.1f}" for name, z in r.errors.items()]
    note = ", ".join([*short, *(f"no {n.removeprefix('ratio.')}" for n in r.left_out)])
    note += f"; RMSE {r.before:.1f} to {r.after:.2f} floors, fit {r.fit:.2f}, from entry {r.from_entry:.2f}"
    note += f"; other noise x {r.seed:.2f}"
    note += f", other manoeuvres x {max(r.checked.values()):.2f} at most" if r.checked else ""
    note += "".join(f"; not in the tables: {what} {loss:.2f} K" for what, loss in r.not_held.items())
    note += "" if r.counted else " (undeclared effect)"
    return Figure(what, max(map(abs, r.errors.values())), "sigma", note=note)


# From a scenario to records ------------------------------------------------------------------------------------------


def _flown(name: str) -> tuple[Scenario, Flight]:
    scenario = load_scenario(scenario_file(name))
    every = set(POINTS[name]).union(*(POINTS[n] for n, other in CHECKED.items() if other == name))
    scenario = replace(scenario, names=tuple(sorted(every)))
    return scenario, fly_scenario(scenario)


def true_table(point: ControlPoint) -> RatioTable:
    """A control point's ratio table as it might truly be: its declared values and a draw of their errors."""
    table = point.ratio
    every = np.arange(table.ratio.size)
    values, vectors = np.linalg.eigh(prior_covariance(table, every, every))
    rng = np.random.default_rng(list(point.name.encode()))
    error = vectors @ (np.sqrt(np.maximum(values, 0.0)) * rng.standard_normal(len(values)))
    return replace(table, ratio=table.ratio + SHARE * error.reshape(table.ratio.shape))


def _measured(scenario: Scenario, flight: Flight, truth: str) -> dict[str, Record]:
    """Records that declare the vehicle's tables and were measured with another truth."""
    if truth == "linear":
        own = scenario.declared.truth
        altered = Truth(parameters=own.parameters | ALTERED, effect=own.effect)
        return synthesize(
            replace(scenario, declared=scenario.declared.model_copy(update={"truth": altered})), flight=flight
        )
    declared = scenario.vehicle.control_points
    true = {n: replace(p, ratio=true_table(p)) if n in scenario.names else p for n, p in declared.items()}
    records = synthesize(
        replace(scenario, vehicle=replace(scenario.vehicle, control_points=true)), flight=flight, halvings=2
    )
    return {n: replace(r, ratio_table=declared[n].ratio) for n, r in records.items()}


def _of_truth(truth: str, flights: dict[str, tuple[Scenario, Flight]], folder: Path) -> Iterator[Result]:
    for name, (scenario, flight) in flights.items():
        write_records(scenario, _measured(scenario, flight, truth), folder / truth / name)
        write_records(scenario, _measured(_reseeded(scenario), flight, truth), folder / truth / f"{name}_other")
    for name, (scenario, flight) in flights.items():
        for point in POINTS[name]:
            for window in flight.windows:
                yield from _fits(name, scenario.vehicle.control_point(point), flights, window, folder / truth)


# From a record to errors ---------------------------------------------------------------------------------------------


def _reseeded(scenario: Scenario) -> Scenario:
    """A scenario with other noise."""
    noise = scenario.declared.measurements
    declared = scenario.declared.model_copy(
        update={"measurements": noise.model_copy(update={"seed": noise.seed + OTHER_SEED})}
    )
    return replace(scenario, declared=declared)


def _fits(
    name: str, point: ControlPoint, flights: dict[str, tuple[Scenario, Flight]], window: Window, folder: Path
) -> Iterator[Result]:
    flight = flights[name][1]
    for way in WAYS:
        if way == "whole" and window is not flight.windows[0]:
            continue
        record, start = _cut(load_record(folder / name / point.name), window, way)
        no_node = undeclared_derivatives(record, tuple(ALTERED))
        names = (*(n for n in ALTERED if n not in no_node), *FITTED_TOO.get(name, ()))
        fitted = estimate([record], names, starts=[start])
        place = folder / "fits" / f"{name}_{point.name}_{way}_{window.start_s:.0f}"
        update = _revision(fitted, place, name)
        if not isinstance(update, TableUpdate):
            lost = float("nan")
            yield Result(
                name, point.name, folder.name, way, window.start_s, {}, lost, lost, lost, lost, {}, lost, {}, update
            )
            continue
        (held,) = held_fits(update).values()
        floor = held.noise_floor_K
        again = load_record(folder / f"{name}_other" / point.name)
        seed = _after_over_before(update, again if way == "whole" else _cut(again, window, way)[0])
        checked = {}
        if way == "manoeuvre":
            others = [w for w in flight.windows if w is not window]
            checked = {f"{w.start_s:.0f} s": _after_over_before(update, _cut(again, w, way)[0]) for w in others}
        if (other := CHECKED.get(name)) is not None:
            elsewhere = load_record(folder / other / point.name)
            for w in flights[other][1].windows:
                checked[f"{other} {w.start_s:.0f} s"] = _after_over_before(update, _cut(elsewhere, w, "manoeuvre")[0])
        click.echo(f"  {place.parent.parent.name}: {place.name}", err=True)
        yield Result(
            name, point.name, folder.name, way, window.start_s, _errors(fitted, record, point, flight, folder.name),
            held.fit_K / floor, held.before_K / floor, held.after_K / floor, held.from_entry_K / floor, held.not_held,
            seed, checked, (*no_node, *fitted.not_estimated),
        )  # fmt: skip


def _revision(fitted: FitResult, place: Path, name: str) -> TableUpdate | tuple[str, ...]:
    """The tables of a scenario's vehicle with an estimate in them, or why they have it not."""
    if not fitted.fit.converged:
        return tuple(fitted.warnings)
    place.mkdir(parents=True)
    write_estimate(place / NAME, estimate_contents(fitted))
    try:
        return prepare_update(place, point_vehicle(name))
    except InputError as error:
        return (str(error).partition(": ")[2],)


def _after_over_before(update: TableUpdate, record: Record) -> float:
    """RMSE of a record's fit segments with the tables after over that with the tables before."""
    found = errors_before_and_after(update, [record])[record.name]["fit"]
    return float(found["after"]["rmse_K"] / found["before"]["rmse_K"])


def point_vehicle(name: str) -> Path:
    """Directory of the vehicle of a scenario."""
    return load_scenario(scenario_file(name)).vehicle.directory


def _cut(record: Record, window: Window, way: str) -> tuple[Record, StartMaker | None]:
    """The record with the segment that is fitted, and how its march starts."""
    if way == "whole":
        return record, None
    begin, end = window.start_s - SPAN_S, window.end_s + SPAN_S
    declared = record.declared.model_copy(update={"segments": Segments(fit=[[begin, end]])})
    cut = replace(record, declared=declared)
    readings = record.time_s[np.isfinite(record.temperatures_K()).all(axis=0)]
    at = begin if readings[2] < begin else float(readings[2])
    return cut, lambda r, model, mesh: STARTS["profile"](r, model, mesh, at)


def _errors(fitted: FitResult, record: Record, point: ControlPoint, flight: Flight, truth: str) -> dict[str, float]:
    """Estimates less the truth over their sigma."""
    flown = conditions_of_record(record)
    rows = record.fit_mask(flown.time_s)
    x = np.stack([flown[v] for v in RATIO_VARIABLES], axis=1)[rows]
    declared = table_ratios_at(point.ratio, x)
    if truth == "linear":
        about = np.array(mean_condition(flight.conditions))
        off = basis(tuple(ALTERED), x, about, declared) @ np.array(list(ALTERED.values()))
    else:
        off = table_ratios_at(true_table(point), x) - declared
    names = [n for n in fitted.labels if n.startswith("ratio.")]
    true = _projected(basis(names, x, np.array(fitted.problem.reference), declared), off, _heating(record)[rows])
    sigma = dict(zip(fitted.labels, fitted.bounds.sigma, strict=True))
    value = dict(zip(fitted.labels, fitted.fit.values, strict=True))
    return {n: float((value[n] - t) / sigma[n]) for n, t in zip(names, true, strict=True)}


def _heating(record: Record) -> FloatArray:
    flown = conditions_of_record(record)
    return np.asarray(flown["h_ref_kg_m2_s"] * flown["H_r_J_kg"])


def _projected(B: FloatArray, off: FloatArray, weight: FloatArray) -> FloatArray:
    scale = np.sqrt(np.sum((B * weight[:, None]) ** 2, axis=0))
    return np.asarray(np.linalg.lstsq(B * weight[:, None] / scale, off * weight, rcond=None)[0] / scale)
