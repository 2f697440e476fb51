"""The type of a format of telemetry files: endings, reader and writer."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from cpid_drake.sensing.files.table import Problems, TelemetryTable
from cpid_drake.sensing.measurements import Measurements

Topics = Mapping[str, str] | None
"""Names of a bag's topics by kind, if any are given."""


class Selection(Protocol):
    """Selects the columns of a file that are read.

    Attributes:
        texts: by column, its first cell that is text, which a reader adds; such cells are then
            absent samples. None if text is a problem.

    """

    texts: dict[str, str] | None

    def select(self, names: Sequence[str], where: str) -> list[str]:
        """Return the columns to read, or raise an InputError if they are no telemetry.

        Args:
            names: all columns of the file.
            where: the file's name in error messages.

        """


@dataclass(frozen=True)
class ReadOptions:
    """The options of a reader.

    Attributes:
        problems: a list of problems to extend.
        columns: selects the columns to read; a reader yields these columns as they are in the file.
        topics: topics of a bag, by kind.

    """

    problems: Problems
    columns: Selection
    topics: Topics = None


Contents = TelemetryTable | Iterator[TelemetryTable] | Measurements
"""What a reader returns: a table, consecutive tables of the same columns (at least one), or
measurements if each sensor has its own times."""

Reader = Callable[[Path, str, ReadOptions], Contents]
"""Reads a file, given its path, its name in messages, and options.

Raises an InputError if nothing can be read. A file is read with a small memory if its reader
returns consecutive tables.
"""


@dataclass(frozen=True)
class Format:
    """A format of telemetry files.

    Attributes:
        name: the format's name in messages.
        endings: endings of file names, in lower case, each with its dot.
        read: the reader.
        write: writes columns, names and values (N, C) with NaN where a cell is absent; None if the
            format is only read.
        check_head: refuses a file that cannot be telemetry after a look at its beginning, given its
            path, its name in messages, and the columns to read.
        is_bag: whether a folder can have this format too, and topics can be chosen.

    """

    name: str
    endings: tuple[str, ...]
    read: Reader
    write: Callable[[Path, list[str], NDArray[np.float64]], None] | None = None
    check_head: Callable[[Path, str, Selection], None] | None = None
    is_bag: bool = False
