"""Logs in text files: a header, then one line per time; absent samples are empty cells.

Commas separate the cells, or semicolons, tabs or blanks, as in the first line. With semicolons and
tabs, decimals may have commas. The names may stand in a comment above the numbers, as NumPy writes
them, and a line of units may follow them. Without a header, the columns are named 1, 2, 3, ….
Headers of Vicon's and Motive's exports are read, too.

A text is in UTF-8, or in UTF-16 if it has the byte order mark. Numbers are the same in all code
pages; so names, units and comments that are no UTF-8, such as a "°" of Windows, are read in
Windows-1252, and rows must be UTF-8.
"""

import csv
import re
from codecs import BOM_UTF16_BE, BOM_UTF16_LE
from collections.abc import Iterator, Sequence
from itertools import chain, islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cpid_drake.array import Array
from cpid_drake.files.errors import InputError
from cpid_drake.logs.column_map import UNIT_OF, scale_of
from cpid_drake.logs.table import LogTable, repeated_names, seconds_of_texts

_LONGEST_LINE = 1_000_000
"""Longest line of a text file: 10000 columns of 100 digits. A binary file has none."""

ABSENT = ("", "nan", "na", "n/a")
"""Cells without a sample, in lower case."""

_BLOCK = 20_000
"""Lines that are converted at once: their cells as text take a few tens of megabytes."""

_VICON = ("Segments", "Objects", "Trajectories", "Joints", "Model Outputs")
"""First lines of Vicon's files."""

_MOTIVE = {"Type", "ID", "Parent"}
"""Lines of the header of Motive's files that are not used."""

_ROW = re.compile(r'[\s",;]*[+-]?\.?\d')
"""The beginning of a line of numbers."""

_DECIMAL_COMMA = re.compile(r"[+-]?\d+,\d+")
_NO_UNIT = ("", "-", "1", "none", "n/a", "quaternion", "unitless")

Lines = Iterator[tuple[int, str]]


def read_csv(file: Path, where: str) -> LogTable:
    """Read a log; cells that are not finite numbers are in `LogTable.texts`.

    Raises:
        InputError: the file is empty, has no usable header, is not text, or holds several logs.

    """
    lines = _lines(file, where)
    place, header, separator, lines = _header(lines, where)
    problems: list[tuple[int, str]] = []
    numbers: list[NDArray[np.intp]] = [np.empty(0, dtype=int)]
    blocks = [np.empty((0, len(header)))]
    texts: dict[str, dict[int, str]] = {}
    count = 0
    lines = (line for line in lines if not line[1].startswith("#"))
    if separator not in (",", None):
        lines = _with_points(lines)
    while block := list(islice(lines, _BLOCK)):
        values = _plain(block, len(header), separator)
        if values is not None:
            kept = [number for number, _ in block]
        else:
            rows, kept = _cells(block, header, separator, problems, where)
            if (
                not count
                and rows
                and (units := _units(rows[0], header, f"{where}: line {kept[0]}"))
            ):
                header, rows, kept = units, rows[1:], kept[1:]
            values = np.empty((len(rows), len(header)))
            for k, cells in enumerate(zip(*rows)):
                values[:, k], others = _numbers(cells)
                for row, text in others.items():
                    texts.setdefault(header[k], {})[count + row] = text
        blocks.append(values)
        numbers.append(np.array(kept, dtype=int))
        count += len(values)
    columns = dict(zip(header, np.ascontiguousarray(np.concatenate(blocks).T)))
    for name in [name for name, cells in texts.items() if np.isnan(columns[name]).all()]:
        seconds = seconds_of_texts([*texts[name].values()])
        if seconds is not None:
            columns[name][[*texts.pop(name)]] = seconds
    return LogTable(
        columns,
        np.concatenate(numbers),
        texts,
        repeated_names(header, where),
        problems,
        header=place,
    )


