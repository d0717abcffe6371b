"""The command `validate`."""

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
        found = check_path(path)
        CONSOLE.print(f"{path}: good. {found.summary}", soft_wrap=True)
