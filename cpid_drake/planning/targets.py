"""Targets that are plausible before a motion: from a prior, or from the size of the spacecraft."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.errors import InputError
from cpid_drake.identification.prior import TargetPrior

MASSES = (0.03, 0.3)
"""Masses of targets of which nothing is known, as shares of the spacecraft's mass."""

LENGTHS = (0.2, 0.9)
"""Half axes of such targets, as shares of the spacecraft's radius of gyration."""

FARTHEST = 1.2
"""Largest distance of the centre of mass from C's origin, as a share of the mean half axis."""


@dataclass(frozen=True, eq=False)
class PlausibleTarget:
    """A target that is possible as far as the planner knows.

    Attributes:
        parameters: (10,) π.
        information: (10, 10) what is known about π before the motion; default: nothing.
        weight: of its σ beside those of other targets.

    """

    parameters: NDArray[np.float64]
    information: NDArray[np.float64] = field(default_factory=lambda: np.zeros((10, 10)))
    weight: float = 1.0


def plausible_targets(
    mass: float,
    radius: float,
    count: int,
    seed: int,
    prior: TargetPrior | None = None,
    *,
    heaviest: bool = False,
) -> tuple[PlausibleTarget, ...]:
    """Return targets that a motion is planned for.

    Without a prior they are solid ellipsoids of random mass and size, held at a point inside them
    or near their surface. With a prior the first target is its mean, the others are drawn from it,
    and all contain the prior's information; parameters that it does not give are those of an
    ellipsoid.

    Args:
        mass: mass of the spacecraft [kg].
        radius: its radius of gyration [m].
        count: number of targets.
        seed: determines the targets.
        prior: what is known about the target.
        heaviest: make every ellipsoid as heavy and as large as possible, and hold it as far from
            its centre of mass as possible.

    Raises:
        InputError: the prior knows only combinations of parameters; no rigid body is near its mean.

    """
    rng = np.random.default_rng(seed)
    ellipsoids = [_ellipsoid(mass, radius, rng, heaviest) for _ in range(count)]
    if prior is None:
        return tuple(PlausibleTarget(each) for each in ellipsoids)
    if prior.combinations is not None:
        raise InputError(f"{prior.name} determines only combinations of parameters; plan without")
    known = np.flatnonzero(np.isfinite(prior.parameters))
    if not known.size:  # a log that determined nothing
        return tuple(PlausibleTarget(each) for each in ellipsoids)
    covariance = prior.covariance[np.ix_(known, known)]
    information = np.zeros((10, 10))
    information[np.ix_(known, known)] = np.linalg.inv(covariance)
    targets = []
    for k, ellipsoid in enumerate(ellipsoids):
        deviation = 0.0 if k == 0 else 1.0
        for _ in range(200):
            parameters = ellipsoid.copy()
            change = rng.multivariate_normal(np.zeros(len(known)), covariance)
            parameters[known] = prior.parameters[known] + deviation * change
            body = InertialParameters.from_vector(parameters)
            if parameters[0] > 0 and body.is_feasible():
                targets.append(PlausibleTarget(parameters, information))
                break
            deviation *= 0.9
        else:
            raise InputError(f"{prior.name}: no rigid body has these values")
    return tuple(targets)


def _ellipsoid(
    mass: float, radius: float, rng: np.random.Generator, heaviest: bool
) -> NDArray[np.float64]:
    """Return π (10,) of a random solid ellipsoid near C's origin."""
    low, high = np.log(np.array(MASSES) * mass)
    m = float(np.exp(high if heaviest else rng.uniform(low, high)))
    least = LENGTHS[1] if heaviest else LENGTHS[0]
    squares = (radius * rng.uniform(least, LENGTHS[1], 3)) ** 2
    Q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    inertia = m / 5 * (Q * (squares.sum() - squares)) @ Q.T
    direction = rng.normal(size=3)
    com = (
        np.sqrt(squares.mean())
        * (FARTHEST if heaviest else rng.uniform(0, FARTHEST))
        * direction
        / np.linalg.norm(direction)
    )
    return InertialParameters(m, com, (inertia + inertia.T) / 2).to_vector()
