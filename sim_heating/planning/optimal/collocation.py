"""Optimal control by direct collocation: Radau points, IPOPT, mesh refinement.

    maximise goal(x(t_f))    with    dx/dt = f(x, u),  x(0) = x_0,  some of x(t_f) given or bounded,
                                     path(x, u) <= bound,  bounds on x, u and t_f

States are polynomials of degree 3 on each interval that satisfy dx/dt = f at its three Radau points (order 5 at its
end); controls are continuous and linear on each interval, so that the solution can be flown as it is. Paths are bounded
at the Radau points. The error of an interval is the distance of its end state from an independent integration across it
(Runge-Kutta, 16 steps); intervals with too large an error, and those in which a control bends, are halved.
Source: Betts, "Practical Methods for Optimal Control and Estimation Using Nonlinear Programming", 2nd ed., SIAM 2010,
chapter 4; Waechter and Biegler, Math. Program. 106 (2006) 25-57 (IPOPT).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.errors import InputError, RunError
from sim_heating.base.kernels.axis import cells_of

try:
    import casadi as ca
except ImportError:
    ca = None  # type: ignore[assignment]

DEGREE = 3
"""Degree of the polynomial of a state on an interval."""
SUBSTEPS = 16
"""Runge-Kutta steps across an interval, for its error estimate."""
SHORTEST_INTERVAL_S = 2.0
"""Shortest interval that halving makes [s]."""
ITERATIONS = 300
IPOPT = {
    "print_level": 0,
    "sb": "yes",
    "tol": 1e-8,
    "constr_viol_tol": 1e-9,
    "max_iter": ITERATIONS,
    "mu_strategy": "adaptive",
}
WARM = {
    "warm_start_init_point": "yes",
    "mu_strategy": "monotone",
    "mu_init": 1e-5,
    "warm_start_bound_push": 1e-7,
    "warm_start_mult_bound_push": 1e-7,
    "warm_start_slack_bound_push": 1e-7,
}
"""Options of IPOPT, and those added where it starts from the previous solution."""
ACCEPTED = ("Solve_Succeeded", "Solved_To_Acceptable_Level")
STATUS = {
    "Infeasible_Problem_Detected": "no flight meets all bounds at once; relax a limit or the final state",
    "Restoration_Failed": "no flight was found that meets all bounds at once; relax a limit or the final state",
    "Maximum_Iterations_Exceeded": f"the optimiser did not converge in {ITERATIONS} iterations; relax a limit",
}


def require_casadi() -> None:
    """Check that the optimiser is there; raises InputError where CasADi is not installed."""
    if ca is None:
        raise InputError("optimal entry: CasADi is not installed: pip install 'sim-heating[plan]'")


@dataclass(frozen=True)
class OptimalControlProblem:
    """A function of the final state to be maximised, and the motion that leads there.

    model  : CasADi function (x, u) -> dx/dt, paths (none or more);  goal : x -> quantity to be maximised
    scale, control_scale : typical sizes of states and controls
    lower, upper, control_lower, control_upper : their bounds
    start  : (state,) at time 0;  end : number of a state -> its value at the end
    duration_s : shortest and longest [s]
    control_rates : fastest change of each control, in its unit per second; infinite where free
    """

    model: Any
    goal: Any
    scale: FloatArray
    control_scale: FloatArray
    lower: FloatArray
    upper: FloatArray
    control_lower: FloatArray
    control_upper: FloatArray
    start: FloatArray
    end: Mapping[int, float]
    duration_s: tuple[float, float]
    control_rates: FloatArray = field(default_factory=lambda: np.array([np.inf]))


@dataclass(frozen=True)
class UpperBounds:
    """Upper bounds of each path (none where empty) and of states at the end, by their number."""

    path: Sequence[float] = ()
    end: Mapping[int, float] = field(default_factory=dict)


FREE = UpperBounds()


@dataclass(frozen=True)
class Motion:
    """A motion on a mesh: states at the start and 3 points of each interval, controls at the ends of the intervals.

    mesh       : (interval + 1,) ends of the intervals as fractions of the duration, from 0 to 1
    states     : (state, 3 interval + 1);  controls : (control, interval + 1)
    goal       : the quantity that was maximised
    errors     : (interval,) error estimate over the scale of the states
    iterations : of IPOPT
    """

    mesh: FloatArray
    duration_s: float
    states: FloatArray
    controls: FloatArray
    goal: float = float("nan")
    errors: FloatArray = field(default_factory=lambda: np.zeros(0))
    iterations: int = 0

    @property
    def time_s(self) -> FloatArray:
        """Times of the states [s]."""
        return self.duration_s * collocation_times(self.mesh)

    def controls_at(self, time_s: FloatArray) -> FloatArray:
        """(control, time) controls at times [s]."""
        nodes = self.duration_s * self.mesh
        return np.array([np.interp(time_s, nodes, u) for u in self.controls])

    def states_at(self, time_s: FloatArray) -> FloatArray:
        """(state, time) states at times [s] by the polynomials of the intervals."""
        tau = np.clip(np.asarray(time_s) / self.duration_s, 0.0, 1.0)
        k = cells_of(self.mesh, tau)
        inside = (tau - self.mesh[k]) / (self.mesh[k + 1] - self.mesh[k])
        points = _points()
        weights = np.array(
            [
                np.prod([(inside - q) / (p - q) for j, q in enumerate(points) if j != i], axis=0)
                for i, p in enumerate(points)
            ]
        )
        return sum(weights[i] * self.states[:, DEGREE * k + i] for i in range(DEGREE + 1))


def _points() -> FloatArray:
    """0 and the Radau points of an interval from 0 to 1."""
    return np.array([0.0, *ca.collocation_points(DEGREE, "radau")])


def collocation_times(mesh: FloatArray) -> FloatArray:
    """(3 interval + 1,) beginning and Radau points of all intervals of a mesh."""
    inside = mesh[:-1, np.newaxis] + np.diff(mesh)[:, np.newaxis] * _points()[1:]
    return np.concatenate(([mesh[0]], inside.ravel()))


class Transcription:
    """An optimal control problem on a mesh, as a nonlinear program that can be solved for several bounds.

    Each interval has its own variable for the duration, all constrained to be equal, so that the matrices stay banded.
    """

    def __init__(self, problem: OptimalControlProblem, mesh: FloatArray) -> None:
        require_casadi()
        self.problem, self.mesh, self.count = problem, mesh, len(mesh) - 1
        self.shape = (len(problem.start), DEGREE * self.count + 1)
        self.control_shape = (len(problem.control_lower), len(mesh))
        self.paths = problem.model.size1_out(1)
        rates = np.broadcast_to(problem.control_rates, self.control_shape[:1])
        self._limited_rates = [(i, float(rate)) for i, rate in enumerate(rates) if np.isfinite(rate)]
        self._time_scale = float(np.mean(problem.duration_s))
        nlp, options = self._program(), dict[str, Any](print_time=False)
        self._cold = ca.nlpsol("cold", "ipopt", nlp, options | {"ipopt": IPOPT})
        self._warm = ca.nlpsol("warm", "ipopt", nlp, options | {"ipopt": IPOPT | WARM})
        self._across = self._error_function().map(self.count)
        self._last: dict[str, Any] = {}

    def _program(self) -> dict[str, Any]:
        durations = ca.MX.sym("durations", 1, self.count)
        X, U = ca.MX.sym("X", *self.shape), ca.MX.sym("U", *self.control_shape)
        inside = ca.vertcat(*(X[:, j : DEGREE * (self.count - 1) + j + 1 : DEGREE] for j in range(DEGREE + 1)))
        ends = ca.vertcat(U[:, :-1], U[:, 1:])
        lengths = ca.DM(np.diff(self.mesh)).T
        defects, path, turns = self._interval_function().map(self.count)(inside, ends, durations, lengths)
        return {
            "x": ca.vertcat(ca.vec(durations), ca.vec(X), ca.vec(U)),
            "f": -self.problem.goal(X[:, -1] * self.problem.scale),
            "g": ca.vertcat(ca.vec(defects), ca.vec(durations[1:] - durations[:-1]), ca.vec(path), ca.vec(turns)),
        }

    def _interval_function(self) -> Any:
        """(states at 4 points, controls at both ends, duration, length) -> defects and paths at the Radau points, and
        the rates of limited controls over their limits."""
        p, (states, controls) = self.problem, (self.shape[0], self.control_shape[0])
        flat, u = ca.MX.sym("x", states * (DEGREE + 1)), ca.MX.sym("u", 2 * controls)
        duration, length = ca.MX.sym("duration"), ca.MX.sym("length")
        X, (first, last) = ca.reshape(flat, states, DEGREE + 1), (u[:controls], u[controls:])
        points = _points()
        C = np.array(ca.collocation_coeff(list(points[1:]))[0])
        defects, path = [], []
        for j in range(1, DEGREE + 1):
            at = X[:, j] * p.scale, (first + points[j] * (last - first)) * p.control_scale
            rates, paths = p.model(*at)
            defects.append(ca.mtimes(X, ca.DM(C[:, j - 1])) - length * duration * self._time_scale * rates / p.scale)
            path.append(paths)
        seconds = length * duration * self._time_scale
        turns = [(last[i] - first[i]) * p.control_scale[i] / (seconds * rate) for i, rate in self._limited_rates]
        outputs = [ca.vertcat(*defects), ca.vertcat(*path), ca.vertcat(ca.MX(0, 1), *turns)]
        return ca.Function("interval", [flat, u, duration, length], outputs)

    def _error_function(self) -> Any:
        """(x, u at both ends, length [s]) -> x at the end, by Runge-Kutta steps."""
        controls, d = self.control_shape[0], 1.0 / SUBSTEPS
        x, u = ca.MX.sym("x", self.shape[0]), ca.MX.sym("u", 2 * controls)
        h, fraction = ca.MX.sym("h"), ca.MX.sym("share")

        def rate(y: Any, s: Any) -> Any:
            return self.problem.model(y, u[:controls] + s * (u[controls:] - u[:controls]))[0]

        k1 = rate(x, fraction)
        k2 = rate(x + 0.5 * d * h * k1, fraction + 0.5 * d)
        k3 = rate(x + 0.5 * d * h * k2, fraction + 0.5 * d)
        k4 = rate(x + d * h * k3, fraction + d)
        step = ca.Function("step", [x, fraction, u, h], [x + d * h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)])
        y = x
        for i in range(SUBSTEPS):
            y = step(y, i * d, u, h)
        return ca.Function("across", [x, u, h], [y])

    def _limits(self, bounds: UpperBounds) -> dict[str, FloatArray]:
        p = self.problem
        X_low, X_high = (np.repeat((b / p.scale)[:, np.newaxis], self.shape[1], axis=1) for b in (p.lower, p.upper))
        X_low[:, 0] = X_high[:, 0] = p.start / p.scale
        for i, value in p.end.items():
            X_low[i, -1] = X_high[i, -1] = value / p.scale[i]
        for i, value in bounds.end.items():
            X_high[i, -1] = value / p.scale[i]
        ends = zip(p.duration_s, (X_low, X_high), (p.control_lower, p.control_upper), strict=True)
        low, high = (
            self._packed(duration, X, np.repeat(u[:, np.newaxis], len(self.mesh), axis=1)) for duration, X, u in ends
        )
        equal = np.zeros(self.shape[0] * (self.shape[1] - 1) + self.count - 1)
        path = np.tile(np.asarray(bounds.path or [np.inf] * self.paths, dtype=float), DEGREE * self.count)
        lowest, turns = np.full(len(path), -np.inf), np.ones(len(self._limited_rates) * self.count)
        return {
            "lbx": low,
            "ubx": high,
            "lbg": np.concatenate((equal, lowest, -turns)),
            "ubg": np.concatenate((equal, path, turns)),
        }

    def solve(self, guess: Motion, bounds: UpperBounds = FREE) -> Motion:
        """The best motion within the bounds.

        guess  : on any mesh; used where there is no previous solution, or none that leads to a new one
        raises : RunError where IPOPT finds no motion, with its status
        """
        limits, status = self._limits(bounds), ""
        # From the last solution first, since bounds change little between rounds; if that fails, from the guess.
        warm = [(self._warm, self._last)] if self._last else []
        for solver, start in [*warm, (self._cold, {"x0": self._flat(guess)})]:
            solution = solver(**start, **limits)
            status = solver.stats()["return_status"]
            if status in ACCEPTED:
                self._last = {"x0": solution["x"], "lam_x0": solution["lam_x"], "lam_g0": solution["lam_g"]}
                x, goal = np.array(solution["x"]).ravel(), -float(solution["f"])
                return self._motion(x, goal, int(solver.stats()["iter_count"]))
        raise RunError(f"no flight was found: {STATUS.get(status, status)}")

    def _flat(self, guess: Motion) -> FloatArray:
        X = guess.states_at(guess.duration_s * collocation_times(self.mesh)) / self.problem.scale[:, np.newaxis]
        return self._packed(guess.duration_s, X, guess.controls_at(guess.duration_s * self.mesh))

    def _packed(self, duration_s: float, X: FloatArray, controls: FloatArray) -> FloatArray:
        """The program's variables from a duration, scaled states and controls."""
        durations = np.full(self.count, duration_s / self._time_scale)
        U = controls / self.problem.control_scale[:, np.newaxis]
        return np.concatenate((durations, X.ravel(order="F"), U.ravel(order="F")))

    def _motion(self, x: FloatArray, goal: float, iterations: int) -> Motion:
        p = self.problem
        first, after = self.count, self.count + self.shape[0] * self.shape[1]
        states = x[first:after].reshape(self.shape, order="F") * p.scale[:, np.newaxis]
        controls = x[after:].reshape(self.control_shape, order="F") * p.control_scale[:, np.newaxis]
        duration = float(x[0]) * self._time_scale
        lengths = duration * np.diff(self.mesh)
        ends = np.array(
            self._across(states[:, :-1:DEGREE], np.vstack([controls[:, :-1], controls[:, 1:]]), lengths.reshape(1, -1))
        )
        errors = np.max(np.abs(ends - states[:, DEGREE::DEGREE]) / p.scale[:, np.newaxis], axis=0)
        return Motion(self.mesh, duration, states, controls, goal, errors, iterations)


