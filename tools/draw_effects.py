"""Pictures of what each effect does to a flight, and the tables of its parameters in docs/reference/effects.md.

    python -m tools.draw_effects scenarios/all_manoeuvres.toml --docs docs

draws docs/images/effect_NAME.png and writes docs/reference/effects.md, from the repository's root. The magnitudes are
large enough to be visible; every other value is an effect's nominal one. In docs/reference/effects.md the text before
the first heading and the equations between an effect's source and its table are written by hand; they are kept.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from sim_heating.base.conditions import Conditions
from sim_heating.base.files import write_text_atomic
from sim_heating.base.kernels.lag import lag_columns
from sim_heating.base.parameters import Parameter
from sim_heating.base.report.figure import ANGLES, new_figure, save_figure
from sim_heating.heating.effects import Effect, effects, use
from sim_heating.inputs.points import conditions_at_point, mean_condition, point_of_vehicle
from sim_heating.inputs.scenario import load_scenario
from sim_heating.march.ensemble import PointModel
from sim_heating.march.history import PointHistory, march_points
from sim_heating.simulation.run import fly_scenario
from sim_heating.thermal.stack import Sensor

DRAWN: Mapping[str, Mapping[str, float]] = {
    "added-curve": {"low": 30.0, "high": 45.0, "s_5": 0.001, "s_6": 0.004, "s_7": 0.01},
    "alpha-curvature": {"d_alpha2": 2e-4},
    "backface-cooling": {"back_h_W_m2K": 10.0, "back_K": 290.0},
    "bodyflap-curvature": {"d_bodyflap2": 1e-4},
    "catalysis": {"catalysis_step": 0.2, "catalysis_K": 1000.0},
    "coating-thickness": {"coating_factor": 1.5},
    "conductivity": {"conductivity_factor": 1.3},
    "curve": {"low": 30.0, "high": 45.0, "s_4": 0.02, "s_5": 0.08, "s_6": 0.14, "s_7": 0.16},
    "elevon-curvature": {"d_elevon2": 2e-4},
    "emissivity": {"emissivity_factor": 0.93, "change_s": 600.0},
    "gap-flow": {"gap_fraction": 0.02, "gap_depth_m": 0.01},
    "heat-capacity": {"heat_capacity_factor": 1.2},
    "impingement-onset": {"alpha_onset_deg": 41.0, "slope": 0.002},
    "interaction": {"d_alpha_elevon": 3e-4},
    "jet-interaction": {"jet_gain": 0.15},
    "moisture": {"latent_J_kg": 4e4, "boil_K": 373.0},
    "nonisothermal-wall": {"lag_s": 5.0, "lag_fraction": 0.6, "overshoot": 0.15},
    "radiative-conduction": {"k_rad": 0.05},
    "recombination": {"efficiency": 1.0},
    "sensor-lag": {"tau_s": 3.0},
    "sideslip": {"slope_abs_beta": 0.002},
    "time-skew": {"skew_s": 3.0},
    "transition": {"log10_re_onset": 6.6, "factor": 2.5},
}
"""Values of parameters that are not nominal."""
WITHOUT, WITH = "0.35", "tab:red"
SENSOR_COLORS = ("tab:red", "tab:orange", "tab:green", "tab:blue", "tab:purple")
LEAST_RATIO = 1e-4
"""Change of the heating ratio [-] below which it is not drawn: the effect acts elsewhere."""
TABLE = "| parameter | unit | nominal | prior sigma | bounds | |"


def main() -> None:
    """Fly, march without and with each effect, draw, write the page."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("scenario", type=Path)
    parser.add_argument("--docs", type=Path, default=Path("docs"))
    given = parser.parse_args()
    scenario = load_scenario(given.scenario)
    flown = fly_scenario(scenario).conditions
    point = scenario.vehicle.control_point(scenario.names[0])
    at_point = conditions_at_point(scenario.vehicle, point, flown)
    # Without the declared effects: each picture shows what its own effect does.
    bare = replace(point_of_vehicle(scenario.vehicle, point, reference=mean_condition(flown)), effects=())
    known = effects()
    undrawn = sorted(set(known) - set(DRAWN))
    if undrawn:
        raise SystemExit(f"draw_effects: no magnitude for {', '.join(undrawn)}; add it to DRAWN")
    (given.docs / "images").mkdir(exist_ok=True)
    for name, values in DRAWN.items():
        pair = [march(model, at_point) for model in (bare, replace(bare, effects=(use(name, values),)))]
        if known[name].acts_on_readings:
            pair[1] = as_recorded(pair[0], **values)
        draw(given.docs / "images" / f"effect_{name}.png", known[name], values, pair, point.sensors, flown)
    file = given.docs / "reference" / "effects.md"
    write_text_atomic(file, page(file.read_text()))


