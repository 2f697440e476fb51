"""Attitudes under the names, in the orders and in the units of other tools are read right."""

from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from sensing_cases import MOMENTUM, Sines, true_telemetry

from cpid_drake import InertialParameters, load_scenario, shipped_scenario
from cpid_drake.logs.guess.guess import guess_map
from cpid_drake.logs.table import LogTable

BAG = InertialParameters(8.5, [0.26, 0.02, -0.01], [[0.16, 0, 0], [0, 0.19, 0], [0, 0, 0.25]])
PLATE = InertialParameters(3.2, [0.115, 0.015, 0], [[0.0175, 0, 0], [0, 0.0195, 0], [0, 0, 0.0228]])
TIMES = np.arange(0.0, 10.0, 0.05)
UNITS = {"rad": 1.0, "deg": 180 / np.pi}


def made(scenario, target, momentum):
    """Return a shipped spacecraft and its motion with a target."""
    craft = load_scenario(shipped_scenario(scenario)).spacecraft.make()
    motion = Sines.drawn(len(craft.joint_names), 3, 10.0)
    return craft, true_telemetry(craft.tree, craft.joint_names, motion, target, TIMES, momentum)


@pytest.fixture(scope="module")
def flyer():
    return made("free_flyer_payload", BAG, MOMENTUM / 100)


@pytest.fixture(scope="module")
def table():
    return made("air_bearing", PLATE, np.array([0, 0, 0.05, 0.02, -0.03, 0]))


def attitude_of(states):
    return Rotation.from_quat(states.quaternion_WB, scalar_first=True)


def rate_of(states):
    return attitude_of(states).inv().apply(states.w_WB)


def named(form, keys, values):
    return {form.replace("*", key): column for key, column in zip(keys, np.transpose(values))}


def guessed(case, columns):
    """Return the guess for columns beside the joints'."""
    craft, states = case
    joints = named("theta_*", "1234", states.q) | named("theta_dot_*", "1234", states.qdot)
    return guess_map(LogTable({"time": TIMES, **columns, **joints}), craft, "base")


def error(guess, R_WB):
    """Return the largest angle by which a guess reads an attitude wrong [rad]."""
    found = guess.log.attitude
    read = Rotation.from_quat(found.value, scalar_first=True)
    return (R_WB[np.searchsorted(TIMES, found.time - 1e-9)] * read.inv()).magnitude().max()


ROLL = dict(zip("xyz", ("roll", "pitch", "yaw")))
TAIT_BRYAN = ["".join(axes) for axes in permutations("xyz")]
EVERY = [*TAIT_BRYAN, *map(str.upper, TAIT_BRYAN), "ZXZ", "YZY", "XYX"]


def angles_of(R, sequence, form, unit):
    """Return the columns of the angles of a sequence: by axis, or by number."""
    values = R.as_euler(sequence) * UNITS[unit]
    if form == "roll":
        keys = [ROLL[axis] for axis in sequence.lower()]
        columns = dict(zip(keys, values.T))
        return {f"base_{name}": columns[name] for name in ROLL.values()}
    if form == "numbers":
        return named("Sat.EulerAngle*", "123", values)
    columns = named("euler.*", sequence.lower(), values)
    return dict(sorted(columns.items()))


@pytest.mark.parametrize("has_gyro", [True, False])
@pytest.mark.parametrize("form", ["roll", "axes", "numbers"])
def test_the_order_of_angles_follows_from_the_motion(flyer, form, has_gyro):
    rng = np.random.default_rng([len(form), has_gyro])
    _, states = flyer
    for _ in range(1 if form == "numbers" else 3):
        sequence = rng.choice(EVERY if form == "numbers" else TAIT_BRYAN)
        unit, turns = rng.choice([*UNITS]), rng.random() < 0.5
        noise = Rotation.from_rotvec(2e-4 * rng.standard_normal((len(TIMES), 3)))
        R_WB = attitude_of(states) * noise
        columns = angles_of(R_WB.inv() if turns else R_WB, sequence, form, unit)
        if has_gyro:
            rate = rate_of(states) + 1e-3 * rng.standard_normal((len(TIMES), 3))
            columns |= named("gyro.*", "xyz", rate)
        guess = guessed(flyer, columns)
        assert guess.missing == [], (sequence, unit, turns)
        assert guess.column_map.attitude.unit == unit
        assert error(guess, R_WB) < 1e-9


