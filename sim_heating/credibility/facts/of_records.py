"""Facts about predictions and fits of flight records, from which their credibility follows."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain
from typing import Any

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import RATIO_VARIABLES, Conditions
from sim_heating.base.parameters import SHORT_NAMES
from sim_heating.credibility.facts import contributors
from sim_heating.credibility.facts.sources import conditions_of_record, inputs_of_record
from sim_heating.credibility.facts.topics import topics_of_record
from sim_heating.credibility.reviews import digest_of
from sim_heating.credibility.statement import LARGEST_SHARE, NOT_LOOKED_AT, SIGMAS, Answer, Facts, greatest_error_K
from sim_heating.credibility.validation.own_cases import samples_of, wall_readings
from sim_heating.heating.ratio.uncertainty import declared_ratio
from sim_heating.inputs.points import point_of_record
from sim_heating.inputs.record import Record
from sim_heating.march.history import PointHistory, peak
from sim_heating.march.point import PointModel

MODEL_ERROR_RATIO = 1.3
"""RMS of the residuals over that of noise above which the model is reported as deficient [-]."""


def facts_of_record(
    kind: str,
    record: Record,
    model: PointModel,
    flown: Conditions,
    history: PointHistory,
    residual_K: FloatArray,
    *,
    with_peak: bool = True,
) -> Facts:
    """Facts about a prediction along a record.

    kind       : of the result;  model : that was marched;  flown : conditions with its reference heating
    history    : temperatures at the record's sample times [K]
    residual_K : (sensor, sample) measured less predicted [K]
    with_peak  : whether the uncertainty of the highest surface temperature is computed
    """
    t, span = history.time_s, record.conditions.time_s[[0, -1]]
    inside = np.isfinite(history.surface_K) & (t >= span[0]) & (t <= span[1])
    times, surface = t[inside], history.surface_K[inside]
    digest = digest_of(record) if os.path.isdir(record.directory) else ""
    uncertainty = contributors.band_uncertainty(history)
    if uncertainty is None and with_peak and len(times):
        uncertainty = contributors.peak_uncertainty(model, flown, peak(times, surface)[1])
    agreement = _within_uncertainty(record, residual_K, uncertainty)
    return Facts(
        kind=kind,
        topics=frozenset(topics_of_record(record, model)),
        model=tuple(dict.fromkeys(inputs_of_record(record, model.effects))),
        conditions=tuple(conditions_of_record(record)),
        files={f"record {record.name}": digest} if digest else {},
        samples=(samples_of(record.conditions.at(times), surface),) if len(times) else (),
        mesh_error_K=history.mesh_error_K,
        sigma=history.band is not None or contributors.declares_sigma(model, record.conditions),
        uncertainty=uncertainty,
        consistent=within_noise(record, residual_K),
        holds=agreement,
        varied=agreement if record.declared.measured else Answer(False, "the record is synthetic"),
        own_share=_share_of_rise(record, residual_K),
        own_noise=within_noise(record, residual_K),
        folder=record.directory if digest else None,
        reviewed=digest,
    )


def facts_of_readings(kind: str, record: Record) -> Facts:
    """Facts about a result of a record whose wall temperatures are those that were read."""
    model, digest = point_of_record(record), digest_of(record)
    return Facts(
        kind=kind,
        topics=frozenset(topics_of_record(record, model)),
        model=tuple(dict.fromkeys(inputs_of_record(record, model.effects))),
        conditions=tuple(conditions_of_record(record)),
        files={f"{record.flight}/{record.name}": digest},
        samples=(wall_readings(record)[1],),
        sigma=True,
        folder=record.directory,
        reviewed=digest,
    )


def _rmse(residual_K: FloatArray) -> float:
    finite = residual_K[np.isfinite(residual_K)]
    return float(np.sqrt(np.mean(finite**2))) if len(finite) else float("nan")


def within_noise(record: Record, residual_K: FloatArray) -> Answer:
    """Whether the residuals of the used sensors are those of their noise [K]."""
    used = [i for i, sensor in enumerate(record.sensors) if sensor.used]
    if any(s.noise_sigma_K is None for s in record.used_sensors):
        return Answer(False, "the record declares no noise of a thermocouple")
    rmse, floor = _rmse(residual_K[used]), record.noise_floor_K(record.read_mask)
    text = f"RMSE {rmse:.3g} K over all readings, noise floor {floor:.3g} K"
    return Answer(bool(rmse <= MODEL_ERROR_RATIO * floor), text)


def _share_of_rise(record: Record, residual_K: FloatArray) -> Answer:
    """Whether the RMSE of the used sensors [K] is a small part of the rise of their readings."""
    used = [i for i, sensor in enumerate(record.sensors) if sensor.used]
    readings = record.temperatures_K()[used]
    rise_K, rmse = float(np.nanmax(readings) - np.nanmin(readings)), _rmse(residual_K[used])
    text = f"its own readings are missed by {rmse:.3g} K of a rise of {rise_K:.3g} K"
    return Answer(bool(rmse <= LARGEST_SHARE * rise_K), text)


def held_out(fitted_K: float | None, held_K: float | None) -> Answer:
    """Whether data that were not fitted are predicted about as well as those that were.

    fitted_K, held_K : RMSE over the fitted data and over those held out [K]; None where there are none
    """
    if fitted_K is None or held_K is None:
        return Answer(False, "no data were held out")
    text = f"RMSE {held_K:.3g} K held out, {fitted_K:.3g} K fitted"
    return Answer(held_K <= MODEL_ERROR_RATIO * fitted_K, text)


def _within_uncertainty(record: Record, residual_K: FloatArray, uncertainty: contributors.Uncertainty | None) -> Answer:
    """Whether measured and predicted temperatures differ by no more than two standard deviations, with the noise of
    the readings where all used sensors declare it."""
    if uncertainty is None:
        return NOT_LOOKED_AT
    used = [i for i, sensor in enumerate(record.sensors) if sensor.used]
    is_noise_declared = all(s.noise_sigma_K is not None for s in record.used_sensors)
    noise_K = record.noise_floor_K(record.read_mask) if is_noise_declared else 0.0
    rmse, bound = _rmse(residual_K[used]), SIGMAS * float(np.hypot(uncertainty.sigma, noise_K))
    text = f"RMSE {rmse:.3g} K, two sigma of the highest temperature and of the noise {bound:.3g} K"
    return Answer(bool(rmse <= bound), text)


def of_several(facts: Sequence[Facts]) -> Facts:
    """Facts about several records as one result; reviews are looked for next to the first."""
    if len(facts) == 1:
        return facts[0]
    answers = ("consistent", "holds", "varied", "own_share", "own_noise")
    agreed: dict[str, Any] = {name: _all(getattr(f, name) for f in facts) for name in answers}

    def joined(name: str) -> Iterator[Any]:
        return chain.from_iterable(getattr(f, name) for f in facts)

    return replace(
        facts[0],
        topics=frozenset(joined("topics")),
        model=tuple(dict.fromkeys(joined("model"))),
        conditions=tuple(dict.fromkeys(joined("conditions"))),
        files={n: d for f in facts for n, d in f.files.items()},
        samples=tuple(joined("samples")),
        mesh_error_K=greatest_error_K(f.mesh_error_K for f in facts),
        sigma=all(f.sigma for f in facts),
        **agreed,
    )


def _all(answers: Iterable[Answer]) -> Answer:
    every = list(answers)
    return next((a for a in every if not a.holds), every[0])


def ratio_uncertainty(
    sigma: Mapping[str, float], records: Sequence[Record], reference: Sequence[float]
) -> contributors.Uncertainty | None:
    """What the uncertainty of an estimated heating ratio comes from, where the flight was farthest from the reference.

    sigma     : of the estimated parameters, by dotted name
    reference : condition that the derivatives are about, in the order of a ratio table [deg, deg, -, deg, deg]
    returns   : contribution of ratio.scale as sigma r_table, of a derivative as sigma times the excursion of its
                variable; of other parameters alone the relative size is not comparable, and they are left out; None
                where no parameter of the ratio is estimated

    Correlations of the estimates are left out: the combined sigma is an upper bound where they are negative.
    """
    flown = [r.conditions for r in records if r.conditions.columns.keys() >= {*RATIO_VARIABLES}]
    if not flown:
        return None
    x = np.concatenate([np.stack([c[v] for v in RATIO_VARIABLES], axis=1) for c in flown])
    farthest = np.max(np.abs(x - np.asarray(reference)), axis=0).tolist()
    magnitude = max(float(np.max(np.abs(declared_ratio(r.ratio_table, np.atleast_2d(reference))))) for r in records)
    derivatives = map("ratio.d_{}".format, SHORT_NAMES)
    reach = {"ratio.scale": magnitude, "ratio.d0": 1.0, **dict(zip(derivatives, farthest, strict=True))}
    contributions = {n: s * reach[n.partition("@")[0]] for n, s in sigma.items() if n.partition("@")[0] in reach}
    if not any(contributions.values()):
        return None
    method = "sigma of each estimate times the farthest excursion of its variable; correlations left out"
    return contributors.combined(
        "heating ratio where the flight was farthest from the reference condition", "", None, contributions, method
    )
