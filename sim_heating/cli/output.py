"""What a command reports: text for people, or with --json one object for programs on standard output.

    {
      "format": "command/1",
      "command": "estimate",
      "status": 0,                              the exit status
      "directory": "out/fit",                   of the results; null where there is none
      "files": ["out/fit/estimate.json"],       written, as a program can open them
      "warnings": [],
      "results": {},                            contents of the JSON file that the command wrote, or a summary
      "error": null                             or {"kind", "message", "problems"} where the status is not 0
    }

A number that is not finite is null. Progress, warnings and errors go to standard error, with and without --json.
"""

from __future__ import annotations

import json
import logging
import math
import os
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import click

FORMAT = "command/1"
JSON_OPTION, QUIET_OPTION = "--json", "--quiet"


OUT_OPTION = "--out"
CHANGES_NO_RESULT = (JSON_OPTION, QUIET_OPTION, "--force", "--verbose", "-v", "-vv")
"""Options that leave the results as they are."""


def repeatable(arguments: Sequence[str]) -> tuple[list[str], str | None]:
    """A command as its results state it, without options that change no result, and the folder of its results.

    >>> from sim_heating.cli.output import repeatable
    >>> repeatable(["run", "popu_mach20", "--out", "out/popu", "--json"])
    (['run', 'popu_mach20'], 'out/popu')
    """
    kept, out, options = [], None, iter(arguments)
    for option in options:
        name, equals, value = option.partition("=")
        if name == OUT_OPTION:
            out = value if equals else next(options, None)
        elif option not in CHANGES_NO_RESULT:
            kept.append(option)
    return kept, out


class CommandReport:
    """What the command that runs has reported so far.

    is_json  : an object on standard output takes the place of text
    is_quiet : only warnings and errors are printed
    """

    def __init__(self, arguments: Sequence[str] = ()) -> None:
        options = arguments[: arguments.index("--")] if "--" in arguments else arguments
        self.is_json, self.is_quiet = JSON_OPTION in options, QUIET_OPTION in options
        self.command = ""
        self.directory: Path | None = None
        self.files: list[str] = []
        self.warnings: list[str] = []
        self.results: Any = {}
        self.error: dict[str, Any] | None = None

    def contents(self, status: int) -> dict[str, Any]:
        """The object that --json prints."""
        return {
            "format": FORMAT,
            "command": self.command,
            "status": status,
            "directory": self.directory,
            "files": sorted(set(self.files)),
            "warnings": self.warnings,
            "results": self.results,
            "error": self.error,
        }

    @contextmanager
    def standard_output_reserved(self) -> Iterator[None]:
        """With --json: what this process, or one that it starts, prints within the block goes to standard error."""
        if not self.is_json:
            yield
            return
        stdout, saved = sys.stdout, None
        stdout.flush()
        with suppress(OSError):
            saved = os.dup(1)
            os.dup2(2, 1)
        sys.stdout = sys.stderr
        try:
            yield
        finally:
            sys.stdout = stdout
            if saved is not None:
                os.dup2(saved, 1)
                os.close(saved)

    def print_json(self, status: int) -> None:
        """With --json: print the object, in ASCII, which every encoding of an output can represent."""
        if self.is_json:
            sys.stdout.write(json.dumps(_plain(self.contents(status)), indent=2, allow_nan=False) + "\n")
            sys.stdout.flush()


_current = CommandReport()


def current_report() -> CommandReport:
    """The report of the command that runs."""
    return _current


@contextmanager
def reporting(arguments: Sequence[str]) -> Iterator[CommandReport]:
    """The report of a command that runs within the block."""
    global _current
    before, _current = _current, CommandReport(arguments)
    try:
        yield _current
    finally:
        _current = before


def report_files(directory: Path | None, names: Iterable[str | Path]) -> None:
    """Add files that the command wrote.

    directory : of the results, which the names are relative to; None for names that stand alone
    """
    if directory is not None:
        _current.directory = directory
    _current.files += [str(name if directory is None else directory / name) for name in names]


def report_results(results: Mapping[str, Any] | Path) -> None:
    """State the results of the command: an object, or the JSON file that holds them, which --json alone reads."""
    if isinstance(results, Path):
        if not _current.is_json:
            return
        from sim_heating.base.files import read_json

        results = read_json(results)
    _current.results = results


def _plain(value: Any) -> Any:
    """A value as JSON has it; a number that is not finite is None."""
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple, set, frozenset)):
        return [_plain(v) for v in value]
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, (bool, int, str, type(None))):
        return value
    if hasattr(value, "tolist"):  # numpy, which is slow to import
        return _plain(value.tolist())
    if hasattr(value, "model_dump"):
        return _plain(value.model_dump(mode="json"))
    return str(value)


def _enter_name(context: click.Context, _: click.Parameter, __: bool) -> None:
    """Enter the name of the command whose options are read in the report."""
    name_command(context)


def name_command(context: click.Context | None) -> None:
    """Enter the name of a command in the report."""
    if context is not None:
        _current.command = context.command_path.partition(" ")[2]


LEVELS = (logging.WARNING, logging.INFO, logging.DEBUG)
"""Levels of the logger `sim_heating` by the number of -v."""


def _log_to_standard_error(context: click.Context, _: click.Parameter, count: int) -> None:
    """With -v, print what the program logs to standard error until the command ends; with -vv, its details too."""
    if not count:
        return
    logger, handler = logging.getLogger("sim_heating"), logging.StreamHandler()
    handler.setFormatter(logging.Formatter("%(relativeCreated)7.0f ms %(levelname)s %(name)s: %(message)s"))
    level = logger.level
    logger.addHandler(handler)
    logger.setLevel(LEVELS[min(count, len(LEVELS) - 1)])

    def restore() -> None:
        logger.removeHandler(handler)
        logger.setLevel(level)

    context.call_on_close(restore)


COMMON_OPTIONS = (
    click.Option(
        [JSON_OPTION],
        is_flag=True,
        is_eager=True,
        expose_value=False,
        callback=_enter_name,
        help="print one JSON object with status, files and results in place of text",
    ),
    click.Option([QUIET_OPTION], is_flag=True, expose_value=False, help="print only warnings and errors"),
    click.Option(
        ["-v", "--verbose"],
        count=True,
        expose_value=False,
        callback=_log_to_standard_error,
        help="log what is fitted and written to standard error; -vv: in detail",
    ),
)
"""Options that the group and all its commands take. They are found in the arguments, as wrong usage is reported too."""


def with_common_options(command: click.Command) -> click.Command:
    """A command, and those below it, with the options that all commands have."""
    if COMMON_OPTIONS[0] not in command.params:
        command.params += COMMON_OPTIONS
    for below in command.commands.values() if isinstance(command, click.Group) else ():
        if below is not None:
            with_common_options(below)
    return command
