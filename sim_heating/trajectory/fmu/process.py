"""The process of an FMU: FMPy behind one JSON request a line on stdin and one JSON answer a line on stdout.

An FMU is foreign machine code; whatever it breaks is confined to this process. `session.FmuSession` starts this file as
a script; it imports nothing else of the package. Output of the FMU goes to stderr.

    on start       {"ready": true}, when FMPy has been imported
    first request  {"folder", "model", "start", "inputs", "outputs", "start_s", "stop_s", "tolerance"}
    each further   {"time_s", "step_s", "inputs": [...]}
    answer         {"time_s", "values": [...], "ended"}  or  {"error": "what went wrong"}

`model` is FmuModel.process_description; inputs and outputs are (type, value reference), `start` is a list of these with
values for each of two modes, "instantiated" and "initialization". The description of the FMU is not read again: a large
one takes seconds.

`ended` is true where the FMU itself asks to end; time_s is then the time that it reached. The process is the first of
its group and has its parent's id as its argument: when the parent ends it kills the group, whatever the FMU is doing.

Source: Modelica Association (2022), "Functional Mock-up Interface Specification 3.0".
"""

from __future__ import annotations

import json
import math
import os
import signal
import sys
import threading
import time
from typing import Any

from fmpy import model_description as fmi
from fmpy.fmi1 import FMICallException
from fmpy.simulation import instantiate_fmu

DISCARD = 2
"""fmi2Discard and fmi3Discard."""
STATUS = dict(enumerate(("OK", "WARNING", "DISCARD", "ERROR", "FATAL", "PENDING")))
LAST_SUCCESSFUL_TIME, TERMINATED = 2, 3
"""Arguments of fmi2GetRealStatus and fmi2GetBooleanStatus after a discarded step."""
SOLVER_TOLERANCE = 1e-6
"""Relative tolerance of CVode where neither scenario nor FMU gives one."""
UNRECOVERABLE = -1
"""Status of a function that CVode calls, after which it gives up."""
SAME_TIME_S = 1e-9
WATCH_S = 0.5
"""Interval at which the process checks that its parent exists [s]."""


class Refusal(Exception):
    """A request that the FMU did not fulfil, with the reason."""


def _accessors(verb: str, variables: list[tuple[str, int]]) -> list[tuple[str, list[int], list[int]]]:
    """(method, value references, places in the list) of variables, one entry a type."""
    by_method: dict[str, tuple[list[int], list[int]]] = {}
    for index, (kind, reference) in enumerate(variables):
        references, indices = by_method.setdefault(verb + kind, ([], []))
        references.append(reference)
        indices.append(index)
    return [(method, references, indices) for method, (references, indices) in by_method.items()]


class Instance:
    """An initialised FMU; subclasses advance it.

    raises : Refusal, or FMPy's exceptions
    """

    def __init__(self, request: dict[str, Any]) -> None:
        self.model = request["model"]
        self.three = self.model["version"].startswith("3.")
        self.read = _accessors("get", request["outputs"])
        self.inputs = _accessors("set", request["inputs"])
        self.fmu = self._instantiate(request["folder"])
        self._initialise(request)

    def _instantiate(self, folder: str) -> Any:
        description = fmi.ModelDescription(fmiVersion=self.model["version"], instantiationToken=self.model["token"])
        identifier = self.model["identifier"]
        if self.model["interface"] == "co-simulation":
            description.coSimulation = fmi.CoSimulation(modelIdentifier=identifier)
        else:
            description.modelExchange = fmi.ModelExchange(modelIdentifier=identifier)
        return instantiate_fmu(folder, description, logger=_log)

    def _initialise(self, request: dict[str, Any]) -> None:
        times = {"tolerance": request["tolerance"], "startTime": request["start_s"], "stopTime": request["stop_s"]}
        # FMI 2 takes tolerance and times before the start values, FMI 3 on entering the initialization mode.
        if not self.three:
            self.fmu.setupExperiment(**times)
        self._set("instantiated", request)
        self.fmu.enterInitializationMode(**(times if self.three else {}))
        self._set("initialization", request)
        self.fmu.exitInitializationMode()

    def _set(self, mode: str, request: dict[str, Any]) -> None:
        for kind, reference, value in request["start"][mode]:
            getattr(self.fmu, "set" + kind)([reference], [value])

    def values(self) -> list[float]:
        """The outputs as numbers in the FMU's units ([m], [rad] ...), in the order asked for.

        Source: FMI 2.0.4, section 2.1.7.
        """
        outputs = [0.0] * sum(len(indices) for _, _, indices in self.read)
        for method, references, indices in self.read:
            for index, value in zip(indices, getattr(self.fmu, method)(references), strict=True):
                outputs[index] = float(value)
        return outputs

    def put(self, values: list[float]) -> None:
        """Set the inputs, in the FMU's units ([m], [rad] ...), in the order given. Source: FMI 2.0.4, section 2.1.7."""
        for method, references, indices in self.inputs:
            is_integer = "Float" not in method and "Real" not in method
            chosen = [round(values[p]) if is_integer else values[p] for p in indices]
            getattr(self.fmu, method)(references, chosen)

    def step(self, time_s: float, step_s: float) -> tuple[float, bool]:
        """Advance by a step [s]; the time reached [s], and whether the FMU requests the end."""
        raise NotImplementedError


