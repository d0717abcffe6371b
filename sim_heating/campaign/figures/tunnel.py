"""Figure 18: a transient run in the wind tunnel of felt behind a steel leading edge: the lag of its thermocouple."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.report.figure import ANGLES, MEASURED, legend_above, new_figure
from sim_heating.campaign.figures import flown_data
from sim_heating.campaign.figures.figure_file import PaperFigure, Statement, finished
from sim_heating.estimation.fit import FitResult
from sim_heating.estimation.report.plots import AFTER, BEFORE
from sim_heating.inputs.points import conditions_of_record, interface_excess, point_of_record, wall_enthalpy_code
from sim_heating.inputs.record import Record
from sim_heating.simulation.predict import predict

SCALE = "ratio.scale"
PAPER_LAG_S = 3.0
"""Lag of the paper's run [s]."""


def transient(data: flown_data.FlownData) -> PaperFigure:
    """Figure 18: readings of the run, what is declared, fits without and with a time skew; the angle beneath."""
    _, record = data.records_of("tunnel")[0]
    if record.declared.heating.interface is None:
        raise flown_data.LeftOut(f"{record.name}: its record declares no [heating.interface]")
    declared = predict(record)
    fits = {
        "coating": data.tunnel_fit(record, SCALE, flown_data.COATING),
        "time skew": data.tunnel_fit(record, SCALE, flown_data.SKEW),
        "time skew and coating": data.tunnel_fit(record, SCALE, flown_data.SKEW, flown_data.COATING),
    }
    t, read = record.time_s, record.temperatures_K()[0]
    columns = {"time_s": t, "measured_K": read, "declared_K": declared.indicated_K[0]}
    drawn = new_figure(8.0, 7.6, 3, sharex=True, height_ratios=[2.4, 1.4, 0.9])
    top, middle, bottom = drawn[1]
    top.plot(t, read, label=f"measured, {record.sensors[0].name}", **MEASURED)
    top.plot(t, columns["declared_K"], color=BEFORE, label="declared, no lag")
    for (name, fit), style in zip(fits.items(), ("--", "-"), strict=False):
        key = name.replace(" ", "_")
        columns[f"{key}_K"] = fit.after[0].indicated_K[0]
        columns[f"{key}_residual_K"] = read - columns[f"{key}_K"]
        top.plot(t, columns[f"{key}_K"], style, color=AFTER, label=f"fitted with {name}")
        middle.plot(t, columns[f"{key}_residual_K"], style, color=AFTER, linewidth=1.0, label=f"with {name}")
    angle = record.conditions.at(t)["alpha_deg"]
    bottom.plot(t, angle, color=ANGLES["alpha_deg"][1])
    columns["alpha_deg"] = angle
    top.set_ylabel("thermocouple, K")
    middle.set_ylabel("measured\n- fitted, K")
    bottom.set_ylabel(f"{ANGLES['alpha_deg'][0]}, deg")
    bottom.set_xlabel("time, s")
    legend_above(top)
    middle.legend(fontsize=8, loc="best")
    lowered, alone = float(np.min(excess(record))), _skew_of_interface(data, record)
    skew, sigma = flown_data.estimated(fits["time skew"], flown_data.SKEW)
    coating = flown_data.estimated(fits["coating"], flown_data.COATING)
    statements = (
        Statement(
            55,
            "a transient in the tunnel is reduced, and its coating thickness is hard to estimate",
            f"{flown_data.plus_minus(*coating)} times the true coating without a skew",
            abs(coating[0] - 1.0) > 2.0 * coating[1],
        ),
        Statement(
            90,
            "a thermocouple behind an interface follows transients in the tunnel 3 s late",
            f"skew {flown_data.plus_minus(skew, sigma)} s",
            flown_data.agrees(skew, sigma, PAPER_LAG_S, 0.0),
        ),
        Statement(
            91,
            "a step up of wall temperature lowers the heating behind it, and explains the late response",
            f"heating lower by {-lowered:.1%} at most; the interface alone looks like a skew of "
            f"{flown_data.plus_minus(*alone)} s",
            lowered < 0.0 and flown_data.agrees(*alone, PAPER_LAG_S, 0.0),
        ),
    )
    notes = [f"{name} estimated: {_text(fit)}; {flown_data.fit_quality(fit)}" for name, fit in fits.items()]
    notes.append(f"interface as declared: {statements[2].here}")
    title = f"transient run in the wind tunnel, {record.declared.control_point}"
    return finished(18, title, drawn, {"": columns}, tuple(notes), statements)


def excess(record: Record) -> FloatArray:
    """(time,) `interface_excess` of a record as declared [-]."""
    interface = record.declared.heating.interface
    assert interface is not None
    flown, cp = conditions_of_record(record), wall_enthalpy_code(point_of_record(record).wall_enthalpy)
    history = predict(record).history
    wall = np.interp(flown.time_s, history.time_s, history.surface_K)
    return interface_excess(interface.interface, flown, wall, cp)


def _skew_of_interface(data: flown_data.FlownData, record: Record) -> tuple[float, float]:
    """Skew that a fit without the interface needs for readings that have it and no lag, and its sigma [s]."""
    sensor = record.sensors[0]
    readings = {**record.thermocouples, sensor.column: predict(record).indicated_K[0]}
    heating = record.declared.heating.model_copy(update={"interface": None})
    declared = record.declared.model_copy(update={"heating": heating})
    plain = replace(record, declared=declared, thermocouples=readings)
    return flown_data.estimated(data.tunnel_fit(plain, SCALE, flown_data.SKEW), flown_data.SKEW)


def _text(fit: FitResult) -> str:
    """Estimated skew and coating as text."""
    units = {
        flown_data.SKEW: ("skew", "s"),
        flown_data.COATING: ("coating", "times the declared"),
        SCALE: ("relative heating", ""),
    }
    parts = [
        (units[label.partition("@")[0]], v) for label, v in fit.parameters.items() if label.partition("@")[0] in units
    ]
    return ", ".join(f"{title} {flown_data.plus_minus(*value)} {unit}".strip() for (title, unit), value in parts)
