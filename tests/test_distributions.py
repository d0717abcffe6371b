"""Wheel and source distribution: complete, and the same bytes wherever they are built."""

from __future__ import annotations

import hashlib
import os
import re
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest

from tests.support.paths import ROOT

INSIDE = ("aircraft_data", "scenarios", "fmu")
"""Folders of a checkout that a wheel has within the package."""
LEFT = (".pyc", ".nbi", ".nbc", ".fmu")
OUTSIDE = {"__pycache__", "_build", ".venv", ".git", ".hypothesis", ".mypy_cache", ".pytest_cache", ".ruff_cache"}
"""What programs leave in a checkout: endings of files, and folders."""


def build(source: Path, out: Path) -> dict[str, Path]:
    """Build both from a folder; the files by their suffix."""
    command = [sys.executable, "-m", "hatchling", "build", "-d", str(out)]
    subprocess.run(command, cwd=source, check=True, capture_output=True)
    return {path.suffix: path for path in out.iterdir()}


def digests(files: dict[str, Path]) -> dict[str, str]:
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in files.values()}


def files_below(folder: Path) -> set[str]:
    """Files of a folder of a checkout, without what programs leave there."""
    found = (p.relative_to(folder) for p in folder.rglob("*") if p.is_file())
    return {
        p.as_posix() for p in found if not OUTSIDE & set(p.parts) and p.suffix not in (".pyc", ".nbi", ".nbc", ".fmu")
    }


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    return build(ROOT, tmp_path_factory.mktemp("built"))


@pytest.fixture(scope="module")
def unpacked(built: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The source distribution unpacked in another place."""
    with tarfile.open(built[".gz"]) as archive:
        archive.extractall(folder := tmp_path_factory.mktemp("unpacked"), filter="data")
    (source,) = folder.iterdir()
    return source


@pytest.mark.thorough
def test_a_wheel_has_every_file_of_the_package_and_of_the_data_folders(built):
    expected = {f"sim_heating/{name}" for name in files_below(ROOT / "sim_heating")}
    for folder in INSIDE:
        expected |= {f"sim_heating/{folder}/{name}" for name in files_below(ROOT / folder)}
    with zipfile.ZipFile(built[".whl"]) as wheel:
        found = {name for name in wheel.namelist() if ".dist-info/" not in name}
    assert found == expected


@pytest.mark.thorough
def test_a_source_distribution_has_what_the_tests_and_pages_need(unpacked):
    for folder in (*INSIDE, "sim_heating", "tests", "benchmarks", "tools", "examples", "docs"):
        assert files_below(unpacked / folder) == files_below(ROOT / folder)
    for name in ("pyproject.toml", "README.md", "LICENSE", "CHANGELOG.md", "paper.md", "recipe/recipe.yaml", ".ci/run"):
        assert (unpacked / name).read_bytes() == (ROOT / name).read_bytes()


@pytest.mark.thorough
def test_two_builds_in_two_folders_have_the_same_bytes(built, unpacked, tmp_path):
    for path in unpacked.rglob("*"):
        os.utime(path, (1e9, 1e9))
        path.chmod(path.stat().st_mode & 0o700)
    assert digests(build(unpacked, tmp_path)) == digests(built)


@pytest.mark.thorough
def test_the_citation_is_of_the_version_that_is_built(built):
    version = built[".whl"].name.split("-")[1]
    assert f"\nversion: {version}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")


def test_a_default_installation_has_neither_planning_nor_tools_of_development():
    requirements = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["dependencies"]
    names = {re.split(r"[<>=; ]", requirement)[0].lower() for requirement in requirements}
    assert not names & {"distributed", "dask", "casadi", "pyarrow", "mypy", "ruff", "pytest", "cantera", "sphinx"}


CONDA = {"matplotlib": "matplotlib-base", "netCDF4": "netcdf4"}
"""Names of packages that conda-forge has under another one."""


def test_the_conda_recipe_asks_for_what_a_default_installation_does():
    """Every requirement with its versions; that of a platform without a wheel holds for all there."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    stated = [re.match(r"([\w-]+)(.*?)(?:;.*)?$", line) for line in project["dependencies"]]
    expected = {f"{CONDA.get(m[1], m[1])} {m[2].strip()}" for m in stated if m}
    text = (ROOT / "recipe" / "recipe.yaml").read_text(encoding="utf-8")
    run = text.partition("  run:\n")[2].partition("\n\n")[0]
    found = {line.strip().removeprefix("- ") for line in run.splitlines()}
    assert found == expected | {f"python {project['requires-python']}"}
    assert f'version: "{project["version"]}"' in text


def test_every_command_that_the_paper_of_the_project_names_is_a_benchmark():
    text = (ROOT / "paper.md").read_text(encoding="utf-8")
    named = set(re.findall(r"python -m benchmarks[. ](\w+)", text))
    assert len(named) >= 10
    assert [name for name in sorted(named) if not (ROOT / "benchmarks" / f"{name}.py").is_file()] == []
    assert 800 <= len(re.sub(r"<!--.*?-->|---.*?---", "", text, flags=re.DOTALL).split()) <= 1200


@pytest.mark.thorough
def test_the_wheel_says_that_it_is_typed(built: dict[str, Path]) -> None:
    with zipfile.ZipFile(built[".whl"]) as wheel:
        assert "sim_heating/py.typed" in wheel.namelist()
