"""95 % bands: mixtures of members, an estimate in place of priors, readings of a record inside, margins at the band."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from sim_heating import cli
from sim_heating.inputs.record import load_record
from sim_heating.planning.bands import Spread, mixture_quantile, predict_with_band
from tests.support.paths import SCENARIOS

P06 = SCENARIOS / "records" / "practice" / "p06"


def of_normal(mean, sigma):
    return Spread(np.array([[mean]]), np.array([[sigma]]), {})


def test_one_member_has_the_quantile_of_its_normal_distribution():
    assert mixture_quantile([of_normal(700.0, 10.0)], [2.0], 0.975)[0, 0] == pytest.approx(719.59964, abs=1e-4)


def test_two_members_share_the_probability_by_their_weights():
    """Far apart, so that 3/4 and 1/4 of the probability lie about each: the 0.95 quantile is the upper one's 0.8."""
    pair = [of_normal(700.0, 1.0), of_normal(900.0, 10.0)]
    assert mixture_quantile(pair, [3.0, 1.0], 0.95)[0, 0] == pytest.approx(900.0 + 0.8416212 * 10.0, abs=1e-3)


def test_a_band_holds_the_readings_of_a_record_and_adds_in_squares():
    predicted = predict_with_band(load_record(P06))
    band = predicted.history.band
    assert predicted.within_band > 0.9
    half = 0.5 * (band.high_K - band.low_K)[0]
    hottest = int(np.nanargmax(predicted.history.surface_K))
    assert half[hottest] == pytest.approx(1.959964 * np.sqrt(sum(s**2 for s in band.sources.values())), rel=0.02)
    assert np.all(half >= 0.0)


@pytest.mark.thorough
def test_a_run_states_margins_at_the_band(tmp_path: Path):
    xarray = pytest.importorskip("xarray")
    out = tmp_path / "out"
    scenario = SCENARIOS / "recorded_sts107.toml"
    assert cli.main(["run", str(scenario), "--bands", "--out", str(out)]) == 0
    found = json.loads((out / "summary.json").read_text())["control_points"]
    with xarray.open_dataset(out / "flight.nc") as flown:
        for name, point in found.items():
            high = float(flown["surface_high_K"].sel(control_point=name).max())
            assert point["band"]["peak_surface_high_K"] == pytest.approx(high)
            assert point["band"]["surface_margin_at_band_K"] < point["surface_margin_K"]
            assert point["band"]["sources_K"]["model"] > 0.0


def test_a_member_without_bands_is_refused_in_one_line(tmp_path: Path, capsys):
    assert cli.main(["predict", str(P06), "--member", "estimate.json", "1", "--out", str(tmp_path / "out")]) == 2
    errors = [line for line in capsys.readouterr().err.splitlines() if line.startswith("error:")]
    assert errors == ["error: --member: is for --bands; add that option"]
