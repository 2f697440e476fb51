"""The joints' splines over many blocks: one least-squares problem, and what does not fit it."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from cpid_drake.estimation.likelihood.joint_motion import (
    ORDER,
    TIME_SCALE,
    joint_block,
)
from cpid_drake.sensing.measurements import Measurements, Samples
from cpid_drake.sensing.sensors import JointSensor
from cpid_drake.sensing.suite import SensorSuite

SIGMA, RATE_SIGMA = 1e-5, 1e-4
SUITE = SensorSuite(encoders=JointSensor(50.0, SIGMA), joint_rates=JointSensor(20.0, RATE_SIGMA))
EDGES = np.array([-1e-7, 1.0, 1.7, 3.0])
FREQUENCY = 2 * np.pi * np.array([0.15, 0.4, 0.9])


def motion(times, derivative=0):
    """Three joints, each a sine of its own frequency."""
    phase = FREQUENCY * times[:, None] + derivative * np.pi / 2
    return 0.4 * FREQUENCY**derivative * np.sin(phase)


def measured(seed=0, noise=1.0, duration=3.0, rates=True):
    rng = np.random.default_rng(seed)
    t, t_rate = np.arange(0, duration + 1e-9, 0.02), np.arange(0, duration + 1e-9, 0.05)
    q = motion(t) + noise * SIGMA * rng.normal(size=(len(t), 3))
    qdot = motion(t_rate, 1) + noise * RATE_SIGMA * rng.normal(size=(len(t_rate), 3))
    samples = {"encoders": Samples(t, q)}
    return Measurements(
        ("a", "b", "c"), samples | ({"joint_rates": Samples(t_rate, qdot)} if rates else {})
    )


def part(samples, start, end):
    kept = {n: s.where((s.time > start) & (s.time <= end)) for n, s in samples.samples.items()}
    return Measurements(samples.joint_names, kept)


def chain(samples, edges=EDGES, suite=SUITE):
    """Return successive blocks."""
    blocks, track = [], None
    for start, end in itertools.pairwise(edges):
        blocks.append(joint_block(start, end, part(samples, start, end), suite, track))
        track = blocks[-1].track
    return blocks


@pytest.fixture(scope="module")
def blocks():
    return chain(measured())


def test_errors_are_those_of_the_noise():
    """Position and rate at every time within their σ; χ² is that of its degrees of freedom."""
    squares, chi_squared, freedom = [], 0.0, 0
    for seed in range(12):
        blocks = chain(measured(seed))
        track = blocks[-1].track
        factor = np.array([[1.0], [TIME_SCALE], [TIME_SCALE**2 / 2]])
        end = np.array([EDGES[-1]])
        truth = factor * np.vstack([motion(end, d) for d in range(3)])
        squares.append(np.sum((track.root @ (track.mean - truth)) ** 2, axis=0))
        chi_squared += sum(block.chi_squared for block in blocks)
        freedom += sum(block.freedom for block in blocks)
    assert 0.5 * ORDER < np.mean(squares) < 1.7 * ORDER
    assert abs(chi_squared / freedom - 1) < 5 * np.sqrt(2 / freedom) + 0.02


def test_outliers_of_one_joint_are_left_out_and_nothing_else():
    """The others keep all their samples; the fit is as if the entries were missing."""
    clean = measured(rates=False)
    value = clean.encoders.value.copy()
    value[[20, 70, 110], 1] += [0.05, -40 * SIGMA, 3.0]
    spoiled = Measurements(clean.joint_names, encoders=Samples(clean.encoders.time, value))
    suite = replace(SUITE, joint_rates=None)
    reference, blocks = chain(clean, suite=suite), chain(spoiled, suite=suite)
    assert [block.outliers for block in reference] == [0, 0, 0]
    assert [block.outliers for block in blocks] == [1, 1, 1]
    root = reference[-1].track.root
    shift = root @ (blocks[-1].track.mean - reference[-1].track.mean)
    np.testing.assert_allclose(shift[:, [0, 2]], 0, atol=1e-3)
    assert np.abs(shift[:, 1]).max() < 1.0


def test_noise_that_is_larger_than_given_widens_the_covariance():
    """By χ² per degree of freedom; the errors are then as large as their σ again."""
    squares, factor = [], np.array([[1.0], [TIME_SCALE], [TIME_SCALE**2 / 2]])
    for seed in range(12):
        track = chain(measured(seed, noise=4.0))[-1].track
        truth = factor * np.vstack([motion(EDGES[-1:], d) for d in range(3)])
        squares.append(np.sum((track.root @ (track.mean - truth)) ** 2, axis=0))
    assert 0.4 * ORDER < np.mean(squares) < 2.5 * ORDER
    plain, wide = (chain(measured(1, noise=noise))[0] for noise in (1.0, 4.0))
    if plain.pieces == wide.pieces:
        ratio = np.linalg.norm(plain.rows) / np.linalg.norm(wide.rows)
        assert ratio == pytest.approx(4.0, rel=0.3)


def test_a_gap_is_bridged_with_the_jerk_so_far():
    """Without samples the σ at the end is that of the jerk, not that of a free polynomial."""
    samples = measured(rates=False)
    before = chain(samples, EDGES[:2], replace(SUITE, joint_rates=None))[0].track
    time = samples.encoders.time
    few = Measurements(
        samples.joint_names, encoders=samples.encoders.where((time < 1.15) | (time > 1.695))
    )
    block = joint_block(1.0, 1.7, part(few, 1.0, 1.7), replace(SUITE, joint_rates=None), before)
    t = np.array([1.4])
    error = np.abs(block.basis(t) @ block.coefficients - motion(t)).max()
    assert error < 0.05 * before.jerk * 0.7**3
    assert block.track.jerk > 0


def test_errors_of_resolution_are_those_of_the_coefficients():
    """Joints that start from rest, at all places between two steps: errors as large as their σ."""
    suite = SensorSuite(encoders=JointSensor(100.0, 0.0, bits=16))
    step, times = suite.encoders.step, np.arange(0, 0.501, 0.01)
    zero = np.linspace(-0.5, 0.5, 101)[:-1] * step
    true = (2e-2 * times**3)[:, None] + zero
    samples = Measurements(
        tuple(f"joint {k}" for k in range(len(zero))),
        encoders=Samples(times, np.round(true / step) * step),
    )
    block = joint_block(-1e-7, 0.5, samples, suite, None)
    exact = np.linalg.lstsq(block.basis(times), true, rcond=None)[0]
    errors = np.einsum("jrk,jk->jr", block.rows, (exact - block.coefficients).T)
    assert 0.3 < np.mean(errors**2) < 1.2
    assert np.mean(errors**2, axis=0).max() < 2.0
