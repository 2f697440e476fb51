"""The zero of the clock means nothing: samples with other stamps say the same of the target."""

import numpy as np
import pytest
from sensing_cases import MOMENTUM, Sines, coarse_suite, measured, small_craft

from cpid_drake import identify
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.identification.estimators import methods
from cpid_drake.sensing.measurements import Samples
from cpid_drake.sensing.noise import add_noise

SHIFT = 256.0
"""Added to every stamp [s]; a power of two, so that stamps keep nearly all their digits."""


@pytest.fixture(scope="module")
def craft(tmp_path_factory):
    return small_craft(tmp_path_factory.mktemp("craft"))


SMALL, LARGE = (
    0.03,
    0.6,
)  # motions [rad]: of the small one the recursive fit is not sure after one window


@pytest.mark.parametrize(
    ("estimator", "size"),
    [*((name, LARGE) for name in methods() if name != "eq18"), ("recursive_fit", SMALL)],
)
def test_estimate_and_covariance_are_those_of_samples_from_zero_on(
    craft, skewed_target, estimator, size
):
    suite, motion = coarse_suite(), Sines.drawn(4, seed=101, duration=6.0, size=size)
    samples = add_noise(suite, measured(craft, motion, skewed_target, suite, MOMENTUM), seed=2)
    later = samples.updated({name: Samples(s.time + SHIFT, s.value) for name, s in samples.items()})
    options = {"estimator": estimator, "sensors": suite, "momentum": TotalMomentum.unknown()}
    first, second = (identify(craft, data, **options) for data in (samples, later))
    sigma = np.sqrt(np.diag(first.covariance))
    assert np.isfinite(sigma).all()
    np.testing.assert_array_less(np.abs(second.parameters - first.parameters), 0.01 * sigma)
    np.testing.assert_allclose(np.sqrt(np.diag(second.covariance)), sigma, rtol=0.01)
    assert (second.rejected, second.warnings) == (first.rejected, first.warnings)
    assert not any("momentum" in warning for warning in first.warnings)
