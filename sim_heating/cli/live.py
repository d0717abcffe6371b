"""The command `sim-heating live`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from sim_heating.base.errors import InputError, RunError
from sim_heating.cli import console

if TYPE_CHECKING:
    from sim_heating.live.engine import LinkEngine
    from sim_heating.live.outputs.published import Output
    from sim_heating.live.outputs.server import PageServer
    from sim_heating.live.spec import Link
    from sim_heating.live.state import State


MOST_REMARKS = 20
"""Remarks on a link that are printed at its end; live.json has all."""


@click.command()
@click.argument("link", type=console.PATH, required=False)
@click.option(
    "--out",
    callback=console.optional_directory,
    help="directory of journal and results; default: out/NAME, of a replay out/NAME-replay",
)
@console.FORCE
@click.option(
    "--replay", type=console.PATH, metavar="RECORD", help="send this record again in place of the link's sources"
)
@click.option(
    "--speed", type=console.NumberRange(0.0), help="flight seconds a second of --replay and --demo; 0: no limit"
)
@click.option("--demo", is_flag=True, help="fly the Mach-20 POPU in JSBSim at 10x, stream it and open the page")
@click.option("--headless", is_flag=True, help="serve no page")
@click.option("--metrics", is_flag=True, help="serve Prometheus metrics and the latest state without a page, too")
@click.option("--host", metavar="ADDRESS", help="address of the page; other machines than this one need its token")
@click.option("--port", type=click.IntRange(0, 65535), help="port of the page; 0 for any that is free")
@click.option("--token", help="what readers of the page have to give; with --host one is made where none is given")
@click.option("--to-record", type=console.PATH, metavar="JOURNAL", help="make records of a journal, and end")
@console.ROOT
def live(
    link: Path | None,
    out: Path | None,
    replay: Path | None,
    speed: float | None,
    demo: bool,
    headless: bool,
    metrics: bool,
    host: str | None,
    port: int | None,
    token: str | None,
    to_record: Path | None,
    root: Path | None,
) -> None:
    """Follow a flight while it is flown: telemetry in by a LINK file, estimate and prediction out.

    Ctrl-C ends the link and writes its results. A link that was killed goes on from its journal when it is started
    again with the same --out.
    """
    if to_record is not None:
        _make_records(to_record, link, out, root)
        return
    _check_options(link, replay, demo, speed)
    loaded, stream = _link_of(link, replay, demo, speed, root)
    options = {k: v for k, v in {"host": host, "port": port, "token": token}.items() if v is not None}
    server = _server(loaded, headless, metrics, options)
    directory = out if out is not None else Path("out") / _default_name(loaded, replay, demo)
    _follow(loaded, directory, server, demo, stream, _sent_again(replay, demo))


def _default_name(link: Link, replay: Path | None, demo: bool) -> str:
    """Folder of the results where none is named: a replay is not put where the flight itself was recorded."""
    return "live-demo" if demo else f"{link.path.stem}-replay" if replay is not None else link.path.stem


def _sent_again(replay: Path | None, demo: bool) -> str:
    """What a link sends again, whose journal the same may replace; "" for a flight that comes once."""
    from sim_heating.live.recording.journal import record_again

    return "demonstration" if demo else "" if replay is None else record_again(replay)


def _check_options(link: Path | None, replay: Path | None, demo: bool, speed: float | None) -> None:
    if demo and (link is not None or replay is not None):
        raise click.UsageError("--demo flies by itself; give neither LINK nor --replay")
    if not demo and link is None and replay is None:
        raise click.UsageError("Missing argument 'LINK', --replay RECORD or --demo.")
    if speed is not None and replay is None and not demo:
        raise click.UsageError("--speed is that of --replay or --demo")


def _make_records(journal: Path, link: Path | None, out: Path | None, root: Path | None) -> None:
    from sim_heating.live.recording.to_record import to_record
    from sim_heating.live.spec import load_link

    if out is None:
        raise click.UsageError("--to-record needs --out, the directory of the records")
    declared = None if link is None else load_link(link, root=root)
    records, notes = to_record(journal, out, declared, root=root)
    for line in notes:
        console.print_warning(line)
    names = sorted(p.name for p in out.iterdir() if not p.name.startswith("."))
    console.print_outputs(out, names, {"control_points": list(records), "notes": notes})


def _link_of(
    link: Path | None, replay: Path | None, demo: bool, speed: float | None, root: Path | None
) -> tuple[Link, Any]:
    """The link that is followed, and what opens its sources where these are not the file's own."""
    from sim_heating.live.sources import open_source
    from sim_heating.live.spec import load_link, replayed

    if demo:
        from sim_heating.live.sources.demo import SPEED, demo_link, flight_source

        return demo_link(), flight_source(SPEED if speed is None else speed)
    loaded = None if link is None else load_link(link, root=root)
    if replay is not None:
        loaded = replayed(loaded, replay, 1.0 if speed is None else speed, root=root)
    assert loaded is not None
    return loaded, open_source


