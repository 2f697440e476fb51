"""The result of an identification: one type for every estimator, offline and online."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
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
from cpid_drake.identification.consistency import Consistency
from cpid_drake.identification.effects import EffectEstimate, UndeclaredErrors
from cpid_drake.identification.table_setting import TableSetting
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
        every: of a long log, `time` and `value` are an even selection: every k-th residual.
        beginning: (M, channels) the first residuals without selection, for tests that need
            neighbours; None if `value` contains all residuals.

    """

    time: NDArray[np.float64]
    value: NDArray[np.float64]
    unit: str
    every: int = 1
    beginning: NDArray[np.float64] | None = None

    def __len__(self) -> int:
        return self.time.size

    @property
    def neighbours(self) -> NDArray[np.float64]:
        """(M, channels) residuals of successive samples: all, or the first ones of a long log."""
        return self.value if self.beginning is None else self.beginning


@dataclass(frozen=True)
class MomentumChanges:
    """Number of changes of momentum that the samples show, and time of the last [s]."""

    count: int
    last_time: float


@dataclass(frozen=True, eq=False)
class MomentumEstimate:
    """The estimate of a constant momentum.

    Attributes:
        value: (k,) the angular momentum, and further entries if the estimator has them.
        covariance: (k, k).

    """

    value: NDArray[np.float64]
    covariance: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SeparateEstimate:
    """The estimate from one log or from the prior alone, beside a joint estimate.

    Attributes:
        name: the log or the prior.
        parameters: (10,) π; NaN where not determined.
        intervals: (10, 2) their 95 % intervals; NaN where not determined.
        rank: number of determined combinations of the ten unknowns.
        sample_count: number of samples used; 0 for a prior.
        probability: of so large a difference from all others if all have the same target.
        doubts: reasons not to trust this estimate.

    """

    name: str
    parameters: NDArray[np.float64]
    intervals: NDArray[np.float64]
    rank: int
    sample_count: int
    probability: float
    doubts: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class JointEstimate:
    """The logs and the prior of a joint estimate, and whether they agree.

    Attributes:
        logs: the estimates from each log alone.
        prior: the prior alone; None without one.
        chi_squared, freedom: of the test whether the logs agree.
        probability: of so large a χ² if all logs have the same target; 1 for one log.
        dominated: names of the parameters that the prior determines more than the logs do.

    """

    logs: tuple[SeparateEstimate, ...]
    prior: SeparateEstimate | None = None
    chi_squared: float = 0.0
    freedom: int = 0
    probability: float = 1.0
    dominated: tuple[str, ...] = ()


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
        tests: whiteness of the residuals of each sensor.
        residuals: residuals by sensor, or by "linear" and "angular" for rows.
        rejected: number of samples that could not be used, by sensor; sensors without such samples
            are omitted.
        momentum_changes: changes of momentum that the samples show; None for estimators that look
            for none.
        warnings: sentences for the reader.
        doubts: reasons not to trust the estimate; see `cpid_drake.identification.checks`.
        momentum: the total momentum that was assumed: "zero", "unknown" or "known".
        misfit: size of the residuals relative to the assumed noise, or 1 if the noise explains it.
        noise: factors by which the noise of sensors is larger than given; for several logs by
            "sensor of log".
        unexplained: share of the log whose samples were not used because nothing explains them.
        momentum_estimate: the estimate of an unknown momentum; None without one.
        joint: the separate estimates, if several logs or a prior were used; else None.
        effects: estimates of the constant errors that the sensors declare.
        consistency: what rigid bodies can have of the estimate; None if it was not computed.
        undeclared: errors beyond these that the samples show; None if they were not looked for.
        table: what a table that carries the spacecraft leaves to be known; None without a table.

    """

    parameterization: Parameterization
    solution: LeastSquaresSolution
    sample_count: int
    estimator: str
    rows: str | None = None
    sensors: SensorSuite | None = None
    converged: bool = True
    whiteness: Whiteness | None = None
    tests: Mapping[str, Whiteness] = field(default_factory=dict)
    residuals: Mapping[str, ResidualSeries] = field(default_factory=dict)
    rejected: Mapping[str, int] = field(default_factory=dict)
    momentum_changes: MomentumChanges | None = None
    warnings: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()
    momentum: str = "zero"
    misfit: float = 1.0
    noise: Mapping[str, float] = field(default_factory=dict)
    unexplained: float = 0.0
    momentum_estimate: MomentumEstimate | None = None
    table: TableSetting | None = None
    consistency: Consistency | None = None
    joint: JointEstimate | None = None
    effects: tuple[EffectEstimate, ...] = ()
    undeclared: UndeclaredErrors | None = None

    @property
    def is_trustworthy(self) -> bool:
        """Whether nothing contradicts the assumptions behind the estimate and its intervals."""
        return not self.doubts

    @property
    def is_complete(self) -> bool:
        """Whether everything is known that can act on the motion: ten numbers, on a table four."""
        return self.is_observable or (
            self.table is not None and self.solution.rank >= self.table.size
        )

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
            InputError: the samples do not determine all ten parameters, or no rigid body is near
                the estimate.

        """
        raw = self.raw()
        try:
            inverse = np.linalg.inv(self.parameterization.jacobian(self.solution.estimate))
            return raw.nearest_feasible(inverse.T @ self.solution.information @ inverse)
        except (InputError, RuntimeError, np.linalg.LinAlgError) as error:
            raise InputError(f"no rigid body was found near the estimate: {error}") from error

    @cached_property
    def consistent(self) -> InertialParameters | None:
        """The result of `feasible`, or None where it raises an error."""
        try:
            return self.feasible()
        except InputError:
            return None

    def spatial_inertia(self) -> "SpatialInertia":
        """Return the consistent estimate about C's origin, in C; all NaN if there is none."""
        from pydrake.multibody.tree import SpatialInertia

        target = self.consistent
        return SpatialInertia.NaN() if target is None else target.to_spatial_inertia()

    def explain(self) -> str:
        """Return a sentence on what the samples determine."""
        known = f"{self.sample_count} samples determine {self.solution.rank} of 10"
        if self.is_observable:
            return f"{known} parameters (condition {self.solution.condition_number:.3g})"
        if self.table is not None:
            return f"{known}; {' '.join(self.table.sentences())}"
        gap = self.describe_gap()
        if self.doubts:  # another motion would not help
            return f"{known}: {gap}"
        return f"{known}: {gap}; turn the target about further axes, or wait for more samples"

    def describe_gap(self) -> str:
        """Return a sentence on what the samples do not determine; empty if they determine all."""
        if self.is_observable:
            return ""
        if self.table is not None and self.is_complete:
            return "what has no effect on a motion in the plane of the table"
        entries = self.parameterization.entries
        return describe_unobservable(self.solution.unobservable, entries) or "no motion was seen"
