"""What a channel holds that its sensor did not measure is made good or left out, and told."""

import re
import sys
from io import BytesIO, TextIOWrapper

import numpy as np
import pytest
from flyer_cases import JOINT, MASS, RATE, columns, csv_of, flyer, write
from sensing_cases import Sines, coarse_suite, measured, small_craft

from cpid_drake import InputError, from_columns, identify
from cpid_drake.commands.main import main
from cpid_drake.identification.checked_log import check_log
from cpid_drake.logs.channels import look_at
from cpid_drake.logs.log import Samples
from cpid_drake.sensors.sensors import JointSensor

CRAFT = ("--spacecraft", "free_flyer_payload")


def wrapped(angle):
    return (angle + np.pi) % (2 * np.pi) - np.pi


def checked(given):
    return check_log(flyer(), from_columns(given))


def channel(log, name):
    [found] = [each for each in log.channels if each.name == name]
    return found


class TestWrappedJoints:
    def test_a_wrapped_joint_is_the_same_as_the_unwrapped_one(self):
        plain, other = columns(), columns()
        other[JOINT] = wrapped(other[JOINT])
        assert np.abs(np.diff(other[JOINT])).max() > 6
        log = checked(other)
        expected = checked(plain).measurements.encoders.value
        turns = (log.measurements.encoders.value - expected) / (2 * np.pi)
        np.testing.assert_allclose(turns, turns[:1].round() + 0 * turns, atol=1e-12)
        assert channel(log, "encoders").notes == (
            "wrapped by whole turns, unwrapped: arm_joint1 (3 jumps)",
        )
        assert log.failures == ()

    def test_limits_hold_up_to_whole_turns(self):
        """A joint of -3.1 to 3.1 rad at rest near -2.8 rad, logged as 3.5 rad."""
        given = columns()
        given[JOINT] = 3.5 + 0.1 * np.sin(given["time"])
        assert not any("limits" in warning for warning in checked(given).warnings)
        given[JOINT] = 3.1 + 0.3 * np.sin(given["time"])
        assert any("beyond the model's limits" in warning for warning in checked(given).warnings)

    def test_a_sliding_joint_is_not_wrapped(self, craft, skewed_target):
        """One that moves by 6.28 m within a sample is damaged, not turned."""
        motion = Sines.drawn(len(craft.joint_names), 3, 6.0, 0.5)
        log = measured(craft, motion, skewed_target, coarse_suite())
        k = craft.joint_names.index("slide")
        log.encoders.value[50:, k] += 2 * np.pi
        seen = look_at(log, craft)
        np.testing.assert_array_equal(seen.log.encoders.value, log.encoders.value)

    @pytest.fixture
    def spun(self, tmp_path, skewed_target):
        """Return a function: a log in which a wheel turns at a speed, modulo 2π, and its truth."""
        craft = small_craft(tmp_path, wheels=True)
        motion = Sines.drawn(len(craft.joint_names), 3, 6.0, 0.5)
        k = craft.joint_names.index("spin_x")

        def make(speed):
            suite = coarse_suite(joint_rates=JointSensor(50.0))
            log = measured(craft, motion, skewed_target, suite)
            true = log.encoders.value[:, k] + speed * log.encoders.time
            log.encoders.value[:, k] = wrapped(true)
            log.joint_rates.value[:, k] += speed
            return craft, log, k, true

        return make

    def test_a_wheel_that_turns_often_between_samples_follows_its_rates(self, spun):
        craft, log, k, true = spun(700.0)
        assert np.median(np.diff(true)) > 2 * np.pi
        seen = look_at(log, craft)
        new = seen.log.encoders.value[:, k]
        np.testing.assert_allclose(new - new[0], true - true[0], atol=1e-9)

    def test_a_wheel_that_is_fast_and_has_no_rates_is_refused(self, spun):
        craft, log, _, true = spun(50.0)
        assert 2 < np.median(np.diff(true)) < np.pi
        log = log.updated({"joint_rates": log.joint_rates.where(slice(0))})
        [error] = look_at(log, craft).errors
        assert "q:spin_x turns by" in error
        assert "give its rates, qd:spin_x" in error


ALL = ("attitude", "gyro", "position", "velocity", "encoders", "joint_rates")


