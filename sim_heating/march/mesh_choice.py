"""Choice of the mesh of a stack: trial heatings, and the flight where it is known, on a mesh and its refinement.

Two trial heatings resemble entries with steps of heating. In one a flux drives the surface towards a radiation
equilibrium near its highest temperature of use. In the other a film whose recovery temperature is that temperature
drives it, since a surface of low emittance meets heating that has nothing to do with what it radiates. The change when
every element is halved, times 4/3 for a second-order method and a factor of safety, estimates the error of the coarser
mesh; the coarsest mesh below the tolerance is taken. Where the conditions of a flight are known, that mesh is confirmed
on them, or refined until it is. Equations: docs/theory/equations_march.md, equations 16 and 17.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from typing import TypeVar

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import Conditions
from sim_heating.base.errors import RunError
from sim_heating.base.kernels.block import CONDITION_COLUMNS, H_REF, P_SURFACE, Q_ADD, RECOVERY_ENTHALPY
from sim_heating.heating.effects import Effect
from sim_heating.heating.ratio.lookup import pack_table
from sim_heating.march.ensemble import Ensemble, condition_history
from sim_heating.march.point import PointModel, heating_vector, kernel_effects, stack_values
from sim_heating.thermal.faces import SIGMA
from sim_heating.thermal.frame import STEP_TOLERANCE_K
from sim_heating.thermal.mesh import Mesh, build_mesh, fewest_nodes, halve_elements
from sim_heating.thermal.stack import pairs

TOLERANCE_K = 0.3
"""Error estimate of the automatic mesh at surface, bondline and sensors [K], on the trial heatings to the highest
temperature of use, and on the flight where it is known."""
NODE_COUNTS = (14, 16, 20, 24, 28, 32, 40, 48, 56, 64, 72, 80, 100, 128, 160, 200)
"""Node counts tried; few different ones, so that points share lane groups."""
SAFETY = 1.1
"""Factor on the estimate [-], so that errors of higher order do not make the true error larger: they are 1 to 2 % in
the walls and heatings of tests/march/test_mesh_choice.py."""
RULED_OUT = 4.0
"""An error of second order that would be this many times the tolerance on a larger mesh rules out that mesh [-]."""
PULSE_TIME_S = np.array([0.0, 300.0, 440.0, 441.0, 470.0, 471.0, 600.0, 900.0, 1200.0])
PULSE_SHAPE = np.array([0.0, 1.0, 1.0, 0.5, 0.5, 1.0, 0.9, 0.1, 0.0])
"""Shape of both trial heatings [-]: an entry, with steps of half of the heating within a second."""
PULSE_PRESSURE_PA = 1000.0
NOMINAL_SURFACE_K = 1300.0
"""Surface temperature of the trial where the first layer names no highest temperature of use."""
FILM_EMITTANCE = 0.85
"""The film of the trial heats a cold wall with what a surface of this emittance radiates at the temperature of use."""
FILM_CP_J_KGK = 1004.5
"""Specific heat of the air of the film [J/(kg K)]; it divides out of the flux."""
COMPARED_K = 0.1 * STEP_TOLERANCE_K
"""Largest error of a time step of the marches that are compared [K]: their difference is to be that of the meshes."""
KEPT = 1000
"""Number of meshes chosen on flights that are kept."""


def pack(
    models: Sequence[PointModel],
    step_s: float = 1.0,
    tolerance_K: float = STEP_TOLERANCE_K,
    behind: Mapping[int, int] | None = None,
) -> Ensemble:
    """Ensemble of control points on meshes chosen for them.

    models : control points;  step_s : longest time step [s] of the marches to come
    tolerance_K : largest error of a time step [K]
    behind : point -> the wall upstream of its interface, by their numbers (Ensemble)
    raises : RunError where a trial march on a mesh did not converge

    Error estimates of docs/theory/equations_march.md, equation 16, are below 0.3 K.
    """
    meshes = [mesh for mesh, _ in choose_meshes(models, step_s)]
    return Ensemble(models, meshes, step_s, tolerance_K=tolerance_K, behind=behind)


def choose_meshes(models: Sequence[PointModel], step_s: float = 1.0) -> list[tuple[Mesh, float | None]]:
    """Mesh of each control point with its error estimate on trial heatings, eps = 4/3 F max |T_h - T_(h/2)|.

    models  : control points;  step_s : longest time step of the marches to come [s], which also grades the mesh
    returns : (mesh, error [K]) of each point, of 14, 16, 20 ... 200 nodes the first whose estimate is below 0.3 K, else
              the largest; None for the error where the point prescribes its node count
    raises  : RunError where a trial march did not converge

    Surface, bondline and sensors are compared. The trials heat to the highest temperature of use, with steps of half of
    the heating: a flight that heats more, or at once, may have a larger error (`meshes_on_flights`). Results are cached
    for each stack, sensors, node count and step. Derived in docs/theory/equations_march.md, equations 16 and 17.
    """
    keys = [_key(m, step_s) for m in models]
    new = {key: m for key, m in zip(keys, models, strict=True) if key not in _CHOSEN}
    _CHOSEN.update({key: (mesh_of_nodes(m, m.nodes, step_s), None) for key, m in new.items() if m.nodes is not None})
    _CHOSEN.update(_refine_on_trials({key: m for key, m in new.items() if m.nodes is None}, step_s))
    return [_CHOSEN[key] for key in keys]


def meshes_on_flights(
    models: Sequence[PointModel], flights: Sequence[Conditions], step_s: float = 1.0
) -> list[tuple[Mesh, float | None]]:
    """Mesh of each control point with its error estimate on its own flight, eps = 4/3 F max |T_h - T_(h/2)|.

    models  : control points;  flights : conditions of each, on common times
    step_s  : longest time step of the marches to come [s]
    returns : (mesh, error [K]) of each point: the mesh of `choose_meshes`, refined where its error on the flight is not
              below 0.3 K; one of a prescribed node count is kept. None for the error where a step did not converge, as
              with parameters that cool a wall to 0 K
    raises  : RunError where a trial march did not converge

    Results are cached for each point and flight. Derived in docs/theory/equations_march.md, equation 16.
    """
    meshes = [mesh for mesh, _ in choose_meshes(models, step_s)]
    time_s, histories = flights[0].time_s, list(map(condition_history, flights))
    keys = [_flown_key(m, mesh, step_s, time_s, h) for m, mesh, h in zip(models, meshes, histories, strict=True)]
    confirmed = {key: _CONFIRMED[key] for key in keys if key in _CONFIRMED}
    trying = {i: mesh for i, (key, mesh) in enumerate(zip(keys, meshes, strict=True)) if key not in confirmed}
    refined = _refine_on_flights(models, trying, step_s, time_s, histories)
    confirmed |= {keys[i]: of_point for i, of_point in refined.items()}
    _CONFIRMED.update(confirmed)
    while len(_CONFIRMED) > KEPT:
        _CONFIRMED.pop(next(iter(_CONFIRMED)), None)
    return [confirmed[key] for key in keys]


def _refine_on_flights(
    models: Sequence[PointModel],
    trying: Mapping[int, Mesh],
    step_s: float,
    time_s: FloatArray,
    histories: Sequence[FloatArray],
) -> dict[int, tuple[Mesh, float | None]]:
    """Point -> mesh and its error on the point's flight [K], from the meshes to try first."""
    refined: dict[int, tuple[Mesh, float | None]] = {}
    while trying:
        flown = np.stack([histories[i] for i in trying])
        errors = _flown_errors([models[i] for i in trying], list(trying.values()), step_s, time_s, flown)
        tried = dict(zip(trying, zip(trying.values(), errors, strict=True), strict=True))
        refined |= tried
        finer = {i: _finer_mesh(models[i], *of_point, step_s) for i, of_point in tried.items()}
        trying = {i: mesh for i, mesh in finer.items() if mesh is not None}
    return refined


