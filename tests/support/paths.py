"""Paths of the project's files for the tests: vehicles, scenarios, records, and test data."""

from pathlib import Path

TESTS = Path(__file__).resolve().parents[1]
ROOT = TESTS.parent
DATA = TESTS / "data"
TILE = DATA / "records" / "tile"
"""A small flight record of one tile."""
BOARD = DATA / "records" / "board"
"""A small record of an insulation board under a lamp."""
AIRCRAFT = ROOT / "aircraft_data"
ORBITER = AIRCRAFT / "orbiter"
SCENARIOS = ROOT / "scenarios"
RECORDS = SCENARIOS / "records"
PRACTICE = RECORDS / "practice"
