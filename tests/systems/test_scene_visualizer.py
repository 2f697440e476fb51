"""The scene in Meshcat: it shows what momentum conservation and the estimate say."""

import re

import numpy as np
import pytest
from pydrake.common.value import Value
from pydrake.geometry import StartMeshcat
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.multibody.tree import SpatialInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.visualization import AddDefaultVisualization

from cpid_drake import InputError, MomentumIdentifier, SceneVisualizer
from cpid_drake.spacecraft.appearance import inertia_ellipsoid


class Spy:
    """Stands in for Meshcat and remembers the last value of everything."""

    def __init__(self) -> None:
        self.values = {}

    def SetObject(self, path, shape, rgba):
        self.values[path] = shape

    def SetLine(self, path, vertices, line_width, rgba):
        self.values[path] = vertices

    def AddButton(self, name):
        self.values["button", name] = True

    def DeleteButton(self, name):
        del self.values["button", name]

    def buttons(self) -> list[str]:
        return [key[1] for key in self.values if key[0] == "button"]

    def SetCameraPose(self, camera_in_world, target_in_world):
        self.values["camera"] = camera_in_world, target_in_world

    def SetTransform(self, path, X_ParentPath, time_in_recording=None):
        self.values[path, "transform"] = X_ParentPath

    def SetProperty(self, path, name, value, time_in_recording=None):
        self.values[path, name] = value

    def shown(self, path: str) -> bool:
        return self.values[f"/cpid/{path}", "visible"]

    def arrow(self, path: str) -> np.ndarray:
        """The vector in W whose square root of length is that of an arrow from tail to head."""
        X_WA = self.values[f"/cpid/{path}", "transform"]
        length = self.values[f"/cpid/{path}/scaled", "scale"][2]
        return X_WA.rotation().matrix()[:, 2] * length**2


@pytest.fixture
def scene(servicer):
    """Return a function (telemetry, truth) -> (spy, draw(k, estimate, covariance))."""

    def make(telemetry, truth=None):
        spy = Spy()
        system = SceneVisualizer(servicer, meshcat=spy, truth=truth)
        context = system.CreateDefaultContext()
        states = servicer.to_states(telemetry)

        def draw(k, estimate=None, covariance=np.nan, passed=True):
            M = SpatialInertia.NaN() if estimate is None else estimate.to_spatial_inertia()
            values = np.zeros((10, 10))
            values[1:4, 1:4] = covariance
            system.GetInputPort("state").FixValue(context, states[k])
            system.GetInputPort("covariance").FixValue(context, values.ravel())
            system.GetInputPort("spatial_inertia").FixValue(context, Value(M))
            system.GetInputPort("checks_passed").FixValue(context, [float(passed)])
            context.SetTime(telemetry.time[k])
            system.ForcedPublish(context)

        return spy, draw

    return make


def capture_pose(servicer, telemetry, k):
    context = servicer.plant.CreateDefaultContext()
    servicer.plant.SetPositionsAndVelocities(context, servicer.to_states(telemetry)[k])
    return servicer.capture_frame.CalcPoseInWorld(context)


def test_momentum_of_spacecraft_and_target_cancels(scene, zero_momentum_motion, skewed_target):
    """Linear and angular arrows are equal and opposite, whatever the motion, and not zero."""
    telemetry = zero_momentum_motion(skewed_target, 4, 3)
    spy, draw = scene(telemetry, truth=skewed_target)
    for k in range(4):
        draw(k)
        for kind in ("linear", "angular"):
            ours, theirs = (spy.arrow(f"momentum/{kind}_{o}") for o in ("spacecraft", "target"))
            assert np.linalg.norm(ours) > 0.01
            np.testing.assert_allclose(ours, -theirs, rtol=0, atol=1e-9)


def test_angular_momentum_is_that_of_drake_about_the_centre_of_mass(
    scene, servicer, random_motion, skewed_target
):
    """The sum of the two angular arrows, which does not cancel here, in one scale for all."""
    telemetry = random_motion(3, 5)
    spy, draw = scene(telemetry, truth=skewed_target)
    plant = servicer.make_simulation_plant(skewed_target)
    context, scales = plant.CreateDefaultContext(), []
    for k in range(3):
        draw(k)
        found = sum(spy.arrow(f"momentum/angular_{owner}") for owner in ("spacecraft", "target"))
        plant.SetPositionsAndVelocities(context, servicer.to_states(telemetry)[k])
        p_WS = plant.CalcCenterOfMassPositionInWorld(context)
        total = plant.CalcSpatialMomentumInWorldAboutPoint(context, p_WS).rotational()
        scales.append(np.linalg.norm(found) / np.linalg.norm(total))
        np.testing.assert_allclose(found, scales[-1] * total, rtol=0, atol=1e-9)
    np.testing.assert_allclose(scales, scales[0])


