"""The commands `sim-heating new scenario` and `new study`: what is flown, and what is planned with it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from sim_heating.base.errors import InputError
from sim_heating.cli.console import COMPILING, OUT, PATH, ROOT, NumberRange, progress_line
from sim_heating.cli.new.options import flight_options, points_option, quantity_option, title_option
from sim_heating.cli.new.printing import print_made, print_notes


@click.command("scenario")
@click.option("--vehicle", required=True, help="name or directory of the vehicle")
@OUT
@points_option("all")
@quantity_option("--altitude", "m", "altitude_m", "120km", "H", "altitude of the entry; default 120 km")
@quantity_option("--speed", "m/s", "velocity_m_s", "7450m/s", "V", "speed relative to the air; default 7450 m/s")
@click.option("--gamma", type=NumberRange(-89.0, 10.0), help="path angle in deg; default -1.2 for a glider, else -1.5")
@click.option(
    "--until-mach",
    type=NumberRange(0.2, 30.0),
    default=2.0,
    show_default=True,
    help="Mach number at which the flight ends",
)
@click.option(
    "--trajectory",
    type=PATH,
    metavar="FILE",
    help="a recorded trajectory in place of the built-in entry: CSV or JSON lines, names with units",
)
@flight_options
@click.option("--manoeuvre", is_flag=True, help="fly a pushover-pullup at 6096 m/s (20,000 ft/s)")
@ROOT
@title_option("scenario")
def new_scenario(vehicle: str, out: Path, points: tuple[str, ...], root: Path | None, **options: Any) -> None:
    """Make a scenario, DIR/scenario.toml: an entry of a vehicle for `run`, `synthesize` and `plan`.

    \b
      sim-heating new scenario --vehicle pod --out flight
      sim-heating run flight/scenario.toml --out flight/results
    """
    from sim_heating.templates.starters import write_new_scenario

    for option, name in (("--field", "fields"), ("--atmosphere", "atmosphere")):
        if options[name] and options["trajectory"] is None:
            raise InputError(f"{option}: is of a recorded trajectory; give --trajectory FILE, or leave it out")

    initial = {"altitude_m": options["altitude"], "velocity_m_s": options["speed"], "gamma_deg": options["gamma"]}
    with progress_line("new scenario") as progress:
        progress(0.1, COMPILING)
        path, notes = write_new_scenario(
            out,
            vehicle,
            title=options["title"],
            points=points,
            recorded=options["trajectory"],
            fields=options["fields"],
            atmosphere=options["atmosphere"],
            initial={name: value for name, value in initial.items() if value is not None},
            stop_mach=options["until_mach"],
            manoeuvre=options["manoeuvre"],
            root=root,
        )
    if notes:
        print_notes(notes)
    below = "" if root is None else f" --root {root}"
    print_made(
        f"scenario of {vehicle}",
        path,
        f"sim-heating run {path} --out {out}/run{below}",
        f"sim-heating synthesize {path} --out {out}/records{below}",
        notes=notes,
    )


@click.command("study")
@click.argument("kind", type=click.Choice(["dispersion", "envelope", "optimal"]))
@click.option("--scenario", type=PATH, required=True, help="the nominal flight; see `sim-heating new scenario`")
@OUT
@points_option("those of the scenario")
@click.option(
    "--flights", type=click.IntRange(16), default=128, show_default=True, help="flights of a dispersion, a power of two"
)
@ROOT
@title_option("study")
def new_study(
    kind: str, scenario: Path, out: Path, points: tuple[str, ...], flights: int, root: Path | None, title: str
) -> None:
    """Make a study of a scenario's flight, DIR/study.toml, for `sim-heating plan`.

    KIND is `dispersion` (peak temperatures of many dispersed entries), `envelope` (margins to the limits over a map of
    flights), or `optimal` (the largest cross-range within the limits).

    \b
      sim-heating new study dispersion --scenario flight/scenario.toml --out study
      sim-heating plan study/study.toml --out study/results
    """
    from sim_heating.cli.path_check import CheckedPath, check_path
    from sim_heating.templates.starters import write_new_study

    tables: dict[str, Any] = {}
    notes: tuple[str, ...] = ()
    if kind == "optimal":
        from sim_heating.inputs.scenario import load_scenario
        from sim_heating.planning.optimal.of_scenario import optimal_table

        base = load_scenario(scenario, root=root)
        with progress_line("new study") as progress:
            progress(0.1, COMPILING)
            table = optimal_table(base, points or base.names)
        tables, notes = {"optimal": table.values, "above": table.above}, table.notes
    checked = list[CheckedPath]()
    path = write_new_study(
        out, kind, scenario, title=title, points=points, flights=flights, root=root,
        check=lambda file: checked.append(check_path(file, root)), **tables,
    )  # fmt: skip
    if notes:
        print_notes(notes)
    below = "" if root is None else f" --root {root}"
    print_made(checked[0].summary, path, f"sim-heating plan {path} --out {out}/results{below}", notes=notes)
