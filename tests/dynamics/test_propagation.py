"""The propagated motion of the base: against Euler's equations, and sums over bodies."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation
from sensing_cases import MOMENTUM, Sines

from cpid_drake import HalfCosine, InputError, Spline
from cpid_drake.dynamics.body_dynamics import BodyDynamics
from cpid_drake.dynamics.kinematics import forward_kinematics
from cpid_drake.dynamics.momentum import momenta
from cpid_drake.dynamics.orbit import Orbit
from cpid_drake.dynamics.propagation import Wrench, propagate

ORBIT = Orbit(rate=0.05, nadir_W=np.array([0.6, 0.0, -0.8]), normal_W=np.array([0.8, 0.0, 0.6]))
POSE = {
    "quaternion_WB": Rotation.from_rotvec([0.3, 0.5, -0.2]).as_quat(scalar_first=True),
    "p_WB": np.array([20.0, -10.0, 5.0]),
}


@pytest.fixture(scope="module")
def motion():
    return Sines.drawn(4, seed=101, duration=6.0, size=0.6)


def still(motion):
    return replace(motion, amplitude=0 * motion.amplitude)


@pytest.fixture(scope="module")
def reach():
    """Return a gentle motion, as the paper's."""
    ends = np.random.default_rng(61).uniform(-1, 1, (2, 4))
    return HalfCosine(*ends, duration=10.0)


def test_velocities_are_the_rates_of_the_pose(craft, skewed_target, reach):
    """By differences over 1 ms: p and v, and the attitude with ω, belong together."""
    times = np.array([0.0, 3.999, 4.0, 4.001])
    phi = skewed_target.to_standard_vector()
    base = propagate(craft.tree, reach, phi, times, momentum_W=MOMENTUM)
    velocity = (base.p_WB[3] - base.p_WB[1]) / 2e-3
    np.testing.assert_allclose(velocity, base.v_WB[2], atol=1e-8)
    before, after = Rotation.from_quat(base.quaternion_WB[[1, 3]], scalar_first=True)
    rate = (after * before.inv()).as_rotvec() / 2e-3
    np.testing.assert_allclose(rate, base.w_WB[2], atol=1e-8)


def test_many_targets_at_once_are_the_same_as_one_by_one(craft, skewed_target, reach):
    rng, times = np.random.default_rng(62), np.array([0.0, 2.0, 7.0])
    phi = skewed_target.to_standard_vector() * rng.uniform(0.9, 1.1, (4, 1))
    momenta = MOMENTUM * rng.uniform(0.0, 1.0, (4, 1))
    together = propagate(craft.tree, reach, phi, times, momentum_W=momenta)
    for k in range(4):
        one = propagate(craft.tree, reach, phi[k], times, momentum_W=momenta[k])
        for name in ("quaternion_WB", "p_WB", "w_WB", "v_WB"):
            np.testing.assert_allclose(getattr(together, name)[k], getattr(one, name), atol=1e-13)


def test_the_result_depends_neither_on_the_steps_nor_on_the_times(craft, skewed_target):
    """Pieces of a spline begin anywhere, and a sample may be anywhere in a step."""
    coefficients = np.random.default_rng(63).uniform(-0.5, 0.5, (12, 4))
    coefficients[1], coefficients[-1] = coefficients[0], coefficients[-2]
    spline, phi = Spline(coefficients, 9.7), skewed_target.to_standard_vector()
    times = np.sort(np.random.default_rng(64).uniform(0.0, 11.0, 50))
    given = {
        "momentum_W": MOMENTUM,
        "wrench": lambda time: Wrench(0.01 * np.arange(6), orbit=ORBIT),
    }
    many = propagate(craft.tree, spline, phi, [0.0, *times], max_step=0.05, **given)
    few = propagate(craft.tree, spline, phi, [0.0, times[-1]], **given)
    whole = propagate(craft.tree, spline, phi, [0.0, *times], **given)
    for name, value in vars(whole).items():
        np.testing.assert_allclose(value, getattr(many, name), rtol=0, atol=3e-10)
        np.testing.assert_allclose(value[-1], getattr(few, name)[-1], rtol=1e-12, atol=1e-12)