class TestWhatADriverDoesNotFill:
    @pytest.mark.parametrize(
        ("prefix", "name", "other"),
        [
            ("qd:", "joint_rates", "joint positions with joint rates (joint rates left out)"),
            ("bw", "gyro", "attitude with angular velocity (angular velocity left out)"),
            ("v", "velocity", "position with velocity (velocity left out)"),
            ("q?", "attitude", "attitude with angular velocity (attitude left out)"),
            ("?", "position", "position with velocity (position left out)"),
        ],
    )
    def test_a_constant_channel_is_left_out_and_named(self, prefix, name, other):
        """Rates are zero, as of an Odometry with an empty twist; poses are those of the origin."""
        given = columns(*ALL)
        mine = {"q?": ["qw", "qx", "qy", "qz"], "?": ["x", "y", "z"]}
        for column in mine.get(prefix, [each for each in given if each.startswith(prefix)]):
            given[column][:] = float(column == "qw")
        log = checked(given)
        found = channel(log, name)
        assert not found.is_used
        assert "not filled, left out" in found.notes[0]
        assert not len(log.measurements[name])
        assert log.conventions.not_compared == (other,)
        assert log.failures == ()
        assert any(found.notes[0] in warning for warning in log.warnings)

    def test_the_target_is_found_without_unfilled_rates(self):
        given = columns("attitude", "gyro", "position", "encoders", "joint_rates")
        for name in [each for each in given if each.startswith("qd:")]:
            given[name][:] = 0.0
        found = identify(flyer(), from_columns(given), sensors="testbed")
        assert abs(found["m"].value - MASS) < 4 * found["m"].sigma
        assert any("not filled, left out" in warning for warning in found.warnings)
        assert found.passed

    def test_an_attitude_that_nothing_replaces_is_refused(self):
        given = columns("attitude", "position", "encoders")
        given |= dict(zip(("qw", "qx", "qy", "qz"), np.eye(4)[0][:, None] + 0 * given["time"]))
        with pytest.raises(InputError, match=r"attitude: constant while arm_joint1.*not filled"):
            checked(given)

    def test_a_joint_position_that_is_not_filled_is_refused(self):
        given = columns(*ALL)
        given[JOINT][:] = 0.0
        with pytest.raises(InputError, match=f"{JOINT} is constant while {RATE} shows motion"):
            checked(given)

    def test_a_locked_joint_is_all_right(self):
        given = columns(*ALL)
        given[JOINT][:], given[RATE][:] = 2.0, 0.0
        log = checked(given)
        assert channel(log, "joint_rates").notes == channel(log, "encoders").notes == ()

    def test_a_constant_rate_that_is_the_motion_is_all_right(self):
        given = columns(*ALL)
        given[JOINT], given[RATE][:] = 1.0 + 0.2 * given["time"], 0.2
        assert channel(checked(given), "joint_rates").notes == ()

    def test_a_locked_joint_whose_encoder_is_noisy_is_all_right(self):
        """All encoders have noise of 5 mrad: over a log it spans 30 mrad, and is no motion."""
        given, rng = columns(*ALL), np.random.default_rng(3)
        given[JOINT][:], given[RATE][:] = 2.0, 0.0
        for name in [each for each in given if each.startswith("q:")]:
            given[name] += 5e-3 * rng.standard_normal(len(given[name]))
        assert np.ptp(given[JOINT]) > 0.03
        seen = look_at(from_columns(given), flyer())
        assert not seen.errors
        assert [each.is_used for each in seen.table if each.name == "joint_rates"] == [True]


class TestEndsOfScale:
    @pytest.fixture
    def halted(self):
        """Return columns of a joint that rests for 2 s, then turns one way at a growing rate."""
        given, rng = columns(*ALL), np.random.default_rng(3)
        after = np.maximum(given["time"] - 2.0, 0.0)
        noise = 1e-3 * np.abs(rng.standard_normal(len(after)))
        given[JOINT] = 2.0 + 0.05 * after**2
        given[RATE] = np.where(after > 0, 0.1 * after + noise, 0.0)
        return given

    def test_what_is_cut_off_is_left_out(self, halted):
        is_beyond = halted[RATE] > 0.6
        halted[RATE] = np.minimum(halted[RATE], 0.6)
        found = channel(checked(halted), "joint_rates")
        assert found.notes == (f"{is_beyond.sum()} rows at the end of the scale (0.6), left out",)
        assert found.rows == (~is_beyond).sum()

    def test_zero_is_no_end(self, halted):
        """A driver that gives exactly zero at rest measures it."""
        found = channel(checked(halted), "joint_rates")
        assert found.notes == ()
        assert found.rows == len(halted["time"])


