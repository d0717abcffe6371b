"""Pictures of the README are those that its demonstration makes: a comment before each names the file below `out`."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from sim_heating.cli import main
from tests.support.paths import ROOT

PICTURE = re.compile(r"<!-- picture: (\S+) -->\s*!\[[^\]]*\]\(([^)]+)\)")
CHANGED = 5e-4
"""Fraction of pixels that letters of another version of a font may change; a curve that moves changes more."""


@pytest.mark.thorough
def test_pictures_of_the_readme_are_those_of_its_demo(tmp_path: Path) -> None:
    pictures = PICTURE.findall((ROOT / "README.md").read_text())
    assert len(pictures) == 2
    assert main(["demo", "--out", str(tmp_path / "out"), "--quiet"]) == 0
    for made, shown in pictures:
        new, old = imread(tmp_path / "out" / made), imread(ROOT / shown)
        assert new.shape == old.shape, f"copy {made} of the demo to {shown}"
        changed = float(np.mean(np.max(np.abs(new - old), axis=-1) > 0.2))
        assert changed < CHANGED, f"{shown} is older than what it shows; copy {made} of the demo to it"
