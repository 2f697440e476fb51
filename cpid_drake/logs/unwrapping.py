"""Angles of joints without the jumps of counters that stay within one turn."""

import numpy as np
from numpy.typing import NDArray

_SLACK = 0.1  # by which a wrapped angle may leave one turn: noise [rad]

Array = NDArray[np.float64]


def unwrapped(value: Array, turned: Array) -> tuple[Array, int]:
    """Return an angle (N,) [rad] without jumps by whole turns, and the number of jumps.

    Args:
        value: the angle. It is unchanged unless it jumps by more than half a turn, and stays within
            one turn, or the jump is one turn between small steps.
        turned: the angle (N,) by its rate, from any zero; it is used if it explains the angle.

    """
    steps = np.diff(value)
    jumps = np.abs(steps) > np.pi
    if not jumps.any():
        return value, 0
    is_within = bool(np.ptp(value) <= 2 * np.pi + _SLACK)
    if not is_within:
        rest = np.abs(np.abs(steps) - 2 * np.pi)
        usual = float(np.median(np.abs(steps)))
        is_turn = jumps & (rest < max(0.5, 5 * usual)) & (usual < 0.5)
        if not (is_turn == jumps).all():
            return value, 0
    expected = np.diff(turned)
    rest = _rest(steps - expected)
    if np.sqrt(np.mean(rest**2)) > 0.6:  # other rates leave 1.8
        expected, rest = np.zeros(len(steps)), _rest(steps)
        if not np.sqrt(np.mean(np.diff(rest) ** 2)) < 0.6:  # no motion from sample to sample
            return value, 0
    new = np.append(value[0], value[0] + np.cumsum(expected + rest))
    return new, int((np.abs(new[1:] - new[:-1] - steps) > np.pi).sum())


def _rest(steps: Array) -> Array:
    """Return steps without whole turns."""
    return np.asarray(steps - 2 * np.pi * np.round(steps / (2 * np.pi)))
