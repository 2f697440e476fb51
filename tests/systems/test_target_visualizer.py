"""The estimate's ellipsoid in Meshcat: hidden until it exists, then where the truth is."""

import numpy as np
import pytest
from pydrake.common.value import Value
from pydrake.geometry import Meshcat
from pydrake.math import RigidTransform
from pydrake.multibody.tree import BodyIndex, SpatialInertia

from cpid_drake import TargetVisualizer, load_scenario, make_simulation, shipped_scenario
from cpid_drake.appearance import inertia_ellipsoid
from cpid_drake.systems.target_visualizer import _wire_sphere


@pytest.fixture(scope="module")
def recorded():
    scenario = load_scenario(shipped_scenario("paper"))
    scenario.simulation.duration = 4.5
    scenario.simulation.simulator.accuracy = 1e-6
    meshcat = Meshcat()
    simulation = make_simulation(scenario, meshcat=meshcat)
    meshcat.StartRecording()
    simulation.run()
    meshcat.StopRecording()
    meshcat.PublishRecording()
    return simulation, meshcat


def test_both_ellipsoids_arms_and_target_are_in_the_scene(recorded):
    _, meshcat = recorded
    for path in (
        "/cpid/target/estimate/ellipsoid",
        "/cpid/target/truth/ellipsoid",
        "/drake/visualizer/dual_arm_servicer/capture_arm_link3",
        "/drake/visualizer/captured_target",
    ):
        assert meshcat.HasPath(path), path


def test_the_recording_is_one_self_contained_file(recorded):
    _, meshcat = recorded
    html = meshcat.StaticHtml()
    assert 'src="http' not in html
    assert len(html) < 10e6


class Spy:
    """Stands in for Meshcat and remembers the last value of everything."""

    def __init__(self) -> None:
        self.values = {}

    def SetObject(self, path, shape, rgba):
        self.values[path] = shape

    def SetLineSegments(self, path, start, end, line_width, rgba):
        self.values[path] = (start, end)

    def SetTransform(self, path, X_ParentPath, time_in_recording=None):
        self.values[path, "transform"] = X_ParentPath

    def SetProperty(self, path, name, value, time_in_recording=None):
        self.values[path, name] = value


def test_the_estimate_is_hidden_until_there_is_one(skewed_target):
    """And then it is drawn with the semi-diameters of the solid ellipsoid of that inertia."""
    spy, M_TCo_C = Spy(), skewed_target.to_spatial_inertia()
    system = TargetVisualizer(spy, BodyIndex(1), truth=M_TCo_C)
    context = system.CreateDefaultContext()
    X_WC = RigidTransform([1.0, 2.0, 3.0])
    system.GetInputPort("body_poses").FixValue(context, Value([RigidTransform(), X_WC]))
    inertia = system.GetInputPort("spatial_inertia")
    shown = ("/cpid/target/estimate", "visible")

    inertia.FixValue(context, Value(SpatialInertia.NaN()))
    system.ForcedPublish(context)
    assert spy.values[shown] is False
    assert spy.values["/cpid/target", "transform"].IsExactlyEqualTo(X_WC)

    inertia.FixValue(context, Value(M_TCo_C))
    system.ForcedPublish(context)
    assert spy.values[shown] is True
    semi_diameters, X_CE = inertia_ellipsoid(M_TCo_C)
    for name in ("estimate", "truth"):
        assert spy.values[f"/cpid/target/{name}/ellipsoid", "scale"] == semi_diameters.tolist()
        assert spy.values[f"/cpid/target/{name}", "transform"].IsExactlyEqualTo(X_CE)


def test_wire_sphere_is_of_unit_radius():
    for points in _wire_sphere():
        np.testing.assert_allclose(np.linalg.norm(points, axis=0), 1.0, atol=1e-12)
