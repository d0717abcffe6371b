"""The image of a model: the two arrays that its function works on, the variables in them, and its error messages.

`model.bin`, little-endian, 8 bytes a number, no gaps:

    16 bytes            "sim-heating-fmu2"
    int64[7]            numbers in R and in N, variables, problems, bytes of text, place of the token, checksum
    variables           int64 kind, role, place, count, place of the name; float64 lower, upper
    problems            int64 place of the name and of the rule in the text, place of the value in R or -1
    R, N                float64, int64
    text                UTF-8, each piece ended by a 0, padded with zeros to a whole number of words

The checksum is the sum of all words after it, each mixed with its place, modulo 2^64 (`checksum`).
"""

from __future__ import annotations

import re
import struct
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

MAGIC = b"sim-heating-fmu2"
LINE = 8
"""Numbers in a cache line, at which an aligned block begins."""
TEXT_BYTES = 1024
"""Bytes for the path of a table, with the 0 that ends it."""


class Kind(IntEnum):
    """What a variable is: a number (or an array of them) in R, an integer in N, the path of a ratio table in N."""

    NUMBER = 0
    INTEGER = 1
    TABLE = 2


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
    """A variable of the FMU; its value reference is its place in the list.

    place   : of its first entry in R or N
    unit    : SI or degrees, "1" for a pure number
    shape   : of an array, empty for one number
    choices : name and text of each value 1, 2, ... of an enumeration
    """

    name: str
    kind: Kind
    role: Role
    place: int
    text: str
    unit: str = "1"
    lower: float = -np.inf
    upper: float = np.inf
    nominal: float | None = None
    shape: tuple[int, ...] = ()
    choices: tuple[tuple[str, str], ...] = ()

    @property
    def count(self) -> int:
        """Number of entries of its array that it takes."""
        return TEXT_BYTES // 8 if self.kind is Kind.TABLE else int(np.prod(self.shape, dtype=int))


@dataclass(frozen=True)
class Problem:
    """Message for an outcome of the model: a name, a rule, and the place of the value in R (-1 without one)."""

    name: str
    rule: str
    place: int = -1


@dataclass
class Image:
    """An image, to which numbers, integers, variables and problems are added.

    name      : of the model, an identifier
    title     : one line on the model
    step_s    : communication step recommended to hosts [s]
    variables : in the order of their value references
    problems  : in the order of the outcomes of the model
    """

    name: str
    title: str
    step_s: float
    variables: list[Variable] = field(default_factory=list)
    problems: list[Problem] = field(default_factory=list)
    _R: list[NDArray[np.float64]] = field(default_factory=list)
    _N: list[NDArray[np.int64]] = field(default_factory=list)
    _text: bytearray = field(default_factory=lambda: bytearray(1))
    n_R: int = 0
    n_N: int = 0

    def add_numbers(self, values: ArrayLike, *, aligned: bool = False) -> int:
        """Add numbers to R, with `aligned` at the beginning of a cache line; the place of the first."""
        # As `aligned_zeros` of the ensemble: vectors of a block then do not cross cache lines.
        if aligned and self.n_R % LINE:
            self.add_numbers(np.zeros(LINE - self.n_R % LINE))
        added = np.array(values, dtype=np.float64).ravel()
        self._R.append(added)
        self.n_R += len(added)
        return self.n_R - len(added)

    def add_integers(self, values: ArrayLike) -> int:
        """Add integers to N; the place of the first."""
        added = np.array(values, dtype=np.int64).ravel()
        self._N.append(added)
        self.n_N += len(added)
        return self.n_N - len(added)

    def add_text(self, piece: str) -> int:
        """Add a text to the image; its place."""
        return _append(self._text, piece)

    @property
    def R(self) -> NDArray[np.float64]:
        """All numbers (a copy)."""
        return np.concatenate(self._R)

    @property
    def N(self) -> NDArray[np.int64]:
        """All integers (a copy)."""
        return np.concatenate(self._N)

    def set_integers(self, values: Sequence[tuple[int, int]]) -> None:
        """Set integers of N.

        values : (place, value) of each
        """
        whole = self.N
        for place, value in values:
            whole[place] = value
        self._N = [whole]

    def set_numbers(self, R: NDArray[np.float64]) -> None:
        """Replace all numbers of R by an array of equal length."""
        self._R = [np.array(R, dtype=np.float64)]

    def value(self, variable: Variable) -> NDArray[np.float64] | int | str:
        """Start value of a variable."""
        if variable.kind is Kind.TABLE:
            return ""
        if variable.kind is Kind.INTEGER:
            return int(self.N[variable.place])
        return self.R[variable.place : variable.place + variable.count]

    def binary(self, token: str) -> bytes:
        """The file `model.bin`."""
        text = self._text.copy()

        def place(piece: str) -> int:
            return _append(text, piece)

        at = place(token)
        variables = b"".join(
            struct.pack("<5q2d", v.kind, v.role, v.place, v.count, place(v.name), v.lower, v.upper)
            for v in self.variables
        )
        problems = b"".join(struct.pack("<3q", place(p.name), place(p.rule), p.place) for p in self.problems)
        text.extend(b"\0" * (-len(text) % 8))
        body = variables + problems + self.R.astype("<f8").tobytes() + self.N.astype("<i8").tobytes() + bytes(text)
        counts = (self.n_R, self.n_N, len(self.variables), len(self.problems), len(text), at)
        return MAGIC + struct.pack("<6qQ", *counts, checksum(body)) + body


def identifier(name: str) -> str:
    """A name as a C identifier."""
    plain = re.sub(r"\W", "_", name, flags=re.ASCII)
    return f"_{plain}" if plain[:1].isdigit() else plain


def _append(text: bytearray, piece: str) -> int:
    at = len(text)
    text.extend(piece.encode() + b"\0")
    return at


def checksum(body: bytes) -> int:
    """Sum of the words modulo 2^64, each plus a multiple of its place and then mixed as splitmix64 does.

    A single changed or moved word changes the sum; several leave it unchanged with a probability of 2^-64 (Steele, Lea
    and Flood, 2014).
    """
    # Mixed and not only summed: two flipped high bits cancelled in a linear sum, and a damaged state was accepted.
    words = np.frombuffer(body, dtype="<u8")
    z = words + np.arange(1, len(words) + 1, dtype=np.uint64) * np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return int(np.sum(z ^ (z >> np.uint64(31)), dtype=np.uint64))
