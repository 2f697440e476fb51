"""Momentum under external forces and torques, against a numerical solution of Newton's laws."""

import numpy as np
from scipy.integrate import solve_ivp

from cpid_drake.dynamics.disturbed_momentum import SystemMomentum

START = SystemMomentum(np.array([3.0, -2.0, 1.0, 5.0, 4.0, -6.0]), np.array([0.4, -0.3, 0.7]), 50.0)
DISTURBANCE_W = np.array([0.5, -0.2, 0.3, 0.02, -0.05, 0.04])
WRENCH_W = np.array([-1.0, 0.4, 0.8, 2.0, -3.0, 1.0])


def solved(start: SystemMomentum, time: float) -> SystemMomentum:
    """Integrate the two laws step by step."""

    def rates(_, state):
        p, P = state[6:], state[3:6]
        force = start.mass * DISTURBANCE_W[3:]
        torque = DISTURBANCE_W[:3] + WRENCH_W[:3] + np.cross(p, force)
        return np.concatenate([torque, force + WRENCH_W[3:], P / start.mass])

    initial = np.concatenate([start.momentum_W, start.p_WScm])
    end = solve_ivp(rates, (0.0, time), initial, rtol=1e-11, atol=1e-11).y[:, -1]
    return SystemMomentum(end[:6], end[6:], start.mass)


def test_the_polynomial_solves_newtons_laws():
    found, expected = START.after(7.0, DISTURBANCE_W, WRENCH_W), solved(START, 7.0)
    np.testing.assert_allclose(found.momentum_W, expected.momentum_W, rtol=1e-9)
    np.testing.assert_allclose(found.p_WScm, expected.p_WScm, rtol=1e-9)


def test_an_acceleration_does_not_turn_the_system():
    """It leaves the angular momentum about the system's own centre of mass constant."""

    def about_com(system):
        return system.momentum_W[:3] - np.cross(system.p_WScm, system.momentum_W[3:])

    moved = START.after(7.0, np.append(np.zeros(3), DISTURBANCE_W[3:]), np.zeros(6))
    np.testing.assert_allclose(about_com(moved), about_com(START), rtol=1e-12)
    turned = START.after(7.0, np.append(DISTURBANCE_W[:3], np.zeros(3)), np.zeros(6))
    np.testing.assert_allclose(about_com(turned) - about_com(START), 7 * DISTURBANCE_W[:3])
