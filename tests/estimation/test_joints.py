"""The joints as smoothing splines: one dense problem, noise and jerk of the log, gaps, outliers."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from scipy.signal import lfilter

from cpid_drake.estimation.block import Block, after
from cpid_drake.estimation.joints import smooth_joints
from cpid_drake.estimation.likelihood.joint_model import ORDER, jerk_rows
from cpid_drake.estimation.process import DECLARED_COUNT as DECLARED
from cpid_drake.files.errors import InputError
from cpid_drake.logs.log import Log, Samples
from cpid_drake.sensors.sensors import JointSensor
from cpid_drake.sensors.suite import SensorSuite

SIGMA, RATE_SIGMA = 1e-4, 1e-3
SUITE = SensorSuite(encoders=JointSensor(50.0, SIGMA), joint_rates=JointSensor(20.0, RATE_SIGMA))
FREQUENCY = 2 * np.pi * np.array([0.15, 0.3, 0.5])


def motion(times, derivative=0):
    """Three joints, each a sine of its own frequency."""
    phase = FREQUENCY * np.asarray(times)[:, None] + derivative * np.pi / 2
    return 0.4 * FREQUENCY**derivative * np.sin(phase)


def log(seed=0, duration=6.0, rate=50.0, noise=1.0, gaps=(), rates=True):
    """Return samples of the motion; `gaps` are times without samples."""
    rng = np.random.default_rng(seed)
    samples = {}
    for name, step, sigma, derivative in (
        ("encoders", 1 / rate, SIGMA, 0),
        ("joint_rates", 0.05, RATE_SIGMA, 1),
    ):
        t = np.arange(0, duration + 1e-9, step)
        for start, end in gaps:
            t = t[(t < start) | (t > end)]
        value = motion(t, derivative) + noise * sigma * rng.normal(size=(len(t), 3))
        samples[name] = Samples(t, value)
    if not rates:
        del samples["joint_rates"]
    return Log(("a", "b", "c"), samples)


def blocks_of(samples, length=1.0):
    end = float(samples.encoders.time[-1])
    edges = np.append(np.arange(-1e-7, end - 0.5 * length, length), end + 1e-7)
    return [Block(a, b, after(samples, a, b)) for a, b in pairwise(edges.tolist())]


def evaluated(parts, times, derivative=0):
    values = [
        part.basis(times[(times > part.start) & (times <= part.end)], derivative)
        @ part.coefficients
        for part in parts
    ]
    return np.concatenate(values)


def dense(parts, j):
    """Return rows, right-hand side and each block's columns of one joint in all blocks."""
    first = np.cumsum([0, *(part.size - ORDER for part in parts)])
    columns = [slice(start, start + part.size) for part, start in zip(parts, first)]
    rows = np.zeros((sum(part.size for part in parts), first[-1] + ORDER))
    done = 0
    for part, place in zip(parts, columns):
        rows[done : done + part.size, place] = part.rows[j]
        done += part.size
    return rows, np.concatenate([part.target[j] for part in parts]), columns


def test_blocks_that_follow_each_other_are_one_least_squares_problem():
    """With positions, rates and accelerations in common."""
    _, parts = smooth_joints(blocks_of(log(duration=4.0)), SUITE)
    for j in range(3):
        rows, target, columns = dense(parts, j)
        c = np.linalg.lstsq(rows, target, rcond=None)[0]
        for part, place in zip(parts, columns):
            np.testing.assert_allclose(part.coefficients[:, j], c[place], atol=1e-3 * SIGMA)


