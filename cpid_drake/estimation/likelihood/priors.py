"""Plausible sizes of a target before any sample."""

import numpy as np
from numpy.typing import NDArray


def psi_scale(known_mass: float, known_inertia: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (10,) magnitudes of ψ for a target as heavy and as large as the spacecraft."""
    radius = np.sqrt(np.trace(known_inertia) / 2 / known_mass)
    mass = known_mass / 2
    return mass * np.concatenate([[1.0], 3 * [radius], 6 * [radius**2]])
