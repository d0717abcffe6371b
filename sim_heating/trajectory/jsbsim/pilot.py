"""Interface of guidance and JSBSim: observations of the vehicle, and commands to its attitude control.

Source: Berndt (2004), "JSBSim: An Open Source Flight Dynamics Model in C++", AIAA 2004-4923.
"""

from __future__ import annotations

import math

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import FRAME
from sim_heating.heating.atmosphere import G0_M_S2
from sim_heating.trajectory.aero import Aero
from sim_heating.trajectory.flight import ROW
from sim_heating.trajectory.guidance import Observation, clip
from sim_heating.trajectory.jsbsim.host import FT_M, PSF_PA, JSBSimHost
from sim_heating.trajectory.manoeuvres import CLOSED, OPEN, Offsets
from sim_heating.trajectory.schedules import pack, scheduled
from sim_heating.trajectory.spec import Guidance, VehicleState

G0_FT_S2 = G0_M_S2 / FT_M


class Observer:
    """Reads the state for guidance and samples after a frame."""

    def __init__(self, host: JSBSimHost) -> None:
        self._host = host
        self._north, self._east, self._down = (host.getter(f"velocities/v-{d}-fps") for d in ("north", "east", "down"))
        self._wind_north, self._wind_east = (host.getter(f"atmosphere/total-wind-{d}-fps") for d in ("north", "east"))
        self._drag, self._lift = host.getter("forces/fwx-aero-lbs"), host.getter("forces/fwz-aero-lbs")
        self._axial = host.getter("forces/fbx-aero-lbs"), host.getter("forces/fbx-external-lbs")
        self._mass = host.getter("inertia/mass-slugs")
        self._gravity = host.getter("accelerations/gravity-ft_sec2")
        self._radius = host.getter("position/radius-to-vehicle-ft")
        self._inertial = host.getter("velocities/eci-velocity-mag-fps")
        self._speed, self._altitude = host.getter("velocities/vt-fps"), host.getter("position/h-sl-ft")
        self._mach, self._qbar = host.getter("velocities/mach"), host.getter("aero/qbar-psf")
        self._alpha, self._alpha_command = host.getter("aero/alpha-deg"), host.getter("control/alpha-cmd-deg")
        self._beta = host.getter("aero/beta-deg")
        self._bank = host.getter("control/bank-rad")
        self._latitude, self._longitude = host.getter("position/lat-geod-deg"), host.getter("position/long-gc-deg")
        self._row = np.empty(len(ROW))

    def observe(self) -> Observation:
        """The observation of guidance: time [s], position [m], speed [m/s], accelerations [m/s2], angles [deg]."""
        climb, mass = -self._down(), self._mass()
        horizontal2 = self._inertial() ** 2 - climb * climb
        return Observation(
            time_s=self._host.time_s,
            altitude_m=self._altitude() * FT_M,
            velocity_m_s=self._speed() * FT_M,
            mach=self._mach(),
            altitude_rate_m_s=climb * FT_M,
            drag_m_s2=self._drag() / mass * FT_M,
            lift_m_s2=self._lift() / mass * FT_M,
            net_gravity_m_s2=(self._gravity() - horizontal2 / self._radius()) * FT_M,
            qbar_Pa=self._qbar() * PSF_PA,
            alpha_deg=self._alpha(),
            heading_deg=self._heading_deg(),
            latitude_deg=self._latitude(),
            longitude_deg=self._longitude(),
        )

    def row(self) -> FloatArray:
        """One sample in the order of flight.ROW, each number in the unit of its column ([s], [m], [deg] ...); the
        array is reused."""
        row = self._row
        self._host.read_frame(row[: len(FRAME)])
        row[len(FRAME) :] = (
            math.degrees(self._bank()),
            math.degrees(math.asin(clip(-self._down() / self._speed(), -1.0, 1.0))),
            self._heading_deg(),
            self._latitude(),
            self._longitude(),
            -sum(get() for get in self._axial) / (self._mass() * G0_FT_S2),
        )
        return row

    def attitude_error_deg(self) -> float:
        """The larger of sideslip and the error of the angle of attack [deg]; NaN where either is NaN."""
        alpha, beta = abs(self._alpha() - self._alpha_command()), abs(self._beta())
        # max() would drop a NaN in one of its two places.
        return alpha if alpha > beta or math.isnan(alpha) else beta

    def _heading_deg(self) -> float:
        return math.degrees(math.atan2(self._east() - self._wind_east(), self._north() - self._wind_north()))


