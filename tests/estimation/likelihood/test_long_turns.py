"""The base's motion in blocks as long as those of slow encoders, against a simulation."""

import numpy as np
import pytest
from block_cases import Case, joints_of
from sensing_cases import Sines, coarse_suite, measured, small_craft

from cpid_drake.estimation.likelihood.model import BlockModel
from cpid_drake.files.errors import InputError

SUITE = coarse_suite()
SLOW = np.array([60.0, -40.0, 70.0, 1.0, 1.0, -1.0])
"""Momentum with which the small craft tumbles at 0.9 rad/s."""


def tumble(folder, target, speed, length):
    """Return the turn between the true attitude after a time and the predicted one [rad]."""
    craft, momentum_W = small_craft(folder), speed / 0.9 * SLOW
    motion = Sines.drawn(4, seed=3, duration=21.5, size=0.1)
    samples = measured(craft, motion, target, SUITE, momentum_W)
    case = Case(craft, motion, target, SUITE, momentum_W, samples)
    block = case.block(0.5, 0.5 + length)
    model = BlockModel(craft.tree, joints_of(block, SUITE), block.samples, SUITE).motion
    end = model.end(model.trajectory(case.state(0.5)))
    return (end.attitude * case.state(0.5 + length).attitude.inv()).magnitude()


@pytest.mark.parametrize(("speed", "length"), [(0.9, 1.0), (1.8, 20.0), (3.6, 20.0)])
def test_a_long_turn_is_followed(tmp_path, skewed_target, speed, length):
    """Up to 70 rad in a block: Picard's iteration loses 28 of them in rounding errors."""
    assert tumble(tmp_path, skewed_target, speed, length) < 1e-4


def test_a_turn_too_fast_for_the_grid_is_refused(tmp_path, skewed_target):
    """The grid of a long block has steps of 0.05 s."""
    with pytest.raises(InputError, match="rotates too fast"):
        tumble(tmp_path, skewed_target, 14.0, 20.0)
