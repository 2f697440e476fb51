"""Newton-Euler as rows, against Drake's inverse dynamics and mass matrix."""

import numpy as np
import pytest
from pydrake.multibody.tree import MultibodyForces
from techniques.newton_euler import (
    ReferenceDynamics,
    momentum_regressor,
    newton_euler_regressor,
    skew_consistent_regressor,
    spatial_inertia,
)

from cpid_drake import InertialParameters
from cpid_drake.dynamics.rotations import cross, rotate
from cpid_drake.spacecraft.free_floating import FreeFloatingDynamics

TARGET = InertialParameters(
    60.0, [0.5, -0.12, 0.08], [[8.0, -0.7, 0.4], [-0.7, 11.0, 0.9], [0.4, 0.9, 6.0]]
)
PHI = TARGET.to_standard_vector()


@pytest.fixture(scope="module")
def moving(craft):
    """Return states with momentum, their rates, and the motion of C, all by Drake."""
    rng = np.random.default_rng(7)
    plant = craft.make_simulation_plant(TARGET)
    context = plant.CreateDefaultContext()
    dynamics, J = FreeFloatingDynamics(craft, plant), len(craft.joint_names)
    target, C = plant.GetBodyByName("captured_target"), craft.capture_frame.name()
    frame = plant.GetFrameByName(C)
    rows = []
    for _ in range(4):
        x = rng.normal(0, 0.4, plant.num_multibody_states())
        x[:4] /= np.linalg.norm(x[:4])
        plant.SetPositionsAndVelocities(context, x)
        force = dynamics.generalized_force(context, rng.normal(0, 1, J))
        plant.get_applied_generalized_force_input_port().FixValue(context, force)
        vdot = plant.EvalTimeDerivatives(context).CopyToVector()[plant.num_positions() :]
        A = plant.CalcSpatialAccelerationsFromVdot(context, vdot)[target.index()]
        R_CW = frame.CalcPoseInWorld(context).rotation().matrix().T
        w = frame.CalcSpatialVelocityInWorld(context).rotational()
        vectors = [R_CW @ each for each in (A.translational(), A.rotational(), w)]
        rows.append((x, vdot, *vectors))
    return [np.array(each) for each in zip(*rows)]


def test_the_skew_consistent_form_is_newton_euler_for_its_own_twist(moving):
    _, _, a, alpha, w = moving
    v = np.random.default_rng(2).normal(size=a.shape)
    A, V = np.hstack([alpha, a - cross(w, v)]), np.hstack([w, v])
    found = skew_consistent_regressor(A, V, V)
    np.testing.assert_allclose(found, newton_euler_regressor(a, alpha, w), rtol=0, atol=1e-12)
    np.testing.assert_allclose(
        momentum_regressor(V) @ PHI, rotate(spatial_inertia(PHI), V), rtol=0, atol=1e-12
    )


def in_B(craft, x, vdot):
    """Return q, v and v̇ with the base's twist in B, of a state and accelerations of Drake's."""
    telemetry = craft.to_motion(0.0, x)
    columns = {k: c - craft.plant.num_positions() for k, c in craft.state_columns.items()}
    R = telemetry.R_WB[0].T
    w, u = R @ telemetry.w_WB[0], R @ telemetry.v_WB[0]
    rates = [R @ vdot[columns["w_WB"]], R @ vdot[columns["v_WB"]] - np.cross(w, u)]
    v = np.concatenate([w, u, telemetry.qdot[0]])
    return telemetry.q[0], v, np.concatenate([*rates, vdot[columns["qdot"]]])


def test_the_equations_of_motion_are_drakes(craft, moving):
    """No force on the base, and the joint efforts of Drake's inverse dynamics."""
    plant = craft.make_simulation_plant(TARGET)
    context = plant.CreateDefaultContext()
    order = craft.state_columns["qdot"] - plant.num_positions()
    for x, vdot in zip(*moving[:2]):
        plant.SetPositionsAndVelocities(context, x)
        tau = plant.CalcInverseDynamics(context, vdot, MultibodyForces(plant))
        q, v, rate = in_B(craft, x, vdot)
        M, Cv = ReferenceDynamics.at(craft.tree.lumped, q, v, v).with_target(PHI, v, v)
        found = M @ rate + Cv
        np.testing.assert_allclose(found, [*np.zeros(6), *tau[order]], rtol=0, atol=1e-9)


def test_energy_of_the_tracking_error_changes_by_the_applied_forces_only(craft, moving):
    """sᵀ (Ṁ − 2C) s = 0 for every s, with Ṁ along the motion by differences."""
    x, vdot, h = *moving[:2], 1e-5
    tree, rng = craft.tree.lumped, np.random.default_rng(4)
    for state, rate in zip(x, vdot):
        q, v, _ = in_B(craft, state, rate)
        step = h * v[6:]
        ends = [
            ReferenceDynamics.at(tree, q + k * step, v, v).with_target(PHI, v, v)[0]
            for k in (-1, 1)
        ]
        s = rng.normal(size=len(v))
        known = ReferenceDynamics.at(tree, q, v, s)
        Cs = known.with_target(PHI, v, s)[1]
        change = s @ (ends[1] - ends[0]) @ s / (2 * h)
        assert abs(change) > 0.1
        assert change == pytest.approx(2 * s @ Cs, abs=1e-6 * np.abs(known.M).max())
