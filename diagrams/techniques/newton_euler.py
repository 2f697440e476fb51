"""Newton-Euler equations that are linear in a body's ten parameters, and their relative form.

Twists are [ω; v], momenta and wrenches [n; f], about the origin of a body's frame and in this
frame. φ = (m, m c, J) are the standard unknowns and ψ = (μ, μc, I_*) the relative ones; see
`parameterizations`.

The wrench that the arm exerts on the target about C's origin Co is F = Y(a_WCo, α, ω) φ (Atkeson,
An and Hollerbach 1986, "Estimation of inertial parameters of manipulator loads and links").

**Relative form.** Without external force the system's centre of mass does not accelerate, so the
centre of mass K of the spacecraft accelerates by −f/m_k. With s the vector from K to Co and s̈ its
second derivative in W,

    F = Y(s̈, α, ω) ψ:

in f = m a_Tcm put m a_Tcm = −m_k a_WK, which gives f = μ (s̈ + α × c + ω × (ω × c)). In
n = m c × a + J α + ω × J ω put a = s̈ − f/m_k: the part −(m μ/m_k) c × (…) c has the form of an
inertia, and m − m μ/m_k = μ. No acceleration, velocity or position of the base's origin is needed,
and the total momentum may be any constant.

**Skew-consistent form.** With a reference twist V_r and its derivative A_r as seen in the body,

    F_r = G A_r + [ω̃_r  ṽ_r; 0  ω̃_r] G V,      G V = Y_mom(V) φ,

is Newton-Euler for V_r = V, and the sum of Jᵀ F_r over all bodies is M v̇_r + C v_r with Ṁ − 2C
skew (Slotine and Li 1987, "On the adaptive control of robot manipulators"). The factorization
V ×* (G V_r) is not skew.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cpid_drake.dynamics.outboard import Outboard, cross_force, cross_motion
from cpid_drake.dynamics.parameterizations import moved_moments, tensor_to_vector
from cpid_drake.dynamics.rotations import rotate, skew
from cpid_drake.dynamics.rows import inertia_operator
from cpid_drake.dynamics.tree import KinematicTree

Array = NDArray[np.float64]


def newton_euler_regressor(a: ArrayLike, alpha: ArrayLike, w: ArrayLike) -> Array:
    """Return Y (..., 6, 10) with Y φ the wrench [n; f] on a body about its frame's origin.

    Y is the derivative of `momentum_regressor` as seen in W.

    Args:
        a: (..., 3) acceleration of the origin in W, or s̈ of the relative form [m/s²].
        alpha: (..., 3) angular acceleration in W [rad/s²].
        w: (..., 3) angular velocity in W [rad/s].

    All are expressed in the body's frame.

    """
    a, w_x = np.asarray(a), skew(w)
    Y = np.zeros((*a.shape[:-1], 6, 10))
    Y[..., :3, 1:4] = -skew(a)
    Y[..., :3, 4:] = inertia_operator(alpha) + w_x @ inertia_operator(w)
    Y[..., 3:, 0], Y[..., 3:, 1:4] = a, skew(alpha) + w_x @ w_x
    return Y


def momentum_regressor(V: ArrayLike) -> Array:
    """Return Y_mom (..., 6, 10) with Y_mom φ the momentum of a body with the twist V (..., 6)."""
    V = np.asarray(V)
    Y = np.zeros((*V.shape[:-1], 6, 10))
    Y[..., :3, 1:4], Y[..., :3, 4:] = -skew(V[..., 3:]), inertia_operator(V[..., :3])
    Y[..., 3:, 0], Y[..., 3:, 1:4] = V[..., 3:], skew(V[..., :3])
    return Y


def skew_consistent_regressor(A_r: ArrayLike, V_r: ArrayLike, V: ArrayLike) -> Array:
    """Return Y_r (..., 6, 10) with Y_r φ the wrench F_r of the module's text.

    Args:
        A_r: (..., 6) derivative of the components of V_r.
        V_r: (..., 6) reference twist.
        V: (..., 6) twist.

    """
    V_r, Y = np.asarray(V_r)[..., None, :], momentum_regressor(V)
    added = cross_force(V_r, np.swapaxes(Y, -1, -2))
    return momentum_regressor(A_r) + np.swapaxes(added, -1, -2)


def spatial_inertia(phi: Array) -> Array:
    """Return G (..., 6, 6) of standard vectors φ (..., 10): the momentum is G V."""
    return np.asarray(np.einsum("uij,...j->...iu", momentum_regressor(np.eye(6)), phi))


@dataclass(frozen=True, eq=False)
class ReferenceDynamics:
    """Equations of motion M v̇_r + C v_r of the spacecraft with skew Ṁ − 2C, at one instant.

    The velocities v are the base's twist in B, then the J joint rates.

    Attributes:
        M: (6 + J, 6 + J) mass matrix.
        Cv_r: (6 + J,) C v_r.
        J_C: (6, 6 + J) Jacobian of C's twist, in C.
        bias_C: (6,) derivative of J_C, times v_r.

    """

    M: Array
    Cv_r: Array
    J_C: Array
    bias_C: Array

    @classmethod
    def at(cls, tree: KinematicTree, q: Array, v: Array, v_r: Array) -> "ReferenceDynamics":
        """Return them at joint positions (J,), velocities and reference velocities (6 + J,).

        Args:
            tree: the spacecraft's bodies; `KinematicTree.lumped` is the fastest.
            q: (J,) joint positions [rad or m].
            v: (6 + J,) velocities.
            v_r: (6 + J,) reference velocities.

        """
        # All bodies in B, about its origin: screws of the joints, and which bodies they move.
        known = Outboard.at(tree, q[None], v[None, 6:], v[None, :3], v[None, 3:6])
        joints, V = tree.jointed, known.V[:, 0]
        moves = np.zeros((len(V), len(q)))
        for k, body in enumerate(tree.bodies):
            moves[k] = moves[body.parent] if body.parent >= 0 else 0.0
            if body.joint >= 0:
                moves[k, body.joint] = 1.0
        S, inboard = np.zeros((len(q), 6)), np.zeros((len(q), 6))
        for k in joints:
            S[tree.bodies[k].joint] = known.joint_screw(k)[0]
            inboard[tree.bodies[k].joint] = V[tree.bodies[k].parent]
        J = np.concatenate(
            [np.tile(np.eye(6), (len(V), 1, 1)), np.swapaxes(moves[..., None] * S, 1, 2)], axis=2
        )
        V_r = J @ v_r
        # A screw moves with its inboard body; derivatives are those that each body sees.
        rates = v_r[6:, None] * cross_motion(inboard - V[0], S)
        bias = moves @ rates - cross_motion(V - V[0], V_r)
        moments = moved_moments(tree.masses, tree.inertias, known.bodies.R, known.bodies.r)
        h, inertia = (each[:, 0] for each in moments)
        G = spatial_inertia(np.concatenate([tree.masses, h, tensor_to_vector(inertia)], axis=1))
        F = rotate(G, bias) + cross_force(V_r, rotate(G, V))
        turned, C = np.swapaxes(J, 1, 2), tree.capture_body
        R, r = known.bodies.R[C, 0], known.bodies.r[C, 0]
        R_BC, p_BC = R @ tree.R_BC, r + R @ (tree.p_BC - tree.bodies[C].p_BBcm)
        X_CB = np.block([[R_BC.T, np.zeros((3, 3))], [-R_BC.T @ skew(p_BC), R_BC.T]])
        return cls(
            M=(turned @ G @ J).sum(axis=0),
            Cv_r=rotate(turned, F).sum(axis=0),
            J_C=X_CB @ J[C],
            bias_C=X_CB @ bias[C],
        )

    def with_target(self, phi: Array, v: Array, v_r: Array) -> tuple[Array, Array]:
        """Return M and C v_r of the system with a target φ (10,) on C."""
        J, G = self.J_C, spatial_inertia(phi)
        F = skew_consistent_regressor(self.bias_C, J @ v_r, J @ v) @ phi
        return self.M + J.T @ G @ J, self.Cv_r + J.T @ F
