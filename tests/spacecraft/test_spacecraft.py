"""Model files as spacecraft: any tree on a free base is read right, and all else is refused."""

from dataclasses import replace

import numpy as np
import pytest
from model_parts import INERTIA, joint, link, urdf
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.systems.framework import DiagramBuilder
from scipy.spatial.transform import Rotation

from cpid_drake import InputError, Motion, Spacecraft
from cpid_drake.dynamics.momentum import momentum_samples
from cpid_drake.files.resources import models_directory

# -- models --------------------------------------------------------------------------------------

TWO_LINKS = urdf(link("base", 50.0), link("arm"), joint("j", "base", "arm"))


def s_link(name, mass=10.0, pose="0 0 0 0 0 0", **inertia) -> str:
    values = "".join(f"<{key}>{value}</{key}>" for key, value in (INERTIA | inertia).items())
    return (
        f'<link name="{name}"><pose>{pose}</pose><inertial><pose>0.1 -0.2 0.3 0.2 0.1 -0.3</pose>'
        f"<mass>{mass}</mass><inertia>{values}</inertia></inertial></link>"
    )


def s_joint(name, parent, child, kind="revolute", axis="0.6 0 0.8", inner="") -> str:
    body = "" if kind == "fixed" else f"<axis><xyz>{axis}</xyz></axis>"
    return (
        f'<joint name="{name}" type="{kind}"><pose>0.05 0.1 -0.2 0.1 0.2 0.3</pose>'
        f"<parent>{parent}</parent><child>{child}</child>{body}{inner}</joint>"
    )


def sdf(*parts) -> str:
    return (
        '<?xml version="1.0"?><sdf version="1.9" xmlns:drake="http://drake.mit.edu">'
        f'<model name="two">{"".join(parts)}</model></sdf>'
    )


ARM_POSE = "0.5 -0.1 0.2 0.3 -0.2 0.4"
HAND_POSE = "0.9 0.3 0.1 -0.5 0.6 0.2"


def mjcf(rest="") -> str:
    inertial = '<inertial pos="0.1 -0.2 0.3" mass="{}" fullinertia="2 3 4 0.1 -0.2 0.3"/>'
    return f"""<mujoco model="two"><worldbody><body name="base"><freejoint/>{inertial.format(50)}
        <body name="arm" pos="0.5 -0.1 0.2" euler="20 -30 40">
        <joint name="j" type="hinge" axis="0.6 0 0.8" pos="0.1 0.2 -0.3"/>{inertial.format(10)}
        <body name="hand" pos="0.3 0 0"><joint name="k" type="slide" axis="0 1 0" pos="0 0.2 0"/>
        {inertial.format(1)}</body></body></body></worldbody>{rest}</mujoco>"""


@pytest.fixture
def load(tmp_path):
    """Return a function (text, ending, ...) -> Spacecraft of a file with this text."""

    def make(text, ending=".urdf", *, base="base", capture_frame="arm", **options):
        path = tmp_path / f"model{ending}"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return Spacecraft(path, base=base, capture_frame=capture_frame, **options)

    return make


@pytest.fixture
def refusal(load):
    """Return a function that loads what must be refused, and gives the message."""

    def make(*args, **options) -> str:
        with pytest.raises(InputError) as caught:
            load(*args, **options)
        message = str(caught.value)
        assert "\n" not in message
        return message

    return make


def random_telemetry(joint_names, n=8, seed=0) -> Motion:
    rng = np.random.default_rng(seed)
    return Motion(
        joint_names,
        np.arange(n, dtype=float),
        quaternion_WB=Rotation.random(n, rng).as_quat(scalar_first=True),
        p_WB=rng.normal(size=(n, 3)),
        w_WB=rng.normal(size=(n, 3)),
        v_WB=rng.normal(size=(n, 3)),
        q=rng.uniform(-2, 2, size=(n, len(joint_names))),
        qdot=rng.normal(size=(n, len(joint_names))),
    )


def assert_close(ours, theirs):
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-12 * max(1.0, np.abs(theirs).max()))


