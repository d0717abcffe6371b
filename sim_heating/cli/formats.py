"""The command `sim-heating formats`."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING

import click

from sim_heating.base.errors import InputError
from sim_heating.cli.console import CONSOLE, print_table
from sim_heating.cli.output import report_results

if TYPE_CHECKING:
    from sim_heating.base.report.table import Table
    from sim_heating.formats.key_tables import KeyTable


@click.command()
@click.argument("name", required=False)
@click.option("--schema", "as_schema", is_flag=True, help="print the JSON Schema of the format")
def formats(name: str | None, as_schema: bool) -> None:
    """List the file formats, or the keys of the format NAME with their units, ranges and defaults.

    Example: sim-heating formats record
    """
    from sim_heating.formats.catalogue import ModelFormat, format_named
    from sim_heating.formats.key_tables import key_tables
    from sim_heating.formats.schema_files import schema, schema_text

    if name is None:
        if as_schema:
            raise InputError("--schema is of one format; give its name")
        _print_formats()
        return
    chosen = format_named(name)
    if as_schema:
        if not isinstance(chosen, ModelFormat):
            raise InputError(f"`{name}` has no JSON Schema; `sim-heating formats {name}` prints its columns or keys")
        CONSOLE.print(schema_text(chosen), end="", soft_wrap=True)
        report_results({"schema": schema(chosen)})
        return
    tables = key_tables(chosen)
    for table in tables:
        if table.keys:
            print_table(_keys(table, f"{table.heading or chosen.file}: {table.about or chosen.title}"))
    report_results({"file": chosen.file, "tables": [asdict(table) for table in tables]})


def _print_formats() -> None:
    from sim_heating.base.report.table import Column, Table
    from sim_heating.formats.catalogue import FORMATS

    columns = [Column(head, is_text=True) for head in ("name", "file", "what it is")]
    print_table(Table("File formats", columns, [(f.name, f.file, f.title) for f in FORMATS]))
    report_results({"formats": [{"name": f.name, "file": f.file, "title": f.title} for f in FORMATS]})


def _keys(table: KeyTable, title: str) -> Table:
    from sim_heating.base.report.table import Column, Table

    columns = [Column(head, is_text=True) for head in ("key", "value", "default", "meaning")]
    rows = [(k.name, k.value, "required" if k.required else k.default, k.description) for k in table.keys]
    return Table(title, columns, rows)
