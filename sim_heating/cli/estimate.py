"""The commands `sim-heating estimate` and `sim-heating design`."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import sim_heating as sh
from sim_heating.base.errors import InputError, RunError, error_context
from sim_heating.cli import console
from sim_heating.cli.parameter_options import merged_settings, parameter_options

if TYPE_CHECKING:
    from sim_heating.estimation.fit import FitResult
    from sim_heating.inputs.fit_settings import FitSettings
    from sim_heating.inputs.record import Record

ESTIMATED = "estimated"
"""Value of an option for a level of noise that the fit is to find."""
LARGEST_NOISE = 1e4
"""Upper bound of levels and correlation times of noise."""


def _reference_condition(_: click.Context, __: click.Parameter, value: str | None) -> dict[str, float]:
    """Value of --reference, `alpha_deg=40,...`, by name of the variable."""
    from sim_heating.base.conditions import RATIO_VARIABLES
    from sim_heating.base.files import plain_number, suggestion
    from sim_heating.base.limits import limit_message, out_of_range

    condition = {}
    for item in (value or "").split(","):
        if not item.strip():
            continue
        name, _equals, number = (piece.strip() for piece in item.partition("="))
        if name in condition:
            raise InputError(f"--reference: {name} is given twice; leave one out")
        if name not in RATIO_VARIABLES:
            raise InputError(f"--reference: `{name}` is not a ratio variable{suggestion(name, RATIO_VARIABLES)}")
        try:
            condition[name] = plain_number(number)
        except ValueError:
            raise InputError(f"--reference: {name}: `{number}` is not a number; write {name}=40") from None
        if out_of_range(name, condition[name]):
            raise InputError(f"--reference: {name}: {limit_message(name, condition[name])}; write {name}=40")
    return condition


def _fit_segments(_: click.Context, __: click.Parameter, value: tuple[str, ...]) -> Any:
    """Values of --fit, each `640,760` or `640,760@FLIGHT`: [start, end] times [s], by owner where there is one."""
    from sim_heating.base.files import plain_number
    from sim_heating.base.parameters import AT

    by_owner: dict[str, list[list[float]]] = {}
    for item in value:
        text, _at, owner = item.partition(AT)
        try:
            start, end = (plain_number(number) for number in text.split(","))
        except ValueError:
            raise InputError(f"--fit: `{item}` is not a segment; write --fit 640,760 (start and end in s)") from None
        if not -math.inf < start < end < math.inf:
            raise InputError(f"--fit: {item}: give two finite times in s, the start before the end")
        by_owner.setdefault(owner, []).append([start, end])
    return by_owner.get("", []) if set(by_owner) <= {""} else by_owner


def _starts(_: click.Context, __: click.Parameter, value: tuple[str, ...]) -> Any:
    """Values of --start, each `circuit:650` or `circuit:650@FLIGHT`, by owner where there is one."""
    from sim_heating.base.parameters import AT

    by_owner: dict[str, str] = {}
    for item in value:
        text, _at, owner = item.partition(AT)
        if owner in by_owner:
            raise InputError(f"--start: is given twice{f' for {owner}' if owner else ''}; leave one out")
        by_owner[owner] = text
    return by_owner.get("") if set(by_owner) <= {""} else by_owner


def _start(value: str | None) -> Any:
    """Where a march begins, `declared` or `circuit:650` and the like, as a function that makes the initial state.

    Without a time it is the start of the record's first fit segment.
    """
    from sim_heating.base.files import plain_number, suggestion
    from sim_heating.estimation.starts import STARTS

    if value in (None, "declared"):
        return None
    kind, _colon, at = value.partition(":")
    if kind not in STARTS:
        raise InputError(f"--start: `{kind}` is not a way to start{suggestion(kind, ['declared', *STARTS])}")
    try:
        time_s = plain_number(at) if at else None
    except ValueError:
        raise InputError(f"--start: `{at}` is not a time in s; write {kind}:650") from None
    if time_s is None and kind == "lost":
        raise InputError("--start: lost needs the time in s at which the readings come back; write lost:650")

    def start(record: Any, model: Any, mesh: Any) -> Any:
        with error_context(f"--start {value}"):
            return STARTS[kind](record, model, mesh, _fit_start_s(record, kind) if time_s is None else time_s)

    return start


def _fit_start_s(record: Any, kind: str) -> float:
    """Start of the first fit segment of a record [s].

    raises : InputError where it has none, so that there is nothing before a start
    """
    segments = record.declared.segments.fit
    if not segments:
        raise InputError(f"needs a time, or fit segments: write {kind}:650, or give --fit START,END")
    return float(min(segments)[0])


NOISE = "--process-noise and --ratio-noise"
APART = {
    ("--segments", NOISE): "segments are fitted without process noise",
    ("--segments", "--profile"): "a profile is of one fit",
    ("--segments", "--model-error"): "segments are fitted without an error of the model",
    ("--profile", NOISE): "is of a fit without process noise",
    ("--model-error", NOISE): "is of a fit without process noise",
}
"""Options of which one excludes the other, with the reason."""


def _refuse_together(stated: Mapping[str, object]) -> None:
    """raises : InputError for two options that exclude each other;  stated : option -> whether it was given"""
    for (option, other), reason in APART.items():
        if stated[option] and stated[other]:
            raise InputError(f"{option}: {reason}; leave out {other}")


def _process_noise(nodes: str | None, ratio: str | None) -> Any:
    """Process noise of `--process-noise` and `--ratio-noise`; None where neither is given."""
    from sim_heating.estimation.filter.process_noise import CORRELATION, FIRST_GUESS, NODE, RATIO, ProcessNoise

    if nodes is None and ratio is None:
        return None
    q, sigma, tau, estimated = 0.0, 0.0, ProcessNoise().ratio_correlation_s, []

    def level(text: str, name: str, hint: str) -> float:
        if text != ESTIMATED:
            return _level(text, hint)
        estimated.append(name)
        return FIRST_GUESS[name]

    if nodes is not None:
        q = level(nodes, NODE, f"--process-noise {nodes}: give K/sqrt(s), as 0.2, or `{ESTIMATED}`")
    if ratio is not None:
        first, _comma, time_s = ratio.partition(",")
        hint = f"--ratio-noise {ratio}: give sigma and correlation time in s, as 0.01,30, or `{ESTIMATED}`"
        sigma = level(first, RATIO, hint)
        if time_s:
            tau = _level(time_s, hint)
        elif first == ESTIMATED:
            estimated.append(CORRELATION)
        if tau == 0.0 or not (time_s or first == ESTIMATED):
            raise InputError(hint)
    return ProcessNoise(q, sigma, tau, tuple(estimated))


def _level(text: str, hint: str) -> float:
    """A number from 0 to LARGEST_NOISE; InputError with the hint for any other text."""
    from sim_heating.base.files import plain_number

    try:
        level = plain_number(text)
    except ValueError:
        raise InputError(hint) from None
    if not 0.0 <= level <= LARGEST_NOISE:
        raise InputError(f"{hint}; {text} is not within 0 to {LARGEST_NOISE:g}")
    return level


@click.command()
@click.argument("records", type=console.PATH, nargs=-1, required=True)
@console.OUT
@click.option(
    "--parameters",
    callback=console.comma_list,
    help="dotted names, separated by commas; default: magnitude and derivatives",
)
@click.option(
    "--reference", callback=_reference_condition, help="condition alpha_deg=40,... that derivatives are about"
)
@click.option(
    "--start",
    multiple=True,
    callback=_starts,
    help="initial temperatures: declared (default), or circuit, profile or filter at the start of the first fit "
    "segment, or at a time, filter:TIME_S; lost:TIME_S (heating unknown until then); behind @ the flight, record or "
    "point, where not for all",
)
@click.option(
    "--fit",
    "fit",
    multiple=True,
    callback=_fit_segments,
    metavar="START,END[@FLIGHT]",
    help="fit this segment of each record, times in s, in place of its own; may be repeated",
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
    help="Kalman filter: random variation of the heating ratio, sigma and correlation time, or `estimated`",
)
@click.option(
    "--segments", type=float, metavar="LENGTH_S", help="fit consecutive segments of this length [s] (one record)"
)
@click.option(
    "--profile",
    "profiles",
    multiple=True,
    metavar="NAME",
    help="95 % interval of an estimated parameter by the profile of the likelihood, with a picture; may be repeated",
)
@click.option(
    "--model-error",
    is_flag=True,
    help="errors of heating and flight, as the records state them, are part of the fit: for what is to predict others",
)
@parameter_options
@console.ROOT
def estimate(
    records: tuple[Path, ...],
    out: Path,
    parameters: tuple[str, ...] | None,
    reference: dict[str, float],
    start: Any,
    fit: Any,
    settings_file: Path | None,
    fix: dict[str, float],
    prior: dict[str, Any],
    bound: dict[str, Any],
    tie: list[list[str]],
    node_noise: str | None,
    ratio_noise: str | None,
    segments: float | None,
    profiles: tuple[str, ...],
    model_error: bool,
    root: Path | None,
) -> None:
    """Estimate heating and thermal parameters from the thermocouples of flight records, jointly, with bounds."""
    from sim_heating.base.files import require_writable

    noise = _process_noise(node_noise, ratio_noise)
    _refuse_together(
        {
            "--segments": segments is not None,
            NOISE: noise is not None,
            "--profile": profiles,
            "--model-error": model_error,
        }
    )
    names = None if parameters is None else list(parameters)
    stated = merged_settings(
        settings_file,
        parameters=names,
        reference=reference,
        start=start,
        fit=fit,
        fix=fix,
        prior=prior,
        bound=bound,
        tie=tie,
    )
    if segments is not None:
        _estimate_trend(records, out, stated, segments, root, settings_file)
        return
    from sim_heating.estimation.report.report import estimate_contents, estimate_table, output_files
    from sim_heating.inputs.record import load_records

    loaded = load_records(records, root=root)
    with _in_settings(settings_file):
        loaded, starts = _with_segments(loaded, stated)
    files = output_files(loaded, filtered=noise is not None, profiles=bool(profiles))
    require_writable(out, "estimate", expected=files, inputs=[record.directory for record in loaded])
    with console.progress_line("estimate") as progress, _in_settings(settings_file):
        fitted = sh.estimate(
            loaded,
            stated.parameters,
            reference=stated.reference_condition,
            fixed=stated.fix,
            priors=stated.priors,
            bounds=stated.bounds,
            ties=stated.tie,
            starts=starts,
            process_noise=noise,
            error_of=sh.stated_error if model_error else None,
            profiles=profiles,
            progress=progress,
        )
        progress(0.95, "writing")
        names = sh.write_fit(fitted, out)
    contents = estimate_contents(fitted)
    console.print_table(estimate_table(f"{', '.join(r.name for r in loaded)}: estimate", contents))
    _print_fit(fitted, contents)
    _print_errors(contents)
    console.print_outputs(out, names, "estimate.json")
    if not contents.converged:
        raise RunError(f"estimate: {fitted.fit.status.value}; {out} holds the last iteration, which is not an estimate")


def _in_settings(file: Path | None) -> AbstractContextManager[None]:
    """Prefix the problems of what a file of settings states with the file, whose records are good by themselves."""
    from sim_heating.base.files import display_path

    return nullcontext() if file is None else error_context(display_path(file))


def _with_segments(records: list[Record], stated: FitSettings) -> tuple[list[Record], list[Any]]:
    """The records with the segments that are stated for them, and where their marches start."""
    from sim_heating.inputs.parameter_owners import Owners

    owners = Owners(records)
    segments = [owners.of_owner(stated.segments_s, record, "fit") for record in records]
    starts = [_start(owners.of_owner(stated.starts, record, "start")) for record in records]
    pairs = zip(records, segments, strict=True)
    return [record.with_fit(stated_s) if stated_s else record for record, stated_s in pairs], starts


def _estimate_trend(
    records: tuple[Path, ...],
    out: Path,
    stated: FitSettings,
    length_s: float,
    root: Path | None,
    settings_file: Path | None,
) -> None:
    """Fit consecutive segments of one record, and print how many were fitted and omitted."""
    from sim_heating.base.files import require_writable
    from sim_heating.estimation.report.report import TREND, write_trend
    from sim_heating.estimation.trend import trend

    if len(records) > 1:
        raise InputError(f"--segments: {len(records)} records are given; segments are fitted to one record at a time")
    if stated.tie:
        raise InputError("--segments: each segment has its own parameters; leave out --tie")
    loaded = sh.load_record(records[0], root=root)
    with _in_settings(settings_file):
        (record,), (start,) = _with_segments([loaded], stated)
    require_writable(out, "estimate", expected=TREND, inputs=[record.directory])
    with console.progress_line("estimate") as progress, _in_settings(settings_file):
        fitted = trend(
            record,
            length_s,
            stated.parameters,
            start=start,
            reference=stated.reference_condition,
            fixed=stated.fix,
            priors=stated.priors,
            bounds=stated.bounds,
            progress=progress,
        )
        names = write_trend(fitted, out)
    many = "s" if len(fitted.segments) != 1 else ""
    console.CONSOLE.print(
        f"{len(fitted.segments)} segment{many} of {length_s:g} s fitted, {len(fitted.left_out)} left out"
    )
    for line in fitted.left_out[:3]:
        console.CONSOLE.print(f"left out: {line}")
    for line in fitted.warnings:
        console.print_warning(line)
    console.print_outputs(out, names, {"segments": len(fitted.segments), "left_out": fitted.left_out})


def _parameter_lines(contents: Any, profiles: Sequence[str]) -> Iterator[str]:
    """Lines on parameters that are fixed or tied, on their profiles, and on those that are not estimated."""
    for name, p in contents.fixed.items():
        if name not in contents.not_estimated:
            yield f"{name}: fixed at {p.value:g}{'' if p.unit == '1' else f' {p.unit}'}"
    for name, other in contents.ties.items():
        if name != other:
            yield f"{name}: tied to {other}"
    yield from profiles
    for name, why in contents.not_estimated.items():
        yield f"{name}: not estimated, {why}"


def _print_fit(fitted: FitResult, contents: Any) -> None:
    """Print what a fit has besides its parameters: tied and fixed ones, profiles, warnings, levels of noise."""
    from sim_heating.estimation.report.remarks import further_warnings

    for line in _parameter_lines(contents, [profile.in_words() for profile in fitted.profiles.values()]):
        console.CONSOLE.print(line)
    for line in (*(r.in_words for r in contents.remarks), *further_warnings(fitted.warnings, contents.remarks)):
        console.print_warning(line)
    if fitted.innovations is not None:
        console.CONSOLE.print(fitted.innovations.levels.noise.summary())


def _print_errors(contents: Any) -> None:
    """Print RMSE of the declared and the fitted model and of the innovations of a filter, and the noise floor."""
    from sim_heating.estimation.report.remarks import floor_in_words, samples_in_words

    extra, innovations = contents.model_extra or {}, contents.innovations
    declared = extra.get("predicted") or {}
    march = "" if innovations is None else ", plain march without readings"
    for segments in ("fit", "holdout"):
        before, after = declared.get(segments), getattr(contents, segments)
        if after is not None and before is not None:
            console.CONSOLE.print(
                f"RMSE, {segments}{march}: {before.rmse_K:.2f} K declared, {after.rmse_K:.2f} K fitted "
                f"({after.n} samples)"
            )
    if innovations is not None:
        console.CONSOLE.print(
            f"RMSE, innovations, which the fit minimised: {innovations.rmse_K:.2f} K, "
            f"{innovations.normalised_rms:.2f} of what the filter expects ({innovations.n} samples)"
        )
    if floor := floor_in_words(contents):
        console.CONSOLE.print(f"Noise floor: {floor}")
    if samples := samples_in_words(extra.get("samples", {})):
        console.CONSOLE.print(f"Samples: {samples}")


@click.command()
@click.argument("scenario", type=console.PATH)
@console.OUT
@click.option(
    "--parameters",
    callback=console.comma_list,
    help="dotted names of the parameters whose bounds are minimised, separated by commas",
)
@click.option("--criterion", type=click.Choice(["D", "A"]), help="D: volume of the bounds; A: their mean square")
@click.option("--evaluations", type=click.IntRange(1), help="number of designs to evaluate")
@click.option(
    "--repetitions", type=click.IntRange(0), default=0, help="check the bounds against this many simulated fits"
)
@console.ROOT
def design(
    scenario: Path,
    out: Path,
    parameters: tuple[str, ...] | None,
    criterion: str | None,
    evaluations: int | None,
    repetitions: int,
    root: Path | None,
) -> None:
    """Design a scenario's manoeuvres: the bounds they would give, the most informative ones, other instruments."""
    from sim_heating.base.files import require_writable
    from sim_heating.estimation.design import report
    from sim_heating.inputs.scenario import with_design

    stated = {"parameters": parameters and list(parameters), "criterion": criterion, "evaluations": evaluations}
    loaded = with_design(sh.load_scenario(scenario, root=root), {k: v for k, v in stated.items() if v is not None})
    require_writable(out, "design", expected=report.FILES, inputs=loaded.files)
    with console.progress_line("design") as progress:
        designed = report.design(loaded, repetitions=repetitions, progress=progress)
        progress(0.99, "writing")
        names = report.write_design(designed, out)
    contents = report.summary(designed)
    console.print_table(report.bounds_table(designed, [n for n in designed.planner.design.flights if n > 1]))
    console.CONSOLE.print(f"{contents['tried']} designs tried, {contents['kept_limits']} keep the limits")
    for line in report.changes(contents):
        console.CONSOLE.print(line)
    _print_checks(contents)
    if designed.planner.compared:
        console.print_table(report.instruments_table(designed))
    if contents["locations"]:
        console.CONSOLE.print(f"locations, bounds over the ratio: {_ranking(contents)}")
    for line in (*map(_interface_in_words, contents["interfaces"]), *report.notes(designed)):
        console.CONSOLE.print(line)
    console.print_outputs(out, names, "design.json")


