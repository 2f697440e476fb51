"""Joints that follow another one: one coordinate of the spacecraft, several joints of a plant."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from model_parts import joint, link, moments, urdf
from scipy.stats import chi2
from sensing_cases import Sines, coarse_suite, measured, mimic, nees, small_craft

from cpid_drake import (
    InertialParameters,
    InputError,
    Motion,
    Spacecraft,
    identify,
    load_scenario,
    make_simulation,
    write_log,
)
from cpid_drake.dynamics.body_dynamics import BodyDynamics
from cpid_drake.dynamics.momentum import momentum_samples
from cpid_drake.logs.simulated_noise import add_noise
from cpid_drake.spacecraft.target_export import export_target

GRIPPER = {
    "oppose": (-1.5, 0.03, "grip"),
    "bend": (-3.0, 0.46, "grip"),
    "fold": (-0.5, -0.3, "shoulder"),
}
"""Multiplier, offset and leader of each joint that follows, by the model: bend follows oppose."""


@pytest.fixture(scope="module")
def craft(tmp_path_factory) -> Spacecraft:
    return small_craft(tmp_path_factory.mktemp("craft"), gripper=True)


def test_the_joints_are_those_that_lead(craft):
    assert set(craft.joint_names) == {"shoulder", "slide", "elbow", "roll", "grip"}
    assert craft.plant.num_velocities() == 6 + 8


def test_momentum_is_drakes_with_each_joint_where_the_model_has_it(craft, random_motion):
    motion, plant = random_motion(6, 3, craft), craft.plant
    ours, context = momentum_samples(craft.tree, motion), craft.plant.CreateDefaultContext()
    for k, state in enumerate(craft.to_states(motion)):
        plant.SetPositionsAndVelocities(context, state)
        for name, (multiplier, offset, leader) in GRIPPER.items():
            j = craft.joint_names.index(leader)
            own = plant.GetJointByName(name)
            place = multiplier * motion.q[k, j] + offset
            if hasattr(own, "set_angle"):
                own.set_angle(context, place)
                own.set_angular_rate(context, multiplier * motion.qdot[k, j])
            else:
                own.set_translation(context, place)
                own.set_translation_rate(context, multiplier * motion.qdot[k, j])
        theirs = craft.momentum_sample(context)
        np.testing.assert_allclose(ours.P[k], theirs.P[0], atol=1e-11)
        np.testing.assert_allclose(ours.L[k], theirs.L[0], atol=1e-11)
        np.testing.assert_allclose(ours.p_WKcm[k], theirs.p_WKcm[0], atol=1e-12)


def test_states_and_motions_are_inverse(craft, random_motion):
    motion = random_motion(4, 5, craft)
    again = craft.to_motion(motion.time, craft.to_states(motion))
    np.testing.assert_array_equal(again.q, motion.q)
    np.testing.assert_array_equal(again.qdot, motion.qdot)


def test_an_export_has_the_same_gripper(craft, tmp_path, skewed_target, random_motion):
    export_target(tmp_path / "out.urdf", skewed_target, format="urdf", spacecraft=craft)
    again = Spacecraft(tmp_path / "out.urdf", base="base", capture_frame="hand")
    assert again.joint_names == craft.joint_names
    motion = random_motion(6, 3, craft)
    held = craft.tree.with_target(skewed_target.to_standard_vector())
    ours, theirs = momentum_samples(held, motion), momentum_samples(again.tree, motion)
    np.testing.assert_allclose(theirs.P, ours.P, atol=1e-10)
    np.testing.assert_allclose(theirs.L, ours.L, atol=1e-10)
    with pytest.raises(InputError, match="which is written in format urdf or drake-yaml"):
        export_target(tmp_path / "out.sdf", skewed_target, format="sdf", spacecraft=craft)


FINGERS = (
    link("base", 50.0),
    link("left", 2.0),
    link("right", 2.0),
    joint("a", "base", "left", "prismatic"),
    joint("b", "base", "right", "prismatic"),
)


def load(tmp_path, *parts: str, ending: str = ".urdf", capture_frame: str = "left") -> Spacecraft:
    path = tmp_path / f"model{ending}"
    path.write_text(urdf(*parts) if ending == ".urdf" else parts[0])
    return Spacecraft(path, base="base", capture_frame=capture_frame)


def test_a_joint_that_follows_a_fixed_one_stands_at_its_offset(tmp_path):
    follows = FINGERS[4].replace("</joint>", mimic("a", 2.0, 0.25))
    fixed = load(tmp_path, *FINGERS[:3], FINGERS[3].replace("prismatic", "fixed"), follows)
    assert fixed.joint_names == ()
    free = load(tmp_path, *FINGERS[:3], FINGERS[3].replace("prismatic", "fixed"), FINGERS[4])
    q, qdot = np.array([[0.25]]), np.zeros((1, 1))
    expected = com(free, q, qdot)
    np.testing.assert_allclose(com(fixed, q[:, :0], qdot[:, :0]), expected, atol=1e-12)


def com(craft: Spacecraft, q, qdot) -> np.ndarray:
    return BodyDynamics.at(craft.tree, q, qdot).p_BK


def test_a_fixed_joint_follows_none(tmp_path):
    """Some published grippers have it; other readers leave it out."""
    follows = FINGERS[4].replace("prismatic", "fixed").replace("</joint>", mimic("a"))
    assert load(tmp_path, *FINGERS[:4], follows).joint_names == ("a",)


def test_sdf_says_the_same(tmp_path):
    text = (
        '<sdf version="1.11"><model name="m"><link name="base"><inertial><mass>9</mass></inertial>'
        '</link><link name="left"><inertial><mass>2</mass></inertial></link><link name="right">'
        "<inertial><mass>2</mass></inertial></link>{}{}</model></sdf>"
    )
    axis = (
        '<joint name="{}" type="prismatic"><parent>base</parent><child>{}</child><axis>'
        "<xyz>0 1 0</xyz>{}</axis></joint>"
    )
    own = (
        '<mimic joint="a"><multiplier>-2</multiplier><offset>.1</offset>'
        "<reference>.3</reference></mimic>"
    )
    text = text.format(axis.format("a", "left", ""), axis.format("b", "right", own))
    craft = load(tmp_path, text, ending=".sdf")
    [follower] = [body for body in craft.tree.bodies if body.follows]
    assert (follower.joint, follower.multiplier) == (0, -2.0)
    np.testing.assert_allclose(follower.p_PF, [0, 0.1 + 2 * 0.3, 0])


def test_two_instances_have_two_grippers(tmp_path):
    (tmp_path / "hand.urdf").write_text(
        urdf(*FINGERS[:4], FINGERS[4].replace("</joint>", mimic("a", -1.0)), name="hand")
    )
    path = tmp_path / "two.dmd.yaml"
    path.write_text(
        "directives:\n- add_model: {name: l, file: package://mine/hand.urdf}\n"
        "- add_model: {name: r, file: package://mine/hand.urdf}\n"
        "- add_weld: {parent: l::base, child: r::base, X_PC: {translation: [1, 0, 0]}}\n"
    )
    craft = Spacecraft(
        path, base="l::base", capture_frame="l::left", packages={"mine": str(tmp_path)}
    )
    assert craft.joint_names == ("l::a", "r::a")
    moved = com(craft, np.eye(2), np.zeros((2, 2)))
    single = load(tmp_path, *FINGERS[:4], FINGERS[4].replace("</joint>", mimic("a", -1.0)))
    ahead = com(single, np.ones((1, 1)), np.zeros((1, 1))) - com(single, *np.zeros((2, 1, 1)))
    at_rest = com(craft, np.zeros((1, 2)), np.zeros((1, 2)))
    np.testing.assert_allclose(moved - at_rest, ahead / 2 + np.zeros((2, 3)), atol=1e-12)


def test_a_name_that_follows_in_one_file_only_is_refused(tmp_path):
    (tmp_path / "l.urdf").write_text(urdf(*FINGERS))
    follows = FINGERS[4].replace("</joint>", mimic("a", -1.0))
    (tmp_path / "r.urdf").write_text(urdf(*FINGERS[:4], follows))
    path = tmp_path / "two.dmd.yaml"
    path.write_text(
        "directives:\n- add_model: {name: l, file: package://mine/l.urdf}\n"
        "- add_model: {name: r, file: package://mine/r.urdf}\n"
        "- add_weld: {parent: l::base, child: r::base}\n"
    )
    with pytest.raises(InputError, match="joint 'b' follows another one in one file"):
        Spacecraft(path, base="l::base", capture_frame="l::left", packages={"mine": str(tmp_path)})


@pytest.mark.parametrize("seed", range(5))
def test_a_target_is_identified_with_a_gripper_that_moves(craft, skewed_target, seed):
    """The log has the joints that lead; hidden errors are as large as stated."""
    motion = Sines.drawn(5, seed=seed, duration=6.0, size=0.5)
    suite = coarse_suite()
    log = add_noise(suite, measured(craft, motion, skewed_target, suite), seed=seed)
    found = identify(craft, log, sensors=suite, known_bodies="exact")
    assert not found.failures
    assert found.intervals[0, 0] < skewed_target.mass < found.intervals[0, 1]
    assert nees(found, skewed_target) < chi2.ppf(0.999, 10)


SCENARIO = """
spacecraft: {{model: {model}, base: base, capture_frame: hand}}
target: {{mass: 60.0, p_CTcm_C: [0.5, -0.12, 0.08],
  I_TTcm_C: [[8.0, -0.7, 0.4], [-0.7, 11.0, 0.9], [0.4, 0.9, 6.0]]}}
