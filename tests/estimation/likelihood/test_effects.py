"""The random walk of a bias."""

import numpy as np
from scipy.spatial.transform import Rotation

from cpid_drake.estimation.likelihood.effects import GyroBias
from cpid_drake.estimation.likelihood.motion import TrajectoryState
from cpid_drake.sensors.sensors import Gyro

WALKING = Gyro(rate=5.0, bias=1.0, bias_random_walk=60.0)


def some_state(bias):
    return TrajectoryState(
        psi=np.arange(10.0),
        attitude=Rotation.from_rotvec([0.3, -0.5, 0.8]),
        p_Wcm=np.array([1.0, 2.0, 3.0]),
        v_Wcm=np.array([0.1, 0.2, 0.3]),
        L=np.array([5.0, 6.0, 7.0]),
        bias=np.asarray(bias, dtype=float),
    )


def test_a_chain_of_blocks_has_the_covariance_of_a_random_walk():
    """Wiener process: cov(b(s), b(t)) = σ² + growth² min(s, t), whatever the blocks' lengths."""
    edges = np.array([100.0, 101.0, 101.5, 104.0])
    information = np.zeros((4, 4))
    information[0, 0] = WALKING.bias_sigma**-2
    for k in range(3):
        bias = GyroBias("gyro", WALKING, 0, edges[k], edges[k + 1])
        rows, rest = bias.links(some_state(np.zeros((2, 3))))
        np.testing.assert_array_equal(rest, 0)
        part = (rows.T @ rows)[::3, ::3]
        information[k : k + 2, k : k + 2] += part
    elapsed = edges - edges[0]
    expected = WALKING.bias_sigma**2 + WALKING.bias_growth**2 * np.minimum.outer(elapsed, elapsed)
    np.testing.assert_allclose(np.linalg.inv(information), expected, rtol=1e-9)
