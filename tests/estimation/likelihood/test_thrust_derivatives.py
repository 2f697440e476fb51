"""Derivatives of a block with thrust, valve by valve, agree with differences of its residuals."""

from dataclasses import replace

import numpy as np
import pytest
from block_cases import joints_of, make_case
from scipy.spatial.transform import Rotation
from sensing_cases import MOMENTUM, coarse_suite

from cpid_drake.dynamics.body_dynamics import BodyDynamics
from cpid_drake.estimation.likelihood.actuators import thrust_log
from cpid_drake.estimation.likelihood.constants import Constants
from cpid_drake.estimation.likelihood.forces import white_forces
from cpid_drake.estimation.likelihood.model import BlockModel
from cpid_drake.logs.log import THRUST, Samples
from cpid_drake.sensors.sensors import VectorSensor
from cpid_drake.sensors.suite import Disturbances
from cpid_drake.sensors.thrusters import Thrusters, Valve

SUITE = coarse_suite(
    velocity=VectorSensor(rate=10.0, sigma=1e-4),
    disturbances=Disturbances(acceleration_noise=1e-3, torque_noise=1e-2, torque_B=0.5),
    thrusters=Thrusters(
        {
            "a": Valve(np.array([0.3, 0.1, -0.2]), np.array([0, 1.0, 0.2]), 2.0, 0.1),
            "b": Valve(np.array([0.1, 0.2, 0.1]), np.array([1, 0, 1.0]), 3.0, 0.3, "target"),
            "c": Valve(
                np.array([0.2, 0.0, 0.1]), np.array([0.3, 1, 0]), 1.0, 0.1, "target", "world"
            ),
        },
        delay_ms=30.0,
        loss=0.1,
        common_force=0.2,
    ),
)
OPENINGS = Samples(
    np.array([1.0, 1.2, 1.5, 2.1, 2.6]),
    np.array([[1, 0, 0], [1, 1, 0], [0, 1.0, 1], [1, 1, 1], [0, 0, 0.5]]),
)
UNKNOWNS = ["attitude", "momentum", "psi", "forces"]
SUITE.encoders = replace(SUITE.encoders, zero_mrad=2.0, drift_mrad_per_s=1.0)
ERRORS = ["a.force", "b.force", "c.force", "thrusters.common_force", "thrusters.loss"]
ERRORS += ["thrusters.valve_delay", "torque_B"]
OF_JOINTS = ["encoders.zero", "encoders.drift"]
ERRORS += OF_JOINTS


@pytest.fixture(scope="module")
def block(tmp_path_factory, skewed_target):
    """Return a prediction by state and constant errors, the block's model, and a state."""
    case = make_case(tmp_path_factory.mktemp("craft"), skewed_target, SUITE, MOMENTUM, 3.0)
    samples = case.block(0.999, 2.2, case.samples.updated({THRUST: OPENINGS}))
    constants = Constants.of(SUITE, 4)
    nominal, joints = np.full(constants.size, 0.2), joints_of(samples, SUITE)
    white = white_forces(SUITE, 0.999, 2.2, is_planar=False)
    forces = np.linspace(-0.5, 0.5, white[-1].rows.stop)
    state = replace(case.state(0.999), constants=nominal, forces=forces)

    def predicted(state):
        model = BlockModel(
            case.craft.tree,
            joints,
            samples.samples,
            SUITE,
            constants=constants,
            nominal=state.constants,
            origin=0.4,
        )
        trajectory = model.motion.trajectory(state)
        parts = [each.residuals(trajectory).ravel() for each in model.sensors.values()]
        return np.concatenate(parts), model, trajectory

    return predicted, state, constants


def changed(state, constants, name, entry, h):
    if name == "attitude":
        return replace(state, attitude=Rotation.from_rotvec(h * np.eye(3)[entry]) * state.attitude)
    if name == "momentum":
        key = "L" if entry < 3 else "v_Wcm"
        return replace(state, **{key: getattr(state, key) + h * np.eye(3)[entry % 3]})
    key, place = (
        ("constants", constants.place(name).start + entry) if name in ERRORS else (name, entry)
    )
    value = getattr(state, key)
    return replace(state, **{key: value + h * np.eye(len(value))[place]})


