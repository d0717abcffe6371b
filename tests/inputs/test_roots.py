"""Files that a file names: read from its own folder, the vehicle's, the package's data and the root, nowhere else.

Every file that is refused is one that the program could read: without the rule it would be used.
"""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from sim_heating.base.errors import InputError
from sim_heating.base.files import with_digest, write_json
from sim_heating.cli import main
from sim_heating.closure.batch import find_records
from sim_heating.closure.revise.update import prepare_update
from sim_heating.inputs.ratio_sources import build_tables, write_tables
from sim_heating.inputs.record import load_record, record_digest
from sim_heating.inputs.scenario import load_scenario
from sim_heating.inputs.vehicle import load_vehicle
from sim_heating.planning.optimal.spec import load_optimal_study
from sim_heating.planning.study import load_study
from sim_heating.trajectory.aero import load_aero
from tests.support.paths import AIRCRAFT, ROOT, SCENARIOS, TILE
from tests.support.systems import posix

pytestmark = posix
OUTSIDE = "outside the folders that may be read from here"
FLOWN = '[trajectory]\nsource = "recorded"\nfile = "{file}"\n'
MEASURED = AIRCRAFT / "orbiter" / "flight_data" / "sts96" / "tile_468.csv"
TRACK = SCENARIOS / "data" / "sts107_early_entry.csv"


class Place:
    """A project with a vehicle, a record and a scenario, and a folder elsewhere that holds files of the same kinds."""

    def __init__(self, folder: Path) -> None:
        self.project, self.elsewhere = folder / "project", folder / "elsewhere"
        for home in (self.project, self.elsewhere):
            shutil.copytree(AIRCRAFT / "capsule", home / "capsule")
            shutil.copytree(TILE, home / "tile")
            shutil.copy(TRACK, home / "track.csv")
            shutil.copy(MEASURED, home / "measured.csv")
            shutil.copy(SCENARIOS / "entry_3dof.toml", home / "entry.toml")
            (home / "glide.fmu").write_bytes(b"no archive")
        (self.project / "cases").mkdir()

    def scenario(self, text: str, head: str = 'vehicle = "capsule"') -> Path:
        path = self.project / "cases" / "scenario.toml"
        path.write_text(f'format = "scenario/1"\ntitle = ""\n{head}\n{text}')
        return path

    def study(self, base: str, text: str = "", vehicle: str = "capsule") -> Path:
        path = self.project / "cases" / "study.toml"
        path.write_text(f'format = "study/1"\ntitle = ""\nvehicle = "{vehicle}"\n{base}\n{text}')
        return path


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Place:
    made = Place(tmp_path)
    monkeypatch.chdir(made.project)
    return made


def scenario_flying(place: Place, name: str) -> object:
    return load_scenario(place.scenario(FLOWN.format(file=name)))


def scenario_comparing(place: Place, name: str) -> object:
    compared = f'[[compare]]\ncontrol_point = "FACE"\nlabel = ""\nfile = "{name}"\n'
    return load_scenario(place.scenario(FLOWN.format(file="../track.csv") + compared))


def scenario_with_vehicle(place: Place, name: str) -> object:
    return load_scenario(place.scenario(FLOWN.format(file="../track.csv"), f'vehicle = "{name}"'))


def study_of_scenario(place: Place, name: str) -> object:
    return load_study(place.study(f'scenario = "{name}"'))


def study_flying(place: Place, name: str) -> object:
    return load_study(place.study(FLOWN.format(file=name)))


def study_with_vehicle(place: Place, name: str) -> object:
    return load_study(place.study(FLOWN.format(file="../track.csv"), vehicle=name))


def optimal_with_vehicle(place: Place, name: str) -> object:
    text = (SCENARIOS / "studies" / "optimal_entry.toml").read_text()
    path = place.project / "cases" / "optimal.toml"
    path.write_text(text.replace('vehicle = "orbiter"', f'vehicle = "{name}"'))
    return load_optimal_study(path)


NAMING: dict[str, tuple[str, str, Callable[[Place, str], object]]] = {
    "trajectory of a scenario": ("track.csv", "scenario.toml, [trajectory]: `file`", scenario_flying),
    "history to compare with": ("measured.csv", "scenario.toml, [compare] 1: `file`", scenario_comparing),
    "vehicle of a scenario": ("capsule", "scenario.toml, `vehicle`", scenario_with_vehicle),
    "scenario of a study": ("entry.toml", "study.toml, `scenario`", study_of_scenario),
    "trajectory of a study": ("track.csv", "study.toml, [trajectory]: `file`", study_flying),
    "vehicle of a study": ("capsule", "study.toml, `vehicle`", study_with_vehicle),
    "vehicle of an optimal entry": ("capsule", "optimal.toml, `vehicle`", optimal_with_vehicle),
}
"""Key -> a file that it may name, the place that a message names, and what reads it by a name."""


