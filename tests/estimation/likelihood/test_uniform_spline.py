"""Splines over equidistant nodes, and their weights."""

import itertools

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from cpid_drake.estimation.likelihood.uniform_spline import (
    UniformSpline,
    spline_weights,
    step_weights,
)


@pytest.mark.parametrize("count", [5, 6, 40])
def test_a_spline_and_its_weights_are_scipys(count):
    """At times between the nodes, at nodes, and a little outside."""
    rng = np.random.default_rng(7)
    nodes = 3.0 + 0.2 * np.arange(count)
    values = rng.normal(size=(count, 3))
    times = np.concatenate([rng.uniform(nodes[0], nodes[-1], 50), nodes, [2.97, nodes[-1] + 0.04]])
    expected = CubicSpline(nodes, values)(times)
    np.testing.assert_allclose(UniformSpline(3.0, 0.2, values)(times), expected, atol=1e-10)
    np.testing.assert_allclose(spline_weights(nodes, times) @ values, expected, atol=1e-10)
    areas = [CubicSpline(nodes, values).integrate(a, b) for a, b in itertools.pairwise(nodes)]
    np.testing.assert_allclose(UniformSpline(3.0, 0.2, values).steps(), areas, atol=1e-10)
    np.testing.assert_allclose(0.2 * step_weights(count) @ values, areas, atol=1e-10)
