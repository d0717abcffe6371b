"""Envelope expansion: trends of flights and trim, consistency of the tables' sigma, and the command."""

from __future__ import annotations

import shutil
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from sim_heating.base.conditions import Conditions
from sim_heating.base.errors import InputError
from sim_heating.base.files import files_written, read_csv_columns, read_json
from sim_heating.cli import main
from sim_heating.heating.ratio.table import RatioTable, read_ratio_table, write_ratio_table
from sim_heating.heating.ratio.uncertainty import Evidence, node_weights, posterior
from sim_heating.inputs.points import conditions_at_point
from sim_heating.inputs.scenario import load_scenario
from sim_heating.inputs.vehicle import load_vehicle
from sim_heating.march.ensemble import histories
from sim_heating.march.history import march_points
from sim_heating.march.linearised import LinearMarch, Track
from sim_heating.planning.envelope.case import BaseEntry, Case, FlownCase, alpha_schedule, cross_range_km, held_alpha
from sim_heating.planning.envelope.margins import EvaluatedCase, MarginEvaluator
from sim_heating.planning.limited_point import LimitedPoint
from sim_heating.planning.plan import parts_of
from sim_heating.planning.ratio_table_modes import informed_root, peak_sensitivities
from sim_heating.planning.study import load_study
from sim_heating.simulation.run import run
from sim_heating.trajectory.aero import load_aero
from sim_heating.trajectory.point_mass import WGS84_RADIUS_M
from sim_heating.trajectory.spec import Stop
from tests.support.paths import ROOT
from tests.support.studies import entry_3dof

POINTS = ("WING_LE", "V07T9975", "V07T9730", "BODYFLAP")
STOP_M_S = 5500.0
"""Past all peaks of surface temperature, so that flights are short."""


@cache
def base(stop_m_s: float = STOP_M_S) -> BaseEntry:
    scenario = load_scenario(ROOT / "scenarios" / "entry_3dof.toml")
    spec = scenario.declared.trajectory
    changes = {"manoeuvre": (), "stop": Stop(velocity_m_s=stop_m_s), "sample_s": 2.0}
    return BaseEntry(spec.model_copy(update=changes), scenario.vehicle)


@cache
def evaluator(*names: str) -> MarginEvaluator:
    """Of these control points, all by default: the covariance of a large table takes seconds."""
    scenario = load_scenario(ROOT / "scenarios" / "entry_3dof.toml")
    points = [scenario.vehicle.control_point(name) for name in names or POINTS]
    limited = [LimitedPoint(p, p.limits.surface_K, p.limits.bondline_K) for p in points]
    return MarginEvaluator(base(), limited, scenario, soak_s=0.0)


@cache
def flown(case: Case) -> FlownCase:
    return base().fly(case)


@cache
def evaluated(case: Case) -> EvaluatedCase:
    result = evaluator().evaluate(case)
    assert result.error is None, result.error
    return result


def peak(case: Case, limit: str) -> float:
    return evaluated(case).margins[limit].value


# Physics of the cases ------------------------------------------------------------------------------------------------


@pytest.mark.thorough
def test_lower_angle_of_attack_cools_leeside_and_heats_leading_edge() -> None:
    low, base_entry = Case(alpha_offset_deg=-6.0), Case()
    assert peak(low, "V07T9975 surface") < peak(base_entry, "V07T9975 surface") - 20.0
    assert peak(low, "WING_LE surface") > peak(base_entry, "WING_LE surface") + 5.0


@pytest.mark.thorough
@pytest.mark.parametrize("limit", ["WING_LE surface", "BODYFLAP surface", "V07T9975 surface"])
def test_a_heavier_vehicle_and_a_shorter_flight_are_hotter(limit: str) -> None:
    assert peak(Case(mass_kg=84000.0), limit) < peak(Case(), limit) < peak(Case(mass_kg=104000.0), limit)
    assert peak(Case(drag_factor=0.8), limit) < peak(Case(), limit)


@pytest.mark.thorough
def test_drag_tracking_compensates_a_denser_atmosphere() -> None:
    thin, dense = flown(Case(density_factor=0.8)).conditions, flown(Case(density_factor=1.2)).conditions
    at = [float(np.interp(-6500.0, -c["velocity_m_s"], c["altitude_m"])) for c in (thin, dense)]
    assert at[1] - at[0] == pytest.approx(7000.0 * np.log(1.5), rel=0.25)
    limit = "WING_LE surface"
    assert peak(Case(density_factor=1.2), limit) == pytest.approx(peak(Case(density_factor=0.8), limit), abs=5.0)


