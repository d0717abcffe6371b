"""A page for each format in Markdown: its keys or columns with units, ranges and defaults, and a complete example."""

from __future__ import annotations

from collections.abc import Mapping

from sim_heating.base.errors import InputError
from sim_heating.base.limits import QUANTITIES, USUAL, quantity
from sim_heating.formats.catalogue import FORMATS, ColumnFormat, FileFormat, KeyFormat, ModelFormat
from sim_heating.formats.key_tables import KeyTable, key_tables

EXAMPLE_LINES = 120
"""Lines of an example that a page shows at most: of a longer CSV file the first 8."""


def format_page(declared: FileFormat, read: Mapping[str, str]) -> str:
    """The page of a format in Markdown.

    read : path below the repository -> contents, for the examples
    """
    lines = [f"# {declared.file}", "", _sentence(declared.title), ""]
    if declared.about:
        lines += [declared.about, ""]
    if isinstance(declared, ModelFormat):
        lines += _schema_words(declared)
    for table in key_tables(declared):
        lines += [f"## {table.heading}" if table.heading else f"## {_first_heading(declared)}", ""]
        lines += [] if not table.about else [table.about, ""]
        lines += _markdown(table, declared)
    lines += _example(declared, read)
    return "\n".join(lines).rstrip() + "\n"


def _first_heading(declared: FileFormat) -> str:
    return "Columns" if isinstance(declared, ColumnFormat) else "Keys"


def _sentence(text: str) -> str:
    return text[0].upper() + text[1:] + "."


def _schema_words(declared: ModelFormat) -> list[str]:
    sentences = [
        f"JSON Schema: `sim_heating/schemas/{declared.name}.schema.json`, printed by `sim-heating formats "
        f"{declared.name} --schema`."
    ]
    if declared.language == "toml":
        sentences.append(
            f"Editors that know TOML complete and check a file whose first line is `#:schema PATH`; files that "
            f"`sim-heating new` makes name `{declared.name}.schema.json` beside them, which the command above writes. "
            "An unknown key is an error that names the nearest known one."
        )
    return [" ".join(sentences), ""]


def _markdown(table: KeyTable, declared: FileFormat) -> list[str]:
    if not table.keys:
        return []
    if isinstance(declared, KeyFormat):
        return ["| key | |", "|---|---|", *(f"| `{k.name}` | {_cell(k.description)} |" for k in table.keys), ""]
    if isinstance(declared, ColumnFormat):
        rows = [f"| `{k.name}` | {'yes' if k.required else 'no'} | {_cell(k.description)} |" for k in table.keys]
        return ["| column | required | |", "|---|---|---|", *rows, ""]
    rows = [
        f"| `{k.name}` | {_cell(k.value)} | {'**required**' if k.required else k.default} | {_cell(k.description)} |"
        for k in table.keys
    ]
    return ["| key | value | default | |", "|---|---|---|---|", *rows, ""]


def _cell(text: str) -> str:
    return " ".join(text.replace("|", "\\|").split())


def _example(declared: FileFormat, read: Mapping[str, str]) -> list[str]:
    if declared.example is None:
        return []
    if declared.example not in read:
        raise InputError(f"{declared.example}: is not at hand; run this in a checkout")
    lines = read[declared.example].splitlines()
    cut = len(lines) > EXAMPLE_LINES
    shown = lines if not cut else lines[: 8 if isinstance(declared, ColumnFormat) else EXAMPLE_LINES]
    rest = [f"The first {len(shown)} of its {len(lines)} lines."] if cut else []
    language = "text" if isinstance(declared, ColumnFormat) else declared.file.rpartition(".")[2]
    return ["## Example", "", f"`{declared.example}`:", "", f"```{language}", *shown, "```", "", *rest]


def limits_page() -> str:
    """The page of the ranges of quantities: beyond the possible one a number is refused, beyond the usual one told."""
    rows = []
    for name in sorted({*QUANTITIES, *USUAL}):
        range_, usual = quantity(name), USUAL.get(name)
        possible = "" if range_ is None else f"{range_.lowest:g} to {range_.highest:g}"
        rows.append(
            f"| `{name}` | {possible} | "
            + ("|" if usual is None else f"{usual.lowest:g} to {usual.highest:g}")
            + (" |" if usual is None else f" | {usual.source} |")
        )
    text = (
        "# Ranges of quantities\n\nA number beyond the possible range of its key or column is refused. One beyond the "
        "usual range is accepted, and a warning tells it, also in `--json`; 0 stands for none. A key that is absent "
        "here has the range of the unit that it ends in. Columns of conditions are compared with one another and with "
        "the rows before and after them as well: `sim_heating.heating.recorded.plausible` states each relation.\n\n"
        "| key, column or quantity | possible | usual | the usual range rests on |\n|---|---|---|---|\n"
    )
    return text + "\n".join(rows) + "\n"


def index_page() -> str:
    """The page that lists all formats."""
    rows = [f"| [`{f.file}`]({f.name}.md) | {f.title} |" for f in FORMATS]
    text = (
        "# File formats\n\nAll numbers are in SI units and angles in degrees; a key or column ends in its unit. Files "
        "are UTF-8. `sim-heating validate PATH` checks those that people write, a flight by the scenario that names "
        "it, and reports every problem in one line with file, place and rule. `sim-heating formats NAME` prints the "
        "keys of a format. [Ranges of quantities](limits.md) states what is refused and what is told.\n\n"
        "| file | |\n|---|---|\n"
    )
    return text + "\n".join(rows) + "\n"