def test_a_fast_tumble_is_as_exact(craft, skewed_target, motion):
    """At several rad/s, where a step of 0.2 s would be more than half a radian."""
    phi, times = skewed_target.to_standard_vector(), np.linspace(0.0, 6.0, 13)
    for factor in (1.0, 10.0, 30.0):
        given = {"momentum_W": factor * np.asarray(MOMENTUM)}
        found = propagate(craft.tree, motion, phi, times, **given)
        finer = propagate(craft.tree, motion, phi, times, max_step=0.05, **given)
        np.testing.assert_allclose(found.quaternion_WB, finer.quaternion_WB, rtol=0, atol=1e-7)
    assert np.linalg.norm(found.w_WB, axis=1).max() > 3
    with pytest.raises(InputError, match="too fast to follow"):
        propagate(craft.tree, motion, phi, times, momentum_W=[0, 0, 1e300, 0, 0, 0])


@pytest.mark.parametrize(
    ("times", "step"), [([1.0, 1.0], 0.1), ([], 0.1), ([0.0, 1.0], 0.0), ([0.0, 1.0], -1.0)]
)
def test_bad_times_are_refused(craft, skewed_target, reach, times, step):
    with pytest.raises(InputError, match=r"times must be increasing|max_step"):
        propagate(craft.tree, reach, skewed_target.to_standard_vector(), times, max_step=step)


def test_a_rigid_body_obeys_eulers_equations(craft, motion, skewed_target):
    """J ω' + ω × J ω = 3 n² r × J r in B, and Clohessy-Wiltshire motion of the centre of mass."""
    full = craft.tree.with_target(skewed_target.to_standard_vector())
    locked, times = still(motion), np.linspace(0, 20, 6)
    dynamics = BodyDynamics.at(full, *np.zeros((2, 1, 4)) + locked.evaluate(0.0)[:2, None])
    J, com, mass = dynamics.I_K[0], dynamics.p_BK[0], full.mass
    found = propagate(
        craft.tree,
        locked,
        skewed_target.to_standard_vector(),
        times,
        momentum_W=MOMENTUM,
        wrench=lambda time: Wrench(orbit=ORBIT),
        max_step=0.02,
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
    np.testing.assert_allclose(found.momentum_W[-1, 3:], mass * drift[-1, 3:], rtol=0, atol=1e-7)


def _product(q, w):
    """Return q ∘ (0, w)."""
    return np.concatenate([[-q[1:] @ w], q[0] * w + np.cross(q[1:], w)])


def test_momentum_changes_by_the_forces_on_all_bodies(craft, motion, skewed_target):
    """While the joints move: the tide on every body, a disturbance, and thrusters."""
    phi, step = skewed_target.to_standard_vector(), 1e-3
    full = craft.tree.with_target(phi)
    times = 3.0 + step * np.arange(-2, 3)
    disturbance = np.arange(6) * 0.01
    thrust = np.array([0.5, -0.4, 0.3, 2.0, -1.0, 1.5])
    found = propagate(
        craft.tree,
        motion,
        phi,
        np.concatenate([[0.0], times]),
        momentum_W=MOMENTUM,
        wrench=lambda time: Wrench(disturbance, thrust, ORBIT),
        max_step=0.02,
        **POSE,
    )
    telemetry = found.to_motion(craft.joint_names, [0.0, *times], motion).select(slice(1, None))
    bodies, _ = forward_kinematics(full, **telemetry.states)
    P, L = (each.sum(axis=0) for each in momenta(full, bodies))
    momentum = np.hstack([L, P])
    rate = (8 * (momentum[3] - momentum[1]) - (momentum[4] - momentum[0])) / (12 * step)

    time, expected = times[2:3], np.zeros(6)
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
    np.testing.assert_allclose(found.momentum_W[1:], momentum, rtol=0, atol=1e-9)