@pytest.mark.thorough
def test_forward_centre_of_gravity_or_lower_body_flap_raises_the_elevon() -> None:
    def elevon(**changes: float) -> float:
        c = flown(Case(**changes)).conditions
        return float(np.interp(-6500.0, -c["velocity_m_s"], c["elevon_deg"]))

    assert elevon(cg_fraction=0.66, bodyflap_deg=8.0) < elevon(cg_fraction=0.667, bodyflap_deg=8.0) - 1.0
    assert elevon(bodyflap_deg=14.0) < elevon(bodyflap_deg=8.0) - 1.0
    assert elevon(bodyflap_deg=8.0, cm_shift=0.0) < elevon(bodyflap_deg=8.0, cm_shift=0.03) - 1.0


@pytest.mark.thorough
def test_the_elevon_and_the_body_flap_share_the_heat() -> None:
    up, down = Case(bodyflap_deg=5.0), Case(bodyflap_deg=16.0)
    assert peak(down, "BODYFLAP surface") > peak(up, "BODYFLAP surface") + 10.0
    assert peak(down, "V07T9730 surface") < peak(up, "V07T9730 surface") - 10.0


@pytest.mark.thorough
def test_a_trim_beyond_the_elevons_travel_is_reported_with_the_distance() -> None:
    case = Case(cg_fraction=0.65, bodyflap_deg=22.5)
    c = flown(case)
    held = c.conditions["elevon_deg"] <= c.trim.low_deg + 1e-9
    assert np.all(c.trim.required_deg[held] < c.trim.low_deg)
    assert np.array_equal(c.trim.required_deg[~held], c.conditions["elevon_deg"][~held])
    assert evaluated(case).margins["elevon travel, up"].margin < -5.0
    assert any(m.kind == "elevon" for _, m in evaluated(case).other_violations)


@pytest.mark.thorough
def test_a_flight_outside_a_table_is_reported_with_variable_and_distance() -> None:
    result = evaluated(Case(cg_fraction=0.65, bodyflap_deg=22.5))
    m = result.margins["BODYFLAP ratio table, elevon below -10 deg"]
    assert m.margin == pytest.approx(m.value + 10.0)
    assert m.margin < 0.0
    assert any(line.startswith("BODYFLAP: elevon_deg up to") for line in result.outside)


def test_an_offset_that_the_limits_of_guidance_hold_is_told() -> None:
    """A map had a column for an angle that was never flown."""
    guidance = base().guidance
    assert held_alpha(Case(alpha_offset_deg=-2.0), guidance) == ""
    low, high = guidance.alpha_limits_deg
    assert max(alpha for _, alpha in alpha_schedule(Case(alpha_offset_deg=60.0), guidance, 1.0)) == high
    assert f"and is flown within {low:g} to {high:g} deg" in held_alpha(Case(alpha_offset_deg=60.0), guidance)


def test_a_station_holds_its_angle_of_attack_and_leaves_the_rest() -> None:
    guidance = base().guidance
    schedule = np.array(alpha_schedule(Case(alpha_station=20.0, station_alpha_deg=33.0), guidance, 1.0)).T
    plain = np.array(sorted(guidance.alpha_deg)).T
    mach = np.linspace(3.0, 28.0, 501)
    held, free = np.abs(mach - 20.0) <= 1.0, np.abs(mach - 20.0) >= 1.25
    assert np.interp(mach[held], *schedule) == pytest.approx(33.0)
    assert np.interp(mach[free], *schedule) == pytest.approx(np.interp(mach[free], *plain))


def test_cross_range_is_the_distance_from_the_first_great_circle() -> None:
    R = WGS84_RADIUS_M / 1e3
    assert cross_range_km((0.0, 0.0), 90.0, (0.0, 77.0)) == pytest.approx(0.0, abs=1e-9)
    assert cross_range_km((0.0, 0.0), 90.0, (10.0, 0.0)) == pytest.approx(R * np.radians(10.0))
    assert cross_range_km((0.0, 0.0), 0.0, (0.0, 10.0)) == pytest.approx(-R * np.radians(10.0))


