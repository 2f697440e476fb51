"""The replay of a log shows the momenta of the motion, not those of its noise."""

import numpy as np
from flyer_cases import SAMPLE, flyer

from cpid_drake import load_sensors, read_log
from cpid_drake.dynamics.kinematics import forward_kinematics
from cpid_drake.dynamics.momentum import momenta
from cpid_drake.report.replay import motion_of


def test_at_rest_the_first_and_the_last_frame_show_no_momentum():
    """The joints of the sample log rest at both ends; arrows are drawn in shares of the largest."""
    craft, log = flyer(), read_log(SAMPLE)
    motion = motion_of(log, craft, load_sensors("testbed"))
    assert (motion.time[0], motion.time[-1]) == (0.0, 10.0)
    bodies, _ = forward_kinematics(craft.tree, **motion.states)
    momentum = np.linalg.norm(momenta(craft.tree, bodies)[0].sum(axis=0), axis=1)
    assert momentum[[0, -1]].max() < 0.1 * momentum.max()
