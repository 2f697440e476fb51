"""Targets that are plausible before a motion: from a prior, or from the size of the spacecraft."""

import numpy as np

from cpid_drake.array import Array
from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.files.errors import InputError
from cpid_drake.identification.prior import TargetPrior

MASSES = (0.03, 0.3)
"""Masses of targets of which nothing is known, as shares of the spacecraft's mass."""

LENGTHS = (0.2, 0.9)
"""Half axes of such targets, as shares of the spacecraft's radius of gyration."""

FARTHEST_CENTRE = 1.2
"""Largest distance of the centre of mass from C's origin, as a share of the mean half axis."""


def plausible_targets(
    mass: float,
    radius: float,
    count: int,
    seed: int,
    prior: TargetPrior | None = None,
    *,
    heaviest: bool = False,
) -> Array:
    """Return π (T, 10) of targets that a motion is planned for.

    Without a prior they are solid ellipsoids of random mass and size, held at a point inside them
    or near their surface. With a prior the first target is its mean, and the others are drawn from
    it; parameters that it does not give are those of an ellipsoid.

    Args:
        mass: mass of the spacecraft [kg].
        radius: its radius of gyration [m].
        count: number T of targets.
        seed: determines the targets.
        prior: what is known about the target.
        heaviest: make every ellipsoid as heavy as possible, larger than the mean, and hold it as
            far from its centre of mass as possible.

    Raises:
        InputError: the prior has only combinations of parameters; no rigid body is near its mean.

    """
    rng = np.random.default_rng(seed)
    targets = np.array([_ellipsoid(mass, radius, rng, heaviest) for _ in range(count)])
    if prior is None:
        return targets
    if prior.combinations is not None and not np.isfinite(prior.parameters).all():
        raise InputError(f"{prior.name} determines only combinations of parameters; plan without")
    entries = np.flatnonzero(np.isfinite(prior.parameters))
    if not entries.size:  # a log that determined nothing
        return targets
    mean, covariance = prior.parameters[entries], prior.covariance[np.ix_(entries, entries)]
    for k, target in enumerate(targets):
        deviation = 0.0 if k == 0 else 1.0
        for _ in range(200):
            change = rng.multivariate_normal(np.zeros(len(entries)), covariance)
            target[entries] = mean + deviation * change
            if target[0] > 0 and InertialParameters.from_vector(target).is_physically_consistent():
                break
            deviation *= 0.9
        else:
            raise InputError(f"{prior.name}: no rigid body has these values")
    return targets


def prior_information(prior: TargetPrior | None) -> Array:
    """Return the information (10, 10) of a prior about π; zero for what it does not identify."""
    information = np.zeros((10, 10))
    if prior is not None:
        entries = np.flatnonzero(np.isfinite(prior.parameters))
        places = np.ix_(entries, entries)
        information[places] = np.linalg.inv(prior.covariance[places])
    return information


def _ellipsoid(mass: float, radius: float, rng: np.random.Generator, heaviest: bool) -> Array:
    """Return π (10,) of a random solid ellipsoid near C's origin."""
    low, high = np.log(np.array(MASSES) * mass)
    m = float(np.exp(high if heaviest else rng.uniform(low, high)))
    least = np.mean(LENGTHS) if heaviest else LENGTHS[0]
    squares = (radius * rng.uniform(least, LENGTHS[1], 3)) ** 2
    Q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    inertia = m / 5 * (Q * (squares.sum() - squares)) @ Q.T
    direction = rng.normal(size=3)
    com = (
        np.sqrt(squares.mean())
        * (FARTHEST_CENTRE if heaviest else rng.uniform(0, FARTHEST_CENTRE))
        * direction
        / np.linalg.norm(direction)
    )
    return InertialParameters(m, com, (inertia + inertia.T) / 2).to_vector()
