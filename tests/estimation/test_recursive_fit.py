"""The recursive fit: independent of how samples arrive, consistent, and flat in memory."""

import itertools
import pickle
from dataclasses import dataclass, replace

import numpy as np
import pytest
from block_cases import best_psi, fired, make_case
from scipy.stats import chi2
from sensing_cases import MOMENTUM, Sines, coarse_suite, measured

from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.estimation.block_queue import BlockQueue
from cpid_drake.estimation.faults import Explained
from cpid_drake.estimation.likelihood.constants import LINEAR
from cpid_drake.estimation.recursive_fit import RecursiveFit, has_moved, last_time
from cpid_drake.estimation.recursive_state import counted
from cpid_drake.estimation.window_fit import fit_window
from cpid_drake.identification.fit_estimator import identification_of_state
from cpid_drake.identification.fit_setup import prior_of, recursive_fit
from cpid_drake.identification.result import MomentumChanges
from cpid_drake.sensing.measurements import Measurements, Samples
from cpid_drake.sensing.noise import add_noise
from cpid_drake.sensing.sensors import JointSensor
from cpid_drake.studies.trials import Firing

SUITE = coarse_suite(encoders=JointSensor(25.0, 1e-5))
END = 6.0


@pytest.fixture(scope="module")
def case(tmp_path_factory, skewed_target):
    return make_case(tmp_path_factory.mktemp("craft"), skewed_target, SUITE, duration=END)


@pytest.fixture(scope="module")
def samples(case):
    return add_noise(SUITE, case.samples, 1)


@pytest.fixture(scope="module")
def estimator(case):
    return RecursiveFit(case.craft.tree, SUITE, prior_of(case.craft.tree, None))


@pytest.fixture(scope="module")
def whole(estimator, samples):
    """The state after all samples in one chunk."""
    return estimator.run([samples])


def cut(samples, edges):
    """Yield samples in pieces."""
    edges = np.concatenate([[-np.inf], np.sort(edges), [np.inf]])
    for start, end in itertools.pairwise(edges):
        kept = {n: s.where((s.time > start) & (s.time <= end)) for n, s in samples.items()}
        piece = Measurements(samples.joint_names, kept)
        if last_time(piece) > -np.inf:
            yield piece


def nees(case, state):
    error = best_psi(state.known) - case.psi
    return float(error @ state.known.psi_information() @ error)


def later(samples, shift):
    return samples.updated({n: Samples(s.time + shift, s.value) for n, s in samples.items()})


# -- the queue ------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(5))
def test_blocks_do_not_depend_on_how_samples_arrive(samples, seed):
    """Every sample is in one block, at start < time ≤ end, in blocks without gaps between them."""

    def blocks_of(pieces):
        queue, blocks = BlockQueue.of(SUITE), []
        for piece in pieces:
            queue, more = queue.added(piece, last_time(piece))
            blocks += more
        return blocks + queue.finished()

    rng = np.random.default_rng(seed)
    expected = blocks_of([samples])
    found = blocks_of(cut(samples, rng.uniform(0, END, rng.integers(1, 60))))
    assert [(b.start, b.end) for b in found] == [(b.start, b.end) for b in expected]
    assert [b.start for b in found[1:]] == [b.end for b in found[:-1]]
    assert found[-1].end >= samples.encoders.time[-1]
    for name, given in samples.samples.items():
        parts = [block.samples[name].time for block in found]
        np.testing.assert_array_equal(np.concatenate(parts), given.time)
        for block, part in zip(found, parts):
            assert (part > block.start).all()
            assert (part <= block.end).all()


def test_blocks_are_a_second_long_or_twenty_encoder_samples():
    assert BlockQueue.of(SUITE).length == 1.0
    slow = replace(SUITE, encoders=JointSensor(4.0, 1e-5))
    assert BlockQueue.of(slow).length == pytest.approx(5.0)


def test_a_block_is_complete_when_all_its_samples_have_come(samples):
    """Not before `until` has passed its end, whatever samples there are."""
    queue, blocks = BlockQueue.of(SUITE).added(samples.between(0, 1.5), 0.99)
    assert not blocks
    queue, blocks = queue.added(samples.between(1.5001, 1.6), 1.6)
    assert len(blocks) == 1
    assert blocks[0].samples.encoders.time[-1] == 1.0
    assert queue.waiting.encoders.time[0] > 1.0
    assert queue.edge == pytest.approx(1.0, abs=1e-6)