def _follow(
    link: Link,
    directory: Path,
    server: PageServer | None,
    demo: bool,
    open_sources: Any,
    sent_again: str,
) -> None:
    from sim_heating.base.files import require_writable
    from sim_heating.live.engine import LinkEngine, check_estimate
    from sim_heating.live.recording.journal import NAME, Journal
    from sim_heating.live.recording.same_link import meaning
    from sim_heating.live.recording.to_record import RECORDS
    from sim_heating.live.results.files import COMMAND, RESULT, expected_files, inputs_of
    from sim_heating.live.run import run

    check_estimate(link)
    require_writable(directory, COMMAND, expected=expected_files(link), inputs=inputs_of(link))
    contents = link.declared.model_dump(mode="json", exclude_unset=True)
    journal = Journal(
        directory / NAME,
        contents,
        link.path,
        fsync_s=link.declared.journal.fsync_s,
        means=meaning(link),
        sent_again=sent_again,
        has_results=(directory / RESULT).is_file(),
    )
    ended = False
    try:
        engine = LinkEngine(link, journal)
        outputs = _outputs(engine, server, opens_browser=demo)
        state = run(
            engine,
            outputs,
            resume=journal.is_resumed,
            open_sources=open_sources,
            waiting=lambda: console.progress_line(link.title),
        )
        ended = True
    except KeyboardInterrupt:
        journal.close(is_end=False)  # which removes that of a link that was not begun
        console.print_warning(_kept_line(directory / NAME))
        raise
    finally:
        journal.close(is_end=ended)
    if journal.problem:
        console.print_warning(journal.problem)
    _print_summary(engine, state)  # first: it is reported though the disk is full
    names, notes = _written(engine, state, directory)
    for line in notes:
        console.print_warning(line)
    console.print_outputs(directory, [NAME, *names], RESULT)
    if RECORDS in names:
        console.CONSOLE.print(f"Records for `sim-heating estimate`: {directory / RECORDS}, one of each control point")


def _kept_line(journal: Path) -> str:
    """What a link keeps that ends without results; its journal is closed."""
    if journal.is_file():
        return f"{journal} keeps what came: the same command goes on from it"
    return "nothing had come: no journal is kept"


def _written(engine: LinkEngine, state: State, directory: Path) -> tuple[list[str], list[str]]:
    """Write the results; where that fails the flight is not closed, so that the same command can go on with it."""
    from sim_heating.live.recording.journal import NAME, open_again
    from sim_heating.live.results.files import write_results

    try:
        return write_results(engine, state, directory)
    except (InputError, RunError, OSError):
        open_again(directory / NAME)
        console.print_warning(
            f"{directory / NAME} holds the flight and is not closed: the same command, once what follows is mended, "
            "goes on from it and writes the results"
        )
        raise


def _print_summary(engine: LinkEngine, state: State) -> None:
    """Print the estimates at the end of a link, what came, what was taken out, and whether an effect is missing."""
    _print_estimates(engine, state)
    counts, health = engine.counts, state.link
    console.CONSOLE.print(
        f"Came: {counts['messages']} messages, {counts['frames']} frames and {counts['readings']} readings, of which "
        f"{health.lost} lost, {health.late} late, {health.too_late} too late, {health.doubled} doubled; "
        f"{health.damaged} damaged, {health.jumps} clock jumps"
    )
    removed = [removal.text for removal in state.removed]
    remarks = [line for line in engine.remarks.lines() if line not in removed]
    for line in (*removed, *remarks[:MOST_REMARKS]):
        console.print_warning(line)
    if len(remarks) > MOST_REMARKS:
        console.print_warning(f"{len(remarks) - MOST_REMARKS} more remarks are in live.json")
    console.CONSOLE.print(f"Missing effect: {state.missing.text}", style="red" if state.missing.alarm else None)


