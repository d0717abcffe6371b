"""Heating-ratio tables of a vehicle from compact descriptions, so that no number of a table is typed twice.

    sim-heating ratio-tables aircraft_data/orbiter

reads every `ratio_sources/*.toml` of a vehicle and writes `ratio_tables/<control point>.csv`, or
`<control point>_turbulent.csv` for turbulent flow. A source defines, for one or more control points,

    ratio(alpha, beta, log10_re, elevon, bodyflap) = base(alpha, log10_re) * factor_1 * factor_2 * ...
    (sigma / ratio)^2 = relative_sigma^2 + sum of the sigma curves^2

and, with [scaling], how the product is scaled from the wind tunnel to flight (heating/ratio/tunnel_to_flight.py). The
format is described in docs/reference/vehicle_format.md. A description always gives the same bytes.
"""

from __future__ import annotations

import os
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Discriminator, Field, Tag, model_validator

from sim_heating.base import files
from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import RATIO_VARIABLES
from sim_heating.base.errors import InputError, error_context
from sim_heating.base.files import Declared, FileOfFolder, LocatedError, Location, display_path
from sim_heating.base.kernels.axis import cells_of
from sim_heating.base.limits import QUANTITIES
from sim_heating.heating.atmosphere import us76_kernel
from sim_heating.heating.ratio import tunnel_to_flight
from sim_heating.heating.ratio.table import (
    RatioTable,
    log_re_remark,
    range_problems,
    ratio_table_text,
    read_ratio_table,
)
from sim_heating.heating.reference.recovery import RecoveryName
from sim_heating.inputs.declared_effects import turbulent_recovery
from sim_heating.inputs.vehicle import recovery_of, vehicle_directory
from sim_heating.inputs.vehicle_files import NAME, ControlPointFile, VehicleFile
from sim_heating.trajectory.spec import state_problems

Variable = Literal["alpha_deg", "beta_deg", "log10_re", "elevon_deg", "bodyflap_deg"]
Points = list[list[float]]
"""[[x, value], ...], x increasing; linear between the points, constant beyond the ends."""

TURBULENT = "_turbulent"
"""What the name of a turbulent table adds to that of its control point."""
FORMATS = dict.fromkeys(RATIO_VARIABLES, "g") | {"ratio": ".5g", "sigma": ".2g"}
"""Number formats of a table: rounded far below any sigma, so that every machine writes the same bytes."""


class Curve(Declared):
    """A piecewise linear function of one variable.

    variable : variable that it is over
    """

    quantities: ClassVar = {"points": ("variable", "ratio_factor")}

    variable: Variable
    points: Points = Field(min_length=1, description="[[x, value], ...], x increasing")

    @model_validator(mode="after")
    def _check(self) -> Curve:
        if any(len(p) != 2 for p in self.points):
            raise LocatedError((("points",), f"{self.points} is not a curve; give [[x, value], ...]"))
        x = [p[0] for p in self.points]
        if x != sorted(set(x)):
            raise LocatedError((("points",), f"{x} does not increase; sort the points and remove repeated ones"))
        return self

    def at(self, x: FloatArray) -> FloatArray:
        """Values at x, constant beyond the ends."""
        xs, values = np.array(self.points).T
        return np.interp(x, xs, values)


class SigmaCurve(Curve):
    """A part of the relative standard deviation."""

    quantities: ClassVar = {"points": ("variable", "relative_sigma")}


class CurveFactor(Curve):
    """A factor given by a curve.

    kind : "curve"
    """

    kind: Literal["curve"]


class DeflectionFactor(Declared):
    """A factor for the Newtonian pressure on a deflected surface, `tunnel_to_flight.deflection_factor`.

    kind : "newtonian-deflection"
    variable : deflection that it is over
    """

    kind: Literal["newtonian-deflection"]
    variable: Literal["elevon_deg", "bodyflap_deg"]
    pressure_exponent: float = Field(gt=0.0, le=1.0, description="0.5 laminar, 0.8 turbulent")


