"""The convention is named that rates and the momentum ask for, and no other cause is."""

import re
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

from cpid_drake import (
    InertialParameters,
    InputError,
    from_columns,
    identify,
    load_scenario,
    read_log,
    shipped_scenario,
)
from cpid_drake.files.resources import models_directory
from cpid_drake.identification.log_conventions import check_as_read
from cpid_drake.logs.column_map import ColumnMap, TimeColumn
from cpid_drake.logs.conventions import check_conventions
from cpid_drake.logs.formats import table_of
from cpid_drake.logs.instants import instants_of
from cpid_drake.logs.log import Samples
from cpid_drake.logs.score import MOMENTUM as BY_MOMENTUM
from cpid_drake.logs.score import explain_by_momentum
from cpid_drake.logs.simulated_noise import add_noise
from cpid_drake.sensors.sensors import AttitudeSensor, JointSensor, VectorSensor
from cpid_drake.sensors.suite import SensorSuite
from cpid_drake.simulation.trials import ideal_samples, make_case

TIMES = np.arange(0.0, 6.0, 0.03)
POINT = np.array([0.3, -0.2, 0.5])
SUITE = coarse_suite()
DEGREES = 180 / np.pi


@pytest.fixture(scope="module")
def wheeled(tmp_path_factory):
    return small_craft(tmp_path_factory.mktemp("wheels"), wheels=True)


@pytest.fixture(scope="module")
def states(wheeled, skewed_target):
    """Return a log of all exact quantities."""
    motion = Sines.drawn(len(wheeled.joint_names), 11, TIMES[-1], 0.6)
    names = wheeled.joint_names
    return log_of(true_telemetry(wheeled.tree, names, motion, skewed_target, TIMES, MOMENTUM))


@pytest.fixture(scope="module")
def draw(craft, skewed_target):
    """Return a function that draws a noisy log, in truth of another tree."""
    motion = Sines.drawn(len(craft.joint_names), 105, 6.0, 0.5)

    def make(tree=craft.tree, suite=SUITE, momentum=MOMENTUM):
        return add_noise(suite, measured(craft, motion, skewed_target, suite, momentum, tree), 1)

    return make


@pytest.fixture(scope="module")
def noisy(draw):
    return draw()


def changed(name, change):
    return lambda log: log.updated({name: Samples(log[name].time, change(log))})


def without(log, *names):
    return log.updated({name: log[name].where(slice(0)) for name in names})


def said(tree, log):
    return check_conventions(log, tree).sentence


def attitudes(log, at="attitude"):
    """Return the attitudes at the samples of a sensor whose times are those of the attitude."""
    assert np.array_equal(log[at].time, log.attitude.time)
    return Rotation.from_quat(log.attitude.value, scalar_first=True)


def wheels(craft, size):
    return np.where([craft.tree.is_rotor(k) for k in range(len(craft.joint_names))], size, 1.0)


def turning(craft, size):
    sliding = [b.joint for b in craft.tree.bodies if b.prismatic]
    return np.where(np.isin(np.arange(len(craft.joint_names)), sliding), 1.0, size)


SPOILED_STATES = {
    "velocity is in degrees per second": ("gyro", lambda c, m: m.gyro.value * DEGREES),
    "velocity is in rpm": ("gyro", lambda c, m: m.gyro.value * 30 / np.pi),
    "expressed in W's axes": ("gyro", lambda c, m: attitudes(m, "gyro").apply(m.gyro.value)),
    "qd of all turning joints is in degrees per second": (
        "joint_rates",
        lambda c, m: m.joint_rates.value * turning(c, DEGREES),
    ),
    "qd of all wheels is in rpm": (
        "joint_rates",
        lambda c, m: m.joint_rates.value * wheels(c, 30 / np.pi),
    ),
    "qd:elbow is the rate of q:elbow with the opposite sign": (
        "joint_rates",
        lambda c, m: m.joint_rates.value * np.where(np.array(c.joint_names) == "elbow", -1, 1),
    ),
    "velocity is in millimetres per second": ("velocity", lambda c, m: m.velocity.value * 1e3),
    "velocity is in inches per second": ("velocity", lambda c, m: m.velocity.value / 0.0254),
    "velocity is expressed in B's axes": (
        "velocity",
        lambda c, m: attitudes(m, "velocity").inv().apply(m.velocity.value),
    ),
    "its -y, x, -z are x, y, z (angular_velocity.R_BS: [[0, -1, 0], [1, 0, 0], [0, 0, -1]]": (
        "gyro",
        lambda c, m: m.gyro.value[:, [1, 0, 2]] * [1, -1, -1],
    ),
}


