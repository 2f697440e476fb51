"""Reads ROS bags as columns, with the samples of each sensor in the rows of their own times.

Reads the message types in `TOPIC_TYPES` from bags of ROS 2 (sqlite3, MCAP) and of ROS 1. The PyPI
package `rosbags` does the parsing, so ROS need not be installed. Definitions of other types, which
may be in the bag, are not looked at; so one that cannot be parsed does no harm.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from cpid_drake.array import Array
from cpid_drake.files.errors import InputError
from cpid_drake.logs.column_choice import VELOCITY_IN_B
from cpid_drake.logs.log import THRUST, THRUST_COLUMNS
from cpid_drake.logs.ros_messages import (
    SOURCES,
    TOPIC_TYPES,
    TRANSFORMS,
    joint_values,
    message_values,
    stamp_of,
)
from cpid_drake.logs.screening import LONGEST_DELAY
from cpid_drake.logs.table import LogTable, common_rows
from cpid_drake.sensors.sensors import SENSORS

if TYPE_CHECKING:
    from rosbags.interfaces import Connection

Series = tuple[NDArray[np.int64], Array]
"""Stamps (N,) [ns] and values (N, width)."""

_Part = tuple[str, Sequence[str], Series]
"""A quantity, its columns, and its samples."""

_COLUMNS = {THRUST: THRUST_COLUMNS, "velocity": VELOCITY_IN_B}
"""The columns of quantities that are no sensor's own, or in other axes."""

Decode = Callable[[bytes, str], Any]
"""Returns the message in bytes, given the name of its type."""


@dataclass(eq=False)
class _Messages:
    """The messages of topics: stamps [ns]; stamps and values by quantity, or by joint's column."""

    stamps: list[int] = field(default_factory=list)
    samples: dict[str, tuple[list[int], list[Sequence[float]]]] = field(default_factory=dict)
    empty: int = 0

    def add(self, stamp: int, values: Mapping[str, Sequence[float]]) -> None:
        """Add the quantities in a message."""
        self.stamps.append(stamp)
        self.empty += not values
        for name, numbers in values.items():
            stamps, rows = self.samples.setdefault(name, ([], []))
            stamps.append(stamp)
            rows.append(numbers)

    def series(self, name: str) -> Series:
        """Return the samples of a quantity."""
        stamps, rows = self.samples[name]
        return np.array(stamps, dtype=np.int64), np.array(rows, dtype=float)


def read_rosbag(path: str | Path, topics: Mapping[str, str]) -> LogTable:
    """Return the motion of a spacecraft in a ROS bag as columns with the package's names.

    Attitude is read from the odometry, else from the poses, else from the IMU; position from the
    odometry, else from the poses; velocity from the odometry, in the axes of its child frame, or of
    W if a map of columns says so (velocity.frame); angular velocity from the IMU, else from the
    odometry. Poses must be those of B in W; the odometry's child frame and the IMU's frame have
    B's axes (transforms, such as that of a tilted IMU, are not read). Covariances are ignored,
    except for a first entry of -1, by which an IMU declares that it has no orientation or no
    angular velocity. A quaternion of zeros, as in a message that nobody filled, is no attitude.

    A topic of thrust is read only if it is named, because most topics of this type are those of
    force sensors: force and torque of all thrusters about the base's origin, in a frame of B's
    axes. Each message holds until the next.

    Poses are those of any of the types; of a topic of many transforms, those between two frames.
    Joint states are merged by the joints' names, from all topics. Empty messages are counted and
    left out. NaN, by which drivers say that they have no value, is absent. Topics that are not used
    are listed with the ignored columns.

    Times are the headers' stamps, not the times of recording, and start at zero at the bag's first
    stamp. The subtraction is done in whole nanoseconds, because seconds since 1970 have an error of
    2e-7 s as floating-point numbers. (A stamp more than ten days from the others is from a clock
    that was not yet set, and is never used as the first stamp.) Rows are in the order of stamps;
    messages of one topic with the same stamp have rows of their own, which screening judges.

    Args:
        path: the folder of a bag of ROS 2, a single .db3 or .mcap file of it, or a .bag file of
            ROS 1.
        topics: the topic to read by kind in `TOPIC_TYPES`, such as {"imu": "/imu/data"}; "" for no
            topic; of joints several, "/arm,/wheels"; of transforms with the frames of W and B,
            "/tf:world:base". A kind except "thrust" may be omitted if the bag has at most one topic
            of its types, without transforms.

    Raises:
        InputError: `rosbags` is not installed; no bag, or a damaged one; several topics of a kind,
            none of joints, or none of the base; messages that contradict each other in frames or
            joints; stamps that are all equal or jump back.

    """
    try:
        from rosbags import rosbag1, rosbag2
    except ImportError as error:
        raise InputError("ROS bags need a package: pip install 'cpid-drake[ros]'") from error
    where = str(path)
    is_ros1 = Path(path).suffix.lower() == ".bag"
    try:
        if not Path(path).exists():
            raise InputError(f"{where}: no such file or folder")
        if Path(path).is_dir() and not Path(path, "metadata.yaml").is_file():
            raise InputError(
                f"{where}: a folder without metadata.yaml: not a ROS 2 bag; of ROS 1, give the "
                ".bag file"
            )
        with (rosbag1 if is_ros1 else rosbag2).Reader(Path(path)) as reader:
            chosen = _choose_topics(where, reader.connections, topics)
            decode = _decoder(reader.connections, is_ros1)
            read = {k: _read(where, reader, decode, k, names) for k, names in chosen.items()}
            every = {c.topic: c.msgtype for c in reader.connections}
    except InputError:
        raise
    except Exception as error:  # the package raises exceptions of many types on damaged bags
        problem = f"{type(error).__name__}: {error}"
        raise InputError(f"{where}: not a ROS bag, or a damaged one ({problem})") from error
    return _table(read, chosen, every)


