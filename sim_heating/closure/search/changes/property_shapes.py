"""A property of the insulation that is off by one factor below a span of temperature or pressure, by another above it.

Tables are joined of two sources, or measured over part of their range and extrapolated. With a smooth step S from 0 to
1 over the span, in temperature or in log10 of pressure,

    k = f [1 + d (S(T) - S(700 K))] k_declared,      S = s^2 (3 - 2 s),    s = (T - T_1) / (T_2 - T_1) within 0 and 1

f is the factor of the effect, estimated with d; the ends of the span are searched. `conductivity` and `heat-capacity`
have this form besides those of the effects, whose factor changes linearly (docs/reference/effects.md, equations 7 and
11).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from sim_heating.base.arrays import FloatArray
from sim_heating.base.parameters import Parameter
from sim_heating.closure.search.changes.wall_changes import with_layers
from sim_heating.closure.search.trials.change import RecordChange, Span, moved_ends
from sim_heating.heating.effects.conductivity import LEAST_DECADES
from sim_heating.inputs.points import conditions_of_record, point_of_record
from sim_heating.inputs.record import Record
from sim_heating.march.point import insulation_layer
from sim_heating.thermal.mesh import DIFFUSIVITY_AT_K, DIFFUSIVITY_AT_PA
from sim_heating.thermal.stack import Material, PressureTable, pairs


@dataclass(frozen=True)
class Axis:
    """What a property changes with.

    name   : in words;  suffix, unit : of the names of the ends in a report
    spans  : from which the search for the ends starts;  within : limits of the ends;  shortest : span
    zero   : where the factor is f, at which meshes are graded: they stay as they are
    least_factor : on a property, over f [-]: it limits the change d, which is 3 at most, of either sign
    """

    name: str
    suffix: str
    unit: str
    spans: tuple[Span, ...]
    within: Span
    shortest: float
    zero: float
    least_factor: float = 0.05

    def shape(self, x: ArrayLike, span: Span) -> FloatArray:
        """S - S(zero) at places on the axis [-]."""
        s, zero = (np.clip((np.asarray(at) - span[0]) / (span[1] - span[0]), 0.0, 1.0) for at in (x, self.zero))
        return np.asarray(s * s * (3.0 - 2.0 * s) - zero * zero * (3.0 - 2.0 * zero))

    def limits(self, span: Span) -> tuple[float, float]:
        """Bounds of the change d, within which the factor is `least_factor` or more at any place [-]."""
        room = 1.0 - self.least_factor
        below, above = np.maximum(np.abs(self.shape(span, span)), room / 3.0)
        return float(-room / above), float(room / below)

    def points(self, span: Span) -> FloatArray:
        """Places between which the step is linear, and that of its zero."""
        return np.append(np.linspace(*span, 9), self.zero)


TEMPERATURE = Axis(
    "temperature", "K", "K", ((300.0, 700.0), (500.0, 900.0), (700.0, 1100.0), (900.0, 1300.0)), (100.0, 2500.0), 100.0,
    DIFFUSIVITY_AT_K,
)  # fmt: skip
PRESSURE = Axis(
    "pressure",
    "log10_Pa",
    "1",
    ((1.0, 3.0), (2.0, 4.0), (3.0, 5.0)),
    (-1.0, 6.0),
    0.5,
    float(np.log10(DIFFUSIVITY_AT_PA)),
)
CONDUCTIVITY, HEAT_CAPACITY = "conductivity", "heat-capacity"


def shape_changes(record: Record) -> list[RecordChange]:
    """Shapes of the errors of the insulation's tables: conductivity and heat capacity in temperature, and conductivity
    in pressure, where its table has pressures and the flight passes through half a decade of them."""
    material = record.construction.layer_materials()[insulation_layer(record.construction)]
    shapes = [_shape(record, e, TEMPERATURE, s) for e in (CONDUCTIVITY, HEAT_CAPACITY) for s in TEMPERATURE.spans]
    if isinstance(material.conductivity_W_mK, PressureTable):
        p_Pa = np.maximum(conditions_of_record(record)["p_surface_Pa"], 1.0)
        if np.log10(np.max(p_Pa) / np.min(p_Pa)) > LEAST_DECADES:
            shapes += [_shape(record, CONDUCTIVITY, PRESSURE, s) for s in PRESSURE.spans]
    return shapes


def _shape(record: Record, effect: str, axis: Axis, span: Span) -> RecordChange:
    """The shape of one property with one span."""
    property_name = effect.replace("-", "_")
    factor = point_of_record(record).definition(f"stack.rsi.{property_name}_factor")
    name, sigma = (
        f"{property_name}_change",
        float(np.sqrt(2.0)) * factor.sigma,
    )  # two factors that scatter independently
    parameter = Parameter(name, "1", 0.0, sigma, *axis.limits(span), f"change of the factor with {axis.name}")
    text = f"{effect.replace('-', ' ')} of the insulation changes with {axis.name}"
    ends = f"between {span[0]:.3g} and {span[1]:.3g} {axis.suffix.replace('_', ' ')}"

    def near(fraction: float) -> Sequence[RecordChange]:
        return [_shape(record, effect, axis, s) for s in moved_ends(span, fraction, axis.shortest, axis.within)]

    return RecordChange(
        "wall", text, parameter, partial(with_shape, effect=effect, axis=axis, span=span),
        lambda change: f"{text} {ends} by {100.0 * change:+.0f} % of the declared one", effect=effect, form=text,
        near=near, free=(factor.name,),
        ends={
            f"{property_name}_{end}_{axis.suffix}": (x, axis.unit) for end, x in zip(("from", "to"), span, strict=True)
        },
    )  # fmt: skip


def with_shape(record: Record, change: float, *, effect: str, axis: Axis, span: Span) -> Record:
    """The record with a change d [-] of a property of its insulation across a span of an axis."""
    stack, number = record.declared.stack, insulation_layer(record.construction)
    layer, name = stack.layer[number], stack.layer_names[number]

    def factor(x: FloatArray) -> FloatArray:
        return np.maximum(1.0 + change * axis.shape(x, span), axis.least_factor)

    material = record.declared.materials[layer.material]
    if effect == HEAT_CAPACITY:
        table = pairs(material.specific_heat_J_kgK)
        T_K = np.union1d(table[0], axis.points(span))
        c = np.interp(T_K, *table) * factor(T_K)
        changed = material.model_copy(update={"specific_heat_J_kgK": np.column_stack((T_K, c)).tolist()})
    else:
        p_Pa, T_K, k = _conductivity_over(material, axis.points(span), axis is PRESSURE)
        k = k * (factor(np.log10(p_Pa)) if axis is PRESSURE else factor(T_K)[:, np.newaxis])
        changed = material.model_copy(update={"conductivity_W_mK": _conductivity_table(material, p_Pa, T_K, k)})
    # a material of its own: another layer of the same one stays as it is
    changed_name = f"{layer.material}, {name}"
    layers = [*stack.layer]
    layers[number] = layer.model_copy(update={"material": changed_name, "name": name})
    return with_layers(record, layers, {**record.declared.materials, changed_name: changed})


def _conductivity_over(
    material: Material, points: FloatArray, of_pressure: bool
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Declared conductivity on its grid with more points: (p,) [Pa], (T,) [K], (T, p) [W/(m K)].

    points : temperatures [K] or log10 of pressures [Pa]
    """
    p_Pa, T_K, k = material.conductivity_grid()
    if of_pressure:
        finer = np.union1d(np.log10(p_Pa), points)
        return 10.0**finer, T_K, np.array([np.interp(finer, np.log10(p_Pa), row) for row in k])
    finer = np.union1d(T_K, points)
    return p_Pa, finer, np.array([np.interp(finer, T_K, column) for column in k.T]).T


def _conductivity_table(
    material: Material, p_Pa: FloatArray, T_K: FloatArray, k: FloatArray
) -> PressureTable | list[list[float]]:
    """A table of conductivity in the form that the material declares."""
    if isinstance(material.conductivity_W_mK, PressureTable):
        return PressureTable(p_Pa=p_Pa.tolist(), T_K=T_K.tolist(), k=k.tolist())
    return np.column_stack((T_K, k[:, 0])).tolist()
