"""Covariance of a target's parameters from an information matrix, and its derivative."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class TargetCovariance:
    """The covariance of ψ, with all other unknowns and the known bodies' errors p estimated.

    Information of the samples about p counts only as far as the first order in p is accurate: a
    combination that they determine with information λ has the variance 1/(1 + λ/(1 + c²λ)) with
    the curvature c; see `block_state.BlockState.with_estimated_bodies`. With A, B and D the blocks
    of the information about the unknowns x of the fit and about p,

        S = D − Bᵀ A⁻¹ B,      cov x = A⁻¹ + A⁻¹ B g(S) Bᵀ A⁻¹,      g(λ) = a + b/(1 + e λ),

    where e = 1 + c², a = c²/e and b = 1/e.

    Attributes:
        information: (B, n, n) the information about x and p, with the prior of x.
        unknowns: number of entries of x, the last ten of which are ψ.
        curvature: c; see `BodyUncertainty.curvature`.

    """

    information: NDArray[np.float64]
    unknowns: int
    curvature: float = 0.0

    @cached_property
    def psi(self) -> NDArray[np.float64]:
        """(B, 10, 10) the covariance of ψ."""
        gain = self._by_bodies[:, -10:]
        covariance = self._inverse[:, -10:, -10:] + self._a * gain @ np.swapaxes(gain, 1, 2)
        if gain.shape[2]:
            found = np.linalg.solve(self._seen, np.swapaxes(gain, 1, 2))
            covariance += self._b * gain @ found
        return np.asarray((covariance + np.swapaxes(covariance, 1, 2)) / 2)

    def weights(
        self, k: int, directions: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return how the variance of combinations of ψ changes with the information matrix.

        For a change dF of the information, the variance of vᵀψ changes by Σ_r s_r l_rᵀ dF r_r.

        Args:
            k: number of the motion in the batch.
            directions: (V, 10) combinations v.

        Returns:
            l and r (V, 3, n), with the signs s in r.

        """
        A, B = self._inverse[k], self._by_bodies[k]
        y = np.zeros((len(directions), self.information.shape[-1]))
        y[:, : self.unknowns] = directions @ A[-10:]
        bodies = directions @ B[-10:]  # Bᵀ A⁻¹ v
        seen = np.linalg.solve(self._seen[k], bodies.T).T if bodies.size else bodies

        def in_all(p: NDArray[np.float64]) -> NDArray[np.float64]:
            return np.concatenate([-p @ B.T, p], axis=1)

        z, r = in_all(self._a * bodies + self._b * seen), in_all(seen)
        left = np.stack([y, 2 * y, r], axis=1)
        return left, np.stack([-y, z, -self._b * self._e * r], axis=1)

    @property
    def _e(self) -> float:
        return 1 + self.curvature**2

    @property
    def _a(self) -> float:
        return self.curvature**2 / self._e

    @property
    def _b(self) -> float:
        return 1 / self._e

    @cached_property
    def _inverse(self) -> NDArray[np.float64]:
        """(B, x, x) A⁻¹, computed with scaled unknowns."""
        A = self.information[:, : self.unknowns, : self.unknowns]
        scale = 1 / np.sqrt(np.diagonal(A, axis1=1, axis2=2))
        scaled = scale[:, :, None] * A * scale[:, None]
        return np.asarray(scale[:, :, None] * np.linalg.inv(scaled) * scale[:, None])

    @cached_property
    def _by_bodies(self) -> NDArray[np.float64]:
        """(B, x, p) A⁻¹ B."""
        return np.asarray(self._inverse @ self.information[:, : self.unknowns, self.unknowns :])

    @cached_property
    def _seen(self) -> NDArray[np.float64]:
        """(B, p, p) 1 + e S."""
        F, u = self.information, self.unknowns
        S = F[:, u:, u:] - F[:, u:, :u] @ self._by_bodies
        return np.asarray(np.eye(S.shape[-1]) + self._e * S)
