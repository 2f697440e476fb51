"""The spacecraft of these tests, and its sensors."""

import pytest
from sensing_cases import coarse_suite, small_craft


@pytest.fixture(scope="module")
def craft(tmp_path_factory):
    return small_craft(tmp_path_factory.mktemp("craft"))


@pytest.fixture(scope="module")
def suite():
    return coarse_suite()
