"""Errors of sensors and forces: declared ones are estimated, others named if they matter."""

from copy import deepcopy
from dataclasses import replace

import numpy as np
import pytest
from planar_cases import SUITE as TABLE_SUITE
from planar_cases import TARGET as TABLE_TARGET
from planar_cases import errors as planar_errors
from planar_cases import motion as planar_motion
from planar_cases import planar_craft
from scipy.spatial.transform import Rotation
from scipy.stats import chi2
from sensing_cases import (
    MOMENTUM,
    RPY,
    Sines,
    acting,
    coarse_suite,
    measured,
    nees,
    sigmas,
    small_craft,
)

from cpid_drake import Spacecraft, TotalMomentum, identify
from cpid_drake.logs.log import Log, Samples
from cpid_drake.logs.simulated_noise import SensorNoise, add_noise
from cpid_drake.sensors.sensors import JointSensor

PUSH = np.array([1e-3, -5e-4, 0.0])
HIDDEN = {
    "attitude.delay": ("attitude", "delay_ms", 30.0),
    "gyro.scale": ("gyro", "scale_ppm", 3000.0),
    "encoders.zero": ("encoders", "zero_mrad", 5.0),
}


def suite_with(name, value=None, suite=None):
    """Return sensors with one declared error."""
    result = deepcopy(suite or coarse_suite())
    sensor, key, usual = HIDDEN[name]
    setattr(result[sensor], key, usual if value is None else value)
    return result


@pytest.fixture(scope="module")
def log(craft, skewed_target):
    """Return a function from true sensors to a noisy log of 10 s."""

    def make(true=None, seed=4, motion=101, momentum_W=None):
        true = true or coarse_suite()
        sines = Sines.drawn(4, seed=motion, duration=10.0, size=0.6)
        return add_noise(true, measured(craft, sines, skewed_target, true, momentum_W), seed)

    return make


def changed(log: Log, sensor, function) -> Log:
    """Return a log with other values of a sensor, as a function of time (N,) and value (N, k)."""
    samples = log[sensor]
    return log.updated({sensor: replace(samples, value=function(samples.time, samples.value))})


def pushed(log: Log, times: float = 1.0) -> Log:
    """Return a log with the motion under a steady acceleration in the plane."""
    return changed(log, "position", lambda t, p: p + 0.5 * t[:, None] ** 2 * PUSH * times)


def true_value(suite, seed, name):
    """Return the drawn error of a sensor in the units of its declaration."""
    sensor, _, kind = name.rpartition(".")
    drawn = SensorNoise(suite, seed).constants(sensor, 4)
    return {
        "delay": 1e3 * drawn.delay,
        "scale": 1e6 * np.diag(drawn.scale),
        "zero": 1e3 * drawn.zero,
    }[kind]


