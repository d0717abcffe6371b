"""Predictions that the tests of credibility share."""

from __future__ import annotations

import pytest

import sim_heating as sh
from sim_heating.simulation.predict import Prediction
from tests.support.paths import ROOT


@pytest.fixture(scope="session")
def board() -> Prediction:
    """The measured board under a lamp, predicted as declared."""
    return sh.predict(ROOT / "scenarios" / "records" / "kaowool_board")


@pytest.fixture(scope="session")
def tile() -> Prediction:
    """A measured tile of STS-96, predicted as declared."""
    return sh.predict(ROOT / "scenarios" / "records" / "sts96_597")