@pytest.mark.parametrize("key", NAMING)
@pytest.mark.parametrize("how", ["absolute", "up", "link"])
def test_a_file_elsewhere_is_refused_in_one_line_with_file_key_and_folders(place, key, how):
    target, where, read = NAMING[key]
    name = {"absolute": str(place.elsewhere / target), "up": f"../../elsewhere/{target}", "link": "linked.any"}[how]
    folder = "capsule" if key == "history to compare with" else "cases"  # which the name is relative to
    if how == "link":
        (place.project / folder / name).symlink_to(place.elsewhere / target)
        where = (
            where if folder == "cases" else "capsule/linked.any: the link"
        )  # a vehicle's links are checked as a whole
    with pytest.raises(InputError) as caught:
        read(place, name)
    (line,) = caught.value.problems
    assert where in line
    assert OUTSIDE in line
    assert str(place.project) in line
    assert str(place.elsewhere / target) in line


@pytest.mark.parametrize("key", [k for k in NAMING if "vehicle of" not in k])
def test_a_link_to_a_file_below_the_root_is_followed(place, key):
    target, _, read = NAMING[key]
    for folder in ("cases", "capsule"):
        (place.project / folder / "linked.any").symlink_to(place.project / target)
    read(place, "linked.any")


def test_the_root_is_the_nearest_folder_with_scenarios_above_the_file(place, monkeypatch, tmp_path):
    path = place.scenario(FLOWN.format(file="../../elsewhere/track.csv"), f'vehicle = "{AIRCRAFT / "capsule"}"')
    (tmp_path / "scenarios").mkdir()
    load_scenario(path)
    (place.project / "scenarios").mkdir()
    with pytest.raises(InputError, match=OUTSIDE):
        load_scenario(path)
    monkeypatch.chdir(tmp_path)  # the working directory counts where no folder above holds scenarios
    with pytest.raises(InputError, match=OUTSIDE):
        load_scenario(path)
    (tmp_path / "scenarios").rmdir()
    (place.project / "scenarios").rmdir()
    load_scenario(path)


def test_the_folder_that_the_user_names_replaces_the_default(place):
    path = place.scenario(FLOWN.format(file="../../elsewhere/track.csv"), f'vehicle = "{AIRCRAFT / "capsule"}"')
    load_scenario(path, root=place.elsewhere)
    own = str(AIRCRAFT / "capsule")
    load_study(place.study('scenario = "../../elsewhere/entry.toml"', vehicle=own), root=place.elsewhere)
    inside = place.scenario(FLOWN.format(file="../track.csv"), f'vehicle = "{AIRCRAFT / "capsule"}"')
    with pytest.raises(InputError, match=OUTSIDE):
        load_scenario(inside, root=place.elsewhere)
    with pytest.raises(InputError, match=r"--root .*missing: is not a directory"):
        load_scenario(path, root=place.elsewhere / "missing")


