"""Ceramic-fibre board under a lamp: what plain conduction lacks, mechanism by mechanism.

The record scenarios/records/kaowool_board. Plain conduction at the published properties (adiabatic back, no gas);
the stand as declared; convection; then on top of it one mechanism at a time, each an effect with its parameters
estimated, or a property as published elsewhere and nothing estimated; and the early residual as deposited heat.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np

from benchmarks.measure import Figure, save
from sim_heating.base.arrays import FloatArray
from sim_heating.base.errors import RunError
from sim_heating.base.files.toml import read_toml_dict
from sim_heating.base.parameters import Parameter
from sim_heating.heating.effects import use
from sim_heating.inputs.points import point_of_record
from sim_heating.inputs.record import Record, load_record
from sim_heating.simulation.predict import predict
from tests.support.deposited_heat import Deposit, Slab, deposited_heat
from tests.support.quick_fit import Model, quick_fit

matplotlib.use("Agg")
from matplotlib import pyplot as plt

ROOT = Path(__file__).resolve().parent.parent
BOARD = ROOT / "scenarios" / "records" / "kaowool_board"
IMAGES = ROOT / "docs" / "images"
SILICA = ROOT / "aircraft_data" / "orbiter" / "materials" / "li900.toml"
MATERIAL = "kaowool-pm"
EARLY_S, LATE_S, INVERTED_S = 150.0, 900.0, 200
CONVECTION = "ratio.d0"
GAS_STARTS = ({CONVECTION: 1.5},)
UNIT_W_M2K = 10.4
"""Film coefficient that a ratio of 1 stands for: h_ref times the specific heat of the record."""
GAS_K, GAS_W_MK, GAS_POWER = 300.0, 0.0260, 0.75
"""Conductivity of nitrogen, 0.026 W/(m K) (T / 300 K)^0.75: within 3 % from 300 to 1300 K (handbook)."""
DEPTH_STEP_M = 1e-4


@dataclass(frozen=True)
class Mechanism:
    """A mechanism that is fitted on top of convection.

    effect, start : its name and values to start from;  names : its parameters that are estimated
    bounds        : [lowest, highest] of some of them, where the effect's own allow impossible values
    """

    label: str
    effect: str = ""
    names: tuple[str, ...] = ()
    start: Mapping[str, float] = field(default_factory=dict)
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)


MECHANISMS = (
    Mechanism("conductivity", "conductivity", ("conductivity_factor",)),
    Mechanism("heat capacity", "heat-capacity", ("heat_capacity_factor",)),
    Mechanism("radiation in depth", "radiative-conduction", ("k_rad",)),
    Mechanism("emittance", "emissivity", ("emissivity_factor",)),
    Mechanism("cooling behind the stand", "backface-cooling", ("back_h_W_m2K",)),
    Mechanism("gap flow", "gap-flow", ("gap_fraction", "gap_depth_m")),
    Mechanism(
        "moisture boils", "moisture", ("latent_J_kg", "boil_K", "width_K"),
        {"latent_J_kg": 2e3, "boil_K": 340.0, "width_K": 20.0},
    ),
    Mechanism(
        "moisture boils, given off at a temperature", "moisture",
        ("latent_J_kg", "boil_K", "deposit_J_kg", "condense_K", "width_K"),
        {"latent_J_kg": 2e3, "boil_K": 360.0, "deposit_J_kg": 2e3, "condense_K": 310.0, "width_K": 20.0},
        {"latent_J_kg": (0.0, 2e4), "deposit_J_kg": (0.0, 2e4), "boil_K": (330.0, 420.0), "condense_K": (295.0, 330.0),
         "width_K": (15.0, 40.0)},
    ),
    Mechanism(
        "vapour diffuses inward", "moisture", ("vapour_W_m", "boil_K", "width_K"),
        {"latent_J_kg": 0.0, "vapour_W_m": 1.0, "boil_K": 320.0, "width_K": 18.0},
        {"boil_K": (310.0, 373.0), "width_K": (10.0, 25.0)},
    ),
)  # fmt: skip
VAPOUR = MECHANISMS[-1]


def run() -> list[Figure]:
    """The ladder, the mechanisms, the inversion."""
    record = load_record(BOARD)
    plain = predict(bare(record)).residual_K
    figures = list(_errors("plain conduction, adiabatic back", record, plain))
    figures += _errors("declared, on its stand", record, predict(record).residual_K)
    convection = quick_fit(record, [CONVECTION], GAS_STARTS)
    figures += _errors("convection", record, convection.residual_K, convection)
    for mechanism in MECHANISMS:
        try:
            fitted = tried(record, mechanism)
        except RunError as error:
            figures.append(Figure(f"{mechanism.label}: cannot be fitted", float("nan"), "", note=str(error)))
            continue
        figures += _errors(mechanism.label, record, fitted.residual_K, fitted)
    figures += _errors("contact to the stand", record, *_residual_and_fit(record, "stack.contact_factor"))
    figures += _errors("depths of the joints", record, *_depths(record))
    for part in (0.968, 1.032):
        figures += _errors(f"flux {part:g} times", record, *_residual_and_fit(brighter(record, part)))
    figures += _errors("conductivity of gas, solid, radiation", record, *_residual_and_fit(physical(record, k=True)))
    figures += _errors("specific heat as silica fibres'", record, *_residual_and_fit(physical(record, cp=True)))
    silica = physical(record, k=True, cp=True)
    factor = "effect.conductivity.conductivity_factor"
    figures += _errors("both, and a factor of conductivity", record, *_residual_and_fit(silica, factor))
    last = tried(physical(record, k=True), VAPOUR)
    figures += _errors("conductivity of gas, solid, radiation; vapour", record, last.residual_K, last)
    deposit = inverted(record, convection)
    figures += _deposit_figures(record, deposit)
    draw_residuals(record, {"plain conduction": plain, "on its stand, convection": convection.residual_K,
                            "and conductivity of gas, solid, radiation; vapour": last.residual_K})  # fmt: skip
    draw_deposit(record, deposit)
    save("kaowool", figures)
    return figures


# What is tried -------------------------------------------------------------------------------------------------------


def tried(record: Record, mechanism: Mechanism, *more: str) -> Model:
    """A mechanism, convection and further named parameters, estimated together."""
    names = [f"effect.{mechanism.effect}.{name}" for name in mechanism.names]
    start = GAS_STARTS[0] | {f"effect.{mechanism.effect}.{n}": v for n, v in mechanism.start.items()}
    bounds = {f"effect.{mechanism.effect}.{n}": b for n, b in mechanism.bounds.items()}
    priors = {n: Parameter(n, "K", start[n], lower=low, upper=high) for n, (low, high) in bounds.items()}
    used = [use(mechanism.effect, mechanism.start), *(use(n.split(".")[1]) for n in more)]
    return quick_fit(record, [CONVECTION, *more, *names], [start], effects=used, priors=priors)


def _residual_and_fit(record: Record, *names: str) -> tuple[FloatArray, Model]:
    used = [use(n.split(".")[1]) for n in names if n.startswith("effect.")]
    fitted = quick_fit(record, [CONVECTION, *names], GAS_STARTS, effects=used)
    return fitted.residual_K, fitted


def bare(record: Record) -> Record:
    """The board alone with its emittance: no paint, no stand."""
    stack, materials = record.declared.stack, record.declared.materials
    board = materials[MATERIAL].model_copy(update={"emissivity": materials["black-paint"].emissivity})
    alone = stack.model_copy(update={"layer": [stack.layer[1].model_copy(update={"contact_m2K_W": 0.0})]})
    return replace(record, declared=record.declared.model_copy(update={"stack": alone, "materials": {MATERIAL: board}}))


def brighter(record: Record, part: float) -> Record:
    """The record with a multiple of the flux."""
    return replace(record, conditions=record.conditions.with_columns(q_add_W_m2=part * record.conditions["q_add_W_m2"]))


def physical(record: Record, *, k: bool = False, cp: bool = False) -> Record:
    """The board's conductivity as that of gas, solid and radiation, fitted to its published points,

        k = k_gas(T) + a + b T^3,

    and its specific heat falling to low temperature as silica fibres' does, through its published point."""
    board = record.declared.materials[MATERIAL]
    changed: dict[str, Any] = {}
    if k:
        T, published = np.array(board.conductivity_W_mK)[1:].T
        a, b = np.linalg.lstsq(np.column_stack([np.ones(len(T)), (1e-3 * T) ** 3]), published - gas(T), rcond=None)[0]
        at = np.arange(280.0, 1381.0, 20.0)
        changed["conductivity_W_mK"] = np.column_stack([at, gas(at) + a + b * (1e-3 * at) ** 3]).tolist()
    if cp:
        T, c = np.array(read_toml_dict(SILICA)["specific_heat_J_kgK"]).T
        at_K, own = board.specific_heat_J_kgK[0]
        changed["specific_heat_J_kgK"] = np.column_stack([T, c * own / np.interp(at_K, T, c)]).tolist()
    materials = record.declared.materials | {MATERIAL: board.model_copy(update=changed)}
    return replace(record, declared=record.declared.model_copy(update={"materials": materials}))


