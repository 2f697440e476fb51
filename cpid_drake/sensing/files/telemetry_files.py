"""Telemetry from and to files: CSV, NPZ, Parquet and ROS 2 bags."""

import csv
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.telemetry import Telemetry
from cpid_drake.errors import InputError
from cpid_drake.resources import resolve_model
from cpid_drake.sensing.files.table import (
    LARGEST,
    Problems,
    TelemetryTable,
    check_columns,
    known_column,
    measurements_of_table,
    table_of,
)
from cpid_drake.sensing.measurements import Measurements

TABLE_ENDINGS = (".csv", ".npz", ".parquet")
BAG_ENDINGS = (".mcap", ".db3")

_LONGEST_LINE = 1_000_000
_BLOCK = 4_000_000
_LARGEST_TABLE = 250_000_000  # numbers: 2 GB
_MOST_COLUMNS = 10_000


@dataclass(frozen=True, eq=False)
class TelemetryFile:
    """What is in a telemetry file, and what is wrong with it.

    Attributes:
        measurements: the samples of every sensor that have no problem.
        row_count: number of rows in the file.
        problems: what is wrong, and where.
        partial: by sensor, the number of samples of which only a part is there; left out.
        ignored: columns whose name means nothing.

    """

    measurements: Measurements
    row_count: int
    problems: Problems
    partial: dict[str, int]
    ignored: tuple[str, ...]


def inspect_telemetry(
    path: str | Path, *, topics: Mapping[str, str] | None = None
) -> TelemetryFile:
    """Read a telemetry file and say all that is wrong in it.

    What the columns mean is said in `telemetry_table`; in CSV files a sample that is absent is an
    empty cell, in NPZ files (one array (N,) for each column) NaN, in Parquet files null or NaN.
    Bags are read as `rosbag_files.read_rosbag` does.

    Args:
        path: the file, or a bag's folder.
        topics: of a bag: see `rosbag_files.read_rosbag`.

    Raises:
        InputError: no such file or folder, a file of another kind, or one in which nothing can be
            read: see also `telemetry_table.check_columns`.

    """
    where = str(path)
    if _is_bag(path):
        from cpid_drake.sensing.files.rosbag import read_rosbag

        return _of_bag(read_rosbag(path, topics=topics))
    if topics:
        raise InputError(f"{where}: topics are for ROS 2 bags")
    file = _table_file(path)
    readers = {".csv": _read_csv, ".npz": _read_npz, ".parquet": _read_parquet}
    problems = Problems()
    try:
        table, ignored = readers[file.suffix.lower()](file, where, problems)
    except MemoryError as error:
        raise InputError(f"{where}: the file does not fit into memory") from error
    row_count = len(table.values)
    measurements, partial = measurements_of_table(table, problems)
    if not problems.count and not any(len(samples) for _, samples in measurements.items()):
        raise InputError(f"{where}: there are no samples in it")
    return TelemetryFile(measurements, row_count, problems, partial, ignored)


def check_telemetry(path: str | Path) -> None:
    """Refuse a file that cannot be telemetry, without reading more than the head of a CSV file.

    Raises:
        InputError: no such file, a file of another kind, or a CSV file with a wrong first line.

    """
    if _is_bag(path):
        return
    file = _table_file(path)
    if file.suffix.lower() == ".csv":
        with file.open("rb") as stream:
            for first, raw in _blocks_of_lines(stream, str(path)):
                for number, line in _numbered_text(first, raw, str(path)):
                    _header(number, line, str(path))
                    return


def _is_bag(path: str | Path) -> bool:
    return Path(path).suffix in BAG_ENDINGS or Path(path).is_dir()


def _table_file(path: str | Path) -> Path:
    file = resolve_model(path)
    if file.suffix.lower() not in TABLE_ENDINGS:
        raise InputError(
            f"{path}: telemetry is read from {', '.join((*TABLE_ENDINGS, *BAG_ENDINGS))} files "
            f"and bag folders, not from '{file.suffix or file.name}'"
        )
    return file


def read_telemetry(
    path: str | Path,
    *,
    leave_out_bad: bool = False,
    topics: Mapping[str, str] | None = None,
) -> Measurements:
    """Return the samples in a telemetry file: CSV, NPZ, Parquet or a ROS 2 bag.

    Args:
        path: the file, or a bag's folder.
        leave_out_bad: leave out rows that have a problem, instead of refusing the file.
        topics: of a bag: see `rosbag_files.read_rosbag`.

    Raises:
        InputError: as `inspect_telemetry`, and, unless bad rows are left out, the first problem.

    """
    found = inspect_telemetry(path, topics=topics)
    if not leave_out_bad:
        refuse_problems(found, str(path))
    return found.measurements