class FileBase(Declared):
    """Ratios in alpha and log10_re from a CSV file, scaled to the control point's length.

    Linear between the nodes of the file and constant beyond them, except below the lowest alpha, where the windward
    trend sin(alpha) sqrt(cos(alpha)) continues.

    column : column of the file with the ratio
    """

    file: FileOfFolder = Field(description="CSV next to the source, with columns alpha_deg, log10_re and `column`")
    column: str
    file_length_over_L: float = Field(gt=0.0, description="length that the file applies to, over the reference length")
    length: Literal["x_over_L", "running_length_m"] = Field(description="key of the control point file")
    length_exponent: float = Field(description="-0.5 laminar, -0.2 turbulent")


class TheoryState(Declared):
    """A flight state that theory is evaluated at."""

    quantities: ClassVar = {"velocity_m_s": "flight_speed_m_s"}

    altitude_m: float = Field(ge=0.0, le=200e3, description="altitude in the standard atmosphere in m, 0 to 200 km")
    velocity_m_s: float = Field(gt=0.0, description="speed in m/s, above 0")

    def implausible(self) -> list[tuple[Location, str]]:
        """Numbers beyond their ranges, and km where m are asked for."""
        return [*super().implausible(), *state_problems(self.altitude_m, self.velocity_m_s)]


class TheoryBase(Declared):
    """Ratios by theory: Eckert's flat plate on a windward surface over the vehicle's reference sphere.

    Evaluated at the table's angles of attack, plus the control point's `local_angle_deg`, and at the flight states;
    between these linear in log10_re and constant beyond them (`tunnel_to_flight.theoretical_ratio`).

    theory : heating of a flat plate
    """

    theory: Literal["eckert-laminar", "eckert-turbulent"]
    length: Literal["x_over_L", "running_length_m"] = Field(description="key of the control point file")
    wall_K: float = Field(gt=0.0, description="wall temperature in K, above 0")
    flight: list[TheoryState] = Field(min_length=1, description="[{ altitude_m, velocity_m_s }, ...], in any order")


class Axes(Declared):
    """Nodes of the table."""

    alpha_deg: list[float] = Field(min_length=1)
    beta_deg: list[float] = Field(min_length=1)
    log10_re: list[float] = Field(min_length=1)
    elevon_deg: list[float] = Field(default=[0.0], min_length=1)
    bodyflap_deg: list[float] = Field(default=[0.0], min_length=1)

    @model_validator(mode="after")
    def _check(self) -> Axes:
        unsorted = [n for n in RATIO_VARIABLES if (x := getattr(self, n)) != sorted(set(x))]
        if unsorted:
            rule = "does not increase from node to node; sort the nodes and remove repeated ones"
            raise LocatedError(*(((n,), f"{getattr(self, n)} {rule}") for n in unsorted))
        return self

    def implausible(self) -> list[tuple[Location, str]]:
        """Nodes outside the range of their variable, or too close together."""
        close: list[tuple[Location, str]] = [
            ((n,), text)
            for n in RATIO_VARIABLES
            if (text := QUANTITIES[n].axis_problem(getattr(self, n)[0], getattr(self, n)[-1])) is not None
        ]
        return super().implausible() or close

    def unusual(self) -> list[tuple[Location, str]]:
        """Unusual nodes, and Reynolds numbers of no entry."""
        text = log_re_remark(self.log10_re)
        return [*super().unusual(), *([] if text is None else [(("log10_re",), text)])]

    def arrays(self) -> tuple[FloatArray, ...]:
        """The five axes in the order of a ratio table."""
        return tuple(np.array(getattr(self, name), dtype=float) for name in RATIO_VARIABLES)


def _base_kind(value: Any) -> str:
    """Tag of a base; tags are no keys of the file, so that the place of a problem leaves them out."""
    kinds = {"file": FileBase, "theory": TheoryBase}
    tags = (k for k, model in kinds.items() if isinstance(value, model) or (isinstance(value, dict) and k in value))
    return f"by {next(tags, 'curve')}"


