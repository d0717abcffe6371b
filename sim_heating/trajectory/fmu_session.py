"""An FMU in a process of its own (`fmu_process`), stepped from here: a crash or a hang there is one clear line here.

The FMU is unpacked into a temporary folder, which is also the process's working directory; both are gone when the
session ends, however it ends.
"""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple

import fmpy

from sim_heating.errors import InputError, RunError
from sim_heating.files import shown

PROCESS = Path(__file__).with_name("fmu_process.py")
READY_S = 120.0
"""Longest time for the process itself to start."""
WATCH_S = 0.05
"""How often the watch looks at the clock."""
GOODBYE_S = 5.0
"""Longest time that an FMU may take to terminate."""
LAST_WORDS = 300
"""Characters of what the FMU printed last that an error tells."""


class Answer(NamedTuple):
    """Time that the FMU reached [s], its outputs in the order asked for, and whether it wants to end."""

    time_s: float
    values: list[float]
    ended: bool


class FmuSession:
    """One FMU, instantiated and initialised at `start`, then moved on by `step`; a context manager.

    path      : the FMU
    timeout_s : longest time that one call into the FMU may take [s]
    raises    : RunError with what happened, when and what the FMU said; InputError where it cannot be unpacked
    """

    def __init__(self, path: Path, timeout_s: float) -> None:
        self.path = path
        self.timeout_s = timeout_s

    def __enter__(self) -> FmuSession:
        self._folder = tempfile.TemporaryDirectory(prefix="sim_heating_fmu_", ignore_cleanup_errors=True)
        try:
            place = Path(self._folder.name)
            (place / "run").mkdir()
            self._unpack(place / "fmu")
            self._log = (place / "printed.txt").open("w+b")
            self._process = subprocess.Popen(
                [sys.executable, "-P", str(PROCESS)],
                cwd=place / "run", stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self._log,
            )  # fmt: skip
        except BaseException:
            self._folder.cleanup()
            raise
        self._deadline: float | None = None
        self._over, self._hung = threading.Event(), False
        threading.Thread(target=self._watch, daemon=True).start()
        try:
            self._answer("before it was loaded", READY_S)
        except BaseException as error:
            self.__exit__(type(error), error, None)
            raise
        return self

    def _unpack(self, place: Path) -> None:
        try:
            fmpy.extract(self.path, place)
        except Exception as error:  # FMPy raises plain Exceptions, zipfile and zlib their own
            raise InputError(f"{shown(self.path)}: cannot be unpacked ({error}); it is damaged") from None

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        self._over.set()
        try:
            if self._process.stdin is not None:
                self._process.stdin.close()
            self._process.wait(GOODBYE_S if kind is None else 0.0)
        except (subprocess.TimeoutExpired, OSError):
            self._process.kill()
            self._process.wait()
        finally:
            if self._process.stdout is not None:
                self._process.stdout.close()
            self._log.close()
            self._folder.cleanup()

    def start(
        self, interface: str, start: Mapping[str, Any], inputs: Sequence[str], outputs: Sequence[str], *,
        stop_s: float, tolerance: float | None,
    ) -> Answer:  # fmt: skip
        """Instantiate and initialise at 0 s: start values by name, names of inputs and outputs; outputs at 0 s."""
        request = {
            "folder": str(Path(self._folder.name) / "fmu"), "interface": interface, "start": dict(start),
            "inputs": list(inputs), "outputs": list(outputs), "start_s": 0.0, "stop_s": stop_s, "tolerance": tolerance,
        }  # fmt: skip
        return self._ask(request, "while it was instantiated and initialised")

    def step(self, time_s: float, step_s: float, inputs: Sequence[float]) -> Answer:
        """One communication step from time_s with inputs held at the given values."""
        request = {"time_s": time_s, "step_s": step_s, "inputs": list(inputs)}
        return self._ask(request, f"in its step at {time_s:.9g} s")

    def _ask(self, request: Mapping[str, Any], when: str) -> Answer:
        stdin = self._process.stdin
        assert stdin is not None
        with suppress(BrokenPipeError):  # a process that is gone has no answer either
            stdin.write(json.dumps(request).encode() + b"\n")
            stdin.flush()
        answer = self._answer(when, self.timeout_s)
        if "error" in answer:
            raise RunError(f"{shown(self.path)}: the FMU failed {when}: {answer['error']}{self._last_words()}")
        return Answer(**answer)

    def _answer(self, when: str, patience_s: float) -> dict[str, Any]:
        """What the process says next."""
        stdout = self._process.stdout
        assert stdout is not None
        self._deadline = time.monotonic() + patience_s
        line = stdout.readline()
        self._deadline = None
        if not line.endswith(b"\n"):
            raise RunError(f"{shown(self.path)}: {self._death(when)}{self._last_words()}")
        found: dict[str, Any] = json.loads(line)
        return found

    def _death(self, when: str) -> str:
        status = self._process.wait()
        if self._hung:
            return f"the FMU hung {when}: no answer within {self.timeout_s:g} s (timeout_s); it was stopped"
        if status < 0:
            name = signal.Signals(-status).name if -status in set(signal.Signals) else f"signal {-status}"
            return f"the FMU crashed {when} ({name})"
        return f"the FMU ended its process {when} (exit status {status})"

    def _last_words(self) -> str:
        """What the FMU printed last, on one line."""
        self._log.seek(0)
        said = " ".join(self._log.read().decode("utf-8", "replace").split())
        return f"; it said: {said[-LAST_WORDS:]}" if said else ""

    def _watch(self) -> None:
        """Stops the process when an answer is overdue."""
        while not self._over.wait(WATCH_S):
            deadline = self._deadline
            if deadline is not None and time.monotonic() > deadline:
                self._hung = True
                self._process.kill()
                return
