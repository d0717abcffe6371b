"""Effects that a declared model may lack: one file each, found by being in this folder.

A file of this folder, or of a folder named in SIM_HEATING_EFFECTS (a path list), defines EFFECT = Effect(...). There
are two kinds. An effect on the heating or on the emittance has a kernel

    f(B, c, p, wall_K) -> float

that reads the flight conditions from B[c] on and its own parameters from B[p] on (offsets in base/kernels/block.py),
takes the wall temperature [K], and returns what is added to the heating ratio [-], or the factor [-] on the ratio or
the emittance. An effect of mode "model" has no kernel: its parameters stand for existing parameters of the model
(`places`).

Effects act in the order of docs/effects.md, equation 1: those that add, the lag, those that multiply.
"""

from __future__ import annotations

import importlib
import importlib.util
import os
import pkgutil
import sys
import traceback
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Literal

from sim_heating.base.conditions import Conditions
from sim_heating.base.errors import InputError
from sim_heating.base.files import suggestion
from sim_heating.base.kernels.block import EFFECT_SLOTS, EFFECT_WIDTH
from sim_heating.base.parameters import CLOCK_SKEW, Parameter

__all__ = ["Effect", "EffectUse", "effect", "effects", "own_files", "use"]

FOLDERS_VARIABLE = "SIM_HEATING_EFFECTS"


@dataclass(frozen=True)
class Try:
    """One start of the search for an effect: the parameters estimated together, and where the search begins.

    names : parameters of the effect that are estimated together
    start : initial values of any of its parameters, each in its own unit; else the neutral value, or else the nominal

    A start at which the effect is neutral is best: the sensitivity to its magnitude there gives to first order how much
    the effect would reduce the error.
    """

    names: tuple[str, ...]
    start: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Effect:
    """An effect on the heating, on the emittance, or on parameters of the model.

    name       : as in a closure report
    mode       : "add" to the ratio; "multiply" the ratio, after everything that adds; "emittance"; or "model"
    parameters : in the order in which the kernel reads them; EFFECT_WIDTH at most
    kernel     : compiled f(B, c, p, wall_K); None for an effect of mode "model"
    needs_wall : whether the kernel's value depends on the wall temperature
    lags       : whether the ratio lags; the first two parameters are then time constant [s] and fraction [-]
    places     : dotted names that the parameters of a "model" effect stand for, in their order
    needs      : columns of the flight conditions that have to be there and to vary for the effect to be identifiable;
                 `close-loop` looks for it in no other flight
    neutral    : its magnitudes and the values at which, all of them together, it does nothing for any other parameters
    tries      : for a flight's conditions, the starts of the search for it in data; by default one, with all parameters
                 that have a prior, from their nominal values
    physics    : the physical process, in a line
    source     : publication or flight in which it was seen
    raises     : InputError where parameters are too many, mode and kernel contradict each other, `places` and
                 parameters differ in number, or `neutral` names a parameter that does not exist
    """

    name: str
    mode: Literal["add", "multiply", "emittance", "model"]
    parameters: tuple[Parameter, ...]
    kernel: Callable[..., float] | None = field(default=None, compare=False)
    needs_wall: bool = False
    lags: bool = False
    places: tuple[str, ...] = ()
    needs: tuple[str, ...] = ()
    neutral: Mapping[str, float] = field(default_factory=dict, compare=False)
    tries: Callable[[Conditions], Sequence[Try]] | None = field(default=None, compare=False)
    physics: str = ""
    source: str = ""

    def __post_init__(self) -> None:
        if len(self.parameters) > EFFECT_WIDTH:
            raise InputError(f"effect {self.name}: {len(self.parameters)} parameters; {EFFECT_WIDTH} at most")
        if (self.mode == "model") != (self.kernel is None):
            raise InputError(f"effect {self.name}: a kernel goes with any mode but `model`, and with those always")
        if self.mode == "model" and len(self.places) != len(self.parameters):
            raise InputError(f"effect {self.name}: name a place for each of its {len(self.parameters)} parameters")
        self._known(self.neutral, "neutral")

    @property
    def built_in(self) -> bool:
        """Whether its kernel is one of the package's; False for a user-defined one and for mode "model"."""
        return getattr(self.kernel, "__module__", "").startswith(f"{__name__}.")

    @property
    def acts_on_clock(self) -> bool:
        """Whether it changes the times of a record's readings: such an effect has no part in the march."""
        return CLOCK_SKEW.name in self.places

    def own_name(self, place: str) -> str | None:
        """Name within this effect of a parameter of the model, such as `skew_s` of `clock.skew`; None for another."""
        return dict(zip(self.places, (p.name for p in self.parameters), strict=False)).get(place)

    def tried(self, flown: Conditions) -> Sequence[Try]:
        """Starts of the search for this effect in a flight's data.

        flown   : conditions of the flight, over which onsets and times are spread
        returns : starts, each completed with the effect's neutral values
        raises  : InputError where a start names a parameter that the effect does not have
        """
        if self.tries is None:
            return [Try(tuple(p.name for p in self.parameters if p.sigma > 0.0))]
        found = self.tries(flown)
        self._known([n for t in found for n in (*t.names, *t.start)], "tried")
        return [replace(t, start={**self.neutral, **t.start}) for t in found]

    def felt(self, names: Sequence[str], start: Mapping[str, float]) -> tuple[str, ...]:
        """Parameters that change the heating at a start: where the effect is neutral there, its magnitudes only.

        names   : parameters of the effect
        start   : value of each parameter, in its unit
        returns : those of `names` with a sensitivity that is not identically zero
        """
        neutral = bool(self.neutral) and all(start[n] == value for n, value in self.neutral.items())
        return tuple(n for n in names if n in self.neutral or not neutral)

    def _known(self, names: Iterable[str], what: str) -> None:
        """raises : InputError where one of the names is not a parameter of this effect"""
        known = {p.name for p in self.parameters}
        for name in names:
            if name not in known:
                raise InputError(f"effect {self.name}: `{name}` is {what}, which is none of its parameters")


