"""Simulated external forces and torques: their size, their random walks and their streams."""

import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from cpid_drake.sensors.disturbances import Disturbances
from cpid_drake.sensors.simulated_disturbance import WALK_PERIOD, SimulatedDisturbance

SIZES = Disturbances(acceleration=1e-4, torque=2e-3)
WALKS = Disturbances(1e-4, 2e-3, acceleration_walk=3e-5, torque_walk=4e-4)


def test_constants_have_the_given_sigma_and_do_not_change():
    drawn = [SimulatedDisturbance(SIZES, seed) for seed in range(2000)]
    values = np.array([each.at(0.0) for each in drawn])
    np.testing.assert_allclose(values.std(axis=0), np.repeat([2e-3, 1e-4], 3), rtol=0.06)
    np.testing.assert_array_equal(drawn[3].at(0.0), drawn[3].at(77.3))
    assert list(drawn[3].changes(0.0, 100.0)) == []


def test_walks_grow_as_the_root_of_time():
    changes = []
    for seed in range(2000):
        drawn = SimulatedDisturbance(WALKS, seed)
        changes.append([drawn.at(t) - drawn.at(0.0) for t in (1.0, 9.0)])
    spread = np.std(changes, axis=0)
    expected = np.outer([1.0, 3.0], np.repeat([4e-4, 3e-5], 3))
    np.testing.assert_allclose(spread, expected, rtol=0.06)


def test_a_walk_is_constant_between_its_changes():
    drawn = SimulatedDisturbance(WALKS, 4)
    edges = list(drawn.changes(0.2, 3.0))
    assert edges == [0.5, 1.0, 1.5, 2.0, 2.5]
    for edge in edges:
        np.testing.assert_array_equal(drawn.at(edge), drawn.at(edge + 0.99 * WALK_PERIOD))
        assert (drawn.at(edge) != drawn.at(edge - 1e-6)).all()


def test_given_constants_replace_random_ones_and_leave_the_walk():
    push = np.array([1.0, -2.0, 3.0])
    free, given = (SimulatedDisturbance(WALKS, 6, acceleration_W=push_W) for push_W in (None, push))
    np.testing.assert_array_equal(given.at(0.0)[3:], push)
    np.testing.assert_array_equal(given.at(7.0)[:3], free.at(7.0)[:3])
    np.testing.assert_allclose(
        given.at(7.0)[3:] - push, free.at(7.0)[3:] - free.at(0.0)[3:], atol=1e-15
    )


@pytest.fixture
def busy():
    """Let threads take turns as often as they can."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(before)


def test_threads_see_the_same_values(busy):
    sizes = Disturbances(1e-4, 2e-3, torque_walk=4e-4, torque_noise=1e-3)
    times = np.arange(0.0, 400.0 * WALK_PERIOD, 20 * WALK_PERIOD)
    expected = SimulatedDisturbance(sizes, 5)
    values = np.array([expected.at(time) for time in times])
    with ThreadPoolExecutor(8) as threads:
        for _ in range(30):
            shared = SimulatedDisturbance(sizes, 5)
            for seen in threads.map(lambda _, s=shared: [s.at(time) for time in times], range(8)):
                np.testing.assert_array_equal(seen, values)