def test_shipped_studies_and_scenarios_load_from_any_working_directory(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    load_study(SCENARIOS / "studies" / "dispersed_small.toml")
    load_scenario(SCENARIOS / "sts96_iss.toml")


@pytest.mark.parametrize("name", ["../../elsewhere/glide.fmu", "../glide.fmu", "../cases/linked.fmu"])
def test_an_fmu_is_code_and_runs_from_the_scenarios_folder_or_a_named_root_alone(place, name):
    (place.project / "cases" / "linked.fmu").symlink_to(place.project / "glide.fmu")
    path = place.scenario(f'[trajectory]\nsource = "fmu"\nfile = "{name}"\n')
    with pytest.raises(InputError) as caught:
        load_scenario(path)
    assert "is code and is run from" in str(caught.value) or OUTSIDE in str(caught.value)
    with pytest.raises(InputError) as caught:  # it is opened, and is no FMU
        load_scenario(path, root=place.project.parent)
    assert "glide.fmu" in str(caught.value) or "linked.fmu" in str(caught.value)
    assert "--root" not in str(caught.value)


def test_an_fmu_beside_its_scenario_is_opened(place):
    shutil.copy(place.project / "glide.fmu", place.project / "cases" / "own.fmu")
    with pytest.raises(InputError) as caught:
        load_scenario(place.scenario('[trajectory]\nsource = "fmu"\nfile = "own.fmu"\n'))
    assert "own.fmu" in str(caught.value)
    assert "--root" not in str(caught.value)


# Files of a directory ------------------------------------------------------------------------------------------------


RECORD_KEYS = {
    "[conditions]: `file`": ('file = "conditions.csv"', "conditions.csv"),
    "[thermocouples]: `file`": ('file = "thermocouples.csv"', "thermocouples.csv"),
    "[heating]: `ratio_table`": ('ratio_table = "ratio_table.csv"', "ratio_table.csv"),
}


@pytest.mark.parametrize("key", RECORD_KEYS)
def test_files_of_a_record_lie_in_its_directory(place, key):
    line, file = RECORD_KEYS[key]
    tile, declaration = place.project / "tile", place.project / "tile" / "record.toml"
    text = declaration.read_text()
    assert line in text
    for name in (f"../../elsewhere/tile/{file}", str(place.elsewhere / "tile" / file), f"sub/../../tile/{file}"):
        declaration.write_text(text.replace(line, line.replace(file, name)))
        with pytest.raises(InputError) as caught:
            load_record(tile)
        assert f"record.toml, {key}" in str(caught.value)
        assert "is not a file of this record" in str(caught.value)
    declaration.write_text(text)
    check_links_of(place, tile / file, lambda root: load_record(tile, root=root))


def test_the_declaration_of_a_record_is_not_a_link_to_elsewhere(place):
    tile = place.project / "tile"
    check_links_of(place, tile / "record.toml", lambda root: load_record(tile, root=root))


def test_a_folder_of_records_may_link_to_records_below_the_root_alone(place):
    many = place.project / "many"
    many.mkdir()
    (many / "near").symlink_to(place.project / "tile")
    assert [p.name for p in find_records([many])] == ["near"]
    (many / "near").unlink()
    (many / "far").symlink_to(place.elsewhere / "tile")
    with pytest.raises(InputError, match=OUTSIDE):
        find_records([many])
    assert [p.name for p in find_records([many], place.elsewhere)] == ["far"]


def check_links_of(place: Place, file: Path, read: Callable[[Path | None], object]) -> None:
    """Read a file that is a link: to elsewhere, refused without a root that holds it, and to a place below the root."""
    relative = file.relative_to(place.project)
    file.unlink()
    file.symlink_to(place.elsewhere / relative)
    with pytest.raises(InputError) as caught:
        read(None)
    line = caught.value.problems[0]
    assert str(relative) in line
    assert OUTSIDE in line
    read(place.elsewhere)
    file.unlink()
    shutil.copy(place.elsewhere / relative, place.project / f"moved{file.suffix}")
    file.symlink_to(place.project / f"moved{file.suffix}")
    read(None)


@pytest.mark.parametrize(
    "file",
    [
        "vehicle.toml", "materials/al2219.toml", "control_points/FACE.toml", "ratio_tables/FACE.csv", "guidance.toml",
        "aero/aero.toml", "aero/longitudinal.csv", "ratio_sources/face.toml", "provenance.md",
    ],
)  # fmt: skip
def test_links_in_a_vehicle_lead_below_the_root(place, file):
    capsule = place.project / "capsule"
    check_links_of(place, capsule / file, lambda root: load_vehicle(capsule, root=root))
    (capsule / file).unlink()
    (capsule / file).symlink_to(place.elsewhere / "capsule" / file)
    with pytest.raises(InputError, match=OUTSIDE):
        build_tables(capsule)


def test_a_linked_folder_of_a_vehicle_is_looked_through(place):
    capsule = place.project / "capsule"
    shutil.move(capsule / "materials", place.project / "materials")
    (capsule / "materials").symlink_to("../materials")
    (capsule / "round").symlink_to(".")
    load_vehicle(capsule)
    (place.project / "materials" / "far.toml").symlink_to(place.elsewhere / "capsule" / "materials" / "al2219.toml")
    with pytest.raises(InputError, match=r"materials/far\.toml: the link leads to"):
        load_vehicle(capsule)


def test_tables_of_a_vehicle_are_named_below_its_folders(place):
    capsule = place.project / "capsule"
    shutil.copy(place.elsewhere / "capsule" / "ratio_tables" / "FACE.csv", place.elsewhere / "FACE.csv")
    point = capsule / "control_points" / "FACE.toml"
    point.write_text(point.read_text().replace('"ratio_tables/FACE.csv"', '"../../elsewhere/FACE.csv"'))
    with pytest.raises(InputError, match=r"`ratio_table`: .* is outside the vehicle directory"):
        load_vehicle(capsule)
    aero = capsule / "aero" / "aero.toml"
    text = aero.read_text()
    for home in ("../../../elsewhere", str(place.elsewhere)):
        aero.write_text(text.replace('"longitudinal.csv"', f'"{home}/capsule/aero/longitudinal.csv"'))
        with pytest.raises(InputError, match=r"\[tables\]: `longitudinal`: .* is not a file of this folder"):
            load_aero(capsule)


def test_the_file_of_a_ratio_source_is_in_its_folder(place):
    orbiter = Path(shutil.copytree(AIRCRAFT / "orbiter", place.project / "orbiter"))
    estimate = Path(__file__).parent.parent / "data" / "lower_surface_ratio_estimate.csv"
    shutil.copy(estimate, place.elsewhere / "lower_surface.csv")
    source = orbiter / "ratio_sources" / "nosecap.toml"
    base = """[base]
file = "../../../elsewhere/lower_surface.csv"
column = "h_over_href_laminar"
file_length_over_L = 0.05
length = "x_over_L"
length_exponent = -0.5
"""
    source.write_text(re.sub(r"\[base\]\n(?:[^\n\[].*\n)+", base, source.read_text()))
    with pytest.raises(InputError, match=r"\[base\]: `file`: .* is not a file of this folder"):
        build_tables(orbiter)


def test_a_ratio_source_writes_tables_of_the_vehicle_alone(place):
    capsule = place.project / "capsule"
    source = capsule / "ratio_sources" / "face.toml"
    source.write_text(source.read_text().replace('"FACE"', '"../../elsewhere/capsule/control_points/FACE"'))
    before = sorted(p.relative_to(place.elsewhere) for p in place.elsewhere.rglob("*"))
    with pytest.raises(InputError, match=r"face\.toml.*`control_points`, row 1"):
        write_tables(capsule)
    assert sorted(p.relative_to(place.elsewhere) for p in place.elsewhere.rglob("*")) == before


# Records of an estimate ----------------------------------------------------------------------------------------------


def test_records_of_an_estimate_elsewhere_are_read_with_their_digest_alone(place):
    """An estimate names what it was made from, often elsewhere: the digest shows that its author knew the files."""
    record = place.elsewhere / "tile"
    data = {
        "format": "estimate/1", "records": [str(record)], "converged": True, "iterations": 1, "noise_floor_K": 1.0,
        "reference_condition": dict.fromkeys(("alpha_deg", "beta_deg", "log10_re", "elevon_deg", "bodyflap_deg"), 1.0),
        "parameters": {"ratio.d0": {"value": 0.1, "sigma": 0.01, "unit": "1"}}, "not_estimated": {}, "correlation": {},
        "fit": {"rmse_K": 1.0, "max_abs_K": 1.0, "n": 5}, "holdout": None,
    }  # fmt: skip
    estimate = place.project / "estimate.json"

    def message(inputs: dict[str, str], root: Path | None = None) -> str:
        write_json(estimate, with_digest(data | {"inputs": inputs}))
        with pytest.raises(InputError) as caught:  # the record is of no point of the capsule
            prepare_update(estimate, place.project / "capsule", root=root)
        return str(caught.value)

    stated = {str(record): record_digest(load_record(record))}
    assert "`records`, item 1" in message({str(record): "sha256:0"})
    assert OUTSIDE in message({str(record): "sha256:0"})
    (record / "record.toml").write_text("secret = 17")  # whose text no message may repeat
    found = message(stated)
    assert OUTSIDE in found
    assert "secret" not in found
    shutil.copy(TILE / "record.toml", record / "record.toml")
    assert OUTSIDE not in message(stated)
    assert OUTSIDE not in message(stated, place.elsewhere)


# On the command line -------------------------------------------------------------------------------------------------


def test_the_command_refuses_with_exit_2_and_takes_a_root(place, capsys):
    scenario = place.scenario(FLOWN.format(file="../../elsewhere/track.csv"))
    assert main(["validate", str(scenario)]) == 2
    assert OUTSIDE in capsys.readouterr().err
    assert main(["validate", str(scenario), "--root", str(place.project.parent)]) == 0
    assert main(["validate", str(scenario), "--root", "missing"]) == 2
    assert "--root missing: is not a directory" in capsys.readouterr().err


@pytest.mark.parametrize(
    "command",
    ["run", "synthesize", "predict", "validate", "estimate", "design", "close-loop", "update-tables", "ratio-tables",
     "measured-records", "plan", "fmu export", "fmu trajectory"],
)  # fmt: skip
def test_every_command_that_loads_files_takes_a_root(command, capsys):
    assert main([*command.split(), "--help"]) == 0
    assert "--root DIR" in capsys.readouterr().out


@pytest.mark.parametrize("name", ["a\\u0000b", "x" * 5000, "loop", ""])
def test_names_that_are_no_paths_are_answered_in_one_line(place, name):
    os.symlink("loop", place.project / "cases" / "loop")
    with pytest.raises(InputError) as caught:
        load_scenario(place.scenario(FLOWN.format(file=name)))
    assert len(str(caught.value).splitlines()) == 1


def test_the_checkout_of_the_tests_has_no_link_that_leads_out_of_it():
    for vehicle in ("orbiter", "capsule"):
        load_vehicle(ROOT / "aircraft_data" / vehicle)
