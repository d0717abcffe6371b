"""A record states its heating ratio as a table or as a constant; without one nothing is predicted in silence."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from sim_heating.base.errors import InputError
from sim_heating.cli import cli
from sim_heating.inputs.record import load_record, write_record
from sim_heating.simulation.predict import predict
from tests.support.verification.surface import constant_ratio, declared_ratios


def test_a_constant_ratio_heats_as_its_balance_says():
    for row in declared_ratios():
        assert row.kept, row


def test_a_constant_ratio_is_kept_in_the_record(tmp_path: Path):
    record = constant_ratio(0.5)
    write_record(record, tmp_path / "plate")
    again = load_record(tmp_path / "plate")
    assert again.declared.heating.ratio == 0.5
    assert not again.lacks_ratio
    np.testing.assert_array_equal(predict(again).indicated_K, predict(record).indicated_K)


def test_a_reference_without_a_ratio_is_not_predicted(tmp_path: Path):
    with pytest.raises(InputError, match="--ratio, --ratio-table and --like"):
        predict(constant_ratio(None))
    write_record(constant_ratio(None), tmp_path / "plate")
    told = CliRunner().invoke(cli, ["predict", str(tmp_path / "plate"), "--out", str(tmp_path / "out")])
    assert isinstance(told.exception, InputError)
    assert "`ratio` is missing" in str(told.exception)


def test_a_ratio_is_a_constant_or_a_table(tmp_path: Path):
    write_record(constant_ratio(1.0), tmp_path / "plate")
    toml = tmp_path / "plate" / "record.toml"
    toml.write_text(toml.read_text().replace("ratio = 1.0", 'ratio = 1.0\nratio_table = "r.csv"'))
    with pytest.raises(InputError, match="is a constant in place of `ratio_table`"):
        load_record(tmp_path / "plate")


@pytest.mark.thorough
def test_estimate_and_close_loop_go_on_without_a_ratio(tmp_path: Path):
    record = constant_ratio(1.0)
    heated = predict(record).indicated_K[0] + np.random.default_rng(1).normal(0.0, 1.0, len(record.time_s))
    bare = constant_ratio(None)
    bare.thermocouples["T_K"][:] = heated
    write_record(bare, tmp_path / "plate")
    for command, file in (("estimate", "estimate.json"), ("close-loop", "closure.json")):
        out = tmp_path / command
        done = CliRunner().invoke(cli, [command, str(tmp_path / "plate"), "--out", str(out)])
        assert done.exit_code == 0, done.output
        assert '"predicted": null' in (out / file).read_text()