@pytest.mark.thorough
def test_a_required_cross_range_is_flown_and_one_out_of_reach_is_refused() -> None:
    most = abs(flown(Case(one_sided=True)).cross_range_km)
    assert abs(flown(Case(cross_range_km=0.6 * most)).cross_range_km) == pytest.approx(0.6 * most, abs=3.0)
    refused = evaluator().evaluate(Case(cross_range_km=2.0 * most))
    assert refused.margins == {}
    assert f"{most:.0f} km is the most that is flown" in (refused.error or "")


def test_sideslip_and_aileron_balance_a_lateral_centre_of_gravity() -> None:
    y = 0.04
    c, plain = flown(Case(lateral_cg_m=y)), flown(Case())
    aero = load_aero(base().vehicle.directory).with_changes(cm_shift=True)
    lateral, span, arm = aero.file.lateral, aero.file.reference.span_m, base().elevon_arm_m
    for i in (100, 200, 300):
        at = [float(plain.conditions[n][i]) for n in ("mach", "alpha_deg", "elevon_deg", "bodyflap_deg")]
        cn, ca, _ = aero.body_coefficients(*at)
        per_deg = (
            0.5
            * np.subtract(
                aero.body_coefficients(at[0], at[1], at[2] + 1.0, at[3]),
                aero.body_coefficients(at[0], at[1], at[2] - 1.0, at[3]),
            )[0]
        )
        beta, aileron = c.conditions["beta_deg"][i], c.aileron_deg[i]
        assert lateral.Cn_beta_deg * beta == pytest.approx(ca * y / span)
        roll = lateral.Cl_beta_deg * beta + per_deg * arm / span * aileron + cn * y / span
        assert roll == pytest.approx(0.0, abs=1e-12)
    mirrored = flown(Case(lateral_cg_m=-y))
    assert mirrored.aileron_deg == pytest.approx(-c.aileron_deg)
    starboard = c.at_side(11.0)["elevon_deg"] - plain.conditions["elevon_deg"]
    assert starboard == pytest.approx(mirrored.at_side(-11.0)["elevon_deg"] - plain.conditions["elevon_deg"])


# Sigma of the tables --------------------------------------------------------------------------------------------------


def at_point(case: Case, name: str) -> Conditions:
    point = base().vehicle.control_point(name)
    return conditions_at_point(base().vehicle, point, flown(case).conditions)


def marched(name: str, tables: list[RatioTable], conditions: Conditions) -> np.ndarray:
    """(table, time) surface temperatures with other tables."""
    model = evaluator(name).models[0]
    histories_K = march_points([replace(model, ratio=t) for t in tables], [conditions] * len(tables))
    return np.array([h.surface_K for h in histories_K])


@pytest.mark.sample(1)
@pytest.mark.parametrize("name", POINTS)
def test_sensitivity_to_table_errors_is_that_of_a_table_with_errors(name: str) -> None:
    conditions, alone = at_point(Case(), name), evaluator(name)
    root, table = alone.roots[0], alone.points[0].point.ratio
    assert root is not None
    peak = peak_sensitivities(alone.models, alone.meshes, [root], [conditions])[0].surface
    at = int(np.flatnonzero(conditions.time_s == peak.time_s)[0])
    rng = np.random.default_rng(3)
    for _ in range(3):
        z = rng.standard_normal(root.shape[1])
        error = 0.02 * (root @ z).reshape(table.ratio.shape)
        both = [replace(table, ratio=table.ratio + sign * error) for sign in (1.0, -1.0)]
        T = marched(name, both, conditions)[:, at]
        assert (T[0] - T[1]) / 0.04 == pytest.approx(float(peak.slope @ z), abs=0.03 * peak.sigma_K)


@pytest.mark.thorough
def test_tables_drawn_from_their_covariance_spread_the_peak_by_sigma() -> None:
    name, share, draws = "WING_LE", 0.1, 400
    conditions, alone = at_point(Case(), name), evaluator(name)
    root, table = alone.roots[0], alone.points[0].point.ratio
    assert root is not None
    sigma = evaluated(Case()).margins[f"{name} surface"].sigma
    z = np.random.default_rng(4).standard_normal((draws, root.shape[1]))
    tables = [replace(table, ratio=table.ratio + share * (root @ row).reshape(table.ratio.shape)) for row in z]
    spread = np.std(np.max(marched(name, tables, conditions), axis=1)) / share
    assert spread == pytest.approx(sigma, rel=4.0 / np.sqrt(2.0 * draws))


