"""Memory of an ensemble: its points in lanes of eight, and all of their numbers in one array."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from graphlib import CycleError, TopologicalSorter

import numpy as np

from sim_heating.base.arrays import FloatArray, IntArray
from sim_heating.base.kernels import block
from sim_heating.base.kernels.block import LANES
from sim_heating.march.frames import BLOCK_END, BLOCK_START, INTS_END, INTS_START
from sim_heating.thermal.elements import set_temperatures

CACHE_LINE = 64
"""Length of a line of the processor's cache [bytes]."""


@dataclass(frozen=True)
class LaneOffsets:
    """Where the lanes of a point are: its group, lanes from `lane` to before `end`, first number of the group's block.

    Offsets are places in the `state` of its ensemble, those of the point's first lane.
    """

    group: int
    lane: int
    end: int
    start: int

    def temperature(self, node: int) -> int:
        """Offset of a node temperature [K]; node 0 is at the surface."""
        return self.start + (block.HEAD_ROWS + node * block.NODE_ROWS + block.T) * LANES + self.lane

    @property
    def node_0(self) -> int:
        """Offset [-] in `state` of the first number of node 0, the node at the surface."""
        return self.start + block.HEAD_ROWS * LANES + self.lane

    def scalar(self, row: int) -> int:
        """Offset [-] in `state` of one number of the lane.

        row : row of the block ahead of its nodes (base/kernels/block.py)
        """
        return self.start + row * LANES + self.lane


class LaneMemory:
    """Blocks of numbers and integers of lane groups, and which point each lane is of.

    nodes  : (point,) number of nodes of each
    kinds  : (point,) numbers; points of different kinds share no group, those of the lowest come first
    behind : point -> the point of the wall upstream of its interface, by their numbers; that wall is in an earlier
             group, so that its step is taken first

    groups  : (group, 4) where its block begins and ends in `state`, and where its integers do in `ints`
    lanes   : (group * LANES,) point of each lane; lanes without a point repeat the last one, and never fail alone
    offsets : of each point
    state   : (number,) temperatures, conditions and all else that changes;  ints : (integer,) what does not
    """

    def __init__(self, nodes: Sequence[int], kinds: Sequence[int], behind: Mapping[int, int]) -> None:
        members = _grouped(nodes, kinds, behind)
        most = [max(nodes[i] for i in group) for group in members]
        blocks = np.concatenate(([0], np.cumsum([block.block_size(n) for n in most])))
        integers = np.concatenate(([0], np.cumsum([block.integers_size(n) for n in most])))
        self.groups: IntArray = np.column_stack([blocks[:-1], blocks[1:], integers[:-1], integers[1:]]).astype(np.int64)
        self.state = aligned_zeros(int(blocks[-1]))
        self.ints: IntArray = np.zeros(integers[-1], dtype=np.int64)
        self.lanes: IntArray = np.array([group + [group[-1]] * (LANES - len(group)) for group in members]).ravel()
        self.offsets = [LaneOffsets(0, 0, 0, 0)] * len(nodes)
        for g, group in enumerate(members):
            self.integers(g)[block.N_NODES] = most[g]
            for lane, i in enumerate(group):
                end = LANES if i == group[-1] else lane + 1
                self.offsets[i] = LaneOffsets(g, lane, end, int(blocks[g]))

    def block(self, group: int) -> FloatArray:
        """(number,) numbers of a lane group: temperatures [K], conditions and all else that changes (a view).

        group : number of the group
        """
        return self.state[self.groups[group, BLOCK_START] : self.groups[group, BLOCK_END]]

    def integers(self, group: int) -> IntArray:
        """(integer,) integers of a lane group: node count, table offsets, effect codes (a view).

        group : number of the group
        """
        return self.ints[self.groups[group, INTS_START] : self.groups[group, INTS_END]]

    def set_temperatures(self, point: int, temperature_K: FloatArray) -> None:
        """Set the node temperatures of a point.

        point : its number;  temperature_K : (node,) outermost first [K]
        """
        offsets = self.offsets[point]
        B, J = self.block(offsets.group), self.integers(offsets.group)
        set_temperatures(B, offsets.lane, offsets.end, J[block.N_NODES], temperature_K)

    def scalars(self, row: int) -> FloatArray:
        """(point,) numbers of one row of the block ahead of its nodes, each in the unit of the row ([K], [J/m2] ...).

        row : of base/kernels/block.py; its quantities: docs/theory/equations_thermal_step.md, section 2
        """
        return np.array([self.state[offsets.scalar(row)] for offsets in self.offsets])


def _grouped(nodes: Sequence[int], kinds: Sequence[int], behind: Mapping[int, int]) -> list[list[int]]:
    """Numbers of the points of each group, at most LANES of one kind, walls upstream in groups before."""
    group_of = {i: i for i in range(len(nodes))}  # by the first point of the group
    members: dict[int, list[int]] = {}
    with_room: list[int] = []
    # Padding behind the back costs as much as nodes do: neighbours in node count share a group.
    for i in sorted(group_of, key=lambda i: (kinds[i], -nodes[i], i)):
        alike = [first for first in with_room if kinds[first] == kinds[i]]
        group_of[i] = first = _group_to_join(i, alike, group_of, behind)
        members.setdefault(first, []).append(i)
        with_room = [f for f in dict.fromkeys([*with_room, first]) if len(members[f]) < LANES]
    first_of = {i: first for first, points in members.items() for i in points}  # the lowest kind comes first
    return [members[first] for first in _groups_in_order(first_of, behind)]


def _group_to_join(i: int, groups: Sequence[int], group_of: dict[int, int], behind: Mapping[int, int]) -> int:
    """The first of several groups with which walls upstream stay in groups before; the point's own without one."""
    return next((first for first in groups if not behind or _groups_in_order(group_of | {i: first}, behind)), i)


def _groups_in_order(group_of: Mapping[int, int], behind: Mapping[int, int]) -> list[int]:
    """Groups in an order in which walls upstream are before what lies behind them; empty where there is none.

    group_of : point -> its group, those of points that are in none yet are of one point; the order without any wall
    """
    before: dict[int, set[int]] = {group: set() for group in group_of.values()}
    for i, wall in behind.items():
        before[group_of[i]].add(group_of[wall])
    try:
        return list(TopologicalSorter(before).static_order())
    except CycleError:
        return []


def aligned_zeros(count: int) -> FloatArray:
    """Array of `count` zeros that begins on a cache line.

    Where every second vector load splits a line, a step takes a fifth longer.
    """
    memory = np.zeros(count + CACHE_LINE // 8)
    first = (-memory.ctypes.data % CACHE_LINE) // 8
    return memory[first : first + count]
