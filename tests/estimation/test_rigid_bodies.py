"""The nearest rigid body, in the metric of what is known."""

import numpy as np
import pytest

from cpid_drake.dynamics.parameterizations import (
    EQ18,
    STANDARD,
    relative_parameterization,
    standard_to_parameters,
    tensor_to_vector,
)
from cpid_drake.estimation.gaussian import Gaussian
from cpid_drake.estimation.rigid_bodies import nearest, sizes, without_rounding

KNOWN_MASS = 10.0
FORMS = [STANDARD, relative_parameterization(KNOWN_MASS), EQ18]
ONE = np.ones(10)


def points(masses, places) -> np.ndarray:
    """Return π (10,) of point masses: any rigid body is a limit of these."""
    second = (np.transpose(places) * masses) @ places
    moments = tensor_to_vector(np.trace(second) * np.eye(3) - second)
    return standard_to_parameters([np.sum(masses), *(np.asarray(masses) @ places), *moments])


def rows_of(A, b) -> Gaussian:
    """Return what rows A x = b with unit errors tell of the unknowns x (10,)."""
    return Gaussian.of_rows({"target": 10}, np.column_stack([A, b]))


@pytest.mark.parametrize("form", FORMS, ids=lambda form: form.name)
def test_a_body_that_is_known_is_the_nearest(form):
    """Also one without extent along an axis or two, and if a part of it is known."""
    rng = np.random.default_rng(len(form.name))
    for count in range(1, 7):
        pi = points(rng.uniform(0.1, 2.0, count), rng.normal(size=(count, 3)))
        x, scale = form.from_parameters(pi), sizes(form, pi[0], 1.0)
        A = rng.normal(size=(rng.integers(1, 11), 10)) * 100 / scale
        distance, near = nearest(rows_of(A, A @ x), form, KNOWN_MASS, scale)
        assert distance < 1e-3
        np.testing.assert_allclose(A @ near, A @ x, atol=1e-3)


def test_a_heavy_target_still_has_less_than_the_known_mass_in_relative_unknowns():
    form = FORMS[1]
    x = np.array([1.5 * KNOWN_MASS, 0, 0, 0, 2.0, 0, 0, 2.0, 0, 2.0])
    distance, near = nearest(rows_of(10 * np.eye(10), 10 * x), form, KNOWN_MASS, ONE)
    assert distance == pytest.approx(10 * 0.5 * KNOWN_MASS, rel=1e-3)
    assert near[0] == pytest.approx(KNOWN_MASS, rel=1e-3)


def test_a_negative_moment_is_no_rigid_body():
    x, known = np.zeros(10), np.eye(10)[[0, 1, 2, 9]]
    x[[0, 9]] = 1.0, -0.05
    distance, _ = nearest(rows_of(known / 0.01, known @ x / 0.01), STANDARD, KNOWN_MASS, ONE)
    assert distance == pytest.approx(5.0, rel=1e-3)  # 0.05 / 0.01


def test_the_nearest_body_keeps_what_is_known_best():
    """The moments (σ 0.1) give way to the triangle inequality, not the mass (σ 1e-4)."""
    x = np.array([1.0, 0, 0, 0, 0.2, 0, 0, 0.2, 0, 0.5])
    A = np.diag([1e4, 1e4, 1e4, 1e4, *6 * [10.0]])
    distance, near = nearest(rows_of(A, A @ x), STANDARD, KNOWN_MASS, ONE)
    assert distance == pytest.approx(10 * 0.1 / np.sqrt(3), rel=1e-3)
    np.testing.assert_allclose(near[:4], x[:4], atol=1e-4)
    np.testing.assert_allclose(
        near[[4, 7, 9]], x[[4, 7, 9]] + [0.1 / 3, 0.1 / 3, -0.1 / 3], atol=1e-4
    )


def test_what_is_smaller_than_rounding_is_no_knowledge():
    scale = sizes(STANDARD, 2.0, 0.5)
    A = np.diag([1e9, 1.0, *8 * [1e3]]) / scale
    found = without_rounding(rows_of(A, A @ np.ones(10)), scale)
    sigma = np.sqrt(np.diag(found.covariance())) / scale
    np.testing.assert_allclose(sigma, [3e-5, 1.0, *8 * [1e-3]], rtol=1e-6)
    np.testing.assert_allclose(found.solve(), 1.0, rtol=1e-6)
