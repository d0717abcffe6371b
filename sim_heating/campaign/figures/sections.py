"""Figure 2: cross sections of the heat shield at the control points of the paper, with the depths of thermocouples."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from sim_heating.base.arrays import FloatArray
from sim_heating.base.report.figure import new_figure
from sim_heating.campaign.figures.figure_file import PaperFigure, finished
from sim_heating.campaign.figures.flown_data import FlownData, LeftOut
from sim_heating.inputs.record import Record

LEAST_SHARE = 0.09
"""Least drawn height of a layer, over that of the section: a coating would not be seen on the scale of the tile."""
COLORS = ("#4d4d4d", "#f2e3c6", "#c7783f", "#dcdcdc", "#a9bdd1", "#6b5b4b", "#e8d0a0", "#b9cfa8", "#d7c4e0", "#8f8f8f")
DARK = ("#4d4d4d", "#6b5b4b", "#c7783f")
MM = 1e3


def sections(data: FlownData) -> PaperFigure:
    """Figure 2: section of each control point of the paper that was flown, layers from the surface down."""
    shown: dict[str, Record] = {}
    for region in data.points:
        try:
            shown[data.points[region]] = data.records_of(region)[0][1]
        except LeftOut:
            continue
    if not shown:
        raise LeftOut(f"no flight has a record of {', '.join(data.points.values())}; name points by --point PART=NAME")
    drawn = new_figure(3.9 * len(shown) + 0.4, 6.4, 1, len(shown), squeeze=False)
    tables: dict[str, dict[str, Any]] = {}
    materials = list(dict.fromkeys(layer.material for r in shown.values() for layer in r.declared.stack.layer))
    colors = {material: COLORS[i % len(COLORS)] for i, material in enumerate(materials)}
    for a, (name, record) in zip(drawn[1].flat, shown.items(), strict=True):
        tables |= _draw_section(a, name, record, colors)
    title = "sections of the heat shield, thicknesses and thermocouple depths in mm (layers not to scale)"
    return finished(2, title, drawn, tables)


def _draw_section(a: Axes, name: str, record: Record, colors: Mapping[str, str]) -> dict[str, dict[str, Any]]:
    """Draw one section, surface at the top; tables of its layers and thermocouples."""
    layers = record.declared.stack.layer
    thickness = np.array([layer.thickness_m for layer in layers])
    faces = np.append(0.0, np.cumsum(thickness))
    drawn = _drawn_faces(thickness)
    for i, layer in enumerate(layers):
        color = colors[layer.material]
        a.barh(-drawn[i], 1.0, -(drawn[i + 1] - drawn[i]), left=0.0, align="edge", color=color, edgecolor="0.3")
        text = f"{layer.material}  {layer.thickness_m * MM:.3g}"
        a.text(
            0.5,
            -0.5 * (drawn[i] + drawn[i + 1]),
            text,
            ha="center",
            va="center",
            fontsize=8.5,
            color="white" if color in DARK else "black",
        )
    depths = [sensor.depth_m for sensor in record.sensors]
    at = np.interp(depths, faces, drawn)
    for sensor, y, label_y in zip(record.sensors, at, _apart(at), strict=True):
        a.plot([1.0, 1.08, 1.14], [-y, -y, -label_y], color="tab:red", linewidth=1.0)
        a.plot([1.0], [-y], "o", color="tab:red", markersize=5)
        text = f"{sensor.name}\n{sensor.depth_m * MM:.3g}"
        a.text(1.16, -label_y, text, ha="left", va="center", fontsize=8, linespacing=1.1)
    back = record.declared.stack.back
    a.text(
        0.5,
        -1.03,
        "back face adiabatic" if isinstance(back, str) else "back face exchanges heat",
        ha="center",
        va="top",
        fontsize=8,
        color="0.3",
    )
    a.set_xlim(-0.03, 1.9)
    a.set_ylim(-1.08, 0.03)
    a.set_title(name, fontsize=11)
    a.set_axis_off()
    return {
        f"{name}_layers": {
            "material": [layer.material for layer in layers],
            "thickness_m": thickness,
            "outer_face_m": faces[:-1],
        },
        f"{name}_thermocouples": {"sensor": [sensor.name for sensor in record.sensors], "depth_m": np.array(depths)},
    }


def _drawn_faces(thickness: FloatArray) -> FloatArray:
    """(layer + 1,) drawn depths of the faces, 0 to 1: in order, no layer below LEAST_SHARE, the rest in proportion."""
    least = min(LEAST_SHARE, 0.5 / len(thickness))
    heights = np.full(len(thickness), least)
    heights += (1.0 - heights.sum()) * thickness / thickness.sum()
    return np.append(0.0, np.cumsum(heights))


def _apart(positions: FloatArray, least: float = 0.075) -> FloatArray:
    """Places of labels in the order of depth, none nearer to the one before than `least`."""
    order, placed = np.argsort(positions), np.array(positions)
    for before, after in pairwise(order):
        placed[after] = max(placed[after], placed[before] + least)
    return placed
