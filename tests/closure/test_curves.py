"""What a residual follows, as a curve with its band: in the right variable, with the shape of what was put in."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from sim_heating.base.files import read_csv_columns
from sim_heating.closure.curves import curve_of, curve_trials, curve_words, write_curve
from sim_heating.closure.search.trials.trial_fit import base_trial, declared_fit, fitted_effects
from sim_heating.heating.effects import use
from sim_heating.heating.effects.curve import TIME, VALUES
from sim_heating.inputs.record import load_record
from tests.closure.test_close_loop import simulated_record
from tests.support.paths import PRACTICE

ONSET_DEG, RISE = 41.0, 0.03
HEIGHTS = RISE * np.maximum(np.linspace(38.0, 44.0, 7) - ONSET_DEG, 0.0)
BENT = use("curve", {"variable": 0.0, "low": 38.0, "high": 44.0} | dict(zip(VALUES, HEIGHTS.tolist(), strict=True)))


@pytest.mark.thorough
def test_a_rise_above_an_angle_of_attack_is_a_curve_in_it_with_its_shape(tmp_path: Path) -> None:
    """A factor 1 + 0.03 (alpha - 41 deg) above 41 deg, by a curve of other knots; derivatives of the table are free."""
    record = simulated_record(load_record(PRACTICE / "p06"), [BENT])
    base = base_trial(declared_fit(record))
    first, *others = curve_trials(base)
    band = curve_of(first)
    assert band.variable == "alpha_deg"
    assert first.excess_chi2 < 0.2 * base.excess_chi2  # knots that lie elsewhere leave a little
    assert all(t.excess_chi2 > 2.0 * max(first.excess_chi2, 0.01) for t in others)
    line = np.polyfit(band.at[band.at < ONSET_DEG - 4.0], band.value[band.at < ONSET_DEG - 4.0], 1)
    i = int(np.argmin(np.abs(band.at - 43.5)))
    bend = band.value[i] - np.polyval(line, band.at[i])
    assert bend == pytest.approx(RISE * 2.5, abs=3.0 * band.sigma[i])
    assert bend > 3.0 * band.sigma[i]
    write_curve(tmp_path / "curve.csv", band)
    written = read_csv_columns(tmp_path / "curve.csv", ("alpha_deg", "relative_change", "sigma"))
    np.testing.assert_allclose(written["relative_change"], band.value, rtol=1e-12)
    assert "the heating departs with angle of attack: " in curve_words(band)


@pytest.mark.thorough
def test_time_is_the_last_variable_where_nothing_departs() -> None:
    base = base_trial(declared_fit(load_record(PRACTICE / "p06")))
    trials = curve_trials(base)
    numbers = [fitted_effects(t)[-1].values[0] for t in trials]
    assert numbers[0] != TIME
    assert all(t.score > 0.0 for t in trials)  # no curve is worth its seven parameters
