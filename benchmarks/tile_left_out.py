"""Each measured tile of STS-96 from the other three: when its heating rises, and the band of its temperature.

The three tiles are closed jointly, with the error of their flight in common. The fourth is predicted with that error,
with the prior of its own table, transition and heating, and no reading of its own: the interval of its rise, and the
95 % band of its readings. The band is that of the linearised model,

    variance = J P J' + F C F' + S L L' S' + noise,

J, P of the parameters of the point with their priors, F, C of the flight with what the three say of it, S L of the
heating's error (docs/theory/model_error.md, equations 1 and 11).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from benchmarks.measure import Figure, save
from sim_heating.base.arrays import FloatArray
from sim_heating.closure.prior.model_error import SmoothFlightError
from sim_heating.closure.search.joint_search import JointSearch, search_jointly
from sim_heating.closure.search.search import SearchResult, search_effects
from sim_heating.closure.search.trials.candidates import candidates
from sim_heating.closure.search.trials.trial_fit import TrialFit, fitted_effects, problem_with
from sim_heating.heating.edge_flow import edge_flow_columns
from sim_heating.heating.effects import EffectUse
from sim_heating.heating.effects.transition import ALPHA_0, ALPHA_SENSITIVITY, BY_RE_THETA, ONSET, TRANSITION
from sim_heating.inputs.points import conditions_of_record, flow_of_record
from sim_heating.inputs.record import load_record

ROOT = Path(__file__).resolve().parent.parent
RECORDS = tuple(ROOT / "scenarios" / "records" / f"sts96_{n}" for n in (468, 480, 597, 730))
WIDENED = 3.0
"""Factor of the search on the sigma of effects' priors, which is taken back here."""
DRAWS, SEED = 4000, 20261128
Z95 = 1.96
LARGEST_RISE_S, LEAST_COVER, LARGEST_BAND_K = 130.0, 0.85, 150.0
"""Half width of the 90 % interval of a rise [s]; readings within the 95 % band; half width of it [K]."""


def run() -> list[Figure]:
    """The joint finding of all four, then each of them from the others."""
    alone = [search_effects(load_record(path)) for path in RECORDS]
    figures = list(_joint(search_jointly(alone)))
    for k, own in enumerate(alone):
        figures += _left_out(own, search_jointly([r for i, r in enumerate(alone) if i != k]))
    save("tile_left_out", figures)
    return figures


def _joint(search: JointSearch) -> Iterator[Figure]:
    best = search.compared
    note = f"{search.conclusion.finding}: {' + '.join(best.names) or 'none'}"
    yield Figure("four tiles jointly: p-value", best.adequacy.p_value, "", note=note)
    trial = best.by_record[best.members[0]]
    error, f, covariance = flight_of(trial)
    for name, (row, prior) in error.rows.items():
        if len(row) == 1:
            sigma = float(np.sqrt(row[0] @ covariance @ row[0]))
            yield Figure(f"four tiles jointly: {name}", float(row[0] @ f), "", note=f"+- {sigma:.2g}; prior {prior:g}")


def flight_of(trial: TrialFit) -> tuple[SmoothFlightError, FloatArray, FloatArray]:
    """The error of a flight that records have in common, its values and their covariance, in standard deviations."""
    part = trial.problem.record_fits[0]
    assert part.model_error is not None
    assert isinstance(part.model_error.flight, SmoothFlightError)
    at = [trial.fit.names.index(n) for n in part.flight_names]
    return part.model_error.flight, trial.fit.values[at], trial.fit.covariance[np.ix_(at, at)]


def _left_out(own: SearchResult, others: JointSearch) -> Iterator[Figure]:
    """What the others say of a tile."""
    best = others.compared
    _, f, C = flight_of(best.by_record[best.members[0]])
    name = own.record.declared.control_point
    yield from _rise(name, own, f, C)
    yield from _band(name, own, f, C)


