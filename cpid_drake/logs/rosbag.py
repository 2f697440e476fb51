"""Reads ROS 2 bags as columns, with the samples of each sensor in the rows of their own times.

Reads the message types in `TOPIC_TYPES` from bags with either storage (sqlite3, MCAP). The
PyPI package `rosbags` does the parsing, so ROS need not be installed.
"""

from array import array
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from cpid_drake.dynamics.rotations import rotate
from cpid_drake.errors import InputError
from cpid_drake.logs.log import THRUST, THRUST_COLUMNS
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

_OF_THE_BASE = ("odometry", "pose", "imu")
"""Kinds of topic with the motion of the base."""

_SOURCES = {
    "attitude": ("odometry", "pose", "imu"),
    "gyro": ("imu", "odometry"),
    "position": ("odometry", "pose"),
    "velocity": ("odometry",),
    "encoders": ("joints",),
    "joint_rates": ("joints",),
}
"""For each sensor, the kinds of topic that can hold its samples.

The first kind that holds any samples is used.
"""

LARGEST_STEP_BACK = 1.0
"""Largest decrease of the stamps from message to message [s]."""


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
    typestore = get_typestore(Stores.ROS2_HUMBLE)
    logs: dict[str, _Log] = {}
    try:
        if not Path(path).exists():
            raise InputError(f"{where}: no such file or folder")
        if Path(path).is_dir() and not Path(path, "metadata.yaml").is_file():
            raise InputError(f"{where}: a folder without metadata.yaml: not a ROS 2 bag")
        with Reader(Path(path)) as reader:
            for kind, topic in _choose_topics(where, reader.connections, topics).items():
                message_type, log = TOPIC_TYPES[kind], _Log(f"{where}: {topic}", kind)
                connections = [
                    connection
                    for connection in reader.connections
                    if (connection.topic, connection.msgtype) == (topic, message_type)
                ]
                for _, _, data in reader.messages(connections=connections):
                    log.add(typestore.deserialize_cdr(data, message_type))
                log.check(expected=sum(connection.msgcount for connection in connections))
                logs[kind] = log
    except InputError:
        raise
    except Exception as error:  # the package raises exceptions of many types on damaged bags
        problem = f"{type(error).__name__}: {error}"
        raise InputError(f"{where}: not a ROS 2 bag, or a damaged one ({problem})") from error
    return _table(logs)


def _table(logs: Mapping[str, "_Log"]) -> Table:
    """Return the columns of a bag, one row for each stamp of any topic."""
    joint_names = logs["joints"].joint_names
    every = np.concatenate([log.stamps for log in logs.values()])
    origin, rows = _origin(every), np.unique(every)
    columns = {"time": (rows - origin) / 1e9}
    texts: dict[str, dict[int, str]] = {}
    rejected = Counter[str]()
    for quantity in (*_SOURCES, THRUST):
        kinds = _SOURCES.get(quantity, (quantity,))
        log = next((logs[k] for k in kinds if k in logs and quantity in logs[k].sensors), None)
        if log is None:
            continue
        stamps, numbers = (np.array(entries) for entries in log.sensors[quantity])
        names: tuple[str, ...] = THRUST_COLUMNS
        if quantity != THRUST:
            names = SENSORS[quantity].columns_of(joint_names)
        value = numbers.reshape(-1, len(names))
        kept = np.unique(stamps, return_index=True)[1]
        if quantity in ("attitude", "velocity"):  # the velocity needs the attitude of its message
            quaternion = np.reshape(log.sensors["attitude"][1], (-1, 4))
            kept = kept[quaternion[kept].any(axis=1)]
            value = _to_world(quaternion, value) if quantity == "velocity" else value
        rejected[quantity] = len(value) - len(kept)
        place = np.searchsorted(rows, stamps[kept])
        for name, column in zip(names, value[kept].T):
            columns[name] = np.full(len(rows), np.nan)
            columns[name][place] = column
            bad = place[np.isnan(column)].tolist()
            texts |= {name: dict.fromkeys(bad, "nan")} if bad else {}
    return Table(columns, texts=texts, rejected=rejected)


def _choose_topics(where: str, connections: list, topics: Mapping[str, str]) -> dict[str, str]:
    """Return the topic to read by kind, for all kinds in the bag."""
    for kind in topics:
        if kind not in TOPIC_TYPES:
            raise InputError(f"no topics of kind '{kind}'; choose from {', '.join(TOPIC_TYPES)}")
    chosen = {}
    for kind, message_type in TOPIC_TYPES.items():
        wanted = topics.get(kind)
        there = sorted({c.topic for c in connections if c.msgtype == message_type})
        if wanted and wanted not in there:
            names = ", ".join(there) or "none"
            raise InputError(f"{where}: no topic {wanted} of type {message_type}; of it: {names}")
        if wanted is None and kind == "thrust":
            continue
        if wanted is None and len(there) > 1:
            raise InputError(
                f"{where}: several topics of type {message_type}: {', '.join(there)}; choose one, "
                f"as in topics={{'{kind}': '{there[0]}'}} (they are not merged)"
            )
        if there and wanted != "":
            chosen[kind] = wanted or there[0]
    if "joints" not in chosen:
        raise InputError(f"{where}: no topic with joint positions ({TOPIC_TYPES['joints']})")
    if not chosen.keys() & {*_OF_THE_BASE}:
        types = ", ".join(TOPIC_TYPES[kind] for kind in _OF_THE_BASE)
        raise InputError(f"{where}: no topic with the motion of the base (of type {types})")
    return chosen


