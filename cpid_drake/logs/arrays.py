"""Logs in NPZ and Parquet files: one array per column; NaN or null for absent samples."""

import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpid_drake.errors import InputError
from cpid_drake.logs.table import Table, check_names

_LARGEST_COLUMN = 200_000_000
"""Largest size of an array in an NPZ file [bytes]: 69 hours at 100 Hz. Archives can be bombs."""


def read_npz(file: Path, where: str) -> Table:
    """Read a log whose arrays are columns; nothing is unpickled.

    Raises:
        InputError: not an NPZ file, a damaged one, or arrays of different lengths.

    """
    columns: dict[str, NDArray[np.float64]] = {}
    unreadable: dict[str, str] = {}
    try:
        with zipfile.ZipFile(file) as archive:
            members = [info.filename.removesuffix(".npy") for info in archive.infolist()]
            twice = check_names(members, where)
            for name, info in zip(members, archive.infolist()):
                if name in columns or name in unreadable:
                    continue
                found = _array(archive, info)
                if isinstance(found, str):
                    unreadable[name] = found
                else:
                    columns[name] = found
    except (zipfile.BadZipFile, zlib.error, EOFError, OSError, RuntimeError) as error:
        # RuntimeError: encrypted, or compressed in a way that is not known here.
        raise InputError(f"{where}: not an NPZ file, or a damaged one: {error}") from error
    reference = "time" if "time" in columns else next(iter(columns), "")
    count = len(columns[reference]) if columns else 0
    for name in [name for name, column in columns.items() if len(column) != count]:
        unreadable[name] = f"has {len(columns.pop(name))} samples, but '{reference}' {count}"
    return Table(columns, unreadable=unreadable, twice=twice)


def _array(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> NDArray[np.float64] | str:
    """Return an array of numbers in an archive, or why it is none.

    The header is read first and compared with the size, so that no memory is allocated for a wrong
    length.
    """
    if member.file_size > _LARGEST_COLUMN:
        return f"holds {member.file_size} bytes, which are too many"
    with archive.open(member) as stream:
        try:
            version = np.lib.format.read_magic(stream)
            read = {
                (1, 0): np.lib.format.read_array_header_1_0,
                (2, 0): np.lib.format.read_array_header_2_0,
            }.get(version)
            if read is None:
                return f"is in a version of the NPY format that is not read: {version}"
            shape, _, dtype = read(stream)
        except (zipfile.BadZipFile, zlib.error, OSError):
            raise
        except Exception:  # NumPy evaluates the header as Python
            return "is not a NumPy array: its header is wrong"
        if dtype.kind not in "fiu" or len(shape) != 1:
            return f"must be an array of numbers with one dimension, not {dtype} of shape {shape}"
        size = member.file_size - stream.tell()
        if size != shape[0] * dtype.itemsize:
            return f"is cut off: {size} bytes for {shape[0]} numbers"
        return np.frombuffer(stream.read(), dtype=dtype).astype(float)


def read_parquet(file: Path, where: str) -> Table:
    """Read a log from a Parquet file.

    Raises:
        InputError: pyarrow is not installed, or the file cannot be read.

    """
    pyarrow, parquet = _pyarrow(where)
    columns, unreadable = {}, {}
    try:
        source = parquet.ParquetFile(file)
        schema = source.schema_arrow
        twice = check_names(schema.names, where)
        for name in dict.fromkeys(schema.names):
            kind = schema.field(schema.names.index(name)).type
            if not (pyarrow.types.is_floating(kind) or pyarrow.types.is_integer(kind)):
                unreadable[name] = f"must hold numbers, not {kind}"
            elif name not in twice:
                chunks = source.read(columns=[name]).column(name).cast(pyarrow.float64())
                columns[name] = chunks.to_numpy()
            else:
                columns[name] = np.full(source.metadata.num_rows, np.nan)
    except (pyarrow.ArrowException, OSError) as error:
        text = " ".join(str(error).split())
        raise InputError(f"{where}: not a Parquet file that can be read: {text:.200}") from error
    return Table(columns, unreadable=unreadable, twice=twice)


def _pyarrow(where: str) -> tuple[Any, Any]:
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as error:
        raise InputError(
            f"{where}: Parquet needs pyarrow; `pip install 'cpid-drake[parquet]'`"
        ) from error
    return pyarrow, pyarrow.parquet


def write_npz(path: Path, columns: list[str], values: NDArray[np.float64]) -> None:
    """Write columns and values (N, C)."""
    arrays: dict[str, Any] = dict(zip(columns, values.T, strict=True))
    np.savez(path, **arrays)


def write_parquet(path: Path, columns: list[str], values: NDArray[np.float64]) -> None:
    """Write columns and values (N, C); NaN becomes null."""
    pyarrow, parquet = _pyarrow(str(path))
    arrays = [pyarrow.array(column, from_pandas=True) for column in values.T]
    parquet.write_table(pyarrow.table(dict(zip(columns, arrays, strict=True))), path)
