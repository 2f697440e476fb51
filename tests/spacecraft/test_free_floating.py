"""Joint efforts of a free-floating spacecraft, against the conservation of energy and momentum."""

import numpy as np
import pytest
from sensing_cases import MOMENTUM, small_craft

from cpid_drake import InertialParameters, MultiSine, Spacecraft
from cpid_drake.spacecraft.free_floating import FreeFloatingDynamics

TARGET = InertialParameters(80.0, [0.3, -0.1, 0.2], np.diag([9.0, 12.0, 8.0]))


@pytest.fixture(scope="module")
def craft(tmp_path_factory) -> Spacecraft:
    return small_craft(tmp_path_factory.mktemp("craft"), wheels=True)


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
