"""What long work tells of how far it is."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[float, str], None]
"""Told the fraction done and what is being done."""


def no_progress(_: float, __: str) -> None:
    """Progress that nobody is told of."""
