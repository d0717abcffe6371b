"""Runs a command of the program in this process and measures the work in it: kernels, and JSBSim's own steps.

    python -m benchmarks.command_floor FLOOR.json estimate scenarios/records/practice/p06 --out out

FLOOR.json then holds `kernels_s`, the processor time of compiled kernels that Python calls, without their loading and
compilation, added over threads, and `jsbsim_s`, that of JSBSim.
"""

from __future__ import annotations

import json
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from sim_heating.base.kernels.jit import Kernel
from sim_heating.base.parallel.threads import march_threads


class Stopwatch:
    """Processor time of calls [s], added over all threads; a call within another one is counted once."""

    def __init__(self) -> None:
        self.seconds, self._lock, self._own = 0.0, threading.Lock(), threading.local()

    def timed(self, call: Callable[..., Any], counts: Callable[[], object] = lambda: None) -> Callable[..., Any]:
        """The call with its time added, unless `counts()` has another value after it: a kernel was loaded in it."""

        def timed(*given: Any, **named: Any) -> Any:
            if getattr(self._own, "inside", False):
                return call(*given, **named)
            self._own.inside, before, start = True, counts(), time.thread_time()
            try:
                return call(*given, **named)
            finally:
                took, self._own.inside = time.thread_time() - start, False
                if counts() == before:
                    with self._lock:
                        self.seconds += took

        return timed


def _time_kernels(watch: Stopwatch) -> None:
    """Have every kernel that is called from now on timed."""

    def call(kernel: Kernel, *arguments: Any) -> Any:
        return watch.timed(kernel.dispatcher, lambda: len(kernel.dispatcher.overloads))(*arguments)

    Kernel.__call__ = call  # type: ignore[method-assign, assignment]


def _time_jsbsim(watch: Stopwatch) -> None:
    from sim_heating.trajectory.jsbsim.host import JSBSimHost

    JSBSimHost._call_jsbsim = watch.timed(JSBSimHost._call_jsbsim)  # type: ignore[method-assign]


def main() -> int:
    """Run the command of the arguments; its exit status."""
    path = Path(sys.argv.pop(1))
    kernels, jsbsim = Stopwatch(), Stopwatch()
    _time_kernels(kernels)
    if sys.argv[1] in ("run", "synthesize"):
        _time_jsbsim(jsbsim)
    from sim_heating.__main__ import main as run

    with march_threads(1):  # all is done in this process, where it is timed
        status = run()
    path.write_text(json.dumps({"kernels_s": kernels.seconds, "jsbsim_s": jsbsim.seconds}))
    return status


if __name__ == "__main__":
    sys.exit(main())
