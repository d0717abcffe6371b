"""The command `sim-heating figures`."""

from __future__ import annotations

from pathlib import Path

import click

from sim_heating.base.errors import InputError
from sim_heating.cli.console import CONSOLE, OUT, PATH, ROOT, print_outputs, progress_line
from sim_heating.cli.named_values import named_texts


def _numbers(_: click.Context, __: click.Parameter, value: str | None) -> list[int] | None:
    """Value of --only, `5,6,8` or `5-8,12`, as numbers of figures."""
    if value is None:
        return None
    numbers: list[int] = []
    for item in value.split(","):
        first, dash, last = item.strip().partition("-")
        try:
            begin = int(first)
            numbers += range(begin, int(last) + 1) if dash else [begin]
        except ValueError:
            raise InputError(f"--only: `{item.strip()}` is not the number of a figure; write --only 5-8,12") from None
    if not numbers:
        raise InputError(f"--only: `{value}` holds no figure; write --only 5-8,12")
    return numbers


@click.command()
@click.argument("flights", type=PATH, nargs=-1, required=True)
@OUT
@click.option("--only", callback=_numbers, metavar="5-8,12", help="numbers of figures; all 18 by default")
@click.option(
    "--reference",
    type=click.Choice(["both", "stagnation", "eckert-turbulent"]),
    default="both",
    help="reference heating of figure 9",
)
@click.option(
    "--point",
    "points",
    multiple=True,
    callback=named_texts("lower=V09T9527"),
    metavar="PART=NAME",
    help="control point in place of the paper's: lower, elevon, pod or tunnel; may be repeated",
)
@ROOT
def figures(
    flights: tuple[Path, ...],
    out: Path,
    only: list[int] | None,
    reference: str,
    points: dict[str, str],
    root: Path | None,
) -> None:
    """Draw the founding paper's figures over FLIGHTS: campaign files, scenarios, or directories of records."""
    from sim_heating.base.files import require_writable
    from sim_heating.campaign.figures.paper import COMMAND, draw_figures, write_figures

    require_writable(out, COMMAND, inputs=flights)
    with progress_line("figures") as progress:
        drawn = draw_figures(flights, only, points=points, reference=reference, root=root, progress=progress)
        names = write_figures(drawn, out) if drawn.drawn else []
    for figure in drawn.drawn:
        CONSOLE.print(f"Figure {figure.number}: {figure.title}")
        for line in figure.notes:
            CONSOLE.print(f"    {line}")
        for statement in figure.statements:
            CONSOLE.print(f"    {statement.verdict}: {statement.paper} ({statement.here})")
    for number, reason in drawn.left_out.items():
        CONSOLE.print(f"Figure {number} is left out: {reason}")
    if drawn.statements:
        CONSOLE.print(drawn.count)
    if not drawn.drawn:
        reasons = (f"figure {number}: {reason}" for number, reason in drawn.left_out.items())
        raise InputError("figures: these flights give none of them, and nothing was written", *reasons)
    print_outputs(out, names, "figures.json")
