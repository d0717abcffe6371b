"""Manoeuvre design: bounds before a flight are those of actual fits, and the search keeps its limits."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sim_heating.base.errors import InputError, RunError
from sim_heating.base.parameters import CLOCK_SKEW, PRESSURE_FACTOR, Parameter
from sim_heating.cli import main
from sim_heating.estimation.design.check import RepeatedFits, repeated_fits
from sim_heating.estimation.design.credibility import credibility_of_design
from sim_heating.estimation.design.information import (
    Experiment,
    PredictedChannel,
    design_criterion,
    experiment,
    marginalise,
    sensitivity_to_effort,
)
from sim_heating.estimation.design.instruments import instrumentation
from sim_heating.estimation.design.locations import locations
from sim_heating.estimation.design.planned_flight import Instruments, PlannedFlight, Planner
from sim_heating.estimation.design.search import DesignSearch
from sim_heating.inputs.scenario import load_scenario, with_design
from sim_heating.thermal.sampling import RateInManoeuvres
from sim_heating.thermal.stack import Sensor
from tests.support.browser import assert_fits, needs_browser
from tests.support.kills import inputs
from tests.support.paths import SCENARIOS
from tests.support.walls import practice_record

SCENARIO = SCENARIOS / "design_popu.toml"
D_ALPHA = "ratio.d_alpha"
COATING = "stack.coating.thickness_factor"
NAMES = (D_ALPHA, "ratio.scale", COATING, CLOCK_SKEW.name, PRESSURE_FACTOR.name)


def planner_of(**keys: object) -> Planner:
    """The shipped scenario, one control point and the 3-DOF entry alone."""
    loaded = load_scenario(SCENARIO)
    spec = loaded.declared.trajectory.model_copy(update={"source": "entry-3dof", "rate_hz": 4.0})
    loaded = replace(loaded, names=("V09T9527",), declared=loaded.declared.model_copy(update={"trajectory": spec}))
    return Planner(with_design(loaded, keys))


@pytest.fixture(scope="module")
def planner() -> Planner:
    return planner_of()


@pytest.fixture(scope="module")
def planned(planner: Planner) -> PlannedFlight:
    return planner.fly(planner.scenario.declared.trajectory.manoeuvre)


@pytest.fixture(scope="module")
def planned_experiment(planner: Planner, planned: PlannedFlight) -> Experiment:
    return planner.experiment(planned, NAMES, {})


def line(x: np.ndarray, bits: int | None = None, **prior: float) -> Experiment:
    """A sensor that reads a + b x with a noise of 1 K."""
    sensor = Sensor(name="s", column="s_K", depth_m=0.0, noise_sigma_K=1.0, bits=bits, range_K=[255.0, 1533.0])
    unknowns = tuple(Parameter(n, "K", 0.0, prior.get(n, np.inf)) for n in ("a", "b"))
    return Experiment(unknowns, (PredictedChannel(sensor, x, 500.0 + x, np.column_stack([np.ones_like(x), x]), 1.0),))


def test_bounds_of_a_straight_line_are_those_of_least_squares():
    x = np.linspace(-1.0, 2.0, 7)
    design_matrix = np.column_stack([np.ones_like(x), x])
    expected = np.linalg.inv(design_matrix.T @ design_matrix)
    assert line(x).covariance(("b", "a")) == pytest.approx(expected[::-1, ::-1], rel=1e-9)


def test_a_prior_adds_its_information():
    x = np.linspace(-1.0, 1.0, 9)  # a and b are independent
    assert line(x, b=0.5).sigma(("b",))[0] ** -2 == pytest.approx(np.sum(x**2) + 4.0, rel=1e-9)


def test_what_is_not_identified_has_no_bound():
    assert np.isinf(line(np.zeros(5)).sigma(("b",))[0])


def test_two_equal_flights_halve_the_variance_under_a_flat_prior():
    x = np.linspace(0.0, 1.0, 6)
    assert line(x).sigma(("b",), 2) == pytest.approx(line(x).sigma(("b",)) / np.sqrt(2.0))


def test_a_separate_clock_in_each_flight_is_averaged_and_a_coating_is_not(planned_experiment):
    shared, private = (
        planned_experiment.with_priors({CLOCK_SKEW.name: 1e-6}),
        planned_experiment.with_priors({COATING: 1e-6}),
    )
    assert private.sigma((D_ALPHA,), 4)[0] < 0.51 * private.sigma((D_ALPHA,))[0]
    assert shared.sigma((COATING,), 4)[0] > 0.51 * shared.sigma((COATING,))[0]  # its prior is not repeated


def test_marginalised_private_unknowns_leave_the_schur_complement():
    rng = np.random.default_rng(3)
    S = rng.normal(size=(20, 5))
    M, prior = S.T @ S, np.array([0.0, 0.0, 1.0, 0.0, 2.0])
    private = np.array([False, True, False, True, False])
    whole = np.linalg.inv(M + np.diag(np.where(private, prior, 0.0)))
    assert np.linalg.inv(marginalise(M, prior, private)) == pytest.approx(whole[np.ix_(~private, ~private)], rel=1e-9)


def test_criteria_are_ratios_of_bounds():
    planned = np.diag([4.0, 100.0])
    assert design_criterion("A", planned, planned) == design_criterion("D", planned, planned) == pytest.approx(1.0)
    assert design_criterion("D", np.diag([1.0, 100.0]), planned) == pytest.approx(np.sqrt(0.5))
    assert design_criterion("A", np.diag([1.0, 100.0]), planned) == pytest.approx(np.sqrt((0.25 + 1.0) / 2.0))


def test_a_criterion_does_not_depend_on_units():
    rng = np.random.default_rng(1)
    a, b = (m @ m.T for m in rng.normal(size=(2, 3, 3)))
    units = np.outer(*2 * [np.array([1e-4, 1.0, 1e5])])
    for criterion in ("A", "D"):
        assert design_criterion(criterion, a * units, b * units) == pytest.approx(design_criterion(criterion, a, b))


def test_bound_falls_with_excursion_and_with_the_root_of_samples():
    information = np.array([[2.0, 0.4], [0.4, 1.0]])
    found = sensitivity_to_effort(("ratio.d_alpha", "ratio.scale"), information, np.zeros(2))
    assert found == {"ratio.d_alpha": pytest.approx({"larger": 0.5, "longer": np.sqrt(0.5)})}


def test_a_known_parameter_gains_less_than_an_unknown_one():
    found = sensitivity_to_effort(("ratio.d_alpha",), np.array([[1.0]]), np.array([1.0]))
    assert found["ratio.d_alpha"]["larger"] == pytest.approx(np.sqrt(2.0 / 5.0))


@pytest.mark.thorough
def test_a_planned_record_warns_of_no_file(
    planner: Planner, planned: PlannedFlight, recwarn: pytest.WarningsRecorder
) -> None:
    """Its readings last a small part of the flight; no user wrote them."""
    planner.experiment(planned, NAMES, {})
    assert not recwarn.list


def test_longer_words_faster_samples_and_better_clocks_never_hurt(planned_experiment):
    def bound(e: Experiment) -> float:
        return float(e.sigma((D_ALPHA,))[0])

    words = [bound(planned_experiment.with_bits(bits)) for bits in (8, 10, 12, 16)]
    assert np.all(np.diff(words) < 0.0)
    assert words[-1] == pytest.approx(bound(planned_experiment.with_bits(None)), rel=1e-3)
    assert bound(planned_experiment.with_priors({CLOCK_SKEW.name: 0.1})) < bound(
        planned_experiment.with_priors({CLOCK_SKEW.name: 0.5})
    )
    assert bound(planned_experiment.with_priors({PRESSURE_FACTOR.name: 0.02})) <= bound(planned_experiment)
    for channel in planned_experiment.channels:
        assert bound(planned_experiment.without([channel.sensor.name])) >= bound(planned_experiment)


def test_ten_hertz_in_the_manoeuvre_alone_lie_between_one_and_ten(planner: Planner, planned: PlannedFlight) -> None:
    rates = (1.0, RateInManoeuvres(manoeuvres_hz=10.0), 10.0)
    sensors = planner.instruments.sensors
    bounds = [planner.experiment(planned, NAMES, {}, Instruments(sensors, r)).sigma((D_ALPHA,))[0] for r in rates]
    assert bounds[0] > 1.1 * bounds[1] > 1.1 * bounds[2]


def test_locations_are_ranked_by_their_bounds_over_their_ratios(planner: Planner, planned: PlannedFlight) -> None:
    """At the design's own point the value is 1; a point without a thermocouple gets one below its coating."""
    names = ("V09T9527", "LOWER_MID", "POD_LRSI")
    both = Planner(replace(planner.scenario, names=names))
    flown = both.fly(planned.manoeuvres)
    ranked = locations(both, flown)
    assert [at.over_declared for at in ranked] == sorted(at.over_declared for at in ranked)
    by_name = {at.control_point: at for at in ranked}
    assert set(by_name) == set(names)
    assert by_name["V09T9527"].over_declared == pytest.approx(1.0)
    for at in ranked:
        peak_K = both.limit(f"{at.control_point} surface_K") - flown.margins[f"{at.control_point} surface_K"]
        limit_K = both.scenario.vehicle.control_point(at.control_point).limits.surface_K
        assert at.surface_margin_K == pytest.approx(limit_K - peak_K)
    assert locations(planner, planned) == []


