"""Damage to the bytes, keys, numbers, columns and members of a file, drawn at random from a seed.

The kinds follow what happens to files: cut or corrupted in transfer, edited by hand, exported by another program,
written in other units, or written by someone hostile.
"""

from __future__ import annotations

import copy
import csv
import io
import json
import random
import re
import tomllib
import warnings
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Any
from xml.etree import ElementTree

import tomlkit

UNIT_SLIPS = (1e3, 1e-3, 1e6, 1e-6)
"""Factors between units that are mistaken for one another."""
NUMBERS = (float("nan"), float("inf"), float("-inf"), 0.0, -1.0, 1e-308, 1e30, 1e308, -1e308, 5e-324, 2**63, 10**400)
TEXTS = (
    "",
    " ",
    "x" * 5000,
    "\u00e9\u4e2d\U0001f680",
    "\u202eabc",
    "$\\frac{$",
    "$$",
    "$x^$",
    "a_b^c$",
    "<script>alert(1)</script>",
    "[red]x[/red",
    "javascript:alert(1)",
    "\"'&;",
    "../../../etc/passwd",
    "/etc/passwd",
    "C:\\x",
    "~",
    "\x1b[31m",
    "a\nb",
    "a\tb",
    "\x00",
    "nan",
    "1e999",
    "1,5",
    "\uff11\uff12",
    "%s%n",
    "{0}",
    "__proto__",
    ".",
    "/",
    "CON",
    "=1+1",
    "None",
    "true",
)
HOSTILE_CELLS = (
    "",
    "nan",
    "inf",
    "-inf",
    "1e999",
    "-1",
    "0",
    "1e30",
    "1e-30",
    "x",
    "1,5",
    "1_0",
    "\uff11\uff12",
    "0x10",
    "--1",
    "<b>",
    "$x^$",
    "=1+1",
    "'",
    '"',
)


@dataclass(frozen=True)
class Damage:
    """One change of a file.

    kind     : name of the operation
    what     : what it did, for a person
    content  : bytes of the file afterwards
    quantity : the number that was scaled, "" where none was
    factor   : its factor
    """

    kind: str
    what: str
    content: bytes
    quantity: str = ""
    factor: float = 1.0


Operation = Callable[[bytes, random.Random], Damage]


def damage(name: str, content: bytes, rng: random.Random) -> Damage:
    """A damaged version of a file, by the format that its name states; plain text where it is of no known one."""
    suffix = PurePosixPath(name).suffix
    structured = {
        ".toml": _toml,
        ".json": _json,
        ".csv": _csv,
        ".jsonl": _message,
        ".xml": _xml,
        ".dml": _xml,
        ".fmu": _archive,
        ".py": _source,
    }.get(suffix)
    operations = [rng.choice(TEXT_OPERATIONS)]
    if structured is not None and rng.random() < 0.75:
        operations = [structured]
    for _ in range(8):  # some operations find nothing to change in some files
        try:
            done = operations[0](content, rng)
        except (ValueError, IndexError, ElementTree.ParseError):  # of a structure that the file does not have
            continue
        if done.content != content:
            return done
    return cut(content, rng)


# text


def cut(content: bytes, rng: random.Random) -> Damage:
    """The file ends early."""
    end = rng.randrange(len(content))
    return Damage("cut", f"cut after {end} of {len(content)} bytes", content[:end])


def _flip(content: bytes, rng: random.Random) -> Damage:
    data, count = bytearray(content), rng.choice((1, 1, 1, 3, 30))
    places = [rng.randrange(len(data)) for _ in range(count)]
    for place in places:
        data[place] ^= 1 << rng.randrange(8)
    return Damage("flip bits", f"one bit changed in bytes {places[:5]}", bytes(data))


def _drop(content: bytes, rng: random.Random) -> Damage:
    begin = rng.randrange(len(content))
    end = begin + rng.choice((1, 1, 2, 10, 200))
    return Damage("drop bytes", f"bytes {begin} to {end} missing", content[:begin] + content[end:])


def _insert(content: bytes, rng: random.Random) -> Damage:
    place = rng.randrange(len(content) + 1)
    pieces = (
        b"\0",
        b"\xff",
        b"\xef\xbb\xbf",
        b"\x1b[2J",
        b"\xc3\xa9",
        b"\x85",
        b"\xe2\x80\xa8",
        b"\r",
        b'"',
        b"#",
        b"\xc2\xa0",
        b"<",
        b"[[",
    )
    piece = rng.choice(pieces)
    return Damage("insert bytes", f"{piece!r} put in at byte {place}", content[:place] + piece + content[place:])


