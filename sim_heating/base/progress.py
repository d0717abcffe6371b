"""Progress reports of long work."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[float, str], None]
"""Called with the fraction done (0 to 1) and a line of text."""


def no_progress(_: float, __: str) -> None:
    """Progress that is not reported."""
