"""Logs as laboratories write them, each made by code of its own from the samples of one log.

Every function yields files by name, and takes the rows of the sample log: time, R_WB, position,
gyro, joint angles at one instant each.
"""

from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime, timedelta

import numpy as np
from scipy.spatial.transform import Rotation

Files = dict[str, str | bytes]

WXYZ = [f"q{a}" for a in "wxyz"]


@dataclass(frozen=True)
class Rows:
    """The samples of one log at common instants."""

    t: np.ndarray
    R: Rotation
    p: np.ndarray
    w: np.ndarray
    q: np.ndarray

    def part(self, every: int) -> "Rows":
        return Rows(*(x[::every] for x in (self.t, self.R, self.p, self.w, self.q)))


def table(names, *columns, between=",", form="{:.9g}", head="", absent="") -> str:
    block = np.column_stack([np.asarray(c, dtype=object) for c in columns])
    lines = [between.join(names)] if names else []
    for row in block:
        cells = (c if isinstance(c, str) else absent if c != c else form.format(c) for c in row)
        lines.append(between.join(cells))
    return head + "\n".join(lines) + "\n"


def wxyz(rows):
    return rows.R.as_quat(scalar_first=True, canonical=False)


def xyzw(rows):
    return rows.R.as_quat(canonical=False)


def numbered(word, count, form="{}{}"):
    return [form.format(word, k + 1) for k in range(count)]


def axes(form):
    return [form.format(a) for a in "xyz"]


LABS: dict[str, Callable[[Rows], Files]] = {}


def lab(make):
    LABS[make.__name__] = make
    return make


@lab
def flat(r):
    names = ["t", *(f"quat_{a}" for a in "wxyz"), *axes("pos_{}_mm"), *axes("gyro_{}_dps")]
    names += numbered("joint", 4, "{}{}_deg")
    parts = wxyz(r), 1000 * r.p, np.degrees(r.w), np.degrees(r.q)
    return {"log.csv": table(names, r.t, *parts)}


def _plotjuggler(r, has_stamps):
    """One row for each message; header stamps are in the rows of their topic only."""
    imu = [*axes("/imu/angular_velocity/{}"), *(f"/imu/orientation/{a}" for a in "xyzw")]
    pose = axes("/pose/position/{}")
    joints = [f"/joint_states/arm_joint{k + 1}/position" for k in range(4)]
    groups = [(imu, np.hstack([r.w, xyzw(r)])), (pose, r.p), (joints, r.q)]
    names, rows = ["__time"], []
    topics = ("imu", "pose", "joint_states")
    for topic, (group, _) in zip(topics, groups):
        names += ([f"/{topic}/header/stamp"] if has_stamps else []) + group
    for k, t in enumerate(r.t):
        for own, (_, values) in enumerate(groups):
            row = [t + 1e-4 * own]
            for other, (each, _) in enumerate(groups):
                here = other == own
                row += [t if here else np.nan] if has_stamps else []
                row += [*values[k]] if here else [np.nan] * len(each)
            rows.append(row)
    return {"log.csv": table(names, *np.array(rows).T, form="{:.12g}")}


@lab
def plotjuggler(r):
    return _plotjuggler(r.part(2), False)


@lab
def plotjuggler_with_header_stamps(r):
    return _plotjuggler(r.part(2), True)


@lab
def two_topics(r):
    """`rostopic echo -p`, a file for each topic, stamps in ns."""
    stamp = np.array([f"{1_700_000_000_000_000_000 + int(1e9 * t)}" for t in r.t], dtype=object)
    odom = [
        *axes("field.pose.pose.position.{}"),
        *(f"field.pose.pose.orientation.{a}" for a in "xyzw"),
    ]
    joints = [f"field.position{k}" for k in range(4)]
    return {
        "odom.csv": table(["%time", *odom], stamp, r.p, xyzw(r)),
        "joints.csv": table(["%time", *joints], stamp, r.q),
    }


