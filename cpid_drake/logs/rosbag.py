"""Reads ROS 2 bags as columns, with the samples of each sensor in the rows of their own times.

Reads the message types in `TOPIC_TYPES` from bags with either storage (sqlite3, MCAP). The
PyPI package `rosbags` does the parsing, so ROS need not be installed.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.rotations import rotate_by_quaternion
from cpid_drake.errors import InputError
from cpid_drake.logs.log import THRUST, THRUST_COLUMNS
from cpid_drake.logs.screening import QUATERNION_NORM
from cpid_drake.logs.table import Table
from cpid_drake.sensors.sensors import SENSORS

TOPIC_TYPES = {
    "odometry": "nav_msgs/msg/Odometry",
    "pose": "geometry_msgs/msg/PoseStamped",
    "imu": "sensor_msgs/msg/Imu",
    "joints": "sensor_msgs/msg/JointState",
    "thrust": "geometry_msgs/msg/WrenchStamped",
}
"""Message types that are read, by kind of topic."""

_SOURCES = {
    "attitude": ("odometry", "pose", "imu"),
    "gyro": ("imu", "odometry"),
    "position": ("odometry", "pose"),
    "velocity": ("odometry",),
    "encoders": ("joints",),
    "joint_rates": ("joints",),
    THRUST: ("thrust",),
}
"""For each quantity, the kinds of topic that can hold its samples; the first that does is used."""

LARGEST_STEP_BACK = 1.0
"""Largest decrease of the stamps from message to message [s]."""


@dataclass(frozen=True, eq=False)
class _Topic:
    """The messages of a topic: stamps (N,) [ns]; stamps and values (n, width) by quantity."""

    stamps: NDArray[np.int64]
    samples: Mapping[str, tuple[NDArray[np.int64], NDArray[np.float64]]]
    joint_names: tuple[str, ...]


def read_rosbag(path: str | Path, topics: Mapping[str, str]) -> Table:
    """Return the motion of a spacecraft in a ROS 2 bag as columns with the package's names.

    Attitude is read from the odometry, else from the poses, else from the IMU; position from the
    odometry, else from the poses; velocity from the odometry, rotated from its child frame to W by
    the attitude in the same message; angular velocity from the IMU, else from the odometry. Poses
    must be those of B in W; the odometry's child frame and the IMU's frame must have B's axes
    (transforms, such as that of a tilted IMU, are not read). The messages' covariances are ignored,
    except for a first entry of -1, by which an IMU declares that it has no orientation or no
    angular velocity. A quaternion of zeros, as in a message that nobody filled, is no attitude.

    A topic of thrust is read only if it is named, because most topics of this type are those of
    force sensors: force and torque of all thrusters about the base's origin, in a frame of B's
    axes. Each message holds until the next.

    Every joint state must name all joints, in any order; joints in several messages or topics are
    not combined. Columns are in the order of the first message.

    Times are the headers' stamps, not the times of recording, and start at zero at the bag's first
    stamp. The subtraction is done in whole nanoseconds, because seconds since 1970 have an error of
    2e-7 s as floating-point numbers. (A stamp more than ten days from the others is from a clock
    that was not yet set, and is never used as the first stamp.) Rows are in the order of stamps; of
    messages of one topic with the same stamp, the first counts, and the others are rejected.

    Args:
        path: the bag's folder, or a single .db3 or .mcap file.
        topics: the topic to read by kind in `TOPIC_TYPES`, such as {"imu": "/imu/data"}; "" for no
            topic. A kind except "thrust" may be omitted if the bag has at most one topic of its
            type.

    Raises:
        InputError: `rosbags` is not installed; no bag, or a damaged one; several topics of a kind,
            none of joints, or none of the base; messages that contradict each other in frames or
            joints; stamps that are all equal or jump back.

    """
    try:
        from rosbags.rosbag2 import Reader
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise InputError("ROS 2 bags need a package: pip install 'cpid-drake[ros]'") from error
    where = str(path)
    # The types are the same in every ROS 2, and older bags do not hold their definitions.
    store = get_typestore(Stores.ROS2_HUMBLE)
    try:
        if not Path(path).exists():
            raise InputError(f"{where}: no such file or folder")
        if Path(path).is_dir() and not Path(path, "metadata.yaml").is_file():
            raise InputError(f"{where}: a folder without metadata.yaml: not a ROS 2 bag")
        with Reader(Path(path)) as reader:
            chosen = _choose_topics(where, reader.connections, topics)
            read = {kind: _read_topic(where, reader, store, kind, chosen[kind]) for kind in chosen}
    except InputError:
        raise
    except Exception as error:  # the package raises exceptions of many types on damaged bags
        problem = f"{type(error).__name__}: {error}"
        raise InputError(f"{where}: not a ROS 2 bag, or a damaged one ({problem})") from error
    return _table(read)


def _table(topics: Mapping[str, _Topic]) -> Table:
    """Return the columns of a bag, one row for each stamp of any topic."""
    every = np.concatenate([topic.stamps for topic in topics.values()])
    middle = np.sort(every)[every.size // 2]
    origin = every[np.abs(every - middle) < 10 * 86400 * 10**9].min()
    rows = np.unique(every)
    columns = {"time": (rows - origin) / 1e9}
    texts: dict[str, dict[int, str]] = {}
    rejected = Counter[str]()
    for quantity, kinds in _SOURCES.items():
        there = [topics[k] for k in kinds if k in topics and quantity in topics[k].samples]
        if not there:
            continue
        stamps, value = there[0].samples[quantity]
        names: tuple[str, ...] = THRUST_COLUMNS
        if quantity != THRUST:
            names = SENSORS[quantity].columns_of(topics["joints"].joint_names)
        kept = np.unique(stamps, return_index=True)[1]
        if quantity in ("attitude", "velocity"):  # the velocity needs the attitude of its message
            q = there[0].samples["attitude"][1]
            kept = kept[q[kept].any(axis=1)]
            if quantity == "velocity":
                norm = np.linalg.norm(q, axis=1, keepdims=True)
                is_unit = np.abs(norm - 1) < QUATERNION_NORM
                value = rotate_by_quaternion(q / np.where(is_unit, norm, np.nan), value)
        rejected[quantity] = len(value) - len(kept)
        place = np.searchsorted(rows, stamps[kept])
        for name, column in zip(names, value[kept].T):
            columns[name] = np.full(len(rows), np.nan)
            columns[name][place] = column
            if np.isnan(column).any():
                texts[name] = dict.fromkeys(place[np.isnan(column)].tolist(), "nan")
    return Table(columns, texts=texts, rejected=rejected)


def _choose_topics(where: str, connections: list, topics: Mapping[str, str]) -> dict[str, str]:
    """Return the topic to read by kind, for all kinds in the bag."""
    for kind in topics:
        if kind not in TOPIC_TYPES:
            raise InputError(f"no topics of kind '{kind}'; choose from {', '.join(TOPIC_TYPES)}")
    chosen = {}
    for kind, message_type in TOPIC_TYPES.items():
        wanted = topics.get(kind, "" if kind == "thrust" else None)
        there = sorted({c.topic for c in connections if c.msgtype == message_type})
        if wanted and wanted not in there:
            names = ", ".join(there) or "none"
            raise InputError(f"{where}: no topic {wanted} of type {message_type}; of it: {names}")
        if wanted is None and len(there) > 1:
            raise InputError(
                f"{where}: several topics of type {message_type}: {', '.join(there)}; choose one, "
                f"as in topics={{'{kind}': '{there[0]}'}} (they are not merged)"
            )
        if there and wanted != "":
            chosen[kind] = wanted or there[0]
    if "joints" not in chosen:
        raise InputError(f"{where}: no topic with joint positions ({TOPIC_TYPES['joints']})")
    if not chosen.keys() & {"odometry", "pose", "imu"}:
        types = ", ".join(TOPIC_TYPES[kind] for kind in ("odometry", "pose", "imu"))
        raise InputError(f"{where}: no topic with the motion of the base (of type {types})")
    return chosen


def _read_topic(where: str, reader: Any, store: Any, kind: str, topic: str) -> _Topic:
    """Return the samples of a topic; refuse messages that contradict each other."""
    where, message_type = f"{where}: {topic}", TOPIC_TYPES[kind]
    wanted = (topic, message_type)
    connections = [c for c in reader.connections if (c.topic, c.msgtype) == wanted]
    stamps: list[int] = []
    samples: dict[str, tuple[list[int], list[Sequence[float]]]] = {}
    frames, joints = set(), ()
    for _, _, data in reader.messages(connections=connections):
        message = store.deserialize_cdr(data, message_type)
        if kind == "joints":
            joints = joints or tuple(message.name)
            values = _joint_values(message, joints, where, len(stamps))
        else:
            values = _values(message, kind)
            frames.add((message.header.frame_id, getattr(message, "child_frame_id", "")))
        stamps.append(message.header.stamp.sec * 10**9 + message.header.stamp.nanosec)
        for quantity, numbers in values.items():
            own_stamps, own_values = samples.setdefault(quantity, ([], []))
            own_stamps.append(stamps[-1])
            own_values.append(numbers)
    expected = sum(connection.msgcount for connection in connections)
    if len(stamps) < expected:
        raise InputError(f"{where}: only {len(stamps)} of {expected} messages are present")
    if kind == "joints" and not stamps:
        raise InputError(f"{where} has no messages: no joint positions")
    if len(frames) > 1:
        named = [" ".join(pair).strip() or "(none)" for pair in sorted(frames)[:5]]
        raise InputError(
            f"{where} is of several frames: {'; '.join(named)}; only the base's is wanted"
        )
    times = np.array(stamps, dtype=np.int64)
    if times.size > 1 and (times == times[0]).all():
        raise InputError(f"{where}: all headers have the stamp {times[0] / 1e9:g} s; set the time")
    back = np.maximum.accumulate(times) - times
    far = back > LARGEST_STEP_BACK * 1e9
    if far.any():
        raise InputError(
            f"{where}: stamps jump back by {back[far][0] / 1e9:g} s at message {far.argmax()}; a "
            "clock was set back, or these are several runs: cut the bag"
        )
    arrays = {name: (np.array(own), np.array(each)) for name, (own, each) in samples.items()}
    return _Topic(times, arrays, joints)


def _joint_values(
    message: Any, names: tuple[str, ...], where: str, k: int
) -> dict[str, Sequence[float]]:
    """Return positions and rates of message k in the order of the first message's names."""
    if not names or len(set(names)) < len(names):
        listed = ", ".join(names) or "none"
        raise InputError(f"{where} must name every joint once, not {listed}")
    if sorted(message.name) != sorted(names):
        raise InputError(
            f"{where}: message {k} names joints {', '.join(message.name)}, the first one "
            f"{', '.join(names)}; every message must name all joints"
        )
    values: dict[str, Sequence[float]] = {}
    for quantity, numbers in (("encoders", message.position), ("joint_rates", message.velocity)):
        if len(numbers) not in (0, len(names)):
            raise InputError(
                f"{where}: message {k} has {len(numbers)} values for {len(names)} joints"
            )
        if len(numbers):
            by_name = dict(zip(message.name, numbers.tolist()))
            values[quantity] = [by_name[name] for name in names]
    return values


def _values(message: Any, kind: str) -> dict[str, Sequence[float]]:
    """Return the quantities in a message about the base; the odometry's velocity is in B."""
    if kind == "thrust":
        wrench = message.wrench
        return {THRUST: [*_vector(wrench.torque), *_vector(wrench.force)]}
    if kind == "imu":
        values = {}
        if message.orientation_covariance[0] != -1:
            values["attitude"] = _quaternion(message.orientation)
        if message.angular_velocity_covariance[0] != -1:
            values["gyro"] = _vector(message.angular_velocity)
        return values
    pose = message.pose.pose if kind == "odometry" else message.pose
    values = {"attitude": _quaternion(pose.orientation), "position": _vector(pose.position)}
    if kind == "odometry":
        twist = message.twist.twist
        values |= {"velocity": _vector(twist.linear), "gyro": _vector(twist.angular)}
    return values


def _vector(xyz: Any) -> Sequence[float]:
    return xyz.x, xyz.y, xyz.z


def _quaternion(orientation: Any) -> Sequence[float]:
    """Return (w, x, y, z); ROS has w last."""
    return orientation.w, orientation.x, orientation.y, orientation.z
