"""Equilibrium air by Cantera, with transport properties mixed from published data (`transport`); needs Cantera 3."""

from __future__ import annotations

import numpy as np

from sim_heating.heating.reference.gas import MOLAR_MASS_N2_O2
from tests.support.gas.transport import SPECIES, Transport, transport

AIR = "N2:0.79, O2:0.21"
FROZEN_K = 700.0
"""Below, the composition is that of cold air: its dissociation is below 1e-12."""
H_298_K = {"N2": 8670.0e3, "O2": 8683.0e3}
"""Enthalpy at 298.15 K above 0 K [J/kmol], JANAF Thermochemical Tables (1998)."""
FORMATION = {"O": 246.790e6, "N": 470.818e6, "NO": 89.775e6}
"""Heats of formation at 0 K [J/kmol]."""
DIFFERENCE = 5e-4
"""Relative change of temperature and pressure in the differences of the speed of sound."""


class Air:
    """Equilibrium air of Cantera's airNASA9.yaml: composition, thermodynamics, and transport of `transport`."""

    def __init__(self) -> None:
        import cantera

        self.gas = cantera.Solution("airNASA9.yaml")
        self.gas_constant = float(cantera.gas_constant)
        self.offset = 0.79 * H_298_K["N2"] + 0.21 * H_298_K["O2"]

    def fractions(self, T_K: float, p_Pa: float) -> dict[str, float]:
        """Mole fraction of each species [-] in equilibrium at T [K] and p [Pa]; the gas is left in that state."""
        self.gas.TPX = T_K, p_Pa, AIR
        if T_K >= FROZEN_K:
            self.gas.equilibrate("TP", rtol=1e-10)
        return dict(zip(self.gas.species_names, map(float, self.gas.X), strict=True))

    def thermodynamics(self, T_K: float, p_Pa: float) -> tuple[float, float, float]:
        """Enthalpy above 0 K [J/kg], compressibility [-] and dissociation enthalpy [J/kg]."""
        x = self.fractions(T_K, p_Pa)
        mass = float(self.gas.mean_molecular_weight)
        formation = sum(x[s] * value for s, value in FORMATION.items()) / mass
        return float(self.gas.enthalpy_mass) + self.offset / MOLAR_MASS_N2_O2, MOLAR_MASS_N2_O2 / mass, formation

    def sound(self, T_K: float, p_Pa: float) -> float:
        """Speed of sound [m/s] where the composition stays in equilibrium, by central differences.

            a^2 = -v^2 / [(dv/dp)_T + T/cp (dv/dT)_p^2],    v = Z R T/p,  cp = (dh/dT)_p

        Source: a^2 = (dp/d rho)_s by identities of thermodynamics.
        """
        gas_constant = self.gas_constant / MOLAR_MASS_N2_O2

        def volume(T: float, p: float) -> tuple[float, float]:
            h, Z, _ = self.thermodynamics(T, p)
            return Z * gas_constant * T / p, h

        dT, dp = DIFFERENCE * T_K, DIFFERENCE * p_Pa
        (v, _), (hot, h_hot), (cold, h_cold) = volume(T_K, p_Pa), volume(T_K + dT, p_Pa), volume(T_K - dT, p_Pa)
        by_p = (volume(T_K, p_Pa + dp)[0] - volume(T_K, p_Pa - dp)[0]) / (2.0 * dp)
        by_T, cp = (hot - cold) / (2.0 * dT), (h_hot - h_cold) / (2.0 * dT)
        return float(v / np.sqrt(-by_p - T_K / cp * by_T**2))

    def transport(self, T_K: float, p_Pa: float) -> Transport:
        """Viscosity and frozen Prandtl number; the specific heats are those of Cantera's NASA-9 polynomials."""
        x = self.fractions(T_K, p_Pa)
        partial = dict(zip(self.gas.species_names, self.gas.partial_molar_cp, strict=True))
        return transport(x, np.array([partial[s] for s in SPECIES]), T_K, p_Pa)
