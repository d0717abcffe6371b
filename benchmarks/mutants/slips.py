"""Slips of the unit in shipped inputs: how many are refused, how many told, how many accepted without a word.

    python -m benchmarks.mutants --slips 1500 --seed 0

A slip multiplies a column, or the numbers of a key, by a factor between units, or states a temperature in degC or degF.
Slip n of a seed is always the same. It is judged by `validate`, which reads what every command reads: refused where it
raises, told where it warns of what is unusual. The table goes to results/unit_slips.json.
"""

from __future__ import annotations

import copy
import csv
import io
import math
import random
import shutil
import tempfile
import tomllib
import warnings
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import tomlkit

from benchmarks.measure import Figure, save
from sim_heating.base.errors import InputError, UnusualWarning
from sim_heating.base.limits import quantity
from sim_heating.cli.path_check import check_path

ROOT = Path(__file__).resolve().parents[2]
GOAL = 75.0
"""Slips that are refused or told [%]."""
FACTORS = {"10": 10.0, "60": 60.0, "1000": 1000.0, "pi/180": math.pi / 180.0, "0.3048": 0.3048}
"""Units that are mistaken for one another, in both directions."""
FITTING = {
    "60": ("_s", "_deg_s"), "pi/180": ("_deg", "_deg_s"), "0.3048": ("_m", "_m_s", "_m2"), "10": ("",), "1000": ("",),
    "degC": ("",), "degF": ("",),
}  # fmt: skip
"""Factor -> endings of the quantities whose units it is between; it is tried on all others as well."""
RECORDS = ("practice/p01", "practice/p06", "practice/p09", "sts96_480", "sts96_597", "kaowool_board")
CASES: dict[str, tuple[str, str, tuple[str, ...]]] = {
    **{f"record {name}": (f"scenarios/records/{name}", ".", ("record.toml", "conditions.csv", "thermocouples.csv"))
       for name in RECORDS},
    "vehicle": ("aircraft_data/capsule", ".", ("vehicle.toml", "control_points/*", "materials/*", "ratio_tables/*",
                                              "ratio_sources/*", "guidance.toml")),
    **{f"scenario {name}": ("scenarios", f"{name}.toml", (f"{name}.toml",))
       for name in ("popu_mach20", "flap_mach16", "entry_3dof", "capsule", "all_manoeuvres")},
    "trajectory": ("scenarios", "recorded_sts107.toml", ("recorded_sts107.toml", "data/sts107_early_entry.csv")),
    **{f"study {name}": ("scenarios", f"studies/{name}.toml", (f"studies/{name}.toml",))
       for name in ("small_envelope", "optimal_entry")},
    **{f"link {name}": ("scenarios", f"live/{name}.toml", (f"live/{name}.toml",)) for name in ("demo", "popu_lines")},
}  # fmt: skip
"""Name -> folder that is copied, what is validated in it, files that are changed."""
WITHOUT_UNIT = ("seed", "bits", "nodes", "port", "jets")


REASONS = {
    "thickness_m": "layers of 0.04 to 150 mm are built",
    "depth_m": "a sensor may be anywhere in its wall",
    "noise_sigma_K": "0.01 to 30 K are declared; systematic errors are among them",
    "sigma_K": "no command reads it",
    "nose_radius_m": "2 mm to 12 m are flown",
    "heading_deg": "every heading is flown",
    "latitude_deg": "every place is flown over",
    "longitude_deg": "every place is flown over",
    "alpha_deg": "0 to 60 deg are flown, and no other column says which",
    "beta_deg": "sideslip is 0 in most flights",
    "elevon_deg": "small deflections are flown",
    "bodyflap_deg": "small deflections are flown",
    "hold_s": "0.5 to 60 s are held",
    "horizon_s": "a free choice",
    "gamma_deg": "-0.4 to -25 deg are flown",
    "conductivity_W_mK": "materials of this density have it",
    "density_kg_m3": "materials of this conductivity have it",
    "specific_heat_J_kgK": "materials of this density have it",
    "emissivity": "surfaces have 0.3 to 1",
    "ratio": "control points have 0.001 to 3",
    "p_surface_Pa": "leeward pressures are a thousandth of those in front",
    "bondline_K": "limits of 300 to 1200 K are set",
    "sample_s": "recorders sample at 0.1 to 20 Hz",
    "rate_hz": "recorders sample at 0.05 to 1000 Hz",
    "rate_deg_s": "surfaces and vehicles turn at 0.05 to 40 deg/s",
    "range_K": "recorders span 100 to 2500 K",
    "running_length_m": "1 cm to 60 m are flown",
    "surface_K": "limits of 350 to 3500 K are set",
    "max_use_K": "materials last to 350 to 3500 K",
    "relative_sigma": "tables state 0.1 to 100 %",
    "at_velocity_m_s": "a manoeuvre may be anywhere in the flight",
}
"""Quantity -> why a slip of it may be accepted without a word."""
ELSE = "the value after the slip is usual as well"


