"""Models in DAVE-ML: variables, calculations, functions on gridded and ungridded tables, check data.

    model = read_dave_ml("F16_aero.dml")
    model.check()                                   # every check case within its tolerance, or a problem a line
    model.evaluate({"alpha": [0.0, 5.0], ...})      # values of all variables, by identifier

Between nodes a gridded table is multilinear, beyond them constant, or linear where its `extrapolate` says so. An
ungridded table is linear on the Delaunay triangles of its points, and has the value of the nearest one beyond them.

Source: ANSI/AIAA S-119-2011, Flight Dynamics Model Exchange Standard; DAVE-ML 2.0 reference manual, daveml.org;
Jackson and Hildreth (2002), "Flight Dynamic Model Exchange Using XML", AIAA 2002-4482.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from graphlib import CycleError, TopologicalSorter
from itertools import chain
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator

from sim_heating.base.arrays import FloatArray
from sim_heating.base.errors import InputError, error_context
from sim_heating.base.files import display_path, raise_problems, suggestion, write_text_atomic
from sim_heating.base.files.xml import read_xml
from sim_heating.heating.exchange import mathml

ROOT, SPACE = "DAVEfunc", "http://daveml.org/2010/DAVEML"
DOCTYPE = (
    '<!DOCTYPE DAVEfunc PUBLIC "-//AIAA//DTD for Flight Dynamic Models - Functions 2.0//EN"\n'
    '  "http://www.daveml.org/DTDs/2p0/DAVEfunc.dtd">\n'
)
FLAGS = ("isControl", "isDisturbance", "isInput", "isOutput", "isState", "isStateDeriv", "isStdAIAA")
ENDS = {"neither": (False, False), "min": (True, False), "max": (False, True), "both": (True, True)}
"""Value of `extrapolate` -> whether the table goes on linearly below its first and above its last node."""
LOOSEST = 1e-9
"""Tolerance of a check value that states none, relative to its magnitude or 1."""


@dataclass(frozen=True)
class Variable:
    """A variable.

    attributes  : name, units, symbol, sign, initialValue, minValue, maxValue and others, as they stand in the file
    flags       : of FLAGS;  calculation : None for an input, a constant, or the value of a function
    """

    id: str
    attributes: Mapping[str, str]
    flags: tuple[str, ...] = ()
    description: str = ""
    calculation: mathml.Expression | None = None

    def number(self, name: str) -> float | None:
        """A numeric attribute in the unit of the variable, or [-]; None where it is absent.

        Source: ANSI/AIAA S-119 (2011).
        """
        text = self.attributes.get(name)
        return None if text is None else mathml.number_of(text, f"variableDef `{self.id}`, {name}")

    @property
    def name(self) -> str:
        """Its name in the standard, by which check data may refer to it."""
        return self.attributes.get("name", self.id)


@dataclass(frozen=True)
class GriddedTable:
    """Values on a rectangular grid.

    breakpoints : names of its axes;  axes : increasing nodes of each;  values : one axis a variable, the last fastest
    """

    id: str
    breakpoints: tuple[str, ...]
    axes: tuple[FloatArray, ...]
    values: FloatArray

    def at(self, x: Sequence[FloatArray], ends: Sequence[tuple[bool, bool]]) -> FloatArray:
        """Values at points, multilinear, in the unit of the table, or [-].

        x    : values of each variable;  ends : of each, whether the table goes on linearly below and above
        Source: ANSI/AIAA S-119 (2011).
        """
        cells = []
        for axis, xi, (below, above) in zip(self.axes, x, ends, strict=True):
            if len(axis) == 1:
                cells.append((np.zeros(np.shape(xi), dtype=int), np.zeros(np.shape(xi))))
                continue
            i = np.clip(np.searchsorted(axis, xi, side="right") - 1, 0, len(axis) - 2)
            f = (xi - axis[i]) / (axis[i + 1] - axis[i])
            cells.append((i, np.clip(f, -np.inf if below else 0.0, np.inf if above else 1.0)))
        value = np.zeros(np.broadcast_shapes(*map(np.shape, x)))
        for corner in np.ndindex(*(min(2, len(axis)) for axis in self.axes)):
            weight: Any = 1.0
            for (_, f), upper in zip(cells, corner, strict=True):
                weight = weight * (f if upper else 1.0 - f)
            value = value + weight * self.values[tuple(i + c for (i, _), c in zip(cells, corner, strict=True))]
        return value


@dataclass(frozen=True)
class UngriddedTable:
    """Values at scattered points; points : (n, variables);  values : (n,)"""

    id: str
    points: FloatArray
    values: FloatArray

    @cached_property
    def _inside(self) -> Any:
        return LinearNDInterpolator(self.points, self.values, rescale=True)

    @cached_property
    def _beyond(self) -> Any:
        return NearestNDInterpolator(self.points, self.values, rescale=True)

    def at(self, x: Sequence[FloatArray], ends: Sequence[tuple[bool, bool]]) -> FloatArray:
        """Values at points, in the unit of the table, or [-]; beyond them that of the nearest, whatever `ends` says.

        Source: ANSI/AIAA S-119 (2011).
        """
        if self.points.shape[1] == 1:
            order = np.argsort(self.points[:, 0])
            return np.interp(x[0], self.points[order, 0], self.values[order])
        where = np.stack(np.broadcast_arrays(*x), axis=-1)
        value, nearest = (f(where).reshape(where.shape[:-1]) for f in (self._inside, self._beyond))
        return np.where(np.isnan(value), nearest, value)


Table = GriddedTable | UngriddedTable


@dataclass(frozen=True)
class Function:
    """A dependent variable as a table of others.

    variables : identifiers, in the order of the table's axes
    limits    : least and greatest value of each that the table is read at;  extrapolate : of each, a key of ENDS
    """

    name: str
    variables: tuple[str, ...]
    result: str
    table: Table
    limits: tuple[tuple[float, float], ...]
    extrapolate: tuple[str, ...]
    description: str = ""

    def at(self, values: Mapping[str, ArrayLike]) -> FloatArray:
        """The dependent variable, in its unit, or [-].

        Source: ANSI/AIAA S-119 (2011).
        """
        x = [
            np.clip(np.asarray(values[v], dtype=float), *limits)
            for v, limits in zip(self.variables, self.limits, strict=True)
        ]
        return self.table.at(x, [ENDS[e] for e in self.extrapolate])


@dataclass(frozen=True)
class Signal:
    """A value of a check case.

    variable : identifier;  tolerance : absolute; None of an input
    """

    variable: str
    value: float
    tolerance: float | None = None


@dataclass(frozen=True)
class CheckCase:
    """Values that the model must give for some inputs."""

    name: str
    inputs: tuple[Signal, ...]
    results: tuple[Signal, ...]


@dataclass(frozen=True, repr=False)
class DaveModel:
    """A model of DAVE-ML.

    title, about : of its header;  variables, functions : in the order of the file
    """

    title: str
    variables: Mapping[str, Variable]
    functions: tuple[Function, ...]
    cases: tuple[CheckCase, ...] = ()
    about: str = ""
    author: Mapping[str, str] = field(default_factory=dict)
    date: str = ""

    def __post_init__(self) -> None:
        raise_problems(self._problems())

    def __repr__(self) -> str:
        counts = f"{len(self.inputs)} inputs, {len(self.outputs)} outputs, {len(self.cases)} check cases"
        return f"<DaveModel {self.title!r}: {counts}>"

    @cached_property
    def by_result(self) -> Mapping[str, Function]:
        """Functions by the identifier of their dependent variable."""
        return {f.result: f for f in self.functions}

    @cached_property
    def inputs(self) -> tuple[str, ...]:
        """Identifiers of the variables that the file marks as inputs, and of those that nothing else gives a value."""
        return tuple(
            i
            for i, v in self.variables.items()
            if v.calculation is None
            and i not in self.by_result
            and ("isInput" in v.flags or "initialValue" not in v.attributes)
        )

    @cached_property
    def outputs(self) -> tuple[str, ...]:
        """Identifiers of the variables that the file marks as outputs; where it marks none, all that are computed."""
        marked = tuple(i for i, v in self.variables.items() if "isOutput" in v.flags)
        return marked or tuple(i for i, v in self.variables.items() if v.calculation is not None or i in self.by_result)

    def _needs(self, identifier: str) -> tuple[str, ...]:
        calculation = self.variables[identifier].calculation
        if calculation is not None:
            return tuple(mathml.names_in(calculation))
        function = self.by_result.get(identifier)
        return function.variables if function else ()

    @cached_property
    def _order(self) -> tuple[str, ...]:
        return tuple(TopologicalSorter({i: self._needs(i) for i in self.variables}).static_order())

    def _problems(self) -> list[str]:
        problems = [
            f"variable `{i}`: reads `{name}`, which is not defined{suggestion(name, self.variables)}"
            for i in self.variables
            for name in self._needs(i)
            if name not in self.variables
        ]
        problems += [
            f"function `{f.name}`: its result `{f.result}` is not defined{suggestion(f.result, self.variables)}"
            for f in self.functions
            if f.result not in self.variables
        ]
        if not problems:
            try:
                self._order  # noqa: B018
            except CycleError as error:
                problems.append(f"variables need each other in a circle: {' -> '.join(error.args[1])}")
        return problems

    def nodes_of(self, identifier: str | None) -> FloatArray:
        """All nodes that gridded tables have in a variable, in its unit, or [-]; 0 where none reads it.

        Source: ANSI/AIAA S-119 (2011).
        """
        nodes: set[float] = set()
        for f in self.functions:
            for v, axis in zip(f.variables, f.table.axes if isinstance(f.table, GriddedTable) else (), strict=False):
                nodes |= set(axis.tolist()) if v == identifier else set()
        return np.array(sorted(nodes) or [0.0])

    def evaluate(self, values: Mapping[str, ArrayLike]) -> dict[str, FloatArray]:
        """Values of all variables.

        values  : of the inputs, by identifier; of other variables in place of their initial values
        returns : by identifier, in the shape of the inputs, each in its unit, or [-]
        raises  : InputError that names an input without a value, or an identifier that no variable has
        Source: ANSI/AIAA S-119 (2011).
        """
        unknown = next((i for i in values if i not in self.variables), None)
        if unknown is not None:
            raise InputError(f"`{unknown}` is no variable of the model{suggestion(unknown, self.inputs)}")
        by_identifier: dict[str, Any] = {}
        for i in self._order:
            v = self.variables[i]
            by_identifier[i] = self._value_of(v, values, by_identifier)
            low, high = v.number("minValue"), v.number("maxValue")
            if low is not None or high is not None:
                by_identifier[i] = np.clip(by_identifier[i], low, high)
        return {i: by_identifier[i] for i in self.variables}

    def _value_of(self, v: Variable, values: Mapping[str, ArrayLike], by_identifier: Mapping[str, Any]) -> Any:
        """Value of a variable, not yet within its limits, from those of the variables that it needs."""
        if v.calculation is not None:
            return mathml.evaluate(v.calculation, by_identifier)
        if v.id in self.by_result:
            return self.by_result[v.id].at(by_identifier)
        if v.id in values:
            return np.asarray(values[v.id], dtype=float)
        if (start := v.number("initialValue")) is not None:
            return np.float64(start)
        raise InputError(f"input `{v.id}` ({v.name}) has no value; it needs {', '.join(self.inputs)}")

    def check_problems(self) -> list[str]:
        """Check values, each in the unit of its variable ([deg], [-] ...), that the model misses by more than their
        tolerance, one line each."""
        problems = []
        for case in self.cases:
            outputs = self.evaluate({s.variable: s.value for s in case.inputs})
            for s in case.results:
                off = abs(float(outputs[s.variable]) - s.value)
                tolerance = LOOSEST * max(1.0, abs(s.value)) if s.tolerance is None else s.tolerance
                if not off <= tolerance:
                    value = float(outputs[s.variable])
                    problems.append(
                        f"check case `{case.name}`: `{s.variable}` is {value:.10g}, not {s.value:.10g} +- {tolerance:g}"
                    )
        return problems


def _simple_table(name: str, inputs: Sequence[ET.Element], result: ET.Element, where: str) -> GriddedTable:
    """The table of a function whose points stand in itself."""
    axes, values = tuple(_numbers(i, where) for i in inputs), _numbers(result, where)
    if len(axes) == 1 and np.any(np.diff(axes[0]) <= 0.0):
        raise InputError(f"{where}: its independentVarPts must increase from value to value")
    shape = tuple(map(len, axes))
    if values.size != np.prod(shape):
        raise InputError(f"{where}: {values.size} values, and its variables make {int(np.prod(shape))}")
    return GriddedTable(name, (), axes, values.reshape(shape))


def _extrapolation(variable: ET.Element, where: str) -> str:
    """Ends beyond which a function is extrapolated in a variable; one that is not linear is refused."""
    end, form = variable.get("extrapolate", "neither"), variable.get("interpolate", "linear")
    if end not in ENDS or form != "linear":
        wrong = form if end in ENDS else end
        raise InputError(f"{where}, variable `{variable.get('varID')}`: `{wrong}` is not read here; use linear tables")
    return end


def _limits(variable: ET.Element, where: str) -> tuple[float, float]:
    """Least and greatest value of a variable that its table is read at."""
    least, greatest = variable.get("min", "-1e300"), variable.get("max", "1e300")
    return mathml.number_of(least, f"{where}, min"), mathml.number_of(greatest, f"{where}, max")


class _Reader:
    """Reads a document; messages name the element by its identifier or name."""

    def __init__(self, root: ET.Element) -> None:
        self.root = root
        self.breakpoints = {
            e.get("bpID", ""): _numbers(_child(e, "bpVals"), f"breakpointDef `{e.get('bpID')}`")
            for e in _children(root, "breakpointDef")
        }
        self.tables: dict[str, Table] = {}
        for e in _children(root, "griddedTableDef"):
            self.tables[e.get("gtID", "")] = self.gridded(e)
        for e in _children(root, "ungriddedTableDef"):
            self.tables[e.get("utID", "")] = self.ungridded(e)

    def gridded(self, e: ET.Element) -> GriddedTable:
        name = e.get("gtID") or e.get("name") or "inline"
        where = f"griddedTableDef `{name}`"
        references = [r.get("bpID", "") for r in _children(_child(e, "breakpointRefs", where), "bpRef")]
        axes = self.axes_of(references, where)
        values = _numbers(_child(e, "dataTable", where), where)
        shape = tuple(map(len, axes))
        if values.size != np.prod(shape):
            raise InputError(f"{where}: {values.size} values, and its breakpoints make {int(np.prod(shape))}")
        return GriddedTable(name, tuple(references), axes, values.reshape(shape))

    def axes_of(self, references: Sequence[str], where: str) -> tuple[FloatArray, ...]:
        for r in references:
            if r not in self.breakpoints:
                raise InputError(f"{where}: breakpoints `{r}` are not defined{suggestion(r, self.breakpoints)}")
        for r in references:
            if len(self.breakpoints[r]) == 0 or np.any(np.diff(self.breakpoints[r]) <= 0.0):
                raise InputError(f"breakpointDef `{r}`: must increase from value to value")
        return tuple(self.breakpoints[r] for r in references)

    def ungridded(self, e: ET.Element) -> UngriddedTable:
        name = e.get("utID") or e.get("name") or "inline"
        where = f"ungriddedTableDef `{name}`"
        rows = [_numbers(p, where) for p in _children(e, "dataPoint")]
        if not rows or len({len(r) for r in rows}) != 1 or len(rows[0]) < 2:
            raise InputError(f"{where}: every dataPoint must have the same number of values, two at least")
        points = np.array(rows)
        if len(points) < points.shape[1]:
            raise InputError(f"{where}: {len(points)} points do not span {points.shape[1] - 1} variables")
        return UngriddedTable(name, points[:, :-1], points[:, -1])

    def model(self) -> DaveModel:
        header = _child(self.root, "fileHeader")
        variables: dict[str, Variable] = {}
        for e in _children(self.root, "variableDef"):
            v = _variable(e)
            if not v.id or v.id in variables:
                raise InputError(f"variableDef `{v.id or e.get('name')}`: its varID is missing or repeated")
            variables[v.id] = v
        names = {v.name: i for i, v in reversed(variables.items())}
        functions = tuple(map(self.function, _children(self.root, "function")))
        cases = tuple(
            _case(e, variables, names)
            for data in _children(self.root, "checkData")
            for e in _children(data, "staticShot")
        )
        author = dict(next((child.attrib for child in _children(header, "author")), {}))
        date = next((child.get("date", "") for child in _children(header, "creationDate")), "")
        return DaveModel(
            header.get("name", ""),
            variables,
            functions,
            cases,
            _text(header, "description"),
            author,
            date,
        )

    def function(self, e: ET.Element) -> Function:
        name = e.get("name", "")
        where = f"function `{name}`"
        simple = _children(e, "independentVarPts")
        inputs = simple or _children(e, "independentVarRef")
        result = _child(e, "dependentVarPts" if simple else "dependentVarRef", where)
        if not inputs:
            raise InputError(f"{where}: has no independent variable")
        if simple:
            table: Table = _simple_table(name, inputs, result, where)
        else:
            table = self.table_of(_child(e, "functionDefn", where), where)
            count = table.values.ndim if isinstance(table, GriddedTable) else table.points.shape[1]
            if count != len(inputs):
                raise InputError(f"{where}: {len(inputs)} independent variables, and its table has {count}")
        ends = tuple(_extrapolation(i, where) for i in inputs)
        limits = tuple(_limits(i, where) for i in inputs)
        identifiers = tuple(i.get("varID", "") for i in inputs)
        return Function(name, identifiers, result.get("varID", ""), table, limits, ends, _text(e, "description"))

    def table_of(self, definition: ET.Element, where: str) -> Table:
        for e in definition:
            name = mathml.local_name(e)
            if name in ("griddedTableRef", "ungriddedTableRef"):
                key = e.get("gtID") or e.get("utID") or ""
                if key not in self.tables:
                    raise InputError(f"{where}: table `{key}` is not defined{suggestion(key, self.tables)}")
                return self.tables[key]
            if name in ("griddedTableDef", "griddedTable"):
                return self.gridded(e)
            if name in ("ungriddedTableDef", "ungriddedTable"):
                return self.ungridded(e)
        raise InputError(f"{where}: its functionDefn has no table")


def _children(element: ET.Element, name: str) -> list[ET.Element]:
    return [e for e in element if mathml.local_name(e) == name]


def _child(element: ET.Element, name: str, where: str = "") -> ET.Element:
    children = _children(element, name)
    if not children:
        raise InputError(f"{where or f'<{mathml.local_name(element)}>'}: lacks <{name}>")
    return children[0]


def _text(element: ET.Element, name: str) -> str:
    """Text of the first child of a name, its lines stripped; empty where there is none."""
    text = next((e.text or "" for e in _children(element, name)), "")
    return "\n".join(line for line in (stripped.strip() for stripped in text.splitlines()) if line)


def _numbers(element: ET.Element, where: str) -> FloatArray:
    """Numbers of an element's text, between commas or white space."""
    text = "".join(element.itertext()).replace(",", " ").split()
    return np.array([mathml.number_of(t, where) for t in text])


