"""Telemetry in NPZ and Parquet files: one array per column; NaN or null for absent samples."""

import zipfile
import zlib
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpid_drake.errors import InputError
from cpid_drake.sensing.files.formats import Format, ReadOptions
from cpid_drake.sensing.files.table import TelemetryTable

_BLOCK = 20_000
"""Number of rows that are read at once."""

_LARGEST_COLUMN = 200_000_000
"""Largest size of an array in an NPZ file [bytes]: 69 hours at 100 Hz. Archives can be bombs."""


def _read_npz(file: Path, where: str, options: ReadOptions) -> Iterator[TelemetryTable]:
    try:
        with zipfile.ZipFile(file) as archive, ExitStack() as opened:
            members = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}
            names = list(members)
            keep = options.columns.select(names, where)
            ignored = tuple(name for name in names if name not in keep)
            columns = [
                _NpyColumn(opened, archive, members[name], f"{where}: '{name}'") for name in keep
            ]
            reference = "time" if "time" in keep else keep[0]
            count = columns[keep.index(reference)].count
            for name, column in zip(keep, columns):
                if column.count != count:
                    raise InputError(
                        f"{where}: column '{name}' has {column.count} samples, but '{reference}' "
                        f"{count}"
                    )
            # At least one block, which may be empty; at the end zipfile compares the CRC.
            for first in range(0, count + 1, _BLOCK):
                rows = np.arange(first, min(first + _BLOCK, count))
                values = np.stack([column.read(rows.size) for column in columns], axis=1)
                yield TelemetryTable(tuple(keep), values, rows, ignored=ignored)
    except (zipfile.BadZipFile, zlib.error, EOFError, OSError, RuntimeError) as error:
        # RuntimeError: encrypted, or compressed in a way that is not known here.
        raise InputError(f"{where}: not an NPZ file, or a damaged one: {error}") from error


class _NpyColumn:
    """An array of numbers in the NPY format, which is read piece by piece.

    The header is read first and compared with the size, so that no memory is allocated for a wrong
    length; nothing is unpickled.

    Args:
        opened: closes the file.
        archive, member: the NPY file in an archive.
        where: the array's name in messages.

    Attributes:
        count: length of the array.

    """

    def __init__(
        self, opened: ExitStack, archive: zipfile.ZipFile, member: zipfile.ZipInfo, where: str
    ) -> None:
        if member.file_size > _LARGEST_COLUMN:
            raise InputError(f"{where}: {member.file_size} bytes are too many")
        self._stream = stream = opened.enter_context(archive.open(member))
        try:
            version = np.lib.format.read_magic(stream)
            read_header = {
                (1, 0): np.lib.format.read_array_header_1_0,
                (2, 0): np.lib.format.read_array_header_2_0,
            }.get(version)
            if read_header is None:
                raise InputError(f"{where}: this version of the NPY format is not read: {version}")
            shape, _, self._dtype = read_header(stream)
        except InputError:
            raise
        except (zipfile.BadZipFile, zlib.error, OSError):
            raise
        except Exception as error:  # NumPy evaluates the header as Python
            raise InputError(f"{where}: not a NumPy array: its header is wrong") from error
        if self._dtype.kind not in "fiu" or len(shape) != 1:
            raise InputError(
                f"{where}: must be an array of numbers with one dimension, not {self._dtype} of "
                f"shape {shape}"
            )
        self.count, size = shape[0], member.file_size - stream.tell()
        if size != self.count * self._dtype.itemsize:
            raise InputError(f"{where}: cut off: {size} bytes for {self.count} numbers")

    def read(self, count: int) -> NDArray[np.float64]:
        """Return the next `count` numbers."""
        data = self._stream.read(count * self._dtype.itemsize)
        return np.frombuffer(data, dtype=self._dtype).astype(float)


def _read_parquet(file: Path, where: str, options: ReadOptions) -> Iterator[TelemetryTable]:
    pyarrow, parquet = _pyarrow(where)
    try:
        source = parquet.ParquetFile(file, buffer_size=1 << 20)
        names = source.schema_arrow.names
        keep = options.columns.select(names, where)
        for name in list(keep):
            kind = source.schema_arrow.field(name).type
            if pyarrow.types.is_floating(kind) or pyarrow.types.is_integer(kind):
                continue
            if options.columns.texts is None:
                raise InputError(f"{where}: column '{name}' must hold numbers, not {kind}")
            keep.remove(name)
        ignored = tuple(name for name in names if name not in keep)
        yield TelemetryTable(tuple(keep), np.empty((0, len(keep))), np.arange(0), ignored=ignored)
        first = 0
        for batch in source.iter_batches(_BLOCK, columns=keep):
            arrays = [
                batch.column(name).cast(pyarrow.float64()).to_numpy(zero_copy_only=False)
                for name in keep
            ]
            rows = np.arange(first, first + batch.num_rows)
            yield TelemetryTable(tuple(keep), np.stack(arrays, axis=1), rows, ignored=ignored)
            first += batch.num_rows
    except (pyarrow.ArrowException, OSError) as error:
        text = " ".join(str(error).split())
        raise InputError(f"{where}: not a Parquet file that can be read: {text:.200}") from error


def _pyarrow(where: str) -> tuple[Any, Any]:
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as error:
        raise InputError(
            f"{where}: Parquet needs pyarrow; `pip install 'cpid-drake[parquet]'`"
        ) from error
    return pyarrow, pyarrow.parquet


def _write_npz(path: Path, columns: list[str], values: NDArray[np.float64]) -> None:
    arrays: dict[str, Any] = dict(zip(columns, values.T, strict=True))
    np.savez(path, **arrays)


def _write_parquet(path: Path, columns: list[str], values: NDArray[np.float64]) -> None:
    pyarrow, parquet = _pyarrow(str(path))
    arrays = [pyarrow.array(column, from_pandas=True) for column in values.T]
    parquet.write_table(pyarrow.table(dict(zip(columns, arrays, strict=True))), path)


NPZ = Format("NPZ", (".npz",), _read_npz, _write_npz)

PARQUET = Format("Parquet", (".parquet",), _read_parquet, _write_parquet)
