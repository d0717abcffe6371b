"""The image of a model: the arrays that its function works on, the variables in them, and its error messages.

R and N, numbers and integers, change in a step; T, its tables, does not and is shared by all instances. Of R and N only
the runs that are declared kept are the state of an instance; all else is constant or is computed from them when a step
begins.

`model.bin`, little-endian, 8 bytes a number, no gaps:

    16 bytes            "sim-heating-fmu3"
    int64[10]           numbers in R, in N and in T, variables, problems, kept runs of R and of N, bytes of text, offset
                        of the token, checksum
    variables           int64 kind, role, offset, count, offset of the name; float64 lower, upper
    problems            int64 offset of the name and of the rule in the text, offset of the value in R or -1
    kept runs           int64 offset and count, of R, then of N
    R, N, T             float64, int64, float64
    text                UTF-8, each piece ended by a 0, padded with zeros to a whole number of words

The checksum is the sum of all words after it, each mixed with its index, modulo 2^64 (`checksum`).
"""

from __future__ import annotations

import re
import struct
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

MAGIC = b"sim-heating-fmu3"
LINE = 8
"""Numbers in a cache line, at which an aligned block begins."""


class Kind(IntEnum):
    """What a variable is: a number in R, an integer in N, the path of a table, or an array in T of the last such table.

    The offset of a table's path is that of integers in N: offset of the name of the reference heating in the text, of
    the table in T, the number of lanes that use it, and the offset in N of each lane's own.
    """

    NUMBER = 0
    INTEGER = 1
    TABLE = 2
    SHARED = 3


class Role(IntEnum):
    """Who sets a variable, and when."""

    INDEPENDENT = 0
    INPUT = 1
    TUNABLE = 2
    FIXED = 3
    OUTPUT = 4
    CONSTANT = 5


@dataclass(frozen=True)
class Variable:
    """A variable of the FMU; its value reference is its index in the list.

    offset     : of its first entry in R, N or T
    unit       : SI or degrees, "1" for a pure number
    shape      : of an array, empty for one number
    choices    : name and text of each value 1, 2, ... of an enumeration; without any an integer is one
    integers   : number of integers of a table's path
    depends    : of an output, names of the inputs that it depends on at a communication point
    parameters : of an output, names of the parameters that its initial value depends on
    """

    name: str
    kind: Kind
    role: Role
    offset: int
    text: str
    unit: str = "1"
    lower: float = -np.inf
    upper: float = np.inf
    nominal: float | None = None
    shape: tuple[int, ...] = ()
    choices: tuple[tuple[str, str], ...] = ()
    integers: int = 1
    depends: tuple[str, ...] = ()
    parameters: tuple[str, ...] = ()

    @property
    def count(self) -> int:
        """Number of entries of its array that it takes."""
        return self.integers if self.kind is Kind.TABLE else int(np.prod(self.shape, dtype=int))


@dataclass(frozen=True)
class Problem:
    """Message for an outcome of the model: a name, a rule, and the offset of the value in R (-1 without one)."""

    name: str
    rule: str
    offset: int = -1


@dataclass(frozen=True)
class SampledMap:
    """A function sampled on a rectilinear grid, by the names of its variables.

    name            : of the map, unique in its image
    text            : its meaning, with interpolation and extrapolation
    axes            : of each dimension, name of the array of its nodes
    operating_point : of each dimension, name of the variable at whose value the function is evaluated
    values          : name of the array of the values at the nodes, one dimension an axis
    """

    name: str
    text: str
    axes: tuple[str, ...]
    operating_point: tuple[str, ...]
    values: str


