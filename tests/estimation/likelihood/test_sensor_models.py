"""Residuals of the base's sensors: signs, frames and units, by errors of known size."""

from dataclasses import replace

import numpy as np
import pytest
from block_cases import added_sensors, make_case, rich_suite
from scipy.spatial.transform import Rotation
from sensing_cases import MOMENTUM

from cpid_drake.estimation.likelihood.joint_motion import joint_block
from cpid_drake.estimation.likelihood.model import BlockModel
from cpid_drake.sensing.measurements import Samples
from cpid_drake.sensing.sensors import JointSensor

START, END = 1.0, 2.0


@pytest.fixture(scope="module")
def case(tmp_path_factory, skewed_target):
    with added_sensors():
        suite = replace(rich_suite(), encoders=JointSensor(50.0), joint_rates=None)
        yield make_case(tmp_path_factory.mktemp("craft"), skewed_target, suite, MOMENTUM, 3.0)


def model_of(case, changes=None):
    samples = case.block(START, END).samples.updated(changes or {})
    joints = joint_block(START, END, samples, case.suite, None)
    return BlockModel(case.craft.tree, joints, samples, case.suite)


@pytest.fixture(scope="module")
def trajectory(case):
    """The true motion, with zero bias at both nodes of one gyro and the node of the other."""
    state = replace(case.state(START), bias=np.zeros((3, 3)))
    return lambda model, **changes: model.motion.trajectory(replace(state, **changes))


ERROR = np.array([0.3, -0.2, 0.5])


@pytest.mark.parametrize("name", ["gyro", "gyro_2", "position", "velocity"])
def test_the_residual_is_the_error_of_the_sample_in_sigma(case, trajectory, name):
    """Measured minus predicted, of every sample with its own sensor's σ."""
    samples = case.block(START, END).samples[name]
    sigma = case.suite.sigmas(name)
    wrong = Samples(samples.time, samples.value + ERROR * sigma)
    model = model_of(case, {name: wrong})
    rest = model.sensors[name].residuals(trajectory(model))
    assert len(rest) == len(samples)
    np.testing.assert_allclose(rest, np.tile(ERROR, (len(rest), 1)), atol=0.02)


@pytest.mark.parametrize("name", ["attitude", "tracker_2"])
def test_attitude_errors_are_about_the_boresight_frame(case, trajectory, name):
    """As the simulation of noise makes them: R_WB exp(R_BS error), each axis in its own σ."""
    samples, errors = case.block(START, END).samples[name], case.suite[name]
    sigma = case.suite.sigmas(name)
    assert len(set(sigma)) > 1  # cross and about the boresight
    turn = Rotation.from_rotvec(errors.R_BS @ (ERROR * sigma))
    measured = Rotation.from_quat(samples.value, scalar_first=True) * turn
    wrong = Samples(samples.time, measured.as_quat(scalar_first=True))
    model = model_of(case, {name: wrong})
    rest = model.sensors[name].residuals(trajectory(model))
    np.testing.assert_allclose(rest, np.tile(ERROR, (len(rest), 1)), atol=0.02)


def test_the_sign_of_a_quaternion_means_nothing(case, trajectory):
    samples = case.block(START, END).samples.attitude
    model, other = (
        model_of(case),
        model_of(case, {"attitude": replace(samples, value=-samples.value)}),
    )
    np.testing.assert_allclose(
        other.sensors["attitude"].residuals(trajectory(other)),
        model.sensors["attitude"].residuals(trajectory(model)),
        atol=1e-9,
    )


def test_each_gyro_has_its_own_bias(case, trajectory):
    """The residual of one falls linearly between its nodes, the other's by a constant."""
    model = model_of(case)
    bias = 1e-5 * np.array([[0.0, 0, 0], [1.0, 0, 0], [0.0, 0, 2.0]])
    biased, plain = trajectory(model, bias=bias), trajectory(model)
    first, second = (
        model.sensors[name].residuals(biased) - model.sensors[name].residuals(plain)
        for name in ("gyro", "gyro_2")
    )
    share = (model.sensors["gyro"].samples.time - START) / (END - START)
    np.testing.assert_allclose(first[:, 0], -1e-5 * share / model.sensors["gyro"].sigmas[0])
    np.testing.assert_allclose(second[:, 2], -2e-5 / model.sensors["gyro_2"].sigmas[0])
    assert not first[:, 1:].any()
    assert not second[:, :2].any()


def test_position_moves_with_the_centre_of_mass(case, trajectory):
    """By the velocity times the time since the block's start."""
    model = model_of(case)
    state = case.state(START)
    faster = trajectory(model, v_Wcm=state.v_Wcm + [0.0, 0.01, 0.0])
    change = {
        name: model.sensors[name].residuals(faster)
        - model.sensors[name].residuals(trajectory(model))
        for name in ("position", "velocity", "attitude", "gyro")
    }
    elapsed = model.sensors["position"].samples.time - START
    np.testing.assert_allclose(change["position"][:, 1], -0.01 * elapsed / 1e-3, rtol=1e-6)
    np.testing.assert_allclose(change["velocity"][:, 1], -0.01 / 1e-3, rtol=1e-6)
    assert not change["attitude"].any()
    assert not change["gyro"].any()
