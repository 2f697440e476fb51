"""Exported models: every reader finds the target in them that was meant, and nothing else new."""

from itertools import product

import numpy as np
import pytest
from model_parts import joint, link, urdf
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from scipy.spatial.transform import Rotation

from cpid_drake import InertialParameters, InputError, Spacecraft, identify
from cpid_drake.spacecraft.target_export import FORMATS, export_target

RESOLUTION = 1e-12  # of each quantity's size


@pytest.fixture(autouse=True)
def _no_reader_warns(caplog):
    yield
    assert [record.getMessage() for record in caplog.records] == []


def out_file(folder, format):
    return folder / f"out{FORMATS[format]}"


def assert_same(read, meant, resolution=RESOLUTION):
    """Compare ten parameters; inertia of what it is about C, where readers hold it."""
    reach = np.linalg.norm(meant.p_CTcm_C)
    about_C = np.trace(meant.I_TTcm_C) + meant.mass * reach**2
    np.testing.assert_allclose(read.mass, meant.mass, rtol=resolution)
    np.testing.assert_allclose(read.p_CTcm_C, meant.p_CTcm_C, rtol=0, atol=resolution * reach)
    np.testing.assert_allclose(read.I_TTcm_C, meant.I_TTcm_C, rtol=0, atol=resolution * about_C)


def by_drake(path, name) -> InertialParameters:
    plant = MultibodyPlant(time_step=0.0)
    Parser(plant).AddModels(str(path))
    plant.Finalize()
    body = plant.GetBodyByName(name)
    return InertialParameters.from_spatial_inertia(body.default_spatial_inertia())


def by_mujoco(path, name) -> InertialParameters:
    mujoco = pytest.importorskip("mujoco")
    body = mujoco.MjModel.from_xml_path(str(path)).body(name)
    R = Rotation.from_quat(body.iquat, scalar_first=True).as_matrix()
    inertia = R @ np.diag(body.inertia) @ R.T
    return InertialParameters(body.mass[0], body.ipos, inertia)


def by_pinocchio(path, _name) -> InertialParameters:
    pinocchio = pytest.importorskip("pinocchio")
    model = pinocchio.buildModelFromUrdf(str(path), pinocchio.JointModelFreeFlyer())
    inertia = model.inertias[1]
    return InertialParameters(inertia.mass, inertia.lever, inertia.inertia)


# -- the target alone ----------------------------------------------------------------------------


def rotated(moments, seed=3):
    R = Rotation.random(random_state=seed).as_matrix()
    inertia = R @ np.diag(moments) @ R.T
    return (inertia + inertia.T) / 2


TARGETS = {
    "paper, on the limit": InertialParameters(100.0, [0.4330127, 0, 0], np.diag([20.0, 30, 10])),
    "skewed": InertialParameters(60.0, [0.5, -0.12, 0.08], rotated([8.0, 11, 6])),
    "flat, skewed": InertialParameters(60.0, [0.5, -0.12, 0.08], rotated([8.0, 14, 6])),
    "flat, skewed, far": InertialParameters(2.0, [30.0, -7, 12], rotated([1.0, 3, 2], seed=8)),
    "beyond the limit by rounding": InertialParameters(
        3.0, [0.1, 0, 0], np.diag([0.1, 0.2, np.nextafter(0.1 + 0.2, 1)])
    ),
    "rod along x": InertialParameters(5.0, [0, 0.1, 0.2], np.diag([0.0, 2, 2])),
    "rod": InertialParameters(5.0, [0, 0.1, 0.2], rotated([0.0, 2, 2])),
    "tiny": InertialParameters(1e-6, [1e-3, 2e-3, -1e-4], rotated([3e-13, 4e-13, 5e-13])),
    "huge": InertialParameters(4.2e5, [20.0, -31.0, 7.0], rotated([1.3e8, 2e8, 1.5e8])),
}
targets = pytest.mark.parametrize("target", TARGETS.values(), ids=TARGETS.keys())


@targets
def test_mujoco_reads_what_was_meant(target, tmp_path):
    path = out_file(tmp_path, "mjcf")
    export_target(path, target, format="mjcf")
    assert_same(by_mujoco(path, "target"), target)


@pytest.mark.parametrize("name", ["skewed", "rod", "flat, skewed, far"])
def test_pinocchio_reads_what_was_meant(name, tmp_path):
    path = out_file(tmp_path, "urdf")
    export_target(path, TARGETS[name], format="urdf")
    assert_same(by_pinocchio(path, "target"), TARGETS[name])


@pytest.mark.parametrize(
    ("name", "format"),
    [*product(TARGETS, ["urdf", "sdf", "mjcf"]), ("skewed", "drake-yaml")],
)
def test_drake_reads_what_was_meant(name, format, tmp_path):
    target = TARGETS[name]
    path = out_file(tmp_path, format)
    exported = export_target(path, target, format=format)
    assert exported[0] == path
    assert sorted(exported) == sorted(tmp_path.iterdir())
    assert_same(by_drake(path, "target"), target)


