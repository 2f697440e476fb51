"""What ROS messages say of a spacecraft's motion, of a bag or as they arrive.

A message is any object with the fields of its type.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cpid_drake.array import Array
from cpid_drake.dynamics.rotations import rotate_by_quaternion
from cpid_drake.files.errors import InputError
from cpid_drake.logs.log import THRUST
from cpid_drake.logs.screening import QUATERNION_NORM

TRANSFORMS = "tf2_msgs/msg/TFMessage"
"""Type of topics with the transforms of many frames."""

TOPIC_TYPES = {
    "odometry": ("nav_msgs/msg/Odometry",),
    "pose": (
        "geometry_msgs/msg/PoseStamped",
        "geometry_msgs/msg/PoseWithCovarianceStamped",
        "geometry_msgs/msg/TransformStamped",
        TRANSFORMS,
    ),
    "imu": ("sensor_msgs/msg/Imu",),
    "joints": ("sensor_msgs/msg/JointState",),
    "thrust": ("geometry_msgs/msg/WrenchStamped",),
}
"""Message types that are read, by kind of topic."""

SOURCES = {
    "attitude": ("odometry", "pose", "imu"),
    "gyro": ("imu", "odometry"),
    "position": ("odometry", "pose"),
    "velocity": ("odometry",),
    THRUST: ("thrust",),
}
"""For each quantity, the kinds of topic that can hold its samples; the first that does is used."""


def stamp_of(message: Any) -> int:
    """Return the stamp of a message's header [ns]."""
    stamp = message.header.stamp
    return int(stamp.sec * 10**9 + stamp.nanosec)


def joint_values(message: Any, where: str, k: int) -> dict[str, Sequence[float]]:
    """Return positions and rates of message k by columns."""
    if len(set(message.name)) < len(message.name):
        raise InputError(f"{where} must name every joint once, not {', '.join(message.name)}")
    values: dict[str, Sequence[float]] = {}
    for prefix, numbers in (("q:", message.position), ("qd:", message.velocity)):
        if len(numbers) not in (0, len(message.name)):
            raise InputError(
                f"{where}: message {k} has {len(numbers)} values for {len(message.name)} joints"
            )
        values |= {prefix + name: (float(x),) for name, x in zip(message.name, numbers)}
    return values


def message_values(message: Any, kind: str) -> dict[str, Sequence[float]]:
    """Return the quantities in a message about the base.

    A quaternion of zeros, of a message that nobody filled, is no attitude; the odometry's velocity,
    which is in the axes of its child frame, is then absent, too.
    """
    if kind == "thrust":
        wrench = message.wrench
        return {THRUST: [*_vector(wrench.torque), *_vector(wrench.force)]}
    if kind == "imu":
        values = {}
        if message.orientation_covariance[0] != -1:
            values = _attitude(message.orientation)
        if message.angular_velocity_covariance[0] != -1:
            values["gyro"] = _vector(message.angular_velocity)
        return values
    if hasattr(message, "transform"):
        pose = message.transform
        return {**_attitude(pose.rotation), "position": _vector(pose.translation)}
    pose = message.pose.pose if hasattr(message.pose, "pose") else message.pose
    values = {**_attitude(pose.orientation), "position": _vector(pose.position)}
    if kind == "odometry":
        twist = message.twist.twist
        values["gyro"] = _vector(twist.angular)
        if "attitude" in values:
            values["velocity"] = _vector(twist.linear)
    return values


def velocity_in_W(v_B: ArrayLike, quaternion_WB: ArrayLike) -> Array:
    """Return a velocity (3,) in W, given it in B, and the attitude; NaN if the attitude is none."""
    q = np.asarray(quaternion_WB)
    is_unit = abs(np.linalg.norm(q) - 1) < QUATERNION_NORM
    return rotate_by_quaternion(q, np.asarray(v_B)) if is_unit else np.full(3, np.nan)


def _vector(xyz: Any) -> Sequence[float]:
    return xyz.x, xyz.y, xyz.z


def _attitude(orientation: Any) -> dict[str, Sequence[float]]:
    """Return the attitude w, x, y, z; nothing for zeros. ROS has w last."""
    quaternion = orientation.w, orientation.x, orientation.y, orientation.z
    return {"attitude": quaternion} if any(quaternion) else {}
