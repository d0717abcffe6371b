"""The evidence that is shipped with the package is that of the results and the records of the project."""

from __future__ import annotations

import json

import pytest

from sim_heating.credibility.evidence import EVIDENCE, shipped_evidence
from sim_heating.credibility.facts import topics
from tools import credibility


def test_the_shipped_evidence_is_that_of_the_results():
    """Written again by `python -m tools.credibility`."""
    shipped = json.loads(EVIDENCE.read_text())
    assert shipped["verification"]["digest"] == credibility.rows_digest()
    assert shipped["verification"]["topics"] == credibility.topics()
    assert shipped["claims"] == credibility.claims()


def test_the_shipped_data_sets_are_those_of_the_measured_records(board, tile):
    shipped = {c["name"]: c for c in json.loads(EVIDENCE.read_text())["cases"]}
    assert set(shipped) == set(credibility.RECORDS)
    for predicted in (board, tile):
        made = credibility.case_of(predicted)
        stored = shipped[made["name"]]
        assert made["files"] == stored["files"]
        assert made["rmse_K"] == pytest.approx(stored["rmse_K"], rel=2e-3)
        assert [b["limits"] for b in made["bands"]] == [b["limits"] for b in stored["bands"]]


def test_every_topic_of_the_core_and_of_every_march_has_rows():
    assert all(shipped_evidence().topics[t].verified for t in topics.MARCH)


def test_every_topic_with_rows_is_verified():
    assert [n for n, t in shipped_evidence().topics.items() if not t.verified] == []
