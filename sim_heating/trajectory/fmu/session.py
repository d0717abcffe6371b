"""An FMU in a separate process (process.py), stepped from here: a crash or hang there is one clear line here.

The FMU is unpacked into a temporary folder, which is also the working directory of the process; both are removed when
the session ends, for whatever reason. So are processes that the FMU started: where the platform supports it, the
process has its own session and group, and the group is killed. An interrupt from the terminal therefore does not reach
it.

Source: Modelica Association (2022), "Functional Mock-up Interface Specification 3.0".
"""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple

from sim_heating.base.errors import RunError
from sim_heating.base.files import display_path
from sim_heating.base.files.paths import os_error_reason
from sim_heating.trajectory.fmu.archive import unpack

PROCESS = Path(__file__).with_name("process.py")
READY_S = 120.0
"""Longest time for the process itself to start [s]."""
WATCH_S = 0.05
"""Interval of the watch [s]."""
TERMINATE_S = 5.0
"""Longest time that an FMU may take to terminate [s]."""
OUTPUT_LENGTH = 300
"""Characters of the FMU's last output that an error quotes."""
NO_ANSWER = b"\0\n"
"""Written by the watch in place of an answer that will not come."""
WINDOWS_EXCEPTION = 0x8000_0000
"""Least exit status of a process that an exception has ended on Windows: 0xC0000005 is an access violation."""
CONTROL_CODES = re.compile(r"\x1b\[[0-9;?]*[@-~]|[\x00-\x1f\x7f-\x9f]")
"""Control codes that a terminal would execute."""


Access = tuple[Any, ...]
"""(type, value reference) of a variable, with a value where it is set once."""


class Answer(NamedTuple):
    """Time that the FMU reached [s], its outputs in the requested order, and whether it requests the end."""

    time_s: float
    values: list[float]
    ended: bool


