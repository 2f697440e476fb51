"""What errors of joints and known bodies do to the base: against differences, and drawn."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from sensing_cases import small_craft

from cpid_drake import InertialParameters, Spacecraft
from cpid_drake.dynamics.body_dynamics import BodyDynamics
from cpid_drake.dynamics.kinematics import forward_kinematics
from cpid_drake.dynamics.outboard import Outboard
from cpid_drake.dynamics.parameterizations import relative_parameterization
from cpid_drake.dynamics.sensitivity import (
    axis_normals,
    perturbed,
    screw_sensitivity,
    uncertain_sensitivity,
    with_errors,
)
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.dynamics.uncertainty import BodyUncertainty

N = 5


class Case:
    """Random instants of a spacecraft with a target and angular momentum L, seen from the base."""

    def __init__(self, tree, joint_names, target) -> None:
        rng, J = np.random.default_rng(81), len(joint_names)
        self.tree, self.joint_names, self.target = tree, joint_names, target
        self.q, self.qdot = rng.normal(size=(2, N, J))
        self.L = 20 * rng.normal(size=(N, 3))
        self.psi, self.dynamics, w, v, _ = self.solved(tree, self.q, self.qdot)
        full = tree.with_target(target.to_standard_vector())
        self.outboard = Outboard.at(full, self.q, self.qdot, w, v)

    def solved(self, tree: KinematicTree, q, qdot, target=None):
        """Return ψ, the dynamics, ω, v and ρ where the momentum about the centre of mass is L."""
        mass, target = tree.mass, target or self.target
        psi = relative_parameterization(mass).from_parameters(target.to_vector())
        dynamics = BodyDynamics.at(tree, q, qdot)
        h, rho = dynamics.momentum_at_rest(psi), dynamics.com(psi)
        w = np.linalg.solve(dynamics.inertia(psi), (self.L - h)[..., None])[..., 0]
        return psi, dynamics, w, -(np.cross(w, rho) + dynamics.com_rate(psi)), rho


@pytest.fixture(scope="module")
def craft(tmp_path_factory):
    return small_craft(tmp_path_factory.mktemp("craft"), wheels=True)


@pytest.fixture(scope="module")
def gripper(tmp_path_factory):
    return small_craft(tmp_path_factory.mktemp("gripper"), gripper=True)


@pytest.fixture(scope="module", params=["servicer", "craft", "gripper"])
def case(request, skewed_target):
    """The servicer's joints all turn; the small craft has a sliding one, wheels, and C askew.

    Of the one with a gripper, joints follow others.
    """
    craft = request.getfixturevalue(request.param)
    tree = craft.tree
    if request.param == "craft":
        R_BC = Rotation.from_rotvec([0.7, -0.4, 1.1]).as_matrix()
        tree = replace(tree, R_BC=R_BC, p_BC=np.array([0.1, -0.2, 0.3]))
    return Case(tree, craft.joint_names, skewed_target)


def test_screws_of_the_grasp_are_about_and_along_the_axes_of_c(case):
    which, S = case.outboard.grasp_screws
    _, capture = forward_kinematics(case.tree, case.q, case.qdot)
    axes, turns, shifts = capture.R_WC, S[..., :3], S[..., 3:]
    assert which == 6 * [len(case.tree.bodies)]
    np.testing.assert_allclose(turns[:, :3], axes, atol=1e-12)
    moments = np.cross(capture.p_WC[:, :, None], axes, axis=1)
    np.testing.assert_allclose(turns[:, 3:], moments, atol=1e-12)
    np.testing.assert_allclose(shifts[:, 3:], axes, atol=1e-12)
    assert not shifts[:, :3].any()


def assert_is_derivative(sensitivity, column, ahead, behind, step) -> None:
    for name, k in (("w", 2), ("v", 3), ("com", 4)):
        by_differences = (ahead[k] - behind[k]) / (2 * step)
        exact = getattr(sensitivity, name)[..., column]
        np.testing.assert_allclose(
            exact, by_differences, rtol=0, atol=1e-8, err_msg=f"{name}, column {column}"
        )


def test_by_joints(case):
    each = screw_sensitivity(case.outboard, case.psi, case.dynamics, *case.outboard.joint_screws)
    by_position, by_rate = (
        replace(by, **{name: case.outboard.by_joint(part) for name, part in vars(by).items()})
        for by in each
    )
    assert by_rate.w.shape == (N, 3, len(case.joint_names))
    step = 1e-5
    for j, unit in enumerate(np.eye(len(case.joint_names))):
        moved = [case.solved(case.tree, case.q + s * unit, case.qdot) for s in (step, -step)]
        assert_is_derivative(by_position, j, *moved, step)
        moved = [case.solved(case.tree, case.q, case.qdot + s * unit) for s in (step, -step)]
        assert_is_derivative(by_rate, j, *moved, step)


@pytest.mark.parametrize("size", [0.0, 1.0], ids=["no errors", "errors"])
def test_by_bodies_and_geometry(case, size):
    """Of bodies, arm and C: a step of a relative mass is one of the nominal mass."""
    uncertainty = BodyUncertainty(0.1, 0.02, 0.2, 5.0, 60.0, 4.0, 80.0)
    count = uncertainty.count(case.tree.wheels, len(case.joint_names))
    errors = size * np.random.default_rng(82).normal(size=count)
    there = Case(with_errors(case.tree, uncertainty, errors), case.joint_names, case.target)
    sensitivity = uncertain_sensitivity(
        there.outboard, there.psi, there.dynamics, uncertainty, errors
    )
    step = 1e-5
    for column, unit in enumerate(np.eye(count)):
        moved = [
            case.solved(with_errors(case.tree, uncertainty, errors + s * unit), case.q, case.qdot)
            for s in (step, -step)
        ]
        assert_is_derivative(sensitivity, column, *moved, step)


def test_an_error_of_the_grasp_is_one_of_the_target(case):
    """A target in a frame C that is off moves the base as another target in the nominal C does."""
    declared = BodyUncertainty(grasp_mm=1e3, grasp_mrad=1e3)
    sensitivity = uncertain_sensitivity(
        case.outboard, case.psi, case.dynamics, declared, np.zeros(6)
    )
    target, step = case.target, 1e-5
    for i, unit in enumerate(np.eye(6)):
        moved = []
        for s in (step, -step):
            R = Rotation.from_rotvec(s * unit[3:]).as_matrix()
            com, inertia = s * unit[:3] + R @ target.p_CTcm_C, R @ target.I_TTcm_C @ R.T
            other = InertialParameters(target.mass, com, inertia)
            moved.append(case.solved(case.tree, case.q, case.qdot, other))
        assert_is_derivative(sensitivity, i, *moved, step)


def test_a_displaced_tree_is_that_of_a_changed_model(tmp_path):
    """Joints of all kinds and C, in the frames in which a model file gives them."""
    craft, rng = small_craft(tmp_path), np.random.default_rng(87)
    joints, grasp = 0.1 * rng.normal(size=(4, 5)), 0.1 * rng.normal(size=6)
    text = (tmp_path / "craft.urdf").read_text()
    moving = [body for body in craft.tree.bodies if body.joint >= 0]
    for body, error in zip(moving, joints, strict=True):
        xyz, place = (" ".join(map(str, p.tolist())) for p in (body.p_PF, body.p_PF + error[:3]))
        turn = Rotation.from_rotvec(axis_normals(body) @ error[3:])
        rpy = (Rotation.from_matrix(body.R_PF) * turn).as_euler("xyz")
        rpy = " ".join(map(str, rpy))
        old = f'<origin xyz="{xyz}" rpy="0.3 -0.2 0.4"/>'
        assert text.count(old) == 1
        text = text.replace(old, f'<origin xyz="{place}" rpy="{rpy}"/>')
    place = " ".join(map(str, grasp[:3]))
    turn = " ".join(map(str, Rotation.from_rotvec(grasp[3:]).as_euler("xyz")))
    text = text.replace(
        "</robot>",
        '<link name="grasp"/><joint name="held" type="fixed"><parent link="hand"/>'
        f'<child link="grasp"/><origin xyz="{place}" rpy="{turn}"/></joint></robot>',
    )
    (tmp_path / "changed.urdf").write_text(text)
    changed = Spacecraft(tmp_path / "changed.urdf", base="base", capture_frame="grasp")
    metres = BodyUncertainty(
        joint_position_mm=1e3, joint_axis_mrad=1e3, grasp_mm=1e3, grasp_mrad=1e3
    )
    tree = with_errors(craft.tree, metres, np.append(joints, grasp))
    q, qdot = rng.normal(size=(2, N, 4))
    one, other = BodyDynamics.at(tree, q, qdot), BodyDynamics.at(changed.tree, q, qdot)
    for name in ("I_K", "h_K", "p_BK", "v_BK", "R_BC", "w_BC", "s", "sdot"):
        value, expected = getattr(one, name), getattr(other, name)
        np.testing.assert_allclose(value, expected, rtol=0, atol=1e-9, err_msg=name)


def spread(values) -> float:
    """Return the standard deviation about zero."""
    return np.sqrt(np.mean(np.square(values)))


def second_moment(inertia, axes) -> np.ndarray:
    """Return the second moments along axes (columns) of an inertia."""
    return np.diag(axes.T @ (np.trace(inertia) / 2 * np.eye(3) - inertia) @ axes)


def test_drawn_spacecraft_are_rigid_bodies_of_the_declared_spread(craft):
    """A sample's σ is itself uncertain by 1/√(2 N): 3.5 % of 400 draws."""
    uncertainty = BodyUncertainty(0.02, 0.003, 0.05, 3.0, 20.0, 5.0, 10.0)
    rng, tree, body = np.random.default_rng(84), craft.tree, craft.tree.bodies[0]
    k = max(k for k, each in enumerate(tree.bodies) if each.joint >= 0)
    axes, found = np.linalg.eigh(body.I_BBcm)[1], []
    for _ in range(400):
        drawn = perturbed(tree, uncertainty, rng)
        for each in drawn.bodies:
            assert InertialParameters(
                each.mass, each.p_BBcm, each.I_BBcm
            ).is_physically_consistent()
        moments, nominal = (second_moment(b.I_BBcm, axes) for b in (drawn.bodies[0], body))
        one, link = drawn.bodies[k], tree.bodies[k]
        np.testing.assert_allclose(one.R_PF @ one.R_PF.T, np.eye(3), rtol=0, atol=1e-14)
        found.append(
            (
                [drawn.bodies[0].mass / body.mass - 1],
                drawn.bodies[0].p_BBcm - body.p_BBcm,
                moments / nominal - 1,
                one.p_PF - link.p_PF,
                [np.linalg.norm((one.R_PF - link.R_PF) @ link.axis_F) / np.sqrt(2)],
                drawn.p_BC - tree.p_BC,
                Rotation.from_matrix(tree.R_BC.T @ drawn.R_BC).as_rotvec(),
            )
        )
    sigmas = (0.02, 0.003, 0.05, 0.003, 0.02, 0.005, 0.01)
    for values, sigma in zip(zip(*found), sigmas, strict=True):
        assert spread(values) == pytest.approx(sigma, rel=0.12)