def assert_drake_agrees(spacecraft):
    """The NumPy recursion and Drake's kinematics give the same momentum and the same motion."""
    telemetry = random_telemetry(spacecraft.joint_names)
    ours = momentum_samples(spacecraft.tree, telemetry)
    context = spacecraft.plant.CreateDefaultContext()
    for k, state in enumerate(spacecraft.to_states(telemetry)):
        spacecraft.plant.SetPositionsAndVelocities(context, state)
        theirs = spacecraft.momentum_sample(context)
        assert_close(ours.P[k], theirs.P[0])
        assert_close(ours.L[k], theirs.L[0])
        for name in ("R_WC", "p_WC", "w_WC", "v_WC"):
            assert_close(getattr(ours.motion, name)[k], getattr(theirs.motion, name)[0])


# -- what can be read ----------------------------------------------------------------------------


def test_fixed_joints_and_massless_bodies_agree_with_drake(load):
    parts = [
        link("base", 50.0),
        link("panel", 5.0),
        '<link name="bracket"/>',
        link("arm"),
        '<link name="tip"/>',
        joint("f", "base", "panel", "fixed"),
        joint("g", "base", "bracket", "fixed"),
        joint("j", "bracket", "arm"),
        joint("h", "arm", "tip", "fixed"),
    ]
    spacecraft = load(urdf(*parts), capture_frame="tip")
    assert spacecraft.joint_names == ("j",)
    assert spacecraft.mass == pytest.approx(65.0)
    assert_drake_agrees(spacecraft)


def test_a_branched_tree_agrees_with_drake(load):
    """Two arms, one of them with a sliding joint; C is on the second."""
    parts = [link("base", 50.0)]
    parent = {"a": "base", "b": "a", "c": "base", "d": "c", "e": "c"}
    for k, (name, inboard) in enumerate(parent.items()):
        kind = "prismatic" if name in "bd" else "revolute"
        parts += [link(name, 3.0 + k), joint(f"j_{name}", inboard, name, kind)]
    spacecraft = load(urdf(*parts), capture_frame="d")
    assert set(spacecraft.joint_names) == {f"j_{name}" for name in parent}
    assert_drake_agrees(spacecraft)


@pytest.mark.parametrize("kind", ["revolute", "prismatic", "fixed"])
def test_a_joint_that_points_towards_the_base_agrees_with_drake(load, kind):
    """In the file the hand is the arm's parent; seen from the base it is its child."""
    parts = [
        s_link("base", 50.0),
        s_link("arm", pose=ARM_POSE),
        s_link("hand", pose=HAND_POSE),
        s_joint("j", "base", "arm"),
        s_joint("k", "hand", "arm", kind, axis="0 0.6 -0.8"),
    ]
    assert_drake_agrees(load(sdf(*parts), ".sdf", capture_frame="hand"))


def test_a_base_that_is_a_child_in_the_file_floats(load):
    """The model's tree begins at the arm; seen from either end, momentum is Drake's."""
    text = sdf(s_link("base"), s_link("arm", pose=ARM_POSE), s_joint("j", "arm", "base"))
    assert_drake_agrees(load(text, ".sdf"))
    assert_drake_agrees(load(text, ".sdf", base="arm", capture_frame="base"))


def test_a_capture_frame_with_an_offset_pose_agrees_with_drake(load):
    frame = f'<frame name="grip" attached_to="arm"><pose>{HAND_POSE}</pose></frame>'
    parts = [s_link("base"), s_link("arm", pose=ARM_POSE), s_joint("j", "base", "arm"), frame]
    spacecraft = load(sdf(*parts), ".sdf", capture_frame="grip")
    assert spacecraft.capture_frame.name() == "grip"
    assert_drake_agrees(spacecraft)


@pytest.mark.parametrize("capture_frame", ["arm", "hand"])
def test_joints_beside_the_origins_of_their_bodies_agree_with_drake(load, capture_frame):
    assert_drake_agrees(load(mjcf(), ".xml", capture_frame=capture_frame))


TWO_ARMS = """directives:
- add_model: {name: bus, file: package://mine/model.urdf}
- add_model: {name: left, file: package://mine/arm.urdf}
- add_model: {name: right, file: package://mine/arm.urdf}
- add_weld: {parent: "bus::arm", child: "left::root"}
- add_weld: {parent: "bus::base", child: "right::root"}
"""