def _rise(name: str, own: SearchResult, f: FloatArray, C: FloatArray) -> Iterator[Figure]:
    """The 90 % interval of the time of the rise, and where the tile's own best model has it."""
    trial = next(h.last for h in own.hypotheses if h.admissible and TRANSITION in h.names)
    declared = next(u for u in own.record.declared.heating.effects if u.effect.name == TRANSITION)
    prior = next(p for p in declared.definitions if p.name == "log10_re_onset")
    time_s, criterion = _criterion(own, declared)
    rng = np.random.default_rng(SEED)
    flights = f + rng.multivariate_normal(np.zeros(len(f)), C, DRAWS, method="cholesky")
    rows = own.base.problem.record_fits[0].model_error.flight.rows  # type: ignore[union-attr]
    onsets = prior.value + prior.sigma * rng.standard_normal(DRAWS)
    at_s = np.interp(onsets, criterion, time_s)
    later_s = flights @ rows["time_shift_s"][0][0] + at_s * (flights @ rows["time_stretch"][0][0])
    low, high = np.quantile(at_s + later_s, (0.05, 0.95))
    fitted = next(u for u in fitted_effects(trial) if u.effect.name == TRANSITION)
    time_s, criterion = _criterion(own, fitted)
    seen = float(np.interp(fitted.values[ONSET], criterion, time_s))
    note = f"{low:.0f} to {high:.0f} s from the others; {seen:.0f} s by itself"
    yield Figure(
        f"{name}: rise within its 90 % interval", float(low <= seen <= high), "", 1.0, at_least=True, note=note
    )
    yield Figure(f"{name}: half width of that interval", 0.5 * (high - low), "s", LARGEST_RISE_S)


def _criterion(own: SearchResult, use: EffectUse) -> tuple[FloatArray, FloatArray]:
    """(time,) [s] and what a transition compares with its onset, where it rises (docs/reference/effects.md, eq. 23)."""
    record, values = own.record, use.values
    flown = conditions_of_record(record)
    by_re_theta = values[BY_RE_THETA] != 0.0
    at = edge_flow_columns(flow_of_record(record), flown)["log10_re_theta_m"] if by_re_theta else flown["log10_re"]
    rising = np.maximum.accumulate(at + values[ALPHA_SENSITIVITY] * (flown["alpha_deg"] - values[ALPHA_0]))
    kept = np.append(True, np.diff(rising) > 0.0)
    return flown.time_s[kept], rising[kept]


def _band(name: str, own: SearchResult, f: FloatArray, C: FloatArray) -> Iterator[Figure]:
    """Share of the readings within the 95 % band, and its half width in the middle of the record."""
    record, base = own.record, own.base
    declared = next(u for u in record.declared.heating.effects if u.effect.name == TRANSITION)
    flown = conditions_of_record(record)
    candidate = next(c for c in candidates(record, flown) if c.name == TRANSITION and c.uses == (declared,))
    problem = problem_with(base, candidate).with_flight_unknowns()
    part = problem.record_fits[0]
    of_flight = np.array([u.parameter.name in part.flight_names for u in problem.unknowns])
    at = np.array([u.parameter.value for u in problem.unknowns])
    at[of_flight] = f
    sigma = np.array(
        [u.parameter.sigma / (WIDENED if u.parameter.name in candidate.names else 1.0) for u in problem.unknowns]
    )
    P = np.diag(np.where(np.isfinite(sigma), sigma, 0.0) ** 2)
    P[np.ix_(of_flight, of_flight)] = C
    samples = problem.samples(at)
    J = np.concatenate([s.jacobian for s in samples])
    G, noise = part.error_root_K, part.reading_noise_K
    assert G is not None  # a measured flight has an error
    spread = np.sqrt(np.einsum("ij,jk,ik->i", J, P, J) + np.sum(G**2, axis=1) + noise**2)
    mean = np.concatenate([s.mean_K for s in samples])
    read = np.concatenate([0.5 * (s.channel.intervals.lower_K + s.channel.intervals.upper_K) for s in samples])
    inside = float(np.mean(np.abs(read - mean) <= Z95 * spread))
    time_s = np.concatenate([s.time_s for s in samples])
    middle = Z95 * float(np.median(spread[_middle(time_s)]))
    note = f"median deviation {np.median(read - mean):+.0f} K"
    yield Figure(f"{name}: readings within the 95 % band", inside, "", LEAST_COVER, at_least=True, note=note)
    yield Figure(f"{name}: half width of the band in the middle", middle, "K", LARGEST_BAND_K)


def _middle(time_s: Sequence[float] | FloatArray) -> FloatArray:
    """(reading,) whether a reading is of the middle third of a record."""
    low, high = np.quantile(time_s, (1.0 / 3.0, 2.0 / 3.0))
    return np.asarray((np.asarray(time_s) >= low) & (np.asarray(time_s) <= high))


if __name__ == "__main__":
    run()