@lab
def matlab_timetable(r):
    names = ["Time", *numbered("quat_", 4), *numbered("omega_", 3), *numbered("pos_", 3)]
    names += numbered("theta_", 4)
    stamps = [f"{t:.2f} sec" for t in r.t]
    return {"log.csv": table(names, stamps, wxyz(r), r.w, r.p, r.q)}


@lab
def matlab_table(r):
    names = ["Time", *numbered("q_", 4), *numbered("omega_", 3), *numbered("r_", 3)]
    return {"log.csv": table([*names, *numbered("theta_", 4)], r.t, wxyz(r), r.w, r.p, r.q)}


@lab
def pandas_dates(r):
    start = datetime(2026, 3, 1, 12)
    stamps = [
        (start + timedelta(seconds=float(t))).isoformat(sep=" ", timespec="microseconds")
        for t in r.t
    ]
    names = ["", "qx", "qy", "qz", "qw", *axes("{}"), *axes("bw{}"), *numbered("q:arm_joint", 4)]
    return {"log.csv": table(names, stamps, xyzw(r), r.p, r.w, r.q)}


def _joints_file(r, later=0.0):
    return table(["Time (Seconds)", *numbered("arm_joint", 4)], r.t + later, r.q)


@lab
def motive_and_joints(r):
    """Two files: an export of OptiTrack's Motive, and the robot's joints 0.4 s later."""
    q, frame = xyzw(r), np.arange(len(r.t))
    lines = [
        "Format Version,1.23,Take Name,Take 1,Export Frame Rate,100,"
        "Rotation Type,Quaternion,Length Units,Meters",
        "",
        ",Type," + ",".join(7 * ["Rigid Body"]),
        ",Name," + ",".join(7 * ["base"]),
        ",ID," + ",".join(7 * ["1"]),
        ",," + ",".join(4 * ["Rotation"] + 3 * ["Position"]),
        "Frame,Time (Seconds),X,Y,Z,W,X,Y,Z",
    ]
    for k in range(len(r.t)):
        values = ",".join(f"{x:.7f}" for x in [*q[k], *r.p[k]])
        lines.append(f"{frame[k]},{r.t[k]:.6f},{values}")
    return {"take.csv": "\n".join(lines) + "\n", "joints.csv": _joints_file(r, 0.4)}


@lab
def simulink(r):
    names = ["time", *numbered("attitude", 4, "{}({})"), *numbered("omega", 3, "{}({})")]
    names += [*numbered("position", 3, "{}({})"), *numbered("joint", 4, "{}({})")]
    return {"log.csv": table(names, r.t, wxyz(r), r.w, r.p, r.q)}


@lab
def basilisk(r):
    names = [
        "time",
        *numbered("sigma_BN_", 3),
        *numbered("omega_BN_B_", 3),
        *numbered("r_BN_N_", 3),
    ]
    names += numbered("theta_", 4)
    return {"log.csv": table(names, r.t, r.R.as_mrp(), r.w, r.p, r.q)}


@lab
def german_excel(r):
    """Semicolons, decimal commas, cp1252."""
    names = [
        "Zeit [s]",
        "Gier [°]",
        "Nick [°]",
        "Roll [°]",
        *axes("{} [mm]"),
        *axes("Drehrate {} [°/s]"),
    ]
    names += numbered("Gelenk", 4, "{} {} [°]")
    parts = r.t, r.R.as_euler("ZYX", degrees=True), 1000 * r.p, np.degrees(r.w), np.degrees(r.q)
    text = table(names, *parts, between=";").replace(".", ",")
    return {"log.csv": text.encode("cp1252")}


@lab
def unit_line(r):
    names = ["time", *WXYZ, *axes("{}"), *axes("gyro_{}"), *numbered("arm_joint", 4)]
    units = ",".join(["s", *4 * "-", *3 * ["mm"], *3 * ["deg/s"], *4 * ["deg"]])
    body = table([], r.t, wxyz(r), 1000 * r.p, np.degrees(r.w), np.degrees(r.q))
    return {"log.csv": ",".join(names) + "\n" + units + "\n" + body}


