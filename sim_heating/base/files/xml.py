"""XML that another library reads: what would crash or flood that library is found before."""

from __future__ import annotations

from pathlib import Path
from xml.parsers import expat

from sim_heating.base.errors import InputError, error_context
from sim_heating.base.files.paths import display_path, os_error_reason

DEEPEST = 100
"""Most elements within each other. Readers that call themselves for each one overflow their stack at some thousands."""
LARGEST_BYTES = 256 * 1024 * 1024


def check_xml(content: bytes, root: str | None = None, *, names_standard: bool = False) -> None:
    """Check that XML is well formed, flat enough to be read, and has no document type.

    root           : name of its first element; None for any
    names_standard : a document type that only names the one of a standard may stand there; nothing of it is read
    raises : InputError with the line, without the name of the file
    """
    parser = expat.ParserCreate()
    depth = 0

    def begin(tag: str, _: dict[str, str]) -> None:
        nonlocal depth
        depth += 1
        if depth == 1 and root is not None and tag != root:
            raise InputError(f"its root is `{tag[:40]}`, not `{root}`")
        if depth > DEEPEST:
            raise InputError(f"line {parser.CurrentLineNumber}: more than {DEEPEST} elements within each other")

    def end(_: str) -> None:
        nonlocal depth
        depth -= 1

    def document_type(_name: str, _system: str | None, _public: str | None, declares: int) -> None:
        if names_standard and not declares:
            return
        # Entities are defined there: one of a few lines becomes gigabytes, another one reads a file of this machine.
        raise InputError(f"line {parser.CurrentLineNumber}: a document type (<!DOCTYPE ...>) is not allowed; remove it")

    parser.StartElementHandler, parser.EndElementHandler = begin, end
    parser.StartDoctypeDeclHandler = document_type
    try:
        parser.Parse(content, True)
    except expat.ExpatError as error:
        raise InputError(f"line {error.lineno}: is not XML ({expat.ErrorString(error.code)})") from None


def read_xml(
    path: Path, root: str | None = None, largest_bytes: int = LARGEST_BYTES, *, names_standard: bool = False
) -> bytes:
    """The bytes of an XML file that has passed `check_xml`, which takes `root` and `names_standard`.

    raises : InputError, one line, where it cannot be read, is too large or does not pass
    """
    name = display_path(path)
    try:
        with path.open("rb") as file:
            content = file.read(largest_bytes + 1)
    except OSError as error:
        raise InputError(f"{name}: cannot be read ({os_error_reason(error)})") from None
    if len(content) > largest_bytes:
        raise InputError(f"{name}: is larger than {largest_bytes / 2**20:.0f} MiB")
    with error_context(name):
        check_xml(content, root, names_standard=names_standard)
    return content
