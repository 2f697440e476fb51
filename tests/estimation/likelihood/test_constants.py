"""Constant errors in the likelihood: predictions and derivatives against independent routes."""

from copy import deepcopy
from dataclasses import replace

import numpy as np
import pytest
from block_cases import added_sensors, joints_of, make_case, residuals_of, rich_suite
from scipy.spatial.transform import Rotation
from sensing_cases import MOMENTUM, true_telemetry

from cpid_drake.dynamics.propagation import Wrench, propagate
from cpid_drake.estimation.block import Block
from cpid_drake.estimation.likelihood.constants import Constants
from cpid_drake.estimation.likelihood.error_effects import EFFECTS
from cpid_drake.estimation.likelihood.model import BlockModel, jump_between
from cpid_drake.estimation.roll import jumped
from cpid_drake.logs.log import Samples
from cpid_drake.sensors.disturbances import Disturbances
from cpid_drake.sensors.error_kinds import KINDS
from cpid_drake.sensors.sensors import SENSORS

START, END = 1.0, 2.5
STEP = 0.0125
LATE = 0.013
SIGMAS = {
    "attitude": {"mounting_arcsec": 300.0, "delay_ms": 10.0},
    "tracker_2": {"mounting_arcsec": 100.0},
    "gyro": {"scale_ppm": 1000.0, "misalignment_arcsec": 200.0, "delay_ms": 10.0},
    "gyro_2": {"integrates": True, "delay_ms": 5.0},
    "position": {"lever_arm_mm": 20.0, "delay_ms": 10.0},
    "velocity": {"lever_arm_mm": 20.0, "delay_ms": 10.0},
    "encoders": {
        "zero_mrad": 1.0,
        "joint_scale_ppm": 1000.0,
        "eccentricity_mrad": 1.0,
        "delay_ms": 10.0,
    },
}


CLOCKS = ("attitude", "gyro", "position", "velocity", "encoders")


def suite_with_all():
    suite = deepcopy(rich_suite())
    for sensor in CLOCKS:
        suite[sensor].clock_drift_ppm = 1000.0
    for sensor, errors in SIGMAS.items():
        for name, value in errors.items():
            setattr(suite[sensor], name, value)
    suite.disturbances = Disturbances(acceleration=0.01, torque=1.0, wheel=0.5, target_wheel=0.5)
    return suite


@pytest.fixture(scope="module", autouse=True)
def sensors():
    with added_sensors():
        yield


@pytest.fixture(scope="module")
def case(tmp_path_factory, skewed_target):
    folder = tmp_path_factory.mktemp("craft")
    return make_case(folder, skewed_target, suite_with_all(), MOMENTUM)


def with_values(solver_or_model, **values):
    """Return constants, in units of their σ, with values in SI units and all others zero."""
    constants = Constants.of(solver_or_model, 4)
    vector = np.zeros(constants.size)
    for name, value in values.items():
        name = name.replace("__", ".")
        vector[constants.place(name)] = np.asarray(value) / constants.errors[name].sigma
    return vector


def exact_block(case, telemetry_at, suite):
    """Return the samples of a block from a function of time, and its exact joint motion."""
    samples, parts = case.block(START, END).samples, {}
    for name, old in samples.items():
        record = SENSORS[name]
        if len(old) and record.width is not None:
            parts[name] = Samples(old.time, record.ideal(telemetry_at(old.time, name)))
    samples = samples.updated(parts | {"joint_rates": Samples(np.empty(0), np.empty((0, 4)))})
    return samples, joints_of(Block(START, END, samples), exactly_measured(suite))


def exactly_measured(suite):
    """Return sensors with encoders without noise."""
    return replace(suite, encoders=replace(suite.encoders, sigma=0.0, bits=0), joint_rates=None)


def model_at(case, samples, joints, constants):
    """Return the model of a block about some constant errors, and the true state with them."""
    tree, suite = case.craft.tree, case.suite
    model = BlockModel(tree, joints, samples, suite, None, STEP, nominal=constants)
    return model, replace(case.state(START), constants=constants)


