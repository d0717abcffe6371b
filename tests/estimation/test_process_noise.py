"""Fits with noise of the process: output error without it, honest bounds where a model has it, and by command."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import matplotlib.image as mpl_image
import numpy as np
import pytest
from scipy.stats import binom, chi2

from benchmarks.process_noise import CASE, WANDERING, WHITE, bench_of, disturbed, measure_all
from sim_heating.base.errors import RunError
from sim_heating.base.files import read_csv_columns, read_json
from sim_heating.cli import main
from sim_heating.estimation.filter.innovations import Innovations, fit_innovations
from sim_heating.estimation.filter.process_noise import CORRELATION, NODE, RATIO, ProcessNoise
from sim_heating.estimation.filter.records import filtered_start
from sim_heating.estimation.fit import fit_bounds
from sim_heating.estimation.inference.newton import maximise
from sim_heating.estimation.problem import FitOptions, FitProblem, joint_reference
from sim_heating.inputs.record import Segments, write_record
from tests.support.estimator_cases import CASES, Repeatable, record_of, start_at

NAMES = (
    "ratio.scale", "ratio.d_alpha", "stack.coating.thickness_factor", "clock.skew", "sensor.V09T9527.bias",
    "sensor.V07T9528.gain",
)  # fmt: skip
RUNS = 16
RARE = 1e-3
"""Probability of a result outside its limits by chance."""


@pytest.fixture(scope="module")
def everything() -> FitProblem:
    """A parameter of every kind: heating, stack, clock, a sensor's bias and gain."""
    record = record_of(CASE)
    return FitProblem(
        [record], NAMES, joint_reference([record]), FitOptions(starts=[bench_of(CASE).problem.record_fits[0].start])
    )


@pytest.mark.thorough
def test_without_noise_of_the_process_it_is_output_error(everything: FitProblem) -> None:
    at = np.array([0.04, 4e-4, 1.1, 0.3, 0.5, 1.002])
    filtered, plain = Innovations(everything, ProcessNoise()).evaluate(at), everything.evaluate(at)
    assert filtered.log_likelihood == pytest.approx(plain.log_likelihood, rel=1e-10)
    np.testing.assert_allclose(filtered.information, plain.information, rtol=1e-6, atol=1e-6 * plain.information.max())
    sigma = 1.0 / np.sqrt(np.diag(plain.information))
    # over a tenth of a sigma to either side the log likelihood is no parabola to a thousandth: words of 5 K
    np.testing.assert_allclose(filtered.gradient * sigma, plain.gradient * sigma, rtol=2e-3, atol=1e-3)


@pytest.mark.thorough
def test_side_by_side_log_likelihoods_are_those_one_by_one(
    everything: FitProblem,
) -> None:
    at = np.array([0.04, 4e-4, 1.1, 0.3, 0.5, 1.002])
    scale = np.eye(len(at))[0]
    tried = np.array([at, at + 0.01 * scale, at - 40.0 * scale, *[at] * 7])
    innovations = Innovations(everything, WHITE)
    found = innovations.log_likelihoods(tried)
    assert np.isnan(found[2])
    with pytest.raises(RunError):
        innovations.samples(tried[2])
    for k in (0, 1, 9):
        assert found[k] == pytest.approx(innovations.evaluate(tried[k]).log_likelihood, rel=1e-12)


def test_records_that_are_fitted_together_add_their_log_likelihoods() -> None:
    one = record_of(CASE)
    other = replace(one, directory=Path("other"))
    start, at = bench_of(CASE).problem.record_fits[0].start, np.array([0.03])
    alone, both = (
        FitProblem(records, ["ratio.scale"], joint_reference([one]), FitOptions(starts=[start] * len(records)))
        for records in ([one], [one, other])
    )
    single, double = (Innovations(p, WANDERING).evaluate(at) for p in (alone, both))
    assert double.log_likelihood == pytest.approx(2.0 * single.log_likelihood, rel=1e-12)
    np.testing.assert_allclose(double.information, 2.0 * single.information, rtol=1e-12)


