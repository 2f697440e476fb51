"""The result of an identification: one tree, which is the JSON file and what the page reads."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from cpid_drake.array import Array
from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.parameterizations import (
    PARAMETER_NAMES,
    PARAMETER_UNITS,
    Parameterization,
)
from cpid_drake.estimation.gaussian import LeastSquaresSolution
from cpid_drake.estimation.least_squares import describe_unidentifiable, quantile_95
from cpid_drake.estimation.parameters import determined_parameters
from cpid_drake.files.constraints import InMemory, Limits, Numbers
from cpid_drake.files.errors import InputError, choose_from
from cpid_drake.identification.budget import BudgetRow
from cpid_drake.identification.checks import CONVERGENCE, NEAREST, Check
from cpid_drake.identification.description import describe, gap, html, summary
from cpid_drake.identification.effect_estimates import EffectEstimate
from cpid_drake.identification.parameter import ParameterEstimate
from cpid_drake.identification.request import Source
from cpid_drake.logs.log import Samples
from cpid_drake.sensors.suite import SensorSuite
from cpid_drake.spacecraft.reference import SpacecraftReference

if TYPE_CHECKING:  # Drake and Plotly take half a second to import
    from plotly.graph_objects import Figure
    from pydrake.multibody.tree import SpatialInertia

SPACECRAFT = "spacecraft model"
"""What is given of an estimate that includes no error of the spacecraft's bodies."""

FORMAT = 8
"""Version of the keys of a result file."""

TURNS = 4
"""So many times, the direction in which a parameter becomes extreme is improved."""

NO_MASS = "c and I, because the interval of m contains zero"
"""Why they are not identifiable although the samples determine all unknowns."""

Count = Annotated[int, Limits(ge=0, le=2**53)]
Ten = Annotated[Array, Numbers(10, unknown=True)]
Intervals = Annotated[Array, Numbers(10, 2, unknown=True)]
Rank = Annotated[int, Limits(ge=0, le=10)]


@dataclass(frozen=True, eq=False)
class Combinations:
    """An estimate of ten unknowns, of all or of some combinations, in which its errors are normal.

    Those of π are not: a mass that is weakly known bends what is known of all ten together. What is
    to be combined with other estimates is combined in these unknowns.

    Attributes:
        unknowns: name of the parameterization of the unknowns.
        values: (10,) unknowns; those of undetermined combinations are arbitrary.
        information: (10, 10) inverse covariance, zero for undetermined combinations.
        known_mass: mass of the spacecraft without the target [kg], on which relative unknowns
            depend.

    """

    unknowns: str
    values: Annotated[Array, Numbers(10)]
    information: Annotated[Array, Numbers(10, 10)]
    known_mass: Annotated[float, Limits(gt=0)]


