"""The command `sim-heating design`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
from rich.table import Table

from sim_heating.console import CONSOLE, OUT, PATH, listed, progress_line, tell_files
from sim_heating.files import require_place


@click.command()
@click.argument("scenario", type=PATH)
@OUT
@click.option("--parameters", callback=listed, help="dotted names whose bounds are to be small, with commas")
@click.option("--criterion", type=click.Choice(["D", "A"]), help="volume of the bounds, or their mean square")
@click.option("--evaluations", type=click.IntRange(1), help="designs that are tried")
@click.option("--repetitions", type=click.IntRange(0), default=0, help="hold the bounds against so many actual fits")
def design(
    scenario: Path,
    out: Path,
    parameters: tuple[str, ...] | None,
    criterion: str | None,
    evaluations: int | None,
    repetitions: int,
) -> None:
    """Design a scenario's manoeuvres: the bounds they would give, the most informative ones, other instruments."""
    from sim_heating.estimation.design_report import FILES, notes, summary, write_design
    from sim_heating.estimation.design_report import design as design_manoeuvres
    from sim_heating.scenario import load_scenario, with_design

    given = {"parameters": parameters and list(parameters), "criterion": criterion, "evaluations": evaluations}
    loaded = with_design(load_scenario(scenario), {k: v for k, v in given.items() if v is not None})
    require_place(out, FILES)
    with progress_line("design") as progress:
        designed = design_manoeuvres(loaded, repetitions=repetitions, progress=progress)
        progress(0.99, "writing")
        names = write_design(designed, out)
    found = summary(designed)
    table = Table(title=f"{loaded.title}: {found['control_point']}, one standard deviation", title_justify="left")
    flights = designed.planner.design.flights
    for head in ("parameter", "unit", "as planned", "optimal", *(f"{n} flights" for n in flights if n > 1)):
        table.add_column(head, justify="left" if head in ("parameter", "unit") else "right")
    for name, p in found["parameters"].items():
        after = [p["after_flights"][str(n)] for n in flights if n > 1]
        cells = [f"{x:.3g}" for x in (p["planned_sigma"], p["optimal_sigma"], *after)]
        table.add_row(name, p["unit"], *cells)
    CONSOLE.print(table)
    CONSOLE.print(f"{found['tried']} designs tried, {found['kept_limits']} keep the limits")
    for varied in found["varied"]:
        planned, best = (found[k]["manoeuvres"][varied["manoeuvre"] - 1][varied["key"]] for k in ("planned", "optimal"))
        CONSOLE.print(f"{varied['key']}: {planned:.4g} planned, {best:.4g} optimal")
    _tell_checks(found)
    for line in notes(designed):
        CONSOLE.print(line)
    tell_files(out, names)


def _tell_checks(found: dict[str, Any]) -> None:
    """Bounds of a design by the scenario's own source, and against actual fits."""
    for name in found["parameters"]:
        if found["checked"] is not None:
            planned, best = (found["checked"][k]["sigma"][name] for k in ("planned", "optimal"))
            CONSOLE.print(f"{name}: {planned:.3g} and {best:.3g} flown in {found['checked']['source']}")
        if found["fitted"] is not None:
            fitted = found["fitted"]
            CONSOLE.print(
                f"{name}: {fitted['fits']} fits err by {fitted['rms_error'][name]:.3g}, "
                f"{fitted['predicted'][name]:.3g} predicted for them (surface pressure known)",
                highlight=False,
            )
