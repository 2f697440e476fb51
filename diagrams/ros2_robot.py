#!/usr/bin/env python3
"""A robot on ROS 2 for `cpid live ros2`: it publishes the sample log, and prints the target.

It needs ROS 2 and its messages: a sourced ROS, or `pip install 'cpid-drake[ros2]'`.
"""

import rclpy
from geometry_msgs.msg import InertiaStamped, PoseStamped
from rclpy.time import Time
from sensor_msgs.msg import Imu, JointState

import cpid_drake as cpid

log = cpid.read_log(cpid.models_directory() / "telemetry/free_flyer.csv")
rclpy.init()
node = rclpy.create_node("robot")
joints = node.create_publisher(JointState, "/joint_states", 100)
imu = node.create_publisher(Imu, "/imu/data", 100)
pose = node.create_publisher(PoseStamped, "/pose", 100)


def show(message):
    """Print the mass and the time until which samples are in it."""
    stamp = message.header.stamp
    print(f"{stamp.sec + 1e-9 * stamp.nanosec:.2f} s  m = {message.inertia.m:.4f} kg", flush=True)


node.create_subscription(InertiaStamped, "/cpid/target", show, 10)
while not all(each.get_subscription_count() for each in (joints, imu, pose)):
    rclpy.spin_once(node, timeout_sec=0.1)  # until the node is there

start = node.get_clock().now().nanoseconds
for k, time in enumerate(log.encoders.time):
    now = Time(nanoseconds=start + round(1e9 * time))
    while node.get_clock().now().nanoseconds < now.nanoseconds:
        rclpy.spin_once(node, timeout_sec=0.001)
    message = JointState(name=log.joint_names, position=log.encoders.value[k].tolist())
    message.header.stamp = now.to_msg()
    joints.publish(message)

    message = Imu()
    message.header.stamp = now.to_msg()
    message.orientation_covariance[0] = -1.0  # it has none
    rate = message.angular_velocity
    rate.x, rate.y, rate.z = log.gyro.value[k].tolist()
    imu.publish(message)

    message = PoseStamped()
    message.header.stamp = now.to_msg()
    position, attitude = message.pose.position, message.pose.orientation
    position.x, position.y, position.z = log.position.value[k].tolist()
    attitude.w, attitude.x, attitude.y, attitude.z = log.attitude.value[k].tolist()
    pose.publish(message)
for _ in range(300):  # the last estimate
    rclpy.spin_once(node, timeout_sec=0.01)
