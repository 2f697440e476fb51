"""What errors of joints and known bodies do to the base: against differences, and drawn."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from sensing_cases import small_craft

from cpid_drake import InertialParameters, Telemetry
from cpid_drake.dynamics.kinematics import propagate
from cpid_drake.dynamics.momentum import angular_momentum, linear_momentum, target_momentum
from cpid_drake.dynamics.parameterizations import relative_parameterization
from cpid_drake.dynamics.relative_motion import relative_dynamics
from cpid_drake.dynamics.sensitivity import (
    BodyUncertainty,
    body_sensitivity,
    joint_sensitivity,
    perturbed,
    stretched_inertia_rate,
)
from cpid_drake.dynamics.tree import KinematicTree

N = 5
STRETCHED = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)]  # Exx, Eyy, Ezz, Exy, Exz, Eyz


class Case:
    """Random instants of a spacecraft with a target and angular momentum L, seen from the base."""

    def __init__(self, craft, target) -> None:
        rng, J = np.random.default_rng(81), len(craft.joint_names)
        self.craft, self.target = craft, target
        self.q, self.qdot = rng.normal(size=(2, N, J))
        self.L = 20 * rng.normal(size=(N, 3))
        self.psi, self.dynamics, w, v, _ = self.solved(craft.tree, self.q, self.qdot)
        self.telemetry = Telemetry.seen_from_base(self.q, self.qdot, w, v)
        self.full = craft.tree.with_target(target.to_standard_vector())

    def solved(self, tree: KinematicTree, q, qdot):
        """Return ψ, the dynamics, ω, v and ρ where the momentum about the centre of mass is L."""
        mass = tree.mass
        psi = relative_parameterization(mass).from_parameters(self.target.to_vector())
        dynamics = relative_dynamics(tree, q, qdot)
        h, rho = dynamics.momentum_at_rest(psi), dynamics.com(psi)
        w = np.linalg.solve(dynamics.inertia(psi), (self.L - h)[..., None])[..., 0]
        return psi, dynamics, w, -(np.cross(w, rho) + dynamics.com_rate(psi)), rho


@pytest.fixture(scope="module")
def craft(tmp_path_factory):
    return small_craft(tmp_path_factory.mktemp("craft"), wheels=True)


@pytest.fixture(scope="module", params=["servicer", "craft"])
def case(request, skewed_target):
    """The servicer's joints all turn; the small craft has a sliding one and wheels."""
    return Case(request.getfixturevalue(request.param), skewed_target)


def assert_is_derivative(sensitivity, column, ahead, behind, step) -> None:
    for name, k in (("w", 2), ("v", 3), ("com", 4)):
        by_differences = (ahead[k] - behind[k]) / (2 * step)
        exact = getattr(sensitivity, name)[..., column]
        np.testing.assert_allclose(
            exact, by_differences, rtol=0, atol=1e-8, err_msg=f"{name}, column {column}"
        )


def test_by_joints(case):
    by_position, by_rate = joint_sensitivity(case.full, case.telemetry, case.psi, case.dynamics)
    step = 1e-5
    for j, unit in enumerate(np.eye(len(case.craft.joint_names))):
        moved = [case.solved(case.craft.tree, case.q + s * unit, case.qdot) for s in (step, -step)]
        assert_is_derivative(by_position, j, *moved, step)
        moved = [case.solved(case.craft.tree, case.q, case.qdot + s * unit) for s in (step, -step)]
        assert_is_derivative(by_rate, j, *moved, step)


def test_sliding_joints_are_among_them(craft):
    assert [body.name for body in craft.tree.bodies if body.prismatic] == ["tube"]


def changed(body, x):
    """Return a body after a change (10,) of mass, centre of mass and stretch."""
    E = np.zeros((3, 3))
    for value, (i, j) in zip(x[4:], STRETCHED, strict=True):
        E[i, j] = E[j, i] = value
    second_moment = np.trace(body.I_BBcm) / 2 * np.eye(3) - body.I_BBcm
    second_moment = (np.eye(3) + E) @ second_moment @ (np.eye(3) + E).T
    inertia = np.trace(second_moment) * np.eye(3) - second_moment
    return replace(body, mass=body.mass * (1 + x[0]), p_BBcm=body.p_BBcm + x[1:4], I_BBcm=inertia)


def test_by_known_bodies(case):
    """The target, given by its parameters, stays the same while the known bodies change."""
    tree, count = case.craft.tree, len(case.craft.tree.bodies)
    sensitivity = body_sensitivity(case.full, case.telemetry, case.psi, case.dynamics, count)
    assert sensitivity.w.shape == (N, 3, 10 * count)
    step = 1e-5
    for k in range(0, count, 1 if count < 10 else 3):
        for i, unit in enumerate(np.eye(10)):
            moved = []
            for s in (step, -step):
                bodies = list(tree.bodies)
                bodies[k] = changed(bodies[k], s * unit)
                new = replace(tree, bodies=tuple(bodies))
                moved.append(case.solved(new, case.q, case.qdot))
            assert_is_derivative(sensitivity, 10 * k + i, *moved, step)


