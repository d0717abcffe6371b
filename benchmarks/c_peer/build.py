"""Compile the C peer with the machine's gcc, strictly and with every relaxation, and call it on numpy arrays."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sim_heating.base.kernels.block import (
    BACK_EPS,
    BACK_H,
    BACK_T,
    CONDITION_COLUMNS,
    D0,
    FACTOR_EPS,
    FIRST,
    LANES,
    M_LEFT,
    M_RIGHT,
    N_CONDITIONS,
    REFERENCE,
    SCALE,
    SURROUNDINGS4,
    G,
    T,
    node_row,
    parameters_at,
    scalar_row,
)
from sim_heating.heating.ratio.lookup import VARIABLES, pack_table
from sim_heating.march.ensemble import Ensemble
from sim_heating.march.point import PointModel
from sim_heating.thermal.stack import Material, pairs

FloatArray = NDArray[np.float64]

SOURCE = Path(__file__).with_name("march.c")
STRICT = ("-O3", "-march=native", "-fopenmp-simd", "-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math")
"""IEEE values to the bit; without errno and traps, which the other side does not have either."""
FAST = ("-Ofast", "-march=native", "-fopenmp-simd")
BIN_K, BINS = 5.0, 600
"""Bins by which march.c finds a segment."""
EDGES_K: FloatArray = BIN_K * np.arange(BINS + 1, dtype=np.float64)


def compiler() -> str | None:
    """Path of gcc, or None."""
    return shutil.which("gcc")


def compile_peer(folder: Path, name: str, flags: tuple[str, ...]) -> ctypes.CDLL:
    """Build the shared library with these flags and load it."""
    library = folder / f"{name}.so"
    command = [
        compiler() or "gcc",
        "-std=gnu11",
        "-shared",
        "-fPIC",
        f"-DCONDITIONS={N_CONDITIONS}",
        *flags,
        str(SOURCE),
        "-o",
        str(library),
        "-lm",
    ]
    subprocess.run(command, check=True, capture_output=True, text=True)
    loaded = ctypes.CDLL(str(library))
    loaded.group_size.restype = ctypes.c_long
    return loaded


class _Material(ctypes.Structure):
    _fields_ = (("segments", ctypes.c_void_p), ("of_bin", ctypes.c_void_p))


def _integrals(T_K: FloatArray, values: FloatArray) -> FloatArray:
    """(3, segment): integral from 0 K, value and slope at the foot of each segment; the first temperature is 0 K."""
    integral = np.concatenate(([0.0], np.cumsum(0.5 * np.diff(T_K) * (values[1:] + values[:-1]))))
    slope = np.append(np.diff(values) / np.diff(T_K), 0.0)
    return np.array([integral, values, slope])


def _segments(material: Material, log10_p: FloatArray) -> tuple[FloatArray, NDArray[np.int64]]:
    """(segment, 5 + 3 P) foot, top [K], h, c, c' and for each pressure theta, k, k'; the segment of each bin."""
    p_Pa, at_K, k = material.conductivity_grid()
    c_at_K, c = pairs(material.specific_heat_J_kgK)
    foot = np.unique(np.concatenate([[0.0], at_K, c_at_K]))
    if np.any(foot % BIN_K != 0.0):
        raise ValueError("the C peer takes materials whose temperatures are multiples of a bin")
    columns = [foot, np.append(foot[1:], np.inf), *_integrals(foot, np.interp(foot, c_at_K, c))]
    for x in log10_p:
        at_p = [np.interp(x, np.log10(p_Pa), row) for row in k]
        columns.extend(_integrals(foot, np.interp(foot, at_K, at_p)))
    of_bin = np.searchsorted(foot, EDGES_K[:-1], side="right") - 1
    return np.ascontiguousarray(np.column_stack(columns)), of_bin.astype(np.int64)


def _surface(material: Material, cp_J_kgK: float, pressures: int) -> FloatArray:
    """(bin, 2 + 3 P) emittance, its slope, and H_w, cp, 0 for each pressure."""
    _, eps, slope = _integrals(EDGES_K, np.interp(EDGES_K, *pairs(material.emissivity or [[0.0, 1.0]])))
    wall = [cp_J_kgK * EDGES_K[:-1], np.full(BINS, cp_J_kgK), np.zeros(BINS)]
    return np.column_stack([eps[:-1], slope[:-1], *(wall * pressures)])


def _porous(material: Material) -> bool:
    return len(material.conductivity_grid()[0]) > 1


def _address(array: np.ndarray) -> int:
    return array.ctypes.data


@dataclass
class _Packed:
    nodes: int
    arguments: tuple[np.ndarray, ...]


class Peer:
    """The groups of an ensemble, packed for the C library; `reset` puts them at the ensemble's present temperatures.

    It makes its own tables from the declared materials, and takes what the benchmark needs: points of one construction
    without contact resistance, a constant cp at the wall, first derivatives of the ratio, no effects.
    """

    def __init__(self, library: ctypes.CDLL, ensemble: Ensemble) -> None:
        self._library, self._tolerance_K = library, ensemble.tolerance_K
        layers = ensemble.models[0].construction.layer_materials()
        if any(m.construction is not ensemble.models[0].construction for m in ensemble.models):
            raise ValueError("the C peer takes points of one construction")
        self._log10_p = np.unique(np.concatenate([np.log10(m.conductivity_grid()[0]) for m in layers if _porous(m)]))
        distinct = list({id(m): m for m in layers}.values())
        self._segment_arrays = [_segments(m, self._log10_p) for m in distinct]
        pairs_ = [_Material(_address(s), _address(b)) for s, b in self._segment_arrays]
        self._materials = (_Material * len(pairs_))(*pairs_)
        index = [next(k for k, m in enumerate(distinct) if m is layer) for layer in layers]
        self._lay_table(ensemble.models[0])
        self._packed = [self._pack(ensemble, g, np.array(index)) for g in range(len(ensemble.groups))]
        self._groups = [_aligned(library.group_size(ctypes.c_long(p.nodes))) for p in self._packed]
        self.reset()

    def _lay_table(self, model: PointModel) -> None:
        """Pressures, surface and ratio table in one array."""
        outer = model.construction.layer_materials()[0]
        if model.ratio is None or isinstance(model.wall_enthalpy, str):
            raise ValueError("the C peer takes points with a ratio table and a constant cp")
        surface = _surface(outer, model.wall_enthalpy, len(self._log10_p)).ravel()
        self._surface_at = len(self._log10_p)
        self._ratio_at = self._surface_at + len(surface)
        self._table = np.concatenate([self._log10_p, surface, pack_table(model.ratio)])

    def _pack(self, ensemble: Ensemble, g: int, index: NDArray[np.int64]) -> _Packed:
        B = ensemble.memory.block(g)
        mesh = ensemble.meshes[ensemble.lanes[g * LANES]]
        rows = np.array([[B[node_row(i, r)] for r in (T, M_LEFT, M_RIGHT, G)] for i in range(mesh.nodes)])
        right = index[np.append(mesh.layer, mesh.layer[-1])]
        interface = np.append(0, np.diff(right) != 0)
        which = np.column_stack([interface, *([right] * LANES)]).astype(np.int64)
        first = [parameters_at(lane) for lane in range(LANES)]
        parameters = np.array([B[p : p + REFERENCE + VARIABLES] for p in first]).T
        scalars = np.concatenate(
            [
                [B[scalar_row(r)] for r in (SURROUNDINGS4, BACK_H, BACK_T, BACK_EPS, FACTOR_EPS)],
                parameters[[SCALE, D0]],
                parameters[FIRST : FIRST + VARIABLES],
                parameters[REFERENCE : REFERENCE + VARIABLES],
            ]
        )
        tables = np.repeat([self._ratio_at, self._surface_at], LANES).astype(np.int64)
        return _Packed(mesh.nodes, (rows, which, scalars, tables))

    def reset(self) -> None:
        """Every group at the temperatures that the ensemble had."""
        for group, packed in zip(self._groups, self._packed, strict=True):
            self._library.set_up(
                ctypes.c_void_p(group[1]),
                ctypes.c_long(packed.nodes),
                ctypes.c_long(len(self._log10_p)),
                ctypes.c_void_p(_address(self._table)),
                ctypes.byref(self._materials),
                *(ctypes.c_void_p(_address(a)) for a in packed.arguments),
            )

    def march(self, time_s: FloatArray, history: FloatArray) -> None:
        """All groups through one flight, history (time, condition); no history of temperatures is kept."""
        if history.shape != (len(time_s), len(CONDITION_COLUMNS)):
            raise ValueError(f"history is {history.shape}")
        self._run(self._library.march, time_s, history)

    def march_heated(self, time_s: FloatArray, heating: FloatArray) -> None:
        """March with the heating of stages 1 and 2 of each step given, (time, 2, 5, LANES), equal for all groups."""
        self._run(self._library.march_heated, time_s, heating)

    def _run(self, function: Callable[..., object], time_s: FloatArray, driving: FloatArray) -> None:
        for group in self._groups:
            function(
                ctypes.c_void_p(group[1]), ctypes.c_void_p(_address(time_s)), ctypes.c_void_p(_address(driving)),
                ctypes.c_long(len(time_s)), ctypes.c_double(self._tolerance_K), None,
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
    """Memory of a number of bytes, and the first aligned address in it."""
    memory = ctypes.create_string_buffer(size + boundary)
    return memory, (ctypes.addressof(memory) + boundary - 1) // boundary * boundary
