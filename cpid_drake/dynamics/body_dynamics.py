"""Spacecraft and target as seen from the base: inertia, momentum and centre of mass.

Without external forces, the system's centre of mass Scm moves on a straight line, and the angular
momentum L about it is constant. Seen from the base, with ω = w_WB and all in B,

    J(ψ) ω + h(ψ) = Rᵀ L,      p_WB = p_WScm − R ρ(ψ),

where J, h and ρ are *linear* in the unknowns ψ = (μ, μc, I_*) of the relative rows. For
any two ψ and ψ', with ω the true angular velocity for ψ, this means

    J(ψ') (ω − ω') = Rᵀ(L − L') − Y(ω) (ψ − ψ')

exactly, with Y the relative rows. The attitude does not depend on the position, and the position
does not depend on a measured velocity. A base on a table rotates about the table's normal n only,
and nᵀ (…) is the one equation that determines this rotation; the others contain the table's
reactions.

Source: Ning et al. 2016, Eqs. 5 and 9, about the centre of mass.
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cpid_drake.array import Array
from cpid_drake.dynamics.kinematics import forward_kinematics
from cpid_drake.dynamics.momentum import momenta
from cpid_drake.dynamics.parameterizations import moved_moments, vector_to_tensor
from cpid_drake.dynamics.rotations import cross, inverses, rotate, skew
from cpid_drake.dynamics.rows import relative_regressor
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.files.errors import InputError

LEAST_INERTIA = 0.5
"""Least inertia of the system about any axis, as a share of that without the target.