def test_a_wheel_remains_balanced(craft):
    """Its errors have the same σ, but none moves its centre of mass from the axis or tilts it."""
    uncertainty = BodyUncertainty(mass=0.02, com=0.003, inertia=0.05, joint_axis_mrad=20)
    rng, tree = np.random.default_rng(90), craft.tree
    k = tree.wheels.index(True)
    body = tree.bodies[k]
    axis, across = body.axis_F, axis_normals(body)[:, 0]
    shifts, moments = [], []
    for _ in range(400):
        drawn = perturbed(tree, uncertainty, rng)
        assert drawn.wheels == tree.wheels
        shift = drawn.bodies[k].p_BBcm - body.p_BBcm
        shifts.append(axis @ shift)
        np.testing.assert_allclose(shift, shifts[-1] * axis, rtol=0, atol=1e-15)
        both = (
            second_moment(b.I_BBcm, np.stack([axis, across], 1)) for b in (drawn.bodies[k], body)
        )
        moments.append(np.divide(*both) - 1)
    assert spread(shifts) == pytest.approx(0.003, rel=0.12)
    np.testing.assert_allclose([spread(each) for each in zip(*moments)], 0.05, rtol=0.12)
    assert np.abs(np.corrcoef(np.transpose(moments))[0, 1]) < 0.2
    count = uncertainty.count(tree.wheels, len(craft.joint_names))
    assert count == 4 * 2 + 10 * (len(tree.bodies) - 2) + 2 * len(craft.joint_names)
