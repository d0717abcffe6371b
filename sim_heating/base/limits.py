"""Physical limits of quantities, in a file, typed by a person or from a host, with the rule that a message states.

`LIMITS` holds the columns of flight conditions, `QUANTITIES` every number of a declared file, by its key or by the unit
that the key ends in. What is beyond them is impossible and is refused. The limits are wide: they catch values in
another unit and damaged samples, not unusual vehicles or flights. Where a value outside would be usual in another unit,
the message asks for it and states what to write.

`USUAL` holds the narrower range that flights, vehicles and materials have in fact, each with what it rests on. What is
beyond it is possible: it is accepted, and told in a line (`errors.tell`). Both tables serve records, trajectories,
links, scenarios, vehicles and studies alike; relations between columns are `heating.recorded.plausible`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from itertools import count

HOTTEST_K = 1e5
"""Upper limit of every temperature [K]."""
FASTEST_M_S = 20_000.0

LIMITS: dict[str, tuple[float, float, str]] = {
    "time_s": (-1e9, 1e9, "is not a time in seconds of a flight"),
    "altitude_m": (-5e3, 2e6, "is not an altitude in m (-5000 to 2e6)"),
    "T_inf_K": (0.0, HOTTEST_K, "is not a temperature of air"),
    "T_surroundings_K": (1.0, HOTTEST_K, "is not a temperature of surroundings in K (1 or above)"),
    "T_back_K": (1.0, HOTTEST_K, "is not a temperature behind a wall in K (1 or above)"),
    "q_Pa": (0.0, 1e8, "is not a dynamic pressure in Pa (0 or above)"),
    "q_add_W_m2": (-1e3, 1e8, "is not a flux in W/m2 that a wall absorbs from a lamp or the sun (-1000 to 1e8)"),
    "velocity_m_s": (0.0, FASTEST_M_S, "is not a speed in m/s (0 to 20000); a larger one looks like ft/s"),
    "mach": (0.0, 1e3, "is not a Mach number (0 to 1000)"),
    "alpha_deg": (-180.0, 180.0, "is not an angle of attack in degrees (-180 to 180)"),
    "beta_deg": (-90.0, 90.0, "is not a sideslip angle in degrees (-90 to 90)"),
    "log10_re": (-10.0, 20.0, "is not the base-10 logarithm of a Reynolds number (-10 to 20)"),
    "elevon_deg": (-90.0, 90.0, "is not a deflection in degrees (-90 to 90)"),
    "bodyflap_deg": (-90.0, 90.0, "is not a deflection in degrees (-90 to 90)"),
    "rho_kg_m3": (1e-300, 100.0, "is not a density of air in kg/m3 (above 0, to 100)"),
    "p_inf_Pa": (0.0, 1e10, "is not a pressure (0 or above)"),
    "p_surface_Pa": (0.0, 1e10, "is not a pressure (0 or above)"),
    "h_ref_kg_m2_s": (0.0, 100.0, "is not a film coefficient in kg/(m2 s) (0 to 100)"),
    "H_r_J_kg": (0.0, 2e10, "is not a recovery enthalpy in J/kg (0 to 5e8 of a flow; enthalpies are zero at 0 K)"),
    "jets": (0.0, 1.0, "is not a share of jets firing (0 to 1)"),
}
"""Column -> lowest value, highest value, and the rule that a message states about a value outside."""

LOW_RULE = "is too low for its speed and looks like km; give m"
HIGH_SPEED_M_S, LOW_M = 3000.0, 1000.0
"""Speed [m/s] above which, and altitude [m] below which, nothing flies at the same time."""


@dataclass(frozen=True)
class Quantity:
    """Range of a physical quantity in the unit of its key.

    lowest, highest : ends of the range, both included
    rule            : what a message states about a value outside, as in `8000 is not a position on a vehicle in m`
    slips           : unit that a value may be in by mistake -> size of that unit in the unit of the key
    usual           : range of values that a message may suggest in place of one in such a unit
    reach           : the last x of a schedule over this quantity is at least so large; a lower one is in another unit
    span            : several nodes over this quantity differ by at least so much from first to last
    """

    lowest: float
    highest: float
    rule: str
    slips: Mapping[str, float] = field(default_factory=dict)
    usual: tuple[float, float] = (-math.inf, math.inf)
    reach: float = -math.inf
    span: float = 0.0

    def problem(self, value: float) -> str | None:
        """`value rule; is this UNIT? write NUMBER` for a value outside the range, else None."""
        if self.lowest <= value <= self.highest:
            return None
        return f"{value:g} {self.rule}{self.suggestion(value)}"

    def suggestion(self, value: float) -> str:
        """`; is this UNIT? write NUMBER` where a value would be usual in another unit, else nothing."""
        for unit, size in self.slips.items():
            if self.usual[0] <= value * size <= self.usual[1]:
                return f"; is this {unit}? write {value * size:.10g}"
        return ""

    def axis_problem(self, first: float, last: float) -> str | None:
        """Problem of nodes from `first` to `last` that are so low, or so close, that they are in another unit; or None.

        A schedule of one node has first = last.
        """
        if first != last and abs(last - first) < self.span:
            return f"the nodes are {first:g} to {last:g}, closer together than {self.span:g}; check their unit"
        if not 0.0 < last < self.reach or not (question := self.suggestion(last)):
            return None
        return f"the schedule ends at {last:g}, below {self.reach:g}{question}"


def _range(
    lowest: float,
    highest: float,
    noun: str,
    slips: Mapping[str, float] | None = None,
    usual: tuple[float, float] = (-math.inf, math.inf),
) -> Quantity:
    return Quantity(lowest, highest, f"is not {noun} ({lowest:g} to {highest:g})", slips or {}, usual)


KM, MM, PERCENT, KILO = {"km": 1e3}, {"mm": 1e-3}, {"%": 0.01}, 1e3
SLOWEST_M_S = 20.0
"""Speed [m/s] that a flight is not slower than: a body that falls from rest has it within 2 s."""

_LENGTH = _range(-200.0, 200.0, "a length on a vehicle in m", MM, (-100.0, 100.0))
_SIZE = _range(1e-5, 200.0, "a length on a vehicle in m", MM, (1e-3, 100.0))
_SPEED = _range(SLOWEST_M_S, FASTEST_M_S, "a flight speed in m/s", {"km/s": 1e3}, (500.0, FASTEST_M_S))
_MACH = _range(0.0, 60.0, "a Mach number of a flight")
_TURN = _range(-360.0, 360.0, "an angle in degrees")
_TRAVEL = _range(-60.0, 60.0, "a deflection of a control surface in degrees")
_OFFSET = _range(0.0, 45.0, "a change of the angle of attack in degrees")
_RATIO = _range(0.0, 5.0, "a relative standard deviation", PERCENT, (0.01, 2.0))
_FACTOR = _range(1e-3, 1e3, "a factor on a property")
_LIMIT_K = Quantity(200.0, HOTTEST_K, "is not a temperature limit in K (200 to 100000); a lower one looks like Celsius")
_CLOCK = _range(LIMITS["time_s"][0], LIMITS["time_s"][1], "a time in seconds of a flight")
_WAIT = _range(0.0, 1e6, "a duration in s", {"ms": 1e-3}, (0.0, 1e4))

QUANTITIES: dict[str, Quantity] = {
    **{name: Quantity(*limits) for name, limits in LIMITS.items()},
    "altitude_m": Quantity(*LIMITS["altitude_m"], KM, (1e4, 2e6), reach=200.0),
    "velocity_m_s": Quantity(*LIMITS["velocity_m_s"], {"km/s": 1e3}, (500.0, FASTEST_M_S), reach=SLOWEST_M_S),
    **{name: Quantity(*LIMITS[name], span=0.1)
       for name in ("alpha_deg", "beta_deg", "elevon_deg", "bodyflap_deg")},
    "deflection_deg": Quantity(*LIMITS["elevon_deg"], span=0.1),
    "log10_re": Quantity(*LIMITS["log10_re"], span=0.02),
    # Tables of heating ratios: 300 is the ratio of a sphere of 10 micrometres to one of 1 m
    "heating_ratio": _range(0.0, 300.0, "a ratio of film coefficients"),
    "ratio_factor": _range(-1e3, 1e3, "a factor on a heating ratio"),
    "mach_of_table": Quantity(0.0, 60.0, "is not a Mach number of a flight (0 to 60)", span=0.05),
    "coefficient": _range(-1e3, 1e3, "an aerodynamic coefficient"),
    # State, schedules and manoeuvres of a flight
    "flight_speed_m_s": _SPEED, "at_velocity_m_s": _SPEED, "reversals_m_s": _SPEED,
    "at_mach": _MACH, "below_mach": _MACH, "bodyflap_above_mach": _MACH,
    "onset_log10_re": Quantity(*LIMITS["log10_re"]),
    "log10_re_onset": _range(1.0, 9.0, "the base-10 logarithm of Re, or of Re_theta / M_e, of transition"),
    "re_theta_over_m_e": _range(10.0, 1e4, "Re_theta / M_e of transition"),
    "alpha_sens": _range(-0.5, 0.5, "a fall of log10 Re with angle of attack in 1/deg"),
    "transition_factor": _range(0.1, 20.0, "a factor on turbulent heating"),
    "transition_width": _range(1e-4, 1.0, "a width in log10 Re"),
    "gamma_deg": _range(-90.0, 90.0, "a path angle in degrees"),
    "latitude_deg": _range(-90.0, 90.0, "a latitude in degrees"),
    "bank_deg": _range(-180.0, 180.0, "a bank angle in degrees"),
    "down_deg": _OFFSET, "up_deg": _OFFSET, "amplitude_deg": _TRAVEL, "from_deg": _TRAVEL, "to_deg": _TRAVEL,
    "sideslip_amplitude_deg": _range(-30.0, 30.0, "an amplitude of sideslip in degrees"),
    "wind_m_s": _range(-1e3, 1e3, "a wind in m/s"),
    "density_factor": _range(0.0, 50.0, "a factor on the density of the atmosphere", PERCENT, (0.5, 5.0)),
    "scale_height_m": _range(1e3, 1e5, "a scale height of an atmosphere in m", KM, (1e3, 1e5)),
    "flare_altitude_m": _range(0.0, 1e4, "an altitude of a flare in m"),
    "altitude_change_m": _range(0.0, 2e5, "a change of altitude in m"),
    "sample_offset_s": _range(-1e6, 1e6, "a time of a sample after the start in s"),
    "venting_tau_s": _range(0.0, 1e5, "a time constant of the pressure in an insulation in s"),
    "tau_s": _range(0.0, 600.0, "a time constant of a thermocouple in s", {"ms": 1e-3}, (0.0, 100.0)),
    "jet_q_fraction": _range(-1.0, 10.0, "a relative error of a dynamic pressure", PERCENT, (-0.9, 5.0)),
    "clock_skew_s": _range(-60.0, 60.0, "a skew of a recorder's clock in s", {"ms": 1e-3}, (-10.0, 10.0)),
    **dict.fromkeys(("until_s", "gaps_s", "fit_s", "holdout_s"), _CLOCK),
    **dict.fromkeys(("hold_s", "hold_down_s", "hold_up_s", "pause_s", "on_s", "off_s"),
                    _range(0.0, 3600.0, "a part of a manoeuvre in s", {"ms": 1e-3}, (0.0, 100.0))),
    # A vehicle and its parts
    "mass_kg": _range(1e-3, 5e6, "a mass of a vehicle in kg"),
    "nose_radius_m": _range(1e-5, 50.0, "a nose radius in m", MM, (1e-3, 10.0)),
    **dict.fromkeys(("running_length_m", "reference_length_m", "length_m", "chord_m", "span_m"), _SIZE),
    "position_m": _range(-200.0, 200.0, "a position on a vehicle in m", MM, (-100.0, 100.0)),
    "x_over_L": _range(0.0, 2.0, "a distance over the reference length", PERCENT, (0.0, 1.2)),
    "file_length_over_L": _range(0.0, 2.0, "a distance over the reference length", PERCENT, (0.0, 1.2)),
    **dict.fromkeys(("relative_sigma", "method_sigma", "correction_sigma"), _RATIO),
    "surface_K": _LIMIT_K, "bondline_K": _LIMIT_K,
    # Derivatives whose keys end in the angle that they are per
    "Cl_beta_deg": _range(-1.0, 1.0, "a rolling moment per degree"),
    "Cn_beta_deg": _range(-1.0, 1.0, "a yawing moment per degree"),
    "CY_beta_rad": _range(-50.0, 50.0, "a side force per radian"),
    # Materials, layers and faces
    "density_kg_m3": _range(1e-6, 2.3e4, "a density in kg/m3", {"g/cm3": KILO}, (100.0, 2.3e4)),
    "specific_heat_J_kgK": _range(1e-2, 1e6, "a specific heat in J/(kg K)", {"kJ/(kg K)": KILO}, (20.0, 1e4)),
    "specific_heat_from_100_K": _range(20.0, 1e6, "a specific heat in J/(kg K) from 100 K on", {"kJ/(kg K)": KILO},
                                       (50.0, 2e4)),
    "cp_J_kgK": _range(100.0, 2e4, "a specific heat of a gas in J/(kg K)", {"kJ/(kg K)": KILO}, (100.0, 2e4)),
    "conductivity_W_mK": _range(1e-6, 1e5, "a conductivity in W/(m K)"),
    "emissivity": _range(1e-3, 1.0, "an emissivity", PERCENT, (0.01, 1.0)),
    "effective_emissivity": _range(0.0, 1.0, "an effective emissivity", PERCENT, (0.0, 1.0)),
    "specific_heat_factor": _FACTOR, "conductivity_factor": _FACTOR,
    "thickness_m": _range(1e-9, 5.0, "a thickness of a layer in m", MM, (1e-6, 1.0)),
    "depth_m": _range(0.0, 5.0, "a depth in a wall in m", MM, (0.0, 1.0)),
    "contact_m2K_W": _range(0.0, 1e3, "a contact resistance in m2 K/W"),
    "p_Pa": _range(0.0, 1e10, "a pressure in Pa"),
    "T_K": _range(0.0, HOTTEST_K, "a temperature in K"),
    "stream_K": _range(0.0, HOTTEST_K, "a temperature of a free stream in K"),
    "initial_K": _range(0.0, HOTTEST_K, "a temperature in K"),
    "noise_sigma_K": _range(0.0, 1e3, "a standard deviation of a temperature in K"),
    "bias_K": _range(-2e3, 2e3, "an error of a temperature in K"),
}  # fmt: skip
"""Key of a declared file, or name that a model gives a number, -> its range."""

UNITS: dict[str, Quantity] = {
    "_kg_m2_s": _range(0.0, 1e4, "a film coefficient in kg/(m2 s)"),
    "_kg_m3": _range(0.0, 2.3e4, "a density in kg/m3"),
    "_kg_m2": _range(-1e12, 1e12, "a moment of inertia in kg m2"),
    "_W_m2K": _range(0.0, 1e7, "a film coefficient in W/(m2 K)"),
    "_m2K_W": _range(0.0, 1e3, "a contact resistance in m2 K/W"),
    "_J_kgK": _range(1e-2, 1e6, "a specific heat in J/(kg K)"),
    "_W_mK": _range(1e-6, 1e5, "a conductivity in W/(m K)"),
    "_W_m2": _range(-1e10, 1e10, "a heat flux in W/m2"),
    "_J_kg": _range(-1e11, 1e11, "an enthalpy in J/kg"),
    "_deg_s": _range(1e-4, 200.0, "an angular rate in deg/s"),
    "_rad_s": _range(0.0, 100.0, "an angular frequency in rad/s"),
    "_m_s2": _range(0.0, 1e4, "an acceleration in m/s2"),
    "_m_s": _range(-FASTEST_M_S, FASTEST_M_S, "a speed in m/s"),
    "_m2": _range(1e-6, 1e5, "an area in m2", {"mm2": 1e-6}, (1e-3, 1e4)),
    "_km": _range(-2e4, 2e4, "a distance in km"),
    "_deg": _TURN,
    "_Pa": _range(0.0, 1e10, "a pressure in Pa"),
    "_hz": _range(1e-6, 1e6, "a rate in Hz"),
    "_kg": _range(1e-3, 5e6, "a mass in kg"),
    "_m": _LENGTH,
    "_K": _range(-HOTTEST_K, HOTTEST_K, "a temperature in K"),
    "_s": _WAIT,
}
"""Unit that a key ends in, longer ones first -> range of a number whose key has none of its own."""


@dataclass(frozen=True)
class Usual:
    """Range in which values of a quantity lie in fact, in the unit of its key.

    lowest, highest : ends of the range, both included
    source          : what the range rests on
    """

    lowest: float
    highest: float
    source: str

    def remark(self, value: float) -> str | None:
        """`value is unusual (LOWEST to HIGHEST: SOURCE)` for a value outside the range, else None.

        A value of 0 stands for none. Where the lowest is above 0 the range is that of the magnitude.
        """
        if value == 0.0 or self.lowest <= (abs(value) if self.lowest > 0.0 else value) <= self.highest:
            return None
        return f"{value:g} is unusual ({self.lowest:g} to {self.highest:g}: {self.source}); check its unit"


_ANGLE = "flights of this kind"

_USUAL_RANGES: dict[str | tuple[str, ...], tuple[float, float, str]] = {
    # Columns of conditions
    "altitude_m": (-500.0, 4e5, "the Dead Sea to a low orbit"),
    "velocity_m_s": (0.0, 1.35e4, "the fastest entry from a solar orbit had 12.9 km/s"),
    # the lowest measured, cited from memory, not read: F. J. Schmidlin, mesopause temperatures lower than 100 K,
    # Geophysical Research Letters 19 (1992), 1643-1646
    "T_inf_K": (100.0, 1500.0, "the coldest mesopause to the thermosphere"),
    "stream_K": (35.0, 1500.0, "wind tunnels to the thermosphere"),
    ("T_surroundings_K", "surroundings_K"): (2.5, 2000.0, "space to a furnace"),
    "T_back_K": (120.0, 900.0, "a wall in orbit to a hot structure"),
    "T_upstream_K": (120.0, 2500.0, "a wall in orbit to carbon at the nose"),
    ("q_Pa", "qbar_Pa"): (0.0, 2e5, "entries stay below 0.1 MPa"),
    "q_add_W_m2": (-100.0, 5e6, "the noise of a flux gauge to the strongest lamps"),
    ("mach", "mach_of_table"): (0.0, 45.0, "entries from a solar orbit"),
    "alpha_deg": (-60.0, 180.0, "wings below 60 deg, capsules near 160 or -20 deg"),
    "beta_deg": (-20.0, 20.0, _ANGLE),
    ("elevon_deg", "bodyflap_deg", "from_deg", "to_deg"): (-45.0, 45.0, "travel of control surfaces"),
    "log10_re": (-2.0, 9.5, "a model at 130 km to a large vehicle at sea level"),
    "p_inf_Pa": (0.0, 2e5, "the atmosphere, at most twice that of sea level"),
    "p_surface_Pa": (0.0, 1e6, "stagnation pressures of entries"),
    "h_ref_kg_m2_s": (0.0, 5.0, "a nose of 1 cm at Mach 20 and 20 km has 3"),
    "H_r_J_kg": (1e5, 9.2e7, "air at 100 K to an entry at 13.5 km/s"),
    # A flight, its schedules and manoeuvres
    ("flight_speed_m_s", "at_velocity_m_s", "reversals_m_s"): (
        60.0, 1.35e4, "the fastest entry from a solar orbit had 12.9 km/s"),
    ("at_mach", "below_mach", "bodyflap_above_mach"): (0.2, 45.0, "entries from a solar orbit"),
    "log10_re_onset": (1.7, 8.0, "measured transitions, in Re_theta / M_e and in Re"),
    "re_theta_over_m_e": (50.0, 1000.0, "measured transitions"),
    "alpha_sens": (-0.1, 0.1, "measured transitions"),
    "transition_factor": (1.0, 8.0, "turbulent over laminar heating"),
    "transition_width": (5e-3, 0.5, "measured transitions"),
    ("bank_deg", "bank_limits_deg"): (-150.0, 150.0, _ANGLE),
    ("down_deg", "up_deg"): (1.0, 15.0, "manoeuvres of the Shuttle: 2 to 10 deg"),
    "amplitude_deg": (1.0, 20.0, "pulses of the Shuttle: 2 to 10 deg"),
    "sideslip_amplitude_deg": (0.2, 10.0, "manoeuvres of the Shuttle: 1 to 3 deg"),
    "rate_deg_s": (0.05, 40.0, "actuators move at up to 30 deg/s"),
    "alpha_rate_deg_s": (0.05, 20.0, "vehicles pitch at 1 to 5 deg/s"),
    "bank_rate_deg_s": (0.5, 40.0, "vehicles roll at 3 to 20 deg/s"),
    ("hold_s", "hold_down_s", "hold_up_s", "pause_s", "on_s", "off_s"): (0.5, 60.0, "parts of a manoeuvre"),
    "duration_s": (0.5, 1e4, "manoeuvres to whole entries"),
    "sample_s": (0.05, 10.0, "recorders of temperature sample at 0.1 to 10 Hz"),
    "rate_hz": (0.1, 300.0, "recorders and flight simulators"),
    "soak_s": (10.0, 2e4, "the heat of an entry reaches a structure within minutes to hours"),
    "horizon_s": (5.0, 3600.0, "a part of an entry"),
    "drag_m_s2": (0.1, 100.0, "drag of gliding entries"),
    "start_drag_m_s2": (0.02, 10.0, "guided entries begin at 0.1 to 1 m/s2"),
    "frequency_rad_s": (2e-3, 1.0, "loops of entry guidance"),
    "wind_m_s": (-250.0, 250.0, "the strongest jet streams have 120 m/s"),
    "density_factor": (0.4, 2.5, "the atmosphere's density over the standard one below 120 km"),
    "scale_height_m": (5e3, 1.2e4, "the Earth's atmosphere has 6 to 8.5 km"),
    "cross_range_km": (0.0, 5e3, "lifting entries"),
    "clock_skew_s": (-10.0, 10.0, "recorders of one vehicle"),
    "tau_s": (0.0, 60.0, "thermocouples in walls"),
    "venting_tau_s": (0.0, 1e3, "tiles vent within seconds"),
    # A vehicle and its parts
    "mass_kg": (5.0, 5e5, "a small capsule to the largest orbiter"),
    "nose_radius_m": (2e-3, 12.0, "a sharp wing to a blunt heat shield"),
    "reference_length_m": (0.2, 80.0, "a model to the largest orbiter"),
    "running_length_m": (0.01, 60.0, "a model to the largest orbiter"),
    "length_m": (0.02, 80.0, "a model to the largest orbiter"),
    ("chord_m", "span_m"): (0.1, 80.0, "a model to the largest orbiter"),
    ("reference_area_m2", "area_m2"): (0.02, 1000.0, "wings from a model to the Orbiter's 250 m2"),
    "position_m": (-80.0, 80.0, "a model to the largest orbiter"),
    ("step_m", "point_m"): (5e-3, 60.0, "running lengths of a vehicle"),
    "footprint_m": (1e-3, 5.0, "the extent of a joint"),
    "x_over_L": (0.0, 1.2, "a vehicle with its body flap"),
    ("surface_K", "max_use_K"): (350.0, 3500.0, "paints to carbon"),
    "bondline_K": (300.0, 1200.0, "adhesives to hot structures"),
    ("relative_sigma", "method_sigma", "correction_sigma"): (1e-3, 1.0, "tables of heating"),
    "inclination_deg": (-180.0, 180.0, _ANGLE),
    "local_angle_deg": (-20.0, 90.0, _ANGLE),
    # Materials, layers, faces and sensors
    "density_kg_m3": (20.0, 2e4, "felts and foams to tungsten"),
    "specific_heat_from_100_K": (90.0, 5e3, "metals to water; a peak of latent heat declares apparent = true"),
    "conductivity_W_mK": (4e-3, 500.0, "aerogels in vacuum to silver and graphite"),
    "emissivity": (0.05, 1.0, "bright metals to coatings"),
    "thickness_m": (5e-6, 0.5, "coatings to thick insulations"),
    "depth_m": (0.0, 0.5, "coatings to thick insulations"),
    "contact_m2K_W": (0.0, 0.05, "joints and thin gaps"),
    "cp_J_kgK": (700.0, 2500.0, "carbon dioxide and air to hot air; helium and hydrogen have more"),
    "initial_K": (150.0, 700.0, "walls before an entry or a test"),
    "h_W_m2K": (0.0, 2e3, "stands and walls at rest"),
    "noise_sigma_K": (1e-2, 30.0, "thermocouples and their recorders"),
    "effective_emissivity": (2e-3, 1.0, "insulation of many bright foils to coatings"),
    "bias_K": (-100.0, 100.0, "thermocouples and their recorders"),
    "temperature_K": (100.0, 3000.0, "walls in flight and thermocouples in tests"),
    "wall_K": (100.0, 3000.0, "walls in flight"),
}  # fmt: skip
USUAL: dict[str, Usual] = {
    name: Usual(*row)
    for names, row in _USUAL_RANGES.items()
    for name in ((names,) if isinstance(names, str) else names)
}
"""Key of a declared file, column, or name that a model gives a number -> range of its values in fact, with its source.

