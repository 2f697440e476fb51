"""The result of an identification: one tree, which is the JSON file and what the page reads."""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Annotated

import numpy as np
from annotated_types import Ge, Le
from numpy.typing import NDArray

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.parameterizations import PARAMETER_NAMES, PARAMETER_UNITS
from cpid_drake.errors import InputError
from cpid_drake.estimation.whiteness import Whiteness
from cpid_drake.identification.effects import EffectEstimate, UndeclaredErrors
from cpid_drake.identification.table_setting import TableSetting
from cpid_drake.identification.target_prior import Combinations
from cpid_drake.input_files.validation import Numbers
from cpid_drake.resources import package_folders, resolve_model

FORMAT = 2
"""Version of the keys of a result file."""

Array = NDArray[np.float64]
Count = Annotated[int, Ge(0), Le(2**53)]
Probability = Annotated[float, Ge(0), Le(1)]
Ten = Annotated[Array, Numbers(10, unknown=True)]
Intervals = Annotated[Array, Numbers(10, 2, unknown=True)]
Rank = Annotated[int, Ge(0), Le(10)]


@dataclass(frozen=True)
class Check:
    """A consequence of the assumptions behind an estimate that was tested with the data.

    Attributes:
        name: what was checked.
        sentence: what the failure means; empty if the check passed.
        statistic: what was compared with the limit; None if it is not one finite number.
        limit: where the check begins to fail.
        passed: whether the data agree with the assumptions.

    """

    name: str
    sentence: str
    statistic: float | None = None
    limit: float | None = None
    passed: bool = False

    @classmethod
    def of(
        cls,
        name: str,
        sentence: str,
        statistic: float | None = None,
        limit: float | None = None,
        passed: bool | None = None,
    ) -> "Check":
        """Return a check; by default it passes if its statistic is at most its limit."""
        if passed is None:
            passed = statistic is not None and limit is not None and bool(statistic <= limit)
        shown = float(statistic) if statistic is not None and np.isfinite(statistic) else None
        return cls(name, "" if passed else sentence, shown, limit, passed)


@dataclass(frozen=True)
class SpacecraftReference:
    """The spacecraft of a result.

    Attributes:
        model: an absolute path or a `package://NAME/...` URI.
        base: name of its base body.
        capture_frame: name of the frame C that holds the target.
        packages: folders, by name, of packages that the model's URIs refer to.

    """

    model: str
    base: str
    capture_frame: str
    packages: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Source:
    """The data and options of a log.

    Attributes:
        telemetry: the file or the folder of a bag.
        sha256: hash of the file's content; None for a folder.
        sensors: name of a preset or a YAML file; None if nothing was known about the sensors.
        momentum: name of the total momentum, one of `MOMENTUM_NAMES`, as the caller has given it;
            None if it was to be found out.
        topics: topics of a bag, by kind.
        leave_out_bad: whether rows with a problem were left out.
        command: the command line that repeats the identification.
        start, end: first and last time that was used [s].
        cpid_drake: version of this package.
        columns: the YAML file of a map of the telemetry's columns; None for the package's own.
        columns_sha256: hash of this file.
        planar: whether a table carries the spacecraft, as the caller has said; None if not said.
        known_bodies: uncertainty of the spacecraft, as given; None for a spacecraft that is exact.
        prior: the file of a prior; None without one.
        prior_sha256: hash of this file.

    """

    telemetry: str
    sha256: str | None
    sensors: str | None
    momentum: str | None
    topics: dict[str, str]
    leave_out_bad: bool
    command: str
    start: float
    end: float
    cpid_drake: str
    columns: str | None = None
    columns_sha256: str | None = None
    planar: bool | None = None
    known_bodies: str | None = None
    prior: str | None = None
    prior_sha256: str | None = None