@pytest.mark.thorough
def test_a_location_without_a_thermocouple_has_one_below_its_coating(planner: Planner, planned: PlannedFlight) -> None:
    vehicle = planner.scenario.vehicle
    bare = replace(vehicle.control_point("LOWER_MID"), sensors=())
    points = {**vehicle.control_points, "LOWER_MID": bare}
    without = replace(vehicle, control_points=points)
    both = Planner(replace(planner.scenario, names=("V09T9527", "LOWER_MID"), vehicle=without))
    at = {a.control_point: a for a in locations(both, both.fly(planned.manoeuvres))}["LOWER_MID"]
    assert not at.is_installed
    assert at.sensor.depth_m == bare.construction.stack.layer[0].thickness_m
    assert at.sensor.range_K == [255.0, bare.limits.surface_K]
    assert np.all(np.isfinite(at.sigma))


def test_stated_instruments_take_the_place_of_those_of_the_program(planned: PlannedFlight) -> None:
    """Longer words and a better clock, stated as sets, have the bounds of those words and that prior."""
    sets = [
        {"name": "all alike", "bits": 12, "range_K": [255.0, 1644.0]},
        {"name": "one clock", "prior": {CLOCK_SKEW.name: 0.01}},
    ]
    planner = planner_of(instruments=sets)
    variants = {v.change: v for v in instrumentation(planner, planned, NAMES, {})}
    assert list(variants) == ["as declared", "all alike", "one clock"]
    declared = planner.experiment(planned, NAMES, {})
    of_clock = declared.with_priors({CLOCK_SKEW.name: 0.01})
    np.testing.assert_allclose(variants["one clock"].sigma, of_clock.sigma(planner.targets), rtol=1e-9)
    compared = {of_set.name: instruments for of_set, instruments in planner.compared}
    assert {s.range_K[1] for s in compared["all alike"].sensors if s.range_K} == {1644.0}
    assert np.all(variants["all alike"].sigma <= variants["as declared"].sigma)


