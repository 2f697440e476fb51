"""Gaps in the samples of a tumbling capture: what happens inside of one does not matter."""

import numpy as np
import pytest
from block_cases import Case, fired, make_case
from scipy.stats import chi2
from sensing_cases import MOMENTUM, Sines, coarse_suite, measured, nees, sigmas, small_craft

from cpid_drake import identify
from cpid_drake.estimation.block import BlockQueue, blocks_of
from cpid_drake.logs.log import Log, Samples, concatenated
from cpid_drake.logs.simulated_noise import add_noise
from cpid_drake.sensors.sensors import JointSensor

SUITE = coarse_suite(encoders=JointSensor(25.0, 1e-5))
FAST = np.array([60.0, -40.0, 70.0, 1.0, 1.0, -1.0])
"""Momentum with which the small craft tumbles at 0.8 to 0.9 rad/s."""

START, LENGTH = 8.0, 20.0


@pytest.fixture(scope="module")
def case(tmp_path_factory, skewed_target):
    craft = small_craft(tmp_path_factory.mktemp("craft"))
    motion = Sines.drawn(4, seed=3, duration=2 * START + LENGTH, size=0.1)
    samples = measured(craft, motion, skewed_target, SUITE, FAST)
    return Case(craft, motion, skewed_target, SUITE, FAST, samples)


def without(samples, *names, start=START, end=START + LENGTH):
    """Return samples without those of some sensors between two times."""
    parts = {name: samples[name] for name in names}
    return samples.updated(
        {n: s.where((s.time < start) | (s.time > end)) for n, s in parts.items()}
    )


def found_in(case, samples, estimator="trajectory_fit"):
    return identify(
        case.craft, samples, sensors=case.suite, momentum="unknown", estimator=estimator
    )


@pytest.mark.parametrize("estimator", ["trajectory_fit", "recursive_fit"])
@pytest.mark.parametrize("names", [("encoders",), tuple(SUITE.present())], ids=["joints", "all"])
def test_a_gap_in_a_tumble_is_named_and_the_intervals_hold(case, estimator, names):
    """In 20 s the base turns by 17 rad, and nobody knows how the joints move."""
    gap = without(add_noise(SUITE, case.samples, 0), *names)
    found = found_in(case, gap, estimator)
    assert nees(found, case.target) < chi2.isf(1e-4, 10)
    assert np.isfinite(found.parameters).all()
    assert found.passed
    assert not found.momentum_changes
    if estimator == "trajectory_fit":
        [text] = [text for text in found.warnings if "gap" in text]
        assert "from 8.000 s to 28.040 s" in text


def test_two_logs_with_an_hour_between_them_are_one_log_with_a_gap(case, skewed_target):
    """The second has another momentum, pose and motion of the joints, as after a contact."""
    motion = Sines.drawn(4, seed=4, duration=START, size=0.3)
    first = case.samples.between(0.0, START)
    second = measured(case.craft, motion, skewed_target, SUITE, -0.5 * MOMENTUM)
    later = Log(
        second.joint_names,
        {name: Samples(s.time + 3000.0, s.value) for name, s in second.items() if len(s)},
    )
    both = add_noise(SUITE, concatenated([first, later]), 0)
    one, other = found_in(case, both), found_in(case, both.between(0.0, START))
    assert one.passed
    assert not one.momentum_changes
    assert nees(one, skewed_target) < chi2.isf(1e-4, 10)
    assert (sigmas(one) < sigmas(other)).all()


def test_blocks_do_not_depend_on_when_samples_arrive(case):
    """Nor on a few samples of the joints alone between two gaps."""
    gaps = without(case.samples, "encoders", start=7.3, end=12.0)
    gaps = without(gaps, "encoders", start=12.07, end=21.0)
    queue = BlockQueue.of(SUITE)
    ends = [
        [(block.start, block.end) for block in blocks_of(queue, gaps.blocks(seconds))]
        for seconds in (0.3, 1.0, 5.0, 100.0)
    ]
    assert ends[0] == ends[1] == ends[2] == ends[3]
    edges = np.array(ends[0])
    assert np.diff(edges).max() < 1.001
    inside = (edges[:, 1] > 7.3) & (edges[:, 0] < 20.99)
    assert not inside.any()
    apart = edges[1:, 0] - edges[:-1, 1]
    assert np.sum(apart > 0) == 1


def test_the_block_before_a_gap_does_not_wait_for_its_end(case):
    """It is complete when the encoders have been silent for longer than a block."""
    samples = without(case.samples, "encoders", start=7.3, end=30.0)
    queue, blocks = BlockQueue.of(SUITE).added(samples.between(0.0, 8.6), 8.6)
    assert blocks[-1].end == pytest.approx(7.28, abs=1e-3)
    assert queue.finished() == []


def test_a_firing_is_found_beside_a_gap(tmp_path, skewed_target):
    """In the part behind the gap; what differs between the parts is no change."""
    case = make_case(tmp_path, skewed_target, SUITE, duration=12.0)
    samples = fired(case, 9.5, np.array([6.0, -4.0, 5.0, 3.0, -2.0, 2.0]))
    gap = without(add_noise(SUITE, samples, 2), *SUITE.present(), start=3.0, end=6.0)
    found = found_in(case, gap)
    assert found.momentum_changes == pytest.approx([9.5], abs=0.5)
    assert nees(found, skewed_target) < chi2.isf(1e-4, 10)
