"""Sensitivities of the march, every parameter there is, against differences of the march itself over a whole POPU.

Differences are central and of fourth order, with a step that moves temperatures by STEP_K: the march's own iteration
leaves 1e-8 K, the fifth derivative less than that, so that ten digits less a few remain. Properties are linear over all
temperatures met: a kink of a table has no derivative.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache, partial
from itertools import pairwise

import numpy as np
import pytest

from sim_heating.base.errors import InputError, RunError
from sim_heating.base.files import check
from sim_heating.base.kernels.block import LANES
from sim_heating.base.parameters import EFFECT_PREFIX, RATIO, STACK
from sim_heating.estimation.problem import FitOptions, FitProblem, joint_reference
from sim_heating.estimation.starts import profile_start
from sim_heating.heating.effects import effects, use
from sim_heating.heating.ratio.table import RatioTable
from sim_heating.inputs.record import Record, RecordFile, in_segments
from sim_heating.march.linearised import LinearMarch, Track
from sim_heating.march.mesh_choice import choose_meshes
from sim_heating.march.point import PointModel
from sim_heating.thermal.stack import Material
from tests.support.walls import flight, practice_record, wall

RELATIVE = 1e-6
"""Largest error of a sensitivity over the largest sensitivity of that sensor."""
STEP_K = 1.0
PARTS = (1.0, 0.3, 0.1, 0.03, 0.01, 0.003)
WEIGHTS = {1.0: 8.0 / 12.0, -1.0: -8.0 / 12.0, 2.0: -1.0 / 12.0, -2.0: 1.0 / 12.0}
"""f' h = (8 f(h) - 8 f(-h) - f(2h) + f(-2h)) / 12 + O(h^5)."""

TIME_S = np.arange(0.0, 81.0)
SAMPLE_S = np.concatenate(([0.0], np.arange(0.37, 79.0, 1.3), [80.0]))
"""The first and the last instant, and places all over the steps between."""


def popu(column: str) -> np.ndarray:
    """One doublet of alpha, elevon trimmed to it; all else moves as well, so that every derivative shows."""
    t = TIME_S
    doublet = np.where((t > 20.0) & (t < 60.0), np.sin(2.0 * np.pi * (t - 20.0) / 40.0), 0.0)
    columns = {
        "alpha_deg": 40.0 + 5.0 * doublet,
        "beta_deg": 0.7 + 0.5 * np.sin(t / 7.0),
        "log10_re": 6.3 + 0.005 * t,
        "elevon_deg": 2.0 - 2.0 * np.roll(doublet, 2),
        "bodyflap_deg": 7.0 + 3.0 * np.cos(t / 9.0),
        "h_ref_kg_m2_s": 0.10 + 2e-4 * t,
        "H_r_J_kg": 2.4e7 - 2e4 * t,
        "p_surface_Pa": 2000.0 + 10.0 * t,
        "dissociation_J_kg": 8e6 - 1e4 * t,
        "jets": 1.0 * (np.abs(doublet) > 0.9),
    }
    return columns[column]


COLUMNS = (
    "alpha_deg", "beta_deg", "log10_re", "elevon_deg", "bodyflap_deg", "h_ref_kg_m2_s", "H_r_J_kg", "p_surface_Pa",
    "dissociation_J_kg", "jets",
)  # fmt: skip
BASE = {
    "stack.moisture.latent_J_kg": 5e4, "stack.moisture.boil_K": 800.0, "stack.moisture.deposit_J_kg": 2e4,
    "stack.moisture.condense_K": 700.0, "stack.moisture.width_K": 60.0, "stack.moisture.vapour_W_m": 5.0,
    "stack.gap.fraction": 0.05, "stack.rsi.conductivity_slope": 2e-4, "stack.rsi.conductivity_decade": 0.05,
    "stack.rsi.heat_capacity_slope": -1e-4,
    "stack.rsi.radiative_conductivity": 0.03, "stack.rsi.radiation_from_K": 500.0, "back.h_W_m2K": 12.0,
    "back.T_K": 310.0, "back.emissivity": 0.4,
}  # fmt: skip
"""Values at which every parameter of the stack has something to act on."""
VALUES = {
    "transition": {"log10_re_onset": 6.5, "alpha_sens": 0.02, "width": 0.08, "factor": 1.5, "hysteresis": 0.03},
    "impingement-onset": {"alpha_onset_deg": 37.1, "slope": 2e-3, "saturation": 0.2},
    "emissivity": {"emissivity_factor": 0.9, "change_s": 31.0, "emissivity_slope": 5e-5},
    "nonisothermal-wall": {"decay_begin_s": 30.3},
    "sideslip": {"slope_abs_beta": 2e-3},
    "catalysis": {"flow_step": 0.1, "flow_J_kg": 1.9e7, "fall_fraction": 0.5, "fall_K": 1200.0},
    "added-curve": {"variable": 3.0, "low": 3.0, "high": 11.0, "s_2": 0.01, "s_4": 0.005, "s_7": -0.01},
    "curve": {"variable": 3.0, "low": 3.0, "high": 11.0, "s_1": 0.1, "s_2": -0.1, "s_4": 0.05, "s_6": 0.1, "s_7": 0.2},
}
"""Values at which an effect acts during the POPU; else its nominal ones."""


