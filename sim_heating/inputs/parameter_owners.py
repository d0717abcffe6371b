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
        if is_of_record(stem):
            return self.owned(owner, name)
        if owner not in self.points:
            raise InputError(f"`{name}`: there is no control point `{owner}`{suggestion(owner, self.points)}")
        return [r for r in self.records if r.declared.control_point == owner]

    def owned(self, owner: str, name: str) -> list[Record]:
        """The records of an owner: one, those of a flight, or those of a control point.

        name   : what it is the owner of, for the message
        raises : InputError where there is no such record, flight or control point
        """
        # a record's own name comes first: it may be that of its control point, which others may share
        for kind in (lambda r: r.name, lambda r: r.flight, lambda r: r.declared.control_point):
            if records := [r for r in self.records if kind(r) == owner]:
                return records
        names = [*(r.name for r in self.records), *(r.flight for r in self.records), *self.points]
        hint = suggestion(owner, dict.fromkeys(names))
        raise InputError(f"`{name}`: there is no record, flight or control point `{owner}`{hint}")

    def of_owner(self, values: Mapping[str, T], record: Record, name: str) -> T | None:
        """The value that is stated for a record, by owners; that without one, under "", holds for all others.

        values : owner -> value;  name : what is stated, for messages
        """
        owned = {owner: self.owned(owner, f"{name}{AT}{owner}") for owner in values if owner}
        covering = [o for o, records in owned.items() if any(r is record for r in records)]
        return values[min(covering, key=lambda o: len(owned[o]))] if covering else values.get("")

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
        """The names, with owners or without, that cover a parameter of a record: without owners, each once."""
        return list(dict.fromkeys(n.partition(AT)[0] for n in names if self._covers(n, record)))

    def stated(self, values: Mapping[str, T], record: Record) -> dict[str, T]:
        """What is stated of the parameters of a record, by their names without owners."""
        covering = [n for n in values if self._covers(n, record)]
        covering.sort(key=lambda n: -len(self.covered(n)) if AT in n else -len(self.records) - 1)
        return {n.partition(AT)[0]: values[n] for n in covering}

    def _covers(self, name: str, record: Record) -> bool:
        return any(r is record for r in self.covered(name))