class RatioSource(Declared):
    """Contents of ratio_sources/<NAME>.toml.

    revision : revision of the tables that are made from it
    """

    format: Literal["ratio-source/1"]
    control_points: list[Annotated[str, Field(pattern=f"^{NAME}$", description="name of a control point")]] = Field(
        min_length=1, description="names of control points: letters, digits and _, no digit first"
    )
    source: str
    confidence: str
    revision: str
    recovery: RecoveryName | None = Field(default=None, description="enthalpy that the ratio is reduced with")
    flow: Literal["laminar", "turbulent"] = Field(default="laminar", description="turbulent: NAME_turbulent.csv")
    relative_sigma: float = Field(gt=0.0, description="one standard deviation over the ratio, above 0")
    note: str = ""
    axes: Axes
    base: Annotated[
        Annotated[FileBase, Tag("by file")]
        | Annotated[TheoryBase, Tag("by theory")]
        | Annotated[Curve, Tag("by curve")],
        Discriminator(_base_kind),
    ] = Field(description="a file, a curve or a theory")
    factor: list[Annotated[CurveFactor | DeflectionFactor, Field(discriminator="kind")]] = Field(default=[])
    sigma: list[SigmaCurve] = Field(default=[])
    scaling: tunnel_to_flight.Scaling | None = None

    @property
    def scaling_to_flight(self) -> tunnel_to_flight.Scaling:
        """The scaling, its flight state reduced with the recovery enthalpy of the source."""
        assert self.scaling is not None
        flight = self.scaling.flight.model_copy(update={"recovery": self.recovery})
        return self.scaling.model_copy(update={"flight": flight})

    @model_validator(mode="after")
    def _check_recovery(self) -> RatioSource:
        if self.scaling is not None and self.scaling.flight.recovery not in (None, self.recovery):
            rule = f"`{self.scaling.flight.recovery}` is not the `recovery` of the source; remove it"
            raise LocatedError((("scaling", "flight", "recovery"), rule))
        if self.scaling is not None and self.recovery == "attachment-line":
            rule = "`attachment-line` is of no surface that a ratio is scaled for; remove [scaling]"
            raise LocatedError((("recovery",), rule))
        if isinstance(self.base, TheoryBase):
            if self.scaling is not None:
                raise LocatedError((("scaling",), "a base by theory holds in flight; remove one of them"))
            if self.recovery in (None, "total", "attachment-line"):
                rule = f"`{self.base.theory}` goes with the enthalpy of an edge; give edge-laminar or edge-turbulent"
                raise LocatedError((("recovery",), rule))
        return self


def _require_reference(path: Path, source: RatioSource, reference: str) -> None:
    """Refuse a source whose ratios are over another reference heating than the vehicle's."""
    key = "[base]" if isinstance(source.base, TheoryBase) else "" if source.scaling is None else "[scaling]"
    if key and reference != tunnel_to_flight.REFERENCE:
        raise InputError(
            f"{display_path(path)}, {key}: takes ratios over `{tunnel_to_flight.REFERENCE}`, not {reference}"
        )


def build_tables(
    vehicle: str | os.PathLike[str], *, root: str | os.PathLike[str] | None = None
) -> dict[str, RatioTable]:
    """The ratio tables that a vehicle's ratio_sources describe, by the names of their files without the ending: those
    of the control points, with `_turbulent` for turbulent flow.

    root   : as `load_vehicle` takes it
    raises : InputError where there is no source, a source or a file that it names cannot be used, or two sources make
             one table
    """
    directory = vehicle_directory(vehicle)
    files.roots_of(directory / "vehicle.toml", root).check_links(directory)
    file = files.read_toml(directory / "vehicle.toml", VehicleFile)
    sources = sorted((directory / "ratio_sources").glob("*.toml"))
    if not sources:
        raise InputError(f"{display_path(directory / 'ratio_sources')}: holds no description; add a .toml file")
    tables: dict[str, RatioTable] = {}
    points = sorted(p.stem for p in (directory / "control_points").glob("*.toml"))
    for path in sources:
        source = files.read_toml(path, RatioSource)
        _require_reference(path, source, file.heating.reference)
        for name in source.control_points:
            table = name + (TURBULENT if source.flow == "turbulent" else "")
            if table in tables:
                raise InputError(
                    f"{display_path(path)}: `control_points`: {table} already has a table from another source; remove "
                    "one"
                )
            if name not in points:
                rule = f"the vehicle has no control point `{name}`{files.suggestion(name, points)}"
                raise InputError(f"{display_path(path)}: `control_points`: {rule}")
            point = files.read_toml(directory / "control_points" / f"{name}.toml", ControlPointFile)
            with error_context(display_path(path)):
                tables[table] = _build(source, path, point, file)
    return tables