@pytest.mark.parametrize("seed", range(4))
def test_the_roughest_block_says_how_rough_a_motion_is(seed):
    """Half a cosine between two rests; with the usual jerk the rate at its start is 11 σ off."""
    rng, t, w, sigma = np.random.default_rng(seed), np.arange(0, 8, 0.01), np.pi / 2.34, 1e-5

    def turn(times, derivative=0):
        phase = w * np.clip(np.asarray(times) - 2.03, 0.0, np.pi / w)
        return 0.3 * w * np.sin(phase) if derivative else 0.3 * (1 - np.cos(phase))

    noisy = turn(t) + sigma * rng.standard_normal(len(t))
    samples = Log(("a",), {"encoders": Samples(t, noisy[:, None])})
    suite = SensorSuite(encoders=JointSensor(100.0, sigma))
    _, parts = smooth_joints(blocks_of(samples), suite)
    rows, _, columns = dense(parts, 0)
    covariance, worst = np.linalg.inv(rows.T @ rows), 0.0
    for part, place in zip(parts, columns):
        at = np.linspace(part.start + 1e-6, part.end, 100)
        basis = part.basis(at, 1)
        spread = np.sqrt(np.einsum("ti,ij,tj->t", basis, covariance[place, place], basis))
        error = basis @ part.coefficients[:, 0] - turn(at, 1)
        worst = max(worst, np.abs(error / spread)[(at > 0.2) & (at < 7.8)].max())
    assert worst < 10


@pytest.mark.parametrize("noise", [1.0, 3.0])
def test_noise_and_errors_are_those_of_the_log(noise):
    """The noise factor is found, and positions are much better than single samples."""
    samples = log(noise=noise)
    smoothness, parts = smooth_joints(blocks_of(samples), SUITE)
    np.testing.assert_allclose(smoothness.noise, noise, rtol=0.12)
    t = np.linspace(0.1, 5.9, 200)
    errors = evaluated(parts, t) - motion(t)
    assert np.sqrt(np.mean(errors**2)) < 0.5 * noise * SIGMA


def test_a_drawn_jerk_and_its_noise_are_found():
    """Eight joints with a jerk that is white noise, so slow that splines of few pieces follow."""
    rng, J, h, jerk = np.random.default_rng(0), 8, 0.02, 0.02
    step = np.array([[1, h, h**2 / 2], [0, 1, h], [0, 0, 1]])
    spread = [[h**5 / 20, h**4 / 8, h**3 / 6], [h**4 / 8, h**3 / 3, h**2 / 2]]
    root = np.linalg.cholesky(jerk**2 * np.array([*spread, [h**3 / 6, h**2 / 2, h]]))
    states = [np.zeros((3, J))]
    for _ in range(800):
        states.append(step @ states[-1] + root @ rng.normal(size=(3, J)))
    position = np.stack(states)[:, 0]
    times = h * np.arange(len(position))
    samples = Samples(times, position + SIGMA * rng.normal(size=position.shape))
    log = Log(tuple("abcdefgh"), {"encoders": samples})
    suite = SensorSuite(encoders=JointSensor(50.0, SIGMA))
    smoothness, _ = smooth_joints(blocks_of(log), suite)
    assert np.exp(np.mean(np.log(smoothness.jerk / jerk))) == pytest.approx(1, abs=0.25)
    np.testing.assert_allclose(smoothness.noise, 1, rtol=0.1)


def test_smoothness_and_noise_have_the_most_evidence():
    """By the formula, with dense rows of the whole log."""
    suite = SensorSuite(encoders=JointSensor(50.0, SIGMA))
    samples = log(duration=4.0, noise=3.0, rates=False)
    smoothness, parts = smooth_joints(blocks_of(samples), suite)
    first = np.cumsum([0, *(part.size - ORDER for part in parts)])
    n, K, t = len(samples.encoders), first[-1] + ORDER, samples.encoders.time
    B, P = np.zeros((0, K)), np.zeros((0, K))
    for part, start in zip(parts, first):
        for_block = np.eye(K)[start : start + part.size]
        times = t[(t > part.start) & (t <= part.end)]
        B = np.vstack([B, part.basis(times) / SIGMA @ for_block])
        P = np.vstack([P, jerk_rows(part.end - part.start, part.pieces) @ for_block])

    def squares(u, q):
        rows, target = np.vstack([B, np.exp(-u / 2) * P]), np.append(q / SIGMA, np.zeros(len(P)))
        rest = target - rows @ np.linalg.lstsq(rows, target, rcond=None)[0]
        volume = 2 * np.sum(np.log(np.abs(np.diag(np.linalg.qr(rows, mode="r")))))
        return DECLARED + rest @ rest, volume + (K - ORDER) * u

    def evidence(u, q):
        S, volume = squares(u, q)
        return (DECLARED + n - ORDER) * np.log(S) + volume

    for q, jerk, noise in zip(samples.encoders.value.T, smoothness.jerk, smoothness.noise):
        u = 2 * np.log(jerk / noise)
        best = minimize_scalar(evidence, bounds=(u - 2, u + 2), method="bounded", args=(q,)).x
        assert u == pytest.approx(best, abs=0.02)
        assert noise == pytest.approx(np.sqrt(squares(u, q)[0] / (DECLARED + n - ORDER)), rel=1e-6)


