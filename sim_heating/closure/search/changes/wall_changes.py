"""Changes of the wall that no effect is: properties of its layers, contacts between them, other materials.

Factors of a layer are parameters of the model by the layer's own name, with exact sensitivities. What an effect's name
covers is left to the effect: the conductivity and heat capacity of the insulation, thickness and heat capacity of the
coating. A density that is wrong is a wrong heat capacity, as the model knows only their product.

Layers that have come apart, or were never bonded, touch through a contact resistance that the record does not declare.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from sim_heating.base.parameters import LAYER, MODEL, STACK_PREFIX, Parameter
from sim_heating.closure.search.trials.change import RecordChange, off_by
from sim_heating.heating.effects import effects
from sim_heating.inputs.points import point_of_record
from sim_heating.inputs.record import Record
from sim_heating.inputs.vehicle import library_materials
from sim_heating.thermal.stack import FACES, Layer, Material, PressureTable, face_emittance

THICKNESS, CONDUCTIVITY, HEAT_CAPACITY = (p.name for p in LAYER)
QUANTITIES = {
    THICKNESS: ("thickness", "thicker", "thinner"),
    CONDUCTIVITY: ("conductivity", "above", "below"),
    HEAT_CAPACITY: ("heat capacity (density times specific heat)", "above", "below"),
}
GAS, INSULATION, METAL, OTHER = "gas", "insulation", "metal", "other"


CONTACT = Parameter("contact_m2K_W", "m2 K/W", 0.0, 0.02, 0.0, 10.0, "contact resistance at the inner face of a layer")
"""Of layers that are declared to touch perfectly. Its usual size is a guess: half a millimetre of air, which conducts
0.025 W/(m K)."""
LEAST_OF_DECLARED, SCATTER_OF_DECLARED = (MODEL["stack.contact_factor"].lower, MODEL["stack.contact_factor"].sigma)
"""Least contact resistance over a declared one, and its standard deviation, as of the model's own factor."""


def wall_changes(record: Record) -> list[RecordChange]:
    """All changes of the wall of a record: factors of its layers, contacts between them, and materials of the library
    in place of its own."""
    return [*layer_changes(record), *contact_changes(record), *material_changes(record)]


# Factors of a layer ---------------------------------------------------------------------------------------------------


def layer_changes(record: Record) -> list[RecordChange]:
    """Thickness, conductivity and heat capacity of every layer, without those that an effect is named after.

    Priors are those of the model's parameters: the scatter that the stack declares, else the usual one.
    """
    model = point_of_record(record)
    of_effects = {model.places.get(name) for effect in effects().values() for name in effect.model_parameters}
    return [
        _layer_change(layer, p.name, model.definition(name))
        for layer in dict.fromkeys(record.declared.stack.layer_names)
        for p in LAYER
        if (name := f"{STACK_PREFIX}{layer}.{p.name}") in model.places and model.places[name] not in of_effects
    ]


def _layer_change(layer: str, property_name: str, parameter: Parameter) -> RecordChange:
    quantity, above, below = QUANTITIES[property_name]

    thicker = property_name == THICKNESS
    thing = f"layer {layer}" if thicker else f"{quantity} of layer {layer}"

    def describe(factor: float) -> str:
        return f"{thing} {off_by(factor, above, below)} {'than declared' if thicker else 'the declared one'}"

    apply = partial(with_factor, layer=layer, property_name=property_name)
    return RecordChange("wall", f"{quantity} of layer {layer}", parameter, apply, describe, in_model=True)


def with_factor(record: Record, factor: float, *, layer: str, property_name: str) -> Record:
    """The record with a layer of another thickness, conductivity or heat capacity.

    factor : over the declared value [-];  layer : its name;  property_name : name of the parameter in parameters.LAYER

    Sensors at a face stay there, those within the layer keep their distance from its outer face.
    """
    stack = record.declared.stack
    changed = [i for i, name in enumerate(stack.layer_names) if name == layer]
    if property_name == THICKNESS:
        return _with_thickness(record, changed, factor)
    materials, layers = dict(record.declared.materials), list(stack.layer)
    for i in changed:
        # A material of its own: another layer of the same one stays as it is.
        name = f"{layers[i].material}, {layer}"
        materials[name] = _scaled(record.declared.materials[layers[i].material], property_name, factor)
        layers[i] = layers[i].model_copy(update={"material": name, "name": layer})
    return with_layers(record, layers, materials)