def test_the_terminal_compares_stated_instruments_a_row_each(tmp_path, capsys) -> None:
    """Longer words tell more of the elevon's derivative; the row has the bound of design.json."""
    text = (SCENARIOS / "design_first_look.toml").read_text(encoding="utf-8")
    lists = '\n[[design.instruments]]\nname = "12 bits"\nbits = 12\n'
    (tmp_path / "flap.toml").write_text(text + lists, encoding="utf-8")
    arguments = ["design", str(tmp_path / "flap.toml"), "--evaluations", "1", "--out", str(tmp_path / "out")]
    assert main(arguments) == 0
    printed = capsys.readouterr().out
    sets = json.loads((tmp_path / "out" / "design.json").read_text())["instruments"]
    bounds = {of_set["what"]: of_set["sigma"]["ratio.d_elevon"] for of_set in sets}
    assert bounds["12 bits"] < bounds["as declared"]
    for kind, name in (("declared", "as declared"), ("stated", "12 bits")):
        assert re.search(rf"{kind}[ │]+{name}[ │]+{bounds[name]:.3g} ", printed)


def test_a_stated_instrument_outside_the_wall_is_refused_by_its_set() -> None:
    deep = {"name": "TC9", "column": "tc9_K", "depth_m": 0.5, "noise_sigma_K": 1.0}
    with pytest.raises(InputError, match=r"\[\[design.instruments\]\] deep: `sensor\[0\].depth_m`: 0.5 m is outside"):
        planner_of(instruments=[{"name": "deep", "sensor": [deep]}])
    with pytest.raises(InputError, match=r"`clock\.skw`"):
        planner_of(instruments=[{"name": "clock", "prior": {"clock.skw": 0.01}}])


