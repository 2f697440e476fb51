"""All estimators on the same sensors: who is right, who is biased, and what none can know."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2
from sensing_cases import (
    Sines,
    coarse_suite,
    measured,
    nees,
    true_psi,
)

from cpid_drake import HalfCosine, identify
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.estimation.cramer_rao import cramer_rao_bound
from cpid_drake.logs.simulated_noise import add_noise
from cpid_drake.sensors.sensors import AttitudeSensor, Gyro, JointSensor, VectorSensor

DURATION = 8.0

FAST = {"gyro": Gyro(50.0, 0.005, 1.0, 0.1), "encoders": JointSensor(50.0, 1e-5)}


@pytest.fixture(scope="module")
def motion():
    return Sines.drawn(4, seed=101, duration=DURATION, size=0.6)


@pytest.fixture(scope="module")
def at_rest(craft, motion, skewed_target):
    """What the sensors would give without noise, at zero momentum."""
    return measured(craft, motion, skewed_target, coarse_suite(**FAST))


@pytest.fixture(scope="module")
def scale(skewed_target):
    """What errors are compared with: m, half a metre, tr I."""
    true = skewed_target.to_vector()
    return np.array([true[0], 0.5, 0.5, 0.5, *6 * [true[4:7].sum()]])


# -- the estimators -------------------------------------------------------------------------------


@pytest.mark.parametrize("estimator", ["standard", "relative", "trajectory_fit"])
def test_every_estimator_is_near_and_gives_a_rigid_body(
    craft, at_rest, skewed_target, scale, estimator
):
    """Within 0.2 % of m, 0.5 m and tr I on flight-like sensors, and as the covariance says."""
    suite, true = coarse_suite(**FAST), skewed_target.to_vector()
    result = identify(craft, add_noise(suite, at_rest, 1), sensors=suite, estimator=estimator)
    assert result.rank == 10
    assert np.isfinite(result.covariance).all()
    assert np.linalg.eigvalsh(result.covariance / np.outer(scale, scale))[0] > 0
    assert result.spatial_inertia().IsPhysicallyValid()
    if estimator in ("trajectory_fit", "relative"):
        assert np.abs((result.parameters - true) / scale).max() < 2e-3
        assert result.spatial_inertia().get_mass() == pytest.approx(true[0], rel=2e-3)
    assert "determine 10 of 10 parameters" in result.explain()
    assert nees(result, skewed_target) < chi2.isf(1e-4, 10)


# -- what cannot be known -------------------------------------------------------------------------


@pytest.mark.parametrize(
    "estimator", [pytest.param("recursive_fit", marks=pytest.mark.slow), "trajectory_fit"]
)
def test_without_motion_nothing_is_known(craft, skewed_target, estimator):
    """No rank, or a little from noise; nothing comes out that looks like an answer."""
    q = np.array([0.2, 0.1, -0.3, 0.4])
    suite = coarse_suite(**FAST)
    perfect = measured(craft, HalfCosine(q, q, 4.0), skewed_target, suite)
    options = {"sensors": suite, "estimator": estimator}
    result = identify(craft, add_noise(suite, perfect, 1), **options)
    assert result.rank < 4
    assert not result.is_identifiable
    assert np.isnan(result.parameters).any()
    assert np.isnan(result.covariance).all()
    assert np.isnan(result.spatial_inertia().get_mass())


# -- the Cramér-Rao bound -------------------------------------------------------------------------


def test_the_bound_is_open_where_the_motion_shows_nothing(craft, motion, skewed_target):
    """A slide that moves alone shows no inertia; half as large a motion has twice the σ."""
    suite, sigmas = coarse_suite(), []
    for size in (0.4, 0.2):
        slide = replace(motion, amplitude=size * motion.amplitude * np.eye(4)[1])
        samples = measured(craft, slide, skewed_target, suite)
        bound = cramer_rao_bound(craft.tree, true_psi(craft, skewed_target), samples, suite)
        sigmas.append(np.sqrt(np.diag(bound)))
        shown = sigmas[-1][[4, 5, 6, 7, 8, 9]]
        assert (np.isnan(shown) | (shown > 5.0)).all()  # kg·m²: as large as the moments
    assert sigmas[1][0] == pytest.approx(2 * sigmas[0][0], rel=0.05)


def assert_tighter(better, worse) -> None:
    """Every combination of the parameters is known at least as well, and one far better."""
    size = 1 / np.sqrt(np.diag(worse))
    difference = (worse - better) * size * size[:, None]
    values = np.linalg.eigvalsh(difference)
    assert values[0] > -1e-5  # rounding
    assert values[-1] > 0.05


@pytest.mark.slow
def test_more_and_better_sensors_and_longer_data_tighten_the_bound(craft, motion, skewed_target):
    rich = coarse_suite(velocity=VectorSensor(5.0, 2e-4))
    samples = measured(craft, motion, skewed_target, rich)
    psi = true_psi(craft, skewed_target)

    def bound(suite, samples=samples, **options):
        return cramer_rao_bound(craft.tree, psi, samples, suite, **options)

    reference = bound(rich)
    assert_tighter(reference, bound(replace(rich, gyro=None)))
    assert_tighter(bound(replace(rich, gyro=None)), bound(replace(rich, gyro=None, velocity=None)))
    assert_tighter(bound(replace(rich, attitude=AttitudeSensor(5.0, 1.0, 8.0))), reference)
    assert_tighter(bound(replace(rich, encoders=JointSensor(20.0, 1e-7))), reference)
    assert_tighter(reference, bound(rich, samples.between(0.0, 5.0)))
    assert_tighter(reference, bound(rich, momentum=TotalMomentum.unknown()))