def material(k_300: float, k_1800: float, rho: float, emissivity: float) -> Material:
    """A material with straight properties from 200 to 1800 K."""
    return Material(
        density_kg_m3=rho,
        emissivity=[[200.0, emissivity], [1800.0, emissivity - 0.05]],
        specific_heat_J_kgK=[[200.0, 700.0], [1800.0, 1500.0]],
        conductivity_W_mK=[[200.0, k_300], [1800.0, k_1800]],
    )


@cache
def point(*used: str) -> PointModel:
    """A tile with a contact resistance under its coating, on a cooled skin; dry and without gaps where it has effects:
    heat along a gap takes the film of the surface at the start of a step, and a catalytic film changes within it."""
    coating, rsi = material(0.8, 1.7, 1666.0, 0.85), material(0.02, 0.2, 144.0, 0.85)
    skin = material(120.0, 180.0, 2770.0, 0.85)
    profile = [[0.0, 1150.0], [0.0004, 1140.0], [0.004, 950.0], [0.012, 600.0], [0.0424, 320.0], [0.0454, 320.0]]
    construction = wall(
        (coating, 0.0004), (rsi, 0.042), (skin, 0.003), contact=2e-4,
        initial="profile", initial_profile=profile, initial_K=None,
    )  # fmt: skip
    axes = (np.array([20.0, 60.0]), *(np.array([0.0]) for _ in range(4)))
    table = RatioTable(axes, np.array([0.03, 0.07]).reshape(2, 1, 1, 1, 1))
    chosen = tuple(use(name, VALUES.get(name)) for name in used)
    reference = (40.2, 0.1, 6.4, 2.0, 7.0)
    return PointModel(
        "p", construction, (0.0004, 0.006, 0.0424), table, parameters={} if used else BASE, reference=reference,
        effects=chosen,
    )  # fmt: skip


def marched(models: Sequence[PointModel], names: tuple[str, ...] = ()) -> list:
    """Up to LANES models along the POPU at SAMPLE_S."""
    mesh = choose_meshes([models[0]])[0][0]
    tracks = [Track(model, mesh, names, SAMPLE_S) for model in models]
    return LinearMarch(tracks, TIME_S, flight(TIME_S, **{c: popu(c) for c in COLUMNS})).march()


def errors(sensitivity: np.ndarray, differences: np.ndarray) -> float:
    """Largest error over the samples of (sensor, sample), over the largest value of the parameter at that sensor."""
    largest = np.max(np.abs(differences), axis=1)
    significant = largest > 1e-2 * np.max(largest)  # a sensor that hardly depends on the parameter has no digits left
    return float(np.max((np.max(np.abs(sensitivity - differences), axis=1) / largest)[significant]))


def differences(model: PointModel, steps: dict[str, float]) -> dict[str, np.ndarray]:
    """(sensor, sample) difference of fourth order against each parameter, perturbed by these steps."""
    shifted = [(n, at) for n in steps for at in WEIGHTS]
    found = []
    for k in range(0, len(shifted), LANES):
        found += marched(
            [model.with_parameters({n: model.value(n) + at * steps[n]}) for n, at in shifted[k : k + LANES]]
        )
    result = {n: np.zeros(found[0].temperature_K.shape) for n in steps}
    for (n, at), run in zip(shifted, found, strict=True):
        result[n] += WEIGHTS[at] * run.temperature_K / steps[n]
    return result


