"""From the text of a logger to rows of cells: separator, rows of names and units, preamble, trailer."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

from sim_heating.base.errors import InputError
from sim_heating.base.files import display_path, read_text
from sim_heating.base.files.text import abbreviated
from sim_heating.base.files.units import converted, known_unit
from sim_heating.heating.recorded.cells.block import Block
from sim_heating.heating.recorded.cells.foam import foam_block, is_foam
from sim_heating.heating.recorded.cells.json_rows import is_json, json_block
from sim_heating.heating.recorded.cells.lists import list_block
from sim_heating.heating.recorded.cells.tecplot import is_tecplot, tecplot_block

FORMS = ((is_json, json_block), (is_tecplot, tecplot_block), (is_foam, foam_block))
"""What tells a form by its beginning, and reads it."""


def _with_colons(time: re.Match[str]) -> str:
    return ":".join(part for part in time.groups() if part)


WIDE = "  "
SEPARATORS = {"\t": "tabs", ";": "semicolons", "|": "bars", ",": "commas", WIDE: "wide blanks", " ": "blanks"}
"""In the order in which they are preferred: a comma may be a decimal sign, a blank stands in dates, and no two do."""
Row = tuple[int, Sequence[str]]
"""Line and cells; tuples, which the collector of garbage leaves alone, of a million rows."""
PLAIN = r"[+-]?(?:\d[\d.,'\u00a0\u202f]*|[.,]\d+)(?:[eE][+-]?\d+)?"
"""Pattern of a number with any signs."""
NUMBER_CELL = re.compile(rf"{PLAIN}\s*(?:[^\d\s.,;:/([-][^\d,;:([]{{0,15}}\d?|[([][^\d,;:()[\]]{{1,15}}[)\]])?")
"""A number, also with a unit behind it, such as `21.3 °C`; `1TC (degC)` is the name of a channel."""
CLOCK_CELL = re.compile(
    r"'?(?:[A-Za-z]{3,9},? )?(?:\d{1,4}[-/.](?:\d{1,2}|[A-Za-z]{3,9}\.?)[-/.]\d{1,4}.*"
    r"|\d{1,3}(?:(?:[ /]| ?d(?:ays?)?,? )\d{1,2})?:\d{1,2}\b.*|\d{8}[T _]\d{4,6}.*"
    r"|\d{4}[-/:]?\d{3}[T: ]\d{1,2}:\d{1,2}\b.*"
    r"|\d{1,2}\.? [^\W\d]{3,9}\.? \d{4}.*|[A-Za-z]{3,9} +\d{1,2}(?:,? \d{4}| \d{1,2}:\d{2}:).*)"
)
"""What may be a date or a time of day."""
DOTTED_AFTER_DATE = re.compile(r"(?<=\d[ T])(\d{1,2})\.(\d{2})\.(\d{2})(?![.\d])")
"""Time of day with points in place of colons, behind a date."""
EAST_ASIAN = (
    (re.compile(r"(\d{2,4}) ?[年년] ?(\d{1,2}) ?[月월] ?(\d{1,2}) ?[日일] ?"), r"\1-\2-\3 "),
    (re.compile(r"(\d{1,2}) ?[时時시] ?(\d{1,2}) ?[分분](?: ?(\d{1,2}(?:\.\d+)?) ?[秒초])?"), _with_colons),
    (re.compile(r"(?:上午|午前|오전) ?(\d{1,2}:[\d:.]+)"), r"\1 AM"),
    (re.compile(r"(?:下午|午後|오후) ?(\d{1,2}:[\d:.]+)"), r"\1 PM"),
)
"""Signs of years, hours and halves of a day in Chinese, Japanese and Korean -> the usual ones."""
CODE_PAGES = {
    "gb18030": r"\d年|时间|日期|上午|下午|温度",
    "cp932": r"\d年|時間|日時|日付|午前|午後|温度",
    "cp949": r"\d년|시간|날짜|오전|오후|온도",
}
"""Code page -> words by which a text is in it."""
SEVERAL = re.compile(rf"{PLAIN}(?:\s+{PLAIN})+")
"""Several numbers in one cell."""
FORTRAN = re.compile(r"(?<=[\d.])[dD](?=[+-]?\d)")
"""The sign of an exponent as Fortran writes it, `1.0D+03`."""
FORTRAN_ROW = re.compile(r"[\s\d.,;+\-dD]+")
"""A row of such numbers, and of nothing else."""
RULE = re.compile(r"[\s|+\-=:]{3,}")
"""A line of dashes, which separates the names of a list from its rows."""
SIGN_APART = re.compile(r"(?m)(^|[,;\t|])([+-]) +(?=[\d.])")
"""A sign with blanks behind it, as Graphtec writes numbers."""
PROCESS = {"", "avg", "smp", "min", "max", "std", "tot", "sample", "ave", "average", "last", "mean"}
"""Words of a row that states how a logger reduced its samples."""
EAST_ASIAN_TIME, EAST_ASIAN_TEMPERATURE = "时间|日期|時間|日時|日付|시간|날짜", "温度|溫度|온도"
"""Words for time and date, and for a temperature, in names."""
NAME_WORDS = (
    rf"(?i)time|zeit|date|datum|{EAST_ASIAN_TIME}|temp|{EAST_ASIAN_TEMPERATURE}|^tc|thermo|sensor|chan|^ch\d|^t\d*$|^t_"
    r"|flux|plate"
)
"""Words by which a row is one of names."""
COMMENT_SIGNS = ("#", "%")
"""Signs that begin a line of comment, which may hold the names of the columns."""
HAS_BLANK = re.compile(r"\s").search
"""Whether a line holds a blank of any kind."""
OPEN_QUOTE = re.compile(r'(?:^|[,;\t|])\s*"(?:[^"]|"")*$')
"""A cell that begins with a quote and does not end in the line; another quote may be an inch."""
LABELLED = re.compile(r"([A-Za-z][\w ]*?)\s*[:=]\s*([+-]?\d[^,;\t:=]*?)\s*(?=[,;\t]|\s[A-Za-z]\w*\s*[:=]|$)")
"""Name and value in `Temp: 20.1 C, Hum: 40`, also without commas."""
MONITORED = re.compile(
    r"(?:(\d{1,2}:\d{2}:\d{2}(?:[.,]\d+)?) -> |\[((?:\d{4}-\d{2}-\d{2} )?\d{1,2}:\d{2}:\d{2}(?:[.,]\d+)?)\] ?)(.*)"
)
"""Time of a serial monitor with an arrow, or in brackets, and the text of the device."""
MONITOR_MARK = re.compile(r"^\[| -> ")
"""The bracket or the arrow of a serial monitor."""
QUOTED_LIST = re.compile(r'\s*\(((?:\s*"[^"]*")+)\s*\)\s*')
"""Names as Fluent lists them, `("Time Step" "wall" "flow-time")`."""
TIME_WORDS = rf"(?i)time|zeit|date|datum|{EAST_ASIAN_TIME}|^t$|^(elapsed )?sec"
"""Words of the name of a time."""
THOUSANDS_BLANK = re.compile(r"(?<=\d)[\u00a0\u202f](?=\d{3}(?!\d))")
"""A blank that does not break, between thousands, as in French spreadsheets."""
HEAD_LINES = 50
"""Most lines above the data."""
TRAILER_LINES = 30
"""Most lines behind the data that may be a summary."""
PAGE_CHARACTERS = 100_000
"""Characters from the beginning by which the code page is found."""
SAMPLE_LINES = 4000
"""Lines from which the separator is found: half from the beginning, half from the end."""


def western(cell: str) -> str:
    """A date or a time of day without the signs that East Asian loggers write in it.

    >>> western("2024年3月5日 14时22分05秒"), western("2024/3/5 下午 2:22:05")
    ('2024-3-5 14:22:05', '2024/3/5 2:22:05 PM')
    """
    if cell.isascii():
        return cell
    for pattern, usual in EAST_ASIAN:
        cell = pattern.sub(usual, cell)
    return cell.strip()


def decoded(path: Path) -> str:
    """The text of a file in UTF-8, UTF-16 or a code page of Windows.

    raises : as `read_text`
    """
    try:
        raw = path.read_bytes() if path.is_file() else b""
    except OSError:
        raw = b""
    if raw[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return raw.decode("utf-16", errors="replace")
    try:
        raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        if b"\0" not in raw:  # a spreadsheet of Windows: the degree sign is byte 0xb0
            texts = {page: raw.decode(page, errors="replace") for page in CODE_PAGES}
            page = next((p for p, words in CODE_PAGES.items() if re.search(words, texts[p][:PAGE_CHARACTERS])), "")
            return texts[page] if page else raw.decode("cp1252", errors="replace")
    return read_text(path)


def text_block(path: Path, text: str, separator: str | None = None) -> Block:
    """The block of data of a text.

    separator : between cells, where it is known
    raises    : InputError, one line, where rows differ in their cells, or there are none of numbers
    """
    for is_of_form, block_of_form in FORMS:
        if is_of_form(text):
            return block_of_form(path, text)
    if (block := list_block(path, text)) is not None:
        return block
    numbered = _with_closed_quotes(_numbered_lines(text.replace("\r\n", "\n").replace("\r", "\n")))
    stated, numbered = _stated_separator(numbered)
    recorder = _recorder(numbered)
    numbered, monitored = _without_arrows(numbered)
    if monitored:
        recorder = "serial monitor"
    if not numbered:
        raise InputError(
            f"{display_path(path)}: no rows of numbers were found; give a file with a time and temperatures"
        )
    try:
        sign = separator or stated or _separator(numbered)
        rows = split_lines(numbered, sign)
    except csv.Error as error:  # such as a cell of more than 131072 characters
        raise InputError(f"{display_path(path)}: cannot be read as a table ({error}); give a file of numbers") from None
    return rows_block(path, rows, sign, recorder=recorder, lines=dict(numbered))


def _numbered_lines(text: str) -> list[tuple[int, str]]:
    """Number and text of the lines that are not blank and no rules; signs stand at their numbers, and exponents are
    written with E."""
    lines = (SIGN_APART.sub(r"\1\2", text) if "+ " in text or "- " in text else text).split("\n")
    numbered = [(i, line) for i, line in enumerate(lines, 1) if line.strip(" \t,;")]
    numbered[:HEAD_LINES] = [row for row in numbered[:HEAD_LINES] if not RULE.fullmatch(row[1])]
    return _with_usual_exponents(numbered)


def _with_usual_exponents(lines: list[tuple[int, str]]) -> list[tuple[int, str]]:
    """Lines in which Fortran's `1.0D+03` is written `1.0E+03`."""
    if not any(FORTRAN_ROW.fullmatch(line) and FORTRAN.search(line) for _, line in lines[: 2 * HEAD_LINES]):
        return lines
    return [(i, FORTRAN.sub("E", line) if FORTRAN_ROW.fullmatch(line) else line) for i, line in lines]