joint_motion: !MultiSineMotion
  duration: 4.0
  ramp: 1.0
  frequencies: [0.4]
  centre: {{grip: 0.1}}
  amplitudes: {{shoulder: [0.5], slide: [0.2], elbow: [0.6], roll: [0.7], grip: [0.15]}}
  phases: {{shoulder: [0.0], slide: [1.0], elbow: [2.0], roll: [3.0], grip: [4.0]}}
identification: {{rows: standard, period: 0.25, offset: 0.25}}
simulation: {{duration: 4.0, log_period: 0.125}}
"""


def test_a_diagram_moves_all_joints_and_finds_the_target(craft, tmp_path, skewed_target):
    """By Drake's dynamics: the controller drives each joint as the model couples them."""
    path = tmp_path / "gripper.yaml"
    path.write_text(SCENARIO.format(model=craft.path))
    simulation = make_simulation(load_scenario(path))
    root = simulation.run()
    plant, context = simulation.plant, simulation.plant.GetMyContextFromRoot(root)
    motion = simulation.motion(root)
    for name, (multiplier, offset, leader) in GRIPPER.items():
        k = plant.GetJointByName(name).position_start()
        expected = multiplier * motion.q[-1, craft.joint_names.index(leader)] + offset
        assert plant.GetPositions(context)[k] == pytest.approx(expected, abs=1e-6)
    assert np.ptp(motion.q[:, craft.joint_names.index("grip")]) > 0.1
    found = simulation.identification(root)
    np.testing.assert_allclose(found.parameters, skewed_target.to_vector(), atol=1e-4)