def _variable(e: ET.Element) -> Variable:
    attributes = {k: v for k, v in e.attrib.items() if k != "varID"}
    identifier = e.get("varID", "")
    calculation = None
    for c in _children(e, "calculation"):
        try:
            calculation = mathml.read_math(_child(c, "math"))
        except InputError as error:
            raise InputError(f"variableDef `{identifier}`: {error}") from None
    flags = tuple(mathml.local_name(c) for c in e if mathml.local_name(c) in FLAGS)
    variable = Variable(identifier, attributes, flags, _text(e, "description"), calculation)
    for name in ("initialValue", "minValue", "maxValue"):
        variable.number(name)  # a text that is no number is refused where it stands
    return variable


def _case(e: ET.Element, variables: Mapping[str, Variable], names: Mapping[str, str]) -> CheckCase:
    where = f"staticShot `{e.get('name')}`"

    def signals(group: str, with_tolerance: bool) -> Iterator[Signal]:
        for s in chain.from_iterable(_children(g, "signal") for g in _children(e, group)):
            key = _variable_of_signal(s, where, variables, names)
            tolerance = _text(s, "tol") if with_tolerance else ""
            value = mathml.number_of(_text(s, "signalValue"), f"{where}, `{key}`")
            yield Signal(key, value, mathml.number_of(tolerance, f"{where}, tol") if tolerance else None)

    results = (*signals("internalValues", True), *signals("checkOutputs", True))
    return CheckCase(e.get("name", ""), tuple(signals("checkInputs", False)), results)


