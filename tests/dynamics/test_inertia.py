"""The ten parameters: every representation says the same, and consistency is what physics says."""

import numpy as np
import pytest
from scipy.linalg import eigh
from scipy.spatial.transform import Rotation

from cpid_drake import InertialParameters, InputError
from cpid_drake.dynamics.parameterizations import (
    EQ18,
    STANDARD,
    point_mass_inertia,
    relative_parameterization,
    second_moment,
    standard_to_pseudo_inertia,
)


def pseudo_inertia(body: InertialParameters) -> np.ndarray:
    return standard_to_pseudo_inertia(body.to_standard_vector())


def random_body(rng: np.random.Generator) -> InertialParameters:
    """Point masses at random places: a body that certainly exists."""
    masses, points = rng.uniform(0.5, 20.0, 6), rng.normal(size=(6, 3))
    com = masses @ points / masses.sum()
    inertia = sum(point_mass_inertia(m, p - com) for m, p in zip(masses, points, strict=True))
    return InertialParameters(masses.sum(), com, inertia)


@pytest.mark.parametrize(
    "parameterization",
    [EQ18, STANDARD, relative_parameterization(1031.0)],
    ids=lambda parameterization: parameterization.name,
)
def test_vectors_and_parameters_convert_both_ways(parameterization):
    parameters = random_body(np.random.default_rng(1)).to_vector()
    vector = parameterization.from_parameters(parameters)
    np.testing.assert_allclose(parameterization.to_parameters(vector), parameters, rtol=1e-13)


@pytest.mark.parametrize(
    "parameterization",
    [EQ18, STANDARD, relative_parameterization(1031.0)],
    ids=lambda parameterization: parameterization.name,
)
def test_jacobian_is_the_derivative(parameterization):
    vector = parameterization.from_parameters(random_body(np.random.default_rng(2)).to_vector())
    step = 1e-6 * np.abs(vector)
    columns = [
        (
            parameterization.to_parameters(vector + h * e)
            - parameterization.to_parameters(vector - h * e)
        )
        / (2 * h)
        for h, e in zip(step, np.eye(10), strict=True)
    ]
    jacobian = parameterization.jacobian(vector)
    scale = np.abs(jacobian).max(axis=0)
    assert np.abs((np.stack(columns, axis=1) - jacobian) / scale).max() < 1e-7


@pytest.mark.parametrize(
    "parameterization", [STANDARD, relative_parameterization(1031.0)], ids=["standard", "relative"]
)
def test_the_covariance_of_parameters_is_that_of_many_draws(parameterization):
    """A mass that is known to 0.5 % bends what is known to 0.0005 %: to first order, the least
    variance would be a five-hundredth of that of the draws."""
    vector = parameterization.from_parameters(random_body(np.random.default_rng(2)).to_vector())
    rng, sigma = np.random.default_rng(4), np.array([5e-3, *9 * [5e-6]]) * np.abs(vector)
    draws = parameterization.to_parameters(vector + sigma * rng.normal(size=(200_000, 10)))
    drawn, found = np.cov(draws.T), parameterization.covariance(vector, np.diag(sigma))
    scale = np.sqrt(np.diag(drawn))
    drawn, found = (each / scale / scale[:, None] for each in (drawn, found))
    np.testing.assert_allclose(eigh(found, drawn, eigvals_only=True), 1.0, atol=0.03)


@pytest.mark.parametrize(
    "parameterization", [STANDARD, relative_parameterization(1031.0)], ids=["standard", "relative"]
)
def test_what_does_not_depend_on_an_unknown_coordinate_is_known(parameterization):
    """On a table cz and four moments are unknown (NaN): mass, cx, cy and Izz convert without."""
    known = random_body(np.random.default_rng(3)).to_vector()
    unknown = known.copy()
    unknown[[3, 4, 5, 7, 8, 9]] = np.nan
    vector = parameterization.from_parameters(unknown)
    expected = parameterization.from_parameters(known)
    np.testing.assert_array_equal(vector[[0, 1, 2, 9]], expected[[0, 1, 2, 9]])
    jacobian, full = (parameterization.jacobian(each) for each in (vector, expected))
    np.testing.assert_array_equal(jacobian[[0, 1, 2, 6], :3], full[[0, 1, 2, 6], :3])


