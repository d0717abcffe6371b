"""Aerodynamics of a vehicle as a model of DAVE-ML, and the tables of a vehicle from such a model.

    CN = CN_basic(mach, alpha) + CN_elevon(mach, alpha, elevon) + CN_bodyflap(mach, alpha, bodyflap), likewise CA and Cm

A model that is read has outputs named CN, CA and Cm, of inputs mach, angleOfAttack [deg] and optionally
elevonDeflection and bodyFlapDeflection [deg]. It is sampled at the nodes of its tables; increments of a surface are
those with the other one undeflected.

Source: ANSI/AIAA S-119 (2011); docs/reference/vehicle_format.md.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.errors import InputError
from sim_heating.base.files import csv_text, display_path, raise_problems, write_text_atomic
from sim_heating.heating.exchange import dave_ml
from sim_heating.heating.exchange.dave_ml import CheckCase, DaveModel, Signal, Variable
from sim_heating.heating.exchange.ratio_formats import TOLERANCE
from sim_heating.trajectory.aero import COEFFICIENTS, Aero, Grid

INPUTS = {
    "mach": ("mach", "nd"),
    "alpha_deg": ("angleOfAttack", "deg"),
    "elevon_deg": ("elevonDeflection", "deg"),
    "bodyflap_deg": ("bodyFlapDeflection", "deg"),
}
"""Variable -> its name in S-119 and its unit."""
SURFACES = {"elevon": "elevon_deg", "bodyflap": "bodyflap_deg"}


def aero_model(aero: Aero) -> DaveModel:
    """The tables of a vehicle, coefficients [-] over Mach [-] and angles [deg], as a model, about its moment reference,
    with check data; the flight shift is left out."""
    grids: dict[str, tuple[Grid, tuple[str, ...]]] = {"basic": (aero.basic, ("mach", "alpha_deg"))}
    for name, grid in (("elevon", aero.elevon), ("bodyflap", aero.bodyflap)):
        if grid.values.size > len(COEFFICIENTS):  # a surface that does not exist is one point
            grids[name] = (grid, ("mach", "alpha_deg", SURFACES[name]))
    read = dict.fromkeys(v for _, variables in grids.values() for v in variables)
    variables = {v: Variable(v, {"name": INPUTS[v][0], "units": INPUTS[v][1]}, ("isInput",)) for v in read}
    functions = []
    for c, coefficient in enumerate(COEFFICIENTS):
        terms = []
        for name, (grid, inputs) in grids.items():
            terms.append(key := f"{coefficient}_{name}")
            variables[key] = Variable(key, {"name": key, "units": "nd"})
            axes = (grid.mach, grid.alpha_deg, grid.deflection_deg)[: len(inputs)]
            values = grid.values[..., c].reshape([len(a) for a in axes])
            ends, table = tuple((float(a[0]), float(a[-1])) for a in axes), dave_ml.GriddedTable(key, (), axes, values)
            functions.append(dave_ml.Function(key, inputs, key, table, ends, ("neither",) * len(inputs)))
        sum_ = ("plus", *terms)
        variables[coefficient] = Variable(coefficient, {"name": coefficient, "units": "nd"}, ("isOutput",), "", sum_)
    about = f"source: {aero.file.source}\nconfidence: {aero.file.confidence}"
    model = DaveModel(aero.file.title, variables, tuple(functions), (), about)
    return DaveModel(aero.file.title, variables, tuple(functions), _cases(model, aero), about)


def _cases(model: DaveModel, aero: Aero) -> tuple[CheckCase, ...]:
    """Check cases between nodes, whose values are those that this program flies with."""
    cases = []
    for k, fraction in enumerate((0.0, 0.37, 0.71, 1.0)):

        def between(axis: FloatArray, fraction: float = fraction) -> float:
            return float(axis[0] + fraction * (axis[-1] - axis[0]))

        x = {"mach": between(aero.basic.mach), "alpha_deg": between(aero.basic.alpha_deg)}
        x |= {"elevon_deg": between(aero.elevon.deflection_deg), "bodyflap_deg": between(aero.bodyflap.deflection_deg)}
        x = {name: value for name, value in x.items() if name in model.inputs}
        full = {name: x.get(name, 0.0) for name in INPUTS}
        values = aero.body_coefficients(*(full[n] for n in ("mach", "alpha_deg", "elevon_deg", "bodyflap_deg")))
        results = tuple(Signal(n, float(v), TOLERANCE) for n, v in zip(COEFFICIENTS, values, strict=True))
        cases.append(CheckCase(f"case {k + 1}", tuple(Signal(n, v) for n, v in x.items()), results))
    return tuple(cases)


def export_aero(aero: Aero, out: str | os.PathLike[str]) -> None:
    """Write the tables of a vehicle, coefficients [-] over Mach [-] and angles [deg], as a model of DAVE-ML."""
    dave_ml.write_dave_ml(out, aero_model(aero))


def _outputs_of_vehicle(model: DaveModel, where: str) -> dict[str, str]:
    """Coefficient of a vehicle -> the output of a model that is it.

    raises : InputError where there is none
    """
    outputs = {}
    for c in COEFFICIENTS:
        named = _named(model, c, (c,), model.outputs)
        if named is None:
            raise InputError(f"{where}: no output named `{c}`; CN, CA and Cm are read")
        outputs[c] = named
    return outputs


def _inputs_of_vehicle(model: DaveModel, where: str) -> dict[str, str | None]:
    """Variable of the tables of a vehicle -> the input of a model that is it; None where the model has none.

    raises : InputError where an input is no such variable, or in another unit
    """
    inputs = {v: _named(model, v, (v, INPUTS[v][0]), model.inputs) for v in INPUTS}
    unknown = [i for i in model.inputs if i not in inputs.values()]
    if unknown:
        names = ", ".join(name for name, _ in INPUTS.values())
        raise InputError(f"{where}: input `{unknown[0]}` is no variable of the tables of a vehicle ({names})")
    for v, i in inputs.items():
        units = "" if i is None else model.variables[i].attributes.get("units", "")
        if i is not None and units != INPUTS[v][1]:
            raise InputError(f"{where}: variableDef `{i}` is in `{units}`; `{INPUTS[v][1]}` is read")
    return inputs


def import_aero(path: str | os.PathLike[str], folder: str | os.PathLike[str]) -> list[Path]:
    """Write longitudinal.csv, and elevon.csv and bodyflap.csv where the model has the surface, angles [deg], from a
    model.

    folder  : to write them into, the folder `aero` of a vehicle
    returns : the files
    raises  : InputError where an output is missing, an input is unknown, or check data are missed
    """
    model, where = dave_ml.read_dave_ml(path), display_path(path)
    raise_problems([f"{where}: {p}" for p in model.check_problems()])
    outputs = _outputs_of_vehicle(model, where)
    inputs = _inputs_of_vehicle(model, where)
    nodes = {v: model.nodes_of(i) for v, i in inputs.items()}

    def values(mach: FloatArray, alpha: FloatArray, surface: str | None, at: FloatArray) -> dict[str, FloatArray]:
        zero = np.zeros(mach.shape)
        x = {"mach": mach, "alpha_deg": alpha, "elevon_deg": zero, "bodyflap_deg": zero}
        x |= {} if surface is None else {surface: at}
        evaluated = model.evaluate({i: x[v] for v, i in inputs.items() if i is not None})
        return {c: np.broadcast_to(evaluated[i], mach.shape) for c, i in outputs.items()}

    header = {"source": f"{Path(path).name}: {model.title}"}
    files = []
    for name, surface in (("longitudinal", None), *SURFACES.items()):
        if surface is not None and inputs[surface] is None:
            continue
        axes = [nodes["mach"], nodes["alpha_deg"], np.zeros(1) if surface is None else nodes[surface]]
        mach, alpha, at = (g.ravel() for g in np.meshgrid(*axes, indexing="ij"))
        coefficients = values(mach, alpha, surface, at)
        columns = {"mach": mach, "alpha_deg": alpha}
        if surface is not None:
            base = values(mach, alpha, None, at)
            coefficients = {c: v - base[c] for c, v in coefficients.items()}
            columns["deflection_deg"] = at
        files.append(Path(folder) / f"{name}.csv")
        Path(folder).mkdir(parents=True, exist_ok=True)
        write_text_atomic(files[-1], csv_text(columns | coefficients, None, header))
    return files


def _named(model: DaveModel, column: str, names: tuple[str, ...], among: tuple[str, ...]) -> str | None:
    return next((i for i in among if i == column or model.variables[i].name in names), None)
