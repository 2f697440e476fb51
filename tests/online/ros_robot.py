"""A robot on ROS 2, as a process: it publishes a log's samples, and prints what it hears.

python ros_robot.py LOG RATE [--start T0] [--end T1] [--shift S]: each line on stdout is JSON.
It sends as soon as all its topics have subscribers, and ends when it has heard the
estimate of its last samples, or `--patience` seconds later.
"""

import argparse
import json
import time

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import InertiaStamped, PoseStamped
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import Float64MultiArray

import cpid_drake as cpid

EPOCH = 1_700_000_000 * 10**9
TYPES = {"joints": JointState, "imu": Imu, "pose": PoseStamped}
TOPICS = {"joints": "/joint_states", "imu": "/imu/data", "pose": "/pose"}


class Robot:
    """The node with its publishers and what it heard."""

    def __init__(self, log, reliability: str) -> None:
        self.log, self.node = log, rclpy.create_node("robot")
        qos = QoSProfile(depth=100, reliability=ReliabilityPolicy[reliability])
        self.publishers = {
            kind: self.node.create_publisher(TYPES[kind], topic, qos)
            for kind, topic in TOPICS.items()
        }
        self.until = 0
        self.node.create_subscription(InertiaStamped, "/cpid/target", self.hear_target, 10)
        self.node.create_subscription(InertiaStamped, "/cpid/target_sigma", self.hear_sigma, 10)
        self.node.create_subscription(Float64MultiArray, "/cpid/estimate", self.hear_estimate, 10)
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self.hear_diagnostics, 10)

    def hear_target(self, message) -> None:
        stamp = message.header.stamp
        self.until = stamp.sec * 10**9 + stamp.nanosec
        own = message.inertia
        values = [own.m, own.com.x, own.com.y, own.com.z, own.ixx, own.iyy, own.izz]
        tell(
            target=[*values, own.ixy, own.ixz, own.iyz],
            until=(self.until - EPOCH) / 1e9,
            frame=message.header.frame_id,
        )

    def hear_sigma(self, message) -> None:
        tell(sigma_m=message.inertia.m)

    def hear_estimate(self, message) -> None:
        shape = [each.size for each in message.layout.dim]
        tell(estimate=np.reshape(message.data, shape).tolist())

    def hear_diagnostics(self, message) -> None:
        tell(
            diagnostics={
                each.name: [each.level[0], each.message, {v.key: v.value for v in each.values}]
                for each in message.status
            }
        )

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


def tell(**what) -> None:
    print(json.dumps(what), flush=True)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("log")
    parser.add_argument("rate", type=float)
    parser.add_argument("--start", type=float, default=-np.inf)
    parser.add_argument("--end", type=float, default=np.inf)
    parser.add_argument("--shift", type=float, default=0.0, help="of the stamps [s]")
    parser.add_argument("--silent", default="", help="kind of topic that is not sent")
    parser.add_argument("--reliability", default="RELIABLE")
    parser.add_argument("--eager", action="store_true", help="do not wait for subscribers")
    parser.add_argument("--patience", type=float, default=60.0)
    given = parser.parse_args()
    rclpy.init()
    robot = Robot(cpid.read_log(given.log).between(given.start, given.end), given.reliability)
    while not given.eager and not all(
        each.get_subscription_count() for each in robot.publishers.values()
    ):
        robot.spin(0.1)
    time_, begin = robot.log.encoders.time, time.monotonic()
    last, counts = 0, dict.fromkeys(TYPES, 0)
    for k, stamp in enumerate(time_):
        robot.spin(begin + (stamp - time_[0]) / given.rate - time.monotonic())
        last = EPOCH + round((stamp + given.shift) * 1e9)
        for kind in TYPES.keys() - {given.silent}:
            robot.publishers[kind].publish(robot.message(kind, last, k))
            counts[kind] += 1
    tell(sent=counts)
    end = time.monotonic() + given.patience
    while robot.until < last - 1.6e9 and time.monotonic() < end:
        robot.spin(0.1)
    robot.spin(1.5)
    rclpy.shutdown()


if __name__ == "__main__":
    main()