def _interface_in_words(face: dict[str, Any]) -> str:
    return (
        f"interface of {face['control_point']} behind {face['upstream']}: heating {face['largest_excess']:+.1%} at "
        f"most, at {face['largest_at_s']:.0f} s; in the manoeuvres up to {face['largest_in_manoeuvres']:.1%}"
    )


def _ranking(contents: dict[str, Any]) -> str:
    """Control points by the bounds of one thermocouple there, over those at the design's point."""
    values = ((at["control_point"], at["over_declared"]) for at in contents["locations"])
    return ", ".join(f"{name} {'none' if value is None else format(value, '.2g')}" for name, value in values)


def _print_checks(contents: dict[str, Any]) -> None:
    """Print the bounds of a design flown in the scenario's own source, and those of simulated fits."""
    for name in contents["parameters"]:
        if contents["checked"] is not None:
            planned, best = (contents["checked"][k]["sigma"][name] for k in ("planned", "optimal"))
            console.CONSOLE.print(f"{name}: {planned:.3g} and {best:.3g} flown in {contents['checked']['source']}")
        if contents["fitted"] is not None:
            fitted = contents["fitted"]
            console.CONSOLE.print(
                f"{name}: {fitted['fits']} fits err by {fitted['rms_error'][name]:.3g}, "
                f"{fitted['predicted'][name]:.3g} predicted for them (surface pressure known)",
                highlight=False,
            )
