"""A journal closed as flight records: what came, in the order of its times, one record a control point.

Times are put in order, and of samples of one time the first that came counts. Where the clock jumped, the longest
stretch between two jumps is the record: times before and after a jump are not of one clock. The journal keeps all.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from sim_heating.base.arrays import FloatArray
from sim_heating.base.conditions import DESCRIPTIONS, SURFACES, Conditions
from sim_heating.base.errors import InputError, RunError, reworded
from sim_heating.base.files import display_path, output_directory
from sim_heating.estimation.record_fit import LONGEST_STEP_S
from sim_heating.heating.atmosphere import free_stream
from sim_heating.heating.recorded.reading import lowered_confidence
from sim_heating.inputs.first_readings import other_start
from sim_heating.inputs.points import conditions_behind_walls, conditions_of_record, point_of_record
from sim_heating.inputs.record import Record, Segments, make_record, write_record
from sim_heating.live.filtering.clock_judge import BRIDGED_S
from sim_heating.live.filtering.heated_start import start_of_heated
from sim_heating.live.filtering.timeline import Placed, Timeline
from sim_heating.live.recording.journal import damage_of, journal_file, read_head, read_journal
from sim_heating.live.recording.same_link import differences, meaning
from sim_heating.live.sources import decoder_of
from sim_heating.live.sources.decoder import message_of
from sim_heating.live.sources.mapping import FieldMapping
from sim_heating.live.spec import Link, LinkPoint, make_link
from sim_heating.live.types import Frame, Sample
from sim_heating.march.ensemble import condition_history
from sim_heating.march.mesh_choice import choose_meshes
from sim_heating.simulation.synthesize import flown_columns, ratio_table_of, record_declaration, turbulent_table_of

FIRST_S = 2.0
"""Time after the first frame within which a first reading is one of the start [s]."""
RECORDS = "records"
"""Folder of the records in the directory of a link's results."""


@dataclass
class Stretch:
    """Samples of one clock: frames by time, and readings by control point, sensor and time; the first of a time.

    has_model_density : whether the density of a frame is of the standard atmosphere, and not of the day
    """

    frames: dict[float, Mapping[str, float]] = field(default_factory=dict)
    has_model_density: bool = False
    readings: dict[tuple[str, str], dict[float, float]] = field(default_factory=dict)

    def add(self, sample: Sample) -> None:
        """Add a sample; one of a time that is there already is a double."""
        if isinstance(sample, Frame):
            self.frames.setdefault(sample.time_s, sample.values)
            self.has_model_density |= sample.has_model_density
        else:
            self.readings.setdefault((sample.point, sample.sensor), {}).setdefault(sample.time_s, sample.value_K)

    def add_all(self, samples: Iterable[Sample], low_s: float = -math.inf, high_s: float = math.inf) -> None:
        """Add those of several whose times are in a range [s]."""
        for sample in samples:
            if low_s <= sample.time_s <= high_s:
                self.add(sample)


def samples_of(journal: str | os.PathLike[str], link: Link) -> Iterable[Sample]:
    """Frames and readings of a journal in the order in which they came; what is damaged is left out, as it was live."""
    decoders = [decoder_of(link, source) for source in link.declared.source]
    mapping = FieldMapping(link)
    for entry in read_journal(journal):
        if entry.source >= len(decoders):
            raise InputError(
                f"{display_path(journal_file(journal))}: holds messages of {entry.source + 1} sources, "
                f"{display_path(link.path)} declares {len(decoders)}; name the link that wrote it, or none"
            )
        message = message_of(decoders[entry.source], entry.body, entry.arrived_ns * 1e-9)
        if message is None:
            continue
        try:
            yield from mapping.apply(message)
        except InputError:  # counted and reported when it came
            continue


def stretches(samples: Iterable[Sample], link: Link) -> list[Stretch]:
    """Samples parted where the clock of the frames jumps, as the estimator finds it; gaps do not part them.

    What came too late for the estimate is in its place here.
    """
    settings = link.declared.estimate
    sensors = [(p.name, s.name) for p in link.points for s in p.sensors]
    numbers = {sensor: n for n, sensor in enumerate(sensors)}
    timeline = Timeline(numbers, settings.lateness_s, settings.jump_s)
    parts, waiting = [Stretch()], list[Sample]()
    for sample in samples:
        placed = timeline.put(sample)
        if placed is Placed.JUMPED:
            jump = timeline.jump
            assert jump is not None
            timeline.follow(is_gap := 0.0 < jump.by_s <= BRIDGED_S)
            if not is_gap:
                parts.append(Stretch())
            low, high = jump.to_s - settings.jump_s, sample.time_s + settings.jump_s
            parts[-1].add_all((*waiting, sample), low, high)
            waiting = []
        elif placed in (Placed.TOO_LATE, Placed.WAITING):
            waiting.append(sample)  # late, or the first on another clock: the next frame decides
        elif placed is not Placed.DOUBLED:
            parts[-1].add(sample)
            if isinstance(sample, Frame):
                parts[-1].add_all(waiting, high_s=sample.time_s)
                waiting = []
        timeline.forget(timeline.newest_s - settings.lateness_s)
    parts[-1].add_all(waiting, high_s=timeline.newest_s)  # late ones that no frame came behind
    return parts


