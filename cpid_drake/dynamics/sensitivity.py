"""First-order effects of errors of joint motion and bodies on the base's motion.

Joint positions and rates come from encoders; masses, centres of mass and inertias of the
bodies, and the geometry of the arm, come from drawings. This module computes, in closed form, the
derivatives of the base's angular velocity and of the position of the system's centre of mass with
respect to each of these quantities.

A change of a joint's position, of its place or of its direction displaces all bodies outboard of it
by a small screw S, see `outboard`; a change of its rate changes their momentum by I S. An error of
the capture frame's pose displaces the target alone.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cpid_drake.array import Array
from cpid_drake.dynamics.body_dynamics import BodyDynamics
from cpid_drake.dynamics.outboard import Outboard
from cpid_drake.dynamics.parameterizations import (
    UNIT_TENSORS,
    inertia_of_second_moment,
    second_moment,
)
from cpid_drake.dynamics.rotations import exponentials, right_jacobian, rotate, skew
from cpid_drake.dynamics.tree import KinematicTree, TreeBody
from cpid_drake.dynamics.uncertainty import BodyUncertainty


@dataclass(frozen=True)
class MotionSensitivity:
    """Derivatives of the base's motion by n quantities, at N instants, at constant momentum.

    Attributes:
        w: (N, 3, n) derivatives of the base's angular velocity, in B.
        com: (N, 3, n) derivatives of the system's centre of mass from B's origin, in B.
        v: (N, 3, n) derivatives of the base's velocity in W, in B, for a centre of mass at rest.
        screw: (N, 6, n) small screws that displace the target, at B's origin, in B.

    """

    w: Array
    com: Array
    v: Array
    screw: Array


def screw_sensitivity(
    outboard: Outboard, psi: Array, dynamics: BodyDynamics, which: Sequence[int], S: Array
) -> tuple[MotionSensitivity, MotionSensitivity]:
    """Return the derivatives by displacements along screws, and by their rates.

    Those of `Outboard.joint_screws` are joint positions and joint rates; see `Outboard.by_joint`.

    Args:
        outboard: the spacecraft's bodies *and* the target, as from `KinematicTree.with_target`.
        psi: (10,) the target's relative vector ψ = (μ, μc, I_*).
        dynamics: dynamics of the spacecraft's bodies alone, at the same instants.
        which, S: bodies (n,) and screws (N, 6, n); see `Outboard.displaced`.

    """
    change, by_rates = outboard.displaced(which, S)
    moved = by_rates[:, 3:] / outboard.tree.mass
    inboard = np.isin(which, outboard.inboard_of_target)
    return (
        _motion_sensitivity(change, moved, S * inboard, psi, dynamics),
        _motion_sensitivity(by_rates, np.zeros_like(moved), np.zeros_like(S), psi, dynamics),
    )


def uncertain_sensitivity(
    outboard: Outboard,
    psi: Array,
    dynamics: BodyDynamics,
    uncertainty: BodyUncertainty,
    errors: Array,
) -> MotionSensitivity:
    """Return the derivatives with respect to all uncertain quantities, each in units of its σ.

    They are the quantities of `BodyUncertainty.all_sigmas` whose σ is not zero, at their present
    errors (c,), which the bodies already have; see `with_errors`. The target remains unchanged in
    C. Other arguments as for `screw_sensitivity`.
    """
    tree = outboard.tree
    craft = replace(tree, bodies=tree.bodies[:-1])
    bodies, joints, grasp = _errors_of(craft, uncertainty, errors)
    sigmas = uncertainty.all_sigmas(craft.wheels, len(joints))
    of_bodies, of_geometry = np.split(sigmas > 0, [bodies.size])
    parts = [
        _by_bodies(outboard, dynamics.com(psi), bodies, of_bodies),
        _by_geometry(outboard, joints, grasp, of_geometry),
    ]
    momentum, com, screws = (
        np.concatenate(each, axis=-1) * sigmas[sigmas > 0] for each in zip(*parts, strict=True)
    )
    return _motion_sensitivity(momentum, com, screws, psi, dynamics)


def _by_geometry(
    outboard: Outboard, joints: Array, grasp: Array, wanted: NDArray[np.bool_]
) -> tuple[Array, ...]:
    """Return derivatives of momentum and centre of mass by errors of the geometry, and screws."""
    tree = outboard.tree
    if not wanted.any():
        screws = np.zeros((*outboard.bodies.r.shape[1:2], 6, 0))
        return screws, screws[:, 3:], screws
    moving, target, S = tree.jointed, len(tree.bodies) - 1, []
    for k, error in zip(moving, joints, strict=True):
        normals = axis_normals(tree.bodies[k])
        turns = right_jacobian(normals @ error[3:]) @ normals
        S.append(outboard.frame_screws(k, turns))
    of_C = outboard.frame_screws(target, right_jacobian(grasp[3:]))
    of_C[:, 3:, :3] = of_C[:, 3:, :3] @ tree.bodies[target].R_PF @ exponentials(-grasp[3:])
    which = np.array([*np.repeat(moving, 5), *6 * [target]])[wanted].tolist()
    screws = np.concatenate([*S, of_C], axis=-1)[..., wanted]
    change, moved = outboard.displaced(which, screws)
    inboard = np.isin(which, outboard.inboard_of_target)
    return change, moved[:, 3:] / tree.mass, screws * inboard


def _by_bodies(
    outboard: Outboard, rho: Array, errors: Array, wanted: NDArray[np.bool_]
) -> tuple[Array, ...]:
    """Return the same by errors (K, 10) of the first K bodies; Σ becomes (1 + E) Σ (1 + E)ᵀ."""
    tree, bodies = outboard.tree, outboard.bodies
    total, K, N, dtype = tree.mass, len(errors), len(rho), bodies.v.dtype
    momentum, com = np.zeros((N, 6, K, 10), dtype), np.zeros((N, 3, K, 10), dtype)
    for k, (body, error) in enumerate(zip(tree.bodies, errors)):
        if not wanted[10 * k :][:10].any():
            continue
        R, r, w, v = bodies.R[k], bodies.r[k], bodies.w[k], bodies.v[k]
        nominal, mass = body.mass / (1 + error[0]), body.mass
        axes_B, stretches = error_directions(tree, k)
        axes = R @ axes_B.T
        dP, dL, shift = np.zeros((3, N, 3, 10), dtype)
        dP[..., 0], dP[..., 1:4] = nominal * v, mass * skew(w) @ axes
        dL[:] = skew(r) @ dP
        dL[..., 1:4] -= mass * skew(v) @ axes
        present = np.eye(3) + np.tensordot(error[4:], stretches, axes=1)
        sigma, w_B = second_moment(body.I_BBcm), rotate(np.swapaxes(R, -1, -2), w)
        for i, E in enumerate(stretches @ np.linalg.inv(present)):
            change = inertia_of_second_moment(E @ sigma + sigma @ E.T)
            dL[..., 4 + i] = rotate(R, w_B @ change)
        shift[..., 0], shift[..., 1:4] = nominal / total * (r - rho), mass / total * axes
        momentum[:, :, k], com[:, :, k] = np.concatenate([dL, dP], axis=1), shift
    changes = momentum.reshape(N, 6, -1)[..., wanted]
    return changes, com.reshape(N, 3, -1)[..., wanted], np.zeros_like(changes)


def error_directions(tree: KinematicTree, k: int) -> tuple[Array, Array]:
    """Return the directions of body k's errors: its centre of mass (3, 3), its stretch (6, 3, 3).

    They are the axes of the body's frame, and the unit stretches xx, yy, zz, xy, xz, yz. A wheel
    remains balanced: its centre of mass has an error along the axis n alone, and its second moment
    stretches along the axis (n nᵀ) and equally across it (1 − n nᵀ). Its other directions are zero.
    """
    body = tree.bodies[k]
    if not tree.wheels[k]:
        return np.eye(3), UNIT_TENSORS
    axis = body.axis_F
    axes, stretches = np.zeros((3, 3)), np.zeros((6, 3, 3))
    axes[0], stretches[0] = axis, np.outer(axis, axis)
    stretches[1] = np.eye(3) - stretches[0]
    return axes, stretches


def axis_normals(body: TreeBody) -> Array:
    """Return (3, 2) two unit vectors perpendicular to the axis of a body's joint, in F."""
    axis = body.axis_F
    first = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(axis, first)], axis=-1)