class FmuSession:
    """One FMU, instantiated and initialised by `start`, then advanced by `step`; a context manager.

    path      : the FMU
    timeout_s : longest time that one call into the FMU may take [s]
    raises    : RunError with the failure, its time and the last output of the FMU; InputError where it cannot be
    unpacked
    """

    def __init__(self, path: Path, timeout_s: float) -> None:
        self.path = path
        self.timeout_s = timeout_s
        self._deadline: float | None = None

    def __enter__(self) -> FmuSession:
        with ExitStack() as undo:
            try:
                self._begin(undo)
            except OSError as error:
                raise RunError(
                    f"{display_path(self.path)}: cannot be unpacked and started ({os_error_reason(error)}); "
                    "make room for temporary files or set TMPDIR to another place"
                ) from None
            self._answer("before it was loaded", READY_S)
            self._undo = undo.pop_all()
        return self

    def _begin(self, undo: ExitStack) -> None:
        """Unpack the FMU and start its process and the watch."""
        folder = tempfile.TemporaryDirectory(prefix="sim_heating_fmu_", ignore_cleanup_errors=True)
        self._folder = Path(undo.enter_context(folder))
        (self._folder / "run").mkdir()
        unpack(self.path, self._folder / "fmu")
        # A file and not a pipe: an FMU that prints much would fill a pipe and block.
        self._log = undo.enter_context((self._folder / "printed.txt").open("w+b"))
        # The write end stays open here as well, so that the watch can wake a reader whose process hangs.
        ours, theirs = os.pipe()
        self._answers = undo.enter_context(os.fdopen(ours, "rb"))
        self._answer_end = undo.enter_context(os.fdopen(theirs, "wb", 0))
        self._over, self._hung = threading.Event(), False
        # A session of its own, so that everything the FMU starts ends with it. -P: modules next to process.py must not
        # hide those of the same name elsewhere.
        self._process = subprocess.Popen(
            [sys.executable, "-P", str(PROCESS), str(os.getpid())],
            cwd=self._folder / "run",
            stdin=subprocess.PIPE,
            stdout=self._answer_end,
            stderr=self._log,
            start_new_session=True,
        )
        # Registered after the folder, so that the process has ended before its files are removed.
        undo.push(self._end)
        threading.Thread(target=self._watch, daemon=True).start()

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._undo.__exit__(kind, error, at)

    def _end(self, kind: type[BaseException] | None, *_: object) -> None:
        """Let the process terminate the FMU after success, then kill it and everything that it started."""
        self._over.set()
        try:
            with suppress(subprocess.TimeoutExpired, OSError):
                if kind is not None:
                    self._kill()
                if self._process.stdin is not None:
                    self._process.stdin.close()
                self._process.wait(TERMINATE_S)
        finally:
            self._kill()
            self._process.wait()

    def _kill(self) -> None:
        with suppress(ProcessLookupError, PermissionError):
            if hasattr(os, "killpg"):
                os.killpg(self._process.pid, signal.SIGKILL)
            else:
                self._process.kill()

    def start(
        self,
        model: Mapping[str, Any],
        start: Mapping[str, Sequence[Access]],
        inputs: Sequence[Access],
        outputs: Sequence[Access],
        *,
        stop_s: float,
        tolerance: float | None,
    ) -> Answer:
        """Instantiate and initialise, and give the outputs at time 0 [s].

        model           : FmuModel.process_description
        start           : (type, value reference, value) to be set when "instantiated", and in "initialization" mode
        inputs, outputs : (type, value reference) of the variables of each step

        Source: FMI 2.0.4, section 2.1.6.
        """
        request = {
            "folder": str(self._folder / "fmu"),
            "model": dict(model),
            "start": dict(start),
            "inputs": list(inputs),
            "outputs": list(outputs),
            "start_s": 0.0,
            "stop_s": stop_s,
            "tolerance": tolerance,
        }
        return self._request(request, "while it was instantiated and initialised")

    def step(self, time_s: float, step_s: float, inputs: Sequence[float]) -> Answer:
        """One communication step from time_s [s] with inputs held at the given values.

        Source: FMI 2.0.4, section 4.2.2.
        """
        request = {"time_s": time_s, "step_s": step_s, "inputs": list(inputs)}
        return self._request(request, f"in its step at {time_s:.9g} s")

    def _request(self, request: Mapping[str, Any], when: str) -> Answer:
        stdin = self._process.stdin
        assert stdin is not None
        with suppress(BrokenPipeError):  # a process that has ended gives no answer either
            stdin.write(json.dumps(request).encode() + b"\n")
            stdin.flush()
        answer = self._answer(when, self.timeout_s)
        if "error" in answer:
            raise RunError(f"{display_path(self.path)}: the FMU failed {when}: {answer['error']}{self._last_output()}")
        return Answer(**answer)

    def _answer(self, when: str, patience_s: float) -> dict[str, Any]:
        """The next answer of the process."""
        self._deadline = time.monotonic() + patience_s
        line = self._answers.readline()
        self._deadline = None
        if line.endswith(NO_ANSWER):
            raise RunError(f"{display_path(self.path)}: {self._end_reason(when)}{self._last_output()}")
        answer: dict[str, Any] = json.loads(line)
        return answer

    def _end_reason(self, when: str) -> str:
        status = self._process.wait()
        if self._hung:
            return f"the FMU hung {when}: no answer within {self.timeout_s:g} s (timeout_s); it was stopped"
        if status < 0:
            name = signal.Signals(-status).name if -status in set(signal.Signals) else f"signal {-status}"
            return f"the FMU crashed {when} ({name})"
        if status >= WINDOWS_EXCEPTION:
            return f"the FMU crashed {when} (exit status 0x{status:08X})"
        return f"the FMU ended its process {when} (exit status {status})"

    def _last_output(self) -> str:
        """The last output of the FMU, on one line."""
        self._log.seek(0)
        printed = " ".join(CONTROL_CODES.sub(" ", self._log.read().decode("utf-8", "replace")).split())
        return f"; it printed: {printed[-OUTPUT_LENGTH:]}" if printed else ""

    def _watch(self) -> None:
        """Wake the reader when no answer will come: the process has ended, or is killed because it is overdue.

        End of file on the pipe is not sufficient: processes that the FMU started may keep it open.
        """
        while not self._over.wait(WATCH_S):
            deadline, ended = self._deadline, self._process.poll() is not None
            self._hung = not ended and deadline is not None and time.monotonic() > deadline
            if ended or self._hung:
                self._kill()
                with suppress(OSError, ValueError):  # the session ended meanwhile
                    self._answer_end.write(NO_ANSWER)
                return
