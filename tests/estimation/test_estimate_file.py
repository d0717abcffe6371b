"""estimate.json: what is written reads back, and a damaged one is answered with the key and the value."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sim_heating.base.errors import InputError
from sim_heating.base.files import check
from sim_heating.estimation.report.estimate_file import Estimate, correlations, read_estimate, write_estimate
from sim_heating.inputs.record import load_record, record_digest
from tests.support.paths import TILE

NAMES = ("ratio.scale", "ratio.d_alpha", "stack.coating.thickness_factor")
COVARIANCE = np.array([[4e-4, -1e-6, 1e-5], [-1e-6, 1e-8, 0.0], [1e-5, 0.0, 9e-4]])

GOOD: dict[str, Any] = {
    "format": "estimate/1",
    "records": ["tile"],
    "converged": True,
    "iterations": 7,
    "reference_condition": {"alpha_deg": 40, "beta_deg": 0, "log10_re": 6.1, "elevon_deg": 1, "bodyflap_deg": 12},
    "parameters": {
        "ratio.scale": {"value": -0.1, "sigma": 0.02, "unit": "1"},
        "ratio.d_alpha": {"value": 0.001, "sigma": 0.0001, "unit": "1/deg"},
        "stack.coating.thickness_factor": {"value": 1.2, "sigma": 0.03, "unit": "1"},
    },
    "not_estimated": {"ratio.d_beta": "beta_deg is constant"},
    "correlation": correlations(NAMES, COVARIANCE),
    "noise_floor_K": 1.7,
    "fit": {"rmse_K": 1.8, "max_abs_K": 6.0, "n": 300},
    "holdout": None,
}


def good(**changes: Any) -> dict[str, Any]:
    return json.loads(json.dumps(GOOD)) | changes


def written(folder: Path, text: str) -> Path:
    (folder / "estimate.json").write_text(text)
    return folder / "estimate.json"


def test_an_estimate_reads_back_equal_from_its_file_or_its_directory(tmp_path: Path) -> None:
    estimate = check(good(control_point="TEST", segments=[[[0.0, 200.0]]], studied_by="hand"), Estimate, "here")
    write_estimate(tmp_path / "estimate.json", estimate)
    assert read_estimate(tmp_path / "estimate.json") == estimate
    assert read_estimate(tmp_path) == estimate
    assert json.loads((tmp_path / "estimate.json").read_text())["studied_by"] == "hand"


def test_an_estimate_is_shown_in_one_line_with_its_values() -> None:
    shown = repr(check(good(), Estimate, "here"))
    assert shown.startswith("Estimate(tile: ratio.scale=-0.1 +- 0.02 1, ratio.d_alpha=0.001 +- 0.0001 1/deg, ")
    assert shown.endswith("; converged)")


def test_sigma_and_correlation_give_back_the_covariance() -> None:
    estimate = check(good(), Estimate, "here")
    np.testing.assert_allclose(estimate.covariance(NAMES), COVARIANCE, rtol=1e-12)
    np.testing.assert_allclose(estimate.covariance(NAMES[::2]), COVARIANCE[::2, ::2], rtol=1e-12)


def test_a_pair_may_be_named_in_either_order() -> None:
    turned = {"|".join(reversed(k.split("|"))): v for k, v in GOOD["correlation"].items()}
    np.testing.assert_allclose(
        check(good(correlation=turned), Estimate, "here").covariance(NAMES), COVARIANCE, rtol=1e-12
    )


SIGMA = {"value": 0.1, "sigma": 0.02, "unit": "1"}
DAMAGED = {
    "empty": ("", "the file is empty"),
    "cut off": (json.dumps(GOOD)[:200], "cut off"),
    "not JSON": ("records = 3", "line 1: Expecting value"),
    "a list": ("[1, 2]", "must be an object"),
    "NaN": (json.dumps(GOOD).replace("-0.1", "NaN"), "contains NaN"),
    "another format": (json.dumps(good(format="estimate/9")), "not one of estimate/1"),
    "a closure report": (json.dumps(good(format="closure-report/1")), "is a closure report"),
    "no parameters": (json.dumps({k: v for k, v in GOOD.items() if k != "parameters"}), "`parameters` is missing"),
    "negative sigma": (json.dumps(good(parameters={"ratio.d0": SIGMA | {"sigma": -1.0}})), "must not be below 0"),
    "misspelt parameter": (json.dumps(good(parameters={"ratio.sclae": SIGMA})), "did you mean `ratio.scale`"),
    "wrong unit": (json.dumps(good(parameters={"ratio.d_alpha": SIGMA})), 'it is "1/deg"'),
    "correlation above 1": (json.dumps(good(correlation={"ratio.scale|ratio.d_alpha": 1.5})), "within -1 to 1"),
    "correlation of a stranger": (json.dumps(good(correlation={"ratio.scale|ratio.d0": 0.5})), "ratio.d0 is not among"),
    "correlation of one": (json.dumps(good(correlation={"ratio.scale": 0.5})), "is not a pair"),
    "impossible correlation": (
        json.dumps(good(correlation=dict(zip(GOOD["correlation"], (0.9, 0.9, -0.9), strict=True)))),
        "is not a correlation matrix",
    ),
    "segments of another record": (json.dumps(good(segments=[[], []])), "2 entries for 1 records"),
    "segment backwards": (json.dumps(good(segments=[[[5.0, 1.0]]])), "start before end"),
    "no record": (json.dumps(good(records=[])), "at least 1"),
}


@pytest.mark.parametrize("name", DAMAGED)
def test_a_damaged_estimate_is_refused_in_one_line(name: str, tmp_path: Path) -> None:
    text, hint = DAMAGED[name]
    with pytest.raises(InputError) as caught:
        read_estimate(written(tmp_path, text))
    assert hint in caught.value.problems[0]
    assert "estimate.json" in caught.value.problems[0]
    assert all("\n" not in line for line in caught.value.problems)


def test_an_estimate_that_was_changed_after_it_was_written_is_refused(tmp_path: Path) -> None:
    """Any entry, those that nothing reads included."""
    write_estimate(tmp_path / "estimate.json", check(good(studied_by="hand"), Estimate, "here"))
    whole = json.loads((tmp_path / "estimate.json").read_text())
    for key in whole:
        written(tmp_path, json.dumps({k: v for k, v in whole.items() if k != key}))
        with pytest.raises(InputError, match=r"was changed after it was written|is missing|has no `digest`|not among"):
            read_estimate(tmp_path)
    nearly = whole["parameters"]["ratio.scale"]["value"] + 1e-16
    whole["parameters"]["ratio.scale"]["value"] = nearly
    with pytest.raises(InputError, match=r"estimate\.json: was changed after it was written"):
        read_estimate(written(tmp_path, json.dumps(whole)))


def test_another_layout_of_the_file_is_the_same_estimate(tmp_path: Path) -> None:
    """Other order of keys, line ends, whole numbers without their decimal point, as other programs write them."""
    estimate = check(good(), Estimate, "here")
    write_estimate(tmp_path / "estimate.json", estimate)
    whole = json.loads((tmp_path / "estimate.json").read_text())
    whole["reference_condition"] = {k: int(v) if v == int(v) else v for k, v in whole["reference_condition"].items()}
    text = json.dumps(dict(reversed(whole.items())), indent=4).replace("\n", "\r\n")
    assert text != (tmp_path / "estimate.json").read_text()
    assert read_estimate(written(tmp_path, text)) == estimate


def test_an_estimate_without_a_digest_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"has no `digest`, .* estimate again"):
        read_estimate(written(tmp_path, json.dumps(good())))


def test_a_directory_without_an_estimate_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"estimate\.json: there is no such file"):
        read_estimate(tmp_path)


def test_the_hash_of_a_record_changes_with_any_of_its_files(tmp_path: Path) -> None:
    record = load_record(TILE)
    for name in ("record.toml", "conditions.csv", "thermocouples.csv", "ratio_table.csv"):
        (tmp_path / name).write_bytes((TILE / name).read_bytes())
    copy = load_record(tmp_path)
    assert record_digest(copy) == record_digest(record)
    (tmp_path / "ratio_table.csv").write_text((TILE / "ratio_table.csv").read_text() + "\n")
    assert record_digest(copy) != record_digest(record)