@pytest.mark.parametrize("noise", [0.01, 0.03, 0.1])
def test_an_order_that_noise_hides_is_asked_and_never_read_wrong(flyer, noise):
    """The likeliest is assumed until then."""
    rng = np.random.default_rng(8)
    R_WB = attitude_of(flyer[1]) * Rotation.from_rotvec(noise * rng.standard_normal((200, 3)))
    for sequence in ("zyx", "yxz"):
        guess = guessed(flyer, angles_of(R_WB, sequence, "roll", "rad"))
        is_asked = any("attitude.order" in text for text in guess.missing)
        assert error(guess, R_WB) < 1e-9 or (is_asked and noise > 0.01)
    assert is_asked or noise < 0.1


def test_an_order_that_the_noise_of_the_gyro_hides_is_asked(flyer):
    """The base turns by a few degrees: rates of other orders differ by less than the noise."""
    turns = 0.1 * np.sin(np.outer(TIMES, [1.0, 1.3, 0.7]) + [0.0, 1.0, 2.0])
    rate = np.gradient(turns, TIMES, axis=0)
    rate += 0.3 * np.std(rate) * np.random.default_rng(4).standard_normal(rate.shape)
    columns = angles_of(Rotation.from_rotvec(turns), "yxz", "roll", "rad")
    columns |= named("gyro.*", "xyz", rate)
    assert any("attitude.order" in text for text in guessed(flyer, columns).missing)


def test_orders_that_read_the_same_are_no_question(flyer):
    """The base turns about one axis, and the other angles are noise."""
    _, states = flyer
    yaw = attitude_of(states).as_euler("ZYX")[:, 0]
    noise = 1e-4 * np.random.default_rng(2).standard_normal((len(TIMES), 2))
    angles = np.column_stack([noise, np.unwrap(yaw)])
    rate = np.column_stack([np.zeros((len(TIMES), 2)), np.gradient(np.unwrap(yaw), TIMES)])
    columns = named("*", ROLL.values(), angles) | named("gyro.*", "xyz", rate)
    assert not any("attitude.order" in text for text in guessed(flyer, columns).missing)


def test_axes_of_the_gyro_and_the_order_are_found_together(flyer):
    R_WB, rate = attitude_of(flyer[1]), rate_of(flyer[1])
    columns = angles_of(R_WB, "zyx", "roll", "deg") | named("gyro.*", "xyz", rate[:, [2, 0, 1]])
    guess = guessed(flyer, columns)
    assert guess.missing == []
    assert error(guess, R_WB) < 1e-9
    np.testing.assert_allclose(guess.log.gyro.value, rate, atol=1e-9)


def shadowed(sigma):
    """Return modified Rodrigues parameters, every other second those of the shadow set."""
    square = np.sum(sigma**2, axis=1, keepdims=True)
    is_shadow = (square > 1e-3) & (TIMES[:, None] % 2 > 1)
    return np.where(is_shadow, -sigma / np.maximum(square, 1e-3), sigma)


BY_TOOL = {
    "Basilisk": lambda R, w, p: (
        named("sc.sigma_BN_*", "123", R.as_mrp())
        | named("sc.omega_BN_B_*", "123", w)
        | named("sc.r_BN_N_*", "123", p)
    ),
    "Basilisk without rates": lambda R, w, p: named("sigma_*", "012", R.as_mrp()),
    "a filter that switches": lambda R, w, p: named("mrp_*", "xyz", shadowed(R.as_mrp())),
    "GMAT": lambda R, w, p: (
        named("Sat.Q*", "1234", R.as_quat()) | named("Sat.AngularVelocity*", "XYZ", np.degrees(w))
    ),
    "GMAT's angles": lambda R, w, p: (
        named("Sat.EulerAngle*", "123", R.as_euler("ZYX", degrees=True))
        | named("Sat.AngularVelocity*", "XYZ", np.degrees(w))
    ),
    "42": lambda R, w, p: named("qn[*]", "0123", R.as_quat()) | named("wn[*]", "012", w),
    "Qualisys": lambda R, w, p: (
        named("*", "XYZ", 1e3 * p)
        | named("*", ["Roll", "Pitch", "Yaw"], R.as_euler("XYZ", degrees=True))
        | {"Residual": np.full(len(p), 0.3)}
        | named("Rot[*]", "012345678", R.as_matrix().reshape(-1, 9))
    ),
    "Vicon": lambda R, w, p: (
        named("base:R* [mrad]", "XYZ", 1e3 * R.as_rotvec()) | named("base:T* [mm]", "XYZ", 1e3 * p)
    ),
    "Motive": lambda R, w, p: (
        named("base:Rotation *", "XYZW", R.as_quat()) | named("base:Position * [m]", "XYZ", p)
    ),
    "an aircraft's letters": lambda R, w, p: named(
        "att_*_deg", ["phi", "theta", "psi"], R.as_euler("xyz", degrees=True)
    ),
    "ROS": lambda R, w, p: named("rpy[*]", "012", R.as_euler("xyz")),
}


