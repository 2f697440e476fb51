"""Telemetry in CSV files: a header, then one line per time; absent samples are empty cells.

Commas separate the cells, or semicolons.
"""

import csv
import re
from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from cpid_drake.errors import InputError
from cpid_drake.sensing.files.formats import Format, ReadOptions, Selection
from cpid_drake.sensing.files.table import TelemetryTable

_LONGEST_LINE = 1_000_000
_BLOCK = 4_000_000
MOST_COLUMNS = 10_000
_VICON = ("Segments", "Objects", "Trajectories", "Joints", "Model Outputs")
"""First lines of Vicon's files."""

_NOT_A_NUMBER = re.compile(rb"[nNiI]")  # letters of "nan" and "inf"


def _read(file: Path, where: str, options: ReadOptions) -> Iterator[TelemetryTable]:
    """Yield a table without rows, for the columns, and then a table for each block of lines."""
    header: list[str] = []
    try:
        with file.open("rb") as stream:
            for first, raw in _comma_separated(stream, where):
                if not header:
                    number, header = _find_header(first, raw, where)
                    if not header:
                        continue
                    columns = tuple(options.columns.select(header, f"{where}: line {number}"))
                    known = np.isin(header, columns)
                    ignored = tuple(name for name in header if name not in columns)
                    raw, first = raw[number - first + 1 :], number + 1
                    empty = np.empty((0, len(columns)))
                    yield TelemetryTable(columns, empty, np.arange(0), "line", ignored)
                if not raw:
                    continue
                lines = np.arange(first, first + len(raw))
                block = _read_clean(raw, len(header))
                if block is None:
                    numbered = numbered_text(first, raw, where)
                    numbers, block = _read_cells(numbered, header, known, options)
                    lines = np.array(numbers, dtype=int)
                values = block if known.all() else block[:, known]
                yield TelemetryTable(columns, values, lines, "line", ignored)
    except OSError as error:
        raise InputError(f"{where}: cannot be read: {error.strerror}") from error
    if not header:
        raise InputError(f"{where}: the file is empty")


def _check_head(file: Path, where: str, columns: Selection) -> None:
    """Refuse a file whose first line is not a header with the columns of telemetry."""
    with file.open("rb") as stream:
        for first, raw in _comma_separated(stream, where):
            number, header = _find_header(first, raw, where)
            if header:
                columns.select(header, f"{where}: line {number}")
                return


def _write(path: Path, columns: list[str], values: NDArray[np.float64]) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        for row in values.tolist():
            writer.writerow(["" if value != value else repr(value) for value in row])


def blocks_of_lines(stream: BinaryIO, where: str) -> Iterator[tuple[int, list[bytes]]]:
    """Yield some thousand lines at a time, without line ends, and the number of the first."""
    first, rest, data = 1, b"", stream.read(_BLOCK)
    while data:
        following = stream.read(_BLOCK)
        lines = (rest + data).split(b"\n")
        rest = lines.pop()
        if len(rest) > _LONGEST_LINE or (not lines and len(rest) >= _BLOCK):
            number = first + len(lines)
            raise InputError(f"{where}: line {number} is longer than {_LONGEST_LINE} bytes")
        if rest and not following:  # the last line has no end
            lines.append(rest)
        if lines:
            yield first, lines
        first, data = first + len(lines), following


def _comma_separated(stream: BinaryIO, where: str) -> Iterator[tuple[int, list[bytes]]]:
    """Yield blocks of lines; cells that semicolons separate in the header are so everywhere."""
    semicolons = None
    for first, lines in blocks_of_lines(stream, where):
        if semicolons is None:
            header = next((line for line in lines if line.strip() and line[:1] != b"#"), None)
            semicolons = None if header is None else b";" in header and b"," not in header
        yield first, [line.replace(b";", b",") for line in lines] if semicolons else lines


def numbered_text(first: int, lines: Sequence[bytes], where: str) -> Iterator[tuple[int, str]]:
    """Yield the lines that are not empty or comments, with their numbers."""
    for number, data in enumerate(lines, first):
        if len(data) > _LONGEST_LINE:
            raise InputError(f"{where}: line {number} is longer than {_LONGEST_LINE} bytes")
        try:
            line = data.decode("utf-8-sig" if number == 1 else "utf-8").rstrip("\r")
        except UnicodeDecodeError as error:
            raise InputError(
                f"{where}: line {number} is not text in UTF-8; if this is a CSV file, save it in "
                "that encoding"
            ) from error
        if line and not line.startswith("#"):
            yield number, line


def _split(line: str) -> list[str]:
    """Return the cells of a line.

    Raises:
        csv.Error: its quotes are not valid in CSV.

    """
    return next(csv.reader([line], strict=True)) if '"' in line else line.split(",")


