"""An optimal entry as a part of a study."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import numpy as np

from sim_heating.errors import InputError
from sim_heating.files import write_csv
from sim_heating.page import Table
from sim_heating.planning.optimal import ROUNDS, OptimalEntry, fly_optimal
from sim_heating.planning.optimal_plot import draw_optimal
from sim_heating.planning.plan import Engine, Found, Part, Picture
from sim_heating.planning.study import Study
from sim_heating.progress import Progress

PICTURE, CONDITIONS = "optimal_entry.png", "optimal_conditions.csv"


def optimal_part(study: Study, folder: Path, _engine: Engine, progress: Progress) -> Found:
    """Find the entry of largest cross-range that a study's [optimal] asks for.

    raises : RunError where no flight is found that keeps the limits
    """
    asked = study.optimal()
    if asked is None:
        raise InputError(f"{study.path}: has no [optimal]")
    done = [0]

    def told(line: str) -> None:
        done[0] += 1
        progress(done[0] / ROUNDS, f"round {done[0]}: {line}")

    entry = fly_optimal(asked, progress=told)
    draw_optimal(folder / PICTURE, f"{study.title}\n{study.stamp}", {"optimal": entry})
    write_csv(
        folder / CONDITIONS, entry.conditions.columns, ".10g", {"study": study.hash, "vehicle": study.vehicle.name}
    )
    tables = (Table(HEADS, _rows(entry), "Peak temperatures along the optimal entry [K]"),) if entry.peaks else ()
    head = f"cross-range {entry.cross_range_deg:.3f} deg, {entry.cross_range_km:.0f} km; {entry.status}"
    picture = Picture(PICTURE, "The optimal entry: ground track, altitude, angles, temperatures; limits dotted.")
    return Found(_data(entry), tables, (picture,), (head, *entry.notes))


OPTIMAL = Part(optimal_part, lambda _: (PICTURE, CONDITIONS))
HEADS = ("control point", "surface", "limit", "bondline", "limit")


def _rows(entry: OptimalEntry) -> list[tuple[str, ...]]:
    return [
        (
            p.point, f"{p.surface_K:.0f}", f"{p.surface_limit_K:.0f}" if np.isfinite(p.surface_limit_K) else "-",
            f"{p.bondline_K:.0f}", "-" if p.bondline_limit_K is None else f"{p.bondline_limit_K:.0f}",
        )
        for p in entry.peaks
    ]  # fmt: skip


def _data(entry: OptimalEntry) -> dict[str, object]:
    finite = {"surface_limit_K"}
    return {
        "cross_range_deg": entry.cross_range_deg,
        "cross_range_km": entry.cross_range_km,
        "duration_s": float(entry.motion.duration_s),
        "status": entry.status,
        "held_back_by": entry.binding,
        "peaks": [
            {k: None if k in finite and not np.isfinite(v) else v for k, v in asdict(p).items()} for p in entry.peaks
        ],
        "notes": list(entry.notes),
    }