def _lines(content: bytes, rng: random.Random) -> Damage:
    lines = content.split(b"\n")
    i, k = rng.randrange(len(lines)), rng.randrange(len(lines))
    how = rng.choice(("swap", "double", "delete", "move"))
    if how == "swap":
        lines[i], lines[k] = lines[k], lines[i]
    elif how == "double":
        lines.insert(k, lines[i])
    elif how == "delete":
        del lines[i : i + rng.choice((1, 1, 5))]
    else:
        lines.insert(k, lines.pop(i))
    return Damage(f"{how} lines", f"{how} lines {i + 1}, {k + 1}", b"\n".join(lines))


def _encode(content: bytes, rng: random.Random) -> Damage:
    text = content.decode("utf-8", errors="replace")
    how = rng.choice(("utf-16", "utf-8-sig", "latin-1", "utf-32", "crlf", "cr", "utf-7"))
    if how in ("crlf", "cr"):
        data = content.replace(b"\n", b"\r\n" if how == "crlf" else b"\r")
    else:
        data = ("# \u00e9\n" + text if how == "latin-1" else text).encode(how, errors="replace")
    return Damage("encode", f"written as {how}", data)


def _replace(content: bytes, rng: random.Random) -> Damage:
    what = rng.choice(
        (b"", b" \n", b"\n" * 100, content * 2, b"\0" * 64, bytes(rng.randbytes(200)), b"[" * 20_000, b"{" * 20_000)
    )
    return Damage("replace", f"replaced by {len(what)} bytes, {what[:10]!r} ...", what)


def _digits(content: bytes, rng: random.Random) -> Damage:
    found = list(re.finditer(rb"-?\d+(\.\d+)?([eE][-+]?\d+)?", content))
    m = rng.choice(found)
    old = m[0]
    new = rng.choice(
        (
            b"-" + old,
            old.replace(b".", b","),
            old.replace(b".", b"", 1),
            old[:-1],
            old + b"0",
            old + b".5",
            b"1e999",
            b"nan",
            "\uff11\uff12".encode(),
            b"0" + old,
            old + b"e5",
            b"0x1F",
            b"1_000",
            old[::-1],
            b"",
            b"- " + old,
        )
    )
    what = f"{old.decode()} became {new.decode()!r}"
    return Damage("number as text", what, content[: m.start()] + new + content[m.end() :])


def _characters(content: bytes, rng: random.Random) -> Damage:
    place = rng.randrange(len(content) - 1)
    data = bytearray(content)
    data[place], data[place + 1] = data[place + 1], data[place]
    return Damage("swap characters", f"bytes {place} and {place + 1} swapped", bytes(data))


def _name(content: bytes, rng: random.Random) -> Damage:
    text = content.decode("utf-8", errors="strict")
    m = rng.choice(list(re.finditer(r"[A-Za-z_][A-Za-z_0-9-]{2,}", text)))
    new = rng.choice((m[0][:-1], m[0].upper(), m[0][::-1], m[0] + "x", "", rng.choice(TEXTS)))
    data = (text[: m.start()] + new + text[m.end() :]).encode("utf-8", errors="replace")
    return Damage("word", f"{m[0]} became {new[:40]!r}", data)


TEXT_OPERATIONS: tuple[Operation, ...] = (
    cut,
    _flip,
    _drop,
    _insert,
    _lines,
    _lines,
    _encode,
    _replace,
    _digits,
    _digits,
    _characters,
    _name,
)


# tables of keys: TOML and JSON


def _toml(content: bytes, rng: random.Random) -> Damage:
    data = tomllib.loads(content.decode())
    kind, what, quantity, factor = _change(data, rng)
    return Damage(kind, what, tomlkit.dumps(data).encode("utf-8", errors="replace"), quantity, factor)


def _json(content: bytes, rng: random.Random) -> Damage:
    data = json.loads(content)
    kind, what, quantity, factor = _change(data, rng)
    return Damage(kind, what, json.dumps(data, indent=1).encode("utf-8", errors="replace"), quantity, factor)


def _message(content: bytes, rng: random.Random) -> Damage:
    lines = content.splitlines()
    i = rng.randrange(len(lines))
    done = _json(lines[i], rng)
    lines[i] = json.dumps(json.loads(done.content)).encode("utf-8", errors="replace")
    what = f"line {i + 1}: {done.what}"
    return Damage(done.kind, what, b"".join(line + b"\n" for line in lines), done.quantity, done.factor)


Place = tuple[str | int, ...]


