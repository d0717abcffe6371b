"""Dispersions with the smooth error of the heating: as large as the band of a run has it, and as a study states it."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from sim_heating import cli
from sim_heating.estimation.fit import estimate
from sim_heating.estimation.report.estimate_file import write_estimate
from sim_heating.estimation.report.report import estimate_contents
from sim_heating.inputs.record import load_record
from sim_heating.planning.bands import with_bands
from sim_heating.planning.dispersion.entry import AXES, BATCH, RANDOM, Batch, DispersedEntry
from sim_heating.planning.dispersion.results import first_order
from sim_heating.planning.study import load_study
from sim_heating.simulation.run import run
from tests.support.paths import SCENARIOS
from tests.support.studies import pod_dispersion

pytest.importorskip("pyarrow", reason="dispersions need pyarrow: pip install 'sim-heating[plan]'")

P06 = SCENARIOS / "records" / "practice" / "p06"
POINTS = ("V07T9975", "WING_LE")
FLIGHTS = 512
STUDY = pod_dispersion("The error of the heating alone", FLIGHTS, 'sampling = "random"\n')
ERROR = "model_error = true\n"


def study_with(tmp_path: Path, more: str = ERROR) -> Path:
    (tmp_path / "study.toml").write_text(STUDY + more)
    return tmp_path / "study.toml"


def entry_with(tmp_path: Path, more: str = ERROR) -> DispersedEntry:
    return DispersedEntry(load_study(study_with(tmp_path, more)))


def flown(entry: DispersedEntry, design: str, count: int) -> dict[str, np.ndarray]:
    parts = [entry.fly(Batch(design, k, min(k + BATCH, count))) for k in range(0, count, BATCH)]
    return {name: np.concatenate([p[name] for p in parts]) for name in parts[0]}


@pytest.mark.thorough
def test_peaks_scatter_as_the_band_of_a_run_has_the_error_of_its_model(tmp_path: Path) -> None:
    """By the error alone. N flights know a standard deviation to sqrt((kurtosis - 1)/4N) of it; a normal distribution
    whose standard deviation is itself half-normal has a kurtosis of 9, which makes sqrt(2/N), and three of these are
    allowed. To first order only steps and knots differ: the line between two knots leaves out up to a quarter of the
    variance at its middle, and the peak lies elsewhere between those of either march (3 % here)."""
    entry = entry_with(tmp_path)
    banded = with_bands(run(entry.study.base))
    peaks = flown(entry, RANDOM, FLIGHTS)
    slopes = first_order(entry, flown(entry, AXES, 2 * entry.dimensions + 1))
    for p, name in enumerate(POINTS):
        expected = banded.points[name].history.band.sources["model"]
        assert np.std(peaks[f"surface_K.{name}"]) == pytest.approx(expected, rel=3.0 * np.sqrt(2.0 / FLIGHTS))
        assert slopes.sigma[0, p] == pytest.approx(expected, rel=0.05)


@pytest.mark.thorough
def test_errors_of_two_control_points_are_independent(tmp_path: Path) -> None:
    """The correlation of N independent pairs is below 3/sqrt(N)."""
    peaks = flown(entry_with(tmp_path), RANDOM, 256)
    own, other = (peaks[f"surface_K.{name}"] for name in POINTS)
    assert abs(np.corrcoef(own, other)[0, 1]) < 3.0 / np.sqrt(256)


@pytest.mark.thorough
def test_flights_of_an_estimate_have_the_size_that_its_own_flights_say(tmp_path: Path) -> None:
    """p06 was made without an error: its readings say that the 10 % which it states are far too much."""
    record = shutil.copytree(P06, tmp_path / "p06")
    stated = (record / "record.toml").read_text()
    (record / "record.toml").write_text(stated + "\n[heating.uncertainty]\nrelative = 0.1\n")
    fitted = estimate_contents(estimate(load_record(record), ["ratio.scale", "ratio.d_alpha"]))
    moved = {"control_point": POINTS[0], "records": [str(record)], "inputs": {}}
    write_estimate(tmp_path / "fit.json", fitted.model_copy(update=moved))
    entry = entry_with(tmp_path, ERROR + '[[dispersion.member]]\nestimate = "fit.json"\n')
    known = entry.members.each[0].member.considered.size
    rows = entry.rows(Batch(RANDOM, 0, FLIGHTS))
    of_estimate, of_prior = (
        np.sqrt(np.mean(error.sigma(rows[:, columns]) ** 2))
        for error, columns in zip(entry.errors[0], entry.columns.errors, strict=True)
    )
    assert of_estimate == pytest.approx(known.rms, rel=0.2)
    assert of_prior == pytest.approx(0.05, rel=0.1)
    assert of_estimate < 0.5 * of_prior


@pytest.mark.thorough
def test_study_json_page_and_flights_state_the_error(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    pq = pytest.importorskip("pyarrow.parquet")
    text = STUDY.replace(f"flights = {FLIGHTS}", "flights = 64\nindex_flights = 16") + ERROR
    study, out = tmp_path / "study.toml", tmp_path / "out"
    study.write_text(text)
    assert cli.main(["plan", str(study), "--workers", "1", "--out", str(out)]) == 0
    dispersion = json.loads((out / "study.json").read_text())["dispersion"]
    assert set(dispersion["model_error"]) == set(POINTS)
    assert dispersion["inputs"] == {"model error": "model error, smooth in time, as bands have it"}
    surface = dispersion["peaks"][0]
    assert surface["sobol_indices"]["model error"]["total_bounds"][1] > 0.5
    assert surface["first_order"]["variance_share"] == {"model error": pytest.approx(1.0)}
    assert "the smooth error that bands have" in (out / "report.html").read_text()
    assert "the smooth error that bands have" in capsys.readouterr().out
    sizes = pq.read_table(out / "dispersion_flights.parquet").column("model_error.WING_LE").to_numpy()
    assert np.sqrt(np.mean(sizes**2)) == pytest.approx(dispersion["model_error"]["WING_LE"])


def test_a_study_without_the_error_is_the_study_that_it_was(tmp_path: Path) -> None:
    """Its hash, and so every figure and the names of its batches, is that from before the key was there."""
    silent, declined = (load_study(study_with(tmp_path, more)) for more in ("", "model_error = false\n"))
    assert "model_error" not in silent.declared.model_dump_json()
    assert silent.hash == declined.hash
    assert load_study(study_with(tmp_path)).hash != silent.hash
