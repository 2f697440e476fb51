"""The trajectory fit: its optimum, that its covariance holds, and what it does not need."""

from dataclasses import replace

import numpy as np
import pytest
from block_cases import make_case
from scipy.stats import chi2
from sensing_cases import MOMENTUM, coarse_suite, momentum_about_com

from cpid_drake import InputError
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.estimation.block_queue import BlockQueue
from cpid_drake.estimation.block_state import BlockFit
from cpid_drake.estimation.recursive_fit import RecursiveFit
from cpid_drake.estimation.trajectory_fit import (
    MOST_RESIDUALS,
    Residuals,
    blocks_of,
    fit_trajectory,
    target_information,
)
from cpid_drake.estimation.window_fit import fit_window
from cpid_drake.identification.fit_setup import prior_of
from cpid_drake.sensing.measurement_stream import stream_of
from cpid_drake.sensing.measurements import Samples
from cpid_drake.sensing.noise import add_noise
from cpid_drake.sensing.sensors import JointSensor, VectorSensor

END = 4.0
SUITE = coarse_suite(encoders=JointSensor(25.0, 1e-5), velocity=VectorSensor(4.0, 1e-3))


@pytest.fixture(scope="module")
def case(tmp_path_factory, skewed_target):
    return make_case(tmp_path_factory.mktemp("craft"), skewed_target, SUITE, duration=END)


@pytest.fixture(scope="module")
def tumbling(tmp_path_factory, skewed_target):
    return make_case(tmp_path_factory.mktemp("craft"), skewed_target, SUITE, MOMENTUM, END)


def estimator_of(case, momentum=None, suite=SUITE):
    return RecursiveFit(case.craft.tree, suite, prior_of(case.craft.tree, momentum))


def fitted(case, samples, momentum=None, suite=SUITE):
    return fit_trajectory(estimator_of(case, momentum, suite), [samples])


def nees(case, fit):
    error = fit.known.nominal.psi - case.psi
    return float(error @ fit.known.psi_information() @ error)


@pytest.fixture(scope="module")
def fits(case):
    """Return the fits of three seeds."""
    return [fitted(case, add_noise(SUITE, case.samples, seed)) for seed in range(3)]


def test_errors_are_as_the_covariance_and_the_bound_say(case, fits):
    values = [nees(case, fit) for fit in fits]
    low, high = chi2.ppf([1e-3, 1 - 1e-3], 10 * len(fits))
    assert low < sum(values) < high
    bound = target_information(estimator_of(case), [case.samples], case.psi).psi_information()
    root = np.linalg.inv(np.linalg.cholesky(bound))
    for fit in fits:
        assert fit.converged
        ratio = np.linalg.eigvalsh(root @ fit.known.psi_information() @ root.T)
        assert ratio[0] > 0.7
        assert ratio[-1] < 1.4


def test_chi_squared_is_that_of_noise(fits):
    chi_squared = sum(fit.recursive.chi_squared for fit in fits)
    freedom = sum(fit.recursive.freedom for fit in fits)
    # The first block counts its prior as data that agree.
    assert 1 - 6 * np.sqrt(2 / freedom) < chi_squared / freedom < 1 + 4 * np.sqrt(2 / freedom)
    assert all(fit.recursive.misfit == 1.0 for fit in fits)


def test_the_recursive_fit_is_nearly_as_good(case, fits):
    """On the same samples its estimate differs by a small part of σ."""
    differences = []
    for seed, fit in enumerate(fits[:2]):
        state = estimator_of(case).run([add_noise(SUITE, case.samples, seed)])
        root = fit.known.root[-10:, -10:]
        differences.append(root @ (state.known.nominal.psi - fit.known.nominal.psi))
    assert np.sqrt(np.mean(np.square(differences))) < 0.1  # σ


def test_the_passes_end_at_the_optimum_of_the_whole_window(case, fits):
    """That of all blocks in one window, by the Levenberg-Marquardt method from the prior."""
    estimator = estimator_of(case)
    samples = add_noise(SUITE, case.samples, 0)
    blocks = list(blocks_of(BlockQueue.of(SUITE), [samples]))
    whole = fit_window(estimator.solver, estimator.prior, blocks, estimator.prior.psi)
    difference = fits[0].known.root[-10:, -10:] @ (fits[0].known.nominal.psi - whole.psi)
    assert np.linalg.norm(difference) < 0.05  # σ


