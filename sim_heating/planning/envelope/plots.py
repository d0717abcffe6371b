"""Pictures of an envelope: maps, boundaries, two revisions side by side, and the ranking of manoeuvres."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from sim_heating.base.arrays import BoolArray, FloatArray
from sim_heating.base.report.figure import new_figure, replaced_if_undrawable, save_figure
from sim_heating.planning.envelope import envelope
from sim_heating.planning.envelope.boundary import END_OF_STUDY
from sim_heating.planning.envelope.margins import EvaluatedCase
from sim_heating.planning.envelope.next_flight import RankedManoeuvre
from sim_heating.planning.envelope.tables import NOTHING, edge_limits

LABELS = {
    "alpha_offset_deg": "offset of angle of attack, deg",
    "alpha_station": "Mach number",
    "station_alpha_deg": "angle of attack, deg",
    "alpha_stretch": "stretch of the schedule over Mach number, factor",
    "drag_factor": "reference drag over the nominal",
    "cross_range_km": "cross-range, km",
    "cg_fraction": "centre of gravity from the nose, over length",
    "bodyflap_deg": "body flap, deg",
    "cm_shift": "shift of pitching moment Cm",
    "mass_kg": "mass, kg",
    "density_factor": "density over the nominal",
    "lateral_cg_m": "lateral centre of gravity, m",
}
"""Labels of the axes, by variable of a case."""
FASTEST_MACH = 100.0
"""A station above this is a velocity [m/s]."""
MOST_LIMITS = 7
"""Largest number of limits in a map over one axis: those with the least margins."""
COLOURS = [f"C{i}" for i in range(10)]
HEAD_WIDTH = 70
"""Characters of a line above one of several panels."""


@dataclass(frozen=True)
class DrawnBand:
    """Half the width of a band that is drawn, in sigma, and whether that is by the ratio tables alone."""

    sigmas: float
    by_tables: bool = True

    @property
    def what(self) -> str:
        """What the sigma is of."""
        return "the tables" if self.by_tables else "all temperatures"

    def describe(self) -> str:
        """The band in words."""
        return f"{self.sigmas:g} sigma {'of the ratio tables' if self.by_tables else 'by all that is uncertain'}"


@replaced_if_undrawable
def draw_map(path: Path, title: str, flown: envelope.FlownMap, band: DrawnBand) -> None:
    """Draw a map: over one axis the margins with their bands, over two the least margin and the name of its limit."""
    axes = flown.declared.axes
    if len(axes) == 1:
        _draw_line_map(path, title, flown, band)
    else:
        _draw_plane_map(path, title, flown)


def _draw_line_map(path: Path, title: str, flown: envelope.FlownMap, band: DrawnBand) -> None:
    figure, axes = new_figure(9.0, 6.0, 1)
    (name, values), a = next(iter(flown.declared.axes.items())), axes[0]
    good = [(v, f) for v, f in zip(values, flown.flights, strict=True) if f.error is None]
    hot = {n for _, f in good for n, m in f.margins.items() if m.unit == "K"}
    least = sorted(hot, key=lambda n: min(f.margins[n].margin for _, f in good))[:MOST_LIMITS]
    for colour, limit in zip(COLOURS, least, strict=False):
        x, y, sigma = np.array([(v, f.margins[limit].margin, f.margins[limit].sigma) for v, f in good]).T
        s = band.sigmas * sigma
        a.plot(x, y, "o-", color=colour, markersize=3.5, label=limit)
        a.fill_between(x, y - s, y + s, color=colour, alpha=0.10, linewidth=0)
    _mark_excluded(a, list(zip(values, flown.flights, strict=True)))
    a.axhline(0.0, color="k", linewidth=1.0)
    a.set_xlabel(LABELS[name])
    a.set_ylabel(f"margin to the limit, K (band: {band.describe()})")
    figure.legend(*a.get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=8)
    save_figure(figure, path, title, axes)


def _mark_excluded(a: Axes, flights: Sequence[tuple[float, EvaluatedCase]]) -> None:
    """Mark places on the axis that could not be flown, are out of trim, or lie outside a table."""
    excluded = [x for x, f in flights if f.error is not None or f.other_violations]
    if excluded:
        a.plot(excluded, np.zeros(len(excluded)), "kx", markersize=9, label="no flight, no trim, or outside a table")


def _draw_plane_map(path: Path, title: str, flown: envelope.FlownMap) -> None:
    figure, axes = new_figure(9.0, 6.5, 1)
    (first, xs), (second, ys) = flown.declared.axes.items()
    least = [f.least for f in flown.flights]
    shape = (len(xs), len(ys))
    margin = np.array([np.nan if n is None or n[1].unit != "K" else n[1].margin for n in least]).reshape(shape)
    size = 2.0 * max(float(np.nanmax(np.abs(margin))), 1.0) if np.any(np.isfinite(margin)) else 1.0
    a = axes[0]
    shown = a.pcolormesh(xs, ys, margin.T, shading="nearest", cmap="RdBu", vmin=-size, vmax=size)
    figure.colorbar(shown, label="least margin of all temperatures, K")
    for (i, j), n, f in zip(np.ndindex(shape), least, flown.flights, strict=True):
        limit = "no flight" if f.error is not None else "" if n is None else n[0]
        text = limit.replace(" ", "\n", 1)
        value = "" if np.isnan(margin[i, j]) else f"\n{margin[i, j]:.0f} K"
        a.text(xs[i], ys[j], text + value, ha="center", va="center", fontsize=8)
    a.set_xlabel(LABELS[first])
    a.set_ylabel(LABELS[second])
    save_figure(figure, path, title, axes)
    a.grid(visible=False)


def _colours_of_limits(boundaries: Iterable[envelope.FlownBoundary]) -> dict[str, str]:
    """Colour of each limit that holds at an edge of boundaries, in the order of their names."""
    names = sorted({n for b in boundaries for s in b.segments for n in edge_limits(s)} - {""})
    colours = dict(zip([n for n in names if n != END_OF_STUDY], cycle(COLOURS), strict=False)) | {END_OF_STUDY: "0.5"}
    return {n: colours[n] for n in names}


@replaced_if_undrawable
def draw_boundaries(path: Path, title: str, boundaries: Mapping[str, envelope.FlownBoundary], band: DrawnBand) -> None:
    """Draw a boundary, or that of several revisions side by side; the colour of an edge is that of its limit.

    boundaries : name of the revision -> its boundary
    """
    first = next(iter(boundaries.values())).declared
    rows, columns = len(first.members()), len(boundaries)
    width = 8.5 if columns == 1 else 6.6 * columns
    figure, grid = new_figure(width, 5.2 * rows, rows, columns, sharex=True, sharey=True, squeeze=False)
    colours = _colours_of_limits(boundaries.values())
    for column, (label, boundary) in enumerate(boundaries.items()):
        for row, member in enumerate(first.members()):
            a, segments = grid[row, column], boundary.segments_of(member)
            _draw_boundary(a, segments, colours)
            head = "" if columns == 1 else textwrap.fill(label, HEAD_WIDTH)
            family = "" if first.family is None else f"{LABELS[first.family]} {member:g}"
            a.set_title("\n".join(filter(None, (head, family))), fontsize=8.5)
            a.set_xlabel(LABELS[first.along])
            a.set_ylabel(LABELS[first.sought])
            _name_speeds(a, segments)
    if first.along == "alpha_station":
        grid[0, 0].invert_xaxis()
    handles = _handles(grid[0, 0], colours, band)
    figure.legend(handles=handles, loc="outside lower center", ncols=2, fontsize=8)
    save_figure(figure, path, title, grid)


def _handles(a: Axes, colours: Mapping[str, str], band: DrawnBand) -> list[Any]:
    """Handles of the legend: an edge, the limits on it, and the bands."""
    handles: list[Any] = a.plot(
        [], [], "-", color="0.3", linewidth=1.0, label="edge with the tables as declared; its limit:"
    )
    for name, colour in colours.items():
        handles += a.plot([], [], "x" if name.startswith(NOTHING) else "o", color=colour, label=name)
    for label, strength in (("hotter", 0.35), ("cooler", 0.12)):
        label = f"allowed with {band.what} {band.sigmas:g} sigma {label}"
        handles.append(a.fill_between([], [], [], color="tab:green", alpha=strength, label=label))
    return handles


def _name_speeds(a: Axes, segments: Sequence[envelope.BoundarySegment]) -> None:
    """Write velocities below the Mach numbers of stations; a schedule over velocity has them as its axis."""
    speeds = [s.speed_m_s for s in segments]
    if segments[-1].position > FASTEST_MACH:
        a.set_xlabel("velocity, m/s")
    elif all(v is not None for v in speeds):
        ticks = [f"{s.position:g}\n{v / 1e3:.1f}" for s, v in zip(segments, speeds, strict=True) if v is not None]
        a.set_xticks([s.position for s in segments], ticks)
        a.set_xlabel("Mach number, velocity in km/s")


def _draw_boundary(a: Axes, segments: Sequence[envelope.BoundarySegment], colours: Mapping[str, str]) -> None:
    """Draw the bands, then each edge as a line with points in the colour of the limit there."""
    x = np.array([s.position for s in segments])
    for which, strength in ((envelope.OPTIMISTIC, 0.12), (envelope.CONSERVATIVE, 0.30)):
        low, high = _ends(segments, which)
        a.fill_between(x, low, high, color="tab:green", alpha=strength, linewidth=0)
        isolated = _isolated(np.isfinite(low))
        a.vlines(x[isolated], low[isolated], high[isolated], color="tab:green", alpha=strength, linewidth=5.0)
    low, high = _ends(segments, envelope.NOMINAL)
    edges = ((low, 0), (high, 1))
    for y, side in edges[1:] if segments[0].greatest else edges:
        a.plot(x, y, "-", color="0.3", linewidth=1.0)
        for s, value in zip(segments, y, strict=True):
            a.plot(s.position, value, "o", color=colours.get(edge_limits(s)[side], "k"), markersize=6)
    for s in segments:
        if s.ends(envelope.NOMINAL)[0] is None:
            closest = s.allowed[envelope.NOMINAL].least_violated
            at = 0.0 if s.greatest or closest is None else closest.at
            a.plot(s.position, at, "x", color=colours.get(edge_limits(s)[0], "k"), markersize=8)


def _isolated(is_allowed: BoolArray) -> BoolArray:
    """(position,) whether an allowed position has no allowed neighbour, so that no band is filled there."""
    padded = np.concatenate(([False], is_allowed, [False]))
    return np.asarray(is_allowed & ~padded[:-2] & ~padded[2:])


def _ends(segments: Sequence[envelope.BoundarySegment], which: str) -> tuple[FloatArray, FloatArray]:
    """(place,) low and high ends; NaN where nothing is allowed."""
    low, high = np.array([s.ends(which) for s in segments], dtype=float).T
    return low, high


@replaced_if_undrawable
def draw_ranking(path: Path, title: str, ranked: Sequence[RankedManoeuvre]) -> None:
    """Draw the sigma of the temperatures at the edges of each boundary, now and after each manoeuvre."""
    names = [n for n in ranked[0].conservative_area if any(n in r.sigma_K for r in ranked)]
    figure, axes = new_figure(9.5, 2.2 + 0.7 * len(ranked), 1, max(len(names), 1), sharey=True)
    for a, name in zip(axes, names, strict=False):
        y = np.arange(len(ranked))
        now, after = np.array([r.sigma_K.get(name, (np.nan, np.nan)) for r in ranked]).T
        a.barh(y, now, 0.7, color="0.85", label="now")
        a.barh(y, after, 0.45, color="tab:blue", label="after the manoeuvre")
        a.set_xlabel(f"boundary {name}:\nmean sigma of the limiting temperatures, K")
    axes[0].set_yticks(np.arange(len(ranked)), [textwrap.fill(r.forecast.candidate.name, 26) for r in ranked])
    axes[0].invert_yaxis()
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=2, fontsize=8)
    save_figure(figure, path, title, axes)