def _variable_of_signal(
    signal: ET.Element, where: str, variables: Mapping[str, Variable], names: Mapping[str, str]
) -> str:
    """Identifier of the variable that a signal names by it or by the variable's name.

    raises : InputError for one of no variable
    """
    stated = _first_text(signal, "varID", "signalID")
    stated = (_text(signal, "signalName") if stated is None else stated).strip()
    key = stated if stated in variables else names.get(stated, "")
    if not key:
        label = _first_text(signal, "varID", "signalID", "signalName") or ""
        raise InputError(f"{where}: signal `{label}` is no variable{suggestion(label, names)}")
    return key


def _first_text(element: ET.Element, *names: str) -> str | None:
    """Text of the first child that has one of the names; None without such a child."""
    return next((c.text or "" for c in element if mathml.local_name(c) in names), None)


def read_dave_ml(path: str | os.PathLike[str]) -> DaveModel:
    """Read a model; its document type is not fetched, and one that declares entities is refused.

    raises : InputError with file and element
    """
    file = Path(path)
    content = read_xml(file, ROOT, names_standard=True)
    with error_context(display_path(file)):
        return _Reader(ET.fromstring(content)).model()


def write_dave_ml(path: str | os.PathLike[str], model: DaveModel) -> None:
    """Write a model, atomically: it reads back with equal numbers."""
    write_text_atomic(path, dave_ml_text(model))