class CoSimulation(Instance):
    """An FMU that brings its own solver."""

    def step(self, time_s: float, step_s: float) -> tuple[float, bool]:
        try:
            done = self.fmu.doStep(currentCommunicationPoint=time_s, communicationStepSize=step_s)
        except FMICallException as error:
            if error.status != DISCARD:
                raise
            return self._discarded(time_s, step_s)
        if not self.three:
            return time_s + step_s, False
        _, ended, early, reached_s = done
        if ended or early:
            reached_s = _within(reached_s, time_s, time_s + step_s)
        if ended:
            return reached_s, True
        if early and reached_s < time_s + step_s:
            raise Refusal(f"returned early, at {reached_s:.9g} s, from a step to {time_s + step_s:.9g} s; {_SHORTER}")
        return time_s + step_s, False

    def _discarded(self, time_s: float, step_s: float) -> tuple[float, bool]:
        """A discarded step: in FMI 2 the end of the simulation, or a step that is too long."""
        if not self.three:
            reached_s = self.fmu.getRealStatus(LAST_SUCCESSFUL_TIME)
            if self.fmu.getBooleanStatus(TERMINATED):
                return _within(reached_s, time_s, time_s + step_s), True
        raise Refusal(f"discarded the step of {step_s:.9g} s at {time_s:.9g} s; {_SHORTER}")


_SHORTER = "give shorter steps (rate_hz)"


def _within(reached_s: float, begin_s: float, end_s: float) -> float:
    """A time that an FMU reports to have reached, which must lie in its step."""
    # An end time far outside the step would otherwise be believed and end the flight there.
    for bound_s in (begin_s, end_s):
        if abs(reached_s - bound_s) <= SAME_TIME_S:
            return bound_s
    if not begin_s < reached_s < end_s:
        raise Refusal(f"reports that it reached {reached_s:.9g} s, which is not in its step to {end_s:.9g} s")
    return reached_s


def _log(*arguments: Any) -> None:
    """Print a log message: status, category and message are the last arguments in FMI 2 and 3."""
    status, _, message = arguments[-3:]
    print(f"[{STATUS.get(status, status)}] {(message or b'').decode('utf-8', 'replace')}", flush=True)


class _ConstantInputs:
    """Inputs for FMPy's solver: constant over a communication step."""

    def apply(self, time_s: float) -> None:
        """Nothing to do."""


def _call_status(function: Any, *arguments: Any) -> int:
    """Status that CVode takes from a function of it: an exception that left the function would count as success."""
    try:
        status: int = function(*arguments)
    except Exception as error:
        print(error, flush=True)
        return UNRECOVERABLE
    return status


def _cvode(**settings: Any) -> Any:
    """FMPy's CVode; an FMU that does not evaluate its equations ends the integration."""
    from fmpy.sundials import CVodeSolver

    class Solver(CVodeSolver):  # type: ignore[misc]  # untyped
        """CVode with functions that return a status."""

        def f(self, *arguments: Any) -> int:
            """Derivatives."""
            return _call_status(super().f, *arguments)

        def g(self, *arguments: Any) -> int:
            """Event indicators."""
            return _call_status(super().g, *arguments)

    return Solver(**settings)


