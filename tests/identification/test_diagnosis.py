"""The most likely cause of a log that contradicts its model is named, with its size."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cpid_drake import identify, load_scenario, load_sensors, shipped_scenario
from cpid_drake.dynamics.spatial_inertia import point_mass_inertia
from cpid_drake.identification.checked_log import check_log
from cpid_drake.identification.diagnosis import likely_cause
from cpid_drake.sensing.measurements import Samples
from cpid_drake.sensing.noise import add_noise
from cpid_drake.spacecraft.spacecraft import Spacecraft
from cpid_drake.studies.trials import Firing, ideal_samples, make_case


@pytest.fixture(scope="module")
def case():
    scenario = load_scenario(shipped_scenario("free_flyer_payload"))
    craft = scenario.spacecraft.make()
    truth = scenario.target_truth()
    return make_case(scenario, craft, truth, load_sensors("testbed"), (), 1)


@pytest.fixture(scope="module")
def spacecraft(case) -> Spacecraft:
    return case.spacecraft.make()


@pytest.fixture(scope="module")
def log(case, spacecraft):
    ideal = ideal_samples(case, spacecraft.tree, spacecraft.joint_names)
    return add_noise(case.suite, ideal, 1)


def with_values(log, name, change):
    samples = log[name]
    return log.updated({name: Samples(samples.time, change(samples.value))})


def late(log, name, delay):
    samples = log[name]
    moved = Samples(np.round(samples.time + delay, 6), samples.value)
    return log.updated({name: moved.where(moved.time >= 0)})


def joint_zero(log):
    return with_values(log, "encoders", lambda q: q + [0.0, 0.0, 0.1, 0.0])


def exchanged_joints(log):
    return with_values(log, "encoders", lambda q: q[:, [0, 2, 1, 3]])


def turned_base(log):
    turn = Rotation.from_rotvec([0.0, 0.0, np.pi / 2])
    log = with_values(log, "gyro", lambda w: turn.apply(w, inverse=True))

    def attitudes(quaternions):
        attitude = Rotation.from_quat(quaternions, scalar_first=True)
        return (attitude * turn).as_quat(scalar_first=True)

    return with_values(log, "attitude", attitudes)


def mirrored(log):
    log = with_values(log, "attitude", lambda q: q * [1, -1, 1, -1])
    log = with_values(log, "position", lambda p: p * [1, -1, 1])
    return with_values(log, "gyro", lambda w: w * [-1, 1, -1])


def stuck(log):
    def frozen(p):
        p = p.copy()
        p[500:, 2] = p[500, 2]
        return p

    return with_values(log, "position", frozen)


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda log: late(log, "position", 0.3), ("position are 300 ms late",)),
        (lambda log: late(log, "encoders", -0.2), ("joint positions are 200 ms early",)),
        (joint_zero, ("the zero of q:arm_joint3 is 0.0999 rad",)),
        (exchanged_joints, ("q:arm_joint2 and q:arm_joint3 are exchanged",)),
        (turned_base, ("other axes of the base", "-y, x, z")),
        (mirrored, ("left-handed", "along y")),
        (stuck, ("position is stuck", "z does not change after 5 s")),
    ],
)
@pytest.mark.slow
def test_the_cause_is_named_with_its_size(spoil, words, spacecraft, case, log):
    checked = replace(check_log(spacecraft, log), head=spoil(log))
    cause = likely_cause(spacecraft, checked, case.suite)
    assert all(word in cause for word in words), cause


@pytest.mark.slow
def test_a_forgotten_payload_of_the_base_is_named(spacecraft, case):
    """The base's payload has about a tenth of its mass, and is 15 cm from its centre of mass."""
    tree = spacecraft.tree
    body, place = tree.bodies[0], np.array([-0.1, 0.0, 0.1])
    share = 1.0 / (body.mass + 1.0)
    heavier = replace(
        body,
        mass=body.mass + 1.0,
        p_BBcm=(1 - share) * body.p_BBcm + share * place,
        I_BBcm=body.I_BBcm + (1 - share) * point_mass_inertia(1.0, place - body.p_BBcm),
    )
    true = replace(tree, bodies=(heavier, *tree.bodies[1:]))
    log = add_noise(case.suite, ideal_samples(case, true, spacecraft.joint_names), 1)
    checked = replace(check_log(spacecraft, log), head=log)
    cause = likely_cause(spacecraft, checked, case.suite)
    assert f"body '{body.name}' differ" in cause, cause


@pytest.mark.slow
def test_a_log_of_two_motions_is_not_explained_by_an_impossible_body(spacecraft, case, log):
    half = {n: s.where(s.time < 5.0) for n, s in log.items()}
    jumped = {}
    for name, samples in half.items():
        later = log[name].where(log[name].time < 4.9)
        time = np.concatenate([samples.time, later.time + 5.05])
        jumped[name] = Samples(time, np.concatenate([samples.value, later.value]))
    joined = log.updated(jumped)
    checked = replace(check_log(spacecraft, log), head=joined)
    assert "mass, centre of mass" not in likely_cause(spacecraft, checked, case.suite)


@pytest.mark.slow
def test_a_constant_force_is_named_with_its_size(spacecraft, case):
    push = Firing(0.0, np.array([0.0, 0.0, 0.0, 2.0, 0.0, 0.0]), case.duration)
    pushed = replace(case, firings=(push,))
    log = add_noise(case.suite, ideal_samples(pushed, spacecraft.tree, spacecraft.joint_names), 1)
    cause = likely_cause(spacecraft, check_log(spacecraft, log), case.suite)
    assert "a constant force of about [0.2," in cause, cause


def test_a_good_log_has_no_cause(spacecraft, case, log):
    assert likely_cause(spacecraft, check_log(spacecraft, log), case.suite) == ""


def test_the_first_doubt_of_an_answer_names_the_cause(spacecraft, log):
    found = identify(spacecraft, late(log, "encoders", 0.3))
    assert "joint positions are 300 ms late" in found.doubts[0]
