"""Tiles of STS-96: transition found in temperatures of a flight whose trajectory is not known.

The records scenarios/records/sts96_* before and after (tile_fits.py); one clock common to all of them; and the
influence of the unknown trajectory: other plausible entries, each stretched to last as long as the nominal one, because
the figure states the duration of the flight.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np

from benchmarks.measure import Figure, save
from sim_heating.base.conditions import Conditions
from sim_heating.base.errors import RunError
from sim_heating.base.files.toml import read_toml_dict
from sim_heating.inputs.record import load_record
from sim_heating.inputs.scenario import Scenario, load_scenario
from sim_heating.simulation.predict import predict
from sim_heating.simulation.run import fly_scenario
from tests.support.tile_fits import (
    TRANSITION,
    Clock,
    Tile,
    as_nominal,
    fitted_clock,
    laminar,
    laminar_records,
    rms,
    tiles_of,
)

matplotlib.use("Agg")
from matplotlib import pyplot as plt

ROOT = Path(__file__).resolve().parent.parent
SCENARIO = ROOT / "scenarios" / "sts96_iss.toml"
RECORDS = tuple(ROOT / "scenarios" / "records" / f"sts96_{n}" for n in (468, 480, 597, 730))
PICTURE = ROOT / "docs" / "images" / "sts96_transition.png"
ONSET, WIDTH, FACTOR = TRANSITION
LARGEST_RATIO = 0.4
"""RMSE after over before about the rise, at most."""
LARGEST_APART_S = 10.0
"""Onset and rise, at most [s] apart."""
HEAVIER_KG = 101.0e3
SHOWN_S = (560.0, 1600.0)


def run() -> list[Figure]:
    """The tiles, the clock, other entries."""
    scenario = load_scenario(SCENARIO)
    records = [laminar(load_record(path)) for path in RECORDS]
    tiles = tiles_of({record.declared.control_point: record for record in records})
    figures = [f for name, tile in tiles.items() for f in _figures(name, tile)]
    flown = fly_scenario(scenario).conditions
    clock = fitted_clock(scenario, flown, tiles)
    figures += _clock_figures(clock)
    draw(tiles)
    spread: dict[str, list[Tile]] = {}
    for label, other in entries(scenario):
        stretch = float(flown.time_s[-1] / other.time_s[-1])
        try:
            own = as_nominal(laminar_records(scenario, other, stretch=stretch), tiles)
        except RunError as error:
            figures.append(Figure(f"{label}: cannot be fitted", float("nan"), "", note=str(error)))
            continue
        figures.append(Figure(f"{label}: stretched to the same length", stretch, ""))
        for name, tile in own.items():
            figures += (replace(f, target=None) for f in _brief(f"{label}, {name}", tile))
            spread.setdefault(name, []).append(tile)
    figures += [f for name, found in spread.items() for f in _spread(name, [tiles[name], *found])]
    save("sts96", figures)
    return figures


def _figures(name: str, tile: Tile) -> Iterator[Figure]:
    declared = predict(tile.record).residual_K[0]
    errors = {"declared": tile.errors(declared) | {"whole entry": rms(declared)}}
    for stage, model in (("before", tile.before), ("after", tile.after)):
        errors[stage] = tile.errors(model.residual_K[0]) | {"whole entry": rms(model.whole_residual_K[0])}
    for stage, found in errors.items():
        for where, value in found.items():
            yield Figure(f"{name}, {stage}: RMSE, {where}", value, "K")
    yield from _brief(name, tile)
    values, sigma = tile.after.values, tile.after.sigma
    for parameter in TRANSITION:
        short = parameter.rsplit(".", 1)[-1]
        yield Figure(f"{name}: {short}", values[parameter], "1", note=f"+- {sigma[parameter]:.2g}")
    at = tile.record.conditions.at(np.array([tile.onset_s]))
    note = f"alpha {at['alpha_deg'][0]:.1f} deg, altitude {at['altitude_m'][0] / 1e3:.1f} km"
    yield Figure(f"{name}: Mach at onset", float(at["mach"][0]), "1", note=note)


def _brief(label: str, tile: Tile) -> Iterator[Figure]:
    before, after = (tile.errors(m.residual_K[0])["window"] for m in (tile.before, tile.after))
    values = tile.after.values
    note = f"{before:.1f} K to {after:.1f} K; onset log10 Re {values[ONSET]:.3f}, factor {values[FACTOR]:.2f}"
    yield Figure(f"{label}: RMSE after/before", after / before, "", LARGEST_RATIO, note=note)
    apart, rise = abs(tile.onset_s - tile.rise_s), f"rise at {tile.rise_s:.0f} s"
    yield Figure(f"{label}: onset apart from the rise", apart, "s", LARGEST_APART_S, note=rise)


def _clock_figures(clock: Clock) -> Iterator[Figure]:
    yield Figure("shift of the clock", clock.shift_s, "s", note=f"+- {clock.sigma[0]:.1f} s")
    yield Figure("stretch of the clock", clock.stretch, "", note=f"+- {clock.sigma[1]:.4f}")
    for name, tile in clock.tiles.items():
        found = tile.errors(tile.after.residual_K[0])
        note = f"{found['fit']:.1f} K fitted, {found['holdout']:.1f} K held out"
        note += f"; onset log10 Re {tile.after.values[ONSET]:.3f}, factor {tile.after.values[FACTOR]:.2f}"
        yield Figure(f"with that clock, {name}: RMSE, window", found["window"], "K", note=note)


def _spread(name: str, found: list[Tile]) -> Iterator[Figure]:
    """Spread of a tile's results over all entries, each with its own clock."""
    for parameter in (ONSET, FACTOR):
        x = np.array([t.after.values[parameter] for t in found])
        what = f"{name}: {parameter.rsplit('.', 1)[-1]}, mean of {len(x)} entries"
        note = f"standard deviation {np.std(x, ddof=1):.3f}, {x.min():.3f} to {x.max():.3f}"
        yield Figure(what, float(np.mean(x)), "1", note=note)