def _find_header(first: int, lines: Sequence[bytes], where: str) -> tuple[int, list[str]]:
    """Return the names of columns and the number of their last line; no names without lines.

    A header of Vicon's Nexus or Tracker has five lines: the kind of data, frames per second,
    bodies, names, and units. Names are then such as "Base:TX [mm]" and "Frame [100 Hz]".
    """
    numbered = numbered_text(first, lines, where)
    number, line = next(numbered, (0, ""))
    if line.strip(",").strip().strip('"') not in _VICON:
        return number, _header(number, line, where) if line else []
    try:
        rate, bodies, names, units = (_split(text) for _, text in islice(numbered, 4))
    except (ValueError, csv.Error) as error:
        raise InputError(f"{where}: Vicon's header of five lines is cut off or wrong") from error
    header, body = [], ""
    for k, name in enumerate(names):
        body = (bodies[k] if k < len(bodies) else "").strip() or body
        unit = units[k].strip() if k < len(units) else ""
        unit = f"{rate[0].strip()} Hz" if name == "Frame" else unit
        header.append((f"{body}:" if body else "") + name.strip() + (f" [{unit}]" if unit else ""))
    return number + 4, header


def _header(number: int, line: str, where: str) -> list[str]:
    if "\0" in line:
        raise InputError(f"{where}: not a CSV file: line {number} holds binary data")
    try:
        names = [name.strip() for name in _split(line)]
    except csv.Error as error:
        raise InputError(f"{where}: line {number}: quotes are wrong: {error}") from error
    if len(names) == 1:
        for separator, word in (("\t", "tabs"), (" ", "blanks")):
            if line.count(separator) > 3:
                raise InputError(
                    f"{where}: line {number}: columns are separated by {word}; use commas or "
                    "semicolons, and decimal points"
                )
    if len(names) > MOST_COLUMNS:
        raise InputError(f"{where}: line {number}: more than {MOST_COLUMNS} columns")
    if names[0] and not names[0].strip("0123456789+-.eE"):
        raise InputError(
            f"{where}: line {number} holds numbers; the first line must hold the columns' names"
        )
    return names


def _read_clean(lines: Sequence[bytes], columns: int) -> NDArray[np.float64] | None:
    """Return lines of numbers and empty cells as a block (n, columns); None for other lines.

    Empty cells become NaN.
    """
    if lines[0].endswith(b"\r"):
        lines = [line.removesuffix(b"\r") for line in lines]
    text = b"\n".join([b"", *lines, b""])
    has_empty = any(empty in text for empty in (b",,", b",\n", b"\n,"))
    if has_empty:
        if _NOT_A_NUMBER.search(text):  # a cell with this text is a problem, not an absent sample
            return None
        for _ in range(2):  # one replacement finds every second one of neighbouring empty cells
            text = text.replace(b",,", b",nan,")
        text = text.replace(b",\n", b",nan\n").replace(b"\n,", b"\nnan,")
        if b"\n\n" in text:
            return None
        lines = text[1:-1].split(b"\n")
    try:
        block = np.loadtxt(
            lines, delimiter=",", comments=None, quotechar='"', ndmin=2, encoding="latin1"
        )
    except ValueError:
        return None
    usable = not np.isinf(block).any() and (has_empty or not np.isnan(block).any())
    # A quote that is open at the end of a line would join the next line to it.
    return block if block.shape == (len(lines), columns) and usable else None


def _read_cells(
    numbered: Iterator[tuple[int, str]],
    header: list[str],
    known: NDArray[np.bool_],
    options: ReadOptions,
) -> tuple[list[int], NDArray[np.float64]]:
    """Read lines cell by cell; return their line numbers and their values.

    Lines with a problem are left out. Cells of text are absent if the options collect them.
    Absent cells and cells of unknown columns become NaN.
    """
    problems, texts = options.problems, options.columns.texts
    numbers, rows = [], []
    for number, line in numbered:
        try:
            cells = _split(line)
        except csv.Error as error:
            problems.add(f"line {number}", f"quotes are wrong: {error}")
            continue
        if len(cells) != len(header):
            text = f"{len(cells)} cells, but {len(header)} columns"
            if len(cells) > len(header):
                text += "; are decimals written with commas?"
            problems.add(f"line {number}", text)
            continue
        values = np.full(len(header), np.nan)
        for k, cell in enumerate(cells):
            if not (known[k] and cell and (cell := cell.strip())):
                continue
            try:
                values[k] = float(cell) if cell.isascii() and "_" not in cell else np.inf
            except ValueError:
                values[k] = np.inf
            if not np.isfinite(values[k]) and texts is not None:
                texts.setdefault(header[k], cell)
                values[k] = np.nan
            elif not np.isfinite(values[k]):
                remedy = "leave the cell of an absent sample empty"
                if cell.lower().lstrip("+-") not in ("nan", "inf", "infinity"):
                    remedy = "give a number with a decimal point"
                place = f"line {number}, column '{header[k]}'"
                problems.add(place, f"'{cell:.40}' is not a finite number; {remedy}")
                break
        else:
            numbers.append(number)
            rows.append(values)
    return numbers, np.array(rows).reshape(-1, len(header))


CSV = Format("CSV", (".csv",), _read, _write, _check_head)
