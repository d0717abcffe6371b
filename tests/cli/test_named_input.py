"""Every message about an input names the file, and the key or row, that its user wrote; exit status 2 throughout."""

from __future__ import annotations

import io
import json
import re
import zipfile
from pathlib import Path

import pytest

from sim_heating.base.errors import InputError
from sim_heating.base.files.paths import portable_problem
from sim_heating.cli import main
from sim_heating.cli.path_check import check_path
from sim_heating.live.recording.to_record import Stretch, records_of
from sim_heating.live.spec import load_link
from sim_heating.trajectory.fmu.model import read_fmu
from tests.support.paths import ROOT, SCENARIOS

DOCUMENT = (ROOT / "tests" / "live" / "data" / "entry.xml").read_text()
LINK = """format = "link/1"
vehicle = "orbiter"
control_points = ["V09T9527"]
[time]
field = "TIME_MS"
unit = "ms"
[conditions]
altitude_m = { field = "ALTITUDE_FT", unit = "ft" }
velocity_m_s = { constant = 7000.0 }
rho_kg_m3 = { constant = 1e-5 }
alpha_deg = { constant = 40.0 }
beta_deg = { constant = 0.0 }
elevon_deg = { constant = 0.0 }
bodyflap_deg = { constant = 0.0 }
[[sensor]]
sensor = "V09T9527"
field = "TC1"
[[source]]
"""
PACKETS = 'kind = "ccsds"\nxtce = "entry.xml"\n'


def link(folder: Path, source: str = PACKETS, document: str | None = DOCUMENT) -> Path:
    (folder / "link.toml").write_text(LINK + source)
    if document is not None:
        (folder / "entry.xml").write_text(document)
    return folder / "link.toml"


def refused(path: Path) -> str:
    with pytest.raises(InputError) as error:
        check_path(path)
    assert len(error.value.problems) == 1
    return str(error.value)


# A link and what it names --------------------------------------------------------------------------------------------


def test_a_link_whose_document_is_whole_is_good(tmp_path: Path) -> None:
    assert check_path(link(tmp_path)).kind == "link"


@pytest.mark.parametrize(
    ("old", "new", "line"),
    [
        ("</xtce:SpaceSystem>", "", "entry.xml: is no XTCE document that can be read"),
        ('name="CCSDSPacket"', 'name="Packets"', "entry.xml: there is no container `CCSDSPacket`; it has Packets"),
        ('parameterRef="TC1"', 'parameterRef="TC2"', "entry.xml: is no XTCE document that can be read"),
        ('name="TC1"', 'name="VERSION"', "entry.xml: is no XTCE document"),
        ('<xtce:ParameterRefEntry parameterRef="TC1"/>', "", "link.toml: field `TC1` (sensor V09T9527 of V09T9527)"),
        ('<xtce:ParameterRefEntry parameterRef="TC1"/>', '<xtce:ParameterRefEntry parameterRef="TIME_MS"/>',
         "entry.xml: an EntryList has `TIME_MS` twice; remove one"),
        ('sizeInBits="14"', 'sizeInBits="15"', "do not end at the 48 bits of a primary header"),
        ('sizeInBits="16" encoding="unsigned"', 'sizeInBits="1600" encoding="unsigned"',
         "a number of 1600 bits cannot be"),
        ('sizeInBits="32" encoding="IEEE754"', 'sizeInBits="31" encoding="IEEE754"', "entry.xml: is no XTCE document"),
        ('name="U32"><xtce:IntegerDataEncoding sizeInBits="32"', 'name="U32"><xtce:IntegerDataEncoding sizeInBits="31"',
         "packets are of whole bytes"),
        ("<?xml", "<!DOCTYPE x>\n<?xml", "entry.xml"),
    ],
)  # fmt: skip
def test_a_damaged_document_is_refused_by_validate(tmp_path: Path, old: str, new: str, line: str) -> None:
    assert DOCUMENT.count(old) >= 1
    assert line in refused(link(tmp_path, document=DOCUMENT.replace(old, new, 1)))


