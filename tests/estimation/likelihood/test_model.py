"""The likelihood of a block: its predictions and derivatives against independent routes."""

from dataclasses import replace

import numpy as np
import pytest
from block_cases import added_sensors, joints_of, make_case, residuals_of, rich_suite
from scipy.spatial.transform import Rotation
from sensing_cases import MOMENTUM

from cpid_drake.dynamics.orbit import Orbit
from cpid_drake.dynamics.uncertainty import BodyUncertainty
from cpid_drake.estimation.block import Block
from cpid_drake.estimation.likelihood.model import BlockModel
from cpid_drake.estimation.roll import jumped
from cpid_drake.logs.log import Samples
from cpid_drake.sensors.disturbances import Disturbances

START, END = 1.0, 2.5
STEP = 0.0125
ORBIT = Orbit(rate=0.3, nadir_W=np.array([0.6, 0.0, -0.8]), normal_W=np.array([0.8, 0.0, 0.6]))
UNCERTAINTY = BodyUncertainty(mass=0.01, com=0.002, inertia=0.02)


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
    return samples, joints_of(Block(START, END, samples), case.suite)


@pytest.fixture(scope="module")
def state(case):
    """The true state, with biases of both gyros."""
    return replace(case.state(START), constants=np.array([1.0, -2.0, 3.0, -3.0, 1.0, 2.0]))


def moved(model, state, name, step):
    """Return the state after a step of one effect's quantities."""
    if name == "psi":
        return replace(state, psi=state.psi + step)
    if name == "start":
        return jumped(state, step)
    value = state.constants.copy()
    value[model.motion.constants.place(name)] += step
    return replace(state, constants=value)


def assert_column(exact, ahead, behind, step, tolerance, name):
    """Assert that a column of the Jacobian of the predictions is that of finite differences."""
    column = -(ahead - behind) / (2 * step)
    error = np.abs(exact - column).max()
    assert error <= tolerance * np.abs(column).max() + 1e-9, f"{name}: {error}"


@pytest.mark.parametrize("orbit", [None, ORBIT], ids=["free", "orbit"])
def test_derivatives_by_what_changes_the_state(case, block, state, orbit):
    """Attitude, centre of mass, momentum, biases and target, for all sensors at once."""
    suite = replace(case.suite, disturbances=Disturbances(orbit=orbit))
    samples, joints = block
    if orbit is not None:  # without position: within a block, its derivatives are a straight line's
        none = Samples(np.empty(0), np.empty((0, 3)))
        samples = samples.updated({"position": none, "velocity": none})
    model = BlockModel(case.craft.tree, joints, samples, suite, UNCERTAINTY, STEP)
    if orbit is not None:  # the samples were those of a free motion
        trajectory, shown = model.motion.trajectory(state), {}
        for name in ("attitude", "tracker_2"):
            R = Rotation.from_matrix(trajectory.rotations(samples[name].time))
            shown[name] = Samples(samples[name].time, R.as_quat(scalar_first=True))
        samples = samples.updated(shown)
        model = BlockModel(case.craft.tree, joints, samples, suite, UNCERTAINTY, STEP)
    exact, _ = model.jacobian(model.motion.trajectory(state))
    assert exact.shape == (residuals_of(model, state).size, model.columns["bodies"].stop)
    steps = {"start": np.repeat([1e-5, 1e-3], 6), "psi": np.full(10, 1e-3)}
    for name, columns in model.columns.items():
        if name in ("joints", "bodies"):
            continue
        size = columns.stop - columns.start
        for k in range(columns.start, columns.stop):
            step = steps[name][k - columns.start] if name in steps else 0.1
            change = step * np.eye(size)[k - columns.start]
            ahead, behind = (
                residuals_of(model, moved(model, state, name, s * change)) for s in (1, -1)
            )
            # The coupling by momentum is integrated by the trapezoidal rule.
            is_exact = case.momentum_W is None and orbit is None
            tolerance = 1e-6 if is_exact else 3e-5
            assert_column(exact[:, k], ahead, behind, step, tolerance, f"{name} {k}")


def test_the_attitude_does_not_jump_at_a_node_of_the_grid(case, block, state):
    """Samples lie on nodes: a jump there lets the sign of a tiny delay change χ²."""
    samples, joints = block
    motion = BlockModel(case.craft.tree, joints, samples, case.suite, step=0.05).motion
    trajectory = motion.trajectory(state)
    inner = motion.nodes[1:-1]
    for times in (inner - 1e-11, inner + 1e-11):
        R = Rotation.from_matrix(trajectory.rotations(times))
        at_nodes = Rotation.from_matrix(trajectory.R[1 : len(inner) + 1])
        assert (at_nodes.inv() * R).magnitude().max() < 1e-10
