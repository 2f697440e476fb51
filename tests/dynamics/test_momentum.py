"""Eqs. 4-9 against Drake, and the base motion that conserves momentum."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cpid_drake.dynamics.kinematics import propagate
from cpid_drake.dynamics.momentum import (
    angular_momentum,
    linear_momentum,
    momentum_samples,
    target_momentum,
    total_momentum,
)
from cpid_drake.dynamics.rotations import rotate


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
    bodies, _ = propagate(servicer.tree, telemetry)
    P = linear_momentum(servicer.tree, bodies)
    L = angular_momentum(servicer.tree, bodies, points)
    drake = drake_momentum(servicer.plant, servicer.to_states(telemetry), points)
    scale = np.abs(drake).max()
    np.testing.assert_allclose(np.hstack([P, L]), drake, rtol=0, atol=1e-12 * scale)


def test_total_momentum_agrees_with_a_plant_that_holds_the_target(
    servicer, skewed_target, random_motion
):
    telemetry = random_motion(15, seed=23)
    plant = servicer.make_simulation_plant(skewed_target)
    drake = drake_momentum(plant, servicer.to_states(telemetry), np.zeros((15, 3)))
    ours = np.hstack(total_momentum(servicer.tree, skewed_target, telemetry))
    np.testing.assert_allclose(ours, drake, rtol=0, atol=1e-12 * np.abs(drake).max())


def test_online_and_batched_samples_are_the_same(servicer, random_motion):
    telemetry = random_motion(8, seed=24)
    batch = momentum_samples(servicer.tree, telemetry)
    context = servicer.plant.CreateDefaultContext()
    for k, state in enumerate(servicer.to_states(telemetry)):
        servicer.plant.SetPositionsAndVelocities(context, state)
        one = servicer.momentum_sample(context)
        np.testing.assert_allclose(one.P[0], batch.P[k], rtol=0, atol=1e-10)
        np.testing.assert_allclose(one.L[0], batch.L[k], rtol=0, atol=1e-10)
        for name in ("R_WC", "p_WC", "w_WC", "v_WC"):
            ours, theirs = getattr(one.motion, name)[0], getattr(batch.motion, name)[k]
            np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-12)


def test_base_twist_leaves_no_momentum_in_drake(servicer, skewed_target, zero_momentum_motion):
    states = servicer.to_states(zero_momentum_motion(skewed_target, 10, seed=25))
    plant = servicer.make_simulation_plant(skewed_target)
    assert np.abs(drake_momentum(plant, states, np.zeros((10, 3)))).max() < 1e-11


def test_momentum_is_the_derivative_of_the_centre_of_mass(servicer, paper_target, random_motion):
    """P = M d(r_cm)/dt: Eq. 5 by differences of positions alone."""
    telemetry, step = random_motion(5, seed=26), 1e-6
    plant = servicer.make_simulation_plant(paper_target)
    context = plant.CreateDefaultContext()
    mass = servicer.mass + paper_target.mass
    attitude = Rotation.from_quat(telemetry.quaternion_WB, scalar_first=True)
    places = []
    for h in (step, -step):
        turned = Rotation.from_rotvec(h * telemetry.w_WB) * attitude
        moved = replace(
            telemetry,
            quaternion_WB=turned.as_quat(scalar_first=True),
            p_WB=telemetry.p_WB + h * telemetry.v_WB,
            q=telemetry.q + h * telemetry.qdot,
        )
        row = []
        for state in servicer.to_states(moved):
            plant.SetPositionsAndVelocities(context, state)
            row.append(plant.CalcCenterOfMassPositionInWorld(context))
        places.append(np.array(row))
    expected = mass * (places[0] - places[1]) / (2 * step)
    P, _ = total_momentum(servicer.tree, paper_target, telemetry)
    np.testing.assert_allclose(P, expected, rtol=0, atol=1e-6 * np.abs(P).max())


def test_momentum_turns_with_the_world(servicer, skewed_target, random_motion):
    """Turning the world turns both momenta and changes nothing else."""
    telemetry = random_motion(6, seed=27)
    Q = Rotation.from_rotvec([0.4, -1.1, 0.7])
    attitude = Rotation.from_quat(telemetry.quaternion_WB, scalar_first=True)
    turned = replace(
        telemetry,
        quaternion_WB=(Q * attitude).as_quat(scalar_first=True),
        p_WB=Q.apply(telemetry.p_WB),
        w_WB=Q.apply(telemetry.w_WB),
        v_WB=Q.apply(telemetry.v_WB),
    )
    for before, after in zip(
        total_momentum(servicer.tree, skewed_target, telemetry),
        total_momentum(servicer.tree, skewed_target, turned),
        strict=True,
    ):
        np.testing.assert_allclose(after, Q.apply(before), rtol=0, atol=1e-10)


def test_target_momentum_is_linear_in_the_standard_vector(servicer, random_motion):
    """The same motion, two targets: momenta add as the standard vectors do."""
    from cpid_drake import InertialParameters

    motion = momentum_samples(servicer.tree, random_motion(5, seed=28)).motion
    a = InertialParameters(3.0, [0.1, 0.2, 0.3], np.diag([1.0, 2.0, 1.5]))
    b = InertialParameters(5.0, [-0.3, 0.1, 0.0], np.diag([4.0, 3.0, 2.0]))
    both = InertialParameters.from_standard_vector(a.to_standard_vector() + b.to_standard_vector())
    for part in range(2):
        summed = target_momentum(a, motion)[part] + target_momentum(b, motion)[part]
        np.testing.assert_allclose(target_momentum(both, motion)[part], summed, atol=1e-12)


def test_rotate_is_a_matrix_product():
    rng = np.random.default_rng(29)
    R, v = rng.normal(size=(4, 3, 3)), rng.normal(size=(4, 3))
    np.testing.assert_allclose(rotate(R, v), (R @ v[..., None])[..., 0])


@pytest.mark.parametrize("scale", [0.5, 3.0])
def test_momentum_is_linear_in_the_rates(servicer, random_motion, scale):
    telemetry = random_motion(4, seed=30)
    faster = replace(
        telemetry,
        w_WB=scale * telemetry.w_WB,
        v_WB=scale * telemetry.v_WB,
        qdot=scale * telemetry.qdot,
    )
    slow, fast = (momentum_samples(servicer.tree, x) for x in (telemetry, faster))
    np.testing.assert_allclose(fast.P, scale * slow.P, rtol=1e-12, atol=1e-9)
    np.testing.assert_allclose(fast.L, scale * slow.L, rtol=1e-12, atol=1e-9)