def test_an_error_in_proportion_to_the_table_acts_as_ratio_scale() -> None:
    conditions, alone = at_point(Case(), "WING_LE"), evaluator("WING_LE")
    model, mesh = alone.models[0], alone.meshes[0]
    table = model.ratio
    assert table is not None
    times = conditions.time_s
    track = Track(model, mesh, ("ratio.scale",), times, (0,), table_errors=(table.ratio,))
    slopes = LinearMarch([track], times, histories([conditions])).march()[0].sensitivity[0]
    assert slopes[:, 1] == pytest.approx(slopes[:, 0], rel=1e-6, abs=1e-6)


def evidence(table: RatioTable, sigma: float) -> Evidence:
    """Evidence on the ratio at 40 deg and the Reynolds number of Mach 20, with a sigma."""
    at = np.array([[40.0, 0.0, 6.0, 0.0, 10.0]])
    W = node_weights(table.axes, at)
    nodes = np.unique(W.indices)
    return Evidence(("ratio",), nodes, W[:, nodes].toarray(), W @ table.ratio.ravel(), np.array([[sigma**2]]))


def test_flight_evidence_leaves_the_sigma_of_the_updated_table() -> None:
    table, root = evaluator("WING_LE").points[0].point.ratio, evaluator("WING_LE").roots[0]
    assert root is not None
    measured = evidence(table, 0.02)
    elsewhere = node_weights(table.axes, np.array([[34.0, 0.0, 6.3, 0.0, 10.0], [40.0, 0.0, 6.0, 0.0, 10.0]]))
    remaining = np.linalg.norm((elsewhere @ root) @ informed_root(root, measured), axis=1)
    assert remaining == pytest.approx(posterior(table, [measured]).sigma_along(elsewhere), rel=1e-6)
    nothing = np.linalg.norm((elsewhere @ root) @ informed_root(root, evidence(table, 1e9)), axis=1)
    assert nothing == pytest.approx(np.linalg.norm(elsewhere @ root, axis=1), rel=1e-9)


# The command ---------------------------------------------------------------------------------------------------------

STUDY = f"""format = "study/1"
title = "Pod and leading edge"
vehicle = "orbiter"
control_points = ["V07T9975", "WING_LE"]
{entry_3dof("velocity_m_s = 5800.0", sample_s=2.0)}[envelope]
refinements = 1
before = "orbiter"
[[envelope.map]]
name = "alpha"
axes = {{ alpha_offset_deg = [-6.0, 0.0] }}
[[envelope.boundary]]
name = "alpha"
along = "drag_factor"
at = [1.0]
across = "alpha_offset_deg"
values = [-14.0, -6.0, 0.0]
[next_flight]
[[next_flight.manoeuvre]]
name = "popu"
control_points = ["V07T9975"]
[[next_flight.manoeuvre.flown]]
kind = "popu"
at_velocity_m_s = 6400.0
"""


def test_a_candidate_flies_each_manoeuvre_once(tmp_path: Path) -> None:
    (tmp_path / "study.toml").write_text(STUDY + 1000 * STUDY[STUDY.index("[[next_flight.manoeuvre.flown]]") :])
    with pytest.raises(InputError, match=r"`?flown.* 2: is that of number 1; list each manoeuvre once"):
        load_study(tmp_path / "study.toml")


