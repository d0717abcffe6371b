"""Changes of a record without flow: the flux that its wall absorbs is other than its conditions state.

A test under a lamp has no reference heating whose ratio could take up an error of the flux, and the flux of a lamp, or
the absorptance of a surface, is what is known worst in it. Both are one factor of the column `q_add_W_m2`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sim_heating.base.parameters import Parameter
from sim_heating.closure.search.trials.change import RecordChange
from sim_heating.inputs.record import Record

FLUX = Parameter("factor", "1", 1.0, 0.1, 0.1, 10.0, "absorbed flux over that of the conditions")
"""Its standard deviation is a guess: absorptances of paints and fluxes at a place under a lamp scatter by a tenth."""


def lamp_changes(record: Record) -> list[RecordChange]:
    """Another flux of the lamp, or absorptance of the surface; none where air flows past the wall or nothing is lit."""
    flown = record.conditions
    if record.has_flow or "q_add_W_m2" not in flown or not np.any(flown["q_add_W_m2"]):
        return []
    return [RecordChange("flight", "flux of the lamp", FLUX, with_flux, _describe)]


def with_flux(record: Record, factor: float) -> Record:
    """The record with its absorbed flux times a factor [-]."""
    flown = record.conditions
    return replace(record, conditions=flown.with_columns(q_add_W_m2=factor * flown["q_add_W_m2"]))


def _describe(factor: float) -> str:
    percent = 100.0 * abs(factor - 1.0)
    size = f"{percent:{'.0f' if percent >= 10.0 else '.2g'}} % {'above' if factor > 1.0 else 'below'} the stated one"
    return f"flux of the lamp (or absorptance of the surface) {size}"
