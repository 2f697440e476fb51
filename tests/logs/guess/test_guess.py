"""Noisy logs in conventions drawn at random: the guessed map gives back every sample."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from sensing_cases import (
    MOMENTUM,
    Sines,
    coarse_suite,
    measured,
    small_craft,
    true_telemetry,
)

from cpid_drake import (
    InertialParameters,
    InputError,
    load_scenario,
    shipped_scenario,
)
from cpid_drake.files.resources import models_directory
from cpid_drake.logs.column_map import load_column_map
from cpid_drake.logs.formats import read_table, table_of
from cpid_drake.logs.guess.guess import guess_map
from cpid_drake.logs.simulated_noise import add_noise
from cpid_drake.logs.table import LogTable
from cpid_drake.sensors.sensors import JointSensor, VectorSensor

TARGET = InertialParameters(60.0, [0.5, 0.05, -0.1], [[6, 0, 0], [0, 9, 0], [0, 0, 8]])
BAG = InertialParameters(8.5, [0.26, 0.02, -0.01], [[0.16, 0, 0], [0, 0.19, 0], [0, 0, 0.25]])
SUITE = coarse_suite(velocity=VectorSensor(5.0, 1e-4), joint_rates=JointSensor(20.0, 1e-4))


@pytest.fixture(scope="module")
def craft(tmp_path_factory):
    return small_craft(tmp_path_factory.mktemp("craft"), wheels=True)


@pytest.fixture(scope="module")
def log(craft):
    motion = Sines.drawn(len(craft.joint_names), 3, 10.0)
    return add_noise(SUITE, measured(craft, motion, TARGET, SUITE, MOMENTUM), 4)


def in_other_conventions(log, seed):
    """Return the columns of a log with units and conventions drawn at random."""
    rng = np.random.default_rng(seed)
    names, values = table_of(log)
    given = dict(zip(names, values.T))
    scale, start = [(1.0, 0.0), (1e3, 0.0), (1e6, 1.7e15), (1e9, 1.7e18)][rng.integers(4)]
    columns = {"stamp": given["time"] * scale + start}
    quaternion = np.stack([given[name] for name in ("qw", "qx", "qy", "qz")], axis=1)
    quaternion = quaternion * ([1, -1, -1, -1] if rng.random() < 0.5 else 1)
    order = [1, 2, 3, 0] if rng.random() < 0.5 else [0, 1, 2, 3]
    columns |= {f"quat[{k}]": column for k, column in enumerate(quaternion[:, order].T)}
    length, speed = rng.choice([1.0, 1e3, 100.0]), rng.choice([1.0, 1e3])
    turn, angle = rng.choice([1.0, 180 / np.pi], 2)
    has_rates = rng.random() < 0.7
    for axis in "xyz":
        columns[f"pos.{axis}"] = given[axis] * length
        if has_rates:
            columns[f"gyro.{axis}"] = given[f"bw{axis}"] * turn
            columns[f"vel.{axis}"] = given[f"v{axis}"] * speed
    for joint in log.joint_names:
        size = 1e3 if joint == "slide" else angle
        columns[f"arm/{joint}.position"] = given[f"q:{joint}"] * size
        columns[f"arm/{joint}.velocity"] = given[f"qd:{joint}"] * size
    columns["arm/finger.position"] = np.full(len(values), 3.0)
    return columns


@pytest.mark.parametrize("seed", range(4))
def test_the_guessed_map_gives_back_every_sample(craft, log, tmp_path, seed):
    columns = in_other_conventions(log, seed)
    guess = guess_map(LogTable(columns), craft, "base")
    for name in ("attitude", "position", "encoders", "joint_rates", "gyro", "velocity"):
        read, true = guess.log[name], log[name]
        if name in ("gyro", "velocity") and not any(
            column.startswith("gyro") for column in columns
        ):
            assert not len(read)
            continue
        np.testing.assert_allclose(read.time, true.time, rtol=0, atol=5e-7)
        np.testing.assert_allclose(read.value, true.value, rtol=1e-12, atol=1e-12)
    assert guess.column_map.joint_positions.units == {"slide": "mm"}
    path = tmp_path / "map.yaml"
    path.write_text(guess.text("A map"))
    assert replace(guess, column_map=load_column_map(path)).text("A map") == path.read_text()


def test_joints_are_found_by_number(craft, log):
    columns = in_other_conventions(log, 0)
    joints = log.joint_names
    numbered = {name: column for name, column in columns.items() if not name.startswith("arm/")}
    for k, joint in enumerate(joints):
        numbered[f"q({k + 1})"] = columns[f"arm/{joint}.position"]
    found = guess_map(LogTable(numbered), craft, "base").column_map.joint_positions.columns
    assert found == {joint: f"q({k + 1})" for k, joint in enumerate(joints)}


@pytest.mark.parametrize(("missing", "form"), [(1, "motor/*"), (0, "q:*"), (0, "joint_*")])
def test_columns_of_names_alike_in_most_joints_are_theirs(craft, log, missing, form):
    """Whatever comes first in the file; the package's own names, and joints, before others."""
    columns = in_other_conventions(log, 0)
    renamed = {f"arm/{joint}.position": form.replace("*", joint) for joint in log.joint_names}
    others = [f"a_{joint}" for joint in log.joint_names[missing:]]
    given = {"stamp": columns["stamp"], **{name: columns["pos.x"] for name in others}}
    given |= {renamed.get(name, name): column for name, column in columns.items()}
    given = {name: column for name, column in given.items() if not name.endswith("velocity")}
    found = guess_map(LogTable(given), craft, "base").column_map.joint_positions.columns
    assert found == {joint: form.replace("*", joint) for joint in log.joint_names}