@pytest.mark.parametrize("phrase", SPOILED_STATES)
def test_the_convention_of_exact_rates_is_named(wheeled, states, phrase):
    name, spoil = SPOILED_STATES[phrase]
    bad = changed(name, lambda log: spoil(wheeled, log))(states)
    assert phrase in said(wheeled.tree, bad)
    assert phrase in said(wheeled.tree, without(bad, "position"))


def turned_a_little(t):
    return Rotation.from_rotvec(0.08 * np.sin(np.outer(t, [1.0, 1.7, 0.6]) + [0.0, 1.0, 2.0]))


@pytest.mark.parametrize("axes", ["W", "B"])
def test_the_frame_of_a_gyro_is_named_of_a_base_that_turns_by_a_few_degrees(noisy, axes):
    """Its rates in W's axes differ little from those in B's."""
    at, t, h = noisy.attitude.time, noisy.gyro.time, 1e-5
    rate = (turned_a_little(t + h) * turned_a_little(t - h).inv()).as_rotvec() / (2 * h)
    rate = rate if axes == "W" else turned_a_little(t).inv().apply(rate)
    quaternion = turned_a_little(at).as_quat(scalar_first=True)
    log = noisy.updated({"attitude": Samples(at, quaternion), "gyro": Samples(t, rate)})
    found = check_conventions(log, None, by_momentum=False)
    assert ("angular_velocity.frame: world" in found.sentence) == (axes == "W")
    assert (found.sentence == "") == (axes == "B")


def test_states_as_agreed_have_no_convention(wheeled, states):
    assert said(wheeled.tree, states) == ""


@pytest.mark.parametrize(("unit", "size"), [("ms", 1e3), ("ns", 1e9)])
def test_a_clock_in_another_unit_is_named(wheeled, states, unit, size):
    late = states.updated({n: Samples(s.time * size, s.value) for n, s in states.items()})
    assert f"time.unit: {unit}" in said(wheeled.tree, late)


def test_a_clock_that_counts_uneven_steps_is_named_and_repaired_if_the_map_says_so(
    craft, skewed_target
):
    """The true steps are 5 % longer than the counted ones, and differ by a fifth."""
    rng = np.random.default_rng(5)
    times = np.append(0.0, np.cumsum(0.03 * 1.05 * (1 + 0.2 * rng.uniform(-1, 1, 200))))
    motion = Sines.drawn(len(craft.joint_names), 11, times[-1], 0.6)
    names, values = table_of(
        true_telemetry(craft.tree, craft.joint_names, motion, skewed_target, times, MOMENTUM)
    )
    columns = dict(zip(names, values.T)) | {"time": 0.03 * np.arange(len(times))}
    columns |= {name: column + 1e-6 * rng.normal(size=201) for name, column in columns.items()}
    columns["time"] = 0.03 * np.arange(len(times))
    [text] = check_conventions(from_columns(columns), craft.tree).failures
    assert "a second of the log takes 1.0" in text
    repaired = from_columns(columns, ColumnMap(time=TimeColumn(from_rates=True)))
    np.testing.assert_allclose(np.diff(repaired.gyro.time), np.diff(times), rtol=0.02)
    assert check_conventions(repaired, craft.tree).failures == ()
    wrong_scale = columns | {name: 1.05 * columns[name] for name in ("wx", "wy", "wz")}
    wrong_scale["time"] = times
    assert check_conventions(from_columns(wrong_scale), craft.tree).clock is None


def test_a_gyro_alone_is_enough_at_rest(craft, skewed_target):
    motion = Sines.drawn(len(craft.joint_names), 11, TIMES[-1], 0.6)
    log = log_of(true_telemetry(craft.tree, craft.joint_names, motion, skewed_target, TIMES))
    bad = changed("gyro", lambda m: m.gyro.value * DEGREES)(
        without(log, "attitude", "position", "velocity")
    )
    with pytest.raises(InputError, match=r"\(angular_velocity.unit: deg/s in a map of columns\)"):
        identify(craft, bad)