@pytest.fixture(scope="module")
def planned(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results for a vehicle whose tables are a tenth lower than those of the Orbiter, the vehicle `before`."""
    home = tmp_path_factory.mktemp("planned")
    (home / "study.toml").write_text(STUDY)
    shutil.copytree(load_vehicle("orbiter").directory, home / "later" / "orbiter")
    for name in ("V07T9975", "WING_LE"):
        path = home / "later" / "orbiter" / "ratio_tables" / f"{name}.csv"
        table = read_ratio_table(path)
        write_ratio_table(path, replace(table, ratio=0.9 * table.ratio))
    arguments = ["plan", str(home / "study.toml"), "--vehicle", str(home / "later" / "orbiter"), "--workers", "1"]
    assert main([*arguments, "--out", str(home / "out")]) == 0
    return home


@pytest.mark.thorough
def test_cooler_tables_open_the_envelope(planned: Path) -> None:
    result = read_json(planned / "out" / "study.json")["envelope"]
    before, after = result["before"]["alpha"]["area"], result["boundaries"]["alpha"]["area"]
    assert after["nominal"] > before["nominal"] + 1.0
    segment = result["boundaries"]["alpha"]["segments"][0]
    assert segment["low_limit"] == "WING_LE surface" or segment["low_nominal"] == -14.0
    assert segment["high_limit"] == "V07T9975 surface"
    assert -6.0 < segment["high_nominal"] < 0.0


@pytest.mark.thorough
def test_a_flight_at_the_edge_meets_its_limit(planned: Path) -> None:
    study = load_study(planned / "study.toml", planned / "later" / "orbiter")
    edge = read_json(planned / "out" / "study.json")["envelope"]["boundaries"]["alpha"]["segments"][0]["high_nominal"]
    own = MarginEvaluator(BaseEntry(study.base.declared.trajectory, study.vehicle), study.points, study.base, 0.0)
    assert own.evaluate(Case(alpha_offset_deg=edge)).margins["V07T9975 surface"].margin == pytest.approx(0.0, abs=0.5)


@pytest.mark.thorough
def test_a_manoeuvre_reduces_the_sigma_of_the_pod_that_it_heats(planned: Path) -> None:
    ranked = read_json(planned / "out" / "study.json")["next_flight"]["manoeuvres"]
    now, after = ranked[0]["sigma_K"]["alpha"]
    assert after < 0.8 * now
    assert 0.0 < ranked[0]["sigma_reduction"] < 1.0
    assert ranked[0]["bounds"]["V07T9975"]["ratio.scale"] > 0.01


def test_every_file_names_vehicle_revision_and_study(planned: Path) -> None:
    out = planned / "out"
    study = read_json(out / "study.json")["study"]
    for name in ("map_alpha.csv", "boundary_alpha.csv"):
        head = (out / "envelope" / name).read_text()
        assert study in head
        assert "revision 1" in head
    rows = read_csv_columns(out / "envelope" / "boundary_alpha.csv", ("drag_factor", "high_nominal"), keep_other=False)
    assert rows["high_nominal"][0] == pytest.approx(
        read_json(out / "study.json")["envelope"]["boundaries"]["alpha"]["segments"][0]["high_nominal"], rel=1e-5
    )
    for name in ("map_alpha", "boundary_alpha", "before_after_alpha", "next_flight"):
        assert (out / "envelope" / f"{name}.png").stat().st_size > 10_000


def test_margins_of_the_base_entry_are_those_of_its_run() -> None:
    """Behind the interface with the nose cap, whose wall upstream heats a tile by some kelvins more."""
    names, scenario = ("NOSE_HRSI", "V07T9975"), load_scenario(ROOT / "scenarios" / "entry_3dof.toml")
    declared = scenario.declared.model_copy(update={"trajectory": base().spec})
    ran = run(replace(scenario, declared=declared, names=names)).points
    margins, tile = evaluator(*names).evaluate(Case()).margins, ran["NOSE_HRSI"].model
    for name in names:
        peak_K = ran[name].history.surface_K.max()
        assert margins[f"{name} surface"].value == pytest.approx(peak_K, abs=0.01)
    by_itself = conditions_at_point(base().vehicle, base().vehicle.control_point(tile.name), flown(Case()).conditions)
    (without_wall,) = march_points([tile], [by_itself])
    assert margins["NOSE_HRSI surface"].value > without_wall.surface_K.max() + 1.0


def test_every_margin_names_the_entry_that_it_is_of(planned: Path) -> None:
    """In the map and under credibility, where the margins of two entries seem to contradict each other."""
    names = ["alpha_offset_deg -6", "base entry (alpha_offset_deg 0)"]
    result = read_json(planned / "out" / "study.json")
    assert [f["entry"] for f in result["envelope"]["maps"]["alpha"]["flights"]] == names
    evidence = result["credibility"]["evidence"]
    assert evidence["robustness.holds"]["finding"].startswith("base entry, as `run` has it: least margin ")
    by_map = result["envelope"]["maps"]["alpha"]["flights"][1]["margins_K"]["V07T9975 surface"]
    assert f"least margin {by_map:.0f} K (V07T9975 surface)" in evidence["robustness.holds"]["finding"]
    assert " in the base entry: sigma " in evidence["uncertainty.stated"]["finding"]
    page = (planned / "out" / "report.html").read_text().replace("<wbr>", "")
    assert all(f"<td>{name}</td>" in page for name in names)
    assert "base entry, as " in page


def test_a_study_announces_all_files_that_it_may_write(planned: Path) -> None:
    """So that a file which is not the program's own is reported before the work."""
    study = load_study(planned / "study.toml", planned / "later" / "orbiter")
    announced = {name for part in parts_of(study).values() for name in part.files(study)}
    assert files_written(planned / "out") - {"study.json", "report.html"} == announced


@pytest.mark.parametrize("name", ["alpha_expansion", "cg_expansion", "small_envelope"])
def test_shipped_envelopes_can_be_read(name: str) -> None:
    study = load_study(ROOT / "scenarios" / "studies" / f"{name}.toml")
    envelope, candidates = study.declared.envelope, study.declared.next_flight
    assert envelope is not None
    assert candidates is not None
    assert {p for c in candidates.manoeuvre for p in c.control_points} <= set(study.base.names)
    for b in envelope.boundary:
        case = b.case(b.members()[0], b.at[0], b.values[0])
        assert getattr(case, b.along) == b.at[0]
        assert getattr(case, b.across) == b.values[0]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('across = "alpha_offset_deg"', 'across = "alpha_ofset_deg"', "alpha_offset_deg"),
        ("values = [-14.0, -6.0, 0.0]", "values = [0.0, -6.0]", "must rise"),
        ('control_points = ["V07T9975"]\n[[next', 'control_points = ["NOSECAP"]\n[[next', "`NOSECAP` is not among"),
        ('along = "drag_factor"', 'along = "drag_factor"\nfamily = "cm_shift"', "give both or neither"),
        ("at = [1.0]", "at = [-0.5, 1.0]", "`along`: drag_factor -0.5 must be above 0"),
        ("at = [1.0]", "at = [1.0]\nfixed = { cg_fraction = 1.5 }", "cg_fraction 1.5 must be between 0 and 1"),
        ('along = "drag_factor"', 'along = "alpha_offset_deg"', "is given by `along` and by `across`"),
        ('along = "drag_factor"', 'along = "station_alpha_deg"', "is held about `alpha_station`; give both"),
        ("axes = { alpha", "fixed = { alpha_offset_deg = 1.0 }\naxes = { alpha", "is given by `axes` and by `fixed`"),
    ],
)
def test_a_study_that_asks_for_something_impossible_is_refused_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], old: str, new: str, message: str
) -> None:
    assert old in STUDY
    (tmp_path / "study.toml").write_text(STUDY.replace(old, new))
    assert main(["plan", str(tmp_path / "study.toml"), "--out", str(tmp_path / "out"), "--workers", "1"]) == 2
    errors = capsys.readouterr().err.strip().splitlines()
    assert any(message in line for line in errors)
    assert all(str(tmp_path / "study.toml") in line for line in errors)
    assert not (tmp_path / "out").exists()