def test_columns_of_the_base_are_preferred_to_those_of_other_bodies(craft, log):
    columns = in_other_conventions(log, 0)
    for axis in "xyz":
        columns[f"Base:T{axis.upper()}"] = columns.pop(f"pos.{axis}")
        columns[f"Debris:T{axis.upper()}"] = np.arange(len(columns["stamp"])) * 0.1
    found = guess_map(LogTable(dict(sorted(columns.items(), reverse=True))), craft, "base")
    assert sorted(found.column_map.position.columns) == ["Base:TX", "Base:TY", "Base:TZ"]


@pytest.mark.parametrize(
    ("force", "torque"),
    [("thrust_f", "thrust_t"), ("rcs.force.", "rcs.torque."), ("thruster_", "thruster_moment_")],
)
def test_thrust_is_found_by_name(craft, log, force, torque):
    """It is no position; commands of thrusters are no thrust."""
    columns = in_other_conventions(log, 0)
    for k, axis in enumerate("xyz"):
        columns[force + axis] = np.full(len(columns["stamp"]), k + 1.0)
        columns[torque + axis] = np.full(len(columns["stamp"]), k + 4.0)
        columns[f"thruster_cmd_{axis}"] = np.full(len(columns["stamp"]), 9.0)
    guess = guess_map(LogTable(columns), craft, "base")
    assert guess.column_map.thrust.force == [force + axis for axis in "xyz"]
    assert guess.column_map.position.columns == [f"pos.{axis}" for axis in "xyz"]
    np.testing.assert_array_equal(guess.log.thrust.value[0], [4, 5, 6, 1, 2, 3])
    assert "force at its origin" in guess.reasons["thrust"][0]


def test_without_a_time_the_columns_are_listed(craft, log):
    columns = in_other_conventions(log, 0)
    columns["stamp"] = columns["stamp"][::-1]
    with pytest.raises(InputError, match=r"no column can be the time: .* columns of numbers are"):
        guess_map(LogTable(columns), craft, "base")


def test_the_first_column_is_the_time_if_it_increases_and_numbers_are_no_names(craft, log):
    columns = in_other_conventions(log, 0)
    given = guess_map(LogTable({"thing": columns.pop("stamp"), **columns}), craft, "base")
    assert given.column_map.time.column == "thing"
    counted = {"id": np.arange(len(columns["quat[0]"])) + 1.0, **columns}
    named = LogTable({**counted, "recv_time": counted["id"] / 10})
    received = guess_map(named, craft, "base")
    assert received.column_map.time.column == "recv_time"
    assert "time.unit" in guess_map(LogTable(counted), craft, "base").missing[0]  # a count is open
    numbered = dict(zip(map(str, range(1, 99)), columns.values()))
    with pytest.raises(InputError, match=r"does not name its columns: write a map"):
        guess_map(LogTable(numbered), craft, "base")


def test_the_time_is_in_all_rows_and_a_stamp_of_one_topic_is_not(craft, log):
    columns = in_other_conventions(log, 0)
    some = np.arange(len(columns["stamp"])) % 3 > 0
    stamps = np.where(some, np.nan, columns["stamp"] + 5)
    guess = guess_map(LogTable({"imu/stamp": stamps, **columns}), craft, "base")
    assert guess.column_map.time.column == "stamp"


