"""The scene in Meshcat: it shows what momentum conservation and the estimate say."""

import numpy as np
import pytest
from pydrake.common.value import Value
from pydrake.multibody.tree import SpatialInertia

from cpid_drake import (
    SceneVisualizer,
)
from cpid_drake.spacecraft.appearance import inertia_ellipsoid


class Spy:
    """Stands in for Meshcat and remembers the last value of everything."""

    def __init__(self) -> None:
        self.values = {}

    def SetObject(self, path, shape, rgba):
        self.values[path] = shape

    def SetLine(self, path, vertices, line_width, rgba):
        self.values[path] = vertices

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

        def draw(k, estimate=None, covariance=np.nan):
            M = SpatialInertia.NaN() if estimate is None else estimate.to_spatial_inertia()
            values = np.zeros((10, 10))
            values[1:4, 1:4] = covariance
            system.GetInputPort("state").FixValue(context, states[k])
            system.GetInputPort("covariance").FixValue(context, values.ravel())
            system.GetInputPort("spatial_inertia").FixValue(context, Value(M))
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
    """The sum of the two angular arrows, which does not cancel here, in their scale."""
    telemetry = random_motion(1, 5)
    spy, draw = scene(telemetry, truth=skewed_target)
    draw(0)
    found = sum(spy.arrow(f"momentum/angular_{owner}") for owner in ("spacecraft", "target"))
    plant = servicer.make_simulation_plant(skewed_target)
    context = plant.CreateDefaultContext()
    plant.SetPositionsAndVelocities(context, servicer.to_states(telemetry)[0])
    p_WS = plant.CalcCenterOfMassPositionInWorld(context)
    total = plant.CalcSpatialMomentumInWorldAboutPoint(context, p_WS).rotational()
    np.testing.assert_allclose(found, total / plant.CalcTotalMass(context), rtol=0, atol=1e-9)


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
