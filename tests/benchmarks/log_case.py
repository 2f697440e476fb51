"""One spoiled log: its source, what is wrong with it, and the words that name the cause."""

from dataclasses import dataclass

import log_spoils as spoil
from log_sources import CLEAN, Motion

GROUPS = ("issue", "units", "frames", "joints", "clocks", "model", "payload", "momentum", "noise")


@dataclass(frozen=True, eq=False)
class Case:
    """One spoiled log.

    Attributes:
        group: one of `GROUPS`.
        source: name in `log_sources.SOURCES`.
        words: regular expression, for text in lower case: a message that matches names the cause.
        samples: spoils the samples; None for no change.
        columns: spoils the columns, after the samples; None for no change.
        motion: changes of the truth.
        options: options of `cpid identify` that replace those of the source.
        only: further options of the single run; None to run with the variants of the bench.
        capture_frame: name of a wrong capture frame; empty for the right one.

    """

    group: str
    source: str
    words: str
    samples: spoil.Spoil | None = None
    columns: spoil.ColumnSpoil | None = None
    motion: Motion = CLEAN
    options: tuple[str, ...] = ()
    only: tuple[str, ...] | None = None
    capture_frame: str = ""
