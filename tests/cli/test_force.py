"""A command refuses to replace files that others wrote, in one line that names --force, and replaces them with it."""

from __future__ import annotations

import shlex
import shutil
from collections.abc import Iterator
from pathlib import Path

import click
import pytest

from sim_heating.cli import cli, main
from tests.support.gliding import gliding
from tests.support.paths import ROOT, TILE

RECORD = "new record --csv t.csv --layer 'copper 3mm' --depth TC=back --lamp 20kW/m2 --out out"
VEHICLE = "new vehicle --length 2m --mass 800kg --area 3m2 --nose-radius 1.2m --point 'NOSE=inconel625 2mm' --out out"
STUDY = f"new study envelope --scenario {ROOT}/scenarios/popu_mach20.toml --point WING_LE --out out"
QUICK = [
    ("parameters TILE --out out", "parameters.json"),
    ("predict TILE --out out", "summary.json"),
    (RECORD, "record.toml"),
    (VEHICLE, "vehicle.toml"),
    (STUDY, "study.toml"),
    ("new effect shock-passage --out out", "shock_passage.py"),
    ("ratio-tables out", "ratio_tables/NOSE.csv"),
]
"""Commands of seconds, and a file that each writes."""
LONG = [
    ("run short.toml --out out", "summary.json"),
    ("synthesize short.toml --out out", "truth.toml"),
    ("estimate TILE --out out", "estimate.json"),
    ("close-loop TILE --out out", "closure.json"),
    ("design ROOT/scenarios/design_popu.toml --out out", "design.json"),
    ("plan ROOT/scenarios/studies/small_envelope.toml --out out", "study.json"),
    ("campaign ROOT/scenarios/campaigns/sts2_sts4.toml --out out", "campaign.json"),
    ("fmu export orbiter --out out/orbiter.fmu", "orbiter.fmu"),
    ("fmu trajectory short.toml --out out/short.fmu", "short.fmu"),
]
"""Commands that refuse before their work, of which only the refusal is tried here."""


@pytest.fixture(autouse=True)
def in_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("SIM_HEATING_AIRCRAFT_DATA", str(ROOT / "aircraft_data"))
    Path("short.toml").write_text(gliding(60.0, "V09T9527", vehicle="orbiter"))
    Path("t.csv").write_text("time_s,TC_K\n0,300\n1,301\n2,302\n")


def arguments(command: str) -> list[str]:
    """The words of a command."""
    return shlex.split(command.replace("TILE", str(TILE)).replace("ROOT", str(ROOT)))


def refusal(command: str, capsys: pytest.CaptureFixture[str]) -> str:
    """The one line with which a command refuses a directory that holds a file of somebody else."""
    capsys.readouterr()
    assert main(arguments(command)) == 2
    lines = [line for line in capsys.readouterr().err.splitlines() if not line.endswith("...")]
    assert len(lines) == 1, lines
    return lines[0]


def occupied(command: str, name: str) -> Path:
    """A file of somebody else in the place of a result."""
    if command.startswith("ratio-tables"):
        assert main(arguments(VEHICLE)) == 0
    mine = Path("out") / name
    mine.parent.mkdir(parents=True, exist_ok=True)
    mine.write_text(f"# note: mine\n{mine.read_text()}" if mine.exists() else "mine")
    return mine


@pytest.mark.sample(1)
@pytest.mark.filterwarnings("default")
@pytest.mark.parametrize(("command", "name"), QUICK, ids=[c.split(" --")[0] for c, _ in QUICK])
def test_a_file_of_another_is_replaced_with_force_alone(
    command: str, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    mine = occupied(command, name)
    before = mine.read_text()
    assert "--force" in refusal(command, capsys)
    assert mine.read_text() == before
    assert main([*arguments(command), "--force"]) == 0
    assert mine.read_text() != before
    assert "replaced" in capsys.readouterr().err


@pytest.mark.parametrize(("command", "name"), LONG, ids=[c.split(" --")[0] for c, _ in LONG])
def test_a_long_command_refuses_before_its_work_and_names_force(
    command: str, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    mine = occupied(command, name)
    assert "--force" in refusal(command, capsys)
    assert mine.read_text() == "mine"


def leaves(command: click.Command, name: str = "") -> Iterator[tuple[str, click.Command]]:
    """Commands that are no groups, with their full names."""
    if not isinstance(command, click.Group):
        yield name, command
        return
    context = click.Context(command)
    for below in command.list_commands(context):
        found = command.get_command(context, below)
        assert found is not None
        yield from leaves(found, f"{name} {below}".strip())


def test_every_command_that_writes_results_has_the_option() -> None:
    """Except update-tables, which revises a vehicle with a history of its own: its --out makes a copy."""
    options = {name: {o for p in command.params for o in p.opts} for name, command in leaves(cli)}
    without = {name for name, own in options.items() if own & {"--out", "--ssp"} and "--force" not in own}
    assert without == {"update-tables"}
    assert "--force" in options["ratio-tables"]
    assert "--force" in options["credibility add"]


def test_a_revised_ratio_table_is_not_built_again_even_with_force(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(arguments(VEHICLE)) == 0
    shutil.move("out", "pod")
    table = Path("pod/ratio_tables/NOSE.csv")
    table.write_text(f"# revision: 1\n# parent_revision: 0\n{table.read_text()}")
    assert "from flight data" in refusal("ratio-tables pod --force", capsys)
