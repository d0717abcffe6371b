"""Damaged results, netCDF and kept batches among them: what the next command says of them, and what it leaves.

A file of the results is cut off, emptied, or has bits flipped. Then the statement of the results is asked for, and the
same command runs again. It either makes the whole results, or refuses in a line that names the damaged file and changes
nothing; `--force` makes the whole results then. Where the list of the results itself is damaged, the folder is refused.
"""

from __future__ import annotations

import contextlib
import io
import random
import shutil
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.measure import Figure, Keep
from sim_heating.base.files import MARKER
from sim_heating.cli import main
from tests.support.kills import inputs, state

COMMANDS = {
    "run": ("run", "before.toml"),
    "predict": ("predict", "before"),
    "plan": ("plan", "before_study.toml", "--workers", "1"),
}


def told_by(arguments: list[str]) -> tuple[int, str]:
    """Exit status of a command and what it prints on standard error; a traceback where it raises."""
    errors = io.StringIO()
    with contextlib.redirect_stderr(errors), contextlib.redirect_stdout(io.StringIO()):
        status = main([*arguments, "--quiet"])
    return status, errors.getvalue()


def damage(path: Path, rng: random.Random) -> str:
    """Damage a file at random; what was done."""
    data = bytearray(path.read_bytes())
    kind = rng.choice(("bits", "cut", "emptied", "zeros"))
    at = rng.randrange(max(len(data), 1))
    if kind == "bits":
        for _ in range(rng.choice((1, 3, 30))):
            data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    elif kind == "zeros":
        data[at : at + 512] = bytes(len(data[at : at + 512]))
    else:
        del data[0 if kind == "emptied" else at :]
    path.write_bytes(bytes(data))
    return kind


def damaged_results(times: int, seed: int) -> tuple[Counter[str], list[str]]:
    """What became of results with a damaged file, by outcome, and faults; every second file is netCDF or a batch."""
    rng, counted, faults = random.Random(seed), Counter[str](), list[str]()
    with TemporaryDirectory() as name:
        whole: dict[str, Path] = {}
        for k in range(times):
            command = list(COMMANDS)[k % len(COMMANDS)]
            arguments = [COMMANDS[command][0], str(inputs() / COMMANDS[command][1]), *COMMANDS[command][2:]]
            if command not in whole:
                whole[command] = Path(name) / command
                assert told_by([*arguments, "--out", str(whole[command])])[0] == 0
            out = shutil.copytree(whole[command], Path(name) / f"{k}")
            files = sorted(p for p in out.rglob("*") if p.is_file() and p.stat().st_size > 0)
            chosen = [p for p in files if p.suffix in (".nc", ".parquet")] if k % 2 else files
            path = rng.choice(chosen or files)
            how = f"{command}, {path.relative_to(out)}, {damage(path, rng)}"
            fault = _judge([*arguments, "--out", str(out)], out, path, state_of(whole[command]), counted)
            faults += [f"{how}: {line}" for line in fault]
            shutil.rmtree(out)
    return counted, faults


def state_of(folder: Path) -> dict[str, str]:
    """Files of results by their contents; a netCDF that cannot be read is one of its own."""
    try:
        return state(folder)
    except Exception:  # whatever the library says of a damaged file
        return {"": "cannot be read"}


def _judge(arguments: list[str], out: Path, path: Path, whole: dict[str, str], counted: Counter[str]) -> Iterator[str]:
    status, errors = told_by(["credibility", str(out)])
    if status not in (0, 1, 2) or "Traceback" in errors:
        yield f"credibility: status {status}: {errors[-300:]}"
    damaged = path.read_bytes()
    status, errors = told_by(arguments)
    if status == 2:
        counted["refused"] += 1
        if path.name not in errors:
            yield f"the refusal does not name the file: {errors[-300:]}"
        if path.read_bytes() != damaged:
            yield "a refused command changed the file"
        if path.name == MARKER:  # what else in the folder is of this program is not known any more
            return
        status, errors = told_by([*arguments, "--force"])
    else:
        counted["made again"] += 1
    if status != 0 or "Traceback" in errors:
        yield f"status {status}: {errors[-300:]}"
    elif state_of(out) != whole:
        yield "not the whole results"


def figures(times: int, seed: int, keep: Keep) -> list[Figure]:
    """Damaged results, and what went wrong."""
    counted, faults = keep(f"damaged results, {times}", lambda: damaged_results(times, seed))
    note = ", ".join(f"{n} {what}" for what, n in counted.items())
    return [
        Figure("damaged results", times, "", note=note),
        Figure("damaged results: not made again, or not refused with the file", len(faults), "", 0.0,
               note="; ".join(faults)[:2000]),
    ]  # fmt: skip