def _places(node: Any, place: Place = ()) -> Iterator[tuple[Any, str | int, Place]]:
    """(container, key, place) of all values below a node."""
    items = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
    for key, value in items:
        yield node, key, (*place, key)
        yield from _places(value, (*place, key))


def _change(data: dict[str, Any], rng: random.Random) -> tuple[str, str, str, float]:
    """Change one value or key in place; what was done."""
    found = list(_places(data))
    kind = rng.choice(
        (
            "remove",
            "rename",
            "type",
            "number",
            "number",
            "scale",
            "scale",
            "text",
            "text",
            "list",
            "copy",
            "move",
            "add",
        )
    )
    if kind in ("number", "scale"):
        found = [f for f in found if _is_number(f[0][f[1]])]
    if kind == "text":
        found = [f for f in found if isinstance(f[0][f[1]], str)]
    if kind == "list":
        found = [f for f in found if isinstance(f[0][f[1]], list) and f[0][f[1]]]
    if kind == "rename":
        found = [f for f in found if isinstance(f[0], dict)]
    # a table of thousands of numbers counts as one value among the others
    by_name: dict[Place, list[tuple[Any, str | int, Place]]] = {}
    for f in found:
        by_name.setdefault(tuple(p for p in f[2] if isinstance(p, str)), []).append(f)
    names = sorted(by_name, key=str)
    if not names:
        raise ValueError("nothing of this kind")
    node, key, place = rng.choice(by_name[rng.choice(names)])
    at = ".".join(map(str, place))
    old = node[key]
    quantity, factor = "", 1.0
    if kind == "remove":
        del node[key]
    elif kind == "rename":
        name = str(key)
        node[rng.choice((name[:-1], name.upper(), name + "s", name.replace("_", "-"), rng.choice(TEXTS)))] = node.pop(
            key
        )
    elif kind == "type":
        node[key] = rng.choice(
            (True, 7, "text", [], {}, [1.0], ["a", 1], {"a": 1}, [[1.0, 2.0]], [old], {"value": old}, str(old))
        )
    elif kind == "number":
        node[key] = rng.choice((*NUMBERS, -old, not old, str(old), int(old) if abs(old) < 1e300 else 0))
    elif kind == "scale":
        factor = rng.choice(UNIT_SLIPS)
        node[key], quantity = type(old)(old * factor), ".".join(p for p in place if isinstance(p, str))
    elif kind == "text":
        node[key] = rng.choice((*TEXTS, old[:-1], old.upper(), old + old, old.replace(" ", "")))
    elif kind == "list":
        node[key] = rng.choice((old[:-1], old[1:], old[::-1], old * 2, [*old, old[0]], [old], old * 400, []))
    elif kind == "copy":
        _, _, other = rng.choice(list(_places(data)))
        node[key] = copy.deepcopy(_value(data, other))
    elif kind == "move":
        _, _, other = rng.choice(list(_places(data)))
        target = _value(data, other)
        (target if isinstance(target, dict) else data)[str(key)] = node.pop(key)
    else:
        target = old if isinstance(old, dict) else data
        target[rng.choice(("new", "title", "note", *TEXTS))] = rng.choice((1, 1.5, "x", [], {}))
    remains = key in node if isinstance(node, dict) else isinstance(key, int) and key < len(node)
    if kind == "move" or not remains:
        return f"{kind} of a key", f"{kind} {at}", quantity, factor
    return f"{kind} of a key", f"{kind} {at}: {str(old)[:40]} became {str(node[key])[:40]}", quantity, factor


def _value(data: Any, place: Place) -> Any:
    for part in place:
        data = data[part]
    return data


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


# CSV


