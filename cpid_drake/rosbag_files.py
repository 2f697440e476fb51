"""ROS 2 bags: what a robot published becomes `Measurements`, each sensor at its own times.

Read are the four message types in `TOPIC_TYPES`, from bags of either storage (sqlite3, MCAP), with
the PyPI package `rosbags`: ROS itself need not be installed.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from cpid_drake.errors import InputError
from cpid_drake.kinematics import rotate
from cpid_drake.sensors import Measurements, Samples, sample_widths

TOPIC_TYPES = {
    "odometry": "nav_msgs/msg/Odometry",
    "pose": "geometry_msgs/msg/PoseStamped",
    "imu": "sensor_msgs/msg/Imu",
    "joints": "sensor_msgs/msg/JointState",
}
"""What is read of a bag: a word for each kind of topic, and the message type."""

_SOURCES = {
    "attitude": ("odometry", "pose", "imu"),
    "gyro": ("imu", "odometry"),
    "position": ("odometry", "pose"),
    "velocity": ("odometry",),
    "encoders": ("joints",),
    "joint_rates": ("joints",),
}
"""Which kinds of topic can give a sensor's samples; the first that has any does."""

LARGEST_STEP_BACK = 1.0
"""Messages may come in another order than their stamps by so much [s], not more."""

_Message = tuple[int, dict[str, NDArray[np.float64]]]  # stamp [ns], values by sensor


def read_rosbag(path: str | Path, *, topics: Mapping[str, str] | None = None) -> Measurements:
    """Read the motion of a spacecraft from a ROS 2 bag.

    Attitude comes from the odometry, else the poses, else the IMU; position from the odometry, else
    the poses; velocity from the odometry, turned from its child frame into W by the message's own
    attitude; the gyro's samples from the IMU, else the odometry. The frames must be ours: poses are
    those of B in W, the odometry's child frame and the IMU's frame have B's axes (transforms, as of
    a tilted IMU, are not looked up). The messages' covariances are not used, but for the -1 that
    says that an IMU has no orientation or no angular velocity.

    Joint states must name all joints in every message, in any order; joints spread over several
    messages or topics are not put together. Columns are in the order of the first message.

    Times are those of the headers' stamps, not those of recording, and count from the bag's first
    stamp. It is subtracted in whole nanoseconds: seconds since 1970 would be good to 2e-7 s only.
    (Stamps over ten days from the others, of clocks not yet set, do not count as first.) Samples
    are in the order of stamps; what `sensors.screen` leaves out is left in.

    Args:
        path: the bag's folder, or a single .db3 or .mcap file.
        topics: which topic to read of each kind in `TOPIC_TYPES`, as {"imu": "/imu/data"}; "" for
            none. A kind that is not named needs none where the bag has only one of its type.

    Raises:
        InputError: `rosbags` is not installed; no bag, or a damaged one; several topics of a kind,
            none of joints, or none of the base; messages that contradict each other in frames or
            joints; stamps that do not move or jump back.

    """
    try:
        from rosbags.rosbag2 import Reader
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise InputError("ROS 2 bags need a package: pip install 'cpid-drake[ros]'") from error
    where = str(path)
    if not Path(path).exists():
        raise InputError(f"{where}: no such file or folder")
    # These four types are the same in every ROS 2, and older bags do not hold their definitions.
    typestore = get_typestore(Stores.ROS2_HUMBLE)
    logs: dict[str, list[_Message]] = {}
    joint_names: tuple[str, ...] = ()
    try:
        with Reader(Path(path)) as reader:
            chosen = _choose_topics(where, reader.connections, topics or {})
            for kind, topic in chosen.items():
                connections = [
                    connection
                    for connection in reader.connections
                    if (connection.topic, connection.msgtype) == (topic, TOPIC_TYPES[kind])
                ]
                messages = [
                    typestore.deserialize_cdr(data, TOPIC_TYPES[kind])
                    for _, _, data in reader.messages(connections=connections)
                ]
                topic = f"{where}: {topic}"
                expected = sum(connection.msgcount for connection in connections)
                if len(messages) < expected:
                    raise InputError(f"{topic}: only {len(messages)} of {expected} messages left")
                if kind == "joints":
                    joint_names, values = _joint_values(topic, messages)
                else:
                    _require_one_frame(topic, messages)
                    values = [_BASE_VALUES[kind](message) for message in messages]
                logs[kind] = _in_time(topic, messages, values)
    except InputError:
        raise
    except Exception as error:  # of a damaged bag, the package raises whatever it stumbles on
        problem = f"{type(error).__name__}: {error}"
        raise InputError(f"{where}: not a ROS 2 bag, or a damaged one ({problem})") from error
    origin = _origin([stamp for log in logs.values() for stamp, _ in log])
    return Measurements(joint_names, **_samples(logs, origin, sample_widths(joint_names)))


def _choose_topics(where: str, connections: list, topics: Mapping[str, str]) -> dict[str, str]:
    """Return the topic to read of each kind that is there."""
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
        if wanted is None and len(there) > 1:
            raise InputError(
                f"{where}: several topics of type {message_type}: {', '.join(there)}; choose one, "
                f"as in topics={{'{kind}': '{there[0]}'}} (they are not put together)"
            )
        if there and wanted != "":
            chosen[kind] = wanted or there[0]
    if "joints" not in chosen:
        raise InputError(f"{where}: no topic with joint positions ({TOPIC_TYPES['joints']})")
    if len(chosen) == 1:
        types = ", ".join(TOPIC_TYPES[kind] for kind in ("odometry", "pose", "imu"))
        raise InputError(f"{where}: no topic with the motion of the base (of type {types})")
    return chosen