def test_more_pressure_cools_the_coating_and_warms_the_tile(planner, planned):
    """On a fully catalytic wall: on another one fewer atoms at a higher pressure warm the coating."""
    record, start = planner.record(planned, planner.instruments)
    assert record.declared.heating.catalysis is not None
    heating = record.declared.heating.model_copy(update={"catalysis": None})
    catalytic = replace(record, declared=record.declared.model_copy(update={"heating": heating}))
    for wall, coating_cools in ((catalytic, True), (record, False)):
        found = experiment(wall, NAMES, start=start)
        k = found.names.index(PRESSURE_FACTOR.name)
        outermost, inch_deep = found.channels[0].jacobian[:, k], found.channels[3].jacobian[:, k]
        assert np.all(outermost < 0.0) == coating_cools
        assert np.all(inch_deep > 0.0)


def test_interfaces_are_listed_with_their_predicted_excess(planner, planned):
    """Behind the hotter nose cap the tile is heated more; a point without an interface is not listed."""
    both = Planner(replace(planner.scenario, names=("V09T9527", "NOSE_HRSI")))
    (row,) = both.interfaces(planned.flight)
    assert (row["control_point"], row["upstream"]) == ("NOSE_HRSI", "NOSECAP")
    assert 0.01 < float(row["largest_excess"]) < 0.5
    assert 0.0 < float(row["largest_in_manoeuvres"]) <= float(row["largest_excess"])
    assert planner.interfaces(planned.flight) == []


def test_readings_of_a_record_are_not_used():
    record, _ = practice_record("p06")
    other = {
        n: v if n == "time_s" else np.where(np.isfinite(v), 400.0, np.nan) for n, v in record.thermocouples.items()
    }
    names = ("ratio.scale", D_ALPHA)
    found = [experiment(r, names).sigma(names) for r in (record, replace(record, thermocouples=other))]
    assert found[0] == pytest.approx(found[1], rel=1e-12)


@pytest.mark.thorough
def test_predicted_bounds_are_those_of_simulated_fits():
    # of 200 fits a root mean square is known to 5 %
    planner = planner_of(before_s=5.0, after_s=15.0)
    planned = planner.fly(planner.scenario.declared.trajectory.manoeuvre)
    record, start = planner.record(planned, planner.instruments)
    assert start is not None
    known = replace(start, columns=start.columns[:, :0], unknowns=())
    names = (D_ALPHA, "ratio.scale", COATING, CLOCK_SKEW.name)
    predicted = experiment(record, names, start=known).with_priors({COATING: 0.05, CLOCK_SKEW.name: 0.1})
    fits = repeated_fits(record, predicted, start=known, repetitions=200)
    assert fits.failed == 0
    assert fits.rms_error(names) == pytest.approx(predicted.sigma(names), rel=0.10)


