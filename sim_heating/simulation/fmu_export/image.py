"""The image of a model: the two arrays that its functions work on, the variables in them, and what can go wrong.

`model.bin`, little-endian, 8 bytes a number, no gaps:

    16 bytes            "sim-heating-fmu2"
    int64[7]            numbers in R and in N, variables, problems, bytes of text, place of the token, checksum
    variables           int64 kind, role, place, count, place of the name; float64 lower, upper
    problems            int64 place of the name and of the rule in the text, place of the value in R or -1
    R, N                float64, int64
    text                UTF-8, each piece ended by a 0, filled up with zeros to a whole number of words

The checksum is the sum of all words behind it, each mixed with its place, modulo 2^64 (`checksum`).
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
"""Numbers of a cache line, on which a block begins."""
TEXT_BYTES = 1024
"""Room for the path of a table, and its end."""


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

    shape   : of an array, empty for one number
    unit    : contract unit, "1" where it has none
    choices : of an enumeration: text of 1, 2, ...
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
        """How many entries of its array it takes."""
        return TEXT_BYTES // 8 if self.kind is Kind.TABLE else int(np.prod(self.shape, dtype=int))


@dataclass(frozen=True)
class Problem:
    """What an outcome means: a name, a rule, and where the value stands in R (-1 where there is none)."""

    name: str
    rule: str
    place: int = -1


@dataclass
class Image:
    """An image in the making, then whole.

    name      : of the model, an identifier
    title     : what it is, in a line
    step_s    : communication step that hosts are advised to take [s]
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

    def numbers(self, values: ArrayLike, *, aligned: bool = False) -> int:
        """Put numbers into R; their place."""
        if aligned and self.n_R % LINE:
            self.numbers(np.zeros(LINE - self.n_R % LINE))
        own = np.array(values, dtype=np.float64).ravel()
        self._R.append(own)
        self.n_R += len(own)
        return self.n_R - len(own)

    def integers(self, values: ArrayLike) -> int:
        """Put integers into N; their place."""
        own = np.array(values, dtype=np.int64).ravel()
        self._N.append(own)
        self.n_N += len(own)
        return self.n_N - len(own)

    def text(self, piece: str) -> int:
        """Put a text into the image; its place."""
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
        """Change integers: (place, value)."""
        whole = self.N
        for place, value in values:
            whole[place] = value
        self._N = [whole]

    def set_numbers(self, R: NDArray[np.float64]) -> None:
        """Take all numbers from an array of the same length."""
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
    """A name as an identifier of C."""
    plain = re.sub(r"\W", "_", name, flags=re.ASCII)
    return f"_{plain}" if plain[:1].isdigit() else plain


def _append(text: bytearray, piece: str) -> int:
    at = len(text)
    text.extend(piece.encode() + b"\0")
    return at


def checksum(body: bytes) -> int:
    """Sum of the words modulo 2^64, each plus a multiple of its place and then mixed as splitmix64 does.

    One changed or moved word changes the sum, several leave it with a chance of 2^-64 (Steele, Lea and Flood, 2014).
    """
    words = np.frombuffer(body, dtype="<u8")
    z = words + np.arange(1, len(words) + 1, dtype=np.uint64) * np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return int(np.sum(z ^ (z >> np.uint64(31)), dtype=np.uint64))
