"""Kinematics and momentum against Drake, MuJoCo and Pinocchio, which compute them another way."""

import numpy as np
import pytest
from sensing_cases import small_craft

from cpid_drake.dynamics.kinematics import forward_kinematics
from cpid_drake.dynamics.momentum import momenta, system_momentum


@pytest.fixture(scope="module")
def craft(tmp_path_factory):
    """With turning and sliding joints and reaction wheels."""
    return small_craft(tmp_path_factory.mktemp("craft"), wheels=True)


@pytest.fixture(scope="module", params=["turning joints", "a sliding joint"])
def both_routes(request, random_motion):
    craft = request.getfixturevalue("craft" if request.param == "a sliding joint" else "servicer")
    telemetry = random_motion(20, 11, craft)
    bodies, capture = forward_kinematics(craft.tree, **telemetry.states)
    plant = craft.plant
    context = plant.CreateDefaultContext()
    drake = {"R": [], "r": [], "w": [], "v": [], "R_WC": [], "p_WC": [], "w_WC": [], "v_WC": []}
    for state in craft.to_states(telemetry):
        plant.SetPositionsAndVelocities(context, state)
        links = [plant.GetBodyByName(body.name) for body in craft.tree.bodies]
        X_WB = [link.EvalPoseInWorld(context) for link in links]
        V_WB = [link.EvalSpatialVelocityInWorld(context) for link in links]
        c_W = [X.rotation() @ body.p_BBcm for X, body in zip(X_WB, craft.tree.bodies, strict=True)]
        drake["R"].append([X.rotation().matrix() for X in X_WB])
        drake["r"].append([X.translation() + c for X, c in zip(X_WB, c_W, strict=True)])
        drake["w"].append([V.rotational() for V in V_WB])
        drake["v"].append([V.Shift(c).translational() for V, c in zip(V_WB, c_W, strict=True)])
        X_WC = craft.capture_frame.CalcPoseInWorld(context)
        V_WC = craft.capture_frame.CalcSpatialVelocityInWorld(context)
        drake["R_WC"].append(X_WC.rotation().matrix())
        drake["p_WC"].append(X_WC.translation())
        drake["w_WC"].append(V_WC.rotational())
        drake["v_WC"].append(V_WC.translational())
    return bodies, capture, {name: np.array(values) for name, values in drake.items()}


def test_every_body_and_the_capture_frame_move_as_in_drake(both_routes):
    """Eqs. 1 (w), 2 (r) and 3 (v) to 1e-12."""
    bodies, capture, drake = both_routes
    for name in ("R", "r", "w", "v"):
        ours = np.swapaxes(getattr(bodies, name), 0, 1)
        np.testing.assert_allclose(ours, drake[name], rtol=0, atol=1e-12, err_msg=name)
    for name in ("R_WC", "p_WC", "w_WC", "v_WC"):
        ours = getattr(capture, name)
        np.testing.assert_allclose(ours, drake[name], rtol=0, atol=1e-12, err_msg=name)


def drake_momentum(plant, states, points):
    context = plant.CreateDefaultContext()
    result = []
    for state, p_WQ in zip(states, points, strict=True):
        plant.SetPositionsAndVelocities(context, state)
        L_WQ = plant.CalcSpatialMomentumInWorldAboutPoint(context, p_WQ)
        result.append(np.hstack([L_WQ.translational(), L_WQ.rotational()]))
    return np.array(result)


def test_known_momentum_agrees_with_drake_about_any_point(servicer, random_motion):
    """Eq. 4 and the sum of Eq. 9."""
    telemetry = random_motion(15, seed=21)
    points = np.random.default_rng(22).normal(size=(15, 3))
    bodies, _ = forward_kinematics(servicer.tree, **telemetry.states)
    P, L = (sum(parts) for parts in momenta(servicer.tree, bodies, points))
    drake = drake_momentum(servicer.plant, servicer.to_states(telemetry), points)
    scale = np.abs(drake).max()
    np.testing.assert_allclose(np.hstack([P, L]), drake, rtol=0, atol=1e-12 * scale)


def test_total_momentum_agrees_with_a_plant_that_holds_the_target(
    servicer, skewed_target, random_motion
):
    telemetry = random_motion(15, seed=23)
    plant = servicer.make_simulation_plant(skewed_target)
    drake = drake_momentum(plant, servicer.to_states(telemetry), np.zeros((15, 3)))
    ours = np.hstack(system_momentum(servicer.tree, skewed_target, telemetry))
    np.testing.assert_allclose(ours, drake, rtol=0, atol=1e-12 * np.abs(drake).max())


def test_base_twist_leaves_no_momentum_in_drake(servicer, skewed_target, zero_momentum_motion):
    states = servicer.to_states(zero_momentum_motion(skewed_target, 10, seed=25))
    plant = servicer.make_simulation_plant(skewed_target)
    assert np.abs(drake_momentum(plant, states, np.zeros((10, 3)))).max() < 1e-11


def test_momentum_and_centre_of_mass_agree_with_pinocchio(servicer, random_motion):
    """From the same URDF: h_G about the centre of mass, and the centre itself."""
    pin = pytest.importorskip("pinocchio")
    model = pin.buildModelFromUrdf(str(servicer.path), pin.JointModelFreeFlyer())
    data, telemetry = model.createData(), random_motion(6, 34)
    places = [model.joints[model.getJointId(name)].idx_q for name in servicer.joint_names]
    bodies, _ = forward_kinematics(servicer.tree, **telemetry.states)
    masses = np.array([body.mass for body in servicer.tree.bodies])
    p_WScm = np.einsum("k,kni->ni", masses, bodies.r) / servicer.mass
    P, L = (sum(parts) for parts in momenta(servicer.tree, bodies, p_WScm))
    for k in range(len(telemetry)):
        R = telemetry.R_WB[k]
        q, v = np.zeros(model.nq), np.zeros(model.nv)
        q[:3], q[3:7] = telemetry.p_WB[k], np.roll(telemetry.quaternion_WB[k], -1)
        v[:3], v[3:6] = R.T @ telemetry.v_WB[k], R.T @ telemetry.w_WB[k]
        q[places], v[np.array(places) - 1] = telemetry.q[k], telemetry.qdot[k]
        h = pin.computeCentroidalMomentum(model, data, q, v)
        np.testing.assert_allclose(data.com[0], p_WScm[k], rtol=0, atol=1e-12)
        np.testing.assert_allclose(h.linear, P[k], rtol=0, atol=1e-9)
        np.testing.assert_allclose(h.angular, L[k], rtol=0, atol=1e-9)
