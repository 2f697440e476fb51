"""Recursive kinematics of a tree of bodies, batched over samples (Ning et al. 2016, Eqs. 1-3).

Plain NumPy over arrays that `Spacecraft` reads once from its Drake plant, so it is both the fast
route for many samples and one that is independent of Drake's own kinematics.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cpid_drake.inertia import point_mass_inertia
from cpid_drake.telemetry import Telemetry


@dataclass(frozen=True)
class TreeBody:
    """One body k of the tree and the joint that carries it on its inboard body m.

    Attributes:
        name: the body's name.
        parent: index of the inboard body in the tree; −1 for the base.
        joint: column of the joint in q, or −1 where the body is welded.
        prismatic: whether the joint slides along its axis (else it turns about it).
        axis_F: (3,) unit vector of the joint's axis, the same in F and in M.
        R_PF, p_PF: pose of the joint's inboard frame F, fixed on the inboard body P.
        R_MB, p_MB: pose of this body's frame B in the joint's outboard frame M.
        mass: [kg].
        p_BBcm: (3,) centre of mass in the body's frame [m].
        I_BBcm: (3, 3) inertia about the centre of mass in the body's frame [kg·m²].

    """

    name: str
    parent: int
    joint: int
    prismatic: bool
    axis_F: NDArray[np.float64]
    R_PF: NDArray[np.float64]
    p_PF: NDArray[np.float64]
    R_MB: NDArray[np.float64]
    p_MB: NDArray[np.float64]
    mass: float
    p_BBcm: NDArray[np.float64]
    I_BBcm: NDArray[np.float64]


@dataclass(frozen=True)
class KinematicTree:
    """The known bodies, inboard before outboard, and the capture frame C on one of them."""

    bodies: tuple[TreeBody, ...]
    capture_body: int
    R_BC: NDArray[np.float64]
    p_BC: NDArray[np.float64]

    @cached_property
    def lumped(self) -> "KinematicTree":
        """The same tree with bodies that are welded together as one: the same momentum, sooner."""
        lumps: list[TreeBody] = []
        where: list[tuple[int, NDArray, NDArray]] = []  # of each body: its lump, and its pose there
        for body in self.bodies:
            R_PB, p_PB = body.R_PF @ body.R_MB, body.p_PF + body.R_PF @ body.p_MB
            if body.parent < 0:
                where.append((0, np.eye(3), np.zeros(3)))
                lumps.append(body)
                continue
            lump, R_LP, p_LP = where[body.parent]
            if body.joint < 0:
                where.append((lump, R_LP @ R_PB, p_LP + R_LP @ p_PB))
                lumps[lump] = _joined(lumps[lump], body, *where[-1][1:])
                continue
            where.append((len(lumps), np.eye(3), np.zeros(3)))
            p_LF = p_LP + R_LP @ body.p_PF
            lumps.append(replace(body, parent=lump, R_PF=R_LP @ body.R_PF, p_PF=p_LF))
        lump, R_LB, p_LB = where[self.capture_body]
        return KinematicTree(tuple(lumps), lump, R_LB @ self.R_BC, p_LB + R_LB @ self.p_BC)

    def is_rotor(self, joint: int) -> bool:
        """Return whether a joint's angle makes no difference, as a reaction wheel's.

        It turns a single body that carries nothing and is balanced about the axis: its centre of
        mass on it, its inertia about it symmetric (to 1e-6 of its size).
        """
        [k] = [k for k, body in enumerate(self.bodies) if body.joint == joint]
        body, axis = self.bodies[k], self.bodies[k].axis_F
        if body.prismatic or k == self.capture_body or any(b.parent == k for b in self.bodies):
            return False
        p_MBcm = body.p_MB + body.R_MB @ body.p_BBcm
        off_axis = p_MBcm - axis * (axis @ p_MBcm)
        I_M = body.R_MB @ body.I_BBcm @ body.R_MB.T
        about = axis @ I_M @ axis
        across = (np.trace(I_M) - about) / 2
        balanced = about * np.outer(axis, axis) + across * (np.eye(3) - np.outer(axis, axis))
        size = np.trace(I_M)
        return bool(
            body.mass * off_axis @ off_axis <= 1e-6 * size
            and np.abs(I_M - balanced).max() <= 1e-6 * size
        )


def _joined(
    lump: TreeBody, body: TreeBody, R_LB: NDArray[np.float64], p_LB: NDArray[np.float64]
) -> TreeBody:
    """Return a lump with a body added that is fixed in its frame L."""
    mass = lump.mass + body.mass
    if not body.mass > 0:
        return lump
    coms = np.stack([lump.p_BBcm, p_LB + R_LB @ body.p_BBcm])
    com = np.array([lump.mass, body.mass]) @ coms / mass
    inertia = lump.I_BBcm + R_LB @ body.I_BBcm @ R_LB.T
    for part, place in zip((lump.mass, body.mass), coms):
        inertia = inertia + point_mass_inertia(part, place - com)
    return replace(lump, mass=mass, p_BBcm=com, I_BBcm=inertia)


@dataclass(frozen=True)
class BodyMotion:
    """Pose and velocity of K bodies at N samples, all in W.

    Attributes:
        R: (K, N, 3, 3) attitudes R_WB of the bodies.
        r: (K, N, 3) centres of mass [m]; the paper's r_k.
        w: (K, N, 3) angular velocities [rad/s].
        v: (K, N, 3) velocities of the centres of mass [m/s].

    """

    R: NDArray[np.float64]
    r: NDArray[np.float64]
    w: NDArray[np.float64]
    v: NDArray[np.float64]


@dataclass(frozen=True)
class CaptureMotion:
    """Pose and velocity of the capture frame C at N samples.

    Attributes:
        R_WC: (N, 3, 3) attitude; the paper's A_n.
        p_WC: (N, 3) position of C's origin in W [m]; the paper's d_no.
        w_WC: (N, 3) angular velocity in W [rad/s].
        v_WC: (N, 3) velocity of C's origin in W [m/s].

    """

    R_WC: NDArray[np.float64]
    p_WC: NDArray[np.float64]
    w_WC: NDArray[np.float64]
    v_WC: NDArray[np.float64]


def rotate(R: ArrayLike, vectors: ArrayLike) -> NDArray[np.float64]:
    """Return R @ v for (..., 3, 3) rotations and (..., 3) vectors, broadcast."""
    return np.einsum("...ij,...j->...i", R, vectors)


def cross(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a × b of (..., 3) vectors, broadcast; several times as fast as `numpy.cross`."""
    a0, a1, a2 = a[..., 0], a[..., 1], a[..., 2]
    b0, b1, b2 = b[..., 0], b[..., 1], b[..., 2]
    return np.stack([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0], axis=-1)