def _stated_separator(lines: list[tuple[int, str]]) -> tuple[str, list[tuple[int, str]]]:
    """The separator that a first line `sep=;` states, empty without one, and the other lines."""
    stated = re.fullmatch(r"sep=(.)\s*", lines[0][1].strip('"')) if lines else None
    return ("", lines) if stated is None else (stated[1], lines[1:])


def _with_closed_quotes(lines: list[tuple[int, str]]) -> list[tuple[int, str]]:
    """Lines above the data in which a quoted name may stand on several lines of the file, as in spreadsheets."""
    head, rest = lines[:HEAD_LINES], lines[HEAD_LINES:]
    joined: list[tuple[int, str]] = []
    is_open = False
    for i, line in head:
        if is_open:
            joined[-1] = (joined[-1][0], f"{joined[-1][1]} {line}")
        else:
            joined.append((i, line))
        is_open = line.count('"') % 2 == 0 if is_open else OPEN_QUOTE.search(line) is not None
    return lines if is_open else [*joined, *rest]


def _recorder(lines: Sequence[tuple[int, str]]) -> str:
    """The recorder whose first line names it; empty where none does."""
    first = lines[0][1].lstrip('"') if lines else ""
    if first.startswith(("TOA5", "TOACI1")):
        return f"Campbell {first[:6].rstrip(',' + chr(34))}"
    if "Plot Title" in first:
        return "HOBO"
    return ""


