"""What closing the loop on whole records found, as the fits of their manoeuvres take it over.

A manoeuvre is too short to find an effect in, and a fit without one that the flight has is wrong. What the whole record
showed is therefore in the model of each of its manoeuvres, with the values and bounds of the whole record as prior.

Where the records of a control point each cannot tell the same names apart, all fits of the point take one of them: the
name that most records put first among those that every one of them allows.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from sim_heating.base.files import read_json
from sim_heating.base.parameters import CLOCK_SKEW, EFFECT_PREFIX, SENSOR_PREFIX
from sim_heating.closure.result import FOUND, NAME, NONE, ONE_OF
from sim_heating.heating.effects import EffectUse, effects, use

SKEW = "time-skew"
"""Name of a clock error among the effects of a closure report."""
OF_SENSORS = ("sensor-bias", "sensor-lag")
"""Names of errors of thermocouples there."""

Estimate = tuple[float, float]
"""Value and standard deviation of a parameter, in its unit; 0 where it is on a bound."""


@dataclass(frozen=True)
class Carried:
    """What a closed loop adds to the model of a record's fits.

    sets      : for each thing found, the names that the record cannot tell apart, the likeliest first
    by_effect : name -> dotted name of each of its parameters -> its estimate
    finding   : as closure.json states it, and what is named
    doubt     : why no table should be revised by fits of this record; empty where nothing speaks against it
    """

    sets: tuple[tuple[str, ...], ...] = ()
    by_effect: Mapping[str, Mapping[str, Estimate]] = field(default_factory=dict)
    finding: str = ""
    doubt: str = ""

    @property
    def estimates(self) -> dict[str, Estimate]:
        """Dotted name -> estimate, of everything found."""
        return {name: estimate for parameters in self.by_effect.values() for name, estimate in parameters.items()}


def effect_uses(values: Mapping[str, float]) -> tuple[EffectUse, ...]:
    """The effects among dotted names of parameters, at these values; parameters that are not named are nominal."""
    by_effect: dict[str, dict[str, float]] = {}
    for name, value in values.items():
        if name.startswith(EFFECT_PREFIX):
            _, effect, parameter = name.split(".", 2)
            by_effect.setdefault(effect, {})[parameter] = value
    return tuple(use(effect, parameters) for effect, parameters in by_effect.items())


def read_carried(folder: Path) -> Carried:
    """What the closed loop in a folder of results adds to the fits of its record.

    raises : InputError where its closure.json cannot be read
    """
    report = read_json(folder / NAME)
    finding, sets = str(report["finding"]), tuple(map(tuple, report["alternatives"]))
    conclusion = ": ".join(filter(None, (finding, " + ".join(map(" or ".join, sets)))))
    causes = "; ".join(f"{c['kind']}: {c['what']}" for c in report["not_effects"])
    if finding not in (FOUND, ONE_OF):
        doubt = "" if finding == NONE else f"closing the loop on the whole record ends with {conclusion}"
        return Carried(finding=conclusion, doubt=doubt)
    if causes:
        return Carried(
            finding=conclusion, doubt=f"the record is in error ({causes}); correct it, and run the campaign again"
        )
    by_effect = {name: _of_effect(name, report["estimated"]) for names in sets for name in names[:1]}
    for name, parameters in by_effect.items():
        if not parameters:
            return Carried(finding=conclusion, doubt=f"`{name}` has a form of its own, which fits of manoeuvres lack")
    return Carried(sets, by_effect, conclusion)


def _of_effect(name: str, estimated: Mapping[str, Any]) -> dict[str, Estimate]:
    """Estimates of a closure report that are of one effect, by dotted names; empty for an effect with another form."""
    if name == SKEW:
        begin = CLOCK_SKEW.name
    elif name in OF_SENSORS:
        begin = SENSOR_PREFIX
    elif name in effects():
        begin = f"{EFFECT_PREFIX}{name}."
    else:
        return {}
    return {n: (float(e["value"]), float(e["sigma"] or 0.0)) for n, e in estimated.items() if n.startswith(begin)}


def agreed(records: Sequence[Carried]) -> list[Carried]:
    """What the records of one control point found, under one name where they allow one in common.

    The values of a record that put another name first are those of the records that put this one first, on average.
    """
    chosen = [_with_names(c, _common_names(c, records)) for c in records]
    of_name: dict[str, list[Mapping[str, Estimate]]] = {}
    for c in records:
        for name, parameters in c.by_effect.items():
            of_name.setdefault(name, []).append(parameters)
    return [
        replace(c, by_effect={n: before.by_effect.get(n, mean_estimates(of_name.get(n, []))) for n in c.by_effect})
        for c, before in zip(chosen, records, strict=True)
    ]


def _common_names(carried: Carried, records: Iterable[Carried]) -> list[str]:
    """For each thing that a record found, the name that most records put first among those that all allow.

    Its own first name where they have none in common; of several equally frequent names the first by the alphabet.
    """
    names = []
    for alternatives in carried.sets:
        alike = [s for c in records for s in c.sets if set(s) & set(alternatives)]
        common = set(alternatives).intersection(*alike)
        firsts = Counter(s[0] for s in alike if s[0] in common)
        # of names that equally many put first all records are to take the same one
        names.append(max(sorted(firsts), key=lambda n: firsts[n]) if firsts else alternatives[0])
    return names


def _with_names(carried: Carried, names: Sequence[str]) -> Carried:
    return replace(carried, by_effect={name: carried.by_effect.get(name, {}) for name in names})


def mean_estimates(estimates: Sequence[Mapping[str, Estimate]]) -> dict[str, Estimate]:
    """Mean of the estimates of several records, of the parameters that all have; the largest of their bounds."""
    if not estimates:
        return {}
    common = [n for n in estimates[0] if all(n in other for other in estimates)]
    return {n: (sum(s[n][0] for s in estimates) / len(estimates), max(s[n][1] for s in estimates)) for n in common}
