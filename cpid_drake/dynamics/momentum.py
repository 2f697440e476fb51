"""Momentum of the spacecraft's bodies and of the target (Ning et al. 2016, Eqs. 4-9).

Sums over the spacecraft's bodies start at the base, i = 0, in every equation. The paper's Eqs. 4,
10, 14 and 18 print i = 1. That omits the base and gives a negative mass in the paper's case.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from cpid_drake.array import Array
from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.kinematics import BodyMotion, CaptureMotion, forward_kinematics
from cpid_drake.dynamics.motion import Motion
from cpid_drake.dynamics.parameterizations import moved_moments
from cpid_drake.dynamics.rotations import cross, rotate
from cpid_drake.dynamics.tree import KinematicTree


@dataclass(frozen=True)
class MomentumSamples:
    """The motion of C and the spacecraft's momentum at N samples: what the row families need.

    Attributes:
        motion: pose and velocity of the capture frame C.
        P: (N, 3) linear momentum of the spacecraft, in W [N·s].
        L: (N, 3) their angular momentum about C's origin, in W [N·m·s].
        p_WKcm: (N, 3) their centre of mass, in W [m].
        mass: their mass [kg].

    """

    motion: CaptureMotion
    P: Array
    L: Array
    p_WKcm: Array
    mass: float

    def __len__(self) -> int:
        return len(self.P)

    @property
    def in_C(self) -> Array:
        """(N, 4, 3) velocity of C's origin, angular velocity of C, P and L, in C."""
        vectors = np.empty((len(self), 4, 3))
        vectors[:, 0], vectors[:, 1] = self.motion.v_WC, self.motion.w_WC
        vectors[:, 2], vectors[:, 3] = self.P, self.L
        return vectors @ self.motion.R_WC  # row vectors: (R_WCᵀ v)ᵀ = vᵀ R_WC


def momenta(tree: KinematicTree, motion: BodyMotion, p_WQ: ArrayLike = 0.0) -> tuple[Array, Array]:
    """Return each body's m_i v_i and I_i ω_i + m_i (r_i − p_WQ) × v_i, (K, N, 3) each, in W.

    Their sums over i = 0 … n−1 are P and L. With W's origin as Q (N, 3), L is that of Ning et al.
    2016, Eq. 9, and with the capture point (d_no), that of Eqs. 10, 14 and 18.
    """
    P = tree.masses[..., None] * motion.v
    w_B = rotate(np.swapaxes(motion.R, -1, -2), motion.w)
    spin = rotate(motion.R, rotate(tree.inertias, w_B))
    return P, spin + cross(motion.r - np.asarray(p_WQ), P)


def target_momentum(target: InertialParameters, motion: CaptureMotion) -> tuple[Array, Array]:
    """Return the target's momentum m_n v_n [N·s] and its angular momentum about C's origin [N·m·s].

    Both are (N, 3), in W. The target rotates with the capture frame, ω_n = ω_C: a rigid grasp,
    which the paper assumes without saying so.

    Source: Ning et al. 2016, the target's terms in Eqs. 5 and 9.
    """
    R_WC, w = motion.R_WC, motion.w_WC
    c_W = rotate(R_WC, target.p_CTcm_C)
    P = target.mass * (motion.v_WC + cross(w, c_W))
    w_C = rotate(np.swapaxes(R_WC, -1, -2), w)
    L = rotate(R_WC, w_C @ target.I_TTcm_C) + cross(c_W, P)
    return P, L


def momentum_samples(tree: KinematicTree, motion: Motion) -> MomentumSamples:
    """Return the momentum samples of a motion; welded bodies are treated as one body."""
    tree, R_WB = tree.lumped, motion.R_WB
    joints = np.stack([motion.q, motion.qdot])
    capture, sums = _on_a_base_at_rest(tree, joints.tobytes(), joints.shape)
    P, L, first, inertia = sums
    w_B, v_B = np.moveaxis(np.stack([motion.w_WB, motion.v_WB], axis=1) @ R_WB, 1, 0)
    p_C, v = capture.p_WC, v_B + cross(w_B, capture.p_WC)  # of the base's point at C
    in_B = [p_C, p_C + first / tree.mass, capture.w_WC + w_B, capture.v_WC + v]
    in_B += [P + tree.mass * v + cross(w_B, first), L + rotate(inertia, w_B) + cross(first, v)]
    p_C, p_K, w, v, P, L = np.moveaxis(np.stack(in_B, axis=1) @ np.swapaxes(R_WB, -1, -2), 1, 0)
    place = CaptureMotion(R_WB @ capture.R_WC, motion.p_WB + p_C, w, v)
    return MomentumSamples(place, P, L, motion.p_WB + p_K, tree.mass)


@lru_cache(maxsize=8)  # trials of many targets have one motion of the joints
def _on_a_base_at_rest(
    tree: KinematicTree, joints: bytes, shape: tuple[int, ...]
) -> tuple[CaptureMotion, list[Array]]:
    """Return C's motion, P, L, first moment and inertia about C, from the bytes of (2, N, J)."""
    bodies, capture = forward_kinematics(tree, *np.frombuffer(joints).reshape(shape))
    P, L = momenta(tree, bodies, capture.p_WC)
    p = bodies.r - capture.p_WC
    first, inertias = moved_moments(tree.masses, tree.inertias, bodies.R, p)
    return capture, [each.sum(axis=0) for each in (P, L, first, inertias)]


def system_momentum(
    tree: KinematicTree, target: InertialParameters, motion: Motion
) -> tuple[Array, Array]:
    """Return linear [N·s] and angular momentum [N·m·s] of spacecraft and target, (N, 3), in W.

    The angular momentum is about W's origin. Both are constant while no external force acts.

    Source: Ning et al. 2016, Eqs. 5 and 9.
    """
    samples = momentum_samples(tree, motion)
    P_T, L_T = target_momentum(target, samples.motion)
    P = samples.P + P_T
    return P, samples.L + L_T + cross(samples.motion.p_WC, P)
