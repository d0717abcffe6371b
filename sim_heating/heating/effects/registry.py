"""All effects by name: of this folder, of installed packages, and of the folders that SIM_HEATING_EFFECTS names.

A package offers its effects as entry points of the group `sim_heating.effects` (Python packaging user guide, "Creating
and discovering plugins"): each names a module that defines EFFECT, or an Effect in a module.
"""

from __future__ import annotations

import copyreg
import importlib
import importlib.util
import os
import pickle
import pkgutil
import sys
import traceback
from collections.abc import Callable, Mapping
from functools import cache
from importlib import metadata
from pathlib import Path
from types import ModuleType
from typing import Any

from sim_heating.base.errors import InputError
from sim_heating.base.files import suggestion
from sim_heating.heating.effects.definition import Effect, EffectUse, Window, effect_within

FOLDERS_VARIABLE = "SIM_HEATING_EFFECTS"
GROUP = "sim_heating.effects"
"""Group of the entry points of packages with effects."""
PUBLIC = (
    "write `from sim_heating import Effect, Parameter, SearchStart, flight, njit` (docs/how_to/adding_an_effect.md)"
)
"""What a user's effect imports, for the message about a file that imports from elsewhere."""
RENAMED = {
    "'tries'": "`tries` is now `search_starts`",
    "'places'": "in place of `places`, make each parameter with model_parameter(...)",
}
"""Former arguments of Effect as they stand in Python's message, and what to write now."""


def _loaded(label: str, load: Callable[[], Any], file: Path | None = None) -> Effect | None:
    """The effect of a user's module; None where the module has none, as a file that others import.

    label  : of the module in messages
    load   : imports the module, or the Effect in it
    file   : whose lines are named in messages; None for a package, of which the file where it failed is named
    raises : InputError with the label where the module cannot be run, or where its EFFECT is not an Effect
    """
    loaded = _run(label, load, file)
    is_module = isinstance(loaded, ModuleType)
    effect = getattr(loaded, "EFFECT", None) if is_module else loaded
    if isinstance(effect, Effect) or (effect is None and is_module and file is not None):
        return effect
    name = "EFFECT" if is_module else "it"
    raise InputError(f"{label}: {name} is a {type(effect).__name__}; it must be an Effect")


def _run(label: str, load: Callable[[], Any], file: Path | None) -> Any:
    """What a user's module gives, as `_loaded`; whatever it raises is an InputError."""
    try:
        return load()
    except InputError as error:
        raise InputError(*(f"{label}: {p}" for p in error.problems)) from None
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # whatever a user's file does, sys.exit() included
        where = "" if file is None else _line(file, error)
        raise InputError(f"{label}{where}: {type(error).__name__}: {error}{_remedy(error)}") from None


def _from_file(path: Path) -> Effect | None:
    """The effect that a file defines, as `_loaded`."""
    spec = importlib.util.spec_from_file_location(f"sim_heating_user_effects.{path.stem}", path)
    if spec is None or spec.loader is None:
        raise InputError(f"{path}: not a Python file; an effect is one")
    module, loader = importlib.util.module_from_spec(spec), spec.loader
    sys.modules[spec.name] = module  # a kernel in numba's cache is found again by the name of its module

    def run() -> ModuleType:
        loader.exec_module(module)
        return module

    return _loaded(str(path), run, path)


def _label(entry: metadata.EntryPoint) -> str:
    """Package and name of an entry point, for messages."""
    package = "a package without a name" if entry.dist is None else f"{entry.dist.name} {entry.dist.version}"
    return f"package {package}, entry point `{entry.name} = {entry.value}`"


def _line(path: Path, error: BaseException) -> str:
    """`, line 3` of a user's file where an error was raised; empty where no line of it is concerned."""
    names = {str(path), os.path.abspath(path)}
    lines = [f.lineno for f in traceback.extract_tb(error.__traceback__) if f.filename in names]
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
    files: list[Path] = []
    for folder in map(Path, filter(None, os.environ.get(FOLDERS_VARIABLE, "").split(os.pathsep))):
        if not folder.is_dir():
            raise InputError(f"{FOLDERS_VARIABLE}: {folder} is not a directory; name one that holds effects")
        files += sorted(path for path in folder.glob("*.py") if path.is_file())
    return tuple(files)