def test_a_start_by_the_filter_brings_its_own_uncertainty() -> None:
    record = record_of(CASE)
    part = bench_of(CASE).problem.record_fits[0]
    start = filtered_start(record, part.model, part.mesh, part.start.time_s)
    assert start.covariance_K2 is not None
    known, unknown = (
        Innovations(
            FitProblem([record], ["ratio.scale"], joint_reference([record]), FitOptions(starts=[s])), ProcessNoise()
        )
        for s in (replace(start, covariance_K2=None), start)
    )
    first = [[s.predicted_sigma_K[0] for s in i.samples(np.zeros(1))] for i in (known, unknown)]
    assert max(first[0]) < 1e-6
    assert first[1][0] > 0.2  # the outermost thermocouple follows a heating ratio that wanders
    assert min(first[1]) > 0.01


# Statistics ----------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module", params=["ratio", "nodes"])
def repetitions(request: pytest.FixtureRequest) -> dict[str, np.ndarray]:
    """Errors of scale and alpha derivative over the bounds stated, by output error and by the filter."""
    bench, rng = bench_of(CASE), np.random.default_rng(17)
    noise = {"ratio": WANDERING, "nodes": WHITE}[request.param]
    z: dict[str, list[np.ndarray]] = {"output error": [], "filter": []}
    inside, errors = [], {"output error": [], "filter": []}
    for true_K in disturbed(bench, noise, RUNS, rng)[0]:
        measure_all(bench.problem, true_K, rng)
        plain = maximise(bench.problem.evaluate, bench.problem.parameters, bench.truth, bench.problem.log_likelihoods)
        fit, innovations = fit_innovations(bench.problem, noise, plain.values)
        assert fit.converged
        for how, f in (("output error", plain), ("filter", fit)):
            z[how].append((f.values - bench.truth) / f.sigma)
            errors[how].append(f.values - bench.truth)
        bounds = fit_bounds(innovations.samples(fit.values), fit)
        inside.append(np.abs(fit.values - bench.truth) < bounds.half_width())
    rms = [np.sqrt(np.mean(np.square(errors[how]), axis=0)) for how in ("output error", "filter")]
    return {how: np.array(v) for how, v in z.items()} | {"inside": np.array(inside), "rms": np.array(rms)}


@pytest.mark.thorough
def test_bounds_of_output_error_are_too_narrow_where_the_model_has_noise(repetitions: dict[str, np.ndarray]) -> None:
    squares = np.sum(repetitions["output error"][:, 0] ** 2)
    assert chi2.sf(squares, RUNS) < 1e-9


@pytest.mark.thorough
def test_bounds_of_the_filter_are_the_scatter_of_its_estimates(repetitions: dict[str, np.ndarray]) -> None:
    squares = np.sum(repetitions["filter"] ** 2, axis=0)
    assert np.all(chi2.sf(squares, RUNS) > RARE)
    assert np.all(chi2.cdf(squares, RUNS) > RARE)
    low, high = binom.interval(1.0 - RARE, RUNS, 0.95)
    hits = np.sum(repetitions["inside"], axis=0)
    assert np.all((hits >= low) & (hits <= high))


@pytest.mark.thorough
def test_estimates_of_the_filter_are_nearer_the_truth(repetitions: dict[str, np.ndarray]) -> None:
    # of one parameter at least, the mean of a ratio that wanders passing for a scale whatever is fitted; to 0.70, 0.42
    # of output error's in 400 repetitions (`python -m benchmarks process_noise`), give or take a fifth in 16
    plain, filtered = repetitions["rms"]
    assert np.min(filtered / plain) < 0.9


@pytest.mark.thorough
@pytest.mark.parametrize(("noise", "levels"), [(WHITE, (NODE,)), (WANDERING, (RATIO, CORRELATION))])
def test_levels_of_noise_are_found_from_far_away(noise: ProcessNoise, levels: tuple[str, ...]) -> None:
    bench, rng, ratios = bench_of(CASE), np.random.default_rng(5), []
    unknown = replace(noise, **{name: 0.2 * getattr(noise, name) for name in levels[:1]}, estimated=levels)
    for true_K in disturbed(bench, noise, 3, rng)[0]:
        measure_all(bench.problem, true_K, rng)
        _, innovations = fit_innovations(bench.problem, unknown, bench.truth)
        ratios.append(getattr(innovations.levels.noise, levels[0]) / getattr(noise, levels[0]))
    assert 0.6 < np.exp(np.mean(np.log(ratios))) < 1.6


