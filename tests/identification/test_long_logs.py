"""Streams give the answer of the whole log, and are checked like it."""

import numpy as np
import pytest
from sensing_cases import Sines, small_craft, true_telemetry

from cpid_drake import InertialParameters, identify
from cpid_drake.errors import InputError
from cpid_drake.identification import checked_log
from cpid_drake.identification.checked_log import check_log, log_of_states
from cpid_drake.identification.requirements import in_joint_order
from cpid_drake.sensing.measurement_stream import joined, stream_of
from cpid_drake.sensing.measurements import Measurements, Samples

TARGET = InertialParameters.from_vector([80.0, 0.3, 0.1, -0.2, 15.0, 18.0, 12.0, 0.5, -1.0, 0.8])


@pytest.fixture(scope="module")
def craft(tmp_path_factory):
    return small_craft(tmp_path_factory.mktemp("craft"))


@pytest.fixture(scope="module")
def wheeled(tmp_path_factory):
    return small_craft(tmp_path_factory.mktemp("wheeled"), wheels=True)


def exact(craft, duration=30.0, momentum_W=None):
    motion = Sines.drawn(len(craft.joint_names), 3, duration)
    times = np.arange(0, duration, 0.05)
    return true_telemetry(craft.tree, craft.joint_names, motion, TARGET, times, momentum_W)


def samples_of(states) -> Measurements:
    return log_of_states(states).measurements


@pytest.fixture
def short_head(monkeypatch):
    """Treat all streams as long, so that they are read again and again."""
    monkeypatch.setattr(checked_log, "LONGEST_HEAD", 100)


def test_unusable_samples_are_counted_and_left_out_of_every_chunk(craft, short_head):
    log = samples_of(exact(craft))
    value = log.gyro.value.copy()
    value[[10, 300, 500]] = np.nan
    log = log.updated({"gyro": Samples(log.gyro.time, value)})
    found = identify(craft, stream_of(log, 2.0))
    assert found.rejected == {"gyro": 3}
    assert found.sample_count == len(log.gyro) - 3
    np.testing.assert_allclose(found.parameters, TARGET.to_vector(), atol=1e-6)


def test_a_stream_is_checked_like_a_log_in_memory(craft, short_head):
    log = samples_of(exact(craft))
    degrees = Samples(log.encoders.time, np.degrees(log.encoders.value))
    failures = identify(craft, stream_of(log.updated({"encoders": degrees}), 2.0)).failures
    assert any("is it in degrees" in failure for failure in failures)
    renamed = Measurements(("other", *log.joint_names[1:]), log.samples)
    with pytest.raises(InputError, match=r"no column 'q:\w+'; .* the log's are 'other', "):
        identify(craft, stream_of(renamed, 2.0))
    end = log.encoders.value.copy()
    end[-1, 0] = 9.5  # beyond the limit of 9 rad, in the last chunk
    far = log.updated({"encoders": Samples(log.encoders.time, end)})
    assert "q:shoulder goes to 9.5" in check_log(craft, stream_of(far, 2.0)).warnings[-1]


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


@pytest.mark.parametrize("in_memory", [True, False])
def test_the_part_in_which_the_arm_moves_is_checked(craft, in_memory):
    """Both kinds of a log: 21,000 samples at rest come before those in degrees."""
    log = rest_first(samples_of(exact(craft)), 1050.0, 5)
    rates = Samples(log.joint_rates.time, np.degrees(log.joint_rates.value))
    wrong = log.updated({"joint_rates": rates})
    found = check_log(craft, wrong if in_memory else stream_of(wrong))
    assert any("is it in degrees/s" in failure for failure in found.failures)


def test_the_angle_of_a_rotor_without_encoder_continues_from_chunk_to_chunk(wheeled, short_head):
    log = samples_of(exact(wheeled))
    value = log.encoders.value.copy()
    value[:, [name.startswith("spin") for name in log.joint_names]] = np.nan
    log = log.updated({"encoders": Samples(log.encoders.time, value)})
    whole = in_joint_order(log, wheeled).encoders.value
    streamed = joined(check_log(wheeled, stream_of(log, 2.0)).stream).encoders.value
    np.testing.assert_allclose(streamed, whole, atol=1e-9)
