"""What a link costs, and what makes samples white beside a gap."""

import numpy as np
import pytest
from sensing_cases import Sines, coarse_suite, measured

from cpid_drake.estimation.links import Link, farthest, link_cost, link_sigma
from cpid_drake.estimation.log_state import LogState
from cpid_drake.estimation.unknowns import Model
from cpid_drake.estimation.whitening import whitener

SUITE = coarse_suite()


@pytest.fixture
def model(craft):
    return Model(craft.tree, SUITE)


def test_where_the_pull_holds_a_closed_end_its_slope_is_twice_the_pull(model):
    """Then the pull is what the samples ask for, and χ² of all is least there."""
    rng = np.random.default_rng(0)
    pull, step = rng.standard_normal(12), 1e-9 * rng.standard_normal(12)
    link = Link(0.0, np.zeros(0), pull)
    aim = pull * link_sigma(model, link) ** 2
    slope = (link_cost(model, link, aim + step) - link_cost(model, link, aim - step)) / 2
    assert slope == pytest.approx(2 * pull @ step, rel=1e-3)


def test_an_open_end_may_change_by_its_size(model):
    link = Link(0.0, np.zeros(0), np.ones(12), is_open=True)
    assert link_cost(model, link, farthest(model)) == pytest.approx(12)


def test_slow_noise_decays_over_a_gap(craft, skewed_target):
    """The samples of a block are white with the noise at the start of the next, behind the gap."""
    log = measured(craft, Sines.drawn(4, 3, 8.0, 0.8), skewed_target, SUITE)
    kept = {n: s.where((s.time < 3) | (s.time > 5)) for n, s in log.samples.items()}
    state = LogState.of(Model.of(craft.tree, SUITE), type(log)(log.joint_names, kept))
    [k] = [k for k, link in enumerate(state.links) if link.gap]
    white = whitener(state, k, "attitude", len(state.blocks[k].samples.attitude))
    assert white.end == pytest.approx(state.blocks[k + 1].start)
    assert white.end - state.blocks[k].end > 1.5
