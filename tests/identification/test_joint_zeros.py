"""Large errors of the joints' zeros: the fit is linear in them about their estimates."""

import numpy as np
from sensing_cases import MOMENTUM, Sines, coarse_suite, measured

from cpid_drake import identify
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.logs.log import Samples
from cpid_drake.sensors.sensors import JointSensor

ZEROS = np.array([0.012, -0.008, 0.01, 0.0])  # the last one is a turn of the capture frame
SUITE = coarse_suite(encoders=JointSensor(20.0, 1e-5, zero_mrad=10.0))


def test_the_target_is_found(craft, skewed_target):
    """A model that is linear about zero, or about an early estimate, would be wrong by many σ."""
    motion = Sines.drawn(4, seed=101, duration=8.0, size=0.6)
    exact = measured(craft, motion, skewed_target, SUITE, MOMENTUM)
    encoders = exact.encoders
    log = exact.updated({"encoders": Samples(encoders.time, encoders.value + ZEROS)})
    found = identify(craft, log, sensors=SUITE, momentum=TotalMomentum.unknown())
    error = found.parameters - skewed_target.to_vector()
    assert found.failures == ()
    assert error @ np.linalg.solve(found.covariance, error) < 0.02
