"""The file of an FMU: readable by everybody, and replaced only where it is an export that nobody has changed."""

from __future__ import annotations

import os
import shutil
import stat
import zipfile
from pathlib import Path

import pytest

from sim_heating.base.errors import InputError
from sim_heating.cli import main
from sim_heating.simulation.fmu_export.export import export_fmu
from sim_heating.simulation.fmu_export.parts.archive import RECORD, is_unmodified_export

pytestmark = pytest.mark.skipif(shutil.which("gcc") is None and shutil.which("cc") is None, reason="needs a C compiler")


@pytest.fixture(scope="module")
def exported(tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("archive") / "capsule.fmu"
    export_fmu("capsule", out, ["FACE"])
    return out


def rewritten(source: Path, out: Path, change: dict[str, bytes], comment: bytes = b"") -> Path:
    """The archive with entries changed or added."""
    with zipfile.ZipFile(source) as before, zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as after:
        entries = {entry.filename: before.read(entry) for entry in before.infolist()}
        for name, data in {**entries, **change}.items():
            after.writestr(name, data)
        after.comment = comment
    return out


def foreign(_: Path, out: Path) -> None:
    with zipfile.ZipFile(out, "w") as archive:
        archive.writestr("modelDescription.xml", '<fmiModelDescription fmiVersion="2.0" modelName="Feedthrough"/>')
        archive.writestr("binaries/linux64/Feedthrough.so", b"\x7fELF")


def repeated_name(source: Path, out: Path) -> None:
    shutil.copy(source, out)
    with pytest.warns(UserWarning, match="Duplicate name"), zipfile.ZipFile(out, "a") as archive:
        archive.writestr("modelDescription.xml", b"<fmiModelDescription/>")


USERS_FILES = {
    "a text file": lambda source, out: out.write_text("notes on the entry\n"),
    "an empty file": lambda source, out: out.write_bytes(b""),
    "a foreign FMU": foreign,
    "an altered entry": lambda source, out: rewritten(source, out, {"resources/model.bin": b"sim-heating"}),
    "an added entry": lambda source, out: rewritten(source, out, {"documentation/index.html": b"<p>mine</p>"}),
    "a comment": lambda source, out: rewritten(source, out, {}, b"mine"),
    "a name twice": repeated_name,
    "a record that is none": lambda source, out: rewritten(source, out, {RECORD: b"[1, 2"}),
    "half an export": lambda source, out: out.write_bytes(source.read_bytes()[:20_000]),
    "a byte changed": lambda source, out: out.write_bytes(flipped(source.read_bytes())),
    "a link to an export": lambda source, out: out.symlink_to(source),
    "a link to nothing": lambda source, out: out.symlink_to(source.with_name("nothing.fmu")),
    "a pipe": lambda source, out: os.mkfifo(out),
}


def flipped(data: bytes) -> bytes:
    middle = len(data) // 2
    return data[:middle] + bytes([data[middle] ^ 1]) + data[middle + 1 :]


@pytest.mark.parametrize("kind", USERS_FILES)
def test_a_file_that_is_not_an_unmodified_export_is_refused_before_any_work(kind, exported, tmp_path, capsys):
    out = tmp_path / "x.fmu"
    USERS_FILES[kind](exported, out)
    before = out.read_bytes() if out.is_file() else None
    assert not is_unmodified_export(out)
    # A name that does not exist would be refused next: the file is refused before the vehicle is looked for.
    assert main(["fmu", "export", "no-such-vehicle", "--out", str(out)]) == 2
    error = capsys.readouterr().err.splitlines()
    assert len(error) == 1
    assert "x.fmu: exists and is not an unmodified export of sim-heating" in error[0]
    with pytest.raises(InputError, match="is not an unmodified export"):
        export_fmu("capsule", out, ["FACE"])
    assert os.path.lexists(out)
    assert before is None or out.read_bytes() == before


def test_an_unmodified_export_is_replaced_by_the_next_one(exported, tmp_path):
    out = tmp_path / "x.fmu"
    shutil.copy(exported, out)
    assert is_unmodified_export(out)
    export_fmu("capsule", out, ["FACE"], input_timing="reached")
    assert is_unmodified_export(out)
    with zipfile.ZipFile(out) as new, zipfile.ZipFile(exported) as old:
        assert new.read("resources/model.bin") != old.read("resources/model.bin")


def test_nothing_and_directories_are_no_exports(tmp_path):
    assert not is_unmodified_export(tmp_path)
    assert not is_unmodified_export(tmp_path / "nothing.fmu")


def test_a_trajectory_is_not_written_over_a_users_file(tmp_path, capsys):
    out = tmp_path / "notes.fmu"
    out.write_text("notes\n")
    assert main(["fmu", "trajectory", "no-such-scenario.toml", "--out", str(out)]) == 2
    assert "is not an unmodified export" in capsys.readouterr().err
    assert out.read_text() == "notes\n"


def test_files_unpacked_from_an_export_are_readable_by_everybody(exported, tmp_path):
    with zipfile.ZipFile(exported) as archive:
        modes = {entry.filename: entry.external_attr >> 16 for entry in archive.infolist()}
    assert all(stat.S_ISREG(mode) and mode & 0o444 == 0o444 and not mode & 0o022 for mode in modes.values())
    unzip = shutil.which("unzip")
    if unzip is None:
        pytest.skip("needs unzip to unpack with permissions")
    assert os.spawnv(os.P_WAIT, unzip, [unzip, "-q", str(exported), "-d", str(tmp_path / "unpacked")]) == 0
    files = [path for path in (tmp_path / "unpacked").rglob("*") if path.is_file()]
    assert len(files) == len(modes)
    assert all(path.stat().st_mode & 0o444 == 0o444 for path in files)