def longest_stretch(samples: Iterable[Sample], link: Link) -> tuple[Stretch, list[str]]:
    """The stretch with the most frames, and one line for each other one."""
    parts = stretches(samples, link)
    longest = max(parts, key=lambda s: len(s.frames))
    return longest, [
        f"the clock jumped: {len(s.frames)} frames from {min(s.frames):g} to {max(s.frames):g} s are left out"
        for s in parts
        if s is not longest and s.frames
    ]


def records_of(link: Link, stretch: Stretch) -> dict[str, Record]:
    """Records of a stretch by control point, those that have readings.

    raises : InputError where there are fewer than two frames, or no reading at all
    """
    times = sorted(stretch.frames)
    where = display_path(link.path)
    if len(times) < 2:
        raise InputError(f"{where}: {len(times)} frames of flight conditions came; a record needs two at least")
    columns: dict[str, FloatArray] = {"time_s": np.array(times)}
    for name in stretch.frames[times[0]]:
        columns[name] = np.array([stretch.frames[t].get(name, np.nan) for t in times])
    declared_start = link.declared.estimate.start == "declared"
    records = {
        point.name: record if declared_start else with_heated_start(record)
        for point in link.points
        if (measured := _measured(point, stretch, times[0], times[-1])) is not None
        for record in [_with_confidence(_record_that_can_be(link, point, columns, measured), stretch)]
    }
    if not records:
        raise InputError(f"{where}: no reading of a thermocouple came within the time of the conditions; no record")
    return records


def _with_confidence(record: Record, stretch: Stretch) -> Record:
    """The record with the confidence of its conditions that the density of a standard atmosphere leaves."""
    if not stretch.has_model_density:
        return record
    stated = record.declared.conditions
    conditions = stated.model_copy(update={"confidence": lowered_confidence(stated.confidence)})
    return replace(record, declared=record.declared.model_copy(update={"conditions": conditions}))


def _measured(point: LinkPoint, stretch: Stretch, first_s: float, last_s: float) -> dict[str, FloatArray] | None:
    """Columns of the measurements of a point: its sensors that were read; None where none was."""
    by_sensor = {s.name: stretch.readings.get((point.name, s.name), {}) for s in point.sensors}
    read = {s.column: by_sensor[s.name] for s in point.sensors if np.any(np.isfinite(list(by_sensor[s.name].values())))}
    times = sorted({t for values in read.values() for t in values})
    if not any(first_s <= t <= last_s for t in times):
        return None
    columns = {c: np.array([values.get(t, np.nan) for t in times]) for c, values in read.items()}
    return {"time_s": np.array(times), **columns}


def _record_that_can_be(
    link: Link, point: LinkPoint, flown: Mapping[str, FloatArray], measured: Mapping[str, FloatArray]
) -> Record:
    """The record of a point; an InputError names the link, because none of the record's files is written then."""
    folder = display_path(Path(point.name) / "_")[:-1]
    where = f"{display_path(link.path)}: what came makes no record of {point.name}"
    with reworded(lambda problem: f"{where}: {problem.removeprefix(folder)}"):
        return _record(link, point, flown, measured)


def _record(
    link: Link, point: LinkPoint, flown: Mapping[str, FloatArray], measured: Mapping[str, FloatArray]
) -> Record:
    sensors = [s for s in point.sensors if s.column in measured]
    if link.vehicle is None:
        return _record_like(link.records[point.name], flown, measured)
    vehicle = link.vehicle
    point_declared = vehicle.control_point(point.name)
    columns = {name: np.zeros(len(flown["time_s"])) for name in SURFACES} | dict(flown)
    derived = free_stream(
        columns["altitude_m"], columns["velocity_m_s"], columns["rho_kg_m3"], vehicle.reference_length_m
    )
    conditions = conditions_behind_walls(vehicle, [point_declared], Conditions(derived | columns))[0]
    declared = record_declaration(vehicle, point_declared, sensors, link.title, link.path.stem, measured=True)
    table, turbulent = ratio_table_of(point_declared), turbulent_table_of(point_declared)
    return make_record(declared, flown_columns(conditions), measured, table, point.name, turbulent)


