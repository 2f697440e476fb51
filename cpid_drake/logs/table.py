"""The columns of a log file as they are in the file."""

import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpid_drake.array import Array
from cpid_drake.files.errors import InputError
from cpid_drake.logs.column_map import UNIT_OF, scale_of


@dataclass(eq=False)
class LogTable:
    """N rows of a file, its columns by name.

    Attributes:
        columns: by name, the numbers (N,), NaN where a cell is absent.
        lines: (N,) numbers of the lines in a text file; None for rows 0, 1, ….
        texts: by column, its cells that are not finite numbers, by row; they are NaN in `columns`.
        unreadable: by column that cannot be used, why, such as "must hold numbers"; it is not in
            `columns`.
        problems: rows that could not be read: their numbers in the file, and what is wrong.
        rejected: by quantity, the number of samples that the reader left out.
        notes: by sensor, what the reader found.
        header: place of the names in the file, for messages, such as "line 1".
        files: names of several files that make one log; see `joined`.
        file_of_row: (N,) the file of each row, as its place in `files`.
        file_of_column: by column, its file.

    """

    columns: dict[str, Array]
    lines: NDArray[np.intp] | None = None
    texts: dict[str, dict[int, str]] = field(default_factory=dict)
    unreadable: dict[str, str] = field(default_factory=dict)
    problems: list[tuple[int, str]] = field(default_factory=list)
    rejected: Counter[str] = field(default_factory=Counter)
    notes: dict[str, tuple[str, ...]] = field(default_factory=dict)
    header: str = ""
    files: tuple[str, ...] = ()
    file_of_row: NDArray[np.intp] | None = None
    file_of_column: dict[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.columns = {n: c for n, c in self.columns.items() if n not in self.unreadable}
        for name, column in self.columns.items():
            rows = np.flatnonzero(np.isinf(column))
            if rows.size:
                self.texts.setdefault(name, {}).update(dict.fromkeys(rows.tolist(), "inf"))
                self.columns[name] = np.where(np.isinf(column), np.nan, column)

    def __len__(self) -> int:
        return next((len(column) for column in self.columns.values()), 0)

    def of_columns(self, names: Iterable[str]) -> "LogTable":
        """Return the numbers of some columns only."""
        columns = {name: self.columns[name] for name in names}
        return replace(
            LogTable(columns, self.lines),
            files=self.files,
            file_of_row=self.file_of_row,
            file_of_column=self.file_of_column,
        )

    def of_rows(self, rows: NDArray[np.intp]) -> "LogTable":
        """Return the numbers of some rows only."""
        file_of_row = None if self.file_of_row is None else self.file_of_row[rows]
        return replace(
            LogTable({name: column[rows] for name, column in self.columns.items()}),
            lines=self.numbers[rows],
            files=self.files,
            file_of_row=file_of_row,
            file_of_column=self.file_of_column,
        )

    def is_empty(self, name: str) -> bool:
        """Return whether a column has rows, and nothing in them."""
        column = self.columns[name]
        return column.size > 0 and name not in self.texts and bool(np.isnan(column).all())

    def block(self, names: Iterable[str]) -> Array:
        """Return columns side by side, (N, k)."""
        columns = [self.columns[name] for name in names]
        return np.stack(columns, axis=1) if columns else np.empty((len(self), 0))

    def place(self, row: int | np.intp, column: str = "") -> tuple[int, str]:
        """Return the number of a row in the file, and the place of a cell for messages."""
        word, number = "row" if self.lines is None else "line", int(self.numbers[row])
        file = "" if self.file_of_row is None else f"{self.files[self.file_of_row[row]]}: "
        return number, f"{file}{word} {number}" + (f", column '{column}'" if column else "")

    @property
    def numbers(self) -> NDArray[np.intp]:
        """(N,) numbers of the rows in their file."""
        return np.arange(len(self)) if self.lines is None else self.lines


_STAMP = re.compile(
    r"(?P<day>\d{4}-\d\d-\d\d)?[T ]?(?P<time>\d\d:\d\d:\d\d([.,]\d{1,9})?)"
    r"(?P<zone> ?(Z|UTC|[+-]\d\d:?\d\d))?"
)
_DAY = 86_400 * 10**9  # ns

_DURATION = re.compile(
    r"(?P<number>[+-]?\d+(\.\d+)?(e[+-]?\d+)?) ?(?P<unit>[a-zµ]+)"  # of MATLAB's timetables
    r"|((?P<days>\d+) days? )?(?P<hours>\d+):(?P<minutes>\d\d):(?P<seconds>\d\d(\.\d+)?)"
)
_SECONDS = {word: scale_of(u) for word, u in UNIT_OF.items() if u in ("s", "ms", "us", "ns")}
_SECONDS |= {"min": 60.0, "hr": 3600.0, "day": 86_400.0, "days": 86_400.0}


def seconds_of_texts(texts: Sequence[str]) -> Array | None:
    """Return the times (N,) [s] that texts (N,) say; None for texts that are no times.

    They are stamps of ISO 8601 or of hh:mm:ss, counted from the first; or durations with a unit,
    such as "0.02 sec", or with days or more than 24 hours, as they are. All stamps must have a date
    and the same time zone, or none; a time of day may pass midnight.
    """
    stamps = _since_first(texts)
    return _durations(texts) if stamps is None else stamps


def _since_first(texts: Sequence[str]) -> Array | None:
    """Return seconds since the first stamp; None for other texts."""
    matches = [_STAMP.fullmatch(text) for text in texts]
    kinds = {(bool(m["day"]), m["zone"]) if m else None for m in matches}
    if len(kinds) != 1 or None in kinds:
        return None
    days = ((m["day"] or "1970-01-01", m["time"].replace(",", ".")) for m in matches if m)
    try:
        stamps = np.array(["T".join(pair) for pair in days], dtype="datetime64[ns]").astype(int)
    except ValueError:  # no such day or hour
        return None
    if not matches[0] or not matches[0]["day"]:
        stamps = stamps + _DAY * np.append(0, np.cumsum(np.diff(stamps) < -_DAY // 2))
    return np.asarray((stamps - stamps[0]) / 1e9)


def _durations(texts: Sequence[str]) -> Array | None:
    """Return the seconds of durations; None for other texts."""
    seconds = np.empty(len(texts))
    for k, text in enumerate(texts):
        m = _DURATION.fullmatch(text.lower())
        if m is None or (m["unit"] and m["unit"] not in _SECONDS):
            return None
        if m["unit"]:
            seconds[k] = float(m["number"]) * _SECONDS[m["unit"]]
        else:
            minutes = (int(m["days"] or 0) * 24 + int(m["hours"])) * 60 + int(m["minutes"])
            seconds[k] = minutes * 60 + float(m["seconds"])
    return seconds


def common_rows(series: Sequence[NDArray[Any]]) -> tuple[NDArray[Any], list[NDArray[np.intp]]]:
    """Return the times (R,) of rows that hold several series, and each one's rows (N,) in them.

    There is a row for each time. Samples of a series that repeat a time have further rows with it.

    Args:
        series: of each, the times (N,) in any order.

    """
    pool = np.unique(np.concatenate(series))
    count, places = np.ones(pool.size, dtype=int), []
    for times in series:
        order = np.argsort(times, kind="stable")
        place = np.searchsorted(pool, times[order])
        number = np.empty(len(times), dtype=int)  # of a sample among those with its time
        number[order] = np.arange(len(times)) - np.searchsorted(place, place)
        np.maximum.at(count, place, number[order] + 1)
        places.append(number)
    first = np.cumsum(count) - count
    rows = [first[np.searchsorted(pool, t)] + number for t, number in zip(series, places)]
    return np.repeat(pool, count), rows


def seconds_of_times(times: NDArray[Any]) -> NDArray[Any]:
    """Return seconds of NumPy's durations, and since the first of its dates; others as they are."""
    if times.dtype.kind == "M":
        times = times - times[:1]
    return times / np.timedelta64(1, "s") if times.dtype.kind == "m" else times


def repeated_names(names: Sequence[str], where: str) -> dict[str, str]:
    """Return names that several columns have, and why they cannot be used.

    Raises:
        InputError: there are too many columns.

    """
    if len(names) > 10_000:
        raise InputError(f"{where}: more than 10000 columns")
    return {name: f"is there {n} times" for name, n in Counter(names).items() if n > 1}