# Other entries -------------------------------------------------------------------------------------------------------


def entries(scenario: Scenario) -> Iterator[tuple[str, Conditions]]:
    """Plausible entries in addition to the nominal one."""
    spec = scenario.declared.trajectory
    alpha = read_toml_dict(scenario.vehicle.directory / "guidance.toml")["alpha_deg"]
    drag = spec.guidance.drag_m_s2 or ()
    sts107 = load_scenario(ROOT / "scenarios" / "sts96.toml").declared.trajectory.initial

    def flown(part: str, changes: Mapping[str, Any]) -> Conditions:
        changed = spec.model_copy(update={part: getattr(spec, part).model_copy(update=changes)})
        declared = scenario.declared.model_copy(update={"trajectory": changed})
        return fly_scenario(replace(scenario, declared=declared)).conditions

    yield "path angle -1.0 deg", flown("initial", {"gamma_deg": -1.0})
    yield "path angle -1.2 deg", flown("initial", {"gamma_deg": -1.2})
    yield "start of STS-107", flown("initial", sts107.model_dump() if sts107 else {})
    yield "bank reversals as the vehicle's", flown("guidance", {"reversals_m_s": None})
    yield "the vehicle's own drag schedule", flown("guidance", {"drag_m_s2": None})
    for part in (0.9, 1.1):
        yield f"drag {part:g} times", flown("guidance", {"drag_m_s2": tuple((v, part * d) for v, d in drag)})
    for part in (0.85, 1.15):
        yield f"density {part:g} times", flown("dispersions", {"density_factor": ((0.0, part),)})
    for more in (-2.0, 2.0):
        shifted = tuple((m, a + more) for m, a in alpha)
        yield f"angle of attack {more:+g} deg", flown("guidance", {"alpha_deg": tuple(sorted(shifted))})
    for more in (-1.0, 1.0):
        shifted = tuple((m + more, a) for m, a in alpha)
        yield f"pitch-down {more:+g} in Mach", flown("guidance", {"alpha_deg": tuple(sorted(shifted))})
    yield "mass 101 t", flown("vehicle", {"mass_kg": HEAVIER_KG})


# Picture -------------------------------------------------------------------------------------------------------------


def draw(tiles: Mapping[str, Tile]) -> None:
    """Measured, before and after, for every tile; residuals below."""
    figure, axes = plt.subplots(4, 2, figsize=(11.0, 10.0), sharex=True, height_ratios=[3, 1, 3, 1])
    for k, (name, tile) in enumerate(tiles.items()):
        above, below = axes[2 * (k // 2), k % 2], axes[2 * (k // 2) + 1, k % 2]
        _draw_tile(above, below, name, tile)
    for ax in axes[3]:
        ax.set_xlabel("time from entry interface, s")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="lower center", ncols=3, frameon=False)
    figure.tight_layout(rect=(0.0, 0.04, 1.0, 1.0))
    figure.savefig(PICTURE, dpi=100)
    plt.close(figure)


def _draw_tile(above: Any, below: Any, name: str, tile: Tile) -> None:
    shown = (tile.record.time_s >= SHOWN_S[0]) & (tile.record.time_s <= SHOWN_S[1])
    t, T = tile.record.time_s[shown], tile.record.temperatures_K()[0][shown]
    above.plot(t, T, ".", color="0.5", markersize=3, label="measured in flight")
    for model, colour, label in ((tile.before, "C0", "laminar, linear model"), (tile.after, "C3", "with transition")):
        residual = model.residual_K[0][shown]
        above.plot(t, T - residual, color=colour, linewidth=1.2, label=label)
        below.plot(t, residual, color=colour, linewidth=1.2)
    for segment in tile.record.declared.segments.holdout:
        for ax in (above, below):
            ax.axvspan(*segment, color="C2", alpha=0.15, linewidth=0.0)
    above.set_title(f"tile {name.removeprefix('STS96_')}: onset at {tile.onset_s:.0f} s", fontsize=10)
    above.set_ylabel("surface, K")
    below.set_ylabel("left, K")
    below.set_ylim(-80.0, 80.0)
    for ax in (above, below):
        ax.grid(alpha=0.3)