@pytest.mark.thorough
def test_no_noise_is_found_in_records_without_any() -> None:
    bench, rng, found = bench_of(CASE), np.random.default_rng(6), []
    quiet = ProcessNoise()
    for true_K in disturbed(bench, quiet, 4, rng)[0]:
        measure_all(bench.problem, true_K, rng)
        innovations = Innovations(bench.problem, ProcessNoise(node_K_sqrt_s=0.05, estimated=(NODE,)))
        innovations.estimate_levels(bench.truth)
        found.append(innovations.levels.noise.node_K_sqrt_s)
    assert np.median(found) < 0.05 * WHITE.node_K_sqrt_s


@pytest.mark.thorough
def test_undeclared_sensor_noise_is_found_alongside_that_of_the_process() -> None:
    bench, rng = bench_of(CASE), np.random.default_rng(8)
    measure_all(bench.problem, disturbed(bench, WHITE, 1, rng)[0][0], rng)
    part, record = bench.problem.record_fits[0], record_of(CASE)
    silent = [s.model_copy(update={"noise_sigma_K": None}) for s in record.sensors]
    thermocouples = record.declared.thermocouples.model_copy(update={"sensor": silent})
    unknown = replace(record, declared=record.declared.model_copy(update={"thermocouples": thermocouples}))
    problem = FitProblem([unknown], list(CASES[CASE].truth), bench.problem.reference, FitOptions(starts=[part.start]))
    own = problem.record_fits[0]
    own.channels = [replace(c, intervals=read.intervals) for c, read in zip(own.channels, part.channels, strict=True)]
    own.sigma_K = dict.fromkeys(own.sigma_K, 3.0)
    innovations = Innovations(problem, WHITE)
    innovations.estimate_levels(bench.truth)
    ratio = np.array([own.sigma_K[c.number] / c.sensor.noise_sigma_K for c in part.channels])
    assert 0.6 < np.exp(np.mean(np.log(ratio))) < 1.6


# By command ----------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def wandered(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, np.ndarray, np.ndarray]:
    """A record of a POPU whose heating ratio wanders; times [s] of the steps and what was added in each."""
    coarse, rng = record_of(CASE), np.random.default_rng(11)
    stack = coarse.declared.stack.model_copy(update={"nodes": None})  # as fine as the mesh that the command chooses
    record = replace(coarse, declared=coarse.declared.model_copy(update={"stack": stack}))
    case, about = CASES[CASE], joint_reference([coarse])
    problem = FitProblem([record], list(case.truth), about, FitOptions(starts=[start_at(case)]))
    part, bench = problem.record_fits[0], Repeatable(problem, np.array(list(case.truth.values())), {})
    true_K, added = (x[0] for x in disturbed(bench, WANDERING, 1, rng))
    measure_all(problem, true_K, rng)
    start = part.start.profile
    initial = {"initial": "profile", "initial_profile": np.column_stack([part.mesh.depth_m, start]).tolist()}
    columns = {"time_s": part.sample_s} | {
        c.sensor.column: 0.5 * (c.intervals.lower_K + c.intervals.upper_K) for c in part.channels
    }
    declared = record.declared.model_copy(update={"stack": stack.model_copy(update=initial), "segments": Segments()})
    flown = record.conditions.at(part.time_s)
    whole = replace(record, declared=declared, conditions=flown, thermocouples=columns, directory=Path("popu"))
    home = tmp_path_factory.mktemp("wandered") / "popu"
    write_record(whole, home)
    return home, part.time_s, added


