"""The command `sim-heating`: a group whose commands are imported when they are called.

`sim-heating --help` and `--version` answer in a fraction of a second because a command's module imports numpy, numba
and the modules of the program within its functions only (tests/cli/test_startup.py).
"""

from __future__ import annotations

import errno
import os
import sys
import warnings
from importlib import import_module
from pathlib import Path
from typing import Any

import click
from click.shell_completion import CompletionItem

from sim_heating.base.errors import InputError, RunError, one_line
from sim_heating.base.progress import EndingSignals, stating_command
from sim_heating.cli.console import ERRORS, HelpfulGroup, show_warning, silent_console
from sim_heating.cli.output import CommandReport, name_command, repeatable, reporting, with_common_options

COMMANDS = {
    "run": "simulate",
    "synthesize": "simulate",
    "predict": "simulate",
    "demo": "simulate",
    "new": "new",
    "validate": "validate",
    "formats": "formats",
    "parameters": "parameters",
    "estimate": "estimate",
    "design": "estimate",
    "close-loop": "close_loop",
    "update-tables": "tables",
    "campaign": "campaign",
    "figures": "figures",
    "ratio-tables": "tables",
    "table": "tables",
    "measured-records": "tables",
    "plan": "plan",
    "live": "live",
    "credibility": "credibility",
    "fmu": "fmu",
    "completion": "completion",
    "examples": "examples",
    "reproduce": "reproduce",
}
"""Command -> module of this folder that defines it; the order is that of the help text."""


EXAMPLES = {
    "run": "run scenarios/popu_mach20.toml --out out/popu",
    "synthesize": "synthesize scenarios/popu_mach20.toml --out out/records",
    "predict": "predict scenarios/records/sts96_468 --out out/predicted",
    "demo": "demo --out out",
    "validate": "validate scenarios/popu_mach20.toml scenarios/records/practice/p06 orbiter",
    "estimate": "estimate out/records/V09T9527 --out out/fit",
    "design": "design scenarios/design_popu.toml --out out/design",
    "close-loop": "close-loop scenarios/records/practice/p08 --out out/closed",
    "update-tables": "update-tables out/fit --vehicle orbiter --out out/vehicles",
    "campaign": "campaign scenarios/campaigns/sts2_sts4.toml --out out/campaign",
    "figures": "figures scenarios/records/practice/p06 --only 5-8 --out out/figures",
    "ratio-tables": "ratio-tables capsule",
    "table": "table capsule/FACE --out out/face.dml",
    "measured-records": "measured-records scenarios/sts96.toml --out out/measured",
    "plan": "plan scenarios/studies/small_envelope.toml --out out/plan",
    "live": "live scenarios/live/popu_lines.toml --out out/live",
    "fmu": "fmu export orbiter --out out/orbiter.fmu",
    "new": "new record --csv temperatures.csv --layer 'LI-900 51 mm' --out out/record",
    "credibility": "credibility add scenarios/records/sts96_468",
    "completion": "completion bash",
    "examples": "examples --out .",
    "reproduce": "reproduce out/popu",
}
"""Command -> the example of its help; commands that state their own are absent."""


INPUT_FILES = ("record", "records", "scenario", "study", "campaign_file", "path", "paths", "flights")
"""Names of the arguments and options that take files of a user."""
COMPLETED = (*INPUT_FILES, "vehicle", "vehicles")
"""Names of the arguments and options that tab completion offers records, scenarios or vehicles for."""
TAKES_EXAMPLES = (*INPUT_FILES, "link", "replay", "trajectory")
"""Names of the arguments and options that a shipped example may be named by."""
WITHOUT_EXAMPLES = ("new", "update-tables", "examples", "reproduce")
"""Commands that take no example."""
CHANGED_BY = {"credibility": {"path"}}
"""Command -> names of arguments whose files it changes: no shipped example."""


