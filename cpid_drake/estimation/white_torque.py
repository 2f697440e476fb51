"""Whether a white torque acts that nothing models: its intensities, and what one change says of it.

With the intensity q it changes the angular momentum in a time h by u ~ N(0, q² h). Samples that
say H and b of u alone have the evidence

    2 log p(y | q) / p(y | 0) = bᵀ(H + 1/(q² h))⁻¹ b − log det(q² h H + 1).

Source: Kass and Raftery 1995, Bayes factors.
"""

import numpy as np
from scipy.special import logsumexp

from cpid_drake.array import Array
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.estimation.gaussian import Gaussian
from cpid_drake.estimation.likelihood.constants import TORQUE
from cpid_drake.estimation.likelihood.forces import SHORTEST_PIECE
from cpid_drake.estimation.links import farthest
from cpid_drake.estimation.unknowns import Model
from cpid_drake.sensors.error_kinds import KINDS

SHARES = 10.0 ** np.arange(-3, 0)
"""q that are compared, each as probable before the samples, as shares of that of a white torque of
plausible size in each of its pieces. A larger torque gains with these, too."""

NO_GAINS = np.zeros(len(SHARES))
"""`gains_of_change` of no change."""


def intensities(tree: KinematicTree) -> Array:
    """Return the q (n,) that are compared, for a spacecraft [N·m·√s]."""
    # q = share · σ_τ √h, with the plausible torque σ_τ in each piece of the length h
    return np.asarray(SHARES * KINDS[TORQUE].plausible(tree) * SHORTEST_PIECE**0.5)


def gain_of(gains: Array) -> float:
    """Return by how much −2 log(evidence) falls with one of the q, from that (n,) with each."""
    # p(y | q) / p(y | 0), on average
    return 2 * float(logsumexp(np.asarray(gains) / 2) - np.log(len(gains)))


def gains_of_change(model: Model, changes: Gaussian, name: str, length: float) -> Array:
    """Return by how much −2 log(evidence) falls (n,) with each q, by one change of the momentum.

    Args:
        model: the unknowns.
        changes: of changes (12,) of attitude, centre of mass, L and v themselves, with the priors
            of open ends; all others are zero, and so is what is not L.
        name: of the change.
        length: time h in which the torque acts [s].

    """
    R, sigma = changes.R[:, changes.places[name]][:, 6:9], farthest(model)[6:9]
    information, b = R.T @ R - np.diag(sigma**-2), R.T @ changes.z
    h, V = np.linalg.eigh(information)
    variance = length * intensities(model.tree)[:, None] ** 2
    size = 1 + variance * np.maximum(h, 0.0)
    return np.asarray(np.sum(variance * (V.T @ b) ** 2 / size - np.log(size), axis=1))
