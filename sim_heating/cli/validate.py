"""The command `sim-heating validate`."""

from __future__ import annotations

from pathlib import Path

import click

from sim_heating.cli.console import CONSOLE, PATH


@click.command()
@click.argument("paths", type=PATH, nargs=-1, required=True)
def validate(paths: tuple[Path, ...]) -> None:
    """Check records, scenarios, tables or vehicles, and report what is wrong."""
    from sim_heating.cli.path_check import check_path

    for path in paths:
        CONSOLE.print(f"{path}: good. {check_path(path).summary}", soft_wrap=True)
