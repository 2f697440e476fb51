"""The likelihood of a block: its predictions and derivatives against independent routes."""

from dataclasses import replace

import numpy as np
import pytest
from block_cases import added_sensors, make_case, rich_suite
from sensing_cases import MOMENTUM

from cpid_drake.dynamics.parameterizations import relative_parameterization
from cpid_drake.dynamics.sensitivity import with_errors
from cpid_drake.dynamics.uncertainty import BodyUncertainty
from cpid_drake.estimation.likelihood.joint_motion import joint_block
from cpid_drake.estimation.likelihood.model import BlockModel
from cpid_drake.sensing.measurements import Samples
from cpid_drake.sensing.sensors import JointSensor

START, END = 1.0, 2.5
STEP = 0.0125
UNCERTAINTY = BodyUncertainty(mass=0.01, com=0.002, inertia=0.02)
NOTHING = np.empty(0), np.empty((0, 4))
BASE = ("attitude", "gyro", "position", "velocity", "gyro_2", "tracker_2")


@pytest.fixture(scope="module", autouse=True)
def sensors():
    with added_sensors():
        yield


@pytest.fixture(scope="module", params=[None, MOMENTUM], ids=["at rest", "tumbling"])
def case(request, tmp_path_factory, skewed_target):
    return make_case(tmp_path_factory.mktemp("craft"), skewed_target, rich_suite(), request.param)


@pytest.fixture(scope="module")
def block(case):
    """Return the samples of one block, and its joint motion."""
    samples = case.block(START, END).samples
    return samples, joint_block(START, END, samples, case.suite, None)


@pytest.fixture(scope="module")
def model(case, block):
    samples, joints = block
    return BlockModel(case.craft.tree, joints, samples, case.suite, UNCERTAINTY, STEP)


@pytest.fixture(scope="module")
def state(case):
    """The true state, with two nodes of the walking bias and one of the constant bias."""
    bias = 1e-6 * np.array([[1.0, -2.0, 3.0], [2.0, 1.0, -1.0], [-3.0, 1.0, 2.0]])
    return replace(case.state(START), bias=bias)


def residuals(model, state):
    return model.residuals(model.motion.trajectory(state))


def assert_column(exact, ahead, behind, step, tolerance, name):
    """Assert that a column of the Jacobian of the predictions is that of finite differences."""
    column = -(ahead - behind) / (2 * step)
    error = np.abs(exact - column).max()
    assert error <= tolerance * np.abs(column).max() + 1e-9, f"{name}: {error}"


def test_the_predictions_are_the_simulated_readings(case, model, state):
    """Of all sensors, in their frames; the simulation integrates linear and angular momentum."""
    assert set(model.sensors) == set(BASE)
    samples = case.block(START, END).samples
    exact = replace(case.suite, encoders=JointSensor(50.0), joint_rates=None)
    joints = joint_block(
        START, END, samples.updated({"joint_rates": Samples(*NOTHING)}), exact, None
    )
    fine = BlockModel(case.craft.tree, joints, samples, case.suite, None, STEP)
    true = replace(state, bias=np.zeros((3, 3)))
    assert np.abs(residuals(fine, true)).max() < 5e-3  # σ


def test_derivatives_by_what_changes_the_state(case, model, state):
    """Attitude, centre of mass, momentum, biases and target, for all sensors at once."""
    exact, _ = model.jacobian(model.motion.trajectory(state))
    assert exact.shape == (residuals(model, state).size, model.columns["bodies"].stop)
    steps = {"start": 1e-5, "momentum": 1e-3, "psi": 1e-3}
    for name, columns in model.columns.items():
        if name in ("joints", "bodies"):
            continue
        for k in range(columns.start, columns.stop):
            step = steps.get(name, 1e-6)
            change = step * np.eye(model.size)[k]
            ahead, behind = (residuals(model, model.moved(state, s * change)) for s in (1, -1))
            # The coupling by momentum is integrated by the trapezoidal rule.
            tolerance = 3e-5 if case.momentum_W is not None else 1e-6
            assert_column(exact[:, k], ahead, behind, step, tolerance, f"{name} {k}")


