"""The cache of compiled kernels is renewed by every source that a kernel is made of, and by nothing else; what two
processes need at once, one of them compiles."""

from __future__ import annotations

import ast
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numba
import pytest

from sim_heating.base.kernels import cache_folder
from sim_heating.base.kernels.cache_folder import PACKAGE, kernel_sources, known_digest, source_digest
from tests.support.systems import posix


def parsed_imports(path: Path, modules: dict[str, Path]) -> set[Path]:
    """Modules of the package that a module imports, from its syntax tree."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom):
            names |= {str(node.module), *(f"{node.module}.{alias.name}" for alias in node.names)}
        elif isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
    return {modules[name] for name in names if name in modules}


def parsed_sources() -> set[Path]:
    """Modules that import the compiler of kernels, and all that they import, directly or through others.

    The public face of the package, which has a name for everything, is none of them.
    """
    files = {p: (PACKAGE.name, *p.relative_to(PACKAGE).with_suffix("").parts) for p in PACKAGE.rglob("*.py")}
    modules = {".".join(n[:-1] if n[-1] == "__init__" else n): p for p, n in files.items()}
    imports = {path: parsed_imports(path, modules) for name, path in modules.items() if name != PACKAGE.name}
    found = {path for path, names in imports.items() if modules["sim_heating.base.kernels.jit"] in names}
    while True:
        more = found.union(*(imports[path] for path in found))
        if more == found:
            return found
        found = more


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


@pytest.fixture
def settled(package, monkeypatch):
    """A copy of the package that counts as unchanged for long."""
    monkeypatch.setattr(cache_folder, "SETTLED_S", 0.0)
    return package


@pytest.mark.thorough
def test_sources_of_kernels_are_those_that_a_parser_finds():
    assert {path for path in kernel_sources() if path.suffix == ".py"} == parsed_sources()


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
def test_the_digest_is_kept_and_found_again_after_a_change_that_leaves_size_and_time_of_a_file(settled, tmp_path):
    package = settled
    source, kept = package / "thermal" / "step.py", tmp_path / "kept"
    kept.mkdir()
    before = known_digest(kept, package)
    assert before == known_digest(kept, package) == source_digest(package)
    assert len(list(kept.iterdir())) == 1
    state, text = source.stat(), source.read_text()
    source.write_text(text.replace("0", "1", 1))
    os.utime(source, ns=(state.st_atime_ns, state.st_mtime_ns))
    assert source.stat().st_size == state.st_size
    assert known_digest(kept, package) == source_digest(package) != before


@pytest.mark.thorough
@pytest.mark.sample(1)
@posix
@pytest.mark.parametrize("damage", [b"", b"0123", b"\xff" * 16, b"no digest at all"])
def test_a_kept_digest_that_is_damaged_is_worked_out_again(settled, tmp_path, damage):
    package = settled
    kept = tmp_path / "kept"
    kept.mkdir()
    digest = known_digest(kept, package)
    (file,) = kept.iterdir()
    file.write_bytes(damage)
    assert known_digest(kept, package) == digest
    assert file.read_text() == digest


@pytest.mark.thorough
def test_the_digest_is_found_where_none_can_be_kept(settled, tmp_path):
    assert known_digest(tmp_path / "absent", settled) == source_digest(settled)


@pytest.mark.thorough
def test_no_digest_is_kept_of_files_that_were_changed_a_moment_ago(package, tmp_path):
    assert known_digest(tmp_path, package) == source_digest(package)
    assert [path.name for path in tmp_path.iterdir()] == [package.name]


@pytest.mark.thorough
@posix
def test_a_link_to_nothing_that_an_editor_left_is_no_source(settled, tmp_path):
    before = known_digest(tmp_path, settled)
    (settled / "thermal" / ".#step.py").symlink_to("user@host.1234")
    assert known_digest(tmp_path, settled) == source_digest(settled) == before


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
