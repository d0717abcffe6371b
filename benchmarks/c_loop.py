"""The compiled march against hand-written C of the same scheme: 512 control points of 24 nodes, 1500 s in 1 s steps."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.c_peer.build import FAST, STRICT, Peer, compile_peer, compiler
from benchmarks.measure import Figure, in_turn, one_thread, save
from benchmarks.problems import NOTHING, ensemble_of, entry, points
from sim_heating.ensemble import Ensemble
from sim_heating.jit import njit, raw
from sim_heating.layout import ADDED, FILM, LANES, PCOL, PFRAC, RECOVERY
from sim_heating.march import BLOCK_END, BLOCK_START, INTS_END, INTS_START
from sim_heating.thermal.kernel import step

FloatArray = NDArray[np.float64]

POINTS, NODES, ROUNDS = 512, 24, 9
AGREEMENT_K = 1e-9
HEATED = (FILM, RECOVERY, ADDED, PCOL, PFRAC)
"""Rows that the surface takes, in the order in which the C library reads them."""


@njit
def march_heated(B, J, table, chain, time_s, heating) -> None:  # type: ignore[no-untyped-def]
    """A group through an entry with its heating given, (time, 2, 5, LANES): stages 1 and 2 of the step to a time."""
    b, j, t = raw(B), raw(J), raw(table)
    for k in range(1, len(time_s)):
        for r in range(5):
            row = HEATED[r]
            for lane in range(LANES):
                B[row * LANES + lane] = B[(row + 2) * LANES + lane]
                B[(row + 1) * LANES + lane] = heating[k, 0, r, lane]
                B[(row + 2) * LANES + lane] = heating[k, 1, r, lane]
        step(b, j, t, chain, time_s[k] - time_s[k - 1])


def _heating(ensemble: Ensemble, time_s: FloatArray, history: FloatArray) -> FloatArray:
    """(time, 2, 5, LANES) heating of the first group; that of all others is the same."""
    rows = [row + stage for stage in (1, 2) for row in HEATED]
    kept = np.array([ensemble.places[lane].scalar(row) for row in rows for lane in range(LANES)])
    ensemble.reset()
    return ensemble.march(time_s, history, keep=kept).reshape(len(time_s), 2, len(HEATED), LANES).copy()


def _all_heated(ensemble: Ensemble, time_s: FloatArray, heating: FloatArray) -> None:
    for g in range(len(ensemble.groups)):
        start, end, ints, ints_end = ensemble.groups[g, [BLOCK_START, BLOCK_END, INTS_START, INTS_END]]
        march_heated(
            ensemble.state[start:end], ensemble.ints[ints:ints_end], ensemble.table, ensemble.chain, time_s, heating
        )


def run(rounds: int = ROUNDS) -> list[Figure]:
    """Validate the C against the compiled Python, then time both side by side on one thread."""
    if compiler() is None:
        return [Figure("C peer: there is no gcc, skipped", float("nan"), "")]
    time_s, history = entry(1.0)
    ensemble = ensemble_of(points(POINTS), NODES)
    with tempfile.TemporaryDirectory() as folder, one_thread():
        libraries = {name: compile_peer(Path(folder), name, f) for name, f in (("strict", STRICT), ("fast", FAST))}
        peers = {name: Peer(library, ensemble) for name, library in libraries.items()}
        apart = {name: _apart(ensemble, peer, time_s, history) for name, peer in peers.items()}
        whole = in_turn(
            {
                "numba": lambda: ensemble.march(time_s, history, keep=NOTHING),
                **{name: (lambda p=peer: p.march(time_s, history[0])) for name, peer in peers.items()},
            },
            rounds,
            {"numba": ensemble.reset, **{name: peer.reset for name, peer in peers.items()}},
        )
        heating = _heating(ensemble, time_s, history)
        start = _heated_start(ensemble, time_s, history)
        _check_heated(ensemble, peers["strict"], start, time_s, heating)
        thermal = in_turn(
            {
                "numba": lambda: _all_heated(ensemble, time_s, heating),
                **{name: (lambda p=peer: p.march_heated(time_s, heating)) for name, peer in peers.items()},
            },
            rounds,
            {"numba": lambda: ensemble.restore(start), **{name: peer.reset for name, peer in peers.items()}},
        )
    per_step = 1e9 / (POINTS * (len(time_s) - 1))
    figures = [
        Figure("C strict and numba apart, all nodes of 512 points after 1500 s", apart["strict"], "K", AGREEMENT_K),
        Figure("C -Ofast and numba apart", apart["fast"], "K"),
        Figure("entry, 512 x 24: numba / C strict", whole.ratio("numba", "strict"), "", 1.3),
        Figure("entry, 512 x 24: numba / C -Ofast (limit)", whole.ratio("numba", "fast"), ""),
        Figure("thermal step alone: numba / C strict", thermal.ratio("numba", "strict"), "", 1.3),
        Figure("thermal step alone: numba / C -Ofast (limit)", thermal.ratio("numba", "fast"), ""),
        Figure("entry: numba, per point and step", whole.best("numba") * per_step, "ns"),
        Figure("entry: C strict, per point and step", whole.best("strict") * per_step, "ns"),
        Figure("entry: C -Ofast, per point and step", whole.best("fast") * per_step, "ns"),
        Figure("entry, 512 x 24: numba, one thread", whole.best("numba"), "s"),
    ]
    save("c_loop", figures, {"rounds_s": {"entry": whole.seconds, "thermal": thermal.seconds}})
    return figures


def _apart(ensemble: Ensemble, peer: Peer, time_s: FloatArray, history: FloatArray) -> float:
    """Largest difference of any node temperature [K] at the end of the entry."""
    ensemble.reset()
    ensemble.march(time_s, history, keep=NOTHING)
    peer.reset()
    peer.march(time_s, history[0])
    return _difference(ensemble, peer)


def _difference(ensemble: Ensemble, peer: Peer) -> float:
    worst = 0.0
    for g in range(len(ensemble.groups)):
        members = ensemble.lanes[g * LANES : (g + 1) * LANES]
        own = np.array([ensemble.node_temperatures(int(i)) for i in members]).T
        worst = max(worst, float(np.max(np.abs(own - peer.node_temperatures(g)))))
    return worst


def _heated_start(ensemble: Ensemble, time_s: FloatArray, history: FloatArray) -> FloatArray:
    """State before the first step of the entry, its conditions set."""
    ensemble.reset()
    ensemble.begin(np.repeat(history[0, :1], len(ensemble.models), axis=0))
    return ensemble.snapshot()


def _check_heated(ensemble: Ensemble, peer: Peer, start: FloatArray, time_s: FloatArray, heating: FloatArray) -> None:
    """Both programs still agree where the heating is given."""
    for r, row in enumerate(HEATED):
        heating[0, 1, r] = ensemble.block(0)[(row + 2) * LANES : (row + 3) * LANES]
    ensemble.restore(start)
    _all_heated(ensemble, time_s, heating)
    peer.reset()
    peer.march_heated(time_s, heating)
    apart = _difference(ensemble, peer)
    if not apart <= AGREEMENT_K:
        raise RuntimeError(f"C and numba are {apart:g} K apart with the heating given")
