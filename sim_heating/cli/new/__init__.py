"""The commands `sim-heating new record`, `vehicle`, `scenario`, `effect` and `study`."""

from __future__ import annotations

import click

from sim_heating.cli.console import HelpfulGroup
from sim_heating.cli.new.effect import new_effect
from sim_heating.cli.new.flight import new_scenario, new_study
from sim_heating.cli.new.record import new_record
from sim_heating.cli.new.vehicle import new_vehicle


@click.group("new", cls=HelpfulGroup)
def new() -> None:
    """Make a record, vehicle, scenario, effect or study to go on from, out of a few numbers.

    Each is commented, validates at once, and runs in the command that it is for.
    """


for _command in (new_record, new_vehicle, new_scenario, new_study, new_effect):
    new.add_command(_command)
