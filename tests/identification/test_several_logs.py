"""One target from several logs and priors: they agree, or the one that differs is named."""

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
    nees,
    sigmas,
    true_telemetry,
)

from cpid_drake import InertialParameters, TargetPrior, TotalMomentum, identify, load_sensors
from cpid_drake.dynamics.uncertainty import BodyUncertainty
from cpid_drake.identification.result_files import read_result, write_result
from cpid_drake.logs.simulated_noise import add_noise
from cpid_drake.sensors.sensors import AttitudeSensor, Gyro, JointSensor, VectorSensor

DURATION = 5.0
TIMES = np.arange(0.0, DURATION, 0.05)
ROWS = {"rows": "standard"}


@pytest.fixture(scope="module")
def noisy(craft, suite, skewed_target):
    """Return a function (seed, momentum, target, size) -> samples of a motion of its own."""

    def make(seed, momentum_W=None, target=skewed_target, size=0.6):
        motion = Sines.drawn(4, 101 + seed, DURATION, size)
        exact = measured(craft, motion, target, suite, momentum_W=momentum_W)
        return add_noise(suite, exact, seed=seed)

    return make


@pytest.fixture(scope="module")
def logs(noisy):
    """Three logs of one target; the second one has momentum."""
    return {f"log {k}": noisy(k, MOMENTUM if k == 1 else None) for k in range(3)}


def turned(craft, joint):
    """Return a motion of one joint only, which turns the target about one axis only."""
    motion = Sines.drawn(4, 100 + joint, DURATION, 0.6)
    amplitude = np.zeros_like(motion.amplitude)
    amplitude[:, joint] = motion.amplitude[:, joint]
    return replace(motion, amplitude=amplitude)


class TestNoisyLogs:
    @pytest.fixture(scope="class")
    @classmethod
    def joint(cls, craft, suite, logs):
        return identify(craft, logs, sensors=suite)

    def test_each_has_its_own_momentum_and_all_agree(self, joint, skewed_target):
        found = joint
        assert found.passed
        assert found.momentum == "unknown"
        assert nees(found, skewed_target) < chi2.isf(1e-3, 10)
        assert found.check("agreement").statistic < chi2.isf(1e-3, 20)
        assert found.check("agreement").limit == pytest.approx(chi2.isf(1e-4, 20))
        for log in found.logs.values():
            assert log.check("agreement").statistic < chi2.isf(1e-3, 10)

    def test_together_they_know_more_than_each(self, joint, craft, suite, logs):
        found, alone = joint, identify(craft, logs["log 0"], sensors=suite)
        assert np.all(sigmas(found) < sigmas(alone))
        assert found.sample_count == sum(log.sample_count for log in found.logs.values())
        own = found.logs["log 0"].parameters
        assert np.all(np.abs(own - alone.parameters) < 0.1 * sigmas(alone))

    def test_one_without_motion_is_not_used(self, craft, suite, logs, noisy):
        both = {"log 0": logs["log 0"], "still": noisy(3, size=0.0)}
        found = identify(craft, both, sensors=suite)
        assert "still identifies nothing of the target, and was not used" in found.warnings
        assert found.logs["still"].rank == 0
        alone = identify(craft, logs["log 0"], sensors=suite)
        assert np.all(np.abs(found.parameters - alone.parameters) < 0.05 * sigmas(alone))

    def test_one_log_twice_has_twice_the_information(self, craft, suite, logs):
        log = logs["log 0"]
        alone, twice = (
            identify(craft, each, sensors=suite, **ROWS) for each in (log, {"a": log, "b": log})
        )
        np.testing.assert_allclose(twice.parameters, alone.parameters, rtol=1e-6, atol=1e-7)
        told = [np.linalg.inv(each.combinations.information) for each in (twice, alone)]
        np.testing.assert_allclose(2 * told[0], told[1], rtol=1e-6)
        assert twice.check("agreement").statistic < 1e-6

    def test_a_log_of_another_target_is_named(self, craft, suite, logs, noisy, skewed_target):
        other = InertialParameters(
            1.02 * skewed_target.mass, skewed_target.p_CTcm_C, skewed_target.I_TTcm_C
        )
        mixed = {**logs, "other": noisy(4, target=other)}
        found = identify(craft, mixed, sensors=suite, rows="relative")
        assert any("other differs from the rest, most in m: 61" in text for text in found.failures)

    def test_a_failed_check_of_one_log_is_one_of_all(self, craft, suite, logs):
        two, zero = {n: logs[n] for n in ("log 0", "log 1")}, TotalMomentum.zero()
        failures = identify(craft, two, sensors=suite, momentum=zero, **ROWS).failures
        assert any(failure.startswith("log 1: ") for failure in failures)
        assert not any(failure.startswith("log 0: ") for failure in failures)

    @pytest.mark.slow
    def test_fits_that_leave_combinations_open_determine_all_together(self, craft, skewed_target):
        """Poor sensors do not see the base's slow turning about the axes that no joint has."""
        poor = coarse_suite(
            attitude=AttitudeSensor(5.0, 800.0, 6400.0, np.array([0.0, 0.6, 0.8])),
            gyro=Gyro(20.0, 1.2, 240.0, 24.0),
            position=VectorSensor(5.0, 4e-2),
        )
        some = {
            str(j): add_noise(poor, measured(craft, turned(craft, j), skewed_target, poor), j)
            for j in (3, 0)
        }
        found = identify(craft, some, sensors=poor)
        assert max(log.rank for log in found.logs.values()) < 10
        assert found.rank == 10
        assert found.passed
        assert nees(found, skewed_target) < chi2.isf(1e-3, 10)


