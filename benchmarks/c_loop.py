"""The compiled march against hand-written C of the same scheme: 512 control points of 24 nodes, 1500 s in 1 s steps."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.c_peer.build import FAST, STRICT, Peer, compile_peer, compiler
from benchmarks.measure import Figure, Times, in_turn, one_thread, save
from sim_heating.base.kernels.block import ADDED, FILM, LANES, N_NODES, PCOL, PFRAC, RECOVERY, STEPPING
from sim_heating.base.kernels.jit import njit
from sim_heating.base.kernels.operations import pointer
from sim_heating.march.ensemble import Ensemble
from sim_heating.march.frames import BLOCK_END, BLOCK_START, INTS_END, INTS_START
from sim_heating.thermal.step import close_step, step
from tests.support.problems import NOTHING, ensemble_of, entry, points

FloatArray = NDArray[np.float64]

POINTS, NODES, ROUNDS = 512, 24, 9
PORTION = 64
"""Points timed together: short enough that both sides meet the same state of the machine."""
THREADED_POINTS = 1000
AGREEMENT_K = 1e-9
PEERS = {
    "strict": STRICT,
    "fast": FAST,
    "narrow": (*STRICT, "-mno-avx512f"),
    "wide": (*STRICT, "-mprefer-vector-width=512", "-DWIDTH=8"),
}
"""The C by the flags that it is compiled with; the last two only show which width of vectors is its limit."""
TEXTS = {
    "strict": "strict",
    "fast": "-Ofast",
    "narrow": "strict without AVX-512",
    "wide": "strict, vectors of 512 bits",
}
HEATED = (FILM, RECOVERY, ADDED, PCOL, PFRAC)
"""Rows of the surface, in the order in which the C library reads them."""


@njit
def march_heated(B, J, table, dispatcher, time_s, heating) -> None:
    """A group through an entry with its heating given, (time, 2, 5, LANES): stages 1 and 2 of the step to a time."""
    b, j, t = pointer(B), pointer(J), pointer(table)
    for lane in range(LANES):
        B[STEPPING * LANES + lane] = 1.0
    for k in range(1, len(time_s)):
        for r in range(5):
            row = HEATED[r]
            for lane in range(LANES):
                B[row * LANES + lane] = B[(row + 2) * LANES + lane]
                B[(row + 1) * LANES + lane] = heating[k, 0, r, lane]
                B[(row + 2) * LANES + lane] = heating[k, 1, r, lane]
        step(b, j, t, dispatcher, time_s[k] - time_s[k - 1])
        close_step(b, j[N_NODES], time_s[k] - time_s[k - 1])


def _heating(ensemble: Ensemble, time_s: FloatArray, history: FloatArray) -> FloatArray:
    """(time, 2, 5, LANES) heating of the first group; it is the same for all others."""
    rows = [row + stage for stage in (1, 2) for row in HEATED]
    kept = np.array([ensemble.lane_offsets[lane].scalar(row) for row in rows for lane in range(LANES)])
    ensemble.reset()
    return ensemble.march(time_s, history, keep=kept).reshape(len(time_s), 2, len(HEATED), LANES).copy()


def _all_heated(ensemble: Ensemble, time_s: FloatArray, heating: FloatArray) -> None:
    for g in range(len(ensemble.groups)):
        start, end, ints, ints_end = ensemble.groups[g, [BLOCK_START, BLOCK_END, INTS_START, INTS_END]]
        march_heated(
            ensemble.state[start:end],
            ensemble.ints[ints:ints_end],
            ensemble.table,
            ensemble.dispatcher,
            time_s,
            heating,
        )


def run(rounds: int = ROUNDS) -> list[Figure]:
    """Validate the C against the compiled Python, then time both on one thread, portion by portion side by side."""
    if compiler() is None:
        return [Figure("C peer: there is no gcc, skipped", float("nan"), "")]
    time_s, history = entry(1.0)
    models = points(POINTS)
    apart: dict[str, float] = {"strict": 0.0, "fast": 0.0}
    entries, thermals = [], []
    with tempfile.TemporaryDirectory() as folder, one_thread():
        libraries = {name: compile_peer(Path(folder), name, flags) for name, flags in PEERS.items()}
        for first in range(0, POINTS, PORTION):
            ensemble = ensemble_of(models[first : first + PORTION], NODES)
            peers = {name: Peer(library, ensemble) for name, library in libraries.items()}
            for name in apart:
                apart[name] = max(apart[name], _apart(ensemble, peers[name], time_s, history))
            entries.append(_time_entry(ensemble, peers, time_s, history, rounds))
            thermals.append(_time_thermal(ensemble, {n: peers[n] for n in apart}, time_s, history, rounds))
    figures = [
        Figure("C strict and numba apart, all nodes of 512 points after 1500 s", apart["strict"], "K", AGREEMENT_K),
        Figure("C -Ofast and numba apart", apart["fast"], "K"),
        Figure("entry, 512 x 24: numba / C strict", _ratio(entries, "strict"), "", 1.1),
        Figure("entry, 512 x 24: numba / C -Ofast (limit)", _ratio(entries, "fast"), "", 1.15),
        Figure("thermal step alone: numba / C strict", _ratio(thermals, "strict"), "", 1.1),
        Figure("thermal step alone: numba / C -Ofast (limit)", _ratio(thermals, "fast"), ""),
    ]
    names = {"numba": "numba", **{name: f"C {text}" for name, text in TEXTS.items()}}
    total = {name: sum(times.best(name) for times in entries) for name in names}
    per_step = 1e9 / (POINTS * (len(time_s) - 1))
    figures += [Figure(f"entry: {text}, per point and step", total[n] * per_step, "ns") for n, text in names.items()]
    figures.append(Figure("entry, 512 x 24: numba, one thread", total["numba"], "s"))
    figures.append(_two_threads(time_s, history, rounds))
    rounds_s = {"entry": [t.seconds for t in entries], "thermal": [t.seconds for t in thermals]}
    save("c_loop", figures, {"portions_rounds_s": rounds_s})
    return figures


def _two_threads(time_s: FloatArray, history: FloatArray, rounds: int) -> Figure:
    """Gain of two threads for many points in one march, on a machine of two cores or more."""
    ensemble = ensemble_of(points(THREADED_POINTS), NODES)

    def alone() -> None:
        with one_thread():
            ensemble.march(time_s, history, keep=NOTHING)

    def together() -> None:
        ensemble.march(time_s, history, keep=NOTHING)

    times = in_turn({"one": alone, "all": together}, rounds, {"one": ensemble.reset, "all": ensemble.reset})
    what = f"entry, {THREADED_POINTS} x {NODES}: one thread / one for each core"
    return Figure(what, times.ratio("one", "all"), "", 1.9, True, f"{os.cpu_count()} cores")


def _ratio(portions: list[Times], name: str) -> float:
    """Median of numba over C, over all pairs that ran side by side."""
    pairs = [n / c for t in portions for n, c in zip(t.seconds["numba"], t.seconds[name], strict=True)]
    return float(np.median(pairs))


def _time_entry(
    ensemble: Ensemble, peers: dict[str, Peer], time_s: FloatArray, history: FloatArray, rounds: int
) -> Times:
    tasks = {name: (lambda p=peer: p.march(time_s, history[0])) for name, peer in peers.items()}
    return in_turn(
        {"numba": lambda: ensemble.march(time_s, history, keep=NOTHING), **tasks},
        rounds,
        {"numba": ensemble.reset, **{name: peer.reset for name, peer in peers.items()}},
    )


def _time_thermal(
    ensemble: Ensemble, peers: dict[str, Peer], time_s: FloatArray, history: FloatArray, rounds: int
) -> Times:
    heating = _heating(ensemble, time_s, history)
    start = _heated_start(ensemble, history)
    _check_heated(ensemble, peers["strict"], start, time_s, heating)
    tasks = {name: (lambda p=peer: p.march_heated(time_s, heating)) for name, peer in peers.items()}
    return in_turn(
        {"numba": lambda: _all_heated(ensemble, time_s, heating), **tasks},
        rounds,
        {"numba": lambda: ensemble.restore(start), **{name: peer.reset for name, peer in peers.items()}},
    )


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


def _heated_start(ensemble: Ensemble, history: FloatArray) -> FloatArray:
    """State before the first step of the entry, its conditions set."""
    ensemble.reset()
    ensemble.begin(np.repeat(history[0, :1], len(ensemble.models), axis=0))
    return ensemble.snapshot()


def _check_heated(ensemble: Ensemble, peer: Peer, start: FloatArray, time_s: FloatArray, heating: FloatArray) -> None:
    """Both programs still agree where the heating is given."""
    for r, row in enumerate(HEATED):
        heating[0, 1, r] = ensemble.memory.block(0)[(row + 2) * LANES : (row + 3) * LANES]
    ensemble.restore(start)
    _all_heated(ensemble, time_s, heating)
    peer.reset()
    peer.march_heated(time_s, heating)
    apart = _difference(ensemble, peer)
    if not apart <= AGREEMENT_K:
        raise RuntimeError(f"C and numba are {apart:g} K apart with the heating given")
