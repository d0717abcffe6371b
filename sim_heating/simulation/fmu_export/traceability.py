"""What an exported model can be trusted for, inside the export: Simulation Resource Meta Data (SRMD) with its evidence.

    resources/traceability/heating.srmd       version, inputs with digests, credibility, region validated, references
    resources/traceability/credibility.json   the credibility statement, as results of `run` hold it
    resources/traceability/reference.csv      inputs of a reference descent and the temperatures of `HeatingPlugin`

A host repeats reference.csv with `input_timing` = reached, steps of 1 s, and compares. In a system (SSP) the file
resources/heating.srmd names heating.fmu with its SHA3-256 digest.

Source: SSP Traceability 1.0, Modelica Association / prostep ivip, SRMD.xsd; NASA-STD-7009 for the statement.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from xml.etree import ElementTree as ET

import numpy as np

from sim_heating.base.conditions import FRAME, Conditions
from sim_heating.base.files import csv_text
from sim_heating.base.files.package import package_version
from sim_heating.credibility.facts.of_flight import facts_of_model
from sim_heating.credibility.statement import assess
from sim_heating.credibility.validation.own_cases import all_cases
from sim_heating.credibility.validation.region import UNITS, ValidationCase
from sim_heating.heating.atmosphere import free_stream, us76
from sim_heating.inputs.vehicle import Vehicle
from sim_heating.simulation.fmu_export.parts.description import generation_time, xml_bytes
from sim_heating.simulation.plugin import HeatingPlugin

SRMD = "http://ssp-standard.org/SSPTraceability1/SimulationResourceMetaData"
STC = "http://ssp-standard.org/SSPTraceability1/SSPTraceabilityCommon"
XLINK = "http://www.w3.org/1999/xlink"
VERSION = "1.0.0"
DOMAIN = "org.sim-heating"
"""Namespace of the types of the classifications."""
FOLDER = "resources/traceability"
DURATION_S = 60
ALTITUDES_M, SPEEDS_M_S = (70e3, 62e3), (6500.0, 5500.0)
"""First and last altitude and speed of the reference descent, in the standard atmosphere."""

for _prefix, _namespace in (("srmd", SRMD), ("stc", STC), ("xlink", XLINK)):
    ET.register_namespace(_prefix, _namespace)

Entries = Sequence[tuple[str, str, str]]
"""Keyword, text and file of entries; the file is empty where there is none."""


def srmd_bytes(name: str, classes: Mapping[str, Entries], data: str = "", content: bytes = b"") -> bytes:
    """A document of SRMD.

    name    : of the resource;  classes : type of each classification below DOMAIN -> its entries
    data    : address of the file that it is about;  content : of that file, for its digest; empty where it is inside it
    """
    root = ET.Element(
        f"{{{SRMD}}}SimulationResourceMetaData",
        {
            "version": VERSION,
            "name": name,
            "generationTool": f"sim-heating {package_version()}",
            "generationDateAndTime": generation_time(),
        },
    )
    if data:
        root.attrib |= {"data": data, "checksum": hashlib.sha3_256(content).hexdigest(), "checksumType": "SHA3-256"}
    for kind, entries in classes.items():
        classification = ET.SubElement(root, f"{{{STC}}}Classification", type=f"{DOMAIN}.{kind}")
        for keyword, text, link in entries:
            entry = ET.SubElement(classification, f"{{{STC}}}ClassificationEntry", keyword=keyword)
            entry.text = text
            if link:
                entry.set(f"{{{XLINK}}}href", link)
    return xml_bytes(root)


class Traceability:
    """What is known about an exported heating model.

    vehicle, control_points : as `export_fmu` takes them
    columns                 : h_ref and H_r are inputs: there is then no reference descent
    """

    def __init__(self, vehicle: Vehicle, control_points: Sequence[str] | None, *, columns: bool = False) -> None:
        plugin = HeatingPlugin(vehicle, control_points)
        frames = _descent(plugin, vehicle)
        surface, bondline = _temperatures(plugin, frames)
        models = plugin.ensemble.models[: len(plugin.names)]
        statement = assess(facts_of_model(vehicle, plugin.points, models, frames, list(surface.T)))
        self.title = f"Heating of {vehicle.title}"
        self.credibility = statement.as_json()
        self.reference = "" if columns else _reference_text(plugin, frames, surface, bondline)
        self.classes: dict[str, Entries] = {
            "model": [
                ("vehicle", vehicle.name, ""),
                ("revision", str(vehicle.revision), ""),
                ("control points", ", ".join(plugin.names), ""),
                *((name, digest, "") for name, digest in statement.facts.files.items()),
            ],
            "credibility": [
                ("statement", str(self.credibility["summary"]), "credibility.json"),
                *(
                    (name, f"level {'not assessed' if f['level'] is None else f['level']}: {f['reason']}", "")
                    for name, f in self.credibility["factors"].items()
                ),
            ],
            "validated-region": [(case.name, text, "") for case in all_cases() for text in _region_texts(case)],
            "reference-results": [("none", "h_ref and H_r are inputs", "")]
            if columns
            else [
                ("descent", f"{DURATION_S} s, steps of 1 s, input_timing reached, HeatingPlugin", "reference.csv"),
                ("tolerance_K", "0.5", ""),
            ],
        }

    def files(self) -> dict[str, bytes]:
        """Content of the files inside the FMU, by name."""
        contents = {
            f"{FOLDER}/heating.srmd": srmd_bytes(self.title, self.classes),
            f"{FOLDER}/credibility.json": (json.dumps(self.credibility, indent=1) + "\n").encode(),
        }
        return contents | ({f"{FOLDER}/reference.csv": self.reference.encode()} if self.reference else {})

    def of_file(self, data: str, content: bytes) -> bytes:
        """A document of SRMD beside the file that it is about; what it links to lies in the archive of that file."""
        return srmd_bytes(
            self.title, {k: [(w, t, "") for w, t, _ in e] for k, e in self.classes.items()}, data, content
        )


def _region_texts(case: ValidationCase) -> list[str]:
    """Conditions of each range of Mach numbers of a measured data set, with the error of its prediction."""
    texts = []
    for band in case.bands:
        ends = ", ".join(f"{n} {low:g} to {high:g}{UNITS[n]}" for n, (low, high) in band.limits.items())
        texts.append(f"{case.vehicle} {case.control_point}, {case.kind}: {ends}; RMSE {band.rmse_K:.3g} K, n {band.n}")
    return texts


def _descent(plugin: HeatingPlugin, vehicle: Vehicle) -> Conditions:
    """Conditions of the reference descent, a second apart; angle of attack in the middle of the first point's table."""
    t = np.arange(DURATION_S + 1.0)
    z, V = (np.interp(t, (0.0, DURATION_S), ends) for ends in (ALTITUDES_M, SPEEDS_M_S))
    rho = us76(z)[2]
    axis = plugin.points[0].ratio.axes[0]
    columns = {n: np.zeros(len(t)) for n in FRAME} | {"time_s": t, "altitude_m": z, "velocity_m_s": V, "rho_kg_m3": rho}
    columns["alpha_deg"] = np.full(len(t), round(0.5 * float(axis[0] + axis[-1]), 3))
    return Conditions(columns | free_stream(z, V, rho, vehicle.reference_length_m))


def _temperatures(plugin: HeatingPlugin, frames: Conditions) -> tuple[np.ndarray, np.ndarray]:
    """(time, point) temperatures of the surface and the bondline [K]."""
    rows = [{n: float(frames[n][i]) for n in FRAME} for i in range(len(frames))]
    plugin.reset(rows[0])
    rows_K = []
    for i, row in enumerate(rows):
        if i:
            plugin.step(row)
        rows_K.append([[d[name] for name in plugin.names] for d in (plugin.surface_K, plugin.bondline_K)])
    both = np.array(rows_K)
    return both[:, 0], both[:, 1]


def _reference_text(plugin: HeatingPlugin, frames: Conditions, surface: np.ndarray, bondline: np.ndarray) -> str:
    columns = {n: frames[n] for n in FRAME}
    for i, name in enumerate(plugin.names):
        columns |= {f"{name}.surface_K": surface[:, i], f"{name}.bondline_K": bondline[:, i]}
    formats = dict.fromkeys(columns, ".10g")
    return csv_text(columns, formats)
