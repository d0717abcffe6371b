"""Figure 4: temperatures a priori and a posteriori of the Kalman filter, from approximate initial conditions."""

from __future__ import annotations

from typing import Any

import numpy as np

from sim_heating.base.report.figure import legend_above, new_figure
from sim_heating.campaign.figures.figure_file import PaperFigure, Statement, finished
from sim_heating.campaign.figures.flown_data import POPU, FlownData
from sim_heating.estimation.filter.process_noise import ProcessNoise
from sim_heating.estimation.report.filtered import POSTERIOR, PRIOR, FilteredSensor, filtered_history

START_BEFORE_S = 50.0
"""The paper's approximate initial conditions were generated this long before the manoeuvre [s]."""
NOISE = ProcessNoise(node_K_sqrt_s=0.1)
"""White noise of every node: a tenth of a kelvin in a second [K s^(-1/2)]."""
FIRST_S = 15.0
"""Time after the start that is enlarged, where the steps of the filter can be seen [s]."""


def steps(data: FlownData) -> PaperFigure:
    """Figure 4: every thermocouple of the lower surface, before and after each of its readings."""
    flown = data.manoeuvre("lower", POPU, 20.0)
    start_s = flown.manoeuvre.start_s - START_BEFORE_S
    fit = data.filtered_fit(flown, start_s, NOISE)
    assert fit.innovations is not None
    history = filtered_history(fit.innovations, fit.fit.values, fit.problem.record_fits[0])
    sensors = sorted(history.sensors, key=lambda s: s.channel.sensor.depth_m)
    height = 1.0 + 1.55 * len(sensors)
    drawn = new_figure(11.0, height, len(sensors), 2, squeeze=False, sharex="col", width_ratios=[1.15, 1.0])
    tables: dict[str, dict[str, Any]] = {}
    for row, sensor in zip(drawn[1], sensors, strict=True):
        early = sensor.time_s <= sensor.time_s[0] + FIRST_S
        for a, shown in zip(row, (early, np.ones(len(early), dtype=bool)), strict=True):
            _plot_steps(a, sensor, shown)
        row[0].set_ylabel(f"{sensor.channel.sensor.name}, K\n{1e3 * sensor.channel.sensor.depth_m:.1f} mm")
        tables[sensor.channel.sensor.name] = {
            "time_s": sensor.time_s,
            "read_K": sensor.read_K,
            "prior_K": sensor.prior_K,
            "prior_sigma_K": sensor.prior_sigma_K,
            "posterior_K": sensor.posterior_K,
            "posterior_sigma_K": sensor.posterior_sigma_K,
        }
    legend_above(drawn[1][0, 0])
    drawn[1][-1, 0].set_xlabel(f"time, s: the first {FIRST_S:g} s")
    drawn[1][-1, 1].set_xlabel("time, s; shaded: manoeuvre")
    for a in drawn[1][:, 1]:
        a.axvspan(flown.manoeuvre.start_s, flown.manoeuvre.end_s, color="tab:orange", alpha=0.14, linewidth=0)
    drawn[0].align_ylabels(drawn[1])
    largest = max(float(np.max(np.abs(s.posterior_K[:3] - s.prior_K[:3]))) for s in sensors)
    last = max(float(np.max(np.abs(s.posterior_K[-10:] - s.prior_K[-10:]))) for s in sensors)
    title = (
        f"a priori and a posteriori temperatures, {flown.label}, started by the circuit analogy {START_BEFORE_S:g} s "
        "before"
    )
    note = f"largest step of the filter: {largest:.1f} K in the first three samples, {last:.1f} K in the last ten"
    statement = Statement(
        60,
        "the filter takes the error of approximate initial conditions back at every node",
        f"steps of up to {largest:.1f} K at first, {last:.1f} K at last",
        last < largest / 3.0,
    )
    return finished(4, title, drawn, tables, (note,), (statement,))


def _plot_steps(a: Any, s: FilteredSensor, shown: np.ndarray) -> None:
    """Plot prediction and update of each reading, joined in the order of time, with the bound of the prediction."""
    t, prior, posterior = s.time_s[shown], s.prior_K[shown], s.posterior_K[shown]
    bound = 2.0 * s.prior_sigma_K[shown]
    a.fill_between(t, prior - bound, prior + bound, color=PRIOR, alpha=0.15, linewidth=0)
    path = np.column_stack([prior, posterior]).ravel()
    a.plot(np.repeat(t, 2), path, color="0.55", linewidth=0.8)
    a.plot(t, prior, "^", color=PRIOR, markersize=4, label="a priori")
    a.plot(t, posterior, "v", color=POSTERIOR, markersize=4, label="a posteriori")
    a.plot(t, s.read_K[shown], "o", color="0.2", markersize=2.2, label="measured")
    values = np.concatenate([prior, posterior, s.read_K[shown]])
    margin = 0.1 * max(float(np.ptp(values)), 1.0)
    a.set_ylim(float(values.min()) - margin, float(values.max()) + margin)