def _finer_mesh(model: PointModel, mesh: Mesh, error_K: float | None, step_s: float) -> Mesh | None:
    """The mesh to try next on a flight; None where the error is small or not known, or the node count prescribed."""
    nodes = None if error_K is None or model.nodes is not None else _next_count(mesh.nodes, error_K)
    return None if nodes is None else mesh_of_nodes(model, nodes, step_s)


_Key = tuple[str, tuple[float, ...], int | None, float]
_CHOSEN: dict[_Key, tuple[Mesh, float | None]] = {}


def _key(model: PointModel, step_s: float) -> _Key:
    return model.construction.model_dump_json(), model.depths_m, model.nodes, step_s


def mesh_of_nodes(model: PointModel, nodes: int, step_s: float) -> Mesh:
    """Mesh of a control point with a prescribed node count, at least what its interfaces and sensors need.

    model  : the point, its sensor depths in [m];  nodes : prescribed node count
    step_s : longest time step, which sets how fine the mesh is at the surface [s]

    Derived in docs/theory/equations_march.md, section 4.
    """
    depths = np.array(model.depths_m, dtype=float)
    return build_mesh(model.construction, depths, max(nodes, fewest_nodes(model.construction, depths)), step_s)


Key = TypeVar("Key")


def _next_count(nodes: int, error_K: float) -> int | None:
    """The node count to try after one with an error; None where that is below the tolerance, or after the last.

    Counts that the second order of the error rules out by far are passed over.
    """
    larger = [count for count in NODE_COUNTS if count > nodes]
    if error_K < TOLERANCE_K or not larger:
        return None
    hopeless = nodes * np.sqrt(error_K / (RULED_OUT * TOLERANCE_K))
    return next((count for count in larger if count >= hopeless), larger[-1])


