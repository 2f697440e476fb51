"""From momentum rows to the target's parameters: one result type, offline and online."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydrake.multibody.tree import SpatialInertia

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.momentum import momentum_samples
from cpid_drake.dynamics.parameterizations import Parameterization
from cpid_drake.dynamics.rows import ROW_FAMILIES, RowFamily
from cpid_drake.dynamics.telemetry import Telemetry
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.errors import InputError
from cpid_drake.estimation.least_squares import DEFAULT_RANK_TOLERANCE, LeastSquaresSolution
from cpid_drake.estimation.observability import describe_unobservable
from cpid_drake.estimation.square_root import empty_root, solve_root, update_root
from cpid_drake.spacecraft.spacecraft import Spacecraft

_AT_ONCE = 2048
"""Samples that are made rows of at once: their arrays fit into a processor's cache."""


@dataclass(frozen=True)
class Identification:
    """What some samples say about the target.

    All rows weigh the same, as in Ning et al. 2016. Rows of Eq. 18 are in m/s and N·m·s, so that
    their covariance is rough (σ of the mass up to 25 times too large); standard rows do better.

    Attributes:
        parameterization: what the rows are linear in.
        solution: their least-squares solution for these unknowns.
        sample_count: number of samples used.

    """

    parameterization: Parameterization
    solution: LeastSquaresSolution
    sample_count: int

    @property
    def is_observable(self) -> bool:
        """Whether the samples determine all ten parameters."""
        return self.solution.is_observable

    @property
    def parameters(self) -> NDArray[np.float64]:
        """(10,) m, c, Ixx, Iyy, Izz, Ixy, Ixz, Iyz as estimated; NaN where not observable."""
        return self.parameterization.to_parameters(self.solution.estimate)

    @property
    def covariance(self) -> NDArray[np.float64]:
        """(10, 10) covariance of `parameters`, to first order; NaN where not observable."""
        # A parameter that is known depends on known unknowns only.
        known = np.isfinite(self.solution.estimate)
        jacobian = self.parameterization.jacobian(self.solution.estimate)[:, known]
        is_open = ~np.isfinite(self.parameters)
        jacobian[is_open] = 0.0
        covariance = jacobian @ self.solution.covariance[np.ix_(known, known)] @ jacobian.T
        covariance[is_open, :] = covariance[:, is_open] = np.nan
        return covariance

    def raw(self) -> InertialParameters:
        """Return the estimate as it is: no rigid body may have it.

        Raises:
            InputError: the samples do not determine all ten parameters.

        """
        if not self.is_observable:
            raise InputError(self.explain())
        return InertialParameters.from_vector(self.parameters)

    def feasible(self) -> InertialParameters:
        """Return the physically possible parameters nearest to the estimate, in its own metric.

        Raises:
            InputError: the samples do not determine all ten parameters.

        """
        raw = self.raw()
        inverse = np.linalg.inv(self.parameterization.jacobian(self.solution.estimate))
        return raw.nearest_feasible(inverse.T @ self.solution.information @ inverse)

    def spatial_inertia(self) -> SpatialInertia:
        """Return the feasible estimate about C's origin, in C; all NaN until observable."""
        if not self.is_observable:
            return SpatialInertia.NaN()
        return self.feasible().to_spatial_inertia()

    def explain(self) -> str:
        """Say in words what the samples determine."""
        known = f"{self.sample_count} samples determine {self.solution.rank} of 10"
        if self.is_observable:
            return f"{known} parameters (condition {self.solution.condition_number:.3g})"
        gap = describe_unobservable(self.solution.unobservable, self.parameterization.entries)
        advice = "turn the target about further axes, or wait for more samples"
        return f"{known}: {gap or 'no motion seen'}; {advice}"


def row_family(name: str, unknown_momentum: bool = False) -> RowFamily:
    """Return the row family of this name.

    Raises:
        InputError: there is none, or it is not linear in an unknown momentum that is asked for.

    """
    if name not in ROW_FAMILIES:
        raise InputError(f"no row family '{name}'; choose from {', '.join(ROW_FAMILIES)}")
    family = ROW_FAMILIES[name]
    if unknown_momentum and family.momentum_columns is None:
        others = ", ".join(n for n, other in ROW_FAMILIES.items() if other.momentum_columns)
        raise InputError(f"rows '{name}' need zero momentum; with an unknown one use {others}")
    return family


def identify(
    spacecraft: Spacecraft,
    telemetry: Telemetry,
    *,
    rows: str = "eq18",
    unknown_momentum: bool = False,
    rank_tolerance: float = DEFAULT_RANK_TOLERANCE,
) -> Identification:
    """Identify the target held by a spacecraft from telemetry, by batch least squares.

    Args:
        spacecraft: the known spacecraft.
        telemetry: N samples of its motion.
        rows: "eq18" (Ning et al. 2016, Eq. 18), "standard", or "relative" (attitude and joints
            only: base position and velocity are not used).
        unknown_momentum: whether the total momentum is constant and unknown, as after the capture
            of a tumbling target, instead of zero; not with "eq18".
        rank_tolerance: see `estimators.least_squares.DEFAULT_RANK_TOLERANCE`.

    Raises:
        InputError: no such rows, rows that cannot have an unknown momentum, or telemetry of other
            joints.

    """
    family = row_family(rows, unknown_momentum)
    if telemetry.joint_names != spacecraft.joint_names:
        raise InputError(
            f"telemetry of joints {', '.join(telemetry.joint_names)} is not of this spacecraft, "
            f"whose joints are {', '.join(spacecraft.joint_names)}"
        )
    root, row_count = accumulate_rows(spacecraft.tree, telemetry, family, unknown_momentum)
    solution = solve_root(
        root,
        row_count,
        eliminated=family.momentum_size if unknown_momentum else 0,
        rank_tolerance=rank_tolerance,
    )
    return Identification(family.parameterization(spacecraft.mass), solution, len(telemetry))


def accumulate_rows(
    tree: KinematicTree, telemetry: Telemetry, family: RowFamily, unknown_momentum: bool
) -> tuple[NDArray[np.float64], int]:
    """Return the square root (n + 1, n + 1) of the rows [N | A | b], and their number.

    Some thousand samples at a time, so that memory does not grow with their number. Rows that are
    zero throughout (a sample at rest) say nothing and are not counted.
    """
    nuisance = family.momentum_size if unknown_momentum else 0
    root, count = empty_root(nuisance + 10), 0
    for start in range(0, len(telemetry), _AT_ONCE):
        samples = momentum_samples(tree, telemetry.select(slice(start, start + _AT_ONCE)))
        rows = family.full_rows(samples, unknown_momentum)
        root = update_root(root, rows)
        count += int(rows[:, nuisance:].any(axis=1).sum())
    return root, count
