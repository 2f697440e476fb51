"""The fit of all unknowns: its minimum, noise that is larger than declared, changes, and online."""

from dataclasses import replace

import numpy as np
import pytest
from block_cases import make_case
from scipy.signal import lfilter
from scipy.stats import chi2
from sensing_cases import Sines, coarse_suite, measured, small_craft, true_psi

from cpid_drake.estimation.evidence import Question
from cpid_drake.estimation.fit import fit
from cpid_drake.estimation.gaussian import Gaussian
from cpid_drake.estimation.log_state import LogState
from cpid_drake.estimation.posterior import target_estimate
from cpid_drake.estimation.process import Process
from cpid_drake.estimation.start import start_of
from cpid_drake.estimation.unknowns import MOMENTUM as OF_LOG
from cpid_drake.estimation.unknowns import PSI, Model
from cpid_drake.estimation.whiteness import LagSums
from cpid_drake.logs.log import Log, Samples
from cpid_drake.logs.simulated_noise import add_noise
from cpid_drake.sensors.sensors import AttitudeSensor, Gyro, JointSensor

SUITE = coarse_suite()

AT_REST = Question({}, {f"{OF_LOG}|log": np.zeros(6)})


@pytest.fixture(scope="module")
def case(tmp_path_factory, skewed_target):
    return make_case(tmp_path_factory.mktemp("craft"), skewed_target, SUITE, None, 6.0)


def fitted(case, seed=0, samples=None, suite=None, rows=(), **options):
    suite = suite or case.suite
    model = Model(case.craft.tree, suite, rows=rows)
    samples = add_noise(case.suite, case.samples if samples is None else samples, seed)
    return fit(model, [LogState.of(model, samples)], **options)


def target(gaussian, values, at_rest=False):
    """Return ψ and its covariance; with a momentum of zero, or whatever it is."""
    if at_rest:
        name = next(n for n in values if n.startswith(OF_LOG))
        gaussian = gaussian.condition({name: -values[name]})
    found = gaussian.marginal([PSI])
    return values[PSI] + found.solve(), found.covariance()


@pytest.fixture(scope="module")
def found(case):
    return fitted(case)


def test_noise_is_as_declared_though_unknowns_absorb_some_of_it(found):
    """Residuals alone are smaller than the noise."""
    rest = found.rolled[0].all_residuals()
    assert min(np.sqrt(np.mean(each**2)) for each in rest.values()) < 0.95
    np.testing.assert_allclose(list(found.logs[0].noise_factors.values()), 1.0, rtol=0.15)


def test_noise_that_the_joints_absorb_is_counted(case):
    """Three times a gyro's noise, with poor encoders: residuals alone say 2.6 times."""
    declared = replace(SUITE, encoders=JointSensor(20.0, 3e-4))
    real = replace(declared, gyro=replace(SUITE.gyro, angle_random_walk=0.015))
    model, factors = Model(case.craft.tree, declared), []
    for seed in range(2):
        samples = add_noise(real, case.samples, seed)
        factors.append(fit(model, [LogState.of(model, samples)]).logs[0].noise_factors["gyro"])
    assert 2.67 < np.mean(factors) < 3.2


@pytest.mark.parametrize(("correlation", "least", "most"), [(0.0, 0.85, 1.15), (0.5, 1.55, 1.95)])
def test_slow_noise_counts_as_strong_as_it_is(tmp_path, skewed_target, correlation, least, most):
    """First-order Gauss-Markov noise is √3 times as strong if it is slow, as the motion is."""
    suite = replace(SUITE, gyro=Gyro(50.0, 0.005, 1.0), encoders=JointSensor(50.0, 1e-5))
    case, factors = make_case(tmp_path, skewed_target, suite, None, 12.0), []
    exact, sigma, rng = case.samples.gyro, suite.sigmas("gyro"), np.random.default_rng(0)
    for seed in range(2):
        white = sigma * rng.standard_normal((len(exact) + 50, 3)) * np.sqrt(1 - correlation**2)
        noise = lfilter([1.0], [1.0, -correlation], white, axis=0)[50:]
        samples = add_noise(suite, case.samples, seed)
        samples = samples.updated({"gyro": Samples(exact.time, exact.value + noise)})
        model = Model(case.craft.tree, suite)
        [log] = fit(model, [LogState.of(model, samples)]).logs
        noise = log.noise.processes.get("gyro", Process())
        rho = np.exp(-1 / 50 / noise.tau)
        factors.append(np.sqrt(noise.white + noise.slow * (1 + rho) / (1 - rho)))
    assert least <= np.mean(factors) < most


