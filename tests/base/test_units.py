"""Units as loggers, ranges and tools write them: one parser for records, options, links and FMUs."""

from __future__ import annotations

import pytest

from sim_heating.base.files.units import converted, known_unit, name_and_unit
from sim_heating.live.sources.mapping import unit_conversion

SPELLINGS = {
    ("K", 293.15, 293.15): ("K", "kelvin", "Kelvin", "°K", "deg K", "k"),
    ("K", 20.0, 293.15): (
        "C", "(deg. C)", "Deg C", "DEG C", "degC", "deg_C", "°C", "ºC", "℃", "*C", "?C", "Â°C", "\ufffdC", "[°C]",
        "celsius", "degrees Celsius", "oC", "°C (LGR S/N: 1, SEN S/N: 1)",
    ),
    ("K", 68.0, 293.15): ("F", "oF", "(deg. F)", "°F", "degF", "Deg F", "Fahrenheit", "°F (LGR S/N: 1, SEN S/N: 1)"),
    ("K", 527.67, 293.15): ("R", "(deg R)", "degR", "°R", "Rankine"),
    ("W/m2", 1.0, 11356.5283): (
        "BTU/ft2-s", "BTU/ft2/s", "Btu/ft^2-sec", "BTU/ft²·s", "BTU/(ft2 s)", "(BTU/ft2 s)", "BTU per sq. ft per s",
        "BTU per square foot per second",
    ),
    ("W/m2", 1.0, 3.1545911857): ("BTU/hr-ft2", "BTU/ft2-hr"),
    ("W/m2", 900.0, 900.0): ("W m-2", "W per sq. m", "W/m2", "W/m^2", "W/m²", "W·m⁻²", "W/sq m", "Watts/m2", "W*m^-2",
                           "W per square meter", "W/square metre"),
    ("W/m2", 2.0, 20000.0): ("W/cm2", "W/cm^2", "W per sq. cm"),
    ("W/(m2.K)", 8.0, 8.0): ("W/m2K", "W/m2 K", "W/m2-K", "W/(m2.K)", "W/m²·K", "W/m2C", "W/(m2 °C)"),
    ("m", 10.0, 2.54e-4): ("mil", "mils", "thou"),
    ("s", 1500.0, 1.5): ("ms", "msec", "millis", "milliseconds"),
    ("s", 2.0, 2.0): ("s", "sec", "sec.", "Sec", "SECONDS", "S"),
    ("s", 2.0, 120.0): ("min", "Min", "minutes", "mins."),
    ("kg/m3", 1.0, 515.378818): ("slug/ft3", "slug/cu.ft", "slugs/ft^3", "slugs per cubic ft"),
    ("m/s", 100.0, 30.48): ("ft/s", "fps", "ft/sec", "feet per second"),
    ("rad/s", 30.0, 3.14159265359): ("rpm", "RPM", "rev/min", "Rev/Min", "r/min", "U/min", "Upm", "revs per minute"),
    ("rad/s", 180.0, 3.14159265359): ("deg/s", "°/s", "dps"),
    ("m3/s", 60.0, 1e-3): ("l/min", "L/min", "lpm", "LPM"),
    ("m3/s", 100.0, 0.0471947443): ("cfm", "CFM", "ft3/min"),
    ("V", 5.0, 0.005): ("mV", "mVDC", "mV DC"),
    ("A", 4.0, 4.0): ("A", "Amp", "amps"),
    ("ohm", 2.0, 2000.0): ("kOhm", "kohm", "kohms", "kΩ", "k\u2126"),
    ("ohm", 2.0, 2e6): ("MOhm", "Mohm", "MΩ"),
    ("Pa", 1.0, 1e5): ("bar", "Bar", "bara", "bar(a)", "bar a", "bar abs"),
    ("Pa", 1.0, 1000.0): ("kPa", "kPaA", "kPa(a)", "kPa abs"),
    ("Pa", 750.0, 99991.7763): ("torr", "Torr"),
    ("N.m", 3.0, 3.0): ("Nm", "N·m", "N m"),
    ("1", 40.0, 0.4): ("%", "%RH", "% rh", "% r.H."),
}  # fmt: skip
"""SI unit, number in the unit, number in the SI unit -> spellings."""


@pytest.mark.parametrize(("si", "number", "in_si"), SPELLINGS)
def test_a_unit_is_read_however_a_logger_spells_it(si: str, number: float, in_si: float) -> None:
    for spelling in SPELLINGS[si, number, in_si]:
        found = converted(spelling, si)
        assert found is not None, spelling
        assert found(number) == pytest.approx(in_si, rel=1e-8), spelling
        assert unit_conversion(spelling, si, "a link")(number) == pytest.approx(in_si, rel=1e-8)  # links read the same


@pytest.mark.parametrize("text", ["counts", "Avg", "Smp", "deg", "mV", "hh:mm", "°", "GMT-07:00", "", "C/s", "m", "%"])
def test_a_text_that_is_no_temperature_is_none(text: str) -> None:
    assert converted(text, "K") is None


def test_a_unit_of_two_readings_is_refused() -> None:
    assert known_unit("W/mK") != known_unit("W/(m.K)")  # mK is a millikelvin
    assert known_unit("1/s.m") is None


def test_a_share_is_a_unit_alone_and_no_factor_of_another() -> None:
    """`%s` would be a hundredth of a second, and `rh`, a humidity, 1e-27 of an hour."""
    for text in ("%s", "% s", "s.%", "percent s", "ppm s", "rh", "%K", "K%", "ppm K", "%W/m2", "W/m2 %"):
        assert known_unit(text) is None, text
    assert known_unit("%") == known_unit("percent") is not None
    assert converted("%/s", "1/s") is not None


def test_a_short_name_that_a_logger_means_otherwise_is_no_unit() -> None:
    """pint reads them as bar times gram or year, centifemtometre, elementary charges, parsecs, carats."""
    for text in ("bar(g)", "kPag", "psig", "bar g", "ue", "me", "pcs", "ct", "a", "Nm3/h", "VAC", "counts/ue"):
        assert known_unit(text) is None, text


@pytest.mark.parametrize(
    ("head", "name", "unit"),
    [
        ("TC1 [degC]", "TC1", "degC"), ("Heat Flux (BTU/ft2-s)", "Heat Flux", "BTU/ft2-s"), ("Time/s", "Time", "s"),
        ("Temp, °F (LGR S/N: 1, SEN S/N: 1)", "Temp", "°F"), ("q_kW_m2", "q", "kW/m2"), ("TC1_C", "TC1", "C"),
        ("TC 1", "TC 1", ""), ("TC1 deg. F", "TC1", "deg. F"), ("T (mV)", "T", "mV"), ("q W/m2", "q", "W/m2"),
        ("Temperature (*C) c:1", "Temperature", "*C"), ("TC_A", "TC_A", ""), ("k", "k", ""),
        ("T (K), Point: 1", "T Point: 1", "K"), ("TC_Avg(2)", "TC_Avg(2)", ""), ("T, °C", "T", "°C"),
    ],
)  # fmt: skip
def test_a_head_is_a_name_and_a_unit(head: str, name: str, unit: str) -> None:
    assert name_and_unit(head, ("s", "K", "W/m2")) == (name, unit)
