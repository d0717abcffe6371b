"""The sampled maps of an image after FMI-LS-STRUCT 1.0.0-rc.1, a release candidate of a layered standard of FMI 3.

A tool for calibration reads from it which arrays are the nodes and the values of one map. Each map is a terminal of
kind `rectilinearGrid`, whose members are, for each axis, the array of its nodes and the variable at whose value the map
is evaluated, then the array of its values. The manifest in `extra` says that terminals are to be read in this way.

Source: FMI Layered Standard for Structured Data (FMI-LS-STRUCT) 1.0.0-rc.1, sections 2 to 4; terminals: FMI 3.0.
"""

from __future__ import annotations

from xml.etree import ElementTree as ET

from sim_heating.simulation.fmu_export.parts.description import xml_bytes
from sim_heating.simulation.fmu_export.parts.image import Image, SampledMap

NAME, VERSION = "org.fmi-standard.fmi-ls-struct", "1.0.0-rc.1"
MANIFEST, TERMINALS = f"extra/{NAME}/fmi-ls-manifest.xml", "terminalsAndIcons/terminalsAndIcons.xml"
"""Entries of the archive."""
_MANIFEST_NAMESPACE = "http://fmi-standard.org/fmi-ls-manifest"
ET.register_namespace("fmi-ls", _MANIFEST_NAMESPACE)


def map_files(image: Image) -> dict[str, bytes]:
    """Manifest and terminals of an image's maps, by their entries in the archive; nothing where it has no map."""
    return {MANIFEST: _manifest(), TERMINALS: _terminals(image)} if image.maps else {}


def _manifest() -> bytes:
    stated = {"name": NAME, "version": VERSION, "description": "Layered standard for structuring of variables"}
    names = {f"{{{_MANIFEST_NAMESPACE}}}fmi-ls-{key}": value for key, value in stated.items()}
    return xml_bytes(ET.Element("fmiLayeredStandardManifest", names))


def _terminals(image: Image) -> bytes:
    root = ET.Element("fmiTerminalsAndIcons", fmiVersion="3.0")
    terminals = ET.SubElement(root, "Terminals")
    for sampled in image.maps:
        _terminal(terminals, sampled)
    return xml_bytes(root)


def _terminal(parent: ET.Element, sampled: SampledMap) -> None:
    terminal = ET.SubElement(
        parent,
        "Terminal",
        name=sampled.name,
        terminalKind=f"{NAME}.map.rectilinearGrid",
        matchingRule=f"{NAME}.map",
        description=sampled.text,
    )

    def add_member(variable: str, member: str, kind: str) -> None:
        full_kind = f"{NAME}.map.{kind}"
        ET.SubElement(
            terminal, "TerminalMemberVariable", variableName=variable, memberName=member, variableKind=full_kind
        )

    # An operating point belongs directly after its nodes.
    for axis, point in zip(sampled.axes, sampled.operating_point, strict=True):
        axis_name = axis.removeprefix(f"{sampled.name}.")
        add_member(axis, axis_name, "domain")
        add_member(point, f"{axis_name}_now", "domainInput")
    add_member(sampled.values, sampled.values.removeprefix(f"{sampled.name}."), "codomain")
