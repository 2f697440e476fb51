"""Rows with noise inside: the errors are those that the covariance says, or a check fails."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2
from sensing_cases import MOMENTUM, Sines, log_of, measured, nees, sigmas, true_telemetry

from cpid_drake import (
    Motion,
    TotalMomentum,
    identify,
    load_scenario,
    load_sensors,
    make_simulation,
    shipped_scenario,
)
from cpid_drake.dynamics.body_dynamics import BodyDynamics
from cpid_drake.dynamics.parameterizations import standard_to_relative
from cpid_drake.dynamics.rotations import rotate
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


@pytest.mark.parametrize("rows", ["standard", "relative"])
def test_errors_of_smoothed_samples_are_no_larger_than_the_covariance_says(
    craft, suite, noisy, skewed_target, rows
):
    count, total = 8, 0.0
    for seed in range(count):
        log = noisy(seed, MOMENTUM if seed % 2 else None)
        found = identify(craft, log, rows=rows, sensors=suite)
        assert not found.failures
        assert found.momentum == ("unknown" if seed % 2 else "zero")
        total += nees(found, skewed_target)
    assert total < chi2.ppf(0.999, 10 * count)


def test_errors_of_rounded_states_have_no_bias_and_the_size_of_the_covariance(craft, skewed_target):
    """The mean error of several runs is no larger than their scatter explains."""
    count, total, errors = 10, 0.0, []
    for seed in range(count):
        found = identify(craft, rounded(states(craft, skewed_target, seed), 2), rows="standard")
        assert not found.failures
        assert found.momentum == "zero"
        total += nees(found, skewed_target)
        errors.append(found.parameters - skewed_target.to_vector())
    assert total < chi2.ppf(0.999, 10 * count)
    scatter = np.std(errors, axis=0, ddof=1) / np.sqrt(count)
    assert np.all(np.abs(np.mean(errors, axis=0)) < 5 * scatter)


def test_rows_of_other_units_do_not_widen_the_interval_of_a_mass(craft, skewed_target):
    """1/m is in the linear rows of Eq. 18 only, whose errors are small beside the angular ones."""
    motion, errors = Sines.drawn(4, seed=101, duration=8.0, size=0.6), []
    for phase in np.linspace(0.0, 0.09, 10):
        times = np.arange(phase, 8.0, 0.1)
        exact = true_telemetry(craft.tree, craft.joint_names, motion, skewed_target, times)
        found = identify(craft, log_of(exact, decimals=4), rows="eq18")
        errors.append((found.parameters[0] - skewed_target.mass) / sigmas(found)[0])
    assert 0.3 < np.sqrt(np.mean(np.square(errors))) < 2.0


@pytest.mark.parametrize("seed", range(3))
def test_a_mass_that_the_noise_hides_from_eq18_is_not_known(craft, suite, noisy, seed):
    """Slopes of a few positions say nothing about 1/m, whose plausible size is that of 1/m."""
    found = identify(craft, noisy(seed), rows="eq18", sensors=suite)
    assert not np.isfinite(found.parameters[0])
    assert found.rank < 10


@pytest.mark.parametrize(("samples", "rank"), [(1, 6), (2, 9), (3, 10)])
@pytest.mark.parametrize("rows", ["eq18", "standard"])
def test_three_exact_samples_determine_what_two_do_not(
    servicer, zero_momentum_motion, skewed_target, rows, samples, rank
):
    motion = zero_momentum_motion(skewed_target, samples, 1)
    assert identify(servicer, motion, rows=rows).rank == rank


class TestMomentum:
    def test_a_given_zero_that_the_samples_contradict_is_a_failed_check(self, craft, suite, noisy):
        options = {"rows": "standard", "sensors": suite, "momentum": TotalMomentum.zero()}
        found = identify(craft, noisy(1, MOMENTUM), **options)
        assert "identify with --momentum unknown" in found.failures[0]

    @pytest.mark.parametrize(("rows", "size"), [("standard", 1e-4), ("relative", 3e-5)])
    def test_one_too_small_to_be_seen_is_within_the_covariance(
        self, craft, suite, noisy, skewed_target, rows, size
    ):
        """A target with zero momentum is known better than the momentum: it would be 12 σ off."""
        count, total = 6, 0.0
        for seed in range(count):
            found = identify(craft, noisy(seed, size * MOMENTUM), rows=rows, sensors=suite)
            total += nees(found, skewed_target)
        assert total < chi2.ppf(0.999, 10 * count)


def test_rows_cannot_explain_declared_forces(craft, suite, noisy):
    pushed = replace(suite, disturbances=Disturbances(acceleration_noise=1e-4))
    found = identify(craft, noisy(0), rows="standard", sensors=pushed)
    assert "rows assume a constant momentum" in found.failures[0]


@pytest.mark.parametrize("joint", [0, 3])
def test_a_joint_of_the_wrong_sign_misses_the_samples_by_more_than_their_errors(joint):
    """The samples of each sensor show how large their errors are: noise is no excuse."""
    simulation = make_simulation(load_scenario(shipped_scenario("exciting_motion")))
    craft, motion, flight = simulation.spacecraft, simulation.joint_motion, load_sensors("flight")
    samples = add_noise(flight, measured(craft, motion, simulation.truth, flight), 0)
    signs = np.where(np.arange(len(craft.joint_names)) == joint, -1.0, 1.0)
    wrong = replace(samples.encoders, value=signs * samples.encoders.value)
    for encoders, passes in ((samples.encoders, True), (wrong, False)):
        log = samples.updated({"encoders": encoders})
        found = identify(craft, log, rows="standard", sensors=flight)
        assert found.check("misfit").passed == passes