def test_pseudo_inertia_is_the_second_moment_of_the_mass():
    """Point masses: Σ m p pᵀ, Σ m p and Σ m are the blocks (Wensing et al. 2018)."""
    rng = np.random.default_rng(5)
    masses, points = rng.uniform(0.5, 2.0, 5), rng.normal(size=(5, 3))
    homogeneous = np.hstack([points, np.ones((5, 1))])
    expected = (masses[:, None] * homogeneous).T @ homogeneous
    com = masses @ points / masses.sum()
    inertia = sum(point_mass_inertia(m, p - com) for m, p in zip(masses, points, strict=True))
    body = InertialParameters(masses.sum(), com, inertia)
    np.testing.assert_allclose(pseudo_inertia(body), expected, rtol=1e-12, atol=1e-12)


def test_the_papers_true_inertia_is_consistent_though_on_the_limit(paper_target):
    assert paper_target.is_physically_consistent()
    assert paper_target.to_spatial_inertia().IsPhysicallyValid()
    assert min(np.linalg.eigvalsh(pseudo_inertia(paper_target))) < 1e-9


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"mass": -1.0}, "not positive"),
        ({"mass": 0.0}, "not positive"),
        ({"I_TTcm_C": np.diag([-1.0, 1.0, 1.0])}, "negative"),
        ({"I_TTcm_C": np.diag([1.0, 1.0, 2.1])}, "triangle inequality"),
    ],
)
def test_inconsistency_is_said_in_words(change, reason):
    values = {"mass": 1.0, "p_CTcm_C": np.zeros(3), "I_TTcm_C": np.eye(3)} | change
    assert reason in "; ".join(InertialParameters(**values).inconsistencies())


def test_consistency_does_not_depend_on_the_frame(paper_target):
    """A flat body stays consistent, and an inconsistent one inconsistent, however it is turned."""
    inconsistent = np.diag([20.0, 30.001, 10.0])
    for R in Rotation.random(50, np.random.default_rng(9)).as_matrix():
        turned = InertialParameters(
            100.0, R @ paper_target.p_CTcm_C, R @ paper_target.I_TTcm_C @ R.T
        )
        assert turned.is_physically_consistent()
        assert not InertialParameters(
            1.0, np.zeros(3), R @ inconsistent @ R.T
        ).is_physically_consistent()


@pytest.mark.parametrize("violation", [1e-12, 1e-6, 1.0])
def test_a_small_violation_costs_a_small_change(paper_target, violation):
    vector = paper_target.to_vector() + violation * np.array([0, 0, 0, 0, -1, 1, 0, 0, 0, 1])
    raw = InertialParameters.from_vector(vector)
    consistent = raw.nearest_consistent()
    assert consistent.to_spatial_inertia().IsPhysicallyValid()
    # 1e-12 of the body's size is the margin that keeps rounding out of Drake's own check.
    assert np.abs(consistent.to_vector() - vector).max() < 2 * violation + 1e-10


def test_the_nearest_inertia_is_nearer_than_others_of_rigid_bodies():
    """By the second moment, of which random rigid bodies about the same point are no nearer."""
    rng = np.random.default_rng(3)
    raw = InertialParameters(10.0, [0.1, 0.2, -0.1], np.diag([2.0, 1.0, 4.0]))
    near = raw.nearest_consistent()
    assert (near.mass, near.p_CTcm_C.tolist()) == (10.0, [0.1, 0.2, -0.1])

    def distance(inertia):
        return np.linalg.norm(second_moment(inertia) - second_moment(raw.I_TTcm_C))

    for _ in range(300):
        share = rng.uniform(1e-4, 1.0)
        other = (1 - share) * near.I_TTcm_C + share * random_body(rng).I_TTcm_C
        assert distance(near.I_TTcm_C) < distance(other) + 1e-9


def test_a_body_nearest_to_one_of_negative_mass_has_some_mass():
    """At least a thousandth of the estimate's magnitude: a simulator divides by it."""
    raw = InertialParameters(-50.0, [0.1, 0.2, -0.1], np.diag([1.0, 2.0, 2.5]))
    assert raw.nearest_consistent().mass > 0.0499


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (("60", np.zeros(3), np.eye(3)), "numbers, not text"),
        ((60.0, np.zeros(3), "eye"), "numbers, not text"),
        ((1.0, [0, 0], np.eye(3)), "shape"),
        ((1.0, [0, 0, 0], np.eye(2)), "shape"),
        ((np.nan, [0, 0, 0], np.eye(3)), "finite"),
        ((1.0, [0, np.inf, 0], np.eye(3)), "finite"),
        ((1.0, [0, 0, 0], [[1, 2, 0], [0, 1, 0], [0, 0, 1]]), "symmetric"),
        ((1.0, [0, 0, 0], [[1, 1e-6, 0], [0, 1, 0], [0, 0, 1]]), "symmetric"),
    ],
)
def test_bad_values_are_refused(values, message):
    with pytest.raises(InputError, match=message):
        InertialParameters(*values)
