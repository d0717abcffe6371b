"""Trim of the Orbiter: moment balance from its tables, read independently, and another program's elevons in trim."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.interpolate import RegularGridInterpolator
from scipy.optimize import brentq

from sim_heating.trajectory.aero import load_aero
from tests.support.verification.row import Row
from tests.support.verification.trajectories import ORBITER

CONTROL_MACH = 10.0
"""Highest Mach number of the tables; coefficients are held above."""


PUBLISHED_TRIM = {
    (0.66, 0.0, 0.0): (1.8, 0.3, -2.4, -5.3),
    (0.66, 0.0, 16.3): (-18.8, -19.7, -23.5, -32.7),
    (0.66, 0.03, 10.0): (5.2, 2.2, -1.0, -5.4),
    (0.67, 0.0, 0.0): (7.4, 6.6, 5.4, 3.3),
    (0.67, 0.0, 16.3): (-2.6, -3.6, -5.5, -8.3),
    (0.67, 0.03, 16.3): (6.6, 4.9, 2.7, -0.3),
}
"""Elevon in trim [deg] at alpha 30, 35, 40 and 45 deg and Mach 10 or more, by centre of gravity [-], moment found in
flight [-] and body flap [deg]; computed by another program from the source's own points, 5 deg apart."""


def _column(path: Path, keys: tuple[str, ...], name: str) -> Callable[..., float]:
    """Linear interpolation of one column of a table at its highest Mach number."""
    lines = [line for line in path.read_text().splitlines() if not line.startswith("#")]
    found = {
        tuple(float(row[k]) for k in keys): float(row[name])
        for row in csv.DictReader(lines)
        if float(row["mach"]) == CONTROL_MACH
    }
    axes = [np.unique([place[i] for place in found]) for i in range(len(keys))]
    values = np.array([found[place] for place in sorted(found)]).reshape([len(a) for a in axes])
    table = RegularGridInterpolator(axes, values)
    return lambda *place: float(table([place])[0])


def moment_about_cg(alpha_deg: float, elevon_deg: float, bodyflap_deg: float, cg: float = 0.667) -> float:
    """Cm + CN (x_cg - 0.65 L) / c of the three tables at Mach 10."""
    total = {}
    for name in ("CN", "Cm"):
        total[name] = (
            _column(ORBITER / "aero" / "longitudinal.csv", ("alpha_deg",), name)(alpha_deg)
            + _column(ORBITER / "aero" / "elevon.csv", ("alpha_deg", "deflection_deg"), name)(alpha_deg, elevon_deg)
            + _column(ORBITER / "aero" / "bodyflap.csv", ("alpha_deg", "deflection_deg"), name)(alpha_deg, bodyflap_deg)
        )
    return total["Cm"] + total["CN"] * (cg - 0.65) * 32.77362 / 12.05992


def rows() -> list[Row]:
    """All of this subject."""
    aero = load_aero(ORBITER)
    source, is_ = "tables read and interpolated independently, moment balance", "rounding"
    found = []
    for alpha, flap in ((40.0, 7.0), (35.0, 0.0), (45.0, 10.0), (30.0, 0.0)):
        elevon = float(brentq(lambda e, a=alpha, f=flap: moment_about_cg(a, e, f), -35.0, 20.0, xtol=1e-10))
        got = aero.trim_elevon_deg(12.0, alpha, flap)
        found.append(
            Row(
                f"elevon in trim at Mach 12, {alpha:g} deg, body flap {flap:g} deg",
                elevon,
                got,
                1e-6,
                "deg",
                source,
                is_,
            )
        )
    lift = 1.205 * math.cos(math.radians(40.0)) - 0.0608 * math.sin(math.radians(40.0))
    book = "Aerodynamic Design Data Book, Mach 10, 40 deg: CN 1.205, CA 0.0608"
    found.append(
        Row(
            "lift coefficient at Mach 10, 40 deg",
            lift,
            aero.coefficients(10.0, 40.0)[0],
            5e-4,
            "-",
            book,
            "digits printed",
        )
    )
    source, is_ = "another program, from the own points of the data book", "printed to 0.1 deg"
    for (cg, shift, flap), published in PUBLISHED_TRIM.items():
        flown = aero.with_changes(cg_fraction=cg, cm_shift=shift)
        for alpha, elevon in ((35.0, published[1]), (45.0, published[3])):
            name = f"elevon in trim, {alpha:g} deg, flap {flap:g} deg, centre of gravity {cg:g}, Cm shift {shift:g}"
            found.append(Row(name, elevon, flown.trim_elevon_deg(12.0, alpha, flap), 0.06, "deg", source, is_))
    return found
