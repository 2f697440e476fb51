"""Telemetry in MATLAB files (.mat up to version 7): vectors and matrices, also in structs.

A vector is a column of its name, a matrix `a` has the columns `a(:,1)`, `a(:,2)`, …, and a field
of a struct is `s.field`. Variables of another length than most are not samples, and are ignored;
NaN is an absent sample.
"""

import zlib
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cpid_drake.errors import InputError
from cpid_drake.sensing.files.csv_format import MOST_COLUMNS
from cpid_drake.sensing.files.formats import Format, ReadOptions
from cpid_drake.sensing.files.table import LARGEST_TABLE, TelemetryTable

_HDF5 = b"MATLAB 7.3 MAT-file"


def _read(file: Path, where: str, options: ReadOptions) -> TelemetryTable:
    with file.open("rb") as stream:
        head = stream.read(128)
    if head.startswith(_HDF5):
        raise InputError(
            f"{where}: MATLAB's format 7.3 (HDF5) is not read; save the variables with "
            "save('log.mat', 'time', ..., '-v7')"
        )
    from scipy.io import loadmat, whosmat

    try:
        size = sum(int(np.prod(shape)) for _, shape, _ in whosmat(file))
        if size > LARGEST_TABLE:
            raise InputError(f"{where}: more than {LARGEST_TABLE} numbers; split the file")
        variables = loadmat(file, struct_as_record=True, squeeze_me=False, chars_as_strings=True)
    except InputError:
        raise
    except (OSError, zlib.error, EOFError, MemoryError, RecursionError) as error:
        raise InputError(f"{where}: not a MATLAB file, or a damaged one: {error}") from error
    except Exception as error:  # SciPy raises exceptions of many types on damaged files
        problem = f"{type(error).__name__}: {error}"
        raise InputError(f"{where}: not a MATLAB file, or a damaged one ({problem})") from error
    arrays = dict(_arrays(variables))
    if not arrays:
        raise InputError(
            f"{where}: there are no vectors or matrices of numbers (tables and timeseries are not "
            "read; save their columns as arrays)"
        )
    lengths = Counter(max(array.shape) for array in arrays.values())
    count = max(lengths, key=lambda length: (lengths[length] if length > 1 else 0, length))
    columns = dict(_columns(arrays, count))
    keep = options.columns.select(list(columns), where)
    others = tuple(name for name, array in arrays.items() if count not in array.shape)
    ignored = (*(name for name in columns if name not in keep), *others)
    values = np.stack([columns[name] for name in keep], axis=1)
    return TelemetryTable(tuple(keep), values, np.arange(1, count + 1), ignored=ignored)


def _arrays(variables: dict[str, NDArray]) -> Iterator[tuple[str, NDArray]]:
    """Yield the arrays of numbers with two dimensions, also those in structs, with their names."""
    for name, value in variables.items():
        if name.startswith("__") or not isinstance(value, np.ndarray):
            continue
        if value.dtype.names and value.size == 1:
            record = value.reshape(-1)[0]
            inside = [(f"{name}.{field}", record[field]) for field in value.dtype.names]
        else:
            inside = [(name, value)]
        for path, array in inside:
            is_array = isinstance(array, np.ndarray) and array.dtype.kind in "fiub"
            if is_array and array.ndim == 2 and array.size:
                yield path, array


def _columns(arrays: dict[str, NDArray], count: int) -> Iterator[tuple[str, NDArray[np.float64]]]:
    """Yield the columns (count,) of vectors and matrices with this number of samples."""
    for name, array in arrays.items():
        if count not in array.shape or min(array.shape) > MOST_COLUMNS:
            continue
        by_row = array if array.shape[0] == count else array.T
        for k, column in enumerate(by_row.T.astype(float), 1):
            yield (name if min(array.shape) == 1 else f"{name}(:,{k})"), column


MATLAB = Format("MATLAB", (".mat",), _read)