@dataclass(frozen=True, eq=False)
class MomentumEstimate:
    """The estimate of a constant momentum.

    Attributes:
        value: (k,) the angular momentum, and further entries if the estimator has them.
        covariance: (k, k).

    """

    value: Annotated[Array, Numbers(unknown=True)]
    covariance: Annotated[Array, Numbers(unknown=True)]


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
        doubts: failed checks of this estimate.

    """

    name: str
    parameters: Ten
    intervals: Intervals
    rank: Rank
    sample_count: Count
    probability: Probability
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
    chi_squared: Annotated[float, Ge(0)] = 0.0
    freedom: Count = 0
    probability: Probability = 1.0
    dominated: tuple[str, ...] = ()

    @property
    def parts(self) -> tuple[SeparateEstimate, ...]:
        """The separate estimates, that of the prior last."""
        return self.logs if self.prior is None else (*self.logs, self.prior)


@dataclass(frozen=True, eq=False)
class Consistency:
    """The physically consistent part of the intervals of an estimate.

    Attributes:
        intervals: (10, 2) the part of each 95 % interval that a rigid body can have; for parameters
            that are not determined, their extreme values over all rigid bodies that agree with what
            is known. NaN without a bound, and if no rigid body agrees.
        size: largest distance of a part of the target from C that the bounds assume [m].
        is_possible: whether any rigid body agrees with the estimate within its uncertainty.

    """

    intervals: Intervals
    size: float
    is_possible: bool


@dataclass(frozen=True, eq=False, kw_only=True)
class Identification:
    """The estimate of a target, and its quality. NaN in arrays is null in files.

    Attributes:
        format: see `FORMAT`.
        names, units: names and units of the ten parameters.
        parameters: (10,) m [kg], c [m], Ixx, Iyy, Izz, Ixy, Ixz, Iyz [kg·m²]; NaN where not known.
        covariance: (10, 10) of `parameters`, to first order; NaN where not known. With unweighted
            rows of Eq. 18, which are in m/s and N·m·s, it is rough: the σ of the mass can be 25
            times too large. With standard rows it is accurate to a factor of 1.5.
        intervals: (10, 2) two-sided 95 % intervals of `parameters`, of Student's t distribution if
            the noise is estimated from the residuals, else of the normal distribution.
        rank: number of parameters, or of combinations of them, that the samples determine.
        singular_values: (10,) singular values of the scaled problem, descending.
        condition: ratio of the largest to the smallest; None below a rank of ten.
        not_observable: what the samples do not determine, in words; empty if they determine all.
        nearest: (10,) the rigid body that is nearest to the estimate, NaN where not known; None if
            it was not computed or there is none.
        consistency: the physically consistent part of the intervals; None if not computed.
        combinations: what a result of a rank below ten determines; else None.
        sample_count: number of samples used.
        rejected: number of samples that could not be used, by sensor.
        estimator: name of the estimator in `estimators.ESTIMATORS`.
        rows: name of the row family; None for estimators without rows.
        momentum: the total momentum that was assumed: "zero", "unknown" or "known".
        momentum_estimate: the estimate of an unknown momentum; None without one.
        momentum_changes: times of changes of the momentum that the samples show [s]; None for
            estimators that look for none.
        whiteness: of the residuals, of the least white sensor if there are several; None if there
            are no residuals.
        effects: estimates of the constant errors that the sensors declare, and of forces.
        undeclared: errors beyond these that the samples show; None if they were not looked for.
        table: what a table that carries the spacecraft leaves to be known; None without a table.
        joint: the separate estimates, if several logs or a prior were used; else None.
        checks: see `cpid_drake.identification.checks`; those that failed come first.
        warnings: sentences for the reader.
        spacecraft: the model that was used; None if it was no file.
        sources: the data and options of every log; empty if they were no files.

    """

    format: int = FORMAT
    names: tuple[str, ...] = PARAMETER_NAMES
    units: tuple[str, ...] = PARAMETER_UNITS
    parameters: Ten
    covariance: Annotated[Array, Numbers(10, 10, unknown=True)]
    intervals: Intervals
    rank: Rank
    singular_values: Ten
    condition: float | None = None
    not_observable: str = ""
    nearest: Ten | None = None
    consistency: Consistency | None = None
    combinations: Combinations | None = None
    sample_count: Count
    rejected: Mapping[str, Count] = field(default_factory=dict)
    estimator: str
    rows: str | None = None
    momentum: str = "zero"
    momentum_estimate: MomentumEstimate | None = None
    momentum_changes: tuple[float, ...] | None = None
    whiteness: Whiteness | None = None
    effects: tuple[EffectEstimate, ...] = ()
    undeclared: UndeclaredErrors | None = None
    table: TableSetting | None = None
    joint: JointEstimate | None = None
    checks: tuple[Check, ...] = ()
    warnings: tuple[str, ...] = ()
    spacecraft: SpacecraftReference | None = None
    sources: tuple[Source, ...] = ()

    @property
    def doubts(self) -> tuple[str, ...]:
        """The sentences of the failed checks."""
        return tuple(check.sentence for check in self.checks if not check.passed)

    @property
    def is_trustworthy(self) -> bool:
        """Whether nothing contradicts the assumptions behind the estimate and its intervals."""
        return not self.doubts

    @property
    def is_observable(self) -> bool:
        """Whether the samples determine all ten parameters."""
        return self.rank == 10

    @property
    def is_complete(self) -> bool:
        """Whether everything is known that can act on the motion: ten numbers, on a table four."""
        return self.is_observable or (self.table is not None and self.rank >= self.table.size)

    @property
    def shown_intervals(self) -> Array:
        """(10, 2) the intervals to show: what a rigid body can have of them, where computed."""
        return self.intervals if self.consistency is None else self.consistency.intervals

    def raw(self) -> InertialParameters:
        """Return the estimate, which may be physically inconsistent.

        Raises:
            InputError: the samples do not determine all ten parameters.

        """
        if not self.is_observable:
            raise InputError(self.explain())
        return InertialParameters.from_vector(self.parameters)

    @property
    def infeasibilities(self) -> tuple[str, ...]:
        """Why no rigid body can have the estimate; empty if one can, or if not all is known."""
        return tuple(self.raw().infeasibilities()) if self.is_observable else ()

    @cached_property
    def consistent(self) -> InertialParameters | None:
        """The rigid body that is nearest to the estimate; None unless all ten are known."""
        if self.nearest is None or not np.isfinite(self.nearest).all():
            return None
        return InertialParameters.from_vector(self.nearest)

    def explain(self) -> str:
        """Return a sentence on what the samples determine."""
        known = f"{self.sample_count} samples determine {self.rank} of 10"
        if self.is_observable:
            return f"{known} parameters (condition {self.condition or np.inf:.3g})"
        if self.table is not None:
            return f"{known}; {' '.join(self.table.sentences())}"
        if self.doubts:  # another motion would not help
            return f"{known}: {self.not_observable}"
        return (
            f"{known}: {self.not_observable}; turn the target about further axes, or wait for more "
            "samples"
        )

    def files(self) -> list[Path]:
        """Return the files that the result was computed from, as far as they exist."""
        names = [] if self.spacecraft is None else [self.spacecraft.model]
        packages = {} if self.spacecraft is None else self.spacecraft.packages
        for source in self.sources:
            files = (source.telemetry, source.sensors, source.columns, source.prior)
            names += filter(None, files)
        found = []
        for name in names:
            with suppress(InputError):  # a preset, or a file that was moved
                found.append(resolve_model(name, package_folders(packages)))
        return found
