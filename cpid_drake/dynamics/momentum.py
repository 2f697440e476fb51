"""Momentum of the known bodies and of the target (Ning et al. 2016, Eqs. 4-9).

Sums over the known bodies start at the base, i = 0, in every equation. The paper's Eqs. 4, 10, 14
and 18 print i = 1. That omits the base and gives a negative mass in the paper's case.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.kinematics import BodyMotion, CaptureMotion, forward_kinematics
from cpid_drake.dynamics.motion import Motion
from cpid_drake.dynamics.rotations import cross, rotate
from cpid_drake.dynamics.tree import KinematicTree


@dataclass(frozen=True)
class MomentumSamples:
    """The motion of C and the known bodies' momentum at N samples: what the row families need.

    Attributes:
        motion: pose and velocity of the capture frame C.
        P: (N, 3) linear momentum of the known bodies, in W [N·s].
        L: (N, 3) their angular momentum about C's origin, in W [N·m·s].
        p_WKcm: (N, 3) their centre of mass, in W [m].
        mass: their mass [kg].

    """

    motion: CaptureMotion
    P: NDArray[np.float64]
    L: NDArray[np.float64]
    p_WKcm: NDArray[np.float64]
    mass: float

    def __len__(self) -> int:
        return len(self.P)

    @property
    def in_C(self) -> NDArray[np.float64]:
        """(N, 4, 3) velocity of C's origin, angular velocity of C, P and L, in C."""
        vectors = np.empty((len(self), 4, 3))
        vectors[:, 0], vectors[:, 1] = self.motion.v_WC, self.motion.w_WC
        vectors[:, 2], vectors[:, 3] = self.P, self.L
        return vectors @ self.motion.R_WC  # row vectors: (R_WCᵀ v)ᵀ = vᵀ R_WC


def momenta(
    tree: KinematicTree, motion: BodyMotion, p_WQ: ArrayLike = 0.0
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return each body's m_i v_i and I_i ω_i + m_i (r_i − p_WQ) × v_i, (K, N, 3) each, in W.

    Args:
        tree: the bodies.
        motion: the motion of these bodies.
        p_WQ: (N, 3) the point Q of the angular momentum [m]; default: W's origin.

    """
    P = tree.masses[..., None] * motion.v
    w_B = rotate(np.swapaxes(motion.R, -1, -2), motion.w)
    spin = rotate(motion.R, rotate(tree.inertias, w_B))
    return P, spin + cross(motion.r - np.asarray(p_WQ), P)


def linear_momentum(tree: KinematicTree, motion: BodyMotion) -> NDArray[np.float64]:
    """Return P = Σ m_i v_i, i = 0 … n−1, as (N, 3) in W [N·s] (Ning et al. 2016, Eq. 4)."""
    return np.asarray(np.sum(tree.masses[..., None] * motion.v, axis=0))


def angular_momentum(
    tree: KinematicTree, motion: BodyMotion, p_WQ: ArrayLike
) -> NDArray[np.float64]:
    """Return L = Σ (I_i ω_i + m_i (r_i − p_WQ) × v_i), i = 0 … n−1, as (N, 3) in W [N·m·s].

    The origin of W as Q gives the sum in Ning et al. 2016, Eq. 9, and the capture point (d_no) the
    sums in Eqs. 10, 14 and 18. Arguments as for `momenta`.
    """
    return momenta(tree, motion, p_WQ)[1].sum(axis=0)


def target_momentum(
    target: InertialParameters, motion: CaptureMotion
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
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
    tree = tree.lumped
    bodies, capture = forward_kinematics(tree, **motion.states)
    return MomentumSamples(
        capture,
        linear_momentum(tree, bodies),
        angular_momentum(tree, bodies, capture.p_WC),
        np.sum(tree.masses[..., None] * bodies.r, axis=0) / tree.mass,
        tree.mass,
    )


def total_momentum(
    tree: KinematicTree, target: InertialParameters, motion: Motion
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return linear [N·s] and angular momentum [N·m·s] of spacecraft and target, (N, 3), in W.

    The angular momentum is about W's origin. Both are constant while no external force acts.

    Source: Ning et al. 2016, Eqs. 5 and 9.
    """
    samples = momentum_samples(tree, motion)
    P_T, L_T = target_momentum(target, samples.motion)
    P = samples.P + P_T
    return P, samples.L + L_T + cross(samples.motion.p_WC, P)