class TestDeclared:
    def test_it_is_estimated(self, craft, log, skewed_target):
        """Its interval and those of the target contain the truth, and no check fails."""
        name = "attitude.delay"
        suite = suite_with(name)
        found = identify(craft, log(suite), sensors=suite)
        assert found.passed
        assert (np.abs(found.parameters - skewed_target.to_vector()) < 4 * sigmas(found)).all()
        [effect] = found.effects
        assert effect.name == name
        assert (np.abs(effect.value - true_value(suite, 4, name)) < 4 * effect.sigma).all()
        assert effect.is_learned
        assert (effect.sigma <= effect.prior_sigma).all()

    def test_large_zeros_of_joints_are_linear_about_their_estimates(self, craft, skewed_target):
        """A model that is linear about zero, or about an early estimate, is wrong by many σ."""
        zeros = np.array([0.012, -0.008, 0.01, 0.0])  # the last one turns the capture frame
        suite = coarse_suite(encoders=JointSensor(20.0, 1e-5, zero_mrad=10.0))
        motion = Sines.drawn(4, seed=101, duration=8.0, size=0.6)
        exact = measured(craft, motion, skewed_target, suite, MOMENTUM)
        encoders = Samples(exact.encoders.time, exact.encoders.value + zeros)
        options = {"sensors": suite, "momentum": TotalMomentum.unknown()}
        found = identify(craft, exact.updated({"encoders": encoders}), **options)
        assert found.failures == ()
        assert nees(found, skewed_target) < 0.02

    def test_errors_much_larger_than_declared_fail_a_check(self, craft, skewed_target):
        def sensors(factor):
            usual = coarse_suite()
            return coarse_suite(
                attitude=replace(usual.attitude, mounting_arcsec=200.0 * factor),
                gyro=replace(usual.gyro, scale_ppm=500.0 * factor),
                encoders=replace(usual.encoders, zero_mrad=0.5 * factor),
            )

        motion, doubt = Sines.drawn(4, seed=101, duration=6.0, size=0.6), "their declared sigma"
        ideal = measured(craft, motion, skewed_target, sensors(1.0))
        samples = add_noise(sensors(6.0), ideal, 2)
        found = identify(craft, samples, sensors=sensors(1.0))
        (text,) = [failure for failure in found.failures if doubt in failure]
        assert 3.0 < float(text.split("about ")[1].split(" times")[0]) < 12.0
        told = identify(craft, samples, sensors=sensors(6.0))
        assert not any(doubt in failure for failure in told.failures)


class TestUndeclared:
    def test_a_clean_log_shows_none(self, craft, log, suite, skewed_target):
        found = identify(craft, log(), sensors=suite)
        assert found.passed
        assert not any("do not declare" in warning for warning in found.warnings)
        assert (np.abs(found.parameters - skewed_target.to_vector()) < 4 * sigmas(found)).all()

    @pytest.mark.slow
    @pytest.mark.parametrize("name", ["gyro.scale", "encoders.zero"])
    def test_a_hidden_one_is_named_with_its_value(self, craft, log, suite, skewed_target, name):
        """The result includes it: the target is right, and a warning says what to declare.

        The zero of the last joint turns the target as a whole, and no sample shows it: each
        interval is right, but the set of possible targets is bent, and no ellipsoid.
        """
        found = identify(craft, log(suite_with(name)), sensors=suite)
        sensor, key, _ = HIDDEN[name]
        [effect] = acting(found)
        assert effect.name == name
        seen = effect.sigma < 0.5 * effect.prior_sigma
        error = effect.value - true_value(suite_with(name), 4, name)
        assert (np.abs(error) < 4 * effect.sigma)[seen].all()
        [said] = [text for text in found.warnings if "do not declare" in text]
        assert f"{sensor}: {{{key}: " in said
        assert found.failures == ()
        assert (np.abs(found.parameters - skewed_target.to_vector()) < 4 * sigmas(found)).all()
        assert name == "encoders.zero" or nees(found, skewed_target) < chi2.isf(1e-4, 10)

    @pytest.mark.slow
    def test_intervals_include_one_that_is_too_small_to_be_named(
        self, craft, log, suite, skewed_target
    ):
        """Between what is not seen and what is named, an answer must not be confidently wrong."""
        found = identify(craft, log(suite_with("gyro.scale", 14.0)), sensors=suite)
        assert found.passed
        assert not acting(found)
        assert any("gyro.scale (probability" in each for each in found.warnings)
        clean = identify(craft, log(), sensors=suite)
        scale = sigmas(clean)
        wider = (found.covariance - clean.covariance) / scale / scale[:, None]
        assert np.linalg.eigvalsh(wider).max() > 2.0
        assert nees(found, skewed_target) < chi2.isf(1e-3, 10)

    @pytest.mark.slow
    def test_one_that_the_first_two_thirds_do_not_show_is_a_failed_check(
        self, craft, log, suite, skewed_target
    ):
        """What the whole log names, samples that did not choose it cannot confirm."""
        found = identify(craft, log(suite_with("gyro.scale", 28.0)), sensors=suite)
        assert [effect.name for effect in acting(found)] == ["gyro.scale"]
        assert "the cause is not known" in found.failures[0]
        assert not any("the result includes it" in text for text in found.warnings)
        assert nees(found, skewed_target) < chi2.isf(1e-3, 10)


