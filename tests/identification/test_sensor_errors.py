"""Errors of sensors, forces and bodies are estimated: with their stated σ, or a plausible one."""

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
    coarse_suite,
    measured,
    nees,
    sigmas,
    small_craft,
    true_psi,
)

from cpid_drake import Spacecraft, TotalMomentum, identify
from cpid_drake.dynamics.propagation import Wrench, propagate
from cpid_drake.estimation.cramer_rao import cramer_rao_bound
from cpid_drake.logs.log import Log, Samples, ideal_log
from cpid_drake.logs.simulated_noise import SensorNoise, add_noise
from cpid_drake.sensors.disturbances import Disturbances
from cpid_drake.sensors.sensors import JointSensor

PUSH = np.array([1e-3, -5e-4, 0.0])
HIDDEN = {
    "attitude.delay": ("attitude", "delay_ms", 30.0),
    "gyro.scale": ("gyro", "scale_ppm", 3000.0),
    "encoders.zero": ("encoders", "zero_mrad", 2.0),
    "gyro.clock_drift": ("gyro", "clock_drift_ppm", 150.0),
}


def silent(suite):
    """Return sensors of which only the noise is stated."""
    return replace(suite, unstated=None)


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
        "clock_drift": 1e6 * drawn.clock_drift,
    }[kind]


class TestDeclared:
    @pytest.mark.parametrize("name", ["attitude.delay", "gyro.clock_drift"])
    def test_it_is_estimated(self, craft, log, skewed_target, name):
        """Its interval and those of the target contain the truth, and no check fails."""
        suite = suite_with(name)
        found = identify(craft, log(suite), sensors=suite)
        assert found.passed
        assert (np.abs(found.parameters - skewed_target.to_vector()) < 4 * sigmas(found)).all()
        [effect] = [each for each in found.effects if each.name != "gyro.bias"]
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

        motion, doubt = Sines.drawn(4, seed=101, duration=6.0, size=0.6), "as large as its sigma"
        ideal = measured(craft, motion, skewed_target, sensors(1.0))
        samples = add_noise(sensors(6.0), ideal, 2)
        found = identify(craft, samples, sensors=sensors(1.0))
        (text,) = [failure for failure in found.failures if doubt in failure]
        assert 4.0 < float(text.split("is ")[1].split(" times")[0]) < 24.0
        told = identify(craft, samples, sensors=sensors(6.0))
        assert not any(doubt in failure for failure in told.failures)


class TestNotStated:
    def test_no_error_is_exactly_zero(self, craft, log, suite, skewed_target):
        """A clean log passes, is right, and says what its uncertainty comes from."""
        found, exact = (identify(craft, log(), sensors=each) for each in (silent(suite), suite))
        assert found.passed
        assert nees(found, skewed_target) < chi2.isf(1e-3, 10)
        assert (sigmas(found) > sigmas(exact)).all()
        names = {effect.name for effect in found.effects}
        assert names >= {"gyro.scale", "encoders.zero", "torque", "torque_B", "compliance", "wheel"}
        assert {effect.name for effect in exact.effects} == {"gyro.bias"}  # it is stated
        assert exact.given == ("spacecraft model",)
        assert not found.given

    def test_silence_about_errors_does_not_look_like_momentum(self, found):
        """Torques that walk hide a small momentum, but do not make it likely."""
        assert found.momentum == "zero"
        assert not any("momentum" in text for text in found.warnings)

    @pytest.mark.slow
    @pytest.mark.parametrize("name", [*HIDDEN])
    def test_a_hidden_one_is_in_the_intervals(self, craft, log, suite, skewed_target, name):
        found = identify(craft, log(suite_with(name)), sensors=silent(suite))
        [effect] = [each for each in found.effects if each.name == name]
        error = effect.value - true_value(suite_with(name), 4, name)
        assert (np.abs(error) < 4 * effect.sigma).all()
        assert found.failures == ()
        assert (np.abs(found.parameters - skewed_target.to_vector()) < 4 * sigmas(found)).all()
        assert nees(found, skewed_target) < chi2.isf(1e-3, 10)

    @pytest.mark.slow
    def test_ten_clean_logs_have_honest_intervals(self, craft, log, suite, skewed_target):
        """Plausible errors that are not there make intervals wider than they need be."""
        found = [
            identify(craft, log(seed=seed, motion=100 + seed), sensors=silent(suite))
            for seed in range(10)
        ]
        assert all(each.passed for each in found)
        errors = [nees(each, skewed_target) for each in found]
        assert sum(errors) < chi2.isf(1e-3, 100)
        assert max(errors) < chi2.isf(1e-3, 10)

    def test_one_that_is_stated_to_be_zero_is_not_estimated(self, craft, log, suite):
        sensors = replace(silent(suite), gyro=replace(suite.gyro, scale_ppm=0.0))
        names = {effect.name for effect in identify(craft, log(), sensors=sensors).effects}
        assert "gyro.scale" not in names
        assert "gyro.misalignment" in names