@dataclass(frozen=True)
class EffectUse:
    """An effect with the values of its parameters, each in its unit, in the order of `effect.parameters`."""

    effect: Effect
    values: tuple[float, ...]


def _from_file(path: Path) -> Effect | None:
    """The effect that a file defines; None where it defines none, as a file that others import.

    raises : InputError with file and line where the file cannot be run, or where its EFFECT is not an Effect
    """
    spec = importlib.util.spec_from_file_location(f"sim_heating_user_effects.{path.stem}", path)
    if spec is None or spec.loader is None:
        raise InputError(f"{path}: is not a Python file; an effect is one")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # a kernel in numba's cache is found again by the name of its module
    try:
        spec.loader.exec_module(module)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    except Exception as error:  # whatever a user's file does
        line = next(
            (f.lineno for f in reversed(traceback.extract_tb(error.__traceback__)) if f.filename == str(path)), 0
        )
        line = getattr(error, "lineno", None) or line
        raise InputError(f"{path}, line {line}: {type(error).__name__}: {error}") from None
    found = getattr(module, "EFFECT", None)
    if found is not None and not isinstance(found, Effect):
        raise InputError(f"{path}: EFFECT is a {type(found).__name__}; it must be an Effect")
    return found


def _built_in() -> list[Effect]:
    names = [m.name for m in pkgutil.iter_modules(__path__) if m.name != "compiled"]
    modules = [importlib.import_module(f"{__name__}.{name}") for name in sorted(names)]
    return [m.EFFECT for m in modules if hasattr(m, "EFFECT")]


def own_files() -> tuple[Path, ...]:
    """Python files of the folders in SIM_HEATING_EFFECTS, in the order in which they are read.

    raises : InputError where one of the folders does not exist
    """
    found: list[Path] = []
    for folder in map(Path, filter(None, os.environ.get(FOLDERS_VARIABLE, "").split(os.pathsep))):
        if not folder.is_dir():
            raise InputError(f"{FOLDERS_VARIABLE}: {folder} is not a directory; name one that holds effects")
        found += sorted(folder.glob("*.py"))
    return tuple(found)


@cache
def _all(files: tuple[Path, ...]) -> Mapping[str, Effect]:
    found = {e.name: e for e in _built_in()}
    taken = dict.fromkeys(found, "the package")
    for path in files:
        own = _from_file(path)
        if own is None:
            continue
        if own.name in found:
            raise InputError(f"{path}: {taken[own.name]} has an effect `{own.name}` already; give yours another name")
        found[own.name], taken[own.name] = own, str(path)
    return found


def effects() -> Mapping[str, Effect]:
    """All effects by name: the package's and those of the folders in SIM_HEATING_EFFECTS.

    raises : InputError where a folder does not exist, a user's file defines no valid effect, or a name is taken already
    """
    return _all(own_files())


def effect(name: str) -> Effect:
    """The effect of a name.

    raises : InputError with the nearest known name where the name is unknown
    """
    known = effects()
    if name not in known:
        raise InputError(f"effect `{name}` is not known{suggestion(name, sorted(known))}")
    return known[name]


def use(name: str, values: Mapping[str, float] | None = None) -> EffectUse:
    """An effect with some of its parameters set and the rest nominal.

    name    : of the effect
    values  : parameter values by name, each in the parameter's unit
    returns : the effect and all its values, in the order in which its kernel reads them
    raises  : InputError naming a parameter that the effect does not have, or a value outside its bounds
    """
    found, given = effect(name), dict(values or {})
    known = [p.name for p in found.parameters]
    for key in given:
        if key not in known:
            raise InputError(f"effect {name}: no parameter `{key}`. It has: {', '.join(known)}.")
    chosen = tuple(float(given.get(p.name, p.value)) for p in found.parameters)
    for p, value in zip(found.parameters, chosen, strict=True):
        if not p.lower <= value <= p.upper:
            raise InputError(f"effect {name}, {p.name}: {value:g} is outside its bounds {p.lower:g} to {p.upper:g}")
    return EffectUse(found, chosen)


def check_count(uses: tuple[EffectUse, ...], where: str) -> None:
    """Check that the effects of one control point fit into its lane.

    uses   : effects of the control point; those of mode "model" take no slot
    where  : control point or file, for the message
    raises : InputError where more than EFFECT_SLOTS of them have a kernel
    """
    kernels = sum(use.effect.kernel is not None for use in uses)
    if kernels > EFFECT_SLOTS:
        raise InputError(f"{where}: {kernels} effects with a kernel; {EFFECT_SLOTS} at most at one control point")
