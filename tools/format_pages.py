"""The JSON Schemas in sim_heating/schemas and the pages in docs/reference/formats, from the models that read the files:

python -m tools.format_pages

It also writes the line `#:schema PATH` into every shipped TOML file that has none, or another one. With `--examples` it
first makes the examples of result files again, by `estimate` and `close-loop` on practice records.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
import tomllib
from pathlib import Path

from sim_heating.base.files import write_text_atomic
from sim_heating.base.files.schema import SCHEMAS, schema_line, schema_path
from sim_heating.cli import main as sim_heating
from sim_heating.formats.catalogue import FORMATS, ModelFormat, format_named, formats_with_schema
from sim_heating.formats.schema_files import schema_text
from tools.format_markdown import format_page, index_page, limits_page

ROOT = Path(__file__).resolve().parents[1]
PAGES = ROOT / "docs" / "reference" / "formats"
MARK = "#:schema "
RECORDS = "scenarios/records/practice"
RESULTS = {
    "estimate": ["estimate", f"{RECORDS}/p06", "--parameters", "ratio.scale,ratio.d_alpha"],
    "closure": ["close-loop", f"{RECORDS}/p08"],
}
"""Format of a result file -> command that writes its example."""


def pages() -> dict[Path, str]:
    """Path -> contents of each schema and page."""
    examples = {f.example: (ROOT / f.example).read_text() for f in FORMATS if f.example is not None}
    found = {schema_path(f.name): schema_text(f) for f in formats_with_schema()}
    found |= {PAGES / f"{f.name}.md": format_page(f, examples) for f in FORMATS}
    return found | {PAGES / "index.md": index_page(), PAGES / "limits.md": limits_page()}


def shipped_files() -> dict[Path, ModelFormat]:
    """Shipped TOML file -> its format."""
    found: dict[Path, ModelFormat] = {}
    named = {f.name: f for f in formats_with_schema()}
    for declared in named.values():
        for path in sorted(p for pattern in declared.files for p in ROOT.glob(pattern)):
            data = tomllib.loads(path.read_text())
            if data.get("format") == "optimal-entry/1":
                found[path] = named["optimal_entry"]
            elif "based_on" in data:
                found[path] = named["derived_material"]
            else:
                found[path] = declared
    return found


def with_schema_line(text: str, line: str) -> str:
    """The text of a TOML file with the line at its beginning, in place of another one."""
    return line + "\n" + (text.partition("\n")[2] if text.startswith(MARK) else text)


def make_examples() -> None:
    """Run the commands of RESULTS in the repository's root and keep the files that they write."""
    for name, command in RESULTS.items():
        declared = format_named(name)
        with tempfile.TemporaryDirectory() as folder:
            if status := sim_heating([*command, "--out", folder]):
                raise SystemExit(status)
            shutil.copy(Path(folder) / declared.file, ROOT / str(declared.example))


def main() -> None:
    """Write everything that differs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--examples", action="store_true", help="make the examples of result files first; a minute")
    if parser.parse_args().examples:
        make_examples()
    SCHEMAS.mkdir(exist_ok=True)
    PAGES.mkdir(parents=True, exist_ok=True)
    lines = {path: schema_line(declared.name, path.parent) for path, declared in shipped_files().items()}
    _write({path: with_schema_line(path.read_text(), line) for path, line in lines.items()})
    _write(pages())  # after the files, which they show as examples


def _write(texts: dict[Path, str]) -> None:
    for path, text in texts.items():
        if not path.exists() or path.read_text() != text:
            write_text_atomic(path, text)
            print(path.relative_to(ROOT))


if __name__ == "__main__":
    main()
