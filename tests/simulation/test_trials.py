"""The truth of trials: external forces and torques change the momentum as Newton's laws say."""

from dataclasses import replace

import numpy as np
import pytest
from sensing_cases import MOMENTUM, Sines, coarse_suite

from cpid_drake.dynamics.momentum import system_momentum
from cpid_drake.dynamics.orbit import Orbit
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.sensors.disturbances import Disturbances
from cpid_drake.simulation.burns import Burn
from cpid_drake.simulation.trials import Case, base_trajectory, draw, ideal_samples

SIZES = Disturbances(1e-3, 0.2, acceleration_walk=5e-4, torque_walk=0.1)
TIMES = np.array([0.0, 0.3, 0.5, 1.1, 1.9, 2.5, 4.0])


@pytest.fixture(scope="module")
def case(skewed_target) -> Case:
    return Case(
        truth=skewed_target,
        motion=Sines.drawn(4, seed=101, duration=4.0),
        duration=4.0,
        momentum_W=MOMENTUM,
        momentum=TotalMomentum.unknown(),
        known_bodies=None,
        suite=coarse_suite(disturbances=SIZES),
        seed=3,
    )


def momenta(case, craft, disturbance):
    """Return P, L about the centre of mass, and this centre (N, 3), by sums over the bodies."""
    base = base_trajectory(case, craft.tree, TIMES, disturbance)
    telemetry = base.to_motion(craft.joint_names, TIMES, case.motion)
    P, L = system_momentum(craft.tree, case.truth, telemetry)
    mass = case.truth.mass + craft.mass
    still = replace(telemetry, w_WB=0 * telemetry.w_WB, v_WB=np.zeros_like(P), qdot=0 * telemetry.q)
    # The angular momentum of a system in pure translation with velocity u is m p × u.
    p = np.zeros_like(P)
    for axis in range(3):
        u = np.eye(3)[(axis + 1) % 3]
        _, moving = system_momentum(craft.tree, case.truth, replace(still, v_WB=np.tile(u, (7, 1))))
        p[:, axis] = moving[:, (axis + 2) % 3] / mass
    return P, L - np.cross(p, P), p


def test_forces_and_torques_change_the_momentum(case, craft):
    disturbance = case.disturbance(8)
    (P, L, p), (P0, L0, p0) = (
        momenta(case, craft, each) for each in (disturbance, case.disturbance())
    )
    fine = np.arange(0.0, 4.0, 0.01)
    values = np.array([disturbance.at(t) for t in fine])
    summed = np.vstack([np.zeros(6), np.cumsum(values * 0.01, axis=0)])
    impulses = np.array([summed[round(t / 0.01)] for t in TIMES])
    mass = case.truth.mass + craft.mass
    np.testing.assert_allclose(P - P0, mass * impulses[:, 3:], atol=1e-9 * mass)
    speeds = np.vstack([np.zeros(3), np.cumsum(summed[:-1, 3:] * 0.01, axis=0)])
    moved = np.array([speeds[round(t / 0.01)] for t in TIMES])
    np.testing.assert_allclose(p - p0, moved, atol=3e-5)  # a sum of rectangles
    np.testing.assert_allclose(L - L0, impulses[:, :3], atol=1e-7)


def test_an_orbit_leaves_burns_and_disturbances_as_they_are(case, craft):
    """The momentum is integrated in an orbit, and has a closed form without one."""
    free = replace(case, burns=(Burn(1.3, 0.4, np.array([7.0, -5, 5]), np.full(3, 0.5)),))
    sizes = replace(SIZES, orbit=Orbit(rate=1e-9))
    slow = replace(free, suite=replace(case.suite, disturbances=sizes))
    expected, found = (
        base_trajectory(each, craft.tree, TIMES, case.disturbance(8)) for each in (free, slow)
    )
    for name, value in vars(expected).items():
        np.testing.assert_allclose(getattr(found, name), value, rtol=0, atol=1e-8, err_msg=name)


def test_every_trial_has_its_own_disturbance(case, craft):
    ideal = ideal_samples(case, craft.tree, craft.joint_names)
    one, again, other = (draw(case, craft, number) for number in (0, 0, 1))
    np.testing.assert_array_equal(one.position.value, again.position.value)
    drift = np.abs(one.position.value - ideal.position.value)
    assert drift[-1].max() > 10 * case.suite.position.sigma / 4
    assert np.abs(one.position.value - other.position.value)[-1].max() > 1e-3


def test_given_values_act_in_all_trials(case, craft):
    push = np.array([0.01, 0.0, 0.0])
    pushed = replace(
        case,
        suite=coarse_suite(position=replace(case.suite.position, sigma=0.0)),
        acceleration_W=push,
    )
    quiet = replace(pushed, acceleration_W=None)
    drift = draw(pushed, craft, 0).position.value - draw(quiet, craft, 0).position.value
    np.testing.assert_allclose(drift[-1], 0.5 * push * 4.0**2, atol=1e-9)