@lab
def epoch_ms(r):
    names = [
        "timestamp",
        *(f"q{a}" for a in "xyzw"),
        *axes("p{}"),
        *axes("gyro_{}"),
        *numbered("joint_", 4),
    ]
    return {
        "log.csv": table(
            names, np.round(1.7e12 + 1000 * r.t), xyzw(r), r.p, r.w, r.q, form="{:.13g}"
        )
    }


def _own(r):
    names = ["time", *WXYZ, *axes("{}"), *axes("bw{}"), *numbered("q:arm_joint", 4)]
    return names, [r.t, wxyz(r), r.p, r.w, r.q]


@lab
def duplicated_rows(r):
    names, parts = _own(r)
    lines = table(names, *parts).splitlines()
    return {"log.csv": "\n".join([*lines[:200], *lines[190:200], *lines[200:]]) + "\n"}


@lab
def nan_as_absent(r):
    names, (t, q, p, w, joints) = _own(r)
    p = np.where(np.arange(len(t))[:, None] % 2 == 0, p, np.nan)
    return {"log.csv": table(names, t, q, p, w, joints, absent="NaN")}


@lab
def dropouts_as_minus_9999(r):
    names, (t, q, p, w, joints) = _own(r)
    p = np.where(np.arange(len(t))[:, None] % 97 == 5, -9999.0, p)
    return {"log.csv": table(names, t, q, p, w, joints)}


@lab
def joints_without_answer_as_minus_9999(r):
    names, (t, q, p, w, joints) = _own(r)
    joints = np.where(np.arange(len(t))[:, None] % 41 == 7, -9999.0, joints)
    return {"log.csv": table(names, t, q, p, w, joints)}


@lab
def scalar_last(r):
    names = ["t", *numbered("q", 4), *axes("w{}"), *axes("{}"), *numbered("arm_joint", 4)]
    return {"log.csv": table(names, r.t, xyzw(r), r.w, r.p, r.q)}


@lab
def scalar_last_without_gyro(r):
    names = ["t", *numbered("q", 4), *axes("{}"), *numbered("arm_joint", 4)]
    return {"log.csv": table(names, r.t, xyzw(r), r.p, r.q)}


@lab
def tum(r):
    head = "# timestamp tx ty tz qx qy qz qw j1 j2 j3 j4\n"
    return {"log.csv": table([], r.t, r.p, xyzw(r), r.q, between=" ", head=head)}


@lab
def euler_xyz_without_gyro(r):
    names = ["time", "rx", "ry", "rz", *axes("{}"), *numbered("arm_joint", 4)]
    return {"log.csv": table(names, r.t, r.R.as_euler("XYZ"), r.p, r.q)}


@lab
def roll_pitch_yaw_in_mrad(r):
    names = ["time", "roll_mrad", "pitch_mrad", "yaw_mrad", *axes("{}"), *axes("gyro_{}")]
    angles = 1000 * r.R.as_euler("xyz")
    return {"log.csv": table([*names, *numbered("arm_joint", 4)], r.t, angles, r.p, r.w, r.q)}


@lab
def roll_pitch_yaw_in_another_order(r):
    names = [
        "time",
        "roll",
        "pitch",
        "yaw",
        *axes("{}"),
        *axes("gyro_{}"),
        *numbered("arm_joint", 4),
    ]
    return {"log.csv": table(names, r.t, r.R.as_euler("XYZ"), r.p, r.w, r.q)}


@lab
def joints_from_the_tip(r):
    names = ["time", *WXYZ, *axes("{}"), *axes("bw{}"), *numbered("joint", 4)]
    return {"log.csv": table(names, r.t, wxyz(r), r.p, r.w, r.q[:, ::-1])}