def perturbed(
    tree: KinematicTree, uncertainty: BodyUncertainty, rng: np.random.Generator
) -> KinematicTree:
    """Return a tree whose bodies and geometry are drawn at random around those of `tree`.

    The inertias remain physically consistent.
    """
    sigmas = uncertainty.all_sigmas(tree.wheels, len(tree.jointed))
    return with_errors(tree, uncertainty, rng.standard_normal(len(sigmas))[sigmas > 0])


def with_errors(tree: KinematicTree, uncertainty: BodyUncertainty, errors: Array) -> KinematicTree:
    """Return a tree with errors of its bodies and geometry, which may be large.

    The inertias remain physically consistent; a mass does if its relative error is above −1.

    Args:
        tree: the spacecraft's bodies.
        uncertainty: the σ of the errors.
        errors: (c,) in units of σ, without the quantities whose σ is zero; first those of each
            body, then of each joint, then of C.

    """
    of_bodies, of_joints, grasp = _errors_of(tree, uncertainty, errors)
    bodies = []
    for k, (body, error) in enumerate(zip(tree.bodies, of_bodies, strict=True)):
        axes, stretches = error_directions(tree, k)
        stretch = np.eye(3) + np.tensordot(error[4:], stretches, axes=1)
        inertia = inertia_of_second_moment(stretch @ second_moment(body.I_BBcm) @ stretch.T)
        mass, com = body.mass * (1 + error[0]), body.p_BBcm + error[1:4] @ axes
        bodies.append(replace(body, mass=mass, p_BBcm=com, I_BBcm=inertia))
    for k, error in zip(tree.jointed, of_joints, strict=True):
        body = bodies[k]
        turn = exponentials(axis_normals(body) @ error[3:])
        bodies[k] = replace(body, p_PF=body.p_PF + error[:3], R_PF=body.R_PF @ turn)
    p_BC, R_BC = tree.p_BC + tree.R_BC @ grasp[:3], tree.R_BC @ exponentials(grasp[3:])
    return replace(tree, bodies=tuple(bodies), p_BC=p_BC, R_BC=R_BC)


def _errors_of(
    tree: KinematicTree, uncertainty: BodyUncertainty, errors: Array
) -> tuple[Array, Array, Array]:
    """Return errors of bodies (K, 10), joints (J, 5) and C (6,) in SI units; see `with_errors`."""
    sizes = uncertainty.all_sigmas(tree.wheels, len(tree.jointed))
    sizes[sizes > 0] *= errors
    of_bodies, of_joints, grasp = np.split(sizes, [10 * len(tree.bodies), len(sizes) - 6])
    return of_bodies.reshape(-1, 10), of_joints.reshape(-1, 5), grasp


def _motion_sensitivity(
    momentum: Array, com: Array, screws: Array, psi: Array, dynamics: BodyDynamics
) -> MotionSensitivity:
    """Return those of the motion from those of [L; P] (N, 6, n), at constant base twist, and ρ."""
    rho = skew(dynamics.com(psi))
    dL, dP = momentum[:, :3], momentum[:, 3:]
    w = -dynamics.mobility(psi) @ (dL - rho @ dP)
    return MotionSensitivity(w, com, rho @ w - dP / dynamics.total_mass(psi), screws)