def _print_estimates(engine: LinkEngine, state: State) -> None:
    """Print temperatures and parameters of each control point."""
    from sim_heating.base.report.table import Column, Table

    heads = ["surface [K]", "bondline [K]", "margin [K]"]
    rows = [
        (
            point,
            _bound(point_state.surface_K, point_state.surface_sigma_K, ".1f", ".1f"),
            _bound(point_state.bondline_K, point_state.bondline_sigma_K, ".1f", ".1f"),
            point_state.margin_K,
        )
        for point, point_state in state.points.items()
    ]
    if rows:
        when = "" if state.time_s is None else f" at {state.time_s:.1f} s of flight"
        columns = [Column("control point"), *(Column(h, format=".0f") for h in heads)]
        console.print_table(Table(f"{engine.link.title}{when}, estimates +- sigma", columns, rows))
        # a row each: side by side six of them are wider than a terminal
        fitted = [
            (point, name, _bound(parameter.value, parameter.sigma), parameter.unit)
            for point, point_state in state.points.items()
            for name, parameter in point_state.parameters.items()
        ]
        heads = ["control point", "parameter", "estimate +- sigma", "unit"]
        console.print_table(Table("Parameters", [Column(h) for h in heads], fitted))


def _bound(value: float, sigma: float, spec: str = ".4g", sigma_spec: str = ".2g") -> str:
    return f"{value:{spec}} +- {sigma:{sigma_spec}}"


def _server(link: Link, headless: bool, metrics: bool, options: dict[str, Any]) -> PageServer | None:
    """What serves the page of a link, or its metrics alone; None where neither is wanted."""
    from sim_heating.live.sources.extra import need_extra

    declared = link.declared.output
    has_page = declared.page and not headless
    if not (has_page or metrics or declared.metrics):
        if options:
            names = ", ".join(f"--{name}" for name in options)
            raise click.UsageError(f"{names}: this link has no page; serve its metrics alone by --metrics")
        return None
    need_extra("starlette", "uvicorn", "websockets", "prometheus_client")
    from sim_heating.live.outputs.display import Display
    from sim_heating.live.outputs.server import PageServer

    if link.vehicle is not None:
        display = Display.of_vehicle(link.vehicle, link.names, link.title)
    else:
        display = Display.of_records([link.records[name] for name in link.names], link.title)
    return PageServer(display, **{"host": declared.host, "port": declared.port, "page": has_page, **options})


def _outputs(engine: LinkEngine, server: PageServer | None, *, opens_browser: bool) -> list[Output]:
    """The outputs of a link: its page, the displays that it sends lines to, the JSBSim that it writes to."""
    link, declared = engine.link, engine.link.declared.output
    outputs: list[Output] = [] if server is None else [_Announced(server, opens_browser)]
    for address in declared.lines:
        from sim_heating.live.outputs.lines import lines_to

        outputs.append(lines_to(address))
    if declared.jsbsim is not None:
        from sim_heating.live.outputs.jsbsim_properties import JSBSimProperties

        outputs.append(JSBSimProperties.of_link(link, engine.remarks.add))
    return outputs


class _Announced:
    """A page, or metrics alone, whose address is printed when it is served."""

    def __init__(self, server: PageServer, opens_browser: bool) -> None:
        self._server, self._opens_browser = server, opens_browser

    async def start(self) -> None:
        await self._server.start()
        console.ERRORS.print(f"{'page' if self._server.has_page else 'metrics'}: {self._server.url}")
        if self._opens_browser and self._server.has_page and console.CONSOLE.is_terminal:
            click.launch(self._server.url)

    def publish(self, published: Any) -> None:
        self._server.publish(published)

    async def stop(self) -> None:
        await self._server.stop()
