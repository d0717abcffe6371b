"""Help and version load no libraries of numbers, pictures and models; checks of files, no compiler."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import click
import pytest
from click.testing import CliRunner

from sim_heating.cli import COMMANDS, cli
from tests.support.paths import ROOT

HEAVY = {
    "numpy", "scipy", "numba", "llvmlite", "pydantic", "matplotlib", "pandas", "xarray", "jsbsim", "fmpy", "pint",
    "dask", "distributed",
}  # fmt: skip
"""Packages that a help text does not need; each takes longer to import than all that it does need."""
LOADED = """
import json, sys
from sim_heating.__main__ import main
status = main()
print(json.dumps([status, sorted({name.split(".")[0] for name in sys.modules})]))
"""
GROUPS = {
    "credibility": ("show", "rules", "add", "list", "remove", "review"),
    "fmu": ("export", "trajectory"),
    "new": ("record", "vehicle", "scenario", "study", "effect"),
}
"""Commands of the commands that are groups."""


def packages_loaded(*arguments: str) -> set[str]:
    """Names of the packages that a process has imported after a command."""
    command = [sys.executable, "-c", LOADED, *arguments]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    status, packages = json.loads(done.stdout.splitlines()[-1])
    assert status == 0
    return set(packages)


@pytest.mark.sample(2)
@pytest.mark.parametrize(
    "arguments",
    [
        ("--help",),
        ("--version",),
        *((name, "--help") for name in COMMANDS),
        *((group, name, "--help") for group, names in GROUPS.items() for name in names),
    ],
    ids=" ".join,
)
def test_help_and_version_load_no_heavy_package(arguments: tuple[str, ...]) -> None:
    assert packages_loaded(*arguments) & HEAVY == set()


def test_a_check_of_a_vehicle_loads_no_compiler_and_no_pictures() -> None:
    assert packages_loaded("validate", str(ROOT / "aircraft_data" / "orbiter")) & HEAVY == {"numpy", "pydantic"}


@pytest.mark.parametrize("record", ["practice/p06", "kaowool_board"])
def test_a_check_of_a_record_loads_no_compiler_and_no_pictures(record: str) -> None:
    """The standard atmosphere that it is compared with is a kernel, run by the interpreter for a few thousand rows."""
    assert packages_loaded("validate", str(ROOT / "scenarios" / "records" / record)) & HEAVY == {"numpy", "pydantic"}


@pytest.mark.parametrize("group", [(), ("new",), ("fmu",), ("credibility",)], ids=str)
def test_a_help_text_has_the_whole_sentence_on_each_command(group: tuple[str, ...]) -> None:
    """At the 80 columns of a pipe, where most are longer than a line."""
    listed = CliRunner().invoke(cli, [*group, "--help"], terminal_width=80).output.partition("Commands:")[2]
    assert len(listed.split("\n\n")[0].splitlines()) > 3
    assert "..." not in listed.split("\n\n")[0]


def test_help_of_every_command_is_covered() -> None:
    context = click.Context(cli)
    groups = {name: cli.get_command(context, name) for name in cli.list_commands(context)}
    subcommands = {name: tuple(g.commands) for name, g in groups.items() if isinstance(g, click.Group)}
    assert subcommands == GROUPS
