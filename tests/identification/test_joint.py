"""One target from several logs: together they know more, and a log of another target is named."""

from dataclasses import replace

import numpy as np
import pytest
from dense_problem import Dense
from scipy.stats import chi2
from sensing_cases import (
    MOMENTUM,
    Sines,
    coarse_suite,
    log_of,
    measured,
    true_telemetry,
)

from cpid_drake import InertialParameters, TotalMomentum, identify
from cpid_drake.dynamics.uncertainty import BodyUncertainty
from cpid_drake.identification.identify import identify_together
from cpid_drake.identification.target_prior import TargetPrior
from cpid_drake.logs.simulated_noise import add_noise
from cpid_drake.sensors.sensors import AttitudeSensor, Gyro, JointSensor, VectorSensor

POOR = {
    "attitude": AttitudeSensor(5.0, 200.0, 1600.0, np.array([0.0, 0.6, 0.8])),
    "gyro": Gyro(20.0, 0.3, 60.0, 6.0),
    "position": VectorSensor(5.0, 2e-2),
}
"""Sensors that do not see the base's slow turning about the axes that no joint turns about."""

DURATION = 5.0
TIMES = np.arange(0.0, DURATION, 0.05)


@pytest.fixture(scope="module")
def suite():
    return coarse_suite()


@pytest.fixture(scope="module")
def logs(craft, suite, skewed_target):
    """Three logs of one target; the second one has momentum."""
    samples = {}
    for k, momentum_W in enumerate((None, MOMENTUM, None)):
        motion = Sines.drawn(4, 101 + k, DURATION, 0.6)
        exact = measured(craft, motion, skewed_target, suite, momentum_W=momentum_W)
        samples[f"log {k}"] = add_noise(suite, exact, seed=k)
    return samples


def sigmas(found):
    return np.sqrt(np.diag(found.covariance))


def nees(found, target):
    error = found.parameters - target.to_vector()
    return error @ np.linalg.solve(found.covariance, error)


def turned(craft, joints, seed):
    """Return exact states of a motion of some joints only."""
    motion = Sines.drawn(4, seed, DURATION, 0.6)
    amplitude = np.zeros_like(motion.amplitude)
    amplitude[:, joints] = motion.amplitude[:, joints]
    return replace(motion, amplitude=amplitude)


@pytest.mark.slow
class TestSeveralLogs:
    @pytest.fixture(scope="class")
    @classmethod
    def joint(cls, craft, suite, logs):
        return identify_together(craft, logs, sensors=suite)

    def test_each_log_has_its_own_momentum(self, joint, skewed_target):
        assert joint.passed
        assert joint.momentum == "unknown"
        assert nees(joint, skewed_target) < 35

    def test_together_they_know_more_than_each(self, joint, craft, suite, logs):
        alone = identify(craft, logs["log 0"], sensors=suite, estimator=joint.estimator)
        assert np.all(sigmas(joint) < sigmas(alone))
        assert joint.sample_count == sum(log.sample_count for log in joint.logs.values())
        own = joint.logs["log 0"].parameters
        assert np.all(np.abs(own - alone.parameters) < 0.1 * sigmas(alone))

    def test_logs_of_one_target_agree(self, joint):
        assert joint.check("agreement").statistic < chi2.isf(1e-3, 20)
        assert joint.check("agreement").limit == pytest.approx(chi2.isf(1e-4, 20))

    def test_the_order_of_the_logs_does_not_matter(self, joint, craft, suite, logs):
        backwards = dict(reversed(logs.items()))
        again = identify_together(craft, backwards, sensors=suite, estimator=joint.estimator)
        assert np.all(np.abs(again.parameters - joint.parameters) < 0.01 * sigmas(joint))
        np.testing.assert_allclose(sigmas(again), sigmas(joint), rtol=1e-3)


@pytest.fixture(scope="module")
def pair(craft, suite, skewed_target):
    """One motion with two draws of the noise."""
    samples = measured(craft, Sines.drawn(4, 101, DURATION, 0.6), skewed_target, suite)
    return {name: add_noise(suite, samples, seed) for seed, name in enumerate("ab")}


def test_errors_of_the_spacecraft_limit_logs_together(craft, skewed_target):
    """Logs with different motions know no more than one dense problem of both, and little less.

    The noise averages, and the errors of the spacecraft, which both logs share, do not.
    """
    uncertainty = BodyUncertainty(com=2e-3)
    suite = coarse_suite(gyro=Gyro(5.0, 0.005, 1.0), encoders=JointSensor(20.0, 1e-7))
    logs, information = {}, np.diag(np.append(np.zeros(10), np.ones(15)))
    for seed in (101, 102):
        motion = Sines.drawn(4, seed, 3.0, 0.6)
        logs[str(seed)] = samples = measured(craft, motion, skewed_target, suite)
        problem = Dense(craft, motion, suite, samples, bodies=uncertainty)
        information += problem.information(np.append(skewed_target.to_vector(), np.zeros(24)))
    dense = np.sqrt(np.diag(np.linalg.inv(information))[:10])
    options = {"momentum": TotalMomentum.zero(), "known_bodies": uncertainty}
    found = sigmas(identify_together(craft, logs, sensors=suite, **options))
    assert np.all(found > 0.98 * dense)
    assert np.median(found / dense) < 1.3