LIGHT = (
    link("base", 400.0),
    link("arm", 20.0),
    link("finger", 0.2, **moments(1e-3, 1e-3, 1e-3)),
    link("other", 0.2, **moments(1e-3, 1e-3, 1e-3)),
    link("panel", 30.0),
    joint("turn", "base", "arm", limits=(-9, 9)),
    joint("grip", "arm", "finger", "prismatic", limits=(0.0, 0.1)),
    joint("also", "arm", "other", "prismatic", limits=(-0.1, 0.0)).replace(
        "</joint>", mimic("grip", -1.0)
    ),
)


class TestUnlogged:
    """A gripper whose fingers nobody logs is where the model has it; anything larger is refused."""

    def log(self, craft, joints: int, **changes):
        motion, suite = Sines.drawn(joints, seed=4, duration=4.0, size=0.6), coarse_suite()
        target = InertialParameters(60.0, [0.5, -0.12, 0.08], np.diag([8.0, 11.0, 6.0]))
        return measured(craft, motion, target, suite), suite

    def test_fingers_are_fixed_and_what_that_could_change_is_said(self, tmp_path):
        craft = load(tmp_path, *LIGHT[:4], *LIGHT[5:], capture_frame="arm")
        log, suite = self.log(craft.locked(["grip"]), 1)
        found = identify(craft, log, sensors=suite, known_bodies="exact", momentum="zero")
        [said] = [text for text in found.warnings if "grip" in text]
        assert "grip is not logged, and fixed at 0 m: over its range it moves" in said
        # Two equal masses that move in opposite senses move no centre of mass.
        assert "centre of mass by 0 mm" in said

    @pytest.mark.parametrize(
        "command",
        [
            ("log", "check"),
            ("log", "map"),
            ("identify",),
            ("live", "replay", "--no-show", "--rate", "50", "--sensors", "testbed"),
        ],
        ids=lambda words: words[-1] if len(words) < 3 else words[1],
    )
    def test_all_commands_that_read_a_log_fix_them(self, tmp_path, run_cpid, command):
        craft = load(tmp_path, *LIGHT[:4], *LIGHT[5:], capture_frame="arm")
        log, suite = self.log(craft.locked(["grip"]), 1)
        write_log(tmp_path / "log.csv", add_noise(suite, log, seed=1))
        names = ("--model", craft.path, "--base", "base", "--capture-frame", "arm")
        code, stdout, stderr = run_cpid(*command, tmp_path / "log.csv", *names)
        assert code in (0, 3), stderr
        assert "grip is not logged, and fixed at 0 m" in stdout + stderr

    def test_a_shift_is_mass_by_travel_over_all_mass(self, tmp_path):
        craft = load(tmp_path, *LIGHT[:3], *LIGHT[5:7], capture_frame="arm")
        log, suite = self.log(craft.locked(["grip"]), 1)
        found = identify(craft, log, sensors=suite, known_bodies="exact")
        expected = 1e3 * 0.2 * 0.1 / 420.2
        assert any(f"centre of mass by {expected:.2g} mm" in text for text in found.warnings)

    def test_a_joint_whose_zero_is_beyond_its_limits_is_at_the_nearest(self, tmp_path):
        """As in Astrobee's gripper, whose joints are 0.35 to 0.7 rad."""
        grip = LIGHT[6].replace('lower="0.0"', 'lower="0.03"')
        craft = load(tmp_path, *LIGHT[:3], LIGHT[5], grip, capture_frame="arm")
        fixed = craft.locked(["grip"])
        [finger] = [body for body in fixed.tree.bodies if body.name == "finger"]
        [free] = [body for body in craft.tree.bodies if body.name == "finger"]
        np.testing.assert_allclose(finger.p_PF, free.p_PF + 0.03 * free.R_PF @ free.axis_F)
        log, suite = self.log(fixed, 1)
        found = identify(craft, log, sensors=suite, known_bodies="exact")
        assert any("grip is not logged, and fixed at 0.03 m" in each for each in found.warnings)

    @pytest.mark.parametrize(
        ("parts", "capture_frame", "says"),
        [
            ((*LIGHT[:2], LIGHT[4], LIGHT[5], joint("fold", "base", "panel")), "arm", "q:fold"),
            ((*LIGHT[:3], *LIGHT[5:7]), "finger", "no column 'q:grip'; the spacecraft's joints"),
        ],
        ids=["a large panel", "a joint that carries the target"],
    )
    def test_what_matters_must_be_logged(self, tmp_path, parts, capture_frame, says):
        craft = load(tmp_path, *parts, capture_frame=capture_frame)
        missing = "fold" if "fold" in craft.joint_names else "grip"
        log, suite = self.log(craft.locked([missing]), 1)
        with pytest.raises(InputError, match=says):
            identify(craft, log, sensors=suite, known_bodies="exact")


def test_a_locked_joint_stays_locked_in_a_copy(craft, random_motion):
    fixed = pickle.loads(pickle.dumps(craft.locked(["grip"])))
    assert fixed.joint_names == tuple(name for name in craft.joint_names if name != "grip")
    motion = random_motion(3, 7, craft)
    k = craft.joint_names.index("grip")
    moves = np.arange(5) != k
    still = replace(motion, q=motion.q * moves, qdot=motion.qdot * moves)
    less = Motion(
        fixed.joint_names,
        *(getattr(still, name) for name in ("time", "quaternion_WB", "p_WB", "w_WB", "v_WB")),
        q=np.delete(still.q, k, 1),
        qdot=np.delete(still.qdot, k, 1),
    )
    ours, theirs = momentum_samples(fixed.tree, less), momentum_samples(craft.tree, still)
    np.testing.assert_allclose(ours.L, theirs.L, atol=1e-11)
    np.testing.assert_array_equal(fixed.to_states(less), craft.to_states(still))