def _decoder(connections: "Sequence[Connection]", is_ros1: bool) -> Decode:
    """Return what makes messages of bytes, given the name of their type."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    if not is_ros1:
        # The types are the same in every ROS 2, and older bags do not hold their definitions.
        return get_typestore(Stores.ROS2_HUMBLE).deserialize_cdr
    built_in = {each for types in TOPIC_TYPES.values() for each in types}
    types = dict[str, Any]()
    for connection in connections:
        if connection.msgtype in built_in:
            types |= get_types_from_msg(connection.msgdef.data, connection.msgtype)
    store = get_typestore(Stores.EMPTY)
    store.register(types)
    return store.deserialize_ros1


def _table(
    topics: Mapping[str, _Messages], chosen: Mapping[str, list[str]], every: Mapping[str, str]
) -> LogTable:
    """Return the columns of a bag, in rows of every stamp of any topic."""
    stamps = np.concatenate([np.array(each.stamps, dtype=np.int64) for each in topics.values()])
    middle = np.sort(stamps)[stamps.size // 2]
    origin = stamps[np.abs(stamps - middle) < 10 * 86400 * 10**9].min()
    parts, used, table = list[_Part](), {"joints"}, LogTable({})
    for quantity, kinds in SOURCES.items():
        usable = [kind for kind in kinds if kind in topics and quantity in topics[kind].samples]
        if not usable:
            continue
        used.add(usable[0])
        columns = _COLUMNS.get(quantity) or SENSORS[quantity].columns
        series = topics[usable[0]].series(quantity)
        parts.append((quantity, columns, series))
        table.rejected[quantity] = len(topics[usable[0]].stamps) - len(series[0])
    for name in topics["joints"].samples:
        quantity = "joint_rates" if name.startswith("qd:") else "encoders"
        parts.append((quantity, (name,), topics["joints"].series(name)))
    rows, places = common_rows([np.unique(stamps), *(series[0] for _, _, series in parts)])
    table.columns["time"] = (rows - origin) / 1e9
    for (quantity, names, (_, value)), place in zip(parts, places[1:], strict=True):
        _put(table, quantity, names, value, place)
    if topics["joints"].empty:
        text = f"{topics['joints'].empty} empty messages left out"
        table.notes["encoders"] = (*table.notes.get("encoders", ()), text)
    taken = {topic for kind in used if kind in chosen for topic in chosen[kind]}
    table.unreadable = {
        f"topic {topic} ({kind.split('/')[-1]})": "is a topic that is not used"
        for topic, kind in sorted(every.items())
        if topic not in {each.partition(":")[0] for each in taken}
    }
    return table


def _put(
    table: LogTable, quantity: str, names: Sequence[str], value: Array, rows: NDArray[np.intp]
) -> None:
    """Add columns of a quantity, given its samples (N, width) and their rows (N,)."""
    absent = np.isnan(value).any(axis=1)
    if absent.any() and quantity not in ("encoders", "joint_rates"):
        text = f"{absent.sum()} samples of {', '.join(names)} are NaN, left out"
        table.notes[quantity] = (*table.notes.get(quantity, ()), text)
    for name, column in zip(names, value.T, strict=True):
        table.columns[name] = np.full(len(table), np.nan)
        table.columns[name][rows] = column


def _choose_topics(
    where: str, connections: "Sequence[Connection]", topics: Mapping[str, str]
) -> dict[str, list[str]]:
    """Return the topics to read by kind, for all kinds in the bag."""
    for kind in topics:
        if kind not in TOPIC_TYPES:
            raise InputError(f"no topics of kind '{kind}'; choose from {', '.join(TOPIC_TYPES)}")
    chosen = dict[str, list[str]]()
    for kind, types in TOPIC_TYPES.items():
        wanted = topics.get(kind, "" if kind == "thrust" else None)
        types_of = {c.topic: c.msgtype for c in sorted(connections) if c.msgtype in types}
        plain = sorted(topic for topic in types_of if types_of[topic] != TRANSFORMS)
        words = " or ".join(types)
        if wanted is None and len(plain) > 1 and kind != "joints":
            raise InputError(
                f"{where}: several topics of type {words}: {', '.join(plain)}; choose one, as in "
                f"--topic {kind}={plain[0]} or topics={{'{kind}': '{plain[0]}'}}"
            )
        names = plain if wanted is None else [each for each in wanted.split(",") if each]
        for name in names:
            if name.partition(":")[0] not in types_of:
                listed_topics = ", ".join(sorted(types_of)) or "none"
                raise InputError(
                    f"{where}: no topic {name} of type {words}; of it: {listed_topics}"
                )
        if names:
            chosen[kind] = names
    if "joints" not in chosen:
        raise InputError(f"{where}: no topic with joint positions ({TOPIC_TYPES['joints'][0]})")
    if not chosen.keys() & {"odometry", "pose", "imu"}:
        types = tuple(each for kind in ("odometry", "pose", "imu") for each in TOPIC_TYPES[kind])
        transforms = sorted({c.topic for c in connections if c.msgtype == TRANSFORMS})
        remedy = (
            f"; name the frames of {transforms[0]}: --topic pose={transforms[0]}:WORLD:BASE"
            if transforms
            else ""
        )
        raise InputError(
            f"{where}: no topic with the motion of the base (of type {', '.join(types)}){remedy}"
        )
    return chosen


def _read(where: str, reader: Any, decode: Decode, kind: str, topics: Sequence[str]) -> _Messages:
    """Return the samples of topics of a kind; refuse messages that contradict each other."""
    read, owners = _Messages(), dict[str, str]()
    for topic in topics:
        name, *frames = topic.split(":")
        one = _read_topic(f"{where}: {name}", reader, decode, kind, name, tuple(frames))
        for column in one.samples if kind == "joints" else ():
            if owners.setdefault(column, name) != name:
                raise InputError(
                    f"{where}: {owners[column]} and {name} both have '{column}': name the topics "
                    f"of joints to read, as in --topic joints={name}"
                )
        read.stamps += one.stamps
        read.samples |= one.samples
        read.empty += one.empty
    if kind == "joints" and not any(name.startswith("q:") for name in read.samples):
        raise InputError(f"{where}: {', '.join(topics)} has no joint positions in its messages")
    return read


def _read_topic(
    where: str, reader: Any, decode: Decode, kind: str, topic: str, wanted: tuple[str, ...]
) -> _Messages:
    """Return the samples of a topic; `wanted` are the frames W and B of a topic of transforms."""
    connections = [
        c for c in reader.connections if c.topic == topic and c.msgtype in TOPIC_TYPES[kind]
    ]
    read, frames, count = _Messages(), set[tuple[str, ...]](), 0
    for connection, _, data in reader.messages(connections=connections):
        message = decode(data, connection.msgtype)
        count += 1
        for part in message.transforms if connection.msgtype == TRANSFORMS else (message,):
            both = part.header.frame_id, getattr(part, "child_frame_id", "")
            pair = () if kind == "joints" else tuple(filter(None, both))
            frames.add(pair)
            if wanted and pair != wanted:
                continue
            stamp = stamp_of(part)
            if kind == "joints":
                read.add(stamp, joint_values(part, where, count - 1))
            else:
                read.add(stamp, message_values(part, kind))
    expected = sum(connection.msgcount for connection in connections)
    if count < expected:
        raise InputError(f"{where}: only {count} of {expected} messages are present")
    named = [" to ".join(pair) or "(none)" for pair in sorted(frames)[:8]]
    if wanted and wanted not in frames:
        raise InputError(
            f"{where}: no transform from {' to '.join(wanted)}, only {'; '.join(named)}; chains "
            "are not followed"
        )
    if len(frames) > 1 and not wanted:
        remedy = f"as in --topic {':'.join((f'{kind}={topic}', *max(frames)))}"
        raise InputError(
            f"{where} is of several frames: {'; '.join(named)}; name the base's, {remedy}"
        )
    times = np.array(read.stamps, dtype=np.int64)
    if times.size > 1 and (times == times[0]).all():
        raise InputError(f"{where}: all headers have the stamp {times[0] / 1e9:g} s; set the time")
    back = np.maximum.accumulate(times) - times
    far = back > LONGEST_DELAY * 1e9
    if far.any():
        raise InputError(
            f"{where}: stamps jump back by {back[far][0] / 1e9:g} s at message {far.argmax()}; a "
            "clock was set back, or these are several runs: cut the bag"
        )
    return read