class TestErrorsInCommon:
    def test_those_of_the_spacecraft_limit_logs_together(self, craft, skewed_target):
        """Different motions know no more than one dense problem of both, and little less."""
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
        both = identify(craft, logs, sensors=suite, **options)
        found, least = sigmas(both), min(both.noise.values())  # the samples have no noise
        assert np.all(found > 0.98 * least * dense)
        assert np.median(found / dense) < 1.3

    def test_a_target_that_slipped_by_less_than_the_grasp_is_known_is_noticed(
        self, craft, suite, skewed_target
    ):
        """The grasp is known to 5 mm, but its error is the same in both logs: 2 mm are 25 σ."""
        motion, logs = Sines.drawn(4, 101, 3.0, 0.6), {}
        for k, slip in enumerate((0.0, 2e-3)):
            com = skewed_target.p_CTcm_C + np.array([slip, 0.0, 0.0])
            target = InertialParameters(skewed_target.mass, com, skewed_target.I_TTcm_C)
            logs[f"log {k}"] = add_noise(suite, measured(craft, motion, target, suite), seed=k)
        options = {"momentum": TotalMomentum.unknown(), "sensors": suite}
        found = identify(craft, logs, known_bodies=BodyUncertainty(grasp_mm=5.0), **options)
        assert not found.passed


class TestExactLogs:
    @pytest.fixture(scope="class")
    @classmethod
    def states(cls, craft, skewed_target):
        """Each log turns one joint."""
        tree, names = craft.tree, craft.joint_names
        return {
            f"joint {j}": true_telemetry(tree, names, turned(craft, j), skewed_target, TIMES)
            for j in (3, 0)
        }

    def test_two_logs_of_two_samples_determine_all_together(
        self, servicer, zero_momentum_motion, skewed_target
    ):
        """Two samples leave one combination open, another one in each log."""
        motions = {str(seed): zero_momentum_motion(skewed_target, 2, seed) for seed in (1, 2)}
        found = identify(servicer, motions, **ROWS)
        assert [log.rank for log in found.logs.values()] == [9, 9]
        np.testing.assert_allclose(found.parameters, skewed_target.to_vector(), rtol=1e-5)

    def test_a_moving_log_and_a_log_at_rest_are_one_target(self, craft, states, skewed_target):
        """The momentum of one log is no momentum of the other one."""
        motion = Sines.drawn(4, 105, DURATION, 0.6)
        moving = true_telemetry(
            craft.tree, craft.joint_names, motion, skewed_target, TIMES, MOMENTUM
        )
        found = identify(craft, {"rest": states["joint 0"], "moving": log_of(moving)}, **ROWS)
        said = "moving: the samples contradict a total momentum of zero, so the momentum was"
        assert any(text.startswith(said) for text in found.warnings)
        np.testing.assert_allclose(found.parameters, skewed_target.to_vector(), rtol=1e-7)