def test_a_long_gap_is_one_block(samples):
    """Without encoder samples, whole lengths of blocks are added to it."""
    gap = cut(later(samples.between(3.5, 6.0), 100.0), np.empty(0))
    queue, first = BlockQueue.of(SUITE).added(samples.between(0, 2.5), 2.5)
    _, blocks = queue.added(next(gap), 106.0)
    assert len(first) + len(blocks) < 8
    lengths = [block.end - block.start for block in blocks]
    assert max(lengths) > 99


# -- the recursion --------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", [0, 1])
def test_any_chunks_give_the_same_state(estimator, samples, whole, seed):
    """Bit for bit; a state in the middle can be saved and resumed."""
    rng = np.random.default_rng(seed)
    state = estimator.start()
    for piece in cut(samples, rng.uniform(0, END, 40)):
        state = pickle.loads(pickle.dumps(estimator.process(state, piece, last_time(piece))))
    state = estimator.finish(state)
    np.testing.assert_array_equal(state.known.root, whole.known.root)
    np.testing.assert_array_equal(state.known.nominal.psi, whole.known.nominal.psi)
    assert state.used == whole.used == {name: len(s) for name, s in samples.samples.items()}


def test_a_state_is_a_value(estimator, samples):
    """Processing more samples does not change the state before."""
    state = estimator.process(estimator.start(), samples.between(0, 1.5), 1.5)
    before = pickle.dumps(state)
    estimator.process(state, samples.between(1.5001, 2.5), 2.5)
    assert pickle.dumps(state) == before


def test_without_faults_none_are_found(case, whole):
    assert not whole.initializing
    assert whole.is_explained
    assert (whole.changes, whole.misfit) == (0, 1.0)
    assert not whole.left_out
    assert nees(case, whole) < chi2.isf(1e-3, 10)


def test_memory_does_not_grow(case, estimator, whole):
    """The state has the same size after two and three times as long, also without the base."""
    once = estimator.process(estimator.start(), case.samples, END)
    sizes = [len(pickle.dumps(once))]
    for k in (1, 2):
        times = np.arange(0, END, 0.04)
        q = case.motion.evaluate(times)[:, 0]
        encoders = Samples(times + k * END + 0.04, q)
        once = estimator.process(
            once, Measurements(case.samples.joint_names, encoders=encoders), (k + 1) * END
        )
        sizes.append(len(pickle.dumps(once)))
    assert max(sizes) < 1.2 * sizes[0]
    assert once.block is not None


@dataclass(frozen=True, eq=False)
class AfterRest:
    """A motion that begins smoothly after a rest."""

    motion: Sines
    rest: float
    duration: float

    def evaluate(self, time):
        u = np.maximum(np.asarray(time, dtype=float) - self.rest, 0.0)
        moved = self.motion.evaluate(u**3 / (u**2 + 1))
        rate = (u**4 + 3 * u**2) / (u**2 + 1) ** 2
        moved[..., 1, :] *= rate[..., None]
        return moved


@pytest.mark.parametrize("until", [1.2, 2.2])
def test_the_last_window_is_linear_about_the_constant_errors_that_it_finds(
    until, tmp_path, skewed_target
):
    """Errors that it does not find are of no use: those of the joints are far from zero.

    A window that will be fitted again is linear about those found so far, which changes its target
    by a small part of its σ.
    """
    suite = coarse_suite(encoders=JointSensor(25.0, 1e-5, zero_mrad=5.0))
    case = make_case(tmp_path, skewed_target, suite, MOMENTUM, 3.0)
    prior = prior_of(case.craft.tree, TotalMomentum.unknown())
    estimator = RecursiveFit(case.craft.tree, suite, prior)
    samples = add_noise(suite, case.samples, 3).between(0, until)
    state = estimator.process(estimator.start(), samples, until)
    assert state.initializing
    distance, _ = distance_to_linear(estimator, state)
    assert distance < 0.5  # σ
    state = estimator.finish(state)
    assert state.initializing
    distance, best = distance_to_linear(estimator, state)
    assert distance < 0.02
    assert np.abs(state.sweep.about).max() > LINEAR
    assert estimator.solver.constants.agree(state.sweep.about, best)


