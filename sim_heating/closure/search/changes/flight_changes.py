"""Changes of a record's flight: its density, velocity, angle of attack or clock is other than its conditions state."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.errors import RunError
from sim_heating.base.parameters import CLOCK_SKEW, Parameter
from sim_heating.closure.clues.flight_consistency import Discrepancy, contradictions_of_motion, misfit_of_motion
from sim_heating.closure.clues.record_checks import declared_readings
from sim_heating.closure.prior import changed_flight
from sim_heating.closure.search.trials.change import RecordChange, Span, moved_ends, off_by
from sim_heating.closure.search.trials.trial_fit import TrialFit
from sim_heating.inputs.record import Record

EVERYWHERE: Span = (-np.inf, np.inf)
UNKNOWNS = {
    "flux": Parameter("factor", "1", 1.0, 0.1, 0.1, 10.0, "absorbed flux over that of the conditions"),
    "density": Parameter("density_factor", "1", 1.0, 0.1, 0.3, 3.0, "true density over that of the conditions"),
    "velocity": Parameter("velocity_factor", "1", 1.0, 0.01, 0.7, 1.4, "true velocity over that of the conditions"),
    "angle of attack": Parameter("alpha_bias_deg", "deg", 0.0, 0.5, -15.0, 15.0, "true less stated angle of attack"),
    "smoothing": Parameter("smoothing_s", "s", 0.0, 2.0, 0.0, 30.0, "width of the mean that the stated angle is"),
    "shift": replace(CLOCK_SKEW, name="skew_s", lower=-900.0, upper=900.0, text="flight later than its conditions"),
}
"""Unknowns of the changes. Their standard deviations are guesses: shears of density of a tenth and winds of 1 % of the
velocity are usual, as is half a degree of angle of attack; absorptances of paints and fluxes at a place under a lamp
scatter by a tenth. Conditions that are too early are thermocouples that lag."""
SCALED: Mapping[str, Callable[[Record, FloatArray | float], Record]] = {
    "density": changed_flight.with_density,
    "velocity": changed_flight.with_velocity,
}
"""By quantity, the record whose flight has it multiplied by a factor."""
SHIFT_STARTS = (-30.0, -10.0, 10.0, 30.0)
"""Shifts that a fit may start from [s]: its likelihood has a maximum of its own at each steep part of the heating."""
THINNEST_M, BRIEFEST_S = 1000.0, 20.0
"""Least thickness of a layer and least duration of a drift: shorter ones would imitate a manoeuvre."""


def judged_by_motion(record: Record, fit: TrialFit) -> tuple[float, list[str]]:
    """What the motion of the flight says against a change of the record [BIC], and how it contradicts it, in a line.

    record  : the whole record, with all samples of its conditions
    returns : evidence, negative where the motion follows from the forces better with the change, and a line; 0 and none
              for a change of wall or sensors, or in a test without flow

    The heating alone hardly tells a layer of density from an error of the velocity; the drag does. A change that
    deviates by more than the scatter of the whole flight, and more than the conditions as stated, explains the heating
    by a flight that was not flown.
    """
    if fit.change is None or fit.change.kind != "flight" or not record.has_flow:
        return 0.0, []
    stated, changed = record.conditions, fit.change.apply(record, fit.value).conditions
    lines = [f"{fit.change.what}: {d.message}" for d in contradictions_of_motion(stated, changed)[:1]]
    return misfit_of_motion(changed) - misfit_of_motion(stated), lines


def _at_least(length: float, spans: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    return [span for span in spans if span[1] - span[0] >= length]


def flight_changes(record: Record, suspected: Sequence[Discrepancy] = ()) -> list[RecordChange]:
    """Changes of the flight that may explain a record; none for a ground test.

    suspected : parts of the flight whose conditions contradict each other; layers of density and drifts of velocity are
                tried there as well as along the whole heated descent
    """
    min_flight_m_s = 1000.0  # a record whose velocity stays below is a ground test
    # parts of the heated descent, and of the heated time, at whose ends layers of density and drifts of velocity are
    # tried
    layers_tried, drifts_tried = 8, 6
    max_suspected = 4  # contradictions within the conditions, the clearest ones, whose spans are tried
    flown = record.conditions
    if flown["velocity_m_s"].max() < min_flight_m_s:
        return []
    heated, spans = changed_flight.heated_part(flown), suspected[:max_suspected]
    z, t = flown["altitude_m"][heated], flown.time_s[heated]
    z_span, t_span = (float(z.min()), float(z.max())), (float(t.min()), float(t.max()))
    layers = _at_least(THINNEST_M, [(d.lowest_m, d.highest_m) for d in spans] + _parts(z_span, layers_tried))
    times = [(d.begin_s, d.end_s) for d in spans] + _across(spans) + _parts(t_span, drifts_tried)
    times = _at_least(BRIEFEST_S, times)
    likeliest_s = likeliest_shift_s(record)
    starts = SHIFT_STARTS if likeliest_s is None else tuple(dict.fromkeys((*SHIFT_STARTS, likeliest_s)))
    return [
        time_shift(starts),
        trajectory_shift(starts),
        scale("density"),
        scale("velocity"),
        alpha_bias(),
        alpha_smoothed(),
        *(form.between(*span, z_span) for form in (DENSITY_LAYER, SMOOTH_LAYER) for span in layers),
        *(form.between(*span, t_span) for form in (VELOCITY_DRIFT, VELOCITY_EXCURSION) for span in times),
    ]


def _across(spans: Sequence[Discrepancy]) -> list[Span]:
    """Times from one contradiction to another of the same relation: an error of the velocity that is undone again shows
    in the deceleration where it grows, and with the other sign where it falls."""
    pairs = [(a, b) for a in spans for b in spans if a.relation == b.relation and a.begin_s < b.begin_s]
    return [(a.begin_s, b.end_s) for a, b in pairs]


def _parts(span: Span, count: int) -> list[Span]:
    """Spans of one, two and four parts of a range that is divided into `count`, each beginning at every part."""
    at = np.linspace(*span, count + 1)
    return [(float(at[i]), float(at[i + k])) for k in (1, 2, 4) for i in range(0, count + 1 - k)]


def likeliest_shift_s(record: Record) -> float | None:
    """Time by which the flight was later than its conditions, by the shape of the temperatures [s]; None where unknown.

    Readings are fitted by a + b (prediction of the declared model, shifted), so that an error of the heating as a whole
    does not count.
    """
    step_s = 10.0  # step of the shifts that are compared [s]
    try:
        flown_s, indicated_K = declared_readings(record)
    except RunError:
        return None
    used = [i for i, s in enumerate(record.sensors) if s.used]
    t, read, fitted = record.time_s, record.temperatures_K()[used], record.fit_mask()
    shifts = np.arange(UNKNOWNS["shift"].lower, UNKNOWNS["shift"].upper + step_s, step_s)
    error_K = np.array([_shape_error_K(s, t[fitted], read[:, fitted], flown_s, indicated_K[used]) for s in shifts])
    return float(shifts[np.nanargmin(error_K)]) if np.any(np.isfinite(error_K)) else None


def _shape_error_K(
    shift_s: float, t: FloatArray, read: FloatArray, flown_s: FloatArray, indicated: FloatArray
) -> float:
    """RMS about the line of measured over shifted predicted temperatures [K]; NaN for too little overlap."""
    min_overlap = 0.6  # part of the readings that a shifted flight has to cover
    at = t - shift_s
    inside = (at >= flown_s[0]) & (at <= flown_s[-1])
    if np.count_nonzero(inside) < min_overlap * len(t):
        return float("nan")
    squares, count = 0.0, 0
    for measured, predicted in zip(read, indicated, strict=True):
        compared = inside & np.isfinite(measured)
        x, y = np.interp(at[compared], flown_s, predicted), measured[compared]
        if len(y) < 10 or np.ptp(x) == 0.0:
            continue
        # The shape alone, free in level and scale: a wrong table must not be mistaken for another flight.
        x, y = x - np.mean(x), y - np.mean(y)
        squares, count = squares + max(float(y @ y - (x @ y) ** 2 / (x @ x)), 0.0), count + len(y)
    return float(np.sqrt(squares / count)) if count else float("nan")


def time_shift(starts: Sequence[float] = SHIFT_STARTS) -> RecordChange:
    """The flight was earlier or later than the clock of its conditions states; starts : as of a change [s]."""
    text, unknown, describe = "time of the flight conditions", UNKNOWNS["shift"], _shifted("flight conditions")
    return RecordChange(
        "flight", text, unknown, changed_flight.shift_conditions, describe, tuple(starts), effect="time-skew"
    )


def trajectory_shift(starts: Sequence[float] = SHIFT_STARTS) -> RecordChange:
    """Velocity, altitude and air were earlier or later than stated, and the angles were not: two sources, merged.

    starts : as of a change [s]
    """
    text, describe = "velocity, altitude and air", _shifted("velocity, altitude and air", " against the angles")
    return RecordChange(
        "flight",
        f"time of {text} against the angles",
        UNKNOWNS["shift"],
        changed_flight.shift_trajectory,
        describe,
        tuple(starts),
    )


def scale(quantity: str) -> RecordChange:
    """The density, or the velocity, was another by a factor along the whole flight; quantity : which of them."""
    text = f"{quantity} of the flight conditions"
    return RecordChange("flight", text, UNKNOWNS[quantity], SCALED[quantity], _scaled(text))


@dataclass(frozen=True)
class Variation:
    """A factor of the density that varies along the altitude, or of the velocity along the time.

    quantity : "density" or "velocity"
    name     : of the change, without its ends;  where : at which place it has its value, in words
    shape    : from its ends, altitudes [m] or times [s], and the part of the factor that holds there [-]
    """

    quantity: str
    name: str
    where: str
    shape: Callable[[float, float], tuple[Sequence[float], Sequence[float]]]

    def between(self, low: float, high: float, limits: Span = EVERYWHERE) -> RecordChange:
        """The change between two altitudes [m] or times [s]; limits : that these may be moved in."""
        of_density = self.quantity == "density"
        ends = f"{low / 1e3:.1f} and {high / 1e3:.1f} km" if of_density else f"from {low:.0f} to {high:.0f} s"
        text, shortest = f"{self.name} {ends}", THINNEST_M if of_density else BRIEFEST_S
        at, part = self.shape(low, high)

        def apply(record: Record, factor: float) -> Record:
            x = record.conditions["altitude_m"] if of_density else record.conditions.time_s
            return SCALED[self.quantity](record, 1.0 + (factor - 1.0) * np.interp(x, at, part))

        def near(fraction: float) -> list[RecordChange]:
            return [self.between(*ends, limits) for ends in moved_ends((low, high), fraction, shortest, limits)]

        words = _scaled(text, self.where)
        return RecordChange("flight", text, UNKNOWNS[self.quantity], apply, words, form=self.name, near=near)


def _sharp(low: float, high: float) -> tuple[list[float], list[float]]:
    """Altitudes of a layer with edges of 1 m, and 1 within it."""
    return [low - 1.0, low, high, high + 1.0], [0.0, 1.0, 1.0, 0.0]


def _smooth(low: float, high: float) -> tuple[list[float], list[float]]:
    """Altitudes that a layer is interpolated between, and 1 - cos there."""
    at = np.linspace(0.0, 1.0, 33)
    return (low + (high - low) * at).tolist(), (0.5 - 0.5 * np.cos(2.0 * np.pi * at)).tolist()


def _drift(begin: float, end: float) -> tuple[list[float], list[float]]:
    """Times of a drift, and a rise to 1 at the second, which stays."""
    return [begin, end], [0.0, 1.0]


def _excursion(begin: float, end: float) -> tuple[list[float], list[float]]:
    """Times of an excursion, and a rise to 1 in the middle of them and back."""
    return [begin, 0.5 * (begin + end), end], [0.0, 1.0, 0.0]


DENSITY_LAYER = Variation("density", "density between", "", _sharp)
"""The density was another by a factor between two altitudes."""
SMOOTH_LAYER = Variation("density", "density of a smooth layer between", ", at most", _smooth)
"""The density was another by a factor that rises and falls between two altitudes, as 1 - cos."""
VELOCITY_DRIFT = Variation("velocity", "drift of the velocity", ", at its end", _drift)
"""The velocity drifts away between two times, and keeps the factor that it has at the second."""
VELOCITY_EXCURSION = Variation("velocity", "excursion of the velocity", ", at its largest", _excursion)
"""The velocity drifts away between two times and returns as evenly: an error that was corrected."""


def alpha_bias() -> RecordChange:
    """The angle of attack was another by some degrees, along the whole flight."""

    def describe(value: float) -> str:
        return f"angle of attack {abs(value):.2g} deg too {'small' if value > 0.0 else 'large'}"

    text = "angle of attack of the flight conditions"
    return RecordChange("flight", text, UNKNOWNS["angle of attack"], changed_flight.with_alpha, describe)


def alpha_smoothed() -> RecordChange:
    """The stated angle of attack is a mean over some seconds of the one flown."""

    def describe(width_s: float) -> str:
        return f"angle of attack stated as a mean over {width_s:.2g} s (standard deviation)"

    text = "smoothing of the angle of attack"
    starts_s = (5.0, 12.0)  # of the width: from 0 a small one changes nothing
    return RecordChange("flight", text, UNKNOWNS["smoothing"], changed_flight.with_sharper_alpha, describe, starts_s)


def _shifted(quantity: str, suffix: str = "") -> Callable[[float], str]:
    """Words for a shift in time by which the true values are later than the stated ones [s]."""
    return lambda value: f"{quantity} {abs(value):.3g} s too {'early' if value > 0.0 else 'late'}{suffix}"


def _scaled(quantity: str, suffix: str = "") -> Callable[[float], str]:
    """Words for a factor of true over stated values."""
    return lambda factor: (
        f"{quantity} {100.0 * abs(1.0 / factor - 1.0):.2g} % too {'low' if factor > 1.0 else 'high'}{suffix}"
    )


def lamp_changes(record: Record) -> list[RecordChange]:
    """Another flux of the lamp, or absorptance of the surface; none where air flows past the wall or nothing is lit.

    A test under a lamp has no reference heating whose ratio could take up an error of the flux, and the flux of a lamp,
    or the absorptance of a surface, is what is known worst in it. Both are one factor of the column `q_add_W_m2`.
    """
    flown = record.conditions
    if record.has_flow or "q_add_W_m2" not in flown or not np.any(flown["q_add_W_m2"]):
        return []

    def with_flux(stated: Record, factor: float) -> Record:
        column = factor * stated.conditions["q_add_W_m2"]
        return replace(stated, conditions=stated.conditions.with_columns(q_add_W_m2=column))

    def describe(factor: float) -> str:
        return f"flux of the lamp (or absorptance of the surface) {off_by(factor, 'above', 'below')} the stated one"

    return [RecordChange("flight", "flux of the lamp", UNKNOWNS["flux"], with_flux, describe)]