def largest_residual(case, samples, joints, constants):
    return np.abs(residuals_of(*model_at(case, samples, joints, constants))).max()


def truth(case, times):
    tree, names = case.craft.tree, case.craft.joint_names
    return true_telemetry(tree, names, case.motion, case.target, times, case.momentum_W)


def test_every_kind_of_errors_acts_in_some_way():
    assert EFFECTS.keys() == KINDS.keys()


def test_a_new_kind_is_two_records(case, monkeypatch):
    """Rotors in the base that turn about one axis are those about any axis with one entry."""
    about_y = replace(KINDS["wheel"], name="rotor", entries=1)
    monkeypatch.setitem(KINDS, "rotor", about_y)
    monkeypatch.setitem(EFFECTS, "rotor", replace(EFFECTS["wheel"], how=np.eye(3)[:, 1:2]))
    samples, joints = exact_block(case, lambda times, _: truth(case, times), case.suite)
    model, state = model_at(case, samples, joints, with_values(case.suite, rotor=0.3, wheel=0.1))
    J, end = model.jacobian(model.motion.trajectory(state))
    own, all_axes = model.columns["rotor"].start, model.columns["wheel"].start
    assert np.abs(J[:, own]).max() > 0.1
    np.testing.assert_allclose(J[:, own], J[:, all_axes + 1], rtol=1e-12)
    np.testing.assert_allclose(end[:, own], end[:, all_axes + 1], rtol=1e-12)


@pytest.mark.parametrize("late", [LATE, -LATE])
def test_late_sensors_show_an_earlier_motion(case, late):
    """The stamps of all sensors of the base are late; or those of the encoders are early."""

    def telemetry(times, name):
        return truth(case, times - (0.0 if name in ("tracker_2", "gyro_2") else late))

    suite = case.suite
    samples, joints = exact_block(case, telemetry, suite)
    samples = without(samples, "tracker_2", "gyro_2")
    delays = {f"{name}__delay": late for name in ("attitude", "gyro", "position", "velocity")}
    assert largest_residual(case, samples, joints, with_values(suite, **delays)) < 0.02
    early = with_values(suite, encoders__delay=-late)
    assert largest_residual(case, samples, joints, early) < 0.02
    assert largest_residual(case, samples, joints, with_values(suite)) > 1.0


@pytest.mark.parametrize("fast", [0.005, -0.005])
def test_a_fast_clock_is_late_by_more_and_more(case, fast):
    """At 1 s the stamps are late by 5 ms, at 2.5 s by 12 ms."""
    samples, joints = exact_block(case, lambda t, name: truth(case, t - fast * t), case.suite)
    samples = without(samples, "tracker_2", "gyro_2")
    drifts = {f"{name}__clock_drift": fast for name in CLOCKS[:-1]}
    assert largest_residual(case, samples, joints, with_values(case.suite, **drifts)) < 0.02
    delays = {f"{name}__delay": fast * (START + END) / 2 for name in CLOCKS[:-1]}
    assert largest_residual(case, samples, joints, with_values(case.suite, **delays)) > 1.0


def test_all_rates_seem_smaller_if_the_clock_of_the_joint_motion_is_fast(case):
    """A motion that is faster in truth than by the encoders' stamps, seen on true clocks."""
    fast = 3e-3
    samples, joints = exact_block(case, lambda t, name: truth(case, t + fast * t), case.suite)
    rates = {
        name: Samples(samples[name].time, samples[name].value * (1 + fast))
        for name in ("gyro", "velocity")
    }
    samples = without(samples.updated(rates), "tracker_2", "gyro_2")
    told = with_values(case.suite, encoders__clock_drift=fast)
    assert largest_residual(case, samples, joints, told) < 0.02
    others = {f"{name}__clock_drift": -fast for name in CLOCKS[:-1]}
    assert largest_residual(case, samples, joints, with_values(case.suite, **others)) > 1.0


def without(samples, *names):
    """Return a log without some sensors."""
    return samples.updated(
        {n: Samples(np.empty(0), np.empty((0, samples[n].value.shape[1]))) for n in names}
    )


