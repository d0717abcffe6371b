"""Marches of the records of a fit: made once, set to other parameters, the latest result of each group stored."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from sim_heating.base.arrays import FloatArray
from sim_heating.base.kernels.block import LANES
from sim_heating.estimation.record_fit import RecordFit, group_march, lane_groups, set_parameters
from sim_heating.march.linearised import Linearised, LinearMarch

LastMarches = list[tuple[bytes | None, Sequence[Linearised]]]
"""By group of records, the last parameter vector, as bytes, and its marches [K]."""


class FitMarches:
    """Marches of the records of a fit at parameter vectors.

    record_fits : records with their unknowns; those on common times are a group, which is marched side by side

    `groups` are the records of each group, `latest` the last result of each. A march packs its arrays when it is made:
    it is stored and set to other parameters. Linearised as docs/theory/equations_march.md, equations 4 to 8, state.
    """

    def __init__(self, record_fits: Sequence[RecordFit]) -> None:
        self.record_fits = tuple(record_fits)
        self.groups = lane_groups(record_fits)
        self.latest: LastMarches = [(None, [])] * len(self.groups)
        self._linearised: list[LinearMarch | None] = [None] * len(self.groups)
        self._plain: list[LinearMarch | None] = [None] * len(self.record_fits)

    def __getstate__(self) -> dict[str, Any]:
        """All but the marches, which hold addresses of compiled code and are made when they are asked for."""
        groups = len(self.groups)
        return {
            **self.__dict__,
            "_linearised": [None] * groups,
            "_plain": [None] * len(self.record_fits),
            "latest": [(None, [])] * groups,
        }

    def of_group(self, k: int, vector: FloatArray) -> Sequence[Linearised]:
        """A group at a parameter vector (parameter,): temperatures [K] and sensitivities, by record of the group.

        raises : RunError where a march failed
        """
        # likelihood, bounds, pictures and residual tests ask for the same vector in turn
        cached, marched = self.latest[k]
        if cached != vector.tobytes():
            group, march = self.groups[k], self._linearised[k]
            march = self._linearised[k] = group_march(group) if march is None else march
            marched = march.march(*set_parameters(march, group, [vector] * len(group)))
            self.latest[k] = (vector.tobytes(), marched)
        return marched

    def of_records(self, vector: FloatArray) -> list[Linearised]:
        """All records at a parameter vector (parameter,): temperatures [K] and sensitivities, by record.

        raises : RunError where a march failed
        """
        by_record = {
            id(p): f
            for k, group in enumerate(self.groups)
            for p, f in zip(group, self.of_group(k, vector), strict=True)
        }
        return [by_record[id(record_fit)] for record_fit in self.record_fits]

    def store(self, vector: FloatArray, marched: Mapping[int, Linearised]) -> None:
        """Store results of marches made elsewhere, so that the next evaluation at that vector marches nothing.

        vector  : (parameter,) at which they were made
        marched : index of the record -> its march [K]
        """
        for k, group in enumerate(self.groups):
            self.latest[k] = (vector.tobytes(), [marched[self.record_fits.index(record_fit)] for record_fit in group])

    def has(self, vector: FloatArray) -> bool:
        """Whether an evaluation at a parameter vector (parameter,) needs no march."""
        return all(cached == vector.tobytes() for cached, _ in self.latest)

    def plain(self, k: int) -> LinearMarch:
        """A march of record number k, LANES times, without sensitivities."""
        march = self._plain[k]
        if march is None:
            record_fit = self.record_fits[k]
            history = record_fit.history(record_fit.time_s)
            march = self._plain[k] = LinearMarch(
                [record_fit.track(sensitive=False)] * LANES, record_fit.time_s, history
            )
        return march