def _write_breakpoints(
    root: ET.Element, tables: Mapping[int, GriddedTable | UngriddedTable], names: Mapping[int, str]
) -> dict[bytes, str]:
    """Define the breakpoints of gridded tables, equal ones once; their names by their bytes."""
    axes: dict[bytes, str] = {}
    gridded = ((key, table) for key, table in tables.items() if isinstance(table, GriddedTable))
    for key, i, axis in ((key, i, axis) for key, table in gridded for i, axis in enumerate(table.axes, 1)):
        if axis.tobytes() not in axes:
            axes[axis.tobytes()] = name = f"BP_{len(axes) + 1}_{names[key]}_{i}"
            e = ET.SubElement(root, "breakpointDef", name=name, bpID=name)
            ET.SubElement(e, "bpVals").text = _listed(axis)
    return axes


def dave_ml_text(model: DaveModel) -> str:
    """A model as a document of DAVE-ML 2.0."""
    root = ET.Element(ROOT, xmlns=SPACE)
    header = ET.SubElement(root, "fileHeader", name=model.title)
    ET.SubElement(header, "author", {"name": "unknown", "org": "unknown", **model.author})
    ET.SubElement(header, "creationDate", date=model.date or "unknown")
    if model.about:
        ET.SubElement(header, "description").text = model.about
    for v in model.variables.values():
        _write_variable(root, v)
    tables = {id(f.table): f.table for f in model.functions}
    names = _table_names(tables)
    axes = _write_breakpoints(root, tables, names)
    for key, table in tables.items():
        _write_table(root, table, names[key], axes)
    for f in model.functions:
        _write_function(root, f, names[id(f.table)])
    if model.cases:
        data = ET.SubElement(root, "checkData")
        for case in model.cases:
            _write_case(data, case, model.variables)
    ET.indent(root)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{DOCTYPE}{ET.tostring(root, encoding="unicode")}\n'