class _Log:
    """The samples of one topic by sensor, in the order of messages.

    Args:
        where: the topic, for error messages.
        kind: a key of `TOPIC_TYPES`.

    Attributes:
        stamps: stamps of all messages [ns].
        sensors: by sensor, the stamps of its samples [ns], and the numbers of all samples.
        joint_names: names in the first message of joints.

    """

    def __init__(self, where: str, kind: str) -> None:
        self.where, self.kind = where, kind
        self.stamps = array("q")
        self.sensors: dict[str, tuple[array, array]] = {}
        self.joint_names: tuple[str, ...] = ()
        self._frames: set[tuple[str, str]] = set()

    def add(self, message: Any) -> None:
        """Add the samples of a message."""
        if self.kind == "joints":
            values: Mapping[str, Sequence[float]] = self._joint_values(message)
        else:
            values = _BASE_VALUES[self.kind](message)
            self._frames.add((message.header.frame_id, getattr(message, "child_frame_id", "")))
        stamp = message.header.stamp
        self.stamps.append(stamp.sec * 10**9 + stamp.nanosec)
        for sensor, numbers in values.items():
            stamps, all_numbers = self.sensors.setdefault(sensor, (array("q"), array("d")))
            stamps.append(self.stamps[-1])
            all_numbers.extend(numbers)

    def check(self, expected: int) -> None:
        """Refuse messages that are incomplete or contradict each other."""
        if len(self.stamps) < expected:
            raise InputError(
                f"{self.where}: only {len(self.stamps)} of {expected} messages are present"
            )
        if self.kind == "joints" and not self.stamps:
            raise InputError(f"{self.where} has no messages: no joint positions")
        if len(self._frames) > 1:
            frames = [" ".join(pair).strip() or "(none)" for pair in sorted(self._frames)[:5]]
            raise InputError(
                f"{self.where} is of several frames: {'; '.join(frames)}; only the base's is wanted"
            )
        stamps = np.array(self.stamps)
        if stamps.size > 1 and (stamps == stamps[0]).all():
            raise InputError(
                f"{self.where}: all headers have the stamp {stamps[0] / 1e9:g} s; set the time"
            )
        back = np.maximum.accumulate(stamps) - stamps
        far = back > LARGEST_STEP_BACK * 1e9
        if far.any():
            raise InputError(
                f"{self.where}: stamps jump back by {back[far][0] / 1e9:g} s at message "
                f"{far.argmax()}; a clock was set back, or these are several runs: cut the bag"
            )

    def _joint_values(self, message: Any) -> dict[str, list[float]]:
        if not self.joint_names:
            self.joint_names = tuple(message.name)
        names, k, values = self.joint_names, len(self.stamps), {}
        if not names or len(set(names)) < len(names):
            listed = ", ".join(names) or "none"
            raise InputError(f"{self.where} must name every joint once, not {listed}")
        if sorted(message.name) != sorted(names):
            raise InputError(
                f"{self.where}: message {k} names joints {', '.join(message.name)}, the first one "
                f"{', '.join(names)}; every message must name all joints"
            )
        for sensor, numbers in (("encoders", message.position), ("joint_rates", message.velocity)):
            if len(numbers) not in (0, len(names)):
                raise InputError(
                    f"{self.where}: message {k} has {len(numbers)} values for {len(names)} joints"
                )
            if len(numbers):
                by_name = dict(zip(message.name, numbers.tolist()))
                values[sensor] = [by_name[name] for name in names]
        return values


def _vector(xyz: Any) -> tuple[float, ...]:
    return xyz.x, xyz.y, xyz.z


def _quaternion(orientation: Any) -> tuple[float, ...]:
    """Return (w, x, y, z); ROS has w last."""
    return orientation.w, orientation.x, orientation.y, orientation.z


def _pose_values(message: Any) -> dict[str, tuple[float, ...]]:
    pose = message.pose
    return {"attitude": _quaternion(pose.orientation), "position": _vector(pose.position)}


def _odometry_values(message: Any) -> dict[str, tuple[float, ...]]:
    twist = message.twist.twist
    values = _pose_values(message.pose)
    return values | {"velocity": _vector(twist.linear), "gyro": _vector(twist.angular)}


def _imu_values(message: Any) -> dict[str, tuple[float, ...]]:
    values = {}
    if message.orientation_covariance[0] != -1:
        values["attitude"] = _quaternion(message.orientation)
    if message.angular_velocity_covariance[0] != -1:
        values["gyro"] = _vector(message.angular_velocity)
    return values


def _thrust_values(message: Any) -> dict[str, tuple[float, ...]]:
    wrench = message.wrench
    return {THRUST: (*_vector(wrench.torque), *_vector(wrench.force))}


_BASE_VALUES = {
    "odometry": _odometry_values,
    "pose": _pose_values,
    "imu": _imu_values,
    "thrust": _thrust_values,
}


def _origin(stamps: NDArray[np.int64]) -> int:
    """Return the first stamp [ns] of those within ten days of the middle one."""
    middle = np.sort(stamps)[stamps.size // 2]
    return stamps[np.abs(stamps - middle) < 10 * 86400 * 10**9].min()


def _to_world(
    quaternion_WB: NDArray[np.float64], v_WB_B: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return v_WB_W (N, 3); NaN where the quaternion is not of unit norm."""
    with np.errstate(over="ignore"):
        unit = np.abs(np.linalg.norm(quaternion_WB, axis=1, keepdims=True) - 1) < 1e-3
    attitude = Rotation.from_quat(np.where(unit, quaternion_WB, [1, 0, 0, 0]), scalar_first=True)
    return np.where(unit, rotate(attitude.as_matrix(), v_WB_B), np.nan)
