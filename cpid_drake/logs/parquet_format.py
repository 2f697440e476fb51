"""Logs in Parquet files: NaN or null for absent samples."""

from pathlib import Path
from typing import Any

from cpid_drake.array import Array
from cpid_drake.files.errors import InputError
from cpid_drake.logs.table import LogTable, repeated_names, seconds_of_times


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
                columns[name] = seconds_of_times(stamps)
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


def write_parquet(path: Path, columns: list[str], values: Array) -> None:
    """Write columns and values (N, C); NaN becomes null."""
    pyarrow, parquet = _pyarrow(str(path))
    arrays = [pyarrow.array(column, from_pandas=True) for column in values.T]
    parquet.write_table(pyarrow.table(dict(zip(columns, arrays, strict=True))), path)