A quantity that is absent here has its impossible range alone."""


@cache
def quantity(name: str) -> Quantity | None:
    """Range of a number by its key, else by the unit that the key ends in; None for a number without a unit."""
    return QUANTITIES.get(name) or next((q for unit, q in UNITS.items() if name.endswith(unit)), None)


def usual_remark(name: str, value: float) -> str | None:
    """What is unusual about a value of a quantity or column, in the words of a message; None where nothing is."""
    usual = USUAL.get(name)
    return None if usual is None else usual.remark(value)


def numbers_in(value: object) -> Iterator[tuple[tuple[int, ...], float]]:
    """Location and value of each number of nested lists; of a number by itself, with the location ().

    An integer beyond all floating-point numbers counts as infinite.
    """
    if type(value) is float or (isinstance(value, (int, float)) and not isinstance(value, bool)):
        try:
            yield (), float(value)
        except OverflowError:
            yield (), math.inf if value > 0 else -math.inf
    elif isinstance(value, (list, tuple)):
        for i, item in zip(count(), value, strict=False):
            yield from (((i, *below), number) for below, number in numbers_in(item))


def low_and_fast(altitude_m: float, velocity_m_s: float) -> bool:
    """Whether nothing flies as fast at so low an altitude, as where km stand for m."""
    return velocity_m_s >= HIGH_SPEED_M_S and abs(altitude_m) < LOW_M


def frame_problem(frame: Mapping[str, float]) -> tuple[str, str] | None:
    """The first column of a frame whose value is impossible, with the rule that it violates, or None."""
    for name, value in frame.items():
        if name in LIMITS and out_of_range(name, value):
            return name, LIMITS[name][2]
    if low_and_fast(frame["altitude_m"], frame["velocity_m_s"]):
        return "altitude_m", LOW_RULE
    return None


def out_of_range(name: str, value: float) -> bool:
    """Whether a value lies outside the limits of its column."""
    lowest, highest, _ = LIMITS[name]
    return not lowest <= value <= highest


LONGEST_S = 1e6
"""Longest flight in a file, twelve days [s]: a march of seconds through years would not end."""


def limit_message(name: str, value: float) -> str:
    """`value rule` for a value outside the limits of its column."""
    return f"{value:g} {LIMITS[name][2] if math.isfinite(value) else 'is not a finite number'}"