# -- attached to a spacecraft --------------------------------------------------------------------

# Roll and yaw of this frame are about one axis.
HAND = '<frame name="hand" link="arm" xyz="0.1 0.2 0.3" rpy="0.3 -1.5707963267948966 0.4"/>'
URDF = urdf(link("base"), link("arm"), joint("j", "base", "arm"), HAND)


MJCF = """\
<mujoco model="mine">
  <compiler angle="degree"/>
  <worldbody>
    <body name="base"><freejoint/>
      <inertial pos="0.1 -0.2 0.3" mass="10" fullinertia="2 3 4 0.1 -0.2 0.3"/>
      <body name="arm" pos="0.5 -0.1 0.2" euler="20 30 40">
        <joint name="j" type="hinge" axis="0.6 0 0.8" limited="true" range="-90 90"/>
        <inertial pos="0.1 -0.2 0.3" mass="10" fullinertia="2 3 4 0.1 -0.2 0.3"/>
        <body name='hand' pos="0.1 0.2 0.3" euler="0 90 0"/>
        <body name="tip" pos="0.1 0.2 0.3" euler="10 20 30">
          <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""
MODELS = {
    "urdf, a frame": ("mine.urdf", URDF, "hand"),
    "urdf, a link": ("mine.urdf", URDF, "arm"),
    "mjcf, an empty body": ("mine.xml", MJCF, "hand"),
    "mjcf, a joint beside its body's origin": (
        "mine.xml",
        MJCF.replace('axis="0.6 0 0.8"', 'axis="0.6 0 0.8" pos="0.1 -0.2 0.05"'),
        "tip",
    ),
}
models = pytest.mark.parametrize(("file", "text", "frame"), MODELS.values(), ids=MODELS.keys())


@pytest.fixture
def load(tmp_path):
    """Return a function (file name, text, capture frame) -> Spacecraft, in a folder of its own."""

    def make(file, text, frame) -> Spacecraft:
        folder = tmp_path / "models"
        folder.mkdir(exist_ok=True)
        (folder / file).write_text(text)
        return Spacecraft(folder / file, base="base", capture_frame=frame)

    return make


def assert_joined(path, spacecraft, target, name="target"):
    """The exported model has the momentum, and the joints, of spacecraft and target in one."""
    plant = MultibodyPlant(time_step=0.0)
    Parser(plant).AddModels(str(path))
    plant.Finalize()
    whole = spacecraft.make_simulation_plant(target)
    assert plant.num_positions() == whole.num_positions()
    assert plant.num_velocities() == whole.num_velocities()
    context, expected = plant.CreateDefaultContext(), whole.CreateDefaultContext()
    rng = np.random.default_rng(1)
    for _ in range(3):
        q, v = rng.normal(size=plant.num_positions()), rng.normal(size=plant.num_velocities())
        q[:4] /= np.linalg.norm(q[:4])
        for one, its_context in ((plant, context), (whole, expected)):
            one.SetPositions(its_context, q)
            one.SetVelocities(its_context, v)
        L, L_expected = (
            one.CalcSpatialMomentumInWorldAboutPoint(its_context, np.zeros(3)).get_coeffs()
            for one, its_context in ((plant, context), (whole, expected))
        )
        np.testing.assert_allclose(L, L_expected, rtol=0, atol=1e-12 * np.abs(L_expected).max())
    X_WT = plant.GetFrameByName(name).CalcPoseInWorld(context)
    X_WC = whole.GetFrameByName(spacecraft.capture_frame.name()).CalcPoseInWorld(expected)
    np.testing.assert_allclose(X_WT.GetAsMatrix34(), X_WC.GetAsMatrix34(), rtol=0, atol=1e-12)


@models
@pytest.mark.parametrize("format", ["urdf", "sdf", "mjcf"])
def test_any_model_is_written_with_the_target_in_any_format(
    load, file, text, frame, format, skewed_target, tmp_path
):
    spacecraft = load(file, text, frame)
    path = out_file(tmp_path, format)
    export_target(path, skewed_target, format=format, spacecraft=spacecraft)
    assert_joined(path, spacecraft, skewed_target)


@models
def test_directives_add_the_target_to_any_model(load, file, text, frame, skewed_target, tmp_path):
    spacecraft = load(file, text, frame)
    path = out_file(tmp_path, "drake-yaml")
    exported = export_target(path, skewed_target, format="drake-yaml", spacecraft=spacecraft)
    assert exported == (path, tmp_path / "out_target.urdf")
    assert_joined(path, spacecraft, skewed_target)


def test_mujoco_and_pinocchio_find_the_target_at_its_place(load, skewed_target, tmp_path):
    """The known bodies and the target have one centre of mass in all readers."""
    mujoco, pinocchio = pytest.importorskip("mujoco"), pytest.importorskip("pinocchio")
    by_urdf, mjcf = (load(*MODELS[name]) for name in ("urdf, a frame", "mjcf, an empty body"))
    path = out_file(tmp_path, "urdf")
    export_target(path, skewed_target, format="urdf", spacecraft=by_urdf)
    model = pinocchio.buildModelFromUrdf(str(path), pinocchio.JointModelFreeFlyer())
    com = pinocchio.centerOfMass(model, model.createData(), pinocchio.neutral(model))
    np.testing.assert_allclose(com, default_com(by_urdf, skewed_target), atol=1e-14)
    path = out_file(tmp_path, "mjcf")
    export_target(path, skewed_target, format="mjcf", spacecraft=mjcf)
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(data.subtree_com[0], default_com(mjcf, skewed_target), atol=1e-14)


def default_com(spacecraft, target):
    plant = spacecraft.make_simulation_plant(target)
    return plant.CalcCenterOfMassPositionInWorld(plant.CreateDefaultContext())


def test_the_exported_capture_is_identified_as_known(
    servicer, skewed_target, zero_momentum_motion, tmp_path
):
    """Holding the exported target as part of itself, the spacecraft sees nothing more in it."""
    path = out_file(tmp_path, "urdf")
    export_target(path, skewed_target, format="urdf", spacecraft=servicer)
    joined = Spacecraft(path, base="bus", capture_frame="capture_point")
    telemetry = zero_momentum_motion(skewed_target, 20, 3)
    found = identify(servicer, telemetry, rows="standard").parameters
    np.testing.assert_allclose(found, skewed_target.to_vector(), atol=1e-9)
    rest = identify(joined, telemetry, rows="standard").solution.estimate
    np.testing.assert_allclose(rest, 0, atol=1e-9)


# -- names and paths -----------------------------------------------------------------------------


def test_a_name_that_is_taken_gets_a_number(load, skewed_target, tmp_path):
    text = URDF.replace('"arm"', '"target"').replace('"j"', '"target_2_weld"')
    spacecraft = load("mine.urdf", text, "hand")
    for format in ("urdf", "drake-yaml"):
        path = out_file(tmp_path, format)
        export_target(path, skewed_target, format=format, spacecraft=spacecraft)
        assert_joined(path, spacecraft, skewed_target, "target_3")
    for taken in ("base", "hand", "mine", "target_2"):
        with pytest.raises(InputError, match=f"'{taken}' is taken"):
            export_target(
                tmp_path / "b.urdf",
                skewed_target,
                format="urdf",
                spacecraft=spacecraft,
                name=taken,
            )


# -- what is refused, and leaves no file ---------------------------------------------------------


@pytest.fixture
def refusal(load, skewed_target, tmp_path):
    """Return a function that exports what must be refused, and gives the message."""

    def export(file, format, target=skewed_target, **options) -> str:
        before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
        with pytest.raises(InputError) as caught:
            export_target(tmp_path / file, target, format=format, **options)
        after = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
        assert after == before
        message = str(caught.value)
        assert "\n" not in message
        return message.replace(f"{tmp_path}/", "")

    return export


def test_no_file_of_what_no_body_has(refusal):
    target = InertialParameters(1.0, [0, 0, 0], np.diag([1.0, 1, 2.1]))
    assert refusal("a.urdf", "urdf", target).startswith("a.urdf: not written: no rigid body has")
    lighter = InertialParameters(-1.0, [0, 0, 0], np.eye(3))
    assert "mass -1 kg is not positive" in refusal("a.urdf", "urdf", lighter)


def test_the_spacecrafts_own_model_is_never_overwritten(load, refusal):
    spacecraft = load("mine.urdf", URDF, "hand")
    options = {"spacecraft": spacecraft, "overwrite": True}
    assert "would be lost" in refusal("models/mine.urdf", "urdf", **options)


def test_names_that_are_not_unique_need_directives(load, refusal, tmp_path):
    """Two copies of one model have links and joints of the same names."""
    load("mine.urdf", URDF, "hand")
    file = f"file://{tmp_path}/models/mine.urdf"
    directives = tmp_path / "models" / "two.dmd.yaml"
    directives.write_text(
        f"directives: [{{add_model: {{name: a, file: {file}}}}}, {{add_model: {{name: b, file: "
        f"{file}}}}}, {{add_weld: {{parent: a::hand, child: b::base}}}}]"
    )
    spacecraft = Spacecraft(directives, base="a::base", capture_frame="b::hand")
    message = refusal("a.urdf", "urdf", spacecraft=spacecraft)
    assert message.endswith("use format drake-yaml, which adds the model as it is")