class Commands:
    """Writes the commands of guidance and manoeuvres to the vehicle's attitude control.

    While a manoeuvre pulses the elevon or opens the pitch loop, the elevon is at its deflection from the start of the
    manoeuvre plus the offset; jets hold the angle of attack, or nothing does.
    """

    def __init__(self, host: JSBSimHost, aero: Aero, guidance: Guidance, state: VehicleState) -> None:
        self._host = host
        names = (
            "alpha-cmd-deg",
            "beta-cmd-deg",
            "bank-cmd-deg",
            "bodyflap-cmd-deg",
            "elevon-direct",
            "elevon-direct-deg",
            "pitch-open",
            "jet-firing",
        )
        self._set = {name: host.node(f"control/{name}").set_double_value for name in names}
        self._elevon_deg = host.getter("fcs/elevon-pos-deg")
        self._frozen_deg: float | None = None
        self._alpha_limits = guidance.alpha_limits_deg
        self._against_mach = state.bodyflap_deg is None or state.bodyflap_against == "mach"
        trimmed = aero.bodyflap_schedule(guidance.alpha_deg, guidance.alpha_against)
        self._bodyflap = pack((), [state.bodyflap_deg or trimmed])

    def write(self, alpha_deg: float, bank_deg: float, offsets: Offsets, mach: float, velocity_m_s: float) -> None:
        """Set the commands [deg]; the angle of attack stays within the limits of guidance."""
        setters = self._set
        setters["alpha-cmd-deg"](clip(alpha_deg + offsets.alpha_deg, *self._alpha_limits))
        setters["bank-cmd-deg"](bank_deg)
        setters["beta-cmd-deg"](offsets.beta_deg)
        setters["bodyflap-cmd-deg"](self.bodyflap_deg(mach, velocity_m_s) + offsets.bodyflap_deg)
        setters["jet-firing"](clip(offsets.jets, 0.0, 1.0))
        self._write_pitch(offsets)

    def bodyflap_deg(self, mach: float, velocity_m_s: float) -> float:
        """Scheduled body flap [deg]."""
        return scheduled(self._bodyflap, 0, mach if self._against_mach else velocity_m_s)

    def initialise(
        self, alpha_deg: float, bank_deg: float, elevon_deg: float, mach: float, velocity_m_s: float
    ) -> None:
        """Set the commands [deg] before the start, with the lags of the control in steady state and the elevon in
        trim."""
        self.write(alpha_deg, bank_deg, Offsets(), mach, velocity_m_s)
        for state in ("lag1", "lag2", "ref"):
            self._host.node(f"control/alpha-{state}-deg").set_double_value(alpha_deg)
            self._host.node(f"control/bank-{state}-deg").set_double_value(bank_deg)
        self._host.node("control/elevon-park-deg").set_double_value(elevon_deg)

    def _write_pitch(self, offsets: Offsets) -> None:
        if offsets.pitch == CLOSED:
            if self._frozen_deg is not None:
                self._set["elevon-direct"](0.0)
                self._set["pitch-open"](0.0)
                self._frozen_deg = None
            return
        # Offsets of a manoeuvre are about the deflection at which it began.
        if self._frozen_deg is None:
            self._frozen_deg = self._elevon_deg()
            self._set["elevon-direct"](1.0)
        self._set["pitch-open"](1.0 if offsets.pitch == OPEN else 0.0)
        self._set["elevon-direct-deg"](self._frozen_deg + offsets.elevon_deg)
