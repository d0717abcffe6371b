"""Factors and levels of the credibility statement: `rules.toml` as data, and the level that evidence reaches.

A level counts only when all levels below it are reached, so that a rule is never made up for by another one, and
evidence that is taken away never raises a level.
"""

from __future__ import annotations

import tomllib
from collections.abc import Collection
from dataclasses import dataclass
from functools import cache
from pathlib import Path

RULES = Path(__file__).with_name("rules.toml")
REVIEW = "review."
"""Evidence of a signed review is named `review.FACTOR.LEVEL`."""
HIGHEST = 4


@dataclass(frozen=True)
class Level:
    """One level of a factor.

    number : 1 to 4;  rule : what it asks for, in words;  needs : names of the evidence that the rule asks for
    """

    number: int
    rule: str
    needs: tuple[str, ...]


@dataclass(frozen=True)
class Factor:
    """A factor of credibility.

    about     : what it judges;  lowest : rule of level 0
    by_people : whether only a signed review says anything about it
    """

    name: str
    title: str
    about: str
    lowest: str
    levels: tuple[Level, ...]
    by_people: bool = False

    def level(self, evidence: Collection[str]) -> int:
        """Level that evidence reaches, 0 to 4: the last whose rule, and all rules below, are met.

        evidence : names of the evidence that is there

        >>> verification = next(f for f in rules().factors if f.name == "verification")
        >>> verification.level({"verification.core", "verification.error"})
        1
        """
        reached = 0
        for level in self.levels:
            if not set(level.needs) <= set(evidence):
                break
            reached = level.number
        return reached

    def rule(self, level: int) -> str:
        """Rule of a level, 0 to 4."""
        return self.levels[level - 1].rule if level else self.lowest

    def missing(self, evidence: Collection[str]) -> tuple[str, ...]:
        """Names of the evidence that the next level needs and that is not there; empty at the highest level."""
        level = self.level(evidence)
        return () if level == HIGHEST else tuple(n for n in self.levels[level].needs if n not in evidence)


@dataclass(frozen=True)
class Rules:
    """All factors in their order; `basis` says after which standard, and what the statement is not."""

    basis: str
    factors: tuple[Factor, ...]


@cache
def rules() -> Rules:
    """The content of rules.toml."""
    data = tomllib.loads(RULES.read_text(encoding="utf-8"))
    return Rules(data["basis"], tuple(_factor(f) for f in data["factor"]))


def _factor(data: dict[str, object]) -> Factor:
    levels = data.pop("level")
    assert isinstance(levels, list)
    numbered = tuple(Level(i, level["rule"], tuple(level["needs"])) for i, level in enumerate(levels, start=1))
    return Factor(**data, levels=numbered)  # type: ignore[arg-type]
