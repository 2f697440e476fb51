"""The likelihood in an orbit: against an integration of the momentum, and finite differences."""

from dataclasses import replace

import numpy as np
import pytest
from block_cases import (
    STEPS,
    added_sensors,
    check_derivatives,
    fired,
    make_case,
    rich_suite,
    trial_of,
)
from sensing_cases import MOMENTUM

from cpid_drake import identify
from cpid_drake.dynamics.orbit import Orbit
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.estimation.likelihood.joint_motion import joint_block
from cpid_drake.estimation.likelihood.model import BlockModel
from cpid_drake.sensing.disturbances import Disturbances
from cpid_drake.sensing.sensors import JointSensor
from cpid_drake.studies.trials import base_trajectory

START, END = 1.0, 2.5
ORBIT = Orbit(rate=0.03, nadir_W=np.array([0.6, 0.0, -0.8]), normal_W=np.array([0.8, 0.0, 0.6]))


@pytest.fixture(scope="module", autouse=True)
def sensors():
    with added_sensors():
        yield


@pytest.fixture(scope="module", params=[None, MOMENTUM], ids=["at rest", "tumbling"])
def case(request, tmp_path_factory, skewed_target):
    """Sensors of the joints are exact; a base far from W's origin has a large tide."""
    suite = replace(
        rich_suite(),
        encoders=JointSensor(50.0),
        joint_rates=None,
        disturbances=Disturbances(orbit=ORBIT),
    )
    folder = tmp_path_factory.mktemp("craft")
    case = make_case(folder, skewed_target, suite, request.param)
    return replace(case, samples=fired(case))


def truth(case, time):
    """Return the true state at a time: momentum and pose are integrated together."""
    times = np.array([0.0, time, case.motion.duration])
    base = base_trajectory(trial_of(case), case.craft.tree, times)
    telemetry = base.to_telemetry(case.craft.joint_names, times, case.motion)
    return case.state_of(telemetry.select(slice(1, 2)))


def model_of(case, orbit=ORBIT):
    samples = case.block(START, END).samples
    suite = replace(case.suite, disturbances=Disturbances(orbit=orbit))
    joints = joint_block(START, END, samples, case.suite, None)
    return BlockModel(case.craft.tree, joints, samples, suite, None, 0.0125)


def test_the_predictions_are_the_simulated_readings(case):
    """In the orbit; and without it they are far off."""
    state = replace(truth(case, START), bias=np.zeros((3, 3)))
    for orbit, low, high in ((ORBIT, 0.0, 5e-3), (None, 0.5, np.inf)):
        model = model_of(case, orbit)
        worst = np.abs(model.residuals(model.motion.trajectory(state))).max()
        assert low <= worst < high


def test_the_end_of_a_block_is_the_true_state(case):
    model = model_of(case)
    state = replace(truth(case, START), bias=np.zeros((3, 3)))
    end, expected = model.motion.end(model.motion.trajectory(state)), truth(case, END)
    assert (end.attitude.inv() * expected.attitude).magnitude() < 1e-8
    for name in ("p_Wcm", "v_Wcm", "L"):
        value = getattr(end, name)
        np.testing.assert_allclose(value, getattr(expected, name), rtol=0, atol=2e-7, err_msg=name)


def test_derivatives_of_readings_and_of_the_end(case):
    """The change by momentum and gravity gradient is integrated by the trapezoidal rule."""
    state = replace(truth(case, START), bias=np.zeros((3, 3)))
    check_derivatives(model_of(case), state, STEPS, drift=1e-6)


def test_a_fit_finds_the_target_in_the_orbit(case):
    """The gravity gradient is no unknown force."""
    options = {"momentum": TotalMomentum.unknown(), "is_final": False}
    found = identify(case.craft, case.samples, sensors=case.suite, **options)
    error = np.abs(found.parameters - case.target.to_vector())
    assert np.all(error < 0.1 * np.sqrt(np.diag(found.covariance)))
    assert found.misfit == 1.0
