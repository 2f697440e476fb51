"""The spacecraft of these tests."""

import pytest
from sensing_cases import small_craft


@pytest.fixture(scope="module")
def craft(tmp_path_factory):
    return small_craft(tmp_path_factory.mktemp("craft"))
