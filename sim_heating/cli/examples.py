"""Shipped examples by name, and the command `sim-heating examples`.

A name that is a file or folder of the current folder is that one. Any other name may be a shipped example: the name of
a scenario (`popu_mach20`), a path below the shipped scenarios or their records (`practice/p08`), or the path that the
documentation gives (`scenarios/popu_mach20.toml`). A line on standard error says that the shipped one is taken.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import Any

import click

from sim_heating.base.errors import InputError
from sim_heating.cli.console import CONSOLE, ERRORS, FORCE, print_table
from sim_heating.cli.output import current_report, report_files, report_results

FOLDERS = ("", "records", "studies", "campaigns", "live")
"""Folders below the shipped scenarios that a name is looked for in."""
COPIED = ("scenarios", "aircraft_data")
"""Data folders that `examples --out` copies."""


def example_path(name: str) -> Path | None:
    """File or folder of a shipped example; None where no example has the name.

    >>> from sim_heating.cli.examples import example_path
    >>> example_path("practice/p08").name, example_path("no_such_example")
    ('p08', None)
    """
    from sim_heating.base.files.package import data_folders

    path = Path(name)
    if path.is_absolute() or ".." in path.parts or not path.parts:
        return None
    root = next(filter(Path.is_dir, data_folders("scenarios")), None)
    if root is None:
        return None
    below = Path(*path.parts[1:]) if path.parts[0] == "scenarios" and len(path.parts) > 1 else path
    candidates = (root / folder / file for folder in FOLDERS for file in (f"{below}.toml", str(below)))
    return next(filter(_is_example, candidates), None)


def _is_example(path: Path) -> bool:
    """Whether a path is a file of an example, a record, or a folder of records."""
    return path.is_file() or any(path.glob("record.toml")) or any(path.glob("*/record.toml"))


class ExamplePath(click.Path):
    """A path of the current folder, else of a shipped example."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The path that an argument stands for."""
        is_missing = not Path(value).exists()
        example = example_path(str(value)) if is_missing else None
        if is_missing and example is None:
            _refuse_misspelt(str(value))
        if example is not None and not current_report().is_quiet:
            ERRORS.print(f"{value}: not in this folder; the shipped example {example} is taken")
        return super().convert(value if example is None else example, param, ctx)


def _refuse_misspelt(name: str) -> None:
    """raises : InputError where no example has a name, and one has nearly that name, or ends in it"""
    from sim_heating.base.files import suggestion

    names = [example for example, _ in _names()]
    meant = next((example for example in names if example.endswith(f"/{name}")), None)
    near = suggestion(name, names, otherwise="", cutoff=0.8) if meant is None else f"; did you mean `{meant}`?"
    if near:
        raise InputError(f"{name}: is no file of this folder and no shipped example{near}")


@click.command()
@click.option("--out", type=click.Path(path_type=Path), help="folder that scenarios and aircraft_data are copied into")
@FORCE
def examples(out: Path | None) -> None:
    """List the shipped examples, or copy them into a folder to change and run them there."""
    from sim_heating.base.report.table import Column, Table

    names = sorted(_names())
    if out is None:
        print_table(Table("Shipped examples", [Column("name"), Column("kind", is_text=True)], names))
        report_results({"examples": [{"name": name, "kind": kind} for name, kind in names]})
        return
    files = _copy(out)
    CONSOLE.print(f"Copied {len(files)} files into {out}: {', '.join(COPIED)}")
    report_files(out, files)
    report_results({"files": len(files)})


def _names() -> Iterator[tuple[str, str]]:
    """Name and kind of each example."""
    from sim_heating.base.files.package import data_folders

    root = next(folder for folder in data_folders("scenarios") if folder.is_dir())
    kinds = {"": "scenario", "studies": "study", "campaigns": "campaign", "live": "link"}
    for folder, kind in kinds.items():
        yield from ((path.stem, kind) for path in (root / folder).glob("*.toml"))
    for path in (root / "records").rglob("record.toml"):
        yield path.parent.relative_to(root / "records").as_posix(), "record"


def _copy(out: Path) -> list[Path]:
    """Copy the data folders, all files or none; names of the files below the folder.

    raises : InputError where another file has one of the names, unless others may be replaced
    """
    from sim_heating.base.files import OR_FORCE, replace_files, replaces_others

    copies = dict(chain.from_iterable(map(_shipped, COPIED)))
    there = {f: (out / f).read_bytes() for f in copies if (out / f).exists()}
    new = {f: data for f, data in copies.items() if there.get(f) != data}
    changed = [f for f in new if f in there]
    if changed and not replaces_others():
        raise InputError(f"{out / changed[0]}: is not the shipped file; copy into another folder{OR_FORCE}")
    replace_files(out, {file.as_posix(): data for file, data in new.items()})
    return list(copies)


def _shipped(name: str) -> Iterator[tuple[Path, bytes]]:
    """Name and content of each file of a data folder."""
    from sim_heating.base.files.package import data_folders

    root = next(folder for folder in data_folders(name) if folder.is_dir())
    for path in sorted(root.rglob("*")):
        if path.is_file() and "__pycache__" not in path.parts:
            yield name / path.relative_to(root), path.read_bytes()
