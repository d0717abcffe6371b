"""Schemas and pages of the file formats agree with the models that read the files, and with the files themselves."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Iterator
from typing import Any

import pytest
from click.testing import CliRunner
from jsonschema import Draft202012Validator

from sim_heating.base.files.schema import SCHEMAS, schema_line, schema_path
from sim_heating.cli import cli
from sim_heating.estimation.report.estimate_file import read_estimate
from sim_heating.formats.catalogue import FORMATS, format_named, formats_with_schema
from tests.support.paths import ROOT
from tools.format_pages import MARK, pages, shipped_files

WITH_SCHEMA = [f.name for f in formats_with_schema()]


def validator(name: str) -> Draft202012Validator:
    js = json.loads(schema_path(name).read_text())
    Draft202012Validator.check_schema(js)
    return Draft202012Validator(js)


def test_each_schema_and_each_page_is_the_one_that_the_models_give():
    """They are written by `python -m tools.format_pages`."""
    written = pages()
    assert len(written) > len(FORMATS)
    assert [path.name for path, text in written.items() if path.read_text() != text] == []


def test_every_shipped_file_fits_its_schema():
    found = shipped_files()
    assert {d.name for d in found.values()} >= set(WITH_SCHEMA) - {"estimate"}
    checks = {name: validator(name) for name in WITH_SCHEMA}
    wrong = [
        f"{path.relative_to(ROOT)}: {error.json_path}: {error.message}"
        for path, declared in found.items()
        for error in checks[declared.name].iter_errors(tomllib.loads(path.read_text()))
    ]
    assert not wrong, "\n".join(wrong)


def test_the_first_line_of_every_shipped_file_leads_to_its_schema():
    for path, declared in shipped_files().items():
        line = path.read_text().partition("\n")[0]
        assert line == schema_line(declared.name, path.parent)
        assert (path.parent / line.removeprefix(MARK)).resolve() == schema_path(declared.name)


@pytest.mark.parametrize("name", WITH_SCHEMA)
def test_every_key_has_a_description(name: str):
    def without(js: Any, place: str) -> Iterator[str]:
        for key, value in js.get("properties", {}).items():
            if "description" not in value and "$ref" not in json.dumps(value):
                yield f"{place}.{key}"

    js = json.loads(schema_path(name).read_text())
    found = [w for place, m in ({"": js} | js.get("$defs", {})).items() for w in without(m, place)]
    assert not found


@pytest.mark.parametrize(
    ("name", "file", "place", "value"),
    [
        ("scenario", "scenarios/popu_mach20.toml", "vehicel", "orbiter"),
        ("scenario", "scenarios/popu_mach20.toml", "vehicle", 3),
        ("record", "scenarios/records/practice/p08/record.toml", "stack.initial_K", "20 C"),
        ("record", "scenarios/records/practice/p08/record.toml", "heating.reference", "newton"),
        ("vehicle", "aircraft_data/capsule/vehicle.toml", "reference_length_m", 3900.0),  # mm
        ("material", "aircraft_data/capsule/materials/al2219.toml", "density_kg_m3", None),  # left out
    ],
)
def test_an_editor_sees_what_the_program_refuses(name: str, file: str, place: str, value: Any):
    data = tomllib.loads((ROOT / file).read_text())
    check = validator(name)
    assert check.is_valid(data)
    *tables, key = place.split(".")
    table = data
    for t in tables:
        table = table[t]
    if value is None:
        del table[key]
    else:
        table[key] = value
    assert not check.is_valid(data)


def test_a_file_of_a_user_names_its_schema_and_no_machine():
    assert schema_line("record", SCHEMAS.parent) == "#:schema schemas/record.schema.json"
    assert schema_line("record") == "#:schema record.schema.json"


@pytest.mark.parametrize("name", [f.name for f in FORMATS])
def test_the_command_prints_the_keys_of_a_format(name: str):
    result = CliRunner().invoke(cli, ["formats", name])
    assert result.exit_code == 0, result.output
    assert len(result.output.splitlines()) > 5


def test_the_command_prints_a_schema_and_names_the_nearest_format():
    printed = CliRunner().invoke(cli, ["formats", "record", "--schema"])
    assert json.loads(printed.output) == json.loads(schema_path("record").read_text())
    wrong = CliRunner().invoke(cli, ["formats", "recrod"])
    assert "did you mean `record`" in str(wrong.exception)


def test_the_examples_of_results_are_results():
    folder = ROOT / "docs" / "reference" / "formats" / "examples"
    assert read_estimate(folder / "estimate.json").converged
    assert not list(validator("estimate").iter_errors(json.loads((folder / "estimate.json").read_text())))
    keys = set(format_named("closure").keys)
    assert {*json.loads((folder / "closure.json").read_text()), "effects"} == keys
