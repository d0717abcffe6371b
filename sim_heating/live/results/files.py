"""Results of a link: live.json with the last state and all remarks, report.html, and the flight as records."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from sim_heating.base.errors import InputError
from sim_heating.base.files import output_directory, write_json
from sim_heating.base.files.package import package_version
from sim_heating.inputs.record import Record, write_record
from sim_heating.live.engine import LinkEngine
from sim_heating.live.recording.journal import NAME
from sim_heating.live.recording.to_record import RECORDS, longest_stretch, records_of, samples_of
from sim_heating.live.state import State, plain

FORMAT = "live/1"
RESULT, PAGE = "live.json", "report.html"


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
    with output_directory(out, "live", inputs=[engine.link.path]) as folder:
        try:
            stretch, left_out = longest_stretch(samples_of(journal, engine.link), engine.link)
            notes += left_out
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
