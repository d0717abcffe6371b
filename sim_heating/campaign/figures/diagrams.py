"""Figures 1 and 3: the systems approach and the estimator as boxes and arrows, in the program's own words."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import FancyBboxPatch

from sim_heating.base.report.figure import MANOEUVRE_NAMES, new_figure
from sim_heating.campaign.figures.figure_file import PaperFigure, finished
from sim_heating.campaign.figures.flown_data import FlownData

WIDTH, HEIGHT = 2.5, 1.0
"""Size of a box, in units of the positions."""
COLORS = {"data": "#dbe9f6", "model": "#e6f2dc", "estimate": "#fdebd0", "result": "#f3e3f0"}
CHARACTERS = 25
"""Characters of a line in a box."""


@dataclass(frozen=True)
class Box:
    """A box of a diagram: its middle, its kind (a key of COLORS), heading and text."""

    x: float
    y: float
    kind: str
    head: str
    text: str = ""


Arrow = tuple[str, str, str, float]
"""From, to, label, and how far the arrow bends: 0 straight, else its curvature."""


def systems_approach(data: FlownData) -> PaperFigure:
    """Figure 1: from vehicle and wind tunnel to the flight envelope, by way of flight test manoeuvres."""
    kinds = dict.fromkeys(m.kind for f in data.flights for m in f.manoeuvres)
    names = ", ".join(MANOEUVRE_NAMES.get(kind, kind) for kind in kinds) or "none stated"
    records = sum(len(f.records) for f in data.flights)
    flown = f"{', '.join(f.name for f in data.flights)}: {sum(len(f.manoeuvres) for f in data.flights)} manoeuvres"
    boxes = {
        "design": Box(0.0, 4.0, "data", "Vehicle", "stacks, control points, limits"),
        "tunnel": Box(3.6, 4.0, "data", "Wind tunnel and theory", "ratio-tables: scaled to flight"),
        "tables": Box(3.6, 2.4, "model", "Heating-ratio tables", "alpha, beta, log10 Re, elevon, body flap"),
        "simulator": Box(0.0, 2.4, "model", "Simulator", "run, fmu: heating and one-dimensional conduction"),
        "envelope": Box(-3.6, 2.4, "result", "Flight envelope", "plan: margins, cross range, centre of gravity"),
        "flight": Box(-3.6, 0.6, "data", "Flight tests", f"{names}. {flown}"),
        "records": Box(0.0, 0.6, "data", "Thermocouples", f"{records} records of embedded thermocouples"),
        "estimator": Box(3.6, 0.6, "estimate", "HEATEST", "estimate, close-loop: derivatives and effects with bounds"),
    }
    arrows: list[Arrow] = [
        ("design", "simulator", "thermal model", 0.0),
        ("tunnel", "tables", "prior", 0.0),
        ("tables", "simulator", "heating", 0.0),
        ("simulator", "envelope", "temperatures", 0.0),
        ("envelope", "flight", "next manoeuvres", 0.0),
        ("flight", "records", "measured", 0.0),
        ("records", "estimator", "readings", 0.0),
        ("estimator", "tables", "update-tables", 0.0),
        ("simulator", "estimator", "same equations", 0.0),
    ]
    title = "systems approach to envelope expansion, with the commands of each step"
    return _diagram(1, title, boxes, arrows)


def estimator(_: FlownData) -> PaperFigure:
    """Figure 3: the estimator, a time loop of model and Kalman update within a loop of parameter updates."""
    boxes = {
        "initial": Box(-3.8, 3.0, "data", "Initial conditions", "T, dT/d theta, P at the start of the segment"),
        "model": Box(0.0, 3.0, "model", "Model", "one step: T-, (dT/d theta)-, P- a priori; that of the simulator"),
        "kalman": Box(3.8, 3.0, "estimate", "Kalman update", "T+, (dT/d theta)+, P+ a posteriori"),
        "conditions": Box(0.0, 4.8, "data", "Flight conditions", "alpha, beta, Re, elevon, body flap, h_ref, H_r"),
        "readings": Box(3.8, 4.8, "data", "Thermocouples", "reading, its noise and the recorder's word"),
        "update": Box(0.0, 0.8, "estimate", "Parameter update", "Newton-Raphson on the likelihood of theta"),
        "result": Box(-3.8, 0.8, "result", "Estimates", "heating and thermal parameters with Cramer-Rao bounds"),
    }
    arrows: list[Arrow] = [
        ("initial", "model", "", 0.0),
        ("conditions", "model", "", 0.0),
        ("readings", "kalman", "", 0.0),
        ("model", "kalman", "prediction", -0.25),
        ("kalman", "model", "time loop", -0.25),
        ("kalman", "update", "innovations,\ntheir sensitivities", 0.0),
        ("update", "model", "theta, next\niteration", 0.0),
        ("update", "result", "converged", 0.0),
    ]
    title = "flow of the estimator; without process noise the update is left out and the innovations are residuals"
    return _diagram(3, title, boxes, arrows)


def _diagram(number: int, title: str, boxes: Mapping[str, Box], arrows: Sequence[Arrow]) -> PaperFigure:
    drawn = new_figure(10.0, 5.6, 1)
    a = drawn[1][0]
    for box in boxes.values():
        _draw_box(a, box)
    for start, end, label, bend in arrows:
        _draw_arrow(a, boxes[start], boxes[end], label, bend)
    xs, ys = [b.x for b in boxes.values()], [b.y for b in boxes.values()]
    a.set_xlim(min(xs) - 0.6 * WIDTH, max(xs) + 0.6 * WIDTH)
    a.set_ylim(min(ys) - 0.6 * HEIGHT, max(ys) + 0.6 * HEIGHT)
    a.set_axis_off()
    columns: dict[str, Any] = {
        "from": [boxes[start].head for start, *_ in arrows],
        "to": [boxes[arrow[1]].head for arrow in arrows],
        "what": [" ".join(arrow[2].split()) for arrow in arrows],
    }
    contents = {"box": [b.head for b in boxes.values()], "text": [b.text for b in boxes.values()]}
    return finished(number, title, drawn, {"": columns, "boxes": contents})


def _draw_box(a: Axes, box: Box) -> None:
    corner, shape = (box.x - WIDTH / 2, box.y - HEIGHT / 2), "round,pad=0,rounding_size=0.12"
    a.add_patch(
        FancyBboxPatch(corner, WIDTH, HEIGHT, boxstyle=shape, facecolor=COLORS[box.kind], edgecolor="0.4", zorder=2)
    )
    lines = textwrap.wrap(box.text, CHARACTERS)
    a.text(box.x, box.y + 0.30, box.head, ha="center", va="center", fontsize=10, weight="bold", zorder=3)
    a.text(box.x, box.y - 0.14, "\n".join(lines), ha="center", va="center", fontsize=8, zorder=3, linespacing=1.15)


def _draw_arrow(a: Axes, start: Box, end: Box, label: str, bend: float) -> None:
    """Draw an arrow from edge to edge of two boxes, its label at the middle."""
    first, last = _edge(start, end, bend), _edge(end, start, bend)
    style = {"arrowstyle": "-|>", "color": "0.25", "linewidth": 1.2, "connectionstyle": f"arc3,rad={bend}"}
    a.annotate("", xy=last, xytext=first, arrowprops=style, zorder=1)
    if label:
        x, y = 0.5 * (first[0] + last[0]), 0.5 * (first[1] + last[1]) + _lift(first, last, bend)
        a.text(
            x,
            y,
            label,
            ha="center",
            va="center",
            fontsize=8,
            color="0.15",
            zorder=4,
            bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.8, "alpha": 0.9},
        )


def _lift(first: tuple[float, float], last: tuple[float, float], bend: float) -> float:
    """How far above its arrow a label stands: on a sloping one nothing, beside a bent one where the bend is."""
    if bend:
        return 0.5 * bend * (first[0] - last[0])
    return 0.14 if abs(first[1] - last[1]) < 1e-9 else 0.0


def _edge(box: Box, other: Box, bend: float) -> tuple[float, float]:
    """The point where the line to another box leaves a box; a bent one leaves above or below the middle of a side."""
    dx, dy = other.x - box.x, other.y - box.y
    if bend and abs(dy) < 1e-9:
        return box.x + np.sign(dx) * WIDTH / 2, box.y - np.sign(bend * dx) * 0.22 * HEIGHT
    scale = min(WIDTH / 2 / abs(dx) if dx else np.inf, HEIGHT / 2 / abs(dy) if dy else np.inf)
    return box.x + scale * dx, box.y + scale * dy
