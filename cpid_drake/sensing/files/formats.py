"""The type of a format of telemetry files: endings, reader and writer."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cpid_drake.sensing.files.table import Problems, TelemetryTable
from cpid_drake.sensing.measurements import Measurements

Topics = Mapping[str, str] | None
"""Names of a bag's topics by kind, if any are given."""


Reader = Callable[[Path, str, Problems, Topics], TelemetryTable | Measurements]
"""Reads a file, given its path, its name in messages, a list of problems to extend, and topics.

Returns a table, or measurements if each sensor has its own times. Raises an InputError if nothing
can be read.
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
        check_head: refuses a file that cannot be telemetry after a look at its beginning.
        is_bag: whether a folder can have this format too, and topics can be chosen.

    """

    name: str
    endings: tuple[str, ...]
    read: Reader
    write: Callable[[Path, list[str], NDArray[np.float64]], None] | None = None
    check_head: Callable[[Path, str], None] | None = None
    is_bag: bool = False