def test_time_stamps_in_nanoseconds_are_refused_without_rates(craft, noisy):
    """Nothing but the stamps themselves tells their unit."""
    slow = without(noisy, "gyro")
    slow = slow.updated({n: Samples(1e9 * s.time, s.value) for n, s in slow.items()})
    with pytest.raises(InputError, match=r"s apart if the time is in seconds: it must be in s"):
        identify(craft, slow)


def joints(order, signs=1.0):
    return changed("encoders", lambda m: signs * m.encoders.value[:, order])


def in_degrees(log):
    return np.where(np.arange(4) == 1, 1.0, DEGREES) * log.encoders.value  # joint 1 slides


def turned_base(log):
    turn = Rotation.from_rotvec([0.0, 0.0, np.pi / 2])
    log = changed("gyro", lambda m: turn.apply(m.gyro.value, inverse=True))(log)
    return changed("attitude", lambda m: (attitudes(m) * turn).as_quat(scalar_first=True))(log)


def mirrored(log):
    log = changed("attitude", lambda m: m.attitude.value * [1, -1, 1, -1])(log)
    log = changed("position", lambda m: m.position.value * [1, -1, 1])(log)
    return changed("gyro", lambda m: m.gyro.value * [-1, 1, -1])(log)


def moved_point(log):
    return log.position.value + attitudes(log, "position").apply(POINT)


CONVENTIONS = {
    "q:slide has the opposite sign of the model's joint (reversed_joints: [slide]": joints(
        [0, 1, 2, 3], [1, -1, 1, 1]
    ),
    "q:shoulder and q:elbow are exchanged": joints([2, 1, 0, 3]),
    "shoulder … and elbow … of two arms are exchanged": joints([2, 3, 0, 1]),
    "joint_positions.unit: deg": changed("encoders", in_degrees),
    "attitude.R_BS: [[0, -1, 0], [1, 0, 0], [0, 0, 1]]": turned_base,
    "direction: R_BW": changed("attitude", lambda m: m.attitude.value * [1, -1, -1, -1]),
    "order: xyzw": changed("attitude", lambda m: m.attitude.value[:, [1, 2, 3, 0]]),
}
OF_POSITIONS = {
    "position is expressed in other axes than the attitude: its -y, x, z": changed(
        "position", lambda m: m.position.value[:, [1, 0, 2]] * [1, -1, 1]
    ),
    "left-handed: the log is mirrored along y": mirrored,
    "position.unit: mm": changed("position", lambda m: m.position.value * 1e3),
    "position.unit: in": changed("position", lambda m: m.position.value / 0.0254),
    "the position is that of the point [0.": changed("position", moved_point),
    "position.unit: cm, position.point_B: [0.": changed("position", lambda m: moved_point(m) * 100),
    "position is expressed in B's axes": changed(
        "position", lambda m: attitudes(m, "position").inv().apply(m.position.value)
    ),
}


DEG = changed("encoders", in_degrees)
MM = changed("position", lambda m: m.position.value * 1e3)
INVERSE = changed("attitude", lambda m: m.attitude.value * [1, -1, -1, -1])
TILTED = changed("gyro", lambda m: TILT.apply(m.gyro.value))
TILT = Rotation.from_rotvec([0.3, -0.5, 0.2])

TURN = Rotation.from_rotvec(np.radians(40.0) * np.array([0.6, 0.0, -0.8]))
OTHER_BASE = changed("attitude", lambda m: (attitudes(m) * TURN.inv()).as_quat(scalar_first=True))


def with_late_gyro(log):
    return log.updated({"gyro": Samples(log.gyro.time + 0.08, log.gyro.value)})