class LazyGroup(HelpfulGroup):
    """A group that imports the module of a command when the command is called."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        self.commands = dict.fromkeys(COMMANDS)  # type: ignore[assignment]  # click suggests the nearest of these

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in COMMANDS:
            return None
        module = import_module(f"{__name__}.{COMMANDS[cmd_name]}")
        command = getattr(module, cmd_name.replace("-", "_"))
        assert isinstance(command, click.Command)
        if command.epilog is None and cmd_name in EXAMPLES:
            command.epilog = f"Example: sim-heating {EXAMPLES[cmd_name]}"
        if cmd_name not in WITHOUT_EXAMPLES:
            _with_examples(command, set(TAKES_EXAMPLES) - CHANGED_BY.get(cmd_name, set()))
        return with_common_options(_with_completion(command))


@click.group(cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(package_name="sim-heating", prog_name="sim-heating")
def cli() -> None:
    """Aerodynamic heating alongside a flight simulator: temperatures from a trajectory, and back."""
    try:
        os.getcwd()
    except OSError:
        raise InputError("the working directory was removed; change to one that exists") from None
    if os.environ.get("SIM_HEATING_EFFECTS"):  # the import is slow, and help should not wait for it
        from sim_heating.heating.effects import user_effect_files

        user_effect_files()  # a folder that does not exist is refused by all commands, whether they use effects or not


def _complete_paths(context: click.Context, parameter: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """What an argument is completed to; the module is imported by a completion alone."""
    from sim_heating.cli.completion import complete_paths

    return complete_paths(context, parameter, incomplete)


def _with_examples(command: click.Command, names: set[str]) -> None:
    """Let arguments and options of these names, of a command and of those below it, name shipped examples."""
    from sim_heating.cli.examples import ExamplePath

    for parameter in command.params:
        if parameter.name in names and isinstance(parameter.type, click.Path):
            parameter.type = ExamplePath(path_type=Path)
    for below in command.commands.values() if isinstance(command, click.Group) else ():
        _with_examples(below, names)


def _with_completion(command: click.Command) -> click.Command:
    """A command, and those below it, whose paths are completed."""
    for parameter in command.params:
        if parameter.name in COMPLETED and parameter._custom_shell_complete is None:
            parameter._custom_shell_complete = _complete_paths
    for below in command.commands.values() if isinstance(command, click.Group) else ():
        _with_completion(below)
    return command


with_common_options(cli)


def main(arguments: list[str] | None = None, signals: EndingSignals | None = None) -> int:
    """Run the command; its exit status: 0 done, 1 failed, 2 bad usage or input, 130 after Ctrl-C, 143 after SIGTERM.

    signals : handlers of the process, where it is the command's own
    """
    signals = signals or EndingSignals()
    argv = sys.argv[1:] if arguments is None else arguments
    with reporting(argv) as report:
        try:
            try:
                with (
                    report.standard_output_reserved(),
                    silent_console(report.is_json or report.is_quiet),
                    stating_command(*repeatable(argv)),
                ):
                    status = _status(argv, report, signals)
                signals.ignore()
            except KeyboardInterrupt:  # between the command and its answer
                signals.ignore()
                status = _interrupted(report, signals)
        except Exception as error:  # a fault of the program, whose traceback follows
            report.error = {"kind": "internal", "message": one_line(repr(error)), "problems": []}
            report.print_json(1)
            raise
        try:
            report.print_json(status)
        except OSError as error:
            return _system_error(report, error)
    return status


def _status(arguments: list[str], report: CommandReport, signals: EndingSignals) -> int:
    """Run the command, report its errors and interrupts; exit status."""
    try:
        with warnings.catch_warnings():
            warnings.showwarning = show_warning  # type: ignore[assignment]
            status = _exit_status(arguments, report)
        sys.stdout.flush()
    except (KeyboardInterrupt, click.Abort):
        return _interrupted(report, signals)
    except Exception as error:
        if signals.received:  # a library has made another error of the interrupt
            return _interrupted(report, signals)
        if not isinstance(error, OSError):
            raise
        return _system_error(report, error)
    return signals.exit_status if signals.received else status


def _interrupted(report: CommandReport, signals: EndingSignals) -> int:
    """Report an interrupt; exit status."""
    exec("")  # Python would end by SIGINT whatever the status, if the interrupt came within an exec() of some library
    return _failed(report, signals.exit_status, "interrupted", "interrupted", "nothing was left half-written")


def _system_error(report: CommandReport, error: OSError) -> int:
    """Report an error of the system, such as a full disk, or of a path that none can be; exit status."""
    if error.errno in (errno.ENAMETOOLONG, errno.ELOOP):
        path = one_line(str(error.filename))
        return _failed(report, 2, "error", "input", f"{path}: cannot be opened ({error.strerror}); give another path")
    return _failed(report, 1, "failed", "system", one_line(f"{error.filename or 'system'}: {error.strerror or error}"))


def _exit_status(arguments: list[str], report: CommandReport) -> int:
    """Run the command, report its errors; exit status. Interrupts and errors of the system are raised."""
    try:
        cli.main(arguments, prog_name="sim-heating", standalone_mode=False)
    except click.exceptions.Exit as stop:
        return stop.exit_code
    except click.ClickException as error:
        name_command(getattr(error, "ctx", None))
        if isinstance(error, click.NoSuchOption):
            error = click.NoSuchOption(error.option_name, error.message, _close_options(error), error.ctx)
        return _failed(report, 2, "error", "usage", error.format_message())
    except InputError as error:
        return _failed(report, 2, "error", "input", *error.problems)
    except RunError as error:
        return _failed(report, 1, "failed", "failed", str(error))
    return 0


def _close_options(error: click.NoSuchOption) -> list[str]:
    """The options that an unknown one is similar to by its letters; the dashes are the same in all."""
    from sim_heating.base.files import nearest_name

    wrong = error.option_name.strip("-")
    return [name for name in error.possibilities or () if nearest_name(wrong, [name.strip("-")])]


def _failed(report: CommandReport, status: int, label: str, kind: str, *problems: str) -> int:
    """Print why a command did not succeed, and enter it in the report; its exit status."""
    message = "\n".join(problems)
    ERRORS.print(f"{label}: {message}")
    report.error = {"kind": kind, "message": message, "problems": list(problems)}
    return status