@pytest.mark.thorough
def test_a_search_never_leaves_its_limits_and_beats_the_plan(planner):
    search = DesignSearch(planner_of(evaluations=12))
    found = search.run()
    assert found.best.feasible
    assert min(t.criterion for t in found.designs) < 1.0
    during = found.best.flight.conditions
    window = found.best.flight.windows[0]
    flown = (during.time_s >= window.start_s) & (during.time_s <= window.end_s)
    assert during["alpha_deg"][flown].min() >= 32.0
    assert window.end_s - window.start_s <= 40.0
    assert found.best_experiment.sigma((D_ALPHA,))[0] < found.planned_experiment.sigma((D_ALPHA,))[0]


@pytest.mark.thorough
def test_limits_that_no_design_keeps_are_an_error():
    limits = {"alpha_deg": [39.9, 40.1]}
    with pytest.raises(RunError, match="none of 4 designs keeps the limits; the nearest exceeds that of alpha_deg"):
        DesignSearch(planner_of(evaluations=4, limits=limits)).run()


def test_a_manoeuvre_that_does_not_identify_a_parameter_is_refused():
    with pytest.raises(InputError, match=r"ratio\.d_bodyflap: bodyflap_deg is constant"):
        DesignSearch(planner_of(parameters=["ratio.d_bodyflap"]))


def test_a_number_of_flights_is_listed_once() -> None:
    with pytest.raises(InputError, match=r"`flights`: 1 is repeated; list each number of flights once"):
        planner_of(flights=[1] * 1000)


@pytest.mark.parametrize(
    ("key", "names"),
    [("parameters", ["ratio.d_alfa"]), ("nuisance", ["ratio.d_alfa"]), ("prior", {"ratio.d_alfa": 1e-4})],
)
def test_a_misspelt_parameter_is_reported_with_its_place_and_the_nearest(key, names):
    message = rf"toml, \[design\], {key}: .*unknown parameter `ratio\.d_alfa`; did you mean `ratio\.d_alpha`"
    with pytest.raises(InputError, match=message):
        planner_of(**{key: names})


@pytest.fixture(scope="module")
def flap_design(tmp_path_factory) -> Path:
    """Files of the shipped design of a body-flap sweep and an elevon pulse, its flight begun just before them."""
    text = (SCENARIOS / "design_flap.toml").read_text(encoding="utf-8")
    head, _, rest = text.partition("[design]")
    head = head.replace("121920.0", "67000.0").replace("7450.0", "5100.0").replace("-1.2", "-0.1")
    head = re.sub("control_points = .*", 'control_points = ["BODYFLAP"]', head.replace("mach = 2.5", "time_s = 155.0"))
    declared = rest.partition("[[design.vary]]")[0].replace("evaluations = 64", "evaluations = 2")
    home = tmp_path_factory.mktemp("flap_design")
    vary = '[[design.vary]]\nmanoeuvre = 2\nkey = "hold_s"\nlow = 1.0\nhigh = 12.0\n'
    (home / "flap.toml").write_text(f"{head}[design]{declared}{vary}", encoding="utf-8")
    assert main(["design", str(home / "flap.toml"), "--out", str(home / "out")]) == 0
    return home / "out"


def test_a_whole_design_reports_its_result(flap_design):
    """Both derivatives of a sweep in which the elevon follows the flap, and of a pulse that separates them."""
    found = json.loads((flap_design / "design.json").read_text())
    planned, optimal = ([p[k] for p in found["parameters"].values()] for k in ("planned_sigma", "optimal_sigma"))
    assert set(found["parameters"]) == {"ratio.d_elevon", "ratio.d_bodyflap"}
    assert [m["kind"] for m in found["optimal"]["manoeuvres"]] == ["bodyflap-sweep", "elevon-pulse"]
    assert sum((o / p) ** 2 for o, p in zip(optimal, planned, strict=True)) <= 2.0  # the criterion A of the scenario
    assert found["tried"] == 2
    kinds = {i["kind"] for i in found["instruments"]}
    assert kinds >= {"word", "rate", "clock", "pressure", "without", "extra sensor"}