TOGETHER = {
    "unit: deg, joint_positions.columns: {": (DEG, joints([2, 1, 0, 3])),
    "joint_positions.unit: deg": (DEG, MM),
    "reversed_joints: [slide]": (joints([0, 1, 2, 3], [1, -1, 1, 1]), MM),
    "direction: R_BW, angular_velocity.R_BS: [[": (INVERSE, TILTED),
    "attitude.direction: R_BW in a map": (with_late_gyro, INVERSE),
    "exchanged (attitude.R_BS: [[": (OTHER_BASE, joints([0, 2, 1, 3])),
    "other axes of the base than the model's: turned by": (
        OTHER_BASE,
        changed("gyro", lambda m: TURN.apply(m.gyro.value)),
    ),
}
"""By what is named first, two conventions that no single remedy mends."""


@pytest.mark.parametrize("words", TOGETHER)
def test_conventions_that_are_wrong_together_are_named(craft, noisy, words):
    log = noisy
    for change in TOGETHER[words]:
        log = change(log)
    assert words in said(craft.tree, log)


def test_a_search_without_time_says_that_it_did_not_decide(craft, noisy, monkeypatch):
    monkeypatch.setattr("cpid_drake.logs.conventions.BUDGET", 0.0)
    findings = check_conventions(DEG(noisy), craft.tree)
    assert findings.better == ()
    assert any("not decided in 0 s" in text for text in findings.unchecked)


@pytest.mark.parametrize("words", CONVENTIONS | OF_POSITIONS)
def test_the_convention_of_a_noisy_log_is_named(craft, noisy, words):
    assert words in said(craft.tree, (CONVENTIONS | OF_POSITIONS)[words](noisy))


@pytest.mark.parametrize("push", [0.003, 0.03, 0.3])
def test_no_convention_is_blamed_for_thrusters_that_fire(craft, noisy, push):
    """Thrust through the centre of mass, which no one logs: all positions go on at other rates."""
    impulses = push * np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.5], [-1.0, 1.0, 0.0]])
    gone = np.maximum(noisy.position.time[:, None] - [1.0, 2.5, 4.0], 0.0) @ impulses
    log = changed("position", lambda m: m.position.value + gone)(noisy)
    assert check_as_read(log, craft).conventions.failures == ()


@pytest.mark.parametrize(("unit", "size"), [("in", 1 / 0.0254), ("cm", 100.0)])
def test_one_target_for_motion_and_turn_tells_the_unit_of_noisy_positions(craft, draw, unit, size):
    """Each of both alone is explained by some target in another unit, or at another point."""
    suite = replace(SUITE, position=VectorSensor(10.0, 3e-3))
    bad = changed("position", lambda m: m.position.value * size)(draw(suite=suite))
    assert f"(position.unit: {unit} in a map" in said(craft.tree, bad)


@pytest.mark.slow
@pytest.mark.parametrize(("spoil", "words"), [(turned_base, "other axes"), (mirrored, "mirrored")])
def test_the_convention_of_a_log_that_no_target_fits_is_named(craft, noisy, spoil, words):
    """With the first failed check, or, if the fit ends without an answer, in its error."""
    try:
        text = identify(craft, spoil(noisy), sensors=SUITE).failures[0]
    except InputError as error:
        text = str(error)
    assert words in text


@pytest.mark.parametrize("words", ["q:shoulder and q:elbow are exchanged", "direction: R_BW"])
def test_the_convention_of_a_noisy_log_without_positions_is_named(craft, noisy, words):
    assert words in said(craft.tree, without(CONVENTIONS[words](noisy), "position"))


@pytest.mark.parametrize("words", ["direction: R_BW", "order: xyzw", "position.unit: in"])
def test_the_convention_of_a_noisy_log_without_gyro_is_named(craft, noisy, words):
    assert words in said(craft.tree, without((CONVENTIONS | OF_POSITIONS)[words](noisy), "gyro"))


def test_another_body_that_holds_the_target_is_named(craft, draw):
    k = next(k for k, body in enumerate(craft.tree.bodies) if body.name == "tube")
    held = replace(craft.tree, capture_body=k, R_BC=np.eye(3), p_BC=np.zeros(3))
    words = "the body 'tube' of the model, not the capture frame, holds the target"
    assert said(craft.tree, draw(held)) == words