@pytest.mark.parametrize("name", CLOCKS)
def test_readings_change_with_a_clock_as_differences_say(case, name):
    samples, joints = exact_block(case, lambda times, name: truth(case, times), case.suite)
    constants = with_values(case.suite, **{f"{n}__clock_drift": 5e-4 for n in CLOCKS[:3]})
    model, there = model_at(case, samples, joints, constants)
    exact, _ = model.jacobian(model.motion.trajectory(there))
    both = []
    for step in (1e-3, -1e-3):
        moved = constants.copy()
        moved[model.motion.constants.place(f"{name}.clock_drift")] += step
        both.append(residuals_of(*model_at(case, samples, joints, moved)))
    column = -(both[0] - both[1]) / 2e-3
    found = exact[:, model.columns[f"{name}.clock_drift"].start]
    assert np.abs(found - column).max() < 1e-3 * np.abs(column).max()


def test_gears_and_discs_beside_their_axes_change_the_positions_of_joints(case):
    """Encoders whose error is s m + a sin m + b cos m where they show m."""
    scale, sine, cosine = 1e-3 * np.array(
        [[0.8, -1.0, 0.6, -0.7], [1.0, 0.5, -0.8, 0.9], [-0.6, 0.9, 1.0, -0.8]]
    )
    samples, _ = exact_block(case, lambda times, name: truth(case, times), case.suite)
    q = shown = samples.encoders.value
    for _ in range(5):
        shown = q + scale * shown + sine * np.sin(shown) + cosine * np.cos(shown)
    samples = samples.updated({"encoders": Samples(samples.encoders.time, shown)})
    joints = joints_of(Block(START, END, samples), exactly_measured(case.suite))
    samples = without(samples, "gyro_2")
    values = {
        "encoders__joint_scale": scale,
        "encoders__eccentricity_sine": sine,
        "encoders__eccentricity_cosine": cosine,
    }
    told = with_values(case.suite, **values)
    assert largest_residual(case, samples, joints, told) < 0.05
    for name in values:
        less = {key: value for key, value in values.items() if key != name}
        assert largest_residual(case, samples, joints, with_values(case.suite, **less)) > 1.0, name


JOINTS = ("zero", "drift", "joint_scale", "eccentricity_sine", "eccentricity_cosine")


@pytest.mark.parametrize("kind", JOINTS)
def test_readings_change_with_the_errors_of_joints_as_differences_say(case, kind):
    samples, joints = exact_block(case, lambda times, name: truth(case, times), case.suite)
    suite = replace(case.suite, encoders=replace(case.suite.encoders, drift_mrad_per_s=0.1))
    told, size = replace(case, suite=suite), 1e-3 * np.array([0.8, -1.0, 0.6, -0.7])
    constants = with_values(suite, **{f"encoders__{each}": size for each in JOINTS[2:]})
    model, there = model_at(told, samples, joints, constants)
    exact, _ = model.jacobian(model.motion.trajectory(there))
    columns = model.columns[f"encoders.{kind}"]
    first = model.motion.constants.place(f"encoders.{kind}").start
    for k in range(4):
        both = []
        for step in (1e-2, -1e-2):
            moved = constants.copy()
            moved[first + k] += step
            both.append(residuals_of(*model_at(told, samples, joints, moved)))
        column = -(both[0] - both[1]) / 2e-2
        error = np.abs(exact[:, columns.start + k] - column).max()
        assert error < 3e-3 * np.abs(column).max()


