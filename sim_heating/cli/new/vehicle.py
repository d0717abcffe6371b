"""The command `sim-heating new vehicle`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from sim_heating.cli.console import OUT, NumberRange
from sim_heating.cli.named_values import named_texts
from sim_heating.cli.new.options import quantity_option, title_option
from sim_heating.cli.new.printing import print_made, print_notes


@click.command("vehicle")
@OUT
@quantity_option(
    "--length", "m", "reference_length_m", "4m", "L", "reference length, such as 4m or 13ft", required=True
)
@quantity_option("--mass", "kg", "mass_kg", "3000kg", "M", "mass at entry, such as 3000kg", required=True)
@quantity_option("--area", "m2", "reference_area_m2", "12m2", "A", "reference area of CD, such as 12m2", required=True)
@quantity_option("--nose-radius", "m", "nose_radius_m", "0.5m", "R", "radius of the reference sphere", required=True)
@click.option(
    "--point",
    "points",
    multiple=True,
    required=True,
    metavar='NAME="LAYER / LAYER"',
    help='a control point and its layers, outermost first, NOSE="LI-900 50 mm / al2024 2 mm"; repeat',
)
@click.option(
    "--place",
    "positions",
    multiple=True,
    callback=named_texts("NOSE=0.3"),
    metavar="NAME=X",
    help="its distance from the nose over the length; 0 for the first point",
)
@click.option(
    "--ratio",
    "ratios",
    multiple=True,
    callback=named_texts("NOSE=0.3"),
    metavar="NAME=R",
    help="its heating ratio over the reference sphere; default 1 at the nose, 0.3 elsewhere",
)
@click.option(
    "--surfaces/--no-surfaces",
    default=False,
    show_default=True,
    help="an elevon and a body flap, in tables and records",
)
@click.option(
    "--alpha",
    "alpha_deg",
    type=NumberRange(-60.0, 60.0),
    default=20.0,
    show_default=True,
    help="angle of attack of the entry in deg, negative for a capsule that trims there",
)
@click.option(
    "--drag-coefficient",
    type=NumberRange(0.01, 5.0),
    default=1.3,
    show_default=True,
    help="CD over the reference area",
)
@click.option(
    "--lift-to-drag",
    type=NumberRange(0.0, 5.0),
    default=0.3,
    show_default=True,
    help="L/D at that angle of attack",
)
@title_option("vehicle")
def new_vehicle(
    out: Path, points: tuple[str, ...], positions: dict[str, str], ratios: dict[str, str], **options: Any
) -> None:
    """Make a vehicle that flies: a directory of materials, control points, ratio tables, aerodynamics and guidance.

    The name of the vehicle is that of the directory. What is not given is estimated, with confidence C. A capsule:

    \b
      sim-heating new vehicle --length 2m --mass 800kg --area 3m2 --nose-radius 1.2m \\
          --point 'NOSE=RCG 0.4 mm / LI-900 60 mm / al2024 3 mm' \\
          --point 'SIDE=inconel625 2 mm' --place SIDE=0.5 --ratio SIDE=0.2 --out pod
    """
    from sim_heating.templates.vehicle import VehicleInput, describe_vehicle, point_inputs, write_new_vehicle

    lengths = {key: options.pop(key) for key in ("length", "mass", "area", "nose_radius")}
    vehicle, notes = write_new_vehicle(
        out,
        VehicleInput(
            point_inputs(points, positions, ratios),
            length_m=lengths["length"],
            mass_kg=lengths["mass"],
            area_m2=lengths["area"],
            nose_radius_m=lengths["nose_radius"],
            **options,
        ),
    )
    print_notes(notes)
    print_made(
        describe_vehicle(vehicle), out, f"sim-heating new scenario --vehicle {out} --out {out}_flight", notes=notes
    )
