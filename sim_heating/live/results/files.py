"""Results of a link: live.json with the last state and all remarks, report.html, and the flight as records."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from sim_heating.base.errors import InputError
from sim_heating.base.files import output_directory, write_json
from sim_heating.base.files.package import package_version
from sim_heating.inputs.record import DECLARATION, Record, write_record
from sim_heating.live.engine import LinkEngine
from sim_heating.live.recording.journal import NAME, damage_of
from sim_heating.live.recording.to_record import RECORDS, longest_stretch, records_of, samples_of
from sim_heating.live.spec import Link
from sim_heating.live.state import State, plain

FORMAT, COMMAND = "live/1", "live"
RESULT, PAGE = "live.json", "report.html"


def inputs_of(link: Link) -> list[Path]:
    """Files and directories that a link reads."""
    inputs = [link.path, *(Path(record.directory) for record in link.records.values())]
    if link.vehicle is not None:
        inputs.append(Path(link.vehicle.directory))
    if link.scenario is not None:
        inputs += [Path(file) for file in link.scenario.files]
    for source in link.declared.source:
        for key in ("file", "xtce", "record"):
            if (name := getattr(source, key, None)) is not None:
                inputs.append(link.file(name, f"[[source]]: `{key}`"))
    return inputs


def expected_files(link: Link) -> list[str]:
    """Names of the results of a link, its records among them."""
    names = [DECLARATION, "conditions.csv", "thermocouples.csv", "ratio_table.csv"]
    return [RESULT, PAGE, *(f"{RECORDS}/{point}/{name}" for point in link.names for name in names)]


def summary(engine: LinkEngine, state: State, credibility: Mapping[str, Any] | None) -> dict[str, Any]:
    """Contents of live.json: what came, the last state, all remarks, and what supports the estimates."""
    return {
        "format": FORMAT,
        "title": engine.link.title,
        "control_points": list(engine.link.names),
        "counts": dict(engine.counts),
        "state": plain(state),
        "remarks": engine.remarks.lines(),
        "program": f"sim-heating {package_version()}",
        "credibility": credibility,
    }


def write_results(engine: LinkEngine, state: State, out: str | os.PathLike[str]) -> tuple[list[str], list[str]]:
    """Write the results of a link that has ended into the directory of its journal.

    returns : names of the files and folders, and one line for each thing that could not be made
    """
    from sim_heating.base.report.page import write_page  # matplotlib is slow to import
    from sim_heating.live.results.credibility import credibility_of_link
    from sim_heating.live.results.report import live_page

    notes: list[str] = []
    records: dict[str, Record] = {}
    journal = Path(out) / NAME
    with output_directory(out, COMMAND, inputs=inputs_of(engine.link)) as folder:
        try:
            stretch, left_out = longest_stretch(samples_of(journal, engine.link), engine.link)
            notes += [*damage_of(journal), *left_out]
            records = records_of(engine.link, stretch)
        except InputError as error:
            notes += [f"no record: {line}" for line in error.problems]
        supported = None
        try:
            supported = credibility_of_link(engine, state, records, {NAME: journal, "link": engine.link.path}).as_json()
        except InputError as error:  # of a vehicle or a record that is no longer where it was
            notes += [f"no credibility statement: {line}" for line in error.problems]
        write_json(folder / RESULT, summary(engine, state, supported))
        write_page(folder / PAGE, lambda: live_page(engine, state, supported))
        for name, record in records.items():
            comment = "Made by sim-heating live of what came over a link."
            write_record(record, folder / RECORDS / name, comment=comment)
        names = sorted(p.name for p in folder.iterdir() if not p.name.startswith("."))
    return names, notes
