"""Blocks that are solved alone, behind what is known: they give what the fit of all samples gives.

From the sixth block on, a log of `case` is solved so.
"""

import numpy as np
import pytest
from block_cases import MOMENTUM, fired, make_case, target_of
from sensing_cases import coarse_suite, gauss_markov

from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.dynamics.uncertainty import BodyUncertainty
from cpid_drake.estimation.block import BlockQueue, blocks_of
from cpid_drake.estimation.bounded_fits import BoundedFits
from cpid_drake.estimation.events import fit_with_events
from cpid_drake.estimation.evidence import Question
from cpid_drake.estimation.fit import fit
from cpid_drake.estimation.log_state import LogState
from cpid_drake.estimation.online import OnlineState, run, step
from cpid_drake.estimation.unknowns import Model
from cpid_drake.identification.online_answer import identification_of_state
from cpid_drake.logs.log import Samples
from cpid_drake.logs.simulated_noise import add_noise

SUITE = coarse_suite()


@pytest.fixture(scope="module")
def case(tmp_path_factory, skewed_target):
    return make_case(tmp_path_factory.mktemp("craft"), skewed_target, SUITE, None, 14.0)


@pytest.fixture(scope="module")
def model(case):
    return Model(case.craft.tree, SUITE)


@pytest.fixture(scope="module")
def uncertain(case):
    """Unknowns with errors of the spacecraft, whose derivatives stay at their first values."""
    bodies = BodyUncertainty(mass=0.01, inertia=0.01, grasp_mm=2.0)
    return Model.of(case.craft.tree, SUITE, bodies)


@pytest.mark.parametrize("name", ["model", "uncertain"])
def test_blocks_alone_are_the_fit_of_all_samples(case, name, request):
    model = request.getfixturevalue(name)
    samples = add_noise(SUITE, case.samples, 1)
    state, whole = run(model, [samples]), fit(model, [LogState.of(model, samples, "online")])
    assert not state.events
    psi, covariance = target_of(state.last)
    expected, of_all = target_of(whole)
    sigma = np.sqrt(np.diag(of_all))
    assert np.abs((psi - expected) / sigma).max() < 0.1
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), sigma, rtol=0.02)


@pytest.mark.parametrize(("size", "time"), [(1.0, 9.37), (0.3, 9.02), (0.01, 9.37), (0.0005, 9.0)])
def test_a_change_is_found_where_it_is(case, model, size, time):
    """One that samples show at once, to their step; a small one to a third of a block."""
    state = run(model, [add_noise(SUITE, fired(case, time, size * MOMENTUM), 3)])
    assert len(state.events) == 1
    assert abs(state.events[0] - time) < (0.06 if size > 0.005 else 0.34)
    assert case.nees(*target_of(state.last)) < 30
    assert identification_of_state(model, state).passed


def test_more_changes_than_are_probable_do_not_bend_the_target(case, model):
    """As after seven others: from then on the momentum is another in every block."""
    samples = add_noise(SUITE, fired(case, [4.02, 7.5, 10.9], MOMENTUM), 3)
    state = run(model, [samples], OnlineState(settled=tuple(np.linspace(-7.0, -1.0, 7))))
    assert case.nees(*target_of(state.last)) < 30
    result = identification_of_state(model, state)
    assert any("changes of the momentum are many" in text for text in result.failures)
    quiet = run(model, [add_noise(SUITE, case.samples, 3)])
    own, of_quiet = (target_of(each.last)[1][0, 0] ** 0.5 for each in (state, quiet))
    assert own > 1.5 * of_quiet  # what links blocks is not used


def test_a_block_that_needs_more_work_than_it_may_is_counted(case, model):
    """The one in which a weak change is sought; its samples are not used."""
    samples = add_noise(SUITE, fired(case, 9.0, 0.0005 * MOMENTUM), 3)
    state = run(model, [samples], OnlineState(most=40))
    assert case.nees(*target_of(state.last)) < 30
    sums = state.all_sums()
    assert sums["gyro"].rejected == 20
    assert {name: each.used + each.rejected for name, each in sums.items()} == {
        name: len(each) for name, each in samples.items() if name in sums
    }


def test_noise_that_grows_is_seen(case, model):
    """By a factor of 1.6 from 8 s on, of gyro and position: nothing changed."""
    samples, loud = add_noise(SUITE, case.samples, 1), {}
    for name, each in samples.items():
        if name in ("gyro", "position"):
            error = each.value - case.samples[name].value
            value = each.value + 0.6 * (each.time > 8.0)[:, None] * error
            loud[name] = Samples(each.time, value)
    state = run(model, [samples.updated(loud)])
    assert state.events == ()
    assert case.nees(*target_of(state.last)) < 30
    assert state.last.logs[0].noise.processes["gyro"].total > 1.4


def test_a_short_last_block_does_not_hide_slow_noise(case, model):
    """How large noise is counts over the window: within a tenth of a second it is small."""
    samples, rng = add_noise(SUITE, case.samples, 1), np.random.default_rng(3)
    time, value = samples["gyro"].time, samples["gyro"].value
    sigma = 3 * np.std(value - case.samples["gyro"].value)
    slow = sigma * gauss_markov(rng, time, value.shape, 3.0)
    samples = samples.updated({"gyro": Samples(time, value + slow)})
    *blocks, last = blocks_of(BlockQueue.of(SUITE), [samples.between(0.0, 9.0)])
    states = [OnlineState()]
    for block in (*blocks, last.part(last.start, last.start + 0.21)):
        states.append(step(model, states[-1], block))
    before, after = (identification_of_state(model, s).noise["gyro"] for s in states[-2:])
    assert before > 2
    assert after == pytest.approx(before, rel=0.2)


def test_a_change_late_in_a_long_log_is_found_by_all_samples(case, model):
    """Ends of blocks are compared in groups: this one is in the second."""
    samples = add_noise(SUITE, fired(case, 13.02, 0.1 * MOMENTUM), 3)
    whole = fit(model, [LogState.of(model, samples, "online")])
    found = fit_with_events(
        whole, Question.of(model, ["online"], TotalMomentum.zero()), BoundedFits()
    )
    assert np.abs(np.subtract(found.logs[0].changes, [13.02])).max() < 0.34
    assert case.nees(*target_of(found)) < 30
