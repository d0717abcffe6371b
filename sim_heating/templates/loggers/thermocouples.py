"""Temperatures of files that hold the emf of thermocouples: the reference functions of ITS-90, letter by letter.

    E(T) = e + E(T_ref)

e the emf in the file, T_ref the temperature of the reference junction, E the reference function of the type for a
junction at 0 degC. source: NIST Monograph 175 (1993), by the package thermocouple-its90.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.errors import InputError
from sim_heating.base.files.units import converted

ICE_K = 273.15
STEP_K = 0.25
"""Between nodes of the reference functions; linear interpolation between them is within 1e-4 K."""
DIGITS = 4
"""Decimal places that the interpolation leaves."""
LEAST_C = {"B": 250.0}
COLDEST_C = -200.0
"""Temperatures [degC] below which no emf is inverted: type B has two temperatures there, others hardly any slope."""
EXAMPLE = "--thermocouple K --reference-junction 25degC"


@dataclass(frozen=True)
class EmfColumn:
    """Emf of a thermocouple over the rows of a file.

    location : file and column, for messages
    unit     : of the cells, as `mV`
    values   : (row,) NaN where a sample is lost
    lines    : (row,) row of the file, for messages
    """

    location: str
    unit: str
    values: FloatArray
    lines: Sequence[int]


def is_emf(unit: str) -> bool:
    """Whether a unit is one of voltage.

    >>> is_emf("mV"), is_emf("degC"), is_emf("")
    (True, False, False)
    """
    return bool(unit) and converted(unit, "V") is not None


def temperatures_K(letter: str, column: EmfColumn, reference_K: FloatArray | float, junction: str) -> FloatArray:
    """Temperatures of the junction that a column of emf states.

    letter      : type of the thermocouple
    reference_K : temperature of the reference junction [K], one for each row or one for all
    junction    : what states it, for messages
    returns     : (row,) [K], NaN where a sample or its reference is lost
    raises      : InputError with the row of the first emf that no temperature of the type has

    Source: NIST Monograph 175, reference functions of the letter-designated types.
    """
    to_volts = converted(column.unit, "V")
    assert to_volts is not None  # `is_emf` was asked
    nodes_K, nodes_V = _reference_function(letter)
    _check_reference(letter, reference_K, nodes_K, f"{column.location}, {junction}")
    rising = nodes_K >= ICE_K + LEAST_C.get(letter, COLDEST_C) - 1e-9
    low_K, low_V = nodes_K[rising][0], nodes_V[rising][0]
    total_V = to_volts.factor * column.values + np.interp(reference_K, nodes_K, nodes_V)
    outside = np.flatnonzero((total_V < low_V) | (total_V > nodes_V[-1]))
    if outside.size:
        i = int(outside[0])
        raise InputError(
            f"{column.location}, row {column.lines[i]}: {column.values[i]:g} {column.unit} is no emf of type {letter} "
            f"between {low_K - ICE_K:g} and {nodes_K[-1] - ICE_K:g} degC; state the type, or a lost sample as "
            f"--lost={column.values[i]:g}"
        )
    return np.round(np.interp(total_V, nodes_V[rising], nodes_K[rising]), DIGITS)


def _check_reference(letter: str, reference_K: FloatArray | float, nodes_K: FloatArray, location: str) -> None:
    """Refuse a reference junction outside the reference function."""
    T_K = np.atleast_1d(np.asarray(reference_K, dtype=float))
    outside = T_K[(nodes_K[0] > T_K) | (nodes_K[-1] < T_K)]
    if outside.size:
        raise InputError(
            f"{location}: {outside[0] - ICE_K:g} degC is outside the reference function of type {letter}; give the "
            "temperature of the terminals, such as 25degC"
        )


@cache
def _reference_function(letter: str) -> tuple[FloatArray, FloatArray]:
    """Temperatures [K] of nodes over the range of a type, and its emf [V] there."""
    import thermocouple_its90

    thermocouple = thermocouple_its90.get(letter)
    low_C, high_C = thermocouple.range
    low_C = max(low_C, COLDEST_C)
    T_C = np.linspace(low_C, high_C, round((high_C - low_C) / STEP_K) + 1)
    return T_C + ICE_K, 1e-3 * np.array([thermocouple.emf(float(T)) for T in T_C])
