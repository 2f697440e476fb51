"""The base's motion from angular momentum about the system's centre of mass.

Without external forces, the system's centre of mass moves on a straight line, and the angular
momentum L about it is constant. Seen from the base, with ω = w_WB and all in B,

    J(ψ) ω + h(ψ) = Rᵀ L,      p_WB = p_Wcm − R ρ(ψ),

where J, h and ρ are *linear* in the unknowns ψ = (μ, μc, I_*) of the relative rows. For
any two ψ and ψ', with ω the true angular velocity for ψ, this means

    J(ψ') (ω − ω') = Rᵀ(L − L') − Y(ω) (ψ − ψ')

exactly, with Y the relative rows. The attitude does not depend on the position, and the position
does not depend on a measured velocity.

Source: Ning et al. 2016, Eqs. 5 and 9, about the centre of mass.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cpid_drake.dynamics.base_motion import KnownDynamics, known_dynamics
from cpid_drake.dynamics.parameterizations import vector_to_tensor
from cpid_drake.dynamics.rotations import cross, rotate, skew, unskew
from cpid_drake.dynamics.rows import relative_regressor
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.errors import InputError

LEAST = 0.5
"""Least inertia of the system about any axis, as a share of that without the target."""


@dataclass(frozen=True)
class RelativeDynamics:
    """The known bodies and the capture frame as seen from the base, at N instants.

    Attributes:
        mass: mass of the known bodies [kg].
        I_K: (N, 3, 3) their inertia about their centre of mass K, in B.
        h_K: (N, 3) their angular momentum about K on a base that does not turn, in B.
        p_BK: (N, 3) K from B's origin, in B [m].
        v_BK: (N, 3) rate of p_BK as seen from B [m/s].
        R_BC: (N, 3, 3) attitude of C in B.
        w_BC: (N, 3) angular velocity of C relative to B, in C [rad/s].
        s: (N, 3) vector from K to C's origin, in C [m].
        sdot: (N, 3) its rate as seen from B, in C [m/s].
        normal_B: (3,) normal in B of a table that carries the base; None without one.

    """

    mass: float
    I_K: NDArray[np.float64]
    h_K: NDArray[np.float64]
    p_BK: NDArray[np.float64]
    v_BK: NDArray[np.float64]
    R_BC: NDArray[np.float64]
    w_BC: NDArray[np.float64]
    s: NDArray[np.float64]
    sdot: NDArray[np.float64]
    normal_B: NDArray[np.float64] | None = None

    @classmethod
    def from_known(cls, known: KnownDynamics, mass: float) -> "RelativeDynamics":
        """Return the dynamics of known bodies of this mass [kg], converted from B's origin to K."""
        M, h, X = known.M, known.h, known.X
        p_BK = unskew(M[:, :3, 3:]) / mass
        R_CB = X[:, :3, :3]
        R_BC = np.swapaxes(R_CB, -1, -2)
        p_BC = -unskew(R_BC @ X[:, 3:, :3])
        v_BK = h[:, 3:] / mass
        return cls(
            mass=mass,
            I_K=M[:, :3, :3] + mass * skew(p_BK) @ skew(p_BK),
            h_K=h[:, :3] - rotate(skew(p_BK), h[:, 3:]),
            p_BK=p_BK,
            v_BK=v_BK,
            R_BC=R_BC,
            w_BC=known.V_BC[:, :3],
            s=rotate(R_CB, p_BC - p_BK),
            sdot=known.V_BC[:, 3:] - rotate(R_CB, v_BK),
            normal_B=known.normal_B,
        )

    @classmethod
    def joined(cls, parts: Sequence["RelativeDynamics"]) -> "RelativeDynamics":
        """Return the instants of all parts, which are of one spacecraft."""
        names = vars(parts[0]).keys() - {"mass", "normal_B"}
        arrays = {n: np.concatenate([getattr(part, n) for part in parts]) for n in names}
        return cls(parts[0].mass, normal_B=parts[0].normal_B, **arrays)

    def part(self, rows: slice) -> "RelativeDynamics":
        """Return some of the instants."""
        arrays = {
            name: value[rows]
            for name, value in vars(self).items()
            if name not in ("mass", "normal_B")
        }
        return replace(self, **arrays)

    def regressor(self, w_B: ArrayLike) -> NDArray[np.float64]:
        """Return Y (N, 3, 10) in B at angular velocities w_B (N, 3): the relative rows."""
        w = rotate(np.swapaxes(self.R_BC, -1, -2), w_B)
        sdot = self.sdot + rotate(skew(w), self.s)
        return self.R_BC @ relative_regressor(self.s, sdot, w + self.w_BC)

    def inertia(self, psi: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return J(ψ) (N, 3, 3) about the system's centre of mass, in B, of ψ (10,)."""
        mu, first, s = psi[0], psi[1:4], self.s
        moment = vector_to_tensor(psi[4:]) - mu * skew(s) @ skew(s)
        cross = s[:, :, None] * first
        moment = moment - cross - np.swapaxes(cross, -1, -2)
        moment += (2 * s @ first)[:, None, None] * np.eye(3)
        return self.I_K + self.R_BC @ moment @ np.swapaxes(self.R_BC, -1, -2)

    def mobility(self, psi: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return ∂ω/∂L (N, 3, 3) in B: the inverse of J(ψ); on a table n nᵀ / (nᵀ J n).

        Raises:
            InputError: with this target, the inertia about some axis is less than `LEAST` of that
                without it. No rigid body reduces the inertia; noise may.

        """
        J, n = self.inertia(psi), self.normal_B
        more = J.real - LEAST * self.inertia(np.zeros(10))
        if n is None:
            if np.isfinite(J).all() and (np.linalg.eigvalsh(more)[:, 0] > 0).all():
                return np.asarray(np.linalg.inv(J))
        elif (n @ more @ n > 0).all():
            return np.asarray(np.outer(n, n) / (n @ J @ n)[:, None, None])
        raise InputError("no rigid body reduces the system's inertia as this target does")

    def inertia_regressor(self, vectors_B: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the derivative (N, 3, 10) of J(ψ) x with respect to ψ, for x (N, 3), in B."""
        x = rotate(np.swapaxes(self.R_BC, -1, -2), vectors_B)
        return self.R_BC @ relative_regressor(self.s, cross(x, self.s), x)

    def momentum_at_rest(self, psi: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return h(ψ) (N, 3), in B: the angular momentum while the base does not turn."""
        Y = relative_regressor(self.s, self.sdot, self.w_BC)
        return self.h_K + rotate(self.R_BC, Y @ psi)

    def com(self, psi: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return ρ(ψ) (N, 3): the system's centre of mass from B's origin, in B [m]."""
        return self.p_BK + rotate(self.R_BC, psi[0] * self.s + psi[1:4]) / self.mass

    def com_regressor(self) -> NDArray[np.float64]:
        """Return ∂ρ/∂ψ (N, 3, 4): ρ depends on (μ, μc) only."""
        columns = np.concatenate([rotate(self.R_BC, self.s)[..., None], self.R_BC], axis=-1)
        return columns / self.mass

    def com_rate(self, psi: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the rate of ρ(ψ) as seen from B (N, 3), in B [m/s]."""
        moved = psi[0] * self.sdot + skew(self.w_BC) @ psi[1:4]
        return self.v_BK + rotate(self.R_BC, moved) / self.mass

    def com_rate_regressor(self) -> NDArray[np.float64]:
        """Return the derivative of `com_rate` with respect to (μ, μc), (N, 3, 4)."""
        columns = np.concatenate(
            [rotate(self.R_BC, self.sdot)[..., None], self.R_BC @ skew(self.w_BC)], axis=-1
        )
        return columns / self.mass


def relative_dynamics(tree: KinematicTree, q: ArrayLike, qdot: ArrayLike) -> RelativeDynamics:
    """Return the known bodies as seen from the base at joint positions and rates, (N, J) each."""
    return RelativeDynamics.from_known(known_dynamics(tree, q, qdot), tree.mass)
