"""A published state in the forms that its readers take, each made once however many there are."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property
from typing import Any, Protocol

from sim_heating.live.state import AheadState, PointState, State, plain, state_json


class Output(Protocol):
    """What a link publishes its states to."""

    async def start(self) -> None:
        """Begin; raises InputError where an address cannot be used."""

    def publish(self, published: Published) -> None:
        """Take a state and return at once."""

    async def stop(self) -> None:
        """End, with the latest state given to who can take it."""


class Published:
    """A state and its forms.

    state : what is published
    """

    def __init__(self, state: State) -> None:
        self.state = state
        self._of_page: dict[str, str] = {}

    @cached_property
    def line(self) -> str:
        """All of the state as one line of JSON."""
        return state_json(self.state)

    def page(self, point: str | None) -> str:
        """What the page shows of the state as JSON: one control point whole, of the others what table and map show.

        point : name of the control point that is shown whole; the first one where there is none of this name
        """
        points = self.state.points
        shown = point if point is not None and point in points else next(iter(points), "")
        if shown not in self._of_page:
            brief = {name: state if name == shown else _brief(state) for name, state in points.items()}
            self._of_page[shown] = state_json(replace(self.state, points=brief))
        return self._of_page[shown]

    @cached_property
    def scalars(self) -> dict[str, Any]:
        """The state as nested objects without the time histories of the look-ahead."""
        points = {
            name: replace(point, ahead=_without_histories(point.ahead)) for name, point in self.state.points.items()
        }
        contents: dict[str, Any] = plain(replace(self.state, points=points))
        return contents

    @cached_property
    def scalar_line(self) -> str:
        """`scalars` as one line of JSON, with its flight time as `timestamp`, too."""
        return json.dumps({"timestamp": self.state.time_s, **self.scalars}, separators=(",", ":"), allow_nan=False)


def _brief(point: PointState) -> PointState:
    return replace(point, sensors={}, parameters={}, ahead=_without_histories(point.ahead))


def _without_histories(ahead: Mapping[str, AheadState]) -> dict[str, AheadState]:
    none: tuple[float, ...] = ()
    return {
        name: replace(future, time_s=none, surface_K=none, surface_sigma_K=none, bondline_K=none, bondline_sigma_K=none)
        for name, future in ahead.items()
    }


class Latest:
    """The latest state for one reader: what came before it and was not taken is gone.

    >>> import asyncio
    >>> from sim_heating.live.outputs.published import Latest, Published
    >>> from sim_heating.live.state import State
    >>> async def read():
    ...     latest = Latest()
    ...     for k in range(3):
    ...         latest.put(Published(State(k, None, 0.0)))
    ...     return (await latest.take()).state.sequence
    >>> asyncio.run(read())
    2
    """

    def __init__(self) -> None:
        self._state: Published | None = None
        self._changed = asyncio.Event()

    def put(self, published: Published) -> None:
        """Replace the state that waits."""
        self._state = published
        self._changed.set()

    async def take(self) -> Published:
        """The latest state that was not taken yet."""
        await self._changed.wait()
        self._changed.clear()
        assert self._state is not None
        return self._state
