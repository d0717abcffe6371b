"""Tables that are no text: Parquet and Excel, old and new, by pandas, TDMS of LabVIEW by npTDMS."""

from __future__ import annotations

import re
from pathlib import Path

import pandas as pd

from sim_heating.base.errors import InputError
from sim_heating.base.files import display_path
from sim_heating.heating.recorded.cells.block import Block, cell_text, of_frame
from sim_heating.templates.loggers.layout_file import LoggerLayout

TDMS_UNITS = ("unit_string", "NI_UnitDescription")
"""Properties of a channel of a TDMS file that state its unit; the first that is there holds."""
KINDS = {b"PAR1": "parquet", b"PK\x03\x04": "xlsx", b"\xd0\xcf\x11\xe0": "xls", b"TDSm": "tdms"}
"""First bytes -> kind of file."""
LIBRARIES = {"parquet": "pyarrow", "xlsx": "openpyxl", "xls": "xlrd", "tdms": "nptdms"}


def kind_of_file(path: Path) -> str:
    """`parquet`, `xlsx`, `xls`, `tdms` by the first bytes; empty for a text."""
    try:
        with path.open("rb") as stream:
            return KINDS.get(stream.read(4), "")
    except OSError:
        return ""


def read_table(path: Path, kind: str, layout: LoggerLayout) -> Block | list[list[str]]:
    """The table of a file; rows of cells of a sheet, whose names are yet to be recognised.

    layout : its `sheet` is that of a workbook, or the group of a TDMS file; None where it has one alone
    raises : InputError, one line, where the library is absent, the file is damaged, or the sheet has to be chosen
    """
    try:
        if kind == "parquet":
            return _parquet(path)
        return _tdms(path, layout) if kind == "tdms" else _workbook(path, layout)
    except ImportError as error:
        named = re.search(r"dependency '([\w.-]+)'", str(error))  # of pandas, such as for a sheet of LibreOffice
        library = named[1] if named else LIBRARIES[kind]
        raise InputError(
            f"{display_path(path)}: needs {library}; pip install {library}, or export a CSV file"
        ) from None
    except InputError:
        raise
    except Exception as error:  # each library has its own
        line = " ".join(str(error).split())[:120]
        raise InputError(f"{display_path(path)}: cannot be read as {kind} ({line}); export a CSV file") from None


def _parquet(path: Path) -> Block:
    frame = pd.read_parquet(path)
    if frame.index.name is not None or isinstance(frame.index, pd.DatetimeIndex):
        frame = frame.rename_axis(str(frame.index.name or "time")).reset_index()
    return of_frame(path, frame, {}, "Parquet", 1)


def _workbook(path: Path, layout: LoggerLayout) -> list[list[str]]:
    sheets = {
        name: table
        for name, table in pd.read_excel(path, sheet_name=None, header=None, dtype=object).items()
        if table.size
    }
    name = chosen_name(path, "sheet", [str(s) for s in sheets], layout)
    return [[cell_text(v) for v in row] for row in sheets[name].itertuples(index=False)]


def _tdms(path: Path, layout: LoggerLayout) -> Block:
    from nptdms import TdmsFile

    read = TdmsFile.read(str(path))
    groups = {g.name: g for g in read.groups() if any(map(len, g.channels()))}
    channels = groups[chosen_name(path, "group", list(groups), layout)].channels()
    columns: dict[str, object] = {}
    units: dict[str, str] = {}
    steps = {float(c.properties["wf_increment"]) for c in channels if c.properties.get("wf_increment")}
    lengths = set(map(len, channels))
    if len(lengths) > 1 or len(steps) > 1:
        raise InputError(f"{display_path(path)}: the channels of the group differ in length or rate; export one rate")
    if steps:
        step, offset = steps.pop(), float(channels[0].properties.get("wf_start_offset", 0.0))
        columns["time"] = [offset + step * i for i in range(lengths.pop())]
        units["time"] = "s"
    for channel in channels:
        columns[channel.name] = channel[:]
        stated = filter(None, map(channel.properties.get, TDMS_UNITS))
        units[channel.name] = str(next(stated, ""))
    return of_frame(path, pd.DataFrame(columns), units, "TDMS", 1)


def chosen_name(path: Path, kind: str, names: list[str], layout: LoggerLayout) -> str:
    """The name that the `sheet` of a layout chooses, or the only one; `kind` it is a name of, in words.

    raises : InputError, one line with the names, where there is no such name, or none was chosen of several
    """
    chosen = layout.sheet
    if chosen is not None and chosen not in names:
        raise InputError(
            f"{layout.place('sheet')}: there is no such {kind} in {display_path(path)}; it has {', '.join(names)}"
        )
    if chosen is None and len(names) != 1:
        listed = ", ".join(names) or "none with cells"
        raise InputError(f"{display_path(path)}: has {len(names)} {kind}s ({listed}); choose one, --sheet NAME")
    return chosen if chosen is not None else names[0]
