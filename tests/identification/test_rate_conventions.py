"""The unit or frame of rates is named that the conservation of momentum asks for."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from sensing_cases import MOMENTUM, Sines, log_of, small_craft, true_telemetry

from cpid_drake import InputError, identify
from cpid_drake.identification.rate_conventions import other_convention
from cpid_drake.sensing.measurements import Samples

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
def test_the_convention_is_named(wheeled, log, phrase, left_out):
    name, spoil = SPOILS[phrase]
    bad = log.updated({name: Samples(log[name].time, spoil(wheeled, log))})
    bad = bad.updated({n: bad[n].where(slice(0)) for n in left_out})
    assert phrase in other_convention(wheeled.tree, bad)


def test_rates_as_agreed_are_no_other_convention(wheeled, log):
    assert other_convention(wheeled.tree, log) == ""


def test_a_wrong_mass_is_no_convention(wheeled, log):
    first, *others = wheeled.tree.bodies
    heavier = replace(wheeled.tree, bodies=(replace(first, mass=1.5 * first.mass), *others))
    assert other_convention(heavier, log) == ""


def test_a_gyro_alone_is_enough_at_rest(craft, skewed_target):
    motion = Sines.drawn(len(craft.joint_names), 11, TIMES[-1], 0.6)
    log = log_of(true_telemetry(craft.tree, craft.joint_names, motion, skewed_target, TIMES))
    log = log.updated({n: log[n].where(slice(0)) for n in ("attitude", "position", "velocity")})
    bad = log.updated({"gyro": Samples(log.gyro.time, log.gyro.value * 180 / np.pi)})
    assert "angular velocity is in degrees" in other_convention(craft.tree, bad)
    assert "in degrees per second: it must be in rad/s" in identify(craft, bad).doubts[0]


def test_time_stamps_in_nanoseconds_are_refused(craft, skewed_target):
    """Without rates, nothing but the stamps themselves tells their unit."""
    motion = Sines.drawn(len(craft.joint_names), 11, TIMES[-1], 0.6)
    log = log_of(true_telemetry(craft.tree, craft.joint_names, motion, skewed_target, TIMES))
    names = ("attitude", "position", "encoders")
    slow = {n: Samples(1e9 * log[n].time, log[n].value) for n in names}
    slow |= {n: log[n].where(slice(0)) for n in ("gyro", "velocity", "joint_rates")}
    with pytest.raises(
        InputError, match=r"3e\+07 s apart if the time is in seconds: it must be in s"
    ):
        identify(craft, log.updated(slow))
