"""One rule of what is known: of a target, and of the difference between two."""

import numpy as np
import pytest
from scipy.stats import chi2
from sensing_cases import coarse_suite, small_craft, true_psi

from cpid_drake.estimation.gaussian import Gaussian
from cpid_drake.estimation.least_squares import KNOWN
from cpid_drake.estimation.posterior import difference, target_estimate
from cpid_drake.estimation.unknowns import PSI, Model


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    return Model(small_craft(tmp_path_factory.mktemp("craft")).tree, coarse_suite())


@pytest.fixture(scope="module")
def psi(tmp_path_factory, skewed_target):
    return true_psi(small_craft(tmp_path_factory.mktemp("other")), skewed_target)


def prior(model, psi):
    return model.cone.prior(PSI, psi)


def told(rows, step):
    """Return rows (k, 10) with unit noise that say that ψ is off by a step (10,)."""
    return Gaussian.of_rows({PSI: 10}, np.column_stack([rows, rows @ step]))


def test_the_prior_alone_knows_nothing(model, psi):
    found = target_estimate(model, psi, prior(model, psi))
    assert found.rank == 0
    assert np.isnan(found.estimate).all()
    assert np.isnan(found.covariance).all()
    assert len(found.unidentifiable) == 10


def test_what_samples_tell_is_told_without_the_prior(model, psi):
    """Value and covariance are those of the samples, weak or strong, if they are known at all."""
    unit = np.linalg.inv(prior(model, psi).R)
    rng = np.random.default_rng(3)
    axes = np.linalg.qr(rng.standard_normal((10, 10)))[0]
    rows = np.geomspace(4.0, 1e5, 10)[:, None] * axes @ np.linalg.inv(unit)
    step = unit @ rng.standard_normal(10) / 100
    found = target_estimate(model, psi, told(rows, step).add(prior(model, psi)))
    assert found.rank == 10
    np.testing.assert_allclose(
        (found.estimate - psi - step) / np.abs(unit).max(axis=1), 0, atol=1e-9
    )
    np.testing.assert_allclose(found.covariance, np.linalg.inv(rows.T @ rows), rtol=1e-5)
    np.testing.assert_allclose(found.determined.R.T @ found.determined.R, rows.T @ rows, rtol=1e-5)


@pytest.mark.parametrize("flatness", [0.0, 0.95])
def test_a_combination_is_known_from_a_share_of_its_plausible_size_on(model, psi, flatness):
    """However flat the estimate is, about which the prior is narrow."""
    psi = psi - flatness * np.r_[np.zeros(4), psi[4:]]
    axes = np.linalg.qr(np.random.default_rng(4).standard_normal((10, 10)))[0]
    for size, rank in ((0.98, 9), (1.02, 10)):
        sizes = np.append(np.full(9, 1e3), size / KNOWN)
        rows = sizes[:, None] * axes / model.plausible
        found = target_estimate(model, psi, told(rows, np.zeros(10)).add(prior(model, psi)))
        assert found.rank == rank
        assert np.isnan(found.estimate).any() == (rank < 10)


def test_the_difference_of_two_targets_has_its_distribution(model, psi):
    """Whether both logs know all of it or few combinations, and share an error of the hardware."""
    unit, rng = np.linalg.inv(prior(model, psi).R), np.random.default_rng(0)
    names, inside = [PSI, f"{PSI} 1"], np.linalg.inv(prior(model, psi).R)
    axes = [100.0 * rng.standard_normal((k, 10)) @ np.linalg.inv(unit) for k in (10, 4)]
    shared = [rng.standard_normal((k, 2)) * 50 for k in (10, 4)]
    values, counts = [], []
    for _ in range(400):
        total = Gaussian.of_rows({"errors": 2}, np.column_stack([np.eye(2), np.zeros(2)]))
        target, errors = inside @ rng.standard_normal(10), rng.standard_normal(2)
        for name, A, B in zip(names, axes, shared, strict=True):
            b = A @ target + B @ errors + rng.standard_normal(len(A))
            rows = Gaussian.of_rows({name: 10, "errors": 2}, np.column_stack([A, B, b]))
            none = Gaussian.of_triangle({name: 10}, 1e-4 * prior(model, psi).rows)
            total = total.add(rows).add(none)
        chi_squared, freedom = difference(total, model.plausible, names)
        values.append(chi_squared)
        counts.append(freedom)
    assert set(counts) <= {2, 3, 4}
    low, high = chi2.ppf([1e-4, 1 - 1e-4], sum(counts))
    assert low < sum(values) < high


def test_another_target_is_noticed(model, psi):
    unit = np.linalg.inv(prior(model, psi).R)
    rows, names = 100.0 * np.linalg.inv(unit), [PSI, "psi 1", "psi 2"]
    total = Gaussian.of_rows({}, np.zeros((0, 1)))
    for k, name in enumerate(names):
        step = unit @ np.full(10, 0.1 * (k == 2))
        total = total.add(Gaussian.of_triangle({name: 10}, told(rows, step).rows))
    chi_squared, freedom = difference(total, model.plausible, names)
    assert freedom == 20
    assert chi_squared == pytest.approx(2 / 3 * 10 * 10.0**2, rel=1e-2)


def test_a_difference_is_known_from_the_same_share_on(model):
    inside = np.diag(1 / model.plausible)
    for size, freedom in ((0.98, 0), (1.02, 10)):
        total = told(1e3 * inside, np.zeros(10))
        rows = size / KNOWN * inside
        total = total.add(Gaussian.of_triangle({"psi 1": 10}, told(rows, np.zeros(10)).rows))
        assert difference(total, model.plausible, [PSI, "psi 1"]) == (0.0, freedom)
