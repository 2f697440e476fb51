"""Bounds over rigid bodies: they contain the truth, turn with C, and are exact in limit cases."""

import numpy as np
import pytest
from paper_equations import eq18_to_world
from scipy.spatial.transform import Rotation

from cpid_drake.dynamics.parameterizations import (
    parameters_to_eq18,
    parameters_to_standard,
    relative_parameterization,
    standard_to_parameters,
    tensor_to_vector,
)
from cpid_drake.estimation.gaussian import Gaussian
from cpid_drake.estimation.rigid_body_set import RigidBodySet

KNOWN_MASS = 10.0
FORMS = {
    "standard": parameters_to_standard,
    "relative": relative_parameterization(KNOWN_MASS).from_parameters,
    "eq18": parameters_to_eq18,
}


def points(masses, places) -> np.ndarray:
    """Return π (10,) of point masses: any rigid body is a limit of these."""
    second = (np.transpose(places) * masses) @ places
    moments = tensor_to_vector(np.trace(second) * np.eye(3) - second)
    return standard_to_parameters([np.sum(masses), *(np.asarray(masses) @ places), *moments])


def random_body(rng, size: float = 1.0) -> np.ndarray:
    count = rng.integers(1, 7)  # a point, a rod, a plate and others
    places = rng.normal(size=(count, 3))
    places *= size * rng.uniform(0, 1, (count, 1)) / np.linalg.norm(places, axis=1, keepdims=True)
    return points(rng.uniform(0.1, 2.0, count), places)


def bodies(rows, form, mass=1.0, size=1.0, radius=1.0) -> RigidBodySet:
    return RigidBodySet(rows, radius, form, KNOWN_MASS, mass, size)


def rows_of(A, b) -> Gaussian:
    """Return what rows A x = b with unit errors tell of the unknowns x (10,)."""
    return Gaussian.of_rows({"target": 10}, np.column_stack([A, b]))


def exactly(x, places, sigma=1e-9) -> Gaussian:
    """Return the rows of unknowns x (10,) of which some are known."""
    A = np.eye(10)[list(places)] / sigma
    return rows_of(A, A @ x)


@pytest.mark.parametrize("form", FORMS)
def test_the_truth_is_always_inside(form):
    rng = np.random.default_rng(len(form))
    for _ in range(25):
        pi = random_body(rng)
        x = FORMS[form](pi)
        A = rng.normal(size=(rng.integers(1, 11), 10)) * 10 / np.maximum(np.abs(x), 0.05)
        noise = rng.normal(size=len(A))
        found = bodies(rows_of(A, A @ x + noise), form, pi[0], 1.0, np.linalg.norm(noise))
        assert found.nearest()[0] <= found.radius * (1 + 1e-6)
        low, high = found.bounds().T
        slack = 1e-5 * np.array([pi[0], 1, 1, 1, *6 * [pi[0]]])
        assert (low <= pi + slack).all()
        assert (pi <= high + slack).all()


def test_more_information_never_widens_the_bounds():
    rng = np.random.default_rng(3)
    pi = random_body(rng)
    x = parameters_to_standard(pi)
    A = rng.normal(size=(10, 10)) * 10 / np.maximum(np.abs(x), 0.05)
    before = first = None
    for count in range(2, 11):
        bounds = bodies(rows_of(A[:count], A[:count] @ x), "standard", pi[0]).bounds()
        if before is not None:
            # The inertia's bounds use those of the centre of mass, so they shrink as well.
            assert (bounds[:, 0] >= before[:, 0] - 1e-5).all()
            assert (bounds[:, 1] <= before[:, 1] + 1e-5).all()
        before = bounds
        first = bounds if first is None else first
    assert (np.diff(before) < 0.7 * np.diff(first)).all()


@pytest.mark.parametrize("form", ["standard", "relative"])
def test_the_bounds_of_what_does_not_turn_do_not_depend_on_cs_axes(form):
    """The bounds of the mass are the same; those of Ixx are those of Iyy after a quarter turn."""
    rng = np.random.default_rng(5)
    pi = random_body(rng)
    x = FORMS[form](pi)
    A = rng.normal(size=(5, 10)) * 10 / np.maximum(np.abs(x), 0.05)
    rows = rows_of(A, A @ x)
    straight = bodies(rows, form, pi[0]).bounds()
    quarter = eq18_to_world(Rotation.from_euler("z", 90, degrees=True).as_matrix()[None])[0]
    turned = bodies(rows_of(A @ np.linalg.inv(quarter), A @ x), form, pi[0]).bounds()
    np.testing.assert_allclose(turned[0], straight[0], rtol=1e-5)
    # cx' = −cy, cy' = cx; Ixx' = Iyy, Ixy' = −Ixy
    np.testing.assert_allclose(turned[1], -straight[2, ::-1], atol=1e-5)
    np.testing.assert_allclose(turned[2], straight[1], atol=1e-5)
    np.testing.assert_allclose(turned[4], straight[5], atol=1e-5)
    np.testing.assert_allclose(turned[7], -straight[7, ::-1], atol=1e-5)