def _without_arrows(lines: list[tuple[int, str]]) -> tuple[list[tuple[int, str]], bool]:
    """Lines of a serial monitor, `10:45:00.512 -> 20.06,20.46` of an Arduino or `[2024-05-03 10:45:00.512] 20.06,20.46`
    of a terminal, with a separator for the arrow or the brackets."""
    head = lines[:HEAD_LINES]
    if sum(MONITOR_MARK.search(line) is not None for _, line in head) < 0.9 * len(head):
        return lines, False
    matches = [(i, line, MONITORED.fullmatch(line.strip())) for i, line in lines]
    stamped = [(i, m) for i, _, m in matches if m is not None]
    if len(stamped) < 0.9 * len(lines):
        return lines, False
    others = [(i, line) for i, line, m in matches if m is None and i > stamped[0][0]]  # refused as rows, not lost
    head, rows = _rows_of_monitor(stamped)
    return [*head, *sorted([*rows, *others])], True


def _rows_of_monitor(
    stamped: Sequence[tuple[int, re.Match[str]]],
) -> tuple[list[tuple[int, str]], list[tuple[int, str]]]:
    """A row of names where all lines label their values, and the rows of time and values.

    stamped : line, and match of MONITORED
    """
    times, texts = [m[1] or m[2] for _, m in stamped], [(i, m[3]) for i, m in stamped]
    labelled = _labelled_values([text for _, text in texts])
    if labelled is not None:
        names, values = labelled
        rows = [(i, ";".join([time, *row])) for (i, _), time, row in zip(stamped, times, values, strict=True)]
        return [(0, ";".join(["time", *names]))], rows
    sign = _separator(texts) if any(re.search("[,;\t ]", text) for _, text in texts[:50]) else ";"
    return [], [(i, time + sign + text) for time, (i, text) in zip(times, texts, strict=True)]


