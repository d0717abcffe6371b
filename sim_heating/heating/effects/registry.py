"""All effects by name: those of this folder, and those of the folders that SIM_HEATING_EFFECTS names."""

from __future__ import annotations

import copyreg
import importlib
import importlib.util
import os
import pickle
import pkgutil
import sys
import traceback
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from sim_heating.base.errors import InputError
from sim_heating.base.files import suggestion
from sim_heating.heating.effects.definition import Effect, EffectUse, Window, effect_within

FOLDERS_VARIABLE = "SIM_HEATING_EFFECTS"
PUBLIC = (
    "write `from sim_heating import Effect, Parameter, SearchStart, flight, njit` (docs/how_to/adding_an_effect.md)"
)
"""What a user's effect imports, for the message about a file that imports from elsewhere."""
RENAMED = {
    "'tries'": "`tries` is now `search_starts`",
    "'places'": "in place of `places`, make each parameter with model_parameter(...)",
}
"""Former arguments of Effect as they stand in Python's message, and what to write now."""


def _from_file(path: Path) -> Effect | None:
    """The effect that a file defines; None where it defines none, as a file that others import.

    raises : InputError with file and line where the file cannot be run, or where its EFFECT is not an Effect
    """
    spec = importlib.util.spec_from_file_location(f"sim_heating_user_effects.{path.stem}", path)
    if spec is None or spec.loader is None:
        raise InputError(f"{path}: not a Python file; an effect is one")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # a kernel in numba's cache is found again by the name of its module
    try:
        spec.loader.exec_module(module)
    except InputError as error:
        raise InputError(*(f"{path}: {p}" for p in error.problems)) from None
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # whatever a user's file does, sys.exit() included
        raise InputError(f"{path}{_line(path, error)}: {type(error).__name__}: {error}{_remedy(error)}") from None
    found = getattr(module, "EFFECT", None)
    if found is not None and not isinstance(found, Effect):
        raise InputError(f"{path}: EFFECT is a {type(found).__name__}; it must be an Effect")
    return found


def _line(path: Path, error: BaseException) -> str:
    """`, line 3` of a user's file where an error was raised; empty where no line of it is concerned."""
    own = {str(path), os.path.abspath(path)}
    lines = [f.lineno for f in traceback.extract_tb(error.__traceback__) if f.filename in own]
    line = getattr(error, "lineno", None) or (lines[-1] if lines else None)
    return f", line {line}" if line else ""


def _remedy(error: BaseException) -> str:
    """What to write instead, where a user's file was made for an earlier version of the package; else nothing."""
    if isinstance(error, ImportError) and (error.name or "").partition(".")[0] == "sim_heating":
        return f"; {PUBLIC}"
    if isinstance(error, TypeError):
        return "".join(f"; {now}" for former, now in RENAMED.items() if former in str(error))
    return ""


@cache
def _built_in() -> Mapping[str, Effect]:
    names = sorted(m.name for m in pkgutil.iter_modules([str(Path(__file__).parent)]))
    modules = [importlib.import_module(f"{__package__}.{name}") for name in names if name != "compiled"]
    return {m.EFFECT.name: m.EFFECT for m in modules if hasattr(m, "EFFECT")}


def user_effect_files() -> tuple[Path, ...]:
    """Python files of the folders in SIM_HEATING_EFFECTS, in the order in which they are read.

    raises : InputError where one of the folders does not exist
    """
    found: list[Path] = []
    for folder in map(Path, filter(None, os.environ.get(FOLDERS_VARIABLE, "").split(os.pathsep))):
        if not folder.is_dir():
            raise InputError(f"{FOLDERS_VARIABLE}: {folder} is not a directory; name one that holds effects")
        found += sorted(path for path in folder.glob("*.py") if path.is_file())
    return tuple(found)


@cache
def _all(files: tuple[Path, ...]) -> Mapping[str, Effect]:
    found = dict(_built_in())
    defined_by = dict.fromkeys(found, "the package")
    for path in files:
        effect = _from_file(path)
        if effect is None:
            continue
        name = effect.name
        if name in found:
            raise InputError(f"{path}: {defined_by[name]} already has an effect `{name}`; give yours another name")
        found[name], defined_by[name] = effect, str(path)
    return found


def effects() -> Mapping[str, Effect]:
    """All effects by name: the package's and those of the folders in SIM_HEATING_EFFECTS.

    raises : InputError where a folder does not exist, a user's file defines no valid effect, or a name is taken already

    >>> import sim_heating as sh
    >>> [p.name for p in sh.effects()["gap-flow"].parameters]
    ['gap_fraction', 'gap_depth_m']
    """
    return _all(user_effect_files())


def effect(name: str) -> Effect:
    """Effect of a name.

    raises : InputError with the nearest known name where the name is unknown
    """
    # Those of the package first: a vehicle that declares one does not depend on the files of a user.
    known = own if name in (own := _built_in()) else effects()
    if name not in known:
        folders = os.environ.get(FOLDERS_VARIABLE) or "not set: set it to the folder of your file"
        where = f" (your own are read from the folders in {FOLDERS_VARIABLE}, which is {folders})"
        raise InputError(f"unknown effect `{name}`{suggestion(name, sorted(known))}{where}")
    return known[name]


def use(name: str, values: Mapping[str, float] | None = None, window: Window | None = None) -> EffectUse:
    """An effect with some of its parameters set and the rest nominal.

    name    : of the effect
    values  : parameter values by name, each in the parameter's unit
    window  : range of a flight condition within which it acts; None: always
    returns : the effect and all its values, in the order in which its kernel reads them
    raises  : InputError naming a parameter that the effect does not have, or a value outside its bounds
    """
    found, given = effect(name), dict(values or {})
    found = found if window is None else effect_within(found, window)
    known = [p.name for p in found.parameters]
    for key in given:
        if key not in known:
            raise InputError(f"effect {name}: no parameter `{key}`. It has: {', '.join(known)}.")
    chosen = tuple(float(given.get(p.name, p.value)) for p in found.parameters)
    for p, value in zip(found.parameters, chosen, strict=True):
        if not p.lower <= value <= p.upper:
            raise InputError(f"effect {name}, {p.name}: {value:g} is outside its bounds {p.lower:g} to {p.upper:g}")
    return EffectUse(found, chosen)


def _reduced(found: Effect) -> Any:
    """An effect as another process gets it: by its name, as the module of a user's file has none to be imported by."""
    if found.window is not None:
        always = effect(found.name.removesuffix(f"-{found.window.name}"))
        return effect_within, (always, found.window)
    known = effects().get(found.name) is found
    return (effect, (found.name,)) if known else found.__reduce_ex__(pickle.DEFAULT_PROTOCOL)


copyreg.pickle(Effect, _reduced)
