"""What a parser leaves out of a model: it is as MuJoCo reads it, or refused with what to do."""

import mujoco
import numpy as np
import pytest
from model_parts import INERTIA, joint, link, moments, urdf

from cpid_drake import InputError, Spacecraft

OWN = '<inertial pos="0.2 0 0" mass="5" diaginertia="0.1 0.5 0.5"/>'
BUS = '<inertial pos="0 0 0" mass="50" diaginertia="5 5 5"/>'
HINGE = '<joint name="j" axis="0 0 1"/>'
TWO = HINGE + '<joint name="k" axis="0 1 0"/>'
BODY = '<body name="e"><inertial pos="0 0 0" mass="7" diaginertia="1 1 1"/></body>'
MESH = '<asset><mesh name="t" vertex="0 0 0 1 0 0 0 1 0 0 0 1"/></asset>'


def mjcf(arm=OWN, head="", pose='pos="1 0 0"', joints=HINGE, bus=BUS, rest="") -> str:
    return (
        f'<mujoco model="s">{head}<worldbody><body name="bus"><freejoint/>{bus}<body name="arm" '
        f'{pose}>{joints}{arm}<body name="tip" pos="0.5 0 0"/></body></body></worldbody>{rest}'
        "</mujoco>"
    )


def geom(text: str) -> str:
    return f"<geom {text}/>"


READ = {
    "euler in degrees": mjcf(pose='pos="1 0 0" euler="0 90 30"'),
    "euler in radians": mjcf(head='<compiler angle="radian"/>', pose='euler="0 1 0.3"'),
    "order of euler": mjcf(head='<compiler eulerseq="zyx"/>', pose='euler="10 90 30"'),
    "fixed axes": mjcf(head='<compiler eulerseq="XYZ"/>', pose='euler="10 90 30"'),
    "axisangle": mjcf(pose='axisangle="0 1 0 30"'),
    "xyaxes": mjcf(pose='xyaxes="0 1 0 -1 0 0"'),
    "zaxis": mjcf(pose='zaxis="1 0 0"'),
    "quat of any length": mjcf(pose='quat="1 1 0 0"'),
    "joint beside the origin": mjcf(joints='<joint name="j" axis="0 0 1" pos="0.1 0.2 0"/>'),
    "axis of any length": mjcf(joints='<joint name="j" axis="0 0 3"/>'),
    "default axis": mjcf(joints='<joint name="j"/>'),
    "slide": mjcf(joints='<joint name="j" type="slide" axis="1 0 0"/>'),
    "ref": mjcf(joints='<joint name="j" axis="0 0 1" ref="30"/>'),
    "springs": mjcf(joints='<joint name="j" axis="0 0 1" springref="30" stiffness="2"/>'),
    "two joints without a pose": mjcf(pose="", joints=TWO),
    "box": mjcf(geom('type="box" size="0.5 0.05 0.05"')),
    "density": mjcf(geom('type="box" size="0.5 0.05 0.05" density="300"')),
    "pose of a geom": mjcf(
        geom('type="box" size=".5 .05 .05" mass="3" pos=".1 .2 .3" euler="10 20 30"')
    ),
    "geom beside an inertial": mjcf(OWN + geom('type="box" size="0.5 0.05 0.05"')),
    "inertia from geoms": mjcf(
        OWN + geom('type="box" size="0.5 0.05 0.05"'),
        '<compiler inertiafromgeom="true"/>',
        bus=geom('type="box" size=".3 .3 .3"'),
    ),
    "capsule from to": mjcf(geom('type="capsule" fromto="0 0 0 0.5 0 0" size="0.05"')),
    "cylinder from to": mjcf(geom('type="cylinder" fromto="0 0 0 0.5 0.2 0" size="0.05"')),
    "ellipsoid": mjcf(geom('type="ellipsoid" size="0.5 0.1 0.05"')),
    "default class": mjcf(
        geom('class="x" type="box" size=".1 .1 .1"') + geom('size="0.1"'),
        '<default><geom density="500"/><joint axis="0 1 0"/><default class="x"><geom mass="2"/>'
        "</default></default>",
        joints='<joint name="j"/>',
    ),
    "full inertia": mjcf('<inertial pos=".2 0 0" mass="5" fullinertia=".5 .6 .7 .01 .02 .03"/>'),
    "turned inertia": mjcf(
        '<inertial pos=".2 0 0" euler="10 20 30" mass="5" diaginertia=".5 .6 .7"/>'
    ),
    "free joint by type": mjcf().replace("<freejoint/>", '<joint type="free"/>'),
    "pose of the base": mjcf().replace('"bus">', '"bus" pos="1 2 3" euler="10 20 30">'),
    "sites and sensors": mjcf(
        OWN + '<site name="s"/>', rest='<sensor><jointpos joint="j"/></sensor>'
    ),
}