def _labelled_values(texts: Sequence[str]) -> tuple[list[str], list[list[str]]] | None:
    """Names and the values of each line, where all lines are as `Temp: 20.1, Hum: 40` with the same names."""
    lines = list(map(LABELLED.findall, texts))
    if any(LABELLED.sub("", text).strip(" ,;\t") for text in texts):
        return None  # a label that is none, as of `T 1: 20 T 2: 21`
    if not all(lines) or len({tuple(n for n, _ in pairs) for pairs in lines}) != 1:
        return None
    return [name.strip() for name, _ in lines[0]], [[value for _, value in pairs] for pairs in lines]


def split_lines(lines: Sequence[tuple[int, str]], sign: str) -> list[Row]:
    """Number and cells of each line; a quoted cell may hold the separator, and ends with its line.

    sign : separator; a blank stands for any number of blanks, and two for two or more
    """
    texts = [line for _, line in lines]
    if sign == " ":
        rows = list(map(tuple, map(str.split, texts)))
    elif sign == WIDE:
        rows = [tuple(re.split(r" {2,}|\t+", line.strip())) for line in texts]
    else:
        rows = list(map(tuple, csv.reader(texts, delimiter=sign, skipinitialspace=True)))
        if len(rows) != len(texts):  # a quote that is not closed
            rows = [tuple(next(csv.reader([line], delimiter=sign, skipinitialspace=True))) for line in texts]
    # names often have blanks, and a million rows below them none
    spaced = len(texts) if any(map(HAS_BLANK, texts[HEAD_LINES:])) else HEAD_LINES
    rows[:spaced] = [tuple(map(str.strip, cells)) for cells in rows[:spaced]]
    return [(i, cells) for (i, _), cells in zip(lines, rows, strict=True)]


def _separator(lines: Sequence[tuple[int, str]]) -> str:
    """The separator that gives most lines the same number of cells, two or more, each of one number at most."""
    half = SAMPLE_LINES // 2
    sample = lines if len(lines) <= 2 * half else [*lines[:half], *lines[-half:]]
    text = "\n".join(line for _, line in sample)
    best, most = ",", 0.0
    for sign in SEPARATORS:
        if sign in text or (sign == " " and "\t" in text):
            agreement = _agreement(split_lines(sample, sign), sign)
            if agreement > most + 0.05:
                best, most = sign, agreement
    return best


def _agreement(rows: Sequence[Row], sign: str) -> float:
    """Share of the rows that have the usual number of cells, less those with a cell that shows another separator."""
    width, often = _usual_width(rows)
    if width < 2 or (sign == WIDE and not _are_columns_of_dates(rows[:HEAD_LINES], width)):
        return 0.0
    wrong = sum(any(_is_torn(c, sign) for c in cells) for _, cells in rows)
    return (often - wrong) / len(rows)


def _usual_width(rows: Sequence[Row]) -> tuple[int, int]:
    """The number of cells that most rows have, and how many have it."""
    return max(Counter(len(cells) for _, cells in rows).items(), key=lambda item: (item[1], item[0]))


def _are_columns_of_dates(rows: Sequence[Row], width: int) -> bool:
    """Whether cells that wide blanks separate are dates with blanks of their own, below names as many."""
    has_names = any(len(cells) == width and not _is_data(cells) for _, cells in rows)
    return has_names and any(" " in cell and is_clock(cell) for _, cells in rows for cell in cells)


