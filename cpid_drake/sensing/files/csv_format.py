"""Telemetry in CSV files: a header, then one line per time; absent samples are empty cells."""

import csv
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from cpid_drake.errors import InputError
from cpid_drake.sensing.files.formats import Format, Topics
from cpid_drake.sensing.files.table import (
    LARGEST_TABLE,
    Problems,
    TelemetryTable,
    check_columns,
    known_column,
)

_LONGEST_LINE = 1_000_000
_BLOCK = 4_000_000
_MOST_COLUMNS = 10_000


def _read(file: Path, where: str, problems: Problems, topics: Topics) -> TelemetryTable:
    header, blocks, places, size = None, [], [], 0
    try:
        with file.open("rb") as stream:
            for first, raw in _blocks_of_lines(stream, where):
                if header is None:
                    number, line = next(_numbered_text(first, raw, where), (0, ""))
                    if not line:
                        continue
                    header = _header(number, line, where)
                    known = np.array([known_column(name) for name in header])
                    raw, first = raw[number - first + 1 :], number + 1
                    blocks.append(np.empty((0, known.sum())))
                if not raw:
                    continue
                numbers: Sequence[int] = range(first, first + len(raw))
                block = _read_clean(raw, len(header))
                if block is None:
                    numbered = _numbered_text(first, raw, where)
                    numbers, block = _read_cells(numbered, header, problems)
                blocks.append(block if known.all() else block[:, known])
                places.append(numbers)
                size += blocks[-1].size
                if size > LARGEST_TABLE:
                    raise InputError(f"{where}: more than {LARGEST_TABLE} numbers; split the file")
    except OSError as error:
        raise InputError(f"{where}: cannot be read: {error.strerror}") from error
    if header is None:
        raise InputError(f"{where}: the file is empty")
    columns = tuple(name for name in header if known_column(name))
    ignored = tuple(name for name in header if not known_column(name))
    lines = np.concatenate([np.array(numbers, dtype=int) for numbers in ([], *places)])
    return TelemetryTable(columns, np.concatenate(blocks), lines, "line", ignored)


def _check_head(file: Path, where: str) -> None:
    """Refuse a file whose first line is not a header with the columns of telemetry."""
    with file.open("rb") as stream:
        for first, raw in _blocks_of_lines(stream, where):
            for number, line in _numbered_text(first, raw, where):
                _header(number, line, where)
                return


def _write(path: Path, columns: list[str], values: NDArray[np.float64]) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        for row in values.tolist():
            writer.writerow(["" if value != value else repr(value) for value in row])


def _blocks_of_lines(stream: BinaryIO, where: str) -> Iterator[tuple[int, list[bytes]]]:
    """Yield some thousand lines at a time, without line ends, and the number of the first."""
    first, rest = 1, b""
    while data := stream.read(_BLOCK):
        lines = (rest + data).split(b"\n")
        rest = lines.pop()
        if len(rest) > _LONGEST_LINE or (not lines and len(rest) >= _BLOCK):
            number = first + len(lines)
            raise InputError(f"{where}: line {number} is longer than {_LONGEST_LINE} bytes")
        if lines:
            yield first, lines
        first += len(lines)
    if rest:
        yield first, [rest]


def _numbered_text(first: int, lines: Sequence[bytes], where: str) -> Iterator[tuple[int, str]]:
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


def _header(number: int, line: str, where: str) -> list[str]:
    if "\0" in line:
        raise InputError(f"{where}: not a CSV file: line {number} holds binary data")
    try:
        names = [name.strip() for name in _split(line)]
    except csv.Error as error:
        raise InputError(f"{where}: line {number}: quotes are wrong: {error}") from error
    if len(names) == 1:
        for separator, word in ((";", "semicolons"), ("\t", "tabs"), (" ", "blanks")):
            if line.count(separator) > 3:
                raise InputError(
                    f"{where}: line {number}: columns are separated by {word}; use commas, and "
                    "decimal points"
                )
    if len(names) > _MOST_COLUMNS:
        raise InputError(f"{where}: line {number}: more than {_MOST_COLUMNS} columns")
    if names[0] and not names[0].strip("0123456789+-.eE"):
        raise InputError(
            f"{where}: line {number} holds numbers; the first line must hold the columns' names"
        )
    check_columns(names, f"{where}: line {number}")
    return names


def _read_clean(lines: Sequence[bytes], columns: int) -> NDArray[np.float64] | None:
    """Return lines with a number in every cell as a block (n, columns); None for other lines."""
    if lines[0].endswith(b"\r"):
        lines = [line.removesuffix(b"\r") for line in lines]
    try:
        block = np.loadtxt(
            lines, delimiter=",", comments=None, quotechar='"', ndmin=2, encoding="latin1"
        )
    except ValueError:
        return None
    # A quote that is open at the end of a line would join the next line to it.
    return block if block.shape == (len(lines), columns) and np.isfinite(block).all() else None


def _read_cells(
    numbered: Iterator[tuple[int, str]], header: list[str], problems: Problems
) -> tuple[list[int], NDArray[np.float64]]:
    """Read lines cell by cell; return their line numbers and their values.

    Lines with a problem are left out. Absent cells and cells of unknown columns become NaN.
    """
    numbers, rows = [], []
    known = [known_column(name) for name in header]
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
            if not np.isfinite(values[k]):
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
