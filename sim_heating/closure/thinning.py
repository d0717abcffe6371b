"""A record as a search marches it: with no more samples of its conditions than those between which they are as good as
linear, and on half the nodes. What that changes is taken out where the search begins (search.py)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sim_heating.conditions import Conditions
from sim_heating.points import conditions_of_record
from sim_heating.record import Record

FloatArray = NDArray[np.float64]

LONGEST_S = 2.0
"""Longest step between the samples that are kept [s]."""
TOLERANCES = {
    "alpha_deg": 0.1, "beta_deg": 0.1, "log10_re": 0.01, "elevon_deg": 0.2, "bodyflap_deg": 0.2, "jets": 0.02,
}  # fmt: skip
"""By how much a sample may lie off the line between those that are kept, in its own unit."""
HEATING = 0.002
"""And the heating of a cold wall, over the greatest of the flight."""


def thinned(record: Record, nodes: int) -> Record:
    """The record with fewer samples of its conditions, and `nodes` nodes where it needs no more for its sensors."""
    flown = conditions_of_record(record)
    stack = record.declared.stack.model_copy(update={"nodes": nodes})
    declared = record.declared.model_copy(update={"stack": stack})
    return replace(record, declared=declared, conditions=record.conditions.at(flown.time_s[kept_samples(flown)]))


def kept_samples(flown: Conditions) -> NDArray[np.int64]:
    """(kept,) numbers of the samples that are kept, the first and the last among them."""
    t = flown.time_s
    heating = flown["h_ref_kg_m2_s"] * flown["H_r_J_kg"]
    greatest = float(np.max(np.abs(heating)))
    columns = [heating / (HEATING * greatest)] if greatest > 0.0 else []
    columns += [flown[name] / tolerance for name, tolerance in TOLERANCES.items() if name in flown]
    x = np.column_stack(columns)
    kept = [0]
    while kept[-1] < len(t) - 1:
        i = kept[-1]
        j = max(int(np.searchsorted(t, t[i] + LONGEST_S * (1.0 + 1e-9), side="right")) - 1, i + 1)
        while j > i + 1 and not _straight(t[i : j + 1], x[i : j + 1]):
            j -= 1
        kept.append(j)
    return np.array(kept, dtype=np.int64)


def _straight(t: FloatArray, x: FloatArray) -> bool:
    """Whether all samples lie within 1 of the line from the first to the last."""
    part = (t - t[0]) / (t[-1] - t[0])
    return bool(np.all(np.abs(x - x[0] - part[:, np.newaxis] * (x[-1] - x[0])) <= 1.0))