def _is_torn(cell: str, sign: str) -> bool:
    """Whether a cell shows that another separator is right: it holds several numbers, or ends in one."""
    if not cell or not any(c.isdigit() for c in cell):
        return False
    if sign == " " and cell[-1] in ",;":
        return True
    if sign == "," and re.search(r"\d\s*;", cell):
        return True
    if re.fullmatch(r"\d{8}\s+\d{4,6}", cell):
        return False
    if CLOCK_CELL.fullmatch(cell):
        return _is_torn_clock(cell, sign)
    return re.search(r"\d[.,]?\s+[+-]?[.,]?\d", THOUSANDS_BLANK.sub("", cell)) is not None


def _is_torn_clock(cell: str, sign: str) -> bool:
    """Whether numbers stand behind the date or the time of day in a cell."""
    if sign == " " and len(re.findall("[,;]", cell)) > 1:
        return True  # one may be the decimal sign of the seconds
    ends_in_year = re.search(r"[A-Za-z]{3} +\d{1,2} [\d:]+ \d{4}$", cell)
    return not ends_in_year and re.search(r":\d{2}(?:\.\d+)?\s+[+-]?(?!\d\d:\d\d$)[\d.]", cell) is not None


def is_number(cell: str) -> bool:
    """Whether a cell holds a number, also one with a unit."""
    return NUMBER_CELL.fullmatch(cell) is not None


def is_clock(cell: str) -> bool:
    """Whether a cell may hold a date or a time of day."""
    cell = western(cell)
    has_time = SEVERAL.fullmatch(cell) is None or DOTTED_AFTER_DATE.search(cell) is not None
    return CLOCK_CELL.fullmatch(cell) is not None and has_time


def _is_data(cells: Sequence[str]) -> bool:
    """Whether cells are those of a row of data: a number or a clock at least, and no more texts than these."""
    full = [c for c in cells if c]
    values = sum(is_number(c) or is_clock(c) or c.lower() in ("nan", "inf") for c in full)
    return any(is_number(c) or is_clock(c) for c in full) and 2 * values >= len(full)


def rows_block(
    path: Path,
    split: Sequence[Row],
    sign: str,
    *,
    recorder: str = "",
    lines: dict[int, str] | None = None,
) -> Block:
    """The block of rows of cells, in which names, units, data and trailer are yet to be distinguished.

    split  : line and cells of each row that is not blank
    lines  : texts of the lines; None for a sheet
    raises : InputError, one line, for rows whose cells do not fit
    """
    file = display_path(path)
    split, width = _with_constants(split, _usual_width(split)[0])
    first = _first_row(split, width, recorder)
    if first is None:
        raise _no_numbers(file, split, width)
    if first:
        _refuse_wide_data(file, split[first - 1], width)
    body, notes = _body(file, split, first, _last_row(split, first, width))
    columns = _columns_of_rows(file, body, width)
    while width > 1 and not any(columns[-1]) and not _named_cell(split, first, width - 1):
        columns.pop()  # a separator ends each line
        width -= 1
    names, units, names_line = _head(file, split, first, width, recorder, lines)
    separated = f"cells separated by {SEPARATORS.get(sign, f'`{sign}`')}" if sign else ""
    about = ", ".join(filter(None, [recorder, separated]))
    named = tuple(name or f"column{k}" for k, name in enumerate(names, 1))
    table = (named, tuple(units), tuple(columns), tuple(line for line, _ in body))
    return Block(path, *table, sign, "", names_line, about, tuple(notes))


def _no_numbers(file: str, split: Sequence[Row], width: int) -> InputError:
    """The message of a file without rows of numbers, with the last row of the usual width."""
    usual, cells = next((line, cells) for line, cells in reversed(split) if len(cells) == width)
    return InputError(
        f"{file}: no rows of numbers were found; row {usual}, `{_shown(cells)}`, is none. Write a time and "
        "temperatures alone in each row, one number a cell, or state --separator"
    )


def _wrong_width(file: str, row: Row, width: int) -> InputError:
    """The message of a row that has another number of cells."""
    rule = f"does not have {width} cells as the other rows; mend or remove it, or state --separator"
    return InputError(f"{file}, row {row[0]}: `{_shown(row[1])}` {rule}")


