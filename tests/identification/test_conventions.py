"""The convention is named that the conservation of momentum asks for, and no other cause."""

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
    small_craft,
    true_telemetry,
)

from cpid_drake import InputError, identify
from cpid_drake.identification.conventions import convention_of
from cpid_drake.logs.log import Samples
from cpid_drake.logs.simulated_noise import add_noise

TIMES = np.arange(0.0, 6.0, 0.03)


@pytest.fixture(scope="module")
def wheeled(tmp_path_factory):
    return small_craft(tmp_path_factory.mktemp("wheels"), wheels=True)


@pytest.fixture(scope="module", params=[None, MOMENTUM], ids=["at rest", "tumbling"])
def log(wheeled, skewed_target, request):
    motion = Sines.drawn(len(wheeled.joint_names), 11, TIMES[-1], 0.6)
    motion = true_telemetry(
        wheeled.tree, wheeled.joint_names, motion, skewed_target, TIMES, request.param
    )
    return log_of(motion)


def attitudes(log):
    return Rotation.from_quat(log.attitude.value, scalar_first=True)


def wheel_sizes(craft, size):
    rotors = [craft.tree.is_rotor(k) for k in range(len(craft.joint_names))]
    assert any(rotors)
    return np.where(rotors, size, 1.0)


SPOILS = {
    "angular velocity is in degrees": ("gyro", lambda c, m: m.gyro.value * 180 / np.pi),
    "angular velocity is in revolutions": ("gyro", lambda c, m: m.gyro.value * 30 / np.pi),
    "angular velocity is expressed in W": (
        "gyro",
        lambda c, m: attitudes(m).apply(m.gyro.value),
    ),
    "joint rates are in degrees": ("joint_rates", lambda c, m: m.joint_rates.value * 180 / np.pi),
    "wheels' rates are in revolutions": (
        "joint_rates",
        lambda c, m: m.joint_rates.value * wheel_sizes(c, 30 / np.pi),
    ),
    "velocity is in millimetres": ("velocity", lambda c, m: m.velocity.value * 1e3),
    "velocity is in feet": ("velocity", lambda c, m: m.velocity.value / 0.3048),
    "velocity is expressed in B": (
        "velocity",
        lambda c, m: attitudes(m).inv().apply(m.velocity.value),
    ),
}


@pytest.mark.parametrize("phrase", SPOILS)
@pytest.mark.parametrize("left_out", [(), ("position",)], ids=["complete", "no position"])
def test_the_convention_of_exact_rates_is_named(wheeled, log, phrase, left_out):
    name, spoil = SPOILS[phrase]
    bad = log.updated({name: Samples(log[name].time, spoil(wheeled, log))})
    bad = bad.updated({n: bad[n].where(slice(0)) for n in left_out})
    assert phrase in str(convention_of(wheeled.tree, bad))


def test_rates_as_agreed_are_no_convention_of(wheeled, log):
    assert convention_of(wheeled.tree, log) is None


def test_a_wrong_mass_is_no_convention(wheeled, log):
    first, *others = wheeled.tree.bodies
    heavier = replace(wheeled.tree, bodies=(replace(first, mass=1.5 * first.mass), *others))
    assert convention_of(heavier, log) is None


def test_a_gyro_alone_is_enough_at_rest(craft, skewed_target):
    motion = Sines.drawn(len(craft.joint_names), 11, TIMES[-1], 0.6)
    log = log_of(true_telemetry(craft.tree, craft.joint_names, motion, skewed_target, TIMES))
    log = log.updated({n: log[n].where(slice(0)) for n in ("attitude", "position", "velocity")})
    bad = log.updated({"gyro": Samples(log.gyro.time, log.gyro.value * 180 / np.pi)})
    assert "angular velocity is in degrees" in str(convention_of(craft.tree, bad))
    assert "in degrees per second: it must be in rad/s" in identify(craft, bad).failures[0]


def test_time_stamps_in_nanoseconds_are_refused(craft, skewed_target):
    """Without rates, nothing but the stamps themselves tells their unit."""
    motion = Sines.drawn(len(craft.joint_names), 11, TIMES[-1], 0.6)
    log = log_of(true_telemetry(craft.tree, craft.joint_names, motion, skewed_target, TIMES))
    names = ("attitude", "position", "encoders")
    slow = {n: Samples(1e9 * log[n].time, log[n].value) for n in names}
    slow |= {n: log[n].where(slice(0)) for n in ("gyro", "velocity", "joint_rates")}
    with pytest.raises(InputError, match=r"s apart if the time is in seconds: it must be in s"):
        identify(craft, log.updated(slow))


SUITE = coarse_suite()


