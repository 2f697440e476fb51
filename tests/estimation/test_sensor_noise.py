"""Noise of sensors: what is white, what is slow, and what a target's error is beside its σ."""

from functools import partial

import numpy as np
import pytest
from block_cases import fired, make_case
from scipy.stats import chi2
from sensing_cases import coarse_suite, gauss_markov, with_drawn_errors

from cpid_drake.estimation.bounded_fits import BoundedFits
from cpid_drake.estimation.events import fit_with_events
from cpid_drake.estimation.evidence import Question
from cpid_drake.estimation.fit import fit
from cpid_drake.estimation.log_state import LogState
from cpid_drake.estimation.noise_evidence import NoiseEvidence
from cpid_drake.estimation.process import Innovations, Process, proxy
from cpid_drake.estimation.unknowns import MOMENTUM, PSI, Model
from cpid_drake.logs.log import Samples
from cpid_drake.sensors.sensors import Gyro, JointSensor, VectorSensor

SUITE = coarse_suite(
    gyro=Gyro(50.0, 0.005, 1.0, 0.1),
    position=VectorSensor(20.0, 1e-3),
    encoders=JointSensor(50.0, 1e-5),
)
AT_REST = Question({}, {f"{MOMENTUM}|log": np.zeros(6)})


def half(rng, times, shape):
    """Half of the variance is white."""
    slow = gauss_markov(rng, times, shape, 0.2)
    return np.sqrt(0.5) * (slow + rng.standard_normal(shape))


def white(rng, times, shape):
    return rng.standard_normal(shape)


def spoiled(ideal, errors, seed, kept=None):
    """Return samples with errors of their usual size, of which a share is kept."""
    rng, samples = np.random.default_rng(seed), {}
    for name, each in with_drawn_errors(SUITE, ideal, partial(errors, rng)).items():
        seen = np.ones(len(each), bool) if kept is None else rng.random(len(each)) < kept
        seen[:2] = True
        samples[name] = each.where(seen)
    return ideal.updated(samples)


@pytest.fixture(scope="module")
def case(tmp_path_factory, skewed_target):
    return make_case(tmp_path_factory.mktemp("craft"), skewed_target, SUITE, None, 8.0)


def fitted(case, samples):
    model = Model(case.craft.tree, SUITE)
    return fit(model, [LogState.of(model, samples)])


def nees(case, found):
    at_rest = {f"{MOMENTUM}|log": -found.values[f"{MOMENTUM}|log"]}
    known = found.posterior.condition(at_rest).marginal([PSI])
    return case.nees(found.values[PSI] + known.solve(), known.covariance())


@pytest.mark.parametrize("jitter", [0.0, 0.2])
def test_whitened_noise_is_white(jitter):
    """The covariance of whitened samples and of the state at the end is 1, at any stamps."""
    rng, noise = np.random.default_rng(0), Process(0.7, 2.0, 0.3)
    times = np.sort(0.02 * (np.arange(50) + jitter * rng.uniform(-1, 1, 50)) + 0.02)
    weights = rng.uniform(0.3, 1.0, 50)
    own = Innovations(times, 0.0, 1.1, weights, noise)
    at = np.array([0.0, *times, 1.1])
    K = 2.0 * np.exp(-np.abs(at[:, None] - at) / 0.3)
    S = K[1:, 1:] - np.outer(K[1:, 0], K[1:, 0]) / 2.0
    S[:50, :50] += np.diag(0.7 / weights**2)
    W = np.column_stack([own(np.eye(50)), own.edges[:, 1]])
    np.testing.assert_allclose(W @ S @ W.T, np.eye(51), atol=1e-12)
    np.testing.assert_allclose(W @ K[1:, 0] / 2.0, -own.edges[:, 0], atol=1e-12)
    assert own.volume == pytest.approx(np.linalg.slogdet(S)[1])


