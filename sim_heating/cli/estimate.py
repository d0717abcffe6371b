"""The command `sim-heating estimate`.

The command `sim-heating design`.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import click
from rich.table import Table

from sim_heating.base.errors import InputError, RunError, error_context
from sim_heating.cli.console import CONSOLE, OUT, PATH, comma_list, print_outputs, progress_line

ESTIMATED = "estimated"
"""Of a level of noise that is to be found."""
HIGHEST = 1e4
"""No level or time of a noise that means anything is above this."""


def _condition(_: click.Context, __: click.Parameter, value: str | None) -> dict[str, float]:
    """`alpha_deg=40,...` as a condition."""
    from sim_heating.base.conditions import RATIO_VARIABLES
    from sim_heating.base.files import suggestion
    from sim_heating.base.limits import limit_message, out_of_range

    found = {}
    for item in (value or "").split(","):
        if not item.strip():
            continue
        name, _equals, number = (part.strip() for part in item.partition("="))
        if name in found:
            raise InputError(f"--reference: {name} is given twice; leave one out")
        if name not in RATIO_VARIABLES:
            raise InputError(f"--reference: `{name}` is not a ratio variable{suggestion(name, RATIO_VARIABLES)}")
        try:
            found[name] = float(number)
        except ValueError:
            raise InputError(f"--reference: {name}: `{number}` is not a number; write {name}=40") from None
        if out_of_range(name, found[name]):
            raise InputError(f"--reference: {name}: {limit_message(name, found[name])}; write {name}=40")
    return found


def _fit_segments(_: click.Context, __: click.Parameter, value: tuple[str, ...]) -> list[list[float]]:
    """`640,760`, as often as there are segments."""
    found = []
    for item in value:
        try:
            start, end = (float(part) for part in item.split(","))
        except ValueError:
            raise InputError(f"--fit: `{item}` is not a segment; write --fit 640,760 (start and end in s)") from None
        if not -math.inf < start < end < math.inf:
            raise InputError(f"--fit: {item}: give two finite times in s, the start before the end")
        found.append([start, end])
    return found


def _start(_: click.Context, __: click.Parameter, value: str) -> Any:
    """`declared`, or `circuit:650` and the like: how a fit starts, as a maker of starts."""
    from sim_heating.base.files import suggestion
    from sim_heating.estimation.starts import STARTS

    if value == "declared":
        return None
    kind, _colon, at = value.partition(":")
    if kind not in STARTS:
        raise InputError(f"--start: `{kind}` is not a way to start{suggestion(kind, ['declared', *STARTS])}")
    try:
        time_s = float(at)
    except ValueError:
        raise InputError(f"--start: `{at}` is not a time in s; write {kind}:650") from None

    def start(record: Any, model: Any, mesh: Any) -> Any:
        with error_context(f"--start {value}"):
            return STARTS[kind](record, model, mesh, time_s)

    return start


def _process_noise(nodes: str | None, ratio: str | None) -> Any:
    """What `--process-noise` and `--ratio-noise` say; None where neither is given."""
    from sim_heating.estimation.filter.process_noise import CORRELATION, FIRST_GUESS, NODE, RATIO, ProcessNoise

    if nodes is None and ratio is None:
        return None
    q, sigma, tau, looked_for = 0.0, 0.0, ProcessNoise().ratio_correlation_s, []
    if nodes == ESTIMATED:
        q, looked_for = FIRST_GUESS[NODE], [NODE]
    elif nodes is not None:
        q = _level(nodes, f"--process-noise {nodes}: give K/sqrt(s), as 0.2, or `{ESTIMATED}`")
    if ratio is not None:
        first, _comma, time_s = ratio.partition(",")
        hint = f"--ratio-noise {ratio}: give sigma and correlation time in s, as 0.01,30, or `{ESTIMATED}`"
        if first == ESTIMATED:
            sigma, looked_for = FIRST_GUESS[RATIO], [*looked_for, RATIO]
        else:
            sigma = _level(first, hint)
        if time_s:
            tau = _level(time_s, hint)
        elif first == ESTIMATED:
            looked_for.append(CORRELATION)
        if tau == 0.0 or not (time_s or first == ESTIMATED):
            raise InputError(hint)
    return ProcessNoise(q, sigma, tau, tuple(looked_for))


def _level(text: str, hint: str) -> float:
    """A number from 0 to HIGHEST."""
    try:
        found = float(text)
    except ValueError:
        raise InputError(hint) from None
    if not 0.0 <= found <= HIGHEST:
        raise InputError(f"{hint}; {text} is not within 0 to {HIGHEST:g}")
    return found


@click.command()
@click.argument("records", type=PATH, nargs=-1, required=True)
@OUT
@click.option("--parameters", callback=comma_list, help="dotted names, with commas; default: magnitude and derivatives")
@click.option("--reference", callback=_condition, help="alpha_deg=40,... that derivatives are about")
@click.option("--start", default="declared", callback=_start, help="declared, or circuit, profile, filter:TIME_S")
@click.option(
    "--fit",
    "fit",
    multiple=True,
    callback=_fit_segments,
    metavar="START,END",
    help="fit these times of each record, in s, in place of its own segments; may be given again",
)
@click.option(
    "--process-noise",
    "node_noise",
    metavar="K_PER_SQRT_S",
    help="Kalman filter: white noise of the model at every node, or `estimated`",
)
@click.option(
    "--ratio-noise",
    metavar="SIGMA,TIME_S",
    help="Kalman filter: a heating ratio that wanders, its sigma and correlation time, or `estimated`",
)
@click.option("--segments", type=float, help="instead: fit short segments of so many s in turn (one record)")
def estimate(
    records: tuple[Path, ...],
    out: Path,
    parameters: tuple[str, ...] | None,
    reference: dict[str, float],
    start: Any,
    fit: list[list[float]],
    node_noise: str | None,
    ratio_noise: str | None,
    segments: float | None,
) -> None:
    """Estimate heating and thermal parameters from the thermocouples of flight records, jointly, with bounds."""
    from sim_heating.base.files import require_writable

    noise = _process_noise(node_noise, ratio_noise)
    if segments is not None:
        if noise is not None:
            raise InputError("--segments: short segments are fitted without noise of the process; leave one out")
        if reference or start is not None:
            raise InputError("--segments: short segments have starts and references of their own; leave those out")
        _estimate_trend(records, out, parameters, fit, segments)
        return
    from sim_heating.estimation.fit import estimate as fit_records
    from sim_heating.estimation.report.report import estimate_contents, output_files, write_fit
    from sim_heating.inputs.record import load_record

    loaded = [_with_fit(load_record(path), fit) for path in records]
    require_writable(out, output_files(loaded, filtered=noise is not None))
    with progress_line("estimate") as progress:
        starts = [start] * len(loaded)
        fitted = fit_records(
            loaded, parameters, reference=reference, starts=starts, process_noise=noise, progress=progress
        )
        progress(0.95, "writing")
        names = write_fit(fitted, out)
    found = estimate_contents(fitted)
    table = Table(title=f"{', '.join(r.name for r in loaded)}: estimate", title_justify="left")
    for head in ("parameter", "value", "sigma", "unit"):
        table.add_column(head, justify="left" if head in ("parameter", "unit") else "right")
    for name, parameter in found.parameters.items():
        table.add_row(name, f"{parameter.value:.5g}", f"{parameter.sigma:.2g}", parameter.unit)
    CONSOLE.print(table)
    for name, why in found.not_estimated.items():
        CONSOLE.print(f"{name}: not estimated, {why}")
    for line in fitted.warnings:
        CONSOLE.print(line, style="red")
    if fitted.innovations is not None:
        CONSOLE.print(fitted.innovations.levels.noise.words())
    _tell_fit(found)
    print_outputs(out, names)
    if not found.converged:
        raise RunError(f"estimate: {fitted.fit.status.value}; {out} holds where it ended, which is no estimate")


def _with_fit(record: Any, fit: list[list[float]]) -> Any:
    return record.with_fit(fit) if fit else record


def _estimate_trend(
    records: tuple[Path, ...], out: Path, parameters: tuple[str, ...] | None, fit: list[list[float]], length_s: float
) -> None:
    """Short segments of one record, one after the other."""
    from sim_heating.base.files import require_writable
    from sim_heating.estimation.report.report import TREND, write_trend
    from sim_heating.estimation.trend import trend
    from sim_heating.inputs.record import load_record

    if len(records) > 1:
        raise InputError(f"--segments: {len(records)} records; short segments are of one record, give them one by one")
    record = _with_fit(load_record(records[0]), fit)
    require_writable(out, TREND)
    with progress_line("estimate") as progress:
        found = trend(record, length_s, parameters, progress=progress)
        names = write_trend(found, out)
    CONSOLE.print(f"{len(found.segments)} segments of {length_s:g} s fitted, {len(found.left_out)} left out")
    for line in found.left_out[:3]:
        CONSOLE.print(f"left out: {line}")
    for line in found.warnings:
        CONSOLE.print(line, style="red")
    print_outputs(out, names)


def _tell_fit(found: Any) -> None:
    """Errors before and after, against the noise floor."""
    declared = (found.model_extra or {}).get("predicted", {})
    for what in ("fit", "holdout"):
        before, after = declared.get(what), getattr(found, what)
        if after is not None and before is not None:
            CONSOLE.print(
                f"RMSE, {what}: {before.rmse_K:.2f} K declared, {after.rmse_K:.2f} K fitted ({after.n} samples)"
            )
    if found.noise_floor_K is not None:
        CONSOLE.print(f"Noise floor: {found.noise_floor_K:.2f} K")


@click.command()
@click.argument("scenario", type=PATH)
@OUT
@click.option("--parameters", callback=comma_list, help="dotted names whose bounds are to be small, with commas")
@click.option("--criterion", type=click.Choice(["D", "A"]), help="volume of the bounds, or their mean square")
@click.option("--evaluations", type=click.IntRange(1), help="designs that are tried")
@click.option("--repetitions", type=click.IntRange(0), default=0, help="hold the bounds against so many actual fits")
def design(
    scenario: Path,
    out: Path,
    parameters: tuple[str, ...] | None,
    criterion: str | None,
    evaluations: int | None,
    repetitions: int,
) -> None:
    """Design a scenario's manoeuvres: the bounds they would give, the most informative ones, other instruments."""
    from sim_heating.base.files import require_writable
    from sim_heating.estimation.design.report import FILES, notes, summary, write_design
    from sim_heating.estimation.design.report import design as design_manoeuvres
    from sim_heating.inputs.scenario import load_scenario, with_design

    given = {"parameters": parameters and list(parameters), "criterion": criterion, "evaluations": evaluations}
    loaded = with_design(load_scenario(scenario), {k: v for k, v in given.items() if v is not None})
    require_writable(out, FILES)
    with progress_line("design") as progress:
        designed = design_manoeuvres(loaded, repetitions=repetitions, progress=progress)
        progress(0.99, "writing")
        names = write_design(designed, out)
    found = summary(designed)
    table = Table(title=f"{loaded.title}: {found['control_point']}, one standard deviation", title_justify="left")
    flights = designed.planner.design.flights
    for head in ("parameter", "unit", "as planned", "optimal", *(f"{n} flights" for n in flights if n > 1)):
        table.add_column(head, justify="left" if head in ("parameter", "unit") else "right")
    for name, p in found["parameters"].items():
        after = [p["after_flights"][str(n)] for n in flights if n > 1]
        cells = [f"{x:.3g}" for x in (p["planned_sigma"], p["optimal_sigma"], *after)]
        table.add_row(name, p["unit"], *cells)
    CONSOLE.print(table)
    CONSOLE.print(f"{found['tried']} designs tried, {found['kept_limits']} keep the limits")
    for varied in found["varied"]:
        planned, best = (found[k]["manoeuvres"][varied["manoeuvre"] - 1][varied["key"]] for k in ("planned", "optimal"))
        CONSOLE.print(f"{varied['key']}: {planned:.4g} planned, {best:.4g} optimal")
    _tell_checks(found)
    for line in notes(designed):
        CONSOLE.print(line)
    print_outputs(out, names)


def _tell_checks(found: dict[str, Any]) -> None:
    """Bounds of a design by the scenario's own source, and against actual fits."""
    for name in found["parameters"]:
        if found["checked"] is not None:
            planned, best = (found["checked"][k]["sigma"][name] for k in ("planned", "optimal"))
            CONSOLE.print(f"{name}: {planned:.3g} and {best:.3g} flown in {found['checked']['source']}")
        if found["fitted"] is not None:
            fitted = found["fitted"]
            CONSOLE.print(
                f"{name}: {fitted['fits']} fits err by {fitted['rms_error'][name]:.3g}, "
                f"{fitted['predicted'][name]:.3g} predicted for them (surface pressure known)",
                highlight=False,
            )
