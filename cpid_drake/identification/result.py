"""The result of an identification: one type for every estimator, offline and online."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.parameterizations import Parameterization
from cpid_drake.errors import InputError
from cpid_drake.estimation.intervals import quantile_95
from cpid_drake.estimation.least_squares import LeastSquaresSolution
from cpid_drake.estimation.observability import describe_unobservable
from cpid_drake.estimation.whiteness import Whiteness
from cpid_drake.sensing.suite import SensorSuite

if TYPE_CHECKING:  # Drake takes half a second to import
    from pydrake.multibody.tree import SpatialInertia

ADVICE = (
    "turn the target about three axes (joints with different axes moving at different "
    "times), with larger angles and rates, or log longer"
)
"""The advice if the motion does not determine all parameters."""


@dataclass(frozen=True, eq=False)
class ResidualSeries:
    """Residuals of one sensor or of one kind of rows.

    Attributes:
        time: (N,) [s].
        value: (N, channels) measured minus predicted.
        unit: unit of `value`; "σ" where residuals are divided by the sensor's noise.

    """

    time: NDArray[np.float64]
    value: NDArray[np.float64]
    unit: str

    def __len__(self) -> int:
        return self.time.size


@dataclass(frozen=True)
class MomentumChanges:
    """Number of changes of momentum that an online estimator detected, and time of the last [s]."""

    count: int
    last_time: float


@dataclass(frozen=True, eq=False)
class Identification:
    """The estimate of a target, and its quality.

    Attributes:
        parameterization: the estimator's ten unknowns.
        solution: estimate of the unknowns, with covariance and rank.
        sample_count: number of samples used.
        estimator: name of the estimator in `estimators.ESTIMATORS`.
        rows: name of the row family; None for estimators without rows.
        sensors: the sensors that were assumed; None if all samples had the same weight.
        converged: whether an iterative estimator reached its solution.
        whiteness: whiteness of the residuals, of the least white sensor if there are several; None
            if there are no residuals.
        residuals: residuals by sensor, or by "linear" and "angular" for rows.
        rejected: number of samples that could not be used, by sensor; sensors without such samples
            are omitted.
        momentum_changes: changes of momentum that an online estimator detected; None for estimators
            that detect none.
        warnings: sentences for the reader.

    """

    parameterization: Parameterization
    solution: LeastSquaresSolution
    sample_count: int
    estimator: str
    rows: str | None = None
    sensors: SensorSuite | None = None
    converged: bool = True
    whiteness: Whiteness | None = None
    residuals: Mapping[str, ResidualSeries] = field(default_factory=dict)
    rejected: Mapping[str, int] = field(default_factory=dict)
    momentum_changes: MomentumChanges | None = None
    warnings: tuple[str, ...] = ()

    @property
    def is_observable(self) -> bool:
        """Whether the samples determine all ten parameters."""
        return self.solution.is_observable

    @property
    def parameters(self) -> NDArray[np.float64]:
        """(10,) m [kg], c [m], Ixx, Iyy, Izz, Ixy, Ixz, Iyz [kg·m²]; NaN where not observable."""
        return self.parameterization.to_parameters(self.solution.estimate)

    @property
    def covariance(self) -> NDArray[np.float64]:
        """(10, 10) covariance of `parameters`, to first order; NaN where not observable.

        With unweighted rows of Eq. 18, which are in m/s and N·m·s, the covariance is rough: the
        standard deviation of the mass can be 25 times too large. With standard rows it is accurate
        to a factor of 1.5.
        """
        # A known parameter depends only on unknowns that are determined.
        known = np.isfinite(self.solution.estimate)
        jacobian = self.parameterization.jacobian(self.solution.estimate)[:, known]
        is_open = ~np.isfinite(self.parameters)
        jacobian[is_open] = 0.0
        covariance = jacobian @ self.solution.covariance[np.ix_(known, known)] @ jacobian.T
        covariance[is_open, :] = covariance[:, is_open] = np.nan
        return covariance

    @property
    def intervals(self) -> NDArray[np.float64]:
        """(10, 2) two-sided 95 % intervals of `parameters`; NaN where not observable.

        The intervals use Student's t distribution if the noise is estimated from the residuals,
        else the normal distribution.
        """
        freedom = self.solution.row_count - self.solution.rank if self.sensors is None else None
        half = quantile_95(freedom) * np.sqrt(np.diag(self.covariance))
        return self.parameters[:, None] + half[:, None] * np.array([-1.0, 1.0])

    def raw(self) -> InertialParameters:
        """Return the estimate, which may be physically inconsistent.

        Raises:
            InputError: the samples do not determine all ten parameters.

        """
        if not self.is_observable:
            raise InputError(self.explain())
        return InertialParameters.from_vector(self.parameters)

    def feasible(self) -> InertialParameters:
        """Return the consistent parameters nearest to the estimate, in its information metric.

        Raises:
            InputError: the samples do not determine all ten parameters.

        """
        raw = self.raw()
        inverse = np.linalg.inv(self.parameterization.jacobian(self.solution.estimate))
        return raw.nearest_feasible(inverse.T @ self.solution.information @ inverse)

    def spatial_inertia(self) -> "SpatialInertia":
        """Return the feasible estimate about C's origin, in C; all NaN until observable."""
        from pydrake.multibody.tree import SpatialInertia

        if not self.is_observable:
            return SpatialInertia.NaN()
        return self.feasible().to_spatial_inertia()

    def explain(self) -> str:
        """Return a sentence on what the samples determine."""
        known = f"{self.sample_count} samples determine {self.solution.rank} of 10"
        if self.is_observable:
            return f"{known} parameters (condition {self.solution.condition_number:.3g})"
        gap = self.describe_gap()
        return f"{known}: {gap}; turn the target about further axes, or wait for more samples"

    def describe_gap(self) -> str:
        """Return a sentence on what the samples do not determine; empty if they determine all."""
        if self.is_observable:
            return ""
        entries = self.parameterization.entries
        return describe_unobservable(self.solution.unobservable, entries) or "no motion was seen"
