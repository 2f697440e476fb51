"""Where a fit starts: near the truth, from the gyro or from the attitude alone."""

from dataclasses import replace

import numpy as np
import pytest
from block_cases import make_case
from scipy.spatial.transform import Rotation
from sensing_cases import MOMENTUM, coarse_suite, measured

from cpid_drake.dynamics.parameterizations import relative_parameterization
from cpid_drake.estimation.log_state import LogState
from cpid_drake.estimation.roll import roll
from cpid_drake.estimation.start import start_of, state_of
from cpid_drake.estimation.unknowns import PSI, Model
from cpid_drake.files.errors import InputError
from cpid_drake.logs.log import Samples
from cpid_drake.sensors.sensors import AttitudeSensor, Gyro, JointSensor

SUITES = {
    "gyro": coarse_suite(),
    "attitude": coarse_suite(gyro=None, attitude=AttitudeSensor(20.0, 5.0, 5.0)),
}


def test_a_late_first_attitude_is_predicted_back(tmp_path, skewed_target):
    """The base turns by 0.1 rad before the star tracker sees it."""
    case = make_case(tmp_path, skewed_target, SUITES["gyro"], MOMENTUM, 3.0)
    attitude = case.samples.attitude
    late = case.samples.updated({"attitude": attitude.where(attitude.time > 0.3)})
    model = Model(case.craft.tree, case.suite)
    _, (log,) = start_of(model, [LogState.of(model, late)])
    turn = (log.starts[0].attitude * case.state(0.0).attitude.inv()).magnitude()
    q = late.attitude.value[0]
    unseen = Rotation.from_quat(q, scalar_first=True) * case.state(0.0).attitude.inv()
    assert unseen.magnitude() > 0.1
    assert turn < 0.2 * unseen.magnitude()


@pytest.mark.parametrize("late", [-0.6, -0.3, 0.3, 0.6])
def test_a_wrong_clock_is_no_obstacle(tmp_path, skewed_target, late):
    """Rows of a gyro with wrong stamps fit an impossible body best; no motion follows from one."""
    case = make_case(tmp_path, skewed_target, SUITES["gyro"], MOMENTUM, 4.0)
    gyro = Samples(case.samples.gyro.time + late, case.samples.gyro.value)
    model = Model(case.craft.tree, case.suite)
    samples = case.samples.updated({"gyro": gyro.where(gyro.time > 0.0)})
    values, [log] = start_of(model, [LogState.of(model, samples)])
    assert np.isfinite(roll(model, log, values).cost(model, log))


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
    assert np.linalg.norm(log.starts[0].L - expected.L) < 0.02 * np.linalg.norm(expected.L)
    assert (log.starts[0].attitude * expected.attitude.inv()).magnitude() < 1e-6


@pytest.mark.parametrize("is_open", [False, True])
def test_fast_joints_are_no_noise(tmp_path, skewed_target, is_open):
    """At 1 and 2.3 Hz, of which a gyro of 100 Hz tells; also if the momentum may change."""
    suite = coarse_suite(gyro=Gyro(100.0), encoders=JointSensor(100.0, 1e-5))
    case = make_case(tmp_path, skewed_target, suite, MOMENTUM, 8.0)
    fast = replace(case.motion, frequency=10.0 * case.motion.frequency)
    samples = measured(case.craft, fast, skewed_target, case.suite, MOMENTUM)
    model = Model(case.craft.tree, case.suite)
    log = LogState.of(model, samples)
    values, _ = start_of(model, [log.opened(range(len(log.blocks) - 1)) if is_open else log])
    error = relative_parameterization(model.mass).to_parameters(values[PSI])
    error -= skewed_target.to_vector()
    size = np.repeat([skewed_target.mass, 0.5, np.trace(skewed_target.I_TTcm_C)], [1, 3, 6])
    assert np.abs(error / size).max() < 0.1


def test_a_block_without_attitudes_has_no_start(tmp_path, skewed_target):
    case = make_case(tmp_path, skewed_target, SUITES["gyro"], MOMENTUM, 3.0)
    attitude = case.samples.attitude
    model = Model(case.craft.tree, case.suite)
    log = LogState.of(model, case.samples.updated({"attitude": attitude.where(attitude.time < 1)}))
    with pytest.raises(InputError, match="no attitude samples"):
        state_of(model, log.part(2, 3), model.unknown(PSI).mean)
