"""Recursive kinematics of a tree of bodies, batched over samples (Ning et al. 2016, Eqs. 1-3).

Plain NumPy over arrays that `Spacecraft` reads once from its Drake plant. It is fast for many
samples, and independent of Drake's own kinematics.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from cpid_drake.array import Array
from cpid_drake.dynamics.rotations import cross, product, rotate_about_axis
from cpid_drake.dynamics.tree import KinematicTree


@dataclass(frozen=True)
class BodyMotion:
    """Pose and velocity of K bodies at N samples, all in W.

    Attributes:
        R: (K, N, 3, 3) attitudes R_WB of the bodies.
        r: (K, N, 3) centres of mass [m]; the paper's r_k.
        w: (K, N, 3) angular velocities [rad/s].
        v: (K, N, 3) velocities of the centres of mass [m/s].

    """

    R: Array
    r: Array
    w: Array
    v: Array


@dataclass(frozen=True)
class CaptureMotion:
    """Pose and velocity of the capture frame C at N samples.

    Attributes:
        R_WC: (N, 3, 3) attitude; the paper's A_n.
        p_WC: (N, 3) position of C's origin in W [m]; the paper's d_no.
        w_WC: (N, 3) angular velocity in W [rad/s].
        v_WC: (N, 3) velocity of C's origin in W [m/s].

    """

    R_WC: Array
    p_WC: Array
    w_WC: Array
    v_WC: Array


def forward_kinematics(
    tree: KinematicTree,
    q: ArrayLike,
    qdot: ArrayLike,
    *,
    R_WB: ArrayLike = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
    p_WB: ArrayLike = 0.0,
    w_WB: ArrayLike = 0.0,
    v_WB: ArrayLike = 0.0,
) -> tuple[BodyMotion, CaptureMotion]:
    """Return the motion of every body and of C, computed from the base outwards.

    With joint k between the bodies m and k, b_m and c_k the vectors from m's centre of mass to the
    joint and from there to k's, and H_k the unit vector of the joint's axis:

        ω_k = ω_m + H_k q̇_k,   r_k = r_m + b_m + c_k,   v_k = v_m + ω_m × b_m + ω_k × c_k.

    Sliding joints are an extension of the paper: axis · q is added to b_m, and axis · q̇ to v_k.

    Args:
        tree: the bodies.
        q, qdot: (N, J) positions [rad or m] and rates of the joints.
        R_WB: (N, 3, 3) attitude of the base.
        p_WB: (N, 3) position of B's origin, in W [m].
        w_WB, v_WB: (N, 3) angular velocity of the base and velocity of B's origin, in W.

    By default the motion is seen from the base: the frames W and B coincide.

    Source: Ning et al. 2016, Eqs. 1-3.

    """
    q, qdot, w_WB, v_WB = (np.asarray(values) for values in (q, qdot, w_WB, v_WB))
    K, N = len(tree.bodies), len(q)
    R, r, w, v = np.empty((K, N, 3, 3)), *np.empty((3, K, N, 3))
    for k, body in enumerate(tree.bodies):
        m = body.parent
        if m < 0:
            R[k], w[k] = R_WB, w_WB
            c_k = product(R[k], body.p_BBcm)
            r[k] = np.asarray(p_WB) + c_k
            v[k] = v_WB + cross(w[k], c_k)
            continue
        R_WF = product(R[m], body.R_PF)
        b_m = product(R[m], body.p_PF - tree.bodies[m].p_BBcm)
        H_k, rate, slide, R[k] = np.zeros((N, 3)), np.zeros(N), np.zeros(3), R_WF
        if body.joint >= 0:
            m_k = body.multiplier  # of a joint that follows another
            q_k, qdot_k = m_k * q[:, body.joint], m_k * qdot[:, body.joint]
            axis = product(R_WF, body.axis_F)
            if body.prismatic:
                b_m = b_m + axis * q_k[:, None]
                slide = axis * qdot_k[:, None]
            else:
                R[k] = rotate_about_axis(R_WF, body.axis_F, q_k)
                H_k, rate = axis, qdot_k
        c_k = product(R[k], body.p_BBcm)
        w[k] = w[m] + H_k * rate[:, None]  # Eq. 1
        r[k] = r[m] + b_m + c_k  # Eq. 2
        v[k] = v[m] + cross(w[m], b_m) + cross(w[k], c_k) + slide  # Eq. 3

    n_i = tree.capture_body
    R_WC = product(R[n_i], tree.R_BC)
    b_ni = product(R[n_i], tree.p_BC - tree.bodies[n_i].p_BBcm)
    v_WC = v[n_i] + cross(w[n_i], b_ni)
    return BodyMotion(R, r, w, v), CaptureMotion(R_WC, r[n_i] + b_ni, w[n_i].copy(), v_WC)
