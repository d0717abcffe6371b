"""The command `sim-heating validate`."""

from __future__ import annotations

from pathlib import Path

import click

from sim_heating.base.errors import InputError
from sim_heating.cli.console import CONSOLE, PATH, ROOT


@click.command()
@click.argument("paths", type=PATH, nargs=-1, required=True)
@ROOT
def validate(paths: tuple[Path, ...], root: Path | None) -> None:
    """Check records, scenarios, campaigns, studies, tables or vehicles, and report what is wrong."""
    from sim_heating.cli.path_check import check_path

    problems: list[str] = []
    for path in paths:
        try:
            CONSOLE.print(f"{path}: good. {check_path(path, root).summary}", soft_wrap=True)
        except InputError as error:
            problems.extend(error.problems)
    if problems:
        raise InputError(*problems)
