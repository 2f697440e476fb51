"""The prior of a gyro's bias is the covariance of a random walk."""

import numpy as np
import pytest

from cpid_drake.estimation.likelihood.gyro_bias import GyroBias
from cpid_drake.sensing.noise import SensorNoise
from cpid_drake.sensing.sensors import Gyro
from cpid_drake.sensing.suite import SensorSuite


def covariance(bias: GyroBias) -> np.ndarray:
    """Return the covariance (K, K) of one axis."""
    information = bias.prior().T @ bias.prior()
    return np.linalg.inv(information)[::3, ::3]


@pytest.mark.parametrize(("start", "end"), [(0.0, 9.0), (100.0, 104.5)])
def test_the_variance_grows_with_time_from_the_start(start, end):
    """Wiener process: cov(b(s), b(t)) = σ² + growth² min(s, t)."""
    gyro = Gyro(bias=2.0, bias_random_walk=30.0)
    bias = GyroBias(gyro, start, end)
    elapsed = bias.nodes - start
    expected = gyro.bias_sigma**2 + gyro.bias_growth**2 * np.minimum.outer(elapsed, elapsed)
    np.testing.assert_allclose(covariance(bias), expected, rtol=1e-9)


def test_simulated_biases_have_the_covariance_of_the_prior():
    gyro = Gyro(rate=5.0, bias=1.0, bias_random_walk=60.0)
    bias = GyroBias(gyro, 0.0, 4.0)
    samples = np.array(
        [SensorNoise(SensorSuite(gyro=gyro), seed).gyro_bias(21)[::5] for seed in range(2000)]
    )
    found = np.einsum("nkc,nlc->kl", samples, samples) / (3 * len(samples))
    np.testing.assert_allclose(found, covariance(bias), rtol=0.08)


def test_a_constant_bias_has_one_node():
    gyro = Gyro(bias=3.0)
    bias = GyroBias(gyro, 5.0, 20.0)
    np.testing.assert_allclose(covariance(bias), [[gyro.bias_sigma**2]])
    np.testing.assert_array_equal(bias.weights(np.array([5.0, 20.0])), [[1.0], [1.0]])


def test_biases_between_nodes_are_interpolated():
    bias = GyroBias(Gyro(bias_random_walk=1.0), 10.0, 13.0)
    times = np.array([10.0, 10.25, 12.5, 13.0])
    np.testing.assert_allclose(bias.weights(times) @ bias.nodes, times)