def test_a_target_that_slipped_by_less_than_the_grasp_is_known_is_noticed(
    craft, suite, skewed_target
):
    """The grasp is known to 5 mm, but its error is the same in both logs: 2 mm are 25 σ."""
    motion, logs = Sines.drawn(4, 101, 3.0, 0.6), {}
    for k, slip in enumerate((0.0, 2e-3)):
        com = skewed_target.p_CTcm_C + np.array([slip, 0.0, 0.0])
        target = InertialParameters(skewed_target.mass, com, skewed_target.I_TTcm_C)
        logs[f"log {k}"] = add_noise(suite, measured(craft, motion, target, suite), seed=k)
    options = {"momentum": TotalMomentum.unknown(), "known_bodies": BodyUncertainty(grasp_mm=5.0)}
    found = identify_together(craft, logs, sensors=suite, **options)
    assert not found.passed


@pytest.mark.slow
def test_errors_of_a_sensor_that_no_log_determines_do_not_average(craft, pair):
    """Zeros of the joints are errors of cz, and not of the mass."""
    plain = coarse_suite()
    zeros = coarse_suite(encoders=replace(plain["encoders"], zero_mrad=1.0))
    options = {"sensors": zeros, "momentum": TotalMomentum.zero()}
    alone = sigmas(identify(craft, pair["a"], **options))
    twice = sigmas(identify_together(craft, pair, **options))
    assert twice[3] > 0.95 * alone[3]
    assert twice[0] == pytest.approx(alone[0] / np.sqrt(2), rel=0.15)


@pytest.mark.slow
def test_a_log_without_motion_is_not_used(craft, suite, logs, skewed_target):
    still = measured(craft, Sines.drawn(4, 101, DURATION, 0.0), skewed_target, suite)
    both = {"log 0": logs["log 0"], "still": add_noise(suite, still, seed=3)}
    found = identify_together(craft, both, sensors=suite)
    assert "still determines nothing about the target, and was not used" in found.warnings
    assert found.logs["still"].rank == 0
    alone = identify(craft, logs["log 0"], sensors=suite)
    assert np.all(np.abs(found.parameters - alone.parameters) < 0.05 * sigmas(alone))


@pytest.mark.slow
def test_fits_that_leave_combinations_open_determine_all_together(craft, skewed_target):
    """Each log turns one joint, and so the target about one axis only."""
    suite, logs = coarse_suite(**POOR), {}
    for joint in (3, 0):
        samples = measured(craft, turned(craft, [joint], 100 + joint), skewed_target, suite)
        logs[f"joint {joint}"] = add_noise(suite, samples, seed=joint)
    found = identify_together(craft, logs, sensors=suite)
    assert max(log.rank for log in found.logs.values()) < 10
    assert found.rank == 10
    assert found.passed
    assert nees(found, skewed_target) < 35


class TestExactLogs:
    @pytest.fixture(scope="class")
    @classmethod
    def states(cls, craft, skewed_target):
        """Each of the first two logs turns one joint: the target turns about one axis only."""
        tree, names = craft.tree, craft.joint_names
        return {
            f"joint {j}": true_telemetry(
                tree, names, turned(craft, [j], 100 + j), skewed_target, TIMES
            )
            for j in (3, 0)
        }

    def test_a_log_without_positions_is_joined_by_relative_rows(self, craft, states):
        whole, other = (log_of(telemetry) for telemetry in states.values())
        kept = {n: s for n, s in other.samples.items() if n not in ("position", "velocity")}
        found = identify_together(craft, {"a": whole, "b": replace(other, samples=kept)})
        assert found.rows == "relative"
        assert found.rank == 10


class TestPrior:
    SIGMA = np.array([6.0, *3 * [0.05], *6 * [1.5]])

    def prior(self, target, shift=0.0):
        return TargetPrior(
            "the prior", target.to_vector() + shift * self.SIGMA, np.diag(self.SIGMA**2)
        )

    def test_a_vague_prior_changes_nothing(self, craft, suite, logs, skewed_target):
        log = logs["log 0"]
        options = {"sensors": suite, "estimator": "least_squares"}
        alone = identify(craft, log, **options)
        found = identify(craft, log, prior=self.prior(skewed_target, 0.5), **options)
        assert not found.dominated
        assert np.all(np.abs(found.parameters - alone.parameters) < 0.1 * sigmas(alone))
        np.testing.assert_allclose(sigmas(found), sigmas(alone), rtol=0.02)
        assert found.logs["the prior"].check("agreement").statistic < chi2.isf(0.01, 10)

    @pytest.mark.slow
    def test_a_prior_of_another_target_is_doubted(self, craft, suite, logs, skewed_target):
        prior = self.prior(skewed_target, 8.0)
        found = identify(craft, logs["log 0"], sensors=suite, prior=prior)
        assert "the logs and the prior do not have the same target" in found.failures[0]

    def test_a_known_mass_alone_is_a_prior(self, craft, suite, logs, skewed_target):
        parameters, covariance = np.full(10, np.nan), np.full((10, 10), np.nan)
        parameters[0], covariance[0, 0] = skewed_target.mass, 1e-8
        prior = TargetPrior("the scale", parameters, covariance)
        options = {"sensors": suite}
        alone = identify(craft, logs["log 0"], **options)
        found = identify(craft, logs["log 0"], prior=prior, **options)
        assert found.dominated[0] == "m"
        assert sigmas(found)[0] == pytest.approx(1e-4, rel=0.01)
        assert np.all(sigmas(found) <= 1.001 * sigmas(alone))
