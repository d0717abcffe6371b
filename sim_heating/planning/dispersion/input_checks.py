"""Inputs of a dispersed entry that no flight can have, told before any flight."""

from __future__ import annotations

from sim_heating.base.errors import InputError
from sim_heating.base.files import repeated_name
from sim_heating.planning.dispersion.entry import DispersedEntry, require_pyarrow
from sim_heating.planning.dispersion.flight import entry_with_deviations
from sim_heating.planning.dispersion.spec import FLIGHT_INPUTS, LARGEST_SIGMAS, DispersedInput


def check_inputs(entry: DispersedEntry) -> None:
    """Check the inputs of a dispersed entry before any flight.

    raises : InputError with one line a problem
    """
    require_pyarrow()
    problems = []
    for k, i in enumerate(entry.inputs):
        try:
            _check_input(entry, i, k)
        except InputError as error:
            problems += [f"{entry.study.path}, [dispersion], input {k + 1}: {line}" for line in error.problems]
    if (label := repeated_name(entry.labels)) is not None:
        problems.append(f"{entry.study.path}, [dispersion]: `{label}` is repeated; give it once")
    if problems:
        raise InputError(*problems)


def _check_input(entry: DispersedEntry, i: DispersedInput, k: int) -> None:
    low, high = (i.low, i.high) if i.sigma is None else (-LARGEST_SIGMAS * i.sigma, LARGEST_SIGMAS * i.sigma)
    assert low is not None  # DispersedInput has either sigma or both ends
    assert high is not None
    for name in i.control_points or []:
        entry.study.vehicle.control_point(name)
        if name not in entry.point_names:
            raise InputError(f"`{i.name}`: `{name}` is not among the study's control points")
    if i.name in FLIGHT_INPUTS:
        _check_flight_input(entry, i, entry.labels[k], low, high)
        return
    if i.name.startswith("ratio.") and i.name != "ratio.scale":
        raise InputError(
            f"`{i.name}` is not dispersed: the sigma of the ratio tables states their error; disperse `ratio.scale`"
        )
    points = i.points_of(entry.point_names)
    for p in points:
        entry.lanes.place_of(p, i.name)  # it exists there
    _require_room(entry, i, points, low, high)


def _require_room(entry: DispersedEntry, i: DispersedInput, points: list[int], low: float, high: float) -> None:
    """Refuse deviations that leave the range of a parameter at any of the points."""
    for model in (m.models[p] for m in entry.members.each for p in points if not m.replaces(p, i.name)):
        definition, value = model.definition(i.name), model.value(i.name)
        if not definition.lower <= value + low <= value + high <= definition.upper:
            raise InputError(
                f"`{i.name}`: {value + low:g} to {value + high:g} leaves {definition.lower:g} to "
                f"{definition.upper:g} at {model.name}, by {LARGEST_SIGMAS:g} sigma; make it narrower, or uniform"
            )


def _check_flight_input(entry: DispersedEntry, i: DispersedInput, label: str, low: float, high: float) -> None:
    aero = entry.sampler.aero
    for value in (low, high):
        spec = entry_with_deviations(entry.sampler.base, entry.inputs, {label: value})
        aero.with_changes(
            mass_kg=spec.vehicle.mass_kg, cg_fraction=spec.vehicle.cg_fraction, cm_shift=spec.vehicle.cm_shift
        )
        factors = [f for _, f in spec.dispersions.density_factor or ()]
        initial = spec.initial
        if i.name in ("aero.CN", "aero.CA"):
            factors.append(1.0 + value)
        if factors and min(factors) <= 0.0:
            raise InputError(
                f"`{i.name}`: a deviation of {value:g} makes a factor of {min(factors):g}, which must be above 0; "
                "make the deviation smaller"
            )
        if initial is not None and not (initial.altitude_m > 0.0 and initial.velocity_m_s > 0.0):
            raise InputError(f"`{i.name}`: a deviation of {value:g} leaves no altitude or no velocity; make it smaller")
