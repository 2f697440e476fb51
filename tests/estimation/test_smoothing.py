"""Samples of many rates become motion: errors are what the covariance says, on SO(3) too."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from sensing_cases import Sines, coarse_suite, measured, true_telemetry

from cpid_drake.estimation.smoothing import smooth
from cpid_drake.logs.log import Samples
from cpid_drake.logs.simulated_noise import add_noise
from cpid_drake.sensors.sensors import AttitudeSensor, Gyro

DURATION = 8.0
SEEDS = range(8)
TUMBLE = np.array([40.0, -90.0, 60.0, 4.0, 2.0, -3.0])  # turns by more than a whole turn
JOINTS = 4
GROUPS = {
    "attitude": slice(0, 3),
    "angular velocity": slice(3, 6),
    "position": slice(6, 9),
    "velocity": slice(9, 12),
    "joints": slice(12, 12 + JOINTS),
    "joint rates": slice(12 + JOINTS, 12 + 2 * JOINTS),
}


@pytest.fixture(scope="module")
def motion(craft):
    return Sines.drawn(JOINTS, seed=91, duration=DURATION)


@pytest.fixture(scope="module")
def scene(craft, motion, skewed_target):
    """Return a function (suite, momentum) -> measurements without noise, and the true motion."""

    def make(suite, momentum=None):
        perfect = measured(craft, motion, skewed_target, suite, momentum)

        def truth(times):
            return true_telemetry(
                craft.tree, craft.joint_names, motion, skewed_target, times, momentum
            )

        return perfect, truth

    return make


def errors(ours, truth):
    """Return the errors (N, quantities) of smoothed motion in the order of its covariance."""
    true = truth(ours.time)
    R, R_true = (Rotation.from_quat(t.quaternion_WB, scalar_first=True) for t in (ours, true))
    return np.hstack(
        [
            (R.inv() * R_true).as_rotvec(),
            R_true.inv().apply(true.w_WB) - R.inv().apply(ours.w_WB),
            true.p_WB - ours.p_WB,
            true.v_WB - ours.v_WB,
            true.q - ours.q,
            true.qdot - ours.qdot,
        ]
    )


def normalized(suite, perfect, truth, seeds=SEEDS, change=lambda measurements: measurements):
    """Return errors over their σ, (seeds, N, quantities), and the instants."""
    result = []
    for seed in seeds:
        found, covariance = smooth(change(add_noise(suite, perfect, seed)), suite)
        sigma = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
        result.append(errors(found, truth) / sigma)
    return np.array(result), found.time


def assert_consistent(z, **highest) -> None:
    """Errors over σ have a mean square of one, or somewhat more where it is said."""
    for name, columns in GROUPS.items():
        high = highest.get(name.replace(" ", "_"), 1.3)
        rms = np.sqrt(np.mean(z[..., columns] ** 2))
        assert 0.7 < rms < high, f"{name}: errors are {rms:.2f} times their σ"


# -- the covariance -------------------------------------------------------------------------------


@pytest.mark.slow
def test_errors_are_as_large_as_the_covariance_says(scene):
    """Each by itself, and with its correlations: attitude with its rate, a joint with its rate."""
    suite = coarse_suite()
    perfect, truth = scene(suite, TUMBLE)
    e, P = [], []
    for seed in SEEDS:
        found, covariance = smooth(add_noise(suite, perfect, seed), suite)
        e.append(errors(found, truth))
        P.append(covariance)
    e, P = np.array(e), np.array(P)
    assert_consistent(e / np.sqrt(np.diagonal(P, axis1=2, axis2=3)), velocity=1.5)
    for columns in (np.arange(6), np.array([12, 12 + JOINTS])):
        part = P[:, :, columns[:, None], columns]
        scaled = np.linalg.solve(part, e[:, :, columns, None])[..., 0]
        mean = np.mean(np.sum(e[:, :, columns] * scaled, axis=-1)) / columns.size
        assert 0.75 < mean < 1.25


@pytest.mark.slow
def test_a_gyro_less_craft_has_the_splines_rates(scene):
    """Angular velocity from attitude alone, and joint rates from encoders alone."""
    suite = coarse_suite(gyro=None, attitude=AttitudeSensor(20.0, 5.0, 40.0))
    perfect, truth = scene(suite)
    z, _ = normalized(suite, perfect, truth)
    assert_consistent(z, angular_velocity=1.5, velocity=1.5)


def test_the_gyros_bias_is_no_angular_velocity(scene):
    """A bias far above what the sheet says is σ would show in the rate."""
    suite = coarse_suite(gyro=Gyro(20.0, 0.001, 50.0, 0.0))
    perfect, truth = scene(suite)
    bias = np.array([3e-4, -2e-4, 1e-4])
    gyro = Samples(perfect.gyro.time, perfect.gyro.value + bias)
    found, _ = smooth(perfect.updated({"gyro": gyro}), suite)
    rates = errors(found, truth)[:, GROUPS["angular velocity"]]
    np.testing.assert_allclose(rates.mean(axis=0), 0.0, atol=2e-5)


# -- on SO(3) -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("rate", "integrates"), [(10.0, False), (10.0, True), (2.0, False)], ids=str
)
def test_noise_free_motion_comes_back_through_whole_turns(scene, rate, integrates):
    """A base that tumbles through more than a turn: attitude and rate are right throughout."""
    suite = coarse_suite(gyro=Gyro(50.0, integrates=integrates), attitude=AttitudeSensor(rate))
    perfect, truth = scene(suite, TUMBLE)
    smoothed, _ = smooth(perfect, suite)
    true = truth(smoothed.time)
    assert np.linalg.norm(true.w_WB, axis=1).mean() * DURATION > 2 * np.pi
    e = errors(smoothed, truth)
    assert np.abs(e[:, GROUPS["attitude"]]).max() < 1e-6
    assert np.abs(e[:, GROUPS["angular velocity"]]).max() < 1e-6


def test_a_precise_gyro_carries_a_noisy_attitude_through_a_tumble(scene):
    """The error of the attitude is one turn in W for the whole log, some tenth of its noise."""
    sigma = np.radians(200 / 3600)
    suite = coarse_suite(attitude=AttitudeSensor(5.0, 200.0, 200.0), gyro=Gyro(20.0, 0.001))
    perfect, truth = scene(suite, 3 * TUMBLE)
    smoothed, _ = smooth(add_noise(suite, perfect, 2), suite)
    e = errors(smoothed, truth)
    assert np.sqrt(np.mean(e[:, GROUPS["attitude"]] ** 2)) < 0.4 * sigma
    assert np.sqrt(np.mean(e[:, GROUPS["angular velocity"]] ** 2)) < 5e-5


@pytest.mark.parametrize("turn", [[0, -3.14159, 0], [2, 2, -1.5]])
def test_attitude_knows_no_preferred_direction(scene, turn):
    """Turned as a whole, the motion is turned as a whole, to rounding."""
    suite = coarse_suite()
    noisy = add_noise(suite, scene(suite)[0], 1)
    R = Rotation.from_rotvec(turn)

    def turned(samples):
        attitude = Rotation.from_quat(samples.value, scalar_first=True)
        return Samples(samples.time, (R * attitude).as_quat(scalar_first=True))

    plain, _ = smooth(noisy, suite)
    other, _ = smooth(noisy.updated({"attitude": turned(noisy.attitude)}), suite)
    np.testing.assert_allclose(other.R_WB, R.as_matrix() @ plain.R_WB, rtol=0, atol=1e-9)
    np.testing.assert_allclose(other.w_WB, R.apply(plain.w_WB), rtol=0, atol=1e-9)


# -- gaps and what is missing ---------------------------------------------------------------------


def without(name, start, end):
    def change(measurements):
        samples = getattr(measurements, name)
        keep = (samples.time < start) | (samples.time > end)
        return measurements.updated({name: samples.where(keep)})

    return change


@pytest.mark.parametrize("name", ["encoders", "attitude", "position"])
def test_no_times_are_in_a_gap_and_beside_it_the_errors_are_known(scene, name):
    suite = coarse_suite()
    z, times = normalized(suite, *scene(suite), range(4), without(name, 3.5, 4.5))
    assert not ((times > 3.6) & (times < 4.4)).any()
    assert np.sqrt(np.mean(z**2)) < 1.3
