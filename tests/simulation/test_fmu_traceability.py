"""What an exported FMU can be trusted for lies inside it: SRMD of SSP Traceability, valid, with its evidence."""

from __future__ import annotations

import csv
import hashlib
import io
import json
import shutil
import zipfile
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from sim_heating.base.conditions import FRAME
from sim_heating.inputs.vehicle import load_vehicle
from sim_heating.simulation.fmu_export.traceability import FOLDER, SRMD, STC, Traceability, srmd_bytes
from tests.support.fmu_hosts import compile_host, run_host

KINDS = [f"org.sim-heating.{k}" for k in ("model", "credibility", "validated-region", "reference-results")]


@pytest.fixture(scope="module")
def about() -> Traceability:
    return Traceability(load_vehicle("capsule"), ["FACE"])


def entries(document: bytes) -> dict[str, dict[str, str]]:
    """Text of the entries of each classification, by keyword."""
    root = ET.fromstring(document)
    assert root.tag == f"{{{SRMD}}}SimulationResourceMetaData"
    return {
        c.get("type", ""): {e.get("keyword", ""): e.text or "" for e in c.iter(f"{{{STC}}}ClassificationEntry")}
        for c in root.iter(f"{{{STC}}}Classification")
    }


def test_the_document_conforms_to_the_schema_of_ssp_traceability(about, tmp_path):
    srmd = pytest.importorskip("pyssp_standard.srmd")
    place = tmp_path / "heating.srmd"
    place.write_bytes(about.files()[f"{FOLDER}/heating.srmd"])
    with srmd.SRMD(place) as document:
        document.__check_compliance__()
        assert [c.classification_type for c in document.classifications] == KINDS


def test_the_document_states_credibility_region_and_references(about):
    found = entries(about.files()[f"{FOLDER}/heating.srmd"])
    statement = json.loads(about.files()[f"{FOLDER}/credibility.json"])
    assert found[KINDS[0]]["vehicle"] == "capsule"
    assert found[KINDS[1]]["statement"] == statement["summary"]
    assert set(statement["factors"]) <= set(found[KINDS[1]])
    assert any("mach" in text and "RMSE" in text for text in found[KINDS[2]].values())
    assert "60 s" in found[KINDS[3]]["descent"]


def test_a_document_beside_a_file_carries_its_digest(about):
    root = ET.fromstring(about.of_file("heating.fmu", b"content"))
    assert root.get("data") == "heating.fmu"
    assert root.get("checksum") == hashlib.sha3_256(b"content").hexdigest()


def test_a_model_whose_heating_is_an_input_states_no_reference_results():
    about = Traceability(load_vehicle("capsule"), ["FACE"], columns=True)
    assert entries(about.files()[f"{FOLDER}/heating.srmd"])[KINDS[3]] == {"none": "h_ref and H_r are inputs"}
    assert f"{FOLDER}/reference.csv" not in about.files()


def test_a_title_that_xml_cannot_hold_does_not_break_the_document():
    assert ET.fromstring(srmd_bytes("a \x01 <b>", {})).get("name") == "a   <b>"


@pytest.mark.thorough
@pytest.mark.skipif(shutil.which("gcc") is None, reason="needs a C compiler")
def test_the_fmu_gives_its_reference_results_in_a_plain_c_host(tmp_path):
    from sim_heating.simulation.fmu_export.export import export_fmu

    fmu = tmp_path / "capsule.fmu"
    export_fmu("capsule", fmu, ["FACE"])
    text = zipfile.ZipFile(fmu).read(f"{FOLDER}/reference.csv").decode()
    rows = [{k: float(v) for k, v in row.items()} for row in csv.DictReader(io.StringIO(text))]
    frames = [{n: row[n] for n in FRAME if n in ("time_s", "altitude_m", "velocity_m_s", "alpha_deg", "beta_deg",
                                                 "rho_kg_m3")} for row in rows]  # fmt: skip
    names = ["FACE.surface_K", "FACE.bondline_K"]
    found = run_host(compile_host(tmp_path), fmu, "reached", frames, names)
    expected = np.array([[row[n] for n in names] for row in rows])
    assert np.max(np.abs(found - expected)) < 0.5
    assert expected[-1, 0] - expected[0, 0] > 100.0
