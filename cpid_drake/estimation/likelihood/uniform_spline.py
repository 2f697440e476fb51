"""Cubic splines, interpolation and integrals over equidistant nodes."""

from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from cpid_drake.array import Array

GAUSS_LEGENDRE = np.polynomial.legendre.leggauss(3)
"""Points in −1 to 1 and weights whose sum is the integral of a polynomial up to degree five."""


class UniformSpline:
    """The cubic spline through values (N, n) at N equidistant nodes.

    It is that of `scipy.interpolate.CubicSpline`, whose construction takes much longer.

    Attributes:
        c: (4, N − 1, n) coefficients of the powers 3 to 0 in each interval.

    """

    def __init__(self, start: float, step: float, values: Array) -> None:
        self._start, self._step = start, step
        slope = _slopes(len(values)) @ values / step
        chord = (values[1:] - values[:-1]) / step
        bend = (slope[1:] + slope[:-1] - 2 * chord) / step
        linear, square = slope[:-1], (chord - slope[:-1]) / step - bend
        self.c = np.stack([bend / step, square, linear, values[:-1]])

    def place(self, times: Array) -> tuple[NDArray[np.intp], Array]:
        """Return the interval of each time (M,), and the time since its start [s]."""
        elapsed = times - self._start
        k = np.maximum(np.minimum((elapsed / self._step).astype(int), self.c.shape[1] - 1), 0)
        return k, elapsed - k * self._step

    def __call__(self, times: Array) -> Array:
        """Return the values (M, n) at times (M,)."""
        k, t = self.place(times)
        c, t = self.c[:, k], t[:, None]
        return np.asarray(((c[0] * t + c[1]) * t + c[2]) * t + c[3])

    def steps(self) -> Array:
        """Return the integrals (N − 1, n) over all intervals."""
        powers = self._step ** np.arange(4, 0, -1) / np.arange(4, 0, -1)
        return np.tensordot(powers, self.c, axes=1)

    def by_delay(self, times: Array) -> Array:
        """Return the derivative (M, n) of the values between nodes by a delay of jumps: zero."""
        return np.zeros((len(times), self.c.shape[2]))

    def steps_by_delay(self) -> Array:
        """Return that of `steps` (N − 1, n)."""
        return np.zeros(self.c.shape[1:])

    def since_node(self, times: Array) -> tuple[NDArray[np.intp], Array, Array]:
        """Return the interval of each time (M,), and time and integral (M, n) since it began."""
        k, t = self.place(times)
        c, x = self.c[:, k], t[:, None]
        return k, t, np.asarray((((c[0] * (x / 4) + c[1] / 3) * x + c[2] / 2) * x + c[3]) * x)


class RampedSpline(UniformSpline):
    """The sum of a cubic spline and of ramps a (t − s)⁺, for values whose slope jumps.

    Args:
        start, step: the nodes [s].
        values: (N, 3) values of the sum at the nodes.
        times: (S,) times s at which the slope jumps [s].
        slopes: (S, 3) the jumps a.

    """

    def __init__(
        self, start: float, step: float, values: Array, times: Array, slopes: Array
    ) -> None:
        self._times, self._slopes = times, slopes
        self._nodes: Array = start + step * np.arange(len(values), dtype=float)
        super().__init__(start, step, values - self._ramps(self._nodes))

    def _ramps(self, times: Array) -> Array:
        return np.asarray(np.maximum(times[:, None] - self._times, 0.0) @ self._slopes)

    def _areas(self, times: Array) -> Array:
        return np.asarray(np.maximum(times[:, None] - self._times, 0.0) ** 2 @ self._slopes / 2)

    def __call__(self, times: Array) -> Array:
        """See `UniformSpline`."""
        return super().__call__(times) + self._ramps(times)

    def steps(self) -> Array:
        """See `UniformSpline`."""
        return super().steps() + np.diff(self._areas(self._nodes), axis=0)

    def by_delay(self, times: Array) -> Array:
        """See `UniformSpline`."""
        return self._smooth_by_delay(times) - self._jumps(times)

    def steps_by_delay(self) -> Array:
        """See `UniformSpline`."""
        return self._smooth_by_delay.steps() - np.diff(self._ramps(self._nodes), axis=0)

    @cached_property
    def _smooth_by_delay(self) -> UniformSpline:
        return UniformSpline(self._start, self._step, self._jumps(self._nodes))

    def _jumps(self, times: Array) -> Array:
        return (times[:, None] > self._times) @ self._slopes

    def since_node(self, times: Array) -> tuple[NDArray[np.intp], Array, Array]:
        """See `UniformSpline`."""
        k, t, smooth = super().since_node(times)
        return k, t, smooth + self._areas(times) - self._areas(self._nodes[k])


def spline_weights(nodes: Array, times: Array) -> Array:
    """Return (M, N) weights of N equidistant nodes at times (M,): those of `UniformSpline`."""
    at = np.round((times - nodes[0]) / (nodes[1] - nodes[0]), 12)
    return _spline_weights(len(nodes), at.tobytes())


def spline_slopes(nodes: Array, times: Array) -> Array:
    """Return (M, N) weights of the nodes in the rates at times (M,) of a spline through them."""
    slopes = _slopes(len(nodes)) / (nodes[1] - nodes[0])
    return np.asarray(spline_weights(nodes, times) @ slopes)


@lru_cache(maxsize=1024)
def _spline_weights(count: int, times: bytes) -> Array:
    """Return the weights at times since the first node: the same in every sweep."""
    return _unit_splines(count)(np.frombuffer(times))


@lru_cache(maxsize=64)
def step_weights(count: int) -> Array:
    """Return (N − 1, N) weights of N nodes, one apart, in the integrals of `UniformSpline`."""
    return _unit_splines(count).steps()


@lru_cache(maxsize=64)
def _unit_splines(count: int) -> UniformSpline:
    """Return the splines through the unit vectors (N, N) at N nodes, one apart."""
    return UniformSpline(0.0, 1.0, np.eye(count))


@lru_cache(maxsize=64)
def _slopes(count: int) -> Array:
    """Return the slopes (N, N) at N nodes, one apart, of the splines through the unit vectors."""
    nodes = np.arange(count)
    return np.asarray(CubicSpline(nodes, np.eye(count))(nodes, 1))