@pytest.fixture
def load(tmp_path):
    def make(text: str, ending: str = ".xml", capture_frame: str = "tip") -> Spacecraft:
        path = tmp_path / f"model{ending}"
        path.write_text(text)
        return Spacecraft(path, base="bus", capture_frame=capture_frame)

    return make


@pytest.mark.parametrize("name", READ)
def test_what_is_read_is_what_mujoco_reads(load, name):
    """Masses, centres of mass, inertias, and the poses at some joint positions."""
    craft, model = load(READ[name]), mujoco.MjModel.from_xml_string(READ[name])
    data, context = mujoco.MjData(model), craft.plant.CreateDefaultContext()
    for k, q in enumerate(np.linspace(0.4, -0.7, len(craft.joint_names))):
        own = model.joint(craft.joint_names[k])
        data.qpos[own.qposadr[0]] = q
        positions = craft.plant.GetPositions(context)
        positions[craft.state_columns["q"][k]] = q
        craft.plant.SetPositions(context, positions)
    mujoco.mj_forward(model, data)
    R_WB, p_WB = data.body("bus").xmat.reshape(3, 3), data.body("bus").xpos
    base = craft.base.body_frame()
    for body in ("bus", "arm", "tip"):
        theirs, ours = data.body(body), craft.plant.GetBodyByName(body)
        X_BF = craft.plant.CalcRelativeTransform(context, base, ours.body_frame())
        R_BF = R_WB.T @ theirs.xmat.reshape(3, 3)
        np.testing.assert_allclose(X_BF.rotation().matrix(), R_BF, atol=1e-9)
        np.testing.assert_allclose(X_BF.translation(), R_WB.T @ (theirs.xpos - p_WB), atol=1e-9)
        mass = model.body(body).mass[0]
        assert ours.default_mass() == pytest.approx(mass)
        if mass:
            M = ours.default_spatial_inertia()
            p_BFcm = R_WB.T @ (theirs.xipos - theirs.xpos)
            np.testing.assert_allclose(R_BF @ M.get_com(), p_BFcm, atol=1e-9)
            R_BI = R_WB.T @ theirs.ximat.reshape(3, 3)
            I_B = R_BI @ np.diag(model.body(body).inertia) @ R_BI.T
            own = M.Shift(M.get_com()).CalcRotationalInertia().CopyToFullMatrix3()
            np.testing.assert_allclose(R_BF @ own @ R_BF.T, I_B, atol=1e-6 * np.trace(I_B))