def distance_to_linear(estimator, state):
    """Return how far [σ] a fit about the constant errors that a window finds is, and the errors."""
    known = state.sweep.state
    best = known.best_constants(known.nominal.psi)
    psi, window = known.nominal.psi, state.window
    again = fit_window(estimator.solver, state.prior, window, psi, constants=best, again=True)
    assert again.converged
    return np.linalg.norm(known.root[-10:, -10:] @ (again.psi - psi)), best


@pytest.mark.parametrize("until", [1.0, 1.2])
def test_each_window_is_fitted_once_also_at_the_end(until, estimator, samples, monkeypatch):
    """What came after the last fit is fitted at the end; what was fitted before is not."""
    ends, fit = [], RecursiveFit._fit

    def watched(self, state, **options):
        ends.append(state.window[-1].end)
        return fit(self, state, **options)

    monkeypatch.setattr(RecursiveFit, "_fit", watched)
    state = estimator.run([samples.between(0.0, until)])
    assert state.known is not None
    assert ends[-1] == pytest.approx(until, abs=0.05)
    assert len(set(ends)) == len(ends)


def test_rest_before_the_motion_is_forgotten(case, estimator, skewed_target):
    """Nothing is known at rest, few blocks are kept, and nothing is called a fault after it."""
    motion = AfterRest(case.motion, 8.0, 8.0 + END)
    samples = add_noise(SUITE, measured(case.craft, motion, skewed_target, SUITE), 3)
    state = estimator.process(estimator.start(), samples.between(0.0, 8.0), 8.0)
    assert state.known is None
    assert len(state.window) <= 6
    state = estimator.process(state, samples.between(8.0001, 8.0 + END), 8.0 + END)
    state = estimator.finish(state)
    assert state.changes == 0
    assert nees(case, state) < chi2.isf(1e-4, 10)


def test_constant_rates_are_no_motion(samples):
    """Wheels that spin on and noise do not count, one joint that moves does."""
    time = np.arange(0, 1, 0.04)
    noise = 1e-5 * np.random.default_rng(0).normal(size=(len(time), 2))
    spinning = np.stack([300.0 * time, np.zeros(len(time))], axis=1) + noise

    def moved(value):
        measurements = Measurements(("a", "b"), encoders=Samples(time, value))
        return has_moved(tuple(BlockQueue(2.0).added(measurements, 0.5)[0].finished()), SUITE)

    assert not moved(spinning)
    assert moved(spinning + np.stack([0 * time, 0.01 * np.sin(3 * time)], axis=1))
    single = spinning.copy()
    single[7, 1] += 0.5  # one outlier is no motion
    assert not moved(single)


def test_pieces_that_follow_each_other_are_one_change(estimator, whole):
    """Whether in one block or in two; a later piece is another change."""
    pieces = [((1.0, 1.125), (1.125, 1.25)), ((1.25, 1.5),), (), ((3.0, 3.125),)]
    state, counts = estimator.start(), []
    for bridged in pieces:
        state = counted(state, None, Explained(whole.known, bridged=bridged))
        counts.append(state.changes)
    assert counts == [1, 1, 1, 2]
    assert state.change_time == 3.125
    assert state.bridged_time == pytest.approx(0.625)


@pytest.mark.parametrize(
    ("time", "duration"),
    [(0.6, 0.0), (4.4, 0.0), (3.4, 0.5)],
    ids=["at the start", "later", "long"],
)
def test_a_firing_is_found(case, estimator, time, duration):
    """Within a second, a long one perhaps twice; the covariance of the target holds."""
    added = np.array([6.0, -4.0, 5.0, 3.0, -2.0, 2.0])
    perfect = fired(case, Firing(time, added))
    state = estimator.run([add_noise(SUITE, perfect, 2)])
    assert state.changes == 1
    assert -0.5 < state.change_time - time < 1.0
    assert nees(case, state) < chi2.isf(1e-4, 10)


