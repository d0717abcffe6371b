"""Run a command with --json and read the object that it prints."""

from __future__ import annotations

import json
from typing import Any

import pytest

from sim_heating.cli import main


def run_json(capsys: pytest.CaptureFixture[str], *arguments: str, status: int = 0) -> dict[str, Any]:
    """The object that a command prints with --json; its exit status is asserted."""
    capsys.readouterr()
    assert main([*arguments, "--json"]) == status
    found: dict[str, Any] = json.loads(capsys.readouterr().out, parse_constant=pytest.fail)
    assert (found["format"], found["status"]) == ("command/1", status)
    return found
