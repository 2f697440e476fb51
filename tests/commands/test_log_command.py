"""`cpid log`: logs of common tools are identified after `cpid log map`, without editing by hand."""

import json
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from cpid_drake import (
    Measurements,
    Telemetry,
    load_scenario,
    read_telemetry,
    shipped_scenario,
    write_telemetry,
)
from cpid_drake.dynamics.propagation import propagate
from cpid_drake.logs.column_map import load_column_map
from cpid_drake.logs.log import Samples
from cpid_drake.resources import models_directory
from cpid_drake.sensors.sensors import SENSORS

CRAFT = ("--scenario", "free_flyer_payload")
TRUTH = [8.5, 0.26, 0.02, -0.015, 0.16, 0.19, 0.25, 0.012, -0.008, 0.01]
"""The target of scenarios/free_flyer_payload.yaml."""

SAMPLE = models_directory() / "telemetry/free_flyer.csv"
MARKER = np.array([0.12, -0.08, 0.15])


@cache
def truth() -> Telemetry:
    """Return the exact motion of a shipped scenario."""
    scenario = load_scenario(shipped_scenario("free_flyer_payload"))
    craft, time = scenario.spacecraft.make(), np.arange(161) / 16
    motion = scenario.make_joint_motion(craft)
    base = propagate(craft.tree, motion, scenario.target_truth().to_standard_vector(), time)
    return base.to_telemetry(craft.joint_names, time, motion)


def in_body(motion, vectors):
    return np.einsum("nji,nj->ni", motion.R_WB, vectors)


def write_csv(path, columns):
    """Write columns of numbers or texts by name."""
    rows = zip(
        *(c if isinstance(c, list) else map(repr, np.asarray(c).tolist()) for c in columns.values())
    )
    path.write_text("\n".join([",".join(columns), *map(",".join, rows)]) + "\n")


def ros_csv(folder, motion):
    """A topic exported by ROS: nested names, ns since 1970, xyzw, degrees, names in text cells."""
    stamp = [str(1_700_000_000_000_000_000 + round(t * 1e9)) for t in motion.time]
    columns = {"%time": stamp, "field.header.seq": np.arange(len(motion))}
    columns |= {"field.header.stamp": stamp, "field.header.frame_id": ["map"] * len(motion)}
    for axis, values in zip("xyz", motion.p_WB.T):
        columns[f"field.pose.position.{axis}"] = values
    for axis, values in zip("wxyz", motion.quaternion_WB.T):
        columns[f"field.pose.orientation.{axis}"] = values
    order = ["x", "y", "z", "w"]
    moved = {
        f"field.pose.orientation.{a}": columns.pop(f"field.pose.orientation.{a}") for a in order
    }
    columns |= moved
    for k in range(36):
        columns[f"field.pose.covariance{k}"] = np.zeros(len(motion))
    for axis, values in zip("xyz", motion.v_WB.T):
        columns[f"field.twist.linear.{axis}"] = values
    for axis, values in zip("xyz", in_body(motion, motion.w_WB).T):
        columns[f"field.twist.angular.{axis}"] = np.degrees(values)
    names = [*reversed(motion.joint_names), "gripper"]
    angles = {**dict(zip(motion.joint_names, np.degrees(motion.q).T)), "gripper": motion.time}
    rates = {**dict(zip(motion.joint_names, np.degrees(motion.qdot).T)), "gripper": motion.time}
    for k, name in enumerate(names):
        columns[f"field.name{k}"] = [name] * len(motion)
        columns[f"field.position{k}"] = angles[name]
        columns[f"field.velocity{k}"] = rates[name]
        columns[f"field.effort{k}"] = np.zeros(len(motion))
    write_csv(folder / "log.csv", columns)
    return folder / "log.csv"


def vicon_csv(folder, motion):
    """A file of Vicon's Nexus: five lines of header, frames, millimetres, rotation vectors."""
    rotation = Rotation.from_quat(motion.quaternion_WB, scalar_first=True).as_rotvec(degrees=True)
    marker = motion.p_WB + np.einsum("nij,j->ni", motion.R_WB, MARKER)
    target = np.zeros((len(motion), 6))
    angles = np.degrees(motion.q)
    frames = np.arange(len(motion))[:, None] + 101
    table = np.hstack([frames, 0 * frames, target, rotation, marker * 1000, angles])
    joints = [f"{joint}" for joint in motion.joint_names]
    lines = [
        "Segments",
        "16",
        ",,Bag:Bag,,,,,,body:Base,,,,,," + ",".join("Joints" for _ in joints),
        "Frame,Sub Frame," + "RX,RY,RZ,TX,TY,TZ," * 2 + ",".join(joints),
        ",," + "deg,deg,deg,mm,mm,mm," * 2 + ",".join("deg" for _ in joints),
        *(",".join(map(repr, row)) for row in table.tolist()),
    ]
    (folder / "log.csv").write_text("\n".join(lines) + "\n")
    return folder / "log.csv"


