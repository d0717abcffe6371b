"""Errors that a caller may want to catch."""

from __future__ import annotations

import re
import unicodedata
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import TypeVar

R = TypeVar("R")
S = TypeVar("S")
LONGEST = 600
"""Characters of one problem; of a longer one, such as a library's own text, the middle is left out."""
TAIL = 150
CONTROLS = ("Cc", "Cs", "Cn", "Zl", "Zp")
"""Categories of characters without a glyph: controls, halves of a pair, unassigned, separators of lines."""
DIRECTIONS = ("LRE", "RLE", "LRO", "RLO", "PDF", "LRI", "RLI", "FSI", "PDI")
"""Classes of characters that change the direction of writing."""

_NOT_PLAIN = re.compile(r"[^\n\t -~]")


def printable(text: str) -> str:
    """A text whose control characters are shown as escapes; line breaks and tabs are kept.

    A terminal would obey some of them, a browser drops some, and overrides of the direction of writing make a name read
    as another.
    """
    return _NOT_PLAIN.sub(lambda match: repr(match[0])[1:-1] if _is_control(match[0]) else match[0], text)


def _is_control(c: str) -> bool:
    return unicodedata.category(c) in CONTROLS or unicodedata.bidirectional(c) in DIRECTIONS


def one_line(text: str) -> str:
    """A problem as one printable line: other characters (a line break in a key) as escapes, a long one cut."""
    line = "".join(c if c.isprintable() else repr(c)[1:-1] for c in text.strip())
    return line if len(line) <= LONGEST else f"{line[: LONGEST - TAIL]} ... {line[-TAIL:]}"


class InputError(ValueError):
    """A file, an argument or a flight condition that cannot be used.

    problems : one line each: what, where, and what to do. All problems of a file are given at once, each once;
               the first stands alone as the message of a one-line report. Whatever the texts contain, a line is
               printable and of a length that can be read.

    >>> import sim_heating as sh
    >>> try:
    ...     sh.load_vehicle("orbitre")
    ... except sh.InputError as error:
    ...     print(error)
    vehicle `orbitre`: unknown vehicle; did you mean `orbiter`?
    """

    def __init__(self, *problems: str) -> None:
        self.problems = tuple(dict.fromkeys(map(one_line, problems)))
        super().__init__("\n".join(self.problems))

    def __reduce__(self) -> tuple[type[InputError], tuple[str, ...]]:
        return type(self), self.problems  # an error of another process keeps its problems apart


@contextmanager
def reworded(reword: Callable[[str], str]) -> Iterator[None]:
    """Word every problem that the block raises again."""
    try:
        yield
    except InputError as error:
        raise InputError(*map(reword, error.problems)) from None


def error_context(location: str) -> AbstractContextManager[None]:
    """Prefix every problem that the block raises with its place: a file, table or option."""
    return reworded(lambda problem: f"{location}: {problem}")


@contextmanager
def failure_context(location: str) -> Iterator[None]:
    """As `error_context`, also for a run that fails: the file is that of what was run."""
    try:
        with error_context(location):
            yield
    except RunError as error:
        raise RunError(f"{location}: {error}") from error


class RunError(RuntimeError):
    """A run that failed although its input was good: no convergence, or a host that stopped; one printable line.

    >>> import sim_heating as sh
    >>> issubclass(sh.RunError, RuntimeError)
    True
    """

    def __init__(self, message: str) -> None:
        super().__init__(one_line(message))


class LeftOutWarning(UserWarning):
    """A piece of the results that is left out because it could not be made.

    Evidence, sections of a page and entries of a JSON file are pieces. What a command was asked for, such as
    temperatures, estimates or a finding, fails as a whole instead.
    """


class UnusualWarning(UserWarning):
    """Input that is possible and accepted, yet outside what flights, vehicles and materials are like in fact."""


def tell(remarks: Iterable[str]) -> None:
    """Tell what is unusual about an input, each remark as an UnusualWarning of one line: file, row or key, and why.

    A command prints them, and lists them in the object of `--json`; a program that uses the package sees warnings.
    """
    for remark in dict.fromkeys(map(one_line, remarks)):
        warnings.warn(remark, UnusualWarning, stacklevel=3)


def reason_of(error: Exception) -> str:
    """The type and the message of an error on one line."""
    return one_line(f"{type(error).__name__}: {' '.join(str(error).split())}")


def tell_left_out(title: str, error: Exception) -> str:
    """Warn of a piece that an error costs, by its title; returns the reason."""
    reason = reason_of(error)
    warnings.warn(f"{title}: left out ({reason})", LeftOutWarning, stacklevel=3)
    return reason


def or_left_out(make: Callable[[], R], substitute: S, title: str) -> R | S:
    """The piece that `make` returns; where it raises, a substitute, and a LeftOutWarning that gives the reason.

    title : names the piece in the warning, such as "evidence, axial steps"
    """
    try:
        return make()
    except Exception as error:
        tell_left_out(title, error)
        return substitute
