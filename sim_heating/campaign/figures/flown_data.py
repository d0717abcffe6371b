"""What the figures are drawn from: control points by their part in the paper, manoeuvres by speed, fits about them.

The heating model of a fit is equation 2 of the founding paper: a ratio linear in angle of attack or elevon, without a
table, constant parameters over one manoeuvre. It is the ratio of a fully catalytic wall where the record declares
recombination, as that of a table is.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeVar

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import RATIO_VARIABLES
from sim_heating.base.errors import InputError, RunError, one_line
from sim_heating.base.files import suggestion
from sim_heating.base.report.figure import MANOEUVRE_NAMES
from sim_heating.campaign.flights import CampaignFlight, Manoeuvre
from sim_heating.estimation.filter.process_noise import ProcessNoise
from sim_heating.estimation.fit import FitResult, estimate
from sim_heating.estimation.inference.newton import NewtonSettings
from sim_heating.estimation.starts import READINGS, start_at
from sim_heating.estimation.trend import Trend, trend
from sim_heating.heating.effects import EffectUse, use
from sim_heating.heating.effects.transition import TRANSITION
from sim_heating.inputs.points import conditions_of_record, intermittency_along, point_of_record
from sim_heating.inputs.record import Record
from sim_heating.inputs.vehicle import Vehicle, load_vehicle
from sim_heating.simulation.predict import Prediction, predict
from sim_heating.thermal.stack import Sensor

T = TypeVar("T")

POINTS = {"lower": "V09T9527", "elevon": "V07T9730", "pod": "V07T9975", "tunnel": "TUNNEL_FRSI"}
"""Part of a control point in the paper -> the control point: lower surface, outboard elevon, side of the OMS pod, felt
on the plate of the wind tunnel."""
POPU = ("popu",)
FLAP = ("bodyflap-sweep", "elevon-sweep", "bodyflap-pulse", "elevon-pulse")
"""Kinds of manoeuvres that move the elevon, itself or because it trims the body flap."""
SIGMAS = 2.0
"""Half width of a band, and largest difference that agrees, in standard deviations [-]."""
MACH_SPAN = 1.5
"""Largest distance of a manoeuvre from the paper's, in speed over 1000 ft/s."""
FIT_SPAN_S = 10.0
"""Time before and after a manoeuvre that is fitted with it [s]: parameters are constant over a short time only."""

STAGNATION, ECKERT = "stagnation", "eckert-turbulent"
REFERENCES = {"both": (STAGNATION, ECKERT), STAGNATION: (STAGNATION,), ECKERT: (ECKERT,)}
"""Choice of the reference heating of figure 9 -> those that are shown; stagnation is that of the records."""
ONSET, SLOPE = "effect.impingement-onset.alpha_onset_deg", "effect.impingement-onset.slope"
SKEW, COATING = "clock.skew", "stack.coating.thickness_factor"
LAG = use("nonisothermal-wall", {"lag_s": 1.0, "lag_fraction": 1.0, "overshoot": 0.0})
"""All of the ratio lags, by a time that a fit finds."""
LAG_TIME = "effect.nonisothermal-wall.lag_s"
JET_GAIN = "effect.jet-interaction.jet_gain"
LENGTH_S = 5.0
"""Length of the paper's sequential segments [s]."""
LONG_FIT_SPAN_S = {"pod": 40.0}
"""Time fitted before and after a manoeuvre where the wall remembers longer [s]: felt under a thick coating, whose
fit with a skew does not converge over a shorter time. The paper made its segments longer, too."""
TREND_BEFORE_S, TREND_AFTER_S = 20.0, 40.0
"""Time before and after the manoeuvre over which they follow each other [s]."""


class LeftOut(Exception):
    """A figure that the given flights cannot give; the text is the reason."""


@dataclass(frozen=True, eq=False)
class PointManoeuvre:
    """One manoeuvre at one control point.

    flight    : name of the flight;  record : of the control point;  manoeuvre : when, and how fast
    segment_s : start and end of the fit [s]: the manoeuvre and some time about it, as far as there are readings
    """

    flight: str
    record: Record
    manoeuvre: Manoeuvre
    segment_s: tuple[float, float]

    @property
    def mach(self) -> str:
        """`Mach 20`, in units of 1000 ft/s."""
        return f"Mach {self.manoeuvre.shuttle_mach:.0f}"

    @property
    def key(self) -> str:
        """`mach20`, for names of files and columns."""
        return f"mach{self.manoeuvre.shuttle_mach:.0f}"

    @property
    def label(self) -> str:
        """Flight, speed and kind, as `STS-2, Mach 20 pushover-pullup`."""
        kind = MANOEUVRE_NAMES.get(self.manoeuvre.kind, self.manoeuvre.kind)
        return f"{self.flight}, {self.mach} {kind}"

    @property
    def outermost(self) -> tuple[int, Sensor]:
        """Number and declaration of the used thermocouple nearest the surface."""
        used = [(i, s) for i, s in enumerate(self.record.sensors) if s.used]
        return min(used, key=lambda pair: pair[1].depth_m)


