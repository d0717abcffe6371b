"""FlightGear's generic protocol for a link: the line that its file describes is what the link file reads."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree

import pytest

from sim_heating.live.sources.json_lines import JsonDecoder
from sim_heating.live.sources.mapping import FieldMapping
from sim_heating.live.spec import load_link
from sim_heating.live.types import Message
from tests.support.paths import ROOT

LIVE = ROOT / "scenarios" / "live"
SEPARATORS = {"newline": "\n", "tab": "\t", "space": " "}
"""Words that FlightGear takes for characters."""
FLIGHT = {
    "simulation/sim-time-sec": 812.345678, "position/h-sl-ft": 240123.4567, "velocities/vt-fps": 20123.45678,
    "aero/alpha-deg": 39.987654, "aero/beta-deg": -0.012345, "fcs/elevator-pos-deg": -2.5,
    "atmosphere/rho-slugs_ft3": 8.765432e-8,
}  # fmt: skip


def rendered(properties: dict[str, float]) -> str:
    """A line as FlightGear writes it: factor and offset, then the format of C, chunk by chunk."""
    output = ElementTree.parse(LIVE / "flightgear.xml").getroot().find("generic/output")
    assert output.findtext("binary_mode") == "false"
    written = []
    for chunk in output.findall("chunk"):
        assert chunk.findtext("type") == "double"  # any other is rounded to an integer or to single precision
        assert chunk.findtext("format").count("%") == 1
        value = properties[chunk.findtext("node").removeprefix("/fdm/jsbsim/")]
        value = float(chunk.findtext("offset", "0")) + value * float(chunk.findtext("factor", "1"))
        written.append(chunk.findtext("format") % value)
    between, end = (output.findtext(f"{name}_separator") for name in ("var", "line"))
    return SEPARATORS.get(between, between).join(written) + SEPARATORS.get(end, end)


def test_a_line_of_flightgear_is_a_frame_of_the_link():
    line = rendered(FLIGHT)
    assert line.endswith("}\n")
    assert len(line) < 1000  # a datagram
    mapping = FieldMapping(load_link(LIVE / "flightgear.toml"))
    (frame,) = mapping.apply(Message(0.0, line.encode(), JsonDecoder().decode(line.encode())))
    assert frame.time_s == pytest.approx(812.345678)
    assert frame.values == pytest.approx(
        {
            "altitude_m": 240123.4567 * 0.3048, "velocity_m_s": 20123.45678 * 0.3048, "alpha_deg": 39.987654,
            "beta_deg": -0.012345, "elevon_deg": -2.5, "bodyflap_deg": 0.0, "rho_kg_m3": 8.765432e-8 * 515.3788184,
        },
        rel=1e-6, abs=1e-5,
    )  # fmt: skip
    assert frame.values["rho_kg_m3"] == pytest.approx(8.765432e-8 * 515.3788184, rel=1e-6)


def test_the_properties_are_those_of_jsbsim(tmp_path):
    jsbsim = pytest.importorskip("jsbsim")
    fdm = jsbsim.FGFDMExec(None)
    fdm.set_debug_level(0)
    fdm.set_output_path(str(tmp_path))  # of a file that its ball writes
    fdm.load_model("ball")
    fdm["ic/h-sl-ft"], fdm["ic/vt-fps"] = 240000.0, 20000.0
    fdm.run_ic()
    catalogue = {line.split(" ")[0] for line in fdm.query_property_catalog("").splitlines()}
    assert catalogue >= set(FLIGHT)
    assert all(math.isfinite(fdm[name]) for name in FLIGHT)
    assert '"h_ft":240000.000' in rendered({name: fdm[name] for name in FLIGHT})
