"""Angles of joints without the jumps of counters that stay within one turn."""

import numpy as np

from cpid_drake.array import Array

_SLACK = 0.1  # by which a wrapped angle may leave one turn: noise [rad]


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
    if np.ptp(value) > 2 * np.pi + _SLACK:
        rest = np.abs(np.abs(steps) - 2 * np.pi)
        usual = float(np.median(np.abs(steps)))
        is_turn = jumps & (rest < max(0.5, 5 * usual)) & (usual < 0.5)
        if not (is_turn == jumps).all():
            return value, 0
    error = np.unwrap(value - turned)
    new = error + turned
    if np.sqrt(np.mean(np.diff(error) ** 2)) > 0.6:  # other rates leave 1.8
        new = np.unwrap(value)
        if not np.sqrt(np.mean(np.diff(new, n=2) ** 2)) < 0.6:  # no motion from sample to sample
            return value, 0
    return new, int((np.abs(np.diff(new) - steps) > np.pi).sum())