A rigid body never reduces it; half of it leaves room for estimates from noisy samples.
"""


@dataclass(frozen=True)
class BodyDynamics:
    """The spacecraft's bodies and the capture frame as seen from the base, at N instants.

    Methods take vectors ψ (..., 10) of one or many targets; zeros for no target.

    Attributes:
        mass: mass of the spacecraft [kg].
        normal_B: (3,) normal in B of a table that carries the base; None without one.
        I_K: (N, 3, 3) their inertia about their centre of mass K, in B.
        h_K: (N, 3) their angular momentum about K on a base that does not rotate, in B.
        p_BK: (N, 3) K from B's origin, in B [m].
        v_BK: (N, 3) rate of p_BK as seen from B [m/s].
        R_BC: (N, 3, 3) attitude of C in B.
        w_BC: (N, 3) angular velocity of C relative to B, in C [rad/s].
        s: (N, 3) vector from K to C's origin, in C [m].
        sdot: (N, 3) its rate as seen from B, in C [m/s].

    """

    mass: float
    normal_B: Array | None
    I_K: Array
    h_K: Array
    p_BK: Array
    v_BK: Array
    R_BC: Array
    w_BC: Array
    s: Array
    sdot: Array

    @classmethod
    def at(cls, tree: KinematicTree, q: ArrayLike, qdot: ArrayLike) -> "BodyDynamics":
        """Return them at joint positions and rates, (N, J) each."""
        bodies, capture = forward_kinematics(tree, q, qdot)
        p_BK = np.sum(tree.masses[..., None] * bodies.r, axis=0) / tree.mass
        P, L = momenta(tree, bodies, p_BK)
        v_BK = P.sum(axis=0) / tree.mass
        _, inertias = moved_moments(tree.masses, tree.inertias, bodies.R, bodies.r - p_BK)
        R_CB = np.swapaxes(capture.R_WC, -1, -2)
        return cls(
            mass=tree.mass,
            normal_B=tree.normal_B,
            I_K=inertias.sum(axis=0),
            h_K=L.sum(axis=0),
            p_BK=p_BK,
            v_BK=v_BK,
            R_BC=capture.R_WC,
            w_BC=rotate(R_CB, capture.w_WC),
            s=rotate(R_CB, capture.p_WC - p_BK),
            sdot=rotate(R_CB, capture.v_WC - v_BK),
        )

    @classmethod
    def concatenate(cls, parts: Sequence["BodyDynamics"]) -> "BodyDynamics":
        """Return the instants of all parts, which are of one spacecraft."""
        arrays = (np.concatenate([getattr(part, name) for part in parts]) for name in _BY_INSTANT)
        return cls(parts[0].mass, parts[0].normal_B, *arrays)

    def part(self, rows: slice | NDArray[np.intp]) -> "BodyDynamics":
        """Return some of the instants."""
        arrays = (getattr(self, name)[rows] for name in _BY_INSTANT)
        return BodyDynamics(self.mass, self.normal_B, *arrays)

    def regressor(self, w_B: ArrayLike) -> Array:
        """Return Y (N, 3, 10) in B at angular velocities w_B (N, 3): the relative rows."""
        w = rotate(np.swapaxes(self.R_BC, -1, -2), w_B)
        sdot = self.sdot + cross(w, self.s)
        return self.R_BC @ relative_regressor(self.s, sdot, w + self.w_BC)

    def total_mass(self, psi: Array) -> Array:
        """Return the mass (...) of spacecraft and target [kg]: μ = m_k m/(m_k + m)."""
        return np.asarray(self.mass**2 / (self.mass - psi[..., 0]))

    def inertia(self, psi: Array) -> Array:
        """Return J(ψ) (..., N, 3, 3) about the system's centre of mass, in B."""
        mu, first, s = psi[..., 0], psi[..., 1:4], self.s
        moment = vector_to_tensor(psi[..., 4:])[..., None, :, :]
        moment = moment - mu[..., None, None, None] * skew(s) @ skew(s)
        outer = s[:, :, None] * first[..., None, None, :]
        moment = moment - outer - np.swapaxes(outer, -1, -2)
        moment += 2 * np.trace(outer, axis1=-2, axis2=-1)[..., None, None] * np.eye(3)
        return self.I_K + self.R_BC @ moment @ np.swapaxes(self.R_BC, -1, -2)

    def mobility(self, psi: Array) -> Array:
        """Return ∂ω/∂L (..., N, 3, 3) in B: the inverse of J(ψ); on a table n nᵀ / (nᵀ J n).

        Raises:
            InputError: with this target, the inertia about some axis is less than `LEAST_INERTIA`
                of that without it. No rigid body reduces the inertia; noise may.

        """
        J, n = self.inertia(psi), self.normal_B
        more = J - LEAST_INERTIA * self.I_K
        if n is None:
            with suppress(np.linalg.LinAlgError):  # not positive definite
                if np.isfinite(np.linalg.cholesky(more)).all():
                    return inverses(J)
        elif (n @ more @ n > 0).all():
            return np.asarray(np.outer(n, n) / (n @ J @ n)[..., None, None])
        raise InputError("no rigid body reduces the system's inertia as this target does")

    def inertia_regressor(self, vectors_B: Array) -> Array:
        """Return the derivative (N, 3, 10) of J(ψ) x with respect to ψ, for x (N, 3), in B."""
        x = rotate(np.swapaxes(self.R_BC, -1, -2), vectors_B)
        return self.R_BC @ relative_regressor(self.s, cross(x, self.s), x)

    def momentum_at_rest(self, psi: Array) -> Array:
        """Return h(ψ) (..., N, 3), in B: the angular momentum while the base does not rotate."""
        Y = relative_regressor(self.s, self.sdot, self.w_BC)
        return self.h_K + rotate(self.R_BC, rotate(Y, psi[..., None, :]))

    def com(self, psi: Array) -> Array:
        """Return ρ(ψ) (..., N, 3): the system's centre of mass from B's origin, in B [m]."""
        return self.p_BK + rotate(self.com_regressor(), psi[..., None, :4])

    def com_regressor(self) -> Array:
        """Return ∂ρ/∂ψ (N, 3, 4): ρ depends on (μ, μc) only."""
        columns = np.concatenate([rotate(self.R_BC, self.s)[..., None], self.R_BC], axis=-1)
        return np.asarray(columns / self.mass)

    def com_rate(self, psi: Array) -> Array:
        """Return the rate of ρ(ψ) as seen from B (..., N, 3), in B [m/s]."""
        return self.v_BK + rotate(self.com_rate_regressor(), psi[..., None, :4])

    def com_rate_regressor(self) -> Array:
        """Return the derivative of `com_rate` with respect to (μ, μc), (N, 3, 4)."""
        columns = np.concatenate([self.sdot[..., None], skew(self.w_BC)], axis=-1)
        return np.asarray(self.R_BC @ columns / self.mass)

    def base_twist(
        self, psi: Array, L_Scm_B: ArrayLike = (0.0,) * 3, v_Scm_B: ArrayLike = 0.0
    ) -> tuple[Array, Array]:
        """Return the base's velocities ω and v (..., N, 3) in W, in B, that conserve momentum.

        Args:
            psi: (..., 10) ψ.
            L_Scm_B: (..., N, 3) angular momentum about the system's centre of mass, in B [N·m·s].
            v_Scm_B: (..., N, 3) velocity of this centre, in B [m/s].

        """
        w = rotate(self.mobility(psi), np.asarray(L_Scm_B) - self.momentum_at_rest(psi))
        v = np.asarray(v_Scm_B) - self.com_rate(psi) - cross(w, self.com(psi))
        return w, v if self.normal_B is None else v - (v @ self.normal_B)[..., None] * self.normal_B


_BY_INSTANT = ("I_K", "h_K", "p_BK", "v_BK", "R_BC", "w_BC", "s", "sdot")