# -- messages ------------------------------------------------------------------------------------


def _vector(xyz: Any) -> NDArray[np.float64]:
    return np.array([xyz.x, xyz.y, xyz.z])


def _quaternion(orientation: Any) -> NDArray[np.float64]:
    """Return (w, x, y, z); ROS has w last."""
    return np.array([orientation.w, orientation.x, orientation.y, orientation.z])


def _pose_values(message: Any) -> dict[str, NDArray[np.float64]]:
    pose = message.pose
    return {"attitude": _quaternion(pose.orientation), "position": _vector(pose.position)}


def _odometry_values(message: Any) -> dict[str, NDArray[np.float64]]:
    twist = message.twist.twist
    values = _pose_values(message.pose)
    v_WB_B, quaternion = _vector(twist.linear), values["attitude"]
    # Where the attitude says nothing, neither does the velocity.
    v_WB_W = np.full(3, np.nan)
    if abs(np.linalg.norm(quaternion) - 1) < 1e-3:
        v_WB_W = rotate(Rotation.from_quat(quaternion, scalar_first=True).as_matrix(), v_WB_B)
    return {**values, "velocity": v_WB_W, "gyro": _vector(twist.angular)}


def _imu_values(message: Any) -> dict[str, NDArray[np.float64]]:
    values = {}
    if message.orientation_covariance[0] != -1:
        values["attitude"] = _quaternion(message.orientation)
    if message.angular_velocity_covariance[0] != -1:
        values["gyro"] = _vector(message.angular_velocity)
    return values


_BASE_VALUES = {"odometry": _odometry_values, "pose": _pose_values, "imu": _imu_values}


def _joint_values(
    topic: str, messages: list
) -> tuple[tuple[str, ...], list[dict[str, NDArray[np.float64]]]]:
    """Return the joints of the first message, and every message's values in their order."""
    if not messages:
        raise InputError(f"{topic} has no messages: no joint positions")
    names, result = tuple(messages[0].name), []
    if not names or len(set(names)) < len(names):
        raise InputError(f"{topic} must name every joint once, not {', '.join(names) or 'none'}")
    for k, message in enumerate(messages):
        if sorted(message.name) != sorted(names):
            raise InputError(
                f"{topic}: message {k} is of joints {', '.join(message.name)}, the first of "
                f"{', '.join(names)}; every message must be of all joints"
            )
        order, values = [message.name.index(name) for name in names], {}
        for sensor, numbers in (("encoders", message.position), ("joint_rates", message.velocity)):
            if len(numbers) not in (0, len(names)):
                raise InputError(
                    f"{topic}: message {k} has {len(numbers)} values for {len(names)} joints"
                )
            if len(numbers):
                values[sensor] = np.array(numbers, dtype=float)[order]
        result.append(values)
    return names, result


def _require_one_frame(topic: str, messages: list) -> None:
    frames = {(m.header.frame_id, getattr(m, "child_frame_id", "")) for m in messages}
    if len(frames) > 1:
        names = "; ".join(sorted(" ".join(pair).strip() or "(none)" for pair in frames)[:5])
        raise InputError(f"{topic} is of several frames: {names}; it must be of the base only")


# -- times ---------------------------------------------------------------------------------------


def _in_time(
    topic: str, messages: list, values: list[dict[str, NDArray[np.float64]]]
) -> list[_Message]:
    """Return the messages' values with their stamps [ns], in the order of stamps."""
    if not messages:
        return []
    times = [message.header.stamp for message in messages]
    stamps = np.array([time.sec * 10**9 + time.nanosec for time in times])
    if stamps.size > 1 and (stamps == stamps[0]).all():
        raise InputError(f"{topic}: all headers have the stamp {stamps[0] / 1e9:g} s; set the time")
    back = np.maximum.accumulate(stamps) - stamps
    if back.max() > LARGEST_STEP_BACK * 1e9:
        k = int((back > LARGEST_STEP_BACK * 1e9).argmax())
        raise InputError(
            f"{topic}: stamps jump back by {back[k] / 1e9:g} s at message {k}; a clock was set "
            "back, or these are several runs: cut the bag there"
        )
    return [(int(stamps[k]), values[k]) for k in np.argsort(stamps, kind="stable")]


def _origin(stamps: list[int]) -> int:
    """Return the first stamp [ns] of those within ten days of the middle one."""
    middle = sorted(stamps)[len(stamps) // 2]
    return min(stamp for stamp in stamps if abs(stamp - middle) < 10 * 86400 * 10**9)


def _samples(
    logs: dict[str, list[_Message]], origin: int, widths: dict[str, int]
) -> dict[str, Samples]:
    samples = {}
    for sensor, width in widths.items():
        picked: list[tuple[int, NDArray[np.float64]]] = []
        for kind in _SOURCES[sensor]:
            if not picked:
                picked = [(t, v[sensor]) for t, v in logs.get(kind, []) if sensor in v]
        time = np.array([stamp - origin for stamp, _ in picked], dtype=np.int64) / 1e9
        samples[sensor] = Samples(time, np.array([v for _, v in picked]).reshape(-1, width))
    return samples
