"""The result of an identification as a JSON file."""

import json
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated

import numpy as np
from annotated_types import Ge, Gt, Le
from numpy.typing import NDArray

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.parameterizations import PARAMETER_NAMES, PARAMETER_UNITS
from cpid_drake.dynamics.total_momentum import MOMENTUM_NAMES
from cpid_drake.errors import InputError
from cpid_drake.identification.effects import HeldOut
from cpid_drake.input_files.validation import Numbers, from_tree, load_json, nulls
from cpid_drake.output_files.drafts import write_text
from cpid_drake.resources import package_folders, resolve_model

_LARGEST_FILE = 16 * 2**20  # bytes; a result has a few thousand
_LARGEST = 1e90  # SI units; products of larger numbers overflow

Count = Annotated[int, Ge(0), Le(2**53)]
Probability = Annotated[float, Ge(0), Le(1)]
Array = NDArray[np.float64]


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
    """The data and options of a result.

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
class SeparateRecord:
    """The estimate from one log or from the prior alone; see `result.SeparateEstimate`.

    Attributes:
        name: the log or the prior.
        parameters: (10,) π; NaN where not determined.
        interval_95: (10, 2) their 95 % intervals.
        rank: number of determined combinations.
        samples_used: number of samples.
        probability: of so large a difference from all others if all have the same target.
        doubts: reasons not to trust this estimate.
        source: the data and options of a log; None for the prior.

    """

    name: str
    parameters: Annotated[Array, Numbers(10, unknown=True)]
    interval_95: Annotated[Array, Numbers(10, 2, unknown=True)]
    rank: Annotated[int, Ge(0), Le(10)]
    samples_used: Count
    probability: Probability
    doubts: list[str] = field(default_factory=list)
    source: Source | None = None


@dataclass(frozen=True, eq=False)
class JointRecord:
    """The parts of a joint estimate, and whether they agree; see `result.JointEstimate`.

    Attributes:
        logs: the separate estimates of the logs.
        prior: the prior alone; None without one.
        chi_squared, freedom, probability: of the test whether the logs agree.
        dominated: parameters that the prior determines more than the logs do.

    """

    logs: list[SeparateRecord]
    prior: SeparateRecord | None
    chi_squared: Annotated[float, Ge(0)]
    freedom: Count
    probability: Probability
    dominated: list[str]


@dataclass(frozen=True, eq=False)
class CombinationsRecord:
    """The combinations that a result of a rank below ten determines.

    Attributes:
        unknowns: name of the parameterization of the ten unknowns.
        known_mass: mass of the spacecraft without the target [kg], on which relative unknowns
            depend.
        values: (10,) unknowns; those of undetermined combinations are arbitrary.
        information: (10, 10) inverse covariance, zero for undetermined combinations.

    """

    unknowns: str
    known_mass: Annotated[float, Gt(0)]
    values: Annotated[Array, Numbers(10)]
    information: Annotated[Array, Numbers(10, 10)]


@dataclass(frozen=True)
class WhitenessRecord:
    """Whiteness of the residuals; see `cpid_drake.estimation.whiteness.Whiteness`."""

    lag_one_correlation: float
    white: bool
    correlation_time_samples: float


@dataclass(frozen=True, eq=False)
class EffectRecord:
    """The estimate of a constant error; see `cpid_drake.identification.effects.EffectEstimate`."""

    name: str
    unit: str
    value: Annotated[Array, Numbers()]
    sigma: Annotated[Array, Numbers()]
    prior_sigma: float
    text: str


@dataclass(frozen=True, eq=False)
class UndeclaredRecord:
    """The errors that the samples show beyond the declared ones; see `effects.UndeclaredErrors`.

    Attributes:
        effects: estimates of those that act.
        suspected: probability of every other candidate to act.
        gains: gain of the log evidence by each candidate alone, by name.
        held_out: prediction of samples that did not choose them; None if it was not possible.
        proposed: whether the errors are proposed: the prediction does not contradict them.
        declaration: what to add to the sensors' file, as YAML.

    """

    effects: list[EffectRecord]
    suspected: Mapping[str, Probability]
    gains: Mapping[str, float]
    held_out: HeldOut | None
    proposed: bool
    declaration: list[str]


@dataclass(frozen=True, eq=False)
class FeasibleEstimate:
    """The physically consistent estimate: m [kg], c [m], Ixx, Iyy, Izz, Ixy, Ixz, Iyz [kg·m²]."""

    mass: float
    com: Annotated[Array, Numbers(3)]
    inertia: Annotated[Array, Numbers(6)]


@dataclass(frozen=True, eq=False)
class BodiesRecord:
    """What rigid bodies can have of an estimate; see `consistency.Consistency`.

    Attributes:
        parameters: (10,) the nearest rigid body; null where the samples determine nothing.
        interval_low, interval_high: (10,) the part of each 95 % interval that a rigid body can
            have, and bounds of what is not determined; null without a bound.
        size: largest distance of a part of the target from C that the bounds assume [m].
        possible: whether any rigid body agrees with the estimate within its uncertainty.

    """

    parameters: Annotated[Array, Numbers(10, unknown=True)]
    interval_low: Annotated[Array, Numbers(10, unknown=True)]
    interval_high: Annotated[Array, Numbers(10, unknown=True)]
    size: float
    possible: bool


@dataclass(frozen=True, eq=False, kw_only=True)
class IdentificationResult:
    """The keys of a result file. Unknown numbers are null in files; here None, NaN in arrays.

    Attributes:
        mass: estimated m [kg].
        com: (3,) c, in C [m].
        inertia: (6,) Ixx, Iyy, Izz, Ixy, Ixz, Iyz about the centre of mass, in C [kg·m²].
        covariance: (10, 10) covariance of `parameters`.
        feasible: the physically consistent estimate; None unless all ten are known.
        rank: number of parameters, or of combinations of them, that the data determine.
        condition: condition number of the problem; None if it is not known.
        samples_used, samples_rejected: counts of samples.
        warnings: sentences for the reader.
        doubts: reasons not to trust the estimate; empty if there are none.
        estimator: its name.
        rows: name of the row family, if the estimator has one.
        spacecraft: the model that was used.
        names, units: names and units of the ten parameters.
        interval_95: (10, 2) 95 % intervals of `parameters`; None if the file has none.
        infeasibilities: the reasons why no rigid body can have `parameters`; empty if one can.
        principal_moments: (3,) principal moments of `feasible`, ascending [kg·m²]; None if not
            known.
        principal_axes: (3, 3) their axes in C, as columns; None if not known.
        not_observable: the parameters that the data do not determine, in words.
        bodies: what rigid bodies can have of the estimate; None if the file does not contain it.
        table: what can be known on a table that carries the spacecraft, and how to see what is not
            known, in sentences; empty for a spacecraft that floats freely.
        singular_values: (10,) singular values of the scaled problem, descending; None if not known.
        residual_whiteness: None if there were no residuals to test.
        samples_rejected_by_sensor: `samples_rejected` by sensor.
        effects: estimates of constant errors of the sensors and of external forces.
        undeclared: errors beyond these that the samples show; None if they were not looked for.
        source: the data and options of the result; None for several logs, and if the file does not
            contain them.
        joint: the separate estimates, if several logs or a prior were used; else None.
        combinations: what a result of a rank below ten determines; None for other results.

    """

    mass: float | None
    com: Annotated[Array, Numbers(3, unknown=True)]
    inertia: Annotated[Array, Numbers(6, unknown=True)]
    covariance: Annotated[Array, Numbers(10, 10, unknown=True)]
    feasible: FeasibleEstimate | None
    rank: Annotated[int, Ge(0), Le(10)]
    condition: float | None
    samples_used: Count
    samples_rejected: Count
    warnings: list[str]
    estimator: str
    rows: str | None
    spacecraft: SpacecraftReference
    doubts: list[str] = field(default_factory=list)
    names: list[str] = field(default_factory=lambda: list(PARAMETER_NAMES))
    units: list[str] = field(default_factory=lambda: list(PARAMETER_UNITS))
    interval_95: Annotated[Array, Numbers(10, 2, unknown=True)] | None = None
    infeasibilities: list[str] = field(default_factory=list)
    principal_moments: Annotated[Array, Numbers(3)] | None = None
    principal_axes: Annotated[Array, Numbers(3, 3)] | None = None
    not_observable: str = ""
    table: list[str] = field(default_factory=list)
    bodies: BodiesRecord | None = None
    singular_values: Annotated[Array, Numbers(10, unknown=True)] | None = None
    residual_whiteness: WhitenessRecord | None = None
    samples_rejected_by_sensor: Mapping[str, Count] = field(default_factory=dict)
    effects: list[EffectRecord] = field(default_factory=list)
    undeclared: UndeclaredRecord | None = None
    source: Source | None = None
    joint: JointRecord | None = None
    combinations: CombinationsRecord | None = None

    @property
    def parameters(self) -> Array:
        """(10,) the unchanged estimate, in the order of `names`; NaN where not known."""
        mass = np.nan if self.mass is None else self.mass
        return np.concatenate([[mass], self.com, self.inertia])

    def files(self) -> list[Path]:
        """Return the files that the result was computed from, as far as they exist."""
        craft = self.spacecraft
        names = [craft.model]
        for source in self.sources():
            files = (source.telemetry, source.sensors, source.columns, source.prior)
            names += filter(None, files)
        found = []
        for name in names:
            with suppress(InputError):  # a preset, or a file that was moved
                found.append(resolve_model(name, package_folders(craft.packages)))
        return found

    def sources(self) -> list[Source]:
        """Return the data and options of every log, as far as the file contains them."""
        if self.source is not None:
            return [self.source]
        logs = [] if self.joint is None else self.joint.logs
        return [log.source for log in logs if log.source is not None]

    @property
    def target(self) -> InertialParameters | None:
        """The physically consistent estimate as inertial parameters; None unless all are known."""
        if self.feasible is None:
            return None
        ten = np.concatenate([[self.feasible.mass], self.feasible.com, self.feasible.inertia])
        return InertialParameters.from_vector(ten)


def read_result(path: str | Path) -> IdentificationResult:
    """Read a result file.

    Raises:
        InputError: the file does not exist or is not JSON; a key is missing, unknown, repeated or
            of the wrong type; a number is not finite; or the feasible estimate is not physically
            consistent.

    """
    with resolve_model(path).open("rb") as file:
        data = file.read(_LARGEST_FILE + 1)
    if len(data) > _LARGEST_FILE:
        raise InputError(f"{path}: larger than {_LARGEST_FILE >> 20} MiB: not a result file")
    return _parse(data, str(path))


def write_result(path: str | Path, result: IdentificationResult) -> None:
    """Write a result file, which `read_result` reads without loss.

    Raises:
        InputError: for the same reasons as `result_text`, or the file cannot be written.

    """
    write_text(path, result_text(result, str(path)))


def result_text(result: IdentificationResult, where: str) -> str:
    """Return the text of a result file.

    Args:
        result: the contents.
        where: the file's name in error messages.

    Raises:
        InputError: `read_result` would refuse the file.

    """
    text = json.dumps(asdict(result), indent=2, allow_nan=False, default=nulls) + "\n"
    _parse(text.encode(), where)
    return text


def _parse(data: bytes, where: str) -> IdentificationResult:
    result = from_tree(IdentificationResult, load_json(data, where), where, "a result")
    expected = (("names", result.names, PARAMETER_NAMES), ("units", result.units, PARAMETER_UNITS))
    for key, given, right in expected:
        if tuple(given) != right:
            raise InputError(f"{where}: {key} must be {', '.join(right)}")
    for source in result.sources():
        if source.momentum not in (None, *MOMENTUM_NAMES):
            names = ", ".join(MOMENTUM_NAMES)
            raise InputError(f"{where}: source.momentum must be one of {names}")
    if result.feasible is not None:
        size = max(np.abs(part).max() for part in vars(result.feasible).values())
        if size > _LARGEST:
            raise InputError(f"{where}: feasible: {size:g} is too large for a rigid body")
        problems = result.target.infeasibilities() if result.target else ()
        if problems:
            raise InputError(f"{where}: feasible: no rigid body has these: {'; '.join(problems)}")
    return result
