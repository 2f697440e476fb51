"""Logs in NPZ and Parquet files: one array per column; NaN or null for absent samples."""

import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from cpid_drake.array import Array
from cpid_drake.files.errors import InputError
from cpid_drake.logs.table import LogTable, repeated_names

_LARGEST_COLUMN = 200_000_000
"""Largest size of an array in an NPZ file [bytes]: 69 hours at 100 Hz. Archives can be bombs."""


def read_npz(file: Path, where: str) -> LogTable:
    """Read a log whose arrays are columns; nothing is unpickled.

    Raises:
        InputError: not an NPZ file, or a damaged one.

    """
    columns: dict[str, Array] = {}
    unreadable: dict[str, str] = {}
    try:
        with zipfile.ZipFile(file) as archive:
            names = [info.filename.removesuffix(".npy") for info in archive.infolist()]
            for name, info in zip(names, archive.infolist()):
                if info.file_size > _LARGEST_COLUMN:
                    unreadable[name] = f"holds {info.file_size} bytes, which are too many"
                    continue
                try:
                    with archive.open(info) as stream:
                        array = np.lib.format.read_array(stream, allow_pickle=False)
                except (ValueError, MemoryError) as error:
                    unreadable[name] = f"is not a NumPy array of numbers: {error!s:.99}"
                    continue
                if array.dtype.kind == "M" and array.ndim == 1 and not np.isnat(array).any():
                    array = (array - array[:1]) / np.timedelta64(1, "s")
                if array.dtype.kind in "fiu" and array.ndim == 1:
                    columns[name] = array.astype(float)
                else:
                    text = f"{array.dtype} of shape {array.shape}"
                    unreadable[name] = f"must be an array of numbers with one dimension, not {text}"
    except (zipfile.BadZipFile, zlib.error, EOFError, OSError, RuntimeError) as error:
        # RuntimeError: encrypted, or compressed in a way that is not known here.
        raise InputError(f"{where}: not an NPZ file, or a damaged one: {error}") from error
    reference = "time" if "time" in columns else next(iter(columns), "")
    for name, column in columns.items():
        count = len(columns[reference])
        if len(column) != count:
            unreadable[name] = f"has {len(column)} samples, but '{reference}' {count}"
    return LogTable(columns, unreadable=unreadable | repeated_names(names, where))


def read_parquet(file: Path, where: str) -> LogTable:
    """Read a log from a Parquet file.

    Raises:
        InputError: pyarrow is not installed; not a Parquet file that can be read.

    """
    pyarrow, parquet = _pyarrow(where)
    columns = {}
    try:
        source = parquet.ParquetFile(file)
        schema = source.schema_arrow
        unreadable = repeated_names(schema.names, where)
        for name, kind in zip(schema.names, schema.types):
            if pyarrow.types.is_timestamp(kind) and name not in unreadable:
                stamps = source.read(columns=[name]).column(name).to_numpy()
                columns[name] = (stamps - stamps[:1]) / np.timedelta64(1, "s")
            elif not (pyarrow.types.is_floating(kind) or pyarrow.types.is_integer(kind)):
                unreadable.setdefault(name, f"must hold numbers, not {kind}")
            elif name not in unreadable:
                chunks = source.read(columns=[name]).column(name).cast(pyarrow.float64())
                columns[name] = chunks.to_numpy()
    except (pyarrow.ArrowException, OSError) as error:
        text = " ".join(str(error).split())
        raise InputError(f"{where}: not a Parquet file that can be read: {text:.200}") from error
    return LogTable(columns, unreadable=unreadable)


def _pyarrow(where: str) -> tuple[Any, Any]:
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as error:
        raise InputError(
            f"{where}: Parquet needs pyarrow; `pip install 'cpid-drake[parquet]'`"
        ) from error
    return pyarrow, pyarrow.parquet


def write_npz(path: Path, columns: list[str], values: Array) -> None:
    """Write columns and values (N, C)."""
    arrays: dict[str, Any] = dict(zip(columns, values.T, strict=True))
    np.savez(path, **arrays)


def write_parquet(path: Path, columns: list[str], values: Array) -> None:
    """Write columns and values (N, C); NaN becomes null."""
    pyarrow, parquet = _pyarrow(str(path))
    arrays = [pyarrow.array(column, from_pandas=True) for column in values.T]
    parquet.write_table(pyarrow.table(dict(zip(columns, arrays, strict=True))), path)