@lab
def gyro_named_dps_in_rad(r):
    names = ["time", *WXYZ, *axes("{}"), *axes("gyro_{}_dps"), *numbered("arm_joint", 4)]
    return {"log.csv": table(names, r.t, wxyz(r), r.p, r.w, r.q)}


@lab
def pose_filled_forward(r):
    names, (t, q, p, w, joints) = _own(r)
    held = (np.arange(len(t)) // 5) * 5
    return {"log.csv": table(names, t, q[held], p[held], w, joints)}


@lab
def joints_in_degrees_without_position(r):
    names = ["time", *WXYZ, *axes("gyro_{}"), *numbered("arm_joint", 4, "{}{}_deg")]
    return {"log.csv": table(names, r.t, wxyz(r), r.w, np.degrees(r.q))}


@lab
def px4(r):
    """World axes north, east, down; body axes forward, right, down."""
    D = Rotation.from_euler("x", np.pi)
    q, p, w = (D * r.R * D).as_quat(scalar_first=True), r.p * [1, -1, -1], r.w * [1, -1, -1]
    names = ["timestamp", *(f"q[{k}]" for k in range(4)), *axes("{}")]
    names += [*(f"angular_velocity[{k}]" for k in range(3)), *numbered("arm_joint", 4)]
    return {"log.csv": table(names, np.round(1e6 * r.t), q, p, w, r.q, form="{:.10g}")}


@lab
def joints_with_blanks(r):
    names = [
        "Time (s)",
        "Quat W",
        "Quat X",
        "Quat Y",
        "Quat Z",
        *axes("Pos {} (m)"),
        *axes("Gyro {} (deg/s)"),
    ]
    names += numbered("Joint", 4, "{} {} (deg)")
    return {"log.csv": table(names, r.t, wxyz(r), r.p, np.degrees(r.w), np.degrees(r.q))}


@lab
def sec_and_nanosec(r):
    sec = np.floor(r.t) + 1.7e9
    nano = np.round(1e9 * (r.t - np.floor(r.t)))
    names = ["header.stamp.sec", "header.stamp.nanosec", *(f"orientation.{a}" for a in "xyzw")]
    names += [*axes("angular_velocity.{}"), *axes("position.{}"), *numbered("arm_joint", 4)]
    return {"log.csv": table(names, sec, nano, xyzw(r), r.w, r.p, r.q, form="{:.10g}")}


@lab
def utf_16(r):
    names, parts = _own(r)
    return {"log.csv": table(names, *parts, between="\t").encode("utf-16")}


@lab
def three_decimals(r):
    names, (t, q, p, w, joints) = _own(r)
    return {"log.csv": table(names, t, np.round(q, 3), p, w, joints)}


@lab
def clocks_apart(r):
    pose = table(["time", *WXYZ, *axes("{}")], r.t, wxyz(r), r.p)
    return {
        "mocap.csv": pose,
        "joints.csv": table(["time", *numbered("q:arm_joint", 4)], r.t + 0.3, r.q),
    }


@lab
def imu_tilted(r):
    names, (t, q, p, w, joints) = _own(r)
    tilted = Rotation.from_euler("y", 30, degrees=True).apply(w)
    return {"log.csv": table(names, t, q, p, tilted, joints)}


@lab
def tracked_body_turned(r):
    names, (t, _, p, w, joints) = _own(r)
    turned = r.R * Rotation.from_euler("z", 30, degrees=True)
    return {"log.csv": table(names, t, turned.as_quat(scalar_first=True), p, w, joints)}


@lab
def velocity_of_odometry(r):
    """The rates of joints beside their positions, in rpm."""
    names = ["time", *WXYZ, *axes("{}"), *axes("bw{}"), *numbered("arm_joint", 4)]
    rates = np.gradient(r.q, r.t, axis=0) * 30 / np.pi
    names += numbered("qd_arm_joint", 4, "{}{}_rpm")
    return {"log.csv": table(names, r.t, wxyz(r), r.p, r.w, r.q, rates)}
