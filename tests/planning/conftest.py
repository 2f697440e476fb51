"""Scenarios with what a planner needs of them."""

import pytest
from planning_cases import Planned, planned


@pytest.fixture(scope="session")
def exciting() -> Planned:
    return planned("exciting_motion", "flight")


@pytest.fixture(scope="session")
def uncertain() -> Planned:
    return planned("uncertain_spacecraft", "flight")
