"""Pictures of a design: planned and optimal manoeuvre, bounds along each number, and what instruments would buy."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.ticker import LogLocator, NullLocator, StrMethodFormatter

from sim_heating.estimation.design_flight import Planned
from sim_heating.plots import ANGLES, new_figure, save_figure
from sim_heating.run import MANOEUVRED
from sim_heating.trajectory.flight import Window

if TYPE_CHECKING:
    from sim_heating.estimation.design_report import Designed

PLANNED, OPTIMAL = "tab:orange", "tab:blue"
MARKS = ("o", "s", "^", "D", "v")
LABELS = {
    "at_velocity_m_s": "speed at the start, m/s",
    "at_mach": "Mach number at the start",
    "rate_deg_s": "rate, deg/s",
    "hold_s": "hold, s",
    "down_deg": "down, deg",
    "up_deg": "up, deg",
    "amplitude_deg": "amplitude, deg",
}


def draw_design(path: Path, designed: Designed) -> None:
    """The variable of each manoeuvre, and the outermost thermocouple's temperature, as planned and as designed."""
    found, count = designed.found, len(designed.found.planned.manoeuvres)
    figure, axes = new_figure(8.5, 3.0 * (count + 1), count + 1)
    for flown, told, color, label in (
        (found.planned, found.planned_told, PLANNED, "planned"),
        (found.best, found.best_told, OPTIMAL, "optimal"),
    ):
        for k, window in enumerate(flown.flight.windows):
            variable = MANOEUVRED[window.kind]
            speed = float(flown.flight.conditions.at([window.start_s])["velocity_m_s"][0])
            t, y = _about(flown, window, variable, designed.planner.design.before_s, designed.planner.design.after_s)
            axes[k].plot(t, y, color=color, label=f"{label}, at {speed:.0f} m/s")
            axes[k].set_ylabel(f"{ANGLES.get(variable, ('jets', ''))[0]}{', deg' if variable in ANGLES else ''}")
            axes[k].set_xlabel("time from the start of the manoeuvre, s")
        outermost = min(told.channels, key=lambda c: c.sensor.depth_m)
        since = outermost.time_s - flown.flight.windows[0].start_s
        axes[-1].plot(since, outermost.mean_K, ".-", color=color, label=label)
    axes[-1].set_ylabel(f"{outermost.sensor.name}, K")
    axes[-1].set_xlabel("time from the start of the first manoeuvre, s")
    for a in axes:
        a.legend(fontsize=8)
    save_figure(
        figure, path, f"{designed.scenario.title}\n{designed.planner.point.name}: as planned, and optimal", axes
    )


def _about(
    flown: Planned, window: Window, variable: str, before_s: float, after_s: float
) -> tuple[np.ndarray, np.ndarray]:
    t = flown.conditions.time_s
    shown = (t >= window.start_s - before_s) & (t <= window.end_s + after_s)
    return t[shown] - window.start_s, flown.conditions[variable][shown]


def draw_sweeps(path: Path, designed: Designed) -> None:
    """Bounds over those of the optimal design along each number that was varied; open where a limit is passed."""
    sweeps, best = designed.sweeps, designed.found.best_told.sigma(designed.wanted)
    columns = min(3, len(sweeps))
    rows = -(-len(sweeps) // columns)
    figure, axes = new_figure(3.9 * columns, 3.2 * rows + 0.6, rows, columns, sharey=True, squeeze=False)
    for a, sweep in zip(axes.ravel(), sweeps, strict=False):
        for k, name in enumerate(designed.wanted):
            y, color = sweep.sigma[:, k] / best[k], f"C{k}"
            a.plot(sweep.value, y, color=color, linewidth=1.2, label=name)
            for kept, face in ((True, color), (False, "white")):
                at = sweep.feasible == kept
                a.plot(sweep.value[at], y[at], MARKS[k % len(MARKS)], color=color, markerfacecolor=face, markersize=5)
        chosen = getattr(designed.found.best.manoeuvres[sweep.vary.manoeuvre - 1], sweep.vary.key)
        a.axvline(chosen, color="0.4", linestyle=":", linewidth=1.0)
        a.set_xlabel(LABELS.get(sweep.vary.key, sweep.vary.key))
        a.set_yscale("log")
        a.yaxis.set_major_locator(LogLocator(subs=(1.0, 1.5, 2.0, 3.0, 5.0, 7.0)))
        a.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        a.yaxis.set_minor_locator(NullLocator())
    for a in axes.ravel()[len(sweeps) :]:
        a.set_visible(False)
    for a in axes[:, 0]:
        a.set_ylabel("bound over that of the optimal design")
    axes[0, 0].legend(fontsize=8)
    title = f"{designed.scenario.title}\nbounds about the optimal design (dotted); open: passes a limit"
    save_figure(figure, path, title, axes)


def draw_instruments(path: Path, designed: Designed) -> None:
    """Bounds with other instruments over those with the declared ones."""
    base, others = designed.instruments[0].sigma, designed.instruments[1:]
    figure, axes = new_figure(8.5, 0.33 * len(others) * max(1, len(designed.wanted) * 0.7) + 1.8, 1)
    height = 0.8 / len(base)
    rows = np.arange(len(others))[::-1]
    ratio = np.array([v.sigma / base for v in others])
    highest = 1.15 * float(np.max(ratio[np.isfinite(ratio) & (ratio < 10.0)], initial=1.0))
    for k, name in enumerate(designed.wanted):
        shown = np.where(ratio[:, k] < highest, ratio[:, k], highest)
        axes[0].barh(rows - k * height, shown, height, color=f"C{k}", label=name)
        for row, value, at in zip(rows, ratio[:, k], shown, strict=True):
            text = f"{value:.2f}" if value < 1000.0 else "not told"
            axes[0].text(at, row - k * height, f" {text}", va="center", fontsize=7.5)
    axes[0].axvline(1.0, color="0.3", linewidth=0.9)
    axes[0].set_xlim(0.0, 1.12 * highest)
    axes[0].set_yticks(rows - 0.5 * height * (len(base) - 1), [f"{v.kind}: {v.what}" for v in others], fontsize=8)
    axes[0].set_xlabel("bound over that with the declared instruments")
    axes[0].legend(fontsize=8, loc="best")
    save_figure(figure, path, f"{designed.scenario.title}\nwhat other instruments would buy", axes)
