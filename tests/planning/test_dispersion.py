"""Dispersed entries: designs, statistics with known answers, table errors, the whole chain against single flights."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import ndtr
from scipy.stats import kstest, sobol_indices

from sim_heating.base.errors import InputError
from sim_heating.heating.ratio.uncertainty import node_weights, prior_covariance
from sim_heating.inputs.points import conditions_at_point, conditions_behind_walls
from sim_heating.march.history import march_points
from sim_heating.planning.dispersion.entry import BATCH, DIFFERENCE, SOBOL, Batch, DispersedEntry
from sim_heating.planning.dispersion.flight import COMPLETED, LEFT_ATMOSPHERE, entry_with_deviations
from sim_heating.planning.dispersion.input_checks import check_inputs
from sim_heating.planning.dispersion.results import batches_of, evaluate, exact_slopes, notes_of
from sim_heating.planning.dispersion.spec import DispersedInput, Dispersion
from sim_heating.planning.dispersion.statistics import (
    AdditiveModel,
    additive_model,
    deviations,
    indices,
    probability,
    quantile,
    quantiles,
    random_rows,
    saltelli_rows,
    sobol_rows,
)
from sim_heating.planning.ratio_table_modes import table_factors, table_modes
from sim_heating.planning.soak import with_soak
from sim_heating.planning.study import load_study
from sim_heating.trajectory import entry3dof
from sim_heating.trajectory.flight import ROW, conditions_from_rows
from tests.support.paths import SCENARIOS
from tests.support.studies import entry_3dof

TOGETHER = 8
"""Flights that are marched together, one in each lane of a group."""

STUDY = """
format = "study/1"
title = "a few dispersed entries"
vehicle = "orbiter"
control_points = {names}
soak_s = 600.0
{entry}{limits}
[dispersion]
flights = {flights}
scrambles = 2
tables = {tables}
quantiles = [0.5, 0.9]
{more}
{inputs}
"""

THERMAL = """
[[dispersion.input]]
name = "stack.emissivity_factor"
sigma = 0.02
[[dispersion.input]]
name = "stack.rsi.conductivity_factor"
sigma = 0.05
control_points = ["V09T9527"]
"""

FLIGHT = """
[[dispersion.input]]
name = "entry.gamma_deg"
sigma = 0.02
[[dispersion.input]]
name = "air.density"
sigma = 1.0
over = [[0.0, 0.02], [80000.0, 0.08]]
[[dispersion.input]]
name = "air.wind_east_m_s"
low = -20.0
high = 20.0
over = [[0.0, 1.0], [90000.0, 1.0], [110000.0, 0.0]]
[[dispersion.input]]
name = "vehicle.mass_kg"
sigma = 400.0
"""


def study_of(tmp_path, inputs="", **given):
    flown = entry_3dof("mach = 2.5", **{k: given.pop(k) for k in ("altitude_m", "velocity_m_s") if k in given})
    names = '["NOSECAP", "V09T9527"]'
    keys = {"flights": 64, "tables": 0.0, "limits": "", "more": "", "names": names} | given
    path = tmp_path / "study.toml"
    path.write_text(STUDY.format(entry=flown, inputs=inputs, **keys))
    return load_study(path)


def entry_of(tmp_path, inputs="", **given):
    return DispersedEntry(study_of(tmp_path, inputs, **given))


def refusal(tmp_path, text):
    """The message for a study with this input."""
    with pytest.raises(InputError) as error:
        check_inputs(entry_of(tmp_path, f"[[dispersion.input]]\n{text}\n"))
    return str(error.value)


def dispersion_of(entry):
    """The result of all flights of a dispersion, flown in this process."""
    flown = {}
    for purpose, batches in batches_of(entry).items():
        parts = [entry.fly(b) for b in batches]
        flown[purpose] = {n: np.concatenate([p[n] for p in parts]) for n in parts[0]} if parts else {}
    return evaluate(entry, flown)


# Designs ------------------------------------------------------------------------------------------------------------


def test_a_batch_draws_its_own_part_of_the_sequence():
    whole = sobol_rows(7, 3, 1, 0, 256)
    parts = [sobol_rows(7, 3, 1, k, k + 64) for k in range(0, 256, 64)]
    np.testing.assert_array_equal(whole, np.vstack(parts))
    assert not np.array_equal(whole, sobol_rows(7, 3, 2, 0, 256))


def test_rows_are_standard_normal():
    for rows in (sobol_rows(3, 1, 0, 0, 1024), random_rows(3, 1, 0, 0, 1024)):
        assert all(kstest(column, "norm").pvalue > 1e-3 for column in rows.T)


def test_uniform_input_stays_within_its_ends_and_normal_has_its_sigma():
    inputs = [
        DispersedInput(name="entry.gamma_deg", low=-0.1, high=0.3),
        DispersedInput(name="vehicle.mass_kg", sigma=50.0),
    ]
    deviation = deviations(inputs, sobol_rows(2, 1, 0, 0, 1024))
    assert deviation[:, 0].min() >= -0.1
    assert deviation[:, 0].max() <= 0.3
    np.testing.assert_allclose(deviation.mean(axis=0), [0.1, 0.0], atol=0.5)
    np.testing.assert_allclose(deviation.std(axis=0), [i.standard_deviation for i in inputs], rtol=0.01)


def test_saltellis_design_swaps_one_group_and_comes_in_pieces():
    groups = [[0, 2], [1]]
    rows = saltelli_rows(groups, 1, 32, 0, 128)
    np.testing.assert_array_equal(rows, np.vstack([saltelli_rows(groups, 1, 32, k, k + 32) for k in range(0, 128, 32)]))
    A, B, first, second = rows.reshape(4, 32, 3)
    np.testing.assert_array_equal(first, np.column_stack([B[:, 0], A[:, 1], B[:, 2]]))
    np.testing.assert_array_equal(second, np.column_stack([A[:, 0], B[:, 1], A[:, 2]]))


# Statistics ---------------------------------------------------------------------------------------------------------


def test_bounds_of_a_quantile_hold_with_their_confidence():
    """Exponential values, 95 % bounds of the 0.9 quantile, 2000 samples of 200: within three binomial deviations."""
    rng, truth = np.random.default_rng(4), -np.log(0.1)
    covered = sum(
        low <= truth <= high for _, low, high in (quantile(rng.exponential(size=200), 0.9, 0.95) for _ in range(2000))
    )
    assert covered / 2000 > 0.95 - 3.0 * np.sqrt(0.95 * 0.05 / 2000)
    assert covered / 2000 < 0.99


def test_a_quantile_among_flights_that_were_not_completed_is_unknown():
    x = np.arange(100.0)
    x[:20] = np.nan
    value, low, high = quantile(x, 0.9, 0.95)
    assert (value, high) == (None, None)
    assert low is None
    assert quantile(x, 0.5, 0.95)[0] == 69.0


def test_too_few_flights_for_a_bound_have_none():
    assert quantile(np.arange(10.0), 0.99, 0.95)[2] is None


def test_no_event_in_n_flights_has_the_exact_upper_bound():
    estimate = probability(np.zeros(100, dtype=bool), 0.95)
    assert estimate.low == 0.0
    assert estimate.high == pytest.approx(1.0 - 0.025 ** (1.0 / 100.0), rel=1e-12)


def test_sobol_quantiles_scatter_less_than_random_ones():
    """A smooth function of six inputs: standard error between 16 scrambles against 16 independent samples."""
    scramble = np.repeat(np.arange(16), 256)

    def scatter(draw):
        x = np.concatenate([draw(6, 2, k, 0, 256) @ np.arange(1.0, 7.0) for k in range(16)])
        return quantiles(x, scramble, [0.5], 0.95)[0].scatter

    assert scatter(sobol_rows) < 0.5 * scatter(random_rows)


def test_ishigamis_function_has_its_known_indices():
    """f = sin x1 + 7 sin^2 x2 + 0.1 x3^4 sin x1 on [-pi, pi]^3; Ishigami and Homma (1990): S = 0.3139, 0.4424, 0,
    S_T = 0.5576, 0.4424, 0.2437."""
    groups = [[0], [1], [2]]
    rows = saltelli_rows(groups, 1, 4096, 0, 5 * 4096)
    x = (2.0 * ndtr(rows) - 1.0) * np.pi
    f = np.sin(x[:, 0]) + 7.0 * np.sin(x[:, 1]) ** 2 + 0.1 * x[:, 2] ** 4 * np.sin(x[:, 0])
    nothing = AdditiveModel(np.zeros((0, 3)))
    estimate = indices(f, groups, 0.95, 1, rows, nothing)
    np.testing.assert_allclose(estimate.first, [0.3139, 0.4424, 0.0], atol=0.02)
    np.testing.assert_allclose(estimate.total, [0.5576, 0.4424, 0.2437], atol=0.01)
    assert np.all((estimate.total_bounds[:, 0] < estimate.total) & (estimate.total < estimate.total_bounds[:, 1]))
    blocks = f.reshape(5, -1)
    other = sobol_indices(func={"f_A": blocks[:1], "f_B": blocks[1:2], "f_AB": blocks[2:, np.newaxis]}, n=4096)
    np.testing.assert_allclose(estimate.first, np.ravel(other.first_order), atol=2e-3)
    np.testing.assert_allclose(estimate.total, np.ravel(other.total_order), rtol=1e-3)


def test_sixteen_index_flights_suffice_where_other_flights_explain_most():
    """f = 3 z1 + z2 + z2^2 + z1 z3/10: variances 9, 1 + 2 and 0, and 0.01 of the first and third together."""

    def f(z):
        return 3.0 * z[:, 0] + z[:, 1] + z[:, 1] ** 2 + 0.1 * z[:, 0] * z[:, 2]

    groups, main = [[0], [1], [2]], sobol_rows(3, 5, 0, 0, 64)
    rows = saltelli_rows(groups, 5, 16, 0, 5 * 16)
    alone = indices(f(rows), groups, 0.95, 1, rows, AdditiveModel(np.zeros((0, 3))))
    helped = indices(f(rows), groups, 0.95, 1, rows, additive_model(main, f(main), np.zeros(3)))
    V = 12.01
    np.testing.assert_allclose(helped.first, np.array([9.0, 3.0, 0.0]) / V, atol=0.02)
    np.testing.assert_allclose(helped.total, np.array([9.01, 3.0, 0.01]) / V, atol=0.02)
    assert np.max(np.ptp(helped.total_bounds, axis=1)) < 0.2 * np.max(np.ptp(alone.total_bounds, axis=1))


# Errors of ratio tables ---------------------------------------------------------------------------------------------


def test_modes_give_the_covariance_that_sigma_and_reach_state(tmp_path):
    entry = entry_of(tmp_path, tables=1.0)
    point = entry.points[1].point
    rows = entry.planned.rows[0, : entry.planned.frame_counts[0]]
    path = conditions_from_rows(rows, 32.77362)
    x = np.stack([path[v] for v in ("alpha_deg", "beta_deg", "log10_re", "elevon_deg", "bodyflap_deg")], axis=1)
    W = node_weights(point.ratio.axes, x)
    modes = table_modes(entry.study.vehicle, point.name, x)
    nodes = np.arange(point.ratio.ratio.size)
    mean = point.ratio.ratio.ravel()
    G = np.log1p(prior_covariance(point.ratio, nodes, nodes) / np.outer(mean, mean))
    wanted = W @ G @ W.T
    np.testing.assert_allclose(np.asarray(W @ (modes @ modes.T) @ W.T), wanted, atol=0.01 * wanted.max())


@pytest.mark.thorough
def test_dispersed_tables_keep_mean_and_sigma_where_it_is_flown(tmp_path):
    entry = entry_of(tmp_path, tables=1.0)
    table, modes = entry.points[1].point.ratio, entry.modes[1]
    factors = table_factors(modes, random_rows(modes.shape[1], 1, 0, 0, 20000))
    node = int(
        np.ravel_multi_index(
            [np.searchsorted(table.axes[0], 40.0), len(table.axes[1]) // 2, 2, 0, 0], table.ratio.shape
        )
    )
    drawn = table.ratio.ravel()[node] * factors[node]
    assert np.all(factors > 0.0)
    assert drawn.mean() == pytest.approx(table.ratio.ravel()[node], rel=0.01)
    assert drawn.std() == pytest.approx(table.sigma.ravel()[node], rel=0.05)


# The chain ----------------------------------------------------------------------------------------------------------


def test_a_dispersed_flight_is_the_built_in_entry_bit_for_bit(tmp_path):
    entry = entry_of(tmp_path, FLIGHT, more="step_s = 0.25\nthermal_step_s = 1.0")
    changes = entry.flight_deviations(np.array([0.03, 1.0, 12.0, -300.0]))
    spec = entry_with_deviations(entry.sampler.base, entry.inputs, changes)
    flown = entry.sampler.fly(entry.inputs, [{}, changes])
    own = entry3dof.fly(spec, entry.study.vehicle).conditions
    count = min(len(own), flown.frame_counts[1])
    for name in ("altitude_m", "velocity_m_s", "alpha_deg", "elevon_deg", "rho_kg_m3", "gamma_deg"):
        np.testing.assert_array_equal(flown.rows[1, :count, ROW.index(name)], own[name][:count])


@pytest.mark.thorough
def test_peaks_are_those_of_the_programs_march_along_the_same_flight(tmp_path):
    """One step a sample on the same meshes; the soak in longer steps: 0.05 K."""
    entry = entry_of(tmp_path, FLIGHT + THERMAL)
    z = sobol_rows(entry.dimensions, 1, 0, 0, TOGETHER)
    deviation = deviations(entry.inputs, z)
    flown = entry.sampler.fly(entry.inputs, [entry.flight_deviations(row) for row in deviation])
    peaks = entry.march(flown, deviation, z)
    for i in (0, 5):
        conditions = conditions_from_rows(flown.rows[i, : flown.frame_counts[i]], 32.77362)
        for p, limited in enumerate(entry.points):
            factors = {"stack.emissivity_factor": 1.0 + deviation[i, 4]}
            factors |= {"stack.rsi.conductivity_factor": 1.0 + deviation[i, 5]} if p == 1 else {}
            model = replace(entry.lanes.models[p], parameters=factors, nodes=entry.meshes[p].nodes)
            along = with_soak(conditions_at_point(entry.study.vehicle, limited.point, conditions), 600.0)
            history = march_points([model], [along], longest_step_s=4.0)[0]
            assert peaks.surface_K[i, p] == pytest.approx(history.surface_K.max(), abs=0.05)
            assert peaks.bondline_K[i, p] == pytest.approx(history.bondline_K.max(), abs=0.05)


CAP = '[[dispersion.input]]\nname = "stack.emissivity_factor"\nsigma = 0.1\ncontrol_points = ["NOSECAP"]\n'


@pytest.mark.parametrize("points", ['["NOSE_HRSI"]', '["NOSE_HRSI", "NOSECAP"]'])
def test_a_tile_behind_the_nose_cap_is_heated_as_run_has_it(tmp_path, points):
    """The cap upstream of the interface is marched first, whether it is a point of the study or not."""
    has_cap = "NOSECAP" in points
    entry = entry_of(tmp_path, CAP if has_cap else "", names=points)
    z = np.linspace(-1.0, 1.0, TOGETHER)[:, np.newaxis] * np.ones((1, entry.dimensions))
    peaks = entry.march(entry.planned, deviations(entry.inputs, z), z)
    vehicle, (tile, *_) = entry.study.vehicle, entry.points
    flown = conditions_from_rows(entry.planned.rows[0, : entry.planned.frame_counts[0]], vehicle.reference_length_m)
    model = replace(entry.lanes.models[0], nodes=entry.meshes[0].nodes)
    at_walls = [
        conditions_behind_walls(vehicle, [tile.point], flown)[0],
        conditions_at_point(vehicle, tile.point, flown),
    ]
    behind, alone = (march_points([model], [c], longest_step_s=4.0)[0].surface_K.max() for c in at_walls)
    assert entry.planned_peaks[0, 0, 0] == pytest.approx(behind, abs=0.1)
    assert behind > alone + 1.0
    # A cap that radiates more is colder, and the layer that it leaves heats the tile less.
    of_tile = peaks.surface_K[:, 0]
    assert np.all(np.diff(of_tile) < 0.0) if has_cap else np.ptp(of_tile) == 0.0


TRANSITION = """
[[effect]]
name = "transition"
control_points = ["V09T9527"]
parameters = { log10_re_onset = 6.0, factor = 2.0 }
"""
ONSET = '[[dispersion.input]]\nname = "effect.transition.log10_re_onset"\nsigma = 0.1\ncontrol_points = ["V09T9527"]\n'


@pytest.mark.thorough
def test_a_dispersed_onset_of_transition_is_that_of_the_effect(tmp_path):
    entry = entry_of(tmp_path, ONSET, limits=TRANSITION)
    z = np.linspace(-2.0, 2.0, TOGETHER)[:, np.newaxis]
    deviation = deviations(entry.inputs, z)
    peaks = entry.march(entry.planned, deviation, z)
    conditions = conditions_from_rows(entry.planned.rows[0, : entry.planned.frame_counts[0]], 32.77362)
    point = entry.points[1].point
    along = with_soak(conditions_at_point(entry.study.vehicle, point, conditions), 600.0)
    for i in (0, TOGETHER - 1):
        onset = {"effect.transition.log10_re_onset": 6.0 + deviation[i, 0]}
        model = replace(entry.lanes.models[1].with_parameters(onset), nodes=entry.meshes[1].nodes)
        history = march_points([model], [along], longest_step_s=4.0)[0]
        assert peaks.surface_K[i, 1] == pytest.approx(history.surface_K.max(), abs=0.05)
    assert peaks.surface_K[0, 1] > peaks.surface_K[-1, 1] + 20.0
    np.testing.assert_allclose(peaks.surface_K[:, 0], peaks.surface_K[0, 0], rtol=1e-12)


@pytest.mark.thorough
def test_a_flight_is_the_same_whatever_flew_before_it(tmp_path):
    entry, fresh = (entry_of(tmp_path, FLIGHT + THERMAL, tables=1.0) for _ in range(2))
    entry.fly(Batch(SOBOL, 0, BATCH, 1))
    batch = Batch(SOBOL, 0, 16)
    assert entry(batch) == fresh(batch)


@pytest.mark.thorough
def test_flights_that_skip_out_count_as_above_every_limit(tmp_path):
    entry = entry_of(tmp_path, '[[dispersion.input]]\nname = "entry.velocity_m_s"\nlow = 0.0\nhigh = 300.0\n')
    result = dispersion_of(entry)
    gone = result.columns["outcome"] == LEFT_ATMOSPHERE
    assert 0 < gone.sum() < len(gone)
    assert result.completed.count == np.sum(result.columns["outcome"] == COMPLETED)
    assert all(a.exceeded is None or a.exceeded.count >= gone.sum() for a in result.peaks)
    assert any("were not completed" in line for line in notes_of(result))


# What a study reports -----------------------------------------------------------------------------------------------


@pytest.mark.thorough
def test_first_order_holds_where_small_thermal_inputs_alone_are_dispersed(tmp_path):
    result = dispersion_of(entry_of(tmp_path, THERMAL, flights=256))
    for peak in result.peaks:
        assert peak.first["holds"], peak
        assert peak.first["sigma_K"] == pytest.approx(peak.sigma_K, rel=0.06)


def test_exact_slopes_are_those_of_differences(tmp_path):
    """Linear march against central differences of 0.1 sigma, 0.1 % of the largest of a peak."""
    entry = entry_of(tmp_path, THERMAL)
    z = np.zeros((TOGETHER, entry.dimensions))
    for k in range(2):
        z[2 * k, k], z[2 * k + 1, k] = DIFFERENCE, -DIFFERENCE
    deviation = deviations(entry.inputs, z)
    flown = entry.sampler.fly(entry.inputs, [{}] * TOGETHER)
    peaks = entry.march(flown, deviation, z)
    T = np.array([peaks.surface_K, peaks.bondline_K])
    for quantity, point, k, slope in exact_slopes(entry):
        difference = T[quantity, 2 * k, point] - T[quantity, 2 * k + 1, point]
        assert slope == pytest.approx(difference / (deviation[2 * k, k] - deviation[2 * k + 1, k]), rel=1e-3)


@pytest.mark.thorough
def test_a_limit_that_every_flight_exceeds_is_reported_in_one_line(tmp_path):
    limits = '[[limit]]\ncontrol_point = "NOSECAP"\nsurface_K = 1200.0\n'
    result = dispersion_of(entry_of(tmp_path, THERMAL, limits=limits))
    lines = [line for line in notes_of(result) if "every flight exceeds" in line]
    assert len(lines) == 1
    assert "NOSECAP: every flight exceeds the limit of 1200 K at its surface; the lowest peak is 1" in lines[0]
    assert result.within_limits.count == 0


@pytest.mark.thorough
def test_flights_outside_the_tables_do_not_count_as_within_the_limits(tmp_path):
    """From 130 km, log10 Re begins below 2, the lower end of the tables."""
    limits = '[[limit]]\ncontrol_point = "NOSECAP"\nsurface_K = 3000.0\n'
    result = dispersion_of(entry_of(tmp_path, THERMAL, altitude_m=130e3, limits=limits))
    assert result.within_limits.value == 1.0
    assert result.within_limits_and_data.value == 0.0
    worst = max(result.excursions, key=lambda o: o.farthest)
    assert (worst.variable, worst.flights) == ("log10_re", 64)
    assert worst.farthest == pytest.approx(2.0 - result.columns["least.log10_re"].min())
    assert any("log10_re lies outside" in line and "do not count as within" in line for line in notes_of(result))


@pytest.mark.thorough
def test_trim_beyond_the_elevon_travel_does_not_count_as_within_limits(tmp_path):
    """The most forward centre of gravity of the aerodynamics, with the body flap fully down."""
    limits = "[trajectory.vehicle]\ncg_fraction = 0.65\nbodyflap_deg = [[0.0, 22.5]]\n"
    limits += '[[limit]]\ncontrol_point = "NOSECAP"\nsurface_K = 3000.0\n'
    result = dispersion_of(entry_of(tmp_path, THERMAL, limits=limits, flights=16))
    assert result.within_limits.value == 1.0
    assert result.within_limits_and_data.value == 0.0
    lines = [line for line in notes_of(result) if line.startswith("trim:")]
    assert len(lines) == 1
    assert f"in 16 of 16 flights, for {result.columns['end_s'][0] + 0.5:.0f} s at most" in lines[0]


def test_a_vehicle_without_an_elevon_is_in_trim(tmp_path):
    """A capsule trims by its centre of gravity: there is no travel to be at an end of."""
    path = tmp_path / "study.toml"
    path.write_text(
        'format = "study/1"\ntitle = "capsule"\nvehicle = "capsule"\ncontrol_points = ["HOT_SKIN"]\nsoak_s = 0.0\n'
        f"{entry_3dof('mach = 20.0')}[dispersion]\nflights = 16\nscrambles = 2\nseed = 1\nindex_flights = 0\n"
        '[[dispersion.input]]\nname = "entry.gamma_deg"\nsigma = 0.02\n'
    )
    entry = DispersedEntry(load_study(path))
    first = next(iter(batches_of(entry).values()))[0]
    assert not entry.fly(first)["untrimmed_s"].any()


@pytest.mark.sample(3)
@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('name = "vehicle.cg_fraction"\nsigma = 0.01', "outside 0.65 to 0.675"),
        ('name = "air.density"\nsigma = 1.0\nover = [[0.0, 0.5]]', "makes a factor of"),
        ('name = "stack.emissivity_factor"\nsigma = 0.4', "leaves 0 to 1.5"),
        ('name = "ratio.d_alpha"\nsigma = 0.4', "the sigma of the ratio tables states their error"),
        ('name = "effect.transition.log10_re_onset"\nsigma = 0.1', "unknown parameter"),
        ('name = "stack.emissivity_factor"\nsigma = 0.01\ncontrol_points = ["WING_LE"]', "not among the study's"),
    ],
)
def test_impossible_inputs_are_refused_before_any_flight(tmp_path, text, message):
    refused = refusal(tmp_path, text)
    assert message in refused
    assert "input 1" in refused


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('name = "entry.gamma_deg"', "give sigma, or low and high"),
        ('name = "entry.gama_deg"\nsigma = 0.1', "there is no input `entry.gama_deg`; did you mean `entry.gamma_deg`"),
        ('name = "stack.emisivity_factor"\nsigma = 0.1', "did you mean `stack.emissivity_factor`"),
        ('name = "air.density"\nsigma = 1.0', "give `over`"),
        ('name = "entry.gamma_deg"\nsigma = 1.0\nover = [[0.0, 1.0]]', "is only for air.density"),
        ('name = "entry.gamma_deg"\nsigma = 1.0\ncontrol_points = ["NOSECAP"]', "changes the flight"),
    ],
)
def test_an_input_that_is_declared_wrongly_is_refused_with_its_place(tmp_path, text, message):
    refused = refusal(tmp_path, text)
    assert message in refused
    assert "[dispersion.input]" in refused


def test_every_input_is_described_with_its_size_and_unit(tmp_path):
    wave = '[[dispersion.input]]\nname = "air.density"\nsigma = 2.0\nover = [[0.0, 0.0], [60000.0, -0.04]]\n{}'
    entry = entry_of(tmp_path, FLIGHT + wave.format('title = "a wave"\n') + THERMAL, tables=1.0)
    assert entry.group_descriptions == [
        ("path angle at entry", "sigma 0.02 deg"),
        ("density, relative (profile 1)", "sigma 0.08 at most"),
        ("wind to the east", "-20 to 20 m/s at most"),
        ("mass", "sigma 400 kg"),
        ("density, relative (a wave)", "sigma 0.08 at most"),
        ("stack.emissivity_factor", "sigma 0.02"),
        ("stack.rsi.conductivity_factor", "sigma 0.05"),
        ("ratio tables", "their own sigma"),
    ]
    assert len(entry.group_descriptions) == len(entry.groups)


@pytest.mark.thorough
@pytest.mark.parametrize("path", sorted((SCENARIOS / "studies").glob("dispersed_*.toml")), ids=lambda p: p.stem)
def test_shipped_dispersions_can_be_flown(path):
    entry = DispersedEntry(load_study(path))
    check_inputs(entry)
    assert entry.dimensions > len(entry.inputs)


def test_a_list_of_very_many_inputs_is_refused():
    one = {"name": "entry.gamma_deg", "sigma": 0.02}
    assert len(Dispersion(input=[one] * 256).input) == 256
    with pytest.raises(ValueError, match="at most 256"):
        Dispersion(input=[one] * 257)
