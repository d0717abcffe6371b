"""`update-tables` with effects: fitted effects are written into the control point's file, and can be reverted."""

from __future__ import annotations

import shutil
import tomllib
from pathlib import Path

import pytest

from sim_heating.base.errors import InputError
from sim_heating.base.files import read_json
from sim_heating.cli import main
from sim_heating.closure.revise.effects import edit_effects
from sim_heating.closure.revise.update import prepare_update
from sim_heating.estimation.fit import estimate
from sim_heating.estimation.report.estimate_file import read_estimate, write_estimate
from sim_heating.estimation.report.report import estimate_contents
from sim_heating.heating.effects import use
from sim_heating.inputs.record import load_record
from sim_heating.inputs.scenario import load_scenario
from sim_heating.inputs.vehicle import load_vehicle
from sim_heating.simulation.synthesize import synthesize, write_records
from tests.closure.test_update_tables import POINT, contents, edit, one_point_orbiter, popu_in_a_glide

TRANSITION = {"log10_re_onset": 6.0, "alpha_sens": 0.0, "width": 0.05, "factor": 1.6, "alpha_0_deg": 38.0}
COATING = 1.6
FILE = f"orbiter/control_points/{POINT}.toml"
HIDDEN = f"""
[[truth.effect]]
name = "transition"
parameters = {{ {", ".join(f"{n} = {v}" for n, v in TRANSITION.items())} }}
[[truth.effect]]
name = "coating-thickness"
parameters = {{ coating_factor = {COATING} }}
"""


