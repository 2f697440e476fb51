"""Newton-Euler equations that are linear in a body's ten parameters, and their relative form.

Twists are [ω; v], momenta and wrenches [n; f], about the origin of a body's frame and in this
frame. φ = (m, m c, J) are the standard unknowns and ψ = (μ, μc, I_*) the relative ones; see
`parameterizations`.

The wrench that the arm exerts on the target about C's origin Co is F = Y(a_WCo, α, ω) φ (Atkeson,
An and Hollerbach 1986, "Estimation of inertial parameters of manipulator loads and links").

**Relative form.** Without external force the system's centre of mass does not accelerate, so the
centre of mass K of the known bodies accelerates by −f/m_k. With s the vector from K to Co and s̈ its
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

from cpid_drake.dynamics.parameterizations import moved_moments, tensor_to_vector
from cpid_drake.dynamics.rotations import cross, rotate, skew
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
    return momentum_regressor(A_r) + _reference_cross(np.asarray(V_r)) @ momentum_regressor(V)


def spatial_inertia(phi: Array) -> Array:
    """Return G (..., 6, 6) of standard vectors φ (..., 10): the momentum is G V."""
    return np.asarray(np.einsum("uij,...j->...iu", momentum_regressor(np.eye(6)), phi))


def _reference_cross(V_r: Array) -> Array:
    """Return [ω̃_r  ṽ_r; 0  ω̃_r] (..., 6, 6)."""
    result = np.zeros((*V_r.shape[:-1], 6, 6))
    result[..., :3, :3] = result[..., 3:, 3:] = skew(V_r[..., :3])
    result[..., :3, 3:] = skew(V_r[..., 3:])
    return result


@dataclass(frozen=True, eq=False)
class ReferenceDynamics:
    """Equations of motion M v̇_r + C v_r of the known bodies with skew Ṁ − 2C, at one instant.

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
            tree: the known bodies; `KinematicTree.lumped` is the fastest.
            q: (J,) joint positions [rad or m].
            v: (6 + J,) velocities.
            v_r: (6 + J,) reference velocities.

        """
        bodies, J = tree.bodies, np.zeros((len(tree.bodies) + 1, 6, 6 + len(q)))  # the last is C's
        joints = np.array([body.joint for body in bodies])
        X, S = _transforms(tree, np.where(joints < 0, 0.0, q[joints]))
        for k, body in enumerate(bodies):
            J[k] = X[k] @ J[body.parent] if body.parent >= 0 else np.eye(6, J.shape[2])
            if body.joint >= 0:
                J[k, :, 6 + body.joint] += S[k]
        J[-1] = X[-1] @ J[tree.capture_body]
        own, moved = J[:-1], S * np.where(joints < 0, 0.0, v[6 + joints])[:, None]
        V_r = own @ v_r
        # The derivative of a twist's components in a frame that turns and moves by `moved`.
        added = np.concatenate(
            [cross(V_r[:, :3], moved[:, :3]), cross(V_r[:, :3], moved[:, 3:])], 1
        )
        added[:, 3:] += cross(V_r[:, 3:], moved[:, :3])
        bias = np.zeros((len(J), 6))
        for k, body in enumerate(bodies):
            bias[k] = added[k] + X[k] @ bias[body.parent] if body.parent >= 0 else added[k]
        bias[-1] = X[-1] @ bias[tree.capture_body]
        G = _inertias(tree)
        F = G @ bias[:-1, :, None] + _reference_cross(V_r) @ G @ (own @ v)[..., None]
        turned = np.swapaxes(own, 1, 2)
        return cls(
            M=(turned @ G @ own).sum(axis=0),
            Cv_r=(turned @ F).sum(axis=0)[:, 0],
            J_C=J[-1],
            bias_C=bias[-1],
        )

    def with_target(self, phi: Array, v: Array, v_r: Array) -> tuple[Array, Array]:
        """Return M and C v_r of the system with a target φ (10,) on C."""
        J, G = self.J_C, spatial_inertia(phi)
        F = skew_consistent_regressor(self.bias_C, J @ v_r, J @ v) @ phi
        return self.M + J.T @ G @ J, self.Cv_r + J.T @ F


def _transforms(tree: KinematicTree, q: Array) -> tuple[Array, Array]:
    """Return X (K + 1, 6, 6) from twists of each body's parent to its own, and screws (K, 6).

    The last X is C's. Positions q (K,) are those of the bodies' joints.
    """
    R_PF, p_PF, axis = (
        np.stack([getattr(body, name) for body in tree.bodies])
        for name in ("R_PF", "p_PF", "axis_F")
    )
    slides, K = np.array([[body.prismatic] for body in tree.bodies]), skew(axis)
    angle = np.where(slides[:, 0], 0.0, q)[:, None, None]
    R = R_PF @ (np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K)
    p = p_PF + rotate(R_PF, axis * np.where(slides, q[:, None], 0.0))
    R_BP = np.swapaxes(np.concatenate([R, tree.R_BC[None]]), 1, 2)
    X = np.zeros((len(R_BP), 6, 6))
    X[:, :3, :3] = X[:, 3:, 3:] = R_BP
    X[:, 3:, :3] = -R_BP @ skew(np.concatenate([p, tree.p_BC[None]]))
    return X, np.concatenate([axis * ~slides, axis * slides], axis=1)


def _inertias(tree: KinematicTree) -> Array:
    """Return the spatial inertias (K, 6, 6) of the bodies about their frames' origins."""
    masses, coms = tree.masses, np.stack([body.p_BBcm for body in tree.bodies])
    h, moments = moved_moments(masses[:, 0], tree.inertias[:, 0], np.eye(3), coms)
    return spatial_inertia(np.concatenate([masses, h, tensor_to_vector(moments)], axis=1))
