"""The fit online: changes of any size, what it knows, and bounded work.

That it is the fit of all samples is shown in `tests/online/test_online_identifier.py`.
"""

from dataclasses import replace

import numpy as np
import pytest
from block_cases import MOMENTUM, fired, make_case, target_of
from sensing_cases import coarse_suite

from cpid_drake.dynamics.body_dynamics import BodyDynamics
from cpid_drake.dynamics.uncertainty import BodyUncertainty
from cpid_drake.estimation.block import BlockQueue, blocks_of
from cpid_drake.estimation.fit import fit
from cpid_drake.estimation.linearity import inertia_change
from cpid_drake.estimation.log_state import LogState
from cpid_drake.estimation.online import LONGEST, OnlineState, run, step
from cpid_drake.estimation.process import Process
from cpid_drake.estimation.roll import roll
from cpid_drake.estimation.sweep import sweep
from cpid_drake.estimation.unknowns import BODIES, PSI, Model
from cpid_drake.identification.online_answer import identification_of_state
from cpid_drake.logs.log import Log, Samples
from cpid_drake.logs.simulated_noise import add_noise

SUITE = coarse_suite()


@pytest.fixture(scope="module")
def case(tmp_path_factory, skewed_target):
    return make_case(tmp_path_factory.mktemp("craft"), skewed_target, SUITE, None, 6.0)


@pytest.fixture(scope="module")
def model(case):
    return Model(case.craft.tree, SUITE)


@pytest.mark.parametrize(("size", "time"), [(1.0, 4.37), (0.01, 4.0), (0.01, 4.37), (0.001, 4.37)])
def test_a_change_of_any_size_leaves_the_target_right(case, model, size, time):
    """A fit that does not know of it is confidently wrong."""
    samples = add_noise(SUITE, fired(case, time, size * MOMENTUM), 3)
    state = run(model, [samples])
    assert not state.waiting
    assert case.nees(*target_of(state.last)) < 30
    if size < 0.01:
        return
    assert len(state.events) == 1
    assert abs(state.events[0] - time) < 0.5
    if size == 0.01:
        deaf = fit(model, [LogState.of(model, samples)])
        assert case.nees(*target_of(deaf)) > 60


def test_a_change_inside_of_a_block_leaves_the_window_as_one(case, model):
    """It opens both ends of a part of a block; a short window ends before the log does."""
    samples = add_noise(SUITE, fired(case, 2.5, 0.1 * MOMENTUM), 3)
    state = run(model, [samples], OnlineState(window=2))
    assert state.settled == state.events == (pytest.approx(2.5, abs=0.1),)


def test_blocks_that_are_linear_about_another_target_fail_a_check(case, model):
    """By a fifth of the target: not if it is what it was."""
    state = run(model, [add_noise(SUITE, case.samples, 1)])
    [log] = state.last.logs
    past = replace(log.past, first={PSI: 1.2 * log.past.first[PSI]})
    other = replace(state, last=replace(state.last, logs=[replace(log, past=past)]))
    found = [identification_of_state(model, s) for s in (state, other)]
    assert not found[0].failures
    assert any("not linear about the target" in failure for failure in found[1].failures)


def test_a_block_that_left_before_its_fit_converged_fails_a_check(case, model):
    """However well later windows converge."""
    state = run(model, [add_noise(SUITE, case.samples, 1)])
    for each, count in ((state, 0), (replace(state, unsettled=1), 1)):
        found = identification_of_state(model, each)
        assert found.converged == (count == 0)


def test_a_relative_change_of_the_inertia_is_that_of_each_axis(case, model):
    """Of a target with which the system's inertia is larger by a hundredth about every axis."""
    found = fit(model, [LogState.of(model, add_noise(SUITE, case.samples, 1))])
    q = case.motion.evaluate(case.motion.duration)[:1]
    at_end = BodyDynamics.at(case.craft.tree, q, 0 * q)
    by = (at_end.inertia(np.eye(10)) - at_end.inertia(np.zeros(10)))[:, 0].reshape(10, 9)
    J = at_end.inertia(found.values[PSI])[0]
    larger = np.linalg.lstsq(by.T, 0.01 * J.ravel(), rcond=None)[0]
    np.testing.assert_allclose(larger @ by, 0.01 * J.ravel(), atol=1e-9)
    assert inertia_change(found, found.values[PSI] + larger) == pytest.approx(0.01, rel=0.01)


