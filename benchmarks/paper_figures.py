"""The founding paper's figures from the shipped flights: time of the whole command, and the pictures of the gallery.

The command runs twice, and the second time counts: the kernels are compiled then. The pictures are drawn again,
reduced, for docs/how_to/figures.md; what was found is saved with the times.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.measure import Figure, save, spent_by_children_s
from sim_heating.base.files.text import write_bytes_atomic
from sim_heating.base.report.figure import picture_file
from sim_heating.campaign.figures.paper import DRAWINGS, draw_figures

ROOT = Path(__file__).resolve().parent.parent
FLIGHTS = ("scenarios/sts2.toml", "scenarios/sts4.toml", "scenarios/sts5.toml", "scenarios/records/tunnel_plate")
IMAGES = ROOT / "docs" / "images"
REDUCED_DPI = 80
"""Resolution of the pictures of the gallery, three quarters of the command's."""
LONGEST_S = 180.0


def run() -> list[Figure]:
    """Time the command, and draw the gallery."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "sim_heating", "figures", *FLIGHTS, "--out", folder]
        for _ in range(2):
            start, before = time.perf_counter(), spent_by_children_s()
            subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
            seconds, processor_s = time.perf_counter() - start, spent_by_children_s() - before
    found = draw_figures([ROOT / s for s in FLIGHTS])
    for figure in found.drawn:
        picture = picture_file(figure.figure, "png", dpi=REDUCED_DPI)
        write_bytes_atomic(IMAGES / f"paper_{figure.stem}.png", picture)
    figures = [
        Figure("sim-heating figures, three flights and a tunnel run, warm", seconds, "s", target=LONGEST_S),
        Figure("its processor time", processor_s, "s"),
        Figure("figures drawn", len(found.drawn), "", target=len(DRAWINGS), at_least=True),
        Figure(
            "statements of the paper that the flights show",
            sum(s.observed for _, s in found.statements),
            "",
            note=f"of {len(found.statements)}",
        ),
    ]
    save("paper_figures", figures, {"found": found.summary()})
    return figures
