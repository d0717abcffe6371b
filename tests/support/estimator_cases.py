"""Flights with a known truth for the estimator's benchmarks: manoeuvres of JSBSim entries over plugs of 14 nodes.

The truth is the march that is fitted, so that estimation is tested and not physics. Records of another program's
physics are in estimator_null.py. As in the founding paper a fit starts 50 s before the manoeuvre, here with the
true temperatures, where it does not start at entry interface.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from sim_heating.base.parameters import CLOCK_SKEW, Parameter
from sim_heating.estimation.inference.likelihood import reading_intervals
from sim_heating.estimation.problem import FitOptions, FitProblem, joint_reference
from sim_heating.estimation.record_fit import Start, StartMaker
from sim_heating.inputs.points import conditions_of_record, point_of_record
from sim_heating.inputs.record import Record, Segments
from sim_heating.inputs.scenario import Scenario, load_scenario
from sim_heating.inputs.sensor_model import measure
from sim_heating.march.ensemble import Ensemble, condition_history
from sim_heating.march.point import PointModel
from sim_heating.simulation.run import fly_scenario
from sim_heating.simulation.synthesize import synthesize
from sim_heating.thermal.mesh import Mesh
from sim_heating.trajectory.flight import Flight
from tests.support.paths import SCENARIOS
from tests.support.problems import NOTHING

FloatArray = NDArray[np.float64]

NODES = 14
BEFORE_S, AFTER_S = 50.0, 60.0
"""Times fitted around a manoeuvre."""


@dataclass(frozen=True)
class Case:
    """A flight, and the parameters estimated from it.

    scenario, until_m_s : the flight, and the speed at which it ends
    point               : control point
    truth               : dotted name -> true value of what is estimated
    whole               : fitted from entry interface on, and not around the manoeuvre alone
    bits                : of the recorder words, where not those declared
    """

    name: str
    scenario: str
    until_m_s: float
    point: str
    truth: Mapping[str, float] = field(default_factory=dict)
    whole: bool = False
    bits: int | None = None

    @property
    def marched(self) -> dict[str, float]:
        """True values of the march's parameters."""
        return {k: v for k, v in self.truth.items() if k != CLOCK_SKEW.name}


PLUG = ("popu_mach20", 5800.0, "V09T9527")
PLUG_TRUTH = {"ratio.scale": 0.05, "ratio.d_alpha": 5e-4}
ELEVON = ("flap_mach16", 4550.0, "V07T9730")
ELEVON_TRUTH = {"ratio.scale": -0.05, "ratio.d_elevon": 1e-3, "ratio.d_bodyflap": -5e-4}
CASES = {
    case.name: case
    for case in (
        Case("popu", *PLUG, PLUG_TRUTH),
        Case("flap alone", *ELEVON, ELEVON_TRUTH),
        Case("coating", *PLUG, {**PLUG_TRUTH, "stack.coating.thickness_factor": 1.15}),
        Case("skew", *PLUG, {**PLUG_TRUTH, CLOCK_SKEW.name: 0.35}),
        Case("flap", *ELEVON, ELEVON_TRUTH, whole=True),
        Case("flap alone, 16 bits", *ELEVON, ELEVON_TRUTH, bits=16),
    )
}


@cache
def flown(scenario: str, until_m_s: float) -> tuple[Scenario, Flight]:
    """A scenario of the project, flown until its velocity falls to a limit."""
    whole = load_scenario(SCENARIOS / f"{scenario}.toml")
    trajectory = whole.declared.trajectory
    stop = trajectory.stop.model_copy(update={"velocity_m_s": until_m_s, "mach": None})
    declared = whole.declared.model_copy(update={"trajectory": trajectory.model_copy(update={"stop": stop})})
    cut = replace(whole, declared=declared)
    return cut, fly_scenario(cut)


@cache
def record_of(case_name: str) -> Record:
    """The record that a crew would have of a case's control point, fitted around the manoeuvre."""
    case = CASES[case_name]
    scenario, flight = flown(case.scenario, case.until_m_s)
    record = synthesize(replace(scenario, names=(case.point,)), flight=flight)[case.point]
    window = flight.windows[0]
    fitted = None if case.whole else [[window.start_s - BEFORE_S, window.end_s + AFTER_S]]
    changed: dict[str, object] = {
        "stack": record.declared.stack.model_copy(update={"nodes": NODES}),
        "segments": Segments(fit=fitted),
    }
    if case.bits is not None:
        sensors = [s.model_copy(update={"bits": case.bits}) for s in record.sensors]
        changed["thermocouples"] = record.declared.thermocouples.model_copy(update={"sensor": sensors})
    return replace(record, declared=record.declared.model_copy(update=changed))


def start_at(case: Case) -> StartMaker:
    """A start before the manoeuvre with the true temperatures there, marched from entry interface."""

    def start(record: Record, model: PointModel, mesh: Mesh) -> Start:
        window = flown(case.scenario, case.until_m_s)[1].windows[0]
        conditions = conditions_of_record(record)
        until = conditions.time_s <= window.start_s - BEFORE_S
        ensemble = Ensemble([model.with_parameters(case.marched)], [mesh])
        ensemble.march(conditions.time_s[until], condition_history(conditions)[np.newaxis, until], keep=NOTHING)
        return Start(float(conditions.time_s[until][-1]), ensemble.node_temperatures(0), np.zeros((mesh.nodes, 0)))

    return start


@dataclass
class Repeatable:
    """A fit whose measurements can be drawn again and again; no sensor of it is calibrated.

    truth  : (parameter,) true values;  true_K : sensor's number -> (sample,) true temperatures of what is fitted
    """

    problem: FitProblem
    truth: FloatArray
    true_K: dict[int, FloatArray]

    def draw(self, rng: np.random.Generator) -> None:
        """Measure once more: noise and recorder words of all sensors."""
        part = self.problem.record_fits[0]
        part.channels = [
            replace(c, intervals=reading_intervals(c.sensor, measure(c.sensor, self.true_K[c.number], rng)))
            for c in part.channels
        ]


def repeatable(case: Case) -> Repeatable:
    """The fit of a case with flat priors, so that no prior looks like a bias."""
    record = record_of(case.name)
    flat = {n: replace(_definition(record, n), sigma=np.inf) for n in case.truth}
    starts = [None if case.whole else start_at(case)]
    problem = FitProblem([record], list(case.truth), joint_reference([record]), FitOptions(priors=flat, starts=starts))
    truth = np.array(list(case.truth.values()))
    return Repeatable(problem, truth, {s.channel.number: s.mean_K for s in problem.samples(truth)})


def _definition(record: Record, name: str) -> Parameter:
    return CLOCK_SKEW if name == CLOCK_SKEW.name else point_of_record(record).definition(name)
