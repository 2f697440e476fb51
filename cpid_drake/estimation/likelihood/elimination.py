"""Weighted least squares on rows, with the errors of the joint motion eliminated."""

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.linalg.blas import dsyrk


class WeightedRows:
    """M rows that contain independent white noise and the errors of the joint motion.

    After multiplication of the rows by the weights W, their covariance is C = 1 + N Nᵀ with the
    joint motion's Jacobian N. Its inverse is applied by the matrix inversion lemma (Woodbury 1950),
    which eliminates the joint motion's errors.

    Args:
        joint_jacobian: N (M, k), in units of σ of the errors; None without such errors.
        weights: (M,) square roots of the rows' weights.

    """

    def __init__(
        self, joint_jacobian: NDArray[np.float64] | None, weights: NDArray[np.float64]
    ) -> None:
        self.weights = weights
        self._N = np.empty((len(weights), 0))
        if joint_jacobian is not None:
            self._N = joint_jacobian * weights[:, None]
        normal = dsyrk(1.0, self._N.T) if self._N.size else np.empty((0, 0))  # only its upper half
        normal[np.diag_indices(len(normal))] += 1.0
        self._factor = cho_factor(normal, overwrite_a=True, check_finite=False)

    def normal_equations(
        self, A: NDArray[np.float64], b: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
        """Return AᵀC⁻¹A (n, n), AᵀC⁻¹b (n,) and bᵀC⁻¹b of A (M, n) and b (M,)."""
        A, b = A * self.weights[:, None], b * self.weights
        to_A, to_b = self._N.T @ A, self._N.T @ b
        solved = cho_solve(self._factor, to_A)
        normal = A.T @ A - to_A.T @ solved
        cost = float(b @ b) - float(to_b @ cho_solve(self._factor, to_b))
        return (normal + normal.T) / 2, A.T @ b - solved.T @ to_b, cost

    def cost(self, b: NDArray[np.float64]) -> float:
        """Return bᵀC⁻¹b of b (M,)."""
        b = b * self.weights
        to_b = self._N.T @ b
        return float(b @ b) - float(to_b @ cho_solve(self._factor, to_b))

    def own_noise(self, b: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return residuals b (M,) minus the effect of the joint motion's most likely errors."""
        errors = cho_solve(self._factor, self._N.T @ (b * self.weights))
        return np.asarray(b - self._N @ errors / self.weights)

    def cross(self, A: NDArray[np.float64], K: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return AᵀC⁻¹K (n, k) of A (M, n) and K (M, k)."""
        A, K = A * self.weights[:, None], K * self.weights[:, None]
        return np.asarray(A.T @ K - (self._N.T @ A).T @ cho_solve(self._factor, self._N.T @ K))


def marginal(information: NDArray[np.float64], kept: int) -> NDArray[np.float64]:
    """Return the information (kept, kept) about the first unknowns, with the others eliminated."""
    N = information
    if len(N) == kept:
        return N
    scale = 1 / np.sqrt(np.maximum(np.diag(N), 1e-300))
    N = N * scale * scale[:, None]
    cross = N[:kept, kept:]
    rest = N[kept:, kept:] + 1e-14 * np.eye(len(N) - kept)
    result = N[:kept, :kept] - cross @ cho_solve(cho_factor(rest), cross.T)
    return np.asarray((result + result.T) / 2 / scale[:kept] / scale[:kept, None])
