"""Ways to spoil the order and the times of a log."""

from collections.abc import Callable

import numpy as np
from log_spoils import Columns, ColumnSpoil, Spoil, changed
from numpy.typing import NDArray

from cpid_drake.sensing.measurements import Measurements, Samples


def retimed(name: str, change: Callable[[NDArray[np.float64]], NDArray[np.float64]]) -> Spoil:
    """Return a spoil of one sensor's times; samples before t = 0 are removed."""

    def apply(samples: Samples) -> Samples:
        time = np.round(change(samples.time), 6)
        return Samples(time, samples.value).where(time >= 0)

    return changed(name, apply)


def played_backwards(columns: Columns) -> Columns:
    """Return the rows in the opposite order, at increasing times."""
    time = columns["time"]
    return {
        name: time[-1] - time[::-1] if name == "time" else values[::-1]
        for name, values in columns.items()
    }


def shuffled(columns: Columns) -> Columns:
    """Return the rows in random order, the times included."""
    order = np.random.default_rng(3).permutation(columns["time"].size)
    return {name: values[order] for name, values in columns.items()}


def shuffled_values(columns: Columns) -> Columns:
    """Return the rows in random order at increasing times."""
    return {**shuffled(columns), "time": columns["time"]}


def closed_gaps(share: float) -> Spoil:
    """Return a spoil that loses bursts of rows, while the times are counted on."""

    def apply(m: Measurements) -> Measurements:
        end = max(s.time[-1] for _, s in m.items() if len(s))
        starts = np.random.default_rng(4).uniform(0.1 * end, 0.9 * end, 5)
        length = share * end / 5

        def closed(s: Samples) -> Samples:
            lost = np.zeros(len(s), dtype=bool)
            shift = np.zeros(len(s))
            for start in starts:
                lost |= (s.time >= start) & (s.time < start + length)
                shift += length * (s.time >= start + length)
            time = np.round(s.time - shift, 6)
            kept = np.flatnonzero(~lost)
            kept = kept[np.unique(time[kept], return_index=True)[1]]
            return Samples(time[kept], s.value[kept])

        return m.updated({name: closed(s) for name, s in m.items() if len(s)})

    return apply


def lost_rows(share: float) -> ColumnSpoil:
    """Return a spoil that loses single rows at random."""

    def apply(columns: Columns) -> Columns:
        kept = np.random.default_rng(5).random(columns["time"].size) >= share
        return {name: values[kept] for name, values in columns.items()}

    return apply


def joined_with_jump(columns: Columns) -> Columns:
    """Return the second half of the log before the first half, at increasing times."""
    half = columns["time"].size // 2
    rolled = {name: np.roll(values, half) for name, values in columns.items()}
    return {**rolled, "time": columns["time"]}