def _refuse_wide_data(file: str, above: Row, width: int) -> None:
    """Refuse a row of data that has more cells than the first of the usual width below it.

    raises : InputError
    """
    if len(above[1]) > width and _is_data(above[1]) and not _is_comment(above[1]):
        raise _wrong_width(file, above, width)


def _with_constants(split: Sequence[Row], width: int) -> tuple[Sequence[Row], int]:
    """Rows, and their number of cells, of a file whose first row of data alone has the constants of the run behind its
    readings, below their names, as Lascar writes it: the cells of the others are empty there."""
    k = next((k for k, (_, cells) in enumerate(split[:HEAD_LINES]) if len(cells) > width and _is_data(cells)), 0)
    wide = len(split[k][1])
    has_names = k > 0 and len(split[k - 1][1]) == wide and not _is_data(split[k - 1][1])
    if not has_names or any(len(cells) != width for _, cells in split[k + 1 :]):
        return split, width
    rest = ((line, (*cells, *[""] * (wide - width))) for line, cells in split[k + 1 :])
    return [*split[: k + 1], *rest], wide


def _body(file: str, split: Sequence[Row], first: int, last: int) -> tuple[list[Row], list[str]]:
    """Rows of data from the first to the last, without comments, and notes of what is left out.

    raises : InputError, one line, where too many rows stand behind the last
    """
    notes = _notes_of_trailer(file, split[last + 1 :])
    rows = split[first : last + 1]
    body = [row for row in rows if row[1][0][:1] not in COMMENT_SIGNS or not _is_comment(row[1])]
    if comments := len(rows) - len(body):
        notes.append(f"{comments} lines of comment amid the data left out")
    below = _lines_of_names(rows, split[first - 1][1]) if first and comments else set()
    if below:
        body = [row for row in body if row[0] not in below]
        notes.append(f"the names stand again in row {min(below)}, below a comment: left out")
    return body, notes


def _notes_of_trailer(file: str, behind: Sequence[Row]) -> list[str]:
    """A note of the rows behind the data, where there are any.

    raises : InputError, one line, where they are too many
    """
    if not behind:
        return []
    line, cells = behind[0]
    if len(behind) > TRAILER_LINES:
        rule = "does not have the cells of the rows above; cut the file there"
        raise InputError(f"{file}, row {line}: `{_shown(cells)}` {rule}")
    return [f"rows {line} to {behind[-1][0]} behind the data left out (`{_shown(cells)}`)"]


def _lines_of_names(rows: Sequence[Row], names: Sequence[str]) -> set[int]:
    """Lines amid the data that have the names of the columns again, below a comment."""
    return {row[0] for above, row in pairwise(rows) if row[1] == names and _is_comment(above[1])}


def _columns_of_rows(file: str, body: Sequence[Row], width: int) -> list[list[str]]:
    """Cells by column of rows of data.

    raises : InputError, one line, for a row that has fewer cells, or more that are not empty
    """
    for line, cells in body:
        if len(cells) != width and (len(cells) < width or any(cells[width:])):
            raise _wrong_width(file, (line, cells), width)
    return [[cells[column] for _, cells in body] for column in range(width)]


def _shown(cells: Sequence[str]) -> str:
    return abbreviated(", ".join(cells)).strip('"')


def _is_comment(cells: Sequence[str]) -> bool:
    return cells[0].startswith(COMMENT_SIGNS) and len(cells[0]) > 1


def _first_row(split: Sequence[Row], width: int, recorder: str) -> int | None:
    """Index of the first row of data: of the usual width, and so is the next one."""
    ahead = {"Campbell TOA5": 4, "Campbell TOACI1": 2}.get(recorder, 0) or _rows_to_the_time(split[:HEAD_LINES], width)
    for k in range(ahead, len(split)):
        if _is_row(split[k][1], width):
            after = split[k + 1][1] if k + 1 < len(split) else split[k][1]
            if _is_comment(after) or _is_row(after, width) or not _names_below(split, k):
                return k
    return None


def _is_row(cells: Sequence[str], width: int) -> bool:
    return len(cells) == width and not _is_comment(cells) and _is_data(cells)


def _rows_to_the_time(split: Sequence[Row], width: int) -> int:
    """Number of rows up to the first that names a time right above one; 0 where there is none, or data stand before.

    Such a row may also name channels by numbers, and pairs as `Rate,10` may stand above it.
    """
    for k, ((_, cells), (_, below)) in enumerate(pairwise(split)):
        if is_number(cells[0]) or is_clock(cells[0]):
            return 0
        if len(cells) == len(below) == width and any(
            re.search(TIME_WORDS, cell) and (is_number(value) or is_clock(value))
            for cell, value in zip(cells, below, strict=True)
        ):
            return k + 1
    return 0