REFUSED = {
    "two joints and a position": (mjcf(joints=TWO), "body 'arm' has 2 joints", "body of its own"),
    "two joints and a rotation": (mjcf(pose='euler="0 9 0"', joints=TWO), "line 1", "of its own"),
    "frame": (mjcf(OWN + f'<frame pos="0 0 1">{BODY}</frame>'), "<frame> in <body>", "take it out"),
    "replicate": (
        mjcf(OWN + f'<replicate count="3" offset="0 .1 0">{BODY}</replicate>'),
        "<replicate> in <body>",
        "in another way",
    ),
    "box from to": (mjcf(geom('type="box" fromto="0 0 0 .5 0 0" size=".05"')), "fromto", "lost"),
    "ellipsoid from to": (
        mjcf(geom('type="ellipsoid" fromto="0 0 0 .5 0 0" size=".05"')),
        "fromto",
        "line 1",
    ),
    "mesh of vertices": (mjcf(geom('type="mesh" mesh="t"'), MESH), "'vertex' of <mesh>", "lost"),
    "shell": (
        mjcf(geom('type="box" size=".5 .05 .05" shellinertia="true" mass="2"')),
        "'shellinertia' of <geom>",
        "take it out",
    ),
    "groups": (
        mjcf(geom('size=".1" group="3"'), '<compiler inertiagrouprange="0 2"/>'),
        "'inertiagrouprange' of <compiler>",
        "lost",
    ),
    "total mass": (mjcf(head='<compiler settotalmass="9"/>'), "'settotalmass'", "<compiler>"),
    "bound of masses": (mjcf(head='<compiler boundmass="9"/>'), "'boundmass'", "<compiler>"),
    "ball": (mjcf(joints='<joint name="j" type="ball"/>'), "joint 'j'", "only revolute"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_mjcf_that_is_not_read_whole_is_refused(load, name):
    text, *says = REFUSED[name]
    with pytest.raises(InputError) as caught:
        load(text)
    message = str(caught.value)
    assert all(part in message for part in says), message
    assert "\n" not in message


GOOD = link("bus", 50.0), link("arm"), joint("j", "bus", "arm")
TEMPLATE = urdf(*GOOD).replace("<robot ", '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" ')


def sdf(inner: str = "") -> str:
    moments = "".join(f"<{key}>{value}</{key}>" for key, value in INERTIA.items())
    own = f"<inertial><mass>9</mass><inertia>{moments}</inertia>{inner}</inertial>"
    return (
        f'<sdf version="1.9"><model name="s"><link name="bus">{own}</link><link name="arm">{own}'
        '</link><joint name="j" type="revolute"><parent>bus</parent><child>arm</child><axis><xyz>'
        "0 0 1</xyz></axis></joint></model></sdf>"
    )


def changed(old: str, new: str) -> str:
    text = urdf(*GOOD)
    assert old in text
    return text.replace(old, new, 1)


OTHERS = {
    "xacro include": (
        TEMPLATE.replace("<link", '<xacro:include filename="w.xacro"/><link', 1),
        ".urdf",
        "run xacro first",
    ),
    "xacro property": (changed('value="50.0"', 'value="${m}"'), ".urdf", "run xacro first"),
    "misspelt inertial": (
        urdf(*GOOD).replace("inertial>", "inertal>"),
        ".urdf",
        "<inertal> in <link> is not read",
    ),
    "misspelt axis": (urdf(*GOOD).replace("<axis", "<axes"), ".urdf", "<axes> in <joint>"),
    "misspelt origin": (
        changed("<inertial>", '<inertial><orgin xyz="1 0 0"/>'),
        ".urdf",
        "<orgin> in <inertial>",
    ),
    "misspelt attribute": (
        changed('<origin xyz="0.5', '<origin xzy="0.5'),
        ".urdf",
        "'xzy' of <origin> is not read",
    ),
    "misspelt link": (
        urdf(*GOOD, link("boom").replace("link", "lnk")),
        ".urdf",
        "<lnk> in <robot> is not read",
    ),
    "two inertias": (
        changed("</link>", '<inertial><mass value="7"/></inertial></link>'),
        ".urdf",
        "<link> has 2 <inertial>: only one is read",
    ),
    "two masses": (
        changed('<mass value="50.0"/>', '<mass value="50.0"/><mass value="5"/>'),
        ".urdf",
        "<inertial> has 2 <mass>",
    ),
    "two masses in SDF": (sdf("<mass>3</mass>"), ".sdf", "<inertial> has 2 <mass>"),
    "added mass": (
        sdf("<fluid_added_mass><xx>1</xx></fluid_added_mass>"),
        ".sdf",
        "<fluid_added_mass> is not read",
    ),
}


@pytest.mark.parametrize("name", OTHERS)
def test_what_urdf_and_sdf_lose_in_silence_is_refused(load, name):
    text, ending, says = OTHERS[name]
    with pytest.raises(InputError) as caught:
        load(text, ending, "arm")
    assert says in str(caught.value)


EXTENSIONS = {
    "of a simulator": ("<self_collide>false</self_collide>", ""),
    "friction": ("<mu1>0.8</mu1>", ""),
    "shape of a filter": (
        '<self_filter><origin xyz="0 0 1"/><geometry><box size="1 1 1"/></geometry></self_filter>',
        "",
    ),
    "pose of a sensor": ('<sensor name="imu"><pose>0 0 1 0 0 0</pose></sensor>', ""),
    "a text": ("<description>The arm of 2019, 3 m long</description>", ""),
    "hardware": ("", "<hardware><motor>1</motor></hardware>"),
    "limits of a driver": (
        "",
        '<hardware id="0"><limit lower="-0.1" upper="0.1" vel="3.0" acc="10.0" effort="30.0"/>'
        '<transform ratio="1.0" offset_pos_cnt="-107603600" torque_per_unit="1.0"/><inputs>'
        "<load_torque_value>Analog Input 1</load_torque_value></inputs></hardware>",
    ),
    "interface": ("", "<hardwareInterface>EffortJointInterface</hardwareInterface>"),
    "encoder": ("", '<encoder resolution="4096" counts="65536"/>'),
    "gear": ("", '<gear ratio="100"/>'),
    "standard": ("", '<calibration rising="0.1"/><safety_controller k_velocity="10"/>'),
}


@pytest.mark.parametrize("name", EXTENSIONS)
def test_an_element_that_changes_no_body_or_joint_is_counted(load, name, caplog):
    """Other readers of URDF ignore it: masses and the motion are those of the file without it."""
    in_link, in_joint = EXTENSIONS[name]
    text = changed("</link>", f"{in_link}</link>").replace("</joint>", f"{in_joint}</joint>")
    with_it, without = load(text, ".urdf", "arm"), load(urdf(*GOOD), ".urdf", "arm")
    assert with_it.mass == without.mass
    for ours, theirs in zip(with_it.tree.bodies, without.tree.bodies, strict=True):
        np.testing.assert_array_equal(ours.I_BBcm, theirs.I_BBcm)
        np.testing.assert_array_equal(ours.p_PF, theirs.p_PF)
    [said] = [each for each in caplog.messages if "not read, and without effect" in each]
    assert said.endswith(" (1)")


def test_a_transmission_of_no_joint_is_counted(load, caplog):
    """Published parts of robots have those of the whole; Drake refuses them."""
    names = "".join(
        f'<transmission name="t{name}"><type>transmission_interface/SimpleTransmission</type>'
        f'<joint name="{name}"><hardwareInterface>x</hardwareInterface></joint>'
        f'<actuator name="a{name}"><mechanicalReduction>1</mechanicalReduction></actuator>'
        "</transmission>"
        for name in ("j", "gone")
    )
    craft = load(urdf(*GOOD, names), ".urdf", "arm")
    assert craft.limits.efforts[0] == 10
    assert any("transmission of no joint (1)" in each for each in caplog.messages)


def test_misspelt_limits_are_refused(load):
    with pytest.raises(InputError, match="limits is like limit"):
        load(urdf(*GOOD).replace("<limit ", "<limits "), ".urdf", "arm")


@pytest.mark.parametrize("parent", ["link", "joint", "inertial", "axis"])
def test_what_sdf_does_not_define_is_counted_if_it_changes_nothing(load, parent, caplog):
    """A vendor's elements in SDF: all of a kind are left out together."""
    text = sdf().replace(f"</{parent}>", f"<hardware>1</hardware></{parent}>")
    craft = load(text, ".sdf", "arm")
    assert craft.mass == 18.0
    assert any("hardware (" in each for each in caplog.messages)
    wrong = sdf().replace(f"</{parent}>", f"<mas>1</mas><hardware>1</hardware></{parent}>", 1)
    with pytest.raises(InputError, match=r"XML Element\[mas\], child of element"):
        load(wrong, ".sdf", "arm")


LOST = {
    "mass": ('<mas value="5"/>', "mas is like mass"),
    "mass in another case": ("<Mass>5</Mass>", "Mass is like mass"),
    "inertia": ('<intertia ixx="1"/>', "intertia is like inertia"),
    "second mass": ('<payload><mass value="5"/></payload>', "mass"),
    "inertia of a rotor": ("<rotor_inertia>0.01</rotor_inertia>", "rotor_inertia is like inertia"),
    "moment inside": ('<body><parts ixx="1"/></body>', "ixx"),
    "place": ("<offset>0 0 1</offset>", "offset has several numbers"),
    "place by letters": ('<place xyz="1"/>', "xyz"),
    "turn": ('<mounting><rotation w="1" q="0 0 0 1"/></mounting>', "q has several numbers"),
    "axis": ('<axes xyz="0 0 1"/>', "xyz has several numbers"),
}


@pytest.mark.parametrize("name", LOST)
@pytest.mark.parametrize("parent", ["link", "joint", "inertial"])
def test_an_unknown_element_that_may_be_a_mass_or_a_pose_is_refused(load, name, parent):
    inner, says = LOST[name]
    with pytest.raises(InputError, match="a mass, a joint or a pose may be lost") as caught:
        load(changed(f"</{parent}>", f"{inner}</{parent}>"), ".urdf", "arm")
    assert says in str(caught.value)


def test_a_planar_inertia_is_told_what_to_write(load):
    text = urdf(link("bus", 50.0, **moments(0, 0, 2)), *GOOD[1:])
    with pytest.raises(InputError, match="on a table ixx and iyy do not matter"):
        load(text, ".urdf", "arm")


def test_a_site_is_no_capture_frame(load):
    with pytest.raises(InputError, match="a <site> is not read: write a <body> in its place"):
        load(mjcf(OWN + '<site name="s"/>'), capture_frame="s")


def test_what_does_not_matter_is_said_once(load, caplog):
    load(mjcf(joints='<joint name="j" stiffness="2" frictionloss="1"/>'))
    [said] = [each for each in caplog.messages if "model.xml" in each]
    assert said.endswith(
        "without effect on masses, joints and frames: frictionloss (1), stiffness (1)"
    )


DRAWN = '<geom type="mesh" mesh="t"/>'


def asset(file: str, name: str = ' name="t"') -> str:
    return f'<asset><mesh{name} file="{file}"/></asset>'


MESHES = {
    "absent": mjcf(OWN + DRAWN, asset("missing.obj")),
    "in a folder": mjcf(OWN + DRAWN, f'<compiler meshdir="parts"/>{asset("missing.obj")}'),
    "another format": mjcf(OWN + DRAWN, asset("there.stl")),
    "named by its file": mjcf(OWN + DRAWN, asset("t.stl", "")),
    "not used": mjcf(OWN, asset("missing.obj")),
    "of two bodies": mjcf(OWN + DRAWN, asset("missing.obj"), bus=BUS + DRAWN),
    "in the world": mjcf(OWN, asset("missing.obj")).replace("<worldbody>", f"<worldbody>{DRAWN}"),
    "in an included file": mjcf(OWN + DRAWN, '<include file="meshes.xml"/>'),
}


@pytest.mark.parametrize("name", MESHES)
def test_a_mesh_without_a_part_in_a_mass_may_be_absent(load, tmp_path, name, caplog):
    """All masses are explicit: the model is that without the mesh, and one line says so."""
    (tmp_path / "there.stl").touch()
    (tmp_path / "meshes.xml").write_text(f"<mujocoinclude>{asset('missing.obj')}</mujocoinclude>")
    craft, other = load(MESHES[name]), load(mjcf())
    assert craft.mass == other.mass
    np.testing.assert_array_equal(craft.tree.at_rest.I_BBcm, other.tree.at_rest.I_BBcm)
    assert sum("mesh that is absent or no .obj (1)" in text for text in caplog.messages) == 1


CUBE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"


def test_a_mesh_that_is_there_has_its_mass_beside_one_that_is_absent(load, tmp_path):
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts/there.obj").write_text(CUBE)
    two = '<asset><mesh name="t" file="missing.obj"/><mesh file="there.obj"/></asset>'
    text = mjcf(
        '<geom type="mesh" mesh="there"/>', f'<compiler meshdir="parts"/>{two}', bus=BUS + DRAWN
    )
    assert load(text).mass == pytest.approx(50 + 1000 / 6)  # water's density


MASS_OF_MESH = {
    "absent": mjcf(DRAWN, asset("missing.obj")),
    "another format": mjcf(DRAWN, asset("there.stl")),
    "masses from all geoms": mjcf(
        OWN + DRAWN, '<compiler inertiafromgeom="true"/>' + asset("missing.obj")
    ),
    "by default": mjcf(
        OWN + '<geom class="d"/>',
        f'<default><default class="d">{DRAWN}</default></default>{asset("missing.obj")}',
    ),
}


@pytest.mark.parametrize("name", MASS_OF_MESH)
def test_a_mesh_that_may_be_a_mass_must_be_there(load, tmp_path, name):
    (tmp_path / "there.stl").touch()
    with pytest.raises(InputError, match=r"line 1: <.*may take its mass from mesh 't', whose file"):
        load(MASS_OF_MESH[name])
