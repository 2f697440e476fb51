"""Base motion in an orbit: against Euler's equations, sums over bodies and free motion."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation
from sensing_cases import MOMENTUM, Sines, small_craft

from cpid_drake.dynamics.base_motion import propagate_base
from cpid_drake.dynamics.forced_motion import propagate_forced
from cpid_drake.dynamics.kinematics import propagate
from cpid_drake.dynamics.momentum import angular_momentum, linear_momentum
from cpid_drake.dynamics.orbit import Orbit
from cpid_drake.dynamics.relative_motion import relative_dynamics

ORBIT = Orbit(rate=0.05, nadir_W=np.array([0.6, 0.0, -0.8]), normal_W=np.array([0.8, 0.0, 0.6]))
POSE = {
    "quaternion_WB": Rotation.from_rotvec([0.3, 0.5, -0.2]).as_quat(scalar_first=True),
    "p_WB": np.array([20.0, -10.0, 5.0]),
}


@pytest.fixture(scope="module")
def craft(tmp_path_factory):
    return small_craft(tmp_path_factory.mktemp("craft"))


@pytest.fixture(scope="module")
def motion():
    return Sines.drawn(4, seed=101, duration=6.0, size=0.6)


def still(motion):
    return replace(motion, amplitude=0 * motion.amplitude)


def test_a_slow_orbit_changes_nothing(craft, motion, skewed_target):
    phi, times = skewed_target.to_standard_vector(), np.linspace(0, 6, 7)
    orbit = replace(ORBIT, rate=1e-9)
    found, end = propagate_forced(
        craft.tree, motion, phi, times, orbit, momentum_W=MOMENTUM, **POSE
    )
    free = propagate_base(
        craft.tree, motion, phi, times, momentum_W=MOMENTUM, max_step=0.02, **POSE
    )
    for name, value in vars(free).items():
        np.testing.assert_allclose(getattr(found, name), value, rtol=0, atol=1e-10, err_msg=name)
    np.testing.assert_allclose(end, MOMENTUM, rtol=0, atol=1e-9)


def test_a_rigid_body_obeys_eulers_equations(craft, motion, skewed_target):
    """J ω' + ω × J ω = 3 n² r × J r in B, and Clohessy-Wiltshire motion of the centre of mass."""
    full = craft.tree.with_target(skewed_target.to_standard_vector())
    locked, times = still(motion), np.linspace(0, 20, 6)
    dynamics = relative_dynamics(full, *np.zeros((2, 1, 4)) + locked.evaluate(0.0)[:2, None])
    J, com, mass = dynamics.I_K[0], dynamics.p_BK[0], full.mass
    found, end = propagate_forced(
        craft.tree,
        locked,
        skewed_target.to_standard_vector(),
        times,
        ORBIT,
        momentum_W=MOMENTUM,
        **POSE,
    )
    R0 = Rotation.from_quat(POSE["quaternion_WB"], scalar_first=True)
    p0, v0 = POSE["p_WB"] + R0.apply(com), MOMENTUM[3:] / mass
    w0 = np.linalg.solve(J, R0.inv().apply(MOMENTUM[:3] - np.cross(p0, MOMENTUM[3:])))

    def rate(t, y):
        R, w = Rotation.from_quat(y[:4], scalar_first=True), y[4:]
        r = R.inv().apply(ORBIT.nadir(np.array([t]))[0])
        torque = 3 * ORBIT.n**2 * np.cross(r, J @ r) - np.cross(w, J @ w)
        return np.concatenate([_product(y[:4], w) / 2, np.linalg.solve(J, torque)])

    start = np.concatenate([POSE["quaternion_WB"], w0])
    solved = solve_ivp(rate, (0, 20), start, t_eval=times, rtol=1e-11, atol=1e-12)
    expected = Rotation.from_quat(solved.y[:4].T, scalar_first=True)
    error = expected.inv() * Rotation.from_quat(found.quaternion_WB, scalar_first=True)
    assert error.magnitude().max() < 1e-8
    p_cm = found.p_WB + expected.apply(com)
    drift = ORBIT.transition(0.0, times) @ np.concatenate([p0, v0])
    np.testing.assert_allclose(p_cm, drift[:, :3], rtol=0, atol=1e-8)
    np.testing.assert_allclose(end[3:], mass * drift[-1, 3:], rtol=0, atol=1e-7)


def _product(q, w):
    """Return q ∘ (0, w)."""
    return np.concatenate([[-q[1:] @ w], q[0] * w + np.cross(q[1:], w)])


def test_momentum_changes_by_the_forces_on_all_bodies(craft, motion, skewed_target):
    """While the joints move: the tide on every body, a wrench, a disturbance, and thrusters."""
    phi, step = skewed_target.to_standard_vector(), 1e-3
    full = craft.tree.with_target(phi)
    times = 3.0 + step * np.arange(-2, 3)
    disturbance, wrench = np.arange(6) * 0.01, np.arange(6) * 0.1 - 0.3
    thrust = np.array([0.5, -0.4, 0.3, 2.0, -1.0, 1.5])
    found, _ = propagate_forced(
        craft.tree,
        motion,
        phi,
        np.concatenate([[0.0], times]),
        ORBIT,
        momentum_W=MOMENTUM,
        disturbance_W=disturbance,
        wrench_W=wrench,
        wrench_B=thrust,
        **POSE,
    )
    telemetry = found.to_telemetry(craft.joint_names, [0.0, *times], motion).select(slice(1, None))
    bodies, _ = propagate(full, telemetry)
    P = linear_momentum(full, bodies)
    L = angular_momentum(full, bodies, np.zeros(3))
    momentum = np.hstack([L, P])
    rate = (8 * (momentum[3] - momentum[1]) - (momentum[4] - momentum[0])) / (12 * step)

    time, expected = times[2:3], wrench.copy()
    com = np.average(bodies.r[:, 2], axis=0, weights=[body.mass for body in full.bodies])
    for body, R, r in zip(full.bodies, bodies.R[:, 2], bodies.r[:, 2], strict=True):
        force = body.mass * (ORBIT.tide(time)[0] @ r)
        torque = ORBIT.torque((R @ body.I_BBcm @ R.T)[None], time)[0]
        expected += np.concatenate([torque + np.cross(r, force), force])
    push = full.mass * disturbance[3:]
    expected += np.concatenate([disturbance[:3] + np.cross(com, push), push])
    torque, force = telemetry.R_WB[2] @ thrust[:3], telemetry.R_WB[2] @ thrust[3:]
    expected += np.concatenate([torque + np.cross(telemetry.p_WB[2], force), force])
    np.testing.assert_allclose(rate, expected, rtol=0, atol=1e-6)
