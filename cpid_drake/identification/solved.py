"""An identification with the solution from which it follows, and with its residuals."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.parameterizations import Parameterization
from cpid_drake.errors import InputError
from cpid_drake.estimation.least_squares import (
    LeastSquaresSolution,
    describe_unobservable,
    quantile_95,
)
from cpid_drake.estimation.whiteness import Whiteness
from cpid_drake.identification.result import Array, Identification
from cpid_drake.sensors.suite import SensorSuite

if TYPE_CHECKING:  # Drake takes half a second to import
    from pydrake.multibody.tree import SpatialInertia


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


@dataclass(frozen=True, eq=False)
class SolvedIdentification(Identification):
    """An identification with what is needed to compute it, but not to read it.

    Its parameters, their uncertainty and rank follow from the solution.

    Attributes:
        parameterization: the estimator's ten unknowns.
        solution: estimate of the unknowns, with covariance and rank.
        sensors: the sensors that were assumed; None if all samples had the same weight.
        residuals: residuals by sensor, or by "linear" and "angular" for rows.
        tests: whiteness of the residuals of each sensor.
        converged: whether an iterative estimator reached its solution.
        misfit: size of the residuals of rows relative to the errors of the samples, or 1.
        noise: factors by which the noise of sensors is larger than given; for several logs by
            "sensor of log".
        unexplained: share of the log whose samples were not used because nothing explains them.

    """

    parameterization: Parameterization
    solution: LeastSquaresSolution
    sensors: SensorSuite | None = field(default=None, kw_only=True)
    residuals: Mapping[str, ResidualSeries] = field(default_factory=dict, kw_only=True)
    tests: Mapping[str, Whiteness] = field(default_factory=dict, kw_only=True)
    converged: bool = field(default=True, kw_only=True)
    misfit: float = field(default=1.0, kw_only=True)
    noise: Mapping[str, float] = field(default_factory=dict, kw_only=True)
    unexplained: float = field(default=0.0, kw_only=True)
    parameters: Array = field(init=False)
    covariance: Array = field(init=False)
    intervals: Array = field(init=False)
    rank: int = field(init=False)
    singular_values: Array = field(init=False)
    condition: float | None = field(init=False)
    not_observable: str = field(init=False)

    def __post_init__(self) -> None:
        solution, form = self.solution, self.parameterization
        parameters = form.to_parameters(solution.estimate)
        # A known parameter depends only on unknowns that are determined.
        known = np.isfinite(solution.estimate)
        jacobian = form.jacobian(solution.estimate)[:, known]
        is_open = ~np.isfinite(parameters)
        jacobian[is_open] = 0.0
        covariance = jacobian @ solution.covariance[np.ix_(known, known)] @ jacobian.T
        covariance[is_open, :] = covariance[:, is_open] = np.nan
        freedom = solution.row_count - solution.rank if self.sensors is None else None
        with np.errstate(invalid="ignore"):  # rounding
            half = quantile_95(freedom) * np.sqrt(np.diag(covariance))
        condition = float(solution.condition_number)
        values = {
            "parameters": parameters,
            "covariance": covariance,
            "intervals": parameters[:, None] + half[:, None] * np.array([-1.0, 1.0]),
            "rank": solution.rank,
            "singular_values": solution.singular_values,
            "condition": condition if np.isfinite(condition) else None,
        }
        for name, value in values.items():
            object.__setattr__(self, name, value)
        object.__setattr__(self, "not_observable", self._gap())

    def _gap(self) -> str:
        """Return what the samples do not determine, in words."""
        if self.is_observable:
            return ""
        if self.table is not None and self.is_complete:
            return "what has no effect on a motion in the plane of the table"
        entries = self.parameterization.entries
        return describe_unobservable(self.solution.unobservable, entries) or "no motion was seen"

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
        if self.nearest is not None:
            return super().consistent
        try:
            return self.feasible()
        except InputError:
            return None

    def spatial_inertia(self) -> "SpatialInertia":
        """Return the consistent estimate about C's origin, in C; all NaN if there is none."""
        from pydrake.multibody.tree import SpatialInertia

        target = self.consistent
        return SpatialInertia.NaN() if target is None else target.to_spatial_inertia()