@dataclass
class Image:
    """An image, to which numbers, integers, variables and problems are added.

    name                        : of the model, an identifier
    title                       : one line on the model
    step_s                      : communication step recommended to hosts [s]
    variables                   : in the order of their value references
    problems                    : in the order of the outcomes of the model
    maps                        : functions whose nodes and values are arrays among the variables
    kept_numbers, kept_integers : (offset, count) of the runs of R and of N that are the state of an instance
    """

    name: str
    title: str
    step_s: float
    variables: list[Variable] = field(default_factory=list)
    problems: list[Problem] = field(default_factory=list)
    maps: list[SampledMap] = field(default_factory=list)
    _R: list[NDArray[np.float64]] = field(default_factory=list)
    _N: list[NDArray[np.int64]] = field(default_factory=list)
    _T: list[NDArray[np.float64]] = field(default_factory=list)
    kept_numbers: list[tuple[int, int]] = field(default_factory=list)
    kept_integers: list[tuple[int, int]] = field(default_factory=list)
    _text: bytearray = field(default_factory=lambda: bytearray(1))
    n_R: int = 0
    n_N: int = 0
    n_T: int = 0

    def add_numbers(self, values: ArrayLike, *, aligned: bool = False) -> int:
        """Add numbers to R, with `aligned` at the beginning of a cache line; the offset of the first."""
        # As `aligned_zeros` of the ensemble: vectors of a block then do not cross cache lines.
        if aligned and self.n_R % LINE:
            self.add_numbers(np.zeros(LINE - self.n_R % LINE))
        added = np.array(values, dtype=np.float64).ravel()
        self._R.append(added)
        self.n_R += len(added)
        return self.n_R - len(added)

    def keep_numbers(self, values: ArrayLike) -> int:
        """Add numbers to R that belong to the state of an instance; the offset of the first."""
        first = self.add_numbers(values)
        self.kept_numbers.append((first, self.n_R - first))
        return first

    def add_tables(self, values: ArrayLike) -> int:
        """Add numbers to T; the offset of the first."""
        added = np.array(values, dtype=np.float64).ravel()
        self._T.append(added)
        self.n_T += len(added)
        return self.n_T - len(added)

    def add_integers(self, values: ArrayLike) -> int:
        """Add integers to N; the offset of the first."""
        added = np.array(values, dtype=np.int64).ravel()
        self._N.append(added)
        self.n_N += len(added)
        return self.n_N - len(added)

    def add_text(self, piece: str) -> int:
        """Add a text to the image; its offset."""
        return _append(self._text, piece)

    @property
    def R(self) -> NDArray[np.float64]:
        """All numbers (a copy)."""
        return np.concatenate(self._R)

    @property
    def N(self) -> NDArray[np.int64]:
        """All integers (a copy)."""
        return np.concatenate(self._N)

    @property
    def T(self) -> NDArray[np.float64]:
        """All numbers of the tables (a copy)."""
        return np.concatenate(self._T)

    def set_integers(self, values: Sequence[tuple[int, int]]) -> None:
        """Set integers of N.

        values : (offset, value) of each
        """
        integers = self.N
        for offset, value in values:
            integers[offset] = value
        self._N = [integers]

    def set_numbers(self, R: NDArray[np.float64]) -> None:
        """Replace all numbers of R by an array of equal length."""
        self._R = [np.array(R, dtype=np.float64)]

    def value(self, variable: Variable) -> NDArray[np.float64] | int | str:
        """Start value of a variable."""
        if variable.kind is Kind.TABLE:
            return ""
        if variable.kind is Kind.INTEGER:
            return int(self.N[variable.offset])
        if variable.kind is Kind.SHARED:
            return self.T[variable.offset : variable.offset + variable.count]
        return self.R[variable.offset : variable.offset + variable.count]

    def binary(self, token: str) -> bytes:
        """The file `model.bin`."""
        text = self._text.copy()

        def offset(piece: str) -> int:
            return _append(text, piece)

        at = offset(token)
        variables = b"".join(
            struct.pack("<5q2d", v.kind, v.role, v.offset, v.count, offset(v.name), v.lower, v.upper)
            for v in self.variables
        )
        problems = b"".join(struct.pack("<3q", offset(p.name), offset(p.rule), p.offset) for p in self.problems)
        text.extend(b"\0" * (-len(text) % 8))
        kept = _joined(self.kept_numbers), _joined(self.kept_integers)
        runs = np.array([*kept[0], *kept[1]], dtype="<i8").tobytes()
        arrays = self.R.astype("<f8").tobytes() + self.N.astype("<i8").tobytes() + self.T.astype("<f8").tobytes()
        body = variables + problems + runs + arrays + bytes(text)
        counts = (self.n_R, self.n_N, self.n_T, len(self.variables), len(self.problems), len(kept[0]), len(kept[1]))
        return MAGIC + struct.pack("<9qQ", *counts, len(text), at, checksum(body)) + body


def identifier(name: str) -> str:
    """A name as a C identifier."""
    plain = re.sub(r"\W", "_", name, flags=re.ASCII)
    return f"_{plain}" if plain[:1].isdigit() else plain


def _joined(runs: Sequence[tuple[int, int]]) -> list[tuple[int, int]]:
    """Runs in the order of their offsets, those that touch as one.

    runs : (offset, count) of each
    """
    joined: list[tuple[int, int]] = []
    for offset, count in sorted(runs):
        if joined and joined[-1][0] + joined[-1][1] == offset:
            joined[-1] = joined[-1][0], joined[-1][1] + count
        else:
            joined.append((offset, count))
    return joined


def _append(text: bytearray, piece: str) -> int:
    at = len(text)
    text.extend(piece.encode() + b"\0")
    return at


def checksum(body: bytes) -> int:
    """Sum of the words modulo 2^64, each plus a multiple of its index and then mixed as splitmix64 does.

    A single changed or moved word changes the sum; several leave it unchanged with a probability of 2^-64 (Steele, Lea
    and Flood, 2014).
    """
    # Mixed and not only summed: two flipped high bits cancelled in a linear sum, and a damaged state was accepted.
    integers = np.frombuffer(body, dtype="<u8")
    z = integers + np.arange(1, len(integers) + 1, dtype=np.uint64) * np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return int(np.sum(z ^ (z >> np.uint64(31)), dtype=np.uint64))