def _refine_on_trials(models: Mapping[Key, PointModel], step_s: float) -> dict[Key, tuple[Mesh, float | None]]:
    """Refine all models together, eight in a lane group, until the errors on the trials are below the tolerance."""
    fewest = {key: fewest_nodes(m.construction, np.array(m.depths_m)) for key, m in models.items()}
    counts = {key: next((n for n in NODE_COUNTS if n >= least), least) for key, least in fewest.items()}
    done: dict[Key, tuple[Mesh, float | None]] = {}
    while counts:
        trying = [models[key] for key in counts]
        meshes = [mesh_of_nodes(m, n, step_s) for m, n in zip(trying, counts.values(), strict=True)]
        errors = _trial_errors(trying, meshes, step_s)
        again: dict[Key, int] = {}
        for key, mesh, error in zip(counts, meshes, errors, strict=True):
            done[key] = (mesh, error)
            nodes = _next_count(mesh.nodes, error)
            if nodes is not None:
                again[key] = nodes
        counts = again
    return done


_FlownKey = tuple[bytes, tuple[Effect, ...]]
_CONFIRMED: dict[_FlownKey, tuple[Mesh, float | None]] = {}


def _flown_key(model: PointModel, mesh: Mesh, step_s: float, time_s: FloatArray, history: FloatArray) -> _FlownKey:
    """Digest of all numbers that the temperatures of a point on a flight depend on, and its effects."""
    parts = [mesh.length_m, stack_values(model), heating_vector(model), time_s, history]
    if model.ratio is not None:
        parts.append(pack_table(model.ratio))
    digest = hashlib.sha256(repr((_key(model, step_s), model.wall_enthalpy)).encode())
    for numbers in parts:
        digest.update(np.ascontiguousarray(numbers).tobytes())
    return digest.digest(), tuple(use.effect for use in kernel_effects(model))


def _mesh_errors(
    points: Sequence[PointModel], meshes: Sequence[Mesh], step_s: float, time_s: FloatArray, histories: FloatArray
) -> list[float]:
    """Largest change of surface, bondline and sensor temperatures when every element is halved, times 4/3 F [K].

    histories : (point, time, condition)
    """
    coarse, fine = (
        Ensemble(points, m, step_s, tolerance_K=COMPARED_K).march(time_s, histories, range(len(points)))
        for m in (meshes, [halve_elements(mesh) for mesh in meshes])
    )
    change = np.max(np.abs(coarse - fine), axis=0)
    ends = np.cumsum([2 + len(point.depths_m) for point in points])
    return [float(SAFETY * 4.0 / 3.0 * np.max(of_point)) for of_point in np.split(change, ends[:-1])]


def _flown_errors(
    points: Sequence[PointModel], meshes: Sequence[Mesh], step_s: float, time_s: FloatArray, histories: FloatArray
) -> list[float | None]:
    """Errors of meshes on flights [K]; None for a point whose march did not converge."""
    try:
        return [*_mesh_errors(points, meshes, step_s, time_s, histories)]
    except RunError:
        if len(points) == 1:
            return [None]
    alone = [
        _flown_errors([p], [mesh], step_s, time_s, h[np.newaxis])
        for p, mesh, h in zip(points, meshes, histories, strict=True)
    ]
    return [error for (error,) in alone]


def _trial_errors(models: Sequence[PointModel], meshes: Sequence[Mesh], step_s: float) -> list[float]:
    """The larger of the errors [K] of each mesh on the two trial heatings."""
    # Without ratio, parameters and effects: the trial is a prescribed heating, and the mesh depends on the stack alone.
    bare = [
        PointModel(m.name, m.construction, m.depths_m, parameters={"ratio.d0": 1.0}, wall_enthalpy=FILM_CP_J_KGK)
        for m in models
    ]
    # A short step would cost time and change nothing: steps are divided where their error asks for it.
    step = max(step_s, 1.0)
    time_s = np.linspace(0.0, PULSE_TIME_S[-1], int(np.ceil(PULSE_TIME_S[-1] / step)) + 1)
    shape = np.interp(time_s, PULSE_TIME_S, PULSE_SHAPE)
    histories = np.zeros((2, len(models), len(time_s), len(CONDITION_COLUMNS)))
    histories[..., P_SURFACE] = PULSE_PRESSURE_PA
    for i, point in enumerate(bare):
        outer = point.construction.layer_materials()[0]
        hottest_K = outer.max_use_K or NOMINAL_SURFACE_K
        black_W_m2, recovery_J_kg = SIGMA * hottest_K**4, FILM_CP_J_KGK * hottest_K
        histories[0, i, :, Q_ADD] = shape * np.interp(hottest_K, *pairs(outer.emissivity or [[0.0, 1.0]])) * black_W_m2
        histories[1, i, :, H_REF] = shape * FILM_EMITTANCE * black_W_m2 / recovery_J_kg
        histories[1, i, :, RECOVERY_ENTHALPY] = recovery_J_kg
    both = histories.reshape(-1, *histories.shape[2:])
    errors = _mesh_errors([*bare, *bare], [*meshes, *meshes], step, time_s, both)
    return np.max(np.reshape(errors, (2, -1)), axis=0).tolist()
