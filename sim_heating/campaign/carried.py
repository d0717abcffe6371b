"""What closing the loop on a whole record found, as the fits of its manoeuvres take it over.

A manoeuvre is too short to find an effect in, and a fit without one that the flight has is wrong. What the whole record
showed is therefore in the model of each of its manoeuvres: its parameters are estimated again where the manoeuvre
tells them, and have the values of the whole record where it does not.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from sim_heating.base.files import read_json
from sim_heating.base.parameters import AT, EFFECT_PREFIX
from sim_heating.closure.report import NAME
from sim_heating.closure.statement import FOUND, NONE, ONE_OF
from sim_heating.heating.effects import EffectUse, effects, use

NOT_CARRIED = ("ratio.", "initial.")
"""Parameters of a fit that are of its segment alone."""


@dataclass(frozen=True)
class Carried:
    """What a closed loop adds to the model of a record's fits.

    values   : dotted name -> value of parameters that are no part of the ratio [unit of the parameter]
    finding  : as closure.json states it, and what is named
    doubt    : why no table should be revised by fits of this record; empty where nothing speaks against it
    """

    values: Mapping[str, float] = field(default_factory=dict)
    finding: str = ""
    doubt: str = ""

    @property
    def names(self) -> tuple[str, ...]:
        """Dotted names of the parameters."""
        return tuple(self.values)

    def uses(self) -> tuple[EffectUse, ...]:
        """The effects among them, at these values; parameters that are not named are nominal."""
        found: dict[str, dict[str, float]] = {}
        for name, value in self.values.items():
            if name.startswith(EFFECT_PREFIX):
                _, effect, parameter = name.split(".", 2)
                found.setdefault(effect, {})[parameter] = value
        return tuple(use(effect, parameters) for effect, parameters in found.items())


def read_carried(folder: Path) -> Carried:
    """What the closed loop in a folder of results adds to the fits of its record.

    raises : InputError where its closure.json cannot be read
    """
    report = read_json(folder / NAME)
    finding = str(report["finding"])
    named = " + ".join(" or ".join(names) for names in report["alternatives"])
    words = f"{finding}: {named}" if named else finding
    causes = "; ".join(f"{c['kind']}: {c['what']}" for c in report["not_effects"])
    if causes and finding in (FOUND, ONE_OF):
        return Carried({}, words, f"the record itself is in error ({causes}); correct it and run the campaign again")
    if finding == NONE:
        return Carried({}, words)
    if finding not in (FOUND, ONE_OF):
        return Carried({}, words, "")
    values = _carried_values(report)
    own = {n.split(".")[1] for n in values if n.startswith(EFFECT_PREFIX)}
    without = [name for name in own if name not in effects()]
    if without:
        return Carried({}, words, f"`{without[0]}` has a form of its own, which fits of manoeuvres do not take over")
    return Carried(values, words)


def _carried_values(report: Mapping[str, Any]) -> dict[str, float]:
    """Estimates of the last fit that are neither of the ratio nor of the start."""
    return {
        name: float(p["value"])
        for name, p in report["estimated"].items()
        if AT not in name and not name.startswith(NOT_CARRIED)
    }