@pytest.fixture
def two_arms(load, tmp_path):
    """Return a function that loads two instances of one arm model on one bus."""
    arm = urdf(link("root", 1.0), link("tip", 2.0), joint("turn", "root", "tip"), name="arm")
    (tmp_path / "arm.urdf").write_text(arm)
    (tmp_path / "model.urdf").write_text(TWO_LINKS)

    def make(**names):
        return load(TWO_ARMS, ".dmd.yaml", packages={"mine": tmp_path}, **names)

    return make


OFFSET = "X_PC: {translation: [0.4, -0.3, 0.2], rotation: !Rpy {deg: [20, -30, 50]}}"


@pytest.mark.parametrize("order", ["parent: '{0}', child: '{1}'", "parent: '{1}', child: '{0}'"])
def test_a_weld_with_an_offset_may_be_written_from_either_end(two_arms, load, tmp_path, order):
    """The weld's child may be inboard of its parent: the tree is read outwards from the base."""
    two_arms(capture_frame="right::tip")  # writes the arms' files
    weld = order.format("bus::arm", "left::root")
    text = TWO_ARMS.replace('parent: "bus::arm", child: "left::root"', f"{weld}, {OFFSET}")
    assert OFFSET in text
    options = dict(capture_frame="left::tip", packages={"mine": tmp_path})
    assert_drake_agrees(load(text, ".dmd.yaml", **options))


def test_a_name_that_is_not_unique_must_be_scoped(two_arms):
    with pytest.raises(InputError, match="scope a name as INSTANCE::NAME"):
        two_arms(capture_frame="tip")


def test_a_configuration_is_in_radians_and_finite(load):
    """A position beyond the limits is accepted; an angle in degrees is not."""
    spacecraft = load(TWO_LINKS)
    for value in (2.5, 2.6, -2.1, 1e6):
        np.testing.assert_array_equal(spacecraft.configuration({"j": value}, "here"), [value])
    np.testing.assert_array_equal(spacecraft.configuration({}, "here"), [0.0])
    with pytest.raises(InputError, match=r"outside \[-2, 2.5\]; .* -30 degrees are -0.5236$"):
        spacecraft.configuration({"j": -30.0}, "here")
    for value in (np.nan, np.inf):
        with pytest.raises(InputError, match=r"^here: j = .* is not a finite number$"):
            spacecraft.configuration({"j": value}, "here")
    with pytest.raises(InputError, match=r"^here: no joint 'elbow'; choose from j$"):
        spacecraft.configuration({"elbow": 0.0}, "here")


# -- what is refused -----------------------------------------------------------------------------


def test_a_moving_link_with_a_geometry_needs_an_inertia(refusal, load):
    box = '<visual><geometry><box size="1 1 1"/></geometry></visual>'
    hollow = f'<link name="tube">{box}</link>'
    parts = link("base", 50.0), link("arm"), joint("j", "base", "arm")
    moving = urdf(*parts, hollow, joint("k", "arm", "tube"))
    assert "link 'tube' moves and has a geometry but no <inertial>" in refusal(moving)
    wheel = '<inertial><mass value="2"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
    says = refusal(moving).replace('"M"', '"2"').replace('"A"', '"1"').replace('"C"', '"1"')
    assert f"write in it {wheel}</inertial>" in says
    filled = moving.replace(hollow, hollow.replace(box, f"{wheel}</inertial>{box}"))
    assert load(filled).mass == pytest.approx(62.0)
    # A cover that is fixed to a link, and a link between two joints, have no mass of their own.
    load(urdf(*parts, hollow, joint("k", "arm", "tube", "fixed")), capture_frame="arm")
    between = '<link name="tube"/>', link("hand"), joint("k", "arm", "tube")
    load(urdf(*parts, *between, joint("l", "tube", "hand")), capture_frame="arm")


@pytest.mark.parametrize(
    "equality",
    [
        '<connect body1="base" body2="hand" anchor="0 0 0"/>',
        '<joint joint1="j" joint2="k"/>',
        '<weld body1="base" body2="hand"/>',
    ],
    ids=["connect", "joint", "weld"],
)
def test_an_equality_constraint_is_refused(refusal, equality):
    """Those that Drake does not read too: it only warns that it leaves them out."""
    assert "equality" in refusal(mjcf(rest=f"<equality>{equality}</equality>"), ".xml")