def test_a_change_may_be_in_the_block_before_the_suspected_one(case, estimator, monkeypatch):
    """A window that ends soon after a firing cannot tell its block; a longer one finds it."""
    perfect = fired(case, Firing(1.2, np.array([6.0, -4.0, 5.0, 3.0, -2.0, 2.0])))
    blocks = BlockQueue.of(SUITE).added(add_noise(SUITE, perfect, 2), END)[1][:3]
    assert blocks[1].start < 1.2 < blocks[1].end
    monkeypatch.setattr(RecursiveFit, "_is_well_known", lambda *_: False)  # blocks stay a window
    state = replace(estimator.start(), window=tuple(blocks), changed=2, explained=3)
    state = estimator._fit(state)
    assert state.changed == 1
    assert state.all_changes == (1, blocks[1].end)
    found = identification_of_state(estimator, state)
    assert found.momentum_changes == MomentumChanges(1, blocks[1].end)
    assert f"changed once, last at {blocks[1].end:.3f} s" in found.warnings[0]


def exchanged(samples, until=np.inf):
    """Return samples in which two joints are exchanged before a time [s]."""
    time, value = samples.encoders.time, samples.encoders.value.copy()
    wrong = time < until
    value[wrong] = value[wrong][:, [0, 2, 1, 3]]
    return samples.updated({"encoders": Samples(time, value)})


def test_what_explains_no_beginning_is_not_tried_with_every_longer_window(
    estimator, samples, monkeypatch
):
    sizes = []

    def counting(solver, prior, blocks, psi, **options):
        sizes.append(len(blocks))
        return fit_window(solver, prior, blocks, psi, **options)

    monkeypatch.setattr("cpid_drake.estimation.recursive_fit.fit_window", counting)
    state = estimator.run([exchanged(samples)])
    assert not state.is_explained
    assert state.known.time == pytest.approx(END, abs=0.1)
    # A window may be fitted again with a wider prior.
    assert [size for size, _ in itertools.groupby(sizes)] == [1, 2, 3, 4, 6]


def test_a_good_part_after_a_hopeless_beginning_is_found(tmp_path, skewed_target):
    long = make_case(tmp_path, skewed_target, SUITE, duration=18.0)
    spoiled = exchanged(add_noise(SUITE, long.samples, 1), until=5.0)
    state = recursive_fit(long.craft, SUITE).run([spoiled])
    assert state.is_explained
    assert state.changes >= 1
    assert nees(long, state) < chi2.isf(1e-4, 10)


def test_samples_before_the_first_attitude_are_no_start(case, estimator, samples):
    """Without attitude, the first blocks are left; the estimate is that of the rest."""
    time = samples.attitude.time
    late = samples.updated({"attitude": samples.attitude.where(time > 2.5)})
    state = estimator.run([late])
    assert state.known is not None
    assert state.changes == 0
    assert nees(case, state) < chi2.isf(1e-4, 10)


def test_without_samples_nothing_is_known(case, samples):
    estimator = recursive_fit(case.craft, SUITE)
    for part in (samples.between(50, 60), samples.between(0, 0.2)):
        found = identification_of_state(estimator, estimator.run([part]))
        assert found.solution.rank == 0
        assert np.isnan(found.parameters).all()


def test_a_tumble_of_unknown_momentum_is_recovered(case, tmp_path, skewed_target):
    tumbling = make_case(tmp_path, skewed_target, SUITE, MOMENTUM, END)
    estimator = recursive_fit(tumbling.craft, SUITE, momentum=TotalMomentum.unknown())
    state = estimator.run([add_noise(SUITE, tumbling.samples, 4)])
    assert state.changes == 0
    assert nees(tumbling, state) < chi2.isf(1e-4, 10)
    true = tumbling.state(0.0)
    np.testing.assert_allclose(state.known.nominal.v_Wcm, true.v_Wcm, atol=2e-3)
    np.testing.assert_allclose(state.known.nominal.L, true.L, atol=0.1)


def test_encoders_slower_than_the_suite_says_make_longer_blocks_and_no_gaps(
    case, estimator, samples
):
    """Every fifth encoder sample, with the suite of all: the same answer within the interval."""
    encoders = samples.encoders.where(slice(0, None, 5))
    sparse = samples.updated({"encoders": encoders})
    queue = BlockQueue.of(SUITE).added(sparse.between(0, 1.5), 1.5)[0]
    assert queue.length == pytest.approx(20 * np.median(np.diff(encoders.time)))
    state = estimator.run([sparse])
    assert state.changes == 0
    assert nees(case, state) < chi2.isf(1e-4, 10)
