"""The sigma of every ratio table of the Orbiter follows from published scatter by one rule."""

import csv
import math
from collections import defaultdict

import pytest

from sim_heating.base.files import read_toml
from sim_heating.inputs.ratio_sources import RatioSource
from tests.support.paths import ROOT

SOURCES = ROOT / "aircraft_data" / "orbiter" / "ratio_sources"
FILES = sorted(SOURCES.glob("*.toml"))
REYNOLDS = [[2.0, 0.5], [5.21, 0.2], [6.075, 0.0], [6.773, 0.0], [7.65, 0.3], [8.4, 0.5]]
ALPHA = [[0.0, 0.5], [25.0, 0.0], [45.0, 0.0], [50.0, 0.1]]


def component(row: dict[str, str]) -> float:
    """Relative sigma of a published scatter [-], docs/theory/ratio_scatter.md, equations 2 and 3."""
    low, high, power = (float(row[key]) for key in ("low", "high", "power"))
    if row["reading"] == "range":
        return power * math.log(high / low) / (2.0 * math.sqrt(3.0))
    assert row["reading"] == "two methods"
    return power * math.log(math.sqrt(low * high)) / math.sqrt(2.0)


def sigmas_by_rule() -> dict[str, float]:
    squares: dict[str, float] = defaultdict(float)
    with (SOURCES / "scatter.csv").open() as file:
        for row in csv.DictReader(file):
            for table in row["tables"].split():
                squares[table] += component(row) ** 2
    return {table: math.sqrt(square) for table, square in squares.items()}


@pytest.mark.parametrize("file", FILES, ids=lambda p: p.stem)
def test_sigma_of_a_table_is_that_of_published_scatter(file):
    source, expected = read_toml(file, RatioSource), sigmas_by_rule()[file.stem]
    assert source.relative_sigma == pytest.approx(expected, abs=0.0051)


@pytest.mark.parametrize("file", FILES, ids=lambda p: p.stem)
def test_sigma_grows_alike_away_from_compared_states(file):
    curves = [(s.variable, s.points) for s in read_toml(file, RatioSource).sigma]
    assert ("log10_re", REYNOLDS) in curves
    assert ("alpha_deg", ALPHA) in curves


@pytest.mark.parametrize("name", ["elevon", "elevon_turbulent", "bodyflap", "bodyflap_turbulent"])
def test_deflection_is_as_uncertain_as_its_influence(name):
    source = read_toml(SOURCES / f"{name}.toml", RatioSource)
    law = next(f for f in source.factor if f.kind == "newtonian-deflection")
    curve = next(s for s in source.sigma if s.variable == law.variable)
    for deflection, sigma in curve.points:
        turned = math.sin(math.radians(40.0 + deflection)) / math.sin(math.radians(40.0))
        assert sigma == pytest.approx(abs(2.0 * law.pressure_exponent * math.log(turned)) / math.sqrt(3.0), abs=0.0051)