@pytest.mark.parametrize("rate", [20.0, 100.0])
def test_exact_encoders_are_not_called_noisy(rate):
    """The splines are as fine as the motion asks for; too coarse ones leave 10 σ at 20 Hz."""
    suite = SensorSuite(encoders=JointSensor(rate, 1e-2 * SIGMA))
    samples = log(rate=rate, noise=1e-2, rates=False)
    assert (smooth_joints(blocks_of(samples), suite)[0].noise < 3).all()


def test_gaps_are_bridged_without_ringing():
    """Few samples, larger noise, gaps: errors as large as their σ, accelerations as true ones."""
    suite = SensorSuite(encoders=JointSensor(5.0, SIGMA))
    squares = []
    for seed in range(4):
        gaps = [(3.1, 4.3), (11.1, 12.9), (20.3, 21.5)]
        samples = log(seed, duration=30.0, rate=5.0, noise=3.0, gaps=gaps, rates=False)
        _, parts = smooth_joints(blocks_of(samples, 4.0), suite)
        t = np.linspace(0.5, 29.5, 400)
        acceleration = evaluated(parts, t, 2)
        assert np.abs(acceleration).max() < 2 * np.abs(motion(t, 2)).max()
        for part in parts:
            at = np.linspace(part.start + 0.2, part.end - 0.2, 5)
            error = part.evaluate(at)[:, 0] - motion(at)
            for j in range(3):
                basis = part.basis(at)
                spread = np.linalg.norm(np.linalg.solve(part.rows[j].T, basis.T), axis=0)
                squares.append(np.mean((error[:, j] / spread) ** 2))
    assert np.mean(squares) < 2.0


def test_outliers_do_not_pull_the_motion():
    clean = log(rates=False)
    value = clean.encoders.value.copy()
    rng = np.random.default_rng(1)
    for j in range(3):
        value[rng.choice(len(value), 6, replace=False), j] += 40 * SIGMA
    spoiled = Log(clean.joint_names, {"encoders": Samples(clean.encoders.time, value)})
    suite = SensorSuite(encoders=JointSensor(50.0, SIGMA))
    t = np.linspace(0.1, 5.9, 200)
    motions = [evaluated(smooth_joints(blocks_of(each), suite)[1], t) for each in (clean, spoiled)]
    assert np.abs(motions[1] - motions[0]).max() < 3 * SIGMA
    smoothness, _ = smooth_joints(blocks_of(spoiled), suite)
    assert (smoothness.noise < 2).all()


def test_a_block_without_samples_is_part_of_the_motion():
    samples = log(gaps=[(2.01, 2.99)])
    blocks = blocks_of(samples)
    assert any(not len(block.samples.encoders) for block in blocks_of(samples, 0.5))
    for cut in (blocks, blocks_of(samples, 0.5)):
        _, parts = smooth_joints(cut, SUITE)
        t = np.linspace(2.1, 2.9, 9)
        assert np.abs(evaluated(parts, t) - motion(t)).max() < 0.02


