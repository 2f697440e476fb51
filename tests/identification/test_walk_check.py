"""Steps of what walks are as large as their random walk says."""

import numpy as np
import pytest
from block_cases import make_case
from sensing_cases import coarse_suite

from cpid_drake.estimation.fit import fit
from cpid_drake.estimation.log_state import LogState
from cpid_drake.estimation.unknowns import Model
from cpid_drake.identification.walk_check import walk_checks, walks_of
from cpid_drake.logs.simulated_noise import add_noise
from cpid_drake.sensors.sensors import Gyro, JointSensor

SUITE = coarse_suite(gyro=Gyro(20.0, 0.005, 1.0, 50.0), encoders=JointSensor(8.0, 1e-5))
"""A bias that walks far between blocks of 2.5 s."""


@pytest.fixture(scope="module")
def fitted(tmp_path_factory, skewed_target):
    """Return a function from true sensors and a seed to the fit of a log with `SUITE`."""
    case = make_case(tmp_path_factory.mktemp("craft"), skewed_target, SUITE, None, 40.0)
    model = Model(case.craft.tree, SUITE)
    return lambda true, seed: fit(model, [LogState.of(model, add_noise(true, case.samples, seed))])


def test_steps_as_stated_pass_and_are_as_large_as_their_mean(fitted):
    """Smoothed steps are smaller than true ones, by what the samples do not show."""
    ratios = []
    for seed in range(4):
        found = fitted(SUITE, seed)
        [walk] = walks_of(found)
        assert found.logs[0].interval(1) == pytest.approx(2.5)
        assert walk.mean > 10
        ratios.append(walk.square / walk.mean)
        assert all(check.passed for check in walk_checks(found))
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.3)