def straight_guess(problem: OptimalControlProblem, end: FloatArray, controls: FloatArray, duration_s: float) -> Motion:
    """A first guess: states linear from the start to `end` (state,), controls linear between (control, 2) ends."""
    points = collocation_times(np.array([0.0, 1.0]))
    states = problem.start[:, np.newaxis] + (end - problem.start)[:, np.newaxis] * points
    return Motion(np.array([0.0, 1.0]), duration_s, states, controls)


def refined_mesh(motion: Motion, tolerance: float, bend: FloatArray) -> FloatArray:
    """The mesh of a motion with those intervals halved whose error is too large or in which a control bends.

    bend : (control,) largest distance from a straight line across an interval (u'' h^2 / 8), in the control's unit

    No interval becomes shorter than SHORTEST_INTERVAL_S [s].
    """
    h = np.diff(motion.mesh)
    halve = motion.errors > tolerance
    slopes = np.diff(motion.controls, axis=1) / h
    kinks = np.abs(np.diff(slopes, axis=1)) * np.minimum(h[1:], h[:-1]) / 8.0 > bend[:, np.newaxis]
    bent = np.any(kinks, axis=0)
    # A control bends at a node: both intervals that meet there are halved.
    halve[:-1] |= bent
    halve[1:] |= bent
    halve &= h * motion.duration_s > 2.0 * SHORTEST_INTERVAL_S
    midpoints = 0.5 * (motion.mesh[:-1] + motion.mesh[1:])
    return np.sort(np.concatenate((motion.mesh, midpoints[halve])))