def test_a_moment_and_the_mass_bound_the_others():
    """In the plane: 0 ≤ Ixx ≤ Izz + Σzz, |Ixy| ≤ Izz / 2, with Σzz limited by the size."""
    m, com, Izz, size = 2.0, np.array([0.3, -0.1]), 0.05, 0.8
    x = np.zeros(10)
    x[:3] = m, *(m * com)
    x[9] = Izz + m * com @ com
    bounds = bodies(exactly(x, [0, 1, 2, 9]), "standard", m, size).bounds()
    slack = 2e-3 * m * size**2
    np.testing.assert_allclose(bounds[7], [-Izz / 2, Izz / 2], atol=slack)
    across = m * (size**2 - com @ com) - Izz  # largest Σzz about C's origin
    np.testing.assert_allclose(bounds[4], [0, Izz + across], atol=slack)
    np.testing.assert_allclose(bounds[5], [0, Izz + across], atol=slack)
    np.testing.assert_allclose(bounds[3], np.array([-1, 1]) * np.sqrt(across / m), atol=2e-3)


def test_a_thin_rod_has_equal_moments():
    """Ixx = 0 means that all mass is on a line along x: Iyy = Izz, and no products."""
    x = np.zeros(10)
    x[[0, 4, 7]] = 1.0, 0.0, 0.1
    found = bodies(exactly(x, [0, 1, 2, 3, 4, 7]), "eq18", 1.0, 1.0).bounds()
    np.testing.assert_allclose(found[6], [0.1, 0.1], atol=3e-3)
    np.testing.assert_allclose(found[7:], 0, atol=2e-2)


def test_a_plates_moments_are_related():
    """Ixx + Iyy = Izz at the limit: a third moment larger than the sum is impossible."""
    x = np.zeros(10)
    x[[0, 4, 7]] = 1.0, 0.04, 0.06
    found = bodies(exactly(x, [0, 1, 2, 3, 4, 7]), "eq18", 1.0, 1.0).bounds()
    np.testing.assert_allclose(found[6], [0.02, 0.10], atol=2e-3)  # |Ixx − Iyy| ≤ Izz ≤ Ixx + Iyy


def test_a_point_mass_has_no_inertia():
    m, com = 2.0, np.array([0.3, -0.2, 0.4])
    x = parameters_to_standard(points(np.array([m]), com[None]))
    trace = x[4] + x[7] + x[9]
    A = np.zeros((5, 10))
    A[:4, :4] = np.eye(4)
    A[4, [4, 7, 9]] = 1.0
    b = np.array([*x[:4], trace])
    found = bodies(rows_of(1e9 * A, 1e9 * b), "standard", m, 1.0).bounds()
    np.testing.assert_allclose(found[4:], 0, atol=5e-3)


def test_nothing_known_of_the_mass_leaves_it_unbounded():
    x = parameters_to_eq18(random_body(np.random.default_rng(1)))
    found = bodies(exactly(x, [1, 2, 3]), "eq18").bounds()
    assert found[0, 1] == np.inf


def test_a_negative_moment_is_no_rigid_body():
    x = np.zeros(10)
    x[[0, 9]] = 1.0, -0.05
    negative = bodies(exactly(x, [0, 1, 2, 9], sigma=0.01), "standard", radius=3.0)
    assert negative.bounds() is None
    assert negative.nearest()[0] == pytest.approx(5.0, rel=1e-3)  # 0.05 / 0.01
    uncertain = bodies(exactly(x, [0, 1, 2, 9], sigma=0.02), "standard", radius=3.0)
    low, high = uncertain.bounds()[6]
    assert low == 0.0
    assert 0.0 < high < 0.011  # −0.05 + 3 σ


def test_the_nearest_body_keeps_what_is_known_best():
    """The moments (σ 0.1) give way to the triangle inequality, not the mass (σ 1e-4)."""
    x = np.array([1.0, 0, 0, 0, 0.2, 0, 0, 0.2, 0, 0.5])
    A = np.diag([1e4, 1e4, 1e4, 1e4, *6 * [10.0]])
    distance, near = bodies(rows_of(A, A @ x), "standard").nearest()
    assert distance == pytest.approx(10 * 0.1 / np.sqrt(3), rel=1e-3)
    np.testing.assert_allclose(near[:4], x[:4], atol=1e-4)
    np.testing.assert_allclose(
        near[[4, 7, 9]], x[[4, 7, 9]] + [0.1 / 3, 0.1 / 3, -0.1 / 3], atol=1e-4
    )
