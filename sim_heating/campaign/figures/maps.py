"""Figures 15 and 16: where control points and interfaces of the heat shield are, and the wall temperatures across them.

An interface is one that a point declares, or else lies between a point and the nearest one upstream of it on the same
side, where their heat shields are of different kinds. There the wall is not isothermal: the film coefficient downstream
differs from that of the tables.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import SHUTTLE_MACH_M_S, Conditions
from sim_heating.base.report.figure import new_figure
from sim_heating.campaign.figures.figure_file import PaperFigure, Statement, finished
from sim_heating.campaign.figures.flown_data import POPU, FlownData, LeftOut
from sim_heating.campaign.flights import CampaignFlight
from sim_heating.inputs.points import conditions_behind_walls, excess_behind_interface, point_of_vehicle
from sim_heating.inputs.vehicle import ControlPoint, Vehicle
from sim_heating.march.history import march_points

COLORS = ("tab:blue", "tab:orange", "tab:green", "tab:red", "tab:purple", "tab:brown", "tab:cyan", "tab:olive")
FELT, CAP = "FRSI", "RCC"
"""Heat shields of the paper's interfaces: of the pod downstream, of the nose upstream."""
CAP_PEAK_MACH, LARGEST_MACH, NEAR_MACH = 13.0, 18.0, 1.5
"""Speeds over 1000 ft/s at which the paper has the cap hottest and the interface's effect largest; how near agrees."""
AT_NOSE = 0.02
"""x over L up to which a point is on neither side: the flow goes from it to both."""
SAME_PLACE_M = 0.3
"""Points nearer to each other than this share a label."""
LABEL_M, LABEL_SHARE = 4.0, 0.12
"""Length of a label along x, and its height over the height of a map."""
FEWEST_KFT_S = 2.0
"""Speed over 1000 ft/s from which wall temperatures are drawn."""


@dataclass(frozen=True)
class Interface:
    """An interface between the heat shields of two control points, upstream and downstream."""

    upstream: ControlPoint
    downstream: ControlPoint

    @property
    def declared(self) -> bool:
        """Whether the point downstream declares it."""
        interface = self.downstream.declared.interface
        return interface is not None and interface.upstream == self.upstream.name

    @property
    def materials(self) -> str:
        """Both heat shields, as `RCC/HRSI`."""
        return f"{self.upstream.declared.heat_shield}/{self.downstream.declared.heat_shield}"


def interfaces(points: Sequence[ControlPoint]) -> list[Interface]:
    """Interfaces between neighbouring control points, in the order of distance from the nose."""
    pairs, named = [], {p.name: p for p in points}
    for point in sorted(points, key=lambda p: p.position_m[0]):
        declared = point.declared.interface
        if declared is not None and declared.upstream in named:
            pairs.append(Interface(named[declared.upstream], point))
            continue
        upstream = [q for q in points if q.position_m[0] < point.position_m[0] and _same_side(point, q)]
        if not upstream:
            continue
        nearest = min(upstream, key=lambda q: float(np.linalg.norm(np.subtract(q.position_m, point.position_m))))
        if nearest.declared.heat_shield != point.declared.heat_shield:
            pairs.append(Interface(nearest, point))
    return pairs


def _same_side(point: ControlPoint, upstream: ControlPoint) -> bool:
    """Whether both are windward or both leeward; a point at the nose is upstream of all."""
    return upstream.x_over_L <= AT_NOSE or (point.position_m[2] > 0.0) == (upstream.position_m[2] > 0.0)


def _positions(points: Sequence[ControlPoint], axis: int) -> list[FloatArray]:
    """(point,) distance aft of the nose and coordinate along an axis of the vehicle [m]."""
    return [np.array([p.position_m[k] for p in points]) for k in (0, axis)]


