"""What a rigid body can have of an estimate: the nearest body, intervals, and bounds of the rest.

The estimate of an estimator may be impossible: a negative moment of inertia, or moments that
violate the triangle inequality. Only the part of an interval that some rigid body can have is
shown. It contains the true value as often as the whole interval, because the true value is
possible. Bounds of parameters that the samples do not determine assume a size of the target.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri, fdtri

from cpid_drake.dynamics.relative_motion import relative_dynamics
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.estimation.rigid_body_set import RigidBodySet
from cpid_drake.estimation.source_rows import SourceRows

if TYPE_CHECKING:
    from cpid_drake.identification.result import Identification

OUTSIDE = 1e-4
"""Probability that the true unknowns are outside of the confidence region."""

REACH = 3.0
"""Plausible distance of a part of the target from C, in radii of gyration of the spacecraft."""

_ROUNDING = 1e-6  # of a limit, as a share of the plausible size


@dataclass(frozen=True, eq=False)
class Consistency:
    """What rigid bodies can have of an estimate.

    Attributes:
        parameters: (10,) the nearest rigid body; NaN where the samples determine nothing.
        intervals: (10, 2) the part of each 95 % interval that a rigid body can have; for parameters
            that are not determined, their extreme values over all rigid bodies that agree with what
            is known. NaN if no rigid body agrees; infinite without a bound.
        size: largest distance of a part of the target from C that the bounds assume [m].
        is_possible: whether any rigid body agrees with the estimate within its uncertainty.

    """

    parameters: NDArray[np.float64]
    intervals: NDArray[np.float64]
    size: float
    is_possible: bool

    def assumption(self) -> str:
        """Return the assumption behind the bounds of what is not determined, in words."""
        return (
            f"bounds over all rigid bodies no part of which is farther than {self.size:.2g} m from "
            f"C ({REACH:g} times the spacecraft's radius of gyration)"
        )


def consistency_of(found: "Identification", tree: KinematicTree) -> Consistency | None:
    """Return what rigid bodies can have of an identification.

    None if nothing is known, or if the solver fails.

    Args:
        found: the identification.
        tree: the known spacecraft.

    """
    solution = found.solution
    if not solution.rank or not np.isfinite(solution.values).all():
        return None
    radius = float(chdtri(solution.rank, OUTSIDE))
    freedom = solution.row_count - solution.rank
    if found.sensors is None:
        if freedom < 1:
            return None
        radius = solution.rank * float(fdtri(solution.rank, freedom, 1 - OUTSIDE))
    rows = SourceRows.of_solution(found.solution)
    if not (np.isfinite(rows.A).all() and np.isfinite(rows.b).all()):
        return None
    mass, size = _plausible(found, tree)
    bodies = RigidBodySet(
        rows, float(np.sqrt(radius)), found.parameterization.name, tree.mass, mass, size
    )
    known = np.isfinite(found.parameters)
    distance = bodies.distance()
    if np.isnan(distance):  # the solver failed
        return None
    if distance > bodies.radius:
        nothing = np.full((10, 2), np.nan)
        return Consistency(np.full(10, np.nan), nothing, size, False)
    bounds = bodies.bounds()
    if bounds is None:
        return None
    nearest = found.parameterization.to_parameters(bodies.nearest())
    return _narrowed(found, np.where(known, nearest, np.nan), bounds, mass, size)


def _narrowed(
    found: "Identification",
    nearest: NDArray[np.float64],
    bounds: NDArray[np.float64],
    mass: float,
    size: float,
) -> Consistency:
    """Return the intersection of intervals and bounds."""
    known = np.isfinite(found.parameters)
    free = np.where(known[:, None], found.intervals, [-np.inf, np.inf])
    free = np.where(np.isnan(free), [-np.inf, np.inf], free)
    slack = _ROUNDING * np.array([mass, *3 * [size], *6 * [mass * size**2]])
    low = np.where(bounds[:, 0] > free[:, 0] + slack, bounds[:, 0], free[:, 0])
    high = np.where(bounds[:, 1] < free[:, 1] - slack, bounds[:, 1], free[:, 1])
    # No body may have a value of the interval and be in the confidence region of all unknowns.
    empty = low > high
    low, high = np.where(empty, bounds[:, 0], low), np.where(empty, bounds[:, 1], high)
    return Consistency(nearest, np.stack([low, high], axis=1), size, True)


def _plausible(found: "Identification", tree: KinematicTree) -> tuple[float, float]:
    """Return a plausible mass [kg] and size [m] of the target."""
    still = np.zeros((1, sum(body.joint >= 0 for body in tree.bodies)))
    known = relative_dynamics(tree, still, still)
    size = REACH * float(np.sqrt(np.trace(known.I_K[0]) / 2 / known.mass))
    mass = found.parameters[0]
    share = mass / tree.mass
    return (float(mass) if 1e-3 < share < 1e3 else tree.mass), size
