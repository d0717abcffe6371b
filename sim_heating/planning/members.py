"""Estimates that the evidence cannot tell apart, each with its weight, as a study names them and its results state
them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from pydantic import Field

from sim_heating.base.files import Declared
from sim_heating.base.report.table import Column, Table

if TYPE_CHECKING:
    from sim_heating.planning.bands import Member


class StudyMember(Declared):
    """An [[envelope.member]] or a [[dispersion.member]]: an estimate that the evidence cannot tell from the others,
    with its weight. The page of the study has a table of all members, and study.json the list `members` of its part.

    estimate : an estimate.json, or a directory with one, relative to the study
    weight   : of the members together, that this one is true
    """

    estimate: str
    weight: float = Field(default=1.0, gt=0.0, le=1e6)


def member_data(stated: Sequence[StudyMember], members: Sequence[Member]) -> list[dict[str, Any]]:
    """Estimates of a part for study.json: file, control point, weight and share; none without members.

    members : as they were read, in the order of `stated`
    share   : weight over the sum of all weights [-], the probability that the estimate is true
    """
    total = sum(s.weight for s in stated)
    return [
        {
            "estimate": s.estimate,
            "control_point": None if member.estimate is None else member.estimate.control_point,
            "weight": s.weight,
            "share": s.weight / total,
        }
        for s, member in zip(stated, members if stated else (), strict=True)
    ]


def member_table(title: str, members: Sequence[Mapping[str, Any]]) -> Table:
    """The estimates of `member_data` for the page; with the number of their `flights` where they have one."""
    flown = any("flights" in m for m in members)
    columns = [
        Column("estimate"),
        Column("control point", is_text=True),
        Column("weight", format="g"),
        Column("share", format=".3g", unit="%"),
        *([Column("flights")] if flown else []),
    ]
    rows = [
        (
            m["estimate"],
            m["control_point"] or "several",
            m["weight"],
            100.0 * m["share"],
            *([m["flights"]] if flown else []),
        )
        for m in members
    ]
    return Table(title, columns, rows)
