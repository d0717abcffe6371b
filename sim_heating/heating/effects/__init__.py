"""Effects that a declared model may lack: one file each, picked up by its being there.

A file of this folder, or of a folder named in SIM_HEATING_EFFECTS (a path list), defines EFFECT = Effect(...). There
are two kinds. An effect on the heating or on the emittance has a kernel

    f(B, c, p, wall_K) -> float

that reads the flight conditions from B[c] on and its own parameters from B[p] on (base/kernels/block.py names the
places), takes the wall temperature [K], and gives what is added to the heating ratio, or what the ratio or the
emittance is multiplied by.
An effect of mode "model" has none: its parameters stand for parameters that the model has anyway (`places`).
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
from sim_heating.base.files import nearest_name
from sim_heating.base.kernels.block import EFFECT_SLOTS, EFFECT_WIDTH
from sim_heating.base.parameters import Parameter

__all__ = ["Effect", "EffectUse", "effect", "effects", "own_files", "use"]

FOLDERS_VARIABLE = "SIM_HEATING_EFFECTS"


@dataclass(frozen=True)
class Try:
    """One way to look for an effect: the parameters that are estimated together, and values of any of its parameters
    from which that starts, neutral or else nominal where not given. A start without any effect yet is best: what the
    effect's magnitude would gain is then told exactly by the sensitivity to it."""

    names: tuple[str, ...]
    start: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Effect:
    """An effect on the heating ratio.

    name       : as in a closure report
    mode       : "add" to the ratio, or "multiply" it (what multiplies comes last), or the "emittance"; or "model"
    parameters : in the order in which the kernel reads them; EFFECT_WIDTH at most
    kernel     : compiled f(B, c, p, wall_K); None for an effect of mode "model"
    needs_wall : whether the kernel's value depends on the wall temperature
    lags       : whether the ratio lags behind itself, its first two parameters being time constant and fraction
    places     : dotted names that the parameters of a "model" effect stand for, in their order
    neutral    : its magnitudes and the values at which, all of them together, it does nothing whatever else it has
    tries      : for a flight's conditions, how it is looked for in data; by default with all its parameters that have a
                 prior, from their nominal values
    physics    : what it is, in a line
    source     : where that is from
    """

    name: str
    mode: Literal["add", "multiply", "emittance", "model"]
    parameters: tuple[Parameter, ...]
    kernel: Callable[..., float] | None = field(default=None, compare=False)
    needs_wall: bool = False
    lags: bool = False
    places: tuple[str, ...] = ()
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
        """Whether it is one of the package's."""
        return getattr(self.kernel, "__module__", "").startswith(f"{__name__}.")

    def tried(self, flown: Conditions) -> Sequence[Try]:
        """How it is looked for.

        raises : InputError where that names none of its parameters
        """
        if self.tries is None:
            return [Try(tuple(p.name for p in self.parameters if p.sigma > 0.0))]
        found = self.tries(flown)
        self._known([n for t in found for n in (*t.names, *t.start)], "tried")
        return [replace(t, start={**self.neutral, **t.start}) for t in found]

    def felt(self, names: Sequence[str], start: Mapping[str, float]) -> tuple[str, ...]:
        """Those of some of its parameters that change anything at a start: where it is neutral, its magnitudes only."""
        neutral = bool(self.neutral) and all(start[n] == value for n, value in self.neutral.items())
        return tuple(n for n in names if n in self.neutral or not neutral)

    def _known(self, names: Iterable[str], what: str) -> None:
        """raises : InputError where one of the names is none of its parameters"""
        known = {p.name for p in self.parameters}
        for name in names:
            if name not in known:
                raise InputError(f"effect {self.name}: `{name}` is {what}, which is none of its parameters")


@dataclass(frozen=True)
class EffectUse:
    """An effect with the values of its parameters, in the order of the effect."""

    effect: Effect
    values: tuple[float, ...]


def _from_file(path: Path) -> Effect | None:
    """The effect that a file defines; None where it defines none, as a file that others import.

    raises : InputError where the file cannot be run, or its EFFECT is no Effect
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

    raises : InputError where one of the folders is none
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

    raises : InputError where a folder is none, or a file of one's own is no effect or has the name of another
    """
    return _all(own_files())


def effect(name: str) -> Effect:
    """The effect of a name; InputError with the nearest where there is none."""
    known = effects()
    if name not in known:
        near = nearest_name(name, known)
        hint = f"Nearest: `{near}`." if near else f"Known: {', '.join(sorted(known))}."
        raise InputError(f"effect `{name}` is not known. {hint}")
    return known[name]


def use(name: str, values: Mapping[str, float] | None = None) -> EffectUse:
    """An effect with some of its parameters set and the rest nominal.

    raises : InputError naming a parameter that the effect does not have, or a value outside its bounds
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
    """raises : InputError where one control point has more effects than the kernel holds."""
    kernels = sum(use.effect.kernel is not None for use in uses)
    if kernels > EFFECT_SLOTS:
        raise InputError(f"{where}: {kernels} effects with a kernel; {EFFECT_SLOTS} at most at one control point")
