"""A guess at the map of a log's columns, in the making and at its end."""

import textwrap
from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass, field, fields, is_dataclass, replace
from functools import cached_property
from typing import cast

import numpy as np

from cpid_drake.array import Array
from cpid_drake.files.dumping import dump_yaml
from cpid_drake.logs.channels import look_at
from cpid_drake.logs.column_map import AttitudeColumns, ColumnMap, TimeUnit
from cpid_drake.logs.common_clock import with_delays
from cpid_drake.logs.conversion import LogFile, read_columns
from cpid_drake.logs.dropouts import marks_in
from cpid_drake.logs.guess.names import WORDS, Group, words_of
from cpid_drake.logs.instants import compared_part
from cpid_drake.logs.log import Log, Samples
from cpid_drake.logs.screening import screen
from cpid_drake.logs.table import LogTable
from cpid_drake.spacecraft.spacecraft import Spacecraft


@dataclass(eq=False)
class GuessedMap:
    """A guess at the map of a log's columns.

    Attributes:
        table: the columns of numbers (N,), NaN where a cell is absent.
        spacecraft: the spacecraft model.
        base: name of the base body.
        column_map: the map so far.
        reasons: by key of the map, the reasons for its entries; by "", what is wrong in the whole.
        missing: what the map lacks or nothing in the log confirms, in words.
        free: keys of conventions about which names and values say nothing.
        time_units: the units of time that the steps allow, if there are several.
        delays: of several files, what is added to their stamps [s]; see `common_clock`.
        attitudes: the columns, orders and units of an attitude of angles that names allow.

    """

    table: LogTable
    spacecraft: Spacecraft
    base: str
    column_map: ColumnMap = field(default_factory=ColumnMap)
    reasons: dict[str, list[str]] = field(default_factory=dict)
    missing: list[str] = field(default_factory=list)
    free: set[str] = field(default_factory=set)
    time_units: tuple[TimeUnit, ...] = ()
    delays: dict[str, float] = field(default_factory=dict)
    attitudes: tuple[AttitudeColumns, ...] = ()

    @cached_property
    def columns(self) -> dict[str, Array]:
        """The columns by name, without numbers that mark absent samples."""
        columns = self.table.columns.items()
        return {n: np.where(np.isin(c, marks_in(c)), np.nan, c) for n, c in columns}

    def say(self, key: str, text: str) -> None:
        """Add a reason for an entry."""
        self.reasons.setdefault(key, []).append(text)

    def largest(self, columns: Iterable[str]) -> float:
        """Return the largest size of a number in columns."""
        return max((float(np.nanmax(np.abs(self.columns[c]))) for c in columns), default=0.0)

    def has_unit_norm(self, columns: Iterable[str]) -> bool:
        """Return whether columns together have the norm 1 in nearly all rows that have them."""
        norm = np.linalg.norm([self.columns[name] for name in columns], axis=0)
        norms = norm[np.isfinite(norm)]
        return bool(norms.size and np.mean(np.abs(norms - 1) < 1e-2) > 0.95)

    @property
    def is_planar(self) -> bool:
        """Whether the attitude is an angle alone: of a base on a table."""
        return self.column_map.attitude.order == "yaw"

    def nearness(self, group: Group, words: Collection[str]) -> tuple[int, int, int]:
        """Return how much the name of a group is that of the base, and has of the words."""
        names, own = {self.base.lower(), *words_of(self.base)} - {""}, group.words
        return len(own & names), len(own & WORDS["base"]), len(own & {*words})

    def is_place(self, group: Group) -> bool:
        """Return whether a group is a position by its name, or has none but that of the base."""
        words = group.words
        return bool(words & WORDS["position"] or not words - WORDS["base"] - words_of(self.base))

    @property
    def log(self) -> Log:
        """The samples as read with the map, joints in the spacecraft's order, missing ones at 0."""
        return with_delays(self.with_all_clocks, self.delays)

    @property
    def with_all_clocks(self) -> Log:
        """The log with the stamps of its files."""
        return self._screened(self.read(self.table).log)

    @property
    def compared(self) -> "GuessedMap":
        """The guess with those rows and cells of the table that comparisons use.

        It is the whole table if a sensor's columns have rows of their own, or if thrusters fire.
        """
        read, table = self.read(self.table), self.table
        log = self._screened(read.log)
        part, _ = compared_part(log)
        columns, used = dict[str, Array](), np.zeros(len(table), dtype=bool)
        for sensor, names in self.column_map.of_sensors.items() if log.first_burn == np.inf else ():
            rows = np.isin(read.time, part[sensor].time)
            rows &= np.isfinite(table.block(names)).all(axis=1)
            if rows.sum() < len(part[sensor]):
                return self
            columns |= {name: np.where(rows, table.columns[name], np.nan) for name in names}
            used |= rows
        rest = replace(table, columns={**table.columns, **columns}).of_rows(np.flatnonzero(used))
        return replace(self, table=rest) if used.any() else self

    def _screened(self, read: Log) -> Log:
        """Return a log without samples that are grossly wrong, joints in the spacecraft's order."""
        log, joints = screen(look_at(read, self.spacecraft).log).log, {}
        names = self.spacecraft.joint_names
        for name in ("encoders", "joint_rates"):
            samples = log[name]
            by_joint = dict(zip(log.joint_names, np.nan_to_num(samples.value).T))
            value = [by_joint.get(joint, np.zeros(len(samples))) for joint in names]
            joints[name] = Samples(samples.time, np.reshape(value, (len(names), -1)).T)
        return replace(log.updated(joints), joint_names=names)

    def read(self, table: LogTable) -> LogFile:
        """Return a table as read with the map."""
        return read_columns(self.column_map, table, "the log")

    def text(self, heading: str = "") -> str:
        """Return the map as YAML text for `load_column_map`, its reasons as comments."""
        lines = [line for text in (heading, *self.reasons.get("", ())) for line in _comment(text)]
        for entry in fields(self.column_map):
            value = _without_defaults(getattr(self.column_map, entry.name))
            comments = [
                line for text in self.reasons.get(entry.name, ()) for line in _comment(text)
            ]
            lines += ["", *comments] if value or comments else []
            lines += [dump_yaml({entry.name: value}).rstrip()] if value else []
        return "\n".join(lines).lstrip("\n") + "\n"


def _comment(text: str) -> list[str]:
    return textwrap.wrap(text, 100, initial_indent="# ", subsequent_indent="#   ")


def _without_defaults(section: object) -> object:
    """Return a section as a tree without its defaults."""
    if not is_dataclass(section) or isinstance(section, type):
        return section
    usual, changed = cast(Callable[[], object], type(section))(), {}
    for entry in fields(section):
        given = getattr(section, entry.name)
        if not np.array_equal(given, getattr(usual, entry.name)):
            is_count = isinstance(given, float) and given.is_integer() and abs(given) > 1e3
            plain = given.tolist() if isinstance(given, np.ndarray) else given
            changed[entry.name] = int(given) if is_count else plain  # ns since 1970 are whole
    return changed
