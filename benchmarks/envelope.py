"""The envelope before and after a flight: manoeuvres flown in JSBSim, estimated, put into tables, the study repeated.

The truth that the thermocouples see is a fifth cooler than every table says (COOLER): of the size of the tables'
sigma, as flights have found. The pushover-pullup at Mach 20 is fitted at the points of the
windward side and at the OMS pod, the flap manoeuvre at Mach 16 at elevon and body flap; each estimate goes through
`update-tables`. Then every study of STUDIES is made with the vehicle before and after.
"""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path

import click

from benchmarks.measure import Figure, save
from sim_heating.base.files import read_json
from sim_heating.cli import main

ROOT = Path(__file__).resolve().parent.parent
STUDIES = ("alpha_expansion", "cg_expansion")
COOLER = -0.2
FITTED = {
    "popu_mach20": ("V07T9975", "NOSECAP", "WING_LE", "NOSE_HRSI"),
    "flap_mach16": ("BODYFLAP", "V07T9730"),
}
DOCUMENTED = ROOT / "docs" / "images"
PICTURES = {
    "alpha_expansion": ("before_after_alpha", "before_after_cross_range", "next_flight", "map_alpha"),
    "cg_expansion": ("before_after_cg",),
}
"""Pictures of the document docs/how_to/envelope.md."""


def run() -> list[Figure]:
    """Fly, estimate, update, plan."""
    with tempfile.TemporaryDirectory() as folder:
        home = Path(folder)
        vehicle = revised_vehicle(home)
        figures, results = [], {}
        for name in STUDIES:
            _command(
                "plan", ROOT / "scenarios" / "studies" / f"{name}.toml", "--vehicle", vehicle, "--out", home / name
            )
            found = read_json(home / name / "study.json")
            results[name] = found["envelope"]["boundaries"] | {"before": found["envelope"]["before"]}
            figures += _figures(name, found)
            for picture in PICTURES[name]:
                shutil.copy(home / name / "envelope" / f"{picture}.png", DOCUMENTED / f"envelope_{picture}.png")
    save("envelope", figures, {"studies": results})
    return figures


def revised_vehicle(home: Path) -> Path:
    """The Orbiter after the flights: its directory."""
    vehicle: Path | None = None
    for name, points in FITTED.items():
        text = (ROOT / "scenarios" / f"{name}.toml").read_text(encoding="utf-8")
        lines = [line for line in text.splitlines() if not line.startswith("control_points")]
        whole = "\n".join(lines).replace("[trajectory]\n", f"control_points = {list(points)}\n[trajectory]\n", 1)
        (home / f"{name}.toml").write_text(f'{whole}\n[truth]\nparameters = {{ "ratio.scale" = {COOLER} }}\n')
        _command("synthesize", home / f"{name}.toml", "--out", home / name)
        for point in points:
            fit = home / f"{name}_{point}"
            _command("estimate", home / name / point, "--out", fit)
            if vehicle is None:
                _command("update-tables", fit, "--vehicle", "orbiter", "--out", home / "revised")
                vehicle = home / "revised" / "orbiter"
            else:
                _command("update-tables", fit, "--vehicle", vehicle)
    assert vehicle is not None  # there are estimates
    return vehicle


def _command(*arguments: object) -> None:
    status = main([str(a) for a in arguments])
    if status != 0:
        raise click.ClickException(f"sim-heating {arguments[0]} ended with {status}")


def _figures(study: str, found: dict) -> list[Figure]:
    figures = []
    before = found["envelope"]["before"]
    for name, after in found["envelope"]["boundaries"].items():
        for which in ("nominal", "conservative"):
            a, b = before[name]["area"][which], after["area"][which]
            figures.append(
                Figure(f"{study}, {name}: area allowed ({which}), after the flight", b, "", note=f"{a:.4g} before")
            )
    return figures
