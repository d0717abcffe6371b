"""Equilibrium air of N2, O2, NO, N, O from partition functions: rigid rotators, harmonic oscillators, electronic terms.

Constants of Huber & Herzberg (1979) and of the NIST atomic spectra; heats of formation at 0 K of the JANAF tables. The
polynomials of the package's table are not used. Ions are left out: not above 6000 K.
Source: Vincenti & Kruger, Introduction to Physical Gas Dynamics (1965), chapters IV and V.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

BOLTZMANN, PLANCK, AVOGADRO = 1.380649e-23, 6.62607015e-34, 6.02214076e23
GAS_CONSTANT = BOLTZMANN * AVOGADRO
CM_K = 1.438776877
"""Temperature of a wave number of 1/cm [K]."""


@dataclass(frozen=True)
class Species:
    """A species: molar mass [kg/mol], heat of formation at 0 K [J/mol], electronic levels (weight, temperature [K]).

    A molecule also has a rotational and a vibrational temperature [K] and a symmetry number.
    """

    mass: float
    formation: float
    levels: tuple[tuple[float, float], ...]
    rotation_K: float = 0.0
    vibration_K: float = 0.0
    symmetry: float = 1.0

    def log_partition(self, T: float, p: float) -> float:
        """ln(q / N) at a pressure p [Pa] of the species alone, from its ground state."""
        m = self.mass / AVOGADRO
        log_q = 1.5 * math.log(2.0 * math.pi * m * BOLTZMANN * T / PLANCK**2) + math.log(BOLTZMANN * T / p)
        log_q += math.log(sum(g * math.exp(-E / T) for g, E in self.levels))
        if self.rotation_K > 0.0:
            log_q += math.log(T / (self.symmetry * self.rotation_K)) - math.log1p(-math.exp(-self.vibration_K / T))
        return log_q

    def enthalpy(self, T: float) -> float:
        """Molar enthalpy above that of the elements at 0 K [J/mol]."""
        weights = [g * math.exp(-E / T) for g, E in self.levels]
        electronic = sum(w * E for w, (_, E) in zip(weights, self.levels, strict=True)) / sum(weights)
        thermal = 2.5 * T + electronic
        if self.rotation_K > 0.0:
            thermal += T + self.vibration_K / math.expm1(self.vibration_K / T)
        return self.formation + GAS_CONSTANT * thermal


SPECIES = {
    "N2": Species(0.0280134, 0.0, ((1, 0.0),), 1.98957 * CM_K, 2329.9 * CM_K, 2.0),
    "O2": Species(0.0319988, 0.0, ((3, 0.0), (2, 11390.0), (1, 18985.0)), 1.43768 * CM_K, 1556.4 * CM_K, 2.0),
    "NO": Species(0.0300061, 89.775e3, ((2, 0.0), (2, 174.2)), 1.6961 * CM_K, 1876.1 * CM_K),
    "N": Species(0.0140067, 470.818e3, ((4, 0.0), (10, 27665.0), (6, 41495.0))),
    "O": Species(0.0159994, 246.790e3, ((5, 0.0), (3, 227.7), (1, 326.6), (5, 22831.0), (1, 48620.0))),
}


def equilibrium(T: float, p: float) -> tuple[float, float]:
    """Enthalpy above 0 K [J/kg] and compressibility [-] of 79/21 N2/O2 at T [K] and p [Pa]."""
    gibbs = {name: s.formation / (GAS_CONSTANT * T) - s.log_partition(T, p) for name, s in SPECIES.items()}

    def fractions(log_x: np.ndarray) -> dict[str, float]:
        n, o = float(log_x[0]), float(log_x[1])
        logs = {"N2": 2.0 * n, "O2": 2.0 * o, "NO": n + o, "N": n, "O": o}
        return {name: math.exp(min(value - gibbs[name], 50.0)) for name, value in logs.items()}

    def residual(log_x: np.ndarray) -> list[float]:
        x = fractions(log_x)
        nitrogen, oxygen = 2.0 * x["N2"] + x["NO"] + x["N"], 2.0 * x["O2"] + x["NO"] + x["O"]
        return [sum(x.values()) - 1.0, math.log(nitrogen / oxygen) - math.log(0.79 / 0.21)]

    start = [0.5 * (math.log(0.79) + gibbs["N2"]), 0.5 * (math.log(0.05) + gibbs["O2"])]
    x = fractions(least_squares(residual, start, xtol=1e-15, ftol=1e-15, gtol=1e-15).x)
    mass = sum(x[name] * s.mass for name, s in SPECIES.items())
    enthalpy = sum(x[name] * s.enthalpy(T) for name, s in SPECIES.items())
    return enthalpy / mass, (0.79 * SPECIES["N2"].mass + 0.21 * SPECIES["O2"].mass) / mass
