"""First-order effects of errors in the joint motion and in the known bodies on the base's motion.

Joint positions and rates come from encoders; masses, centres of mass and inertias of the known
bodies come from drawings. This module computes, in closed form, the derivatives of the base's
angular velocity and of the position of the system's centre of mass with respect to each of these
quantities.

S_j = [a; o × a] is the screw of joint j. I and Π are the spatial inertia and the momentum about
B's origin, in B, of all bodies outboard of joint j, and V is the twist of the first of them:

    ∂Π/∂q̇_j = I S_j,      ∂Π/∂q_j = S_j ×* Π − I (S_j × V),

with × and ×* the cross products of twists and of momenta (Featherstone 2008, ch. 2).
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.kinematics import propagate
from cpid_drake.dynamics.momentum import angular_momenta, linear_momenta
from cpid_drake.dynamics.parameterizations import REPORT_ORDER, vector_to_tensor
from cpid_drake.dynamics.relative_motion import RelativeDynamics
from cpid_drake.dynamics.rotations import rotate, skew
from cpid_drake.dynamics.spatial_inertia import (
    inertia_of_second_moment,
    moved_spatial_inertia,
    second_moment,
)
from cpid_drake.dynamics.telemetry import Telemetry
from cpid_drake.dynamics.tree import KinematicTree, TreeBody

# The six symmetric unit stretches (6, 3, 3): xx, yy, zz, xy, xz, yz.
_STRETCHES = vector_to_tensor(np.eye(6))[REPORT_ORDER]


@dataclass(frozen=True)
class MotionSensitivity:
    """Derivatives of the base's motion by n quantities, at N instants, at constant momentum.

    Attributes:
        w: (N, 3, n) derivatives of the base's angular velocity, in B.
        com: (N, 3, n) derivatives of the system's centre of mass from B's origin, in B.
        v: (N, 3, n) derivatives of the base's velocity in W, in B, for a centre of mass at rest.

    """

    w: NDArray[np.float64]
    com: NDArray[np.float64]
    v: NDArray[np.float64]


@dataclass(frozen=True)
class BodyUncertainty:
    """Uncertainty of the known bodies' inertial parameters; the same σ for every body.

    Attributes:
        mass: relative σ of the mass.
        com: σ of each coordinate of the centre of mass [m].
        inertia: relative σ of the principal second moments, and σ of the directions of the
            principal axes [rad].

    """

    mass: float = 0.0
    com: float = 0.0
    inertia: float = 0.0

    @property
    def sigmas(self) -> NDArray[np.float64]:
        """(10,) σ of one body's relative mass (1), centre of mass (3) [m] and stretch (6)."""
        stretch = self.inertia / 2  # the second moment grows by twice the stretch
        return np.array([self.mass, *3 * [self.com], *6 * [stretch]])


def joint_sensitivity(
    tree: KinematicTree, telemetry: Telemetry, psi: NDArray[np.float64], dynamics: RelativeDynamics
) -> tuple[MotionSensitivity, MotionSensitivity]:
    """Return the derivatives with respect to the J joint positions and joint rates.

    Args:
        tree: the known bodies *and* the target, as from `KinematicTree.with_target`.
        telemetry: N instants, as from `Telemetry.seen_from_base`.
        psi: (10,) the target's relative vector ψ = (μ, μc, I_*).
        dynamics: dynamics of the known bodies alone, at the same instants.

    Source: Featherstone 2008, ch. 2.

    """
    bodies, _ = propagate(tree, telemetry)
    moved = zip(tree.bodies, bodies.R, bodies.r, strict=True)
    inertia = np.stack([moved_spatial_inertia(b.mass, b.I_BBcm, R, r) for b, R, r in moved])
    L, P = angular_momenta(tree, bodies, np.zeros(3)), linear_momenta(tree, bodies)
    momentum = np.concatenate([np.stack(list(L)), P], axis=-1)
    for k in range(len(tree.bodies) - 1, 0, -1):  # outboard bodies first
        parent = tree.bodies[k].parent
        inertia[parent] += inertia[k]
        momentum[parent] += momentum[k]
    N, J = len(telemetry), len(telemetry.joint_names)
    by_position, by_rate = np.zeros((2, N, 6, J))
    com_shift = np.zeros((N, 3, J))
    for k, body in enumerate(tree.bodies):
        if body.joint < 0:
            continue
        S, j = _screw(body, bodies.R[k], bodies.r[k]), body.joint
        w = bodies.w[k]
        V = np.concatenate([w, bodies.v[k] - np.cross(w, bodies.r[k])], axis=-1)
        by_rate[:, :, j] = rotate(inertia[k], S)
        by_position[:, :, j] = _cross_force(S, momentum[k]) - rotate(
            inertia[k], _cross_motion(S, V)
        )
        com_shift[:, :, j] = by_rate[:, 3:, j] / inertia[0, :, 5, 5][:, None]
    still = np.zeros_like(com_shift)
    return (
        _motion_sensitivity(by_position, com_shift, psi, dynamics),
        _motion_sensitivity(by_rate, still, psi, dynamics),
    )