def gas(temperature_K: FloatArray) -> FloatArray:
    """Conductivity of nitrogen [W/(m K)]."""
    return GAS_W_MK * (temperature_K / GAS_K) ** GAS_POWER


def _depths(record: Record) -> tuple[FloatArray, Model]:
    """Convection, and each joint where its own residual is least."""
    residual, _ = _residual_and_fit(record)
    moved = record
    for i, sensor in enumerate(record.sensors):
        deeper, _ = _residual_and_fit(_at_depths(record, {i: sensor.depth_m + DEPTH_STEP_M}))
        slope = (deeper[i] - residual[i]) / DEPTH_STEP_M
        moved = _at_depths(moved, {i: sensor.depth_m - float(slope @ residual[i] / (slope @ slope))})
    return _residual_and_fit(moved)


def _at_depths(record: Record, depths_m: Mapping[int, float]) -> Record:
    sensors = [s.model_copy(update={"depth_m": depths_m.get(i, s.depth_m)}) for i, s in enumerate(record.sensors)]
    thermocouples = record.declared.thermocouples.model_copy(update={"sensor": sensors})
    return replace(record, declared=record.declared.model_copy(update={"thermocouples": thermocouples}))


# Heat in depth and time ----------------------------------------------------------------------------------------------


def inverted(record: Record, fitted: Model) -> Deposit:
    """The early residual of a fit as deposited heat."""
    board = record.declared.stack.layer[1]
    material = record.declared.materials[MATERIAL]
    depth = np.linspace(0.0, board.thickness_m, 61)
    deep = [
        s.model_copy(update={"name": f"x{i}", "column": f"x{i}_K", "depth_m": float(x), "used": True})
        for i, x in enumerate(depth)
        for s in record.sensors[:1]
    ]
    thermocouples = record.declared.thermocouples.model_copy(update={"sensor": deep})
    columns = {"time_s": record.time_s} | {s.column: np.full(len(record.time_s), 300.0) for s in deep}
    probed = replace(
        record, declared=record.declared.model_copy(update={"thermocouples": thermocouples}), thermocouples=columns
    )
    T = predict(probed, point_of_record(probed, fitted.values)).history.sensors_K.T[: INVERTED_S + 1]
    k = np.interp(0.5 * (T[:, 1:] + T[:, :-1]), *np.array(material.conductivity_W_mK).T)
    loss = 4.0 * 0.95 * 5.67e-8 * T[:, 0] ** 3 + UNIT_W_M2K * fitted.values[CONVECTION]
    sensors = [int(np.argmin(np.abs(depth - s.depth_m))) for s in record.sensors]
    capacity = material.density_kg_m3 * material.specific_heat_J_kgK[0][1]
    sigma = np.array([s.noise_sigma_K or 1.0 for s in record.sensors])
    residual = fitted.residual_K[:, : INVERTED_S + 1]
    return deposited_heat(Slab(depth, T, k, capacity, sensors, loss), residual, sigma)