def flat_vicon_csv(folder, motion):
    """Vicon's columns in one line of header, without units: those follow from the motion."""
    columns = {"Frame": np.arange(len(motion)), "Sub Frame": np.zeros(len(motion))}
    quaternion = motion.quaternion_WB[:, [1, 2, 3, 0]]
    for name, values in zip(("RX", "RY", "RZ", "RW"), quaternion.T):
        columns[f"Base:{name}"] = values
    for name, values in zip(("TX", "TY", "TZ"), 1000 * motion.p_WB.T):
        columns[f"Base:{name}"] = values
    for joint, values in zip(motion.joint_names, np.degrees(motion.q).T):
        columns[f"{joint}_angle"] = values
    write_csv(folder / "log.csv", columns)
    return folder / "log.csv"


POSE = ("attitude", "position", "encoders")
ALL = (*POSE, "gyro", "velocity", "joint_rates")
LOGS = {
    "ros": (ros_csv, (), ALL),
    "vicon": (vicon_csv, (), POSE),
    "flat_vicon": (flat_vicon_csv, ("--frame-rate", 16), POSE),
}
"""By name, what writes the log, options of `cpid log map`, and the sensors in the log."""


@pytest.mark.parametrize(
    "kind",
    [
        pytest.param(kind, marks=() if kind in ("ros", "vicon") else pytest.mark.slow)
        for kind in LOGS
    ],
)
def test_a_log_of_another_tool_is_identified_like_the_house_log(tmp_path, run_cpid, kind):
    write, options, sensors = LOGS[kind]
    log, columns = write(tmp_path, truth()), tmp_path / "map.yaml"
    house = tmp_path / "house.csv"
    samples = {n: Samples(truth().time, SENSORS[n].quantity.ideal(truth())) for n in sensors}
    write_telemetry(house, Measurements(truth().joint_names, samples))
    code, stdout, stderr = run_cpid("log", "map", log, *CRAFT, "--out", columns, *options)
    assert code == 0, stderr
    assert columns.read_text() in stdout + "\n"
    load_column_map(columns)
    found, codes = [], []
    for file, how in ((house, ()), (log, ("--columns", columns))):
        result = tmp_path / f"{file.stem}.json"
        codes.append(run_cpid("identify", file, *CRAFT, *how, "--json", result)[0])
        found.append(json.loads(result.read_text())["parameters"])
    assert codes[0] == codes[1]
    for part in (slice(0, 1), slice(1, 4), slice(4, 10)):
        size = np.abs(found[0][part]).max()
        # Stamps since 1970 are exact to 1e-7 s, and the marker's place is rounded to 0.1 mm.
        np.testing.assert_allclose(found[1][part], found[0][part], rtol=0, atol=2e-4 * size)
        np.testing.assert_allclose(found[1][part], TRUTH[part], rtol=0, atol=1e-3 * size)
    code, stdout, _ = run_cpid("log", "check", log, *CRAFT, "--columns", columns)
    assert code == 0
    assert "no problems found" in stdout


def test_a_converted_log_is_the_house_log(tmp_path, run_cpid):
    log = ros_csv(tmp_path, truth())
    assert run_cpid("log", "map", log, *CRAFT, "--out", tmp_path / "map.yaml")[0] == 0
    out = tmp_path / "house.csv"
    assert run_cpid("log", "convert", log, "--out", out, "--columns", tmp_path / "map.yaml")[0] == 0
    header, *rows = out.read_text().splitlines()
    values = np.array([row.split(",") for row in rows], dtype=float)
    columns = dict(zip(header.split(","), values.T))
    motion = truth()
    np.testing.assert_allclose(columns["time"], motion.time, atol=2e-7)
    np.testing.assert_allclose(columns["qw"], motion.quaternion_WB[:, 0], atol=1e-15)
    np.testing.assert_allclose(columns["bwx"], in_body(motion, motion.w_WB)[:, 0], atol=1e-15)
    for k, joint in enumerate(motion.joint_names):
        np.testing.assert_allclose(columns[f"q:{joint}"], motion.q[:, k], atol=1e-14)
    assert "q:gripper" not in columns


def test_a_marker_off_the_origin_is_found(tmp_path, run_cpid):
    log = vicon_csv(tmp_path, truth())
    code, stdout, _ = run_cpid("log", "map", log, *CRAFT)
    assert code == 0
    point = yaml.safe_load(stdout)["position"]["point_B"]
    np.testing.assert_allclose(point, MARKER, atol=1e-3)


@pytest.mark.parametrize(
    ("drop", "exit_code", "phrase"),
    [
        ("Frame", 2, "no column can be the time"),
        ("arm_joint2", 2, "no column can be the position of joint 'arm_joint2'"),
        ("RX", 4, "complete this map: no columns are an attitude (attitude.columns)"),
    ],
)
def test_what_is_missing_is_named(tmp_path, run_cpid, drop, exit_code, phrase):
    log = flat_vicon_csv(tmp_path, truth())
    log.write_text(log.read_text().replace(drop, "thing"))
    code, _, stderr = run_cpid("log", "map", log, *CRAFT, "--frame-rate", 16)
    assert code == exit_code
    assert phrase in stderr


