"""What is plausible before the first sample: the size of a target, and how fast it moves."""

import numpy as np
from numpy.typing import NDArray

FASTEST_TUMBLE = 2.0
"""σ of an unknown angular velocity of the system [rad/s]."""

FASTEST_DRIFT = 10.0
"""σ of an unknown velocity of the system's centre of mass [m/s]."""

_LARGEST = 100.0
"""Largest radius of gyration of a target, in radii of gyration of the spacecraft."""


def psi_scale(known_mass: float, known_inertia: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (10,) magnitudes of ψ for a target as heavy and as large as the spacecraft."""
    radius = np.sqrt(np.trace(known_inertia) / 2 / known_mass)
    mass = known_mass / 2
    return mass * np.concatenate([[1.0], 3 * [radius], 6 * [radius**2]])


def plausible_sizes(psi: NDArray[np.float64], least: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (10,) magnitudes of ψ for a target as heavy and as large as one with ψ (10,).

    Args:
        psi: (10,) of the target.
        least: (10,) magnitudes that it has at least.

    """
    if not psi[0] > 0:
        return least
    moments = psi[[4, 7, 9]]
    spread = max(float(moments.sum()) / 2, float(moments.max()), 0.0)  # Σ m r²: some may be unknown
    radius = np.sqrt(spread / psi[0])
    radius = min(radius, _LARGEST * np.sqrt(least[4] / least[0]))
    return np.maximum(psi[0] * np.concatenate([[1.0], 3 * [radius], 6 * [radius**2]]), least)


def plausible_psi(known_mass: float, known_inertia: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return ψ (10,) of a plausible target: the mean of a vague prior.

    It is a solid sphere of a tenth of the spacecraft's mass about C's origin.

    Args:
        known_mass: mass of the known bodies [kg].
        known_inertia: (3, 3) their inertia about their centre of mass [kg·m²].

    """
    radius = np.sqrt(np.trace(known_inertia) / 2 / known_mass)
    mass = 0.1 * known_mass / 1.1  # reduced
    sphere = 0.4 * mass * radius**2
    return np.array([mass, 0, 0, 0, sphere, 0, 0, sphere, 0, sphere], dtype=float)