# Figures -------------------------------------------------------------------------------------------------------------


def _errors(label: str, record: Record, residual_K: FloatArray, fitted: Model | None = None) -> Iterator[Figure]:
    early, late = record.time_s <= EARLY_S, record.time_s >= LATE_S
    for i, sensor in enumerate(record.sensors):
        own = residual_K[i]
        note = f"{rms(own[early]):.1f} K in the first {EARLY_S:g} s, mean late {np.mean(own[late]):+.1f} K"
        if i == 0 and fitted is not None:
            note += f"; {_values(fitted)}"
        yield Figure(f"{label}: RMSE {1e3 * sensor.depth_m:.2f} mm", rms(own), "K", note=note)


def rms(values: FloatArray) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(values**2)))


def _values(fitted: Model) -> str:
    found = []
    sigma = fitted.sigma
    for name, value in fitted.values.items():
        scale, unit = (UNIT_W_M2K, " W/(m2 K)") if name == CONVECTION else (1.0, "")
        found.append(f"{name.rsplit('.', 1)[-1]} {value * scale:.4g} +- {sigma[name] * scale:.2g}{unit}")
    return ", ".join(found)


def _deposit_figures(record: Record, found: Deposit) -> Iterator[Figure]:
    a, length, tau = found.chosen
    chosen = f"amplitude {1e-3 * a:.0f} kW/m3, {1e3 * length:g} mm, {tau:g} s"
    yield Figure("deposit: what is left of the residual", rms(found.left_K), "K", note=chosen)
    bin_m, bin_s = found.depth_m[1] - found.depth_m[0], found.time_s[1] - found.time_s[0]
    given = np.sum(np.maximum(found.source_W_m3, 0.0)) * bin_m * bin_s
    taken = np.sum(np.minimum(found.source_W_m3, 0.0)) * bin_m * bin_s
    yield Figure("deposit: given off within 200 s", 1e-3 * given, "kJ/m2")
    yield Figure("deposit: taken up within 200 s", 1e-3 * taken, "kJ/m2")
    for sensor in record.sensors:
        own = found.source_W_m3[np.argmin(np.abs(found.depth_m - sensor.depth_m))]
        k = int(np.argmax(own))
        first = f"{1e-3 * own[k]:.0f} kW/m3; depth^2 / time {1e6 * sensor.depth_m**2 / found.time_s[k]:.1f} mm2/s"
        yield Figure(f"deposit: largest at {1e3 * sensor.depth_m:.2f} mm", found.time_s[k], "s", note=first)


