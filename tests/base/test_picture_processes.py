"""Tasks shared out to copies of the process: results and order, errors and warnings, nothing left behind."""

from __future__ import annotations

import os
import sys
import threading
import warnings
from functools import partial

import pytest

from sim_heating.base.report.figure import draw_files, new_figure, save_figure
from sim_heating.base.report.processes import in_processes
from sim_heating.base.threads import march_threads

HERE = os.getpid()
copied = pytest.mark.skipif(sys.platform != "linux", reason="a process is copied on Linux alone")


def square(n: int) -> tuple[int, int]:
    return n * n, os.getpid()


@copied
def test_results_keep_the_order_of_the_tasks_and_come_from_two_processes():
    with march_threads(2):
        found = in_processes([partial(square, n) for n in range(5)])
    assert [value for value, _ in found] == [0, 1, 4, 9, 16]
    assert len({process for _, process in found}) == 2
    assert in_processes([]) == []


def test_beside_another_thread_and_in_one_that_shares_its_cores_all_is_done_here():
    done = threading.Event()
    beside = threading.Thread(target=done.wait)
    beside.start()
    with march_threads(2):
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


def test_what_fails_in_a_copy_is_done_again_here():
    with march_threads(2):
        assert in_processes([partial(only_here, n) for n in range(4)]) == [0, 1, 2, 3]


def warned(n: int) -> int:
    if n % 2:
        warnings.warn("seen", UserWarning, stacklevel=1)
    return n


def test_a_warning_of_a_copy_is_given_here():
    with march_threads(2), pytest.warns(UserWarning, match="seen"):
        assert in_processes([partial(warned, n) for n in range(2)]) == [0, 1]


@pytest.mark.parametrize("failing", [0, 1])
def test_an_error_is_raised_here_and_no_process_remains(failing):
    def task(n: int) -> int:
        if n == failing:
            raise ValueError("this picture has no data")
        return n

    with march_threads(2), pytest.raises(ValueError, match="no data"):
        in_processes([partial(task, n) for n in range(2)])
    with pytest.raises(ChildProcessError):
        os.waitpid(-1, os.WNOHANG)


def test_files_drawn_in_copies_have_the_same_bytes(tmp_path):
    def draw(path):
        figure, axes = new_figure(4.0, 3.0, 1)
        axes[0].plot([0.0, 1.0], [300.0, 1200.0])
        save_figure(figure, path, "one curve", axes)

    for threads in (1, 2):
        folder = tmp_path / str(threads)
        folder.mkdir()
        with march_threads(threads):
            draw_files([partial(draw, folder / f"{n}.png") for n in range(3)])
    drawn = {p.read_bytes() for p in tmp_path.rglob("*.png")}
    assert len(list(tmp_path.rglob("*.png"))) == 6
    assert len(drawn) == 1
