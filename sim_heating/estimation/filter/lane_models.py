"""Values of the models of an online filter in their lanes, at the parameters where each point is linearised."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sim_heating.base.arrays import FloatArray, IntArray
from sim_heating.base.kernels.block import D0
from sim_heating.estimation.filter.march import FilterTrack
from sim_heating.march.ensemble import Ensemble
from sim_heating.march.linearised import RATIO_ITSELF, PerturbedLane
from sim_heating.march.packing import PointLanes
from sim_heating.march.point import PointModel, heating_vector, stack_values


@dataclass(frozen=True, eq=False)
class PackedModel:
    """Values of a point as its lanes take them, at any values of its named parameters.

    stack, heating : of the model itself;  entries : of both that each parameter is, by its name, one array
    each; None where a parameter acts in another way, and the model has to be made
    """

    model: PointModel
    names: tuple[str, ...]
    stack: FloatArray
    heating: FloatArray
    entries: Mapping[str, tuple[IntArray, IntArray] | None]

    @staticmethod
    def of(model: PointModel, names: tuple[str, ...]) -> PackedModel:
        """Find the entries that parameters are, the ratio itself among them, as entries that follow two values."""
        entries: dict[str, tuple[IntArray, IntArray] | None] = {}
        for name in dict.fromkeys((*names, RATIO_ITSELF)):
            tried = [model.value(name) + by for by in (0.013, 0.029)]
            models = [model.with_parameters({name: v}) for v in tried]
            changed_at = []
            for vector_of in (stack_values, heating_vector):
                vectors = [vector_of(m) for m in models]
                changed = np.flatnonzero(vectors[0] != vectors[1])
                is_entry = all(np.all(x[changed] == v) for x, v in zip(vectors, tried, strict=True))
                changed_at.append(changed if is_entry else None)
            entries[name] = None if changed_at[0] is None or changed_at[1] is None else (changed_at[0], changed_at[1])
        return PackedModel(model, names, stack_values(model), heating_vector(model), entries)

    def values(self, parameters: Sequence[float], d: float, name: str, step: float) -> tuple[FloatArray, FloatArray]:
        """Values of stack and heating at parameters, one of them perturbed, with a disturbance of the ratio [-]."""
        values = dict(zip(self.names, parameters, strict=False))
        if name:
            values[name] = values.get(name, self.model.value(name)) + step
        if any(self.entries[n] is None for n in values):
            model = self.model.with_parameters(values)
            stack, heating = stack_values(model), heating_vector(model)
        else:
            stack, heating = self.stack.copy(), self.heating.copy()
            for n, value in values.items():
                in_stack, in_heating = self.entries[n] or (0, 0)
                stack[in_stack], heating[in_heating] = value, value
        heating[D0] += d
        return stack, heating

    def rows(
        self, parameters: Sequence[float], d: float, changes: Sequence[tuple[str, float]]
    ) -> tuple[FloatArray, FloatArray]:
        """Values of stack and heating of several lanes, in each of which one parameter is larger.

        parameters : (parameter,), each in its unit;  d : disturbance of the ratio [-]
        changes    : by lane, name of the parameter, empty for none, and by how much it is larger
        returns    : (lane, value) of the stack, (lane, value) of the heating

        Source: docs/theory/equations_march.md, equation 9.
        """
        stack, heating = self.values(parameters, 0.0, "", 0.0)
        stacks, heatings = np.empty((len(changes), len(stack))), np.empty((len(changes), len(heating)))
        stacks[:], heatings[:] = stack, heating
        values = dict(zip(self.names, parameters, strict=False))
        is_entries = all(self.entries[n] is not None for n in values)
        for k, (name, by) in enumerate(changes):
            entry = self.entries[name] if name and is_entries else None
            if entry is not None:
                value = values.get(name, self.model.value(name)) + by
                stacks[k, entry[0]], heatings[k, entry[1]] = value, value
            elif name:
                stacks[k], heatings[k] = self.values(parameters, 0.0, name, by)
        heatings[:, D0] += d
        return stacks, heatings


class LaneModels:
    """Writes the models of the points of a filter into their lanes.

    points    : models with the names of their parameters, which are their march's
    nominal   : lanes of the points
    perturbed : lanes with one parameter larger each;  changed : point, parameter and difference of each of them
    """

    def __init__(
        self,
        points: Sequence[FilterTrack],
        nominal: Ensemble,
        perturbed: Ensemble,
        changed: Sequence[PerturbedLane],
    ) -> None:
        self._nominal, self._perturbed = nominal, perturbed
        self._packed = [PackedModel.of(p.model, p.names) for p in points]
        self._lanes_of: list[tuple[PointLanes, PointLanes, list[tuple[str, float]]]] = []
        for i in range(len(points)):
            lanes = [k for k, lane in enumerate(changed) if lane.track == i]
            changes = [("", 0.0), *((changed[k].name, changed[k].by) for k in lanes)]
            self._lanes_of.append((nominal.writer.lanes_of([i]), perturbed.writer.lanes_of(lanes), changes))

    def write(self, i: int, parameters: Sequence[float], d: float, blocks: Sequence[FloatArray]) -> None:
        """Give the lanes of point number i its parameters and a ratio disturbance.

        parameters : (parameter,), each in its unit;  d : [-]
        blocks     : states of the perturbed lanes that receive them
        """
        nominal, perturbed, changes = self._lanes_of[i]
        stack, heating = self._packed[i].rows(parameters, d, changes)
        self._nominal.writer.write_lanes(self._nominal.state, nominal, stack[:1], heating[:1])
        for state in blocks:
            self._perturbed.writer.write_lanes(state, perturbed, stack[1:], heating[1:])
