"""Rows of one log and of many: the errors are those that the covariance says, or a check fails."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2
from sensing_cases import MOMENTUM, Sines, coarse_suite, log_of, measured, true_telemetry
from test_rows_with_noise import states

from cpid_drake import InertialParameters, Telemetry, TotalMomentum
from cpid_drake.dynamics.rows import RELATIVE_ROWS, ROW_FAMILIES, STANDARD_ROWS
from cpid_drake.identification.by_rows import estimate
from cpid_drake.identification.checked_log import check_log, log_of_states
from cpid_drake.identification.known import Known
from cpid_drake.identification.target_prior import TargetPrior
from cpid_drake.logs.simulated_noise import add_noise

DURATION = 5.0
TIMES = np.arange(0.0, DURATION, 0.05)


@pytest.fixture(scope="module")
def suite():
    return coarse_suite()


@pytest.fixture(scope="module")
def noisy(craft, suite, skewed_target):
    """Return a function (seed, momentum, target) -> samples of a motion of its own."""

    def make(seed, momentum_W=None, target=skewed_target):
        motion = Sines.drawn(4, 101 + seed, DURATION, 0.6)
        exact = measured(craft, motion, target, suite, momentum_W=momentum_W)
        return check_log(craft, add_noise(suite, exact, seed=seed), suite)

    return make


@pytest.fixture(scope="module")
def logs(noisy):
    """Three logs of one target; the second one has momentum."""
    return {f"log {k}": noisy(k, MOMENTUM if k == 1 else None) for k in range(3)}


def sigmas(found):
    return np.sqrt(np.diag(found.covariance))


def nees(found, target):
    """Return the squared error of what is known, in units of its covariance."""
    error = found.parameters - target.to_vector()
    known = np.isfinite(error)
    return error[known] @ np.linalg.solve(found.covariance[np.ix_(known, known)], error[known])


def identify_by_rows(craft, logs, family, momentum=None, sensors=None, prior=None):
    """Return the estimate of exact states or checked logs, before the checks of all estimators."""
    logs = {n: log_of_states(d) if isinstance(d, Telemetry) else d for n, d in logs.items()}
    known = Known(craft, sensors, momentum, prior=prior, family=family)
    return estimate(known, logs)


def heavier(target, factor):
    return InertialParameters(factor * target.mass, target.p_CTcm_C, target.I_TTcm_C)


class TestOneLog:
    @pytest.mark.parametrize("rows", ["standard", "relative"])
    def test_the_errors_of_smoothed_samples_are_no_larger_than_the_covariance_says(
        self, craft, suite, noisy, skewed_target, rows
    ):
        count, family, total = 8, ROW_FAMILIES[rows], 0.0
        for seed in range(count):
            log = {"": noisy(seed, MOMENTUM if seed % 2 else None)}
            found = identify_by_rows(craft, log, family, sensors=suite)
            assert not found.failures
            assert found.momentum == ("unknown" if seed % 2 else "zero")
            total += nees(found, skewed_target)
        assert total < chi2.ppf(0.999, 10 * count)

    def test_the_errors_of_rounded_states_are_no_larger_than_the_covariance_says(
        self, craft, skewed_target
    ):
        count, total = 6, 0.0
        for seed in range(count):
            exact = states(craft, skewed_target, seed)
            rounded = replace(exact, w_WB=np.round(exact.w_WB, 2), v_WB=np.round(exact.v_WB, 2))
            found = identify_by_rows(craft, {"": rounded}, STANDARD_ROWS)
            assert not found.failures
            assert found.momentum == "zero"
            total += nees(found, skewed_target)
        assert total < chi2.ppf(0.999, 10 * count)

    def test_a_given_zero_that_the_samples_contradict_is_a_failed_check(self, craft, suite, logs):
        log = {"": logs["log 1"]}
        found = identify_by_rows(craft, log, STANDARD_ROWS, TotalMomentum.zero(), suite)
        assert "identify with --momentum unknown" in found.failures[0]

    def test_what_is_seen_as_smaller_than_the_noise_is_not_shown(self, craft, skewed_target):
        """Rates rounded to tenths: most of the information of Eq. 18 is noise."""
        exact = states(craft, skewed_target, 0)
        rounded = replace(exact, w_WB=np.round(exact.w_WB, 1), v_WB=np.round(exact.v_WB, 1))
        found = identify_by_rows(craft, {"": rounded}, ROW_FAMILIES["eq18"])
        error = found.parameters - skewed_target.to_vector()
        known = np.isfinite(error)
        assert found.rank < 10
        assert np.all(np.abs(error[known]) < 4 * sigmas(found)[known])


class TestSeveralLogs:
    @pytest.fixture(scope="class")
    @classmethod
    def joint(cls, craft, suite, logs):
        return identify_by_rows(craft, logs, STANDARD_ROWS, sensors=suite)

    def test_each_log_has_its_own_momentum(self, joint, skewed_target):
        assert not joint.failures
        assert joint.momentum == "unknown"
        assert nees(joint, skewed_target) < chi2.isf(1e-3, 10)

    def test_together_they_know_more_than_each(self, joint, craft, suite, logs):
        log = {"log 0": logs["log 0"]}
        alone = identify_by_rows(craft, log, STANDARD_ROWS, sensors=suite)
        assert np.all(sigmas(joint) < sigmas(alone))
        assert joint.sample_count == sum(log.sample_count for log in joint.logs.values())
        np.testing.assert_allclose(joint.logs["log 0"].parameters, alone.parameters)

    def test_logs_of_one_target_agree(self, joint):
        assert joint.check("agreement").statistic < chi2.isf(1e-3, 20)
        assert joint.check("agreement").limit == pytest.approx(chi2.isf(1e-4, 20))

    def test_the_order_of_the_logs_does_not_matter(self, joint, craft, suite, logs):
        backwards = dict(reversed(logs.items()))
        again = identify_by_rows(craft, backwards, STANDARD_ROWS, sensors=suite)
        np.testing.assert_allclose(again.parameters, joint.parameters, rtol=1e-8, atol=1e-8)

    def test_one_log_twice_has_twice_the_information(self, craft, suite, logs):
        log = logs["log 0"]
        alone = identify_by_rows(craft, {"a": log}, STANDARD_ROWS, sensors=suite)
        twice = identify_by_rows(craft, {"a": log, "b": log}, STANDARD_ROWS, sensors=suite)
        np.testing.assert_allclose(twice.parameters, alone.parameters, rtol=1e-6, atol=1e-7)
        np.testing.assert_allclose(sigmas(twice), sigmas(alone) / np.sqrt(2), rtol=1e-6)
        assert twice.check("agreement").statistic < 1e-6

    def test_a_log_of_another_target_is_named(self, craft, suite, logs, noisy, skewed_target):
        other = noisy(4, target=heavier(skewed_target, 1.02))
        found = identify_by_rows(craft, {**logs, "other": other}, RELATIVE_ROWS, sensors=suite)
        assert "other differs from the rest, most in m: 61" in found.failures[0]

    def test_a_doubt_about_one_log_is_a_doubt_about_the_joint_estimate(self, craft, suite, logs):
        two = {name: logs[name] for name in ("log 0", "log 1")}
        found = identify_by_rows(craft, two, STANDARD_ROWS, TotalMomentum.zero(), suite)
        assert any(failure.startswith("log 1: ") for failure in found.failures)
        assert not any(failure.startswith("log 0: ") for failure in found.failures)

    def test_a_log_without_motion_is_not_used(self, craft, suite, logs, skewed_target):
        motion = Sines.drawn(4, 101, DURATION, 0.0)
        samples = add_noise(suite, measured(craft, motion, skewed_target, suite), seed=3)
        both = {"log 0": logs["log 0"], "still": check_log(craft, samples, suite)}
        found = identify_by_rows(craft, both, STANDARD_ROWS, sensors=suite)
        assert "still determines nothing about the target, and was not used" in found.warnings
        alone = found.logs["log 0"]
        assert found.parameters == pytest.approx(alone.parameters, rel=1e-4)


class TestExactLogs:
    @pytest.fixture(scope="class")
    @classmethod
    def turned(cls, craft, skewed_target):
        """Each log turns one joint: the target turns about one axis only."""
        motions = {}
        for joint in (3, 0):
            motion = Sines.drawn(4, 100 + joint, DURATION, 0.6)
            amplitude = np.zeros_like(motion.amplitude)
            amplitude[:, joint] = motion.amplitude[:, joint]
            motions[f"joint {joint}"] = true_telemetry(
                craft.tree,
                craft.joint_names,
                replace(motion, amplitude=amplitude),
                skewed_target,
                TIMES,
            )
        return motions

    def test_rounding_is_no_disagreement(self, craft, turned, skewed_target):
        found = identify_by_rows(craft, turned, STANDARD_ROWS)
        assert (found.check("agreement").statistic or 0.0) < 1e-2
        assert not found.failures
        np.testing.assert_allclose(found.parameters, skewed_target.to_vector(), rtol=1e-7)

    @pytest.mark.parametrize(("samples", "rank"), [(1, 6), (2, 9), (3, 10)])
    @pytest.mark.parametrize("rows", ["eq18", "standard"])
    def test_three_samples_determine_what_two_do_not(
        self, servicer, zero_momentum_motion, skewed_target, rows, samples, rank
    ):
        motion = zero_momentum_motion(skewed_target, samples, 1)
        found = identify_by_rows(servicer, {"": motion}, ROW_FAMILIES[rows])
        assert found.rank == rank

    def test_two_logs_of_two_samples_determine_all_together(
        self, servicer, zero_momentum_motion, skewed_target
    ):
        """Two samples leave one combination open, another one in each log."""
        motions = {str(seed): zero_momentum_motion(skewed_target, 2, seed) for seed in (1, 2)}
        found = identify_by_rows(servicer, motions, STANDARD_ROWS)
        assert [log.rank for log in found.logs.values()] == [9, 9]
        np.testing.assert_allclose(found.parameters, skewed_target.to_vector(), rtol=1e-5)

    def test_a_moving_log_and_a_log_at_rest_are_one_target(self, craft, turned, skewed_target):
        """The momentum of one log is no momentum of the other one."""
        moving = true_telemetry(
            craft.tree,
            craft.joint_names,
            Sines.drawn(4, 105, DURATION, 0.6),
            skewed_target,
            TIMES,
            MOMENTUM,
        )
        logs = {"rest": turned["joint 0"], "moving": check_log(craft, log_of(moving))}
        found = identify_by_rows(craft, logs, STANDARD_ROWS)
        assert "moving: " in found.warnings[0]
        assert "so the momentum was estimated" in found.warnings[0]
        np.testing.assert_allclose(found.parameters, skewed_target.to_vector(), rtol=1e-7)


class TestPrior:
    SIGMA = np.array([6.0, *3 * [0.05], *6 * [1.5]])

    def prior(self, target, shift=0.0):
        return TargetPrior(
            "the prior", target.to_vector() + shift * self.SIGMA, np.diag(self.SIGMA**2)
        )

    def test_it_determines_what_the_log_does_not(
        self, servicer, skewed_target, zero_momentum_motion
    ):
        """Two exact samples leave one combination open."""
        log = {"": zero_momentum_motion(skewed_target, 2, 1)}
        prior = self.prior(skewed_target, 0.5)
        found = identify_by_rows(servicer, log, STANDARD_ROWS, prior=prior)
        assert found.logs[""].rank == 9
        assert found.rank == 10
        assert found.dominated
        assert not found.failures
        assert np.all(sigmas(found) < 1.01 * self.SIGMA)
        error = (found.parameters - skewed_target.to_vector()) / self.SIGMA
        assert np.abs(error).max() < 1.0
        assert "more than the samples do" in found.warnings[0]

    def test_a_vague_prior_changes_nothing(self, craft, suite, logs, skewed_target):
        log = {"": logs["log 0"]}
        alone = identify_by_rows(craft, log, RELATIVE_ROWS, sensors=suite)
        prior = self.prior(skewed_target, 0.5)
        found = identify_by_rows(craft, log, RELATIVE_ROWS, sensors=suite, prior=prior)
        assert not found.dominated
        assert np.all(np.abs(found.parameters - alone.parameters) < 0.1 * sigmas(alone))
        np.testing.assert_allclose(sigmas(found), sigmas(alone), rtol=0.02)

    def test_a_known_centre_of_mass_is_as_exact_as_the_prior_says(
        self, craft, suite, logs, skewed_target
    ):
        """The rows' unknown is m c: the prior is linear about the mass that the log shows."""
        parameters, covariance = np.full(10, np.nan), np.full((10, 10), np.nan)
        parameters[1], covariance[1, 1] = skewed_target.p_CTcm_C[0], 1e-12
        prior, log = TargetPrior("a drawing", parameters, covariance), {"": logs["log 0"]}
        found = identify_by_rows(craft, log, STANDARD_ROWS, sensors=suite, prior=prior)
        assert sigmas(found)[1] == pytest.approx(1e-6, rel=0.01)
        assert found.parameters[1] == pytest.approx(parameters[1], abs=3e-6)

    def test_a_prior_of_another_target_is_doubted(self, craft, suite, logs, skewed_target):
        prior = self.prior(skewed_target, 8.0)
        log = {"": logs["log 0"]}
        found = identify_by_rows(craft, log, STANDARD_ROWS, sensors=suite, prior=prior)
        assert "the logs and the prior do not have the same target" in found.failures[0]

    def test_an_earlier_result_counts_like_its_log(self, craft, suite, logs):
        first, second = ({name: logs[name]} for name in ("log 0", "log 2"))
        earlier = identify_by_rows(craft, first, STANDARD_ROWS, sensors=suite)
        prior = TargetPrior("earlier", earlier.parameters, earlier.covariance)
        found = identify_by_rows(craft, second, STANDARD_ROWS, sensors=suite, prior=prior)
        both = identify_by_rows(craft, first | second, STANDARD_ROWS, sensors=suite)
        assert np.all(np.abs(found.parameters - both.parameters) < 0.1 * sigmas(both))
        np.testing.assert_allclose(sigmas(found), sigmas(both), rtol=0.02)


