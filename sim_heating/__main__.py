"""Entry point of the command `sim-heating` and of `python -m sim_heating`."""

import atexit
import errno
import io
import os
import sys
import threading
from typing import Any, NoReturn

from sim_heating.base.progress import EndingSignals


class _OutputFile(io.FileIO):
    """Standard output or error: what a reader or terminal that has gone does not take is dropped, and ends no command.

    title : its name in messages
    """

    def __init__(self, number: int, title: str) -> None:
        super().__init__(number, "w", closefd=False)
        self._title, self._dropped = title, False

    def write(self, data: Any) -> int:
        if not self._dropped:
            try:
                return super().write(data)
            except OSError as error:
                self._dropped = True  # also where it is reported: Python's last flush would fail again
                if error.errno != errno.EPIPE and not (error.errno == errno.EIO and self.isatty()):
                    raise OSError(error.errno, error.strerror, self._title) from None
        return len(data)


def _open_standard_streams() -> None:
    """Make the standard streams usable in every environment.

    A closed one becomes the null device: the next file to be opened would otherwise have its number, and receive what
    C libraries print. A character that the encoding of an output lacks is written as its escape.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # the lowest free number, which is this one
    if sys.stdin is None:
        sys.stdin = open(0, encoding="utf-8", closefd=False)  # noqa: SIM115
    sys.stdout = _text_output(1, sys.stdout, "standard output")
    sys.stderr = _text_output(2, sys.stderr, "standard error")


def _text_output(number: int, before: Any, title: str) -> Any:
    if before is not None and os.name == "nt":  # whose console takes text by other ways than a file
        before.reconfigure(errors="backslashreplace")
        return before
    raw, encoding = _OutputFile(number, title), "utf-8" if before is None else before.encoding
    is_line_buffered = number == 2 or raw.isatty() or getattr(before, "write_through", False)
    return io.TextIOWrapper(
        io.BufferedWriter(raw), encoding, errors="backslashreplace", line_buffering=is_line_buffered
    )


def main() -> int:
    """Run the command; its exit status: 0 done, 1 failed, 2 bad usage or input, 128 and its number after a signal."""
    signals = EndingSignals()
    try:
        signals.install()
        _open_standard_streams()
        from sim_heating import cli

        return cli.main(signals=signals)
    except BaseException as error:  # of the half second before the command is known; later ones are its own
        if not (signals.received or isinstance(error, KeyboardInterrupt)):
            raise
        return _interrupted(signals.exit_status)  # also where a library has made another error of it


def _interrupted(status: int) -> int:
    """Report an interrupt that came while the program was loaded, as a command reports its own; the exit status."""
    message = "interrupted: nothing was begun"
    print(message, file=sys.stderr)
    if "--json" in sys.argv[1:]:
        from sim_heating.cli.output import CommandReport

        report = CommandReport(sys.argv[1:])
        report.command = next((a for a in sys.argv[1:] if not a.startswith("-")), "")
        report.error = {"kind": "interrupted", "message": message, "problems": [message]}
        report.print_json(status)
    return status


class _End:
    """Ends the process with a status, without taking down its modules one by one.

    That saves 0.2 s of the 0.9 s of processor time that `validate` of a record would take.

    As the first function that is registered for the exit it is called last, after those of libraries. Without a status,
    after a traceback, Python ends as always.
    """

    status: int | None = None

    def __call__(self) -> None:
        if self.status is None:
            return
        try:
            sys.stdout.flush()
            sys.stderr.flush()
        except OSError:  # of which Python tells
            return
        os._exit(self.status)


def run_and_exit() -> NoReturn:
    """Run the command as a process of its own, which ends here with the status of `main`."""
    end = _End()
    atexit.register(end)
    end.status = main()
    if any(t is not threading.current_thread() and not t.daemon for t in threading.enumerate()):
        atexit._run_exitfuncs()  # Python would first wait for a thread that an effect has left, which may never end
    sys.exit(end.status)


if __name__ == "__main__":  # processes that a command starts import this module again
    run_and_exit()