def write_tables(vehicle: str | os.PathLike[str], *, root: str | os.PathLike[str] | None = None) -> list[Path]:
    """Build all tables of a vehicle and write them to the files that its control points name; returns those files.

    root   : as `load_vehicle` takes it
    raises : InputError where one of them has been revised from flight data, is another than this function wrote, or
             another process is writing to the vehicle; nothing is written
    """
    directory = vehicle_directory(vehicle)
    with files.exclusive(directory):
        folder, tables = directory / "ratio_tables", build_tables(directory, root=root)
        texts = {f"{name}.csv": ratio_table_text(table, FORMATS) for name, table in tables.items()}
        for name in texts:
            _refuse_revised(folder / name)
        files.write_own_files(folder, "ratio-tables", texts)
    return [folder / name for name in texts]


def _refuse_revised(path: Path) -> None:
    """Refuse to replace a table that flight data have revised."""
    if path.is_file() and "parent_revision" in (header := read_ratio_table(path).header):
        raise InputError(
            f"{display_path(path)}: is revision {header.get('revision')}, from flight data; revert it, or remove its "
            "control point from the ratio source"
        )


def _build(source: RatioSource, path: Path, point: ControlPointFile, vehicle: VehicleFile) -> RatioTable:
    axes = source.axes.arrays()
    grid = dict(zip(RATIO_VARIABLES, np.meshgrid(*axes, indexing="ij"), strict=True))
    ratio = _base(source.base, path, point, vehicle, grid)
    for factor in source.factor:
        ratio = ratio * _factor(factor, grid)
    relative = np.sqrt(source.relative_sigma**2 + sum(s.at(grid[s.variable]) ** 2 for s in source.sigma))
    header = {
        "control_point": point.name,
        "source": source.source,
        "confidence": source.confidence,
        "revision": source.revision,
        "reference": vehicle.heating.reference,
        **_stated(source.recovery if source.scaling is None else source.scaling.tunnel.recovery),
        "made_from": f"ratio_sources/{path.name}",
    }
    if np.any(ratio <= 0.0):
        raise InputError(f"the ratio of {point.name} falls to {ratio.min():g}; it must be above 0")
    if (too_high := QUANTITIES["heating_ratio"].problem(float(ratio.max()))) is not None:
        raise InputError(f"the ratio of {point.name} rises to {too_high}; check base and factors")
    table = RatioTable(axes, ratio, relative * ratio, header)
    if source.scaling is not None:
        table = tunnel_to_flight.scale_table(table, source.scaling_to_flight)
    expected = recovery_of(point, vehicle.heating).kind
    if source.flow == "turbulent":
        expected = turbulent_recovery(expected)
    if differs := table.recovery_problem(expected, vehicle.heating.reference):
        raise InputError(f"{point.name}: {differs} of the control point; give both the same `recovery`")
    return table


def _stated(recovery: str | None) -> dict[str, str]:
    return {} if recovery is None else {"recovery": recovery}


