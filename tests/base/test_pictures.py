"""Pictures show names as they are written, and a picture that cannot be drawn costs no numbers."""

from __future__ import annotations

import ast
import shutil
import xml.etree.ElementTree as ET
from base64 import b64decode
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from matplotlib.figure import Figure
from matplotlib.text import Text

from sim_heating.base.errors import InputError, printable
from sim_heating.base.report.figure import (
    PictureWarning,
    legend_label,
    mark_beyond,
    new_figure,
    replaced_if_undrawable,
    save_figure,
)
from sim_heating.base.report.page import Picture
from sim_heating.cli import main
from tests.support.paths import ROOT, TILE

NAMES = st.text(st.sampled_from("$\\^_{}%#&~<>'\"abfrc \x1b\u0394\u70ed"), min_size=1, max_size=12)


def drawn(path: Path | None, name: str) -> Figure:
    figure, axes = new_figure(4.0, 3.0, 1)
    axes[0].plot([0.0, 1.0], [1.0, 100.0], label=legend_label(name))
    axes[0].set_yscale("log")
    axes[0].set_xticks([0.0, 1.0], [name, "b"])
    axes[0].set_xlabel(name)
    axes[0].legend()
    return save_figure(figure, path, name, axes)


@pytest.mark.thorough
@settings(max_examples=10)
@example("_")
@example("$$")
@example("\x1b--\u70ed")
@example("$x^$")
@example(r"a$\frac{$b")
@given(NAMES)
def test_any_name_is_text_in_a_picture(tmp_path_factory: pytest.TempPathFactory, name: str) -> None:
    path = tmp_path_factory.mktemp("any") / "picture.png"
    figure = drawn(path, name)
    assert path.read_bytes().startswith(b"\x89PNG")
    svg = b64decode(Picture(figure).data_url.partition(",")[2])
    assert ET.fromstring(svg).tag.endswith("svg")
    label = next(t for t in figure.findobj(Text) if t is figure.axes[0].xaxis.label)
    assert label.get_text() == printable(name)


def test_powers_of_ten_remain_on_a_logarithmic_axis() -> None:
    figure = drawn(None, "$x^$")
    powers = [t for t in figure.axes[0].get_yticklabels() if "10^" in t.get_text()]
    assert powers
    assert all(t.get_parse_math() for t in powers)


@replaced_if_undrawable
def undrawable(path: Path | None, error: Exception) -> None:
    _, axes = new_figure(4.0, 3.0, 1)
    axes[0].plot([0.0], [1.0])
    raise error


def test_a_picture_that_fails_is_replaced_by_its_reason(tmp_path: Path) -> None:
    with pytest.warns(PictureWarning, match=r"a.png: this picture could not be drawn \(ValueError: \$ no \$\)"):
        undrawable(tmp_path / "a.png", ValueError("$ no $"))
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(ValueError, match="no"):
        undrawable(None, ValueError("no"))
    with pytest.raises(InputError, match="full"):  # a place that cannot be written is no fault of the picture
        undrawable(tmp_path / "a.png", InputError("full"))


def test_no_picture_of_a_file_costs_the_results_of_its_command() -> None:
    """Each function `draw_...(path, ...)` is replaced by its reason where it fails, and no helper of one is."""
    replaced, drawing = set(), set()
    for file in sorted((ROOT / "sim_heating").rglob("*.py")):
        for function in ast.walk(ast.parse(file.read_text())):
            if isinstance(function, ast.FunctionDef):
                arguments = [a.arg for a in function.args.args]
                if function.name.startswith("draw_") and arguments[:1] == ["path"]:
                    drawing.add((file.name, function.name))
                if any(ast.unparse(d) == replaced_if_undrawable.__name__ for d in function.decorator_list):
                    replaced.add((file.name, function.name))
    assert len(drawing) > 15
    assert drawing == replaced


def test_a_picture_of_a_page_that_fails_is_replaced_by_its_reason() -> None:
    figure, axes = new_figure(4.0, 3.0, 1)
    save_figure(figure, None, "", np.array(axes))
    figure.text(0.5, 0.5, "$x^$")  # mathematics after the names were made text
    with pytest.warns(PictureWarning, match="report, picture `Temperatures`"):
        url = Picture(figure, "Temperatures").data_url
    assert b"This picture could not be drawn" in b64decode(url.partition(",")[2])


@pytest.mark.thorough
@pytest.mark.sample(1)
@pytest.mark.parametrize("name", ["$$", r"a$\\frac{$b", "[/red]"])
def test_a_record_with_such_names_is_predicted(
    tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copytree(TILE, "record")
    text = Path("record/record.toml").read_text()
    text = text.replace("Tile, every key in use", name).replace('name = "surface"', f'name = "{name}"')
    Path("record/record.toml").write_text(text)
    assert main(["predict", "record", "--out", "out"]) == 0, capsys.readouterr().err
    assert Path("out/prediction.png").is_file()
    assert Path("out/summary.json").is_file()


def test_points_beyond_the_axes_are_marked_within_their_width():
    figure, axes = new_figure(6.0, 3.0, 1)
    time_s = np.linspace(-500.0, 10.0, 200)
    axes[0].plot(time_s, 3.0 * np.sin(time_s))
    axes[0].set_ylim(-1.0, 1.0)
    mark_beyond(axes[0], time_s, 3.0 * np.sin(time_s), "tab:red")
    axes[0].set_xlim(0.0, 10.0)
    save_figure(figure, None, "", axes)  # a warning of the layout is an error here
    assert axes[0].get_position().width > 0.7
    above, below = axes[0].lines[1:]
    assert np.all(above.get_ydata() == 1.0)
    assert np.all(below.get_ydata() == -1.0)
