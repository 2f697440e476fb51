"""Telemetry in JSON-lines files: one object per line; a key that is absent or null is no sample.

Nested objects and lists are columns such as "pose.position.x" and `position[0]`.
"""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cpid_drake.errors import InputError
from cpid_drake.sensing.files.csv_format import MOST_COLUMNS, blocks_of_lines, numbered_text
from cpid_drake.sensing.files.formats import Format, ReadOptions
from cpid_drake.sensing.files.table import TelemetryTable

_BLOCK = 20_000
"""Number of lines that are read at once."""

Value = float | str | None


def _read(file: Path, where: str, options: ReadOptions) -> Iterator[TelemetryTable]:
    """Yield a table without rows, for the columns, and then a table for each block of lines."""
    texts = options.columns.texts
    try:
        names: dict[str, None] = {}
        for _, row, _ in _rows(file, where):
            names.update(dict.fromkeys(row))
            if len(names) > MOST_COLUMNS:
                raise InputError(f"{where}: more than {MOST_COLUMNS} keys")
        if not names:
            raise InputError(f"{where}: there is no line with a JSON object")
        columns = {name: k for k, name in enumerate(options.columns.select(list(names), where))}
        ignored = tuple(name for name in names if name not in columns)
        empty = np.empty((0, len(columns)))
        yield TelemetryTable(tuple(columns), empty, np.arange(0), "line", ignored)
        lines: list[int] = []
        values: list[NDArray[np.float64]] = []
        for number, row, problem in _rows(file, where):
            cells = np.full(len(columns), np.nan)
            for name, cell in row.items():
                if name not in columns or cell is None:
                    continue
                if isinstance(cell, str) and texts is not None:
                    texts.setdefault(name, cell)
                elif isinstance(cell, str) or not np.isfinite(cell):
                    problem = problem or f"'{name}' is {cell!r:.40}, not a finite number"
                else:
                    cells[columns[name]] = cell
            if problem:
                options.problems.add(f"line {number}", problem)
                continue
            lines.append(number)
            values.append(cells)
            if len(lines) == _BLOCK:
                yield TelemetryTable(
                    tuple(columns), np.stack(values), np.array(lines), "line", ignored
                )
                lines, values = [], []
        if lines:
            yield TelemetryTable(tuple(columns), np.stack(values), np.array(lines), "line", ignored)
    except OSError as error:
        raise InputError(f"{where}: cannot be read: {error.strerror}") from error


def _rows(file: Path, where: str) -> Iterator[tuple[int, Mapping[str, Value], str]]:
    """Yield the number of every line, its values by column, and its problem or an empty text."""
    with file.open("rb") as stream:
        for first, raw in blocks_of_lines(stream, where):
            for number, line in numbered_text(first, raw, where):
                try:
                    tree = json.loads(line, object_pairs_hook=_unique)
                    row = dict(_flat("", tree)) if isinstance(tree, dict) else None
                    yield number, row or {}, "" if row else "must be an object with values"
                except (ValueError, RecursionError, OverflowError) as error:
                    yield number, {}, f"not a JSON object: {error}"


def _unique(pairs: list[tuple[str, object]]) -> dict[str, object]:
    tree = dict(pairs)
    if len(tree) < len(pairs):
        raise ValueError("a key is given twice")
    return tree


def _flat(prefix: str, tree: object) -> Iterator[tuple[str, Value]]:
    """Yield the leaves of a tree with their paths."""
    if isinstance(tree, dict):
        for key, item in tree.items():
            yield from _flat(f"{prefix}.{key}" if prefix else key, item)
    elif isinstance(tree, list):
        for k, item in enumerate(tree):
            yield from _flat(f"{prefix}[{k}]", item)
    elif tree is None or isinstance(tree, str):
        yield prefix, tree
    elif isinstance(tree, bool):
        yield prefix, str(tree).lower()
    elif isinstance(tree, int | float):
        yield prefix, float(tree)


def _write(path: Path, columns: list[str], values: NDArray[np.float64]) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        for row in values.tolist():
            there = {name: value for name, value in zip(columns, row) if value == value}
            file.write(json.dumps(there) + "\n")


JSON_LINES = Format("JSON lines", (".jsonl", ".ndjson"), _read, _write)
