"""What is stated of the parameters of a fit, by name: values that are fixed, priors, bounds, and ties.

A plain name is that of a parameter in all records, `ratio.d_alpha`. An owner behind `@` is a control point,
`ratio.d_alpha@V09T9527`; for parameters of clocks and thermocouples it is a record, all records of a flight, or all of
a control point: `clock.skew@STS-2/V09T9527`, `clock.skew@STS-2`. Of several names that cover a parameter, the one of
the fewest records holds.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TypeVar

from sim_heating.base.errors import InputError
from sim_heating.base.files import suggestion
from sim_heating.base.parameters import AT, RECORD_PARAMETERS, SENSOR_PREFIX
from sim_heating.inputs.record import Record

T = TypeVar("T")


def is_of_record(stem: str) -> bool:
    """Whether a parameter, by its name without owner, is of a record's clock or thermocouples, not of its point."""
    return stem in RECORD_PARAMETERS or stem.startswith(SENSOR_PREFIX)


class Owners:
    """Which records of a fit a name covers.

    records : of the fit, under distinct names
    """

    def __init__(self, records: Sequence[Record]) -> None:
        self.records = tuple(records)
        self.points = tuple(dict.fromkeys(r.declared.control_point for r in records))
        self._found: dict[str, list[Record]] = {}

    def known(self, stem: str) -> tuple[str, ...]:
        """Owners that a parameter may have, those of the fewest records first."""
        if not is_of_record(stem):
            return self.points
        return tuple(dict.fromkeys([*(r.name for r in self.records), *(r.flight for r in self.records), *self.points]))

    def covered(self, name: str) -> list[Record]:
        """The records whose parameter a name covers.

        raises : InputError where no record, flight or control point is the owner
        """
        if name not in self._found:
            self._found[name] = self._covered(name)
        return self._found[name]

    def _covered(self, name: str) -> list[Record]:
        stem, at, owner = name.partition(AT)
        if not at:
            return self._with_sensor(stem)
        if owner not in self.known(stem):
            what = "record, flight or control point" if is_of_record(stem) else "control point"
            raise InputError(f"`{name}`: there is no {what} `{owner}`{suggestion(owner, self.known(stem))}")
        # a record's own name comes first: it may be that of its control point, which others may share
        kinds = [lambda r: r.name, lambda r: r.flight] if is_of_record(stem) else []
        for kind in (*kinds, lambda r: r.declared.control_point):
            if found := [r for r in self.records if kind(r) == owner]:
                return found
        return []

    def _with_sensor(self, stem: str) -> list[Record]:
        """All records; of a parameter of a thermocouple those that have it, all where none has."""
        if not stem.startswith(SENSOR_PREFIX):
            return list(self.records)
        sensor = stem.removeprefix(SENSOR_PREFIX).rpartition(".")[0]
        having = [r for r in self.records if any(s.name == sensor for s in r.used_sensors)]
        return having or list(self.records)

    def label(self, stem: str, record: Record) -> str:
        """Name of a record's parameter in results: with its owner where there are several."""
        if is_of_record(stem):
            return f"{stem}{AT}{record.name}" if len(self.records) > 1 else stem
        return f"{stem}{AT}{record.declared.control_point}" if len(self.points) > 1 else stem

    def labels(self, names: Iterable[str]) -> list[str]:
        """The labels of all parameters that names cover, each once."""
        return list(dict.fromkeys(self.label(n.partition(AT)[0], r) for n in names for r in self.covered(n)))

    def of_record(self, names: Iterable[str], record: Record) -> list[str]:
        """Those of some names that cover a parameter of a record, without owners, each once."""
        return list(dict.fromkeys(n.partition(AT)[0] for n in names if self._covers(n, record)))

    def stated(self, values: Mapping[str, T], record: Record) -> dict[str, T]:
        """What is stated of the parameters of a record, by their names without owners."""
        covering = [n for n in values if self._covers(n, record)]
        covering.sort(key=lambda n: -len(self.covered(n)) if AT in n else -len(self.records) - 1)
        return {n.partition(AT)[0]: values[n] for n in covering}

    def _covers(self, name: str, record: Record) -> bool:
        return any(r is record for r in self.covered(name))
