"""Verification: what the program computes against exact, published and independently computed values.

    python -m benchmarks verification

prints one table, reference | expected | got | error | limit, and writes all digits into results/verification.json;
`python -m tools.page_figures --write` puts the table into docs/evidence/verification.md. The exit status is 1 where an
error exceeds its limit. A reference is a closed form, a number that others published, or a solution by methods and code
that share nothing with the package; the rows are those of tests/support/verification.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import asdict

import click

from benchmarks.measure import Figure, save
from tests.support.verification import (
    at_rest,
    atmosphere,
    chosen,
    conduction,
    effects,
    flights,
    gas,
    heating,
    inside,
    loggers,
    numerics,
    optimum,
    sensors,
    stack,
    surface,
    trajectories,
    trim,
    wall_steps,
)
from tests.support.verification.row import Row, text_table

LEAST_ROWS = 60
SUBJECTS: Mapping[str, Callable[[], list[Row]]] = {
    "Conduction": conduction.rows,
    "Surface": surface.rows,
    "Transition and recombination": effects.rows,
    "Behind and within a wall": inside.rows,
    "At rest on the runway": at_rest.rows,
    "Mesh and steps as chosen": chosen.rows,
    "Method": numerics.rows,
    "Whole stack, estimates": stack.rows,
    "Atmosphere": atmosphere.rows,
    "Equilibrium air and shocks": gas.rows,
    "Reference heating": heating.rows,
    "Behind a step of wall temperature": wall_steps.rows,
    "Trajectories": trajectories.rows,
    "Trim": trim.rows,
    "Optimal entry": optimum.rows,
    "Sensors": sensors.rows,
    "Flights as tools write them": flights.rows,
    "Files of loggers": loggers.rows,
}


def run() -> list[Figure]:
    """Compute all rows, print the table, save every digit."""
    found: dict[str, list[Row]] = {}
    start = time.perf_counter()
    for subject, rows in SUBJECTS.items():
        found[subject] = rows()
        click.echo(f"\n{subject}\n{text_table(found[subject])}")
    click.echo("")
    everything = [row for rows in found.values() for row in rows]
    figures = [
        Figure("rows", len(everything), "", LEAST_ROWS, at_least=True),
        Figure("rows with an error beyond its limit", sum(not row.kept for row in everything), "", 0),
        Figure("time", time.perf_counter() - start, "s"),
    ]
    listed = [{"subject": name, **asdict(row), "error": row.error} for name, rows in found.items() for row in rows]
    save("verification", figures, {"rows": listed})
    return figures