def write_csv(path: Path, columns: list[str], values: Array) -> None:
    """Write columns and values (N, C); NaN becomes an empty cell."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        for row in values.tolist():
            writer.writerow(["" if value != value else repr(value) for value in row])


def _lines(file: Path, where: str) -> Lines:
    """Yield the lines that are not empty, with their numbers; any line ends."""
    number = 0
    try:
        with file.open("rb") as stream:
            is_wide = stream.read(2) in (BOM_UTF16_LE, BOM_UTF16_BE)
        code, errors = ("utf-16", "replace") if is_wide else ("utf-8-sig", "surrogateescape")
        with file.open(encoding=code, errors=errors, newline=None) as stream:
            while line := stream.readline(_LONGEST_LINE + 1):
                number += 1
                if len(line) > _LONGEST_LINE:
                    raise InputError(f"{where}: line {number} is longer than {_LONGEST_LINE} bytes")
                line = line.rstrip("\n")
                if not line.isascii():
                    line = _in_one_code(line, is_wide, f"{where}: line {number}")
                if line.strip():
                    yield number, line
    except OSError as error:
        raise InputError(f"{where}: cannot be read: {error.strerror}") from error


def _in_one_code(line: str, is_wide: bool, where: str) -> str:
    """Return a line, that of names or units in Windows-1252 if it is no UTF-8."""
    if is_wide:
        if "\ufffd" in line:
            raise InputError(f"{where} is damaged: it is not text in UTF-16, as the file begins")
        return line
    if not any("\ud800" <= c <= "\udfff" for c in line):
        return line
    try:
        if not _ROW.match(line):
            return line.encode("utf-8", "surrogateescape").decode("cp1252")
    except UnicodeDecodeError:
        pass
    raise InputError(
        f"{where} is not text in UTF-8; if this is a CSV file, save it in that encoding"
    )


def _header(lines: Lines, where: str) -> tuple[str, list[str], str | None, Lines]:
    """Return place and names of columns, their separator (None for blanks), and the rows.

    A header of Vicon's Nexus or Tracker has five lines: the kind of data, frames per second,
    bodies, names, and units. Names are then such as "Base:TX [mm]" and "Frame [100 Hz]".
    """
    comments = list[tuple[int, str]]()
    number, line = next(lines, (0, ""))
    while line.startswith("#"):
        comments = [*comments[-20:], (number, line.lstrip("# \t"))]
        number, line = next(lines, (0, ""))
    if line.startswith("sep="):  # a spreadsheet's note on the separator
        number, line = next(lines, (0, ""))
    if not line:
        raise InputError(f"{where}: the file is empty")
    if "\0" in line:
        raise InputError(f"{where}: not a CSV file: line {number} holds binary data")
    separator = next((s for s in ";\t," if s in line), None)  # decimals may have commas
    if separator is None and " " not in line.strip():
        separator = ","
    try:
        if line.strip(",; \t").strip('"') in _VICON:
            return f"line {number + 4}", _vicon_names(lines), ",", lines
        if line.startswith("Format Version"):
            return (*_motive_names(line, lines, where), ",", lines)
        names = _split(line, separator)
        if all(names) and (not _numbers(names)[1] or seconds_of_texts(names[:1]) is not None):
            lines = chain([(number, line)], lines)
            for number, comment in reversed(comments):
                cells = _split(comment, separator)
                if len(cells) == len(names) > 1 and len(_numbers(cells)[1]) == len(cells):
                    return f"line {number}", cells, separator, lines
            names = [str(k + 1) for k in range(len(names))]
    except InputError:
        raise
    except (ValueError, csv.Error) as error:
        problem = f"the header cannot be read: {error}"
        raise InputError(f"{where}: line {number}: {problem}") from error
    while len(names) > 1 and not names[-1]:
        names.pop()
    return f"line {number}", names, separator, lines


def _with_points(lines: Lines) -> Lines:
    """Return lines with decimal points instead of commas, if commas can be nothing else.

    Three digits behind a comma may be thousands; so lines with other numbers of digits must be
    there, and none with a point.
    """
    first = list(islice(lines, _BLOCK))
    text = "\n".join(line for _, line in first)
    behind = {len(digits) for digits in re.findall(r"\d,(\d+)", text)}
    lines = chain(first, lines)
    if not behind - {3} or "." in text:
        return lines
    return ((number, line.replace(",", ".")) for number, line in lines)


def _vicon_names(lines: Lines) -> list[str]:
    rate, bodies, names, units = (_split(text, ",") for _, text in islice(lines, 4))
    header, body = [], ""
    for k, name in enumerate(names):
        body = (bodies[k] if k < len(bodies) else "") or body
        unit = units[k] if k < len(units) else ""
        unit = f"{rate[0]} Hz" if name == "Frame" else unit
        header.append((f"{body}:" if body else "") + name + (f" [{unit}]" if unit else ""))
    return header


def _motive_names(first: str, lines: Lines, where: str) -> tuple[str, list[str]]:
    """Return place and names, such as "body:Position X [m]", of an export of OptiTrack's Motive.

    Its header has lines of kinds, names and numbers of the bodies, of quantities, and of axes.
    """
    fields = _split(first, ",")
    settings = dict(zip(fields[::2], fields[1::2]))
    if settings.get("Rotation Type", "Quaternion") != "Quaternion":
        raise InputError(
            f"{where}: line 1: Motive's rotations are exported as {settings['Rotation Type']}: "
            "export them with the rotation type Quaternion"
        )
    unit = UNIT_OF.get(settings.get("Length Units", "meters").lower(), "")
    rows = dict[str | int, list[str]]()
    for number, line in islice(lines, 8):
        cells = _split(line, ",")
        if cells[0] == "Frame":
            count = len(cells) - 2
            bodies, kinds = (rows.get(key, [])[-count:] for key in ("Name", ""))
            if not len(bodies) == len(kinds) == count > 0:
                break
            header = cells[:2]
            for body, kind, axis in zip(bodies, kinds, cells[2:]):
                length = f" [{unit}]" if kind == "Position" and unit else ""
                header.append(f"{body}:{kind} {axis}".strip() + length)
            return f"line {number}", header
        rows["Name" if "Name" in cells[:3] else number if {*cells[:3]} & _MOTIVE else ""] = cells
    raise InputError(f"{where}: the header of Motive's export cannot be read: it lacks its lines")


def _units(row: list[str], header: list[str], where: str) -> list[str]:
    """Return names with units, if a row holds those of the columns; none if it holds numbers.

    Raises:
        InputError: a row below the header holds neither numbers nor units.

    """
    words = [cell.strip("[]() ") for cell in row]
    if (
        not any(words)
        or len(_numbers(row)[1]) < sum(map(bool, words))
        or seconds_of_texts(row[:1]) is not None
    ):
        return []
    units = list[str]()
    for name, word in zip(header, words):
        if _DECIMAL_COMMA.fullmatch(word):
            return []
        base, _, per = word.partition("/")
        unit = UNIT_OF.get(base) or UNIT_OF.get(base.lower())
        if word.lower() in _NO_UNIT or (unit and scale_of(unit) == 1 and per in ("", "s", "sec")):
            units.append(name)
        elif unit is not None and per in ("", "s", "sec"):
            units.append(f"{name} [{unit}{'/s' * bool(per)}]")
        else:
            raise InputError(
                f"{where}: '{word:.40}' in column '{name}' is neither a number nor a unit; keep "
                "one line of names above the numbers, or put # before the others"
            )
    return units


def _split(line: str, separator: str | None) -> list[str]:
    """Return the cells of a line; None separates by any number of blanks.

    Raises:
        csv.Error: its quotes are not valid in CSV.

    """
    if separator is None:
        return line.split()
    if '"' in line:
        line = line.strip()
        cells = next(csv.reader([line], delimiter=separator, strict=True, skipinitialspace=True))
        return [cell.strip() for cell in cells]
    return [cell.strip() for cell in line.split(separator)]


def _plain(block: list[tuple[int, str]], width: int, separator: str | None) -> Array | None:
    """Return lines of numbers as (n, width), in a third of the time; None for others."""
    try:
        lines = [line for _, line in block]
        values = np.loadtxt(lines, delimiter=separator, comments=None, ndmin=2)
    except ValueError:
        return None
    is_whole = values.shape == (len(block), width) and not np.isinf(values).any()
    return values if is_whole else None


def _cells(
    block: list[tuple[int, str]],
    header: list[str],
    separator: str | None,
    problems: list[tuple[int, str]],
    where: str,
) -> tuple[list[list[str]], list[int]]:
    """Return the cells of lines and the lines' numbers; lines that cannot be split are problems."""
    rows, kept, width = [], [], len(header)
    for number, line in block:
        try:
            cells = _split(line, separator)
        except csv.Error as error:
            problems.append((number, f"line {number}: quotes are wrong: {error}"))
            continue
        while len(cells) > width and not cells[-1]:
            cells.pop()
        if cells == header and width > 1:
            raise InputError(
                f"{where}: line {number} repeats the header: the file holds several logs, one "
                "after the other; cut it there, and identify from all of them together"
            )
        if len(cells) == width:
            rows.append(cells)
            kept.append(number)
        else:
            text = f"line {number}: {len(cells)} cells, but {width} columns"
            more = "; are decimals written with commas?" if len(cells) > width else ""
            problems.append((number, text + more))
    return rows, kept


def _numbers(cells: Sequence[str]) -> tuple[Array, dict[int, str]]:
    """Return the cells of a column as numbers (n,), NaN where absent or text; and the texts."""
    values, texts = np.full(len(cells), np.nan), {}
    for k, cell in enumerate(cells):
        if cell.lower() in ABSENT:
            continue
        try:
            number = float(cell)
        except ValueError:
            number = np.nan
        if number - number == 0 and cell.isascii() and "_" not in cell:  # Python reads "1_0"
            values[k] = number
        elif text := cell.strip():
            texts[k] = text
    return values, texts