class FlownData:
    """Flights, and what several figures take from them: predictions and fits, made once.

    flights   : at least one;  points : part in the paper -> control point, where not the paper's own
    reference : a key of REFERENCES
    raises    : InputError for an unknown part or reference, or a control point of which no flight has a record
    """

    def __init__(
        self, flights: Sequence[CampaignFlight], points: Mapping[str, str] | None = None, reference: str = "both"
    ) -> None:
        self.flights = tuple(flights)
        if reference not in REFERENCES:
            raise InputError(f"--reference: `{reference}` is not a choice{suggestion(reference, REFERENCES)}")
        self.references = REFERENCES[reference]
        flown = sorted({name for flight in self.flights for name in flight.records})
        for region, name in (points or {}).items():
            if region not in POINTS:
                raise InputError(f"--point: `{region}` is not a part in the paper{suggestion(region, POINTS)}")
            if name not in flown:
                raise InputError(f"--point {region}={name}: no flight has a record of it{suggestion(name, flown)}")
        self.points = POINTS | dict(points or {})
        self._made: dict[tuple[object, ...], object] = {}

    def _once(self, key: tuple[object, ...], make: Callable[[], T]) -> T:
        """What `make` returns or the reason that it raises, the same one whenever it is asked for again."""
        if key not in self._made:
            try:
                self._made[key] = make()
            except LeftOut as reason:
                self._made[key] = reason
            except (InputError, RunError) as error:
                self._made[key] = LeftOut(one_line(str(error)))
        result = self._made[key]
        if isinstance(result, LeftOut):
            raise result
        return result  # type: ignore[return-value]

    def records_of(self, region: str) -> list[tuple[CampaignFlight, Record]]:
        """The flights with a record of a region of the paper.

        raises : LeftOut where there is none
        """
        name = self.points[region]
        records = [(flight, flight.records[name]) for flight in self.flights if name in flight.records]
        if not records:
            flown = ", ".join(sorted({n for flight in self.flights for n in flight.records}))
            raise LeftOut(f"no flight has a record of {name}; name another point of {flown}: --point {region}=NAME")
        return records

    def manoeuvre(self, region: str, kinds: Sequence[str], mach: float) -> PointManoeuvre:
        """The manoeuvre of these kinds whose speed is nearest, with readings of the point.

        mach   : speed in units of 1000 ft/s
        raises : LeftOut where none is within MACH_SPAN, or nothing was read in any
        """
        near = [
            (abs(m.shuttle_mach - mach), flight, record, m)
            for flight, record in self.records_of(region)
            for m in flight.manoeuvres
            if m.kind in kinds
        ]
        candidates = sorted(filter(lambda f: f[0] <= MACH_SPAN, near), key=lambda f: f[0])
        description = f"{MANOEUVRE_NAMES[kinds[0]]} near Mach {mach:g}"
        if not candidates:
            others = ", ".join(f"{f[3].shuttle_mach:.1f}" for f in near) or "none at all"
            raise LeftOut(
                f"no {description} (speed over 1000 ft/s) with a record of {self.points[region]}; flown: {others}"
            )
        for _, flight, record, m in candidates:
            segment = fit_segment(record, m, LONG_FIT_SPAN_S.get(region, FIT_SPAN_S))
            if segment is not None:
                return PointManoeuvre(flight.name, record, m, segment)
        raise LeftOut(f"{self.points[region]}: no readings during the {description}")

    def declared(self, record: Record, without: Sequence[str] = ()) -> Prediction:
        """The declared model of a record from the start of its conditions, without some of its effects."""

        def march() -> Prediction:
            return predict(record, point_of_record(record).without_effects(without) if without else None)

        return self._once(("declared", id(record), *without), march)

    def turbulent_part(self, flown: PointManoeuvre) -> float | None:
        """Largest declared intermittency over the fit of a manoeuvre [-]; None where no transition is declared."""
        transitions = [used for used in flown.record.declared.heating.effects if used.effect.name == TRANSITION]
        if not transitions:
            return None

        def along() -> FloatArray:
            return intermittency_along(transitions[0], conditions_of_record(flown.record))

        time_s = flown.record.conditions.time_s
        inside = (time_s >= flown.segment_s[0]) & (time_s <= flown.segment_s[1])
        return float(np.max(self._once(("intermittency", id(flown.record)), along)[inside]))

    def linear_fit(self, flown: PointManoeuvre, *terms: str, jets: bool = True) -> FitResult:
        """Equation 2 of the paper fitted about a manoeuvre: magnitude, these terms, and Reynolds number.

        terms  : `alpha`, `elevon`, `elevon2` and the like, as in `ratio.d_elevon2`
        jets   : whether reaction jets that fire then are an input of the model as well
        raises : LeftOut where it cannot be fitted
        """
        names = ("ratio.d0", *(f"ratio.d_{term}" for term in terms), "ratio.d_logre")
        names += self.jet_names(flown) if jets else ()
        return self._fit(("linear", *terms, jets), flown, without_table(flown.record), names)

    def jet_names(self, flown: PointManoeuvre) -> tuple[str, ...]:
        """Name of the gain of the reaction jets, where they fire during the fit of a manoeuvre."""
        flight = flown.record.conditions
        inside = (flight.time_s >= flown.segment_s[0]) & (flight.time_s <= flown.segment_s[1])
        return (JET_GAIN,) if "jets" in flight and np.ptp(flight["jets"][inside]) > 0.0 else ()

    def impingement_fit(self, flown: PointManoeuvre, *also: str) -> FitResult:
        """A constant ratio and impingement from an onset on, with clock skew, lag or coating estimated too.

        also   : names of these other parameters
        raises : LeftOut where it cannot be fitted
        """
        names = ("ratio.d0", ONSET, SLOPE, *also, *self.jet_names(flown))
        lag = (LAG,) if LAG_TIME in also else ()
        return self._fit(("onset", *also), flown, without_table(flown.record), names, effects=lag)

    def joint_impingement_fit(self, flown: Sequence[PointManoeuvre]) -> FitResult:
        """`impingement_fit` with a lag and the coating over manoeuvres of several flights, all parameters in common;
        the ratio may change with Reynolds number.

        flown  : manoeuvres at one control point, that of the first begins the search
        raises : LeftOut where they cannot be fitted
        """
        first = self.impingement_fit(flown[0], LAG_TIME, COATING)
        jets = dict.fromkeys(name for manoeuvre in flown for name in self.jet_names(manoeuvre))
        names = ("ratio.d0", "ratio.d_logre", ONSET, SLOPE, LAG_TIME, COATING, *jets)
        values = {name: value for name, (value, _) in first.parameters.items() if name in names}
        reference = dict(zip(RATIO_VARIABLES, first.problem.reference, strict=True))
        records = list({id(manoeuvre.record): manoeuvre.record for manoeuvre in flown}.values())
        segments = [
            sorted(list(manoeuvre.segment_s) for manoeuvre in flown if manoeuvre.record is record) for record in records
        ]

        def fit() -> FitResult:
            fitted = [without_table(r).with_fit(s) for r, s in zip(records, segments, strict=True)]
            starts = [start_at("profile", s[0][0]) for s in segments]
            settings = NewtonSettings(first_values=values)
            return estimate(fitted, names, starts=starts, effects=(LAG,), reference=reference, settings=settings)

        return self._once(("joint", *map(id, records)), fit)

    def tunnel_fit(self, record: Record, *names: str) -> FitResult:
        """Parameters of a tunnel run fitted over all of it, from the declared temperatures before the run.

        raises : LeftOut where it cannot be fitted
        """
        return self._once(("tunnel", id(record), *names), lambda: estimate(record, names))

    def segments(self, flown: PointManoeuvre) -> Trend:
        """Magnitude of the ratio over short segments about a manoeuvre, the alpha derivative that of `linear_fit`.

        raises : LeftOut where no segment can be fitted
        """
        fit = self.linear_fit(flown, "alpha")
        about = dict(zip(RATIO_VARIABLES, fit.problem.reference, strict=True))
        d_alpha = fit.parameters["ratio.d_alpha"][0]
        begin = max(flown.manoeuvre.start_s - TREND_BEFORE_S, readable_from_s(flown.record))
        record = without_table(flown.record).with_fit([[begin, flown.manoeuvre.end_s + TREND_AFTER_S]])

        def fit_segments() -> Trend:
            return trend(
                record,
                LENGTH_S,
                ("ratio.d0",),
                start=start_at("profile", begin),
                fixed={"ratio.d_alpha": d_alpha},
                reference=about,
            )

        return self._once(("segments", id(flown.record), flown.manoeuvre.start_s), fit_segments)

    def filtered_fit(self, flown: PointManoeuvre, start_s: float, noise: ProcessNoise) -> FitResult:
        """`linear_fit` in angle of attack by a Kalman filter, from the temperatures of the circuit analogy at a time.

        raises : LeftOut where it cannot be fitted
        """
        names = ("ratio.d0", "ratio.d_alpha", "ratio.d_logre", *self.jet_names(flown))
        return self._fit(
            ("filtered",), flown, without_table(flown.record), names, start_s=start_s, kind="circuit", noise=noise
        )

    def _fit(
        self,
        key: tuple[object, ...],
        flown: PointManoeuvre,
        record: Record,
        names: Sequence[str],
        *,
        start_s: float | None = None,
        kind: str = "profile",
        noise: ProcessNoise | None = None,
        effects: Sequence[EffectUse] = (),
    ) -> FitResult:
        begin = flown.segment_s[0] if start_s is None else start_s
        segment = record.with_fit([[begin, flown.segment_s[1]]])

        def fit() -> FitResult:
            starts = [start_at(kind, begin)]
            return estimate(segment, names, starts=starts, process_noise=noise, effects=effects)

        return self._once((*key, id(flown.record), flown.manoeuvre.start_s), fit)

    @cached_property
    def vehicle(self) -> Vehicle:
        """The vehicle of the first flight.

        raises : LeftOut where it cannot be read
        """
        flight = self.flights[0]
        if flight.scenario is not None:
            return flight.scenario.vehicle
        name = next(iter(flight.records.values())).declared.vehicle
        if not name:
            raise LeftOut(f"the records of {flight.name} name no vehicle; add `vehicle` to one's record.toml")
        try:
            return load_vehicle(name)
        except InputError as error:
            raise LeftOut(f"the vehicle of {flight.name} is not known: {one_line(str(error))}") from None


