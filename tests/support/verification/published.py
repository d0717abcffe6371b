"""Published numbers that the verification compares with."""

from __future__ import annotations

import csv
from pathlib import Path


def published_atmosphere() -> list[dict[str, float]]:
    """Rows of us76_published.csv: US Standard Atmosphere 1976, Table I; nan where a value was not at hand."""
    text = (Path(__file__).parent / "us76_published.csv").read_text()
    lines = [line for line in text.splitlines() if not line.startswith("#")]
    return [{k: float(v) for k, v in row.items()} for row in csv.DictReader(lines)]
