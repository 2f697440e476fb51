"""From a log to the target: exact logs give exact answers, poor ones say what is wrong."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from sensing_cases import (
    MOMENTUM,
    Sines,
    coarse_suite,
    log_of,
    measured,
    momentum_about_com,
    nees,
    small_craft,
    true_telemetry,
)

from cpid_drake import InputError, identify
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.logs.log import Log, Samples
from cpid_drake.logs.simulated_noise import add_noise
from cpid_drake.sensors.sensors import JointSensor

DURATION = 8.0


@pytest.fixture(scope="module")
def motion():
    return Sines.drawn(4, seed=7, duration=DURATION, size=0.6)


@pytest.fixture(scope="module")
def true_motion(craft, motion, skewed_target):
    times = np.arange(0.0, DURATION, 0.01)
    return true_telemetry(craft.tree, craft.joint_names, motion, skewed_target, times)


@pytest.fixture(scope="module")
def exact(true_motion):
    return log_of(true_motion)


def without(log: Log, *names: str) -> Log:
    nothing = np.empty(0, dtype=int)
    return log.updated({name: log[name].where(nothing) for name in names})


def changed(log: Log, **functions) -> Log:
    parts = {}
    for name, function in functions.items():
        samples = getattr(log, name)
        parts[name] = Samples(samples.time, function(samples.value))
    return log.updated(parts)


def error_over_scale(found, target) -> float:
    scale = np.array([target.mass, *3 * [0.5], *6 * [np.trace(target.I_TTcm_C)]])
    return np.abs((found.parameters - target.to_vector()) / scale).max()


class TestExactLogs:
    @pytest.mark.parametrize("rows", ["standard", "relative", "eq18"])
    def test_every_row_family_finds_the_target(self, craft, exact, skewed_target, rows):
        found = identify(craft, exact, rows=rows)
        assert found.rows == rows
        assert found.sensors is None
        assert found.warnings == ()
        assert error_over_scale(found, skewed_target) < 1e-9

    def test_order_of_joints_does_not_matter(self, craft, exact):
        order = [2, 0, 3, 1]
        names = tuple(exact.joint_names[k] for k in order)
        by_order = {
            "encoders": lambda q: q[:, order],
            "joint_rates": lambda q: q[:, order],
        }
        shuffled = replace(changed(exact, **by_order), joint_names=names)
        expected = identify(craft, exact).parameters
        found = identify(craft, shuffled).parameters
        np.testing.assert_array_equal(found, expected)

    def test_gyro_and_joints_alone_suffice_for_relative_rows(self, craft, exact, skewed_target):
        bare = without(exact, "attitude", "position", "velocity")
        found = identify(craft, bare)
        assert found.rows == "relative"
        assert error_over_scale(found, skewed_target) < 1e-9

    @pytest.mark.parametrize("rows", ["standard", "relative"])
    def test_rates_that_are_not_logged_come_from_positions(self, craft, exact, skewed_target, rows):
        log = without(exact, "gyro", "velocity", "joint_rates")
        found = identify(craft, log, rows=rows)
        assert "estimated from the log" in found.warnings[0]
        assert error_over_scale(found, skewed_target) < 1e-5

    def test_momentum_that_is_not_zero_is_seen_and_can_be_estimated(
        self, craft, motion, skewed_target
    ):
        times = np.arange(0.0, DURATION, 0.02)
        log = log_of(
            true_telemetry(craft.tree, craft.joint_names, motion, skewed_target, times, MOMENTUM)
        )
        assumed_zero = identify(craft, log, momentum=TotalMomentum.zero())
        assert "--momentum unknown" in assumed_zero.failures[0]
        assert not assumed_zero.passed
        assert assumed_zero.momentum == "unknown"  # the answer does not rest on what is wrong
        assert error_over_scale(assumed_zero, skewed_target) < 1e-9
        estimated = identify(craft, log, momentum=TotalMomentum.unknown())
        assert estimated.warnings == estimated.failures == ()
        assert error_over_scale(estimated, skewed_target) < 1e-9
        tested = identify(craft, log)
        assert tested.momentum == "unknown"
        assert tested.failures == ()
        assert "was estimated" in tested.warnings[0]
        assert error_over_scale(tested, skewed_target) < 1e-9


class TestMeasuredLogs:
    """All quantities at common times, with noise; nothing says what the sensors are like."""

    @pytest.fixture(scope="class")
    @classmethod
    def noisy(cls, exact):
        rng = np.random.default_rng(5)
        sizes = {"gyro": 1e-4, "position": 1e-3, "velocity": 1e-3}
        sizes |= {"encoders": 1e-4, "joint_rates": 1e-3}
        log = changed(
            exact, **{n: lambda x, s=s: x + s * rng.normal(size=x.shape) for n, s in sizes.items()}
        )
        turned = Rotation.from_quat(exact.attitude.value, scalar_first=True)
        turned *= Rotation.from_rotvec(1e-4 * rng.normal(size=(len(exact.attitude), 3)))
        attitude = replace(exact.attitude, value=turned.as_quat(scalar_first=True))
        return log.updated({"attitude": attitude})

    @pytest.mark.parametrize(
        "error",
        ["none", *(pytest.param(e, marks=pytest.mark.slow) for e in ("gyro scale", "zeros"))],
    )
    def test_they_are_fitted_and_hidden_errors_are_within_the_intervals(
        self, craft, noisy, skewed_target, error
    ):
        """With rows, a scale of 0.1 % was 3 to 16 σ at exit 0, and a zero of 5 mrad up to 6 σ."""
        log = noisy
        if error == "gyro scale":
            log = changed(log, gyro=lambda w: w * [1.001, 0.999, 1.001])
        if error == "zeros":
            log = changed(log, encoders=lambda q: q + 5e-3 * np.array([1, 0, -1, 1]))
        found = identify(craft, log)
        assert found.estimator == "trajectory_fit"
        off = (found.parameters - skewed_target.to_vector()) / np.sqrt(np.diag(found.covariance))
        assert found.failures or np.abs(off).max() < 3.5
        if error == "none":
            assert not found.failures


class TestNoisyLogs:
    @pytest.mark.parametrize(
        "estimator", ["trajectory_fit", pytest.param("recursive_fit", marks=pytest.mark.slow)]
    )
    def test_noise_can_be_estimated_along(self, craft, motion, skewed_target, estimator):
        suite = coarse_suite()
        suite.gyro.rate = suite.encoders.rate = 50.0
        log = add_noise(suite, measured(craft, motion, skewed_target, suite), seed=3)
        found = identify(craft, log, estimator=estimator)
        assert "estimated from the log" in found.warnings[0]
        error = found.parameters - skewed_target.to_vector()
        distance = error @ np.linalg.solve(found.covariance, error)
        assert distance < 30  # χ² of ten, 0.1 %

    def test_a_late_sensor_does_not_bend_the_answer_without_options(
        self, craft, motion, skewed_target
    ):
        """Rows of smoothed samples know no errors of sensors: χ² of ten is 97."""
        suite = coarse_suite()
        suite.gyro.rate = suite.encoders.rate = 50.0
        log = add_noise(suite, measured(craft, motion, skewed_target, suite), seed=3)
        late = Samples(log.attitude.time + 0.02, log.attitude.value)
        found = identify(craft, log.updated({"attitude": late}))
        assert found.passed
        [late] = [effect for effect in found.effects if effect.name == "attitude.delay"]
        assert abs(late.value[0] - 20.0) < 4 * late.sigma[0]
        assert nees(found, skewed_target) < 30  # χ² of ten, 0.1 %


@pytest.mark.slow
def test_slow_motion_determines_the_same_target(craft, exact, skewed_target):
    slower, rates = 3000.0, ("gyro", "velocity", "joint_rates")
    parts = {
        name: Samples(s.time * slower, s.value / slower if name in rates else s.value)
        for name, s in exact.items()
    }
    assert np.abs(parts["velocity"].value).max() < 1e-3
    found = identify(craft, exact.updated(parts))
    assert found.passed
    assert error_over_scale(found, skewed_target) < 1e-6


class TestRotors:
    """Reaction wheels tell their speed, not their angle."""

    @pytest.fixture(scope="class", autouse=True)
    @classmethod
    def make(cls, tmp_path_factory, skewed_target):
        cls.craft = small_craft(tmp_path_factory.mktemp("wheels"), wheels=True)
        motion = Sines.drawn(6, seed=11, duration=DURATION, size=0.6)
        names, times = cls.craft.joint_names, np.arange(0.0, DURATION, 0.02)
        cls.log = log_of(true_telemetry(cls.craft.tree, names, motion, skewed_target, times))

    def without_position(self, joint):
        k = self.craft.joint_names.index(joint)
        value = self.log.encoders.value.copy()
        value[:, k] = np.nan
        return self.log.updated({"encoders": Samples(self.log.encoders.time, value)})

    def test_a_wheel_whose_angle_is_not_logged_is_no_obstacle(self, skewed_target):
        assert self.craft.tree.is_rotor(self.craft.joint_names.index("spin_x"))
        found = identify(self.craft, self.without_position("spin_x"))
        assert error_over_scale(found, skewed_target) < 1e-9

    def test_the_rates_of_such_a_wheel_are_those_of_its_log(self, skewed_target):
        """The trajectory fit smooths angles and rates together: they must belong together."""
        suite = coarse_suite(joint_rates=JointSensor(50.0, 1e-6))
        log = without(self.without_position("spin_x"), "velocity")  # the suite has none
        found = identify(self.craft, log, sensors=suite)
        assert found.warnings == ()
        assert error_over_scale(found, skewed_target) < 1e-6

    @pytest.mark.parametrize("joint", ["roll", "slide"])
    def test_other_joints_must_be_logged(self, joint):
        with pytest.raises(
            InputError, match=f"no column 'q:{joint}'; positions are optional for rotors only"
        ):
            identify(self.craft, self.without_position(joint))

    @pytest.mark.parametrize("rates", ["none", "not finite"])
    def test_a_wheel_needs_positions_or_rates(self, rates):
        log, k = self.without_position("spin_x"), self.craft.joint_names.index("spin_x")
        if rates == "none":
            log = without(log, "joint_rates")
        else:
            log = changed(log, joint_rates=lambda value: np.where(np.arange(6) == k, np.nan, value))
        with pytest.raises(InputError, match="neither a column 'q:spin_x' nor rates 'qd:spin_x'"):
            identify(self.craft, log)


class TestWhatIsMissing:
    @pytest.mark.parametrize(
        ("gone", "options", "phrase"),
        [
            (
                ["position", "velocity"],
                {"rows": "standard"},
                r"needs velocity \(vx,vy,vz\) or position \(x,y,z\), which the log has no",
            ),
            (
                ["attitude", "gyro"],
                {"rows": "relative"},
                r"needs attitude \(qw,qx,qy,qz\) or angular velocity",
            ),
            (
                [],
                {"estimator": "recursive_fit", "sensors": coarse_suite(encoders=None)},
                r"needs joint positions .*, which is not one of the given sensors",
            ),
        ],
    )
    def test_it_is_named(self, craft, exact, gone, options, phrase):
        with pytest.raises(InputError, match=phrase):
            identify(craft, without(exact, *gone), **options)

    def test_a_known_momentum_needs_no_position(self, craft, motion, skewed_target):
        times = np.arange(0.0, DURATION, 0.05)
        tumbling = true_telemetry(
            craft.tree, craft.joint_names, motion, skewed_target, times, MOMENTUM
        )
        known = momentum_about_com(craft, motion, skewed_target, MOMENTUM)
        log = without(log_of(tumbling), "position")
        for rows in ("standard", "eq18"):
            found = identify(craft, log, rows=rows, momentum=known)
            assert error_over_scale(found, skewed_target) < 1e-9

    def test_joints_that_the_spacecraft_does_not_have_are_left_out_and_named(self, craft, exact):
        names = ("finger", *exact.joint_names)
        added = {
            name: Samples(exact[name].time, np.insert(exact[name].value, 0, 7.0, axis=1))
            for name in ("encoders", "joint_rates")
        }
        found = identify(craft, Log(names, {**exact.samples, **added}))
        expected = identify(craft, exact)
        np.testing.assert_array_equal(found.parameters, expected.parameters)
        assert found.warnings[0] == "left out joints that the spacecraft does not have: finger"
        assert found.warnings[1:] == expected.warnings

    @pytest.mark.parametrize(
        ("options", "phrase"),
        [
            ({"estimator": "magic"}, "no estimator 'magic'; choose from least_squares"),
            ({"rows": "magic"}, "no row family 'magic'"),
            (
                {"rows": "eq18", "momentum": TotalMomentum.unknown()},
                "cannot estimate an unknown momentum",
            ),
            ({"estimator": "trajectory_fit", "rows": "eq18"}, "rows are for least_squares"),
            ({"estimator": "eq18", "rows": "standard"}, "'eq18' is least squares on rows 'eq18'"),
        ],
    )
    def test_options_that_cannot_be(self, craft, exact, options, phrase):
        with pytest.raises(InputError, match=phrase):
            identify(craft, exact, **options)