@dataclass(frozen=True)
class Slip:
    """One slip and what became of it.

    case     : of CASES;  file : that was changed;  name : column, or key with its tables
    factor   : of FACTORS with its direction, or a scale of temperature;  fits : whether it is between units of the name
    outcome  : refused, told or accepted;  message : first line
    """

    case: str
    file: str
    name: str
    factor: str
    fits: bool
    outcome: str
    message: str


def run(count: int, seed: int) -> list[Figure]:
    """Judge a number of slips and save the table."""
    with tempfile.TemporaryDirectory() as folder:
        slips = [judge(seed, n, Path(folder)) for n in range(count)]
    figures = list(_figures(slips))
    tried = Counter(_own(s.name) for s in slips)
    accepted = Counter(_own(s.name) for s in slips if s.outcome == "accepted")
    by_quantity = {
        name: {"accepted": n, "tried": tried[name], "reason": REASONS.get(name, ELSE)}
        for name, n in sorted(accepted.items(), key=lambda item: (-item[1], item[0]))
    }
    each = sorted(f"{s.case}: {s.name} {s.factor}" for s in slips if s.outcome == "accepted")
    save("unit_slips", figures, {"seed": seed, "count": count, "by_quantity": by_quantity, "accepted": each})
    return figures


def _figures(slips: Sequence[Slip]) -> Iterator[Figure]:
    def share(chosen: Sequence[Slip], *outcomes: str) -> float:
        return 100.0 * sum(s.outcome in outcomes for s in chosen) / max(len(chosen), 1)

    yield Figure("unit slips", len(slips), "")
    yield Figure("refused or told", share(slips, "refused", "told"), "%", GOAL, at_least=True)
    yield Figure("refused", share(slips, "refused"), "%")
    fitting = [s for s in slips if s.fits]
    yield Figure("refused or told, of factors between units of the quantity", share(fitting, "refused", "told"), "%",
                 note=f"of {len(fitting)}")  # fmt: skip
    for factor in dict.fromkeys(s.factor for s in slips):
        chosen = [s for s in slips if s.factor == factor]
        yield Figure(f"of {factor}", share(chosen, "refused", "told"), "%", note=f"of {len(chosen)}")


def judge(seed: int, number: int, folder: Path) -> Slip:
    """The slip of a number, and what `validate` says of it."""
    rng = random.Random(f"slip {seed}:{number}")
    while True:
        case, path, name = rng.choice(_all_names())
        home, target, _ = CASES[case]
        own = _own(name)
        kinds = [*(f"{sign} {f}" for f in FACTORS for sign in ("x", "/"))]
        kinds += ["degC", "degF"] * 2 if own.endswith("_K") else []
        kind = rng.choice(kinds)
        place = folder / "tree" / Path(home).name
        shutil.rmtree(folder / "tree", ignore_errors=True)
        shutil.copytree(ROOT / home, place, ignore=shutil.ignore_patterns("practice" if home == "scenarios" else ""))
        changed = place / path.relative_to(ROOT / home)
        if not _change(changed, name, kind):
            continue
        outcome, message = _validate(place / target)
        factor = kind.split()[-1]
        fits = own.endswith(FITTING[factor])
        return Slip(case, path.relative_to(ROOT).as_posix(), name, kind, fits, outcome, message)


