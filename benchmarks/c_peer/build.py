"""Compile the C peer with the machine's gcc, strictly and with everything let go, and call it on numpy arrays."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sim_heating.ensemble import Ensemble
from sim_heating.heating_ratio.kernel import VARIABLES
from sim_heating.layout import (
    BACK_EPS,
    BACK_H,
    BACK_T,
    CONDITION_COLUMNS,
    D0,
    FACTOR_EPS,
    FIRST,
    INTS_PER_NODE,
    IS_INTERFACE,
    LANES,
    M_LEFT,
    M_RIGHT,
    MATERIAL_TABLE,
    N_NODES,
    NODE_INTS,
    RATIO_TABLE,
    REFERENCE,
    SCALE,
    SURFACE_TABLE,
    SURROUNDINGS4,
    G,
    T,
    node_row,
    parameters_at,
    scalar_row,
)
from sim_heating.thermal.kernel import BIN_K, BINS

FloatArray = NDArray[np.float64]

SOURCE = Path(__file__).with_name("march.c")
STRICT = ("-O3", "-march=native", "-fopenmp-simd", "-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math")
"""IEEE values to the bit; errno and traps, which the other side has not either, are let go."""
FAST = ("-Ofast", "-march=native", "-fopenmp-simd")
SAME_POLYNOMIAL = 1e-9
"""Neighbouring bins whose slopes agree to this, relatively, are one segment."""


def compiler() -> str | None:
    """Path of gcc, or None."""
    return shutil.which("gcc")


def compile_peer(folder: Path, name: str, flags: tuple[str, ...]) -> ctypes.CDLL:
    """Build the shared library with these flags and load it."""
    library = folder / f"{name}.so"
    command = [compiler() or "gcc", "-std=gnu11", "-shared", "-fPIC", *flags, str(SOURCE), "-o", str(library), "-lm"]
    subprocess.run(command, check=True, capture_output=True, text=True)
    loaded = ctypes.CDLL(str(library))
    loaded.group_size.restype = ctypes.c_long
    return loaded


class _Material(ctypes.Structure):
    _fields_ = (("segments", ctypes.c_void_p), ("of_bin", ctypes.c_void_p))


def _segments(bins: FloatArray) -> tuple[FloatArray, NDArray[np.int64]]:
    """(segment, 2 + polynomials) with foot and top [K], and the segment of each bin, from the bins of a material table."""
    slopes = bins[:, 2::3]
    scale = np.abs(slopes).max(axis=0) + 1e-300
    new = np.any(np.abs(np.diff(slopes, axis=0)) > SAME_POLYNOMIAL * scale, axis=1)
    first = np.concatenate(([0], np.flatnonzero(new) + 1))
    foot = BIN_K * first
    top = np.append(foot[1:], np.inf)
    of_bin = np.repeat(np.arange(len(first)), np.diff(np.append(first, BINS)))
    return np.column_stack([foot, top, bins[first]]), of_bin.astype(np.int64)


def _address(array: np.ndarray) -> int:
    return array.ctypes.data


@dataclass
class _Packed:
    nodes: int
    arguments: tuple[np.ndarray, ...]


class Peer:
    """The groups of an ensemble, packed for the C library; `reset` puts them at the ensemble's present temperatures.

    Constant parameters only: first derivatives of the ratio, no second-order terms and no effects.
    """

    def __init__(self, library: ctypes.CDLL, ensemble: Ensemble) -> None:
        self._library, self._table = library, np.ascontiguousarray(ensemble.table)
        self._pressures = len(ensemble.tables.log10_p)
        offsets = sorted(set(ensemble.tables.material_offset.values()))
        self._materials = self._pack_materials(offsets)
        index = {offset: i for i, offset in enumerate(offsets)}
        self._packed = [self._pack(ensemble, g, index) for g in range(len(ensemble.groups))]
        self._groups = [_aligned(library.group_size(ctypes.c_long(p.nodes))) for p in self._packed]
        self.reset()

    def _pack_materials(self, offsets: list[int]) -> ctypes.Array:
        width = 3 + 3 * self._pressures
        bins = [self._table[o : o + BINS * width].reshape(BINS, width) for o in offsets]
        self._segment_arrays = [_segments(b) for b in bins]
        pairs = [_Material(_address(s), _address(b)) for s, b in self._segment_arrays]
        return (_Material * len(pairs))(*pairs)

    def _pack(self, ensemble: Ensemble, g: int, index: dict[int, int]) -> _Packed:
        B, J = ensemble.block(g), ensemble.integers(g)
        nodes = int(J[N_NODES])
        rows = np.array([[B[node_row(i, r)] for r in (T, M_LEFT, M_RIGHT, G)] for i in range(nodes)])
        of_nodes = J[NODE_INTS:].reshape(nodes, INTS_PER_NODE)
        materials = of_nodes[:, MATERIAL_TABLE : MATERIAL_TABLE + LANES]
        which = np.column_stack([of_nodes[:, IS_INTERFACE], np.vectorize(index.__getitem__)(materials)])
        parameters = np.array([B[parameters_at(k) : parameters_at(k) + REFERENCE + VARIABLES] for k in range(LANES)]).T
        scalars = np.concatenate(
            [
                [B[scalar_row(r)] for r in (SURROUNDINGS4, BACK_H, BACK_T, BACK_EPS, FACTOR_EPS)],
                parameters[[SCALE, D0]],
                parameters[FIRST : FIRST + VARIABLES],
                parameters[REFERENCE : REFERENCE + VARIABLES],
            ]
        )
        tables = np.concatenate([J[RATIO_TABLE : RATIO_TABLE + LANES], J[SURFACE_TABLE : SURFACE_TABLE + LANES]])
        return _Packed(nodes, (rows, which, scalars, tables))

    def reset(self) -> None:
        """Every group at the temperatures that the ensemble had."""
        for group, packed in zip(self._groups, self._packed, strict=True):
            self._library.set_up(
                ctypes.c_void_p(group[1]), ctypes.c_long(packed.nodes), ctypes.c_long(self._pressures),
                ctypes.c_void_p(_address(self._table)), ctypes.byref(self._materials),
                *(ctypes.c_void_p(_address(a)) for a in packed.arguments),
            )  # fmt: skip

    def march(self, time_s: FloatArray, history: FloatArray) -> None:
        """All groups through one flight, history (time, condition); no history of temperatures is kept."""
        if history.shape != (len(time_s), len(CONDITION_COLUMNS)):
            raise ValueError(f"history is {history.shape}")
        self._run(self._library.march, time_s, history)

    def march_heated(self, time_s: FloatArray, heating: FloatArray) -> None:
        """The same with the heating of stages 1 and 2 of each step given, (time, 2, 5, LANES), equal for all groups."""
        self._run(self._library.march_heated, time_s, heating)

    def _run(self, function: ctypes._CFuncPtr, time_s: FloatArray, driving: FloatArray) -> None:
        for group in self._groups:
            function(
                ctypes.c_void_p(group[1]), ctypes.c_void_p(_address(time_s)), ctypes.c_void_p(_address(driving)),
                ctypes.c_long(len(time_s)), None,
            )  # fmt: skip

    def node_temperatures(self, g: int) -> FloatArray:
        """(node, lane) temperatures of a group [K]."""
        out = np.empty((self._packed[g].nodes, LANES))
        self._library.temperatures(ctypes.c_void_p(self._groups[g][1]), ctypes.c_void_p(_address(out)))
        return out

    def tallies(self, g: int) -> FloatArray:
        """(3, lane) heat taken in [J/m2], Newton iterations, failures."""
        out = np.empty((3, LANES))
        self._library.energy(ctypes.c_void_p(self._groups[g][1]), ctypes.c_void_p(_address(out)))
        return out


def _aligned(size: int, boundary: int = 64) -> tuple[ctypes.Array, int]:
    """Memory of so many bytes and the first address in it on a boundary."""
    memory = ctypes.create_string_buffer(size + boundary)
    return memory, (ctypes.addressof(memory) + boundary - 1) // boundary * boundary