@pytest.fixture(scope="module")
def found(craft, log, suite):
    """Return a result of a clean log, of which only the noise is stated."""
    return identify(craft, log(), sensors=silent(suite))


class TestBudget:
    """Shares of the variance, against identifications in which an error is exact."""

    def test_it_is_sorted_by_its_largest_shares(self, found):
        first, *rows = found.budget
        assert first.name == "all errors together"
        largest = [np.nanmax(row.shares) for row in rows]
        assert largest == sorted(largest, reverse=True)
        assert (first.shares > 0.9).all()

    def test_the_variance_falls_by_the_share_of_all_axes(self, craft, log, suite, found):
        """Of the lever arm's three entries, each alone is at most what all three together are."""
        arm = replace(suite.position, lever_arm_mm=0.0)
        exact = identify(craft, log(), sensors=replace(silent(suite), position=arm))
        gone = 1 - np.diag(exact.covariance) / np.diag(found.covariance)
        rows = [row for row in found.budget if row.name.startswith("lever arm of position")]
        for row in rows:
            assert (row.shares < gone + 0.02).all()

    def test_half_of_a_share_goes_with_the_sigma_that_matters(self, craft, log, suite, found):
        """The axes of the lever arm share little with each other here."""
        rows = [row for row in found.budget if row.name.startswith("lever arm of position")]
        row = max(rows, key=lambda row: row.shares[0])
        arm = replace(suite.position, lever_arm_mm=row.matters)
        told = identify(craft, log(), sensors=replace(silent(suite), position=arm))
        gone = 1 - told.covariance[0, 0] / found.covariance[0, 0]
        most = sum(row.shares[0] for row in rows)
        assert row.shares[0] / 2 - 0.01 < gone < most / 2 + 0.1

    def test_walks_cost_what_a_steady_force_does_not(self, craft, log, suite, found):
        forces = Disturbances(acceleration=0.0, torque=0.0, acceleration_B=0.0, torque_B=0.0)
        calm = replace(silent(suite), disturbances=forces)
        gone = 1 - np.diag(identify(craft, log(), sensors=calm).covariance) / np.diag(
            found.covariance
        )
        parts = [row.shares for row in found.budget if row.name.startswith("random walk")]
        assert (np.max(parts, axis=0) < gone + 0.05).all()


@pytest.mark.parametrize("kind", ["clock_drift_ppm", "joint_compliance_urad"])
def test_the_bound_of_a_motion_has_every_error(craft, skewed_target, suite, kind):
    """It is wider than that of a spacecraft without the error."""
    motion = Sines.drawn(4, seed=101, duration=6.0, size=0.6)
    exact = measured(craft, motion, skewed_target, suite)
    without = silent(suite)
    if kind == "joint_compliance_urad":
        without = replace(without, disturbances=Disturbances(**{kind: 0.0}))
    for name, errors in without.present().items() if kind == "clock_drift_ppm" else ():
        without = replace(without, **{name: replace(errors, **{kind: 0.0})})
    psi = true_psi(craft, skewed_target)
    all_errors, fewer = (
        np.sqrt(np.diag(cramer_rao_bound(craft.tree, psi, exact, each)))
        for each in (silent(suite), without)
    )
    assert (all_errors > fewer * (1 - 1e-6)).all()
    assert (all_errors > fewer * 1.0001).any()


