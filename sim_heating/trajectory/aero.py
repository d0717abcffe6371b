"""Longitudinal aerodynamics of a vehicle: tables over Mach, alpha and control deflection, and the trim they imply.

Forces and moment are those of the body axes of the tables, normal force up and axial force aft,

    CN = CN0(M, alpha) + dCN(M, alpha, elevon) + dCN(M, alpha, bodyflap)       CA, Cm likewise
    CL = CN cos(alpha) - CA sin(alpha)         CD = CN sin(alpha) + CA cos(alpha)
    Cm_cg = Cm + shift(M) + CN (x_cg - x_ref) / c

linear between the points of the tables and constant beyond their ends. The 3-DOF entry and the JSBSim model
are both made from these tables.

Source: docs/theory/equations.md, equation 36.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from sim_heating.base import files
from sim_heating.base.arrays import FloatArray
from sim_heating.base.errors import InputError
from sim_heating.base.files import Convertible, CsvTable, FileOfFolder, Location, display_path
from sim_heating.base.kernels.axis import cell_of
from sim_heating.base.kernels.jit import njit
from sim_heating.base.limits import QUANTITIES
from sim_heating.heating.ratio.table import range_problems
from sim_heating.heating.recorded.plausible import BALLISTIC_KG_M2
from sim_heating.trajectory.spec import Guidance, Positive, TrajectorySpec

Fraction = Annotated[float, Field(ge=0.0, le=1.0)]
Span = tuple[float, float]

COEFFICIENTS = ("CN", "CA", "Cm")

LENGTH_RATIO = 100.0
"""Largest ratio of two reference lengths; a slender missile has 20."""
AREA_RANGE = (3e-4, 10.0)
"""Reference area over the square of the longest reference length: a rod of 40 calibres has 5e-4."""
FORCE_RANGE = {"CN": (1e-6, 100.0), "CA": (1e-7, 10.0)}
"""Largest force coefficient times area over the square of the longest length. Newtonian flow gives less than 2 on the
area that it sees, which is less than 40 squares of a diameter."""

SCHEDULE_SOUND_M_S = 300.0
"""Speed of sound that converts an alpha schedule over velocity to one over Mach, for the body flap alone."""

HYPERSONIC_MACH = 5.0
"""Mach number from which on the sign of the lift is checked: slower, a glider pitches as its landing needs."""
LEAST_DOWN_LIFT = 0.02
"""Downward lift over drag that is warned of; a ballistic body at its trim has less."""


class Reference(Convertible):
    """Reference quantities of the coefficients; the moment reference is a fraction of the length, from the nose.

    moment_reference_fraction : reference point of the moments [-]
    """

    area_m2: Positive
    chord_m: Positive
    span_m: Positive
    length_m: Positive
    moment_reference_fraction: Fraction

    def implausible(self) -> list[tuple[Location, str]]:
        """Lengths [m] and areas [m2] that no body has together."""
        lengths = {name: getattr(self, name) for name in ("length_m", "chord_m", "span_m")}
        shortest, longest = min(lengths, key=lengths.__getitem__), max(lengths, key=lengths.__getitem__)
        problems = super().implausible()
        if lengths[longest] > LENGTH_RATIO * lengths[shortest]:
            rule = f"is more than {LENGTH_RATIO:g} times {shortest} = {lengths[shortest]:g}; correct one of them"
            problems.append(((longest,), f"{lengths[longest]:g} {rule}"))
        elif not AREA_RANGE[0] <= self.area_m2 / lengths[longest] ** 2 <= AREA_RANGE[1]:
            rule = f"m2 is no reference area of a body with {longest} = {lengths[longest]:g}; correct one of them"
            problems.append((("area_m2",), f"{self.area_m2:g} {rule}"))
        return problems


class Mass(Convertible):
    """Mass, centre of gravity (fraction of the length from the nose) and inertia, which scales with mass.

    cg_fraction : centre of gravity [-]
    cg_range : foremost and aftmost centre of gravity [-]
    """

    mass_kg: Positive
    cg_fraction: Fraction
    cg_range: tuple[Fraction, Fraction]
    inertia_at_kg: Positive
    Ixx_kg_m2: Positive
    Iyy_kg_m2: Positive
    Izz_kg_m2: Positive
    Ixz_kg_m2: float = 0.0


class FileOfFolders(Convertible):
    """Files of the tables below the folder `aero`, one row a point of the grid; a surface that does not exist has none.

    longitudinal : CSV of the columns mach, alpha_deg, CN, CA, Cm: normal and axial force, pitching moment
    elevon, bodyflap : CSV of the columns mach, alpha_deg, deflection_deg, CN, CA, Cm: increments for a deflection
    """

    longitudinal: FileOfFolder
    elevon: FileOfFolder | None = None
    bodyflap: FileOfFolder | None = None


class Surface(Convertible):
    """Travel and rate of a control surface, trailing edge down positive.

    schedule_deg : deflection that the other surface is trimmed for [deg]; of the elevon, for the body flap
    """

    range_deg: Span = (0.0, 0.0)
    rate_deg_s: Positive = 1.0
    schedule_deg: float = 0.0


class CmShift(Convertible):
    """Pitching-moment increment found in flight: 0 below mach[0], linear between, Cm above mach[1].

    Cm : increment [-]
    """

    Cm: float = 0.0
    mach: tuple[Positive, Positive] = (5.0, 12.0)


class Lateral(Convertible):
    """Sideslip derivatives, constant."""

    Cl_beta_deg: float = 0.0
    Cn_beta_deg: float = 0.0
    CY_beta_rad: float = 0.0


class Damping(Convertible):
    """Rate derivatives per radian of q c / 2V, p b / 2V and r b / 2V.

    Cmq : pitch damping [1/rad]
    Clp : roll damping [1/rad]
    Cnr : yaw damping [1/rad]
    """

    Cmq: float = 0.0
    Clp: float = 0.0
    Cnr: float = 0.0


class AeroFile(Convertible):
    """Contents of aero.toml."""

    format: Literal["aero/1"]
    title: str
    source: str
    confidence: str
    reference: Reference
    mass: Mass
    tables: FileOfFolders
    elevon: Surface = Surface()
    bodyflap: Surface = Surface()
    cm_shift: CmShift = CmShift()
    lateral: Lateral = Lateral()
    damping: Damping = Damping()


class Grid(NamedTuple):
    """A table on a full grid: values (mach, alpha, deflection, 3) of CN, CA, Cm."""

    mach: FloatArray
    alpha_deg: FloatArray
    deflection_deg: FloatArray
    values: FloatArray

    def packed(self) -> FloatArray:
        """The table as one block for the kernels: three sizes, axes of Mach [-] and of angles [deg], coefficients
        [-].

        Source: docs/theory/equations.md, equation 36.
        """
        sizes = np.array(self.values.shape[:3], dtype=float)
        return np.concatenate((sizes, self.mach, self.alpha_deg, self.deflection_deg, self.values.ravel()))


@njit
def bracket(axis: FloatArray, x: float) -> tuple[int, float]:
    """Interval of x on a rising axis and its position within, 0 to 1 [-]; held at the ends, also for an axis of one
    point."""
    last = axis.shape[0] - 1
    if last == 0 or x <= axis[0]:
        return 0, 0.0
    if x >= axis[last]:
        return last - 1, 1.0
    i = cell_of(axis, 0, last + 1, x)
    return i, (x - axis[i]) / (axis[i + 1] - axis[i])


@njit
def grid_kernel(mach: float, alpha_deg: float, deflection_deg: float, table: FloatArray) -> tuple[float, float, float]:
    """CN, CA, Cm [-] of one packed table, trilinear in Mach and angles [deg], constant beyond the ends.

    Source: docs/theory/equations.md, equation 36.
    """
    n, m, p = int(table[0]), int(table[1]), int(table[2])
    i, u = bracket(table[3 : 3 + n], mach)
    j, v = bracket(table[3 + n : 3 + n + m], alpha_deg)
    k, w = bracket(table[3 + n + m : 3 + n + m + p], deflection_deg)
    values = 3 + n + m + p
    cn = ca = cm = 0.0
    for corner in range(8):
        a, b, c = corner & 1, (corner >> 1) & 1, corner >> 2
        weight = (u if a else 1.0 - u) * (v if b else 1.0 - v) * (w if c else 1.0 - w)
        # On an axis of one point the upper corner has weight 0 and lies behind the table.
        if weight != 0.0:
            at = values + 3 * (((i + a) * m + j + b) * p + k + c)
            cn += weight * table[at]
            ca += weight * table[at + 1]
            cm += weight * table[at + 2]
    return cn, ca, cm


@njit
def body_kernel(
    mach: float,
    alpha_deg: float,
    elevon_deg: float,
    bodyflap_deg: float,
    basic: FloatArray,
    elevon: FloatArray,
    bodyflap: FloatArray,
) -> tuple[float, float, float]:
    """CN, CA, Cm [-] about the moment reference from packed tables, controls [deg] included, flight shift not.

    Source: docs/theory/equations.md, equation 36.
    """
    cn, ca, cm = grid_kernel(mach, alpha_deg, 0.0, basic)
    dn, da, dm = grid_kernel(mach, alpha_deg, elevon_deg, elevon)
    fn, fa, fm = grid_kernel(mach, alpha_deg, bodyflap_deg, bodyflap)
    return cn + dn + fn, ca + da + fa, cm + dm + fm


@dataclass(frozen=True)
class Aero:
    """Aerodynamics and mass of one vehicle as flown: the file, its tables, and the changes of a scenario.

    mass_kg     : mass [kg]
    cg_fraction : centre of gravity from the nose over the reference length [-]
    cm_shift    : pitching moment added above the shift's upper Mach number [-], 0 for the data book
    """

    file: AeroFile
    basic: Grid
    elevon: Grid
    bodyflap: Grid
    mass_kg: float
    cg_fraction: float
    cm_shift: float = 0.0

    @cached_property
    def packed(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """The three tables of coefficients [-] as `body_kernel` takes them.

        Source: docs/theory/equations.md, equation 36.
        """
        return self.basic.packed(), self.elevon.packed(), self.bodyflap.packed()

    @property
    def arm(self) -> float:
        """(x_cg - x_ref) / c [-]: what CN adds to the moment about the centre of gravity.

        Source: docs/theory/equations.md, equation 36.
        """
        ref = self.file.reference
        return (self.cg_fraction - ref.moment_reference_fraction) * ref.length_m / ref.chord_m

    def shift(self, mach: float) -> float:
        """Flight-found pitching moment [-] at a Mach number. Source: docs/theory/equations.md, equation 36."""
        low, high = self.file.cm_shift.mach
        return self.cm_shift * min(max((mach - low) / (high - low), 0.0), 1.0)

    def body_coefficients(
        self, mach: float, alpha_deg: float, elevon_deg: float = 0.0, bodyflap_deg: float = 0.0
    ) -> tuple[float, float, float]:
        """CN (up), CA (aft) and Cm [-] about the moment reference at angles [deg], the flight shift included.

        Source: docs/theory/equations.md, equation 36.
        """
        cn, ca, cm = body_kernel(mach, alpha_deg, elevon_deg, bodyflap_deg, *self.packed)
        return cn, ca, cm + self.shift(mach)

    def coefficients(
        self, mach: float, alpha_deg: float, elevon_deg: float = 0.0, bodyflap_deg: float = 0.0
    ) -> tuple[float, float, float]:
        """CL, CD and Cm [-] about the centre of gravity at angles [deg].

        Source: docs/theory/equations.md, equation 36.
        """
        cn, ca, cm = self.body_coefficients(mach, alpha_deg, elevon_deg, bodyflap_deg)
        s, c = math.sin(math.radians(alpha_deg)), math.cos(math.radians(alpha_deg))
        return cn * c - ca * s, cn * s + ca * c, cm + cn * self.arm

    def trim_elevon_deg(self, mach: float, alpha_deg: float, bodyflap_deg: float = 0.0) -> float:
        """Elevon deflection [deg] of zero moment about the centre of gravity; the end of its travel without one.

        Source: docs/theory/equations.md, equation 36.
        """
        # The moment is linear between the nodes of the table, so that its signs at the nodes bracket the zero exactly.
        nodes = _travel_nodes(self.elevon.deflection_deg, self.file.elevon.range_deg)
        return _zero_crossing(nodes, [self.coefficients(mach, alpha_deg, float(d), bodyflap_deg)[2] for d in nodes])

    def trim_bodyflap_deg(self, mach: float, alpha_deg: float, elevon_deg: float = 0.0) -> float:
        """Body-flap deflection [deg] of zero moment about the centre of gravity; the end of its travel without one.

        Source: docs/theory/equations.md, equation 36.
        """
        nodes = _travel_nodes(self.bodyflap.deflection_deg, self.file.bodyflap.range_deg)
        return _zero_crossing(nodes, [self.coefficients(mach, alpha_deg, elevon_deg, float(d))[2] for d in nodes])

    def bodyflap_schedule(
        self, alpha_deg: Sequence[tuple[float, float]], against: str = "mach"
    ) -> tuple[tuple[float, float], ...]:
        """Body flap [deg] over Mach that keeps the elevon at its scheduled deflection in trim.

        alpha_deg : angle-of-attack schedule [(x, deg), ...]
        against   : meaning of x, "mach" or "velocity_m_s"; a velocity is converted to Mach with 300 m/s, and the
                    elevon trims the small remaining moment

        Source: docs/theory/equations.md, equation 36.
        """
        scale = 1.0 if against == "mach" else 1.0 / SCHEDULE_SOUND_M_S
        x, y = np.array(sorted(alpha_deg), dtype=float).T
        # Corners of the tables, of the schedule and of the shift all become nodes: between them the trim deflection is
        # smooth.
        mach = np.unique(np.concatenate((self.basic.mach, x * scale, self.file.cm_shift.mach)))
        alpha = np.interp(mach, x * scale, y)
        elevon = self.file.elevon.schedule_deg
        return tuple(
            (m, self.trim_bodyflap_deg(m, a, elevon)) for m, a in zip(mach.tolist(), alpha.tolist(), strict=True)
        )

    def with_changes(
        self, *, mass_kg: float | None = None, cg_fraction: float | None = None, cm_shift: bool | float = False
    ) -> Aero:
        """The vehicle with another mass [kg], centre of gravity, or flight-found pitching moment.

        cm_shift : True for the vehicle's own value, False for the data book, or a number
        raises   : InputError where the mass is not above 0 or the centre of gravity lies outside the vehicle's range
        """
        mass = self.mass_kg if mass_kg is None else mass_kg
        cg = self.cg_fraction if cg_fraction is None else cg_fraction
        low, high = self.file.mass.cg_range
        if not (math.isfinite(mass) and mass > 0.0):
            raise InputError(f"mass_kg: {mass} is not a mass (must be above 0)")
        if not low <= cg <= high:
            raise InputError(f"cg_fraction: {cg} is outside {low} to {high} of the reference length")
        # True is a number in Python: only its type distinguishes the switch from a value of 1.
        shift = float(cm_shift) * self.file.cm_shift.Cm if isinstance(cm_shift, bool) else float(cm_shift)
        return replace(self, mass_kg=mass, cg_fraction=cg, cm_shift=shift)


def load_aero(vehicle_dir: Path) -> Aero:
    """Read `<vehicle_dir>/aero/aero.toml` and its tables of coefficients [-] over Mach [-] and angles [deg].

    raises : InputError where a file is missing, a value cannot be used or a table has a hole
    """
    folder = Path(vehicle_dir) / "aero"
    file = files.read_toml(folder / "aero.toml", AeroFile)
    aero = Aero(
        file=file,
        basic=_read_grid(folder / file.tables.longitudinal, deflected=False),
        elevon=_read_control(folder, file.tables.elevon),
        bodyflap=_read_control(folder, file.tables.bodyflap),
        mass_kg=file.mass.mass_kg,
        cg_fraction=file.mass.cg_fraction,
    )
    files.raise_problems([*_force_problems(aero, folder / file.tables.longitudinal), *_mass_problems(aero, folder)])
    return aero


def _force_problems(aero: Aero, path: Path) -> list[str]:
    """Force coefficients that no flow gives on a body of the reference lengths."""
    ref, lines = aero.file.reference, []
    for column, (low, high) in FORCE_RANGE.items():
        largest = float(np.max(np.abs(aero.basic.values[..., COEFFICIENTS.index(column)])))
        force = largest * ref.area_m2 / max(ref.length_m, ref.chord_m, ref.span_m) ** 2
        if force > high or 0.0 < force < low:
            rule = f"its largest value is {largest:g}, which no flow gives over the area and lengths of aero.toml"
            lines.append(f"{display_path(path)}, column {column}: {rule}; correct one of them")
    return lines


def _mass_problems(aero: Aero, folder: Path) -> list[str]:
    """A mass that does not belong to a vehicle of this area: tonnes, or grams."""
    ref = aero.file.reference
    force = float(np.max(np.hypot(aero.basic.values[..., 0], aero.basic.values[..., 1])))
    if force == 0.0:
        return []
    loading = aero.mass_kg / (ref.area_m2 * force)
    if BALLISTIC_KG_M2[0] <= loading <= BALLISTIC_KG_M2[1]:
        return []
    rule = f"{aero.mass_kg:g} kg is {loading:.3g} kg/m2 of mass over the largest area of drag, as no vehicle has"
    return [f"{display_path(folder / 'aero.toml')}, [mass]: `mass_kg`: {rule}; give kg, and the area in m2"]


def flown_aero(spec: TrajectorySpec, vehicle_dir: Path) -> Aero:
    """A vehicle's aerodynamics with the mass [kg], centre of gravity [m] and pitching-moment shift [-] that a
    scenario flies.

    Source: docs/theory/equations.md, equation 36.
    """
    state = spec.vehicle
    return load_aero(vehicle_dir).with_changes(
        mass_kg=state.mass_kg, cg_fraction=state.cg_fraction, cm_shift=state.cm_shift
    )


def check_alpha_schedule(aero: Aero, guidance: Guidance, where: str) -> None:
    """Check the angles of attack [deg] that guidance commands against the aerodynamics that it commands them of.

    where  : vehicle or scenario, for messages
    raises : InputError where an angle lies outside those of the longitudinal table, which is constant beyond its ends
    warns  : where the lift is down at hypersonic speed, as of a capsule whose angle of attack has the other sign;
             surfaces undeflected
    """
    scale = 1.0 if guidance.alpha_against == "mach" else 1.0 / SCHEDULE_SOUND_M_S
    low, high = aero.basic.alpha_deg[[0, -1]]
    flown = [
        (x * scale, min(max(a, guidance.alpha_limits_deg[0]), guidance.alpha_limits_deg[1]))
        for x, a in guidance.alpha_deg
    ]
    for mach, alpha in flown:
        if not low <= alpha <= high:
            raise InputError(
                f"{where}: guidance commands {alpha:g} deg at Mach {mach:.3g}, and {aero.file.tables.longitudinal} "
                f"of aero ends at {low:g} and {high:g} deg; extend the table, or correct `alpha_deg` of guidance"
            )
    mach, alpha = max(flown)
    CL, CD = _undeflected_lift_drag(aero.basic, mach, alpha)
    if mach >= HYPERSONIC_MACH and CL < -LEAST_DOWN_LIFT * CD:
        warnings.warn(
            f"{where}: the lift is down at Mach {mach:.3g} and {alpha:g} deg (CL {CL:.2f}, CD {CD:.2f}); guidance "
            "flies with the lift up, so give the angle the other sign: a capsule with its heat shield forward lifts "
            "at negative angles of attack (`alpha_deg` of guidance, of the tables of aero and of the heating ratios)",
            stacklevel=3,
        )


def _undeflected_lift_drag(basic: Grid, mach: float, alpha_deg: float) -> tuple[float, float]:
    """CL and CD [-] of the longitudinal table, without a compiled kernel: a check of files loads no compiler."""
    body = basic.values[:, :, 0]
    CN, CA, _ = (
        np.interp(alpha_deg, basic.alpha_deg, [np.interp(mach, basic.mach, column) for column in body[:, :, k].T])
        for k in range(3)
    )
    sine, cosine = math.sin(math.radians(alpha_deg)), math.cos(math.radians(alpha_deg))
    return float(CN * cosine - CA * sine), float(CA * cosine + CN * sine)


def _read_control(folder: Path, name: str | None) -> Grid:
    if name is not None:
        return _read_grid(folder / name, deflected=True)
    # A table of one point with values of 0: the kernels need no case for a vehicle without the surface.
    point = np.zeros(1)
    return Grid(point, point, point, np.zeros((1, 1, 1, 3)))


def _read_grid(path: Path, *, deflected: bool) -> Grid:
    axes = ("mach", "alpha_deg", "deflection_deg") if deflected else ("mach", "alpha_deg")
    table = files.read_csv_columns(path, (*axes, *COEFFICIENTS), keep_other=False)
    points = [*(table[a] for a in axes), np.zeros(len(table))][:3]
    mach, alpha, deflection = (np.unique(p) for p in points)
    values = np.full((mach.size, alpha.size, deflection.size, 3), np.nan)
    where = tuple(np.searchsorted(axis, p) for axis, p in zip((mach, alpha, deflection), points, strict=True))
    ranges = {"mach": QUANTITIES["mach_of_table"]} | {a: QUANTITIES[a] for a in axes[1:]}
    ranges |= dict.fromkeys(COEFFICIENTS, QUANTITIES["coefficient"])
    files.raise_problems([line for name, limits in ranges.items() for line in range_problems(table, name, limits)])
    # Of a repeated point the last row would silently be taken.
    _check_repeated_points(table, where, values.shape[:3])
    values[where] = np.stack([table[c] for c in COEFFICIENTS], axis=-1)
    return Grid(mach, alpha, deflection, _extend_in_alpha(path, mach, alpha, values))


def _check_repeated_points(table: CsvTable, where: Sequence[NDArray[np.intp]], shape: tuple[int, ...]) -> None:
    flat = np.ravel_multi_index(tuple(where), shape)
    seen, first = np.unique(flat, return_index=True)
    if seen.size != flat.size:
        row = int(table.lines[np.setdiff1d(np.arange(flat.size), first)[0]])
        raise InputError(f"{display_path(table.path)}, row {row}: this point of the grid is repeated; keep one")


def _extend_in_alpha(path: Path, mach: FloatArray, alpha: FloatArray, values: FloatArray) -> FloatArray:
    """Fill the alphas at which a Mach number was not tested.

    The data book ends at lower alpha for lower Mach. Beyond, coefficients change with alpha as those of the next higher
    Mach number, which keeps the tables continuous; schedules do not fly there. Between points alpha is linear.
    """
    full = values.copy()
    # From the highest Mach number down, as the gap above the tested alphas takes the increments of the next higher one.
    for m in range(mach.size - 1, -1, -1):
        tested = np.flatnonzero(np.all(np.isfinite(values[m]), axis=(1, 2)))
        if tested.size == 0 or (m == mach.size - 1 and tested[-1] != alpha.size - 1) or tested[0] != 0:
            raise InputError(
                f"{display_path(path)}: Mach {mach[m]:g} lacks alphas or deflections; fill the hole in the table"
            )
        for index in np.ndindex(values.shape[2:]):
            line = values[(m, tested, *index)]
            full[(m, slice(None), *index)] = np.interp(alpha, alpha[tested], line)
        if m < mach.size - 1:
            beyond = slice(tested[-1] + 1, None)
            full[m, beyond] = full[m, tested[-1]] + full[m + 1, beyond] - full[m + 1, tested[-1]]
    return full


def _travel_nodes(nodes: FloatArray, travel: Span) -> FloatArray:
    inside = nodes[(nodes > travel[0]) & (nodes < travel[1])]
    return np.unique(np.concatenate(([travel[0]], inside, [travel[1]])))


def _zero_crossing(x: FloatArray, moment: Sequence[float]) -> float:
    """Deflection at which a falling, piecewise linear moment crosses zero; exact for tables linear between them."""
    cm = np.asarray(moment)
    if cm[0] <= 0.0:
        return float(x[0])
    if cm[-1] >= 0.0:
        return float(x[-1])
    i = int(np.flatnonzero(cm <= 0.0)[0])
    return float(x[i - 1] + (x[i] - x[i - 1]) * cm[i - 1] / (cm[i - 1] - cm[i]))