def test_a_check_says_what_was_not_checked(tmp_path, run_cpid):
    write_telemetry(tmp_path / "log.csv", truth())
    stdout = run_cpid("log", "check", tmp_path / "log.csv")[1]
    assert "not checked: units of position, its point, signs of joints (needs --sp" in stdout
    figure = tmp_path / "both.png"
    stdout = run_cpid("log", "check", SAMPLE, *CRAFT, "--figure", figure)[1]
    assert "not checked" not in stdout
    assert "changes of attitude and angular velocity differ by" in stdout
    assert figure.stat().st_size > 10_000


def test_positions_in_millimetres_fail_a_check_of_every_command(tmp_path, run_cpid):
    sample = SAMPLE.read_text().splitlines()
    names = next(line for line in sample if not line.startswith("#")).split(",")
    rows = [line.split(",") for line in sample if not line.startswith("#")][1:]
    for row in rows:
        for axis in "xyz":
            row[names.index(axis)] = repr(1000 * float(row[names.index(axis)]))
    log = tmp_path / "log.csv"
    log.write_text("\n".join([",".join(names), *map(",".join, rows)]) + "\n")
    for expected, command in (
        (2, ("log", "check", log)),
        (4, ("identify", log)),
    ):
        code, stdout, stderr = run_cpid(*command, *CRAFT)
        assert code == expected
        assert "the position is in millimetres" in stdout + stderr
    (tmp_path / "map.yaml").write_text("position: {unit: mm}\n")
    columns = ("--columns", tmp_path / "map.yaml")
    assert run_cpid("log", "check", log, *CRAFT, *columns)[0] == 0


@pytest.mark.slow
def test_reports_and_replays_read_the_log_with_its_map(
    tmp_path, run_cpid, short_reports, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    log = models_directory() / "telemetry/free_flyer_ros.csv"
    assert run_cpid("log", "map", log, *CRAFT, "--out", "map.yaml")[0] == 0
    how = ("--columns", "map.yaml", "--sensors", "testbed")
    code, _, stderr = run_cpid("identify", log, *CRAFT, *how, "--json", "found.json")
    assert code == 0
    assert "ignored columns: field.header.frame_id, gripper/position" in stderr
    assert run_cpid("report", "--result", "found.json", "--out", "page.html")[0] == 0
    page = Path("page.html").read_text()
    assert "no sections that need the log" not in page
    assert "Map of columns" in page
    assert run_cpid("view", log, *CRAFT, *how, "--out", "replay.html")[0] == 0
    map_text = Path("map.yaml").read_text()
    Path("map.yaml").write_text(map_text.replace("unit: mm", "unit: cm"))
    assert run_cpid("report", "--result", "found.json", "--out", "page.html")[0] == 0
    assert "map.yaml has changed since" in Path("page.html").read_text()


class TestCheck:
    def test_a_good_file(self, cpid):
        code, stdout, stderr = cpid("log", "check", SAMPLE, *CRAFT)
        assert (code, stderr) == (0, "")
        assert "1001 samples, 0 to 10 s, every 0.01 s" in stdout
        assert "joints             4: arm_joint1, arm_joint2" in stdout
        assert "no problems found" in stdout

    def test_every_problem_is_listed_with_its_line(self, cpid):
        lines = SAMPLE.read_text().splitlines()[:20]
        lines[13] = lines[13].replace(",", ",,", 1)
        lines[15] = "-0.5" + lines[15][lines[15].index(",") :]
        Path("bad.csv").write_text("\n".join(lines))
        code, stdout, stderr = cpid("log", "check", "bad.csv")
        assert code == 2
        assert "error: line 14: 16 cells, but 15 columns" in stdout
        assert "error: line 16, column 'time': time -0.5 s comes after" in stdout
        assert stderr == "cpid: error: bad.csv: 2 problems found, listed above\n"

    def test_contradictions_are_problems(self, cpid):
        log = read_telemetry(SAMPLE)
        log.gyro.value[:] = np.degrees(log.gyro.value)
        write_telemetry("degrees.csv", log)
        code, stdout, _ = cpid("log", "check", "degrees.csv")
        assert code == 2
        assert "angular_velocity.unit: deg/s" in stdout

    def test_joints_are_compared_with_the_model(self, cpid):
        code, stdout, _ = cpid("log", "check", SAMPLE, "--scenario", "paper")
        assert code == 2
        assert "; the spacecraft's joints are capture_arm_joint1" in stdout

    def test_a_model_needs_its_frames(self, refusal):
        message = refusal("log", "check", SAMPLE, "--base", "bus")
        assert "give --scenario, or all of --spacecraft" in message