def body_sensitivity(
    tree: KinematicTree,
    telemetry: Telemetry,
    psi: NDArray[np.float64],
    dynamics: RelativeDynamics,
    count: int,
) -> MotionSensitivity:
    """Return the derivatives w.r.t. the inertial parameters of the tree's first `count` bodies.

    Each body has ten, in the order of `BodyUncertainty.sigmas`: relative mass, centre of mass in
    the body's frame, and the stretch E (Exx, Eyy, Ezz, Exy, Exz, Eyz) that changes its second
    moment Σ to (1 + E) Σ (1 + E)ᵀ. The target remains unchanged. Other arguments as for
    `joint_sensitivity`.
    """
    bodies, _ = propagate(tree, telemetry)
    total = tree.mass
    rho = dynamics.com(psi)
    momenta, shifts = [], []
    for k, body in enumerate(tree.bodies[:count]):
        R, r, w, v = bodies.R[k], bodies.r[k], bodies.w[k], bodies.v[k]
        dP = [body.mass * v]
        dL = [np.cross(r, dP[0])]
        shift = [body.mass / total * (r - rho)]
        for axis in np.moveaxis(R, -1, 0):
            dP.append(body.mass * np.cross(w, axis))
            dL.append(body.mass * np.cross(axis, v) + np.cross(r, dP[-1]))
            shift.append(body.mass / total * axis)
        for stretch in _STRETCHES:
            change = stretched_inertia_rate(body.I_BBcm, stretch)
            dL.append(rotate(R, rotate(np.swapaxes(R, -1, -2), w) @ change))
            dP.append(np.zeros_like(v))
            shift.append(np.zeros_like(v))
        momenta.append(np.concatenate([np.stack(dL, -1), np.stack(dP, -1)], axis=1))
        shifts.append(np.stack(shift, -1))
    return _motion_sensitivity(
        np.concatenate(momenta, axis=-1), np.concatenate(shifts, axis=-1), psi, dynamics
    )


def perturbed(
    tree: KinematicTree, uncertainty: BodyUncertainty, rng: np.random.Generator
) -> KinematicTree:
    """Return a tree whose bodies' parameters are drawn at random around those of `tree`.

    The inertias remain physically consistent.
    """
    bodies = []
    for body in tree.bodies:
        draw = uncertainty.sigmas * rng.standard_normal(10)
        E = np.tensordot(draw[4:], _STRETCHES, axes=1)
        stretch = np.eye(3) + E
        inertia = inertia_of_second_moment(stretch @ second_moment(body.I_BBcm) @ stretch.T)
        mass = body.mass * (1 + draw[0])
        bodies.append(replace(body, mass=mass, p_BBcm=body.p_BBcm + draw[1:4], I_BBcm=inertia))
    return replace(tree, bodies=tuple(bodies))


def stretched_inertia_rate(
    inertia: NDArray[np.float64], E: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return dI (3, 3) for the change EΣ + ΣEᵀ of the second moment Σ = ½tr(I)1 − I."""
    sigma = second_moment(inertia)
    return inertia_of_second_moment(E @ sigma + sigma @ E.T)


def _motion_sensitivity(
    momentum: NDArray[np.float64],
    com: NDArray[np.float64],
    psi: NDArray[np.float64],
    dynamics: RelativeDynamics,
) -> MotionSensitivity:
    """Return the derivatives of the motion from the derivatives of momentum and centre of mass.

    Args:
        momentum: (N, 6, n) derivatives of [L; P] about B's origin, at constant base twist.
        com: (N, 3, n) derivatives of ρ, the system's centre of mass from B's origin.
        psi: (10,) the target's relative vector.
        dynamics: dynamics of the known bodies alone.

    """
    rho = skew(dynamics.com(psi))
    total = dynamics.mass**2 / (dynamics.mass - psi[0])  # m_k + m, because μ = m_k m/(m_k + m)
    dL, dP = momentum[:, :3], momentum[:, 3:]
    w = -np.asarray(np.linalg.solve(dynamics.inertia(psi), dL - rho @ dP), dtype=float)
    return MotionSensitivity(w, com, rho @ w - dP / total)


def _screw(body: TreeBody, R: NDArray[np.float64], r: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the twist (N, 6) of a joint at unit rate, from its outboard body's R and r."""
    R_WM = R @ body.R_MB.T
    axis = rotate(R_WM, body.axis_F)
    if body.prismatic:
        return np.concatenate([np.zeros_like(axis), axis], axis=-1)
    origin = r - rotate(R, body.p_BBcm) - rotate(R_WM, body.p_MB)
    return np.concatenate([axis, np.cross(origin, axis)], axis=-1)


def _cross_motion(S: NDArray[np.float64], V: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return S × V of twists [ω; v] (N, 6)."""
    w, v = S[..., :3], S[..., 3:]
    return np.concatenate(
        [np.cross(w, V[..., :3]), np.cross(v, V[..., :3]) + np.cross(w, V[..., 3:])], axis=-1
    )


def _cross_force(S: NDArray[np.float64], F: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return S ×* F of a twist [ω; v] and a momentum [L; P] (N, 6)."""
    w, v = S[..., :3], S[..., 3:]
    return np.concatenate(
        [np.cross(w, F[..., :3]) + np.cross(v, F[..., 3:]), np.cross(w, F[..., 3:])], axis=-1
    )
