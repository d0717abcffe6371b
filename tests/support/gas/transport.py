"""Viscosity and frozen Prandtl number of a mixture of N2, O2, NO, N and O, from two published sets of data.

The sets are the fits of CEA (NASA RP-1311; N and O after Levin et al. 1990), with its conductivities, and those of
Blottner et al. (1971), with Eucken's conductivity. Both are mixed by Wilke's rule. Their mean is the value, and their
standard deviation its sigma. Up to 700 K, below the range of Blottner's fits, the viscosity is Sutherland's and the
Prandtl number that of CEA. Ions count as the neutrals that they come from, and the mixture's viscosity is multiplied
by the ratio that the collision cross sections of NASA RP-1232 give with and without the charges.
Equations: docs/theory/equations_reference_heating.md, section 2.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.heating.atmosphere import sutherland_viscosity
from sim_heating.heating.reference.gas import JOIN_K

SPECIES = ("N2", "O2", "NO", "N", "O")
MOLAR_MASS = np.array([28.0134, 31.9988, 30.0061, 14.0067, 15.9994])
"""[kg/kmol]"""
R_MOLAR = 8314.462618
"""[J/(kmol K)]"""
ATMOSPHERE_PA = 101325.0
LEAST_SIGMA = 0.01
"""Relative sigma [-] of a viscosity where the two sets happen to agree: a guess, the accuracy of Wilke's rule."""
LEAST_PRANDTL_SIGMA = 0.05
"""Relative sigma [-] of a Prandtl number where the two sets agree: a guess: a textbook has 0.69 at 1500 K, not 0.76."""


@dataclass(frozen=True)
class Transport:
    """Viscosity [Pa s], frozen Prandtl number [-], and the relative sigma of both [-]."""

    viscosity_Pa_s: float
    viscosity_sigma: float
    prandtl: float
    prandtl_sigma: float


def rows(name: str) -> list[dict[str, str]]:
    """Rows of a CSV file of this folder, without the lines of provenance."""
    lines = (Path(__file__).parent / name).read_text(encoding="utf-8").splitlines()
    return list(csv.DictReader(line for line in lines if not line.startswith("#")))


def _by_species() -> dict[tuple[str, str], list[tuple[float, ...]]]:
    fits: dict[tuple[str, str], list[tuple[float, ...]]] = {}
    for row in rows("cea_fits.csv"):
        numbers = tuple(float(row[name]) for name in ("T_max_K", "A", "B", "C", "D"))
        fits.setdefault((row["species"], row["property"]), []).append(numbers)
    return fits


CEA_FITS = _by_species()
BLOTTNER_FITS = {row["species"]: tuple(float(row[name]) for name in "ABC") for row in rows("blottner_fits.csv")}
CROSS_SECTIONS = {
    frozenset((row["first"], row["second"])): tuple(float(row[name]) for name in "BCD")
    for row in rows("collision_cross_sections.csv")
}


def _cea(species: str, quantity: str, T_K: float) -> float:
    """A fit of CEA, ln y = A ln T + B/T + C/T^2 + D, in the units of its file."""
    fits = CEA_FITS[species, quantity]
    _, A, B, C, D = next((fit for fit in fits if fit[0] >= T_K), fits[-1])
    return math.exp(A * math.log(T_K) + B / T_K + C / T_K**2 + D)


def cea_viscosity(T_K: float) -> FloatArray:
    """Viscosity of each of SPECIES [Pa s] after CEA."""
    return np.array([1e-7 * _cea(s, "viscosity", T_K) for s in SPECIES])


def cea_conductivity(T_K: float) -> FloatArray:
    """Frozen thermal conductivity of each of SPECIES [W/(m K)] after CEA."""
    return np.array([1e-4 * _cea(s, "conductivity", T_K) for s in SPECIES])


def blottner_viscosity(T_K: float) -> FloatArray:
    """Viscosity of each of SPECIES [Pa s] after Blottner et al., 0.1 exp((A ln T + B) ln T + C)."""
    L = math.log(T_K)
    return np.array([0.1 * math.exp((A * L + B) * L + C) for A, B, C in (BLOTTNER_FITS[s] for s in SPECIES)])


def eucken_conductivity(viscosity: FloatArray, cp_molar: FloatArray) -> FloatArray:
    """Eucken's k = mu (cp + 5/4 R/M) of each of SPECIES [W/(m K)]; viscosity [Pa s], cp_molar [J/(kmol K)]."""
    return viscosity * (cp_molar + 1.25 * R_MOLAR) / MOLAR_MASS


def wilke(x: FloatArray, viscosity: FloatArray, values: FloatArray) -> float:
    """Value of a mixture after Wilke, J. Chem. Phys. 18 (1950) 517: sum of x_i y_i / sum of x_j phi_ij.

    x         : mole fractions of SPECIES [-];  viscosity : of each of them [Pa s], for phi
    values    : y, the viscosity of each of them, or its conductivity
    """
    mass = MOLAR_MASS[None, :] / MOLAR_MASS[:, None]  # M_j / M_i
    phi = (1.0 + np.sqrt(viscosity[:, None] / viscosity[None, :]) * mass**0.25) ** 2 / np.sqrt(8.0 * (1.0 + 1.0 / mass))
    return float(np.sum(x * values / (phi @ x)))