def _times(R: NDArray[np.float64], constant: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return R @ constant of (N, 3, 3) rotations and one (3, ...) array, as one large product."""
    return (R.reshape(-1, 3) @ constant).reshape(len(R), 3, *constant.shape[1:])


def turned(R: ArrayLike, axis: ArrayLike, angle: ArrayLike) -> NDArray[np.float64]:
    """Return R (N, 3, 3) turned by angles (N,) [rad] about one unit axis (3,) (Rodrigues).

    The axis is fixed in the frame that R's columns are the axes of: R @ rotation(axis, angle).
    """
    x, y, z = np.asarray(axis, dtype=float)
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    R, angle = np.asarray(R, dtype=float), np.asarray(angle, dtype=float)[:, None, None]
    by_sine, by_cosine = _times(R, K), _times(R, K @ K)
    by_sine *= np.sin(angle)
    by_cosine *= 1 - np.cos(angle)
    by_sine += by_cosine
    by_sine += R
    return by_sine


def angular_velocity(w_m: ArrayLike, H_k: ArrayLike, qdot_k: ArrayLike) -> NDArray[np.float64]:
    """ω_k = ω_m + H_k q̇_k (Ning et al. 2016, Eq. 1).

    Args:
        w_m: (N, 3) angular velocity of the inboard body m, in W [rad/s].
        H_k: (N, 3) unit vector of joint k's axis, in W; zero for a sliding joint.
        qdot_k: (N,) joint rate [rad/s].

    """
    return np.asarray(w_m) + np.asarray(H_k) * np.asarray(qdot_k)[:, None]


def centroid_position(r_m: ArrayLike, b_m: ArrayLike, c_k: ArrayLike) -> NDArray[np.float64]:
    """r_k = r_m + b_m + c_k (Ning et al. 2016, Eq. 2).

    Args:
        r_m: (N, 3) centre of mass of the inboard body m, in W [m].
        b_m: (N, 3) from m's centre of mass to joint k, in W [m].
        c_k: (N, 3) from joint k to body k's centre of mass, in W [m].

    """
    return np.asarray(r_m) + np.asarray(b_m) + np.asarray(c_k)


def centroid_velocity(
    v_m: ArrayLike, w_m: ArrayLike, b_m: ArrayLike, w_k: ArrayLike, c_k: ArrayLike
) -> NDArray[np.float64]:
    """v_k = v_m + ω_m × b_m + ω_k × c_k (Ning et al. 2016, Eq. 3). All (N, 3), in W."""
    return np.asarray(v_m) + cross(w_m, b_m) + cross(w_k, c_k)


def propagate(tree: KinematicTree, telemetry: Telemetry) -> tuple[BodyMotion, CaptureMotion]:
    """Walk the tree outwards from the base and return the motion of every body and of C.

    Sliding joints are an extension of the paper: the joint point moves on the inboard body by
    axis · q, so that b_m grows by it and v_k gains axis · q̇.

    Source: Ning et al. 2016, Eqs. 1-3.
    """
    K, N = len(tree.bodies), len(telemetry)
    R, r, w, v = np.empty((K, N, 3, 3)), *(np.empty((K, N, 3)) for _ in range(3))
    for k, body in enumerate(tree.bodies):
        m = body.parent
        if m < 0:
            R[k], w[k] = telemetry.R_WB, telemetry.w_WB
            c_k = _times(R[k], body.p_BBcm)
            r[k] = telemetry.p_WB + c_k
            v[k] = telemetry.v_WB + cross(w[k], c_k)
            continue
        R_WF = _times(R[m], body.R_PF)
        b_m = _times(R[m], body.p_PF - tree.bodies[m].p_BBcm)
        H_k, rate, slide = np.zeros((N, 3)), np.zeros(N), 0.0
        if body.joint < 0:
            R_WM = R_WF
        else:
            q_k, qdot_k = telemetry.q[:, body.joint], telemetry.qdot[:, body.joint]
            axis = _times(R_WF, body.axis_F)
            if body.prismatic:
                R_WM = R_WF
                b_m = b_m + axis * q_k[:, None]
                slide = axis * qdot_k[:, None]
            else:
                R_WM = turned(R_WF, body.axis_F, q_k)
                H_k, rate = axis, qdot_k
        R[k] = _times(R_WM, body.R_MB)
        c_k = _times(R_WM, body.p_MB) + _times(R[k], body.p_BBcm)
        w[k] = angular_velocity(w[m], H_k, rate)
        r[k] = centroid_position(r[m], b_m, c_k)
        v[k] = centroid_velocity(v[m], w[m], b_m, w[k], c_k) + slide

    n_i = tree.capture_body
    R_WC = _times(R[n_i], tree.R_BC)
    b_ni = _times(R[n_i], tree.p_BC - tree.bodies[n_i].p_BBcm)
    v_WC = v[n_i] + cross(w[n_i], b_ni)
    return BodyMotion(R, r, w, v), CaptureMotion(R_WC, r[n_i] + b_ni, w[n_i].copy(), v_WC)
