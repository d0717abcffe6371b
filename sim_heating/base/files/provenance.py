"""What a result says of its origin: the command, its inputs with their digests, seed, versions, platform.

One block, `provenance`, stands in every JSON file of results, in the attributes of every netCDF file and in the list
of each output directory. `sim-heating reproduce` repeats the command and compares. The block holds no time and no
folder of the results: the same command on the same inputs gives the same bytes.
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property, lru_cache
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from typing import Any

from sim_heating.base.files.package import PACKAGE, package_version
from sim_heating.base.files.paths import file_digest, real_path
from sim_heating.base.progress import running_command

PROVENANCE = "provenance"
"""Key of the block in a JSON file, and name of the attribute of a netCDF file."""


INPUT_FOLDERS = ("vehicle.toml", "estimate.json")
"""Files by which a folder that an option names is an input."""


@dataclass(frozen=True, eq=False)
class Origin:
    """Origin of the results in one output directory.

    target : the directory
    inputs : files and directories that the results are made from
    seed   : of the random numbers; None where there are none
    """

    target: Path
    inputs: tuple[Path, ...]
    seed: int | None

    @cached_property
    def block(self) -> dict[str, Any]:
        """The block, as JSON has it."""
        stated = running_command()
        return {
            "command": None if stated is None else stated["arguments"],
            "folder": "." if stated is None else _below(self.target, stated["out"]),
            "inputs": {input_name(p): input_digest(p) for p in (*self.inputs, *_named_files(stated))},
            "seed": self.seed,
            "versions": versions(),
            "platform": system(),
        }


_origins: list[Origin] = []


@contextmanager
def results_from(target: Path, inputs: Iterable[str | os.PathLike[str] | None], seed: int | None) -> Iterator[None]:
    """Within the block, results have this origin."""
    there = tuple(Path(p) for p in inputs if p is not None and os.path.exists(p))
    _origins.append(Origin(target, there, seed))
    try:
        yield
    finally:
        _origins.pop()


def provenance() -> dict[str, Any] | None:
    """The block of the results that are being written; None outside of an output directory."""
    return dict(_origins[-1].block) if _origins else None


def with_provenance(data: Mapping[str, Any]) -> Mapping[str, Any]:
    """Results that state their format, with the block as a further key; other data as they are."""
    block = provenance()
    return data if block is None or "format" not in data or PROVENANCE in data else {**data, PROVENANCE: block}


def provenance_attributes() -> dict[str, str]:
    """Attributes `history`, as the CF conventions name it, and `provenance`, in JSON, of a netCDF file."""
    block = provenance()
    command = None if block is None else block["command"]
    call = "written from Python" if command is None else " ".join(["sim-heating", *command])
    # a name of a file may hold bytes that are no characters in the encoding of the system
    history = {"history": f"sim-heating {package_version()}: {os.fsencode(call).decode(errors='replace')}"}
    return history if block is None else {**history, PROVENANCE: json.dumps(block)}


@lru_cache(maxsize=1)
def versions() -> dict[str, str]:
    """Versions of the program, of Python and of the libraries that the program requires and finds."""
    by_name = {"sim-heating": package_version(), "python": platform.python_version()}
    try:
        required = requires("sim-heating") or []
    except PackageNotFoundError:
        required = []
    names = {re.split(r"[^\w.-]", line, maxsplit=1)[0] for line in required if "extra ==" not in line}
    for name in sorted(names, key=str.lower):
        try:
            by_name[name] = version(name)
        except PackageNotFoundError:
            continue
    return by_name


def system() -> str:
    """Operating system and kind of processor."""
    return f"{platform.system()} {platform.machine()}"


def input_name(path: Path) -> str:
    """Name of an input: below the data of the package, else below the working directory, else the whole path."""
    real = real_path(path)
    for folder in (PACKAGE, PACKAGE.parent):
        for data in ("aircraft_data", "scenarios"):
            if real.is_relative_to(folder / data):
                return real.relative_to(folder).as_posix()
    try:
        return real.relative_to(Path.cwd()).as_posix()
    except (ValueError, OSError):
        return real.as_posix()


def input_place(name: str) -> Path:
    """Path of an input by its name in a block; it need not exist."""
    candidates = (Path(name), PACKAGE / name, PACKAGE.parent / name)
    return next((p for p in candidates if p.exists()), Path(name))


def input_digest(path: Path) -> str:
    """`sha256:...` of a file's bytes; of a directory, of the names and bytes of its files, hidden ones aside."""
    if not path.is_dir():
        return file_digest(path)
    digest = hashlib.sha256()
    for file in sorted(p for p in path.rglob("*") if p.is_file()):
        name = file.relative_to(path)
        if not any(folder.startswith((".", "__pycache__")) for folder in name.parts):
            digest.update(f"{name.as_posix()}\0{file_digest(file)}\0".encode())
    return f"sha256:{digest.hexdigest()}"


def _named_files(stated: Mapping[str, Any] | None) -> list[Path]:
    """Files, vehicles and folders of an estimate that the arguments of a command name, such as those of options."""
    paths = [] if stated is None else [Path(argument) for argument in stated["arguments"]]
    return [p for p in paths if os.path.isfile(p) or any(os.path.isfile(p / name) for name in INPUT_FOLDERS)]


def _below(target: Path, out: str) -> str:
    """Path of a directory below the folder of a command's results."""
    try:
        return real_path(target).relative_to(out).as_posix()
    except ValueError:
        return "."