@pytest.mark.parametrize(
    ("source", "line"),
    [
        (PACKETS, "entry.xml"),
        ('kind = "json-lines"\ntransport = "file"\nfile = "flight.jsonl"\n', "[[source]]: `file`: there is no"),
        ('kind = "replay"\nrecord = "flight"\n', "flight"),
    ],
)
def test_a_link_that_names_what_is_not_there_is_refused(tmp_path: Path, source: str, line: str) -> None:
    assert line in refused(link(tmp_path, source, document=None))


def test_a_file_of_messages_that_is_none_is_refused(tmp_path: Path) -> None:
    (tmp_path / "flight.jsonl").write_text("time,altitude\n")
    place = link(tmp_path, 'kind = "json-lines"\ntransport = "file"\nfile = "flight.jsonl"\n')
    assert "flight.jsonl: " in refused(place)
    assert "is not JSON" in refused(place)


# File and key --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "name", ["popu_mach20", "studies/small_envelope", "studies/optimal_entry", "campaigns/sts2_sts4", "live/popu_lines"]
)
@pytest.mark.parametrize(
    ("vehicle", "line"),
    [("../orbitr", "not a vehicle; there is no such directory"), ("orbitr", "did you mean `orbiter`?")],
)
def test_a_wrong_vehicle_names_file_and_key(tmp_path: Path, name: str, vehicle: str, line: str) -> None:
    text = (SCENARIOS / f"{name}.toml").read_text()
    (tmp_path / "wrong.toml").write_text(text.replace('vehicle = "orbiter"', f'vehicle = "{vehicle}"', 1))
    found = refused(tmp_path / "wrong.toml")
    assert "wrong.toml: `vehicle`: " in found
    assert line in found


@pytest.mark.parametrize("name", ["con", "NUL", "aux.toml", "com1", "lpt9.csv", "x.", "x ", "a" * 250])
def test_a_name_that_another_system_cannot_hold_is_none(name: str) -> None:
    assert portable_problem(name)


@pytest.mark.parametrize("name", ["console", "nul1", "p06", ".", "..", "V09T9527", "é" * 90])
def test_a_name_that_every_system_holds_is_one(name: str) -> None:
    assert portable_problem(name) is None


