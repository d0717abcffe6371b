"""What is unusual, or contradicts itself, about the frames of a link: told once a column, as for the columns of a file.

A frame whose values are impossible by themselves is refused where it is mapped. What frames have together, their speed,
altitude, density and time, is seen over a stretch of them; a link goes on, as a flight cannot be refused.
"""

from __future__ import annotations

from collections import deque
from operator import attrgetter
from pathlib import Path

import numpy as np

from sim_heating.base.files import CsvTable
from sim_heating.base.limits import usual_remark
from sim_heating.heating.recorded.plausible import implausible_values, unusual_values
from sim_heating.live.types import TIME, Frame

CHECKED_AT = (30, 100, 300, 1000, 3000)
"""Numbers of frames after which those so far are looked at together."""
NEEDED = ("altitude_m", "velocity_m_s", "rho_kg_m3")


class FrameRemarks:
    """Remarks on the frames of a link.

    file : name of the link file, which the lines begin with
    """

    def __init__(self, file: str) -> None:
        self._file, self._count = file, 0
        self._frames: deque[Frame] = deque(maxlen=CHECKED_AT[-1])
        self._told: set[str] = set()

    def add(self, frame: Frame) -> list[str]:
        """Take a frame; one line for each column that is unusual for the first time."""
        self._count += 1
        lines: list[str] = []
        for name, value in frame.values.items():
            if name not in self._told and (text := usual_remark(name, value)) is not None:
                self._told.add(name)
                lines.append(f"{self._file}, frame at {frame.time_s:g} s: {name} {text}")
        if self._count <= CHECKED_AT[-1]:
            self._frames.append(frame)
            if self._count in CHECKED_AT:
                lines += self._together()
        return lines

    def _together(self) -> list[str]:
        """What the columns of the frames so far say of each other."""
        by_time: dict[float, Frame] = {}
        for frame in sorted(self._frames, key=lambda f: f.time_s):
            by_time.setdefault(frame.time_s, frame)
        frames = list(by_time.values())
        names = set(frames[0].values).intersection(*map(attrgetter("values"), frames))
        if not names.issuperset(NEEDED):
            return []
        columns = {name: np.array([f.values[name] for f in frames]) for name in frames[0].values if name in names}
        columns[TIME] = np.array(list(by_time))
        table = CsvTable(columns, {}, Path(f"{self._file}, frames"), np.arange(1, len(frames) + 1))
        lines = implausible_values(table) or unusual_values(table)
        new = [line for line in lines if _column(line) not in self._told]
        self._told |= {_column(line) for line in new}
        return new


def _column(line: str) -> str:
    """The column that a line is about."""
    return line.partition(", column ")[2].partition(":")[0]
