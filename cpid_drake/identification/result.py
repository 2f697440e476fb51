"""The result of an identification: one tree, which is the JSON file and what the page reads."""

import shlex
from collections.abc import Mapping, Sequence
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

FORMAT = 3
"""Version of the keys of a result file."""

IMPROBABLE = 1e-4
"""Probability of what the data show, if all is as assumed, below which a check fails."""

MORE_MOTION = (
    "move the joints by larger angles and at higher rates, joints with different axes at different "
    "times, or log longer"
)
"""The advice if the motion does not determine all that can act on it."""

AGREEMENT = "agreement"
"""Name of the check whether several sources have the same target."""

Array = NDArray[np.float64]
Count = Annotated[int, Ge(0), Le(2**53)]
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
class Request:
    """The request of `cpid identify`: data, spacecraft, estimator and options of one log.

    Attributes:
        telemetry: a file or a bag's folder.
        spacecraft: the known spacecraft.
        estimator, rows: see `cpid_drake.identification.identify.identify`.
        sensors: name of a preset or a YAML file; None if they are unknown.
        momentum: name of the total momentum, see `TotalMomentum.named`; None to test whether it is
            zero, and to estimate it if it is not.
        start, end: first and last time to use [s]; None for all.
        topics: topics of a bag, by kind.
        leave_out_bad: whether to leave out rows that have a problem.
        columns: the YAML file of a map of the telemetry's columns; None for the package's own.
        planar: whether a table carries the spacecraft; None to recognize logs of x, y and yaw.
        known_bodies: uncertainty of the spacecraft, see `uncertainty.read_uncertainty`; None if the
            spacecraft is known exactly.
        prior: the file of a prior of the target; None without one.

    """

    telemetry: str
    spacecraft: SpacecraftReference
    estimator: str | None = None
    rows: str | None = None
    sensors: str | None = None
    momentum: str | None = None
    start: float | None = None
    end: float | None = None
    topics: Mapping[str, str] = field(default_factory=dict)
    leave_out_bad: bool = False
    columns: str | None = None
    planar: bool | None = None
    known_bodies: str | None = None
    prior: str | None = None

    def files(self) -> dict[str, str]:
        """Return the files with hashes in results, by their fields."""
        files = {"telemetry": self.telemetry, "columns": self.columns, "prior": self.prior}
        return {option: name for option, name in files.items() if name is not None}

    def command(self, others: Sequence[str] = ()) -> str:
        """Return the command line of this request, with other logs of the same target."""
        craft = self.spacecraft
        words = ["cpid", "identify", self.telemetry, *others, "--spacecraft", craft.model]
        words += ["--base", craft.base, "--capture-frame", craft.capture_frame]
        options = {
            "--columns": self.columns,
            "--estimator": self.estimator,
            "--rows": self.rows,
            "--sensors": self.sensors,
            "--from": self.start,
            "--to": self.end,
            "--momentum": self.momentum,
            "--known-bodies": self.known_bodies,
            "--prior": self.prior,
        }
        for option, value in options.items():
            words += [] if value is None else [option, str(value)]
        for name, folder in craft.packages.items():
            words += ["--package", f"{name}={folder}"]
        for kind, name in self.topics.items():
            words += ["--topic", f"{kind}={name}"]
        words += ["--leave-out-bad"] if self.leave_out_bad else []
        words += [] if self.planar is None else ["--planar" if self.planar else "--no-planar"]
        return shlex.join(words)


@dataclass(frozen=True)
class Source:
    """A log of a result.

    Attributes:
        request: the request for this log.
        sha256: hashes of `Request.files`; None for a folder.
        start, end: first and last time that was used [s].
        cpid_drake: version of this package; empty if it was not installed.

    """

    request: Request
    sha256: dict[str, str | None]
    start: float
    end: float
    cpid_drake: str


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
class Consistency:
    """The physically consistent part of the intervals of an estimate.

    Attributes:
        intervals: (10, 2) the part of each 95 % interval that a rigid body can have; for parameters
            that are not determined, their extreme values over all rigid bodies that agree with what
            is known. NaN without a bound, and if no rigid body agrees.
        size: largest distance of a part of the target from C that the bounds assume [m].
        distance: of the nearest rigid body from the estimate, in σ.
        radius: largest distance, in σ, with which a body agrees with the estimate.

    """

    intervals: Intervals
    size: float
    distance: float
    radius: float

    @property
    def is_possible(self) -> bool:
        """Whether any rigid body agrees with the estimate within its uncertainty."""
        return self.distance <= self.radius


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
        logs: the estimates from each log alone and, last, from the prior alone, by their names; if
            several logs or a prior were used.
        dominated: names of the parameters that the prior determines more than the logs do.
        checks: see `cpid_drake.identification.checks`; those that failed come first.
        warnings: sentences for the reader.
        sources: the logs and their requests; empty if they were no files.

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
    logs: Mapping[str, "Identification"] = field(default_factory=dict)
    dominated: tuple[str, ...] = ()
    checks: tuple[Check, ...] = ()
    warnings: tuple[str, ...] = ()
    sources: tuple[Source, ...] = ()

    @property
    def spacecraft(self) -> SpacecraftReference | None:
        """The model that was used; None if it was no file."""
        return self.sources[0].request.spacecraft if self.sources else None

    @property
    def command(self) -> str:
        """The command line that repeats the identification; empty without files."""
        if not self.sources:
            return ""
        first, *others = (source.request for source in self.sources)
        return first.command([other.telemetry for other in others])

    @property
    def failures(self) -> tuple[str, ...]:
        """The sentences of the failed checks."""
        return tuple(check.sentence for check in self.checks if not check.passed)

    @property
    def agreement(self) -> Check | None:
        """The check whether all sources, or all other sources, have this target."""
        return next((check for check in self.checks if check.name == AGREEMENT), None)

    @property
    def passed(self) -> bool:
        """Whether nothing contradicts the assumptions behind the estimate and its intervals."""
        return not self.failures

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
        return f"{known}: {' '.join(self.gap())}"

    def gap(self) -> list[str]:
        """Return sentences on what is not known, why, and how to see it; empty if all is known."""
        lines = [] if self.table is None else self.table.sentences()
        if not self.is_complete:
            lines.append(f"Not known: {self.not_observable}.")
            if not self.failures:  # else another motion would not help
                lines.append(f"To see the rest, {MORE_MOTION}.")
        return lines

    def files(self) -> list[Path]:
        """Return the files that the result was computed from, as far as they exist."""
        found = []
        for request in (source.request for source in self.sources):
            names = (request.spacecraft.model, request.sensors)
            packages = package_folders(request.spacecraft.packages)
            for name in filter(None, (*names, *request.files().values())):
                with suppress(InputError):  # a preset, or a file that was moved
                    found.append(resolve_model(name, packages))
        return list(dict.fromkeys(found))