@pytest.fixture(scope="module")
def noisy_log(craft, skewed_target):
    """Return a function that draws a log, in truth of another tree."""
    motion = Sines.drawn(len(craft.joint_names), 105, 6.0, 0.5)

    def make(tree=craft.tree):
        return add_noise(SUITE, measured(craft, motion, skewed_target, SUITE, MOMENTUM, tree), 1)

    return make


@pytest.fixture(scope="module")
def noisy(noisy_log):
    return noisy_log()


def with_values(log, name, change):
    samples = log[name]
    return log.updated({name: Samples(samples.time, change(samples.value))})


def late(log, name, delay):
    samples = log[name]
    moved = Samples(np.round(samples.time + delay, 6), samples.value)
    return log.updated({name: moved.where(moved.time >= 0)})


def joints(order, signs=1.0):
    return lambda log: with_values(log, "encoders", lambda q: signs * q[:, order])


def turned_base(log):
    turn = Rotation.from_rotvec([0.0, 0.0, np.pi / 2])
    log = with_values(log, "gyro", lambda w: turn.apply(w, inverse=True))

    def quaternions(given):
        return (Rotation.from_quat(given, scalar_first=True) * turn).as_quat(scalar_first=True)

    return with_values(log, "attitude", quaternions)


def turned_world(log):
    turn = Rotation.from_rotvec([0.0, 0.0, np.pi / 2])
    return with_values(log, "position", lambda p: turn.apply(p, inverse=True))


def mirrored(log):
    log = with_values(log, "attitude", lambda q: q * [1, -1, 1, -1])
    log = with_values(log, "position", lambda p: p * [1, -1, 1])
    return with_values(log, "gyro", lambda w: w * [-1, 1, -1])


def without_position(log):
    return log.updated({"position": log.position.where(slice(0))})


CONVENTIONS = {
    "q:slide has the opposite sign": joints([0, 1, 2, 3], [1, -1, 1, 1]),
    "q:shoulder and q:elbow are exchanged": joints([2, 1, 0, 3]),
    "shoulder … and elbow … of two arms are exchanged": joints([2, 3, 0, 1]),
    "other axes of the base than the model's: their -y, x, z": turned_base,
}
OF_POSITIONS = {
    "position is expressed in other axes than the attitude: its -y, x, z": turned_world,
    "left-handed: the log is mirrored along y": mirrored,
}


@pytest.mark.parametrize("words", CONVENTIONS | OF_POSITIONS)
def test_the_convention_of_a_noisy_log_is_named(craft, noisy, words):
    bad = (CONVENTIONS | OF_POSITIONS)[words](noisy)
    assert words in str(convention_of(craft.tree, bad, SUITE))


@pytest.mark.parametrize("words", CONVENTIONS)
def test_the_convention_of_a_noisy_log_without_positions_is_named(craft, noisy, words):
    bad = without_position(CONVENTIONS[words](noisy))
    assert words in str(convention_of(craft.tree, bad, SUITE))


def test_another_body_that_holds_the_target_is_named(craft, noisy_log):
    k = next(k for k, body in enumerate(craft.tree.bodies) if body.name == "tube")
    held = replace(craft.tree, capture_body=k, R_BC=np.eye(3), p_BC=np.zeros(3))
    found = convention_of(craft.tree, noisy_log(held), SUITE)
    assert found == "the body 'tube' of the model, not the capture frame, holds the target"


def heavier_base(tree):
    """Return a spacecraft whose base is 10 % heavier, and has its centre of mass elsewhere."""
    first, *others = tree.bodies
    shifted = first.p_BBcm + [0.05, 0.0, -0.05]
    return replace(tree, bodies=(replace(first, mass=1.1 * first.mass, p_BBcm=shifted), *others))


ERRORS = {
    "none": lambda log: log,
    "late position": lambda log: late(log, "position", 0.3),
    "early encoders": lambda log: late(log, "encoders", -0.2),
    "joint zero": lambda log: with_values(log, "encoders", lambda q: q + [0.0, 0.0, 0.1, 0.0]),
    "joint scale": lambda log: with_values(log, "encoders", lambda q: q * [1.0, 1.0, 0.9, 1.0]),
    "gyro scale": lambda log: with_values(log, "gyro", lambda w: 1.05 * w),
}


@pytest.mark.parametrize("error", ERRORS)
@pytest.mark.parametrize("change", [lambda log: log, without_position], ids=["all", "no position"])
def test_an_error_of_some_size_is_no_convention(craft, noisy, error, change):
    assert convention_of(craft.tree, change(ERRORS[error](noisy)), SUITE) is None


def test_a_wrong_model_is_no_convention(craft, noisy_log):
    log = noisy_log(heavier_base(craft.tree))
    assert convention_of(craft.tree, log, SUITE) is None
    assert convention_of(craft.tree, without_position(log), SUITE) is None