@cache
def _of_packages(search_path: tuple[str, ...]) -> tuple[metadata.EntryPoint, ...]:
    """Entry points of installed packages with effects, in the order of package and name.

    search_path : where Python looks for packages, which the answer depends on
    """
    entries = metadata.entry_points(group=GROUP)
    # Of a package that is installed twice Python imports the first.
    return tuple({_label(e): e for e in sorted(entries, key=_label)}.values())


@cache
def _all(files: tuple[Path, ...], entries: tuple[metadata.EntryPoint, ...]) -> Mapping[str, Effect]:
    effects_by_name = dict(_built_in())
    defined_by = dict.fromkeys(effects_by_name, "the package sim-heating")
    sources = [(label := _label(entry), _loaded(label, entry.load)) for entry in entries]
    sources += [(str(path), _from_file(path)) for path in files]
    for label, effect in sources:
        if effect is None:
            continue
        name = effect.name
        if name in effects_by_name:
            raise InputError(f"{label}: {defined_by[name]} already has an effect `{name}`; give yours another name")
        effects_by_name[name], defined_by[name] = effect, label
    return effects_by_name


def add_user_effects(digest: Any) -> None:
    """Add what defines users' effects to a digest of hashlib: files, and modules of packages with their versions."""
    for path in user_effect_files():
        digest.update(path.read_bytes())
    if entries := _of_packages(tuple(sys.path)):
        effects()  # imports them, or says why not
    for entry in entries:
        digest.update(_label(entry).encode())
        file = getattr(sys.modules.get(entry.module), "__file__", None)
        digest.update(b"" if file is None else Path(file).read_bytes())


def effects() -> Mapping[str, Effect]:
    """All effects by name: the package's, those of installed packages, and those of the folders in SIM_HEATING_EFFECTS.

    raises : InputError where a folder does not exist, a user's file or package defines no valid effect, or a name is
             taken already

    >>> import sim_heating as sh
    >>> [p.name for p in sh.effects()["gap-flow"].parameters]
    ['gap_fraction', 'gap_depth_m']
    """
    return _all(user_effect_files(), _of_packages(tuple(sys.path)))


def effect(name: str) -> Effect:
    """Effect of a name.

    raises : InputError with the nearest known name where the name is unknown
    """
    # Those of the package first: a vehicle that declares one does not depend on the files of a user.
    by_name = built_in if name in (built_in := _built_in()) else effects()
    if name not in by_name:
        folders = os.environ.get(FOLDERS_VARIABLE) or "not set: set it to the folder of your file"
        where = f" (your own are read from packages, and from the folders in {FOLDERS_VARIABLE}, which is {folders})"
        raise InputError(f"unknown effect `{name}`{suggestion(name, sorted(by_name))}{where}")
    return by_name[name]


def use(name: str, values: Mapping[str, float] | None = None, window: Window | None = None) -> EffectUse:
    """An effect with some of its parameters set and the rest nominal.

    name    : of the effect
    values  : parameter values by name, each in the parameter's unit ([-], [K], [s] ...)
    window  : range of a flight condition within which it acts; None: always
    returns : the effect and all its values, in the order in which its kernel reads them
    raises  : InputError naming a parameter that the effect does not have, or a value outside its bounds
    """
    used, stated = effect(name), dict(values or {})
    used = used if window is None else effect_within(used, window)
    names = [p.name for p in used.parameters]
    for key in stated:
        if key not in names:
            raise InputError(f"effect {name}: no parameter `{key}`. It has: {', '.join(names)}.")
    chosen = tuple(float(stated.get(p.name, p.value)) for p in used.parameters)
    for p, value in zip(used.parameters, chosen, strict=True):
        if not p.lower <= value <= p.upper:
            raise InputError(f"effect {name}, {p.name}: {value:g} is outside its bounds {p.lower:g} to {p.upper:g}")
    return EffectUse(used, chosen)


def _reduced(reduced: Effect) -> Any:
    """An effect as another process gets it: by its name, as the module of a user's file has none to be imported by."""
    if reduced.window is not None:
        always = effect(reduced.name.removesuffix(f"-{reduced.window.name}"))
        return effect_within, (always, reduced.window)
    is_registered = effects().get(reduced.name) is reduced
    return (effect, (reduced.name,)) if is_registered else reduced.__reduce_ex__(pickle.DEFAULT_PROTOCOL)


copyreg.pickle(Effect, _reduced)
