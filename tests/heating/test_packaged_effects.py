"""Effects of installed packages: offered as entry points of the group `sim_heating.effects`."""

from __future__ import annotations

import hashlib
import importlib
import subprocess
import sys
from pathlib import Path

import pytest

from sim_heating.base.errors import InputError
from sim_heating.cli import main
from sim_heating.heating.effects import add_user_effects, effects, use

EFFECT = """
from sim_heating import Effect, Parameter, flight, njit


@njit
def steep(B, c, p, wall_K):
    return 1.0 + B[p] * (0.1 * (B[c + flight.alpha_deg] - 40.0)) ** 2


{variable} = Effect("{name}", "multiply", (Parameter("growth", "1", 0.0, 0.2, -1.0, 2.0, "at 10 deg from 40"),), steep)
"""
PROJECT = """
[build-system]
requires = ["hatchling"]
build-backend = "hatchling.build"
[project]
name = "my-effects"
version = "1.2"
[project.entry-points."sim_heating.effects"]
packaged-growth = "my_effects.growth"
[tool.hatch.build.targets.wheel]
packages = ["my_effects"]
"""


def install(site: Path, package: str, entry: str, text: str) -> None:
    """Put a package of one module, and what pip records of it, where Python looks for packages."""
    module = entry.partition("=")[2].partition(":")[0].strip()
    (site / f"{module}.py").write_text(text)
    about = site / f"{package}-1.2.dist-info"
    about.mkdir()
    (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.2\n")
    (about / "entry_points.txt").write_text(f"[sim_heating.effects]\n{entry}\n")


@pytest.fixture
def site(tmp_path, monkeypatch):
    """An empty folder of packages, the first of Python's; the working directory is the one above it."""
    folder = tmp_path / "site"
    folder.mkdir()
    monkeypatch.delenv("SIM_HEATING_EFFECTS", raising=False)
    monkeypatch.syspath_prepend(str(folder))
    monkeypatch.chdir(tmp_path)
    importlib.invalidate_caches()
    return folder


@pytest.mark.thorough
def test_pip_install_of_a_package_is_enough_to_have_its_effect(site):
    source = Path("source")
    (source / "my_effects").mkdir(parents=True)
    (source / "pyproject.toml").write_text(PROJECT)
    (source / "my_effects" / "__init__.py").write_text("")
    (source / "my_effects" / "growth.py").write_text(EFFECT.format(variable="EFFECT", name="packaged-growth"))
    pip = [sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--no-build-isolation", "--target", str(site)]
    subprocess.run([*pip, str(source.resolve())], check=True, capture_output=True)
    assert use("packaged-growth", {"growth": 0.1}).values == (0.1,)


def test_an_entry_point_names_a_module_or_an_effect_in_one(site):
    install(site, "pkg_a", "one = growth_a", EFFECT.format(variable="EFFECT", name="growth-a"))
    install(site, "pkg_b", "two = growth_b:OTHER", EFFECT.format(variable="OTHER", name="growth-b"))
    assert {"growth-a", "growth-b", "transition"} <= set(effects())


def test_a_package_and_a_file_with_one_name_are_refused_with_both(site, tmp_path, monkeypatch):
    install(site, "pkg_c", "one = growth_c", EFFECT.format(variable="EFFECT", name="growth-c"))
    folder = tmp_path / "effects"
    folder.mkdir()
    (folder / "again.py").write_text(EFFECT.format(variable="EFFECT", name="growth-c"))
    monkeypatch.setenv("SIM_HEATING_EFFECTS", str(folder))
    with pytest.raises(InputError) as refused:
        effects()
    (line,) = refused.value.problems
    assert line.startswith(f"{folder / 'again.py'}: package pkg_c 1.2, entry point `one = growth_c` already has")


def test_a_package_that_takes_the_name_of_a_shipped_effect_is_refused(site):
    install(site, "pkg_d", "one = growth_d", EFFECT.format(variable="EFFECT", name="catalysis"))
    with pytest.raises(InputError, match=r"^package pkg_d 1\.2, .*: the package sim-heating already has .*`catalysis`"):
        effects()


@pytest.mark.parametrize(
    ("entry", "text", "message"),
    [
        ("one = broken_e", "import no_such_module\n", "ModuleNotFoundError: No module named 'no_such_module'"),
        ("one = broken_f", "raise SystemExit(3)\n", "SystemExit: 3"),
        ("one = broken_g:NOTHING", "", "AttributeError: .*NOTHING"),
        ("one = broken_h:THREE", "THREE = 3\n", "it is a int; it must be an Effect"),
        ("one = broken_i", "", "EFFECT is a NoneType; it must be an Effect"),
    ],
)
def test_an_entry_point_that_fails_is_told_with_its_package(site, capsys, entry, text, message):
    install(site, "pkg_e", entry, text)
    with pytest.raises(InputError, match=rf"^package pkg_e 1\.2, entry point `{entry}`: {message}"):
        effects()


def test_a_broken_package_ends_no_command_that_uses_no_effect_of_users(site):
    install(site, "pkg_j", "one = broken_j", "import no_such_module\n")
    assert main(["formats"]) == 0
    assert use("catalysis").effect.name == "catalysis"


def test_an_edit_of_a_packaged_effect_makes_results_out_of_date(site):
    def digest() -> str:
        add_user_effects(total := hashlib.sha256())
        return total.hexdigest()

    none = digest()
    install(site, "pkg_k", "one = growth_k", EFFECT.format(variable="EFFECT", name="growth-k"))
    sys.path.append(str(site / "elsewhere"))  # a process looks for packages once for each search path
    try:
        first = digest()
        (site / "growth_k.py").write_text(EFFECT.format(variable="EFFECT", name="growth-k") + "# edited\n")
        assert len({none, first, digest()}) == 3
    finally:
        sys.path.pop()