def with_heated_start(record: Record) -> Record:
    """A record that begins in flight with the temperatures in depth [K] that conduct to its first readings.

    The record as it is where it begins as declared, or where no heating conducts to its readings. Source:
    docs/theory/clocks_and_starts.md, equation 8.
    """
    if other_start(record) is None:
        return record
    model, begin_s = point_of_record(record), float(record.conditions.time_s[0])
    mesh = choose_meshes([model], LONGEST_STEP_S)[0][0]
    soon = (record.time_s >= begin_s) & (record.time_s <= begin_s + FIRST_S)
    columns = zip(mesh.sensors, record.sensors, record.temperatures_K()[:, soon], strict=True)
    read_K = {node: float(T[np.isfinite(T)][0]) for node, s, T in columns if s.used and np.any(np.isfinite(T))}
    if not read_K:
        return record
    conditions = condition_history(conditions_of_record(record).at(np.array([begin_s])))[0]
    try:
        profile_K, _ = start_of_heated(model, mesh, read_K, conditions)
    except RunError:
        return record
    rows = [[float(x), round(float(T), 2)] for x, T in zip(mesh.depth_m, profile_K, strict=True)]
    stack = record.declared.stack.model_copy(update={"initial": "profile", "initial_profile": rows})
    return replace(record, declared=record.declared.model_copy(update={"stack": stack}))


def _record_like(record: Record, flown: Mapping[str, FloatArray], measured: Mapping[str, FloatArray]) -> Record:
    """A record with the declaration of another one, and what was flown and measured now."""
    sensors = [s for s in record.sensors if s.column in measured]
    declared = record.with_sensors(sensors).declared
    first_s, last_s = float(measured["time_s"][0]), float(measured["time_s"][-1])
    overlapping: dict[str, list[list[float]]] = {}
    for name, segments in (("fit", declared.segments.fit), ("holdout", declared.segments.holdout)):
        for segment in segments or ():
            if segment[0] <= last_s and segment[1] >= first_s:
                overlapping.setdefault(name, []).append(segment)
    declared = declared.model_copy(update={"segments": Segments(**overlapping)})
    conditions = Conditions(
        {name: v for name, v in flown.items() if name in {*DESCRIPTIONS, *record.conditions.columns}}
    )
    return make_record(
        declared, conditions, measured, record.ratio_table, record.declared.control_point, record.turbulent
    )


def link_of(journal: str | os.PathLike[str], *, root: str | os.PathLike[str] | None = None) -> Link:
    """The link that wrote a journal, as it was declared then.

    raises : InputError where the journal cannot be read, or the vehicle or records are not where they were
    """
    head = read_head(journal)
    return make_link(head.link, head.path, root=root)


def to_record(
    journal: str | os.PathLike[str],
    out: str | os.PathLike[str],
    link: Link | None = None,
    *,
    root: str | os.PathLike[str] | None = None,
) -> tuple[dict[str, Record], list[str]]:
    """Close a journal as flight records in a directory; a single record goes into `out` itself.

    journal : directory of a link, or its journal
    link    : with the mapping to use, by default the one that wrote the journal
    returns : records by control point, and one line for each thing that was left out
    raises  : InputError where the journal holds no record
    """
    apart: list[str] = []
    if link is None:
        link = link_of(journal, root=root)
    else:
        apart = _checked_sources(journal, link)
    longest, notes = longest_stretch(samples_of(journal, link), link)
    notes = [*apart, *damage_of(journal), *notes]
    records = records_of(link, longest)
    for point in link.points:
        read = records[point.name].sensors if point.name in records else []
        names = [s.name for s in read]
        absent = [s.name for s in point.sensors if s.name not in names]
        if absent:
            notes.append(f"{point.name}: no reading of {', '.join(absent)} came; left out")
    write_records(records, out, "live", [journal_file(journal), link.path])
    return records, notes


def _checked_sources(journal: str | os.PathLike[str], link: Link) -> list[str]:
    """A line where a link reads messages in another way than the one that wrote a journal; one of other sources is
    refused.

    A journal whose header is damaged does not tell.
    """
    try:
        head = read_head(journal)
    except InputError:
        return []
    declared = head.link.get("source") or []
    kinds = [
        ["json-lines" if k == "replay" else k for k in sources]
        for sources in (
            [source.get("kind") for source in declared],
            [source.kind for source in link.declared.source],
        )
    ]
    if kinds[0] != kinds[1]:
        raise InputError(
            f"{display_path(link.path)}: its sources ({', '.join(kinds[1])}) are not those of "
            f"{display_path(journal_file(journal))} ({', '.join(kinds[0])}); name the link that wrote it, or none"
        )
    now = link.declared.model_dump(mode="json", exclude_unset=True), meaning(link)
    apart = [] if head.sent_again else differences((head.link, head.means), now)
    name = display_path(link.path)
    return [f"{name}: reads the journal in another way than the link that wrote it: {'; '.join(apart)}"] * bool(apart)


def write_records(
    records: Mapping[str, Record], out: str | os.PathLike[str], command: str, inputs: Sequence[str | Path]
) -> None:
    """Write records into a directory: a single one into itself, several into folders of their names."""
    with output_directory(out, command, inputs=[Path(p) for p in inputs]) as folder:
        for name, record in records.items():
            target = folder if len(records) == 1 else folder / name
            write_record(record, target, comment="Made by sim-heating live of what came over a link.")
