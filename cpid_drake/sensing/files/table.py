"""Telemetry as a table with named columns, one row per time and absent cells, and its problems.

Columns, in SI units and radians; either all columns of a group are present or none:

- `time` [s], strictly increasing;
- `qw`, `qx`, `qy`, `qz`: attitude R_WB of the base as a unit quaternion;
- `x`, `y`, `z`: p_WBo_W, the base frame's origin [m];
- `wx`, `wy`, `wz`: w_WB_W, or `bwx`, `bwy`, `bwz`: w_WB_B, as gyros measure it [rad/s];
- `vx`, `vy`, `vz`: v_WBo_W [m/s];
- `q:<joint>`, `qd:<joint>`: joint positions and rates [rad, m, rad/s, m/s]. Rates of all joints or
  of none; positions of rotors, such as reaction wheels, may be absent;
- "thrust_fx", "thrust_fy", "thrust_fz", "thrust_tx", "thrust_ty", "thrust_tz": force on the base
  [N], and torque about its origin [N·m], of all thrusters together, in B. Each row holds until the
  next. Without the columns of the torque, the force acts at B's origin.

Logs on a table have `yaw` instead of the quaternion; see `sensing.files.planar_columns`.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from difflib import get_close_matches

import numpy as np
import scipy
from numpy.typing import NDArray

from cpid_drake.dynamics.telemetry import Telemetry
from cpid_drake.errors import InputError
from cpid_drake.sensing.files.planar_columns import YAW, is_planar, spatial, spatial_names
from cpid_drake.sensing.measurements import (
    FORCE_COLUMNS,
    THRUST,
    TORQUE_COLUMNS,
    Measurements,
    Samples,
)
from cpid_drake.sensing.sensors import (
    ATTITUDE,
    JOINT_POSITIONS,
    JOINT_RATES,
    SENSORS,
    Sensor,
    sensors_of,
)

LARGEST = 1e9
"""Largest plausible number in a file [SI units, rad]."""

LARGEST_TABLE = 250_000_000
"""Largest number of values in a file (2 GB)."""

LARGEST_TIME = 1e11
"""Largest plausible time in a file [s]."""


THRUST_COLUMNS = (*TORQUE_COLUMNS, *FORCE_COLUMNS)
"""Columns of logged thrust, in the order of its samples."""


@dataclass(frozen=True)
class Problem:
    """A problem in a file: its place, such as "line 12, column 'wx'", and a description."""

    place: str
    text: str

    def __str__(self) -> str:
        return f"{self.place}: {self.text}" if self.place else self.text


@dataclass(eq=False)
class Problems:
    """The problems in a file: the first hundred, and the number of all."""

    first: list[Problem] = field(default_factory=list)
    count: int = 0

    def add(self, place: str, text: str) -> None:
        """Add a problem."""
        self.count += 1
        if len(self.first) < 100:
            self.first.append(Problem(place, text))

    def add_all(self, others: "Problems") -> None:
        """Add the problems that were found before."""
        self.first = (self.first + others.first)[:100]
        self.count += others.count


@dataclass(frozen=True, eq=False)
class TelemetryTable:
    """N rows of C columns.

    Attributes:
        columns: their names.
        values: (N, C), NaN where a cell is absent.
        lines: (N,) numbers of the rows in the file.
        row_word: word for a row in messages, "line" or "row".
        ignored: names of further columns in the file, which have no meaning.
        original: by column, its name in the file, where that is another.
        logged: by sensor, whether the file has any cell of its sample in a row (N,). It is given
            where a conversion mixes the cells of a sample.

    """

    columns: tuple[str, ...]
    values: NDArray[np.float64]
    lines: NDArray[np.intp]
    row_word: str = "row"
    ignored: tuple[str, ...] = ()
    original: Mapping[str, str] = field(default_factory=dict)
    logged: Mapping[str, NDArray[np.bool_]] = field(default_factory=dict)

    def place(self, row: int | np.intp, column: str = "") -> str:
        """Return the place of a row, or of one of its cells, for messages."""
        name = self.original.get(column, column)
        cell = f", column '{name}'" if name else ""
        return f"{self.row_word} {self.lines[row]}{cell}"


def known_column(name: str) -> bool:
    """Return whether the format defines a column of this name."""
    if name in ("time", YAW, *THRUST_COLUMNS) or any(
        name in columns for columns, _ in _base_groups()
    ):
        return True
    return any(name.startswith(prefix) and name != prefix for prefix in _joint_prefixes())


def check_columns(names: Sequence[str], where: str) -> None:
    """Refuse columns from which no telemetry can be read.

    Raises:
        InputError: a repeated column, no `time`, groups that are not complete, angular velocity
            both in W and in B or in W without the attitude, no joint positions, or joints without a
            rate where others have one.

    """
    names = spatial_names(names)
    twice = [name for name, count in Counter(names).items() if count > 1]
    if twice:
        raise InputError(f"{where}: the column '{twice[0]}' is there {names.count(twice[0])} times")
    unknown = [name for name in names if not known_column(name)]
    if "time" not in names:
        raise InputError(f"{where}: there is no column 'time'{_likely('time', unknown)}")
    for columns, sensor in _base_groups():
        missing = [column for column in columns if column not in names]
        if 0 < len(missing) < len(columns):
            raise InputError(
                f"{where}: {sensor.label} needs the columns {', '.join(columns)}; missing: "
                f"{', '.join(missing)}{_likely(missing[0], unknown)}"
            )
    for columns, label in ((FORCE_COLUMNS, "force"), (TORQUE_COLUMNS, "torque")):
        missing = [column for column in columns if column not in names]
        if 0 < len(missing) < len(columns):
            raise InputError(
                f"{where}: the {label} of thrusters needs the columns {', '.join(columns)}; "
                f"missing: {', '.join(missing)}"
            )
    for sensor in SENSORS.values():
        in_W, in_B = ", ".join(sensor.columns_in_W), ", ".join(sensor.columns)
        if not in_W or sensor.columns_in_W[0] not in names:
            continue
        if sensor.columns[0] in names:
            raise InputError(
                f"{where}: {sensor.label} is there twice, in the world ({in_W}) and in the body "
                f"({in_B}); keep one of them"
            )
        if "qw" not in names:
            raise InputError(
                f"{where}: {sensor.label} in the world ({in_W}) needs the attitude (qw, qx, qy, "
                f"qz) to be rotated into the body; if it is in the body, name it {in_B}"
            )
    if not any(name.startswith("q:") for name in names):
        near = _likely("q:joint", unknown)
        raise InputError(f"{where}: there are no joint positions, columns 'q:<joint>'{near}")
    joints = _joints(names, "q:")
    for sensor in sensors_of(JOINT_POSITIONS) + sensors_of(JOINT_RATES):
        have = _joints(names, sensor.columns[0])
        without = [joint for joint in joints if have and joint not in have]
        if without:
            raise InputError(
                f"{where}: there is a column 'q:{without[0]}', but no "
                f"'{sensor.columns[0]}{without[0]}'; give {sensor.label} of all joints or of none, "
                "or leave the joint out (ignore_joints of a map of columns)"
            )


def _likely(wanted: str, unknown: Sequence[str]) -> str:
    if not unknown:
        return ""
    close = get_close_matches(wanted, unknown, n=1)
    shown = ", ".join(f"'{name:.40}'" for name in unknown[:8])
    more = f" and {len(unknown) - 8} more" if len(unknown) > 8 else ""
    if close:
        return f"; did you mean '{close[0]}'?"
    return (
        f"; ignored columns: {shown}{more}; `cpid telemetry map` finds out what the columns of a "
        "log mean"
    )


@dataclass(eq=False)
class TableConverter:
    """Converts consecutive tables of a file to measurements.

    Attributes:
        problems: found problems are added to it.
        partial: by sensor, the number of incomplete samples so far, which are left out: some cells
            of the group are absent, or an angular velocity in W has no attitude on its row.
        latest: time of the latest row so far [s]; earlier rows that follow are a problem.
        row_count: number of rows so far.

    """

    problems: Problems
    partial: Counter[str] = field(default_factory=Counter)
    latest: float = -np.inf
    row_count: int = 0

    def measurements(self, table: TelemetryTable) -> Measurements:
        """Return the samples of the next table by sensor, without rows that have a problem.

        Positions of joints that have only rates are NaN.

        Args:
            table: columns that `check_columns` accepts, cells as they were read.

        """
        if is_planar(table.columns):
            names = tuple(spatial_names(table.columns))
            table = replace(table, columns=names, values=spatial(table.columns, table.values))
        column = {name: k for k, name in enumerate(table.columns)}
        usable = self._usable_rows(table, column)
        self.row_count += len(table.values)
        return _samples_of(table, column, usable, self.partial)

    def _usable_rows(self, table: TelemetryTable, column: dict[str, int]) -> NDArray[np.bool_]:
        """Return which rows (N,) have an increasing time and plausible cells."""
        problems = self.problems
        time = table.values[:, column["time"]]
        usable = np.isfinite(time)
        for row in np.flatnonzero(~usable):
            problems.add(table.place(row, "time"), "the time is absent")
        _check_size(table, column, problems, usable)
        times = np.append(self.latest, np.where(usable, time, -np.inf))
        latest = np.fmax.accumulate(times)
        before, self.latest = latest[:-1], float(latest[-1])
        for row in np.flatnonzero(usable & (time <= before)):
            now, latest_s = (
                np.format_float_positional(t, trim="-") for t in (time[row], before[row])
            )
            what = "is there twice" if time[row] == before[row] else f"comes after {latest_s} s"
            problems.add(table.place(row, "time"), f"time {now} s {what}")
            usable[row] = False
        for sensor in sensors_of(ATTITUDE):
            if sensor.columns[0] not in column:
                continue
            values = table.values[:, [column[name] for name in sensor.columns]]
            with np.errstate(over="ignore"):
                norm = np.linalg.norm(values, axis=1)
            for row in np.flatnonzero(usable & (np.abs(norm - 1) > 1e-3)):
                problems.add(table.place(row), f"the quaternion's norm is {norm[row]:.6g}, not 1")
                usable[row] = False
        return usable


def _samples_of(
    table: TelemetryTable, column: dict[str, int], usable: NDArray[np.bool_], partial: Counter[str]
) -> Measurements:
    joints = tuple(dict.fromkeys(_joints(table.columns, "q:") + _joints(table.columns, "qd:")))
    time = table.values[:, column["time"]]
    samples = {}

    def take(name: str, columns: Sequence[str], others: Sequence[str] = ()) -> Samples:
        """Return the complete samples and others on their row, without a copy if all are there."""
        values = table.values[:, _selection([column[c] for c in (*columns, *others)])]
        absent = np.isnan(values)
        there = ~absent.any(axis=1) & usable
        if there.all():
            return Samples(time, values)
        logged = table.logged.get(name, ~absent[:, : len(columns)].all(axis=1))
        count = int(np.sum(usable & ~there & logged))
        if count:
            partial[name] += count
        return Samples(time[there], values[there])

    for name, sensor in SENSORS.items():
        columns = sensor.columns_of(joints)
        if name == "encoders":
            logged = [c in column for c in columns]
            samples[name] = take(name, [c for c in columns if c in column])
            if not all(logged):
                positions = np.full((len(samples[name]), len(joints)), np.nan)
                positions[:, logged] = samples[name].value
                samples[name] = Samples(samples[name].time, positions)
        elif sensor.columns_in_W and sensor.columns_in_W[0] in column:
            # Without the attitude on the same row it cannot be rotated into B.
            both = take(name, sensor.columns_in_W, SENSORS["attitude"].columns)
            w_WB, quaternion = both.value[:, :3], both.value[:, 3:]
            if len(both):
                R_WB = scipy.spatial.transform.Rotation.from_quat(quaternion, scalar_first=True)
                w_WB = R_WB.inv().apply(w_WB)
            samples[name] = Samples(both.time, w_WB)
        elif all(c in column for c in columns):
            samples[name] = take(name, columns)
    thrust = [name for name in THRUST_COLUMNS if name in column]
    if thrust:
        read = take(THRUST, thrust)
        value = np.zeros((len(read), len(THRUST_COLUMNS)))
        value[:, [THRUST_COLUMNS.index(name) for name in thrust]] = read.value
        samples[THRUST] = Samples(read.time, value)
    return Measurements(joints, samples)


def _selection(indices: list[int]) -> slice | list[int]:
    """Return neighbouring indices as a slice, which selects without a copy."""
    first, count = indices[0], len(indices)
    return slice(first, first + count) if indices == [*range(first, first + count)] else indices


def table_of(motion: Telemetry | Measurements) -> tuple[list[str], NDArray[np.float64]]:
    """Return columns and values (N, C) of telemetry or measurements; NaN where a cell is absent.

    The angular velocity of telemetry is in W, that of measurements in B, as gyros measure it.
    """
    joints = motion.joint_names
    if isinstance(motion, Telemetry):
        groups = {
            SENSORS["attitude"].columns: motion.quaternion_WB,
            SENSORS["position"].columns: motion.p_WB,
            SENSORS["gyro"].columns_in_W: motion.w_WB,
            SENSORS["velocity"].columns: motion.v_WB,
            SENSORS["encoders"].columns_of(joints): motion.q,
            SENSORS["joint_rates"].columns_of(joints): motion.qdot,
        }
        values = np.hstack([motion.time[:, None], *groups.values()])
        return ["time", *(name for group in groups for name in group)], values
    everything = {**dict(motion.items()), THRUST: motion.thrust}
    time = np.unique(np.concatenate([samples.time for samples in everything.values()]))
    names, blocks = ["time"], [time[:, None]]
    for name, samples in everything.items():
        if not len(samples):
            continue
        names += THRUST_COLUMNS if name == THRUST else SENSORS[name].columns_of(joints)
        block = np.full((time.size, samples.value.shape[1]), np.nan)
        block[np.searchsorted(time, samples.time)] = samples.value
        blocks.append(block)
    return names, np.hstack(blocks)


def _base_groups() -> Iterator[tuple[tuple[str, ...], Sensor]]:
    """Yield the columns of every sensor of the base, and the sensor."""
    for sensor in SENSORS.values():
        if sensor.quantity.width is not None:
            yield from ((columns, sensor) for columns in (sensor.columns, sensor.columns_in_W))


def _joint_prefixes() -> list[str]:
    return [sensor.columns[0] for sensor in SENSORS.values() if sensor.quantity.width is None]


def _joints(columns: Sequence[str], prefix: str) -> tuple[str, ...]:
    return tuple(name[len(prefix) :] for name in columns if name.startswith(prefix))


def _check_size(
    table: TelemetryTable, column: dict[str, int], problems: Problems, usable: NDArray[np.bool_]
) -> None:
    """Add implausibly large numbers to the problems, and remove their rows from the usable ones."""
    if not len(table.values):
        return
    highest = np.fmax.reduce(table.values, axis=0)
    lowest = np.fmin.reduce(table.values, axis=0)
    for name, k in column.items():
        limit = LARGEST_TIME if name == "time" else LARGEST
        if not (highest[k] > limit or lowest[k] < -limit):
            continue
        values = table.values[:, k]
        with np.errstate(invalid="ignore"):
            large = np.abs(values) > limit
        for row in np.flatnonzero(large):
            text = f"{values[row]:g} is implausible: beyond {limit:g}"
            if name == "time":
                text += "; is it in ns? It must be in s, unless a map of columns says otherwise"
            problems.add(table.place(row, name), text)
            usable[row] = False
