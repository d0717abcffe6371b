"""`update-tables`: the ratio estimated from a flight is written into the table, and can be reverted."""

from __future__ import annotations

import json
import os
import re
import shutil
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import RATIO_VARIABLES
from sim_heating.base.errors import InputError
from sim_heating.base.files import check, read_json, with_digest
from sim_heating.base.parameters import MODEL
from sim_heating.cli import main
from sim_heating.closure.revise.evidence import FlightEvidence, flight_evidence
from sim_heating.closure.revise.report import draw_update
from sim_heating.closure.revise.revisions import revert
from sim_heating.closure.revise.update import TableUpdate, prepare_update, write_update
from sim_heating.estimation.report.estimate_file import Estimate, correlations, read_estimate, write_estimate
from sim_heating.heating.ratio.table import read_ratio_table, write_ratio_table
from sim_heating.inputs.points import point_of_record, reference_of_record
from sim_heating.inputs.ratio_sources import write_tables
from sim_heating.inputs.record import Record, load_record, record_digest
from sim_heating.inputs.scenario import load_scenario
from sim_heating.inputs.vehicle import load_vehicle
from sim_heating.simulation.predict import predict
from sim_heating.simulation.synthesize import synthesize, write_records
from tests.support.gliding import gliding
from tests.support.json_output import run_json
from tests.support.once import made_once
from tests.support.paths import ROOT

POINT = "V09T9527"
TRUTH = {"ratio.scale": -0.2, "ratio.d_alpha": 0.001}


def popu_in_a_glide(altitude_m: float, velocity_m_s: float, sweep_deg: float) -> str:
    """Text of a scenario whose truth differs from the tables; more tables may be added to it."""
    flight = gliding(160.0, POINT, altitude_m=altitude_m, velocity_m_s=velocity_m_s, vehicle="orbiter")
    parameters = ", ".join(f'"{name}" = {value}' for name, value in TRUTH.items())
    return f"""{flight}[[trajectory.manoeuvre]]
kind = "popu"
at_time_s = 90.0
down_deg = {sweep_deg}
up_deg = {sweep_deg}
[truth]
parameters = {{ {parameters} }}
"""


