"""A target that is much heavier and larger than the spacecraft is identified like others."""

from dataclasses import replace

import numpy as np
import pytest
from sensing_cases import Sines, coarse_suite, measured, true_psi

from cpid_drake import InertialParameters, identify
from cpid_drake.estimation.cramer_rao import cramer_rao_bound
from cpid_drake.logs.simulated_noise import add_noise
from cpid_drake.sensors.sensors import AttitudeSensor, Gyro, JointSensor, VectorSensor

GYRO = Gyro(100.0, 0.005, 1.0, 0.1)
SUITE = coarse_suite(gyro=GYRO)


@pytest.fixture(scope="module")
def target(craft):
    """Five times the mass, and ten times the radius of gyration, of the spacecraft."""
    mass, radius = 5 * craft.mass, 10 * np.sqrt(np.trace(craft_inertia(craft)) / 2 / craft.mass)
    inertia = mass * radius**2 * np.array([[0.9, 0.05, 0], [0.05, 1.1, 0.1], [0, 0.1, 0.7]])
    return InertialParameters(mass, radius * np.array([0.8, 0.3, -0.2]), inertia)


def craft_inertia(craft):
    return sum(body.I_BBcm for body in craft.tree.bodies)


@pytest.fixture(scope="module")
def ideal(craft, target):
    return measured(craft, Sines.drawn(4, 3, 12.0, 0.8), target, SUITE)


def test_the_bound_exists_and_grows_with_the_noise(craft, target, ideal):
    """A prior that stayed in the bound would keep it from growing."""
    noisier = replace(
        SUITE,
        gyro=Gyro(100.0, 0.05, 10.0, 1.0),
        attitude=AttitudeSensor(5.0, 50.0, 400.0, SUITE.attitude.boresight_B),
        position=VectorSensor(5.0, 1e-2),
        encoders=JointSensor(20.0, 1e-4),
    )
    bounds = [
        np.sqrt(np.diag(cramer_rao_bound(craft.tree, true_psi(craft, target), ideal, suite)))
        for suite in (SUITE, noisier)
    ]
    np.testing.assert_allclose(bounds[1], 10 * bounds[0], rtol=1e-3)


def test_it_is_identified_without_false_alarms(craft, target, ideal):
    noisy = add_noise(SUITE, ideal, 1)
    found = identify(craft, noisy, sensors=SUITE)
    error = found.parameters - target.to_vector()
    assert len(found.momentum_changes) == 0
    assert found.failures == ()
    assert error @ np.linalg.solve(found.covariance, error) < 30