def _base(
    base: FileBase | TheoryBase | Curve,
    path: Path,
    point: ControlPointFile,
    vehicle: VehicleFile,
    grid: dict[str, FloatArray],
) -> FloatArray:
    if isinstance(base, Curve):
        return base.at(grid[base.variable])
    length = (
        point.x_over_L if base.length == "x_over_L" else (point.running_length_m or 0.0) / vehicle.reference_length_m
    )
    if length <= 0.0:
        raise InputError(f"[base]: `length`: {point.name} has no {base.length} above 0; give one")
    if isinstance(base, TheoryBase):
        return _from_theory(base, length, point.local_angle_deg or 0.0, vehicle, grid["alpha_deg"], grid["log10_re"])
    at_length = (length / base.file_length_over_L) ** base.length_exponent
    return at_length * _from_file(base, path.parent / base.file, grid["alpha_deg"], grid["log10_re"])


def _from_theory(
    base: TheoryBase,
    x_over_L: float,
    local_angle_deg: float,
    vehicle: VehicleFile,
    alpha_deg: FloatArray,
    log10_re: FloatArray,
) -> FloatArray:
    """Theory's ratio at the angles and, linear in log10_re, between the flight states; constant beyond them."""
    radius = vehicle.heating.nose_radius_m
    assert radius is not None, "the reference of theory is a sphere"
    states = []
    for flown in base.flight:
        T, _, rho = us76_kernel(flown.altitude_m)
        state = tunnel_to_flight.FlowState(
            velocity_m_s=flown.velocity_m_s,
            T_inf_K=T,
            wall_K=base.wall_K,
            length_m=vehicle.reference_length_m,
            nose_radius_m=radius,
        )
        states.append((state.log10_re(rho), state))
    states.sort(key=lambda pair: pair[0])
    for (a, first), (b, second) in pairwise(states):
        if b - a < 1e-3:
            raise InputError(
                f"[base]: `flight`: the states at {first.velocity_m_s:g} and {second.velocity_m_s:g} m/s have one "
                f"log10_re, {a:.3f}; remove one"
            )
    turbulent = base.theory == "eckert-turbulent"
    ratio = np.empty_like(alpha_deg)
    for alpha in np.unique(alpha_deg):
        angle = tunnel_to_flight.surface_angle_deg(float(alpha) + local_angle_deg)
        values = [tunnel_to_flight.theoretical_ratio(state, re, angle, x_over_L, turbulent) for re, state in states]
        here = alpha_deg == alpha
        ratio[here] = np.interp(log10_re[here], [re for re, _ in states], values)
    return ratio


def _from_file(base: FileBase, path: Path, alpha_deg: FloatArray, log10_re: FloatArray) -> FloatArray:
    """The file's ratio, bilinear in alpha and log10_re; constant beyond its ends, windward trend at low alpha."""
    table = files.read_csv_columns(path, ("alpha_deg", "log10_re", base.column))
    files.raise_problems(
        [p for name in ("alpha_deg", "log10_re") for p in range_problems(table, name, QUANTITIES[name])]
    )
    a, re = np.unique(table["alpha_deg"]), np.unique(table["log10_re"])
    values = np.full((len(a), len(re)), np.nan)
    values[np.searchsorted(a, table["alpha_deg"]), np.searchsorted(re, table["log10_re"])] = table[base.column]
    if not np.all(np.isfinite(values)):
        raise InputError(f"{display_path(path)}: the rows do not fill a grid of alpha_deg and log10_re")
    at_alpha = np.stack([np.interp(alpha_deg, a, column) for column in values.T])
    i = cells_of(re, log10_re)
    j = np.minimum(i + 1, len(re) - 1)
    w = np.where(j > i, np.clip((log10_re - re[i]) / np.where(j > i, re[j] - re[i], 1.0), 0.0, 1.0), 0.0)
    low, high = (np.take_along_axis(at_alpha, k[None], 0)[0] for k in (i, j))
    trend = tunnel_to_flight.windward_trend(np.minimum(alpha_deg, a[0])) / tunnel_to_flight.windward_trend(a[:1])
    return ((1.0 - w) * low + w * high) * trend


def _factor(factor: CurveFactor | DeflectionFactor, grid: dict[str, FloatArray]) -> FloatArray:
    if isinstance(factor, CurveFactor):
        return factor.at(grid[factor.variable])
    return tunnel_to_flight.deflection_factor(grid["alpha_deg"], grid[factor.variable], factor.pressure_exponent)