def one_point_orbiter(home: Path) -> Path:
    """The Orbiter with one control point, laminar and fully catalytic: without declared effects."""
    source = ROOT / "aircraft_data" / "orbiter"
    for name in ("vehicle.toml", f"control_points/{POINT}.toml", f"ratio_tables/{POINT}.csv"):
        (home / "orbiter" / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(source / name, home / "orbiter" / name)
    shutil.copytree(source / "materials", home / "orbiter" / "materials")
    for name in ("aero", "guidance.toml"):
        place = source / name
        (shutil.copytree if place.is_dir() else shutil.copy)(place, home / "orbiter" / name)
    vehicle, point = home / "orbiter" / "vehicle.toml", home / "orbiter" / "control_points" / f"{POINT}.toml"
    vehicle.write_text(vehicle.read_text().partition("\n[transition]")[0] + "\n")
    point.write_text(re.sub(r"ratio_table_turbulent = .*\n", "", point.read_text()))
    return home / "orbiter"


@pytest.fixture(scope="session")
def flown_records(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the vehicle, two flights of it whose truth differs from its tables, and the estimate of each."""
    return made_once(tmp_path_factory, "two_flights", fly_twice)


def fly_twice(home: Path) -> None:
    """Fill the folder `flown_records`."""
    one_point_orbiter(home)
    for name, flight in (
        ("first", {"altitude_m": 74000.0, "velocity_m_s": 6800.0, "sweep_deg": 5.0}),
        ("second", {"altitude_m": 70000.0, "velocity_m_s": 6000.0, "sweep_deg": 3.0}),
    ):
        (home / f"{name}.toml").write_text(popu_in_a_glide(**flight))
        scenario = load_scenario(home / f"{name}.toml")
        write_records(scenario, synthesize(scenario), home / name)
        write_estimate(home / f"{name}.json", least_squares(load_record(home / name), tuple(TRUTH)))


def least_squares(record: Record, names: tuple[str, ...]) -> Estimate:
    """Least squares on the outermost thermocouple by differences: an estimate independent of the estimator."""

    def residual(theta: FloatArray) -> FloatArray:
        model = point_of_record(record, dict(zip(names, theta.tolist(), strict=True)))
        return predict(record, model).residual_K[0]

    theta, step = np.zeros(len(names)), np.array([1e-3 if MODEL[n].unit == "1" else 1e-5 for n in names])
    for _ in range(4):
        start = residual(theta)
        slopes = np.stack([(residual(theta + h) - start) / h[i] for i, h in enumerate(np.diag(step))], axis=1)
        theta -= np.linalg.lstsq(slopes, start, rcond=None)[0]
    noise = record.noise_floor_K()
    return estimate_of(record, dict(zip(names, theta, strict=True)), noise**2 * np.linalg.inv(slopes.T @ slopes))


def estimate_of(record: Record, values: Mapping[str, float], covariance: FloatArray, **more: Any) -> Estimate:
    """An estimate with these values."""
    names, sigma = tuple(values), np.sqrt(np.diag(covariance))
    data = {
        "format": "estimate/1",
        "records": [record.name],
        "converged": True,
        "iterations": 4,
        "reference_condition": dict(zip(RATIO_VARIABLES, reference_of_record(record), strict=True)),
        "parameters": {
            n: {"value": float(v), "sigma": float(s), "unit": MODEL[n].unit}
            for (n, v), s in zip(values.items(), sigma, strict=True)
        },
        "correlation": correlations(names, covariance),
        "inputs": {record.name: record_digest(record)},
    }
    return check(data | more, Estimate, "estimate")


def edit(path: Path, change: Callable[[str], str]) -> None:
    text = path.read_text()
    assert change(text) != text
    path.write_text(change(text))


def table_of(vehicle: Path) -> Path:
    return vehicle / "ratio_tables" / f"{POINT}.csv"


def update_and_write(fit: str = "first.json", vehicle: str = "orbiter") -> TableUpdate:
    update = prepare_update(fit, Path(vehicle).resolve())
    write_update(update, None, {}, draw_update)
    return update


def contents(folder: Path) -> dict[str, bytes]:
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


# From a flight to better predictions ---------------------------------------------------------------------------------


@pytest.mark.thorough
def test_a_revised_table_predicts_the_fitted_and_another_manoeuvre(
    workdir: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["update-tables", "first.json", "--vehicle", "./orbiter", "--check", "second"]
    assert main(arguments) == 0
    made = read_json(workdir / "orbiter" / "ratio_revisions" / POINT / "revision_2.json")
    floor = load_record(workdir / "first").noise_floor_K()
    fit = {name: parts["fit"] for name, parts in made["errors_K"].items()}
    assert fit["first"]["before"]["rmse_K"] > 10.0 * floor
    assert fit["first"]["after"]["rmse_K"] < 1.5 * floor
    assert fit["second"]["after"]["rmse_K"] < 0.2 * fit["second"]["before"]["rmse_K"]
    lines = capsys.readouterr().out
    assert "revision 1 to 2" in lines
    assert "ratio.d_alpha" in lines

    assert main(["predict", "first", "--vehicle", "./orbiter", "--out", "after"]) == 0
    assert read_json(workdir / "after" / "summary.json")["fit"] == pytest.approx(fit["first"]["after"])


@pytest.mark.thorough
def test_later_flights_declare_the_revised_table(workdir: Path) -> None:
    update_and_write()
    assert main(["synthesize", "first.toml", "--out", "third"]) == 0
    np.testing.assert_array_equal(
        read_ratio_table(workdir / "third" / "ratio_table.csv").ratio,
        read_ratio_table(table_of(workdir / "orbiter")).ratio,
    )


def test_the_true_ratio_lies_within_the_bounds_of_the_revised_table(workdir: Path) -> None:
    update = prepare_update("first.json", "./orbiter")
    views = {name: row for name, *row in update.parameter_comparison()}
    for name, true in TRUTH.items():
        _, _, before, wide, after, narrow = views[name]
        assert before == pytest.approx(0.0, abs=1e-12)
        assert narrow < 0.2 * wide
        assert abs(after - TRUTH[name]) < 4.0 * narrow, (after, true)


def test_an_estimate_that_makes_a_ratio_negative_revises_nothing(
    workdir: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Such a table could be read by no command afterwards, not even by the one that puts it back."""
    record, known = load_record(workdir / "first"), read_estimate("first.json")
    values = {"ratio.scale": -0.2, "ratio.d_alpha": 0.03}
    write_estimate("steep.json", estimate_of(record, values, known.covariance(tuple(TRUTH))))
    before = contents(workdir)
    assert main(["update-tables", "steep.json", "--vehicle", "./orbiter"]) == 2
    assert contents(workdir) == before
    (line,) = capsys.readouterr().err.splitlines()
    assert "steep.json: makes the ratio -0.0794 at alpha_deg 35, beta_deg 0, log10_re 6.075 of orbiter/ratio" in line
    assert "Nothing was written; estimate it again" in line


def test_a_revision_edited_to_a_negative_ratio_is_named_by_its_row(
    workdir: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    update_and_write()
    table = table_of(workdir / "orbiter")
    rows = table.read_text().splitlines()
    k = next(i for i, row in enumerate(rows) if row.startswith("40,0,6.075,"))
    rows[k] = re.sub(r"^((?:[^,]*,){5})", r"\g<1>-", rows[k])
    table.write_text("\n".join(rows) + "\n")
    for command in (["validate", "./orbiter"], ["update-tables", "second.json", "--vehicle", "./orbiter"]):
        before = contents(workdir)
        assert main(command) == 2
        assert contents(workdir) == before
        assert re.search(
            rf"orbiter/ratio_tables/{POINT}.csv, row {k + 1}, column ratio: -0\.\d+ is not .* check the sign",
            capsys.readouterr().err,
        )


# Evidence of the estimate on the nodes --------------------------------------------------------------------------------


def _parameters_of(ratio: FloatArray, flight: FlightEvidence) -> FloatArray:
    """(k,) parameters of the linear model by a table, H n less what they are for a ratio of 0."""
    return flight.evidence.H @ ratio.ravel()[flight.evidence.nodes] - flight.at_zero


def test_the_evidence_recovers_parameters_by_which_a_table_differs(workdir: Path) -> None:
    record, vehicle = load_record(workdir / "first"), load_vehicle("./orbiter")
    values = {"ratio.scale": -0.07, "ratio.d_alpha": 0.0004, "ratio.d_logre": 0.01}
    estimate = estimate_of(record, values, np.diag([1e-4, 1e-8, 1e-4]))
    point, about = vehicle.control_point(POINT), estimate.reference_condition
    alpha, _, log10_re, _, _ = np.meshgrid(*point.ratio.axes, indexing="ij")
    other_ratio = 0.93 * point.ratio.ratio + 0.0004 * (alpha - about.alpha_deg) + 0.01 * (log10_re - about.log10_re)
    other = replace(point, ratio=replace(point.ratio, ratio=other_ratio))
    flight = flight_evidence(estimate, [record], vehicle, other)
    np.testing.assert_allclose(_parameters_of(other_ratio, flight), list(values.values()), rtol=1e-8)


def test_the_evidence_recovers_a_product_term_by_which_a_table_differs(workdir: Path) -> None:
    record, vehicle = load_record(workdir / "first"), load_vehicle("./orbiter")
    values = {"ratio.scale": 0.1, "ratio.d_alpha": 0.0, "ratio.d_logre": 0.0, "ratio.d_alpha_logre": 0.002}
    estimate = estimate_of(record, values, np.diag([1e-4, 1e-8, 1e-4, 1e-6]))
    point, about = vehicle.control_point(POINT), estimate.reference_condition
    alpha, _, log10_re, _, _ = np.meshgrid(*point.ratio.axes, indexing="ij")
    other_ratio = 1.1 * point.ratio.ratio + 0.002 * (alpha - about.alpha_deg) * (log10_re - about.log10_re)
    other = replace(point, ratio=replace(point.ratio, ratio=other_ratio))
    flight = flight_evidence(estimate, [record], vehicle, other)
    recovered = _parameters_of(other_ratio, flight)
    np.testing.assert_allclose(recovered, list(values.values()), rtol=1e-6, atol=1e-9)


def test_more_samples_of_the_same_path_add_no_information(workdir: Path) -> None:
    one = prepare_update("first.json", "./orbiter")
    edit(workdir / "first" / "thermocouples.csv", lambda t: "\n".join(_every_second(t.splitlines())) + "\n")
    with_values(inputs={"first": record_digest(load_record("first"))})()
    other = prepare_update("first.json", "./orbiter")
    assert len(other.flight.path.x) < 0.6 * len(one.flight.path.x)
    np.testing.assert_allclose(other.laminar.after.sigma, one.laminar.after.sigma, rtol=0.02)


def _every_second(lines: list[str]) -> list[str]:
    return [lines[0], *lines[1::2]]


def test_an_estimate_relative_to_another_declared_table_gives_the_same_ratio(workdir: Path) -> None:
    one = prepare_update("first.json", "./orbiter")
    declared = read_ratio_table(workdir / "first" / "ratio_table.csv")
    write_ratio_table(workdir / "first" / "ratio_table.csv", replace(declared, ratio=1.25 * declared.ratio))
    first = read_estimate("first.json")
    smaller = np.diag([1.0 / 1.25, 1.0])
    scale, slope = first.values(tuple(TRUTH))
    values = {"ratio.scale": (1.0 + scale) / 1.25 - 1.0, "ratio.d_alpha": slope}
    C = smaller @ first.covariance(tuple(TRUTH)) @ smaller
    write_estimate("first.json", estimate_of(load_record("first"), values, C))
    other = prepare_update("first.json", "./orbiter")
    np.testing.assert_allclose(other.laminar.after.ratio, one.laminar.after.ratio, rtol=1e-9)
    np.testing.assert_allclose(other.laminar.after.sigma, one.laminar.after.sigma, rtol=1e-6)


def test_parameters_that_the_table_cannot_represent_are_reported_and_change_nothing(workdir: Path) -> None:
    record, known = load_record(workdir / "first"), read_estimate("first.json")
    C = np.zeros((4, 4))
    C[:2, :2], C[2:, 2:] = known.covariance(tuple(TRUTH)), np.diag([1e-8, 1e-4])
    updates = []
    for elevon, coating in ((0.3, 1.2), (-0.3, 0.9)):
        values = {**TRUTH, "ratio.d_elevon": elevon, "stack.coating.thickness_factor": coating}
        write_estimate("more.json", estimate_of(record, values, C))
        updates.append(prepare_update("more.json", "./orbiter"))
    assert set(updates[0].flight.not_written) == {"ratio.d_elevon", "stack.coating.thickness_factor"}
    assert updates[0].flight.evidence.names == tuple(TRUTH)
    np.testing.assert_array_equal(updates[0].table.ratio, updates[1].table.ratio)


def test_a_joint_estimate_of_several_points_updates_the_one_that_is_named(workdir: Path) -> None:
    alone = read_estimate("first.json")
    shutil.copytree("first", "elsewhere")
    edit(
        workdir / "elsewhere" / "record.toml", lambda t: t.replace(f'control_point = "{POINT}"', 'control_point = "B"')
    )
    both = alone.model_dump() | {
        "records": ["elsewhere", "first"],
        "inputs": alone.inputs | {"elsewhere": record_digest(load_record("elsewhere"))},
        "parameters": {
            f"{n}@{p}": q.model_dump() | {"value": q.value * (p == POINT)}
            for p in ("B", POINT)
            for n, q in alone.parameters.items()
        },
        "correlation": {
            "|".join(f"{n}@{p}" for n in pair.split("|")): rho
            for pair, rho in alone.correlation.items()
            for p in ("B", POINT)
        },
    }
    write_estimate("both.json", check(both, Estimate, "both"))
    with pytest.raises(InputError, match=f"is of B, {POINT}; name one of them with --point"):
        prepare_update("both.json", "./orbiter")
    one, other = prepare_update("first.json", "./orbiter"), prepare_update("both.json", "./orbiter", point_name=POINT)
    np.testing.assert_array_equal(one.table.ratio, other.table.ratio)
    assert [u.record for u in other.used] == ["first"]


@pytest.mark.thorough
def test_two_flights_give_the_same_table_in_either_order(workdir: Path) -> None:
    shutil.copytree("orbiter", "other/orbiter")
    for fit in ("first.json", "second.json"):
        update_and_write(fit)
    for fit in ("second.json", "first.json"):
        update_and_write(fit, "other/orbiter")
    one, other = (read_ratio_table(table_of(workdir / v)) for v in ("orbiter", "other/orbiter"))
    assert one.header["revision"] == other.header["revision"] == "3"
    np.testing.assert_allclose(one.ratio, other.ratio, rtol=2e-6)


# Revisions as files --------------------------------------------------------------------------------------------------


def test_a_revision_states_its_origin(workdir: Path) -> None:
    update = update_and_write()
    header = read_ratio_table(table_of(workdir / "orbiter")).header
    assert (header["revision"], header["parent_revision"], header["reference"]) == ("2", "1", "fay-riddell")
    assert "first 0 to 160 s" in header["revised_from"]
    assert header["recovery"] == "edge-laminar"  # a revision is reduced with what its parent was
    stated = update.estimate.parameters["ratio.scale"]
    assert f"ratio.scale {stated.value:.4g} +- {stated.sigma:.2g}" in header["revised_parameters"]
    assert stated.value == pytest.approx(-0.2, abs=3 * stated.sigma)
    made = read_json(workdir / "orbiter" / header["evidence"])
    assert made["parameters"]["ratio.scale"]["sigma"] == update.estimate.parameters["ratio.scale"].sigma
    assert made["records"][0]["inputs"].startswith("sha256:")
    assert len(made["changed"]["ratio_after"]) == np.count_nonzero(update.laminar.changed)
    assert main(["validate", "orbiter"]) == 0


def test_rows_of_nodes_that_did_not_change_keep_their_text(workdir: Path) -> None:
    before = table_of(workdir / "orbiter").read_text().splitlines()
    update = update_and_write()
    rows = [line for line in table_of(workdir / "orbiter").read_text().splitlines() if line[0].isdigit()]
    kept = [line for line in before if line[0].isdigit()]
    same = np.array([a == b for a, b in zip(kept, rows, strict=True)])
    np.testing.assert_array_equal(same, ~update.laminar.changed.ravel())
    assert 0 < np.count_nonzero(same) < len(same)


@pytest.mark.thorough
@pytest.mark.sample(1)
@pytest.mark.parametrize("line_end", ["\n", "\r\n"])
def test_reverting_twice_gives_back_the_vehicle_byte_for_byte(workdir: Path, line_end: str) -> None:
    table = table_of(workdir / "orbiter")
    table.write_bytes(table.read_text().replace("\n", line_end).encode())
    start = contents(workdir / "orbiter")
    update_and_write("first.json")
    between = contents(workdir / "orbiter")
    update_and_write("second.json")
    assert main(["update-tables", "--vehicle", "./orbiter", "--revert", POINT]) == 0
    assert contents(workdir / "orbiter") == between
    assert revert(Path("orbiter"), POINT) == (2, 1)
    assert contents(workdir / "orbiter") == start


@pytest.mark.thorough
@pytest.mark.parametrize("at", [f"{POINT}.csv", "revision_2.json"])
def test_an_update_interrupted_while_it_writes_leaves_the_vehicle_as_it_was(
    at: str, workdir: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before, real, interruptions = contents(workdir / "orbiter"), os.replace, [at]

    def interrupted(old: Any, new: Any) -> None:
        if Path(new).name in interruptions:
            interruptions.clear()
            raise KeyboardInterrupt
        real(old, new)

    update = prepare_update("first.json", "./orbiter")
    with monkeypatch.context() as patched:
        patched.setattr(os, "replace", interrupted)
        with pytest.raises(KeyboardInterrupt):
            write_update(update, None, {}, draw_update)
    assert contents(workdir / "orbiter") == before
    update_and_write()
    assert read_ratio_table(table_of(workdir / "orbiter")).header["revision"] == "2"


def test_what_a_closed_loop_only_resembles_is_written_when_it_is_accepted(workdir: Path) -> None:
    write_estimate("first.json", read_estimate("first.json").model_copy(update={"finding": "partly"}))
    with pytest.raises(InputError, match=r"its closed loop ends with `partly`.*--accept-partly"):
        prepare_update("first.json", "./orbiter")
    assert prepare_update("first.json", "./orbiter", accept_partly=True).changes


def test_a_dry_run_writes_nothing(workdir: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = contents(workdir)
    printed = run_json(capsys, "update-tables", "first.json", "--vehicle", "./orbiter", "--dry-run")
    assert (printed["files"], printed["results"]["revision"]) == ([], None)
    assert contents(workdir) == before


def test_out_revises_a_copy_and_leaves_the_vehicle_alone(workdir: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = contents(workdir / "orbiter")
    printed = run_json(capsys, "update-tables", "first.json", "--vehicle", "./orbiter", "--out", "mine")
    assert {Path(name).suffix for name in printed["files"]} == {".csv", ".json"}
    assert printed["results"]["control_point"] == POINT
    assert contents(workdir / "orbiter") == before
    assert read_ratio_table(table_of(workdir / "mine" / "orbiter")).header["revision"] == "2"
    assert [p.name for p in (workdir / "mine").iterdir()] == ["orbiter"]


def test_sources_do_not_overwrite_a_table_that_flight_data_revised(workdir: Path) -> None:
    source = ROOT / "aircraft_data" / "orbiter" / "ratio_sources"
    (workdir / "orbiter" / "ratio_sources").mkdir()
    shutil.copy(source / "windward.toml", workdir / "orbiter" / "ratio_sources" / "windward.toml")
    edit(
        workdir / "orbiter" / "ratio_sources" / "windward.toml",
        lambda t: re.sub(r"(?s)^control_points = \[.*?\]", f'control_points = ["{POINT}"]', t, flags=re.MULTILINE),
    )
    write_tables("./orbiter")
    update_and_write()
    after = table_of(workdir / "orbiter").read_bytes()
    with pytest.raises(InputError, match="is revision 2, from flight data"):
        write_tables("./orbiter")
    assert table_of(workdir / "orbiter").read_bytes() == after


# Refused, in one line ----------------------------------------------------------------------------------------


CONTROL_POINT = f"orbiter/control_points/{POINT}.toml"
TABLE = f"orbiter/ratio_tables/{POINT}.csv"
VEHICLE = "orbiter/vehicle.toml"
BETA = {"ratio.d_beta": {"value": 0.1, "sigma": 0.01, "unit": "1/deg"}}

WITH_PRIOR = {"ratio.scale": {"value": -0.1, "sigma": 0.01, "unit": "1", "prior_sigma": 0.2}}


def with_values(**changes: Any) -> Callable[[], None]:
    """An estimate with other contents, as if estimated so."""
    return lambda: edit(Path("first.json"), lambda text: json.dumps(with_digest(json.loads(text) | changes)))


def by_hand(**changes: Any) -> Callable[[], None]:
    """The estimate edited by a person."""
    return lambda: edit(Path("first.json"), lambda text: json.dumps(json.loads(text) | changes))


def without(key: str) -> Callable[[], None]:
    """The estimate with a key removed, as if written so."""

    def changed(text: str) -> str:
        kept = {k: v for k, v in json.loads(text).items() if k != key}
        return json.dumps(kept if key == "digest" else with_digest(kept))

    return lambda: edit(Path("first.json"), changed)


def in_file(name: str, old: str, new: str) -> Callable[[], None]:
    return lambda: edit(Path(name), lambda text: text.replace(old, new))


def without_sigma() -> None:
    write_ratio_table(TABLE, replace(read_ratio_table(TABLE), sigma=None))


def only_high_alpha() -> None:
    def is_kept(row: str) -> bool:
        return not row[0].isdigit() or float(row.split(",")[0]) >= 45.0

    edit(Path(TABLE), lambda text: "\n".join(filter(is_kept, text.splitlines())) + "\n")


def renamed_point() -> None:
    Path(CONTROL_POINT).rename("orbiter/control_points/V09T9999.toml")
    in_file("orbiter/control_points/V09T9999.toml", f'name = "{POINT}"\ntitle', 'name = "V09T9999"\ntitle')()


def over_another_sphere() -> None:
    in_file(VEHICLE, "fay-riddell", "sutton-graves")()
    in_file(TABLE, "fay-riddell", "sutton-graves")()


def edited_after_its_revision() -> None:
    update_and_write()
    in_file(TABLE, "confidence: C", "confidence: A")()


def earlier_revision_in_force() -> None:
    Path("orbiter/ratio_revisions").mkdir()
    shutil.copy(TABLE, "orbiter/ratio_revisions/old.csv")
    in_file(CONTROL_POINT, f"ratio_tables/{POINT}.csv", "ratio_revisions/old.csv")()


def shared_table() -> None:
    text = Path(CONTROL_POINT).read_text()
    own, _, rest = text.partition("[[sensor]]")
    limits = rest[rest.index("[limits]") :]
    Path("orbiter/control_points/TWIN.toml").write_text(own.replace(f'name = "{POINT}"', 'name = "TWIN"', 1) + limits)


NO_PAIR = "first.json, [correlation]: 1 of 1 pairs are missing, `ratio.scale|ratio.d_alpha` first"


def scale(**changes: float) -> Callable[[], None]:
    """The estimate with another ratio.scale."""

    def changed(text: str) -> str:
        found = json.loads(text)
        found["parameters"]["ratio.scale"] |= changes
        return json.dumps(with_digest(found))

    return lambda: edit(Path("first.json"), changed)


REFUSED: dict[str, tuple[Callable[[], object], str]] = {
    "not converged": (with_values(converged=False), "did not converge"),
    "estimated with a prior": (
        with_values(parameters=WITH_PRIOR, correlation={}),
        "ratio.scale was estimated with a prior",
    ),
    "no bound": (scale(sigma=0.0), "first.json, [parameters.ratio.scale]: `sigma`: 0 is not within 1e-12 to 1000"),
    "too wide a bound": (scale(sigma=1e308), "first.json, [parameters.ratio.scale]: `sigma`: 1e+308 is not within"),
    "no such value": (scale(value=1e308), "first.json, [parameters.ratio.scale]: `value`: 1e+308 is beyond 1000"),
    "no heating left": (scale(value=-1.2), "first.json, [parameters.ratio.scale]: `value`: -1.2 leaves no heating"),
    "no correlation": (with_values(correlation={}), NO_PAIR),
    "no such condition": (
        with_values(reference_condition=dict.fromkeys(RATIO_VARIABLES, 0.0) | {"alpha_deg": 1e308}),
        "first.json, [reference_condition]: `alpha_deg`: 1e+308 is not an angle of attack in degrees (-180 to 180)",
    ),
    "edited by hand": (by_hand(iterations=5), "first.json: was changed after it was written"),
    "of an earlier version": (without("digest"), "first.json: has no `digest`"),
    "without the hashes of its records": (without("inputs"), "first.json: `inputs` has no entry for its record first"),
    "about a condition that was not flown": (
        with_values(excursions={"alpha_deg": {"min": 50.0, "max": 55.0}}),
        "lies outside the 50 to 55 that were flown; estimate again with a --reference within them",
    ),
    "one parameter twice": (
        with_values(correlation={"ratio.scale|ratio.d_alpha": 1.0}),
        "[correlation]: is not positive definite (a combination of ratio.scale and ratio.d_alpha",
    ),
    "no ratio parameter": (with_values(parameters={}, correlation={}), "no ratio parameter"),
    "cut off": (lambda: edit(Path("first.json"), lambda text: text[:300]), "cut off"),
    "no such record": (with_values(records=["fitrs"]), "its record `fitrs` does not exist"),
    "several points": (with_values(control_point="LOWER_AFT"), "the estimate is of LOWER_AFT, not of V09T9527"),
    "record changed since": (with_values(inputs={"first": "sha256:0"}), "was changed since the estimate"),
    "segments without samples": (with_values(segments=[[[900.0, 950.0]]]), "no sample lies in the segments"),
    "a variable that did not move": (with_values(parameters=BETA, correlation={}), "cannot distinguish ratio.d_beta"),
    "vehicle without the point": (renamed_point, "no control point `V09T9527`; did you mean `V09T9999`"),
    "other reference by name": (over_another_sphere, "over `fay-riddell`, the tables of orbiter over `sutton-graves`"),
    "other reference by value": (in_file(VEHICLE, "= 0.3048", "= 0.5"), "its h_ref_kg_m2_s is 28"),
    "other wall enthalpy": (in_file(VEHICLE, '"equilibrium-air"', "{ cp_J_kgK = 1004.5 }"), "cp = 1004.5"),
    "table without sigma": (without_sigma, "has no sigma column"),
    "flown outside the table": (only_high_alpha, "alpha_deg lay outside its 45 to 50"),
    "revision that is no number": (in_file(TABLE, "revision: 1", "revision: A"), '"A" is not a whole number'),
    "the same flight again": (update_and_write, "is in revision 2 already"),
    "table edited after its revision": (edited_after_its_revision, "was changed after"),
    "earlier revision in force": (earlier_revision_in_force, "an earlier revision"),
    "table of two points": (shared_table, "is the table of TWIN too"),
}


@pytest.mark.sample(7)
@pytest.mark.parametrize("name", REFUSED)
def test_inconsistent_inputs_are_refused_in_one_line(
    name: str, workdir: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    damage, hint = REFUSED[name]
    damage()
    before = contents(workdir)
    assert main(["update-tables", "first.json", "--vehicle", "./orbiter"]) == 2
    lines = [line for line in capsys.readouterr().err.splitlines() if line.strip()]
    assert len(lines) == 1, lines
    assert hint in lines[0]
    assert contents(workdir) == before


@pytest.mark.parametrize(
    ("arguments", "hint"),
    [
        (["--vehicle", "./orbiter"], "give FIT"),
        (["first.json", "--vehicle", "./orbiter", "--revert", POINT], "takes no FIT"),
        (["--vehicle", "./orbiter", "--revert", POINT], "was not made from flight data"),
        (["--vehicle", "./orbiter", "--revert", "V09T9257"], "did you mean `V09T9527`"),
        (["first.json", "--vehicle", "orbitr"], "unknown vehicle; did you mean `orbiter`?"),
        (["first.json", "--vehicle", "orbiter"], "came with the package; name a folder for your copy with --out"),
        (["first.json", "--vehicle", "./orbiter", "--out", "."], "already contains orbiter"),
        (["first.json", "--vehicle", "./orbiter", "--record", "first", "--record", "second"], "name each in order"),
        (["first.json", "--vehicle", "./orbiter", "--check", "first"], "/first; leave one out, rename one"),
        (["nothing.json", "--vehicle", "./orbiter"], "no such file"),
        (["first.json", "--vehicle", "./orbiter", "--out", "first.toml/x"], "is a file; name a directory"),
    ],
    ids=lambda v: " ".join(v) if isinstance(v, list) else None,
)
def test_wrong_usage_is_reported_in_one_line(
    arguments: list[str], hint: str, workdir: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    if arguments[-1] == "orbiter":  # by name, from a folder without such a vehicle
        shutil.move("orbiter", "elsewhere")
    assert main(["update-tables", *arguments]) == 2
    lines = [line for line in capsys.readouterr().err.splitlines() if line.strip() and not line.endswith("...")]
    assert len(lines) == 1, lines
    assert hint in lines[0]