@dataclass(frozen=True, eq=False, kw_only=True)
class Identification:
    """The estimate of a target, and its quality. NaN in arrays is null in files.

    `print(result)` shows warnings, failed checks and the table that `cpid identify` prints;
    `result["m"]` is one parameter with its σ and its interval.

    The last five attributes are what the estimate was computed with. They are not in files.

    Attributes:
        format: see `FORMAT`.
        names, units: names and units of the ten parameters.
        parameters: (10,) m [kg], c [m], Ixx, Iyy, Izz, Ixy, Ixz, Iyz [kg·m²]; NaN where not
            identifiable.
        covariance: (10, 10) of `parameters`, to second order; NaN where not identifiable. With
            unweighted rows of Eq. 18, which are in m/s and N·m·s, it is rough: the σ of the mass
            can be 25 times too large. With standard rows it is accurate to a factor of 1.5.
        intervals: (10, 2) two-sided 95 % intervals of `parameters`, of Student's t distribution if
            the noise is estimated from the residuals, else of the normal distribution.
        consistent_intervals: (10, 2) the part of each interval that a rigid body can have; for
            parameters that are not determined, the bounds of a target that is as heavy and as large
            as the spacecraft (1 σ). NaN without a bound, and if no rigid body agrees; None if not
            computed.
        nearest: (10,) the rigid body that is nearest to an estimate of all ten; None if it was not
            computed or there is none.
        rank: number of parameters, or of combinations of them, that the samples determine.
        singular_values: (10,) singular values of the scaled problem, descending.
        condition: ratio of the largest to the smallest; None below a rank of ten.
        not_identifiable: what the samples do not determine, in words; empty if they determine all.
        combinations: what the result determines, in its own unknowns; None without a covariance.
        is_planar: whether a table carries the spacecraft.
        normal_C: (3,) the table's normal in C; None if the joints rotate C out of the plane, so
            that all ten parameters act on the motion.
        sample_count: number of samples used.
        rejected: number of samples that could not be used, by sensor.
        estimator: name of the estimator in `estimators.ESTIMATORS`.
        rows: name of the row family; None for estimators without rows.
        momentum: the total momentum that was assumed: "zero", "unknown" or "known".
        momentum_estimate: (k,) estimate of an unknown momentum: the angular one, and further
            entries if the estimator has them; None without one.
        momentum_covariance: (k, k) of `momentum_estimate`.
        momentum_changes: times of changes of the momentum that the samples show [s]; None for
            estimators that look for none.
        noise: factors by which the noise of sensors is larger than given; for several logs by
            "sensor of log".
        effects: estimates of the constant errors of sensors, forces and grasp.
        given: what is taken to be exact although nothing is: "spacecraft model", or nothing.
        budget: what the variance comes from, largest first; see `budget`.
        logs: the estimates from each log alone and, last, from the prior alone, by their names; if
            several logs or a prior were used.
        checks: see `cpid_drake.identification.checks`; those that failed come first.
        warnings: sentences for the reader.
        sources: the logs and their requests; empty if they were no files.
        form: the parameterization of the estimator's ten unknowns.
        solution: the estimate of the unknowns.
        sensors: the sensors that were assumed; None if all samples had the same weight.
        residuals: measured minus predicted, in σ by sensor, or by "linear" and "angular" for rows,
            in `RowFamily.linear_unit` and N·m·s; of a long log, those of rows are parts of it. Of
            the fit online, those of the last blocks.
        history: returns times [s] and the estimates from the samples up to them; None if only
            another identification is needed.

    """

    format: int = FORMAT
    names: tuple[str, ...] = PARAMETER_NAMES
    units: tuple[str, ...] = PARAMETER_UNITS
    parameters: Ten
    covariance: Annotated[Array, Numbers(10, 10, unknown=True)]
    intervals: Intervals
    consistent_intervals: Intervals | None = None
    nearest: Annotated[Array, Numbers(10)] | None = None
    rank: Rank
    singular_values: Ten
    condition: float | None = None
    not_identifiable: str = ""
    combinations: Combinations | None = None
    is_planar: bool = False
    normal_C: Annotated[Array, Numbers(3)] | None = None
    sample_count: Count
    rejected: Mapping[str, Count] = field(default_factory=dict)
    estimator: str
    rows: str | None = None
    momentum: str = "zero"
    momentum_estimate: Annotated[Array, Numbers(unknown=True)] | None = None
    momentum_covariance: Annotated[Array, Numbers(unknown=True)] | None = None
    momentum_changes: tuple[float, ...] | None = None
    noise: Mapping[str, float] = field(default_factory=dict)
    effects: tuple[EffectEstimate, ...] = ()
    given: tuple[str, ...] = ()
    budget: tuple[BudgetRow, ...] = ()
    logs: Mapping[str, "Identification"] = field(default_factory=dict)
    checks: tuple[Check, ...] = ()
    warnings: tuple[str, ...] = ()
    sources: tuple[Source, ...] = ()
    form: Annotated[Parameterization | None, InMemory()] = None
    solution: Annotated[LeastSquaresSolution | None, InMemory()] = None
    sensors: Annotated[SensorSuite | None, InMemory()] = None
    residuals: Annotated[Mapping[str, Samples], InMemory()] = field(default_factory=dict)
    history: Annotated[Callable[[], "History"] | None, InMemory()] = None

    @classmethod
    def of_solution(
        cls,
        form: Parameterization,
        solution: LeastSquaresSolution,
        *,
        sensors: SensorSuite | None = None,
        **others: Any,
    ) -> "Identification":
        """Return the identification that follows from a solution.

        Args:
            form: the parameterization of the ten unknowns.
            solution: their estimate, with covariance and rank.
            sensors: the sensors that were assumed; None if the noise is that of the residuals.
            others: all other attributes.

        """
        freedom = solution.row_count - solution.rank if sensors is None else None
        quantile = quantile_95(freedom)
        parameters, covariance, mass = determined_parameters(form, solution, quantile)
        is_known = ~solution.is_open
        own = np.where(np.outer(is_known, is_known), solution.covariance, 0.0)
        intervals = extremes(form, solution.estimate, own, quantile)
        intervals[0] = mass
        words = describe_unidentifiable(solution.unidentifiable, form.entries)
        if mass[0] <= 0 <= mass[1] and not solution.is_open[1:].all():
            words = "; ".join(each for each in (words, NO_MASS) if each)
        intervals[np.isnan(parameters)] = np.nan
        return cls(
            parameters=parameters,
            covariance=covariance,
            intervals=intervals,
            rank=solution.rank,
            singular_values=solution.singular_values,
            condition=float(solution.condition_number) if solution.is_identifiable else None,
            not_identifiable=words,
            form=form,
            solution=solution,
            sensors=sensors,
            **others,
        )

    @property
    def spacecraft(self) -> SpacecraftReference | None:
        """The model that was used; None if it was no file."""
        return self.sources[0].request.spacecraft if self.sources else None

    @property
    def command(self) -> str:
        """The command line that repeats the identification; empty without files."""
        requests = [source.request for source in self.sources]
        return requests[0].command(requests[1:]) if requests else ""

    @property
    def failures(self) -> tuple[str, ...]:
        """The sentences of the failed checks."""
        return tuple(check.sentence for check in self.checks if not check.passed)

    def check(self, name: str) -> Check | None:
        """Return the check of a name; None if it was not made."""
        return next((check for check in self.checks if check.name == name), None)

    @property
    def passed(self) -> bool:
        """Whether nothing contradicts the assumptions behind the estimate and its intervals."""
        return not self.failures

    @property
    def is_consistent(self) -> bool:
        """Whether a rigid body agrees with the estimate within its uncertainty, as far as known."""
        check = self.check(NEAREST)
        return check is None or check.passed

    @property
    def converged(self) -> bool:
        """Whether an iterative estimator reached its solution."""
        check = self.check(CONVERGENCE)
        return check is None or check.passed

    @property
    def is_identifiable(self) -> bool:
        """Whether the samples determine all ten parameters."""
        return self.rank == 10 and bool(np.isfinite(self.parameters).all())

    @property
    def most(self) -> int:
        """Number of combinations of the parameters that can act on the motion: 4 on a table."""
        return 10 if self.normal_C is None else 4

    @property
    def is_complete(self) -> bool:
        """Whether everything is known that can act on the motion."""
        return self.is_identifiable or (self.most < 10 and self.rank >= self.most)

    @property
    def shown_intervals(self) -> Array:
        """(10, 2) the intervals to show: what a rigid body can have of them, where computed."""
        return self.intervals if self.consistent_intervals is None else self.consistent_intervals

    def raw(self) -> InertialParameters:
        """Return the estimate, which may be physically inconsistent.

        Raises:
            InputError: the samples do not determine all ten parameters.

        """
        if not self.is_identifiable:
            raise InputError(self.explain())
        return InertialParameters.from_vector(self.parameters)

    @property
    def inconsistencies(self) -> tuple[str, ...]:
        """Why no rigid body can have the estimate; empty if one can, or if not all is known."""
        return tuple(self.raw().inconsistencies()) if self.is_identifiable else ()

    @cached_property
    def consistent(self) -> InertialParameters | None:
        """The rigid body nearest to the estimate; see `consistency.checked`.

        None unless all ten parameters are known, and if no rigid body is near the estimate.
        """
        if self.nearest is not None:
            return InertialParameters.from_vector(self.nearest)
        if self.solution is None or not self.is_identifiable or not self.parameters[0]:
            return None
        return self.raw().nearest_consistent()

    def spatial_inertia(self) -> "SpatialInertia":
        """Return the consistent estimate about C's origin, in C; all NaN if there is none."""
        from pydrake.multibody.tree import SpatialInertia

        target = self.consistent
        return SpatialInertia.NaN() if target is None else target.to_spatial_inertia()

    def explain(self) -> str:
        """Return a sentence on what the samples determine."""
        text = f"{self.sample_count} samples determine {self.rank} of 10"
        if self.is_identifiable:
            return f"{text} parameters (condition {self.condition or np.inf:.3g})"
        return f"{text}: {' '.join(gap(self))}"

    def __getitem__(self, name: str) -> ParameterEstimate:
        """Return the estimate of a parameter.

        Raises:
            InputError: no parameter has this name.

        """
        if name not in PARAMETER_NAMES:
            raise InputError(f"no parameter '{name}'; {choose_from(name, PARAMETER_NAMES)}")
        k = PARAMETER_NAMES.index(name)
        value, sigma = float(self.parameters[k]), float(np.sqrt(self.covariance[k, k]))
        low, high = map(float, self.shown_intervals[k])
        return ParameterEstimate(name, value, sigma, (low, high), PARAMETER_UNITS[k], self.passed)

    def __str__(self) -> str:
        return "\n".join([*(f"warning: {each}" for each in self.warnings), *describe(self)])

    def __repr__(self) -> str:
        return summary(self)

    def _repr_html_(self) -> str:
        return html(self)

    def plot(self, truth: InertialParameters | None = None) -> "Figure":
        """Return a figure of Plotly: each parameter with its 95 % interval.

        Args:
            truth: the true target, if it is known.

        """
        from cpid_drake.identification.figure import estimate_figure

        return estimate_figure(self, truth)

    def files(self) -> list[Path]:
        """Return the files that the result was computed from, as far as they exist."""
        paths = (path for source in self.sources for path in source.request.existing_files())
        return list(dict.fromkeys(paths))


