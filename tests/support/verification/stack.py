"""A whole stack through an entry, nonlinear in temperature and pressure; estimates from another program's records."""

from __future__ import annotations

import tomllib
from dataclasses import replace

import numpy as np

from sim_heating.estimation.fit import estimate
from sim_heating.inputs.points import conditions_of_record, point_of_record
from sim_heating.inputs.record import load_record
from sim_heating.march.ensemble import condition_history
from sim_heating.march.history import march_points
from sim_heating.march.mesh_choice import TOLERANCE_K, pack
from tests.support.problems import RECORD
from tests.support.verification import method_of_lines
from tests.support.verification.row import Row

ELEMENTS = (8, 120, 2, 16, 2, 4)
"""Elements of each layer of the independent solution."""
OWN_ERROR_K = 0.06
"""Error of the independent solution: 0.03 K of its 153 nodes, 0.02 K of its tolerance."""


def entry() -> list[Row]:
    """A tile stack of six layers along a recorded entry: finite volumes and scipy's Radau against the march."""
    record = load_record(RECORD)
    model, conditions = replace(point_of_record(record), nodes=None), conditions_of_record(record)
    grid = method_of_lines.grid(model, ELEMENTS)
    own = method_of_lines.solve(model, conditions, grid, rtol=1e-6)
    history = condition_history(conditions)[np.newaxis]
    flown = march_points([model], [conditions])[0]
    chosen = np.column_stack((flown.surface_K, flown.bondline_K, *flown.sensors_K))
    runs = (
        ("as chosen", chosen, TOLERANCE_K + OWN_ERROR_K, "tolerance of the mesh, and 0.06 K of the reference"),
        (
            "100 nodes, 0.1 s",
            pack([replace(model, nodes=100)]).march(conditions.time_s, history, longest_step_s=0.1),
            OWN_ERROR_K,
            "error of the reference: 153 nodes, tolerance 1e-6",
        ),
    )
    source = "own finite volumes, k at mean temperatures, scipy Radau at 1e-6"
    places = (
        ("surface", 0.0),
        ("bondline", model.construction.stack.bondline_m),
        ("first thermocouple", model.depths_m[0]),
    )
    rows = []
    for name, out, limit, is_ in runs:
        for column, (where, depth) in enumerate(places):
            reference = own[:, grid.node(depth)]
            peak, worst = int(np.argmax(reference)), float(np.max(np.abs(out[:, column] - reference)))
            at = f"tile stack through an entry, mesh and steps {name}: {where}"
            rows.append(Row(f"{at}, peak", reference[peak], out[peak, column], limit, "K", source, is_))
            rows.append(Row(f"{at}, largest difference", 0.0, worst, limit, "K", source, is_))
    return rows


def estimates() -> list[Row]:
    """Heating derivatives of two records of another program, fitted by default, against what that program put in."""
    rows = []
    for name in ("p06", "p07"):
        folder = RECORD.with_name(name)
        truth = tomllib.loads((folder / "truth.toml").read_text())
        fit = estimate([load_record(folder)], reference=truth["reference_condition"])
        for label, value, half in zip(fit.labels, fit.fit.values, fit.bounds.half_width(), strict=True):
            expected = truth["parameters"].get(label, 0.0)
            source = "truth of another program's record"
            unit = "-" if label in ("ratio.scale", "ratio.d_logre") else "1/deg"
            rows.append(
                Row(
                    f"estimate of {label}, record {name}",
                    expected,
                    float(value),
                    float(half),
                    unit,
                    source,
                    "95 % bound of the fit",
                )
            )
    return rows


def profiles() -> list[Row]:
    """The profile of a likelihood that is a parabola: 1.96 sigmas on either side."""
    fit = estimate(load_record(RECORD), profiles=["ratio.scale"])
    value, sigma = fit.parameters["ratio.scale"]
    found = fit.profiles["ratio.scale"]
    name, source, is_ = "95 % interval of ratio.scale by the profile", "value, 1.96 sigma", "0.1 sigma"
    return [
        Row(f"{name}: {end}", value + side * 1.96 * sigma, got, 0.1 * sigma, "-", source, is_)
        for end, side, got in (("lower", -1.0, found.lower), ("upper", 1.0, found.upper))
    ]


def rows() -> list[Row]:
    """All of this subject."""
    return [*entry(), *estimates(), *profiles()]
