"""What all commands share: options, the progress line, and printing of tables and file names."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table as RichTable
from rich.text import Text

from sim_heating.base.errors import InputError, UnusualWarning, one_line, printable
from sim_heating.base.progress import no_progress
from sim_heating.cli.output import current_report, report_files, report_results

if TYPE_CHECKING:
    from sim_heating.base.report.table import Table

PLAIN_WIDTH = 110
"""Width in characters where the output is not a terminal."""


WHOLE = 1000
"""Characters of a line on a command in a help text, none of which is as long."""


class HelpfulGroup(click.Group):
    """A group whose help has the whole first sentence of each command: click cuts it off at the terminal's width."""

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        commands = [(name, self.get_command(ctx, name)) for name in self.list_commands(ctx)]
        with formatter.section("Commands"):
            formatter.write_dl([(name, c.get_short_help_str(limit=WHOLE)) for name, c in commands if c is not None])


class PlainConsole(Console):
    """A console on which a text is what it says: markup has no effect, and control characters are shown as escapes."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(markup=False, highlight=False, emoji=False, **settings)

    def print(self, *objects: Any, **settings: Any) -> None:
        super().print(*(printable(o) if isinstance(o, str) else o for o in objects), **settings)


CONSOLE = PlainConsole(width=None if sys.stdout.isatty() else PLAIN_WIDTH)
ERRORS = PlainConsole(stderr=True, soft_wrap=True)


@contextmanager
def silent_console(is_silent: bool) -> Iterator[None]:
    """Print no results within the block; errors, warnings and, without --quiet, progress are printed."""
    before, CONSOLE.quiet = CONSOLE.quiet, is_silent
    try:
        yield
    finally:
        CONSOLE.quiet = before


def show_warning(message: Warning | str, *_: Any) -> None:
    """Print a warning on one line, once, without the place in the program that Python adds."""
    line = one_line(str(message))
    if isinstance(message, UnusualWarning) and line in current_report().warnings:
        return  # of a file that is read twice
    current_report().warnings.append(line)
    ERRORS.print(f"warning: {line}")


def print_warning(line: str) -> None:
    """Print a warning about the results: among them in red, on standard error where they are not printed."""
    current_report().warnings.append(line)
    if CONSOLE.quiet:
        ERRORS.print(f"warning: {one_line(line)}")
    else:
        CONSOLE.print(line, style="red")


def results_directory(_: click.Context, __: click.Parameter, value: str) -> Path:
    """Value of an option --out; a directory that cannot be made or written is refused before any work."""
    from sim_heating.base.files import display_path, require_exclusive
    from sim_heating.base.files.paths import portable_problem
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
    if (problem := portable_problem(path.name)) is not None:
        raise InputError(f"--out {abbreviated(value)}: its last part {problem}")
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


def _replace_others(context: click.Context, _: click.Parameter, value: bool) -> None:
    """Value of --force, which holds until the command ends."""
    if value:
        from sim_heating.base.files import replacing_others

        context.with_resource(replacing_others())


FORCE = click.option(
    "--force",
    is_flag=True,
    is_eager=True,  # before the directory of the results is checked
    expose_value=False,
    callback=_replace_others,
    help="replace files of the names of the results, whoever wrote or changed them; other files stay",
)
_OUT = click.option("--out", required=True, callback=results_directory, help="directory for the results")


def OUT(command: Callable[..., Any]) -> Callable[..., Any]:
    """A command with the options --out and --force."""
    return _OUT(FORCE(command))


PATH = click.Path(path_type=Path)


class NumberRange(click.FloatRange):
    """A number within a range. NaN lies within none, which `click.FloatRange` lets pass."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The number that an argument stands for."""
        number = super().convert(value, param, ctx)
        if math.isnan(number):
            self.fail(f"{value} is not a number", param, ctx)
        return number


ROOT = click.option(
    "--root",
    type=PATH,
    metavar="DIR",
    help="folder that files may name others in; default: the nearest above them with `scenarios`, or the current one",
)


