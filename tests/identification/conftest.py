"""The spacecraft of these tests, and its sensors."""

import pytest
from sensing_cases import coarse_suite


@pytest.fixture(scope="module")
def suite():
    return coarse_suite()
