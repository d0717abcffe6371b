"""Damaged inputs of every format: each is accepted with finite results, or refused, or failed, in a line.

    python -m benchmarks.mutants --count 10000 --seed 0      # resumes where it was interrupted
    python -m benchmarks.mutants --only 137                  # one of them, with all that it prints

Mutant n of a seed is always the same. What is run is kept in out/mutants, with a folder for each fault in
out/mutants/faults; the table goes to results/mutants.json.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path

import click

from benchmarks.measure import Figure, save
from benchmarks.mutants.judge import GOOD, Result, run_numbers
from benchmarks.mutants.subjects import make_inputs

LEDGER = Path("out") / "mutants"
COUNT, SEED = 10_000, 0


def run(count: int = COUNT, seed: int = SEED) -> list[Figure]:
    """Run what is missing of a number of mutants, and count outcomes."""
    home = inputs()
    ledger = LEDGER / f"seed_{seed}.jsonl"
    done = {r.number: r for r in read(ledger)}
    missing = [n for n in range(count) if n not in done]
    with ledger.open("a") as stream:
        for k, result in enumerate(run_numbers(home, seed, missing, LEDGER / "faults")):
            done[result.number] = result
            stream.write(json.dumps(asdict(result)) + "\n")
            stream.flush()
            if k % 200 == 199:
                click.echo(f"  {k + 1} of {len(missing)}")
    results = [done[n] for n in range(count)]
    figures = list(_figures(results))
    tables = {
        "formats": by_format(results),
        "kinds": by_kind(results),
        "accepted_scaled": accepted_scaled(results),
        "faults": [asdict(r) for r in results if r.outcome not in GOOD],
    }
    save("mutants", figures, {"seed": seed, "count": count, **tables})
    return figures


def inputs() -> Path:
    """The whole files, made once."""
    home = LEDGER / "whole"
    if not (home / "complete").is_file():
        home.mkdir(parents=True)
        make_inputs(home.resolve())
        (home / "complete").touch()
    return home.resolve()


def read(ledger: Path) -> Iterator[Result]:
    """Results so far."""
    if ledger.is_file():
        for line in ledger.read_text().splitlines():
            yield Result(**json.loads(line))


def by_format(results: Sequence[Result]) -> dict[str, dict[str, int]]:
    """Format -> outcome -> number."""
    return {f: dict(Counter(r.outcome for r in results if r.format == f)) for f in sorted({r.format for r in results})}


def by_kind(results: Sequence[Result]) -> dict[str, dict[str, int]]:
    """Kind of damage -> outcome -> number."""
    return {k: dict(Counter(r.outcome for r in results if r.kind == k)) for k in sorted({r.kind for r in results})}


def accepted_scaled(results: Sequence[Result]) -> dict[str, dict[str, list[int]]]:
    """`format: quantity` -> factor of a unit slip -> [accepted, tried], where one was accepted."""
    tried = [r for r in results if r.quantity]
    table: dict[str, dict[str, list[int]]] = {}
    for r in tried:
        row = table.setdefault(f"{r.format}: {r.quantity}", {}).setdefault(f"{r.factor:g}", [0, 0])
        row[0] += r.outcome == "accepted"
        row[1] += 1
    return {k: v for k, v in sorted(table.items()) if any(a for a, _ in v.values())}


def _figures(results: Sequence[Result]) -> Iterator[Figure]:
    faults = [r for r in results if r.outcome not in GOOD]
    yield Figure("mutants", len(results), "")
    for outcome in GOOD:
        yield Figure(outcome, sum(r.outcome == outcome for r in results), "")
    kinds = Counter(r.outcome for r in faults)
    yield Figure("faults", len(faults), "", 0.0, note=", ".join(f"{n} {o}" for o, n in kinds.items()))
    slips = [r for r in results if r.quantity]
    share = sum(r.outcome == "accepted" for r in slips) / max(len(slips), 1)
    yield Figure("unit slips accepted", 100.0 * share, "%", note=f"of {len(slips)}")
    yield Figure("longest processor time of one", max(r.seconds for r in results), "s", 10.0)