def worst(model: PointModel, names: Sequence[str]) -> dict[str, float]:
    """Error of the sensitivities to each parameter, against the differences that agree best with the next."""
    exact = marched([model], tuple(names))[0].sensitivity
    sigma = {n: model.definition(n).sigma for n in names}
    scale = {n: min(s, max(abs(model.value(n)), 1.0)) if model.value(n) else s for n, s in sigma.items()}
    first = {n: min(STEP_K / np.max(np.abs(exact[..., k])), 0.1 * scale[n]) for k, n in enumerate(names)}
    tried = [differences(model, {n: step * part for n, step in first.items()}) for part in PARTS]
    result = {}
    for k, n in enumerate(names):
        changes = [errors(b[n], a[n]) for a, b in pairwise(tried)]
        result[n] = errors(exact[..., k], tried[int(np.argmin(changes)) + 1][n])
    return result


def assert_exact(found: dict[str, float]) -> None:
    assert {name: error for name, error in found.items() if not error < RELATIVE} == {}


def test_derivatives_of_first_and_second_order_of_the_heating_ratio_are_exact():
    assert_exact(worst(point(), [p.name for p in RATIO]))


def test_sensitivities_to_stack_contact_and_back_face_are_exact():
    assert_exact(worst(point(), [p.name for p in STACK]))


def test_sensitivities_to_layers_by_their_own_names_are_exact():
    assert_exact(worst(point(), [p.name for _, p in point().layer_parameters]))


@pytest.mark.parametrize("name", [e.name for e in effects().values() if e.kernel is not None])
def test_sensitivities_to_every_effect_and_the_ratio_that_it_acts_on_are_exact(name):
    wanted = [f"{EFFECT_PREFIX}{name}.{p.name}" for p in effects()[name].parameters if p.sigma > 0.0]
    assert_exact(worst(point(name), [*wanted, "ratio.scale", "ratio.d_alpha", "ratio.d_alpha_logre"]))


@pytest.mark.parametrize("used", [(), ("recombination",)])
def test_the_sensitivity_to_an_error_of_the_table_that_is_the_table_is_that_to_the_scale(used):
    model = point(*used)
    assert model.ratio is not None
    mesh = choose_meshes([model])[0][0]
    track = Track(model, mesh, ("ratio.scale",), SAMPLE_S, table_errors=(model.ratio.ratio,))
    found = LinearMarch([track], TIME_S, flight(TIME_S, **{c: popu(c) for c in COLUMNS})).march()[0].sensitivity
    assert errors(found[..., 1], found[..., 0]) < 0.1 * RELATIVE


def test_a_gap_that_opens_between_two_marches_takes_heat_in_the_second():
    closed = point().with_parameters({"stack.gap.fraction": 0.0})
    names = ("ratio.scale", "stack.emissivity_factor", "stack.gap.fraction", "stack.contact_factor")
    mesh = choose_meshes([closed])[0][0]
    march = LinearMarch([Track(closed, mesh, names, SAMPLE_S)], TIME_S, flight(TIME_S, **{c: popu(c) for c in COLUMNS}))
    march.march()
    march.set_models([point()])
    found, again = march.march()[0], marched([point()], names)[0]
    assert np.array_equal(found.temperature_K, again.temperature_K)
    assert errors(found.sensitivity[..., 0], again.sensitivity[..., 0]) < 1e-12
    assert np.allclose(found.sensitivity, again.sensitivity, rtol=1e-9, atol=1e-9 * np.max(np.abs(again.sensitivity)))


ABSENT = dict.fromkeys(
    ["stack.moisture.latent_J_kg", "stack.moisture.deposit_J_kg", "stack.moisture.vapour_W_m", "stack.gap.fraction",
     "stack.rsi.radiative_conductivity"], 0.0
)  # fmt: skip
"""What a dry, dense wall without gaps has none of."""


def test_sensitivities_to_what_a_wall_has_none_of_are_exact():
    # one side of their perturbations is below 0
    assert_exact(worst(point().with_parameters(ABSENT), [*ABSENT]))


@pytest.mark.parametrize(
    ("name", "values"),
    [("moisture", {"latent_J_kg": 0.0, "condense_K": 700.0}), ("gap-flow", {"gap_fraction": 0.0})],
)
def test_sensitivities_to_what_a_wall_has_none_of_are_the_same_bits_beside_others(name, values):
    bare = replace(point().with_parameters(ABSENT), effects=(use(name, values),))
    own = [f"{EFFECT_PREFIX}{name}.{p}" for p in ("latent_J_kg", "deposit_J_kg", "gap_fraction")]
    for wanted in (n for n in own if n.rpartition(".")[2] in {p.name for p in bare.effects[0].effect.parameters}):
        alone = marched([bare], (wanted,))[0].sensitivity
        # of nine perturbed lanes, three a track, the last one is in a group without that of the other side
        assert all(np.array_equal(run.sensitivity, alone) for run in marched([bare] * 3, (wanted,)))


