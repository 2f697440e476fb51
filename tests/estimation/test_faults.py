"""Faults of blocks: outliers are left out, changes of momentum are bridged, gaps are skipped."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from block_cases import best_psi, fired, make_case, spoiled
from scipy.stats import chi2
from sensing_cases import coarse_suite

from cpid_drake.errors import InputError
from cpid_drake.estimation.faults import (
    Block,
    after,
    block_model,
    bridged,
    explain,
    skipped,
    with_first_attitude,
)
from cpid_drake.estimation.initial_state import initial_state
from cpid_drake.identification.fit_setup import prior_of
from cpid_drake.sensing.measurements import Measurements, Samples
from cpid_drake.sensing.noise import add_noise
from cpid_drake.sensing.sensors import Gyro, JointSensor
from cpid_drake.studies.trials import Firing

EDGES = np.array([-1e-7, 1.0, 2.0, 3.0, 4.0])
SUITE = coarse_suite(
    encoders=JointSensor(50.0, 1e-5), gyro=Gyro(50.0, 0.005, 1.0, 0.1), velocity=None
)


@pytest.fixture(scope="module")
def case(tmp_path_factory, skewed_target):
    return make_case(tmp_path_factory.mktemp("craft"), skewed_target, SUITE)


@pytest.fixture(scope="module")
def clean(case):
    return add_noise(SUITE, case.samples, 1)


@pytest.fixture(scope="module")
def prior(case):
    return prior_of(case.craft.tree, None)


def explained(case, prior, samples, edges=EDGES):
    """Return the explanations of successive blocks about the true target."""
    solver, found = case.solver(), []
    blocks = [Block(a, b, after(samples, a, b)) for a, b in itertools.pairwise(edges)]
    state = initial_state(solver, prior, case.psi, blocks[0])
    for block in blocks:
        found.append(explain(solver, prior, state, block))
        state = found[-1].state
    return found


def shift(one, other):
    """Return the difference of two estimates of the target in σ of the second, (10,)."""
    root = other.root[-10:, -10:]
    return root @ (best_psi(one) - best_psi(other))


def nees(case, state):
    error = best_psi(state) - case.psi
    return float(error @ state.psi_information() @ error)


@pytest.fixture(scope="module")
def reference(case, prior, clean):
    return explained(case, prior, clean)


def test_without_faults_nothing_is_explained_away(case, reference):
    for found in reference:
        assert len(found.fits) == 1
        assert not found.bridged
        assert not found.left_out
    assert nees(case, reference[-1].state) < 30


@pytest.mark.parametrize(
    ("name", "size"), [("attitude", 0.02), ("gyro", 1e-3), ("position", 0.3), ("position", 0.012)]
)
@pytest.mark.parametrize("block", [0, 2])
def test_an_outlier_is_left_out(case, prior, clean, reference, name, size, block):
    """It is the bad sample that is left out, the only one, and the estimate stays."""
    time = clean[name].time
    which = np.flatnonzero((time > EDGES[block]) & (time <= EDGES[block + 1]))[2]
    bad = spoiled(clean, name, [which], np.array([size, -size / 2, size]))
    found = explained(case, prior, bad)
    assert [each.bridged for each in found] == 4 * [()]
    assert [each.left_out for each in found] == [
        ((name, 1),) if k == block else () for k in range(4)
    ]
    fewer = clean[name].where(np.arange(len(time)) != which)
    expected = explained(case, prior, clean.updated({name: fewer}))
    assert np.linalg.norm(shift(found[-1].state, expected[-1].state)) < 0.05  # σ


@pytest.mark.parametrize("duration", [0.0, 0.3])
def test_a_firing_is_bridged_and_the_momentum_after_it_estimated(case, prior, duration):
    """Only pieces that contain the firing; the target is as known as its covariance says."""
    added = np.array([6.0, -4.0, 5.0, 3.0, -2.0, 2.0])
    samples = add_noise(SUITE, fired(case, Firing(2.4, added, duration)), 1)
    found = explained(case, prior, samples)
    assert [len(each.bridged) > 0 for each in found] == [False, False, True, False]
    pieces = found[2].bridged
    assert pieces[0][0] <= 2.4 <= pieces[0][1]
    assert pieces[-1][1] < 2.4 + duration + 0.3
    state = found[-1].state
    assert nees(case, state) < 30
    # The velocity of the centre of mass has changed by the firing's force over the whole mass.
    mass = case.craft.mass + case.target.mass
    np.testing.assert_allclose(state.nominal.v_Wcm, added[3:] / mass, atol=2e-3)
    moved = state.nominal.L - found[1].state.nominal.L
    r = case.state(2.4).p_Wcm
    np.testing.assert_allclose(moved, added[:3] - np.cross(r, added[3:]), atol=0.1)


def test_pieces_are_sought_in_the_first_blocks_of_a_long_fault_only(case, prior, clean):
    """After the fault the rest is explained."""
    gyro = clean.gyro
    jitter = np.random.default_rng(3).normal(size=gyro.value.shape)
    wrong = gyro.value + jitter * (gyro.time < 3.0)[:, None]
    samples = clean.updated({"gyro": replace(gyro, value=wrong)})
    first, second, third, last = explained(case, prior, samples)
    assert [found.state.unexplained for found in (first, second, third, last)] == [1, 2, 3, 0]
    assert [len(found.bridged) for found in (first, second, third)] == [4, 8, 2]
    assert third.bridged[0][0] == second.bridged[-1][1]
    assert third.bridged[-1][1] == pytest.approx(3.0)
    assert not last.bridged
    assert nees(case, last.state) < chi2.isf(1e-3, 10)


def test_a_bridge_keeps_target_and_bias_and_opens_the_rest(case, prior, clean, reference):
    """The block counts as one with encoders alone; momentum and place change by unknown amounts."""
    before, solver = reference[1].state, case.solver()
    block = Block(2.0, 3.0, after(clean, 2.0, 3.0))
    wild = spoiled(block.samples, "gyro", slice(None), np.array([0.3, -0.2, 0.1]))
    model = block_model(solver, before, replace(block, samples=wild))
    after_bridge = bridged(solver, prior, before, model, None)
    joints_only = replace(block, samples=Measurements(clean.joint_names, encoders=wild.encoders))
    quiet = solver.solve(before, block_model(solver, before, joints_only)).state
    covariances = [np.linalg.inv(s.root) @ np.linalg.inv(s.root).T for s in (after_bridge, quiet)]
    changes = {"L": prior.unknown_L_sigma, "v_Wcm": 10.0, "attitude": 0.5, "p_Wcm": 10.0}
    for name, sigma in changes.items():
        place = solver.places[name]
        covariances[1][place, place] += sigma**2 * np.eye(3)
    sigma = np.sqrt(np.diag(covariances[1]))
    left, right = (c / sigma / sigma[:, None] for c in covariances)
    np.testing.assert_allclose(left, right, rtol=0, atol=2e-4)  # the momentum was exact
    np.testing.assert_array_equal(after_bridge.nominal.psi, before.nominal.psi)


def without(samples, name, start, end):
    time = samples[name].time
    return samples.updated({name: samples[name].where((time < start) | (time > end))})


@pytest.mark.parametrize("name", ["attitude", "gyro", "position"])
def test_a_gap_of_one_sensor_of_the_base_is_nothing_special(case, prior, clean, name):
    found = explained(case, prior, without(clean, name, 1.3, 3.2))
    assert not any(each.bridged or each.left_out for each in found)
    assert nees(case, found[-1].state) < 30


@pytest.mark.parametrize(("start", "end"), [(1.9, 3.1), (1.5, 2.2)])
def test_a_gap_of_the_encoders_is_skipped(case, prior, clean, start, end):
    """The momentum stays known, the attitude begins again; no outlier, no change is called."""
    found = explained(case, prior, without(clean, "encoders", start, end))
    assert not any(each.bridged for each in found)
    state = found[-1].state
    assert state.time == EDGES[-1]
    assert nees(case, state) < 35
    assert np.abs(state.nominal.L).max() < 1e-6


def test_after_a_gap_the_first_attitude_replaces_the_lost_one(case, clean, reference):
    """Only then; without an attitude sample there is nothing to begin with."""
    before = reference[1].state
    block = Block(2.0, 3.0, after(clean, 2.0, 3.0))
    assert with_first_attitude(before, block) is before
    lost = skipped(case.solver(), before, 2.0)
    found = with_first_attitude(lost, block).nominal.attitude.as_quat(scalar_first=True)
    sample = clean.attitude.value[np.searchsorted(clean.attitude.time, 2.0, side="right")]
    assert abs(found @ sample) == pytest.approx(1.0, abs=1e-12)
    with pytest.raises(InputError, match="no attitude samples"):
        with_first_attitude(lost, Block(2.0, 2.1, after(clean, 2.0, 2.1)))


def test_a_skipped_block_moves_the_centre_of_mass_and_nothing_else(case, reference):
    """By v T; the bias becomes as uncertain as its walk makes it."""
    before = reference[1].state
    moving = replace(before, nominal=replace(before.nominal, v_Wcm=np.array([0.1, 0.2, -0.3])))
    state = skipped(case.solver(), moving, 4.5)
    np.testing.assert_allclose(state.nominal.p_Wcm - before.nominal.p_Wcm, [0.25, 0.5, -0.75])
    assert (state.time, state.track) == (4.5, None)
    for name in ("psi", "L", "v_Wcm", "bias"):
        assert np.array_equal(getattr(state.nominal, name), getattr(moving.nominal, name))
    np.testing.assert_allclose(
        state.psi_information(), before.psi_information(), rtol=1e-3, atol=1e-3
    )
    place = case.solver().places["bias"]
    variance = [np.linalg.inv(s.root)[place] for s in (before, state)]
    added = variance[1] @ variance[1].T - variance[0] @ variance[0].T
    walk = SUITE.gyro.bias_growth**2 * 2.5
    np.testing.assert_allclose(np.diag(added), walk, rtol=1e-3)


def test_parts_of_a_block_share_no_sample(clean):
    """start < time ≤ end; both halves together are the whole."""
    block = Block(1.0, 2.0, after(clean, 1.0, 2.0))
    first, second = block.halves()
    assert (first.start, first.end, second.start, second.end) == (1.0, 1.5, 1.5, 2.0)
    for name, samples in block.samples.samples.items():
        assert (samples.time > 1.0).all()
        assert (samples.time <= 2.0).all()
        both = np.concatenate([first.samples[name].time, second.samples[name].time])
        np.testing.assert_array_equal(both, samples.time)
    assert block.samples.encoders.time[-1] == 2.0
    assert isinstance(block.samples.encoders, Samples)


def test_a_block_without_faults_is_the_solvers(case, prior, clean):
    """The explanation changes nothing if noise explains the block."""
    solver = case.solver()
    block = Block(EDGES[0], 1.0, after(clean, EDGES[0], 1.0))
    state = initial_state(solver, prior, case.psi, block)
    plain = solver.solve(state, block_model(solver, state, block)).state
    found = explain(solver, prior, state, block).state
    np.testing.assert_array_equal(found.root, plain.root)
    np.testing.assert_array_equal(found.rest, plain.rest)