def fit_segment(record: Record, manoeuvre: Manoeuvre, span_s: float = FIT_SPAN_S) -> tuple[float, float] | None:
    """Start and end of the fit about a manoeuvre [s]; None where nothing was read in it.

    span_s : time before and after the manoeuvre [s]
    A start needs some readings before it: where data were lost it is later.
    """
    begin = max(manoeuvre.start_s - span_s, readable_from_s(record))
    inside = (record.time_s >= max(begin, manoeuvre.start_s)) & (record.time_s <= manoeuvre.end_s)
    return (begin, manoeuvre.end_s + span_s) if np.any(inside & record.read_mask) else None


def readable_from_s(record: Record) -> float:
    """Time from which a fit may start from readings: that of the third of every used thermocouple [s], or infinite."""
    read = record.time_s[np.all(np.isfinite(record.temperatures_K(record.used_sensors)), axis=0)]
    return float(read[READINGS - 1]) if len(read) >= READINGS else np.inf


def without_table(record: Record) -> Record:
    """The record without a declared ratio, so that a fit's ratio is all of it; declared recombination stays."""
    nothing = {"ratio_table": None, "transition": None}
    heating = record.declared.heating.model_copy(update=nothing)
    declared = record.declared.model_copy(update={"heating": heating})
    return replace(record, declared=declared, ratio_table=None, turbulent=None)