@pytest.mark.parametrize(
    "arguments",
    [
        ["new", "effect", "con", "--out", "e"],
        ["new", "effect", "a" * 300, "--out", "e"],
        ["run", str(SCENARIOS / "popu_mach20.toml"), "--out", "results/nul"],
        ["fmu", "export", "orbiter", "--out", "con.fmu"],
        ["campaign", "a" * 300 + ".toml", "--out", "o"],
        ["campaign", "a/" * 3000, "--out", "o"],
        ["figures", "a/" * 3000, "--out", "o"],
        ["close-loop", "a/" * 3000, "--out", "o"],
    ],
    ids=lambda a: " ".join(a)[:30],
)
def test_a_name_that_cannot_be_is_an_input(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], arguments: list[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 2
    assert "\nerror: " in "\n" + capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_a_control_point_that_no_file_can_be_named_after_is_told_by_its_option(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    sizes = ["--length", "2m", "--mass", "650kg", "--area", "3m2", "--nose-radius", "1.2m"]
    assert main(["new", "vehicle", *sizes, "--point", "con=copper 3 mm", "--out", "v", "--quiet"]) == 2
    assert capsys.readouterr().err.startswith("error: --point con=copper 3 mm: con is the name of a device on Windows")


@pytest.mark.parametrize("key", ["records", "scenario"])
def test_a_flight_of_a_campaign_whose_path_is_too_long_is_told_with_its_key(tmp_path: Path, key: str) -> None:
    head = 'format = "campaign/1"\ntitle = "t"\nvehicle = "orbiter"\n'
    (tmp_path / "c.toml").write_text(f'{head}[[flight]]\n{key} = "{"a" * 5000}"\n')
    assert f"c.toml, [[flight]] 1: `{key}`: there is no " in refused(tmp_path / "c.toml")


def test_figures_that_flights_do_not_give_leave_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A lamp test has no tile of the lower surface."""
    monkeypatch.chdir(tmp_path)
    board = SCENARIOS / "records" / "kaowool_board"
    assert main(["figures", str(board), "--only", "5", "--out", "figures", "--json"]) == 2
    answer = json.loads(capsys.readouterr().out)
    assert answer["files"] == []
    assert "figure 5: " in answer["error"]["problems"][1]
    assert not (tmp_path / "figures").exists()


# Large input ---------------------------------------------------------------------------------------------------------


def test_equal_flights_of_a_campaign_are_refused_unread(tmp_path: Path) -> None:
    flight = '[[flight]]\nscenario = "absent.toml"\n'
    head = 'format = "campaign/1"\ntitle = "t"\nvehicle = "orbiter"\n'
    (tmp_path / "c.toml").write_text(head + flight * 600)
    assert "[[flight]] 2: absent.toml is that of [[flight]] 1" in refused(tmp_path / "c.toml")
    (tmp_path / "c.toml").write_text(head + flight + "seeds = [1, 2]\n" + flight + "seeds = [3, 2]\n")
    assert "[[flight]] 2: absent.toml with seed 2 is that of [[flight]] 1" in refused(tmp_path / "c.toml")


@pytest.mark.parametrize(
    ("more", "key"),
    [
        ('control_points = ["V09T952"]\n', "`control_points`"),
        ('[[effect]]\nname = "blanket-shift"\ncontrol_points = ["V09T952"]\n', "[[effect]] 1: `control_points`"),
        ('[design]\ncontrol_point = "V09T952"\n', "[design]: `control_point`"),
    ],
)
def test_an_unknown_control_point_of_a_scenario_is_told_with_its_key(tmp_path: Path, more: str, key: str) -> None:
    head, tables = (SCENARIOS / "entry_3dof.toml").read_text().split("[trajectory]", 1)
    head = re.sub(r"(?m)^control_points = .*\n", "", head)
    top, below = (more, "") if more.startswith("control_points") else ("", more)
    path = tmp_path / "s.toml"
    path.write_text(f"{head}{top}[trajectory]{tables}\n{below}")
    with pytest.raises(InputError) as error:
        check_path(path)
    named = [line for line in error.value.problems if "there is no control point `V09T952`" in line]
    assert named
    assert all(line.startswith(f"{path}: {key}: vehicle orbiter: ") for line in named)


@pytest.mark.parametrize(
    ("frame", "line"),
    [
        ({"altitude_m": 250_000.0}, "altitude_m, sample 1: 250000.0 lies outside"),
        ({"velocity_m_s": 30_000.0}, "conditions.csv, row 2, column velocity_m_s: 30000 is not a speed"),
    ],
)
def test_what_came_over_a_link_and_makes_no_record_names_the_link(
    tmp_path: Path, frame: dict[str, float], line: str
) -> None:
    path = link(tmp_path)
    flown = {"altitude_m": 7e4, "velocity_m_s": 7000.0, "rho_kg_m3": 8e-5, "alpha_deg": 40.0, "beta_deg": 0.0}
    frames = {float(k): flown | {"elevon_deg": 0.0, "bodyflap_deg": 0.0} | frame for k in range(3)}
    stretch = Stretch(frames=frames, readings={("V09T9527", "V09T9527"): {0.0: 300.0, 1.0: 301.0, 2.0: 302.0}})
    with pytest.raises(InputError) as error:
        records_of(load_link(path), stretch)
    assert error.value.problems[0].startswith(f"{path}: what came makes no record of V09T9527: {line}")


@pytest.mark.thorough
def test_a_misspelt_variable_among_200000_is_answered_within_seconds(tmp_path: Path) -> None:
    import time

    variables = "".join(
        f'<ScalarVariable name="v{k}" valueReference="{k}" causality="output"><Real unit="m"/></ScalarVariable>'
        for k in range(200_000)
    )
    text = (
        '<?xml version="1.0"?><fmiModelDescription fmiVersion="2.0" modelName="m" guid="1" numberOfEventIndicators="0">'
        f'<CoSimulation modelIdentifier="m"/><ModelVariables>{variables}</ModelVariables><ModelStructure/>'
        "</fmiModelDescription>"
    )
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("modelDescription.xml", text)
        archive.writestr("binaries/linux64/m.so", b"x")
    (tmp_path / "big.fmu").write_bytes(content.getvalue())
    begun_s = time.process_time()
    model = read_fmu(tmp_path / "big.fmu")
    with pytest.raises(InputError, match="has no variable `v20000x`"):
        model.number("v20000x", "here")
    assert time.process_time() - begun_s < 6.0