# Clocks, sensors and starts: through the fit's own problem ----------------------------------------------------------

POPU_S = (690.0, 730.0)
SENSORS = {"calibration": [3.0, 0.97, 2e-5], "bits": None, "range_K": None}


@cache
def recorded() -> Record:
    """A practice flight whose clock sits between the conditions' samples, its calibration curved."""
    record = practice_record("p06")[0]
    data = record.declared.model_dump(exclude_unset=True)
    for sensor in data["thermocouples"]["sensor"]:
        sensor.update(SENSORS)
    columns = {k: v for k, v in record.thermocouples.items() if k != "time_s"}
    return replace(
        record, declared=check(data, RecordFile, "record"), thermocouples={"time_s": record.time_s + 0.29, **columns}
    )


def problem(names: Sequence[str]) -> FitProblem:
    """The Mach-20 POPU of that flight from an estimated profile 20 s before it."""
    record = recorded()
    chosen = in_segments(record.time_s, [POPU_S])
    start = partial(profile_start, time_s=POPU_S[0] - 20.0)
    return FitProblem([record], names, joint_reference([record]), FitOptions(starts=[start], sample_masks=[chosen]))


def test_sensitivities_to_clock_skew_bias_gain_and_initial_profile_are_exact():
    names = ["clock.skew"] + [f"sensor.{s.name}.{what}" for s in recorded().sensors for what in ("bias", "gain")]
    fit = problem(names)
    at = np.array([p.value for p in fit.parameters])
    at[[u.label == "clock.skew" for u in fit.unknowns]] = 0.17
    steps = [0.01 if u.label == "clock.skew" else 1e-3 * u.parameter.sigma for u in fit.unknowns]
    exact = fit.samples(at)
    for k, (step, unknown) in enumerate(zip(steps, fit.unknowns, strict=True)):
        move = step * np.eye(len(at))[k]
        runs = {share: fit.samples(at + share * move) for share in WEIGHTS}
        size = max(np.max(np.abs(s.jacobian[:, k])) for s in exact)
        for i, s in enumerate(exact):
            difference = sum(w * runs[share][i].mean_K for share, w in WEIGHTS.items()) / step
            assert np.max(np.abs(s.jacobian[:, k] - difference)) < RELATIVE * size, unknown.label


def test_a_sample_at_the_first_instant_is_the_initial_profile_without_sensitivities():
    found = marched([point()], ("ratio.scale", "stack.coating.thickness_factor"))[0]
    assert found.temperature_K[0, 0] == pytest.approx(1140.0)  # the profile has a point at that sensor's depth
    assert np.all(found.sensitivity[:, 0] == 0.0)


def test_a_start_below_0_K_fails_its_track_alone_and_a_search_turns_back_from_it():
    model = point()
    mesh = choose_meshes([model])[0][0]
    history = flight(TIME_S, **{c: popu(c) for c in COLUMNS})
    march = LinearMarch([Track(model, mesh, (), SAMPLE_S)] * 2, TIME_S, history)
    warm = np.full(mesh.nodes, 300.0)
    failed, fine = march.attempt(initial_K=[warm - 301.0, warm])
    assert failed is None
    assert fine is not None
    assert np.array_equal(fine.temperature_K, march.attempt(initial_K=[warm, warm])[1].temperature_K)
    with pytest.raises(RunError, match="not above 0 K"):
        march.march(initial_K=[warm - 301.0, warm])
    fit = problem([])
    cold = np.array([p.value - 1e4 for p in fit.parameters])
    assert np.isnan(fit.evaluate(cold).log_likelihood)


def test_sample_outside_the_march_is_refused():
    model = point()
    mesh = choose_meshes([model])[0][0]
    history = flight(TIME_S, **{c: popu(c) for c in COLUMNS})
    march = LinearMarch([Track(model, mesh, (), SAMPLE_S)], TIME_S, history)
    with pytest.raises(InputError, match="1 samples lie outside the march"):
        march.march([0.01])