def march(model: PointModel, flown: Conditions) -> PointHistory:
    """One control point along the flight."""
    return march_points([model], [flown])[0]


def as_recorded(history: PointHistory, skew_s: float = 0.0, tau_s: float = 0.0) -> PointHistory:
    """Temperatures of thermocouples behind a lag, recorded with a clock that lags: recorded T(t) = true T(t - skew)."""
    t = history.time_s
    behind = lag_columns(t, np.ascontiguousarray(history.sensors_K.T), tau_s, True).T
    return replace(history, sensors_K=np.array([np.interp(t - skew_s, t, T) for T in behind]))


def draw(
    path: Path, effect: Effect, values: Mapping[str, float], pair: Sequence[PointHistory], sensors: Sequence[Sensor],
    flown: Conditions,
) -> None:  # fmt: skip
    """Draw the ratio without and with the effect, the change at each thermocouple, and the angles and jets flown."""
    without, with_effect = pair
    t = without.time_s
    acts = np.nanmax(np.abs(with_effect.ratio - without.ratio)) > LEAST_RATIO
    figure, axes = new_figure(8.0, 5.6 if acts else 4.4, 3 if acts else 2, sharex=True)
    if acts:
        axes[0].plot(t, without.ratio, color=WITHOUT, label="declared", linewidth=1.2)
        axes[0].plot(t, with_effect.ratio, color=WITH, label=f"with {effect.name}", linewidth=1.2)
        axes[0].set_ylabel("heating ratio")
        axes[0].legend(fontsize=8, loc="best")
    a = axes[-2]
    for k, (sensor, color) in enumerate(zip(sensors, SENSOR_COLORS, strict=False)):
        change = with_effect.sensors_K[k] - without.sensors_K[k]
        a.plot(t, change, color=color, label=f"{1e3 * sensor.depth_m:.1f} mm deep", linewidth=1.2)
    a.set_ylabel("change of the\nthermocouples, K")
    a.legend(fontsize=8, loc="best")
    for name, (label, color) in ANGLES.items():
        axes[-1].plot(t, flown[name], color=color, label=label, linewidth=1.0)
    axes[-1].plot(t, 10.0 * flown["jets"], color="0.3", label="jets, x 10", linewidth=1.0)
    axes[-1].set_ylabel("deg")
    axes[-1].set_ylim(-15.0, 62.0)
    axes[-1].legend(fontsize=8, loc="upper right", ncols=5)
    axes[-1].set_xlabel("time, s")
    magnitudes = ", ".join(f"{n} = {v:g}" for n, v in values.items())
    save_figure(figure, path, f"{effect.name}: {magnitudes}", axes)


def page(present: str) -> str:
    """Page of all effects: physics, source, equations, parameters and picture of each.

    present : the page as it is, whose text before the first heading, and between the source of an effect and its table,
              is kept
    """
    head, *sections = re.split(r"^## ", present, flags=re.MULTILINE)
    by_name = {section.partition("\n")[0]: section for section in sections}
    lines = [head.rstrip(), ""]
    for name in DRAWN:
        effect = effects()[name]
        lines += [f"## {name}", "", effect.physics, "", f"Source: {effect.source}", ""]
        lines += equations(by_name.get(name, ""))
        lines += [TABLE, "|---|---|---|---|---|---|"]
        lines += [
            f"| `{p.name}` | {p.unit} | {p.value:g} | {p.sigma:g} | {bounds(p, searched)} | {p.text} |"
            for p, searched in zip(effect.parameters, effect.search_definitions(), strict=True)
        ]
        lines += ["", f"![{name}](../images/effect_{name}.png)", ""]
    return "\n".join(lines)


def bounds(p: Parameter, searched: Parameter) -> str:
    """Bounds of a parameter, and those in the search for its effect where they are narrower."""
    text = f"{p.lower:g} to {p.upper:g}"
    return text if searched == p else f"{text}; search {searched.lower:g} to {searched.upper:g}"


def equations(section: str) -> list[str]:
    """Text of an effect's section between its source and the table of its parameters; nothing for a new section."""
    text = section.partition("\nSource: ")[2].partition("\n")[2].partition(TABLE)[0].strip()
    return [text, ""] if text else []


if __name__ == "__main__":
    main()
