"""What is known at the end of a block, as a square root of information, and its solution.

Source: Bierman 1977, Factorization Methods for Discrete Sequential Estimation, ch. V.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.special import chdtri

from cpid_drake.estimation.jumps import Jump
from cpid_drake.estimation.likelihood.joint_block import JointBlock, JointTrack
from cpid_drake.estimation.likelihood.motion import TrajectoryState

KNOWN_SHARE = 0.02
"""A combination of entries of ψ is well known if its σ is below this share of its plausible size.

The nominal ψ moves along such combinations only: values of the others are fitted to noise.
"""

UNLIKELY = 1e-7
"""Probability of χ² below which noise does not explain a block's samples."""


@dataclass(frozen=True, eq=False)
class BlockState:
    """What is known at one instant.

    Attributes:
        time: [s].
        nominal: the state that δX are the deviations from, with one bias for each gyro.
        track: the joint motion by its sensors alone, whose mean the joints' deviations refer to.
        root: (n, n) upper triangle by δX.
        by_bodies: (n, c) by the known bodies' errors.
        rest: (n,) right-hand side.
        bodies: (c, c + 1) triangle and right-hand side of the information about the known bodies'
            errors alone, their prior included.
        jumps: assumed changes that are tested.
        unexplained: number of blocks in a row, up to this instant, that are mostly bridged.
        errors: (c,) errors that the tree contains; see `BlockSolver`. Those of the known bodies
            above are what remains of them, with a prior about minus these.

    """

    time: float
    nominal: TrajectoryState
    track: JointTrack | None
    root: NDArray[np.float64]
    by_bodies: NDArray[np.float64]
    rest: NDArray[np.float64]
    bodies: NDArray[np.float64]
    jumps: tuple[Jump, ...] = ()
    unexplained: int = 0
    errors: NDArray[np.float64] | None = None

    @property
    def extra(self) -> NDArray[np.float64]:
        """(n, c + 12 k) columns of the known bodies' errors and of k assumed changes."""
        return np.hstack([self.by_bodies, *(jump.columns for jump in self.jumps)])

    def with_estimated_bodies(self, misfit: float = 1.0, curvature: float = 0.0) -> "BlockState":
        """Return the state about the best errors p of the known bodies.

        The samples tell about p too: R_p p = z_p + e with unit noise e. The equations
        R δX + G p = z become those in e: G R_p⁻¹ in place of G, and z − G R_p⁻¹ z_p in place of z.
        The uncertain quantities of the returned state are e, whose prior is again N(0, 1).

        Args:
            misfit: χ² per degree of freedom of the samples, which tell less if it is above 1.
            curvature: effects of second order in p, as a share of those of first order; no
                combination of p becomes known better than that.

        """
        c = len(self.bodies)
        if not c:
            return self
        best, root = self.estimated_errors(misfit, curvature)
        gain, rest = self.by_bodies @ root, self.rest - self.by_bodies @ best
        return replace(self, by_bodies=gain, rest=rest, bodies=np.eye(c, c + 1), errors=None)

    def estimated_errors(
        self, misfit: float = 1.0, curvature: float = 0.0
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the best p (c,), and the root S (c, c) of its covariance S Sᵀ.

        The error of the best p is S e with the e and the arguments of `with_estimated_bodies`.
        """
        c = len(self.bodies)
        root: NDArray[np.float64] = self.bodies[:, :c]
        prior = np.zeros(c) if self.errors is None else -self.errors
        size, axes = np.linalg.eigh(root.T @ root - np.eye(c))  # of the samples, without the prior
        share = 1 / (misfit + np.maximum(size, 0) * curvature**2)
        target = share * (axes.T @ (root.T @ self.bodies[:, c] - prior)) + axes.T @ prior
        sigma = 1 / np.sqrt(1 + share * np.maximum(size, 0))
        return axes @ (sigma**2 * target), axes * sigma

    def with_exact_bodies(self) -> "BlockState":
        """Return the state if the known bodies had no errors but those that the tree contains."""
        return replace(self, by_bodies=self.by_bodies[:, :0], bodies=np.zeros((0, 1)), errors=None)

    def best_errors(self) -> tuple[NDArray[np.float64] | None, float]:
        """Return the best errors (c,) of the known bodies, and how far they are from `errors`.

        The distance is in units of their σ together; the errors are None if the bodies are exact.
        """
        c = len(self.bodies)
        if not c:
            return None, 0.0
        change = solve_triangular(self.bodies[:, :c], self.bodies[:, c])
        about = np.zeros(c) if self.errors is None else self.errors
        return about + change, float(np.linalg.norm(self.bodies[:, c]))

    def psi_information(self) -> NDArray[np.float64]:
        """Return the information (10, 10) about ψ with all else eliminated, the prior included."""
        R = self.root[-10:, -10:]
        return R.T @ R

    def psi_consider(self) -> NDArray[np.float64]:
        """Return the covariance (10, 10) that the known bodies' uncertainty adds to that of ψ."""
        gain = solve_triangular(self.root, self.by_bodies)[-10:]
        return gain @ gain.T

    def best_constants(self, psi: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the best values (k,) of the constant errors for a ψ (10,)."""
        k = len(self.nominal.constants)
        R, z = self.root[-k - 10 :, -k - 10 :], self.rest[-k - 10 :]
        rest = z[:k] - R[:k, k:] @ (psi - self.nominal.psi)
        return np.asarray(self.nominal.constants + solve_triangular(R[:k, :k], rest))

    def psi_equations(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return R (10, 10) and z (10,) of R δψ = z + unit noise, with all else eliminated.

        The known bodies' errors are eliminated too: G e in the equations is noise of covariance
        G Gᵀ.
        """
        state = self.with_estimated_bodies()
        R, z, G = state.root[-10:, -10:], state.rest[-10:], state.by_bodies[-10:]
        white = np.linalg.cholesky(np.eye(10) + G @ G.T)
        both = solve_triangular(white, np.column_stack([R, z]), lower=True)
        return both[:, :10], both[:, 10]

    def psi_misfit(self) -> float:
        """Return the increase of χ² at the nominal ψ over its minimum."""
        _, z = self.psi_equations()
        return float(z @ z)


@dataclass(frozen=True, eq=False)
class BlockFit:
    """One block's solution.

    Attributes:
        state: at the end.
        joints: the joint motion.
        residuals: (M, d) what the solution leaves of each sensor's samples in σ, by sensor; d is
            the sensor's `width`.
        chi_squared, freedom: of the samples of the base's sensors, given all before.
        misfit: see `BlockSolver`.

    """

    state: BlockState
    joints: JointBlock
    residuals: dict[str, NDArray[np.float64]]
    times: dict[str, NDArray[np.float64]]
    chi_squared: float
    freedom: int
    misfit: float

    @property
    def is_likely(self) -> bool:
        """Whether noise explains the samples."""
        return self.chi_squared <= self.misfit * chdtri(max(self.freedom, 1), UNLIKELY)


def solution(
    R: NDArray[np.float64],
    z: NDArray[np.float64],
    plausible: NDArray[np.float64] | None,
    share: float = KNOWN_SHARE,
    held: int = 10,
) -> NDArray[np.float64]:
    """Return x (n,) of R x = z, R upper triangular, with ψ as its last ten entries.

    Args:
        R, z: (n, n) and (n,).
        plausible: (10,) plausible sizes of ψ; combinations that are not well known remain zero, and
            the other entries of x are the best for that. None to keep the held entries at zero.
        share: σ of a well-known combination, as a share of its plausible size, is at most this.
        held: number of the last entries, ψ among them, that `plausible` = None keeps at zero.

    Raises:
        numpy.linalg.LinAlgError: the samples contradict each other so much that R or z overflows.

    """
    if not (np.isfinite(R).all() and np.isfinite(z).all()):
        raise np.linalg.LinAlgError("nothing explains the samples")
    last = np.zeros(held if plausible is None else 10)
    n = len(R) - len(last)
    if plausible is not None:
        U, size, axes = np.linalg.svd(R[n:, n:] * plausible)
        known = size > 1 / share
        last = plausible * (axes[known].T @ ((U.T @ z[n:])[known] / size[known]))
    others = solve_triangular(R[:n, :n], z[:n] - R[:n, n:] @ last)
    return np.concatenate([others, last])
