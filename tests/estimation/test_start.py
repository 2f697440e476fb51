"""Where a fit starts: near the truth, from the gyro or from the attitude alone."""

import numpy as np
import pytest
from block_cases import make_case
from sensing_cases import MOMENTUM, coarse_suite

from cpid_drake.dynamics.parameterizations import relative_parameterization
from cpid_drake.estimation.log_state import LogState
from cpid_drake.estimation.start import start_of
from cpid_drake.estimation.unknowns import PSI, Model
from cpid_drake.sensing.sensors import AttitudeSensor

SUITES = {
    "gyro": coarse_suite(),
    "attitude": coarse_suite(gyro=None, attitude=AttitudeSensor(20.0, 5.0, 5.0)),
}


@pytest.mark.parametrize("name", SUITES)
def test_exact_samples_of_a_tumbling_capture_start_near_the_truth(tmp_path, skewed_target, name):
    """Within 2 % of the target's size and of its momentum."""
    case = make_case(tmp_path, skewed_target, SUITES[name], MOMENTUM, 3.0)
    model = Model(case.craft.tree, case.suite)
    values, (log,) = start_of(model, [LogState.of(model, case.samples)])
    expected = case.state(0.0)
    error = relative_parameterization(model.mass).to_parameters(values[PSI])
    error -= skewed_target.to_vector()
    size = np.repeat([skewed_target.mass, 0.5, np.trace(skewed_target.I_TTcm_C)], [1, 3, 6])
    assert np.abs(error / size).max() < 0.02
    assert np.linalg.norm(log.start.L - expected.L) < 0.02 * np.linalg.norm(expected.L)
    assert (log.start.attitude * expected.attitude.inv()).magnitude() < 1e-6