def _names_below(split: Sequence[Row], k: int) -> bool:
    """Whether a row of names follows within a few rows."""
    return any(_count_of_names(cells) >= 2 for _, cells in split[k + 1 : k + 4])


def _count_of_names(cells: Sequence[str]) -> int:
    """How many cells are names of a time or a reading by their words."""
    return sum(re.search(NAME_WORDS, c) is not None for c in cells)


def _last_row(split: Sequence[Row], first: int, width: int) -> int:
    """Index of the last row of data: behind it are lines of words, or of other cells."""
    heads = [split[k][1][0] for k in range(first, min(first + 50, len(split)))]
    named = sum(re.match(r"[A-Za-z]", h) is not None for h in heads) > 0.5 * len(heads)
    for last in range(len(split) - 1, first, -1):
        cells = split[last][1]
        lead = next(filter(None, cells), "")
        if (
            len(cells) >= width
            and _is_data(cells)
            and (named or not re.match(r"[A-Za-z]", lead))
            and not _is_comment(cells)
        ):
            return last
    return first


def _named_cell(split: Sequence[Row], first: int, column: int) -> bool:
    """Whether a column has a name right above the data."""
    above = split[first - 1][1] if first else []
    return len(above) > column and bool(above[column])


def _head(
    file: str, split: Sequence[Row], first: int, width: int, recorder: str, lines: dict[int, str] | None
) -> tuple[list[str], list[str], int]:
    """Names, units, and the line of the names: 0 where there are none."""
    none = [""] * width
    if recorder == "Campbell TOA5":
        names, units = (_filled(split[k][1], width) for k in (1, 2))
        return names, ["" if known_unit(u) is None else u for u in units], split[1][0]
    rows = _rows_above(file, split, first, width, lines)
    process: Sequence[str] = ()
    if rows and _are_process(rows[0][1]):
        process, rows = rows[0][1], rows[1:]
    if not rows:
        return [f"column{k + 1}" for k in range(width)], none, 0
    names, units, line = _names_and_units(rows)
    return _with_process(names, process), units or none, line


def _with_process(names: list[str], process: Sequence[str]) -> list[str]:
    """Names with how the logger reduced the samples behind those that stand several times; `process` may be empty."""
    if not process:
        return names
    return [f"{name} {p}" if names.count(name) > 1 else name for name, p in zip(names, process, strict=True)]


def _are_process(cells: Sequence[str]) -> bool:
    return all(c.lower() in PROCESS for c in cells)


def _names_and_units(rows: Sequence[tuple[int, list[str]]]) -> tuple[list[str], list[str], int]:
    """Names and units of the rows above the data, the nearest first, and the line of the names; no units where no row
    has them."""
    if len(rows) > 1 and _are_names_above(rows):
        return rows[1][1], [c.strip() for c in rows[0][1]], rows[1][0]
    for k, (_, cells) in enumerate(rows[:2]):
        others = [*rows[k + 1 : k + 2], *rows[:k]]  # names stand above their units, or below
        if others and _is_unit_row(cells) and not _is_label_of_units(cells[0]):
            line, names = max(others, key=lambda row: _count_of_names(row[1]))
            return names, [c.strip() for c in cells], line
    return _with_names_above(rows), _labelled_units(rows), rows[0][0]


def _with_names_above(rows: Sequence[tuple[int, list[str]]]) -> list[str]:
    """Names of the row right above the data, and for its empty cells those of the nearest row that has them, such as
    `Tag,,,wall,back` above `Date,Time,ms,,`; a row of units has none. `Min` and `Max` stand behind the name above."""
    names = list(rows[0][1])
    reduced = [k for k, name in enumerate(names) if name and _are_process([name])]
    for _, cells in rows[1:]:
        if not _is_label_of_units(cells[0]):
            names = [name or cell for name, cell in zip(names, cells, strict=True)]
            for k in reduced:
                if _are_process([names[k]]):
                    names[k] = f"{_channel_above(cells, k, reduced)} {names[k]}".strip()
    return names


def _channel_above(cells: Sequence[str], k: int, reduced: Sequence[int]) -> str:
    """The name above a column of a reduced channel, or above the one before it, where that is reduced as well."""
    return cells[k] or (cells[k - 1] if k - 1 in reduced else "")


