"""The Monte Carlo study: what it runs, what it counts, what it writes."""

from dataclasses import replace

import numpy as np
import pytest

from cpid_drake import load_scenario, shipped_scenario
from cpid_drake.dynamics.momentum import total_momentum
from cpid_drake.sensors.presets import load_sensors
from cpid_drake.studies.accuracy import Outcome, run_accuracy, statistics_of
from cpid_drake.studies.trials import Firing, base_trajectory, make_case


@pytest.fixture(scope="module")
def scenario():
    return load_scenario(shipped_scenario("exciting_motion"))


@pytest.mark.slow
def test_same_seed_same_numbers_in_any_number_of_processes(scenario):
    options = {"trials": 2, "presets": ["servicer"], "estimators": ["standard"], "seed": 5}
    one = run_accuracy(scenario, jobs=1, **options).results[0]
    two = run_accuracy(scenario, jobs=2, **options).results[0]
    other = run_accuracy(scenario, jobs=1, **(options | {"seed": 6})).results[0]
    # Another number of threads adds up in another order: equal but for rounding.
    np.testing.assert_allclose(one.rmse, two.rmse, rtol=1e-6)
    assert (one.rmse != other.rmse).all()
    # Each trial draws noise of its own: equal ones would have errors without any spread.
    assert (np.sqrt(one.rmse**2 - one.bias**2) > 0.01 * one.rmse).all()


# -- statistics, on errors of known distribution ---------------------------------------------------


@pytest.fixture(scope="module")
def case(scenario):
    spacecraft = scenario.spacecraft.make()
    suite = load_sensors("flight")
    return make_case(scenario, spacecraft, scenario.target_truth(), suite, ("eq18",), 3)


def drawn(case, covariance, count, reported=1.0, shift=0.0):
    rng = np.random.default_rng(8)
    errors = rng.multivariate_normal(np.zeros(10), covariance, count) + shift
    return [Outcome(case.truth.to_vector() + e, reported * covariance) for e in errors]


@pytest.fixture(scope="module")
def covariance():
    root = np.random.default_rng(1).normal(size=(10, 10))
    scale = np.geomspace(1e-3, 10, 10)
    return (root @ root.T + np.eye(10)) * scale * scale[:, None]


def test_honest_errors_have_ratio_one_and_95_percent_coverage(case, covariance):
    bound = np.sqrt(np.diag(covariance))
    r = statistics_of(case, "p", "e", bound, drawn(case, covariance, 4000))
    np.testing.assert_allclose(r.ratio, 1.0, atol=0.05)
    np.testing.assert_allclose(r.coverage, 0.95, atol=0.015)
    assert r.nees_band[0] < r.nees < r.nees_band[1]
    assert (np.abs(r.bias) < 3.5 * bound / np.sqrt(4000)).all()


def test_overconfidence_shows(case, covariance):
    bound = np.sqrt(np.diag(covariance))
    r = statistics_of(case, "p", "e", bound, drawn(case, covariance, 500, reported=0.25))
    assert r.nees == pytest.approx(40, rel=0.1)
    assert r.coverage.max() < 0.75  # ±1.96 σ/2 holds 67 %


def test_bias_shows(case, covariance):
    bound = np.sqrt(np.diag(covariance))
    r = statistics_of(case, "p", "e", bound, drawn(case, covariance, 500, shift=2 * bound))
    np.testing.assert_allclose(r.bias, 2 * bound, rtol=0.1)
    np.testing.assert_allclose(r.ratio, np.sqrt(1 + 2**2), rtol=0.1)  # of spread and bias together


def test_failures_are_counted_and_left_out(case, covariance):
    bound = np.sqrt(np.diag(covariance))
    outcomes = drawn(case, covariance, 10)
    outcomes[3] = Outcome(problem="too few samples")
    r = statistics_of(case, "p", "e", bound, outcomes)
    assert (r.trials, r.failed, r.problem) == (10, 1, "too few samples")
    assert np.isfinite(r.rmse).all()
    none = statistics_of(case, "p", "e", bound, [outcomes[3]])
    assert none.failed == 1
    assert np.isnan(none.rmse).all()


# -- the truth that trials are drawn from ----------------------------------------------------------


def test_firings_add_momentum_at_once_or_at_a_constant_rate(scenario, case):
    """To that which was there. Two overlap, one was under way at the start, the last is an impulse.

    The motion of spacecraft and target together, by the sums over all bodies.
    """
    before, added = np.array([3.0, -2.0, 2.5, 2.0, 1.0, -1.5]), np.array([6.0, -4, 5, 3, -2, 2])
    firings = (Firing(-0.5, 2 * added, 1.0), Firing(4.0, added, 0.5), Firing(4.25, -3 * added, 0.5))
    fired = replace(case, momentum_W=before, firings=(*firings, Firing(6.0, added)))
    spacecraft, truth = scenario.spacecraft.make(), scenario.target_truth()
    times = np.array([0.0, 0.4, 0.5, 3.9, 4.1, 4.25, 4.35, 4.6, 5.0, 7.0])
    shares = np.array([1.0, 1.8, 2.0, 2.0, 2.2, 2.5, 2.1, 0.9, 0.0, 1.0])
    base = base_trajectory(fired, spacecraft.tree, times)
    telemetry = base.to_telemetry(spacecraft.joint_names, times, case.motion)
    P, L = total_momentum(spacecraft.tree, truth, telemetry)
    np.testing.assert_allclose(np.hstack([L, P]), before + shares[:, None] * added, atol=1e-6)


@pytest.mark.slow
def test_the_truth_is_not_the_nominal_spacecraft_where_that_is_uncertain(scenario):
    uncertain = replace(scenario, known_bodies=replace(scenario.known_bodies, mass=0.01))
    options = {"trials": 1, "presets": ["flight"], "estimators": ["trajectory_fit"]}
    exact = run_accuracy(scenario, **options).results[0]
    rough = run_accuracy(uncertain, **options).results[0]
    assert (rough.crlb > exact.crlb).all()
    assert rough.rmse[0] > 5 * exact.rmse[0]