IMPOSSIBLE = {
    "triangle inequality": {"ixx": 90.0},
    "negative moment": {"ixx": -1.0, "iyy": -1.0, "izz": -1.0},
    "product too large": {"ixy": 9.0},
    "negative mass": {"mass": -5.0},
    "no mass but inertia": {"mass": 0.0},
}


@pytest.mark.parametrize("name", IMPOSSIBLE)
def test_an_inertia_that_no_body_has_is_refused(refusal, name):
    """Drake puts another inertia in its place and only warns; the answer would be wrong."""
    changes = IMPOSSIBLE[name]
    message = refusal(urdf(link("base"), link("arm", **changes), joint("j", "base", "arm")))
    assert "inertia" in message
    parts = [s_link("base"), s_link("arm", pose=ARM_POSE, **changes), s_joint("j", "base", "arm")]
    assert "inertia" in refusal(sdf(*parts), ".sdf")


# -- plants with a target ------------------------------------------------------------------------


@pytest.mark.parametrize("flaw", ["discrete", "occupied", "finalized"])
def test_a_plant_that_cannot_be_used_is_refused(servicer, paper_target, flaw):
    plant = MultibodyPlant(time_step=0.01 if flaw == "discrete" else 0.0)
    if flaw == "occupied":
        servicer_file = "package://cpid_drake_models/paper_target/paper_target.urdf"
        parser = Parser(plant)
        parser.package_map().Add("cpid_drake_models", models_directory())
        parser.AddModels(url=servicer_file)
    if flaw == "finalized":
        plant.Finalize()
    with pytest.raises(InputError, match="empty, not finalized, and continuous"):
        servicer.add_to(plant, paper_target)


def test_gravity_is_off_everywhere(load, paper_target):
    """At rest nothing accelerates, whatever the model file says of gravity."""
    model = sdf(s_link("base"), s_link("arm", pose=ARM_POSE), s_joint("j", "base", "arm"))
    text = model.replace("<model", '<world name="w"><gravity>0 0 -5</gravity><model').replace(
        "</model>", "</model></world>"
    )
    spacecraft = load(text, ".sdf")
    at_rest = random_telemetry(("j",), n=1)
    zero = np.zeros((1, 3))
    state = spacecraft.to_states(replace(at_rest, w_WB=zero, v_WB=zero))[0]
    for plant in (spacecraft.plant, spacecraft.make_simulation_plant(paper_target)):
        context = plant.CreateDefaultContext()
        plant.SetPositionsAndVelocities(context, state)
        plant.SetVelocities(context, np.zeros(plant.num_velocities()))
        vdot = plant.EvalTimeDerivatives(context).get_generalized_velocity().CopyToVector()
        assert np.abs(vdot).max() < 1e-12
        plant.SetVelocities(context, state[plant.num_positions() :])
        vdot = plant.EvalTimeDerivatives(context).get_generalized_velocity().CopyToVector()
        assert np.abs(vdot).max() > 1e-3  # moving joints do accelerate


BOX = '<collision><geometry><box size="2 2 2"/></geometry></collision>'
OVERLAPPING = urdf(
    link("base", inner=BOX),
    link("arm"),
    link("hand", inner=BOX),
    joint("j", "base", "arm"),
    joint("k", "arm", "hand"),
)


def contact_force(plant, diagram) -> float:
    context = plant.GetMyContextFromRoot(diagram.CreateDefaultContext())
    forces = [
        np.abs(plant.get_generalized_contact_forces_output_port(instance).Eval(context))
        for instance in {plant.get_body(k).model_instance() for k in plant.GetFloatingBaseBodies()}
    ]
    return float(np.max(forces))


def test_contact_is_off_in_a_plant_with_geometry(load, paper_target):
    """A gripped target touches the gripper; contact forces on top of the weld would be wrong."""
    spacecraft = load(OVERLAPPING, capture_frame="hand")
    builder = DiagramBuilder()
    plant = MultibodyPlant(time_step=0.0)
    _, scene_graph = AddMultibodyPlantSceneGraph(builder, plant)
    spacecraft.add_to(plant, paper_target, scene_graph=scene_graph)
    assert plant.num_collision_geometries() == 2
    assert contact_force(plant, builder.Build()) == 0.0
