"""A firing far above the noise, which no log says."""

import pytest
from cases import fired, world_of
from logs import log_of
from scipy.stats import chi2
from sensing_cases import nees

from cpid_drake import identify, load_sensors, read_log


@pytest.mark.slow
def test_it_is_found_and_blames_no_body(tmp_path):
    """χ² is 1e8 without changes: what such a fit makes of the bodies says nothing about them."""
    world, suite = fired(world_of("thruster_firing")), load_sensors("flight", unstated="exact")
    log = read_log(log_of(world, suite, 1, tmp_path / "log.npz"))
    found = identify(world.craft, log, sensors=suite)
    assert not found.failures
    assert len(found.momentum_changes) == 1
    assert abs(found.momentum_changes[0] - 5.0) < 0.1
    assert nees(found, world.target) < chi2.isf(1e-3, 10)