def heavier(name, factor, shift=(0.0, 0.0, 0.0)):
    def change(tree):
        bodies = (
            replace(b, mass=factor * b.mass, p_BBcm=b.p_BBcm + shift) if b.name == name else b
            for b in tree.bodies
        )
        return replace(tree, bodies=tuple(bodies))

    return change


def late(name, delay):
    def change(log):
        moved = Samples(np.round(log[name].time + delay, 6), log[name].value)
        return log.updated({name: moved.where(moved.time >= 0)})

    return change


def pushed(log):
    place = log.position
    return place.value + 1e-3 * place.time[:, None] ** 2 * [1.0, -2.0, 0.5]


ERRORS = {
    "none": lambda log: log,
    "late position": late("position", 0.3),
    "early encoders": late("encoders", -0.2),
    "joint zero": changed("encoders", lambda m: m.encoders.value + [0.0, 0.0, 0.1, 0.0]),
    "joint scale": changed("encoders", lambda m: m.encoders.value * [1.0, 1.0, 0.9, 1.0]),
    "gyro scale": changed("gyro", lambda m: 1.05 * m.gyro.value),
    "constant force": changed("position", pushed),
}


@pytest.mark.parametrize("error", ERRORS)
def test_an_error_of_some_size_is_no_convention(craft, noisy, error):
    for left_out in ((), ("position",), ("gyro",)):
        assert said(craft.tree, without(ERRORS[error](noisy), *left_out)) == ""


@pytest.mark.parametrize(
    "change",
    [
        heavier("base", 1.1, (0.05, 0.0, -0.05)),
        heavier("base", 4.0),
        heavier("tube", 0.7),
        heavier("tube", 4.0),
    ],
)
def test_a_wrong_model_is_no_convention_of_the_log(craft, draw, change):
    log = draw(change(craft.tree))
    for left_out in ((), ("position",), ("gyro",)):
        text = said(craft.tree, without(log, *left_out))
        assert text == "" or "or the model's base has another mass" in text


@pytest.mark.parametrize("k", [3, 9])
def test_the_sign_of_a_joint_that_hardly_matters_is_named_in_an_exact_log_only(k):
    scenario = load_scenario(shipped_scenario("paper"))
    craft = scenario.spacecraft.make()
    suite = SensorSuite(
        attitude=AttitudeSensor(16.0), position=VectorSensor(16.0), encoders=JointSensor(16.0)
    )
    case = make_case(scenario, craft, scenario.target_truth(), suite, 1)
    signs = np.where(np.arange(len(craft.joint_names)) == k, -1, 1)
    for tree, is_named in ((craft.tree, True), (heavier("bus", 1.2)(craft.tree), False)):
        log = ideal_samples(case, tree, craft.joint_names)
        text = said(craft.tree, joints(slice(None), signs)(log) if is_named else log)
        words = f"q:{craft.joint_names[k]} has the opposite sign"
        assert (words in text) if is_named else (text == "")


SAMPLE = read_log(models_directory() / "telemetry/free_flyer.csv")
WRONG = {
    "joint_positions.unit: deg": changed("encoders", lambda m: m.encoders.value * DEGREES),
    "reversed_joints: [arm_joint4]": changed(
        "encoders", lambda m: m.encoders.value * [1, 1, 1, -1]
    ),
    "attitude.order: xyzw": changed("attitude", lambda m: m.attitude.value[:, [1, 2, 3, 0]]),
    "angular_velocity.unit: deg/s": changed("gyro", lambda m: m.gyro.value * DEGREES),
}


@pytest.mark.parametrize("remedy", WRONG)
def test_a_log_that_shows_its_convention_is_refused_before_a_fit(remedy):
    """By rates, or by the momentum, whose rows the noise of the sensors does not explain."""
    craft, steps = load_scenario(shipped_scenario("free_flyer_payload")).spacecraft.make(), []
    with pytest.raises(InputError, match=re.escape(remedy)):
        identify(craft, WRONG[remedy](SAMPLE), progress=steps.append)
    assert steps == ["checking log"]


@pytest.mark.parametrize("end", [0.7, 1.0])
def test_a_right_log_of_which_noise_is_half_the_motion_is_not_refused(end):
    """Of a second of smooth motion, many conventions explain what the momentum does not."""
    craft = load_scenario(shipped_scenario("free_flyer_payload")).spacecraft.make()
    found = identify(craft, SAMPLE.between(0.0, end))
    assert not any("map of columns" in failure for failure in found.failures)