def test_stretching_is_to_first_order(craft):
    rng = np.random.default_rng(82)
    body, x = craft.tree.bodies[1], np.concatenate([np.zeros(4), rng.normal(size=6)])
    E = np.zeros((3, 3))
    for value, (i, j) in zip(x[4:], STRETCHED, strict=True):
        E[i, j] = E[j, i] = value
    ahead, behind = (changed(body, s * x).I_BBcm for s in (1e-5, -1e-5))
    rate = stretched_inertia_rate(body.I_BBcm, E)
    np.testing.assert_allclose((ahead - behind) / 2e-5, rate, rtol=0, atol=1e-9)


def test_a_tree_with_the_target_has_its_momentum(craft, skewed_target):
    """Momentum of the tree with the target is that of the known bodies plus the target's."""
    rng, J = np.random.default_rng(83), len(craft.joint_names)
    motion = Telemetry(
        craft.joint_names,
        np.arange(N),
        Rotation.random(N, rng).as_quat(scalar_first=True),
        *rng.normal(size=(3, N, 3)),
        *rng.normal(size=(2, N, J)),
    )
    full = craft.tree.with_target(skewed_target.to_standard_vector())
    assert full.bodies[-1].name == "target"
    assert full.bodies[:-1] == craft.tree.bodies
    known, capture = propagate(craft.tree, motion)
    P_T, L_T = target_momentum(skewed_target, capture)
    everything, _ = propagate(full, motion)
    np.testing.assert_allclose(
        linear_momentum(full, everything), linear_momentum(craft.tree, known) + P_T, atol=1e-11
    )
    L = angular_momentum(craft.tree, known, capture.p_WC) + L_T
    np.testing.assert_allclose(
        angular_momentum(full, everything, capture.p_WC), L, rtol=0, atol=1e-11
    )


def test_disturbed_bodies_are_rigid_bodies_of_the_right_spread(craft):
    uncertainty = BodyUncertainty(mass=0.02, com=0.003, inertia=0.05)
    rng, draws = np.random.default_rng(84), 400
    body = craft.tree.bodies[0]
    axes = np.linalg.eigh(body.I_BBcm)[1]

    def second_moments(inertia):
        along = axes.T @ inertia @ axes
        return np.diag(np.trace(along) / 2 * np.eye(3) - along)

    masses, coms, moments = [], [], []
    for _ in range(draws):
        trees = perturbed(craft.tree, uncertainty, rng)
        for drawn in trees.bodies:
            assert InertialParameters(drawn.mass, drawn.p_BBcm, drawn.I_BBcm).is_feasible()
        drawn = trees.bodies[0]
        masses.append(drawn.mass / body.mass - 1)
        coms.append(drawn.p_BBcm - body.p_BBcm)
        moments.append(second_moments(drawn.I_BBcm) / second_moments(body.I_BBcm) - 1)
    # A sample's σ is itself uncertain by 1/√(2 N): 3.5 % of 400 draws, 2 % of three times as many.
    assert np.std(masses) == pytest.approx(0.02, rel=0.12)
    assert np.std(coms) == pytest.approx(0.003, rel=0.07)
    assert np.std(moments) == pytest.approx(0.05, rel=0.1)
    assert np.abs(np.mean(coms, axis=0)).max() < 4 * 0.003 / np.sqrt(draws)


def test_flat_and_thin_bodies_stay_possible(craft):
    """At the limit of what is possible too: a plate and a rod."""
    rng = np.random.default_rng(85)
    for moments in ([1.0, 2.0, 3.0], [0.0, 1.0, 1.0]):
        body = replace(craft.tree.bodies[0], I_BBcm=np.diag(moments))
        tree = replace(craft.tree, bodies=(body, *craft.tree.bodies[1:]))
        for _ in range(50):
            drawn = perturbed(tree, BodyUncertainty(inertia=0.3), rng).bodies[0]
            low, middle, high = np.linalg.eigvalsh(drawn.I_BBcm)
            assert low > -1e-14 * high
            assert high < (low + middle) * (1 + 1e-14) + 1e-14


def test_no_uncertainty_disturbs_nothing(craft):
    same = perturbed(craft.tree, BodyUncertainty(), np.random.default_rng(86))
    for drawn, body in zip(same.bodies, craft.tree.bodies, strict=True):
        assert drawn.mass == body.mass
        np.testing.assert_array_equal(drawn.p_BBcm, body.p_BBcm)
        np.testing.assert_allclose(drawn.I_BBcm, body.I_BBcm, rtol=0, atol=1e-13)
