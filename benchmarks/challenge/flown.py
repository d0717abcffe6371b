"""The project's own flights as records: every control point of a scenario with several seeds of the noise.

    python -m benchmarks.challenge.flown --seeds 20 --out out/flown

This module alone of the folder uses the package: flight, march and recorder are those of `sim-heating synthesize`, and
the truth is that of the scenario's [truth].
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from benchmarks.challenge.files import scenario_file, toml_text
from sim_heating.inputs.record import Record, write_record
from sim_heating.inputs.scenario import Scenario, load_scenario
from sim_heating.simulation.run import fly_scenario
from sim_heating.simulation.synthesize import synthesize

FLIGHTS = {"flown": ("sts2", "sts4"), "paper": ("sts2_paper",)}
"""Scenarios of a class of records: those shipped, and the pod as the founding paper reports of it."""
PARAMETERS = {
    "stack.coating.thickness_factor": "coating-thickness",
    "stack.insulation.conductivity_factor": "conductivity",
    "stack.insulation.heat_capacity_factor": "heat-capacity",
}
"""Parameters of a truth by the effect that reports them."""


def flown_records(of_class: str, flight: str, seeds: int) -> Iterator[tuple[str, Record, dict[str, Any]]]:
    """Name, record and truth of every control point of a scenario, with noise of seeds 1, 2 and so on.

    The flight is flown once.
    """
    scenario = load_scenario(scenario_file(flight))
    flown = fly_scenario(scenario)
    for seed in range(1, seeds + 1):
        measurements = scenario.declared.measurements.model_copy(update={"seed": seed})
        declared = scenario.declared.model_copy(update={"measurements": measurements})
        for point, record in synthesize(replace(scenario, declared=declared), flight=flown).items():
            yield f"{flight}-{point}-{seed:02d}", record, {"class": of_class} | truth(scenario, point)


def truth(scenario: Scenario, point: str) -> dict[str, Any]:
    """What is true of a control point and not declared: as in answers.toml of the generator."""
    declared = scenario.declared.truth
    parameters = {name: value for name, value in declared.parameters.items() if value != 1.0}
    acting = [e for e in declared.effect if e.control_points is None or point in e.control_points]
    effects = [PARAMETERS[name] for name in parameters] + [e.name for e in acting]
    return {
        "form": [*effects] or ["none"],
        "flight": scenario.path.stem,
        "wall": point,
        "effects": effects,
        "accepted": [[name] for name in effects],
        "separable": True,
        "parameters": [parameters] * bool(parameters) + [dict(e.parameters) for e in acting],
    }


@click.command(help="Write the project's own flights as records, and answers.toml next to them.")
@click.option("--seeds", type=click.IntRange(1), default=20, show_default=True, help="seeds of the noise, from 1 on")
@click.option("--of", "of_class", type=click.Choice([*FLIGHTS]), default="flown", show_default=True)
@click.option("--out", type=click.Path(file_okay=False, path_type=Path), required=True, help="a new directory")
def main(seeds: int, of_class: str, out: Path) -> None:
    """Fly, measure and write."""
    if out.exists() and any(out.iterdir()):
        raise click.BadParameter(f"`{out}` is not empty; give a new directory")
    write_all(of_class, seeds, out)


def write_all(of_class: str, seeds: int, out: Path) -> dict[str, dict[str, Any]]:
    """Write all records of a class, answers.toml last; the truth by record."""
    out.mkdir(parents=True, exist_ok=True)
    answers = {}
    for flight in FLIGHTS[of_class]:
        for name, record, answer in flown_records(of_class, flight, seeds):
            write_record(record, out / name)
            answers[name] = answer
    (out / "answers.toml").write_text(toml_text(answers))
    return answers


if __name__ == "__main__":
    main()