def refuse_problems(found: TelemetryFile, where: str) -> None:
    """Refuse a file that has problems.

    Raises:
        InputError: the first of them.

    """
    if found.problems.count:
        others = found.problems.count - 1
        more = f" (and {others} more: `cpid telemetry check` lists them)" if others else ""
        raise InputError(f"{where}: {found.problems.first[0]}{more}")


def write_telemetry(path: str | Path, motion: Telemetry | Measurements) -> None:
    """Write telemetry or measurements to a CSV, NPZ or Parquet file; all digits are kept.

    Raises:
        InputError: the name ends otherwise, or a time is there twice in one sensor.

    """
    path = Path(path)
    columns, values = table_of(motion)
    if path.suffix == ".csv":
        with path.open("w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(columns)
            for row in values.tolist():
                writer.writerow(["" if value != value else repr(value) for value in row])
    elif path.suffix == ".npz":
        np.savez(path, **dict(zip(columns, values.T, strict=True)))
    elif path.suffix == ".parquet":
        pyarrow, parquet = _pyarrow(str(path))
        arrays = [pyarrow.array(column, from_pandas=True) for column in values.T]
        parquet.write_table(pyarrow.table(dict(zip(columns, arrays, strict=True))), path)
    else:
        raise InputError(f"{path}: telemetry is written as {', '.join(TABLE_ENDINGS)}")


def _of_bag(measurements: Measurements) -> TelemetryFile:
    """Return a bag's samples; those that cannot be used are problems, as rows are elsewhere."""
    problems, usable = Problems(), {}
    rows = sum(len(samples) for _, samples in measurements.items())
    for name, samples in measurements.items():
        fits = (np.abs(samples.value) <= LARGEST).all(axis=1)
        for k in np.flatnonzero(~fits):
            place = f"{name}, message {k + 1} at {samples.time[k]:.6f} s"
            problems.add(place, "a number that is not finite or cannot be meant")
        usable[name] = samples.where(fits)
    return TelemetryFile(measurements.updated(usable), rows, problems, {}, ())


# -- CSV ------------------------------------------------------------------------------------------


def _read_csv(file: Path, where: str, problems: Problems) -> tuple[TelemetryTable, tuple[str, ...]]:
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
                numbers, block = range(first, first + len(raw)), _read_clean(raw, len(header))
                if block is None:
                    numbered = _numbered_text(first, raw, where)
                    numbers, block = _read_cells(numbered, header, problems)
                blocks.append(block if known.all() else block[:, known])
                places.append(numbers)
                size += blocks[-1].size
                if size > _LARGEST_TABLE:
                    raise InputError(f"{where}: more than {_LARGEST_TABLE} numbers; split the file")
    except OSError as error:
        raise InputError(f"{where}: cannot be read: {error.strerror}") from error
    if header is None:
        raise InputError(f"{where}: the file is empty")
    columns = tuple(name for name in header if known_column(name))
    ignored = tuple(name for name in header if not known_column(name))
    lines = np.concatenate([np.array(numbers, dtype=int) for numbers in ([], *places)])
    return TelemetryTable(columns, np.concatenate(blocks), lines, "line"), ignored


def _blocks_of_lines(stream: BinaryIO, where: str) -> Iterator[tuple[int, list[bytes]]]:
    """Yield some thousand lines at a time, without their ends, and the number of the first."""
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
        csv.Error: its quotes are not those of CSV.

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
    """Return lines that hold a number in every cell as a block (n, columns); None for others."""
    if lines[0].endswith(b"\r"):
        lines = [line.removesuffix(b"\r") for line in lines]
    try:
        block = np.loadtxt(
            lines, delimiter=",", comments=None, quotechar='"', ndmin=2, encoding="latin1"
        )
    except ValueError:
        return None
    # A quote that is open at the end of a line would take the next line in.
    return block if block.shape == (len(lines), columns) and np.isfinite(block).all() else None


def _read_cells(
    numbered: Iterator[tuple[int, str]], header: list[str], problems: Problems
) -> tuple[list[int], NDArray[np.float64]]:
    """Read numbered lines cell by cell: absent ones become NaN, lines with a problem are noted.

    Columns without a meaning may hold anything: they become NaN.
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


# -- NPZ and Parquet ------------------------------------------------------------------------------


def _read_npz(file: Path, where: str, problems: Problems) -> tuple[TelemetryTable, tuple[str, ...]]:
    try:
        with zipfile.ZipFile(file) as archive:
            members = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}
            names = list(members)
            check_columns(names, where)
            keep = [name for name in names if known_column(name)]
            arrays = [_read_npy(archive, members[name], f"{where}: '{name}'") for name in keep]
    except (zipfile.BadZipFile, EOFError, OSError, RuntimeError) as error:
        # RuntimeError: encrypted, or compressed in a way that is not known here.
        raise InputError(f"{where}: not an NPZ file, or a damaged one: {error}") from error
    ignored = tuple(name for name in names if name not in keep)
    return _stacked(keep, arrays, where), ignored


def _read_npy(archive: zipfile.ZipFile, member: zipfile.ZipInfo, where: str) -> NDArray[np.float64]:
    """Read one array; its size is checked before anything is made for it, and nothing unpickled."""
    if member.file_size > 8 * _LARGEST_TABLE // 10:
        raise InputError(f"{where}: {member.file_size} bytes are too many")
    with archive.open(member) as stream:
        try:
            version = np.lib.format.read_magic(stream)
            read_header = {
                (1, 0): np.lib.format.read_array_header_1_0,
                (2, 0): np.lib.format.read_array_header_2_0,
            }.get(version)
            if read_header is None:
                raise InputError(f"{where}: this version of the NPY format is not read: {version}")
            shape, _, dtype = read_header(stream)
        except InputError:
            raise
        except Exception as error:  # NumPy reads the header as Python would, and raises as it does
            raise InputError(f"{where}: not a NumPy array: its header is wrong") from error
        if dtype.kind not in "fiu" or len(shape) != 1:
            raise InputError(
                f"{where}: must be an array of numbers with one dimension, not {dtype} of shape "
                f"{shape}"
            )
        data = stream.read()
    if len(data) != shape[0] * dtype.itemsize:
        raise InputError(f"{where}: cut off: {len(data)} bytes for {shape[0]} numbers")
    return np.frombuffer(data, dtype=dtype).astype(float)


def _read_parquet(
    file: Path, where: str, problems: Problems
) -> tuple[TelemetryTable, tuple[str, ...]]:
    pyarrow, parquet = _pyarrow(where)
    try:
        source = parquet.ParquetFile(file)
        names = source.schema_arrow.names
        check_columns(names, where)
        keep = [name for name in names if known_column(name)]
        if source.metadata.num_rows * len(keep) > _LARGEST_TABLE:
            raise InputError(f"{where}: more than {_LARGEST_TABLE} numbers; split the file")
        for name in keep:
            kind = source.schema_arrow.field(name).type
            if not (pyarrow.types.is_floating(kind) or pyarrow.types.is_integer(kind)):
                raise InputError(f"{where}: column '{name}' must hold numbers, not {kind}")
        table = source.read(columns=keep)
        arrays = [table.column(name).cast(pyarrow.float64()).to_numpy() for name in keep]
    except (pyarrow.ArrowException, OSError) as error:
        text = " ".join(str(error).split())
        raise InputError(f"{where}: not a Parquet file that can be read: {text:.200}") from error
    ignored = tuple(name for name in names if name not in keep)
    return _stacked(keep, arrays, where), ignored


def _pyarrow(where: str) -> tuple:
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as error:
        raise InputError(
            f"{where}: Parquet needs pyarrow; `pip install 'cpid-drake[parquet]'`"
        ) from error
    return pyarrow, pyarrow.parquet


def _stacked(names: list[str], arrays: list[NDArray[np.float64]], where: str) -> TelemetryTable:
    """Return columns of equal length as a table; NaN is absent."""
    lengths = {name: len(values) for name, values in zip(names, arrays, strict=True)}
    for name, length in lengths.items():
        if length != lengths["time"]:
            raise InputError(
                f"{where}: column '{name}' has {length} samples, but 'time' {lengths['time']}"
            )
    values = np.stack(arrays, axis=1)
    return TelemetryTable(tuple(names), values, np.arange(len(values)))
