"""Flight conditions that the kernel of an effect reads, by the names of their columns in conditions.csv.

    from sim_heating import flight

    B[c + flight.mach]      Mach number of the lane whose conditions begin at B[c]

Each name is an offset from `c`. The values are those at the stage of the time step at which the kernel is evaluated. A
column that a flight does not have is 0, `turbulent_ratio` 1.
"""

from __future__ import annotations

from sim_heating.base.kernels import block

alpha_deg = block.ALPHA
"""Angle of attack [deg]."""
beta_deg = block.BETA
"""Angle of sideslip [deg]."""
log10_re = block.LOG10_RE
"""log10 of the free-stream Reynolds number on the vehicle's reference length [-]."""
elevon_deg = block.ELEVON
"""Elevon deflection [deg], positive trailing edge down."""
bodyflap_deg = block.BODYFLAP
"""Body-flap deflection [deg], positive trailing edge down."""
p_surface_Pa = block.P_SURFACE
"""Surface pressure at the control point [Pa]."""
h_ref_kg_m2_s = block.H_REF
"""Reference film coefficient [kg/(m2 s)]."""
H_r_J_kg = block.RECOVERY_ENTHALPY
"""Recovery enthalpy [J/kg], zero at 0 K."""
q_add_W_m2 = block.Q_ADD
"""Known additional absorbed flux [W/m2]."""
jets = block.JETS
"""Reaction-jet firing [-], 0 (off) to 1 (firing)."""
mach = block.MACH
"""Mach number [-], speed over the local speed of sound."""
time_s = block.TIME
"""Time [s]."""
H_r_rise_J_kg = block.RECOVERY_RISE
"""Rise of the recovery enthalpy [J/kg] from laminar to fully turbulent flow; 0 where no edge is declared."""
turbulent_ratio = block.TURBULENT_RATIO
"""Turbulent over laminar heating ratio of the declared tables [-]; 1 where no turbulent table is declared."""
log10_re_theta_m = block.LOG10_RE_THETA_M
"""log10 of laminar Re_theta over edge Mach number [-]; 0 where no criterion in it is declared."""
dissociation_J_kg = block.DISSOCIATION
"""Heat of dissociation of the flow at the edge of the boundary layer [J/kg]; 0 where no recombination is declared."""
T_surroundings_K = block.SURROUNDINGS
"""Temperature that the surface radiates to [K]; 0 where it is the one that the stack declares."""
T_back_K = block.BEHIND
"""Temperature behind the wall [K]; 0 where it is the one that the stack declares."""
H_upstream_J_kg = block.UPSTREAM
"""Enthalpy of air at the wall upstream of a declared interface [J/kg]; 0 without one."""
still_air_W_m2K43 = block.STILL_AIR
"""Coefficient of natural convection at rest [W/(m2 K^(4/3))]; 0 in flight, and where surroundings do not follow from
altitude."""
T_inf_K = block.AIR_K
"""Temperature of the air around [K], where surroundings follow from altitude; else 0."""
