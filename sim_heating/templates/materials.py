"""The material library: materials by the names that people use, from the general library and from all vehicles."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from sim_heating.base.errors import InputError
from sim_heating.base.files import nearest_name, read_toml
from sim_heating.base.files.units import converted
from sim_heating.inputs.vehicle import library_materials, vehicle_folders
from sim_heating.templates.quantities import NUMBER, quantity
from sim_heating.thermal.stack import Material

FOLDER = "materials"
"""Folder of general materials, next to those of the vehicles."""
LAYER = re.compile(rf"\s*(.+?)[\s,:=]+({NUMBER})\s*([A-Za-zµμ\"]*(?:/[a-z]+2)?)\s*")
"""Pattern of a layer: a material, a thickness or a mass per area, a unit."""
EXAMPLE = '"copper 3 mm"'
SYNONYMS = (
    (r"alumin(i?)um", "al"),
    (r"titanium", "ti"),
    (r"stainless", "ss"),
    (r"\bsteel\b", ""),
    (r"\b(aisi|sae|alloy)\b", ""),
    (r"\bcu\b", "copper"),
    (r"\bni\b", "nickel"),
    (r"fused (quartz|silica)|quartz", "fusedsilica"),
    (r"-t\d+\b", ""),
)
"""Words that people use for one material, and the spelling of the library; tempers of alloys are left out."""


@dataclass(frozen=True)
class LayerInput:
    """A layer as a person typed it.

    name        : of the material, as in the library, or of the file
    thickness_m : [m]
    """

    name: str
    material: Material
    thickness_m: float


@cache
def material_library() -> dict[str, Material]:
    """Materials by name: the general library, then those of all vehicles that can be loaded by name."""
    general = {
        path.stem: read_toml(path, Material)
        for folder in reversed(vehicle_folders())
        for path in sorted((folder / FOLDER).glob("*.toml"))
    }
    return {**library_materials(), **general}


def _plain(name: str) -> str:
    """A name without case, spaces and signs, in the words of the library."""
    text = name.lower().strip()
    for pattern, word in SYNONYMS:
        text = re.sub(pattern, word, text)
    return re.sub(r"[^a-z0-9]", "", text)


def _alike(plain_name: str, library: Iterable[str]) -> list[str]:
    """Materials of this name, else those whose names begin with it, else the alloys of this number, as AISI 304."""
    if not plain_name:
        return []
    plain = {name: _plain(name) for name in library}
    tests: list[Callable[[str, str], bool]] = [
        str.__eq__,
        str.startswith,
        *([str.endswith] if re.fullmatch(r"\d{3,}", plain_name) else []),
    ]
    alike = ([name for name, text in plain.items() if test(text, plain_name)] for test in tests)
    return next(filter(None, alike), [])


def find_material(name: str) -> tuple[str, Material]:
    """Name and properties of the material that a person means: by its name in the library, loosely, or by a file.

    name    : such as `LI-900`, `aluminium 2024-T6`, `copper`, or the path of a TOML file of a material
    raises  : InputError, one line, where there is none of this name, or several
    """
    if name.endswith(".toml"):
        path = Path(name)
        return re.sub(r"[^A-Za-z0-9_-]", "-", path.stem), read_toml(path, Material)
    library = material_library()
    plain_name = _plain(name)
    names = _alike(plain_name, library)
    if len(names) == 1:
        return names[0], library[names[0]]
    if names:
        raise InputError(f"material `{name}`: may be {', '.join(sorted(names))}; name one of them")
    near = nearest_name(plain_name, library)
    hint = f"did you mean `{near}`? " if near else ""
    listed = ", ".join(sorted(library))
    raise InputError(f"material `{name}`: is not in the library; {hint}known: {listed}; or give a TOML file of it")


def layer_input(text: str, option: str = "--layer") -> LayerInput:
    """A layer from a text such as `LI-900 51 mm`; units of length: mm, m, in, mil, um and others.

    A coating that is applied by weight has its mass per area, `RCG 0.6 kg/m2`, over the density of its material.

    raises : InputError, one line, with what is wrong
    """
    match = LAYER.fullmatch(text)
    if match is None:
        raise InputError(f"{option} `{text}`: write a material and a thickness with its unit, such as {EXAMPLE}")
    if not match[3]:
        raise InputError(f"{option} `{text}`: the thickness has no unit; write such as {EXAMPLE} (mm, m, in, mil, um)")
    name, material = find_material(match[1])
    applied = f"{match[2]} {match[3]}"
    if converted(match[3], "kg/m2") is not None:
        applied = f"{quantity(applied, 'kg/m2', f'{option} `{text}`', EXAMPLE) / material.density_kg_m3:.12g} m"
    return LayerInput(name, material, quantity(applied, "m", f"{option} `{text}`", EXAMPLE, "thickness_m"))


def describe_source(name: str, material: Material) -> str:
    """One line on where the properties of a material come from."""
    confidence = f", confidence {material.confidence}" if material.confidence else ""
    return f"{name}: {material.source or 'no source stated'}{confidence}"
