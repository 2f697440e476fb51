"""Rows of many samples, and the nearest rigid body in their own metric."""

import numpy as np
import pytest

from cpid_drake import InertialParameters, identify


def test_all_rows_of_a_long_log_count(servicer, zero_momentum_motion, skewed_target):
    """More samples than are made rows of at once: every one leaves its degrees of freedom."""
    found = identify(servicer, zero_momentum_motion(skewed_target, 2500, 3), rows="standard")
    assert found.solution.row_count == 6 * 2500


@pytest.mark.parametrize("rows", ["eq18", "standard"])
def test_no_rigid_body_is_nearer_than_the_feasible_one(
    servicer, zero_momentum_motion, paper_target, rows
):
    """The distance is that of the covariance of what is reported, to first order."""
    samples = zero_momentum_motion(paper_target, 12, 5).rounded(3)
    found = identify(servicer, samples, rows=rows)
    assert found.raw().infeasibilities()
    information = np.linalg.inv(found.covariance)

    def distance(vector) -> float:
        error = vector - found.parameters
        return error @ information @ error

    nearest = found.feasible().to_vector()
    sigma = np.sqrt(np.diag(found.covariance))
    rng = np.random.default_rng(1)
    for size in (0.01, 0.1, 1.0):
        for _ in range(10):
            other = nearest + size * sigma * rng.normal(size=10)
            body = InertialParameters.from_vector(other).nearest_feasible()
            assert distance(body.to_vector()) > 0.98 * distance(nearest)
