"""Conventions with which no target explains the base's motion are found without any velocity."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from sensing_cases import MOMENTUM, Sines, coarse_suite, measured, small_craft

from cpid_drake import InertialParameters, identify, load_scenario, shipped_scenario
from cpid_drake.logs.centre_of_mass import TravelModel, base_travel, in_unit
from cpid_drake.logs.consistency import check_consistency
from cpid_drake.logs.log import Measurements, Samples
from cpid_drake.logs.motion_checks import check_motion, not_checked
from cpid_drake.logs.simulated_noise import add_noise
from cpid_drake.sensors.sensors import AttitudeSensor, JointSensor, VectorSensor
from cpid_drake.sensors.suite import SensorSuite
from cpid_drake.studies.trials import ideal_samples, make_case

TARGET = InertialParameters(60.0, [0.5, 0.05, -0.1], [[6, 0, 0], [0, 9, 0], [0, 0, 8]])
POINT = np.array([0.3, -0.2, 0.5])
SUITE = coarse_suite(gyro=None)


@pytest.fixture(scope="module")
def craft(tmp_path_factory):
    return small_craft(tmp_path_factory.mktemp("craft"))


@pytest.fixture(scope="module", params=["exact", "noisy", "tumbling"])
def log(craft, request):
    momentum = MOMENTUM if request.param == "tumbling" else None
    log = measured(craft, Sines.drawn(4, 3, 10.0), TARGET, SUITE, momentum)
    return log if request.param == "exact" else add_noise(SUITE, log, 4)


def changed(log, **values):
    return log.updated({name: Samples(log[name].time, v) for name, v in values.items()})


def moved_point(log):
    R_WB = Rotation.from_quat(log.attitude.value, scalar_first=True)
    assert np.array_equal(log.attitude.time, log.position.time)
    return log.position.value + R_WB.apply(POINT)


def in_base_axes(log):
    R_WB = Rotation.from_quat(log.attitude.value, scalar_first=True)
    return R_WB.inv().apply(log.position.value)


def reversed_joint(log, k):
    value = log.encoders.value.copy()
    value[:, k] *= -1
    return value


def in_degrees(log):
    return np.where(np.arange(4) == 1, 1.0, 180 / np.pi) * log.encoders.value  # joint 1 slides


@pytest.mark.parametrize(
    ("spoil", "phrase"),
    [
        (lambda m: {"position": m.position.value * 1000}, "in millimetres"),
        (lambda m: {"position": m.position.value / 0.0254}, "in inches"),
        (lambda m: {"position": moved_point(m)}, "that of the point [0."),
        (lambda m: {"position": moved_point(m) * 100}, "in centimetres"),
        (lambda m: {"attitude": m.attitude.value * [1, -1, -1, -1]}, "that of R_BW"),
        (lambda m: {"attitude": m.attitude.value[:, [1, 2, 3, 0]]}, "in the order x, y, z, w"),
        (lambda m: {"position": in_base_axes(m)}, "expressed in B's axes"),
        (lambda m: {"encoders": in_degrees(m)}, "in degrees"),
        (lambda m: {"encoders": reversed_joint(m, 2)}, "q:elbow seems to have the opposite sign"),
    ],
)
def test_a_wrong_convention_is_named(craft, log, spoil, phrase):
    bad = changed(log, **spoil(log))
    found = check_motion(craft.tree, craft.joint_names, bad)
    assert len(found.errors + found.warnings) == 1
    assert phrase in (found.errors + found.warnings)[0]


@pytest.fixture(scope="module")
def exact(craft):
    suite = coarse_suite(joint_rates=JointSensor(20.0, 1e-4), velocity=VectorSensor(20.0, 1e-4))
    return measured(craft, Sines.drawn(4, 3, 10.0), TARGET, suite)


def test_a_wrong_unit_fails_a_check_and_is_no_refusal(craft, exact):
    found = identify(craft, changed(exact, position=exact.position.value * 1000), rows="standard")
    assert any("in millimetres" in failure for failure in found.failures)
    assert not identify(craft, exact, rows="standard").failures


def test_a_wrong_mass_of_the_model_is_named_beside_a_wrong_unit(craft):
    """A base that is 100 times lighter than its model moves 50 times as far."""
    light = heavier("base", 0.01)(craft.tree)
    log = measured(craft, Sines.drawn(4, 3, 10.0), TARGET, SUITE, tree=light)
    found = check_motion(craft.tree, craft.joint_names, log)
    [text] = found.errors + found.warnings
    assert "masses of the model are wrong" in text


def test_a_log_in_the_right_conventions_passes(craft, log):
    found = check_motion(craft.tree, craft.joint_names, log)
    assert (found.errors, found.warnings, found.unchecked) == ([], [], [])


def test_gaps_are_not_bridged(craft):
    """A spline through a gap of a second would make up a motion."""
    log = measured(craft, Sines.drawn(4, 3, 10.0), TARGET, SUITE)
    lost = {
        name: log[name].where(abs(log[name].time - middle) > 0.7)
        for name, middle in (("attitude", 3.0), ("encoders", 7.0))
    }
    whole, found = base_travel(log), base_travel(log.updated(lost))
    same = np.searchsorted(whole.time, found.time)
    assert 0.6 * len(whole.time) < len(found.time) < 0.8 * len(whole.time)
    np.testing.assert_allclose(found.time, whole.time[same], atol=1e-9)
    np.testing.assert_allclose(found.q, whole.q[same], atol=1e-3)
    np.testing.assert_allclose(found.R_WB, whole.R_WB[same], atol=1e-3)


def heavier(name, factor):
    def change(tree):
        bodies = (replace(b, mass=factor * b.mass) if b.name == name else b for b in tree.bodies)
        return replace(tree, bodies=tuple(bodies))

    return change


@pytest.mark.parametrize("name", ["base", "tube"])
@pytest.mark.parametrize("factor", [0.7, 4.0])
def test_a_wrong_mass_is_not_taken_for_a_wrong_convention(craft, log, name, factor):
    tree = heavier(name, factor)(craft.tree)
    found = check_motion(tree, craft.joint_names, log)
    assert found.errors == []
    assert not any("q:" in text or "quaternion" in text for text in found.warnings)


@pytest.fixture(scope="module")
def paper():
    scenario = load_scenario(shipped_scenario("paper"))
    craft = scenario.spacecraft.make()
    suite = SensorSuite(
        attitude=AttitudeSensor(16.0), position=VectorSensor(16.0), encoders=JointSensor(16.0)
    )
    return make_case(scenario, craft, scenario.target_truth(), suite, (), 1), craft


def test_a_wrong_mass_is_not_taken_for_the_sign_of_a_joint_that_hardly_matters(paper):
    case, craft = paper
    log = ideal_samples(case, heavier("bus", 1.2)(craft.tree), craft.joint_names)
    found = check_motion(craft.tree, craft.joint_names, log)
    assert found.errors == []
    assert not any("q:" in text for text in found.warnings)


@pytest.mark.parametrize("k", [3, 9])
def test_the_sign_of_a_joint_that_hardly_matters_is_named_in_an_exact_log(paper, k):
    case, craft = paper
    log = ideal_samples(case, craft.tree, craft.joint_names)
    bad = changed(log, encoders=reversed_joint(log, k))
    [text] = check_motion(craft.tree, craft.joint_names, bad).errors
    assert text.startswith(f"q:{craft.joint_names[k]} seems to have the opposite sign")


def test_the_fit_finds_the_mass_and_the_point(craft):
    log = measured(craft, Sines.drawn(4, 3, 10.0), TARGET, SUITE)
    travel = base_travel(changed(log, position=moved_point(log) * 1000))
    fit = TravelModel(craft.tree, travel.q).fit(in_unit(travel, 1e-3), free_point=True)
    assert fit.mass_share == pytest.approx(60.0 / (60.0 + craft.mass), rel=1e-6)
    np.testing.assert_allclose(fit.point_B, POINT, atol=1e-6)
    assert fit.error < 1e-5


def test_a_constant_force_is_not_taken_for_another_convention(craft, log):
    pushed = log.position.value + 1e-3 * log.position.time[:, None] ** 2 * [1.0, -2.0, 0.5]
    found = check_motion(craft.tree, craft.joint_names, changed(log, position=pushed))
    assert (found.errors, found.warnings) == ([], [])


def test_what_cannot_be_compared_is_said(craft, log):
    without = Measurements(log.joint_names, {"encoders": log.encoders, "attitude": log.attitude})
    [text] = check_motion(craft.tree, craft.joint_names, without).unchecked
    assert text.startswith("unit and point of the position, signs of joints (needs positions")
    texts = not_checked(log, has_spacecraft=False)
    assert "units of position (needs --spacecraft)" in texts
    assert "units of joint positions (needs --spacecraft or joint rates)" in texts
    assert not_checked(log, has_spacecraft=True) == []


@pytest.mark.parametrize(("unit", "scale"), [("ms", 1e3), ("us", 1e6), ("ns", 1e9)])
def test_a_clock_in_another_unit_is_named(craft, unit, scale):
    suite = coarse_suite(joint_rates=JointSensor(20.0, 1e-4))
    log = add_noise(suite, measured(craft, Sines.drawn(4, 3, 10.0), TARGET, suite), 4)
    late = log.updated({name: Samples(s.time * scale, s.value) for name, s in log.items()})
    [text] = check_consistency(late).errors
    assert f"if the time is in {unit}: it must be in s" in text
    assert check_consistency(log).errors == []
    without = late.updated({"joint_rates": Samples(np.empty(0), np.empty((0, 4)))})
    assert f"if the time is in {unit}" in check_consistency(without).errors[0]
