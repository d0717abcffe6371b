"""Puts the vehicles, scenarios and C sources into a wheel; everything else is in pyproject.toml.

They stand beside the package in a checkout, where people edit them; an installed package carries copies of its own.
"""

from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

DATA = ("aircraft_data", "scenarios", "fmu")
"""Folders of a checkout that a wheel has within the package; fmu holds the C side of exported FMUs."""


class WheelData(BuildHookInterface):
    """Adds the folders to a wheel that is not an editable installation."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        if version == "standard":
            build_data["force_include"] |= {folder: f"sim_heating/{folder}" for folder in DATA}
