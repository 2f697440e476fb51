"""Whole logs are checked: what is wrong late in a log, or only while the arm moves, is found."""

import numpy as np
import pytest
from sensing_cases import Sines, log_of, true_telemetry

from cpid_drake import InertialParameters, identify
from cpid_drake.files.errors import InputError
from cpid_drake.identification.checked_log import check_log
from cpid_drake.logs.log import Log, Samples

TARGET = InertialParameters.from_vector([80.0, 0.3, 0.1, -0.2, 15.0, 18.0, 12.0, 0.5, -1.0, 0.8])


def exact(craft, duration=30.0, momentum_W=None):
    motion = Sines.drawn(len(craft.joint_names), 3, duration)
    times = np.arange(0, duration, 0.05)
    return true_telemetry(craft.tree, craft.joint_names, motion, TARGET, times, momentum_W)


def test_a_log_is_checked_to_its_end(craft):
    log = log_of(exact(craft))
    renamed = Log(("other", *log.joint_names[1:]), log.samples)
    with pytest.raises(InputError, match=r"no column 'q:\w+'; .* the log's are 'other', "):
        identify(craft, renamed)
    end = log.encoders.value.copy()
    end[-1, 0] = 9.5  # beyond the limit of 9 rad
    far = log.updated({"encoders": Samples(log.encoders.time, end)})
    assert "q:shoulder goes to 9.5" in check_log(craft, far).warnings[-1]


def rest_first(log, duration, seed):
    """Return a log that rests without noise for a time [s], then moves with noise of 1e-4."""
    rng, samples = np.random.default_rng(seed), {}
    rates = ("gyro", "velocity", "joint_rates")
    for name, moving in log.items():
        times = np.arange(0, duration, 0.05)
        still = np.tile(moving.value[0] * (name not in rates), (len(times), 1))
        noisy = moving.value + 1e-4 * rng.normal(size=moving.value.shape)
        samples[name] = Samples(
            np.append(times, duration + moving.time), np.concatenate([still, noisy])
        )
    return log.updated(samples)


def test_the_part_in_which_the_arm_moves_is_checked(craft):
    """21,000 samples at rest come before those in degrees."""
    log = rest_first(log_of(exact(craft)), 1050.0, 5)
    rates = Samples(log.joint_rates.time, np.degrees(log.joint_rates.value))
    wrong = log.updated({"joint_rates": rates})
    found = check_log(craft, wrong)
    assert any("qd of all turning joints is in degrees" in failure for failure in found.failures)