def test_derivatives_by_errors_of_the_joints(case, block, model, state):
    """Every coefficient of every joint, prismatic or revolute."""
    samples, joints = block
    exact, _ = model.jacobian(model.motion.trajectory(state))
    K, J = joints.coefficients.shape
    first = model.columns["joints"].start
    assert model.columns["joints"].stop - first == K * J
    for joint in range(J):
        for k in range(K):
            values = []
            for sign in (1, -1):
                coefficients = joints.coefficients.copy()
                coefficients[k, joint] += sign * 1e-4
                moved = replace(joints, coefficients=coefficients)
                other = BlockModel(case.craft.tree, moved, samples, case.suite, None, STEP)
                values.append(residuals(other, state))
            column = exact[:, first + joint * K + k]
            assert_column(column, *values, 1e-4, 2e-3, f"joint {joint}, {k}")


@pytest.mark.parametrize(("body", "k"), [(0, 0), (0, 2), (0, 5), (1, 0), (2, 3), (4, 8)])
def test_derivatives_by_errors_of_the_known_bodies(case, block, model, state, body, k):
    """In units of their σ; the target remains the same body."""
    samples, joints = block
    exact, _ = model.jacobian(model.motion.trajectory(state))
    target = relative_parameterization(case.craft.mass).to_parameters(state.psi)
    values = []
    for value in (0.1, -0.1):
        errors = np.zeros((len(case.craft.tree.bodies), 10))
        errors[body, k] = value
        tree = with_errors(case.craft.tree, UNCERTAINTY, errors.ravel())
        psi = relative_parameterization(tree.mass).from_parameters(target)
        other = BlockModel(tree, joints, samples, case.suite, None, STEP)
        values.append(residuals(other, replace(state, psi=psi)))
    column = exact[:, model.columns["bodies"].start + 10 * body + k]
    assert_column(column, *values, 0.1, 2e-4, f"{body}, {k}")


GEOMETRY = BodyUncertainty(joint_position_mm=2.0, joint_axis_mrad=3.0, grasp_mm=1.0, grasp_mrad=2.0)


@pytest.mark.parametrize("k", [0, 4, 8, 9, 12, 18, 20, 22, 25])
def test_derivatives_by_errors_of_the_geometry(case, block, state, k):
    """Of the arm (5 columns of each of 4 joints) and of the capture frame (6), in units of σ."""
    samples, joints = block
    model = BlockModel(case.craft.tree, joints, samples, case.suite, GEOMETRY, STEP)
    exact, _ = model.jacobian(model.motion.trajectory(state))
    columns = model.columns["bodies"]
    assert columns.stop - columns.start == 5 * 4 + 6
    values = []
    for value in (0.1, -0.1):
        tree = with_errors(case.craft.tree, GEOMETRY, value * np.eye(26)[k])
        values.append(residuals(BlockModel(tree, joints, samples, case.suite, None, STEP), state))
    assert_column(exact[:, columns.start + k], *values, 0.1, 2e-4, f"{k}")


def test_only_its_own_gyro_reads_a_bias(model, state):
    """The walking bias has two nodes, the constant one has one; all nodes add up to a constant."""
    exact, end = model.jacobian(model.motion.trajectory(state))
    sizes = np.cumsum([0] + [3 * len(sensor.samples) for sensor in model.sensors.values()])
    rows = {name: slice(a, b) for name, a, b in zip(model.sensors, sizes[:-1], sizes[1:])}
    for gyro, nodes in (("gyro", 2), ("gyro_2", 1)):
        columns = model.columns[f"bias of {gyro}"]
        assert columns.stop - columns.start == 3 * nodes
        assert not end[:, columns].any()
        assert not np.delete(exact[:, columns], rows[gyro], axis=0).any()
        total = exact[rows[gyro], columns].reshape(-1, nodes, 3).sum(axis=1)
        sigma = model.sensors[gyro].sigmas[0]
        np.testing.assert_allclose(total * sigma, np.tile(np.eye(3), (len(total) // 3, 1)))
