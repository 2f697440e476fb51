"""Arms that nobody here wrote, on a base of the user's own: the files as their vendors ship them.

From the PyPI package example-robot-data. None is made for a spacecraft: one is welded to the world,
one has a hand whose fingers mimic each other, one has massless links, and all name meshes in a
package that is not known here.
"""

import importlib.metadata
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from cpid_drake import InertialParameters, InputError, Spacecraft, identify, make_simulation
from cpid_drake.simulation.joint_motions import MultiSineMotion
from cpid_drake.simulation.schema import (
    ControllerConfig,
    IdentificationConfig,
    Scenario,
    SimulationConfig,
    SpacecraftConfig,
    TargetConfig,
)

CARRIER = """<robot name="carrier"><link name="carrier"><inertial>
<origin xyz="0.02 0 -0.05"/><mass value="250"/>
<inertia ixx="42" iyy="38" izz="45" ixy="1.5" ixz="0" iyz="-0.8"/>
</inertial></link></robot>"""

# An arm's file, and the links that are welded on the carrier and that hold the target.
ARMS = {
    "ur10": ("ur_description/urdf/ur10_robot.urdf", "base_link", "tool0"),
    "panda": ("panda_description/urdf/panda.urdf", "panda_link0", "panda_hand_tcp"),
    "kinova": ("kinova_description/robots/kinova.urdf", "base", "j2s6s200_end_effector"),
}


@pytest.fixture(scope="module")
def vendor_folder() -> Path:
    try:
        files = importlib.metadata.files("example-robot-data")
    except importlib.metadata.PackageNotFoundError:
        pytest.skip("needs vendors' models: pip install example-robot-data")
    (kinova,) = (file for file in files if file.name == "kinova.urdf")
    return Path(kinova.locate()).resolve().parents[2]


@pytest.fixture
def on_carrier(vendor_folder, tmp_path):
    """Return a function (arm, edit) -> keywords of a Spacecraft of carrier and arm."""

    def write(arm: str, edit=None) -> dict:
        file, first_link, held_by = ARMS[arm]
        packages = {"vendor": str(vendor_folder), "mine": str(tmp_path)}
        arm_file = f"package://vendor/{file}"
        if edit is not None:
            tree = ElementTree.parse(vendor_folder / file)
            edit(tree.getroot())
            tree.write(tmp_path / "arm.urdf")
            arm_file = "package://mine/arm.urdf"
        (tmp_path / "carrier.urdf").write_text(CARRIER)
        directives = tmp_path / "spacecraft.dmd.yaml"
        directives.write_text(f"""
directives:
- add_model:
    name: carrier
    file: package://mine/carrier.urdf
- add_model:
    name: arm
    file: {arm_file}
- add_weld:
    parent: carrier::carrier
    child: arm::{first_link}
    X_PC:
      translation: [0.45, 0, 0.1]
      rotation: !Rpy {{deg: [0, 90, 0]}}
""")
        return dict(model=str(directives), base="carrier", capture_frame=held_by, packages=packages)

    return write


def take_off_the_world(robot: ElementTree.Element) -> None:
    robot.remove(robot.find("link[@name='world']"))
    robot.remove(robot.find("joint[@name='world_joint']"))


def fix_fingers(robot: ElementTree.Element) -> None:
    for finger in robot.findall("joint[@type='prismatic']"):
        finger.set("type", "fixed")


EDITS = {"ur10": take_off_the_world, "panda": fix_fingers, "kinova": None}


def lively(spacecraft: Spacecraft, duration: float) -> MultiSineMotion:
    """Two sines in every joint, about the middle of its range."""
    names = spacecraft.joint_names
    columns = spacecraft.state_columns["q"]
    low = np.maximum(spacecraft.plant.GetPositionLowerLimits()[columns], -7.0)
    high = np.minimum(spacecraft.plant.GetPositionUpperLimits()[columns], 7.0)
    rng = np.random.default_rng(5)
    return MultiSineMotion(
        duration=duration,
        ramp=1.0,
        frequencies=np.array([0.2, 0.4]),
        centre=dict(zip(names, (low + high) / 2)),
        amplitudes={name: np.array([0.15, 0.08]) for name in names},
        phases=dict(zip(names, rng.uniform(-np.pi, np.pi, (len(names), 2)))),
    )


@pytest.fixture(scope="module")
def box() -> InertialParameters:
    """What an arm of this size may hold, with every parameter non-zero."""
    inertia = [[2.1, -0.2, 0.1], [-0.2, 2.6, 0.3], [0.1, 0.3, 1.7]]
    return InertialParameters(35.0, [0.08, -0.05, 0.2], inertia)


@pytest.mark.slow
@pytest.mark.parametrize("arm", ["ur10", "panda"])
def test_a_target_is_identified_on_a_vendors_arm(on_carrier, box, arm):
    """Simulated by Drake, from the arm's file to the ten parameters."""
    keywords = on_carrier(arm, EDITS[arm])
    spacecraft = Spacecraft(**keywords)
    assert len(spacecraft.joint_names) == (7 if arm == "panda" else 6)
    scenario = Scenario(
        spacecraft=SpacecraftConfig(**keywords),
        target=TargetConfig(box.mass, box.p_CTcm_C, box.I_TTcm_C),
        joint_motion=lively(spacecraft, duration=3.0),
        controller=ControllerConfig(has_target_model=True),
        identification=IdentificationConfig(rows="standard", period=0.25, offset=0.25),
        simulation=SimulationConfig(duration=3.0),
    )
    simulation = make_simulation(scenario)
    telemetry = simulation.motion(simulation.run())
    result = identify(simulation.spacecraft, telemetry, rows="standard")
    assert result.is_identifiable
    scale = np.repeat([box.mass, 0.5, np.trace(box.I_TTcm_C)], [1, 3, 6])
    assert np.abs((result.parameters - box.to_vector()) / scale).max() < 1e-6


# -- geometry is not needed ----------------------------------------------------------------------


@pytest.mark.parametrize("mesh", ["missing.obj", "there.stl"])
def test_a_mesh_of_mjcf_that_cannot_be_read_is_named(tmp_path, mesh):
    """There a body may take its mass from the mesh: Drake does not go on without it."""
    (tmp_path / "there.stl").touch()
    file = tmp_path / "model.xml"
    file.write_text(
        f'<mujoco model="r"><asset><mesh name="m" file="{mesh}"/></asset><worldbody>'
        '<body name="hull"><freejoint/><geom type="mesh" mesh="m"/></body></worldbody></mujoco>'
    )
    with pytest.raises(InputError, match=f"mesh.*{mesh}"):
        Spacecraft(file, base="hull", capture_frame="hull")
