"""Sensor models: statistics, rates and seeds; and checks."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from sensing_cases import every_sensor

from cpid_drake import Motion
from cpid_drake.logs.log import (
    Log,
    Samples,
    ideal_log,
    sample_times,
)
from cpid_drake.logs.simulated_noise import SensorNoise, add_noise
from cpid_drake.sensors.sensors import (
    ARCSECOND,
    DEGREE_PER_HOUR,
    DEGREE_PER_ROOT_HOUR,
    SENSORS,
    AttitudeSensor,
    Gyro,
    JointSensor,
    VectorSensor,
)
from cpid_drake.sensors.suite import SensorSuite

JOINTS = ("a", "b")
COUNT = 20000


def motion(times) -> Motion:
    """A base that turns and drifts, joints that swing."""
    t = np.asarray(times)[:, None]
    attitude = Rotation.from_rotvec(t * [0.02, -0.05, 0.03])
    return Motion(
        JOINTS,
        t[:, 0],
        quaternion_WB=attitude.as_quat(scalar_first=True),
        p_WB=t * [0.01, 0.02, -0.03],
        w_WB=np.tile([0.02, -0.05, 0.03], (t.size, 1)),
        v_WB=np.tile([0.01, 0.02, -0.03], (t.size, 1)),
        q=np.sin(t * [0.3, 0.4]),
        qdot=np.cos(t * [0.3, 0.4]) * [0.3, 0.4],
    )


@pytest.fixture(scope="module")
def perfect() -> Log:
    return ideal_log(every_sensor(), JOINTS, motion, 10.0)


# -- statistics ----------------------------------------------------------------------------------


@pytest.mark.parametrize("boresight", [[0.0, 0.0, 1.0], [1.0, 2.0, -0.5]])
def test_a_star_tracker_errs_more_about_its_boresight(boresight):
    sensor = AttitudeSensor(
        cross_boresight_arcsec=2.0, boresight_arcsec=20.0, boresight_B=np.array(boresight)
    )
    R_BS = sensor.R_BS
    np.testing.assert_allclose(R_BS.T @ R_BS, np.eye(3), atol=1e-15)
    assert np.linalg.det(R_BS) == pytest.approx(1.0)
    np.testing.assert_allclose(R_BS[:, 2], np.array(boresight) / np.linalg.norm(boresight))

    true = Rotation.random(COUNT, np.random.default_rng(1))
    noise = SensorNoise(SensorSuite(attitude=sensor), seed=3)
    measured = noise.apply("attitude", true.as_quat(scalar_first=True))
    error_B = (true.inv() * Rotation.from_quat(measured, scalar_first=True)).as_rotvec()
    spread = (error_B @ R_BS).std(axis=0)
    np.testing.assert_allclose(spread, ARCSECOND * np.array([2.0, 2.0, 20.0]), rtol=0.03)
    np.testing.assert_allclose(spread, sensor.sigmas, rtol=0.03)
    np.testing.assert_allclose(np.linalg.norm(measured, axis=1), 1.0, rtol=1e-12)


@pytest.mark.parametrize("rate", [10.0, 100.0])
def test_a_gyro_integrates_to_its_angle_random_walk(rate):
    """The angle's spread grows as √t, by the data sheet's number, whatever the rate of samples."""
    gyro = Gyro(rate=rate, angle_random_walk=0.07)
    white = SensorNoise(SensorSuite(gyro=gyro), seed=5).apply("gyro", np.zeros((25 * COUNT, 3)))
    np.testing.assert_allclose(white[:COUNT].std(axis=0), gyro.sigma, rtol=0.03)
    for averaged in (5, 25):
        tau = averaged / rate
        angles = white.reshape(-1, averaged, 3).sum(axis=1) / rate
        expected = 0.07 * DEGREE_PER_ROOT_HOUR * np.sqrt(tau)
        np.testing.assert_allclose(angles.std(axis=0), expected, rtol=0.03)
        rates = angles / tau
        allan = np.sqrt(0.5 * np.mean(np.diff(rates, axis=0) ** 2, axis=0))
        np.testing.assert_allclose(allan, expected / tau, rtol=0.03)
    one_hour = 0.07 * DEGREE_PER_ROOT_HOUR * np.sqrt(3600.0)
    assert np.degrees(one_hour) == pytest.approx(0.07)


def test_a_bias_is_constant_and_of_the_given_spread():
    gyro = Gyro(bias=3.0)
    biases = []
    for seed in range(1500):
        noise = SensorNoise(SensorSuite(gyro=gyro), seed)
        biases.append(noise.gyro_bias(1)[0])
        if seed < 3:
            samples = noise.apply("gyro", np.zeros((500, 3)))
            np.testing.assert_array_equal(samples, np.tile(biases[-1], (500, 1)))
    np.testing.assert_allclose(np.std(biases, axis=0), 3.0 * DEGREE_PER_HOUR, rtol=0.06)
    assert np.std(biases) == pytest.approx(gyro.bias_sigma, rel=0.04)


def test_a_bias_walks_as_the_root_of_time():
    gyro = Gyro(rate=10.0, bias=1.0, bias_random_walk=6.0)
    changes = []
    for seed in range(1500):
        noise = SensorNoise(SensorSuite(gyro=gyro), seed)
        start = noise.gyro_bias(1)[0]
        changes.append([noise.gyro_bias(k + 1)[k] - start for k in (90, 360)])
    spread = np.std(np.moveaxis(changes, 1, 0).reshape(2, -1), axis=1)
    per_root_hour = 6.0 * DEGREE_PER_HOUR
    np.testing.assert_allclose(spread, per_root_hour * np.sqrt([9 / 3600, 36 / 3600]), rtol=0.03)
    np.testing.assert_allclose(spread, gyro.bias_growth * np.sqrt([9.0, 36.0]), rtol=0.03)


def test_vector_and_joint_sensors_have_white_noise():
    suite = SensorSuite(
        position=VectorSensor(sigma=1e-3),
        velocity=VectorSensor(sigma=2e-3),
        encoders=JointSensor(sigma=3e-3),
        joint_rates=JointSensor(sigma=4e-3),
    )
    noise = SensorNoise(suite, seed=8)
    errors = [noise.apply(name, np.zeros((COUNT, 3))) for name in suite.present()]
    spread = np.std(errors, axis=1)
    np.testing.assert_allclose(spread, np.outer([1e-3, 2e-3, 3e-3, 4e-3], np.ones(3)), rtol=0.03)
    for samples in errors:
        later_and_beside = [samples[1:, 0] * samples[:-1, 0], samples[:, 0] * samples[:, 1]]
        for products in later_and_beside:
            assert abs(products.mean()) < 4 * samples.var() / np.sqrt(COUNT)
    table = np.hstack(errors)
    off_diagonal = np.corrcoef(table.T) - np.eye(12)
    assert np.abs(off_diagonal).max() < 4.5 / np.sqrt(COUNT)


@pytest.mark.parametrize("bits", [1, 17])
def test_encoders_round_to_their_step(bits):
    suite = SensorSuite(encoders=JointSensor(bits=bits))
    step = 2 * np.pi / 2**bits
    assert suite.encoders.step == pytest.approx(step)
    true = np.random.default_rng(2).uniform(-3 * np.pi, 3 * np.pi, (COUNT, 2))
    value = SensorNoise(suite, 0).apply("encoders", true)
    ticks = (value - value[0]) / step
    np.testing.assert_allclose(ticks, np.round(ticks), atol=1e-8)
    assert len(np.unique(np.round(value[0] / step % 1, 6))) == 2, "each has marks of its own"
    other = SensorNoise(suite, 1).apply("encoders", true[:1])
    assert (np.abs((other - value[:1]) / step % 1) > 1e-6).all(), "as has each seed"
    error = value - true
    assert np.abs(error).max() <= step / 2 * (1 + 1e-6)
    np.testing.assert_allclose(error.std(axis=0), step / np.sqrt(12), rtol=0.03)
    assert suite.sigmas("encoders")[0] == pytest.approx(step / np.sqrt(12), rel=1e-3)


def test_sigmas_say_what_samples_are_off_by(perfect):
    suite = every_sensor(gyro=Gyro(rate=100.0, angle_random_walk=0.07), decimals=4)
    long = Log(
        JOINTS,
        {
            name: Samples(
                np.arange(COUNT), np.resize(samples.value, (COUNT, samples.value.shape[1]))
            )
            for name in SENSORS
            for samples in [getattr(perfect, name)]
        },
    )
    noisy = add_noise(suite, long, seed=4)
    for name in list(SENSORS)[1:]:
        error = getattr(noisy, name).value - getattr(long, name).value
        assert np.sqrt(np.mean(error**2)) == pytest.approx(suite.sigmas(name)[0], rel=0.05)
    assert suite.sigmas("attitude").shape == (3,)
    for name in list(SENSORS)[1:]:
        assert suite.sigmas(name).shape == (1,)


# -- rates and times -----------------------------------------------------------------------------


@pytest.mark.parametrize(("rate", "duration"), [(0.1, 0.3), (0.1, 60.0), (7.0, 1.0), (333.3, 10.0)])
def test_samples_come_at_the_rate_from_zero_to_the_end(rate, duration):
    times = sample_times(rate, duration)
    assert times[0] == 0.0
    assert times[-1] <= duration * (1 + 1e-12)
    assert duration - times[-1] < (1 + 1e-9) / rate
    np.testing.assert_array_equal(times, np.arange(times.size) / rate)


# -- seeds ---------------------------------------------------------------------------------------


def values(measurements) -> np.ndarray:
    return np.concatenate([getattr(measurements, name).value.ravel() for name in SENSORS])


def test_a_seed_reproduces_and_another_differs(perfect):
    one, again, other = (values(add_noise(every_sensor(), perfect, seed)) for seed in (6, 6, 7))
    np.testing.assert_array_equal(one, again)
    start = 0
    for name in SENSORS:
        stop = start + getattr(perfect, name).value.size
        assert not (one[start:stop] == other[start:stop]).any()
        start = stop
