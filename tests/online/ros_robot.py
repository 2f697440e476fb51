"""A robot on ROS 2, as a process: it publishes a log's samples, and prints what it hears.

python ros_robot.py LOG RATE [--start T0] [--end T1] [--shift S]: each line on stdout is JSON.
It sends as soon as it hears the node and all its topics have subscribers. It ends when the node has
taken all its samples and it has heard their estimate, or `PATIENCE` seconds later. So a busy
machine makes it slower, and no message is lost.
"""

import argparse
import json
import os
import signal
import time

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import InertiaStamped, PoseStamped
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import Float64MultiArray

import cpid_drake as cpid

BEHIND = "behind the latest stamp [s]"
"""How diagnostics name what the latest message of a topic is behind that of all topics."""

EPOCH = 1_700_000_000 * 10**9
TYPES = {"joints": JointState, "imu": Imu, "pose": PoseStamped}
TOPICS = {"joints": "/joint_states", "imu": "/imu/data", "pose": "/pose"}

DEPTH = 2000
"""More messages than it sends: a reliable publisher overwrites none that the node still lacks."""

PATIENCE = 600.0
"""The longest wait for the node after the last sample [s]. No claim about speed."""


class Robot:
    """The node with its publishers and what it heard."""

    def __init__(self, log, reliability: str) -> None:
        self.log, self.node = log, rclpy.create_node("robot")
        qos = QoSProfile(depth=DEPTH, reliability=ReliabilityPolicy[reliability])
        self.publishers = {
            kind: self.node.create_publisher(TYPES[kind], topic, qos)
            for kind, topic in TOPICS.items()
        }
        self.until = self.sigma_until = self.newest = 0
        self.mass = self.estimated_mass = np.nan
        self.rows: dict[str, dict[str, str]] = {}
        # The last is the last that the node finds: who hears diagnostics hears all of them.
        self.node.create_subscription(InertiaStamped, "/cpid/target", self.hear_target, 10)
        self.node.create_subscription(InertiaStamped, "/cpid/target_sigma", self.hear_sigma, 10)
        self.node.create_subscription(Float64MultiArray, "/cpid/estimate", self.hear_estimate, 10)
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self.hear_diagnostics, 10)

    def hear_target(self, message) -> None:
        own, self.until = message.inertia, stamp_of(message)
        self.mass = own.m
        values = [own.m, own.com.x, own.com.y, own.com.z, own.ixx, own.iyy, own.izz]
        tell(
            target=[*values, own.ixy, own.ixz, own.iyz],
            until=(self.until - EPOCH) / 1e9,
            frame=message.header.frame_id,
        )

    def hear_sigma(self, message) -> None:
        self.sigma_until = stamp_of(message)
        tell(sigma_m=message.inertia.m)

    def hear_estimate(self, message) -> None:
        shape = [each.size for each in message.layout.dim]
        self.estimated_mass = message.data[0]
        tell(estimate=np.reshape(message.data, shape).tolist())

    def hear_diagnostics(self, message) -> None:
        self.newest = stamp_of(message)
        self.rows = {each.name: {v.key: v.value for v in each.values} for each in message.status}
        said = {each.name: [each.level[0], each.message] for each in message.status}
        tell(diagnostics={name: [*said[name], values] for name, values in self.rows.items()})

    def is_heard(self) -> bool:
        """Return whether the node hears it, and it the node."""
        there = (each.get_subscription_count() for each in self.publishers.values())
        return bool(self.rows) and all(there)

    def is_answered(self, last: int) -> bool:
        """Return whether the node has all samples until a stamp, and told what they give."""
        topics = [each for each in self.rows.values() if "messages" in each]
        if self.newest != last or {each.get(BEHIND) for each in topics} != {"0.000"}:
            return False
        behind = float(self.rows["cpid: stream"]["estimate is behind the latest stamp [s]"])
        is_last = abs((last - self.until) / 1e9 - behind) < 0.01
        return is_last and self.sigma_until == self.until and self.estimated_mass == self.mass

    def message(self, kind: str, stamp: int, k: int):
        """Return message k of a kind."""
        message, log = TYPES[kind](), self.log
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 10**9)
        if kind == "joints":
            message.name = list(reversed(log.joint_names))
            message.position = log.encoders.value[k, ::-1].tolist()
        elif kind == "imu":
            message.orientation_covariance[0] = -1.0
            rate = message.angular_velocity
            rate.x, rate.y, rate.z = log.gyro.value[k].tolist()
        else:
            q, p = message.pose.orientation, message.pose.position
            q.w, q.x, q.y, q.z = log.attitude.value[k].tolist()
            p.x, p.y, p.z = log.position.value[k].tolist()
        return message

    def spin(self, seconds: float) -> None:
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            rclpy.spin_once(self.node, timeout_sec=left)


def stamp_of(message) -> int:
    """Return the stamp of a message [ns]."""
    return message.header.stamp.sec * 10**9 + message.header.stamp.nanosec


def tell(**what) -> None:
    print(json.dumps(what), flush=True)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("log")
    parser.add_argument("rate", type=float)
    parser.add_argument("--start", type=float, default=-np.inf)
    parser.add_argument("--end", type=float, default=np.inf)
    parser.add_argument("--shift", type=float, default=0.0, help="of the stamps [s]")
    parser.add_argument("--reliability", default="RELIABLE")
    parser.add_argument("--alone", type=float, default=-np.inf, help="needs no node until then [s]")
    parser.add_argument("--die", action="store_true", help="when all is sent and answered")
    given = parser.parse_args()
    rclpy.init()
    robot = Robot(cpid.read_log(given.log).between(given.start, given.end), given.reliability)
    time_, begin = robot.log.encoders.time, time.monotonic()
    last = 0
    for k, stamp in enumerate(time_):
        while stamp >= given.alone and not robot.is_heard():
            robot.spin(0.1)
            begin = time.monotonic() - (stamp - time_[0]) / given.rate
        robot.spin(begin + (stamp - time_[0]) / given.rate - time.monotonic())
        last = EPOCH + round((stamp + given.shift) * 1e9)
        for kind, publisher in robot.publishers.items():
            publisher.publish(robot.message(kind, last, k))
        if k == 0:
            tell(first=stamp)
    tell(sent=len(time_))
    end = time.monotonic() + PATIENCE
    while not (robot.until if given.die else robot.is_answered(last)) and time.monotonic() < end:
        robot.spin(0.1)
    if given.die:
        os.kill(os.getpid(), signal.SIGKILL)
    rclpy.shutdown()


if __name__ == "__main__":
    main()
