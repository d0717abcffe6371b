"""Ratio tables in long form: each node once, in any order; a missing, repeated or mistyped node is named."""

from __future__ import annotations

import itertools
import random
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim_heating.base.conditions import RATIO_VARIABLES
from sim_heating.base.errors import InputError, UnusualWarning
from sim_heating.heating.ratio.table import RatioTable, read_ratio_table, write_ratio_table
from tests.support.paths import TILE

TILE = TILE / "ratio_table.csv"


def lines() -> list[str]:
    return TILE.read_text().splitlines()


def problem(folder: Path, changed: list[str]) -> str:
    path = folder / "ratio_table.csv"
    path.write_text("\n".join(changed) + "\n")
    with pytest.raises(InputError) as caught:
        read_ratio_table(path)
    assert "ratio_table.csv" in caught.value.problems[0]
    return caught.value.problems[0]


def test_nodes_have_the_ratio_of_their_row() -> None:
    table = read_ratio_table(TILE)
    assert [a.tolist() for a in table.axes] == [[30, 40, 50], [0], [5, 6], [-5, 5], [7.5]]
    assert table.ratio[2, 0, 1, 0, 0] == 0.1105
    assert table.sigma is not None
    assert table.sigma.shape == (3, 1, 2, 2, 1)
    assert table.reference == "sutton-graves"


def test_rows_may_be_in_any_order(tmp_path: Path) -> None:
    shuffled = lines()[5:]
    random.Random(1).shuffle(shuffled)
    (tmp_path / "a.csv").write_text("\n".join([*lines()[:5], *shuffled]))
    np.testing.assert_array_equal(read_ratio_table(tmp_path / "a.csv").ratio, read_ratio_table(TILE).ratio)


def test_sigma_and_header_of_a_table_are_optional(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("\n".join(line.rsplit(",", 1)[0] for line in lines()[4:]))
    table = read_ratio_table(tmp_path / "a.csv")
    assert table.sigma is None
    assert table.reference is None


def test_a_missing_node_is_named(tmp_path: Path) -> None:
    expected = "1 of 12 nodes of the grid missing; add a row for alpha_deg 30, beta_deg 0, log10_re 5, elevon_deg 5"
    assert expected in problem(tmp_path, [*lines()[:6], *lines()[7:]])


def test_a_repeated_node_is_reported_with_both_rows(tmp_path: Path) -> None:
    expected = "row 18: repeats the node of row 7; remove one (alpha_deg 30, beta_deg 0, log10_re 5, elevon_deg 5"
    assert expected in problem(tmp_path, [*lines(), lines()[6]])


def test_a_mistyped_axis_value_is_reported_with_its_row(tmp_path: Path) -> None:
    changed = [line.replace("50,0,5,-5", "50,0,5.5,-5") for line in lines()]
    expected = "row 14, column log10_re: 5.5 occurs at 1 nodes, other values at 5; correct it or complete the grid"
    assert expected in problem(tmp_path, changed)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("30,0,5,5,7.5,0.09150,", "30,0,5,5,7.5,nan,", "row 7, column ratio: nan is not a finite number"),
        ("30,0,5,5,7.5,0.09150,", "30,0,5,5,7.5,,", "row 7, column ratio: the cell is empty; give a number"),
        ("30,0,5,5,7.5,0.09150,", "30,0,5,5,7.5,", "row 7: 6 cells for 7 columns"),
        ("0.09150,0.005", "0.09150,-0.005", "row 7, column sigma: -0.005 is not a standard deviation"),
        ("alpha_deg", "alpha", "there is no column `alpha_deg`; nearest in the file: `alpha`"),
        ("ratio,sigma", "ratio,sigm", "unknown column `sigm`; did you mean `sigma`?"),
        ("ratio,sigma", "ratio,mach", "unknown column `mach`; known: `alpha_deg`"),
        ("30,0,5,5", "30,0,1e5,5", "row 7, column log10_re: 100000 is not the base-10 logarithm of a Reynolds number"),
        ("30,0,5,5", "300,0,5,5", "row 7, column alpha_deg: 300 is not an angle of attack in degrees"),
    ],
)
def test_a_damaged_cell_or_column_name_is_reported(tmp_path: Path, old: str, new: str, expected: str) -> None:
    text = "\n".join(lines())
    assert old in text
    assert expected in problem(tmp_path, text.replace(old, new, 1).splitlines())


