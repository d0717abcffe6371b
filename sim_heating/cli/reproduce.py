"""The command `sim-heating reproduce`: repeat the command that made a result, and compare."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from sim_heating.base.errors import InputError, RunError
from sim_heating.cli.console import CONSOLE, PATH, progress_line
from sim_heating.cli.output import report_results

if TYPE_CHECKING:
    from collections.abc import Iterator

SHOWN = 5
"""Differences within one file that are named; of the others the number is given."""


@click.command()
@click.argument("result", type=PATH)
def reproduce(result: Path) -> None:
    """Repeat the command that made RESULT, a folder of results or a file of one, and compare every file.

    It is repeated into a temporary folder, from the current folder, which its inputs are relative to. Exit status 0:
    all files have the same bytes, but for the folder of the results where they name it. 1: each difference is named, in
    inputs, versions and files.
    """
    from tempfile import TemporaryDirectory

    from sim_heating.base.files.provenance import input_name

    block, folder, names = _stated(result)
    differences = [*_changed_inputs(block), *_other_versions(block)]
    command = block["command"]
    with TemporaryDirectory() as temporary:
        out = Path(temporary) / "out"
        with progress_line(f"sim-heating {' '.join(command)}") as progress:
            progress(0.0, "repeating")
            _repeat(command, out)
        again = out / block["folder"]
        same = 0
        for name in names:
            differing = list(_file_differences(folder / name, again / name, (input_name(again), input_name(folder))))
            same += not differing
            shown = differing[:SHOWN] + (
                [f"{len(differing) - SHOWN} more differences"] if len(differing) > SHOWN else []
            )
            differences += [f"{name}: {line}" for line in shown]
    for line in differences:
        CONSOLE.print(line)
    CONSOLE.print(f"sim-heating {' '.join(command)}: {same} of {len(names)} files have the same bytes")
    report_results({"command": command, "files": len(names), "same": same, "differences": differences})
    if same < len(names):
        raise RunError(f"{result}: {len(names) - same} of {len(names)} files differ from the repeated ones")


def _stated(result: Path) -> tuple[dict[str, Any], Path, list[str]]:
    """The origin of a result, the folder that its files lie in, and the names of the files to compare.

    raises : InputError where it states no command
    """
    from sim_heating.base.files import MARKER, all_files_written, display_path

    if result.is_dir():
        marker = result / MARKER
        below = [marker] if marker.is_file() else sorted(result.rglob(MARKER))
        if not below:
            raise InputError(f"{display_path(result)}: holds no results of this program")
        block = _block(below[0])
        folder, names = result, all_files_written(result)
        if block is not None and below[0] != marker:  # several results of one command
            block = {**block, "folder": _above(block["folder"], below[0].parent.relative_to(result))}
    elif result.is_file():
        block, folder, names = _block(result), result.parent, [result.name]
    else:
        raise InputError(f"{display_path(result)}: does not exist; give a folder of results or a file of one")
    if block is None:
        raise InputError(
            f"{display_path(result)}: states no `provenance`; an earlier version wrote it, or its kind of file "
            "carries none: give its folder"
        )
    if block["command"] is None:
        raise InputError(f"{display_path(result)}: was written from Python, and states no command to repeat")
    return block, folder, names


def _above(folder: str, inner: Path) -> str:
    """Where a folder of results lies in that of a command, from where one below it does."""
    parts, below_parts = Path(folder).parts, inner.parts
    return (
        Path(*parts[: len(parts) - len(below_parts)]).as_posix()
        if parts[len(parts) - len(below_parts) :] == below_parts
        else "."
    )


def _block(path: Path) -> dict[str, Any] | None:
    """The origin that a file states; None where it states none."""
    import json

    from sim_heating.base.files import PROVENANCE, read_json

    if path.suffix == ".nc":
        import netCDF4

        with netCDF4.Dataset(path) as dataset:
            return json.loads(dataset.getncattr(PROVENANCE)) if PROVENANCE in dataset.ncattrs() else None
    if path.suffix != ".json":
        return None
    block = read_json(path).get(PROVENANCE)
    return block if isinstance(block, dict) else None


def _changed_inputs(block: dict[str, Any]) -> Iterator[str]:
    """Inputs that are not there, or not as they were."""
    from sim_heating.base.files.provenance import input_digest, input_place

    for name, digest in block["inputs"].items():
        path = input_place(name)
        if not path.exists():
            yield f"input {name}: is not there"
        elif input_digest(path) != digest:
            yield f"input {name}: was changed since"


def _other_versions(block: dict[str, Any]) -> Iterator[str]:
    """Versions and the platform that differ from those of the result."""
    from sim_heating.base.files.provenance import system, versions

    here = versions()
    for name, version in block["versions"].items():
        if here.get(name) != version:
            yield f"{name}: {version} then, {here.get(name, 'not installed')} here"
    if system() != block["platform"]:
        yield f"platform: {block['platform']} then, {system()} here"


def _repeat(command: list[str], out: Path) -> None:
    """Run a command in a process of its own, its results into a folder.

    raises : RunError with what it says where it fails
    """
    import os
    import subprocess
    import sys

    from sim_heating.base.progress import COMMAND

    environment = {name: value for name, value in os.environ.items() if name != COMMAND}
    arguments = [sys.executable, "-m", "sim_heating", *command, "--out", str(out), "--quiet"]
    done = subprocess.run(arguments, capture_output=True, text=True, env=environment)
    if done.returncode != 0:
        last = (done.stderr.strip().splitlines() or ["no message"])[-1]
        raise RunError(f"sim-heating {' '.join(command)}: {last}")


def _file_differences(old: Path, new: Path, moved: tuple[str, str]) -> Iterator[str]:
    """How a file differs from the repeated one, a line each; none where the bytes are the same.

    moved : folder of the repeated results, as inputs are named, and that of the results: a file that names the one
            stands for a file that names the other
    """
    if not old.is_file() or not new.is_file():
        yield "is missing here" if not old.is_file() else "was not written again"
        return
    if old.read_bytes() == new.read_bytes() or _is_moved(old, new, moved):
        return
    yield from list(_contents_differences(old, new)) or ["has other bytes"]


def _is_moved(old: Path, new: Path, moved: tuple[str, str]) -> bool:
    """Whether a file differs from the repeated one by the folder alone that both name, and by the digest of that."""
    import json

    from sim_heating.base.files.results import DIGEST

    here, there = (path.encode() for path in moved)
    if here not in (repeated := new.read_bytes()):
        return False
    before, after = old.read_bytes(), repeated.replace(here, there)
    if old.suffix != ".json" or before == after:
        return before == after
    return bool({**json.loads(before), DIGEST: None} == {**json.loads(after), DIGEST: None})


def _contents_differences(old: Path, new: Path) -> Iterator[str]:
    """Entries of JSON, columns of CSV, variables and attributes of netCDF that differ."""
    compare = {".json": _json_differences, ".nc": _netcdf_differences, ".csv": _csv_differences}.get(old.suffix)
    return iter(()) if compare is None else compare(old, new)


def _json_differences(old: Path, new: Path) -> Iterator[str]:
    import json

    return _entries("", json.loads(old.read_text("utf-8")), json.loads(new.read_text("utf-8")))


def _netcdf_differences(old: Path, new: Path) -> Iterator[str]:
    import xarray as xr

    with xr.open_dataset(old, decode_times=False) as a, xr.open_dataset(new, decode_times=False) as b:
        yield from _entries("attribute ", dict(a.attrs), dict(b.attrs))
        for name in sorted({*a.variables, *b.variables}, key=str):
            if name not in a.variables or name not in b.variables or not a[name].identical(b[name]):
                yield f"variable {name}"


def _csv_differences(old: Path, new: Path) -> Iterator[str]:
    import numpy as np
    import pandas as pd

    then, now = (pd.read_csv(path, comment="#") for path in (old, new))
    for name in sorted({*then.columns, *now.columns}):
        if name not in then or name not in now or len(then) != len(now):
            yield f"column {name}: other rows"
        elif not then[name].equals(now[name]):
            try:
                yield f"column {name}: by up to {np.nanmax(np.abs(then[name] - now[name])):.3g}"
            except TypeError:
                yield f"column {name}"


def _entries(key: str, old: Any, new: Any) -> Iterator[str]:
    """Entries of two JSON values that differ, with both values."""
    if isinstance(old, dict) and isinstance(new, dict):
        for name in {**old, **new}:  # in the order of the file
            yield from _entries(f"{key}.{name}".lstrip("."), old.get(name), new.get(name))
    elif isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        for i, pair in enumerate(zip(old, new, strict=True)):
            yield from _entries(f"{key}[{i}]", *pair)
    elif old != new:
        yield f"{key}: {str(old)[:80]} then, {str(new)[:80]} now"