def test_the_controls_say_what_is_known_and_whether_to_use_it(scene, random_motion, skewed_target):
    """The legend stays; the numbers are those of the latest estimate."""
    telemetry = random_motion(3, 1)
    spy, draw = scene(telemetry, truth=skewed_target)
    draw(0)
    assert "not all ten parameters identifiable" in spy.buttons()
    assert any("momentum P of the target" in text for text in spy.buttons())
    draw(1, skewed_target, 1e-4 * np.eye(3))
    assert "not all ten parameters identifiable" not in spy.buttons()
    texts = "\n".join(spy.buttons())
    assert re.search(r"^c [-\d. ]+ m ± 0.02$", texts, re.M)  # 1.96 σ
    assert re.search(r"^true 60", texts, re.M)
    assert "a check failed" not in texts
    draw(2, skewed_target, 1e-4 * np.eye(3), passed=False)
    assert any("a check failed" in text for text in spy.buttons())
    assert any("momentum P of the target" in text for text in spy.buttons())


def test_a_kept_scene_is_a_page_that_needs_no_network(servicer, skewed_target, tmp_path, capsys):
    """With the recording, the numbers and their times; its name is printed."""
    meshcat, builder = StartMeshcat(), DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 0.0)
    servicer.add_to(plant, skewed_target, scene_graph=scene_graph)
    state = plant.get_state_output_port()
    identifier = MomentumIdentifier.AddToBuilder(builder, servicer, state=state)
    AddDefaultVisualization(builder, meshcat)
    system = SceneVisualizer.AddToBuilder(
        builder, servicer, state=state, **identifier.estimate_ports(), meshcat=meshcat
    )
    simulator = Simulator(builder.Build())
    meshcat.StartRecording()
    simulator.AdvanceTo(0.2)
    system.keep(tmp_path / "<b>.html")
    assert capsys.readouterr().out == f"{tmp_path}/<b>.html plays the motion in a browser\n"
    page = (tmp_path / "<b>.html").read_text(encoding="utf-8")
    assert "<h1>&lt;b&gt;</h1>" in page
    assert 'const steps = [[0.0, "not all ten parameters identifiable"]]' in page
    assert "momentum P of the target" in page
    assert 'src="http' not in page
    with pytest.raises(InputError, match=r"nowhere"):
        system.keep(tmp_path / "nowhere" / "page.html")


def test_nothing_of_the_target_is_drawn_until_it_is_known(
    scene, servicer, random_motion, skewed_target
):
    """Without the truth, centre of mass and momentum are the estimate's, and wait for it."""
    telemetry = random_motion(2, 1)
    spy, draw = scene(telemetry)
    draw(0)
    parts = ("estimate/inertia", "centre_of_mass")
    parts += ("momentum/linear_spacecraft", "momentum/angular_target")
    for part in parts:
        assert not spy.shown(part), part

    draw(1, skewed_target, np.diag([1e-4, 4e-4, 9e-4]))
    for part in (*parts, "estimate/three_sigma"):
        assert spy.shown(part), part
    X_WC = capture_pose(servicer, telemetry, 1)
    semi_diameters, X_CE = inertia_ellipsoid(skewed_target.to_spatial_inertia())
    assert spy.values["/cpid/estimate/inertia/scaled", "scale"] == semi_diameters.tolist()
    np.testing.assert_allclose(
        spy.values["/cpid/estimate/inertia", "transform"].GetAsMatrix4(),
        (X_WC @ X_CE).GetAsMatrix4(),
        atol=1e-12,
    )


@pytest.mark.parametrize("seed", range(2))
def test_the_ellipsoid_of_the_centre_of_mass_is_three_sigma(
    scene, servicer, random_motion, skewed_target, seed
):
    """Its matrix, rebuilt from what is drawn, is nine times the covariance, turned into W."""
    telemetry = random_motion(1, 2)
    spy, draw = scene(telemetry)
    root = np.diag([0.1, 0.15, 0.2]) + np.random.default_rng(seed).uniform(-0.04, 0.04, (3, 3))
    draw(0, skewed_target, root @ root.T)
    X_WE = spy.values["/cpid/estimate/three_sigma", "transform"]
    semi_axes = spy.values["/cpid/estimate/three_sigma/scaled", "scale"]
    R_WE, X_WC = X_WE.rotation().matrix(), capture_pose(servicer, telemetry, 0)
    R_WC = X_WC.rotation().matrix()
    np.testing.assert_allclose(
        R_WE @ np.diag(np.square(semi_axes)) @ R_WE.T,
        9 * R_WC @ root @ root.T @ R_WC.T,
        rtol=0,
        atol=1e-12,
    )
    np.testing.assert_allclose(X_WE.translation(), X_WC @ skewed_target.p_CTcm_C, atol=1e-12)

    draw(0, skewed_target, 100 * np.eye(3))
    assert not spy.shown("estimate/three_sigma")  # 30 m: no help to anybody
    draw(0, skewed_target, np.nan)
    assert not spy.shown("estimate/three_sigma")