def _own(name: str) -> str:
    """The quantity of a column, or of a key without its tables."""
    return name.rpartition(".")[2].partition("[")[0]


def _validate(path: Path) -> tuple[str, str]:
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        try:
            check_path(path)
        except InputError as error:
            return "refused", error.problems[0]
    told = [str(w.message) for w in found if issubclass(w.category, UnusualWarning)]
    return ("told", told[0]) if told else ("accepted", "")


@cache
def _all_names() -> list[tuple[str, Path, str]]:
    """Case, file and name of every column and key with a unit, each once."""
    found: list[tuple[str, Path, str]] = []
    for case, (home, _, globs) in CASES.items():
        files = sorted(p for glob in globs for p in (ROOT / home).glob(glob) if p.suffix in (".toml", ".csv"))
        found += [(case, path, name) for path in files for name in _names(path)]
    return found


def _names(path: Path) -> list[str]:
    """Columns, or keys with the tables that they are in, whose numbers have a unit; `[k]` is a column of a list."""
    if path.suffix == ".csv":
        head = next(line for line in path.read_text().splitlines() if not line.startswith("#"))
        return [n for n in head.split(",") if n not in WITHOUT_UNIT and (quantity(n) is not None or n == "ratio")]
    return sorted(set(_keys(tomllib.loads(path.read_text()), "")))


def _keys(node: Any, name: str) -> Iterator[str]:
    if isinstance(node, dict):
        for key, value in node.items():
            yield from _keys(value, f"{name}.{key}" if name else key)
    elif isinstance(node, list) and node and isinstance(node[0], dict):
        for i, value in enumerate(node):
            yield from _keys(value, f"{name}#{i}")
    elif (own := name.rpartition(".")[2]) not in WITHOUT_UNIT and quantity(own) is not None:
        if isinstance(node, list) and node and isinstance(node[0], list):
            yield from (f"{name}[{k}]" for k in range(len(node[0])))
        elif isinstance(node, list) or _is_number(node):
            yield name


def _change(path: Path, name: str, kind: str) -> bool:
    """Make the slip; whether anything changed."""
    text = path.read_text()
    if path.suffix == ".csv":
        lines = text.splitlines()
        first = next(i for i, line in enumerate(lines) if not line.startswith("#"))
        names, *body = list(csv.reader(lines[first:]))
        i = names.index(name)
        for row in body:
            row[i] = repr(_slipped(float(row[i]), kind)) if row[i] else ""
        stream = io.StringIO()
        csv.writer(stream, lineterminator="\n").writerows([names, *body])
        new = "".join(f"{line}\n" for line in lines[:first]) + stream.getvalue()
        changed = any(
            float(a[i]) != float(b[i]) for a, b in zip(body, list(csv.reader(lines[first:]))[1:], strict=True) if a[i]
        )
    else:
        data = tomllib.loads(text)
        before = copy.deepcopy(data)
        keys, column = name.partition("[")[0].split("."), name.partition("[")[2].rstrip("]")
        node: Any = data
        for part in keys[:-1]:
            key, _, index = part.partition("#")
            node = node[key][int(index)] if index else node[key]
        own = keys[-1]
        value = node[own]
        if column:
            for row in value:
                row[int(column)] = _slipped(row[int(column)], kind)
        else:
            node[own] = [_slipped(v, kind) for v in value] if isinstance(value, list) else _slipped(value, kind)
        new, changed = tomlkit.dumps(data), data != before
    path.write_text(new)
    return changed


def _slipped(value: Any, kind: str) -> Any:
    if not _is_number(value):
        return value
    if kind == "degC":
        return value - 273.15
    if kind == "degF":
        return 1.8 * value - 459.67
    sign, factor = kind.split()
    return value * FACTORS[factor] if sign == "x" else value / FACTORS[factor]


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)
