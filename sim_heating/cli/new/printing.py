"""What the commands below `sim-heating new` print: what was assumed, what was made, and the commands that come next."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from sim_heating.cli.console import CONSOLE
from sim_heating.cli.output import report_files, report_results


def print_notes(notes: Sequence[str]) -> None:
    """Print what was assumed and used."""
    CONSOLE.print("Assumed and used:")
    for note in notes:
        CONSOLE.print(f"  {note}", soft_wrap=True)


def print_made(
    description: str, path: Path, *commands: str, files: Sequence[Path] | None = None, notes: Sequence[str] = ()
) -> None:
    """Print a description of the product, and the commands that come next; state them for --json.

    files : that were made; all that the command wrote into a directory where None
    """
    from sim_heating.base.files import files_written

    if files is None:
        files = [path] if path.is_file() else sorted(path / name for name in files_written(path))
    report_files(None, files)
    report_results({"made": description, "assumed": list(notes), "next": list(commands)})
    CONSOLE.print(f"Wrote {path}: {description}", soft_wrap=True)
    CONSOLE.print("Next:")
    for command in commands:
        CONSOLE.print(f"  {command}", soft_wrap=True)