def _csv(content: bytes, rng: random.Random) -> Damage:
    lines = content.decode().splitlines()
    first = next(i for i, line in enumerate(lines) if not line.startswith("#"))
    rows = list(csv.reader(lines[first:]))
    names, body = rows[0], rows[1:]
    kind = rng.choice(
        (
            "missing column",
            "double column",
            "swap columns",
            "rename column",
            "swap names",
            "cell",
            "cell",
            "scale cell",
            "scale column",
            "scale column",
            "swap rows",
            "double row",
            "drop rows",
            "short row",
            "long row",
            "one row",
            "no rows",
            "sign",
            "shift",
            "constant",
            "separator",
            "comments",
        )
    )
    i, k = rng.randrange(len(names)), rng.randrange(len(names))
    r, s = rng.randrange(len(body)), rng.randrange(len(body))
    quantity, factor, separator = "", 1.0, ","
    what = f"{names[i]}, row {first + r + 2}"
    if kind == "missing column":
        for row in rows:
            del row[i]
    elif kind == "double column":
        for row in rows:
            row.append(row[i])
    elif kind == "swap columns":
        what = f"{names[i]}, {names[k]}"
        for row in body:
            row[i], row[k] = row[k], row[i]
    elif kind == "swap names":
        what = f"{names[i]}, {names[k]}"
        names[i], names[k] = names[k], names[i]
    elif kind == "rename column":
        names[i] = rng.choice((names[i][:-1], names[i].upper(), f" {names[i]} ", "", "mach", rng.choice(TEXTS)))
        what += f" became {names[i][:40]!r}"
    elif kind == "cell":
        body[r][i] = rng.choice((*HOSTILE_CELLS, rng.choice(TEXTS)))
        what += f" became {body[r][i][:40]!r}"
    elif kind in ("scale cell", "scale column"):
        factor, quantity = rng.choice(UNIT_SLIPS), names[i] + (" (one cell)" if kind == "scale cell" else "")
        for row in [body[r]] if kind == "scale cell" else body:
            row[i] = repr(float(row[i]) * factor) if row[i] else ""
        what += f" times {factor:g}"
    elif kind == "swap rows":
        body[r], body[s] = body[s], body[r]
    elif kind == "double row":
        body.insert(s, list(body[r]))
    elif kind == "drop rows":
        del body[r : r + rng.choice((1, 10, 10_000))]
    elif kind == "short row":
        del body[r][i]
    elif kind == "long row":
        body[r].append("1.0")
    elif kind == "one row":
        body = body[r : r + 1]
    elif kind == "no rows":
        body = []
    elif kind == "sign":
        for row in body:
            row[i] = row[i][1:] if row[i].startswith("-") else f"-{row[i]}"
    elif kind == "shift":
        for row in body:
            row[i] = repr(float(row[i]) + rng.choice((-273.15, -1e4, 1e4))) if row[i] else ""
    elif kind == "constant":
        for row in body:
            row[i] = body[r][i]
    elif kind == "separator":
        separator = rng.choice((";", "\t", " ", "|"))
    else:
        lines[:first] = [f"# {rng.choice(TEXTS)}: {rng.choice(TEXTS)}".replace("\n", " ") for _ in range(3)]
        first = 3
    stream = io.StringIO()
    csv.writer(stream, lineterminator="\n", delimiter=separator).writerows([names, *body])
    text = "".join(f"{line}\n" for line in lines[:first]) + stream.getvalue()
    return Damage(kind, f"{kind}: {what}", text.encode("utf-8", errors="replace"), quantity, factor)


# XML


def _xml(content: bytes, rng: random.Random) -> Damage:
    root = ElementTree.fromstring(content)
    parents = [(parent, child) for parent in root.iter() for child in parent]
    parent, one = rng.choice(parents)
    kind = rng.choice(
        (
            "remove",
            "double",
            "rename",
            "attribute",
            "attribute",
            "no attribute",
            "text",
            "text",
            "number",
            "scale",
            "swap",
            "move",
            "many",
        )
    )
    what, quantity, factor = one.tag, "", 1.0
    if kind == "remove":
        parent.remove(one)
    elif kind == "double":
        parent.append(copy.deepcopy(one))
    elif kind == "rename":
        one.tag = rng.choice((one.tag + "x", one.tag.upper(), "function", "table", "Float64", "Real"))
    elif kind in ("attribute", "no attribute"):
        element = rng.choice([e for e in root.iter() if e.attrib])
        name = rng.choice(sorted(element.attrib))
        if kind == "no attribute":
            del element.attrib[name]
        else:
            hostile = (*(t for t in TEXTS if t.isprintable()), "0", "-1", "99999", "1e999", "nan", "false", "2.5")
            element.set(name, rng.choice(hostile))
        what = f"{element.tag} {name}={element.get(name, '')[:40]!r}"
    elif kind in ("text", "number", "scale"):
        element = rng.choice([e for e in root.iter() if (e.text or "").strip()])
        old, factor = (element.text or "").split(), rng.choice(UNIT_SLIPS)
        at = rng.randrange(len(old))
        if kind == "text":
            old[at] = rng.choice(
                ("", "x", "aero/alpha-deg", "-", "1,5", "a/b/c", *(t for t in TEXTS if t.isprintable()))
            )
        elif kind == "number":
            old[at] = rng.choice(("nan", "inf", "1e308", "-1e308", "0", "-1", "1e-308", "1e999"))
        else:
            old[at], quantity = repr(float(old[at]) * factor), element.tag
        element.text = " ".join(old)
        what = f"{element.tag}: {element.text[:40]!r}"
    elif kind == "swap":
        _, other = rng.choice(parents)
        one.attrib, other.attrib = dict(other.attrib), dict(one.attrib)
        one.text, other.text = other.text, one.text
    elif kind == "move":
        parent.remove(one)
        root.insert(rng.randrange(len(root) + 1), one)
    else:
        parent.extend(copy.deepcopy(one) for _ in range(300))
    return Damage(f"{kind} in XML", f"{kind} {what}", ElementTree.tostring(root), quantity, factor)