def _scaled(material: Material, property_name: str, factor: float) -> Material:
    """A material with its conductivity, or its density, multiplied by a factor."""
    if property_name == HEAT_CAPACITY:
        return material.model_copy(update={"density_kg_m3": factor * material.density_kg_m3})
    table = material.conductivity_W_mK
    if isinstance(table, PressureTable):
        k = [[factor * value for value in row] for row in table.k]
        return material.model_copy(update={"conductivity_W_mK": table.model_copy(update={"k": k})})
    return material.model_copy(update={"conductivity_W_mK": [[T_K, factor * k] for T_K, k in table]})


def _with_thickness(record: Record, changed: Sequence[int], factor: float) -> Record:
    """The record with layers of another thickness, its sensors and the declared profile moved with them."""
    stack = record.declared.stack
    thickness = np.array([layer.thickness_m for layer in stack.layer])
    thickness[changed] *= factor
    before, after = stack.interfaces_m, np.concatenate(([0.0], np.cumsum(thickness)))

    def moved(depth_m: float) -> float:
        # From the outermost face that is not above it: at a face it moves with it.
        i = int(np.searchsorted(before, depth_m * (1.0 + 1e-9), side="right")) - 1
        return float(after[i] + depth_m - before[i])

    layers = [
        layer.model_copy(update={"thickness_m": float(x)}) for layer, x in zip(stack.layer, thickness, strict=True)
    ]
    profile = stack.initial_profile and [[moved(x), T_K] for x, T_K in stack.initial_profile]
    sensors = [s.model_copy(update={"depth_m": moved(s.depth_m)}) for s in record.sensors]
    changed_stack = stack.model_copy(update={"layer": layers, "initial_profile": profile})
    moved_record = record.with_sensors(sensors)
    return replace(moved_record, declared=moved_record.declared.model_copy(update={"stack": changed_stack}))


def with_layers(record: Record, layers: Sequence[Layer], materials: Mapping[str, Material]) -> Record:
    """The record with other layers and materials."""
    stack = record.declared.stack.model_copy(update={"layer": list(layers)})
    return replace(record, declared=record.declared.model_copy(update={"stack": stack, "materials": dict(materials)}))


# Contacts between layers ----------------------------------------------------------------------------------------------


def contact_changes(record: Record) -> list[RecordChange]:
    """A contact resistance at the inner face of every layer but the last, between solids.

    Of the contacts on one side of the layer that insulates most, one alone is fitted: the layers between them are thin,
    and a record tells them apart hardly.
    """
    stack = record.declared.stack
    insulates = [
        layer.thickness_m / _middle_conductivity(record.declared.materials[layer.material]) for layer in stack.layer
    ]
    most = int(np.argmax(insulates))
    gases = {face for i in record.construction.gas_layers for face in (i - 1, i)}
    return [
        _contact_change(record, i, f"contact {'outside' if i < most else 'inside'} layer {stack.layer_names[most]}")
        for i in range(len(stack.layer) - 1)
        if i not in gases
    ]


def _contact_change(record: Record, number: int, form: str) -> RecordChange:
    stack = record.declared.stack
    outer, inner = stack.layer_names[number : number + 2]
    declared, resistance_parameter = stack.layer[number].contact_m2K_W, CONTACT
    if declared > 0.0:
        scatter = max(CONTACT.sigma, SCATTER_OF_DECLARED * declared)
        resistance_parameter = replace(CONTACT, value=declared, sigma=scatter, lower=LEAST_OF_DECLARED * declared)
    text = f"contact between layer {outer} and layer {inner}"
    against = f"{declared:.2g} m2 K/W" if declared > 0.0 else "none"
    return RecordChange(
        "wall", text, resistance_parameter, partial(with_contact, number=number),
        lambda resistance: f"{text}: {resistance:.2g} m2 K/W, declared {against}", form=form,
    )  # fmt: skip