History = Sequence[tuple[float, Identification]]
"""Times [s], and the estimates from the samples up to them."""


def extremes(form: Parameterization, unknowns: Array, covariance: Array, quantile: float) -> Array:
    """Return the extreme values (10, 2) of π where the χ² of ten unknowns is quantile².

    A parameter is no linear function of the unknowns. A mass that passes its pole on the way to
    an extreme value has none, NaN. Those of c and I are where the mass is zero.

    Args:
        form: the parameterization of the unknowns.
        unknowns: (10,) their estimate.
        covariance: (10, 10) of the unknowns.
        quantile: number of σ.

    """
    parameters, P = form.to_parameters(unknowns), covariance
    place, side, sign = np.arange(10)[:, None], np.arange(2), np.array([-1.0, 1.0])
    x, least = np.broadcast_to(unknowns, (10, 2, 10)), np.zeros((10, 2))
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):  # at the pole
        for _ in range(TURNS):
            steps = x[..., None, :] + 1e-30j * np.eye(10)
            # ∂π/∂x by a complex step
            slope = np.nan_to_num(form.to_parameters(steps).imag[place, side, :, place] * 1e30)
            along = slope @ P
            size = np.sqrt(np.sum(along * slope, axis=-1, keepdims=True))
            # the farthest x of the ellipsoid along this slope: x̂ ± q P g / √(gᵀP g)
            x = unknowns + quantile * sign[:, None] * along / np.where(size > 0, size, 1)
            reach = sign * (form.to_parameters(x)[place, side, place] - parameters[:, None])
            reach[0, reach[0] < -0.1 * size[0, :, 0]] = np.nan
            least = np.maximum(least, reach)
    return parameters[:, None] + sign * least
