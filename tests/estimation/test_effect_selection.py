"""The choice of constant errors, against marginal likelihoods of linear models."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from cpid_drake.estimation.effect_selection import EffectSelection, LogFit, model_average
from cpid_drake.estimation.likelihood.constants import ConstantError, Constants

ERRORS = (
    ConstantError("acceleration", 3, 1e-3, "m/s²", 1.0),
    ConstantError("attitude.delay", 1, 0.02, "ms", 1e-3),
    ConstantError("position.delay", 1, 0.02, "ms", 1e-3),
    ConstantError("gyro.scale", 3, 1e-3, "ppm", 1e-6),
)
PRIOR_PSI = 5.0
NAMES = [error.name for error in ERRORS]


def model(seed: int, rows: int = 60) -> np.ndarray:
    """Return a random linear model y = A (c, ψ) + noise of unit variance."""
    return np.random.default_rng(seed).standard_normal((rows, 18))


def selection(A: np.ndarray, y: np.ndarray, candidates=NAMES, nominal=None) -> EffectSelection:
    """Return the selection for samples y, linearized about nominal values (18,)."""
    return EffectSelection([log_fit(A, y, nominal)], candidates)


def log_fit(A: np.ndarray, y: np.ndarray, nominal=None, name="") -> LogFit:
    """Return the fit of samples y, linearized about nominal values (18,)."""
    x = np.zeros(18) if nominal is None else nominal
    prior = np.diag([1.0] * 8 + [1 / PRIOR_PSI] * 10)
    rows, rest = np.vstack([prior, A]), np.concatenate([-prior @ x, y - A @ x])
    root, z = np.linalg.qr(np.column_stack([rows, rest]))[1][:18, :18], None
    z = np.linalg.qr(np.column_stack([rows, rest]))[1][:18, 18]
    constants = Constants(ERRORS)
    places = {
        name: slice(constants.place(name).start + 6, constants.place(name).stop + 6)
        for name in NAMES
    }
    solver = SimpleNamespace(constants=constants, places=places | {"psi": slice(14, 24)})
    big = np.zeros((24, 24))
    big[:6, :6], big[6:, 6:] = np.eye(6), root
    nominal_state = SimpleNamespace(constants=x[:8], psi=x[8:])
    known = SimpleNamespace(root=big, rest=np.concatenate([np.zeros(6), z]), nominal=nominal_state)
    return LogFit(solver, known, name=name)


def exact(A: np.ndarray, y: np.ndarray, free) -> float:
    """Return the logarithm of the marginal likelihood of y."""
    constants, variance = Constants(ERRORS), np.zeros(18)
    variance[8:] = PRIOR_PSI**2
    for name in free:
        variance[constants.place(name)] = 1.0
    return multivariate_normal(cov=np.eye(len(y)) + A * variance @ A.T).logpdf(y)


@pytest.mark.parametrize("free", [[], ["attitude.delay"], ["gyro.scale", "acceleration"], NAMES])
def test_ratios_are_those_of_marginal_likelihoods(free):
    """Of linear models, for which both are exact; about any nominal values."""
    A, rng = model(1), np.random.default_rng(2)
    y = A @ rng.standard_normal(18) + rng.standard_normal(60)
    for nominal in (None, rng.standard_normal(18)):
        found = selection(A, y, nominal=nominal)
        ratio = found.submodel(free).log_likelihood - found.submodel(NAMES).log_likelihood
        assert ratio == pytest.approx(exact(A, y, free) - exact(A, y, NAMES), abs=1e-8)


@pytest.mark.parametrize("hidden", [[], *([name] for name in NAMES), NAMES[:2], NAMES[1:]])
def test_the_hidden_errors_are_found_and_no_others(hidden):
    A, rng, constants = model(7, 400), np.random.default_rng(8), Constants(ERRORS)
    x = np.zeros(18)
    x[8:] = rng.standard_normal(10)
    for name in hidden:
        x[constants.place(name)] = 1.5
    y = A @ x + rng.standard_normal(400)
    assert set(selection(A, y).best(5.0).free) == set(hidden)


def test_the_average_of_models_is_that_of_their_mixture():
    """Against samples of the mixture, with weights from the exact marginal likelihoods."""
    A, rng = model(21), np.random.default_rng(22)
    A[:, 3] = 3 * A[:, 8] + 0.5 * A[:, 3]  # an error that acts nearly as the target does
    x = np.append(np.zeros(8), rng.standard_normal(10))
    x[3] = 0.8
    y = A @ x + rng.standard_normal(60)
    found, odds = selection(A, y), 0.2
    nothing, others = found.submodel(()), [found.submodel([name]) for name in NAMES]
    average = model_average(nothing, others, odds, 0.0)
    weights = np.array([1.0, *(odds * np.exp(exact(A, y, [n]) - exact(A, y, ())) for n in NAMES)])
    weights /= weights.sum()
    assert 0.1 < weights[0] < 0.9
    np.testing.assert_allclose([*average.probabilities.values()], weights[1:], rtol=1e-6)
    counts = np.rint(4_000_000 * weights).astype(int)
    draws = np.concatenate(
        [
            rng.multivariate_normal(each.psi, each.covariance, count)
            for each, count in zip([nothing, *others], counts)
        ]
    )
    error = draws - nothing.psi
    second = error.T @ error / len(error)
    scale = np.sqrt(np.diag(second))
    wider = (nothing.covariance + average.spread - second) / scale / scale[:, None]
    np.testing.assert_allclose(wider, 0.0, atol=0.01)
    assert np.trace(average.spread) > 0.1 * np.trace(nothing.covariance)