def _labelled_units(rows: Sequence[tuple[int, list[str]]]) -> list[str]:
    """Units of a row that begins with the word; empty where there is none above the data."""
    units = next((cells[1:] for _, cells in rows[1:] if _is_label_of_units(cells[0])), None)
    return [] if units is None else ["", *units]


def _is_label_of_units(cell: str) -> bool:
    return re.fullmatch(r"(?i)units?|einheit(en)?", cell.strip(":")) is not None


def _rows_above(
    file: str, split: Sequence[Row], first: int, width: int, lines: dict[int, str] | None
) -> list[tuple[int, list[str]]]:
    """Line and cells of the rows above the data that have a cell for each column, the nearest first.

    raises : InputError, one line, where the nearest row holds names, and not one for each column
    """
    above = [(split[k][0], _head_cells(split[k], width, lines)) for k in range(first - 1, max(first - 5, -1), -1)]
    line, nearest = above[0] if above else (0, [])
    if 1 < len(nearest) != width and any(re.search(NAME_WORDS, c) for c in nearest):
        rule = f"for {width} cells in the rows below; give each column one name, or state --separator"
        raise InputError(f"{file}, row {line}: {len(nearest)} names (`{_shown(nearest)}`) {rule}")
    return [(line, cells) for line, cells in above if len(cells) == width]


def _are_names_above(rows: Sequence[tuple[int, list[str]]]) -> bool:
    """Whether the second row above the data names a time and more, and the first one nothing: it holds units, known or
    not."""
    low, high = rows[0][1], rows[1][1]
    is_named = _count_of_names(high) >= 2
    if is_named and any(_measures(c, "K", "W/m2") for c in low if c):
        return True
    return is_named and not any(re.search(NAME_WORDS, c) for c in low) and all(len(c) < 12 for c in low)


def _head_cells(row: Row, width: int, lines: dict[int, str] | None) -> list[str]:
    """Cells of a row above the data, without the mark of a comment; of names with blanks where blanks separate."""
    line, cells = row[0], _trimmed(list(row[1]))
    if len(cells) <= width <= len(row[1]):
        cells = _filled(cells, width)  # the separators are there, and the last cells empty
    cells = _without_mark(cells, width)
    text = None if lines is None else lines.get(line)
    if len(cells) == width or text is None:
        return cells
    if quoted := QUOTED_LIST.fullmatch(text):
        cells = re.findall(r'"([^"]*)"', quoted[1])
    wide = re.split(r"\t+|\s{2,}", text.lstrip("#% ").strip())
    return wide if len(cells) != width == len(wide) else cells


def _without_mark(cells: list[str], width: int) -> list[str]:
    """Cells of a row without the mark of a comment at its beginning."""
    if cells[0].startswith(COMMENT_SIGNS) and len(cells) > 1 and len(cells[0]) > 1:
        first = cells[0].lstrip("#% ")
        return [first, *cells[1:]] if first else cells[1:]
    return cells[1:] if cells[0] in COMMENT_SIGNS and len(cells) == width + 1 else cells


def _trimmed(cells: list[str]) -> list[str]:
    """Cells without the empty ones at the end, one at least."""
    end = len(cells)
    while end > 1 and not cells[end - 1]:
        end -= 1
    return cells[:end]


def _filled(cells: Sequence[str], width: int) -> list[str]:
    return [*cells, *[""] * (width - len(cells))][:width]


def _is_unit_row(cells: Sequence[str]) -> bool:
    """Whether a row holds units: one of a time or a temperature at least, and nothing that is a name."""
    full = [c.strip("[]()<> ") for c in cells if c.strip("[]()<> -")]
    if any((is_number(c) and c != "1") or re.match("(?i)time|zeit|temp", c) for c in full):
        return False
    return any(_measures(c, "s", "K", "W/m2") for c in full) and sum(map(_is_unit, full)) >= 0.5 * len(full)


def _measures(cell: str, *quantities: str) -> bool:
    """Whether a cell is a unit that converts to one of some SI units, such as `degC` to K."""
    return any(converted(cell, si) is not None for si in quantities)


def _is_unit(cell: str) -> bool:
    """Whether a cell is a unit that is known, or the layout of a clock, such as `hh:mm:ss`."""
    return known_unit(cell) is not None or re.fullmatch(r"(?i)[dhmsy:/ .\-]{4,}|ts|rn", cell) is not None