@pytest.mark.parametrize("name", [*UNKNOWNS, *ERRORS])
def test_derivatives_are_those_of_differences(block, name):
    predicted, state, constants = block
    _, model, trajectory = predicted(state)
    firsts = {"attitude": 0, "momentum": 6, "forces": model.columns["torque_noise"].start}
    first = firsts[name] if name in firsts else model.columns[name].start
    J = model.jacobian(trajectory)[0]
    sizes = {"attitude": 3, "momentum": 6, "psi": 10, "torque_B": 3}
    sizes |= dict.fromkeys(OF_JOINTS, 4)
    for entry in range({**sizes, "forces": len(state.forces)}.get(name, 1)):
        up, down = (predicted(changed(state, constants, name, entry, h))[0] for h in (1e-4, -1e-4))
        expected = (down - up) / 2e-4
        if name in ("psi", *OF_JOINTS):  # the readings of white torques are the last but one
            rows = slice(len(expected) - len(state.forces), len(expected) - 6)
            torques = expected[rows] = torques_by_inertia(model, trajectory, name, entry)
            assert np.allclose(J[rows, first + entry], torques, atol=1e-6 + 0.02 * abs(torques))
        ends = np.cumsum([each.residuals(trajectory).size for each in model.sensors.values()])[:-1]
        ends = ends if name == "thrusters.valve_delay" else []  # by sensor: kinks are local
        for a, b in zip(np.split(J[:, first + entry], ends), np.split(expected, ends), strict=True):
            assert np.linalg.norm(a - b) <= 2e-3 * np.linalg.norm(b)


def test_errors_of_valves_change_what_they_do():
    """One is stronger, all are weaker, each further open one costs a share, and all act late."""
    constants, nominal = Constants.of(SUITE, 4), np.zeros(Constants.of(SUITE, 4).size)
    sizes = {"a.force": 0.1, "thrusters.common_force": -0.05}
    sizes |= {"thrusters.loss": 0.04, "thrusters.valve_delay": 0.02}
    for name, size in sizes.items():
        nominal[constants.place(name)] = size / constants.errors[name].sigma
    log = thrust_log(OPENINGS, SUITE.thrusters, constants, nominal)
    np.testing.assert_allclose(log.samples.time, OPENINGS.time + 0.02)
    left = np.array([1.0, 0.96, 0.96, 0.92, 1.0])
    expected = 0.95 * left[:, None] * OPENINGS.value * [1.1 * 2.0, 3.0, 1.0]
    np.testing.assert_allclose(log.samples.value, expected)


def torques_by_inertia(model, trajectory, name, entry):
    """Return the derivative of R J J_new⁻¹ Rᵀ u by what J_new depends on, for white torques u."""
    force = model.motion.white[0]
    nodes = np.searchsorted(model.motion.nodes, force.middles)
    grid, R = model.motion.grid.part(nodes), trajectory.R[nodes]
    u = np.swapaxes(R, 1, 2) @ trajectory.state.forces[force.rows].reshape(-1, 3, 1)

    q = model.motion.joint_motion(model.motion.nodes[nodes])[:, 0]
    size = 1.0 if name == "psi" else model.motion.constants.errors[name].sigma

    def read(h):
        psi, new = trajectory.state.psi, grid
        if name == "psi":
            psi = psi + h * np.eye(10)[entry]
        else:
            at = np.eye(4)[entry]
            if name == "encoders.drift":
                at = np.outer(model.motion.nodes[nodes] - 0.4, at)
            moved = q - h * size * at
            new = BodyDynamics.at(model.motion.tree, moved, 0 * q)
        return (R @ grid.inertia(trajectory.state.psi) @ new.mobility(psi) @ u).ravel()

    return (read(1e-4) - read(-1e-4)) / 2e-4