def _draw_interfaces(a: Axes, points: Sequence[ControlPoint], axis: int) -> None:
    """Draw the interfaces between points, seen from the side with their materials, those close together once."""
    named: list[tuple[str, float]] = []
    for face in interfaces(points):
        ends = np.array([face.upstream.position_m, face.downstream.position_m])
        a.plot(ends[:, 0], ends[:, axis], color="0.45", linewidth=1.0, linestyle=":", zorder=1)
        middle = np.mean(ends[:, [0, 2]], axis=0)
        if axis == 2 and not any(t == face.materials and abs(x - middle[0]) < LABEL_M for t, x in named):
            named.append((face.materials, middle[0]))
            a.annotate(face.materials, middle, xytext=(14, -6), textcoords="offset points", fontsize=7.5, color="0.3")


def _faces(vehicle: Vehicle) -> list[Interface]:
    """Interfaces that control points declare; where none does, those between neighbours. LeftOut for none of either."""
    every = interfaces(list(vehicle.control_points.values()))
    if not every:
        raise LeftOut(f"{vehicle.name}: its control points have heat shields of one kind, so that it has no interface")
    return [face for face in every if face.declared] or every


def _statements_of(face: Interface, peak: float, most: float, excess: float, step_K: float) -> Sequence[Statement]:
    """What the paper says of an interface.

    peak, most : Mach numbers at which the upstream wall is hottest, and the heating behind it largest
    excess     : of that heating [-];  step_K : largest difference of the walls
    """
    if face.upstream.declared.heat_shield == CAP:
        return _nose_statements(peak, most, excess)
    if face.downstream.declared.heat_shield == FELT:
        paper = "from the pod's tile to its felt the wall temperature falls by a step"
        return [Statement(91, paper, f"{face.downstream.name}: {step_K:.0f} K at most", step_K > 0.0)]
    return []


def control_points(data: FlownData) -> PaperFigure:
    """Figure 15: the control points of the vehicle from the side and from above, by heat shield, and its interfaces."""
    vehicle = data.vehicle
    points = list(vehicle.control_points.values())
    flown = set[str]().union(*(flight.records for flight in data.flights))
    peaks = _peaks(data, points)
    shields = list(dict.fromkeys(p.declared.heat_shield for p in sorted(points, key=lambda p: p.position_m[0])))
    hot = [p for p in points if peaks[p.name] > p.limits.surface_K]
    drawn = new_figure(10.5, 9.0, 2, sharex=True)
    for a, axis, label in zip(drawn[1], (2, 1), ("z, m, up", "y, m, starboard"), strict=True):
        _draw_interfaces(a, points, axis)
        for shield, color in zip(shields, COLORS, strict=False):
            _draw_shield(a, shield, points, axis, color, flown)
        a.scatter(
            *_positions(hot, axis),
            s=150,
            facecolors="none",
            edgecolors="tab:red",
            linewidths=1.4,
            label="above its limit",
            zorder=2,
        )
        _name_points(a, points, axis)
        a.set_ylabel(label)
        a.margins(0.06, 0.22)
    drawn[1][1].set_xlabel("x, m, aft of the nose")
    drawn[0].legend(*drawn[1][0].get_legend_handles_labels(), loc="outside lower center", ncols=7, fontsize=9)
    note = f"{len(interfaces(points))} interfaces: " + "; ".join(
        f"{i.materials} between {i.upstream.name} and {i.downstream.name}" for i in interfaces(points)
    )
    above = [f"{p.name} {peaks[p.name]:.0f} of {p.limits.surface_K:.0f} K" for p in hot]
    notes = (note, f"predicted above the surface limit, {data.flights[0].name}: {', '.join(above) or 'none'}")
    title = f"control points of the vehicle {vehicle.name}; filled: with a record; dotted: interfaces"
    return finished(15, title, drawn, {"": _table(points, flown, peaks)}, notes, (_felt_statement(hot),))


def _felt_statement(hot: Sequence[ControlPoint]) -> Statement:
    """What the paper says of the felt of the pods; hot : points above their limits."""
    on_pods = [p.name for p in hot if p.declared.heat_shield == FELT and p.declared.interface is not None]
    return Statement(
        89,
        "felt of the OMS pods behind the tile is discoloured",
        f"above its limit: {', '.join(on_pods) or 'none'}",
        bool(on_pods),
    )


