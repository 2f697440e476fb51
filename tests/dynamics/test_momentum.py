"""Eqs. 4-9 against Drake, and the base motion that conserves momentum."""

import numpy as np

from cpid_drake.dynamics.momentum import (
    momentum_samples,
    target_momentum,
)


def test_target_momentum_is_linear_in_the_standard_vector(servicer, random_motion):
    """The same motion, two targets: momenta add as the standard vectors do."""
    from cpid_drake import InertialParameters

    motion = momentum_samples(servicer.tree, random_motion(5, seed=28)).motion
    a = InertialParameters(3.0, [0.1, 0.2, 0.3], np.diag([1.0, 2.0, 1.5]))
    b = InertialParameters(5.0, [-0.3, 0.1, 0.0], np.diag([4.0, 3.0, 2.0]))
    both = InertialParameters.from_standard_vector(a.to_standard_vector() + b.to_standard_vector())
    for part in range(2):
        summed = target_momentum(a, motion)[part] + target_momentum(b, motion)[part]
        np.testing.assert_allclose(target_momentum(both, motion)[part], summed, atol=1e-12)
