"""The flown path of a record as a ratio table sees it, and the linear heating model's parameters along it.

Along the path, the ratio of a table is W n (multilinear weights of its nodes), and that of the linear model

    r(x_t) = r_declared(x_t) + sum_k b_k(x_t) theta_k
    b = r_declared for ratio.scale, 1 for ratio.d0, dx_i, dx_i dx_j for the derivatives

W n - r_declared projected on b by least squares, weights O = (h_ref H_r)^2 as heat flux, gives the table's own value of
theta: P (W n - r_declared) with P = (B' O B)^-1 B' O. What a flight says of a table (closure/revise/evidence.py) and
what a table says of a flight's parameters (prior.py) are both this projection.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from sim_heating.base.arrays import BoolArray, FloatArray
from sim_heating.base.conditions import RATIO_VARIABLES
from sim_heating.base.errors import InputError
from sim_heating.heating.effects import EffectUse
from sim_heating.heating.ratio.uncertainty import basis, declared_ratio
from sim_heating.inputs.points import conditions_of_record, intermittency_along
from sim_heating.inputs.record import Record, in_segments


@dataclass(frozen=True)
class FlownPath:
    """The fitted samples.

    x         : (sample, 5) alpha, beta [deg], log10 Re [-], elevon, body flap [deg]
    weight    : (sample,) weight in the projection [(W/m2)^2]
    declared  : (sample,) ratio of the record's own table [-], 0 without one
    turbulent : (sample,) intermittency of the transition in the fit [-], 0 without one
    by_table  : (sample,) turbulent over laminar ratio of the record's own tables [-], 1 without a turbulent one
    """

    x: FloatArray
    weight: FloatArray
    declared: FloatArray
    turbulent: FloatArray
    by_table: FloatArray

    def subset(self, chosen: BoolArray) -> FlownPath:
        """The chosen samples."""
        return FlownPath(*(getattr(self, f.name)[chosen] for f in fields(self)))


def joined_paths(paths: Sequence[FlownPath]) -> FlownPath:
    """The samples of several paths."""
    return FlownPath(*(np.concatenate([getattr(p, f.name) for p in paths]) for f in fields(FlownPath)))


def record_path(
    record: Record, segments: Sequence[Sequence[float]] | None = None, transition: EffectUse | None = None
) -> FlownPath:
    """The fitted samples of one record.

    segments   : [start_s, end_s] of each, None for those of the record
    transition : the transition of the fit, None without one
    raises     : InputError where no reading lies in them
    """
    t = record.time_s
    fitted = record.fit_mask() if segments is None else in_segments(t, segments) & ~record.holdout_mask()
    fitted &= record.read_mask
    span = record.conditions.time_s[[0, -1]]
    t = t[fitted & (t >= span[0]) & (t <= span[1])]
    if len(t) == 0:
        raise InputError(f"{record.name}: no sample lies in the segments of the estimate; is it the record of the fit?")
    return path_at(record, t, transition)


def marched_path(
    record: Record, segments: Sequence[Sequence[float]], begin_s: float, transition: EffectUse | None
) -> FlownPath:
    """The samples on which the fitted temperatures of a record depend: those read, and the heating before them.

    A temperature follows from the heating before it, also where nothing was read. There, a sample of the conditions
    counts as of a heat flux smaller by (exp(-t / `memory_s`))^2, t the time to the next reading.

    segments   : [start_s, end_s] of each
    begin_s    : time at which the march of the fit began [s]
    transition : the transition of the fit, None without one
    """
    # time in which the temperature under a coating forgets its heating [s], about that of conduction 6 mm into a tile,
    # and the number of such times that count
    memory_s, memories = 60.0, 4.0
    fitted = in_segments(record.time_s, segments) & ~record.holdout_mask() & record.read_mask
    read = record.time_s[fitted]
    flown = record.conditions.time_s
    t = flown[(flown >= begin_s) & (flown <= read[-1])]
    until = read[np.minimum(np.searchsorted(read, t), len(read) - 1)] - t
    near = until < memories * memory_s
    path = path_at(record, t[near], transition)
    return replace(path, weight=path.weight * np.exp(-4.0 * until[near] / memory_s))


def path_at(record: Record, t: FloatArray, transition: EffectUse | None) -> FlownPath:
    """The path of a record at times.

    t          : (sample,) times within the conditions [s]
    transition : the transition of the fit, None without one
    """
    conditions = conditions_of_record(record)
    flown = conditions.at(t)
    x = np.stack([flown[v] for v in RATIO_VARIABLES], axis=1)
    # Weighted by the square of the heat flux, on which the temperatures depend.
    weight = (flown["h_ref_kg_m2_s"] * flown["H_r_J_kg"]) ** 2
    turbulent = np.zeros(len(t))
    if transition is not None:
        turbulent = np.interp(t, conditions.time_s, intermittency_along(transition, conditions))
    declared = declared_ratio(record.ratio_table, x)
    return FlownPath(x, weight, declared, turbulent, turbulent_over_laminar(record, x, declared))


def turbulent_over_laminar(record: Record, x: FloatArray, declared: FloatArray) -> FloatArray:
    """(sample,) turbulent over laminar ratio of a record's own tables [-], 1 without a turbulent one.

    x : (sample, 5) alpha, beta [deg], log10 Re [-], elevon, body flap [deg];  declared : (sample,) laminar ratio [-]
    """
    quotient = np.ones(len(x))
    if record.turbulent is not None:
        # A laminar ratio of 0 heats nothing, in either state of the boundary layer.
        rises = declared != 0.0
        quotient[rises] = declared_ratio(record.turbulent, x)[rises] / declared[rises]
    return quotient


def projection(names: Sequence[str], path: FlownPath, reference: FloatArray) -> FloatArray:
    """(parameter, sample) P, which makes the parameters of the linear model of a ratio along the path [-].

    names     : (parameter,) parameters of the linear model;  reference : (5,) condition that they are about
    raises    : InputError where the path cannot distinguish them
    """
    # singular value of the scaled basis below which two parameters cannot be distinguished along the path
    min_singular_value = 1e-6
    B = basis(names, path.x, reference, path.declared)
    root = np.sqrt(path.weight / np.sum(path.weight))
    scale = np.sqrt(np.sum((B * root[:, None]) ** 2, axis=0))
    # Projected, not sampled: the rank is the number of parameters at any sampling rate. Pseudo-measurements along the
    # path were rejected, since their spacing and noise would be invented (decision 0006).
    U, s, V = np.linalg.svd(B * root[:, None] / np.where(scale > 0.0, scale, 1.0), full_matrices=False)
    if len(B) < len(names) or s[-1] < min_singular_value:
        least = V[-1] if len(s) else np.ones(len(names))
        alike = " and ".join(n for n, v in zip(names, least, strict=True) if abs(v) > 0.3)
        raise InputError(f"the fitted samples cannot distinguish {alike}; are the records those of the estimate?")
    P: FloatArray = (V.T / s) @ U.T * root / scale[:, None]
    return P