# Pictures ------------------------------------------------------------------------------------------------------------


def draw_residuals(record: Record, residuals: Mapping[str, FloatArray]) -> None:
    """Residual of each model at each joint, early and whole."""
    figure, axes = plt.subplots(3, 2, figsize=(11.0, 8.0), sharex="col", width_ratios=[1, 1])
    for i, sensor in enumerate(record.sensors):
        for j, end in enumerate((EARLY_S, record.time_s[-1])):
            ax, shown = axes[i, j], record.time_s <= end
            for label, residual in residuals.items():
                ax.plot(record.time_s[shown], residual[i, shown], label=label, linewidth=1.3)
            ax.axhline(0.0, color="0.5", linewidth=0.7)
            ax.grid(alpha=0.3)
            ax.set_title(f"{1e3 * sensor.depth_m:.2f} mm" + (", early" if j == 0 else ""), fontsize=10)
        axes[i, 0].set_ylabel("measured less predicted, K")
    for ax in axes[-1]:
        ax.set_xlabel("time, s")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="lower center", ncols=3, frameon=False)
    figure.tight_layout(rect=(0.0, 0.04, 1.0, 1.0))
    figure.savefig(IMAGES / "kaowool_residuals.png", dpi=100)
    plt.close(figure)


def draw_deposit(record: Record, found: Deposit) -> None:
    """Deposited heat over depth and time."""
    figure, ax = plt.subplots(figsize=(8.0, 4.5))
    largest = 50.0 * np.ceil(1e-3 * float(np.max(np.abs(found.source_W_m3))) / 50.0)
    levels = np.arange(-largest, largest + 1.0, 25.0)
    filled = ax.contourf(found.time_s, 1e3 * found.depth_m, 1e-3 * found.source_W_m3, levels, cmap="RdBu_r")
    for sensor in record.sensors:
        ax.axhline(1e3 * sensor.depth_m, color="k", linewidth=0.7, linestyle=":")
    for i in range(3):
        t = record.time_s[: INVERTED_S + 1]
        hot = np.flatnonzero(record.temperatures_K()[i, : len(t)] >= 373.0)
        if len(hot):
            ax.plot(t[hot[0]], 1e3 * record.sensors[i].depth_m, "k^", label="joint passes 373 K" if i == 0 else None)
    ax.invert_yaxis()
    ax.set_xlabel("time, s")
    ax.set_ylabel("depth, mm (dotted: joints)")
    ax.legend(loc="lower right")
    figure.colorbar(filled, label="heat deposited, kW/m3", ticks=np.arange(-largest, largest + 1.0, 100.0))
    figure.tight_layout()
    figure.savefig(IMAGES / "kaowool_deposit.png", dpi=100)
    plt.close(figure)