def ratio_part(fit: FitResult) -> tuple[tuple[str, ...], FloatArray, FloatArray]:
    """Names of the estimated ratio parameters, their values, and their covariance, in their units."""
    names = fit.problem.record_fits[0].names
    index = [k for k, name in enumerate(names) if name.startswith("ratio.")]
    return tuple(names[k] for k in index), fit.fit.values[index], fit.bounds.covariance[np.ix_(index, index)]


def estimated(fit: FitResult, name: str) -> tuple[float, float]:
    """Value and standard deviation of an estimated parameter, in its unit; its owner apart."""
    return next(v for label, v in fit.parameters.items() if label.partition("@")[0] == name)


def agrees(value: float, sigma: float, paper: float, otherwise: float) -> bool:
    """Whether an estimate agrees with the paper's number and not with another one, by SIGMAS of its bound."""
    return abs(value - paper) < SIGMAS * sigma < abs(value - otherwise)


def fit_quality(fit: FitResult) -> str:
    """RMSE of a fit and its noise floor [K], and whether it converged, as text."""
    record = fit.problem.record_fits[0].record
    errors = fit.after[0].segment_errors()["fit"]
    rmse = f"RMSE {errors['rmse_K']:.2f} K, noise {record.noise_floor_K():.2f} K"
    return rmse if fit.fit.converged else f"{rmse}; {fit.fit.status.value}"


def plus_minus(value: float, sigma: float) -> str:
    """Value and standard deviation as text, both to the second digit of the latter."""
    if not (np.isfinite(sigma) and sigma > 0.0):
        return f"{value:.3g}"
    digits = max(0, 1 - int(np.floor(np.log10(sigma))))
    return f"{value:.{digits}f} +- {sigma:.{digits}f}"
