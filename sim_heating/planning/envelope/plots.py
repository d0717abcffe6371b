"""Pictures of maps, boundaries, two revisions side by side, and the worth of manoeuvres; each stands alone."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from itertools import cycle
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from sim_heating.base.report.figure import new_figure, save_figure
from sim_heating.planning.envelope.boundary import END_OF_STUDY
from sim_heating.planning.envelope.envelope import MIDDLE, PERHAPS, SURE, FlownBoundary, FlownMap, Stretch
from sim_heating.planning.envelope.margins import Evaluated
from sim_heating.planning.envelope.next_flight import Ranked
from sim_heating.planning.envelope.tables import NOTHING, limits_of

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
FASTEST_MACH = 100.0
DRAWN = 7
"""Limits drawn in a map over one axis: those with the least margins."""
COLOURS = [f"C{i}" for i in range(10)]
HEAD_WIDTH = 70
"""Characters of a line above one of several panels."""


def draw_map(path: Path, title: str, flown: FlownMap, sigmas: float) -> None:
    """Margins over one axis, with their bands; over two, the least margin, its limit named."""
    axes = flown.declared.axes
    if len(axes) == 1:
        _draw_line_map(path, title, flown, sigmas)
    else:
        _draw_plane_map(path, title, flown)


def _draw_line_map(path: Path, title: str, flown: FlownMap, sigmas: float) -> None:
    figure, axes = new_figure(9.0, 6.0, 1)
    (name, values), a = next(iter(flown.declared.axes.items())), axes[0]
    good = [(x, f) for x, f in zip(values, flown.flights, strict=True) if f.error is None]
    hot = {n for _, f in good for n, m in f.margins.items() if m.unit == "K"}
    least = sorted(hot, key=lambda n: min(f.margins[n].margin for _, f in good))[:DRAWN]
    x = np.array([v for v, _ in good])
    for colour, limit in zip(COLOURS, least, strict=False):
        y = np.array([f.margins[limit].margin for _, f in good])
        s = sigmas * np.array([f.margins[limit].sigma for _, f in good])
        a.plot(x, y, "o-", color=colour, markersize=3.5, label=limit)
        a.fill_between(x, y - s, y + s, color=colour, alpha=0.10, linewidth=0)
    _mark_refused(a, [(v, f) for v, f in zip(values, flown.flights, strict=True)])
    a.axhline(0.0, color="k", linewidth=1.0)
    a.set_xlabel(LABELS[name])
    a.set_ylabel(f"margin to the limit, K (band: {sigmas:g} sigma of the ratio tables)")
    figure.legend(*a.get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=8)
    save_figure(figure, path, title, axes)


def _mark_refused(a: Axes, flights: Sequence[tuple[float, Evaluated]]) -> None:
    """Places that were not flown, or are out of trim or outside a table: crosses on the axis."""
    refused = [x for x, f in flights if f.error is not None or f.passed_other]
    if refused:
        a.plot(refused, np.zeros(len(refused)), "kx", markersize=9, label="no flight, no trim, or outside a table")


def _draw_plane_map(path: Path, title: str, flown: FlownMap) -> None:
    figure, axes = new_figure(9.0, 6.5, 1)
    (first, xs), (second, ys) = flown.declared.axes.items()
    least = [f.least for f in flown.flights]
    shape = (len(xs), len(ys))
    margin = np.array([np.nan if n is None or n[1].unit != "K" else n[1].margin for n in least]).reshape(shape)
    limit = [
        ("no flight" if f.error is not None else "" if n is None else n[0])
        for n, f in zip(least, flown.flights, strict=True)
    ]
    size = 2.0 * max(float(np.nanmax(np.abs(margin))), 1.0) if np.any(np.isfinite(margin)) else 1.0
    a = axes[0]
    shown = a.pcolormesh(xs, ys, margin.T, shading="nearest", cmap="RdBu", vmin=-size, vmax=size)
    figure.colorbar(shown, label="least margin of all temperatures, K")
    for k, (i, j) in enumerate(np.ndindex(shape)):
        text = limit[k].replace(" ", "\n", 1)
        value = "" if np.isnan(margin[i, j]) else f"\n{margin[i, j]:.0f} K"
        a.text(xs[i], ys[j], text + value, ha="center", va="center", fontsize=8)
    a.set_xlabel(LABELS[first])
    a.set_ylabel(LABELS[second])
    save_figure(figure, path, title, axes)
    a.grid(visible=False)


def draw_boundaries(path: Path, title: str, found: Mapping[str, FlownBoundary], sigmas: float) -> None:
    """A boundary, or the same of several revisions, side by side; edges are coloured by the limit that makes them.

    found : name of the revision -> its boundary
    """
    first = next(iter(found.values())).declared
    rows, columns = len(first.members()), len(found)
    width = 8.5 if columns == 1 else 6.6 * columns
    figure, grid = new_figure(width, 5.2 * rows, rows, columns, sharex=True, sharey=True, squeeze=False)
    names = sorted({n for b in found.values() for s in b.stretches for n in limits_of(s)} - {""})
    colours = dict(zip([n for n in names if n != END_OF_STUDY], cycle(COLOURS), strict=False)) | {END_OF_STUDY: "0.5"}
    for column, (label, boundary) in enumerate(found.items()):
        for row, member in enumerate(first.members()):
            a, own = grid[row, column], boundary.of(member)
            _draw_boundary(a, own, colours)
            heads = [] if columns == 1 else [textwrap.fill(label, HEAD_WIDTH)]
            heads += [] if first.family is None else [f"{LABELS[first.family]} {member:g}"]
            a.set_title("\n".join(heads), fontsize=8.5)
            a.set_xlabel(LABELS[first.along])
            a.set_ylabel(LABELS[first.greatest or first.across])
            _name_speeds(a, own)
    if first.along == "alpha_station":
        grid[0, 0].invert_xaxis()
    a = grid[0, 0]
    handles = a.plot([], [], "-", color="0.3", linewidth=1.0, label="edge with the tables as they stand; its limit:")
    for n in names:
        handles += a.plot([], [], "x" if n.startswith(NOTHING) else "o", color=colours[n], label=n)
    for words, strength in (
        (f"allowed with the tables {sigmas:g} sigma hotter", 0.35),
        (f"allowed with the tables {sigmas:g} sigma cooler", 0.12),
    ):
        handles.append(a.fill_between([], [], [], color="tab:green", alpha=strength, label=words))
    figure.legend(handles=handles, loc="outside lower center", ncols=2, fontsize=8)
    save_figure(figure, path, title, grid)


def _name_speeds(a: Axes, stretches: Sequence[Stretch]) -> None:
    """Velocities under the Mach numbers of stations; a schedule over velocity names them itself."""
    speeds = [s.speed_m_s for s in stretches]
    if stretches[-1].along > FASTEST_MACH:
        a.set_xlabel("velocity, m/s")
    elif all(v is not None for v in speeds):
        ticks = [f"{s.along:g}\n{v / 1e3:.1f}" for s, v in zip(stretches, speeds, strict=True) if v is not None]
        a.set_xticks([s.along for s in stretches], ticks)
        a.set_xlabel("Mach number, velocity in km/s")


def _draw_boundary(a: Axes, stretches: Sequence[Stretch], colours: Mapping[str, str]) -> None:
    """Bands, then each edge as a line with points in the colour of the limit there."""
    x = np.array([s.along for s in stretches])
    for which, strength in ((PERHAPS, 0.12), (SURE, 0.30)):
        low, high = _ends(stretches, which)
        a.fill_between(x, low, high, color="tab:green", alpha=strength, linewidth=0)
        alone = _alone(np.isfinite(low))
        a.vlines(x[alone], low[alone], high[alone], color="tab:green", alpha=strength, linewidth=5.0)
    low, high = _ends(stretches, MIDDLE)
    for y, side in ((low, 0), (high, 1)):
        if side == 0 and stretches[0].greatest:
            continue
        a.plot(x, y, "-", color="0.3", linewidth=1.0)
        for s, value in zip(stretches, y, strict=True):
            a.plot(s.along, value, "o", color=colours.get(limits_of(s)[side], "k"), markersize=6)
    for s in stretches:
        if s.value(MIDDLE)[0] is None:
            closed = limits_of(s)[0]
            bad = s.allowed[MIDDLE].least_bad
            at = 0.0 if s.greatest or bad is None else bad.at
            a.plot(s.along, at, "x", color=colours.get(closed, "k"), markersize=8)


def _alone(known: np.ndarray) -> np.ndarray:
    """Which of the known places have no known neighbour, so that nothing is filled there."""
    beside = np.concatenate(([False], known, [False]))
    return known & ~beside[:-2] & ~beside[2:]


def _ends(stretches: Sequence[Stretch], which: str) -> tuple[np.ndarray, np.ndarray]:
    ends = [s.value(which) for s in stretches]
    return tuple(np.array([np.nan if e[k] is None else e[k] for e in ends], dtype=float) for k in (0, 1))  # type: ignore[return-value]


def draw_ranking(path: Path, title: str, ranked: Sequence[Ranked]) -> None:
    """Sigma of the temperatures at the edges of each boundary, now and after each manoeuvre."""
    names = [n for n in ranked[0].sure if any(n in r.sigma_K for r in ranked)]
    figure, axes = new_figure(9.5, 2.2 + 0.7 * len(ranked), 1, max(len(names), 1), sharey=True)
    for a, name in zip(axes, names, strict=False):
        y = np.arange(len(ranked))
        now, left = np.array([r.sigma_K.get(name, (np.nan, np.nan)) for r in ranked]).T
        a.barh(y, now, 0.7, color="0.85", label="now")
        a.barh(y, left, 0.45, color="tab:blue", label="after the manoeuvre")
        a.set_xlabel(f"boundary `{name}`:\nmean sigma of the limiting temperatures, K")
    axes[0].set_yticks(np.arange(len(ranked)), [textwrap.fill(r.prospect.candidate.name, 26) for r in ranked])
    axes[0].invert_yaxis()
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=2, fontsize=8)
    save_figure(figure, path, title, axes)