@pytest.mark.slow
class TestForces:
    def test_a_wheel_that_the_model_takes_for_fixed_is_named(self, tmp_path, suite, skewed_target):
        """Spun up before the log: 3 to 10 σ off without it, and nothing failed."""
        true, h = small_craft(tmp_path, wheels=True), 0.01
        text = (tmp_path / "craft.urdf").read_text().replace("continuous", "fixed")
        (tmp_path / "fixed.urdf").write_text(text)
        craft = Spacecraft(tmp_path / "fixed.urdf", base="base", capture_frame="hand")
        arm, names = Sines.drawn(4, seed=101, duration=8.0, size=0.6), true.joint_names
        is_arm = np.isin(names, craft.joint_names)
        rate = np.where(np.array(names) == "spin_x", h / 0.04, 0.0)

        class Motion:
            duration = arm.duration

            def evaluate(self, time):
                found = np.zeros((*np.shape(time), 3, len(names)))
                found[..., 0, :], found[..., 1, :] = np.multiply.outer(time, rate), rate
                found[..., is_arm] = arm.evaluate(time)
                return found

            def breaks(self):
                return arm.breaks()

        h_B = h * Rotation.from_euler("xyz", RPY).as_matrix()[:, 0]
        momentum_W = np.concatenate([h_B, np.zeros(3)])
        samples = measured(true, Motion(), skewed_target, suite, momentum_W)
        encoders = samples.encoders
        encoders = Samples(encoders.time, encoders.value[:, is_arm])
        samples = Log(craft.joint_names, {**samples.samples, "encoders": encoders})
        found = identify(craft, add_noise(suite, samples, 1), sensors=suite)
        [effect] = acting(found)
        assert effect.name == "wheel"
        assert np.all(np.abs(effect.value - h_B) < 4 * effect.sigma)
        assert nees(found, skewed_target) < chi2.isf(1e-3, 10)

    def test_one_is_named_with_its_log(self, craft, log, suite, skewed_target):
        logs = {"a": log(seed=10), "b": log(seed=10, motion=102)}
        clean = identify(craft, logs, sensors=suite)
        assert clean.passed
        assert acting(clean) == []
        found = identify(craft, {**logs, "b": pushed(logs["b"])}, sensors=suite)
        [effect] = acting(found)
        assert (effect.name, effect.log) == ("acceleration", "b")
        assert (np.abs(effect.value - PUSH) < 4 * effect.sigma).all()
        assert effect.describe().endswith("during b")
        assert effect.declaration == "disturbances: {acceleration: 0.001}"
        assert any("do not declare: an external acceleration" in text for text in found.warnings)
        assert found.failures == ()
        assert nees(found, skewed_target) < chi2.isf(1e-3, 10)


@pytest.mark.slow
@pytest.mark.parametrize("delay", [0.0, 30.0])
def test_an_error_on_a_table_whose_normal_is_no_axis_of_c_is_named(tmp_path, delay):
    """A delay so large that nothing explains some blocks without it."""
    table = planar_craft(tmp_path, grip_rpy="0.4 -0.3 0.7")
    true = suite_with("attitude.delay", delay, TABLE_SUITE)
    exact = measured(table.on_table(), planar_motion(), TABLE_TARGET, true)
    found = identify(table, add_noise(true, exact, 5), sensors=TABLE_SUITE, planar=True)
    assert found.failures == ()
    if not delay:
        assert acting(found) == []
        return
    [effect] = acting(found)
    assert effect.name == "attitude.delay"
    assert abs(effect.value[0] - true_value(true, 5, "attitude.delay")) < 4 * effect.sigma[0]
    assert any("the result includes it" in text for text in found.warnings)
    assert abs(planar_errors(found)[0]) < 4  # the mass