class ModelExchange(Instance):
    """An FMU of bare equations, integrated by FMPy's CVode (BDF) from one communication point to the next."""

    def __init__(self, request: dict[str, Any]) -> None:
        super().__init__(request)
        self.next_event_s: float | None = None
        if self._update():
            raise Refusal("asked to end during its initialisation")
        derivatives = self.fmu.getContinuousStateDerivatives if self.three else self.fmu.getDerivatives
        self.solver = _cvode(
            nx=self.model["states"],
            nz=self.model["indicators"],
            get_x=self.fmu.getContinuousStates,
            set_x=self.fmu.setContinuousStates,
            get_dx=derivatives,
            get_z=self.fmu.getEventIndicators,
            get_nominals=self.fmu.getNominalsOfContinuousStates,
            set_time=self.fmu.setTime,
            input=_ConstantInputs(),
            startTime=request["start_s"],
            relativeTolerance=request["tolerance"] or SOLVER_TOLERANCE,
        )

    def _update(self) -> bool:
        """Event iteration into continuous time; whether the FMU requests the end."""
        update = self.fmu.updateDiscreteStates if self.three else self.fmu.newDiscreteStates
        again, ended = True, False
        while again and not ended:
            again, ended, _, _, defined, next_s = update()
        self.next_event_s = next_s if defined else None
        if not ended:
            self.fmu.enterContinuousTimeMode()
        return ended

    def put(self, values: list[float]) -> None:
        super().put(values)
        self._restart = bool(self.inputs)

    def step(self, time_s: float, step_s: float) -> tuple[float, bool]:
        end_s = time_s + step_s
        if self._restart:  # inputs jump at a communication point
            self.solver.reset(time_s)
        while time_s < end_s - SAME_TIME_S:
            next_event_s = math.inf if self.next_event_s is None else self.next_event_s
            event, time_s = self._solve(time_s, min(end_s, next_event_s))
            self.fmu.setTime(time_s)
            ended = False
            if self.model["step_events"]:
                step_event, ended = self.fmu.completedIntegratorStep()
                event = event or step_event
            if not ended and (event or time_s >= next_event_s - SAME_TIME_S):
                self.fmu.enterEventMode()
                ended = self._update()
                self.solver.reset(time_s)
            if ended:
                return time_s, True
        return end_s, False

    def _solve(self, time_s: float, target_s: float) -> tuple[bool, float]:
        """Integrate to a time, or to an event before it; whether there is an event, and the time reached."""
        try:
            event, _, reached_s = self.solver.step(time_s, target_s)
        except RuntimeError as error:
            raise Refusal(f"cannot be integrated: {str(error).rpartition('.c: ')[2]}") from None
        return bool(event), reached_s


def serve(requests: Any, answers: Any) -> None:
    """Answer requests until they end or one fails."""

    def answer(**content: Any) -> None:
        answers.write(json.dumps(content) + "\n")
        answers.flush()

    answer(ready=True)
    try:
        request = json.loads(requests.readline())
        kind = CoSimulation if request["model"]["interface"] == "co-simulation" else ModelExchange
        instance = kind(request)
        answer(time_s=request["start_s"], values=instance.values(), ended=False)
        for line in requests:
            request = json.loads(line)
            instance.put(request["inputs"])
            time_s, ended = instance.step(request["time_s"], request["step_s"])
            answer(time_s=time_s, values=instance.values(), ended=ended)
        instance.fmu.terminate()
        instance.fmu.freeInstance()
    except Exception as error:  # the parent reports it, whatever it is
        answer(error=str(error) or type(error).__name__)


def end_with_parent(parent: int) -> None:
    """Kill this process and all that it started as soon as its parent has ended; where the platform has groups."""
    while os.getppid() == parent:
        time.sleep(WATCH_S)
    os.killpg(os.getpid(), signal.SIGKILL)


if __name__ == "__main__":
    if hasattr(os, "killpg"):
        # Otherwise an FMU that has started processes would outlive a killed program.
        threading.Thread(target=end_with_parent, args=[int(sys.argv[1])], daemon=True).start()
    # An FMU may print at any time. Answers get a descriptor of their own, and what it prints goes to the log.
    private = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    serve(sys.stdin, private)
