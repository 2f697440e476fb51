"""What is known before the first sample: plausible sizes of a target, and of the start."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.total_momentum import TotalMomentum

FASTEST_TUMBLE = 2.0
"""σ of an unknown angular velocity of the system [rad/s]."""

FASTEST_DRIFT = 10.0
"""σ of an unknown velocity of the system's centre of mass [m/s]."""

_FAR = 3.0
"""Distance of a target from the mean of a vague prior, in σ, from which the prior is too narrow."""

_LARGEST = 100.0
"""Largest radius of gyration of a target, in radii of gyration of the spacecraft."""

_EXACT = 1e-11
"""σ of a known momentum, as a share of the σ of an unknown one: far below any sensor's effect."""


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
    radius = np.sqrt(max(psi[4] + psi[7] + psi[9], 0.0) / 2 / psi[0])
    radius = min(radius, _LARGEST * np.sqrt(least[4] / least[0]))
    return np.maximum(psi[0] * np.concatenate([[1.0], 3 * [radius], 6 * [radius**2]]), least)


@dataclass(frozen=True, eq=False)
class Prior:
    """What is known before the first sample.

    Attributes:
        psi: (10,) mean of the relative unknowns, those of a rigid body.
        psi_sigma: (10,) their σ.
        plausible: (10,) plausible sizes of ψ.
        is_guess: whether `psi_sigma` is information that enters the final estimate; else it only
            describes which targets are plausible.
        momentum: the total momentum.
        L_sigma: σ of the angular momentum [N·m·s].
        v_sigma: σ of the velocity of the centre of mass [m/s].

    """

    psi: NDArray[np.float64]
    psi_sigma: NDArray[np.float64]
    plausible: NDArray[np.float64]
    momentum: TotalMomentum
    unknown_L_sigma: float
    is_guess: bool = False

    @property
    def L_sigma(self) -> float:
        """σ of the angular momentum at the start [N·m·s]."""
        return self.unknown_L_sigma * (1.0 if self.momentum.is_unknown else _EXACT)

    @property
    def v_sigma(self) -> float:
        """σ of the velocity of the system's centre of mass at the start [m/s]."""
        return FASTEST_DRIFT * (1.0 if self.momentum.is_unknown else _EXACT)

    def excludes(self, psi: NDArray[np.float64]) -> bool:
        """Return whether ψ (10,) is far larger than a vague prior calls plausible."""
        return not self.is_guess and bool((np.abs(psi - self.psi) > _FAR * self.psi_sigma).any())

    def covering(self, psi: NDArray[np.float64]) -> "Prior":
        """Return the prior for targets as large as one with ψ (10,), if that is larger."""
        if self.is_guess:
            return self
        sizes = plausible_sizes(psi, self.plausible)
        return replace(self, psi_sigma=sizes, plausible=sizes)

    def as_wide_as(self, other: "Prior") -> "Prior":
        """Return this prior with the σ and the plausible sizes of another one."""
        return replace(self, psi_sigma=other.psi_sigma, plausible=other.plausible)


def vague_prior(
    known_mass: float,
    known_inertia: NDArray[np.float64],
    momentum: TotalMomentum | None = None,
) -> Prior:
    """Return a vague prior: the target is about as large as the spacecraft, or smaller.

    Its mean is a solid sphere of a tenth of the spacecraft's mass about C's origin; σ corresponds
    to a target with the mass and the radius of gyration of the spacecraft.

    Args:
        known_mass: mass of the known bodies [kg].
        known_inertia: (3, 3) their inertia about their centre of mass [kg·m²].
        momentum: the total momentum; default: zero.

    """
    radius = np.sqrt(np.trace(known_inertia) / 2 / known_mass)
    mass = 0.1 * known_mass / 1.1  # reduced
    sphere = 0.4 * mass * radius**2
    psi = np.array([mass, 0, 0, 0, sphere, 0, 0, sphere, 0, sphere], dtype=float)
    scale = psi_scale(known_mass, known_inertia)
    L_sigma = FASTEST_TUMBLE * float(np.trace(known_inertia)) / 3
    return Prior(psi, scale, scale, momentum or TotalMomentum.zero(), L_sigma)


def guessed_prior(vague: Prior, psi: NDArray[np.float64], sigma: float) -> Prior:
    """Return a prior around a guess of the target, with the vague prior's momentum.

    The relative unknowns are uncorrelated. The σ of each is the share `sigma` of its scale: μ,
    μ k or μ k², with k the radius of gyration of `psi` about C's origin.

    Args:
        vague: the prior from `vague_prior`.
        psi: (10,) mean of the relative unknowns, of a rigid body that is not a point at C's origin.
        sigma: σ of each relative unknown, divided by the unknown's scale.

    """
    radius = np.sqrt((psi[4] + psi[7] + psi[9]) / 2 / psi[0])
    scale = psi[0] * np.concatenate([[1.0], 3 * [radius], 6 * [radius**2]])
    return replace(vague, psi=psi, psi_sigma=sigma * scale, is_guess=True)
