"""Log-Cholesky form of rigid bodies' parameters: every point of R¹⁰ is a rigid body."""

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.parameterizations import (
    pseudo_inertia_to_standard,
    standard_to_pseudo_inertia,
)


class LogCholesky:
    """Relative unknowns ψ(λ) of the pseudo-inertia P = S U Uᵀ S, with exp(λ) on U's diagonal.

    Args:
        scale: (10,) magnitudes of the unknowns; only m and I are used, for S.

    Source: Rucker & Wensing 2022, log-Cholesky parameterization.

    """

    _rows, _columns = np.tril_indices(4)

    def __init__(self, scale: NDArray[np.float64]) -> None:
        mass = np.sqrt(scale[0])
        length = np.sqrt(np.abs(scale[4:]).max() / scale[0])
        self.S = mass * np.diag([length, length, length, 1.0])

    def from_psi(self, psi: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return λ (10,) of a rigid body's ψ (10,); one on the limits is moved inside them."""
        inverse = np.diag(1 / np.diag(self.S))
        P = inverse @ standard_to_pseudo_inertia(psi) @ inverse
        values, axes = np.linalg.eigh((P + P.T) / 2)
        values = np.maximum(values, 1e-3 * values[-1])
        U = np.linalg.cholesky((axes * values) @ axes.T)
        U[np.diag_indices(4)] = np.log(np.diag(U))
        return U[self._rows, self._columns]

    def to_psi(
        self, parameters: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return ψ (10,) and ∂ψ/∂λ (10, 10)."""
        U = np.zeros((4, 4))
        U[self._rows, self._columns] = parameters
        diagonal = np.diag_indices(4)
        U[diagonal] = np.exp(U[diagonal])
        jacobian = np.empty((10, 10))
        for n, (i, j) in enumerate(zip(self._rows, self._columns)):
            dU = np.zeros((4, 4))
            dU[i, j] = U[i, j] if i == j else 1.0
            dP = dU @ U.T + U @ dU.T
            jacobian[:, n] = pseudo_inertia_to_standard(self.S @ dP @ self.S)
        return pseudo_inertia_to_standard(self.S @ U @ U.T @ self.S), jacobian
