"""What one change of momentum says of a white torque, against the densities of the data."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from cpid_drake.estimation.gaussian import Gaussian
from cpid_drake.estimation.links import farthest
from cpid_drake.estimation.unknowns import Model
from cpid_drake.estimation.white_torque import gain_of, gains_of_change, intensities

LENGTH, N = 1.3, 40


@pytest.fixture
def model(craft):
    return Model(craft.tree, None)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_its_gain_is_that_of_the_densities_of_the_data(model, seed):
    """Samples of two changes; of one, L is N(0, q² h), and all else is zero."""
    rng = np.random.default_rng(seed)
    q = intensities(model.tree)
    of_L = np.sqrt(LENGTH) * q[1]
    A = rng.standard_normal((N, 24)) / of_L / np.sqrt(N)
    y = A[:, 18:21] @ (of_L * rng.standard_normal(3)) + rng.standard_normal(N)
    priors = np.diag(1 / np.tile(farthest(model), 2))
    rows = np.vstack([np.column_stack([A, y]), np.column_stack([priors, np.zeros(24)])])
    changes = Gaussian.of_rows({"first": 12, "second": 12}, rows)
    gains = gains_of_change(model, changes, "second", LENGTH)
    without = multivariate_normal(cov=np.eye(N)).logpdf(y)
    for each, gain in zip(q, gains, strict=True):
        B = np.sqrt(LENGTH) * each * A[:, 18:21]
        with_torque = multivariate_normal(cov=np.eye(N) + B @ B.T).logpdf(y)
        assert gain == pytest.approx(2 * (with_torque - without), rel=1e-6, abs=1e-6)


def test_the_gain_of_one_of_some_is_the_mean_of_their_densities():
    assert gain_of([4.0, 4.0, 4.0]) == pytest.approx(4.0)
    assert gain_of([0.0, 2 * np.log(5.0)]) == pytest.approx(2 * np.log(3.0))