@pytest.mark.parametrize("tool", BY_TOOL)
def test_logs_of_simulators_and_trackers_are_read_by_their_names(flyer, tool):
    _, states = flyer
    R_WB, rate = attitude_of(states), rate_of(states)
    guess = guessed(flyer, BY_TOOL[tool](R_WB, rate, states.p_WB))
    assert guess.missing == []
    assert error(guess, R_WB) < 1e-9
    for name, value in (("gyro", rate), ("position", states.p_WB)):
        if len(guess.log[name]):
            np.testing.assert_allclose(guess.log[name].value, value, atol=1e-9)
    has_rate = any(word in tool for word in ("GMAT", "42", "Basilisk")) and "without" not in tool
    assert bool(len(guess.log.gyro)) == has_rate


FLAT = {
    "mm and deg": lambda yaw, xy, w, v: (
        named("*_mm", "xy", 1e3 * xy) | {"theta_deg": np.degrees(yaw)}
    ),
    "unstated units": lambda yaw, xy, w, v: (
        named("*", "xy", 1e3 * xy) | {"heading": np.degrees(yaw)}
    ),
    "the inverse": lambda yaw, xy, w, v: named("base_*", "xy", xy) | {"base_yaw": -yaw},
    "a rate": lambda yaw, xy, w, v: (
        named("mocap *", "XY", xy) | {"psi": -yaw, "gyro_z": np.degrees(w)}
    ),
    "units and a command": lambda yaw, xy, w, v: (
        named("*", "xy", xy)
        | {"yaw [deg]": np.degrees(yaw), "yaw_cmd": yaw + 1, "yaw_dot": w}
        | named("v*", "xy", v)
        | named("thrust_f*", "xyz", np.zeros((len(v), 3)))
        | named("thrust_t*", "xyz", np.zeros((len(v), 3)))
    ),
}


@pytest.mark.parametrize("is_declared", [True, False])
@pytest.mark.parametrize("form", FLAT)
def test_a_log_of_a_table_has_a_yaw_and_two_coordinates(table, form, is_declared):
    craft, states = table
    yaw, rate = np.unwrap(attitude_of(states).as_rotvec()[:, 2]), states.w_WB[:, 2]
    if not is_declared:
        given = load_scenario(shipped_scenario("air_bearing")).spacecraft
        craft = replace(given, on_table=False).make()
    columns = FLAT[form](yaw, states.p_WB[:, :2], rate, states.v_WB[:, :2])
    guess = guessed((craft, states), columns)
    assert guess.missing == []
    assert guess.column_map.attitude.order == "yaw"
    assert error(guess, attitude_of(states)) < 1e-9
    np.testing.assert_allclose(guess.log.position.value, states.p_WB, atol=1e-9)
    if "thrust_fx" in columns:
        thrust = guess.column_map.thrust
        assert (thrust.force, thrust.torque) == (["thrust_fx", "thrust_fy"], ["thrust_tz"])
    for name, value in (("gyro", rate_of(states)), ("velocity", states.v_WB)):
        if len(guess.log[name]):
            np.testing.assert_allclose(guess.log[name].value, value, atol=1e-9)


def test_an_angle_beside_a_height_or_a_pitch_is_no_attitude_of_a_table(flyer):
    _, states = flyer
    for others in (named("*", "xyz", states.p_WB), {"pitch": TIMES, "x": TIMES, "y": TIMES}):
        guess = guessed(flyer, {"yaw": np.sin(TIMES), **others})
        assert "no columns are an attitude" in guess.missing[0]