@pytest.fixture(scope="module")
def fitted(wandered: tuple[Path, np.ndarray, np.ndarray], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What `estimate` writes where it is to find how the ratio wanders, some noise of the nodes being given."""
    out = tmp_path_factory.mktemp("fitted") / "fit"
    asked = ["--parameters", ",".join(CASES[CASE].truth), "--ratio-noise", "estimated", "--process-noise", "0.01"]
    assert main(["estimate", str(wandered[0]), *asked, "--out", str(out)]) == 0
    return out


@pytest.mark.thorough
def test_a_user_finds_the_noise_of_the_ratio(fitted: Path) -> None:
    found = read_json(fitted / "estimate.json")
    noise = found["process_noise"]
    assert noise["estimated"] == [RATIO, CORRELATION]
    assert noise[NODE] == 0.01
    assert 0.4 < noise[RATIO] / WANDERING.ratio_sigma < 2.5
    for name, true in CASES[CASE].truth.items():
        parameter = found["parameters"][name]
        assert abs(parameter["value"] - true) < 4.0 * parameter["sigma"]


@pytest.mark.thorough
def test_filter_finds_how_the_ratio_wandered_but_for_its_mean(wandered, fitted: Path) -> None:
    _, time_s, added = wandered
    history = read_csv_columns(fitted / "ratio_disturbance.csv", ["time_s", "delta_ratio", "sigma"])
    np.testing.assert_array_equal(history["time_s"], time_s)
    apart = (history["delta_ratio"][:-1] - added)[:-5]  # the last steps are hardly read
    assert np.std(apart) < 0.8 * np.std(added)  # words of 5 K contain no more of it


@pytest.mark.thorough
def test_a_priori_temperatures_miss_readings_more_than_a_posteriori_ones(wandered, fitted: Path) -> None:
    what = ("prior", "posterior", "smoothed")
    keys = [f"V09T9527_{w}{s}_K" for w in what for s in ("", "_sigma")]
    table = read_csv_columns(fitted / "filtered.csv", ["time_s", *keys])
    read = read_csv_columns(wandered[0] / "thermocouples.csv", ["time_s", "V09T9527_K"])["V09T9527_K"]
    off = [np.sqrt(np.mean((table[f"V09T9527_{w}_K"] - read) ** 2)) for w in what[:2]]
    assert off[1] < off[0]
    sure = [np.mean(table[f"V09T9527_{w}_sigma_K"]) for w in what]
    assert sure[2] < sure[1] < sure[0]
    picture = mpl_image.imread(fitted / "filtered.png")
    assert len(np.unique((picture[..., :3] * 255).astype(int).reshape(-1, 3), axis=0)) > 50


@pytest.mark.thorough
def test_minimised_error_is_that_of_a_priori_temperatures(wandered, fitted: Path):
    found = read_json(fitted / "estimate.json")
    sensors = ("V09T9527", "V07T9528", "V07T9529", "V07T9530", "V07T9531")
    prior = read_csv_columns(fitted / "filtered.csv", [f"{s}_prior_K" for s in sensors])
    read = read_csv_columns(wandered[0] / "thermocouples.csv", [f"{s}_K" for s in sensors])
    a_priori = np.sqrt(np.mean([(read[f"{s}_K"] - prior[f"{s}_prior_K"]) ** 2 for s in sensors]))
    innovations, plain = found["innovations"], found["fit"]
    # each is predicted from the readings of its own time as well that the filter took before it
    assert innovations["rmse_K"] == pytest.approx(a_priori, rel=0.05)
    assert innovations["normalised_rms"] == pytest.approx(1.0, abs=0.2)
    assert (innovations["n"], innovations["rmse_K"] < plain["rmse_K"]) == (plain["n"], True)


@pytest.mark.parametrize(
    ("options", "hint"),
    [
        (["--process-noise", "-1"], "give K/sqrt(s), as 0.2, or `estimated`"),
        (["--process-noise", "lots"], "give K/sqrt(s), as 0.2, or `estimated`"),
        (["--ratio-noise", "0.01"], "give sigma and correlation time in s, as 0.01,30, or `estimated`"),
        (["--ratio-noise", "0.01,0"], "give sigma and correlation time"),
        (["--ratio-noise", "0.01,nan"], "give sigma and correlation time"),
        (["--process-noise", "0.1", "--segments", "5"], "segments are fitted without process noise"),
    ],
)
def test_invalid_levels_are_refused_in_one_line(options, hint, wandered, tmp_path: Path, capsys) -> None:
    assert main(["estimate", str(wandered[0]), *options, "--out", str(tmp_path / "out")]) == 2
    assert hint in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
