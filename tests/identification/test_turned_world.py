"""The axes of W mean nothing: samples seen from a turned world say the same of the target."""

import numpy as np
from scipy.spatial.transform import Rotation
from sensing_cases import Sines, coarse_suite, measured, small_craft

from cpid_drake import identify
from cpid_drake.sensing.measurements import Samples
from cpid_drake.sensing.noise import add_noise

TURN = Rotation.from_rotvec([1.4, -1.1, 0.8])


def test_the_fit_of_turned_samples_is_the_same(tmp_path, skewed_target):
    craft, suite = small_craft(tmp_path), coarse_suite()
    motion = Sines.drawn(4, seed=101, duration=5.0, size=0.6)
    samples = add_noise(suite, measured(craft, motion, skewed_target, suite), seed=1)
    attitude = TURN * Rotation.from_quat(samples.attitude.value, scalar_first=True)
    turned = samples.updated(
        {
            "attitude": Samples(samples.attitude.time, attitude.as_quat(scalar_first=True)),
            "position": Samples(samples.position.time, TURN.apply(samples.position.value)),
        }
    )
    first, second = (
        identify(craft, data, sensors=suite, estimator="trajectory_fit")
        for data in (samples, turned)
    )
    assert first.converged
    assert second.converged
    sigma = np.sqrt(np.diag(first.covariance))
    np.testing.assert_array_less(np.abs(second.parameters - first.parameters), 0.01 * sigma)
    np.testing.assert_allclose(np.sqrt(np.diag(second.covariance)), sigma, rtol=0.01)