# archives and source


def _archive(content: bytes, rng: random.Random) -> Damage:
    with zipfile.ZipFile(io.BytesIO(content)) as whole:
        members = {info.filename: whole.read(info) for info in whole.infolist()}
    name = rng.choice(sorted(members))
    kind = rng.choice(
        (
            "description",
            "description",
            "description",
            "description",
            "drop",
            "empty",
            "rename",
            "escape",
            "double",
            "member",
            "nested",
        )
    )
    what = name
    if kind == "description":
        inner = damage("modelDescription.xml", members["modelDescription.xml"], rng)
        members["modelDescription.xml"], what = inner.content, inner.what
    elif kind == "drop":
        del members[name]
    elif kind == "empty":
        members[name] = b""
    elif kind == "rename":
        members[rng.choice((name.upper(), name + "x", "resources/" + name, name.split("/")[-1]))] = members.pop(name)
    elif kind == "escape":
        what = rng.choice(("../../escaped", "/tmp/escaped_by_fmu", "a/../../../b", "..\\..\\escaped", "C:\\escaped"))
        members[what] = b"x"
    elif kind == "member":
        if name.endswith(".xml"):
            raise ValueError("another kind")
        half = members[name][: len(members[name]) // 2]
        members[name] = damage("plain", members[name], rng).content if rng.random() < 0.5 else half
    elif kind == "nested":
        below = {f"in/{n}": c for n, c in members.items()}
        members = {"modelDescription.xml/x": b"x", **members} if rng.random() < 0.5 else below
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for member, data in members.items():
            archive.writestr(zipfile.ZipInfo(member), data)
        if kind == "double":
            with warnings.catch_warnings(action="ignore"):
                archive.writestr(zipfile.ZipInfo(name), members[name][: len(members[name]) // 2])
    return Damage(f"{kind} in archive", f"{kind}: {what}", stream.getvalue())


def _source(content: bytes, rng: random.Random) -> Damage:
    """A Python file: an argument or line removed, a number or name replaced."""
    text = content.decode()
    kind = rng.choice(("argument", "value", "statement", "name", "scale"))
    quantity, factor = "", 1.0
    if kind == "argument":
        m = rng.choice(list(re.finditer(r"^    (\w+)=(.*),$", text, re.MULTILINE)))
        new = rng.choice(
            (
                "",
                f"    {m[1]}x={m[2]},",
                f"    {m[1]}=None,",
                f"    {m[1]}=1.5,",
                f"    {m[1]}='<b>$x^$',",
                f"    {m[1]}=(),",
                f"    {m[1]}=[],",
            )
        )
    elif kind in ("value", "scale"):
        m = rng.choice(list(re.finditer(r"(?<=[ (])-?\d+\.\d+", text)))
        new, factor = (
            rng.choice(("float('nan')", "float('inf')", "-1.0", "0.0", "1e308", "'1'", "None", "1/0")),
            rng.choice(UNIT_SLIPS),
        )
        if kind == "scale":
            new, quantity = repr(float(m[0]) * factor), "a number of an effect"
    elif kind == "statement":
        statements = r"^( *)(import .*|from .*|def .*|return .*|u = .*|@.*|EFFECT.*)$"
        m = rng.choice(list(re.finditer(statements, text, re.MULTILINE)))
        bad = (
            "raise ValueError('x\\ny')",
            "raise SystemExit(3)",
            "import nowhere",
            "x = (",
            "print('x')",
            "1/0",
            "pass",
            "return",
            "raise BaseException('x')",
            "import sys; sys.exit('bye')",
            "assert False",
        )
        new = m[1] + rng.choice(bad)
    else:
        m = rng.choice(list(re.finditer(r"[A-Za-z_]{3,}", text)))
        new = m[0] + "x"
    done = text[: m.start()] + new + text[m.end() :]
    return Damage(f"{kind} in Python", f"{kind}: {m[0][:40]!r} became {new[:40]!r}", done.encode(), quantity, factor)