@pytest.mark.slow
class TestForces:
    def test_a_wheel_that_the_model_has_not_is_estimated(self, tmp_path, suite, skewed_target):
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
        found = identify(craft, add_noise(suite, samples, 1), sensors=silent(suite))
        [effect] = [each for each in found.effects if each.name == "wheel"]
        assert np.all(np.abs(effect.value - h_B) < 4 * effect.sigma)
        assert nees(found, skewed_target) < chi2.isf(1e-3, 10)

    def test_each_log_has_its_own(self, craft, log, suite, skewed_target):
        logs = {"a": log(seed=10), "b": log(seed=10, motion=102)}
        found = identify(craft, {**logs, "b": pushed(logs["b"])}, sensors=silent(suite))
        one, other = (each for each in found.effects if each.name == "acceleration")
        assert (one.log, other.log) == ("a", "b")
        assert (np.abs(one.value) < 4 * one.sigma).all()
        assert (np.abs(other.value - PUSH) < 4 * other.sigma).all()
        assert other.describe().endswith("during b")
        assert found.failures == ()
        assert nees(found, skewed_target) < chi2.isf(1e-3, 10)

    def test_a_leak_that_turns_with_the_base_is_in_the_intervals(self, craft, suite, skewed_target):
        """A force of 20 mN at a point of the base: many σ of a target fitted without it."""
        motion = Sines.drawn(4, seed=101, duration=8.0, size=0.6)
        force_B, point = np.array([0.01, -0.015, 0.008]), np.array([0.4, 0.3, -0.2])
        leak = Wrench(constant_B=np.concatenate([np.cross(point, force_B), force_B]))
        phi = skewed_target.to_standard_vector()

        def at(times):
            grid = np.union1d(0.0, times)
            base = propagate(craft.tree, motion, phi, grid, wrench=lambda time: leak, edges=grid)
            whole = base.to_motion(craft.joint_names, grid, motion)
            return whole.select(np.flatnonzero(np.isin(grid, times)))

        exact = ideal_log(suite, craft.joint_names, at, motion.duration)
        log = add_noise(suite, exact, 1)
        assert nees(identify(craft, log, sensors=suite), skewed_target) > 100
        found = identify(craft, log, sensors=silent(suite))
        assert found.failures == ()
        assert nees(found, skewed_target) < chi2.isf(1e-3, 10)


@pytest.mark.slow
@pytest.mark.parametrize("delay", [0.0, 30.0])
def test_an_error_on_a_table_whose_normal_is_no_axis_of_c_is_estimated(tmp_path, delay):
    """A delay so large that nothing explains some blocks without it."""
    table = planar_craft(tmp_path, grip_rpy="0.4 -0.3 0.7")
    true = suite_with("attitude.delay", delay, TABLE_SUITE)
    exact = measured(table.on_table(), planar_motion(), TABLE_TARGET, true)
    found = identify(table, add_noise(true, exact, 5), sensors=silent(TABLE_SUITE), planar=True)
    assert found.failures == ()
    [effect] = [each for each in found.effects if each.name == "attitude.delay"]
    assert abs(effect.value[0] - true_value(true, 5, "attitude.delay")) < 4 * effect.sigma[0]
    assert abs(planar_errors(found)[0]) < 4  # the mass


def test_a_sensor_of_the_log_that_the_suite_lacks_is_said_not_to_be_used(craft, log):
    said = "the angular velocity of the log is not used: the sensors' file has no 'gyro:'"
    measured_log, suite = log(), coarse_suite()
    lacking = replace(suite, gyro=None)
    found = identify(craft, measured_log, sensors=lacking)
    assert sum(text.startswith(said) for text in found.warnings) == 1
    for sensors, gyro in ((suite, slice(None)), (lacking, slice(0))):
        given = measured_log.updated({"gyro": measured_log.gyro.where(gyro)})
        warnings = identify(craft, given, sensors=sensors).warnings
        assert not any("of the log is not used" in text for text in warnings)


def test_a_target_that_the_base_holds_is_identified_with_a_warning(
    tmp_path, craft, log, skewed_target
):
    """The base's reaction to its own joints shows it."""
    small_craft(tmp_path)
    held = Spacecraft(tmp_path / "craft.urdf", base="base", capture_frame="base")
    sines, suite = Sines.drawn(4, seed=101, duration=10.0, size=0.6), coarse_suite()
    noisy = add_noise(suite, measured(held, sines, skewed_target, suite), 4)
    found = identify(held, noisy, sensors=suite)
    assert any("the capture frame is fixed to the base" in text for text in found.warnings)
    assert found["m"].is_identifiable
    assert abs(found["m"].value - skewed_target.mass) < 4 * np.sqrt(found.covariance[0, 0])
    usual = identify(craft, log(), sensors=suite).warnings
    assert not any("is fixed to the base" in text for text in usual)
