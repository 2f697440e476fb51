"""Telemetry in NPZ and Parquet files: one array per column; NaN or null for absent samples."""

import zipfile
from pathlib import Path
from typing import Any

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


def _read_npz(file: Path, where: str, problems: Problems, topics: Topics) -> TelemetryTable:
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
    return _table(names, keep, arrays, where)


def _read_npy(archive: zipfile.ZipFile, member: zipfile.ZipInfo, where: str) -> NDArray[np.float64]:
    """Read one array: check its size before memory is allocated, and unpickle nothing."""
    if member.file_size > 8 * LARGEST_TABLE // 10:
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
        except Exception as error:  # NumPy evaluates the header as Python
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


def _read_parquet(file: Path, where: str, problems: Problems, topics: Topics) -> TelemetryTable:
    pyarrow, parquet = _pyarrow(where)
    try:
        source = parquet.ParquetFile(file)
        names = source.schema_arrow.names
        check_columns(names, where)
        keep = [name for name in names if known_column(name)]
        if source.metadata.num_rows * len(keep) > LARGEST_TABLE:
            raise InputError(f"{where}: more than {LARGEST_TABLE} numbers; split the file")
        for name in keep:
            kind = source.schema_arrow.field(name).type
            if not (pyarrow.types.is_floating(kind) or pyarrow.types.is_integer(kind)):
                raise InputError(f"{where}: column '{name}' must hold numbers, not {kind}")
        table = source.read(columns=keep)
        arrays = [table.column(name).cast(pyarrow.float64()).to_numpy() for name in keep]
    except (pyarrow.ArrowException, OSError) as error:
        text = " ".join(str(error).split())
        raise InputError(f"{where}: not a Parquet file that can be read: {text:.200}") from error
    return _table(names, keep, arrays, where)


def _pyarrow(where: str) -> tuple[Any, Any]:
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as error:
        raise InputError(
            f"{where}: Parquet needs pyarrow; `pip install 'cpid-drake[parquet]'`"
        ) from error
    return pyarrow, pyarrow.parquet


def _table(
    names: list[str], kept: list[str], arrays: list[NDArray[np.float64]], where: str
) -> TelemetryTable:
    """Return the arrays of the kept columns, of equal length, as a table; NaN if absent."""
    lengths = {name: len(values) for name, values in zip(kept, arrays, strict=True)}
    for name, length in lengths.items():
        if length != lengths["time"]:
            raise InputError(
                f"{where}: column '{name}' has {length} samples, but 'time' {lengths['time']}"
            )
    values = np.stack(arrays, axis=1)
    ignored = tuple(name for name in names if name not in kept)
    return TelemetryTable(tuple(kept), values, np.arange(len(values)), ignored=ignored)


def _write_npz(path: Path, columns: list[str], values: NDArray[np.float64]) -> None:
    arrays: dict[str, Any] = dict(zip(columns, values.T, strict=True))
    np.savez(path, **arrays)


def _write_parquet(path: Path, columns: list[str], values: NDArray[np.float64]) -> None:
    pyarrow, parquet = _pyarrow(str(path))
    arrays = [pyarrow.array(column, from_pandas=True) for column in values.T]
    parquet.write_table(pyarrow.table(dict(zip(columns, arrays, strict=True))), path)


NPZ = Format("NPZ", (".npz",), _read_npz, _write_npz)

PARQUET = Format("Parquet", (".parquet",), _read_parquet, _write_parquet)
