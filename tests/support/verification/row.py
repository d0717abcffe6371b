"""One line of the verification: a quantity that the program computes, and what it has to be."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Row:
    """One comparison.

    reference : what is compared, and under which conditions
    expected  : value of the reference [unit]
    got       : value that the program computes [unit]
    limit     : largest error |got - expected| [unit]
    unit      : of the three
    source    : where the expected value comes from
    limit_is  : why the limit is what it is: discretisation, digits of the source, model of the source
    """

    reference: str
    expected: float
    got: float
    limit: float
    unit: str
    source: str
    limit_is: str

    @property
    def error(self) -> float:
        """Got less expected [unit]."""
        return self.got - self.expected

    @property
    def kept(self) -> bool:
        """Whether the error is within its limit; not where one of them is not a number."""
        return abs(self.error) <= self.limit


def within(share: float, reference: str, expected: float, got: float, unit: str, source: str, limit_is: str) -> Row:
    """A row whose limit is a share of the expected value [-]."""
    return Row(reference, expected, got, share * abs(expected), unit, source, limit_is)


def number(value: float) -> str:
    """Six digits, with an exponent only where it is shorter."""
    return f"{value:.6g}"


def cells(row: Row) -> tuple[str, ...]:
    """Reference, expected, got, error and limit as text."""
    unit = "" if row.unit in ("", "-") else f" {row.unit}"
    return (
        row.reference,
        number(row.expected) + unit,
        number(row.got) + unit,
        f"{row.error:.2g}{'' if row.kept else ' !'}",
        f"{row.limit:.2g}",
    )


def text_table(rows: Sequence[Row]) -> str:
    """Rows as text, one a line: reference | expected | got | error | limit; `!` marks an error beyond its limit."""
    lines = [("reference", "expected", "got", "error", "limit"), *map(cells, rows)]
    widths = [max(len(line[k]) for line in lines) for k in range(5)]
    return "\n".join(" | ".join(c.ljust(w) for c, w in zip(line, widths, strict=True)).rstrip() for line in lines)
