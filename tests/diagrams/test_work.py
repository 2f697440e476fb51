"""Processes that share the work of a comparison."""

import numpy as np
import pytest
from techniques.work import shared_work
from threadpoolctl import threadpool_info, threadpool_limits


def blas_threads() -> set[int]:
    return {each["num_threads"] for each in threadpool_info() if each["user_api"] == "blas"}


def threads_of(matrix: np.ndarray):
    """Return a function whose process has loaded the library that solves small matrices."""
    return lambda task: blas_threads() if np.linalg.inv(matrix).any() else set()


@pytest.mark.slow
@pytest.mark.parametrize("jobs", [1, 2])
def test_processes_that_share_work_have_one_thread_each(jobs):
    """What a machine with two processors has by itself is given back."""
    with threadpool_limits(2, user_api="blas"):
        assert list(shared_work(threads_of, np.eye(2), [0, 1], jobs)) == [{1}, {1}]
        assert blas_threads() == {2}
