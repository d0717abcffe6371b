"""Errors that a caller may want to catch."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


class InputError(ValueError):
    """A file, an argument or a flight condition that cannot be used.

    problems : one line each: what, where, and what to do. All problems of a file are given at once;
               the first stands alone as the message of a one-line report.

    >>> import sim_heating as sh
    >>> try:
    ...     sh.load_vehicle("orbitre")
    ... except sh.InputError as error:
    ...     print(error)
    vehicle `orbitre`: unknown vehicle; did you mean `orbiter`?
    """

    def __init__(self, *problems: str) -> None:
        self.problems = problems
        super().__init__("\n".join(problems))


@contextmanager
def error_context(place: str) -> Iterator[None]:
    """Prefix every problem that the block raises with its place: a file, table or option."""
    try:
        yield
    except InputError as error:
        raise InputError(*(f"{place}: {problem}" for problem in error.problems)) from None


class RunError(RuntimeError):
    """A run that failed although its input was good: no convergence, or a host that stopped.

    >>> import sim_heating as sh
    >>> issubclass(sh.RunError, RuntimeError)
    True
    """