def test_three_numbers_r_beside_a_quaternion_are_the_position(craft, log):
    columns = in_other_conventions(log, 1)
    moved = {f"r_{k}": columns.pop(f"pos.{axis}") for k, axis in enumerate("xyz", 1)}
    guess = guess_map(LogTable({**columns, **moved}), craft, "base")
    assert guess.column_map.position.columns == ["r_1", "r_2", "r_3"]
    both = guess_map(LogTable({**in_other_conventions(log, 1), **moved}), craft, "base")
    assert both.column_map.position.columns == ["pos.x", "pos.y", "pos.z"]


@pytest.mark.parametrize(
    ("unit", "turn"), [("rad", 8.0), ("mrad", 0.0), ("deg", 0.0), (None, 0.0), (None, 8.0)]
)
def test_the_unit_of_angles_is_that_of_their_names_or_follows_from_the_motion(unit, turn):
    """Yaw in rad may be beyond a turn."""
    craft = load_scenario(shipped_scenario("free_flyer_payload")).spacecraft.make()
    motion, times = Sines.drawn(len(craft.joint_names), 3, 10.0), np.arange(0.0, 10.0, 0.05)
    states = true_telemetry(craft.tree, craft.joint_names, motion, BAG, times, MOMENTUM / 100)
    attitude = Rotation.from_quat(states.quaternion_WB, scalar_first=True)
    angles = np.unwrap(attitude.as_euler("ZYX"), axis=0)[:, ::-1] + [0.0, 0.0, turn]
    w_B = attitude.inv().apply(states.w_WB)
    size = {"mrad": 1e3, "deg": 180 / np.pi}.get(unit, 1.0)
    names = [f"base_{n}" + (f"_{unit}" if unit else "") for n in ("roll", "pitch", "yaw")]
    columns = {"t": times, **dict(zip(names, size * angles.T))}
    columns |= {f"gyro.{axis}": values for axis, values in zip("xyz", w_B.T)}
    columns |= {f"{n}.position": values for n, values in zip(craft.joint_names, states.q.T)}
    columns |= {f"{n}.velocity": values for n, values in zip(craft.joint_names, states.qdot.T)}
    guess = guess_map(LogTable(columns), craft, "base")
    assert guess.column_map.attitude.unit == (unit or "rad")
    assert not any("attitude" in text for text in guess.missing), guess.missing


def columns_at_200_hz(craft):
    """Return columns at common times, the time in ms, the angles in rad, by plain names."""
    motion, times = Sines.drawn(len(craft.joint_names), 3, 10.0), np.arange(0.0, 1.5, 0.005)
    states = true_telemetry(craft.tree, craft.joint_names, motion, TARGET, times, MOMENTUM)
    columns = {"t": 1e3 * times}
    columns |= {f"Q{k + 1}": values for k, values in enumerate(states.quaternion_WB.T)}
    columns |= {f"pos.{axis}": values for axis, values in zip("xyz", states.p_WB.T)}
    columns |= {f"{n}.position": values for n, values in zip(craft.joint_names, states.q.T)}
    return columns | {f"{n}.rate": values for n, values in zip(craft.joint_names, states.qdot.T)}


def test_a_fast_clock_in_ms_is_found_by_the_rates_or_left_open(craft):
    columns = columns_at_200_hz(craft)
    guess = guess_map(LogTable(columns), craft, "base")
    assert (guess.column_map.time.unit, guess.missing) == ("ms", [])
    without = {name: values for name, values in columns.items() if not name.endswith("rate")}
    [text] = guess_map(LogTable(without), craft, "base").missing
    assert text == "the time may be in s or ms (time.unit)"
    slow = {name: v / (100 if name.endswith("rate") else 1) for name, v in columns.items()}
    slow["t"] = columns["t"] / 10  # in s, in steps of 0.5 s
    guess = guess_map(LogTable(slow), craft, "base")
    assert (guess.column_map.time.unit, guess.missing) == ("s", [])