def _listed(values: FloatArray) -> str:
    return ", ".join(map(repr, values.ravel().tolist()))


def _table_names(tables: Mapping[int, Table]) -> dict[int, str]:
    """Identifiers of tables: their own, with a number where several have one."""
    names: dict[int, str] = {}
    for key, table in tables.items():
        identifier = "".join(c if c.isalnum() or c == "_" else "_" for c in table.id) or "table"
        names[key] = identifier if identifier not in names.values() else f"{identifier}_{len(names) + 1}"
    return names


def _write_variable(root: ET.Element, v: Variable) -> None:
    e = ET.SubElement(root, "variableDef", {"name": v.name, "varID": v.id, **v.attributes})
    if v.description:
        ET.SubElement(e, "description").text = v.description
    if v.calculation is not None:
        math = ET.SubElement(ET.SubElement(e, "calculation"), "math", xmlns=mathml.NAMESPACE)
        math.append(mathml.write_math(v.calculation))
    for flag in v.flags:
        ET.SubElement(e, flag)


def _write_table(root: ET.Element, table: Table, name: str, axes: Mapping[bytes, str]) -> None:
    if isinstance(table, UngriddedTable):
        e = ET.SubElement(root, "ungriddedTableDef", name=name, utID=name)
        for row, value in zip(table.points.tolist(), table.values.tolist(), strict=True):
            ET.SubElement(e, "dataPoint").text = " ".join(map(repr, [*row, value]))
        return
    e = ET.SubElement(root, "griddedTableDef", name=name, gtID=name)
    references = ET.SubElement(e, "breakpointRefs")
    for axis in table.axes:
        ET.SubElement(references, "bpRef", bpID=axes[axis.tobytes()])
    ET.SubElement(e, "dataTable").text = _listed(table.values)


