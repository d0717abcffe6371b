"""Long work: the command that runs, reports of its progress, and the signals that end it."""

from __future__ import annotations

import _thread
import json
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

Progress = Callable[[float, str], None]
"""Called with the fraction done (0 to 1) and a line of text."""


def no_progress(_: float, __: str) -> None:
    """Progress that is not reported."""


COMMAND = "SIM_HEATING_COMMAND"
"""Environment variable that holds the command that runs: processes that it starts inherit it."""


@contextmanager
def stating_command(arguments: list[str] | None, out: str | None) -> Iterator[None]:
    """Within the block, results state this command as their origin.

    arguments : of the command, without the folder of its results and without what changes no result
    out       : folder of its results; None where it has none
    """
    before = os.environ.pop(COMMAND, None)
    if arguments is not None and out is not None:
        os.environ[COMMAND] = json.dumps({"arguments": arguments, "out": os.path.realpath(out)})
    try:
        yield
    finally:
        os.environ.pop(COMMAND, None)
        if before is not None:
            os.environ[COMMAND] = before


def running_command() -> dict[str, Any] | None:
    """The command that runs: `arguments`, and the folder `out` of its results; None where Python calls the program."""
    stated = os.environ.get(COMMAND)
    return None if stated is None else dict(json.loads(stated))


ENDING_SIGNALS = tuple(getattr(signal, n) for n in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, n))
"""Signals that end a command: Ctrl-C, a request to end, a lost terminal; Windows has no hangup."""
SAME_REQUEST_S = 1.0
"""Time [s] within which a further signal is the same request: a terminal and a launcher may both pass on one Ctrl-C."""
AFTER_CALLBACK_S = 0.02
"""Time [s] after which an interrupt is repeated that a callback has ignored."""


class EndingSignals:
    """Handlers that raise KeyboardInterrupt once, so that all that is open is closed, and remember the signal.

    A further signal, after a second, ends the process at once.
    """

    def __init__(self) -> None:
        self._first: signal.Signals | None = None
        self._time_s = 0.0
        self._is_lost = False
        self._report_unraisable = sys.unraisablehook

    def install(self) -> None:
        """Handle every ending signal, except one that the process was started to ignore (as by nohup)."""
        for number in ENDING_SIGNALS:
            if signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, self._end)
        sys.unraisablehook = self._raise_again

    def ignore(self) -> None:
        """Ignore ending signals from now on: the work is done, and its answer is not to be cut off."""
        for number in ENDING_SIGNALS:
            if signal.getsignal(number) == self._end:
                signal.signal(number, signal.SIG_IGN)

    @property
    def received(self) -> bool:
        """Whether a signal came."""
        return self._first is not None

    @property
    def exit_status(self) -> int:
        """Exit status of an interrupted command: 128 and the number of the signal, Ctrl-C where none is known."""
        return 128 + (signal.SIGINT if self._first is None else self._first)

    def _end(self, number: int, _: FrameType | None) -> None:
        if self._first is None or self._is_lost:
            if self._first is None:
                self._first, self._time_s = signal.Signals(number), time.monotonic()
            self._is_lost = False
            raise KeyboardInterrupt
        if time.monotonic() - self._time_s > SAME_REQUEST_S:
            os._exit(self.exit_status)

    def _raise_again(self, unraisable: Any) -> None:
        """Repeat, a little later, an interrupt that came in a callback of a C library, which ignores exceptions."""
        if not (self.received and issubclass(unraisable.exc_type, KeyboardInterrupt)):
            self._report_unraisable(unraisable)
            return
        self._is_lost = True
        threading.Timer(AFTER_CALLBACK_S, self._repeat).start()

    def _repeat(self) -> None:
        if hasattr(signal, "pthread_kill"):  # which also ends a wait
            signal.pthread_kill(
                threading.main_thread().ident or 0, signal.SIGINT if self._first is None else self._first
            )
        else:
            _thread.interrupt_main()


@contextmanager
def signals_deferred() -> Iterator[None]:
    """Ending signals are handled after the block; for the start of processes, which a signal would leave half-made.

    Processes and threads that the block starts are not reached by what the terminal sends: the command ends them.
    Without effect outside the main thread, which alone handles signals.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    received: list[int] = []
    handlers: dict[int, Any] = {n: signal.getsignal(n) for n in ENDING_SIGNALS}
    before = {n: handler for n, handler in handlers.items() if callable(handler) or handler is signal.SIG_DFL}
    for number in before:
        signal.signal(number, lambda n, _: received.append(n))
    mask = _block_interrupts()
    try:
        yield
    finally:
        if mask is not None:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        for number, handler in before.items():
            signal.signal(number, handler)
        if received:
            signal.raise_signal(received[0])


def _block_interrupts() -> Any:
    """Block what a terminal sends in this thread and in what it starts from now on: Ctrl-C and the hangup.

    returns : the earlier mask, None where there is no such
    """
    if not hasattr(signal, "pthread_sigmask"):
        return None
    from multiprocessing.resource_tracker import ensure_running

    ensure_running()  # with the first process it is started, and removes the block
    return signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGHUP})
