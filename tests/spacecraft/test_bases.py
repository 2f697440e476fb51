"""Bases as model files have them: each is the body that floats, and the motion is the same."""

import numpy as np
import pytest
from model_parts import joint, link, urdf

from cpid_drake import InputError, Spacecraft
from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.kinematics import forward_kinematics
from cpid_drake.dynamics.momentum import momenta
from cpid_drake.spacecraft.clearance import Clearance
from cpid_drake.spacecraft.floating_base import floating_joint

ARM = link("bus", 50.0), link("arm"), joint("j", "bus", "arm")
FREE = urdf(*ARM)


def on_world(kind: str, name: str = "world", inner: str = "") -> str:
    """Return the arm with its bus on a link of this name."""
    return urdf(f'<link name="{name}">{inner}</link>', *ARM, joint("w", name, "bus", kind))


def mjcf(free: str, around: str = "{}") -> str:
    body = (
        f'<body name="bus">{free}<inertial pos=".1 0 0" mass="50" diaginertia="5 5 5"/>'
        '<body name="arm" pos="1 0 0"><joint name="j" axis="0 0 1"/>'
        '<inertial pos=".2 0 0" mass="5" diaginertia=".1 .5 .5"/></body></body>'
    )
    return f'<mujoco model="m"><worldbody>{around.format(body)}</worldbody></mujoco>'


LEG = (
    '<body name="root" pos="0 0 1">{}<inertial pos="0 0 0" mass="2" diaginertia="1 1 1"/>{{}}'
    "</body>"
)
SDF = (
    '<sdf version="1.9"><model name="m">{}<link name="bus"><inertial><mass>50</mass></inertial>'
    '</link><link name="arm"><pose>1 0 0 0 0 0</pose></link><joint name="j" type="revolute">'
    "<parent>bus</parent><child>arm</child><axis><xyz>0 0 1</xyz></axis></joint></model></sdf>"
)

BASES = {
    "floating": (on_world("floating"), ".urdf", FREE),
    "floating from a frame": (on_world("floating", "odom"), ".urdf", FREE),
    "welded": (on_world("fixed"), ".urdf", FREE),
    "welded to a massless mount": (
        urdf(
            '<link name="world"/><link name="mount"/>',
            *ARM,
            joint("w", "world", "mount", "fixed"),
            joint("v", "mount", "bus", "fixed"),
        ),
        ".urdf",
        FREE,
    ),
    "after a footprint by a joint of the base's name": (
        on_world("fixed", "footprint").replace('name="w"', 'name="bus"'),
        ".urdf",
        FREE,
    ),
    "after a footprint": (on_world("fixed", "footprint"), ".urdf", FREE),
    "freejoint with a name": (mjcf('<freejoint name="root"/>'), ".xml", mjcf("<freejoint/>")),
    "no freejoint": (mjcf(""), ".xml", mjcf("<freejoint/>")),
    "freejoint of another body": (
        mjcf("", LEG.format("<freejoint/>")),
        ".xml",
        mjcf("", LEG.format("")),
    ),
    "SDF welded": (
        SDF.format('<joint name="w" type="fixed"><parent>world</parent><child>bus</child></joint>'),
        ".sdf",
        SDF.format(""),
    ),
}


@pytest.fixture
def load(tmp_path):
    def make(text: str, ending: str, name: str = "model", **names: str) -> Spacecraft:
        path = tmp_path / f"{name}{ending}"
        path.write_text(text)
        return Spacecraft(path, **{"base": "bus", "capture_frame": "arm"} | names)

    return make


def momentum(craft: Spacecraft) -> np.ndarray:
    rng = np.random.default_rng(1)
    q, qdot = rng.normal(size=(2, 5, len(craft.joint_names)))
    w, v = rng.normal(size=(2, 5, 3))
    bodies, _ = forward_kinematics(craft.tree, q, qdot, w_WB=w, v_WB=v)
    return np.concatenate([part.sum(axis=0) for part in momenta(craft.tree, bodies)])


@pytest.mark.parametrize("name", BASES)
def test_a_base_is_free_however_the_model_holds_it(load, name):
    text, ending, free = BASES[name]
    craft, other = load(text, ending), load(free, ending, "free")
    assert floating_joint(craft.plant, craft.base).num_velocities() == 6
    assert craft.joint_names == other.joint_names == ("j",)
    np.testing.assert_allclose(momentum(craft), momentum(other), atol=1e-12)


@pytest.mark.parametrize("name", BASES)
def test_the_plant_conserves_the_momentum_of_the_tree(load, name):
    """A plant with a target has the same free base: its state has the spacecraft's columns."""
    text, ending, _ = BASES[name]
    craft = load(text, ending)
    plant = craft.make_simulation_plant(InertialParameters(9.0, [0.1, 0, 0], np.eye(3)))
    columns = craft.columns_in(plant)
    assert sorted(columns) == list(range(plant.num_multibody_states()))


def test_what_is_freed_is_said_once(load, caplog):
    craft = load(on_world("fixed"), ".urdf")
    craft.make_simulation_plant(InertialParameters(9.0, [0.1, 0, 0], np.eye(3)))
    [said] = [each for each in caplog.messages if "welded to the world" in each]
    assert said.endswith("link 'bus' is welded to the world in the model, and floats freely here")
    load(on_world("floating"), ".urdf", "other")
    assert len(caplog.messages) == 1


def test_the_arm_of_directives_that_weld_it_to_the_world_is_freed(load, tmp_path):
    (tmp_path / "arm.urdf").write_text(on_world("floating"))
    text = (
        "directives:\n- add_model: {name: a, file: package://mine/arm.urdf}\n"
        "- add_model: {name: b, file: package://mine/arm.urdf}\n"
        "- add_weld: {parent: a::arm, child: b::bus}\n- add_weld: {parent: world, child: a::bus}\n"
    )
    path = tmp_path / "two.dmd.yaml"
    path.write_text(text)
    craft = Spacecraft(
        path, base="a::bus", capture_frame="b::arm", packages={"mine": str(tmp_path)}
    )
    assert craft.joint_names == ("a::j", "b::j")
    assert craft.mass == pytest.approx(120.0)


def test_relative_names_in_a_changed_model_keep_their_folder(load, tmp_path):
    """Drake reads a copy without the floating joint; an error names the user's file."""
    folder = tmp_path / "meshes"
    folder.mkdir()
    (folder / "o.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\n")
    shape = '<visual><geometry><mesh filename="meshes/o.obj"/></geometry></visual>'
    text = on_world("floating").replace("</link>", shape + "</link>", 2)
    craft = load(text, ".urdf")
    Clearance(craft, InertialParameters(9.0, [0.1, 0, 0], np.eye(3)))
    bad = text.replace('type="revolute"', 'type="hinge"')
    with pytest.raises(InputError, match=r"model.urdf: line 1: Joint 'j' has unrecognized type"):
        load(bad, ".urdf")


def test_the_world_is_no_base(load):
    with pytest.raises(InputError, match="the world is no base: name the link that floats"):
        load(on_world("fixed"), ".urdf", base="world")
