"""The shipped models: physically possible, as documented, and moved within their limits."""

import re

import numpy as np
import pytest
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex, JointIndex, RevoluteJoint

from cpid_drake import InertialParameters, load_scenario, make_simulation
from cpid_drake.model_files import models_directory

URDFS = sorted(models_directory().glob("*/*.urdf"))
SCENARIOS = sorted((models_directory() / "scenarios").glob("*.yaml"))
NUMBER = r"[-−]?\d+(?:\.\d+)?"


def strictly_loaded(path) -> MultibodyPlant:
    """Strict parsing turns every warning of Drake into an error."""
    plant = MultibodyPlant(time_step=0.0)
    parser = Parser(plant)
    parser.SetStrictParsing()
    parser.AddModels(str(path))
    plant.Finalize()
    return plant


def bodies(plant) -> list:
    return [plant.get_body(BodyIndex(k)) for k in range(1, plant.num_bodies())]


@pytest.fixture(scope="module")
def readme() -> str:
    return (models_directory() / "README.md").read_text().replace("−", "-")


def test_there_are_models_and_scenarios_to_test():
    assert {path.stem for path in URDFS} >= {"dual_arm_servicer", "paper_target"}
    assert "paper" in {path.stem for path in SCENARIOS}


@pytest.mark.parametrize("path", URDFS, ids=lambda path: path.stem)
def test_every_body_is_physically_possible(path):
    for body in bodies(strictly_loaded(path)):
        inertia = body.default_spatial_inertia()
        if body.default_mass() == 0:
            assert not inertia.CopyToFullMatrix6().any(), body.name()
        else:
            assert inertia.IsPhysicallyValid(), body.name()
            assert not InertialParameters.from_spatial_inertia(inertia).infeasibilities()


def test_the_two_arms_are_identical(servicer):
    """Bodies, joints and limits, name by name; only the mount differs, mirrored in y."""
    plant = servicer.plant
    compared = 0
    for body in bodies(plant):
        if not body.name().startswith("capture_"):
            continue
        twin = plant.GetBodyByName(body.name().replace("capture_", "operating_", 1))
        np.testing.assert_array_equal(
            body.default_spatial_inertia().CopyToFullMatrix6(),
            twin.default_spatial_inertia().CopyToFullMatrix6(),
        )
        compared += 1
    assert compared == 8
    for k in range(1, 7):
        ours, theirs = (plant.GetJointByName(f"{arm}_arm_joint{k}") for arm in _ARMS)
        np.testing.assert_array_equal(ours.revolute_axis(), theirs.revolute_axis())
        for limit in ("position_lower_limits", "position_upper_limits", "velocity_upper_limits"):
            np.testing.assert_array_equal(getattr(ours, limit)(), getattr(theirs, limit)())
        poses = [j.frame_on_parent().GetFixedPoseInBodyFrame() for j in (ours, theirs)]
        places = [pose.translation() * (1, -1 if k == 1 else 1, 1) for pose in poses]
        np.testing.assert_allclose(np.abs(places[0]), np.abs(places[1]), atol=1e-15)
        np.testing.assert_array_equal(poses[0].rotation().matrix(), poses[1].rotation().matrix())


_ARMS = ("capture", "operating")


def test_every_body_is_as_documented(servicer, readme):
    """Mass, centre of mass and moments of models/README.md, row by row."""
    row = re.compile(
        rf"\| `(\S+)` \| ({NUMBER}) \| \(({NUMBER}), ({NUMBER}), ({NUMBER})\) "
        rf"\| ({NUMBER}) \| ({NUMBER}) \| ({NUMBER}) \|"
    )
    documented = {}
    for name, *numbers in row.findall(readme):
        for arm in _ARMS if name.startswith("*") else ("",):
            documented[name.replace("*", arm)] = np.array(numbers, dtype=float)
    assert documented.pop("target")[0] == 100.0
    heavy = {body.name(): body for body in bodies(servicer.plant) if body.default_mass() > 0}
    assert documented.keys() == heavy.keys()
    for name, numbers in documented.items():
        body = InertialParameters.from_spatial_inertia(heavy[name].default_spatial_inertia())
        np.testing.assert_allclose(body.mass, numbers[0], rtol=1e-12, err_msg=name)
        np.testing.assert_allclose(body.p_CTcm_C, numbers[1:4], atol=1e-6, err_msg=name)
        np.testing.assert_allclose(
            body.I_TTcm_C, np.diag(numbers[4:]), rtol=1e-6, atol=1e-9, err_msg=name
        )


