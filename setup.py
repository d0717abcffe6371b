"""Puts the vehicles, scenarios and C sources into a built package; everything else is in pyproject.toml.

They stand beside the package in a checkout, where people edit them; an installed package carries copies of its own.
"""

import shutil
from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py

DATA = {"aircraft_data": "aircraft_data", "scenarios": "scenarios", "fmu": "fmu"}
"""Folder of a checkout -> where it is in the package; fmu holds the C side of exported FMUs."""


class BuildWithData(build_py):
    """build_py that copies the data folders into the package."""

    def run(self) -> None:
        super().run()
        if self.editable_mode:
            return
        for name, place in DATA.items():
            target = Path(self.build_lib) / "sim_heating" / place
            shutil.rmtree(target, ignore_errors=True)
            shutil.copytree(name, target, ignore=shutil.ignore_patterns("__pycache__"))


setup(cmdclass={"build_py": BuildWithData})
