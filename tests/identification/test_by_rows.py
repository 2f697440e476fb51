"""Rows of exact and of rounded states, and what is said of rows with noise inside."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2
from sensing_cases import Sines, measured, nees

from cpid_drake import (
    Motion,
    identify,
    load_scenario,
    load_sensors,
    make_simulation,
    shipped_scenario,
)
from cpid_drake.dynamics.body_dynamics import BodyDynamics
from cpid_drake.dynamics.parameterizations import standard_to_relative
from cpid_drake.dynamics.rotations import rotate
from cpid_drake.dynamics.rows import RELATIVE_ROWS
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.estimation.momentum_rows import changed_motion
from cpid_drake.estimation.rows_fit import LogRows
from cpid_drake.logs.simulated_noise import add_noise
from cpid_drake.sensors.disturbances import Disturbances

SAMPLES = 4000


def states(craft, target, seed) -> Motion:
    """Return random states of zero momentum."""
    rng, zeros = np.random.default_rng(seed), np.zeros((SAMPLES, 3))
    q, qdot = rng.uniform(-2.0, 2.0, (SAMPLES, 4)), 0.3 * rng.normal(size=(SAMPLES, 4))
    psi = standard_to_relative(target.to_standard_vector(), craft.mass)
    twist = BodyDynamics.at(craft.tree, q, qdot).base_twist(psi)
    attitude = Rotation.random(SAMPLES, rng)
    w_WB, v_WB = (rotate(attitude.as_matrix(), part) for part in twist)
    return Motion(
        craft.joint_names,
        np.arange(SAMPLES, dtype=float),
        quaternion_WB=attitude.as_quat(scalar_first=True),
        p_WB=zeros,
        w_WB=w_WB,
        v_WB=v_WB,
        q=q,
        qdot=qdot,
    )


def rounded(exact: Motion, decimals: int) -> Motion:
    """Return states with rounded velocities of the base."""
    return replace(exact, w_WB=np.round(exact.w_WB, decimals), v_WB=np.round(exact.v_WB, decimals))


@pytest.fixture(scope="module")
def noisy(craft, suite, skewed_target):
    """Return a function (seed, momentum) -> samples of a motion of its own."""

    def make(seed, momentum_W=None):
        motion = Sines.drawn(4, 101 + seed, 5.0, 0.6)
        return add_noise(suite, measured(craft, motion, skewed_target, suite, momentum_W), seed)

    return make


@pytest.mark.parametrize("rows", ["standard", "relative", "eq18"])
def test_rows_of_a_measured_log_pass_only_if_noise_does_not_bias_them(
    craft, suite, noisy, skewed_target, rows
):
    """Noise inside of the rows is a bias, which their residuals do not show."""
    for seed in range(3):
        found = identify(craft, noisy(seed), rows=rows, sensors=suite)
        assert found.check("bias by noise in rows") is not None
        assert not found.passed or nees(found, skewed_target) < 40


def test_the_bias_of_rows_is_that_of_many_draws_of_the_noise(craft, skewed_target):
    """Attitudes, rates and joints with noise, and the rows of many draws of it."""
    motion = Sines.drawn(4, 3, 6.0)
    exact = craft.predicted_motion(skewed_target, motion, np.linspace(0.0, 6.0, 61))
    sigma = np.repeat([0.0, 3e-3, 0.0, 0.0, 2e-3, 2e-3], [3, 3, 3, 3, 4, 4])
    draws, biases, rng = [], [], np.random.default_rng(8)
    for _ in range(400):
        changes = sigma * rng.standard_normal((len(exact), len(sigma)))
        rows = LogRows(craft.tree, RELATIVE_ROWS, TotalMomentum.zero())
        rows.add(changed_motion(exact, changes), np.diag(sigma**2)[None])
        draws.append(rows.best())
        biases.append(rows.bias(rows.best()))
    truth = RELATIVE_ROWS.parameterization(craft.mass).from_parameters(skewed_target.to_vector())
    mean, scatter = np.mean(draws, axis=0), np.std(draws, axis=0) / np.sqrt(len(draws))
    far = np.abs(mean - truth) > 10 * scatter  # unknowns that noise moves
    assert far.any()
    np.testing.assert_allclose(np.mean(biases, axis=0)[far], (mean - truth)[far], rtol=0.15)


def test_errors_of_rounded_states_have_no_bias_and_the_size_of_the_covariance(craft, skewed_target):
    """The mean error of several runs is no larger than their scatter explains."""
    count, total, errors = 10, 0.0, []
    for seed in range(count):
        found = identify(craft, rounded(states(craft, skewed_target, seed), 3), rows="standard")
        assert not found.failures
        assert found.momentum == "zero"
        total += nees(found, skewed_target)
        errors.append(found.parameters - skewed_target.to_vector())
    assert total < chi2.ppf(0.999, 10 * count)
    scatter = np.std(errors, axis=0, ddof=1) / np.sqrt(count)
    assert np.all(np.abs(np.mean(errors, axis=0)) < 5 * scatter)


def test_rows_cannot_explain_declared_forces(craft, suite, noisy):
    pushed = replace(suite, disturbances=Disturbances(acceleration_noise=1e-4))
    found = identify(craft, noisy(0), rows="standard", sensors=pushed)
    assert "rows assume a constant momentum" in found.failures[0]


@pytest.mark.parametrize("joint", [0, pytest.param(3, marks=pytest.mark.slow)])
def test_a_joint_that_turns_back_and_less_far_misses_the_samples_by_more_than_their_errors(joint):
    """The samples of each sensor show how large their errors are: noise is no excuse."""
    simulation = make_simulation(load_scenario(shipped_scenario("exciting_motion")))
    craft, motion, flight = (
        simulation.spacecraft,
        simulation.joint_motion,
        load_sensors("flight", unstated="exact"),
    )
    samples = add_noise(flight, measured(craft, motion, simulation.truth, flight), 0)
    signs = np.where(np.arange(len(craft.joint_names)) == joint, -0.6, 1.0)
    wrong = replace(samples.encoders, value=signs * samples.encoders.value)
    for encoders, passes in ((samples.encoders, True), (wrong, False)):
        log = samples.updated({"encoders": encoders})
        found = identify(craft, log, rows="standard", sensors=flight)
        assert found.check("conservation of momentum").passed == passes


def test_a_target_that_slips_at_half_time_is_not_that_of_the_first_half(craft, skewed_target):
    """Also in a log of more samples than are made rows of at once."""
    moved = replace(skewed_target, p_CTcm_C=np.array(skewed_target.p_CTcm_C) + [1e-3, 0, 0])
    first, last = (rounded(states(craft, each, 0), 4) for each in (skewed_target, moved))
    half = np.arange(SAMPLES) < SAMPLES // 2
    found = [
        identify(
            craft,
            replace(
                first,
                w_WB=np.where(half[:, None], first.w_WB, each.w_WB),
                v_WB=np.where(half[:, None], first.v_WB, each.v_WB),
            ),
            rows="standard",
        )
        for each in (first, last)
    ]
    assert [each.check("halves").passed for each in found] == [True, False]