def _draw_shield(a: Any, shield: str, points: Sequence[ControlPoint], axis: int, color: str, flown: set[str]) -> None:
    """Mark the points of one heat shield, filled where they have a record."""
    of_shield = [p for p in points if p.declared.heat_shield == shield]
    filled = [color if p.name in flown else "white" for p in of_shield]
    a.scatter(*_positions(of_shield, axis), s=46, c=filled, edgecolors=color, linewidths=1.6, label=shield, zorder=3)


def _table(points: Sequence[ControlPoint], flown: set[str], peaks: dict[str, float]) -> dict[str, Any]:
    """Columns of the map: places, heat shields, the neighbour upstream across an interface, peaks and limits."""
    upstream = {i.downstream.name: i.upstream.name for i in interfaces(points)}
    return {
        "control_point": [p.name for p in points],
        "heat_shield": [p.declared.heat_shield for p in points],
        **{f"{axis}_m": np.array([p.position_m[k] for p in points]) for k, axis in enumerate("xyz")},
        "interface_upstream": [upstream.get(p.name, "") for p in points],
        "has_record": np.array([float(p.name in flown) for p in points]),
        "peak_surface_K": np.array([peaks[p.name] for p in points]),
        "limit_surface_K": np.array([p.limits.surface_K for p in points]),
    }


def _name_points(a: Axes, points: Sequence[ControlPoint], axis: int) -> None:
    """Name the points, those at one place together; of near ones the upper is named above and the lower below."""
    groups = _by_place(points, axis)
    far_y = LABEL_SHARE * float(np.ptp([g[1] for g in groups]))
    for k, (x, y, names) in enumerate(groups):
        neighbours = [(abs(g[0] - x), g[1]) for g in groups if abs(g[0] - x) < LABEL_M and 0.0 < abs(g[1] - y) < far_y]
        up = min(neighbours)[1] < y if neighbours else k % 2 == 0
        a.annotate(
            "\n".join(names),
            (x, y),
            xytext=(0, 8 if up else -8),
            textcoords="offset points",
            ha="center",
            va="bottom" if up else "top",
            fontsize=7,
        )


def _by_place(points: Sequence[ControlPoint], axis: int) -> list[tuple[float, float, list[str]]]:
    """Position along x and an axis [m] and names of the points, those at one place together."""
    groups: list[tuple[float, float, list[str]]] = []
    for p in sorted(points, key=lambda p: (p.position_m[0], p.position_m[axis])):
        x, y = p.position_m[0], p.position_m[axis]
        near = [g for g in groups if np.hypot(x - g[0], y - g[1]) < SAME_PLACE_M]
        if near:
            near[0][2].append(p.name)
        else:
            groups.append((x, y, [p.name]))
    return groups


