"""The known bodies as seen from the base: rates, linearity in the target, reaction wheels."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from sensing_cases import RPY, small_craft, true_psi

from cpid_drake.dynamics.body_dynamics import BodyDynamics
from cpid_drake.dynamics.rotations import rotate


@pytest.fixture(scope="module")
def craft(tmp_path_factory):
    """With turning and sliding joints and reaction wheels."""
    return small_craft(tmp_path_factory.mktemp("craft"), wheels=True)


@pytest.fixture(scope="module")
def states(craft):
    """Joint positions and rates at random instants; the wheels spin fast."""
    rng = np.random.default_rng(71)
    q, qdot = rng.normal(size=(2, 12, len(craft.joint_names)))
    qdot[:, -2:] *= 300.0
    return q, qdot


@pytest.fixture(scope="module")
def dynamics(craft, states):
    return BodyDynamics.at(craft.tree, *states)


def test_com_rate_is_the_rate_of_com(craft, states, skewed_target):
    """By differences over joint motion at constant rates."""
    q, qdot = states
    qdot = np.where(np.abs(qdot) > 50, 1.0, qdot)
    psi, h = true_psi(craft, skewed_target), 1e-5
    ahead, behind = (BodyDynamics.at(craft.tree, q + s * qdot, qdot).com(psi) for s in (h, -h))
    rate = BodyDynamics.at(craft.tree, q, qdot).com_rate(psi)
    np.testing.assert_allclose((ahead - behind) / (2 * h), rate, rtol=0, atol=1e-9)


def test_everything_is_linear_in_psi(dynamics):
    """J, h, ρ and ρ' are affine in ψ, and their regressors are their derivatives."""
    rng = np.random.default_rng(74)
    a, b, w = rng.normal(size=10), rng.normal(size=10), rng.normal(size=(12, 3))
    for function in (
        dynamics.inertia,
        dynamics.momentum_at_rest,
        dynamics.com,
        dynamics.com_rate,
    ):
        known = function(np.zeros(10))
        both = function(2 * a - 3 * b) - known
        apart = 2 * (function(a) - known) - 3 * (function(b) - known)
        np.testing.assert_allclose(both, apart, rtol=0, atol=1e-12 * np.abs(apart).max())

    known = rotate(dynamics.I_K, w) + dynamics.h_K
    target = rotate(dynamics.inertia(a), w) + dynamics.momentum_at_rest(a) - known
    Y = dynamics.regressor(w)
    np.testing.assert_allclose(Y @ a, target, rtol=0, atol=1e-12 * np.abs(Y).max())
    for regressor, function in (
        (dynamics.com_regressor(), dynamics.com),
        (dynamics.com_rate_regressor(), dynamics.com_rate),
    ):
        by_hand = function(a) - function(np.zeros(10))
        np.testing.assert_allclose(regressor @ a[:4], by_hand, rtol=0, atol=1e-14)


def test_reaction_wheels_are_known_bodies(craft, tmp_path):
    """At rest they add mass and inertia; spinning, just their own spin, whatever their angle."""
    assert craft.joint_names[-2:] == ("spin_x", "spin_y")
    assert craft.mass == pytest.approx(small_craft(tmp_path).mass + 8.0)
    rng = np.random.default_rng(77)
    q, qdot = rng.normal(size=(2, 5, len(craft.joint_names)))
    qdot[:, -2:] = 0.0
    still = BodyDynamics.at(craft.tree, q, qdot)
    qdot[:, -2:] = rates = np.array([100.0, -250.0])
    q[:, -2:] += 1.0
    spinning = BodyDynamics.at(craft.tree, q, qdot)
    axes = Rotation.from_euler("xyz", RPY).as_matrix()[:, :2]
    momentum = axes @ (np.array([0.04, 0.05]) * rates)
    np.testing.assert_allclose(
        spinning.h_K - still.h_K, np.tile(momentum, (5, 1)), rtol=0, atol=1e-12
    )
    for name in ("I_K", "p_BK", "v_BK", "s", "sdot", "w_BC"):
        before, after = getattr(still, name), getattr(spinning, name)
        np.testing.assert_allclose(after, before, rtol=0, atol=1e-13, err_msg=name)
