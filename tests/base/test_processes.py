"""Tasks shared out to copies of the process: results and order, errors and warnings, nothing left behind.

Each deed is done in a process of its own: that of a test has threads, beside which no process is copied.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import threading
import warnings
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import pytest

from sim_heating.base.errors import InputError
from sim_heating.base.parallel.processes import in_processes, in_shares, in_turn
from sim_heating.base.parallel.threads import march_threads, thread_count

HERE = os.getpid()
ROOT = Path(__file__).parents[2]


def square(n: int) -> tuple[int, int]:
    return n * n, os.getpid()


def results_keep_the_order_of_the_tasks():
    found = in_processes([partial(square, n) for n in range(5)])
    assert [value for value, _ in found] == [0, 1, 4, 9, 16]
    assert len({process for _, process in found}) == (2 if sys.platform == "linux" else 1)
    assert in_processes([]) == []


def tasks_are_dealt_out_in_turn():
    """By number, whoever is done first: the same process has the same tasks every time."""
    found = [process == HERE for _, process in in_processes([partial(square, n) for n in range(5)])]
    assert found == ([True, False, True, False, True] if sys.platform == "linux" else [True] * 5)


def shares_keep_the_order_of_their_numbers():
    found = in_shares(lambda chosen: [square(k) for k in chosen], 5)
    assert [value for value, _ in found] == [0, 1, 4, 9, 16]
    assert in_shares(lambda chosen: [thread_count() for _ in chosen], 2) == [1, 1]
    assert in_shares(lambda chosen: [square(k) for k in chosen], 0) == []


def numbers_are_taken_in_turn_with_enough_left_for_each_process():
    found = in_turn(lambda numbers, together: {k: (*square(k), together) for k in numbers}, 12)
    assert [value for value, _, _ in found] == [k * k for k in range(12)]
    assert {together for _, _, together in found} == ({3} if sys.platform == "linux" else {12})
    assert in_turn(lambda numbers, _: dict.fromkeys(numbers), 0) == []


def copies_fail_late(numbers: Iterator[int]) -> dict[int, int]:
    """A copy of this process has done numbers 1 and 3 when it fails at 5."""
    found = {}
    for k in numbers:
        if os.getpid() != HERE and k == 5:
            raise RuntimeError("a copy fails")
        found[k] = k
    return found


def numbers_of_a_copy_that_failed_are_done_here():
    assert in_turn(lambda numbers, _: copies_fail_late(numbers), 7) == list(range(7))


def beside_a_thread_and_in_one_that_shares_its_cores_all_is_done_here():
    done = threading.Event()
    beside = threading.Thread(target=done.wait)
    beside.start()
    found = in_processes([partial(square, n) for n in range(3)])
    done.set()
    beside.join()
    with march_threads(1):
        found += in_processes([partial(square, n) for n in range(3)])
    assert {process for _, process in found} == {HERE}


def only_here(n: int) -> int:
    if os.getpid() != HERE:
        raise RuntimeError("a copy fails")
    return n


def what_fails_in_a_copy_is_done_again_here():
    assert in_processes([partial(only_here, n) for n in range(4)]) == [0, 1, 2, 3]


def warned(n: int) -> int:
    if n % 2:
        warnings.warn("seen", UserWarning, stacklevel=1)
    return n


def a_warning_of_a_copy_is_given_here():
    with pytest.warns(UserWarning, match="seen"):
        assert in_processes([partial(warned, n) for n in range(2)]) == [0, 1]


def of_an_old_library(n: int) -> int:
    warnings.warn("not shown to users", DeprecationWarning, stacklevel=1)
    return os.getpid()


def a_warning_that_nobody_is_shown_has_nothing_done_again():
    found = in_processes([partial(of_an_old_library, n) for n in range(2)])
    assert len(set(found)) == (2 if sys.platform == "linux" else 1)


def failing(n: int, at: int) -> int:
    if n == at:
        raise ValueError("this picture has no data")
    return n


def an_error_is_raised_here_and_no_process_remains():
    for at in range(2):
        with pytest.raises(ValueError, match="no data"):
            in_processes([partial(failing, n, at) for n in range(2)])
        if sys.platform == "linux":
            with pytest.raises(ChildProcessError):
                os.waitpid(-1, os.WNOHANG)


def refused(done: Path) -> None:
    done.write_text(done.read_text() + "once ")
    raise InputError("stop.toml: flies no frame", "stop.toml: has no end")


def wrong_input_found_in_a_copy_is_told_here_and_the_work_is_not_repeated():
    with tempfile.TemporaryDirectory() as folder:
        done = Path(folder) / "done"
        done.write_text("")
        with pytest.raises(InputError) as found:
            in_processes([lambda: None, partial(refused, done)])
        assert found.value.problems == ("stop.toml: flies no frame", "stop.toml: has no end")
        assert done.read_text() == "once "
    if sys.platform == "linux":
        with pytest.raises(ChildProcessError):
            os.waitpid(-1, os.WNOHANG)


def killed() -> int:
    if os.getpid() != HERE:
        os.kill(os.getpid(), signal.SIGKILL)
    return os.getpid()


def a_copy_that_is_killed_has_its_task_done_here():
    assert in_processes([killed, killed]) == [HERE, HERE]


@pytest.mark.thorough
@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="the system confines no process to some cores")
def test_a_process_that_may_use_one_core_shares_nothing_out():
    confined = "import os; os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})"
    program = (
        f"{confined}\nfrom {__name__} import *\nassert thread_count() == 1\n"
        "assert len({process for _, process in in_processes([partial(square, n) for n in range(3)])}) == 1"
    )
    ended = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr


@pytest.mark.sample(1)
@pytest.mark.parametrize(
    "deed",
    [
        results_keep_the_order_of_the_tasks,
        tasks_are_dealt_out_in_turn,
        shares_keep_the_order_of_their_numbers,
        numbers_are_taken_in_turn_with_enough_left_for_each_process,
        numbers_of_a_copy_that_failed_are_done_here,
        beside_a_thread_and_in_one_that_shares_its_cores_all_is_done_here,
        what_fails_in_a_copy_is_done_again_here,
        a_warning_of_a_copy_is_given_here,
        a_warning_that_nobody_is_shown_has_nothing_done_again,
        an_error_is_raised_here_and_no_process_remains,
        wrong_input_found_in_a_copy_is_told_here_and_the_work_is_not_repeated,
        a_copy_that_is_killed_has_its_task_done_here,
    ],
    ids=lambda deed: deed.__name__,
)
def test_of_tasks_in_copies_of_a_process(deed):
    program = f"from {__name__} import *\nwith march_threads(2):\n    {deed.__name__}()"
    ended = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
