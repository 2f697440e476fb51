"""One change of momentum or target is found in a log that is otherwise exact."""

from dataclasses import replace

import numpy as np
import pytest
from sensing_cases import MOMENTUM, Sines, log_of, true_telemetry

from cpid_drake import identify
from cpid_drake.identification.sudden_changes import sudden_change

TIMES = np.arange(0.0, 6.0, 0.03)


@pytest.fixture(scope="module")
def motion_of(craft):
    motion = Sines.drawn(len(craft.joint_names), 11, TIMES[-1], 0.6)

    def make(target, momentum_W=None):
        return true_telemetry(craft.tree, craft.joint_names, motion, target, TIMES, momentum_W)

    return make


def joined(first, second, time):
    """Return the samples of the first motion before a time, and of the second from then on."""
    names = ("quaternion_WB", "p_WB", "w_WB", "v_WB", "q", "qdot")
    before = (time > TIMES)[:, None]
    values = {n: np.where(before, getattr(first, n), getattr(second, n)) for n in names}
    return replace(first, **values)


def interval_of(text):
    words = text.split(" between ")[1].split()
    return float(words[0]), float(words[3])


@pytest.mark.parametrize("time", [1.5, 4.0])
def test_a_change_of_momentum_is_found(craft, motion_of, skewed_target, time):
    log = log_of(joined(motion_of(skewed_target), motion_of(skewed_target, MOMENTUM), time))
    text = sudden_change(craft.tree, log)
    begin, end = interval_of(text)
    assert text.startswith("the momentum changes")
    assert begin < time < end
    assert end - begin < 1.0


@pytest.mark.parametrize("time", [1.5, 4.0])
def test_another_target_is_found(craft, motion_of, skewed_target, time):
    moved = replace(skewed_target, p_CTcm_C=skewed_target.p_CTcm_C + [0.1, 0.0, 0.05])
    log = log_of(joined(motion_of(skewed_target), motion_of(moved), time))
    text = sudden_change(craft.tree, log)
    begin, end = interval_of(text)
    assert text.startswith("the target changes")
    assert begin < time < end
    found = identify(craft, log)
    assert "the target changes between" in found.doubts[0]


@pytest.mark.parametrize("momentum_W", [None, MOMENTUM])
def test_nothing_changes_in_a_good_log(craft, motion_of, skewed_target, momentum_W):
    assert sudden_change(craft.tree, log_of(motion_of(skewed_target, momentum_W))) == ""


def test_a_wrong_mass_is_no_change(craft, motion_of, skewed_target):
    first, *others = craft.tree.bodies
    heavier = replace(craft.tree, bodies=(replace(first, mass=1.5 * first.mass), *others))
    assert sudden_change(heavier, log_of(motion_of(skewed_target))) == ""
