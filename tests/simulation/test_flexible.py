"""A target on a compliant wrist: momentum is conserved, and the modes are those of two bodies."""

from dataclasses import replace

import numpy as np
import pytest
from flyer_cases import MOVING, payload
from scipy.linalg import eigvalsh

from cpid_drake import (
    InputError,
    make_simulation,
)
from cpid_drake.dynamics.body_dynamics import BodyDynamics
from cpid_drake.dynamics.momentum import system_momentum
from cpid_drake.dynamics.rotations import skew
from cpid_drake.simulation.flexible import CompliantWrist

STIFFNESS = np.array([3.0, 4.0, 5.0])
SPRINGS = np.array([400.0, 500.0, 600.0])


def with_wrist(factor: float = 1.0, *, moves: bool = False):
    """Return a scenario with a wrist whose springs and dampers are so many times as stiff."""
    wrist = CompliantWrist(
        factor * STIFFNESS,
        np.sqrt(factor) * np.array([0.5, 0.6, 0.7]),
        factor * SPRINGS if moves else None,
        np.sqrt(factor) * np.array([20.0, 30.0, 40.0]),
    )
    return payload(2.0, 1e-10, momentum_W=MOVING, wrist=wrist)


@pytest.fixture(scope="module")
def compliant():
    simulation = make_simulation(with_wrist(moves=True))
    return simulation, simulation.run()


def test_a_compliant_wrist_conserves_momentum(compliant):
    """That of all bodies, as Drake computes it; in the rigid model the target does not move."""
    simulation, context = compliant
    telemetry, expected = simulation.motion(context), simulation.expected_momentum(context)
    np.testing.assert_allclose(simulation.momentum(context), expected, rtol=0, atol=1e-7)
    P, L = system_momentum(simulation.spacecraft.tree, simulation.truth, telemetry)
    relative = np.abs(np.hstack([L, P]) - expected)
    assert relative.max() > 1e-2
    assert relative[0].max() < 1e-12, "the springs are relaxed at the start"


def test_the_joints_follow_their_motion(compliant):
    """The controller knows the wrist, so the spring disturbs no joint."""
    simulation, context = compliant
    telemetry = simulation.motion(context)
    expected = simulation.joint_motion.evaluate(telemetry.time)[:, 0]
    np.testing.assert_allclose(telemetry.q, expected, rtol=0, atol=1e-8)


@pytest.mark.parametrize("moves", [False, True])
def test_modes_are_those_of_two_free_bodies(moves):
    """With the joints at rest, spacecraft and target are two rigid bodies on a spring."""
    scenario = with_wrist(moves=moves)
    scenario.simulation.momentum_W = np.zeros(6)
    simulation = make_simulation(scenario)
    plant, size = simulation.plant, 6 if moves else 3
    root = simulation.make_simulator().get_mutable_context()
    context = plant.GetMyMutableContextFromRoot(root)
    x = plant.GetPositionsAndVelocities(context)
    places = np.setdiff1d(np.arange(plant.num_positions()), simulation.state_columns)
    rates = np.setdiff1d(np.arange(plant.num_positions(), x.size), simulation.state_columns)
    assert len(places) == len(rates) == size
    port, step = plant.get_generalized_acceleration_output_port(), 1e-6

    def accelerations(columns, change):
        state = x.copy()
        state[columns] += change
        plant.SetPositionsAndVelocities(context, state)
        return port.Eval(context)[rates - plant.num_positions()]

    by_deflection, by_rate = (
        np.transpose(
            [
                (accelerations(columns, each) - accelerations(columns, -each)) / (2 * step)
                for each in step * np.eye(size)
            ]
        )
        for columns in (places, rates)
    )
    found = np.sort(np.sqrt(-np.linalg.eigvals(by_deflection).real)) / (2 * np.pi)

    tree, q = simulation.spacecraft.tree, simulation.joint_motion.evaluate(0.0)[0]
    known = BodyDynamics.at(tree, q[None], 0 * q[None])
    capture = simulation.spacecraft.plant.CreateDefaultContext()
    simulation.spacecraft.plant.SetPositionsAndVelocities(capture, x[simulation.state_columns])
    X_WC = simulation.spacecraft.capture_frame.CalcPoseInWorld(capture)  # B is at W
    R = X_WC.rotation().matrix()
    p_CK = R.T @ (known.p_BK[0] - X_WC.translation())
    parts = [
        (tree.mass, p_CK, R.T @ known.I_K[0] @ R),
        (simulation.truth.mass, simulation.truth.p_CTcm_C, simulation.truth.I_TTcm_C),
    ]
    mobility = np.zeros((6, 6))
    for mass, p, inertia in parts:
        mixed = mass * skew(p)
        about_C = inertia - mixed @ skew(p)
        mobility += np.linalg.inv(np.block([[about_C, mixed], [mixed.T, mass * np.eye(3)]]))
    reduced = np.linalg.inv(mobility)[:size, :size]
    stiffness = np.diag(np.concatenate([STIFFNESS, SPRINGS])[:size])
    expected = np.sqrt(eigvalsh(stiffness, reduced)) / (2 * np.pi)
    np.testing.assert_allclose(found, expected, rtol=1e-6)
    wrist = scenario.simulation.wrist
    damping = np.diag(np.concatenate([wrist.damping, wrist.translational_damping])[:size])
    expected_by_rate = -np.linalg.solve(reduced, damping)
    np.testing.assert_allclose(by_rate, expected_by_rate, atol=1e-6 * np.abs(by_rate).max())


def test_the_spacecraft_alone_has_its_own_coordinates(servicer, skewed_target):
    """The coordinates of the wrist lie between those of the two arms."""
    plant = servicer.make_simulation_plant(skewed_target, CompliantWrist(1e3 * STIFFNESS).connect)
    columns = servicer.columns_in(plant)
    assert (np.diff(columns) > 1).sum() == 2
    x = np.random.default_rng(3).uniform(-0.5, 0.5, plant.num_multibody_states())
    x[servicer.state_columns["quaternion_WB"]] = [0.5, -0.5, 0.5, 0.5]
    whole, alone = plant.CreateDefaultContext(), servicer.plant.CreateDefaultContext()
    plant.SetPositionsAndVelocities(whole, x)
    servicer.plant.SetPositionsAndVelocities(alone, x[columns])
    for name in ("capture_point", "operating_arm_link6"):
        there, here = plant.GetFrameByName(name), servicer.plant.GetFrameByName(name)
        assert there.CalcPoseInWorld(whole).IsNearlyEqualTo(here.CalcPoseInWorld(alone), 1e-12)
        np.testing.assert_allclose(
            there.CalcSpatialVelocityInWorld(whole).get_coeffs(),
            here.CalcSpatialVelocityInWorld(alone).get_coeffs(),
            atol=1e-12,
        )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"stiffness": np.array([3.0, 0.0, 5.0])}, "wrist.stiffness must be three numbers > 0"),
        ({"damping": np.array([0.1, -0.1, 0.1])}, "wrist.damping must be three numbers >= 0"),
        ({"translational_stiffness": np.zeros(3)}, "wrist.translational_stiffness must be three"),
    ],
)
def test_a_wrist_that_cannot_be_simulated_is_refused(change, message):
    def simulate() -> None:
        scenario = with_wrist()
        scenario.simulation.wrist = replace(scenario.simulation.wrist, **change)
        make_simulation(scenario)

    with pytest.raises(InputError, match=message):
        simulate()