def with_contact(record: Record, contact_m2K_W: float, *, number: int) -> Record:
    """The record with another contact resistance at the inner face of a layer.

    contact_m2K_W : [m2 K/W], above 0;  number : of the layer, outermost first

    A sensor at that depth is on the outer side, as with a declared one. The elements of the layers stay as they are.
    """
    stack = record.declared.stack
    layers = list(stack.layer)
    layers[number] = layers[number].model_copy(update={"contact_m2K_W": contact_m2K_W})
    changed = with_layers(record, layers, record.declared.materials)
    if stack.nodes is None or stack.layer[number].contact_m2K_W > 0.0:
        return changed
    # a contact is an element, and has a node more
    finer = changed.declared.stack.model_copy(update={"nodes": stack.nodes + 1})
    return replace(changed, declared=changed.declared.model_copy(update={"stack": finer}))


# Materials of the library ---------------------------------------------------------------------------------------------


def material_changes(record: Record) -> list[RecordChange]:
    """Materials of the record and of the library in place of that of each layer, those of its own class alone."""
    stack, declared = record.declared.stack, record.declared.materials
    library = {f"{n} of the library" if n in declared else n: m for n, m in library_materials().items()}
    return [
        _material_change(layer, name, material)
        for layer in dict.fromkeys(stack.layer_names)
        for present in [declared[stack.layer[stack.layer_names.index(layer)].material]]
        for name, material in {**library, **declared}.items()
        if material != present and material_class(material) == material_class(present)
    ]


def _material_change(layer: str, name: str, material: Material) -> RecordChange:
    text = f"layer {layer} behaves as {name}"
    apply = partial(_with_material, layer=layer, name=name, material=material)
    return RecordChange("wall", text, None, apply, lambda _: text, form=f"another material of layer {layer}")


def material_class(material: Material) -> str:
    """Gas, and of solids insulation, metal, or other, such as a coating or an adhesive, by the conductivity."""
    # conductivity below which a material is an insulation, and above which a metal or carbon, in the middle of its
    # table [W/(m K)]
    insulates_W_mK, conducts_W_mK = 0.3, 5.0
    if material.kind == "gas":
        return GAS
    k = _middle_conductivity(material)
    return INSULATION if k < insulates_W_mK else METAL if k > conducts_W_mK else OTHER


def _middle_conductivity(material: Material) -> float:
    """Conductivity in the middle of its table [W/(m K)]."""
    return float(np.median(material.conductivity_grid()[2]))


def _with_material(record: Record, _: float, *, layer: str, name: str, material: Material) -> Record:
    """The record with another material in a layer; outermost it keeps the declared emittance where it states none, and
    to a layer of gas that of the declared face."""
    stack = record.declared.stack
    layers = []
    materials = dict(record.declared.materials)
    for i, (present, called) in enumerate(zip(_layers_with_faces(record), stack.layer_names, strict=True)):
        if called != layer:
            layers.append(present)
            continue
        if i == 0 and material.emissivity is None:
            material = material.model_copy(update={"emissivity": materials[present.material].emissivity})
        key = name if materials.get(name) in (None, material) else f"{name}, {layer}"
        materials[key] = material
        layers.append(present.model_copy(update={"material": key, "name": layer}))
    return with_layers(record, layers, materials)


def _layers_with_faces(record: Record) -> list[Layer]:
    """Layers of a record; those of gas state the emittances of their faces, which their neighbours may have stated."""
    stack, materials = record.declared.stack, record.declared.materials
    layers = list(stack.layer)
    for i in record.construction.gas_layers:
        emittances = {face: face_emittance(stack, materials, i, face) for face in FACES}
        layers[i] = layers[i].model_copy(update=emittances)
    return layers