def test_a_table_of_negative_ratios_alone_is_refused(tmp_path: Path) -> None:
    table = read_ratio_table(TILE)
    write_ratio_table(tmp_path / "a.csv", replace(table, ratio=-table.ratio))
    with pytest.raises(InputError, match=r"a.csv, column ratio: no ratio is above 0, and the least is -0\."):
        read_ratio_table(tmp_path / "a.csv")


def test_a_node_of_a_negative_ratio_is_refused_by_its_row(tmp_path: Path) -> None:
    """A hot wall gives heat away, with the same film coefficient; one below 0 is a slip of the sign."""
    text = "\n".join(lines()).replace("30,0,5,5,7.5,0.09150,", "30,0,5,5,7.5,-0.09150,")
    assert "row 7, column ratio: -0.0915 is not a ratio of film coefficients, which are not negative" in problem(
        tmp_path, text.splitlines()
    )


def test_an_estimate_near_zero_may_be_negative_and_is_told(tmp_path: Path) -> None:
    text = "\n".join(lines()).replace("30,0,5,5,7.5,0.09150,0.005", "30,0,5,5,7.5,-0.001,0.005")
    (tmp_path / "a.csv").write_text(text)
    with pytest.warns(UnusualWarning, match=r"a.csv, column ratio: 1 of \d+ nodes are negative, down to -0.001"):
        assert read_ratio_table(tmp_path / "a.csv").ratio.min() == -0.001


def test_inconsistent_axes_and_ratios_are_rejected() -> None:
    table = read_ratio_table(TILE)
    with pytest.raises(InputError, match="they must agree"):
        RatioTable(table.axes, table.ratio[:2])
    with pytest.raises(InputError, match="they must agree"):
        RatioTable(table.axes, table.ratio, table.ratio[:2])
    with pytest.raises(InputError, match="alpha_deg must be finite and increase"):
        RatioTable((table.axes[0][::-1], *table.axes[1:]), table.ratio)
    with pytest.raises(InputError, match="every ratio must be a finite number"):
        RatioTable(table.axes, table.ratio * np.nan)


axis = (
    st.lists(st.floats(-9.0, 19.0), min_size=1, max_size=3, unique=True)
    .map(sorted)
    .filter(lambda x: len(x) == 1 or x[-1] - x[0] >= 0.1)
)


@settings(max_examples=40, deadline=None)
@given(axes=st.tuples(*[axis] * len(RATIO_VARIABLES)), seed=st.integers(0, 99), with_sigma=st.booleans())
def test_any_table_is_read_back_as_it_was_written(
    tmp_path_factory: pytest.TempPathFactory, axes: tuple[list[float], ...], seed: int, with_sigma: bool
) -> None:
    shape = tuple(len(a) for a in axes)
    ratio, sigma = 0.1 + np.random.default_rng(seed).random((2, *shape))
    table = RatioTable(tuple(np.array(a) for a in axes), ratio, sigma if with_sigma else None, {"source": "made up"})
    path = tmp_path_factory.mktemp("table") / "a.csv"
    write_ratio_table(path, table)
    back = read_ratio_table(path)
    np.testing.assert_array_equal(back.ratio, ratio)
    assert all(np.array_equal(a, b) for a, b in itertools.zip_longest(back.axes, table.axes))
    assert (back.sigma is None) != with_sigma
    assert back.header == {"source": "made up"}
