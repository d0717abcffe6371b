"""Verdicts on a record that say: this is no aerothermal effect."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Verdict:
    """One finding.

    kind  : "broken sensor", "clock", "material", "trajectory"
    words : what is wrong, by what it is seen, what to do
    """

    kind: str
    words: str
