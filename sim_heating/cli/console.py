"""What all commands share: where results go, progress, words on the terminal."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table as RichTable
from rich.text import Text

from sim_heating.base.errors import InputError

if TYPE_CHECKING:
    from sim_heating.base.report.table import Table

PLAIN_WIDTH = 110
"""Columns of a table where the output is no terminal."""
CONSOLE = Console(width=None if sys.stdout.isatty() else PLAIN_WIDTH, markup=False, highlight=False)
ERRORS = Console(stderr=True, soft_wrap=True, markup=False, highlight=False)


def results_directory(_: click.Context, __: click.Parameter, value: str) -> Path:
    """The directory of results, refused before any work where it cannot be one."""
    from sim_heating.base.files import display_path, require_writable
    from sim_heating.base.files.text import abbreviated, os_error_reason

    if not value.strip():
        raise InputError("--out: is empty; name a directory for the results")
    path = Path(value)
    try:
        there = next(p for p in (path.absolute(), *path.absolute().parents) if p.exists())
    except OSError as error:
        raise InputError(
            f"--out {abbreviated(value)}: {os_error_reason(error)}; name another directory for the results"
        ) from None
    if not there.is_dir():
        raise InputError(f"--out {value}: {display_path(there)} is a file; name a directory for the results")
    require_writable(path)
    return path


def optional_directory(context: click.Context, parameter: click.Parameter, value: str | None) -> Path | None:
    """The same for a directory that may be left out."""
    return None if value is None else results_directory(context, parameter, value)


def comma_list(_: click.Context, parameter: click.Parameter, value: str | None) -> tuple[str, ...] | None:
    """`a,b,c` as names, each once."""
    if value is None:
        return None
    option, names = parameter.opts[0], tuple(name.strip() for name in value.split(",") if name.strip())
    if not names:
        raise InputError(f"{option}: names nothing; give one name or more, a comma between")
    from sim_heating.base.files import repeated_name

    if (name := repeated_name(names)) is not None:
        raise InputError(f"{option}: `{name}` is repeated; name it once")
    return names


OUT = click.option("--out", required=True, callback=results_directory, help="directory for the results")
PATH = click.Path(path_type=Path)


@contextmanager
def progress_line(title: str) -> Iterator[Callable[[float, str], None]]:
    """A progress line on the terminal; its text lines alone where the output is no terminal."""
    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[text]}"), TimeElapsedColumn())
    with Progress(*columns, console=ERRORS, transient=True, disable=not ERRORS.is_terminal) as bar:
        task = bar.add_task(title, total=1.0, text="starting")
        last = [""]

        def tell(fraction: float, text: str) -> None:
            bar.update(task, completed=fraction, text=text)
            stage = text.split(":")[0]
            if not ERRORS.is_terminal and stage != last[0]:
                last[0] = stage
                ERRORS.print(f"{title}: {stage} ...")

        yield tell


def print_outputs(out: Path, names: list[str]) -> None:
    """The files that were written into a directory, but for the list of them that stands there hidden."""
    names = [n for n in names if not Path(n).name.startswith(".")]
    pictures = [n for n in names if n.endswith(".png")]
    files = [n for n in names if not n.endswith(".png")]
    shown = files if len(files) <= 6 else [*files[:6], f"... {len(files)} files in all"]
    CONSOLE.print(f"Wrote {out}: {', '.join(shown)}")
    if pictures:
        CONSOLE.print(f"Plots: {', '.join(pictures)}")


def print_table(table: Table, style: Callable[[int, int], str] | None = None) -> None:
    """Print a table of results.

    style : (row, column) -> style of the cell, as `red`; plain where not given
    """
    rendered = RichTable(title=table.title, title_justify="left")
    for i, column in enumerate(table.layout):
        rendered.add_column(column.head, justify="left" if column.is_text else "right", overflow="fold", no_wrap=i == 0)
    for i, row in enumerate(table.texts):
        rendered.add_row(*(Text(cell, style="" if style is None else style(i, k)) for k, cell in enumerate(row)))
    CONSOLE.print(rendered)