def test_page_of_a_design_names_what_a_sensor_alone_does_not_identify(flap_design):
    """Nothing but the thermocouple at the surface sees a manoeuvre of half a minute."""
    page = (flap_design / "report.html").read_text().replace("<wbr>", "")
    (row,) = re.findall("<td>without</td><td[^>]*>BODYFLAP_surface</td>(.*)</tr>", page)
    assert re.sub("<[^>]*>", " ", row).split() == ["not", "identified", "not", "identified"]


def test_a_design_states_what_supports_it(flap_design):
    """Before a flight nothing is measured: the bounds come from the model, flown as the search flies it."""
    block = json.loads((flap_design / "design.json").read_text())["credibility"]
    assert block["factors"]["data_pedigree"]["level"] >= 1
    assert "trajectory entry-3dof" in block["verification"]["topics"]
    assert 0.0 <= block["region"]["inside"] <= 1.0
    assert block["uncertainty"]["quantity"].startswith("heating ratio")
    assert not block["evidence"]["uncertainty.consistent"]["met"]
    assert "--repetitions" in block["evidence"]["uncertainty.consistent"]["finding"]
    assert "two sigma" in block["evidence"]["robustness.holds"]["finding"]
    assert ">Credibility</h2>" in (flap_design / "report.html").read_text()


def test_simulated_fits_within_the_bounds_are_evidence_for_a_design(planner, planned, planned_experiment):
    """Errors twice as large are not, nor are fits that failed."""
    names = planned_experiment.names
    fits = RepeatedFits(names, np.outer([-1.0, 1.0], planned_experiment.sigma(names)), failed=0)

    def evidence(of: RepeatedFits) -> bool:
        found = credibility_of_design(planner, planned, planned_experiment, (planned,), (of, planned_experiment))
        return found.findings["uncertainty.consistent"].holds

    assert evidence(fits)
    assert not evidence(replace(fits, error=2.0 * fits.error))
    assert not evidence(replace(fits, failed=1))


def test_the_page_of_a_design_states_the_design(flap_design):
    """The numbers to be flown stood in design.json and on the terminal alone."""
    page = (flap_design / "report.html").read_text().replace("<wbr>", "")
    found = json.loads((flap_design / "design.json").read_text())
    planned, optimal = (found[which]["manoeuvres"][1]["hold_s"] for which in ("planned", "optimal"))
    assert f"manoeuvre 2, elevon-pulse: hold_s {planned:.4g} planned, {optimal:.4g} optimal" in page


@needs_browser
def test_the_page_of_a_design_fits_a_screen_a_telephone_and_paper(flap_design):
    assert_fits(flap_design / "report.html")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('key = "hold_s"', 'key = "hold"', "`hold` is not a number that this manoeuvre gives; did you mean `hold_s`"),
        ('criterion = "D"', 'criterion = "E"', "criterion"),
        ("low = 4600.0", "low = 6500.0", "as planned is not within 6500 to 6700"),
        ("alpha_deg = [32.0, 46.0]", "alpha_deg = [46.0, 32.0]", "is not a range"),
        ('control_point = "V09T9527"', 'control_point = "V09T9528"', "no control point `V09T9528`"),
        ("flights = [1, 2, 4]", "flights = [0]", "0 is not a number of flights"),
    ],
)
def test_a_wrong_design_table_is_reported(tmp_path, old, new, message):
    text = SCENARIO.read_text(encoding="utf-8")
    assert old in text
    (tmp_path / "wrong.toml").write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises(InputError, match=message.replace("[", r"\[").replace(".", r"\.")):
        load_scenario(tmp_path / "wrong.toml")


@pytest.mark.parametrize("path", sorted(SCENARIO.parent.glob("design_*.toml")), ids=lambda p: p.stem)
def test_a_shipped_design_is_checked_and_names_what_it_wants(path):
    assert Planner(load_scenario(path)).targets


@pytest.mark.thorough
def test_a_manoeuvre_near_the_end_of_a_steep_flight_is_designed(tmp_path):
    """Its start has the mesh of that flight, and an unknown skew leaves out its last samples."""
    arguments = ["design", str(inputs() / "before.toml"), "--evaluations", "2", "--quiet"]
    assert main([*arguments, "--out", str(tmp_path / "out")]) == 0
