"""Properties of the method: orders of convergence, conservation of energy, sensitivities, a search at a kink."""

from __future__ import annotations

import math

import numpy as np

from sim_heating.base.parameters import Parameter
from sim_heating.estimation.inference.model_error import HeatingNoise
from sim_heating.estimation.inference.newton import Evaluation, maximise
from sim_heating.inputs.points import conditions_of_record, point_of_record
from sim_heating.inputs.record import load_record
from sim_heating.march.ensemble import Ensemble, condition_history
from sim_heating.march.linearised import LinearMarch, Track
from sim_heating.march.mesh_choice import choose_meshes, pack
from sim_heating.march.point import PointModel
from sim_heating.thermal.frame import NOT_CONTROLLED_K
from sim_heating.thermal.mesh import Mesh, build_mesh, halve_elements
from tests.support.problems import RECORD
from tests.support.verification import exact
from tests.support.verification.conduction import CARSLAW, A
from tests.support.verification.row import Row, within
from tests.support.walls import even_mesh, flight, material, wall


def cosine_error(mesh: Mesh, step_s: float) -> float:
    """Largest error [K] of a decaying 100 K cosine after 5 s, at fixed steps."""
    model = PointModel("wall", wall((material(), 0.01)))
    ensemble = Ensemble([model], [mesh], step_s, tolerance_K=NOT_CONTROLLED_K)
    ensemble.set_profile(0, 1000.0 + 100.0 * exact.cosine_decay(A, 0.01, 1, mesh.depth_m, 0.0))
    t = np.array([0.0, 5.0])
    ensemble.march(t, flight(t))
    expected = 1000.0 + 100.0 * exact.cosine_decay(A, 0.01, 1, mesh.depth_m, 5.0)
    return float(np.max(np.abs(ensemble.node_temperatures(0) - expected)))


def orders() -> list[Row]:
    """Orders at which the error of a decaying mode falls."""
    fine, graded = even_mesh(0.01, 128), build_mesh(wall((material(), 0.01)), np.array([]), 14)
    equal, finer = even_mesh(0.01, 8), halve_elements(graded)
    cases = (
        ("in time", 2.0, cosine_error(fine, 0.25), cosine_error(fine, 0.125)),
        ("in space, equal elements", 4.0, cosine_error(equal, 0.005), cosine_error(halve_elements(equal), 0.005)),
        ("in space, graded mesh", 2.0, cosine_error(finer, 0.005), cosine_error(halve_elements(finer), 0.005)),
    )
    is_ = "next term of the expansion"
    return [
        Row(f"order of convergence {name}", order, math.log2(coarse / half), 0.05, "-", f"{CARSLAW}, 3.3", is_)
        for name, order, coarse, half in cases
    ]


def energy() -> list[Row]:
    """Heat gained by a radiating wall of constant properties, and heat that entered it."""
    w = wall((material(2.0, 900.0, 1500.0, 0.85), 0.02), back={"h_W_m2K": 20.0, "T_K": 280.0, "emissivity": 0.8})
    ensemble, t = pack([PointModel("wall", w)]), np.linspace(0.0, 600.0, 301)
    before = ensemble.node_temperatures(0).copy()
    ensemble.march(t, flight(t, q_add_W_m2=8e4 * np.sin(np.pi * t / 600.0)))
    rise = ensemble.node_temperatures(0) - before
    gained = 1500.0 * 900.0 * float(np.sum(0.5 * ensemble.meshes[0].length_m * (rise[1:] + rise[:-1])))
    entered = float(ensemble.counters.absorbed_J_m2[0] - ensemble.counters.emitted_J_m2[0])
    source, is_ = "rho c times the rise, by nodes", "rounding and Newton's last update over 300 steps"
    return [within(1e-10, "heat that entered a wall, emission and back included", gained, entered, "J/m2", source, is_)]


def sensitivities() -> list[Row]:
    """Derivatives of a thermocouple at the end of an entry, against differences of the march itself."""
    record = load_record(RECORD)
    model, conditions = point_of_record(record), conditions_of_record(record)
    mesh, time_s = choose_meshes([model])[0][0], conditions.time_s
    history, samples = condition_history(conditions)[np.newaxis], np.array([900.0])
    steps = {"ratio.scale": 0.01, "ratio.d_alpha": 1e-4, "stack.emissivity_factor": 0.01}
    steps["stack.coating.thickness_factor"] = 0.02
    found = LinearMarch([Track(model, mesh, tuple(steps), samples)], time_s, history).march()[0].sensitivity[0, 0]

    def temperature(name: str, value: float) -> float:
        moved = model.with_parameters({name: value})
        ensemble = Ensemble([moved], [mesh], tolerance_K=NOT_CONTROLLED_K)
        return float(ensemble.march(time_s, history)[int(np.searchsorted(time_s, samples[0])), 2])

    rows = []
    for (name, h), got in zip(steps.items(), found, strict=True):
        at = {k: temperature(name, model.value(name) + k * h) for k in (-2, -1, 1, 2)}
        difference = (8.0 * (at[1] - at[-1]) - (at[2] - at[-2])) / (12.0 * h)
        source, is_ = "central differences of fourth order", "corners of property tables within the difference"
        rows.append(
            within(1e-5, f"derivative of a thermocouple at 900 s to {name}", difference, float(got), "K", source, is_)
        )
    return rows


def kinks() -> list[Row]:
    """A maximum on a ridge that is not smooth: two readings of (1, 2), less 50 times the excess of x + y over 2.3."""

    def evaluate(p: np.ndarray) -> Evaluation:
        left, beyond = p - np.array([1.0, 2.0]), float(p.sum()) - 2.3
        L = -0.5 * float(left @ left) - 50.0 * max(beyond, 0.0)
        return Evaluation(L, -left - 50.0 * np.ones(2) * (beyond > 0.0), np.eye(2))

    parameters = [Parameter(name, "1", 0.0, math.inf) for name in ("x", "y")]
    fit = maximise(evaluate, parameters, [4.0, -1.0])
    name, is_ = "maximum at a kink of the likelihood", "0.001 of a sigma across it, two of them"
    source = "nearest point of the ridge"
    rows = [
        Row(f"{name}: {p}", expected, float(got), 2e-3, "-", source, is_)
        for p, expected, got in zip(("x", "y"), (0.65, 1.65), fit.values, strict=True)
    ]
    return [*rows, Row(f"{name}: converged (1)", 1.0, float(fit.converged), 0.0, "-", "yes", "yes or no")]


def noise_of_conditions() -> list[Row]:
    """White noise of 200 rows, 2 s apart, at knots 10 s apart: the same spectrum at low frequencies."""
    t = np.arange(0.0, 400.0, 2.0)
    noise = HeatingNoise(t, np.full(len(t), 0.03))
    knots = np.arange(0.0, 400.0, 10.0)
    got = float(np.median(noise.at_knots(knots)))
    name = "white noise of 0.03 in rows 2 s apart, at knots 10 s apart: standard deviation"
    return [Row(name, 0.03 * math.sqrt(2.0 / 10.0), got, 1e-6, "-", "n sqrt(d / h)", "rounding")]


def rows() -> list[Row]:
    """All of this subject."""
    return [*orders(), *energy(), *sensitivities(), *kinks(), *noise_of_conditions()]