@pytest.mark.slow
@pytest.mark.parametrize(("rows", "size"), [("standard", 1e-4), ("relative", 3e-5)])
def test_a_momentum_too_small_to_be_seen_is_within_the_covariance(
    craft, suite, noisy, skewed_target, rows, size
):
    """A target with zero momentum is known better than the momentum: it would be 12 σ off."""
    count, total = 6, 0.0
    for seed in range(count):
        log = {"": noisy(seed, size * MOMENTUM)}
        found = identify_by_rows(craft, log, ROW_FAMILIES[rows], sensors=suite)
        total += nees(found, skewed_target)
    assert total < chi2.ppf(0.999, 10 * count)


def test_a_slow_tumble_is_within_the_covariance_of_a_short_log(craft, suite, noisy, skewed_target):
    """3 mN·m·s and 0.3 mN·s: with a momentum of zero, the target would be 9 σ off."""
    found = identify_by_rows(craft, {"": noisy(0, 1e-4 * MOMENTUM)}, STANDARD_ROWS, sensors=suite)
    assert found.is_observable
    assert nees(found, skewed_target) < chi2.isf(1e-3, 10)


def test_momentum_is_found_far_from_the_origin(craft, suite, skewed_target):
    """The prior of an unknown momentum is that about the base, wherever W's origin is."""
    motion = Sines.drawn(4, 102, DURATION, 0.6)
    samples = add_noise(suite, measured(craft, motion, skewed_target, suite, MOMENTUM), seed=1)
    position = samples.position
    far = samples.updated(
        {"position": replace(position, value=position.value + [1e3, -2e3, 500.0])}
    )
    near, found = (
        identify_by_rows(craft, {"": check_log(craft, each, suite)}, STANDARD_ROWS, sensors=suite)
        for each in (samples, far)
    )
    assert found.momentum == "unknown"
    assert np.all(np.abs(found.parameters - near.parameters) < 0.1 * sigmas(near))
