"""Mass distributions of rigid bodies: moments of inertia, second moments and spatial inertias."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cpid_drake.dynamics.rotations import skew


def point_mass_inertia(mass: float, p: ArrayLike) -> NDArray[np.float64]:
    """Return m (|p|² 1 − p pᵀ): the (3, 3) inertia about the origin of a mass [kg] at p (3,) [m].

    By the parallel-axis theorem it is also the change of a body's inertia from its centre of mass
    to a point that is p away. Entries that do not depend on an unknown coordinate (NaN) are known.
    """
    x, y, z = np.asarray(p, dtype=float).tolist()
    return mass * np.array(
        [
            [y * y + z * z, -x * y, -x * z],
            [-x * y, x * x + z * z, -y * z],
            [-x * z, -y * z, x * x + y * y],
        ]
    )


def second_moment(inertia: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return Σ = ∫ r rᵀ dm = ½ tr(I) 1 − I (3, 3) of an inertia I (3, 3) about the same point.

    Source: Wensing et al. 2018.
    """
    return np.trace(inertia) / 2 * np.eye(3) - inertia


def inertia_of_second_moment(sigma: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return I = tr(Σ) 1 − Σ (3, 3) of a second moment (3, 3): the inverse of `second_moment`."""
    return np.trace(sigma) * np.eye(3) - sigma


def spatial_inertia(
    mass: ArrayLike, moment: NDArray[np.float64], inertia: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return G (..., 6, 6) with momentum [L; P] = G [ω; v], about one point and in one frame.

    Args:
        mass: (...) [kg].
        moment: (..., 3) first moment of mass m c from the point [kg·m].
        inertia: (..., 3, 3) inertia about the point [kg·m²].

    """
    h = skew(moment)
    G = np.zeros((*h.shape[:-2], 6, 6), np.result_type(h, inertia))
    G[..., :3, :3] = inertia
    G[..., :3, 3:] = h
    G[..., 3:, :3] = -h
    G[..., 3:, 3:] = np.asarray(mass)[..., None, None] * np.eye(3)
    return G


def moved_moments(
    mass: ArrayLike, I_cm: NDArray[np.float64], R: NDArray[np.float64], p: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return first moments (..., 3) and inertias (..., 3, 3) about another frame's origin.

    Both are in that frame.

    Args:
        mass: (...) [kg].
        I_cm: (..., 3, 3) inertia about the centre of mass, in the body's frame [kg·m²].
        R: (..., 3, 3) attitude of the body's frame in the other.
        p: (..., 3) centre of mass from the other frame's origin [m].

    """
    moment = np.asarray(mass)[..., None] * p
    inertia = R @ I_cm @ np.swapaxes(R, -1, -2)
    # The parallel-axis theorem, as in `point_mass_inertia`, for many masses.
    inertia -= moment[..., :, None] * p[..., None, :]
    square = np.einsum("...i,...i->...", moment, p)
    for k in range(3):
        inertia[..., k, k] += square
    return moment, inertia
