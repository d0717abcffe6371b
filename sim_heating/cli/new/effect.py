"""The command `sim-heating new effect`."""

from __future__ import annotations

from pathlib import Path

import click

from sim_heating.cli.console import OUT, ROOT
from sim_heating.cli.new.printing import print_made


@click.command("effect")
@click.argument("name")
@OUT
@click.option(
    "--mode",
    type=click.Choice(["multiply", "add", "emittance"]),
    default="multiply",
    show_default=True,
    help="a factor on the heating ratio, a term of it, or a factor on the emittance",
)
@click.option(
    "--variable",
    default="mach",
    show_default=True,
    help="what it depends on: mach, alpha_deg, beta_deg, log10_re, elevon_deg, bodyflap_deg, time_s, wall_K",
)
@click.option("--vehicle", default="orbiter", show_default=True, help="vehicle of the practice flight")
@click.option("--point", default="WING_LE", show_default=True, help="control point of the practice flight")
@ROOT
def new_effect(name: str, out: Path, mode: str, variable: str, vehicle: str, point: str, root: Path | None) -> None:
    """Make an effect of your own: DIR/NAME.py, a check of it, and a practice flight whose truth has it.

    The folder is then named in SIM_HEATING_EFFECTS; close-loop looks for the effect in any record.

    \b
      sim-heating new effect shock-passage --variable mach --out effects
      export SIM_HEATING_EFFECTS=effects
      python -m pytest effects/checks
    """
    from sim_heating.templates.starters import write_new_effect

    files = write_new_effect(out, name, mode=mode, variable=variable, vehicle=vehicle, point=point, root=root)
    module = files[0].stem
    below = "" if root is None else f" --root {root}"
    print_made(
        f"effect {name}: {', '.join(str(f) for f in files)}",
        out,
        f"export SIM_HEATING_EFFECTS={out}",
        f"python -m pytest {out}/checks",
        f"sim-heating synthesize {out}/{module}.toml --out practice{below}",
        "sim-heating close-loop practice --out closed",
        files=files,
    )