@pytest.mark.thorough
def test_with_bands_a_margin_has_the_sigma_of_all_that_is_uncertain(tmp_path: Path) -> None:
    """Tables, wall and the error of the heating in squares: against the sigma of the tables alone."""
    study = (ROOT / "scenarios" / "studies" / "small_envelope.toml").read_text().partition("[[envelope.boundary]]")[0]
    planned = {}
    for name, bands in (("tables", "false"), ("all", "true")):
        text = study.replace("refinements = 1", f"sigmas = 1.96\nbands = {bands}").replace(
            "[-12.0, -8.0, -4.0, 0.0]", "[-8.0]"
        )
        (tmp_path / f"{name}.toml").write_text(text)
        assert main(["plan", str(tmp_path / f"{name}.toml"), "--workers", "1", "--out", str(tmp_path / name)]) == 0
        planned[name] = read_json(tmp_path / name / "study.json")["envelope"]["maps"]["alpha"]["flights"][0]
    alone, every = planned["tables"], planned["all"]
    assert "margins_at_band_K" not in alone
    for limit, sigma in alone["sigma_K"].items():
        assert every["sigma_K"][limit] > sigma
        expected = every["margins_K"][limit] - 1.959964 * every["sigma_K"][limit]
        assert every["margins_at_band_K"][limit] == pytest.approx(expected)
    assert every["margins_K"] == alone["margins_K"]
    assert "surface_margin_at_band_K" in (tmp_path / "all" / "envelope" / "map_alpha.csv").read_text()