def test_errors_of_the_model_are_no_noise_if_they_are_small(case):
    """Of samples without noise, only errors of the joints' splines remain, which are correlated."""
    model = Model(case.craft.tree, SUITE)
    found = fit(model, [LogState.of(model, case.samples)])
    rest = found.rolled[0].all_residuals().values()
    assert max(LagSums().added(each).whiteness.correlation_time for each in rest) > 1.3
    np.testing.assert_allclose(list(found.logs[0].noise_factors.values()), 1.0, rtol=0.01)
    assert (found.logs[0].smoothness.noise == 1).all()


def minus_twice_log_likelihood(found):
    """χ² alone is smaller where the noise that the residuals show is larger."""
    noise, rest = found.logs[0].noise_factors, found.rolled[0].all_residuals()
    return found.cost + sum(2 * rest[name].size * np.log(factor) for name, factor in noise.items())


def test_a_further_row_is_about_the_target_itself(case, found):
    """With a target that is known exactly, the fit is that of the momentum and the sensors."""
    psi = true_psi(case.craft, case.target)
    R = np.diag(1e3 / found.model.plausible)
    row = Gaussian.of_rows({PSI: 10}, np.column_stack([R, R @ psi]))
    known = fitted(case, rows=(row,))
    assert known.converged
    np.testing.assert_allclose(known.values[PSI], psi, atol=1e-4 * np.abs(psi).max())
    one, other = minus_twice_log_likelihood(found), minus_twice_log_likelihood(known)
    assert one < other < one + 40


@pytest.mark.parametrize("factor", [0.01, 4.0])
def test_the_minimum_does_not_depend_on_the_start(case, found, factor):
    """A target of a hundredth of the true mass, and one of seven times the true mass."""
    model = found.model
    log = LogState.of(model, add_noise(case.suite, case.samples, 0))
    values, logs = start_of(model, [log])
    far = values | {PSI: factor * true_psi(case.craft, case.target)}
    other = fit(model, logs, values=far)
    psi, covariance = target(found.posterior, found.values)
    again, _ = target(other.posterior, other.values)
    assert other.converged
    assert np.abs((again - psi) / np.sqrt(np.diag(covariance))).max() < 0.05


def test_a_slow_log_with_gaps_and_larger_noise_is_fitted(tmp_path, skewed_target):
    """5 Hz, gaps of 1 to 2 s in the joints, noise three times the declared one, no gyro."""
    declared = coarse_suite(
        gyro=None, encoders=JointSensor(5.0, 1e-3), attitude=AttitudeSensor(5.0, 60.0, 60.0)
    )
    real = replace(
        declared, encoders=JointSensor(5.0, 3e-3), attitude=AttitudeSensor(5.0, 180.0, 180.0)
    )
    case = make_case(tmp_path, skewed_target, real, None, 30.0)
    samples = add_noise(real, case.samples, 1)
    e = samples.encoders
    kept = ~(((e.time > 6.1) & (e.time < 7.2)) | ((e.time > 15.1) & (e.time < 17.0)))
    thinned = {**samples.samples, "encoders": Samples(e.time[kept], e.value[kept])}
    model = Model(case.craft.tree, declared)
    found = fit(model, [LogState.of(model, Log(samples.joint_names, thinned))])
    assert found.converged
    assert found.sweeps <= 25
    np.testing.assert_allclose(found.logs[0].smoothness.noise, 3.0, rtol=0.3)
    assert case.nees(*target(found.posterior, found.values)) < 30


def test_what_the_motion_leaves_open_stays_where_it_was(tmp_path, skewed_target):
    """One joint moves: noise would take the rest far from any rigid body, to one that blocks."""
    craft, motion = small_craft(tmp_path), Sines.drawn(4, seed=101, duration=6.0, size=0.2)
    motion.amplitude[:, :3] = 0.0
    suite = replace(SUITE, gyro=None)
    samples = add_noise(suite, measured(craft, motion, skewed_target, suite), 2)
    model = Model(craft.tree, suite)
    found = fit(model, [LogState.of(model, samples)])
    assert found.converged
    known = target_estimate(model, found.values[PSI], found.posterior)
    assert 0 < known.rank < 10
    rows = known.unidentifiable / known.unit
    assert (np.abs(rows @ (known.values - model.unknown(PSI).mean)) < 1).all()  # σ of the prior
    error = known.determined.minus(true_psi(craft, skewed_target))
    assert error.z @ error.z < chi2.ppf(0.999, known.rank)
