"""Logs with wrong units, frames, joints and clocks."""

import log_clocks as clock
import log_noise as noise
import log_spoils as spoil
import log_words as words
import numpy as np
from log_case import Case
from log_sources import CLEAN


def _arm(k: int) -> str:
    return f"capture_arm_joint{k}"


NO_RATES = spoil.without("joint_rates", "gyro")
NO_VELOCITY = spoil.without("velocity")
POSES = spoil.without("velocity", "joint_rates", "gyro")

UNITS = {
    "position_mm": Case(
        "units", "arms_flight", words.POSITION_UNIT, spoil.scaled("position", 1e3), motion=CLEAN
    ),
    "position_mm_exact": Case(
        "units",
        "arms_exact",
        words.POSITION_UNIT,
        spoil.in_turn(NO_VELOCITY, spoil.scaled("position", 1e3)),
    ),
    "position_cm": Case(
        "units", "flyer_testbed", words.POSITION_UNIT, spoil.scaled("position", 1e2)
    ),
    "position_feet": Case(
        "units", "wheels_servicer", words.POSITION_UNIT, spoil.scaled("position", 1 / 0.3048)
    ),
    "velocity_mm": Case(
        "units",
        "arms_exact",
        r"velocity.{0,60}(unit|millimet|factor)|(unit|millimet).{0,60}velocity",
        spoil.in_turn(spoil.without("position"), spoil.scaled("velocity", 1e3)),
    ),
    "joints_degrees": Case(
        "units", "arms_flight", words.JOINT_UNIT, spoil.scaled("encoders", 180 / np.pi)
    ),
    "joints_degrees_flyer": Case(
        "units", "flyer_testbed", words.JOINT_UNIT, spoil.scaled("encoders", 180 / np.pi)
    ),
    "joints_degrees_rates_too": Case(
        "units",
        "arms_exact",
        words.JOINT_UNIT,
        columns=spoil.scaled_columns(180 / np.pi, ("q:", "qd:")),
    ),
    "rates_degrees_only": Case(
        "units", "arms_exact", words.RATE_UNIT, spoil.scaled("joint_rates", 180 / np.pi)
    ),
    "gyro_degrees": Case(
        "units", "arms_flight", words.RATE_UNIT, spoil.scaled("gyro", 180 / np.pi)
    ),
    "gyro_degrees_relative": Case(
        "units",
        "arms_exact",
        words.RATE_UNIT,
        spoil.in_turn(
            spoil.without("position", "velocity", "attitude"), spoil.scaled("gyro", 180 / np.pi)
        ),
    ),
    "wheels_rpm": Case(
        "units",
        "wheels_exact",
        words.RATE_UNIT,
        columns=spoil.scaled_columns(30 / np.pi, ("qd:wheel",)),
    ),
    "wheels_rpm_no_angles": Case(
        "units",
        "wheels_exact",
        words.RATE_UNIT,
        columns=lambda c: {
            name: values
            for name, values in spoil.scaled_columns(30 / np.pi, ("qd:wheel",))(c).items()
            if not name.startswith("q:wheel")
        },
    ),
    "time_ms": Case(
        "units", "arms_flight", words.TIME_UNIT, columns=spoil.scaled_columns(1e3, ("time",))
    ),
    "time_ns": Case(
        "units", "flyer_testbed", words.TIME_UNIT, columns=spoil.scaled_columns(1e9, ("time",))
    ),
    "time_ms_exact": Case(
        "units", "arms_exact", words.TIME_UNIT, columns=spoil.scaled_columns(1e3, ("time",))
    ),
    "all_1e8": Case(
        "issue",
        "flyer_exact",
        r"large|unit|factor",
        columns=lambda c: {
            name: values if name[0] == "q" and name[1] in "wxyz" else values * 1e8
            for name, values in c.items()
        },
    ),
}