def test_a_rotor_in_the_target_changes_how_joints_move_the_base(case):
    """Derivatives by the joints' motion behind the block's start, against differences."""
    samples, joints = exact_block(case, lambda times, name: truth(case, times), case.suite)
    constants = with_values(case.suite, target_wheel=[20.0, -30.0, 25.0])
    model, state = model_at(case, samples, joints, constants)
    exact, _ = model.jacobian(model.motion.trajectory(state))
    K, J = joints.coefficients.shape
    for j in range(J):
        both = []
        for step in (1e-4, -1e-4):
            moved = joints.coefficients.copy()
            moved[K // 2, j] += step
            both.append(residuals_of(*model_at(case, samples, joints.about(moved), constants)))
        column = -(both[0] - both[1]) / 2e-4
        found = exact[:, model.columns["joints"].start + j * K + K // 2]
        assert np.abs(found - column).max() < 1e-3 * np.abs(column).max()


def test_mountings_scales_and_lever_arms_are_those_of_the_readings(case):
    """R_WB Exp(ε), (1 + S) ω, p + R l, v + R (ω × l)."""
    suite = case.suite
    eps, arm, scale = np.array([1e-3, -2e-3, 3e-3]), np.array([0.02, -0.03, 0.01]), [1e-3, -2e-3, 0]
    off = 1e-3 * np.array([0.5, -1.0, 0.7, 0.2, -0.4, 0.9])
    S = np.diag(scale)
    S[~np.eye(3, dtype=bool)] = off  # row by row
    samples, joints = exact_block(case, lambda times, name: truth(case, times), suite)

    def changed(name, change):
        old = samples[name]
        return Samples(old.time, change(truth(case, old.time), old.value))

    def turned(motion, value):
        R = Rotation.from_quat(value, scalar_first=True) * Rotation.from_rotvec(eps)
        return R.as_quat(scalar_first=True)

    samples = samples.updated(
        {
            "attitude": changed("attitude", turned),
            "gyro": changed("gyro", lambda motion, w: w + w @ S.T),
            "position": changed("position", lambda motion, p: p + motion.R_WB @ arm),
            "velocity": changed(
                "velocity", lambda motion, v: v + np.cross(motion.w_WB, motion.R_WB @ arm)
            ),
        }
    )
    samples = without(samples, "gyro_2")
    values = {
        "attitude__mounting": eps,
        "gyro__scale": scale,
        "gyro__misalignment": off,
        "position__lever_arm": arm,
        "velocity__lever_arm": arm,
    }
    assert largest_residual(case, samples, joints, with_values(suite, **values)) < 0.02
    for name in values:
        less = {key: value for key, value in values.items() if key != name}
        assert largest_residual(case, samples, joints, with_values(suite, **less)) > 1.0, name


def test_an_integrating_gyro_shows_the_mean_over_its_period(case):
    """The mean of ω in B over the time since the sample before."""
    suite, period = case.suite, 1 / case.suite["gyro_2"].rate
    samples, joints = exact_block(case, lambda times, name: truth(case, times), suite)
    points, weights = np.polynomial.legendre.leggauss(8)
    times = samples["gyro_2"].time
    times = times[times >= START + period]
    grid = times[:, None] + period * (points - 1) / 2
    w = SENSORS["gyro_2"].ideal(truth(case, grid.ravel())).reshape(len(times), 8, 3)
    mean = np.einsum("q,mqi->mi", weights / 2, w)
    samples = samples.updated({"gyro_2": Samples(times, mean)})
    assert largest_residual(case, samples, joints, with_values(suite)) < 0.02
    shown = samples.updated({"gyro_2": Samples(times, w[:, -1])})
    assert largest_residual(case, shown, joints, with_values(suite)) > 0.5


def test_a_torque_turns_and_an_acceleration_moves(case):
    """Against an integration with the torque, and against a frame that falls."""
    torque, a = np.array([0.8, -0.5, 0.6]), np.array([0.003, -0.002, 0.004])

    begin, mass = case.state(START), case.craft.mass + case.target.mass
    first = truth(case, np.array([START, START + 1.0]))
    motion = Shifted(case.motion, START)

    P = mass * begin.v_Wcm
    momentum = np.concatenate([begin.L + np.cross(begin.p_Wcm, P), P])

    def telemetry(times, name):
        grid = np.unique(np.concatenate([[START], times])) - START
        base = propagate(
            case.craft.tree,
            motion,
            case.target.to_standard_vector(),
            grid,
            quaternion_WB=begin.attitude.as_quat(scalar_first=True),
            p_WB=first.p_WB[0],
            momentum_W=momentum,
            wrench=lambda time: Wrench(np.concatenate([torque, a])),
            max_step=0.02,
        )
        shown = base.to_motion(case.craft.joint_names, grid, motion)
        return shown.select(np.isin(grid + START, times))

    suite = case.suite
    samples, joints = exact_block(case, telemetry, suite)
    samples = without(samples, "gyro_2")
    values = with_values(suite, torque=torque, acceleration=a)
    assert largest_residual(case, samples, joints, values) < 0.02
    assert largest_residual(case, samples, joints, with_values(suite, torque=torque)) > 1.0
    assert largest_residual(case, samples, joints, with_values(suite, acceleration=a)) > 1.0


class Shifted:
    """A joint motion that begins later."""

    def __init__(self, motion, start):
        self._motion, self._start = motion, start
        self.duration = motion.duration - start

    def evaluate(self, time):
        return self._motion.evaluate(np.asarray(time) + self._start)

    def breaks(self):
        return self._motion.breaks() - self._start


@pytest.mark.parametrize("name", ["attitude", "p_Wcm", "L", "v_Wcm"])
def test_late_readings_of_a_point_beside_the_origin_change_with_the_state(case, name):
    """Derivatives with delays and lever arms that are not zero, against differences."""
    samples, joints = exact_block(case, lambda times, name: truth(case, times - LATE), case.suite)
    late = {f"{sensor}__delay": LATE for sensor in ("attitude", "gyro", "position", "velocity")}
    arm = np.array([0.02, -0.03, 0.01])
    constants = with_values(case.suite, position__lever_arm=arm, velocity__lever_arm=arm, **late)
    model, state = model_at(case, samples, joints, constants)
    exact, _ = model.jacobian(model.motion.trajectory(state))
    first = {"attitude": 0, "p_Wcm": 3, "L": 6, "v_Wcm": 9}[name]
    for k, step in enumerate(1e-5 * np.eye(3)):
        both = []
        for change in (step, -step):
            turn = Rotation.from_rotvec(change)
            value = getattr(state, name)
            value = turn * value if name == "attitude" else value + change
            both.append(residuals_of(model, replace(state, **{name: value})))
        column = -(both[0] - both[1]) / 2e-5
        error = np.abs(exact[:, first + k] - column).max()
        assert error < 1e-3 * np.abs(column).max()


@pytest.mark.parametrize("name", ["start", "attitude.mounting", "wheel", "target_wheel"])
def test_derivatives_hold_at_a_large_mounting_and_a_hidden_wheel(case, name):
    """Of all readings and of the block's end: a tracker turned by 3°, and a wheel of 2.7 N·m·s."""
    samples, joints = exact_block(case, lambda times, name: truth(case, times), case.suite)
    turn, wheel = np.array([0.03, -0.02, 0.04]), np.array([1.0, -2.0, 1.5])
    constants = with_values(
        case.suite, attitude__mounting=turn, wheel=wheel, target_wheel=wheel[::-1]
    )
    model, state = model_at(case, samples, joints, constants)
    rotations = model.motion.trajectory(state).rotations(samples.attitude.time)
    shown = Rotation.from_matrix(rotations) * Rotation.from_rotvec(turn)
    attitude = Samples(samples.attitude.time, shown.as_quat(scalar_first=True))
    model, _ = model_at(case, samples.updated({"attitude": attitude}), joints, constants)
    trajectory = model.motion.trajectory(state)
    exact, end = model.jacobian(trajectory)
    columns = model.columns[name]
    for k, step in enumerate(1e-5 * np.eye(columns.stop - columns.start)):
        both, ends = [], []
        for change in (step, -step):
            if name == "start":
                there = jumped(state, change)
            else:
                value = state.constants.copy()
                value[model.motion.constants.place(name)] += change
                there = replace(state, constants=value)
            both.append(residuals_of(model, there))
            moved = model.motion.end(model.motion.trajectory(there))
            ends.append(jump_between(model.motion.end(trajectory), moved))
        column, at_end = -(both[0] - both[1]) / 2e-5, (ends[0] - ends[1]) / 2e-5
        error = np.abs(exact[:, columns.start + k] - column).max()
        assert error < 1e-3 * np.abs(column).max()
        np.testing.assert_allclose(end[:, columns.start + k], at_end, atol=1e-4)