def _write_function(root: ET.Element, f: Function, table: str) -> None:
    e = ET.SubElement(root, "function", name=f.name)
    if f.description:
        ET.SubElement(e, "description").text = f.description
    for v, (low, high), end in zip(f.variables, f.limits, f.extrapolate, strict=True):
        limits = {"min": repr(low)} if low > -1e300 else {}
        limits |= {"max": repr(high)} if high < 1e300 else {}
        ET.SubElement(e, "independentVarRef", {"varID": v, **limits, "extrapolate": end})
    ET.SubElement(e, "dependentVarRef", varID=f.result)
    definition = ET.SubElement(e, "functionDefn", name=f"{f.name} definition")
    if isinstance(f.table, UngriddedTable):
        ET.SubElement(definition, "ungriddedTableRef", utID=table)
    else:
        ET.SubElement(definition, "griddedTableRef", gtID=table)


def _write_case(data: ET.Element, case: CheckCase, variables: Mapping[str, Variable]) -> None:
    e = ET.SubElement(data, "staticShot", name=case.name)
    internal = [s for s in case.results if "isOutput" not in variables[s.variable].flags]
    groups = [("checkInputs", case.inputs), ("internalValues", internal)]
    groups.append(("checkOutputs", [s for s in case.results if s not in internal]))
    for name, signals in groups:
        if name == "internalValues" and not signals:
            continue
        group = ET.SubElement(e, name)
        for s in signals:
            signal = ET.SubElement(group, "signal")
            # By identifier: names need not be unique.
            ET.SubElement(signal, "varID").text = s.variable
            ET.SubElement(signal, "signalValue").text = repr(s.value)
            if s.tolerance is not None:
                ET.SubElement(signal, "tol").text = repr(s.tolerance)