FRAMES = {
    "gyro_in_world": Case(
        "frames", "tumbling_flight", words.AXES, spoil.turned_by_attitude("gyro", inverse=False)
    ),
    "gyro_named_world": Case(
        "frames", "tumbling_flight", words.AXES, columns=spoil.renamed("bw", "w")
    ),
    "gyro_in_world_exact": Case(
        "frames", "paper_exact", words.AXES, spoil.turned_by_attitude("gyro", inverse=False)
    ),
    "velocity_in_body": Case(
        "frames", "paper_exact", words.AXES, spoil.turned_by_attitude("velocity", inverse=True)
    ),
    "velocity_in_body_only": Case(
        "frames",
        "tumbling_exact",
        words.AXES,
        spoil.in_turn(
            spoil.turned_by_attitude("velocity", inverse=True), spoil.without("position")
        ),
    ),
    "position_in_body": Case(
        "frames", "tumbling_flight", words.AXES, spoil.turned_by_attitude("position", inverse=True)
    ),
    "quaternion_conjugate": Case("frames", "arms_flight", words.AXES, spoil.conjugated()),
    "quaternion_conjugate_poses": Case(
        "frames", "paper_exact", words.AXES, spoil.in_turn(POSES, spoil.conjugated())
    ),
    "quaternion_xyzw": Case(
        "frames", "arms_flight", words.AXES, spoil.reordered("attitude", [1, 2, 3, 0], [1, 1, 1, 1])
    ),
    "quaternion_xyzw_poses": Case(
        "frames",
        "arms_exact",
        words.AXES,
        spoil.in_turn(POSES, spoil.reordered("attitude", [1, 2, 3, 0], [1, 1, 1, 1])),
    ),
    "left_handed": Case(
        "frames",
        "arms_flight",
        words.AXES,
        spoil.in_turn(
            spoil.reordered("attitude", [0, 1, 2, 3], [1, -1, 1, -1]),
            spoil.reordered("position", [0, 1, 2], [1, -1, 1]),
            spoil.reordered("gyro", [0, 1, 2], [-1, 1, -1]),
        ),
    ),
    "position_y_z_swapped": Case(
        "frames", "flyer_testbed", words.AXES, spoil.reordered("position", [0, 2, 1], [1, 1, 1])
    ),
    "base_axes_turned": Case(
        "frames", "arms_flight", words.AXES, spoil.turned_body([np.pi, 0, 0], "attitude", "gyro")
    ),
    "base_axes_yaw_90": Case(
        "frames",
        "flyer_testbed",
        words.AXES,
        spoil.turned_body([0, 0, np.pi / 2], "attitude", "gyro"),
    ),
    "attitude_other_world": Case(
        "frames", "arms_flight", words.AXES, spoil.turned_world([0, 0, np.radians(30)], "attitude")
    ),
    "position_other_point": Case(
        "frames", "arms_flight", words.POINT, spoil.moved_point([0.3, 0.4, 0.5])
    ),
    "position_other_point_exact": Case(
        "frames", "arms_exact", words.POINT, spoil.moved_point([0.3, 0.4, 0.5])
    ),
    "position_other_point_poses": Case(
        "frames",
        "paper_exact",
        words.POINT,
        spoil.in_turn(POSES, spoil.moved_point([0.0, 0.0, 0.5])),
    ),
    "position_other_point_flyer": Case(
        "frames", "flyer_testbed", words.POINT, spoil.moved_point([0.1, 0.0, 0.15])
    ),
    "position_5_cm_off": Case(
        "frames", "arms_flight", words.POINT, spoil.moved_point([0.0, 0.05, 0.0])
    ),
    "gyro_misaligned": Case(
        "frames", "tumbling_flight", words.AXES + "|gyro", spoil.turned_body([0.02, 0, 0], "gyro")
    ),
}

