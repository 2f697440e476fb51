"""Logs in text files: a header, then one line per time; absent samples are empty cells.

Commas separate the cells, or semicolons, tabs or blanks, as in the header. Without a header, the
columns are named 1, 2, 3, ….
"""

import csv
from collections.abc import Iterator, Sequence
from itertools import chain, islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cpid_drake.errors import InputError
from cpid_drake.logs.table import Table, repeated_names

_LONGEST_LINE = 1_000_000
"""Longest line of a text file [bytes]: 10000 columns of 100 digits. A binary file has none."""

_BLOCK = 20_000
"""Lines that are converted at once: their cells as text take a few tens of megabytes."""

_VICON = ("Segments", "Objects", "Trajectories", "Joints", "Model Outputs")
"""First lines of Vicon's files."""

Lines = Iterator[tuple[int, str]]


def read_csv(file: Path, where: str) -> Table:
    """Read a log; cells that are not finite numbers are in `Table.texts`.

    Raises:
        InputError: the file is empty, has no usable header, or is not text.

    """
    lines = _lines(file, where)
    place, header, separator, lines = _header(lines, where)
    problems: list[tuple[int, str]] = []
    numbers: list[NDArray[np.intp]] = [np.empty(0, dtype=int)]
    blocks = [np.empty((0, len(header)))]
    texts: dict[str, dict[int, str]] = {}
    count = 0
    while block := list(islice(lines, _BLOCK)):
        values = _plain(block, len(header), separator)
        if values is not None:
            kept = [number for number, _ in block]
        else:
            rows, kept = _cells(block, len(header), separator, problems)
            values = np.empty((len(rows), len(header)))
            for k, cells in enumerate(zip(*rows)):
                values[:, k], others = _numbers(cells)
                for row, text in others.items():
                    texts.setdefault(header[k], {})[count + row] = text
        blocks.append(values)
        numbers.append(np.array(kept, dtype=int))
        count += len(values)
    return Table(
        dict(zip(header, np.ascontiguousarray(np.concatenate(blocks).T))),
        np.concatenate(numbers),
        "line",
        texts,
        repeated_names(header, where),
        problems,
        header=place,
    )


def write_csv(path: Path, columns: list[str], values: NDArray[np.float64]) -> None:
    """Write columns and values (N, C); NaN becomes an empty cell."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        for row in values.tolist():
            writer.writerow(["" if value != value else repr(value) for value in row])


def _lines(file: Path, where: str) -> Lines:
    """Yield the lines that are not empty or comments, with their numbers."""
    number = 0
    try:
        with file.open("rb") as stream:
            while data := stream.readline(_LONGEST_LINE + 1):
                number += 1
                if len(data) > _LONGEST_LINE:
                    raise InputError(f"{where}: line {number} is longer than {_LONGEST_LINE} bytes")
                line = data.decode("utf-8-sig" if number == 1 else "utf-8").rstrip("\r\n")
                if line and line[0] != "#":
                    yield number, line
    except UnicodeDecodeError as error:
        raise InputError(
            f"{where}: line {number} is not text in UTF-8; if this is a CSV file, save it in that "
            "encoding"
        ) from error
    except OSError as error:
        raise InputError(f"{where}: cannot be read: {error.strerror}") from error


def _header(lines: Lines, where: str) -> tuple[str, list[str], str | None, Lines]:
    """Return place and names of columns, their separator (None for blanks), and the rows.

    A header of Vicon's Nexus or Tracker has five lines: the kind of data, frames per second,
    bodies, names, and units. Names are then such as "Base:TX [mm]" and "Frame [100 Hz]".
    """
    number, line = next(lines, (0, ""))
    if not line:
        raise InputError(f"{where}: the file is empty")
    if "\0" in line:
        raise InputError(f"{where}: not a CSV file: line {number} holds binary data")
    separator = next((s for s in ",;\t" if s in line), None)
    if separator is None and " " not in line.strip():
        separator = ","
    try:
        if line.strip(",; \t").strip('"') in _VICON:
            return f"line {number + 4}", _vicon_names(lines), ",", lines
        names = [name.strip() for name in _split(line, separator)]
    except (ValueError, csv.Error) as error:
        problem = f"the header cannot be read: {error}"
        raise InputError(f"{where}: line {number}: {problem}") from error
    if not _numbers(names)[1] and all(names):
        names = [str(k + 1) for k in range(len(names))]
        lines = chain([(number, line)], lines)
    return f"line {number}", names, separator, lines


def _vicon_names(lines: Lines) -> list[str]:
    rate, bodies, names, units = (_split(text, ",") for _, text in islice(lines, 4))
    header, body = [], ""
    for k, name in enumerate(names):
        body = (bodies[k] if k < len(bodies) else "").strip() or body
        unit = units[k].strip() if k < len(units) else ""
        unit = f"{rate[0].strip()} Hz" if name == "Frame" else unit
        header.append((f"{body}:" if body else "") + name.strip() + (f" [{unit}]" if unit else ""))
    return header


def _split(line: str, separator: str | None) -> list[str]:
    """Return the cells of a line; None separates by any number of blanks.

    Raises:
        csv.Error: its quotes are not valid in CSV.

    """
    if '"' in line and separator is not None:
        return next(csv.reader([line], delimiter=separator, strict=True))
    return line.split(separator)


def _plain(
    block: list[tuple[int, str]], width: int, separator: str | None
) -> NDArray[np.float64] | None:
    """Return lines of finite numbers as (n, width), in a third of the time; None for others."""
    try:
        lines = [line for _, line in block]
        values = np.loadtxt(lines, delimiter=separator, comments=None, ndmin=2)
    except ValueError:
        return None
    return values if values.shape == (len(block), width) and np.isfinite(values).all() else None


def _cells(
    block: list[tuple[int, str]],
    width: int,
    separator: str | None,
    problems: list[tuple[int, str]],
) -> tuple[list[list[str]], list[int]]:
    """Return the cells of lines and the lines' numbers; lines that cannot be split are problems."""
    rows, kept = [], []
    for number, line in block:
        try:
            cells = _split(line, separator)
        except csv.Error as error:
            problems.append((number, f"line {number}: quotes are wrong: {error}"))
            continue
        if len(cells) == width:
            rows.append(cells)
            kept.append(number)
        else:
            text = f"line {number}: {len(cells)} cells, but {width} columns"
            more = "; are decimals written with commas?" if len(cells) > width else ""
            problems.append((number, text + more))
    return rows, kept


def _numbers(cells: Sequence[str]) -> tuple[NDArray[np.float64], dict[int, str]]:
    """Return the cells of a column as numbers (n,), NaN where they are empty or text; the texts."""
    values, texts = np.full(len(cells), np.nan), {}
    for k, cell in enumerate(cells):
        if not cell:
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
