"""What a display needs to know once: names, places and limits of the control points, sensors, declared tables."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from sim_heating.base.conditions import RATIO_VARIABLES
from sim_heating.heating.ratio.lookup import table_ratios_at
from sim_heating.heating.ratio.table import RatioTable
from sim_heating.inputs.record import Record
from sim_heating.inputs.vehicle import Vehicle
from sim_heating.live.state import plain
from sim_heating.thermal.stack import Sensor, Stack

CURVE_POINTS = 60
"""Angles of attack of a drawn table, besides its nodes."""
NEAR_M, NEAR_SHARE = 5e-5, 0.1
"""How far below the coating a sensor is still at the surface [m], and above the bondline at that, over its depth."""


@dataclass(frozen=True)
class ShownSensor:
    """A sensor on a display: its depth [m], and whether it is at the surface, at the bondline, or within the wall."""

    depth_m: float
    near: Literal["surface", "within", "bondline"]


@dataclass(frozen=True)
class ShownPoint:
    """A control point on a display.

    position_m : from the nose [m], x aft, y to starboard, z up; None where not known
    limits     : `surface_K` and `bondline_K` [K], as far as declared
    table      : declared heating ratio; None where the point has no table
    """

    title: str = ""
    position_m: tuple[float, float, float] | None = None
    limits: Mapping[str, float] = field(default_factory=dict)
    sensors: Mapping[str, ShownSensor] = field(default_factory=dict)
    table: RatioTable | None = None


@dataclass(frozen=True)
class Display:
    """What a display shows besides the states.

    title  : what is flown
    points : by name of the control point
    """

    title: str
    points: Mapping[str, ShownPoint]

    @classmethod
    def of_vehicle(cls, vehicle: Vehicle, names: Iterable[str], title: str = "") -> Display:
        """Control points of a vehicle.

        >>> import sim_heating as sh
        >>> from sim_heating.live.outputs.display import Display
        >>> Display.of_vehicle(sh.load_vehicle("orbiter"), ["NOSECAP"]).points["NOSECAP"].position_m
        (0.0, 0.0, 0.0)
        """
        points = {}
        for name in names:
            declared = vehicle.control_point(name)
            limits = {"surface_K": declared.limits.surface_K, "bondline_K": declared.limits.bondline_K}
            points[name] = ShownPoint(
                declared.title,
                declared.position_m,
                {k: v for k, v in limits.items() if v is not None},
                shown_sensors(declared.construction.stack, declared.sensors),
                declared.ratio,
            )
        return cls(title or vehicle.title, points)

    @classmethod
    def of_records(cls, records: Iterable[Record], title: str = "") -> Display:
        """Control points of flight records, which state no places and no limits."""
        records = list(records)
        points = {
            record.declared.control_point: ShownPoint(
                record.declared.title,
                sensors=shown_sensors(record.declared.stack, record.sensors),
                table=record.ratio_table,
            )
            for record in records
        }
        return cls(title or ", ".join(record.name for record in records), points)

    def as_json(self) -> dict[str, Any]:
        """What the page asks for once; tables are asked for by `table_curve`, as they change with the flight."""
        points = {
            name: {
                "title": shown.title,
                "position_m": shown.position_m,
                "limits": shown.limits,
                "sensors": shown.sensors,
                "table": shown.table is not None,
            }
            for name, shown in self.points.items()
        }
        contents: dict[str, Any] = plain({"title": self.title, "points": points})
        return contents


def shown_sensors(stack: Stack, sensors: Iterable[Sensor]) -> dict[str, ShownSensor]:
    """Sensors by name; those within the first layer are at the surface, those near the last one at the bondline."""
    coating_m = stack.layer[0].thickness_m
    bondline_m = sum(layer.thickness_m for layer in stack.layer[:-1])

    def place(depth_m: float) -> Literal["surface", "within", "bondline"]:
        if depth_m <= coating_m * (1.0 + 1e-6) + NEAR_M:
            return "surface"
        return "bondline" if depth_m >= (1.0 - NEAR_SHARE) * bondline_m else "within"

    return {s.name: ShownSensor(s.depth_m, place(s.depth_m)) for s in sensors}


def table_curve(
    table: RatioTable, conditions: Mapping[str, float], declared: float | None = None
) -> dict[str, list[float]]:
    """Declared heating ratio against the angle of attack at the present Reynolds number, sideslip and deflections.

    conditions : of a state; what it lacks is 0, log10_re the middle of the table
    declared   : ratio of the declared model at present, effects included [-]: the table is multiplied so that it is
                 met there. None: the table as it is
    returns    : `alpha_deg` [deg], increasing, over the range of the table, and `ratio` [-]
    """
    alpha = table.axes[0]
    middle = float(np.mean(table.axes[RATIO_VARIABLES.index("log10_re")][[0, -1]]))
    at = np.array([float(conditions.get(name, middle if name == "log10_re" else 0.0)) for name in RATIO_VARIABLES])
    angles = np.union1d(alpha, np.linspace(alpha[0], alpha[-1], CURVE_POINTS))
    x = np.tile(at, (len(angles), 1))
    x[:, 0] = angles
    ratio = table_ratios_at(table, x)
    if declared is not None:
        now = float(table_ratios_at(table, at[np.newaxis])[0])
        ratio *= declared / now if now else 1.0
    return {"alpha_deg": angles.tolist(), "ratio": ratio.tolist()}