def test_the_totals_are_as_documented(servicer, readme):
    text = " ".join(readme.split())
    plant = servicer.plant
    context = plant.CreateDefaultContext()
    mass = float(re.search(rf"whole spacecraft: ({NUMBER}) kg", text)[1])
    assert servicer.mass == pytest.approx(mass)
    arm = float(re.search(rf"One arm with its gripper: ({NUMBER}) kg", text)[1])
    for name in _ARMS:
        links = [body for body in bodies(plant) if body.name().startswith(f"{name}_arm")]
        assert sum(body.default_mass() for body in links) == pytest.approx(arm)
    place = re.search(rf"centre of mass is at \(({NUMBER}), ({NUMBER}), ({NUMBER})\)", text)
    com = plant.CalcCenterOfMassPositionInWorld(context)
    np.testing.assert_allclose(com, np.array(place.groups(), dtype=float), atol=5e-4)
    moments = re.search(rf"diag\(({NUMBER}), ({NUMBER}), ({NUMBER})\)\.", text)
    everything = [body.index() for body in bodies(plant)]
    whole = plant.CalcSpatialInertia(context, plant.world_frame(), everything).Shift(com)
    inertia = whole.CalcRotationalInertia().CopyToFullMatrix3()
    np.testing.assert_allclose(np.diag(inertia), np.array(moments.groups(), dtype=float), atol=1e-3)


def test_joint_limits_are_as_documented(servicer, readme):
    row = re.compile(
        rf"\| `\*_arm_joint(\d)` \| [^|]+ \| ([xyz]) \| [^|]+ \| ±({NUMBER}) \| ({NUMBER}) \|"
    )
    rows = row.findall(readme)
    assert len(rows) == 6
    for k, axis, position, velocity in rows:
        for arm in _ARMS:
            joint = servicer.plant.GetJointByName(f"{arm}_arm_joint{k}")
            np.testing.assert_array_equal(joint.revolute_axis(), np.eye(3)["xyz".index(axis)])
            assert joint.position_upper_limit() == float(position)
            assert joint.position_lower_limit() == -float(position)
            assert joint.velocity_upper_limits()[0] == float(velocity)


def test_capture_points_are_as_documented(servicer):
    """At zero joint angles (3.35, ∓0.45, 0) in the bus frame, parallel to it."""
    context = servicer.plant.CreateDefaultContext()
    for arm, y in zip(_ARMS, (-0.45, 0.45), strict=True):
        frame = servicer.plant.GetFrameByName(f"{arm}_point")
        X_BC = frame.CalcPose(context, servicer.base.body_frame())
        np.testing.assert_allclose(X_BC.translation(), [3.35, y, 0.0], atol=1e-12)
        np.testing.assert_allclose(X_BC.rotation().matrix(), np.eye(3), atol=1e-12)


def test_the_servicer_has_no_friction(servicer):
    plant = servicer.plant
    joints = [plant.get_joint(JointIndex(k)) for k in range(plant.num_joints())]
    revolute = [joint for joint in joints if isinstance(joint, RevoluteJoint)]
    assert len(revolute) == 12
    assert all(joint.default_damping() == 0 for joint in revolute)


def test_the_papers_target_is_the_scenarios_target(paper_scenario):
    """models/paper_target and models/scenarios/paper.yaml say the same of Table 1."""
    plant = strictly_loaded(models_directory() / "paper_target" / "paper_target.urdf")
    (body,) = bodies(plant)
    drawn = InertialParameters.from_spatial_inertia(body.default_spatial_inertia())
    truth = paper_scenario.target_truth()
    np.testing.assert_allclose(drawn.to_vector(), truth.to_vector(), rtol=1e-12, atol=1e-12)
    table_1 = [100.0, 0.4330127, 0.0, 0.0, 20.0, 30.0, 10.0, 0.0, 0.0, 0.0]
    np.testing.assert_array_equal(truth.to_vector(), table_1)


@pytest.mark.parametrize("path", SCENARIOS, ids=lambda path: path.stem)
def test_every_scenario_builds_and_starts(path):
    simulation = make_simulation(load_scenario(path))
    assert simulation.make_simulator().get_context().get_time() == 0.0


@pytest.mark.parametrize("path", SCENARIOS, ids=lambda path: path.stem)
def test_joints_stay_within_their_limits(path):
    simulation = make_simulation(load_scenario(path))
    times = np.linspace(0.0, simulation.scenario.simulation.duration, 500)
    q, qdot, _ = np.moveaxis(simulation.joint_motion.evaluate(times), -2, 0)
    plant = simulation.spacecraft.plant
    columns = simulation.spacecraft.joint_state_columns[0]
    assert (q >= plant.GetPositionLowerLimits()[columns]).all()
    assert (q <= plant.GetPositionUpperLimits()[columns]).all()
    assert (np.abs(qdot) <= simulation.spacecraft.velocity_limits).all()
    assert np.abs(qdot).max() > 0.0
