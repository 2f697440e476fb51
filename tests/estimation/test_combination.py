"""Several sources of one linear model: the joint estimate, and the test whether they agree."""

import numpy as np
import pytest
from scipy.stats import kstest

from cpid_drake.estimation.combination import (
    SourceRows,
    agreement,
    agreement_of_one,
    joint_solution,
)

TRUE = np.array([3.0, -1.0, 0.5, 2.0])
SCALE = np.array([1.0, 10.0, 2.0, 5.0])
NOWHERE = np.zeros(4)


def source(seed: int, count: int = 4, x=TRUE) -> SourceRows:
    rng = np.random.default_rng(seed)
    A = 100 * rng.normal(size=(count, 4)) / SCALE
    return SourceRows(A, A @ x + rng.normal(size=count))


def test_the_joint_estimate_is_that_of_all_rows_at_once():
    sources = [source(1), source(2, 2), source(3, 1)]
    A = np.vstack([each.A for each in sources])
    b = np.concatenate([each.b for each in sources])
    found = joint_solution(sources, NOWHERE, SCALE)
    np.testing.assert_allclose(found.estimate, np.linalg.lstsq(A, b, rcond=None)[0], rtol=1e-10)
    np.testing.assert_allclose(found.covariance, np.linalg.inv(A.T @ A), rtol=1e-9)


def test_sources_that_each_leave_something_open_determine_all_together():
    first, second = source(4, 2), source(5, 2)
    assert joint_solution([first], NOWHERE, SCALE).rank == 2
    assert joint_solution([second], NOWHERE, SCALE).rank == 2
    both = joint_solution([first, second], NOWHERE, SCALE)
    assert both.is_observable
    error = both.estimate - TRUE
    assert error @ np.linalg.solve(both.covariance, error) < 20


def test_combinations_that_no_source_determines_keep_their_nominal_values():
    found = joint_solution([SourceRows(np.eye(4)[:1] * 50, np.array([150.0]))], 7 * SCALE, SCALE)
    assert found.estimate[0] == pytest.approx(3.0)
    assert np.isnan(found.estimate[1:]).all()
    np.testing.assert_allclose(found.values[1:], 7 * SCALE[1:])


def test_the_test_of_agreement_is_chi_squared():
    """Two of three sources determine two combinations each: there are 4 − 4 + 2 + 2 = 4 tests."""
    probabilities, singles = [], []
    for k in range(300):
        sources = [source(3 * k), source(3 * k + 1, 2), source(3 * k + 2, 2)]
        whole = agreement(sources, NOWHERE, SCALE)
        one = agreement_of_one(1, sources, NOWHERE, SCALE)
        assert (whole.freedom, one.freedom) == (4, 2)
        probabilities.append(whole.probability)
        singles.append(one.probability)
    assert kstest(probabilities, "uniform").pvalue > 0.01
    assert kstest(singles, "uniform").pvalue > 0.01


def test_the_source_that_differs_is_found():
    sources = [source(1), source(2), source(3, x=TRUE + 0.5 * SCALE), source(4)]
    whole = agreement(sources, NOWHERE, SCALE)
    excess = [agreement_of_one(k, sources, NOWHERE, SCALE).excess for k in range(4)]
    assert whole.probability < 1e-6
    assert int(np.argmax(excess)) == 2


def test_sources_about_different_combinations_cannot_contradict_each_other():
    first = SourceRows(50 * np.eye(4)[:2], np.array([1.0, 2.0]))
    second = SourceRows(50 * np.eye(4)[2:], np.array([300.0, -400.0]))
    assert agreement([first, second], NOWHERE, SCALE).freedom == 0
    assert agreement([first, second], NOWHERE, SCALE).probability == 1.0
