"""What could be missing, once the sequential test has fired: close-loop on the record so far, in another process.

The journal is closed as a record without the sensors that stick or flicker, and `close_loop` weighs its candidates on
it, drifts of the sensors among them. The link goes on meanwhile.
"""

from __future__ import annotations

import multiprocessing
import os
import tempfile
from collections.abc import Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path

from sim_heating.base.errors import InputError, RunError, one_line
from sim_heating.base.progress import signals_deferred
from sim_heating.live.state import Candidate

NICE = 10
"""By how much the other process steps back behind the link's own."""
AGAIN_S = 60.0
"""Flight time after an alarm from which on candidates are weighed again, and again whenever it has doubled [s]."""
MOST_DEATHS = 3
"""Processes that may die before no other one is begun."""


@dataclass(frozen=True)
class Weighed:
    """What the record so far says is missing at a control point.

    until_s    : end of the record [s]
    finding    : "found", "one of", "partly", "unknown" or "none", as close-loop states it; "" where it could not
    candidates : effects that were named, those that the record cannot tell apart as one, with their calibrated
                 probability
    text       : in one line
    """

    point: str
    until_s: float
    finding: str
    candidates: Sequence[Candidate]
    text: str


class Weighing:
    """Closes the loop on the journal of a link, in a process of its own; one record at a time.

    last : what was found, None before that;  deaths : how often the process ended by itself, as for want of memory
    problem : why a later record could not be weighed, after one was; "" where it could

    What is found on an earlier record stays until a later one is weighed.
    """

    def __init__(self) -> None:
        self._pool: ProcessPoolExecutor | None = None
        self._running: Future[Weighed] | None = None
        self.last: Weighed | None = None
        self.deaths, self.problem = 0, ""
        self._due_s = 0.0

    def is_due(self, since_alarm_s: float) -> bool:
        """Whether a record is to be weighed: the first one, and one of which the time since the alarm has doubled.

        since_alarm_s : flight time since the alarm [s]
        """
        if self._running is not None or self.deaths >= MOST_DEATHS:
            return False
        return self.last is None or since_alarm_s >= self._due_s

    def weighed_from(self, since_alarm_s: float) -> None:
        """Note how long after the alarm a record ends that is being weighed [s]; from double that on another one is."""
        self._due_s = max(2.0 * since_alarm_s, AGAIN_S)

    @property
    def busy(self) -> bool:
        """Whether a record is being weighed."""
        return self._running is not None and not self._running.done()

    def start(
        self,
        journal: str | os.PathLike[str],
        point: str,
        left_out: Sequence[str] = (),
        *,
        root: str | os.PathLike[str] | None = None,
    ) -> bool:
        """Begin with the record so far of a control point; False while another one is being weighed.

        journal  : directory of the link, or its journal
        left_out : names of the sensors that were taken out
        """
        if self.busy:
            return False
        if self._pool is None:
            # spawned: a fork of a process with threads may hold their locks
            self._pool = ProcessPoolExecutor(1, multiprocessing.get_context("spawn"), initializer=_step_back)
        root_path = None if root is None else os.fspath(root)
        with signals_deferred():  # a Ctrl-C ends the link and leaves the process to it
            self._running = self._pool.submit(weigh, os.fspath(journal), point, tuple(left_out), root_path)
        return True

    def poll(self) -> Weighed | None:
        """What was found, once after it was; None otherwise, and where the process died: `start` begins again."""
        if self._running is None or not self._running.done():
            return None
        running, self._running = self._running, None
        try:
            weighed = running.result()
        except BrokenProcessPool:
            self._pool, self.deaths = None, self.deaths + 1
            if self.deaths < MOST_DEATHS:
                return None
            text = f"their process died {self.deaths} times; `close-loop` weighs candidates on the record"
            weighed = Weighed("", float("nan"), "", (), text)
        except Exception as error:  # the link goes on, whatever a record does to the search
            weighed = Weighed("", float("nan"), "", (), f"candidates were not weighed: {one_line(repr(error))}")
        if self.last is not None and self.last.finding and not weighed.finding:
            self.problem = weighed.text
        else:
            self.last, self.problem = weighed, ""
        return self.last

    def stop(self) -> None:
        """End the process, whatever it does."""
        if self._pool is not None:
            for process in list((self._pool._processes or {}).values()):
                process.terminate()
            self._pool.shutdown(wait=False, cancel_futures=True)
        self._pool = self._running = None


def _step_back() -> None:
    if hasattr(os, "nice"):
        os.nice(NICE)


def weigh(journal: str, point: str, left_out: Sequence[str] = (), root: str | None = None) -> Weighed:
    """Close the loop on the record so far of a control point.

    journal  : directory of the link, or its journal;  left_out : names of sensors that were taken out
    returns  : what is missing; a record that cannot be closed gives the reason as its text
    """
    from sim_heating.closure.close import close_loop
    from sim_heating.inputs.record import load_record
    from sim_heating.live.recording.to_record import link_of, to_record

    until_s = float("nan")
    try:
        with tempfile.TemporaryDirectory(prefix="sim_heating_live_") as folder:
            out = Path(folder) / "records"
            records, _ = to_record(journal, out, link_of(journal, root=root))
            if point not in records:
                return Weighed(point, until_s, "", (), f"{point}: no reading of it yet")
            record = load_record(out if len(records) == 1 else out / point)
            record = record.with_sensors([s for s in record.sensors if s.name not in left_out])
            until_s = float(record.time_s[-1])
            stated = close_loop(record).report.statement
    except (InputError, RunError) as error:
        return Weighed(point, until_s, "", (), f"{point}: not weighed: {one_line(str(error))}")
    named = [Candidate(" or ".join(names), stated.probability) for names in stated.alternatives]
    causes = [c.what for c in named]
    sure = "" if stated.probability is None else f", probability {stated.probability:.2f}"
    text = {
        "none": "no effect on the list is missing",
        "unknown": "unknown: no effect on the list explains it",
        "partly": f"unknown in part; it resembles {' and '.join(causes)}{sure}",
    }.get(stated.finding, f"{' and '.join(causes)}{sure}")
    return Weighed(point, until_s, stated.finding, () if stated.finding == "none" else named, f"{point}: {text}")
