"""Many control points together: each as if it were alone, snapshots of the state, and no silent invalid number."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim_heating.base.errors import InputError, RunError
from sim_heating.base.kernels.block import CONDITION_COLUMNS, LANES
from sim_heating.heating.effects import use
from sim_heating.march.ensemble import THREADED_POINT_STEPS, Ensemble, condition_history
from sim_heating.march.mesh_choice import pack
from sim_heating.march.point import PointModel
from sim_heating.thermal.mesh import build_mesh
from sim_heating.thermal.stack import Construction
from tests.support.walls import flight, heat_content, material, practice_model, practice_record, wall

compiling = settings(deadline=None)  # the first example waits for the compiler
CP_J_KGK = 1004.5


@pytest.fixture(scope="module")
def entry() -> tuple[np.ndarray, np.ndarray]:
    """Times and history of 500 s about the manoeuvres of a practice record."""
    conditions = practice_record("p06")[0].conditions
    return conditions.time_s[600:1100], condition_history(conditions)[np.newaxis, 600:1100]


def variants(count: int, nodes: int = 24) -> list[PointModel]:
    """Points that differ in everything a lane can differ in but the node count."""
    effects = ((), (use("catalysis"),), (use("jet-interaction"), use("impingement-onset")))
    return [
        practice_model(
            "p06" if i % 2 else "p07",
            nodes=nodes,
            effects=effects[i % 3],
            parameters={"ratio.scale": 0.05 * i, "stack.coating.thickness_factor": 1.0 + 0.02 * i},
        )
        for i in range(count)
    ]


def alone(model: PointModel, entry) -> np.ndarray:
    return pack([model]).march(*entry)


# Bits ----------------------------------------------------------------------------------------------------------------


def test_point_gives_the_same_bits_alone_and_in_any_lane(entry):
    models = variants(LANES)
    together = pack(models).march(*entry)
    backwards = pack(models[::-1]).march(*entry)
    for i, model in enumerate(models):
        mine, columns = alone(model, entry), slice(4 * i, 4 * i + 4)
        np.testing.assert_array_equal(together[:, columns], mine)
        last = LANES - 1 - i
        np.testing.assert_array_equal(backwards[:, 4 * last : 4 * last + 4], mine)


def test_point_gives_the_same_bits_among_points_of_other_node_counts(entry):
    models = [practice_model("p06", nodes=n) for n in (40, 14, 24, 14, 40, 31, 24, 24, 14)]
    together = pack(models).march(*entry)
    for i, model in enumerate(models):
        np.testing.assert_array_equal(together[:, 4 * i : 4 * i + 4], alone(model, entry))


def test_a_lane_that_fails_does_not_change_the_others(entry):
    time, history = entry
    good, broken = practice_model("p06", nodes=24), practice_model("p07", nodes=24)
    both = np.concatenate([history, history])
    both[1, 250:, CONDITION_COLUMNS.index("q_add_W_m2")] = 1e200
    ensemble = pack([good, broken])
    with pytest.raises(RunError, match="p07"):
        ensemble.march(time, both)
    expected = pack([good])
    expected.march(time, history)
    np.testing.assert_array_equal(ensemble.node_temperatures(0), expected.node_temperatures(0))


@pytest.mark.parametrize("flux", [1e200, 1e308])
def test_point_that_failed_marches_as_if_new_once_it_is_reset(entry, flux):
    time, history = entry
    burst = history.copy()
    burst[..., 250:, CONDITION_COLUMNS.index("q_add_W_m2")] = flux
    model = practice_model("p07")
    ensemble = pack([model])
    with pytest.raises(RunError, match="p07"):
        ensemble.march(time, burst)
    ensemble.reset()
    np.testing.assert_array_equal(ensemble.march(time, history), alone(model, entry))


def test_neighbour_with_other_pressure_columns_moves_a_point_by_rounding_alone(entry):
    odd = {"p_Pa": [3.0, 30.0, 3000.0], "T_K": [300.0, 900.0], "k": [[0.1, 0.2, 0.3], [0.2, 0.3, 0.4]]}
    neighbour = PointModel("neighbour", wall((material(k=odd, emissivity=0.8), 0.02)), nodes=24)
    model = practice_model("p06", nodes=24)
    together = pack([model, neighbour]).march(*entry)
    np.testing.assert_allclose(together[:, :4], alone(model, entry), rtol=0.0, atol=1e-9)


def test_threads_give_the_bits_of_a_serial_march(entry):
    models = variants(6 * LANES, nodes=14)
    assert len(models) * len(entry[0]) > THREADED_POINT_STEPS > LANES * len(entry[0])
    threaded = pack(models).march(*entry)
    for first in range(0, len(models), LANES):
        serial = pack(models[first : first + LANES]).march(*entry)
        np.testing.assert_array_equal(threaded[:, 4 * first : 4 * (first + LANES)], serial)


def test_frames_give_the_bits_of_a_march(entry):
    time, history = entry
    model = practice_model("p06")
    marched, framed = pack([model]), pack([model])
    out = marched.march(time, history)
    framed.begin(history[:, 0])
    for k in range(1, len(time)):
        framed.advance(history[:, k], float(time[k] - time[k - 1]))
        np.testing.assert_array_equal(framed.state[framed.outputs()], out[k])


def test_a_restored_snapshot_continues_with_the_same_bits(entry):
    time, history = entry
    ensemble = pack(variants(5))
    first = ensemble.march(time[:250], history[:, :250])
    saved = ensemble.snapshot()
    onward = ensemble.march(time[249:], history[:, 249:])
    ensemble.restore(saved)
    np.testing.assert_array_equal(ensemble.march(time[249:], history[:, 249:]), onward)
    ensemble.reset()
    np.testing.assert_array_equal(ensemble.march(time[:250], history[:, :250]), first)


def test_snapshot_of_another_model_is_refused():
    with pytest.raises(InputError, match="it is of another model"):
        pack([practice_model("p06", nodes=14)]).restore(pack([practice_model("p06", nodes=16)]).snapshot())


def test_each_point_flies_its_own_flight(entry):
    time, history = entry
    cooler = history.copy()
    cooler[..., CONDITION_COLUMNS.index("h_ref_kg_m2_s")] *= 0.8
    model = practice_model("p06")
    both = pack([model, model]).march(time, np.concatenate([history, cooler]), which=[1, 0])
    np.testing.assert_array_equal(both[:, :4], pack([model]).march(time, cooler))
    np.testing.assert_array_equal(both[:, 4:], pack([model]).march(time, history))


# What goes in --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("column", [c for c in CONDITION_COLUMNS if c not in ("jets", "mach", "time_s")])
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_condition_that_is_not_a_number_is_refused_or_fails_the_step(entry, column, bad):
    time, history = entry[0][:20], entry[1][:, :20].copy()
    history[0, 10, CONDITION_COLUMNS.index(column)] = bad
    with pytest.raises((InputError, RunError)):
        pack([practice_model("p06", nodes=14)]).march(time, history)


def test_jets_that_are_not_a_number_are_refused_where_an_effect_reads_them(entry):
    time, history = entry[0][:20], entry[1][:, :20].copy()
    history[0, 10, CONDITION_COLUMNS.index("jets")] = np.nan
    with pytest.raises((InputError, RunError)):
        pack([practice_model("p06", nodes=14, effects=(use("jet-interaction"),))]).march(time, history)


@pytest.mark.parametrize("damage", ["back in time", "same time twice", "not a number"])
def test_times_that_do_not_increase_are_refused(entry, damage):
    time, history = entry[0][:20].copy(), entry[1][:, :20]
    time[10] = {"back in time": time[5], "same time twice": time[9], "not a number": np.nan}[damage]
    with pytest.raises(InputError):
        pack([practice_model("p06", nodes=14)]).march(time, history)


def test_histories_that_do_not_fit_the_times_are_refused(entry):
    time, history = entry[0][:20], entry[1][:, :20]
    ensemble = pack([practice_model("p06", nodes=14)])
    for wrong in (history[:, :15], history[:, :, :5], history[0]):
        with pytest.raises(InputError):
            ensemble.march(time, wrong)


def test_a_flight_number_that_does_not_exist_is_refused(entry):
    time, history = entry[0][:20], entry[1][:, :20]
    with pytest.raises(InputError):
        pack([practice_model("p06", nodes=14)]).march(time, history, which=[3])
    with pytest.raises(InputError):  # two flights for three points
        pack([practice_model("p06", nodes=14)] * 3).march(time, np.concatenate([history, history]))


@pytest.mark.parametrize("step_s", [0.0, -1.0, np.nan])
def test_step_that_is_not_above_zero_is_refused(entry, step_s):
    time, history = entry[0][:20], entry[1][:, :20]
    with pytest.raises(InputError):
        pack([practice_model("p06", nodes=14)]).march(time, history, longest_step_s=step_s)


def test_sensor_outside_the_stack_is_refused():
    for depth in (-0.001, 1.0, np.nan):
        with pytest.raises(InputError):
            pack([practice_model("p06", nodes=14, depths_m=(depth,))])


@pytest.mark.parametrize("cp", [np.nan, 0.0, -1000.0])
def test_a_specific_heat_of_air_that_is_not_above_zero_is_refused(cp):
    with pytest.raises(InputError):
        pack([practice_model("p06", nodes=14, wall_enthalpy=cp)])


def test_profile_must_fit_the_nodes_and_be_temperatures():
    ensemble = pack([practice_model("p06", nodes=14)])
    for wrong in (np.full(13, 300.0), np.full(14, -1.0), np.full(14, np.nan), np.full(14, np.inf)):
        with pytest.raises(InputError, match="14 temperatures"):
            ensemble.set_profile(0, wrong)


def test_misspelt_parameter_is_answered_with_the_nearest():
    with pytest.raises(InputError, match=r"did you mean `ratio\.d_alpha`"):
        practice_model("p06", parameters={"ratio.d_alhpa": 0.1})


def test_parameter_outside_its_bounds_is_named():
    with pytest.raises(InputError, match=r"stack\.emissivity_factor: 2 is outside its bounds 0 to 1\.5"):
        practice_model("p06", parameters={"stack.emissivity_factor": 2.0})


def test_coating_without_thickness_is_refused():
    with pytest.raises(InputError, match=r"stack\.coating\.thickness_factor: 0 is outside its bounds"):
        practice_model("p06", parameters={"stack.coating.thickness_factor": 0.0})


def test_samples_outside_the_ratio_table_are_counted(entry):
    time, history = entry
    ensemble, beyond = pack([practice_model("p06")]), history.copy()
    ensemble.march(time, history)
    before = ensemble.counters.steps_outside_table[0]
    beyond[0, 100:110, CONDITION_COLUMNS.index("alpha_deg")] = 80.0
    ensemble.reset()
    ensemble.march(time, beyond)
    assert (before, ensemble.counters.steps_outside_table[0]) == (0.0, 10.0)


# Any physical input --------------------------------------------------------------------------------------------------

powers = st.floats(0.0, 1.0)
fluxes = st.floats(2.0, 7.0).map(lambda x: 10.0**x)
steps = st.floats(-3.0, 1.0).map(lambda x: 10.0**x)
pressures = st.one_of(st.just(0.0), st.floats(-3.0, 6.0).map(lambda x: 10.0**x))


@st.composite
def tile_walls(draw, coldest: float, hottest: float) -> Construction:
    """Coating of 10 um to 5 mm, porous tile of 1 to 200 mm, plate of 0.1 to 30 mm, at any initial temperature."""
    record, _ = practice_record("p06")
    m = record.construction.materials
    sizes = [10.0 ** draw(st.floats(*span)) for span in ((-5.0, -2.3), (-3.0, -0.7), (-4.0, -1.5))]
    contact = draw(st.sampled_from([0.0, 1e-5, 1e-2]))
    initial = draw(st.floats(coldest, hottest))
    parts = list(zip((m["rcg"], m["li900"], m["al2024"]), sizes, strict=True))
    return wall(*parts, contact=contact, initial_K=initial, surroundings_K=draw(st.sampled_from([0.0, 300.0])))


@st.composite
def heatings(draw, step_s: float) -> np.ndarray:
    """Six samples of flux up to 10 MW/m2, film, enthalpy and pressure, each free to jump."""
    drawn = {
        "q_add_W_m2": [draw(powers) * draw(fluxes) for _ in range(6)],
        "h_ref_kg_m2_s": [draw(powers) * 0.3 for _ in range(6)],
        "p_surface_Pa": [draw(pressures) for _ in range(6)],
    }
    return flight(step_s * np.arange(6), H_r_J_kg=draw(st.floats(1e5, 3e7)), **drawn)


def march_any(construction: Construction, history: np.ndarray, step_s: float, nodes: int) -> Ensemble:
    model = PointModel("wall", construction, parameters={"ratio.d0": 1.0})
    ensemble = Ensemble([model], [build_mesh(construction, np.array([]), nodes, step_s)], step_s)
    ensemble.march(step_s * np.arange(6), history)
    return ensemble


@pytest.mark.thorough
@compiling
@given(st.data(), tile_walls(100.0, 2500.0), steps, st.integers(14, 60))
def test_any_physical_input_gives_temperatures_or_a_reported_failure(data, construction, step_s, nodes):
    try:
        ensemble = march_any(construction, data.draw(heatings(step_s)), step_s, nodes)
    except RunError:
        return  # it has said so
    assert np.all(np.isfinite(ensemble.node_temperatures(0)))
    assert np.isfinite(heat_content(ensemble))


@pytest.fixture(scope="module")
def tile() -> Ensemble:
    """The tile of a practice record on its automatic mesh."""
    return pack([practice_model("p06", ratio=None, parameters={"ratio.d0": 1.0})])


@compiling
@given(steps, fluxes, st.floats(100.0, 1000.0), pressures)
def test_a_tile_on_its_own_mesh_survives_any_jump_of_heating_from_any_flight_temperature(
    tile, step_s, flux, initial, p_Pa
):
    tile.reset()
    tile.set_profile(0, np.full(tile.meshes[0].nodes, initial))
    history = flight(step_s * np.arange(6), q_add_W_m2=flux * np.array([1, 0, 1, 1, 0, 0]), p_surface_Pa=p_Pa)
    out = tile.march(step_s * np.arange(6), history, longest_step_s=step_s)
    assert tile.counters.failures[0] == 0.0
    assert np.all((out > 50.0) & (out < 5000.0))
