"""Logs in text files: a header, then one line per time; absent samples are empty cells.

Commas separate the cells, or semicolons, tabs or blanks, as in the header. Without a header, the
columns are named 1, 2, 3, ….
"""

import csv
from collections.abc import Iterator
from itertools import chain, islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cpid_drake.errors import InputError
from cpid_drake.logs.table import Table, check_names

_LONGEST_LINE = 1_000_000
_BLOCK = 20_000  # lines that are converted at once
_VICON = ("Segments", "Objects", "Trajectories", "Joints", "Model Outputs")
"""First lines of Vicon's files."""

Lines = Iterator[tuple[int, str]]


def read_csv(file: Path, where: str) -> Table:
    """Read a log; cells that are not finite numbers are in `Table.texts`.

    Raises:
        InputError: the file is empty, has no usable header, or is not text.

    """
    lines = _lines(file, where)
    place, header, separator, has_names, lines = _header(lines, where)
    twice = check_names(header, where)
    problems: list[tuple[int, str]] = []
    numbers: list[NDArray[np.intp]] = []
    blocks: list[list[NDArray[np.float64]]] = []
    texts: dict[str, dict[int, str]] = {}
    count = 0
    while block := list(islice(lines, _BLOCK)):
        plain = _plain(block, len(header), separator)
        if plain is not None:
            blocks.append(list(plain.T))
            numbers.append(np.array([number for number, _ in block]))
            count += len(block)
            continue
        rows, kept = _cells(block, len(header), separator, problems)
        if not rows:
            continue
        columns = []
        is_plain = not any("_" in line for _, line in block)
        for name, cells in zip(header, zip(*rows)):
            values, others = _numbers(cells, is_plain)
            columns.append(values)
            for row, text in others.items():
                texts.setdefault(name, {})[count + row] = text
        blocks.append(columns)
        numbers.append(np.array(kept))
        count += len(rows)
    merged = {
        name: np.concatenate([np.empty(0), *(columns[k] for columns in blocks)])
        for k, name in reversed([*enumerate(header)])  # of several of a name, the first remains
    }
    return Table(
        {name: merged[name] for name in header},
        np.concatenate([np.empty(0, dtype=int), *numbers]),
        "line",
        texts,
        problems=problems,
        has_names=has_names,
        twice=twice,
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


def _header(lines: Lines, where: str) -> tuple[str, list[str], str | None, bool, Lines]:
    """Return place and names of columns, separator, whether the file has names, and its rows.

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
    if line.strip(",; \t").strip('"') in _VICON:
        return f"line {number + 4}", _vicon_header(lines, where), ",", True, lines
    try:
        names = [name.strip() for name in _split(line, separator)]
    except csv.Error as error:
        raise InputError(f"{where}: line {number}: quotes are wrong: {error}") from error
    if all(_is_number(name) for name in names):
        names = [str(k + 1) for k in range(len(names))]
        return f"line {number}", names, separator, False, chain([(number, line)], lines)
    return f"line {number}", names, separator, True, lines


def _vicon_header(lines: Lines, where: str) -> list[str]:
    try:
        rate, bodies, names, units = (_split(text, ",") for _, text in islice(lines, 4))
    except (ValueError, csv.Error) as error:
        raise InputError(f"{where}: Vicon's header of five lines is cut off or wrong") from error
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


def _numbers(cells: tuple[str, ...], is_plain: bool) -> tuple[NDArray[np.float64], dict[int, str]]:
    """Return the cells of a column as numbers (n,), NaN where they are empty or text; the texts."""
    try:
        values = np.fromiter(map(float, cells), float, len(cells))
        if is_plain and np.isfinite(values).all():  # Python's float reads "1_000", too
            return values, {}
    except ValueError:
        values = np.full(len(cells), np.nan)
    texts = {}
    for k, cell in enumerate(map(str.strip, cells)):
        if not cell or _is_number(cell):
            values[k] = float(cell or "nan")
        else:
            values[k], texts[k] = np.nan, cell
    return values, texts


def _is_number(cell: str) -> bool:
    """Return whether a cell holds a finite number."""
    try:
        return cell.isascii() and "_" not in cell and bool(np.isfinite(float(cell)))
    except ValueError:
        return False
