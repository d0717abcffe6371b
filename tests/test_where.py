"""The page of questions where something is: files that exist, and a folder tree that answers by itself."""

from __future__ import annotations

import ast
import re

import pytest

from tests.support.paths import ROOT

PAGE = ROOT / "docs" / "development" / "where.md"
ROWS = re.findall(r"^\| ([^|`]+) \| `([^`]+)` \| `([^`]+)` \|$", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
STEM = 4
"""Letters at the beginning of a word that tell it from others: `revised` and `revise`, `synthetic` and `synthesize`."""


def is_answered_by_its_path(question: str, file: str) -> bool:
    """Whether a folder or the name of a file begins as a word of the question does."""
    names = re.findall(r"[a-z]+", file.removeprefix("sim_heating/").removesuffix(".py"))
    words = {w[:STEM] for w in re.findall(r"[a-z]+", question.lower()) if len(w) >= STEM or w in ("fit", "csv")}
    return any(name[:STEM] in words for name in names[-2:])


def test_twenty_questions_are_asked():
    assert len(ROWS) == 20
    assert len({question for question, _, _ in ROWS}) == 20


@pytest.mark.parametrize(("question", "file", "name"), ROWS, ids=[question for question, _, _ in ROWS])
def test_a_file_of_the_page_defines_what_it_names(question, file, name):
    tree = ast.parse((ROOT / file).read_text(encoding="utf-8"))
    assert name in {n.name for n in tree.body if isinstance(n, (ast.FunctionDef, ast.ClassDef))}


def test_the_folder_tree_alone_answers_at_least_eighteen():
    unanswered = [question for question, file, _ in ROWS if not is_answered_by_its_path(question, file)]
    assert len(ROWS) - len(unanswered) >= 18, unanswered
