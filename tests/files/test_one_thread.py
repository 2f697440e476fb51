"""Small matrices are solved by one thread, whatever the environment says."""

from dataclasses import fields

import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from cpid_drake import Motion, identify


def blas_threads() -> set[int]:
    return {each["num_threads"] for each in threadpool_info() if each["user_api"] == "blas"}


@pytest.fixture
def two_threads():
    """What a machine with two processors has by itself."""
    with threadpool_limits(2, user_api="blas"):
        yield


class Witness(Motion):
    """Exact states that note with how many threads they are read."""

    def __len__(self) -> int:
        seen.append(blas_threads())
        return super().__len__()


seen: list[set[int]] = []


def test_identify_needs_one_thread_and_gives_the_others_back(servicer, random_motion, two_threads):
    motion = random_motion(20, 3)
    motion = Witness(**{field.name: getattr(motion, field.name) for field in fields(motion)})
    seen.clear()
    identify(servicer, motion)
    assert seen
    assert all(each == {1} for each in seen)
    assert blas_threads() == {2}