def cross_section(first: str, second: str, T_K: float, coulomb_logarithm: float = 1.0) -> float:
    """Average collision cross section pi Omega(2,2) of a pair [m2] after NASA RP-1232; ions end in `+`."""
    ions = first.endswith("+") + second.endswith("+")
    pair = frozenset((first, second)) if ions == 0 else frozenset(("ion", "neutral" if ions == 1 else "charge"))
    B, C, D = CROSS_SECTIONS[pair]
    return 1e-20 * math.exp(D) * T_K ** (B * math.log(T_K) + C) * (coulomb_logarithm if ions == 2 else 1.0)


def coulomb_logarithm(T_K: float, electron_pressure_Pa: float) -> float:
    """ln Lambda of charged pairs [-] after NASA RP-1232, eq. 24; 1 at 0.0975 (T/1000)^4 atm, for which the fits are."""
    ratio = (T_K / 1000.0) ** 4 * ATMOSPHERE_PA / max(electron_pressure_Pa, 1e-300)
    return 0.5 * math.log(2.09e-2 * ratio + 1.52 * ratio ** (2.0 / 3.0))


def cross_section_viscosity(fractions: Mapping[str, float], T_K: float, electron_pressure_Pa: float = 0.0) -> float:
    """Viscosity of a mixture [Pa s] from collision cross sections, NASA RP-1232, eq. 26; electrons carry no momentum.

        mu = sum of m_i x_i / sum of x_j Delta_ij,   Delta_ij = 16/5 (2 M_ij / (pi R T))^1/2 pi Omega_ij

    fractions : mole fraction of each species [-]; those of ions end in `+`
    """
    logarithm = coulomb_logarithm(T_K, electron_pressure_Pa) if electron_pressure_Pa > 0.0 else 1.0
    mass = {s: float(MOLAR_MASS[SPECIES.index(s.rstrip("+"))]) for s in fractions}
    avogadro = 6.02214076e26  # 1/kmol

    def delta(i: str, j: str) -> float:
        reduced = mass[i] * mass[j] / (mass[i] + mass[j])
        speed = math.sqrt(2.0 * reduced / (math.pi * R_MOLAR * T_K))
        return 3.2 * speed * cross_section(i, j, T_K, logarithm)

    present = [s for s, x in fractions.items() if x > 0.0]
    return sum(mass[i] / avogadro * fractions[i] / sum(fractions[j] * delta(i, j) for j in present) for i in present)


def _as_neutrals(fractions: Mapping[str, float]) -> FloatArray:
    """Mole fractions of SPECIES where each ion counts as its neutral and electrons do not count."""
    x = np.array([fractions.get(s, 0.0) + fractions.get(f"{s}+", 0.0) for s in SPECIES])
    return np.asarray(x / x.sum())


def ionisation_factor(fractions: Mapping[str, float], T_K: float, p_Pa: float) -> float:
    """Ratio [-] by which charges change the viscosity of a mixture; fractions : of all species and `e-` [-]."""
    heavy = {s: x for s, x in fractions.items() if s != "e-" and x > 1e-12}
    neutral = dict(zip(SPECIES, _as_neutrals(fractions), strict=True))
    charged = cross_section_viscosity(heavy, T_K, fractions.get("e-", 0.0) * p_Pa)
    return charged / cross_section_viscosity(neutral, T_K)


def _mean(a: float, b: float, least: float) -> tuple[float, float]:
    """Mean of two values, and their relative standard deviation, not below `least`."""
    mean = 0.5 * (a + b)
    return mean, max(abs(a - b) / (math.sqrt(2.0) * mean), least)


def transport(fractions: Mapping[str, float], cp_molar: FloatArray, T_K: float, p_Pa: float) -> Transport:
    """Viscosity and frozen Prandtl number of a mixture.

    fractions : mole fraction of each species, ions and electrons (`e-`) included [-]
    cp_molar  : (5,) specific heat of SPECIES [J/(kmol K)];  T_K, p_Pa : temperature [K] and pressure [Pa]
    Sutherland's viscosity up to JOIN_K. The Prandtl number is that of the heavy particles. Half of the change by
    ionisation is added to the sigma: a guess.
    """
    x = _as_neutrals(fractions)
    cp = float(x @ cp_molar) / float(x @ MOLAR_MASS)
    cea, blottner = cea_viscosity(T_K), blottner_viscosity(T_K)
    if T_K <= JOIN_K:
        Pr = wilke(x, cea, cea) * cp / wilke(x, cea, cea_conductivity(T_K))
        return Transport(float(sutherland_viscosity(T_K)), LEAST_SIGMA, Pr, LEAST_PRANDTL_SIGMA)
    mixed = (wilke(x, cea, cea), wilke(x, blottner, blottner))
    conductivity = (
        wilke(x, cea, cea_conductivity(T_K)),
        wilke(x, blottner, eucken_conductivity(blottner, cp_molar)),
    )
    factor = ionisation_factor(fractions, T_K, p_Pa)
    mu, sigma = _mean(*mixed, LEAST_SIGMA)
    prandtl = (mixed[0] * cp / conductivity[0], mixed[1] * cp / conductivity[1])
    Pr, Pr_sigma = _mean(*prandtl, LEAST_PRANDTL_SIGMA)
    return Transport(mu * factor, math.hypot(sigma, 0.5 * (1.0 - factor)), Pr, Pr_sigma)
