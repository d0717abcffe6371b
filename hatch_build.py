"""Puts the vehicles, scenarios and C sources into a wheel; everything else is in pyproject.toml.

They stand beside the package in a checkout, where people edit them; an installed package carries copies of its own.
"""

import re
import shutil
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

DATA = ("aircraft_data", "scenarios", "fmu")
"""Folders of a checkout that a wheel has within the package; fmu holds the C side of exported FMUs."""
SCHEMA = re.compile(rb"\A#:schema ((?:\.\./)+)sim_heating/schemas/")
"""Path of the schema in the first line of a TOML file; within the package the schemas are one folder nearer."""


class WheelData(BuildHookInterface):
    """Adds the folders to a wheel that is not an editable installation."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        if version == "standard":
            self.copies = TemporaryDirectory()
            for folder in DATA:
                copy = Path(self.copies.name) / folder
                shutil.copytree(Path(self.root) / folder, copy, ignore=shutil.ignore_patterns("__pycache__"))
                for path in copy.rglob("*.toml"):
                    path.write_bytes(SCHEMA.sub(rb"#:schema \1schemas/", path.read_bytes(), count=1))
                build_data["force_include"][str(copy)] = f"sim_heating/{folder}"

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        if version == "standard":
            self.copies.cleanup()
