"""Errors are printable lines whatever texts they quote: keys and names of files, and the words of other libraries."""

from __future__ import annotations

import pickle

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim_heating.base.errors import LONGEST, InputError, RunError
from sim_heating.base.files import suggestion

TEXTS = st.text(max_size=40) | st.sampled_from(["a\nb", "\x1b[31mred", "\u202eabc", "x" * 5000, "\x00", "\x85\u2028"])


@given(st.lists(TEXTS, min_size=1, max_size=4))
def test_every_problem_is_one_printable_line_of_a_length_to_be_read(texts: list[str]) -> None:
    for error in (InputError(*texts), RunError(texts[0])):
        lines = str(error).split("\n")
        assert all(line.isprintable() and len(line) <= LONGEST + 5 for line in lines)


def test_a_long_problem_keeps_its_place_and_its_remedy() -> None:
    (line,) = InputError(f"ball.xml: {'x' * 5000}; give a number").problems
    assert line.startswith("ball.xml: xxx")
    assert line.endswith("xxx; give a number")


def test_a_problem_is_given_once_and_problems_stay_apart_on_the_way_from_another_process() -> None:
    error = pickle.loads(pickle.dumps(InputError("a.toml: one", "b.toml: two", "a.toml: one")))
    assert error.problems == ("a.toml: one", "b.toml: two")


@pytest.mark.parametrize(("count", "end"), [(24, "`n23`"), (200, "`n23` and 176 more")])
def test_a_message_lists_known_names_as_far_as_they_are_read(count: int, end: str) -> None:
    assert suggestion("zzz", [f"n{i}" for i in range(count)]).endswith(end)
