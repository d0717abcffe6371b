"""Calculations in content MathML, as DAVE-ML holds them: read, evaluated on arrays, written.

An expression is a number, the identifier of a variable, or a tuple: the operator, then its arguments. `piecewise` has
pieces ("piece", value, condition) and ends with the value otherwise, or None.

Source: ANSI/AIAA S-119-2011, Flight Dynamics Model Exchange Standard, annex on DAVE-ML 2.0; W3C MathML 2.0, chapter 4.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import reduce
from itertools import pairwise
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import ArrayLike

from sim_heating.base.errors import InputError
from sim_heating.base.files import suggestion

Expression = float | str | tuple[Any, ...]
NAMESPACE = "http://www.w3.org/1998/Math/MathML"
ATAN2 = "http://daveml.org/function_spaces.html#atan2"
CONSTANTS = {"pi": np.pi, "exponentiale": np.e, "true": 1.0, "false": 0.0}


def _folded(function: Callable[[Any, Any], Any]) -> Callable[..., Any]:
    return lambda *arguments: reduce(function, arguments)


def _chained(relation: Callable[[Any, Any], Any]) -> Callable[..., Any]:
    """A relation that holds between each argument and the next."""
    return lambda *a: reduce(np.logical_and, [relation(x, y) for x, y in pairwise(a)])


def _minus(*a: Any) -> Any:
    return np.negative(a[0]) if len(a) == 1 else a[0] - a[1]


OPERATORS: dict[str, tuple[int, int, Callable[..., Any]]] = {
    "plus": (1, 99, _folded(np.add)), "times": (1, 99, _folded(np.multiply)), "minus": (1, 2, _minus),
    "divide": (2, 2, np.divide), "power": (2, 2, np.float_power), "rem": (2, 2, np.fmod),
    "quotient": (2, 2, lambda x, y: np.trunc(x / y)), "max": (1, 99, _folded(np.maximum)),
    "min": (1, 99, _folded(np.minimum)), "abs": (1, 1, np.abs), "exp": (1, 1, np.exp), "ln": (1, 1, np.log),
    "log": (1, 1, np.log10), "root": (1, 1, np.sqrt), "floor": (1, 1, np.floor), "ceiling": (1, 1, np.ceil),
    "sin": (1, 1, np.sin), "cos": (1, 1, np.cos), "tan": (1, 1, np.tan), "arcsin": (1, 1, np.arcsin),
    "arccos": (1, 1, np.arccos), "arctan": (1, 1, np.arctan), "sinh": (1, 1, np.sinh), "cosh": (1, 1, np.cosh),
    "tanh": (1, 1, np.tanh), "atan2": (2, 2, np.arctan2), "eq": (2, 99, _chained(np.equal)),
    "neq": (2, 2, np.not_equal), "lt": (2, 99, _chained(np.less)), "gt": (2, 99, _chained(np.greater)),
    "leq": (2, 99, _chained(np.less_equal)), "geq": (2, 99, _chained(np.greater_equal)),
    "and": (1, 99, _folded(np.logical_and)), "or": (1, 99, _folded(np.logical_or)),
    "xor": (1, 99, _folded(np.logical_xor)), "not": (1, 1, np.logical_not),
}  # fmt: skip
"""Operator -> least and most arguments, and the function of arrays; angles of its functions in radians."""


def local_name(element: ET.Element) -> str:
    """Name of an element without its namespace."""
    return str(element.tag).rpartition("}")[2]


def number_of(text: str | None, subject: str) -> float:
    """A finite number, in the unit of what it is of, or [-].

    raises : InputError that says what it is of
    Source: ANSI/AIAA S-119 (2011).

    Source: MathML 2.0, chapter 4.
    """
    try:
        value = float((text or "").strip())
    except ValueError:
        value = float("nan")
    if not np.isfinite(value):
        raise InputError(f"{subject}: `{(text or '').strip()[:40]}` is not a number")
    return value


def read_math(element: ET.Element) -> Expression:
    """The expression of an element of content MathML.

    raises : InputError that names an element which is none of those above, or a wrong number of arguments

    Source: MathML 2.0, chapter 4.
    """
    name = local_name(element)
    if name == "math":
        if len(element) != 1:
            raise InputError(f"<math> holds {len(element)} elements; it must hold one")
        return read_math(element[0])
    if name == "cn":
        return _number(element)
    if name == "ci":
        return (element.text or "").strip()
    if name in CONSTANTS:
        return float(CONSTANTS[name])
    if name == "piecewise":
        return _piecewise(element)
    if name != "apply" or not len(element):
        raise InputError(f"<{name}> of MathML is not known here")
    return _application(element)


def _number(element: ET.Element) -> float:
    if len(element) or element.get("type", "real") not in ("real", "integer", "e-notation"):
        return _scientific(element)
    return number_of(element.text, "<cn>")


def _application(element: ET.Element) -> Expression:
    """The operator of an `apply` with its arguments.

    raises : InputError for an operator that is not known, or a wrong number of arguments
    """
    head = element[0]
    if len(element) == 1 and local_name(head) == "piecewise":  # which is no operator, and many files write it as one
        return _piecewise(head)
    operator = "atan2" if local_name(head) == "csymbol" and "atan2" in (head.text or "") else local_name(head)
    if operator not in OPERATORS:
        raise InputError(f"operator <{operator}> of MathML is not known here{suggestion(operator, OPERATORS)}")
    arguments = tuple(read_math(child) for child in element[1:])
    least, most, _ = OPERATORS[operator]
    if not least <= len(arguments) <= most:
        raise InputError(f"<{operator}> has {len(arguments)} arguments; it takes {least} to {most}")
    return (operator, *arguments)


def _scientific(element: ET.Element) -> float:
    """A number written as mantissa, <sep/>, exponent."""
    if len(element) != 1 or local_name(element[0]) != "sep":
        raise InputError(f"<cn type=`{element.get('type')}`> is not known here; write a decimal number")
    return number_of(f"{(element.text or '').strip()}e{(element[0].tail or '').strip()}", "<cn>")


def _piecewise(element: ET.Element) -> Expression:
    pairs, otherwise = [], None
    for child in element:
        arguments = tuple(read_math(e) for e in child)
        if local_name(child) == "piece" and len(arguments) == 2:
            pairs.append(("piece", *arguments))
        elif local_name(child) == "otherwise" and len(arguments) == 1:
            otherwise = arguments[0]
        else:
            raise InputError(f"<{local_name(child)}> with {len(arguments)} elements in <piecewise>")
    return ("piecewise", *pairs, otherwise)


def names_in(expression: Expression) -> Iterator[str]:
    """Identifiers of the variables of an expression. Source: MathML 2.0, chapter 4."""
    if isinstance(expression, str):
        yield expression
    elif isinstance(expression, tuple):
        for operand in expression[1:]:
            if operand is not None:
                yield from names_in(operand)


def evaluate(expression: Expression, values: Mapping[str, ArrayLike]) -> Any:
    """Value of an expression, in its unit, or [-]; nan where no piece holds.

    values : of the variables, by identifier; arrays of shapes that go together

    Source: MathML 2.0, chapter 4.
    """
    if isinstance(expression, float):
        return np.float64(expression)
    if isinstance(expression, str):
        return np.asarray(values[expression], dtype=float)
    operator, arguments = expression[0], expression[1:]
    with np.errstate(all="ignore"):
        if operator == "piecewise":
            *pairs, otherwise = arguments
            value = np.float64(np.nan) if otherwise is None else evaluate(otherwise, values)
            for _, piece, condition in reversed(pairs):
                value = np.where(evaluate(condition, values), evaluate(piece, values), value)
            return value
        return OPERATORS[operator][2](*(evaluate(a, values) for a in arguments))


def write_math(expression: Expression) -> ET.Element:
    """The expression as an element of content MathML, without the element <math> around it.

    Source: MathML 2.0, chapter 4.
    """
    if isinstance(expression, float):
        element = ET.Element("cn")
        element.text = repr(expression)
        return element
    if isinstance(expression, str):
        element = ET.Element("ci")
        element.text = expression
        return element
    operator, arguments = expression[0], expression[1:]
    if operator == "piecewise":
        element = ET.Element("piecewise")
        *pairs, otherwise = arguments
        for pair in pairs:
            ET.SubElement(element, "piece").extend([write_math(e) for e in pair[1:]])
        if otherwise is not None:
            ET.SubElement(element, "otherwise").append(write_math(otherwise))
        return element
    element = ET.Element("apply")
    if operator == "atan2":
        ET.SubElement(element, "csymbol", definitionURL=ATAN2, encoding="text").text = "atan2"
    else:
        ET.SubElement(element, operator)
    element.extend([write_math(a) for a in arguments])
    return element