def wall_temperatures(data: FlownData) -> PaperFigure:
    """Figure 16: predicted wall temperatures on both sides of each interface against speed, their difference, and the
    heating that it adds.

    Interfaces are those that control points declare; where none does, those between neighbours, without a heating.
    """
    vehicle, flight = data.vehicle, _flight_of_cap(data)
    faces = _faces(vehicle)
    flown = next(iter(flight.records.values())).conditions
    mach = flown["velocity_m_s"] / SHUTTLE_MACH_M_S
    shown = mach >= FEWEST_KFT_S
    names = dict.fromkeys(p.name for i in faces for p in (i.upstream, i.downstream))
    walls = _walls(vehicle, [vehicle.control_points[n] for n in names], flown)
    rows = 3 if faces[0].declared else 2
    drawn = new_figure(
        4.0 * len(faces) + 0.6,
        1.9 + 1.9 * rows,
        rows,
        len(faces),
        squeeze=False,
        sharex=True,
        height_ratios=(2, 1, 1)[:rows],
    )
    columns: dict[str, Any] = {"time_s": flown.time_s[shown], "speed_kft_s": mach[shown]}
    notes, statements = [], list[Statement]()
    for axes, face in zip(drawn[1].T, faces, strict=True):
        warm, behind = walls[face.upstream.name], walls[face.downstream.name]
        for point, color in ((face.upstream, "tab:red"), (face.downstream, "tab:blue")):
            columns[f"{point.name}_K"] = walls[point.name][shown]
            label = f"{point.name}, {point.declared.heat_shield}"
            axes[0].plot(columns["speed_kft_s"], columns[f"{point.name}_K"], color=color, label=label)
        step = warm - behind
        columns[f"{face.upstream.name}_minus_{face.downstream.name}_K"] = step[shown]
        axes[1].plot(mach[shown], step[shown], color="0.2")
        axes[0].set_title(f"{face.materials} interface", fontsize=10)
        axes[0].legend(fontsize=8, loc="best")
        peak, largest = int(np.argmax(warm)), int(np.argmax(step))
        notes.append(
            f"{face.materials}, {face.upstream.name} to {face.downstream.name}: upstream wall hottest at Mach "
            f"{mach[peak]:.1f}, {warm[peak]:.0f} K; it is hotter by {step[largest]:.0f} K at most, at Mach "
            f"{mach[largest]:.1f}"
        )
        if face.declared:
            (conditions,) = conditions_behind_walls(vehicle, [face.downstream], flown)
            excess = excess_behind_interface(vehicle, face.downstream, conditions, behind)[shown]
            shown_excess = np.where(excess == 0.0, np.nan, excess)  # 0 where there is hardly any heating to add to
            columns[f"{face.downstream.name}_excess"] = shown_excess
            axes[2].plot(mach[shown], shown_excess, color="0.2")
            most = int(np.argmax(excess))
            notes.append(
                f"{face.downstream.name}: heating behind the interface {excess[most]:+.1%} at most, at Mach "
                f"{mach[shown][most]:.1f}"
            )
            statements += _statements_of(face, mach[peak], mach[shown][most], excess[most], step[largest])
        for a in axes[1:]:
            a.axhline(0.0, color="0.5", linewidth=0.8)
        axes[-1].set_xlabel("speed, 1000 ft/s")
    labels = ("wall temperature, K", "upstream -\ndownstream, K", "heating added,\nrelative")
    for a, label in zip(drawn[1][:, 0], labels, strict=False):
        a.set_ylabel(label)
    drawn[1][0, 0].invert_xaxis()
    title = f"wall temperatures across interfaces of the heat shield, {flight.name}, declared tables"
    return finished(16, title, drawn, {"": columns}, tuple(notes), tuple(statements))


def _flight_of_cap(data: FlownData) -> CampaignFlight:
    """The flight with a POPU near the speed at which the paper has the cap hottest; the first one without."""
    for flight in data.flights:
        if any(m.kind in POPU and abs(m.shuttle_mach - CAP_PEAK_MACH) < 0.5 for m in flight.manoeuvres):
            return flight
    return data.flights[0]


def _nose_statements(peak_mach: float, most_mach: float, excess: float) -> list[Statement]:
    """What the paper says of the nose cap and the tile behind it, at speeds over 1000 ft/s."""
    return [
        Statement(
            92,
            "the nose cap is hottest near Mach 13",
            f"hottest at Mach {peak_mach:.1f}",
            abs(peak_mach - CAP_PEAK_MACH) < NEAR_MACH,
        ),
        Statement(
            92,
            "the effect of the interface behind the nose cap is largest at Mach 18",
            f"heating of the tile {excess:+.1%} at most, at Mach {most_mach:.1f}",
            abs(most_mach - LARGEST_MACH) < NEAR_MACH,
        ),
    ]


def _peaks(data: FlownData, points: Sequence[ControlPoint]) -> dict[str, float]:
    """Highest predicted wall temperature of each point in the first flight [K]."""
    flown = next(iter(data.flights[0].records.values())).conditions
    return {name: float(np.max(T)) for name, T in _walls(data.vehicle, points, flown).items()}


def _walls(vehicle: Vehicle, points: Sequence[ControlPoint], flown: Conditions) -> dict[str, FloatArray]:
    """Predicted wall temperatures of control points along a flight [K], with the declared tables."""
    models = [point_of_vehicle(vehicle, point) for point in points]
    histories = march_points(models, conditions_behind_walls(vehicle, points, flown))
    return {h.name: h.surface_K for h in histories}
