"""The prior of a gyro's bias is that of the random walk that `SensorNoise` draws."""

import numpy as np
import pytest

from cpid_drake.estimation.likelihood.gyro_bias import GyroBias
from cpid_drake.sensing.sensors import Gyro


@pytest.mark.parametrize("duration", [0.4, 1.5, 7.3])
def test_variance_grows_with_time(duration):
    """σ² = σ₀² + (growth)² t at every node, however far the nodes are apart."""
    gyro = Gyro(100.0, 0.005, bias=1.0, bias_random_walk=30.0)
    bias = GyroBias(gyro, 5.0, 5.0 + duration)
    root = bias.prior()
    variance = np.diag(np.linalg.inv(root.T @ root)).reshape(-1, 3)
    expected = gyro.bias_sigma**2 + gyro.bias_growth**2 * (bias.nodes - 5.0)
    np.testing.assert_allclose(variance, np.tile(expected[:, None], 3), rtol=1e-12)
    assert bias.nodes[-1] == pytest.approx(5.0 + duration)


def test_a_bias_that_does_not_walk_is_one_constant():
    bias = GyroBias(Gyro(100.0, 0.005, bias=2.0), 0.0, 10.0)
    np.testing.assert_allclose(bias.prior(), np.eye(3) / (np.radians(2.0) / 3600))
    np.testing.assert_array_equal(bias.weights(np.array([0.0, 3.0, 10.0])), np.ones((3, 1)))
