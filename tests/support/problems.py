"""The timed problem: the Orbiter's lower-surface plug (coating, tile, strain isolator, structure) through an entry.

Conditions, manoeuvres included, are those of the practice record p06 under tests/data, stretched to 1500 s.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sim_heating.base.kernels.block import CONDITION_COLUMNS, H_REF, LANES, TIME
from sim_heating.inputs.points import conditions_of_record, point_of_record
from sim_heating.inputs.record import load_record
from sim_heating.march.ensemble import Ensemble, condition_history
from sim_heating.march.point import PointModel
from sim_heating.thermal.mesh import Mesh, build_mesh
from tests.support.paths import PRACTICE

FloatArray = NDArray[np.float64]

RECORD = PRACTICE / "p06"
ENTRY_S = 1500.0
NOTHING = np.array([], dtype=np.int64)
"""Keep no histories."""


def plug() -> PointModel:
    """The control point as the record declares it."""
    return point_of_record(load_record(RECORD))


def entry(step_s: float, end_s: float = ENTRY_S) -> tuple[FloatArray, FloatArray]:
    """Times and (flight, time, condition) of the entry at a sample interval [s]."""
    conditions = conditions_of_record(load_record(RECORD))
    history = condition_history(conditions)
    t = conditions.time_s * (ENTRY_S / conditions.time_s[-1])
    time_s = np.linspace(0.0, end_s, round(end_s / step_s) + 1)
    columns = [np.interp(time_s, t, history[:, c]) for c in range(len(CONDITION_COLUMNS))]
    columns[TIME] = time_s
    return time_s, np.column_stack(columns)[np.newaxis].copy()


def points(count: int) -> list[PointModel]:
    """Control points that differ in coating and emittance, and with period LANES in ratio, all of one construction."""
    base = plug()
    return [
        replace(
            base,
            name=f"{base.name}_{i}",
            parameters={
                "ratio.scale": 0.1 * np.sin(i % LANES),
                "ratio.d_alpha": 3e-4 * np.cos(i % LANES),
                "stack.coating.thickness_factor": 1.0 + 0.1 * np.sin(2.0 * i),
                "stack.emissivity_factor": 1.0 + 0.02 * np.cos(3.0 * i),
            },
        )
        for i in range(count)
    ]


def ensemble_of(models: list[PointModel], nodes: int) -> Ensemble:
    """The points on one mesh of a number of nodes."""
    return Ensemble(models, [mesh_of(models[0], nodes)] * len(models), 1.0)


def mesh_of(model: PointModel, nodes: int) -> Mesh:
    """The mesh of a point with a number of nodes, graded for steps of 1 s."""
    return build_mesh(model.construction, np.array(model.depths_m), nodes, 1.0)


def prescribed(history: FloatArray, model: PointModel) -> tuple[PointModel, FloatArray]:
    """The entry with the film coefficient itself in the history, linear between samples: ratio 1 without a table.

    Every integrator then reads the same few functions of time, and none is charged for the ratio table.
    """
    time_s = history[0, :, TIME]
    out = history.copy()
    ensemble = Ensemble([model], [mesh_of(model, 24)], 1.0)
    film = ensemble.march(time_s, history, keep=ensemble.film_offsets()[:1])
    out[0, :, H_REF] = film[:, 0]
    return replace(model, ratio=None, parameters={"ratio.d0": 1.0}), out
