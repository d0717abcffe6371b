"""Sources and confidences that declared inputs state, and what a result was made from."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from sim_heating.base.files import read_toml_dict
from sim_heating.heating.effects import EffectUse
from sim_heating.heating.effects.recombination import RECOMBINATION
from sim_heating.heating.effects.transition import TRANSITION
from sim_heating.heating.ratio.table import RatioTable
from sim_heating.heating.recorded.cells.text import decoded
from sim_heating.heating.recorded.reading import lowered_confidence
from sim_heating.inputs.declared_effects import Catalysis, Transition
from sim_heating.inputs.record import DECLARATION, Record
from sim_heating.inputs.scenario import Scenario
from sim_heating.inputs.vehicle import ControlPoint, Vehicle
from sim_heating.thermal.stack import Construction
from sim_heating.trajectory.recorded import read_recording

IN = "`{{key}}` in {}"
CONFIDENCES = "ABC"
"""A: read in a primary or stored data set; B: known from the literature; C: judged."""


@dataclass(frozen=True)
class DeclaredInput:
    """Something that a result was made from.

    name       : what it is;  source : where it comes from, as stated; empty where it is not stated
    confidence : as stated; empty where it is not
    measured   : whether it is said to be measured, or recorded
    location   : where it is stated, with `{key}` for the key, as "`{key}` in record.toml"; empty where there is none
    """

    name: str
    source: str
    confidence: str
    measured: bool = False
    location: str = ""

    @property
    def worst(self) -> str | None:
        """Lowest of the confidences A, B, C that the text names; None where it names none.

        >>> DeclaredInput("aero", "", "alpha A, drag A to 6900 m/s and C below, the rest B to C").worst
        'C'
        """
        return max(re.findall(rf"\b[{CONFIDENCES}]\b", self.confidence), default=None)


def _materials(construction: Construction, location: str) -> list[DeclaredInput]:
    """Materials of the layers; location : where one is declared, with `{name}` for its name."""
    layers = zip(construction.stack.layer, construction.layer_materials(), strict=True)
    by_name = {layer.material: m for layer, m in layers}
    return [
        DeclaredInput(f"material {n}", m.source or "", m.confidence or "", location=location.replace("{name}", n))
        for n, m in by_name.items()
    ]


def _stated(name: str, declared: Transition | Catalysis, location: str) -> DeclaredInput:
    return DeclaredInput(name, declared.source, declared.confidence, location=location)


def _table(name: str, table: RatioTable | None, file: str | None) -> list[DeclaredInput]:
    if table is None:
        return []
    location = f"`# {{key}}: ...` at the head of {file}" if file else ""
    return [DeclaredInput(name, table.header.get("source", ""), table.header.get("confidence", ""), location=location)]


def inputs_of_point(vehicle: Vehicle, point: ControlPoint, effects: Iterable[EffectUse]) -> list[DeclaredInput]:
    """What the model of a vehicle's control point is built from, with its sources.

    effects : those of the model, declared by the vehicle or added by a scenario
    """
    declared = point.declared
    own_file, vehicle_file = IN.format(f"control_points/{point.name}.toml"), IN.format("vehicle.toml")
    effect_sources = {e.name: e.source for e in declared.effect}
    coating = point.construction.stack.layer[0].material
    transition_place = f"{own_file if declared.transition else vehicle_file}, [transition]"
    catalysis_place = f"{own_file}, [catalysis]" if declared.catalysis else f"{vehicle_file}, [catalysis.{coating}]"
    inputs = [
        DeclaredInput(
            f"vehicle {vehicle.name}",
            vehicle.declared.source,
            vehicle.declared.confidence,
            location=vehicle_file,
        ),
        DeclaredInput(
            f"control point {point.name}",
            declared.source,
            declared.confidence,
            location=own_file,
        ),
        *_materials(point.construction, IN.format("materials/{name}.toml")),
        *_table(f"heating ratio of {point.name}", point.ratio, declared.ratio_table),
    ]
    for used in effects:
        effect = used.effect.name
        if effect == TRANSITION and point.transition is not None:
            inputs.append(_stated("transition", point.transition, transition_place))
        elif effect == RECOMBINATION and point.catalysis is not None:
            inputs.append(_stated(f"recombination on {coating}", point.catalysis, catalysis_place))
        else:
            location = f"{own_file}, its [[effect]]" if effect in effect_sources else ""
            inputs.append(DeclaredInput(f"effect {effect}", effect_sources.get(effect, ""), "", location=location))
    return inputs


def inputs_of_record(record: Record, effects: Iterable[EffectUse]) -> list[DeclaredInput]:
    """What the declared model of a record is built from, with its sources.

    effects : those of the model; one that the record does not declare was found from its own data
    """
    declared, heating = record.declared, record.declared.heating
    inputs = [
        DeclaredInput(
            "construction of the wall",
            declared.source,
            declared.confidence,
            location=f"{IN.format(DECLARATION)}, at the top",
        ),
        *_materials(record.construction, f"{IN.format(DECLARATION)}, [materials.{{name}}]"),
        *_table("heating ratio", record.ratio_table, heating.ratio_table),
        *_table("turbulent heating ratio", record.turbulent, heating.turbulent_file),
    ]
    for used in effects:
        effect = used.effect.name
        if effect == TRANSITION and heating.transition is not None:
            inputs.append(_stated("transition", heating.transition, f"{IN.format(DECLARATION)}, [heating.transition]"))
        elif effect == RECOMBINATION and heating.catalysis is not None:
            inputs.append(_stated("recombination", heating.catalysis, f"{IN.format(DECLARATION)}, [heating.catalysis]"))
        else:
            inputs.append(DeclaredInput(f"effect {effect}", "found from the record", ""))
    return inputs


def conditions_of_record(record: Record) -> list[DeclaredInput]:
    """Where the flight conditions of a record come from."""
    declared = record.declared.conditions
    confidence = declared.confidence
    name = "flight conditions" if record.has_flow else "conditions"
    location = f"{IN.format(DECLARATION)}, [conditions]"
    return [DeclaredInput(name, declared.source, confidence, measured=record.declared.measured, location=location)]


def conditions_of_scenario(scenario: Scenario) -> list[DeclaredInput]:
    """What produced the flight conditions of a scenario: a recording, or the data of the vehicle that was simulated."""
    spec, directory = scenario.declared.trajectory, scenario.vehicle.directory
    if spec.source == "recorded":
        path = Path(spec.file or "")
        flown = read_recording(path, scenario.vehicle.reference_length_m, scenario.vehicle.surfaces, spec.fields)
        return [_recording(path, flown.has_model_density)]
    if spec.source == "fmu":
        return [DeclaredInput(f"trajectory FMU {Path(spec.file or '').name}", "", "")]
    files = [p for p in (directory / "aero" / "aero.toml", directory / "guidance.toml") if p.is_file()]
    return [_toml_source(path, path.relative_to(directory).as_posix()) for path in files]


def _recording(path: Path, has_model_density: bool) -> DeclaredInput:
    """A recorded trajectory, whose head of `# key: value` lines may state its source and confidence.

    has_model_density : whether its density is of the standard atmosphere, which lowers its confidence
    """
    lines = itertools.takewhile(lambda line: line.startswith("#"), decoded(path).splitlines())
    head = [line[1:].strip() for line in lines]
    stated = {key.strip(): value.strip() for key, _, value in (line.partition(":") for line in head)}
    confidence = stated.get("confidence") or " ".join(head)  # many heads state one for each column, in their text
    if has_model_density:
        confidence = lowered_confidence(confidence)
    location = f"`# {{key}}: ...` at the head of {path.name}"
    return DeclaredInput(
        f"recording {path.name}", stated.get("source", ""), confidence, measured=True, location=location
    )


def _toml_source(path: Path, name: str) -> DeclaredInput:
    data = read_toml_dict(path)
    return DeclaredInput(name, str(data.get("source", "")), str(data.get("confidence", "")), location=IN.format(name))