def test_a_slow_motion_is_seen_although_no_block_shows_its_jerk():
    """A sine of 20 s in blocks of 4 s, with three times the declared noise and a gap."""
    rng, t = np.random.default_rng(3), np.arange(0, 60, 0.2)
    t = t[(t < 30) | (t > 33)]
    sigma, speed = 2e-3, 2 * np.pi / 20
    angle = 0.3 * np.sin(speed * t)[:, None]
    samples = Samples(t, angle + 3 * sigma * rng.standard_normal(angle.shape))
    suite = SensorSuite(encoders=JointSensor(5.0, sigma))
    blocks = blocks_of(Log(("a",), {"encoders": samples}), 4.0)
    smoothness, parts = smooth_joints(blocks, suite)
    error = evaluated(parts, t)[:, 0] - angle[:, 0]
    assert np.sqrt(np.mean(error**2)) < sigma
    rate = evaluated(parts, t, 1)[:, 0] - 0.3 * speed * np.cos(speed * t)
    assert np.sqrt(np.mean(rate**2)) < 0.1 * 0.3 * speed
    assert smoothness.noise[0] == pytest.approx(3.0, rel=0.15)


def test_a_long_log_is_smoothed_as_a_short_one_is():
    """Over 20 minutes a parabola of the whole log is nearly singular."""
    suite = SensorSuite(encoders=JointSensor(5.0, SIGMA))
    samples = log(duration=1200.0, rate=5.0, rates=False)
    smoothness, _ = smooth_joints(blocks_of(samples, 2.0), suite)
    np.testing.assert_allclose(smoothness.noise, 1.0, rtol=0.1)


def test_samples_that_determine_no_motion_are_refused():
    two = log(duration=0.02, rates=False)
    with pytest.raises(InputError, match="too few samples"):
        smooth_joints([Block(-1e-7, 1.0, two)], SUITE)


def test_two_samples_behind_a_gap_determine_no_motion():
    samples = log(duration=4.0, rates=False)
    blocks = [Block(a, b, after(samples, a, b)) for a, b in ((-1e-7, 1.0), (1.0, 2.0), (3.0, 3.05))]
    with pytest.raises(InputError, match="too few samples"):
        smooth_joints(blocks, SUITE)


def test_a_pause_of_minutes_is_one_piece_that_disturbs_no_sample():
    given = log(duration=6.0)
    parts = {n: Samples(s.time + 1000.0 * (s.time > 3), s.value) for n, s in given.samples.items()}
    paused = given.updated(parts)
    edges = [-1e-7, 1.0, 2.0, 3.0, 1003.0, 1004.0, 1005.0, 1006.1]
    blocks = [Block(a, b, after(paused, a, b)) for a, b in pairwise(edges)]
    _, found = smooth_joints(blocks, SUITE)
    assert found[3].size < found[2].size
    shown = evaluated(found, paused.encoders.time)
    assert np.abs(shown - paused.encoders.value).max() < 6 * SIGMA


def test_joints_are_elsewhere_behind_a_gap():
    """A part without blocks connects nothing: in half a second they have turned by a radian."""
    given = log(duration=8.0, rates=False)
    time, value = given.encoders.time, given.encoders.value
    moved = Samples(time, value + (time > 4.25)[:, None])
    samples = given.updated({"encoders": moved.where((time <= 4.0) | (time >= 4.5))})
    edges = [-1e-7, 1.0, 2.0, 3.0, 4.0], [4.5 - 1e-7, 5.5, 6.5, 7.5, 8.0]
    blocks = [Block(a, b, after(samples, a, b)) for part in edges for a, b in pairwise(part)]
    smoothness, parts = smooth_joints(blocks, SUITE)
    np.testing.assert_allclose(smoothness.noise, 1.0, rtol=0.12)
    for part in parts:
        at = np.linspace(part.start + 1e-3, part.end, 20)
        error = part.evaluate(at)[:, 0] - motion(at) - (part.start > 4.25)
        assert np.sqrt(np.mean(error**2)) < SIGMA


@pytest.mark.parametrize("rate", [50.0, 500.0])
@pytest.mark.parametrize("frequency", [0.1, 5.0])
def test_a_fast_motion_is_no_noise(frequency, rate):
    """Beside a joint at rest, and in steps of an encoder of 12 bits."""
    step, t = 2 * np.pi / 2**12, np.arange(0.0, 10.0, 1 / rate)
    moving = np.outer(np.sin(2 * np.pi * frequency * t), [0.3, 0.02, 0.0])
    suite = SensorSuite(encoders=JointSensor(rate, bits=12))
    samples = Log(("a", "b", "c"), {"encoders": Samples(t, step * np.round(moving / step))})
    smoothness, parts = smooth_joints(blocks_of(samples), suite)
    np.testing.assert_allclose(smoothness.noise, 1.0, rtol=0.2)
    assert np.abs(evaluated(parts, t) - moving).max() < step