class TestCopies:
    def slow(self, how, every=5):
        given = columns()
        nodes = given["time"][::every]
        for name in ("x", "y", "z"):
            column = given[name]
            held = column[::every].repeat(every)[: len(column)]
            line = np.interp(given["time"], nodes, column[::every])
            given[name] = held if how == "repeats" else line
        return given

    @pytest.mark.parametrize("how", ["repeats", "interpolates"])
    def test_copies_between_measurements_are_left_out(self, how):
        log = checked(self.slow(how))
        assert channel(log, "position").notes == (
            f"{how} each value over 5 rows: 200 rows left out",
        )
        true = columns()
        position = log.measurements.position
        np.testing.assert_allclose(position.time, true["time"][::5], atol=1e-12)
        np.testing.assert_allclose(position.value[:, 0], true["x"][::5], atol=1e-12)
        assert len(log.measurements.attitude) == 251

    def test_a_base_at_rest_in_coarse_steps_is_no_copy(self):
        given = columns()
        for name in ("x", "y", "z"):
            given[name] = np.round(given[name], 2)
        assert (np.diff(given["x"]) == 0).mean() > 0.8
        assert channel(checked(given), "position").notes == ()

    def test_a_drift_in_coarse_steps_is_no_copy(self):
        given = columns()
        for name in ("x", "y", "z"):
            given[name] = np.round(0.005 * given["time"], 3)
        assert np.diff(np.flatnonzero(np.diff(given["x"]))).min() >= 4
        assert channel(checked(given), "position").notes == ()


class TestClocks:
    @pytest.mark.parametrize(
        ("moved", "of", "than", "rows"),
        [
            ("gyro", "attitude", "angular velocity", 2),
            ("gyro", "attitude", "angular velocity", -3),
            ("joint_rates", JOINT, RATE, 5),
            ("velocity", "position", "velocity", 4),
        ],
    )
    def test_another_clock_is_a_delay_in_ms(self, moved, of, than, rows):
        """Of a rate whose stamps are late by some rows of 40 ms: the position's are early."""
        log = from_columns(columns(*ALL))
        late = Samples(log[moved].time + 0.04 * rows, log[moved].value)
        found = check_log(flyer(), log.updated({moved: late}))
        order = "earlier" if rows > 0 else "later"
        text = rf"stamps of {of} are (\d+) ms {order} than those of {than}"
        [delay] = [float(ms) for each in found.warnings for ms in re.findall(text, each)]
        assert delay == pytest.approx(40 * abs(rows), abs=4)

    def test_one_clock_has_no_delay(self):
        found = checked(columns(*ALL))
        assert not any("stamps" in each for each in found.warnings)


class TestCheckCommand:
    @pytest.fixture
    def check(self, run_cpid, tmp_path):
        def run(given, *options):
            return run_cpid("log", "check", write(tmp_path, csv_of(given)), *CRAFT, *options)

        return run

    def test_the_table_says_what_is_used(self, check):
        given = columns("attitude", "gyro", "position", "encoders", "joint_rates")
        for name in [each for each in given if each.startswith("qd:")]:
            given[name][:] = 0.0
        for name in ("bwx", "bwy", "bwz"):
            given[name][100:150] = np.nan
        code, stdout, _ = check(given)
        lines = [" ".join(line.split()) for line in stdout.splitlines()]
        assert code == 0
        assert "angular velocity 201 25 Hz 2.04 s at 3.96 s used -" in lines
        assert any(line.startswith("joint rates 251 25 Hz - left out zero in") for line in lines)
        assert "in degrees" not in stdout
        assert "no problems found" not in stdout
        assert "not checked: joint positions with joint rates (joint rates left out)" in stdout

    def test_errors_say_that_nothing_was_compared(self, check):
        given = columns("attitude", "position", "encoders")
        given |= dict(zip(("qw", "qx", "qy", "qz"), np.eye(4)[0][:, None] + 0 * given["time"]))
        code, stdout, _ = check(given)
        assert code == 2
        assert "error: attitude: constant while" in stdout
        assert "not checked: units, signs and frames: nothing was compared" in stdout

    def test_a_map_of_unfilled_rates_has_no_unit_of_degrees(self, run_cpid, tmp_path):
        given = columns("attitude", "gyro", "position", "encoders", "joint_rates")
        for name in [each for each in given if each.startswith("qd:")]:
            given[name][:] = 0.0
        path = write(tmp_path, csv_of(given))
        code, stdout, stderr = run_cpid("log", "map", path, *CRAFT)
        assert code == 0
        assert "deg" not in stdout
        assert "not filled, left out" in stderr


@pytest.mark.parametrize("arguments", [("list",), ("log", "check", "nöwhere.csv")])
def test_a_terminal_of_ascii_gets_all_that_it_can_show(monkeypatch, arguments):
    streams = [TextIOWrapper(BytesIO(), encoding="ascii") for _ in range(2)]
    monkeypatch.setattr(sys, "stdout", streams[0])
    monkeypatch.setattr(sys, "stderr", streams[1])
    monkeypatch.setattr(sys, "argv", ["cpid", *arguments])
    with pytest.raises(SystemExit):
        main()
    print("kg·m² ± σ °")
    for stream in streams:
        stream.flush()
    written = b"".join(stream.buffer.getvalue() for stream in streams).decode("ascii")
    assert r"kg\xb7m\xb2 \xb1 \u03c3 \xb0" in written
    assert (r"n\xf6where.csv: no such file" in written) == (arguments[0] == "log")
