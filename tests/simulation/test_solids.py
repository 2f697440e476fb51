"""The inertia of a homogeneous solid is that of many points in it."""

import numpy as np
import pytest

from cpid_drake.simulation.scenario import SolidConfig

SIZE = np.array([1.2, 0.5, 0.8])

INSIDE = {
    "box": lambda p: np.ones(len(p), dtype=bool),
    "cylinder": lambda p: p[:, 0] ** 2 + p[:, 1] ** 2 < 1,  # its axis is z
    "ellipsoid": lambda p: np.sum(p**2, axis=1) < 1,
}


@pytest.mark.parametrize("shape", INSIDE)
def test_the_inertia_is_that_of_points_in_the_solid(shape):
    """On a grid of 120 cells along each axis, in units of half the extent."""
    edges = (np.arange(120) + 0.5) / 60 - 1
    points = np.stack(np.meshgrid(edges, edges, edges), axis=-1).reshape(-1, 3)
    points = points[INSIDE[shape](points)] * SIZE / 2
    second = 7.0 * points.T @ points / len(points)
    expected = np.trace(second) * np.eye(3) - second
    found = SolidConfig(shape, SIZE).inertia(7.0)
    np.testing.assert_allclose(found, expected, rtol=2e-3, atol=1e-9)