class TestPrior:
    SIGMA = np.array([6.0, *3 * [0.05], *6 * [1.5]])

    def prior(self, target, shift=0.0):
        return TargetPrior(
            "the prior", target.to_vector() + shift * self.SIGMA, np.diag(self.SIGMA**2)
        )

    def of_one(self, target, place, sigma):
        """Return a prior of one parameter."""
        parameters, covariance = np.full(10, np.nan), np.full((10, 10), np.nan)
        parameters[place], covariance[place, place] = target.to_vector()[place], sigma**2
        return TargetPrior("a drawing", parameters, covariance)

    def test_it_determines_what_the_log_does_not(
        self, servicer, skewed_target, zero_momentum_motion
    ):
        """Two exact samples leave one combination open."""
        log, prior = zero_momentum_motion(skewed_target, 2, 1), self.prior(skewed_target, 0.5)
        found = identify(servicer, log, prior=prior, **ROWS)
        assert found.logs["log"].rank == 9
        assert found.rank == 10
        assert not found.failures
        assert np.all(sigmas(found) < 1.01 * self.SIGMA)
        assert np.abs((found.parameters - skewed_target.to_vector()) / self.SIGMA).max() < 1.0
        assert any("it determines" in text for text in found.warnings)

    def test_a_vague_one_changes_nothing(self, craft, suite, logs, skewed_target):
        options = {"sensors": suite, "rows": "relative"}
        alone = identify(craft, logs["log 0"], **options)
        found = identify(craft, logs["log 0"], prior=self.prior(skewed_target, 0.5), **options)
        assert any("it determines no parameter more" in text for text in found.warnings)
        assert np.all(np.abs(found.parameters - alone.parameters) < 0.1 * sigmas(alone))
        np.testing.assert_allclose(sigmas(found), sigmas(alone), rtol=0.02)
        assert found.logs["the prior"].check("agreement").statistic < chi2.isf(0.01, 10)

    @pytest.mark.parametrize(
        ("estimator", "place", "sigma"), [("standard", 1, 1e-6), ("trajectory_fit", 0, 1e-4)]
    )
    def test_what_it_knows_is_as_exact_as_it_says(
        self, craft, suite, logs, skewed_target, estimator, place, sigma
    ):
        """The rows' unknown is m c: the prior is linear about the mass that the log shows."""
        prior = self.of_one(skewed_target, place, sigma)
        options = {"sensors": suite, "momentum": TotalMomentum.zero()}
        alone = identify(craft, logs["log 0"], estimator=estimator, **options)
        found = identify(craft, logs["log 0"], estimator=estimator, prior=prior, **options)
        assert any(f"determines {('m', 'cx')[place]}" in text for text in found.warnings)
        assert sigmas(found)[place] == pytest.approx(sigma, rel=0.01)
        error = found.parameters - skewed_target.to_vector()
        assert abs(error[place]) < 3 * sigma
        louder = max([1.0, *(found.noise[name] / alone.noise[name] for name in alone.noise)])
        assert np.all(sigmas(found) <= 1.001 * louder * sigmas(alone))

    def test_an_earlier_result_knows_all_ten_together(self, craft, tmp_path):
        """One slow joint: the ten together are known a hundred times better than the mass."""
        inertia = [[5.0, 0.4, -0.3], [0.4, 6.0, 0.5], [-0.3, 0.5, 4.0]]
        target = InertialParameters(40.0, [0.3, -0.2, 0.4], inertia)
        motion = Sines.drawn(4, 1, 10.0, 0.3)
        motion = replace(motion, amplitude=motion.amplitude * [0, 1, 0, 0])
        suite, later = load_sensors("flight", unstated="exact"), Sines.drawn(4, 2, 5.0, 0.5)
        slow, fast = (measured(craft, each, target, suite) for each in (motion, later))
        earlier = identify(craft, add_noise(suite, slow, seed=1), sensors=suite)
        assert sigmas(earlier)[0] > 1e-3 * target.mass
        write_result(tmp_path / "earlier.json", earlier)
        result = read_result(tmp_path / "earlier.json")
        prior = TargetPrior("it", result.parameters, result.covariance, result.combinations)
        found = identify(craft, add_noise(suite, fast, seed=2), sensors=suite, prior=prior)
        assert not found.failures
        assert nees(found, target) < chi2.isf(1e-3, 10)

    def test_one_of_another_target_is_doubted(self, craft, suite, logs, skewed_target):
        prior = self.prior(skewed_target, 8.0)
        found = identify(craft, logs["log 0"], prior=prior, sensors=suite)
        text = "the logs and the prior do not have the same target"
        assert any(text in failure for failure in found.failures)


@pytest.mark.slow
def test_logs_without_sensors_have_the_sensors_of_all(craft, noisy, suite):
    """The first log has no gyro: the order of the logs is no matter."""
    full = noisy(0)
    blind = noisy(1)
    blind = replace(blind, samples={n: s for n, s in blind.samples.items() if n != "gyro"})
    one, other = (
        identify(craft, dict(pair), estimator="trajectory_fit")
        for pair in ([("full", full), ("blind", blind)], [("blind", blind), ("full", full)])
    )
    assert one.sensors.gyro is not None
    np.testing.assert_allclose(sigmas(other), sigmas(one), rtol=1e-3)
