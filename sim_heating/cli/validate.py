"""The command `sim-heating validate`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from sim_heating.base.errors import InputError
from sim_heating.cli.console import CONSOLE, PATH, ROOT, print_warning
from sim_heating.cli.output import report_results


@click.command()
@click.argument("paths", type=PATH, nargs=-1, required=True)
@ROOT
def validate(paths: tuple[Path, ...], root: Path | None) -> None:
    """Check records, scenarios, campaigns, studies, tables or vehicles, and report what is wrong."""
    from sim_heating.cli.path_check import check_path, descriptions

    problems: list[str] = []
    checked: list[dict[str, Any]] = []
    for path in paths:
        try:
            result = check_path(path, root)
        except InputError as error:
            problems.extend(error.problems)
            checked.append({"path": path, "is_good": False, "problems": error.problems})
        else:
            CONSOLE.print(f"{path}: good. {result.summary}", soft_wrap=True)
            for line in result.notes:
                print_warning(line)
            good = {"path": path, "is_good": True, "kind": result.kind, "summary": result.summary}
            good |= {"descriptions": descriptions(path)} | ({"notes": list(result.notes)} if result.notes else {})
            checked.append(good)
    report_results({"paths": checked})
    if problems:
        raise InputError(*problems)