def test_without_noise_it_finds_the_truth(case):
    fit = fitted(case, case.samples)
    assert np.sqrt(nees(case, fit)) < 0.3  # σ: what the splines miss of the motion
    assert fit.recursive.chi_squared < 0.1 * fit.recursive.freedom


def test_chunks_do_not_matter(case, fits):
    samples = add_noise(SUITE, case.samples, 0)
    fit = fit_trajectory(estimator_of(case), stream_of(samples, 0.7))
    np.testing.assert_array_equal(fit.known.nominal.psi, fits[0].known.nominal.psi)


def test_a_known_momentum_is_worth_more_than_an_unknown_one(tumbling):
    """Both hold; taken as zero, it does not fit."""
    samples = add_noise(SUITE, tumbling.samples, 3)
    true = momentum_about_com(tumbling.craft, tumbling.motion, tumbling.target, MOMENTUM)
    known, unknown = (
        fitted(tumbling, samples, momentum) for momentum in (true, TotalMomentum.unknown())
    )
    np.testing.assert_allclose(known.known.nominal.L, true.L_WScm_W, atol=1e-6)
    for fit in (known, unknown):
        assert nees(tumbling, fit) < chi2.isf(1e-4, 10)
    information = [fit.known.psi_information() for fit in (known, unknown)]
    root = np.linalg.inv(np.linalg.cholesky(information[1]))
    assert np.linalg.eigvalsh(root @ information[0] @ root.T)[0] > 0.98
    place = estimator_of(tumbling).solver.places
    L = np.r_[place["L"], place["v_Wcm"]]
    inverse = np.linalg.inv(unknown.known.root)[L]
    error = np.concatenate([unknown.known.nominal.L, unknown.known.nominal.v_Wcm])
    error = error - np.concatenate([true.L_WScm_W, true.v_WScm_W])
    assert error @ np.linalg.solve(inverse @ inverse.T, error) < chi2.isf(1e-4, 6)


@pytest.mark.parametrize("kept", [(), ("gyro",), ("position",), ("velocity",)])
def test_any_sensors_beside_attitude_will_do(case, kept):
    """Absent from the suite, or without samples in the log: the same."""
    absent = {"gyro", "position", "velocity"} - set(kept)
    poor = replace(SUITE, **dict.fromkeys(absent))
    nothing = {name: Samples(np.empty(0), np.empty((0, 3))) for name in absent}
    samples = add_noise(SUITE, case.samples, 6).updated(nothing)
    fit, silent = fitted(case, samples, suite=poor), fitted(case, samples)
    np.testing.assert_allclose(
        silent.known.psi_information(), fit.known.psi_information(), rtol=1e-3, atol=1.0
    )
    assert nees(case, fit) < chi2.isf(1e-4, 10)


def test_without_attitude_it_is_refused(case):
    blind = replace(SUITE, attitude=None)
    nothing = {"attitude": Samples(np.empty(0), np.empty((0, 4)))}
    with pytest.raises(InputError, match="no attitude samples"):
        fitted(case, case.samples.updated(nothing), suite=blind)


def test_residuals_of_a_long_log_are_thinned_evenly(fits):
    """The memory is bounded, the first residuals are all kept, the others at equal distances."""
    record = Residuals()
    state, joints = fits[0].known, None
    for k in range(400):
        times = np.linspace(k, k + 1, 100, endpoint=False)
        rest = {"gyro": np.repeat(times[:, None], 3, axis=1)}
        record.add(BlockFit(state, joints, rest, {"gyro": times}, 0.0, 1, 1.0))
        assert len(record.selections["gyro"].samples()) <= MOST_RESIDUALS
    kept = record.selections["gyro"].samples()
    np.testing.assert_allclose(np.diff(kept.time), record.selections["gyro"].every / 100)
    assert kept.time[-1] > 399
    np.testing.assert_array_equal(kept.value[:, 0], kept.time)
    beginning = record.beginning("gyro")
    assert len(beginning) == MOST_RESIDUALS
    np.testing.assert_allclose(np.diff(beginning[:, 0]), 0.01)
