"""One figure of the paper with its data, and its files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from numpy.typing import ArrayLike

from sim_heating.base.files import write_csv
from sim_heating.base.files.text import write_bytes_atomic
from sim_heating.base.report.figure import DPI, picture_file, replaced_if_undrawable, save_figure

PAD_INCH = 0.1
"""Empty rim about the axes: at another resolution texts are a little wider."""


@dataclass(frozen=True)
class Statement:
    """A statement of the paper that a figure shows, and whether these flights show it.

    number   : in docs/evidence/founding_paper.md;  paper : what the paper says, in words of this project
    here     : what these flights give;  observed : whether they agree
    """

    number: int
    paper: str
    here: str
    observed: bool

    def __post_init__(self) -> None:
        object.__setattr__(self, "observed", bool(self.observed))  # a comparison of arrays gives numpy's own

    @property
    def verdict(self) -> str:
        """`observed` or `not observed`."""
        return "observed" if self.observed else "not observed"


@dataclass(frozen=True, eq=False)
class PaperFigure:
    """One figure of the paper, or of what its text says without a figure.

    number : of the paper, above 16 of the text;  title : what is shown, without the number
    figure : drawn, not saved
    tables : part of a file's name -> columns of a CSV; the part is empty where one file holds all
    notes  : what was found, one line each;  statements : of the paper that it shows
    """

    number: int
    title: str
    figure: Figure
    tables: Mapping[str, Mapping[str, ArrayLike]]
    notes: tuple[str, ...] = ()
    statements: tuple[Statement, ...] = ()

    @property
    def stem(self) -> str:
        """Name of its files without their ends, `figure_08`."""
        return f"figure_{self.number:02d}"

    @property
    def files(self) -> list[str]:
        """Names of its files, the picture first."""
        return [f"{self.stem}.png", *(self._csv(suffix) for suffix in self.tables)]

    def _csv(self, suffix: str) -> str:
        return f"{self.stem}_{suffix}.csv" if suffix else f"{self.stem}.csv"

    def write(self, folder: Path) -> None:
        """Write the picture and its data into a folder."""
        draw_paper_figure(folder / f"{self.stem}.png", self.figure)
        for suffix, columns in self.tables.items():
            header = {"figure": self.number, "title": self.title}
            write_csv(folder / self._csv(suffix), columns, ".8g", header)


@replaced_if_undrawable
def draw_paper_figure(path: Path, figure: Figure) -> None:
    """Draw a figure that is laid out."""
    write_bytes_atomic(path, picture_file(figure, "png", dpi=DPI))


def finished(
    number: int,
    title: str,
    drawn: tuple[Figure, np.ndarray],
    tables: Mapping[str, Mapping[str, Any]],
    notes: tuple[str, ...] = (),
    statements: tuple[Statement, ...] = (),
) -> PaperFigure:
    """A figure with grid and title, laid out.

    drawn : figure and axes
    """
    figure, axes = drawn
    engine = figure.get_layout_engine()
    if isinstance(engine, ConstrainedLayoutEngine):
        engine.set(w_pad=PAD_INCH, h_pad=PAD_INCH)
    save_figure(figure, None, f"Figure {number}: {title}", axes)
    return PaperFigure(number, title, figure, tables, notes, statements)