def test_four_columns_of_norm_one_are_an_attitude_whatever_their_names(craft):
    columns = columns_at_200_hz(craft)
    columns["t"] = columns["t"] / 1e3
    for k, name in enumerate(("shoulder", "slide", "elbow", "roll")):
        size = 1.0 if name == "slide" else 180 / np.pi
        columns[f"A{k + 1}"] = columns.pop(f"{name}.position") * size
    columns = {name: values for name, values in columns.items() if not name.endswith("rate")}
    columns["mode"] = np.zeros(len(columns["t"]))
    columns = {name: values for name, values in columns.items() if "spin" not in name}
    guess = guess_map(LogTable(columns), craft, "base")
    assert sorted(guess.column_map.attitude.columns) == ["Q1", "Q2", "Q3", "Q4"]
    assert list(guess.column_map.joint_positions.columns.values()) == ["A1", "A2", "A3", "A4"]
    assert guess.column_map.joint_positions.unit == "deg"
    assert guess.missing == []
    assert guess.reasons["ignore_columns"] == ["not used: mode"]
    bare = {name: values for name, values in columns.items() if name[0] not in "Qp"}
    bare |= {name: np.radians(v) for name, v in bare.items() if name in ("A1", "A3", "A4")}
    attitude, unit = guess_map(LogTable(bare), craft, "base").missing
    assert "attitude" in attitude
    assert "joint_positions.unit" in unit


def test_exchanged_axes_of_the_gyro_are_found_and_a_foreign_gyro_leaves_the_attitude_open(
    craft, log
):
    """If no convention of the attitude agrees with the gyro, momentum is not asked for a guess."""
    names, values = table_of(log)
    columns = dict(zip(names, values.T))
    assert guess_map(LogTable(columns), craft, "base").missing == []
    axes = {"w_x_imu": "bwy", "w_y_imu": "bwz", "w_z_imu": "bwx"}  # an axis inside of a name
    turned = {name: values for name, values in columns.items() if name not in axes.values()}
    turned |= {name: columns[axis] for name, axis in axes.items()}
    guess = guess_map(LogTable(turned), craft, "base")
    assert guess.missing == []
    np.testing.assert_array_equal(
        guess.column_map.angular_velocity.R_BS, [[0, 0, 1], [1, 0, 0], [0, 1, 0]]
    )
    other = columns | {name: columns[name][::-1] for name in ("bwx", "bwy", "bwz")}
    missing = guess_map(LogTable(other), craft, "base").missing
    assert any("does not rotate at the angular velocity in any convention" in t for t in missing)


ANGLES = ("yaw", "pitch", "roll")


def angle_columns(form):
    """Return the sample log with angles of the base of these names for its quaternion."""
    table = read_table(models_directory() / "telemetry/free_flyer.csv").columns
    q = np.stack([table.pop(name) for name in ("qw", "qx", "qy", "qz")], axis=1)
    ypr = Rotation.from_quat(q, scalar_first=True).as_euler("ZYX").T
    return table | {form.replace("*", name): v for name, v in zip(ANGLES, ypr)}


@pytest.fixture(scope="module")
def flyer():
    return load_scenario(shipped_scenario("free_flyer_payload")).spacecraft.make()


@pytest.mark.parametrize("form", ["*", "body_*", "pose.* [rad]"])
def test_roll_pitch_and_yaw_are_the_attitude(flyer, form):
    guess, sample = guess_map(LogTable(angle_columns(form)), flyer, "body"), angle_columns("*")
    assert guess.missing == []
    at = guess.column_map.attitude
    assert at.columns == [form.replace("*", name) for name in reversed(ANGLES)]
    ypr = np.stack([sample[name] for name in ANGLES], axis=1)
    read = Rotation.from_quat(guess.log.attitude.value, scalar_first=True)
    assert (read * Rotation.from_euler("ZYX", ypr).inv()).magnitude().max() < 1e-6


def test_two_triples_of_angles_leave_the_attitude_open_unless_one_is_the_base_s(flyer):
    columns = angle_columns("s_*")
    columns |= {f"p_{name}": columns[f"s_{name}"][::-1] for name in ANGLES}
    guess = guess_map(LogTable(columns), flyer, "body")
    assert "the attitude may be s_* or p_* (attitude.columns)" in guess.missing[0]
    assert "open: the attitude may be" in " ".join(guess.text().replace("#", "").split())
    assert guess.column_map.attitude.columns == []
    of_base = {name.replace("s_", "body "): values for name, values in columns.items()}
    guess = guess_map(LogTable(of_base), flyer, "body")
    assert guess.missing == []
    assert guess.column_map.attitude.columns == ["body roll", "body pitch", "body yaw"]