@pytest.mark.parametrize(("frequency", "rho"), [(0.3, 0.9), (10.0, 0.0)])
def test_correlated_noise_of_fast_encoders_is_no_motion_and_a_vibration_is(frequency, rho):
    """At 1 kHz, noise with a time of 10 ms looks like a vibration."""
    rng, t = np.random.default_rng(0), np.arange(0.0, 6.0, 1e-3)
    moving = 0.01 * np.sin(2 * np.pi * frequency * t)[:, None]
    fresh = SIGMA * np.sqrt(1 - rho**2) * rng.standard_normal((len(t) + 100, 1))
    noise = lfilter([1.0], [1.0, -rho], fresh, axis=0)[100:]
    suite = SensorSuite(encoders=JointSensor(1000.0, SIGMA))
    samples = Log(("a",), {"encoders": Samples(t, moving + noise)})
    smoothness, parts = smooth_joints(blocks_of(samples), suite)
    assert bool(smoothness.processes) == (rho > 0)
    assert (smoothness.rate > 32) == (frequency > 5)
    assert np.sqrt(np.mean((evaluated(parts, t) - moving) ** 2)) < 0.7 * SIGMA


@pytest.mark.parametrize("rate", [50.0, 500.0])
def test_a_joint_at_rest_is_as_smooth_beside_a_fast_one(rate):
    """Which needs many pieces: in theirs, jerk weighs 1e13 times as much as the samples at rest."""
    t = np.arange(0.0, 20.0, 1 / rate)
    angles = np.outer(np.sin(2 * np.pi * 5.0 * t), [0.3, 0.0])
    step = 2 * np.pi / 2**12
    suite = SensorSuite(encoders=JointSensor(rate, bits=12))
    jerk = []
    for names, columns in (("ab", [0, 1]), ("b", [1])):
        value = step * np.round(angles[:, columns] / step)
        samples = Log(tuple(names), {"encoders": Samples(t, value)})
        jerk.append(smooth_joints(blocks_of(samples), suite)[0].jerk[-1])
    assert jerk[0] == pytest.approx(jerk[1], rel=0.1)


@pytest.mark.parametrize("rate", [50.0, 200.0])
def test_a_joint_at_rest_is_known_to_the_step_of_its_encoder(rate):
    """However many samples repeat its value: the error of rounding stays the same."""
    step = 2 * np.pi / 2**12
    suite = SensorSuite(encoders=JointSensor(rate, bits=12))
    time = np.arange(0.0, 10.0 + 1e-9, 1 / rate)
    rest = Log(("hinge",), {"encoders": Samples(time, np.full((len(time), 1), 7 * step))})
    _, parts = smooth_joints(blocks_of(rest), suite)
    information = 0.0
    for part in parts:
        basis = part.basis(np.linspace(part.start + 1e-6, part.end, 50), 0)
        shift = np.linalg.lstsq(basis, np.ones(50), rcond=1e-12)[0]  # of the whole motion by 1 rad
        information += float(np.sum((part.rows[0] @ shift) ** 2))
    assert 1 / np.sqrt(information) == pytest.approx(step / np.sqrt(12), rel=0.05)


def test_values_that_change_from_sample_to_sample_are_all_used():
    step, time = 2 * np.pi / 2**12, np.arange(0.0, 5.0 + 1e-9, 0.02)
    value = step * np.round(0.5 * time[:, None] / step)
    moves = Log(("hinge",), {"encoders": Samples(time, value)})
    white = JointSensor(50.0, step / np.sqrt(12))
    found = []
    for encoders in (JointSensor(50.0, bits=12), white):
        suite = SensorSuite(encoders=encoders)
        _, parts = smooth_joints(blocks_of(moves), suite)
        found.append([part.rows for part in parts[:1]])
    np.testing.assert_allclose(found[0], found[1], rtol=1e-6)
