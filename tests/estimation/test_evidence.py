"""The evidence of sets of errors against the probability of the data, and what is averaged."""

import itertools

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from cpid_drake.estimation.evidence import SIZES, compare
from cpid_drake.estimation.gaussian import Gaussian

N, WIDE = 60, 100.0
SIGMA = {"scale": np.full(2, 0.5), "zero": np.full(1, 3.0), "delay": np.full(1, 2.0)}
ODDS = dict.fromkeys(SIGMA, 1 / 3)
SIZE = {"x": 2, "scale": 2, "zero": 1, "delay": 1}


def problem(seed, scale=(0.0, 0.0), zero=0.0):
    """Data d = A (x, scale, zero, delay) + e with unit noise."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(N, 6))
    truth = np.array([1.0, -2.0, *scale, zero, 0.0])
    return A, A @ truth + rng.normal(size=N), truth


def gaussian_of(A, d):
    sigma = np.concatenate([np.full(2, WIDE), *SIGMA.values()])
    prior = np.column_stack([np.diag(1 / sigma), np.zeros(6)])
    return Gaussian.of_rows(SIZE, np.vstack([np.column_stack([A, d]), prior]))


@pytest.mark.parametrize("alike", [0.0, 2.0])
def test_probabilities_and_average_are_those_of_the_data(alike):
    """All eight sets, each by the probability density of the data, at the sizes that are best."""
    A, d, _ = problem(1, zero=1.5)
    A[:, 5] += alike * A[:, 4]  # a delay of zero
    found = compare(gaussian_of(A, d), SIGMA, ["x"], ODDS)
    places = {"scale": [2, 3], "zero": [4], "delay": [5]}

    def log_density(free, size):
        index = [0, 1, *itertools.chain.from_iterable(places[name] for name in free)]
        sigma = np.concatenate([[WIDE, WIDE], *(size[n] * SIGMA[n] for n in free)])
        B = A[:, index] * sigma
        price = len(free) * (np.log(1 / 3) - np.log(len(SIZES)))
        value = multivariate_normal(cov=np.eye(N) + B @ B.T).logpdf(d) + price
        P = np.linalg.inv(A[:, index].T @ A[:, index] + np.diag(sigma**-2))
        return value, P @ A[:, index].T @ d, P

    best = {}
    for name in ["zero", "scale", "delay"]:  # the one that acts first, the others beside it
        others = ["zero"] if best else []
        tried = [log_density([*others, name], best | {name: a})[0] for a in SIZES]
        best[name] = SIZES[np.argmax(tried)]
    sets = [list(s) for n in range(4) for s in itertools.combinations(places, n)]
    density = [log_density(free, best)[0] for free in sets]
    weight = np.exp(np.array(density) - max(density))
    weight /= weight.sum()
    wide = {}
    for name in places:
        tried = np.array([log_density(list(places), best | {name: a})[0] for a in SIZES])
        by_size = np.exp(tried - tried.max())
        wide[name] = np.sqrt(by_size @ SIZES**2 / by_size.sum())
    every = [log_density(free, wide) for free in sets]
    mean = sum(w * x[:2] for w, (_, x, _) in zip(weight, every))
    square = sum(w * (P[:2, :2] + np.outer(x[:2], x[:2])) for w, (_, x, P) in zip(weight, every))
    covariance = square - np.outer(mean, mean)
    np.testing.assert_allclose(
        found.gaussian.solve(), mean, rtol=0, atol=1e-3 * np.sqrt(covariance[0, 0])
    )
    np.testing.assert_allclose(
        found.gaussian.covariance(), covariance, rtol=1e-2, atol=1e-2 * covariance.max()
    )
    for name in places:
        expected = sum(w for w, free in zip(weight, sets) if name in free)
        assert found.probability[name] == pytest.approx(expected, abs=2e-3)
    assert list(found.best) == sets[int(np.argmax(weight))] == ["zero"]


def test_nothing_hidden_is_found_in_clean_data():
    for seed in range(12):
        A, d, _ = problem(seed)
        assert compare(gaussian_of(A, d), SIGMA, ["x"], ODDS).named == ()


def test_the_set_that_acts_is_found_and_its_values_too():
    for seed in range(5):
        A, d, truth = problem(seed, scale=(1.0, -1.2), zero=-2.0)
        found = compare(gaussian_of(A, d), SIGMA, ["x"], ODDS)
        assert set(found.named) == set(found.best) == {"scale", "zero"}
        np.testing.assert_allclose(found.values["scale"], truth[2:4], atol=1.0)
        np.testing.assert_allclose(found.values["zero"], truth[4:5], atol=1.0)


@pytest.mark.slow
def test_an_error_of_any_size_widens_the_interval_by_what_it_may_do():
    """Drawn as often as expected, and of all sizes: the average is as good as it says."""
    squares, without = [], []
    for seed in range(300):
        rng = np.random.default_rng(seed + 1000)
        size = 10 ** rng.uniform(-2.0, 0.5) * rng.choice([0, 1], p=[0.75, 0.25])
        A, d, truth = problem(seed, zero=size)
        A = A.copy()
        A[:, 4] += 2 * A[:, 0]
        d = d + 2 * A[:, 0] * size
        gaussian = gaussian_of(A, d)
        found = compare(gaussian, SIGMA, ["x"], ODDS)
        e = found.gaussian.solve() - truth[:2]
        squares.append(e @ np.linalg.solve(found.gaussian.covariance(), e))
        plain = gaussian.condition({"scale": 0.0, "zero": 0.0, "delay": 0.0})
        e = plain.solve() - truth[:2]
        without.append(e @ np.linalg.solve(plain.covariance(), e))
    assert np.mean(without) > 20
    assert 1.6 < np.mean(squares) < 2.6
