"""What all commands share: options, the progress line, and printing of tables and file names."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table as RichTable
from rich.text import Text

from sim_heating.base.errors import InputError, one_line, printable

if TYPE_CHECKING:
    from sim_heating.base.report.table import Table

PLAIN_WIDTH = 110
"""Width in characters where the output is not a terminal."""


class PlainConsole(Console):
    """A console on which a text is what it says: markup has no effect, and control characters are shown as escapes."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(markup=False, highlight=False, emoji=False, **settings)

    def print(self, *objects: Any, **settings: Any) -> None:
        super().print(*(printable(o) if isinstance(o, str) else o for o in objects), **settings)


CONSOLE = PlainConsole(width=None if sys.stdout.isatty() else PLAIN_WIDTH)
ERRORS = PlainConsole(stderr=True, soft_wrap=True)


def show_warning(message: Warning | str, *_: Any) -> None:
    """Print a warning on one line, without the place in the program that Python adds."""
    ERRORS.print(f"warning: {one_line(str(message))}")


def results_directory(_: click.Context, __: click.Parameter, value: str) -> Path:
    """Value of an option --out; a directory that cannot be made or written is refused before any work."""
    from sim_heating.base.files import display_path, require_exclusive
    from sim_heating.base.files.text import abbreviated, os_error_reason

    if not value.strip():
        raise InputError("--out: is empty; name a directory for the results")
    path = Path(value)
    try:
        existing = next(p for p in (path.absolute(), *path.absolute().parents) if p.exists())
    except OSError as error:
        raise InputError(
            f"--out {abbreviated(value)}: {os_error_reason(error)}; name another directory for the results"
        ) from None
    if not existing.is_dir():
        raise InputError(f"--out {value}: {display_path(existing)} is a file; name a directory for the results")
    require_exclusive(path)
    return path


def optional_directory(context: click.Context, parameter: click.Parameter, value: str | None) -> Path | None:
    """Value of an option for a directory of results that may be omitted; None where it is."""
    return None if value is None else results_directory(context, parameter, value)


def comma_list(_: click.Context, parameter: click.Parameter, value: str | None) -> tuple[str, ...] | None:
    """Value of an option `a,b,c` as names; each may be given once."""
    if value is None:
        return None
    option, names = parameter.opts[0], tuple(name.strip() for name in value.split(",") if name.strip())
    if not names:
        raise InputError(f"{option}: holds no name; give one or more, separated by commas")
    from sim_heating.base.files import repeated_name

    if (name := repeated_name(names)) is not None:
        raise InputError(f"{option}: `{name}` is repeated; name it once")
    return names


OUT = click.option("--out", required=True, callback=results_directory, help="directory for the results")
PATH = click.Path(path_type=Path)
ROOT = click.option(
    "--root",
    type=PATH,
    metavar="DIR",
    help="folder that files may name others in; default: the nearest above them with `scenarios`, or the current one",
)


@contextmanager
def progress_line(title: str) -> Iterator[Callable[[float, str], None]]:
    """A progress line on the terminal; where the output is not a terminal, one line of text for each stage."""
    title = one_line(title)
    texts = (TextColumn(field, markup=False) for field in ("{task.description}", "{task.fields[text]}"))
    columns = (next(texts), BarColumn(), next(texts), TimeElapsedColumn())
    with Progress(*columns, console=ERRORS, transient=True, disable=not ERRORS.is_terminal) as bar:
        task = bar.add_task(title, total=1.0, text="starting")
        last = [""]

        def report_progress(fraction: float, text: str) -> None:
            bar.update(task, completed=fraction, text=one_line(text))
            stage = text.split(":")[0]
            if not ERRORS.is_terminal and stage != last[0]:
                last[0] = stage
                ERRORS.print(f"{title}: {stage} ...")

        yield report_progress


def print_outputs(out: Path, names: list[str]) -> None:
    """Print the names of the files written into a directory, without hidden ones."""
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
    rendered, texts = RichTable(title=Text(printable(table.title)), title_justify="left"), table.texts
    natural = [max(map(len, cells)) for cells in zip([c.head for c in table.layout], *texts, strict=True)]
    wrap_heads = sum(natural) + 3 * len(natural) + 1 > CONSOLE.width  # before cells: a number stays on one line
    for i, column in enumerate(table.layout):
        longest = max(map(len, (*column.head.split(), *(row[i] for row in texts))))
        rendered.add_column(
            column.head,
            justify="left" if column.is_text else "right",
            overflow="fold",
            no_wrap=i == 0,
            max_width=longest if wrap_heads and not column.is_text else None,
        )
    for i, row in enumerate(texts):
        rendered.add_row(
            *(Text(printable(cell), style="" if style is None else style(i, k)) for k, cell in enumerate(row))
        )
    CONSOLE.print(rendered)