@pytest.mark.parametrize("process", [Process(0.7), Process(0.7, 2.0, 0.3)], ids=["white", "slow"])
def test_a_series_is_as_likely_as_its_covariance_says(process):
    """Slow noise is stationary: it has no edges."""
    rng = np.random.default_rng(2)
    times, rest = np.sort(rng.uniform(5.0, 8.0, 40)), rng.standard_normal((40, 3))
    S = process.slow * np.exp(-np.abs(times[:, None] - times) / process.tau)
    S += process.white * np.eye(40)
    expected = np.sum(rest * np.linalg.solve(S, rest)) + 3 * np.linalg.slogdet(S)[1]
    assert proxy(times, rest, process) == pytest.approx(expected)


def test_white_noise_is_not_called_slow(case):
    for seed in range(3):
        [log] = fitted(case, spoiled(case.samples, white, seed)).logs
        assert not any(each.slow for each in log.noise.processes.values())
        np.testing.assert_allclose(list(log.noise_factors.values()), 1, rtol=0.12)


def test_outliers_are_no_noise(case):
    """A twelfth of a gyro's samples is off by 8 σ: they weigh less, and its noise is as stated."""
    samples, rng = spoiled(case.samples, white, 1), np.random.default_rng(1)
    gyro, value = samples["gyro"], samples["gyro"].value.copy()
    far = rng.random(len(gyro)) < 1 / 12
    value[far] += 8 * SUITE.sigmas("gyro") * rng.choice([-1, 1], (np.sum(far), 3))
    [log] = fitted(case, samples.updated({"gyro": Samples(gyro.time, value)})).logs
    assert log.noise_factors["gyro"] == pytest.approx(1, rel=0.12)


@pytest.mark.parametrize("share", [0.1, 0.5], ids=["a third", "the rest is slower than a block"])
def test_noise_is_no_smaller_than_declared(case, share):
    """Noise that is slower than a block leaves small residuals, too, and is no smaller."""

    def smaller(rng, times, shape):
        return np.sqrt(share) * rng.standard_normal(shape)

    [log] = fitted(case, spoiled(case.samples, smaller, 0)).logs
    assert all(each.total >= 0.999 for each in log.noise.processes.values())


@pytest.mark.parametrize("kept", [None, 0.8], ids=["all", "four of five"])
def test_intervals_hold_with_noise_half_of_which_is_slow(case, kept):
    found = [fitted(case, spoiled(case.samples, half, seed, kept)) for seed in range(6)]
    assert all(each.converged for each in found)
    squares = [nees(case, each) for each in found]
    assert chi2.ppf(0.01, 10) < np.median(squares) < 20
    for each in found:
        gyro = each.logs[0].noise.processes["gyro"]
        assert 0.6 < gyro.total < 2.0
        assert gyro.slow > 0.2


def test_a_firing_in_slow_noise_is_found(case):
    time, momentum_W = 4.37, 0.05 * np.array([3.0, -2.0, 4.0, 1.0, 0.5, -1.0])
    samples = spoiled(fired(case, time, momentum_W), half, 0)
    found = fit_with_events(fitted(case, samples), AT_REST, BoundedFits())
    [log] = found.logs
    assert found.converged
    assert 1 <= len(log.changes) <= 2
    assert min(abs(each - time) for each in log.changes) < 0.5


def test_slopes_are_those_of_the_evidence(case):
    """One pass backward finds what differences of the evidence show, for all sensors at once."""
    model = Model(case.craft.tree, SUITE)
    found = fit(model, [LogState.of(model, spoiled(case.samples, half, 0))])
    [log], [rolled] = found.logs, found.rolled
    evidence = NoiseEvidence(model, log, rolled, found.values)
    noise = {"gyro": Process(0.6, 0.9, 0.4), "position": Process(0.7, 0.2, 0.1)}
    noise["attitude"] = Process(1.3)
    value, slopes = evidence.with_slopes(noise)
    assert value == pytest.approx(evidence(noise))
    for name, process in noise.items():
        for k, h in enumerate(1e-3 * np.eye(len(process.coordinates))):
            up, down = (process.with_coordinates(process.coordinates + s * h) for s in (1, -1))
            change = evidence({**noise, name: up}) - evidence({**noise, name: down})
            assert slopes[name][k] == pytest.approx(change / 2e-3, rel=1e-4, abs=1e-3)
