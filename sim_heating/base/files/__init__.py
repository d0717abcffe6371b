"""Reading and writing files: inputs are checked completely, outputs are written whole or not at all.

A problem is one line with file, place, value and rule: `record.toml, [thermocouples.sensor] 2: unknown key ...` or
`conditions.csv, row 14, column mach: ...`, where a row is a line of the file as an editor counts them. All problems of
a file are reported at once.
"""

from sim_heating.base.files.csv_table import COLDEST_K, CsvTable, celsius_rule, csv_text, read_csv_columns, write_csv
from sim_heating.base.files.paths import display_path, file_digest, text_digest
from sim_heating.base.files.provenance import PROVENANCE, provenance_attributes, with_provenance
from sim_heating.base.files.results import (
    DIGEST,
    MARKER,
    OR_FORCE,
    all_files_written,
    digest_matches,
    files_written,
    finite_or_none,
    json_text,
    output_directory,
    read_json,
    replaces_others,
    replacing_others,
    require_writable,
    results_digest,
    with_digest,
    write_json,
    write_own_files,
)
from sim_heating.base.files.roots import FileOfFolder, Roots, path_below, roots_of
from sim_heating.base.files.text import (
    nearest_name,
    plain_number,
    raise_problems,
    raw_text,
    read_text,
    repeated_name,
    suggestion,
    write_text_atomic,
)
from sim_heating.base.files.toml import (
    Convertible,
    Declared,
    Extensible,
    LocatedError,
    Location,
    check,
    known_keys,
    raise_located,
    read_toml,
    read_toml_dict,
    toml_text,
)
from sim_heating.base.files.transaction import exclusive, replace_files, require_exclusive, settle, settle_below

__all__ = [
    "COLDEST_K", "DIGEST", "MARKER", "OR_FORCE", "PROVENANCE", "Convertible", "CsvTable", "Declared", "Extensible",
    "FileOfFolder", "LocatedError", "Location", "Roots", "all_files_written", "celsius_rule", "check", "csv_text",
    "digest_matches", "display_path", "exclusive", "file_digest", "files_written", "finite_or_none", "json_text",
    "known_keys", "nearest_name", "output_directory", "path_below", "plain_number", "provenance_attributes",
    "raise_located", "raise_problems", "raw_text", "read_csv_columns", "read_json", "read_text", "read_toml",
    "read_toml_dict", "repeated_name", "replace_files", "replaces_others", "replacing_others", "require_exclusive",
    "require_writable", "results_digest", "roots_of", "settle", "settle_below", "suggestion",
    "text_digest", "toml_text", "with_digest", "with_provenance", "write_csv", "write_json", "write_own_files",
    "write_text_atomic",
]  # fmt: skip
