"""Joint efforts of a free-floating spacecraft, against the conservation of energy and momentum."""

import numpy as np
import pytest
from pydrake.common.value import Value
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import ExternallyAppliedSpatialForce
from sensing_cases import MOMENTUM, small_craft

from cpid_drake import InertialParameters, MultiSine, Spacecraft
from cpid_drake.simulation.flexible import CompliantWrist
from cpid_drake.spacecraft.free_floating import FreeFloatingDynamics

TARGET = InertialParameters(80.0, [0.3, -0.1, 0.2], np.diag([9.0, 12.0, 8.0]))


@pytest.fixture(scope="module", params=["wheels", "gripper"])
def craft(tmp_path_factory, request) -> Spacecraft:
    return small_craft(tmp_path_factory.mktemp("craft"), **{request.param: True})


@pytest.mark.parametrize("momentum_W", [np.zeros(6), MOMENTUM], ids=["at rest", "tumbling"])
def test_the_motors_power_is_the_rate_of_the_kinetic_energy(craft, momentum_W):
    """No other force does work, so τ·q̇ = dT/dt; T follows from conservation of momentum."""
    rng = np.random.default_rng(3)
    J = len(craft.joint_names)
    motion = MultiSine(
        0.3 * np.ones(J), rng.normal(0, 0.2, (2, J)), [0.2, 0.5], rng.normal(0, 2, (2, J)), 1.0, 4.0
    )
    h = 2e-4
    middle = np.linspace(0.5, 3.5, 9)
    times = np.sort(np.concatenate([middle - h, middle, middle + h]))
    telemetry = craft.predicted_motion(TARGET, motion, times, momentum_W)
    states = craft.to_states(telemetry)
    plant = craft.make_simulation_plant(TARGET)
    context = plant.CreateDefaultContext()
    energy = []
    for state in states:
        plant.SetPositionsAndVelocities(context, state)
        energy.append(plant.CalcKineticEnergy(context))
    _, qdot, qddot = np.moveaxis(motion.evaluate(middle), -2, 0)
    efforts = FreeFloatingDynamics(craft, plant).joint_efforts(context, states[1::3], qddot)
    power = np.sum(efforts * qdot, axis=1)
    rate = (np.array(energy[2::3]) - np.array(energy[::3])) / (2 * h)
    assert np.abs(power).max() > 1.0
    np.testing.assert_allclose(power, rate, atol=2e-5 * np.abs(power).max())


def test_joints_accelerate_as_told_beside_springs_and_against_forces(craft):
    """By Drake's forward dynamics: a wrist that yields and damps, pushes on base and target."""
    rng = np.random.default_rng(7)
    wrist = CompliantWrist(np.full(3, 40.0), np.full(3, 3.0), np.full(3, 900.0), np.full(3, 20.0))
    plant = craft.make_simulation_plant(TARGET, wrist.connect)
    context = plant.CreateDefaultContext()
    state = plant.GetPositionsAndVelocities(context)
    state += rng.normal(0.0, 0.1, len(state))
    state[:4] /= np.linalg.norm(state[:4])
    plant.SetPositionsAndVelocities(context, state)
    forces = []
    for name in ("base", "captured_target"):
        force = ExternallyAppliedSpatialForce()
        force.body_index = plant.GetBodyByName(name).index()
        force.p_BoBq_B = rng.normal(0.0, 0.3, 3)
        force.F_Bq_W = SpatialForce(rng.normal(0.0, 5.0, 3), rng.normal(0.0, 20.0, 3))
        forces.append(force)
    joints = craft.columns_in(plant)[craft.joint_columns[1]] - plant.num_positions()
    a_J = rng.normal(0.0, 0.5, len(joints))

    effort = FreeFloatingDynamics(craft, plant).generalized_force(context, a_J, forces)
    assert not np.delete(effort, joints).any()
    plant.get_applied_generalized_force_input_port().FixValue(context, effort)
    plant.get_applied_spatial_force_input_port().FixValue(context, Value(forces))
    vdot = plant.EvalTimeDerivatives(context).CopyToVector()[plant.num_positions() :]
    np.testing.assert_allclose(vdot[joints], a_J, rtol=0, atol=1e-10)
    assert np.abs(np.delete(vdot, joints)).min() > 1e-3
