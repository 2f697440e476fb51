"""Both fits: their optimum, that their covariance holds, and what they do not need."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from block_cases import fired, make_case
from scipy.stats import chi2
from sensing_cases import (
    MOMENTUM,
    Sines,
    coarse_suite,
    measured,
    momentum_about_com,
    true_psi,
)

from cpid_drake import InertialParameters, TotalMomentum, identify
from cpid_drake.estimation.cramer_rao import cramer_rao_bound
from cpid_drake.estimation.online import run
from cpid_drake.estimation.unknowns import PSI, Model
from cpid_drake.identification.online_answer import identification_of_state
from cpid_drake.logs.log import Samples
from cpid_drake.logs.simulated_noise import add_noise
from cpid_drake.sensors.sensors import JointSensor, VectorSensor

FITS = ("trajectory_fit", "recursive_fit")
END = 4.0
SUITE = coarse_suite(encoders=JointSensor(25.0, 1e-5), velocity=VectorSensor(4.0, 1e-3))
FLAT = InertialParameters(60.0, [0.4, 0.1, 0.0], np.diag([10.0, 20.0, 30.0]))


@pytest.fixture(scope="module")
def case(tmp_path_factory, skewed_target):
    return make_case(tmp_path_factory.mktemp("craft"), skewed_target, SUITE, duration=END)


@pytest.fixture(scope="module")
def samples(case):
    return add_noise(SUITE, case.samples, 0)


def fitted(case, samples, *, suite=SUITE, **options):
    return identify(case.craft, samples, sensors=suite, **options)


def distance(found, other, covariance):
    """Return the Mahalanobis distance of two parameter vectors."""
    error = found - other
    return np.sqrt(error @ np.linalg.solve(covariance, error))


def nees(case, found):
    return distance(found.parameters, case.target.to_vector(), found.covariance) ** 2


@pytest.fixture(scope="module")
def fits(case):
    """Return the fits of three seeds."""
    logs = [add_noise(SUITE, case.samples, seed) for seed in range(3)]
    zero = {"momentum": TotalMomentum.zero()}
    return {name: [fitted(case, log, estimator=name, **zero) for log in logs] for name in FITS}


@pytest.mark.parametrize("name", FITS)
def test_errors_are_as_the_covariance_and_the_bound_say(case, fits, name):
    """Noise is no change of momentum and no misfit."""
    low, high = chi2.ppf([1e-3, 1 - 1e-3], 30)
    assert low < sum(nees(case, found) for found in fits[name]) < high
    bound = cramer_rao_bound(case.craft.tree, case.psi, case.samples, SUITE)
    root, largest = np.linalg.inv(np.linalg.cholesky(bound)), []
    for found in fits[name]:
        assert found.converged
        assert not found.momentum_changes
        ratio = np.linalg.eigvalsh(root @ found.covariance @ root.T)
        assert ratio[0] > 0.7
        largest.append(ratio[-1])
    assert np.median(largest) < 1.4


def test_without_noise_it_finds_the_truth(case):
    assert np.sqrt(nees(case, fitted(case, case.samples))) < 0.3  # σ: what the splines miss


@pytest.mark.parametrize("target", ["skewed", "flat"])
@pytest.mark.parametrize("momentum_W", [None, MOMENTUM], ids=["at rest", "tumbling"])
def test_the_start_does_not_matter(tmp_path, skewed_target, target, momentum_W):
    """From two spheres about C, also for a flat target at the limit of rigid bodies."""
    target = FLAT if target == "flat" else skewed_target
    case = make_case(tmp_path, target, SUITE, momentum_W, 3.0)
    noisy, found = add_noise(SUITE, case.samples, 1), []
    for share, radius in ((0.02, 0.3), (0.3, 0.5)):
        m = share * case.craft.mass
        sphere = InertialParameters(m, np.zeros(3), 0.4 * m * radius**2 * np.eye(3))
        model, psi = Model(case.craft.tree, SUITE), true_psi(case.craft, sphere)
        size = np.concatenate([[1.0], 3 * [radius], 6 * [radius**2]])
        model = model.with_prior(PSI, psi, 100.0 * psi[0] * size)
        found.append(identification_of_state(model, run(model, [noisy])))
    one, other = found
    assert distance(one.parameters, other.parameters, one.covariance) < 0.15  # σ
    assert nees(case, one) < chi2.isf(1e-3, 10)


def test_a_known_momentum_is_worth_more_than_an_unknown_one(tmp_path, skewed_target):
    """Both hold, and the unknown one is estimated within its covariance."""
    case = make_case(tmp_path, skewed_target, SUITE, MOMENTUM, END)
    noisy = add_noise(SUITE, case.samples, 3)
    true = momentum_about_com(case.craft, case.motion, case.target, MOMENTUM)
    known, unknown = (
        fitted(case, noisy, momentum=momentum) for momentum in (true, TotalMomentum.unknown())
    )
    for found in (known, unknown):
        assert nees(case, found) < chi2.isf(1e-4, 10)
    root = np.linalg.inv(np.linalg.cholesky(known.covariance))
    assert np.linalg.eigvalsh(root @ unknown.covariance @ root.T)[0] > 0.98
    error = unknown.momentum_estimate - np.concatenate([true.L_WScm_W, true.v_WScm_W])
    assert error @ np.linalg.solve(unknown.momentum_covariance, error) < chi2.isf(1e-4, 6)


@pytest.mark.parametrize("kept", [(), ("gyro",), ("position",), ("velocity",)])
def test_any_sensors_beside_attitude_will_do(case, samples, kept):
    """Absent from the suite, or without samples in the log: the same."""
    absent = {"gyro", "position", "velocity"} - set(kept)
    poor = replace(SUITE, **dict.fromkeys(absent))
    nothing = {name: Samples(np.empty(0), np.empty((0, 3))) for name in absent}
    log = samples.updated(nothing)
    found, silent = fitted(case, log, suite=poor), fitted(case, log)
    sigma = np.sqrt(np.diag(found.covariance))
    np.testing.assert_allclose(np.sqrt(np.diag(silent.covariance)), sigma, rtol=1e-3)
    assert nees(case, found) < chi2.isf(1e-4, 10)


# -- samples that are bad, missing or late ---------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "size", "time"),
    [
        ("attitude", 0.02, 0.5),
        ("gyro", 1e-3, 2.4),
        ("position", 0.3, 0.5),
        ("position", 0.012, 2.4),
    ],
)
def test_an_outlier_is_left_out(case, samples, name, size, time):
    """As if the sample were not there."""
    every, fits = samples[name], []
    which = np.searchsorted(every.time, time)
    value = every.value.copy()
    value[which, -3:] += size * np.array([1, -0.5, 1])
    if name == "attitude":
        value /= np.linalg.norm(value, axis=1)[:, None]
    fewer = every.where(np.arange(len(every)) != which)
    for changed in (Samples(every.time, value), fewer):
        fits.append(fitted(case, samples.updated({name: changed}), estimator="recursive_fit"))
        assert len(fits[-1].momentum_changes) == 0
    one, other = fits
    assert distance(one.parameters, other.parameters, other.covariance) < 0.1  # σ


@pytest.mark.parametrize(
    ("name", "start", "end"),
    [("attitude", 1.3, 3.2), ("gyro", 1.3, 3.2), ("encoders", 1.9, 3.1), ("attitude", -1, 1.5)],
)
def test_a_gap_of_a_sensor_is_no_change(case, samples, name, start, end):
    """Also of the encoders, after which the attitude begins again; and at the beginning."""
    time = samples[name].time
    gap = samples.updated({name: samples[name].where((time < start) | (time > end))})
    found = fitted(case, gap, estimator="recursive_fit")
    assert len(found.momentum_changes) == 0
    assert nees(case, found) < chi2.isf(1e-4, 10)


def test_encoders_slower_than_the_suite_says_make_no_gaps(case, samples):
    sparse = samples.updated({"encoders": samples.encoders.where(slice(0, None, 5))})
    found = fitted(case, sparse, estimator="recursive_fit")
    assert len(found.momentum_changes) == 0
    assert nees(case, found) < chi2.isf(1e-4, 10)


@pytest.mark.parametrize(
    ("time", "duration"),
    [(0.6, 1e-6), pytest.param(3.4, 0.5, marks=pytest.mark.slow)],
    ids=["at the start", "long"],
)
def test_a_firing_is_found(tmp_path, skewed_target, time, duration):
    """Within a second, a long one perhaps twice; the covariance of the target holds."""
    case = make_case(tmp_path, skewed_target, SUITE, duration=6.0)
    perfect = fired(case, time, np.array([6.0, -4.0, 5.0, 3.0, -2.0, 2.0]), duration)
    found = fitted(case, add_noise(SUITE, perfect, 2), estimator="recursive_fit")
    assert 1 <= len(found.momentum_changes) <= (2 if duration > 0.1 else 1)
    assert all(-0.5 < each - time < 1.0 for each in found.momentum_changes)
    assert not found.failures  # the noise is that of the other blocks
    assert nees(case, found) < chi2.isf(1e-4, 10)


@pytest.mark.slow
def test_a_hopeless_beginning_fails_a_check(tmp_path, skewed_target):
    """Two joints are exchanged for two seconds: what is behind the window is not forgotten."""
    case = make_case(tmp_path, skewed_target, SUITE, duration=6.0)
    log = add_noise(SUITE, case.samples, 1)
    time, value = log.encoders.time, log.encoders.value.copy()
    value[time < 2.0] = value[time < 2.0][:, [0, 2, 1, 3]]
    spoiled = log.updated({"encoders": Samples(time, value)})
    assert fitted(case, spoiled, estimator="recursive_fit").failures


@dataclass(frozen=True, eq=False)
class AfterRest:
    """A motion that begins smoothly after a rest."""

    motion: Sines
    rest: float
    duration: float

    def evaluate(self, time):
        u = np.maximum(np.asarray(time, dtype=float) - self.rest, 0.0)
        moved = self.motion.evaluate(u**3 / (u**2 + 1))
        rate = (u**4 + 3 * u**2) / (u**2 + 1) ** 2
        moved[..., 1, :] *= rate[..., None]
        return moved

    def breaks(self):
        return np.array([self.rest])


@pytest.mark.slow
def test_rest_before_the_motion_is_forgotten(case, skewed_target):
    """Nothing is known at rest, and nothing is called a fault after it."""
    motion = AfterRest(case.motion, 4.0, 4.0 + END)
    log = add_noise(SUITE, measured(case.craft, motion, skewed_target, SUITE), 3)
    still = fitted(case, log.between(0.0, 4.0), estimator="recursive_fit")
    assert np.isnan(still.parameters).all()
    found = fitted(case, log, estimator="recursive_fit")
    assert len(found.momentum_changes) == 0
    assert nees(case, found) < chi2.isf(1e-4, 10)