def test_gaps_are_not_bridged_and_the_part_that_moves_is_compared(craft, noisy):
    """A spline through a gap of a second would make up a motion."""
    lost = {
        name: noisy[name].where(abs(noisy[name].time - middle) > 0.7)
        for name, middle in (("attitude", 2.0), ("encoders", 4.5))
    }
    whole, found = instants_of(noisy), instants_of(noisy.updated(lost))
    assert len(found.time) < 0.6 * len(whole.time)
    assert said(craft.tree, noisy.updated(lost)) == ""
    rested = {}
    for name, samples in noisy.items():
        step = np.median(np.diff(samples.time)) if len(samples) else 1.0
        rest = np.arange(-600.0, samples.time[0], step) if len(samples) else np.empty(0)
        value = [np.tile(samples.value[0], (len(rest), 1))] if len(samples) else []
        value = np.vstack([*value, samples.value])
        rested[name] = Samples(np.append(rest, samples.time), value)
    part = instants_of(noisy.updated(rested))
    assert (
        np.ptp(part.values["encoders"], axis=0).max()
        > 0.4 * np.ptp(whole.values["encoders"], axis=0).max()
    )


def test_a_pause_of_minutes_is_no_reason_to_compare_nothing(craft, noisy):
    paused = {n: Samples(s.time + 500.0 * (s.time > 1.5), s.value) for n, s in noisy.items()}
    found = check_conventions(noisy.updated(paused), craft.tree)
    assert {c.name for c in found.comparisons} == {"attitude", BY_MOMENTUM}
    assert not found.failures


def test_the_momentum_finds_the_point_of_the_position(craft, skewed_target):
    motion, suite = Sines.drawn(len(craft.joint_names), 3, 10.0), coarse_suite()
    log = measured(craft, motion, skewed_target, suite)
    moved = changed("position", moved_point)(log)
    found = explain_by_momentum(instants_of(moved), craft.tree, has_free_point=True)
    np.testing.assert_allclose(found.point_B, POINT, atol=1e-3)


def test_what_cannot_be_compared_is_said(craft, noisy):
    alone = changed("attitude", lambda m: np.tile([1.0, 0, 0, 0], (len(m.attitude), 1)))(noisy)
    alone = without(alone, "position", "gyro")
    still = changed("encoders", lambda m: np.tile(m.encoders.value[0], (len(m.encoders), 1)))
    found = check_conventions(still(alone), craft.tree)
    assert "signs of joints" in found.unchecked[0]
    comparisons = check_conventions(noisy, craft.tree).comparisons
    assert {c.name for c in comparisons} == {"attitude", BY_MOMENTUM}
    assert all(c.residual < 0.05 for c in comparisons)


def test_the_unit_of_a_gyro_without_attitude_is_said_to_be_open(craft, noisy):
    """Unless the momentum tells it."""
    alone = without(noisy, "attitude", "position")
    said_open = "unit of the angular velocity (no attitude to compare with)"
    assert said_open in check_conventions(alone, None).not_compared
    assert said_open not in check_conventions(noisy, None).not_compared
    assert check_conventions(noisy, craft.tree).not_compared == ()
    turned = "order and direction of the attitude (no angular velocity to compare with)"
    assert turned in check_conventions(without(noisy, "gyro"), None).not_compared


@pytest.mark.parametrize("seed", range(2))
def test_a_target_that_takes_the_spacecraft_s_inertia_away_explains_nothing(seed):
    """Of joints in degrees that were radians hardly anything moves, and without positions a target
    of negative inertia explains any rotation.
    """
    craft = load_scenario(shipped_scenario("free_flyer_payload")).spacecraft.make()
    bag = InertialParameters(8.5, [0.26, 0.02, -0.01], np.diag([0.16, 0.19, 0.25]))
    suite = coarse_suite(gyro=None, position=None)
    motion = Sines.drawn(len(craft.joint_names), seed, 10.0)
    log = add_noise(suite, measured(craft, motion, bag, suite), 4)
    assert check_conventions(log, craft.tree).better == ()