def test_what_an_update_has_computed_is_used_only_where_it_still_holds(case, model):
    """A prediction at another target is made anew, and rows follow weights and noise."""
    found = run(model, [add_noise(SUITE, case.samples, 2)]).last
    [log], values = found.logs, found.values
    there = values | {PSI: 1.01 * values[PSI]}
    elsewhere, fresh = roll(model, log, there), roll(model, log, values)
    sweep(model, log, elsewhere, there)
    weights = tuple({"attitude": np.full(len(b.samples.attitude), 0.5)} for b in log.blocks)
    noisy = log.with_processes({"gyro": Process(4.0)}).with_each(weights=weights)
    expected = sweep(model, noisy, fresh, values)
    for before in (elsewhere, fresh):
        rolled = roll(model, log, values, before)
        for rest, other in zip(rolled.residuals, fresh.residuals, strict=True):
            for name, each in rest.items():
                np.testing.assert_array_equal(each, other[name])
        sweep(model, log, rolled, values)
        again = sweep(model, noisy, rolled, values)
        assert again.absorbed == pytest.approx(expected.absorbed, rel=1e-9)
        step = (again.gaussian.solve() - expected.gaussian.solve()) @ expected.gaussian.R.T
        assert np.abs(step).max() < 1e-6
        np.testing.assert_allclose(
            again.gaussian.covariance(), expected.gaussian.covariance(), rtol=1e-6, atol=1e-9
        )


def test_what_no_motion_tells_stays_unknown(case):
    """Where C is in the target; derivatives at other values in every block would tell it."""
    model = Model(case.craft.tree, SUITE, BodyUncertainty(grasp_mm=5.0))
    state = run(model, [add_noise(SUITE, case.samples, 1)])
    assert not state.waiting
    grasp = state.last.posterior.marginal([BODIES]).covariance()
    assert (np.sqrt(np.diag(grasp)) > 0.99).all()


def test_a_sensor_that_fails_is_not_used_any_more(case, model):
    """A gyro that shows noise of 100 σ from 4 s on: it hardly counts, and a check of it fails.

    Its samples are outliers, or all of them have larger noise: which, depends on the draw.
    """
    samples = add_noise(SUITE, case.samples, 1)
    gyro, rng = samples["gyro"], np.random.default_rng(5)
    size = 100 * float(np.std(gyro.value - case.samples["gyro"].value))
    value = gyro.value + size * (gyro.time > 4.0)[:, None] * rng.normal(size=gyro.value.shape)
    state = run(model, [samples.updated({"gyro": Samples(gyro.time, value)})])
    assert case.nees(*target_of(state.last)) < 30
    found = identification_of_state(model, state)
    failed = [check.name for check in found.checks if not check.passed]
    assert {"share of outliers", "noise"} & {*failed}


def test_samples_that_no_motion_has_are_a_gap(case, model):
    """A joint that reads 1e12 m for a second: what was known of the target is not lost."""
    samples = add_noise(SUITE, case.samples, 1)
    encoders = samples["encoders"]
    value, wrong = encoders.value.copy(), (encoders.time > 4.05) & (encoders.time < 4.95)
    value[wrong, 1] = 1e12
    state = run(model, [samples.updated({"encoders": Samples(encoders.time, value)})])
    assert state.events == ()
    assert state.sums["encoders"].rejected >= wrong.sum()
    assert case.nees(*target_of(state.last)) < 30
    found = identification_of_state(model, state)
    assert found.check("share of outliers").statistic > 0.1
    assert any("not used: no fit explains them" in warning for warning in found.warnings)


@pytest.mark.slow
def test_stored_blocks_are_few(case, model):
    """At rest nothing becomes known, and nothing is called a change."""
    still = {}
    for name, errors in SUITE.present().items():
        time = np.arange(0, LONGEST + 2.5, 1 / errors.rate)
        value = 0 if name == "gyro" else case.samples[name].value[0]
        shape = (len(time), case.samples[name].value.shape[1])
        still[name] = Samples(time, np.broadcast_to(value, shape))
    samples = add_noise(SUITE, Log(case.samples.joint_names, still), 0)
    state, sizes = OnlineState(), []
    for block in blocks_of(BlockQueue.of(SUITE), [samples]):
        state = step(model, state, block)
        sizes.append(len(state.last.logs[0].blocks) if state.last else len(state.waiting))
    assert max(sizes) <= LONGEST + 1
    assert state.events == ()
    found = identification_of_state(model, state)
    assert np.isnan(found.parameters).all()
