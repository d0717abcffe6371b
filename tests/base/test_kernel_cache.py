"""The cache of compiled kernels is renewed by every source that a kernel is made of, and by nothing else; what two
processes need at once, one of them compiles."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys

import numba
import pytest

from sim_heating.base.kernels.cache_folder import KERNEL_FOLDERS, PACKAGE, source_digest
from tests.support.structure import folder, imports, modules
from tests.support.systems import posix

DECORATORS = "base.kernels.jit"
"""Module that each module with a kernel imports."""


def copy_of_kernels(folder):
    """A copy of the package without what stands above its kernels, but for two modules of that."""
    copy = folder / "sim_heating"
    for name in ("base", "heating", "thermal"):
        shutil.copytree(PACKAGE / name, copy / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("__init__.py", "cli/__init__.py", "closure/close.py"):
        (copy / name).parent.mkdir(exist_ok=True)
        shutil.copy(PACKAGE / name, copy / name)
    return copy


@pytest.fixture
def package(tmp_path):
    """A copy of the package as far as its kernels need it."""
    return copy_of_kernels(tmp_path)


def test_kernels_and_what_they_are_made_of_stand_in_folders_whose_change_renews_the_cache():
    kernels = {name for name in modules() if f"{PACKAGE.name}.{DECORATORS}" in imports(name)} - {PACKAGE.name}
    assert {folder(name) for name in kernels} == set(KERNEL_FOLDERS)
    assert {folder(needed) for name in kernels for needed in imports(name)} == set(KERNEL_FOLDERS)


def test_a_change_of_a_kernel_of_what_it_imports_or_of_its_data_renews_the_cache(package):
    names = ["thermal/step.py", "base/kernels/block.py", "base/kernels/numba_private.py", "heating/atmosphere.py"]
    data = next(package.rglob("*.csv")).relative_to(package).as_posix()
    digests = [source_digest(package)]
    for name in [*names, data]:
        with open(package / name, "a") as file:
            file.write("\n")
        digests.append(source_digest(package))
    assert len(set(digests)) == len(digests)


@pytest.mark.sample(1)
@pytest.mark.parametrize("name", ["README.md", "__init__.py", "cli/__init__.py", "closure/close.py"])
def test_a_change_of_text_or_of_what_no_kernel_imports_keeps_the_cache(package, name):
    before = source_digest(package)
    with open(package / name, "a") as file:
        file.write("\n")
    assert source_digest(package) == before


@pytest.mark.thorough
def test_the_digest_is_that_of_the_contents_wherever_they_are(package, tmp_path):
    assert source_digest(package) == source_digest(copy_of_kernels(tmp_path / "elsewhere"))


@pytest.mark.thorough
@posix
def test_a_link_to_nothing_that_an_editor_left_is_no_source(package):
    before = source_digest(package)
    (package / "thermal" / ".#step.py").symlink_to("user@host.1234")
    assert source_digest(package) == before


@pytest.mark.thorough
@pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason="nothing is compiled")  # type: ignore[attr-defined]
def test_of_two_processes_that_need_a_kernel_one_compiles_it(tmp_path):
    """Each process prints how many functions it took from the cache, of those that it has compiled or loaded."""
    program = """
import pathlib, sys, time
from sim_heating.base.kernels.elementary import exp
from sim_heating.base.kernels.compiler import CACHE
pathlib.Path(sys.argv[1]).touch()
while len(list(pathlib.Path(sys.argv[1]).parent.glob("ready*"))) < 2:
    time.sleep(0.01)
exp(1.0)
print(sum(exp.stats.cache_hits.values()), len(exp.overloads), any(CACHE.glob("*.lock")))
"""
    both = [
        subprocess.Popen(
            [sys.executable, "-c", program, str(tmp_path / f"ready{k}")],
            stdout=subprocess.PIPE,
            text=True,
            env=os.environ | {"XDG_CACHE_HOME": str(tmp_path), "NUMBA_CACHE_DIR": str(tmp_path / "kernels")},
        )
        for k in range(2)
    ]
    assert sorted(process.communicate()[0].split() for process in both) == [["0", "1", "True"], ["1", "1", "True"]]