@pytest.fixture(scope="module")
def flown_records(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the vehicle, two flights whose truth has a transition and a thick coating, and a fit of one with
    the width and angle of the transition fixed at other values than nominal."""
    home = tmp_path_factory.mktemp("flown")
    one_point_orbiter(home)
    for name, flight in (
        ("first", {"altitude_m": 74000.0, "velocity_m_s": 6800.0, "sweep_deg": 5.0}),
        ("second", {"altitude_m": 72000.0, "velocity_m_s": 6300.0, "sweep_deg": 3.0}),
    ):
        (home / f"{name}.toml").write_text(popu_in_a_glide(**flight) + HIDDEN)
        scenario = load_scenario(home / f"{name}.toml")
        write_records(scenario, synthesize(scenario), home / name)
    start = {**TRANSITION, "log10_re_onset": 6.02, "factor": 1.3}
    names = [
        "ratio.scale", "ratio.d_alpha", "effect.transition.log10_re_onset", "effect.transition.factor",
        "effect.coating-thickness.coating_factor", "clock.skew",
    ]  # fmt: skip
    fit = estimate_contents(estimate([load_record(home / "first")], names, effects=(use("transition", start),)))
    inputs = {"first": fit.inputs[str(home / "first")]}
    write_estimate(home / "first.json", fit.model_copy(update={"records": ["first"], "inputs": inputs}))
    return home


def declared() -> dict[str, dict[str, float]]:
    """Effects of the control point as the vehicle has them."""
    return {u.effect.name: u.by_name for u in load_vehicle("./orbiter").control_point(POINT).effects}


@pytest.mark.thorough
def test_effects_of_one_flight_predict_another_and_can_be_reverted(
    workdir: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = contents(workdir / "orbiter")
    arguments = ["update-tables", "first.json", "--vehicle", "./orbiter", "--check", "second"]
    assert main([*arguments, "--dry-run"]) == 0
    assert contents(workdir / "orbiter") == before
    assert "coating-thickness" in capsys.readouterr().out

    assert main(arguments) == 0
    assert "clock.skew: not written, belongs to the record" in capsys.readouterr().out
    fit = read_estimate("first.json").parameters
    found = declared()
    assert set(found) == {"transition", "coating-thickness"}
    for fixed in ("width", "alpha_0_deg"):
        assert found["transition"][fixed] == TRANSITION[fixed]
    true = {f"effect.transition.{n}": TRANSITION[n] for n in ("log10_re_onset", "factor")}
    for name, value in {**true, "effect.coating-thickness.coating_factor": COATING}.items():
        _, effect, parameter = name.split(".")
        assert abs(found[effect][parameter] - value) < 4.0 * fit[name].sigma, name

    errors = read_json(workdir / "orbiter" / "ratio_revisions" / POINT / "revision_2.json")["errors_K"]
    floor = load_record(workdir / "first").noise_floor_K()
    for name in ("first", "second"):
        rmse = {when: errors[name]["fit"][when]["rmse_K"] for when in ("before", "after")}
        assert rmse["before"] > 5.0 * floor
        # the second flight is at other Reynolds numbers in part, where the update leaves the table as it was
        assert rmse["after"] < (1.15 if name == "first" else 2.2) * floor
    assert main(["predict", "second", "--vehicle", "./orbiter", "--out", "after"]) == 0
    assert read_json(workdir / "after" / "summary.json")["fit"] == pytest.approx(errors["second"]["fit"]["after"])

    assert main(["update-tables", "--vehicle", "./orbiter", "--revert", POINT]) == 0
    assert contents(workdir / "orbiter") == before


@pytest.mark.thorough
def test_a_copy_has_the_effects_and_the_vehicle_stays(workdir: Path) -> None:
    before = contents(workdir / "orbiter")
    assert main(["update-tables", "first.json", "--vehicle", "./orbiter", "--out", "copies"]) == 0
    assert contents(workdir / "orbiter") == before
    text = (workdir / "copies" / FILE).read_text()
    assert text.startswith(Path(FILE).read_text().rstrip())
    assert [e["name"] for e in tomllib.loads(text)["effect"]] == ["transition", "coating-thickness"]


@pytest.mark.thorough
def test_a_fit_of_an_effect_alone_changes_no_node(workdir: Path) -> None:
    table = load_vehicle("./orbiter").control_point(POINT).ratio
    asked = "effect.coating-thickness.coating_factor"
    assert main(["estimate", "first", "--parameters", asked, "--out", "fit"]) == 0
    assert main(["update-tables", "fit", "--vehicle", "./orbiter"]) == 0
    value = read_estimate("fit").parameters[asked].value
    assert declared() == {"coating-thickness": {"coating_factor": pytest.approx(value, rel=1e-5)}}
    now = load_vehicle("./orbiter").control_point(POINT).ratio
    assert (now.ratio == table.ratio).all()
    assert now.header["revision"] == "2"


@pytest.mark.parametrize("rho", [-0.999, 0.0, 0.9])
def test_effects_follow_the_ratio_that_the_table_shifts_from_the_fit(workdir: Path, rho: float) -> None:
    fit = read_estimate("first.json")
    scale, factor = (
        fit.parameters[n].model_copy(update={"sigma": s})
        for n, s in (("ratio.scale", 0.2), ("effect.transition.factor", 0.3))
    )
    parameters = {"ratio.scale": scale, "effect.transition.factor": factor}
    both = {"ratio.scale|effect.transition.factor": rho}
    write_estimate("other.json", fit.model_copy(update={"parameters": parameters, "correlation": both}))
    update = prepare_update("other.json", "./orbiter")
    ((_, estimated, _, _, _, drawn, _),) = update.parameter_comparison()
    assert abs(drawn - estimated) > 0.2 * scale.sigma
    transition = update.effects.after[0]
    follow = (transition.by_name["factor"] - factor.value) / factor.sigma
    assert follow == pytest.approx(rho * (drawn - estimated) / scale.sigma, abs=1e-4)


@pytest.mark.thorough
def test_an_effect_is_shifted_no_farther_than_its_bounds(workdir: Path) -> None:
    fit = read_estimate("first.json")
    parameters = {
        n: fit.parameters[n].model_copy(update={"sigma": s})
        for n, s in (("ratio.scale", 0.5), ("effect.transition.factor", 50.0))
    }
    both = {"ratio.scale|effect.transition.factor": -0.99}
    write_estimate("other.json", fit.model_copy(update={"parameters": parameters, "correlation": both}))
    assert main(["update-tables", "other.json", "--vehicle", "./orbiter"]) == 0
    assert declared()["transition"]["factor"] == 0.1
    estimated = read_json(workdir / "orbiter" / "ratio_revisions" / POINT / "revision_2.json")["parameters"]
    assert estimated["effect.transition.factor"]["value"] == parameters["effect.transition.factor"].value


@pytest.mark.thorough
def test_a_declared_effect_is_replaced_and_its_comments_stay(workdir: Path) -> None:
    old = (
        '\n[[effect]] # hot\nname = "transition" # seen in tunnels\nparameters = { factor = 4.0 }\nsource = "a guess"\n'
    )
    other = '\n[[effect]]\nname = "moisture"\nsource = "rain"\n# the end\n'
    edit(Path(FILE), lambda text: text + old + other)
    nominal = declared()["moisture"]
    assert main(["update-tables", "first.json", "--vehicle", "./orbiter"]) == 0
    assert list(declared()) == ["transition", "moisture", "coating-thickness"]
    assert declared()["moisture"] == nominal
    text = Path(FILE).read_text()
    for comment in ("[[effect]] # hot", '"transition" # seen in tunnels', "# the end"):
        assert comment in text
    assert "a guess" not in text


@pytest.mark.thorough
def test_a_file_edited_after_the_update_is_not_reverted(workdir: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["update-tables", "first.json", "--vehicle", "./orbiter"]) == 0
    edit(Path(FILE), lambda text: text + "# mine\n")
    before = contents(workdir / "orbiter")
    assert main(["update-tables", "--vehicle", "./orbiter", "--revert", POINT]) == 2
    assert "was changed after revision 2" in capsys.readouterr().err
    assert contents(workdir / "orbiter") == before


@pytest.mark.thorough
def test_a_table_put_back_without_its_effects_is_refused(workdir: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table = Path(f"orbiter/ratio_tables/{POINT}.csv")
    old = table.read_bytes()
    assert main(["update-tables", "first.json", "--vehicle", "./orbiter"]) == 0
    table.write_bytes(old)
    assert main(["update-tables", "first.json", "--vehicle", "./orbiter"]) == 2
    assert "has the effects of revision 2, and the table is that of revision 1; copy" in capsys.readouterr().err
    shutil.copy(f"orbiter/ratio_revisions/{POINT}/revision_1.toml", FILE)
    assert main(["update-tables", "first.json", "--vehicle", "./orbiter"]) == 0


@pytest.mark.parametrize(
    ("name", "value", "hint"),
    [
        ("effect.transition.factor", 1e3, "1000 is outside its bounds"),
        ("effect.transitoin.factor", 2.0, "did you mean `transition`"),
        ("effect.transition.fctor", 2.0, "no parameter `fctor`"),
    ],
)
def test_impossible_effects_are_refused_in_one_line(
    name: str, value: float, hint: str, workdir: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    fit = read_estimate("first.json")
    factor = fit.parameters["effect.transition.factor"].model_copy(update={"value": value})
    write_estimate("other.json", fit.model_copy(update={"parameters": {name: factor}, "correlation": {}}))
    before = contents(workdir / "orbiter")
    assert main(["update-tables", "other.json", "--vehicle", "./orbiter"]) == 2
    lines = [line for line in capsys.readouterr().err.splitlines() if line.strip()]
    assert len(lines) == 1, lines
    assert hint in lines[0]
    assert contents(workdir / "orbiter") == before


@pytest.mark.parametrize("end_of_line", ["\n", "\r\n"])
def test_line_ends_and_byte_order_mark_stay(workdir: Path, end_of_line: str) -> None:
    raw = "\ufeff" + Path(FILE).read_text().replace("\n", end_of_line)
    effect = {"name": "catalysis", "parameters": {}, "source": "a flight"}
    once = edit_effects(raw, [effect], Path(FILE))
    assert once.startswith(raw.rstrip())
    again = edit_effects(once, [effect | {"source": "another flight"}], Path(FILE))
    assert again == once.replace("a flight", "another flight")
    assert again.count("\n") == again.count(end_of_line)


def test_effects_in_a_form_that_cannot_be_edited_are_refused(workdir: Path) -> None:
    raw = 'effect = [{ name = "catalysis", source = "a tunnel" }]\n' + Path(FILE).read_text()
    with pytest.raises(InputError, match="by hand"):
        edit_effects(raw, [{"name": "moisture", "parameters": {}, "source": "a flight"}], Path(FILE))
