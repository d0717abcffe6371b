"""The command `sim-heating`: a group whose commands are imported when they are called.

`sim-heating --help` and `--version` answer in a fraction of a second because a command's module imports numpy, numba
and the modules of the program within its functions only (tests/cli/test_startup.py).
"""

from __future__ import annotations

import os
import sys
import warnings
from importlib import import_module
from typing import Any

import click

from sim_heating.base.errors import InputError, RunError, one_line
from sim_heating.base.progress import EndingSignals
from sim_heating.cli.console import ERRORS, show_warning

COMMANDS = {
    "run": "simulate",
    "synthesize": "simulate",
    "predict": "simulate",
    "demo": "simulate",
    "validate": "validate",
    "estimate": "estimate",
    "design": "estimate",
    "close-loop": "close_loop",
    "update-tables": "tables",
    "campaign": "campaign",
    "figures": "figures",
    "ratio-tables": "tables",
    "measured-records": "tables",
    "plan": "plan",
    "fmu": "fmu",
}
"""Command -> module of this folder that defines it; the order is that of the help text."""


class LazyGroup(click.Group):
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
        return command


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


def main(arguments: list[str] | None = None, signals: EndingSignals | None = None) -> int:
    """Run the command; its exit status: 0 done, 1 failed, 2 bad usage or input, 130 after Ctrl-C, 143 after SIGTERM.

    signals : handlers of the process, where it is the command's own
    """
    signals = signals or EndingSignals()
    try:
        with warnings.catch_warnings():
            warnings.showwarning = show_warning  # type: ignore[assignment]
            status = _exit_status(arguments)
        sys.stdout.flush()
    except (KeyboardInterrupt, click.Abort):
        return _interrupted(signals)
    except Exception as error:
        if signals.received:  # a library has made another error of the interrupt
            return _interrupted(signals)
        if not isinstance(error, OSError):
            raise
        ERRORS.print(one_line(f"failed: {error.filename or 'system'}: {error.strerror or error}"))
        return 1
    return signals.exit_status if signals.received else status


def _interrupted(signals: EndingSignals) -> int:
    """Report an interrupt; exit status."""
    exec("")  # Python would end by SIGINT whatever the status, if the interrupt came within an exec() of some library
    ERRORS.print("interrupted: nothing was left half-written")
    return signals.exit_status


def _exit_status(arguments: list[str] | None) -> int:
    """Run the command, report its errors; exit status. Interrupts and errors of the system are raised."""
    try:
        cli.main(arguments, prog_name="sim-heating", standalone_mode=False)
    except click.exceptions.Exit as stop:
        return stop.exit_code
    except click.ClickException as error:
        ERRORS.print(f"error: {error.format_message()}")
        return 2
    except InputError as error:
        ERRORS.print(f"error: {error}")
        return 2
    except RunError as error:
        ERRORS.print(f"failed: {error}")
        return 1
    return 0