JOINTS = {
    "joints_exchanged": Case(
        "joints", "arms_flight", words.JOINT, columns=spoil.exchanged_joints({_arm(2): _arm(3)})
    ),
    "arms_exchanged": Case(
        "joints",
        "arms_flight",
        words.JOINT,
        columns=spoil.exchanged_joints({_arm(k): f"operating_arm_joint{k}" for k in range(1, 7)}),
    ),
    "joint_sign": Case(
        "joints", "arms_flight", words.JOINT, spoil.joint_values(_arm(4), lambda v: -v)
    ),
    "joint_sign_exact": Case(
        "joints", "paper_exact", words.JOINT, spoil.joint_values(_arm(2), lambda v: -v)
    ),
    "joint_sign_flyer": Case(
        "joints", "flyer_testbed", words.JOINT, spoil.joint_values("arm_joint2", lambda v: -v)
    ),
    "rate_sign_exact": Case(
        "joints",
        "arms_exact",
        words.JOINT + "|rate",
        spoil.joint_column("joint_rates", _arm(2), lambda t, v: -v),
    ),
    "joint_zero_5_deg": Case(
        "joints",
        "arms_flight",
        words.JOINT,
        spoil.joint_column("encoders", _arm(3), lambda t, v: v + np.radians(5)),
    ),
    "joint_zero_5_deg_flyer": Case(
        "joints",
        "flyer_testbed",
        words.JOINT,
        spoil.joint_column("encoders", "arm_joint3", lambda t, v: v + np.radians(5)),
    ),
    "joint_zero_90_deg": Case(
        "joints",
        "wheels_servicer",
        words.JOINT,
        spoil.joint_column("encoders", "arm_joint2", lambda t, v: v + np.pi / 2),
    ),
    "target_slips": Case(
        "joints",
        "arms_flight",
        words.JOINT + "|slip|loose|jump",
        spoil.joint_column("encoders", _arm(6), lambda t, v: v - np.where(t > 5, 0.1, 0.0)),
    ),
    "joint_scaled": Case(
        "joints", "arms_flight", words.JOINT, spoil.joint_values(_arm(2), lambda v: 1.1 * v)
    ),
    "extra_joint": Case(
        "issue",
        "flyer_testbed",
        "finger",
        columns=spoil.added_column("q:finger_joint", 0.01),
    ),
}

CLOCKS = {
    "gyro_late_50_ms": Case(
        "clocks", "arms_flight", words.CLOCK, clock.retimed("gyro", lambda t: t - 0.05)
    ),
    "attitude_late_50_ms": Case(
        "clocks", "tumbling_flight", words.CLOCK, clock.retimed("attitude", lambda t: t + 0.05)
    ),
    "position_late_500_ms": Case(
        "clocks", "arms_flight", words.CLOCK, clock.retimed("position", lambda t: t + 0.5)
    ),
    "position_late_50_ms": Case(
        "clocks", "flyer_testbed", words.CLOCK, clock.retimed("position", lambda t: t + 0.05)
    ),
    "encoders_late_50_ms": Case(
        "clocks", "arms_flight", words.CLOCK, clock.retimed("encoders", lambda t: t + 0.05)
    ),
    "encoders_late_500_ms": Case(
        "clocks", "wheels_servicer", words.CLOCK, clock.retimed("encoders", lambda t: t + 0.5)
    ),
    "encoders_clock_fast": Case(
        "clocks", "arms_flight", words.CLOCK, clock.retimed("encoders", lambda t: 1.01 * t)
    ),
    "position_clock_fast": Case(
        "clocks", "flyer_testbed", words.CLOCK, clock.retimed("position", lambda t: 1.01 * t)
    ),
    "lost_rows": Case("clocks", "arms_flight", words.CLOCK, columns=clock.lost_rows(0.1)),
    "encoders_lost_time_counted": Case(
        "clocks",
        "arms_flight",
        words.CLOCK,
        lambda m: m.updated({"encoders": clock.closed_gaps(0.1)(m)["encoders"]}),
    ),
    "played_backwards": Case(
        "clocks", "arms_exact", r"sign|backward|time|opposite", columns=clock.played_backwards
    ),
    "shuffled": Case("clocks", "arms_exact", r"time|order|increas", columns=clock.shuffled),
    "shuffled_values": Case(
        "clocks", "arms_exact", r"time|order|does not change|rate", columns=clock.shuffled_values
    ),
    "joined_logs": Case(
        "clocks", "arms_exact", r"jump|gap|joined|motion", columns=clock.joined_with_jump
    ),
    "joined_logs_poses": Case(
        "clocks",
        "paper_flight",
        r"jump|gap|joined|motion",
        columns=clock.joined_with_jump,
    ),
    "position_held": Case(
        "clocks", "flyer_testbed", r"repeat|stuck|held|late|rate", noise.held("position", 20)
    ),
}