COMPILING = "compiling, unless compiled before"
"""Line of progress before work whose first step compiles kernels for longer than it takes."""
TEXT_INTERVAL_S = 15.0
"""Least time [s] between two lines of progress on one stage, where the output is not a terminal."""
ESTIMATE_AFTER_S = 2.0
"""Time [s] after which a remaining time is estimated."""
ESTIMATE_FROM = 0.03
"""Fraction done from which a remaining time is estimated: before, compilation would count many times."""


@contextmanager
def progress_line(title: str) -> Iterator[Callable[[float, str], None]]:
    """Progress on standard error: a line that is renewed on a terminal, elsewhere a line of text for each stage.

    Both state the fraction done and, from the time it took, the time that remains. A long stage has further lines of
    text.
    """
    title = one_line(title)
    if current_report().is_quiet:
        yield no_progress
        return
    if not ERRORS.is_terminal:
        yield _progress_text(title)
        return
    texts = (TextColumn(field, markup=False) for field in ("{task.description}", "{task.fields[text]}"))
    columns = (next(texts), BarColumn(), TaskProgressColumn(), next(texts), TimeElapsedColumn(), TimeRemainingColumn())
    with Progress(*columns, console=ERRORS, transient=True) as bar:
        task = bar.add_task(title, total=1.0, text="starting")
        yield lambda fraction, text: bar.update(task, completed=fraction, text=one_line(text))


def _progress_text(title: str) -> Callable[[float, str], None]:
    """Progress as lines of text, such as `popu: flying (40 %, about 12 s remain) ...`."""
    begun_s = time.monotonic()
    last_stage, last_s = "", -math.inf

    def report_progress(fraction: float, text: str) -> None:
        nonlocal last_stage, last_s
        stage, now_s = text.split(":")[0], time.monotonic()
        if stage == last_stage and now_s - last_s < TEXT_INTERVAL_S:
            return
        line = title + ": " + one_line(stage if stage != last_stage else text)
        if 0.0 < fraction < 1.0:
            elapsed_s = now_s - begun_s
            remaining = f", about {_duration(elapsed_s * (1.0 - fraction) / fraction)} remain"
            is_known = elapsed_s > ESTIMATE_AFTER_S and fraction >= ESTIMATE_FROM
            line += f" ({100.0 * fraction:.0f} %{remaining if is_known else ''})"
        last_stage, last_s = stage, now_s
        ERRORS.print(f"{line} ...")

    return report_progress


def _duration(seconds: float) -> str:
    """A time as a person says it: seconds to two minutes, then minutes, then hours."""
    if seconds < 120.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 7200.0 else f"{seconds / 3600.0:.1f} h"


def print_outputs(out: Path, names: Iterable[str], results: str | Mapping[str, Any]) -> None:
    """Print the names of the files written into a directory, without hidden ones.

    results : the JSON file among them that holds the results, or results, for --json
    """
    names = [n for name in names for n in _files_below(out, name)]
    report_files(out, names)
    contents = out / results if isinstance(results, str) else results
    report_results(contents)
    pictures = [n for n in names if n.endswith(".png")]
    files = sorted((n for n in names if n not in pictures), key=lambda n: (n != "report.html", "/" in n))
    shown = files if len(files) <= 6 else [*files[:6], f"... {len(names)} files in all, {len(pictures)} of them plots"]
    CONSOLE.print(f"Wrote {out}: {', '.join(shown)}")
    if pictures:
        CONSOLE.print(f"Plots: {', '.join(pictures)}")
    _print_credibility(contents)


def _files_below(out: Path, name: str) -> list[str]:
    """Names of the files that a name among results stands for: its own, or those of a folder; without hidden ones."""
    path = out / name
    files = sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]
    return [p.relative_to(out).as_posix() for p in files if not p.name.startswith(".")]


def _print_credibility(results: Path | Mapping[str, Any]) -> None:
    """Print the credibility of results in one line, and what could not be read for it."""
    if isinstance(results, Path):
        from sim_heating.base.files import read_json

        results = read_json(results)
    block = results.get("credibility")
    if block is not None:
        CONSOLE.print(block["summary"])
        for line in block["problems"]:
            print_warning(line)


def print_table(table: Table, style: Callable[[int, int], str] = lambda _row, _column: "") -> None:
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
        rendered.add_row(*(Text(printable(cell), style=style(i, k)) for k, cell in enumerate(row)))
    CONSOLE.print(rendered)
