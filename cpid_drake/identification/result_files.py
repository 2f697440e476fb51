"""The result of an identification as a JSON file."""

import json
import sys
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.parameterizations import PARAMETER_NAMES, PARAMETER_UNITS
from cpid_drake.dynamics.total_momentum import MOMENTUM_NAMES
from cpid_drake.errors import InputError

_LARGEST_FILE = 16 * 2**20  # bytes; a result has some thousand
_LARGEST = 1e90  # SI units: products of what is larger overflow


@dataclass(frozen=True)
class SpacecraftReference:
    """Which spacecraft a result is about.

    Attributes:
        model: an absolute path or a `package://NAME/...` URI.
        base: name of its base body.
        capture_frame: name of the frame C that holds the target.
        packages: folders, by name, of packages that the model's URIs refer to. Files that name
            none can leave them out.

    """

    model: str
    base: str
    capture_frame: str
    packages: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Source:
    """What a result was made from.

    Attributes:
        telemetry: the file or the folder of a bag.
        sha256: of its content; None for a folder.
        sensors: name of a preset or a YAML file; None if nothing was known about the sensors.
        momentum: name of the total momentum; see `TotalMomentum.named`.
        topics: topics of a bag, by kind.
        leave_out_bad: whether rows with a problem were left out.
        command: the command line that asks the same.
        start, end: first and last time that was used [s]; keys `from` and `to`.
        cpid_drake: version of this package.

    """

    telemetry: str
    sha256: str | None
    sensors: str | None
    momentum: str
    topics: dict[str, str]
    leave_out_bad: bool
    command: str
    start: float
    end: float
    cpid_drake: str


@dataclass(frozen=True)
class WhitenessRecord:
    """Whiteness of the residuals, as `cpid_drake.estimation.whiteness.Whiteness` states it."""

    lag_one_correlation: float
    white: bool
    correlation_time_samples: float


@dataclass(frozen=True, eq=False)
class IdentificationResult:
    """What a result file holds. Unknown numbers are NaN here and null in files.

    Attributes:
        parameters: (10,) m [kg], c [m], Ixx, Iyy, Izz, Ixy, Ixz, Iyz [kg·m²] as estimated; in C,
            inertia about the centre of mass. In files: `mass`, `com`, `inertia`.
        covariance: (10, 10) of `parameters`.
        feasible: the physically consistent estimate; None unless all ten are known.
        rank: how many of the ten (or combinations of them) the data determine.
        condition: condition number of the problem; NaN where there is none.
        samples_used, samples_rejected: counts of samples.
        warnings: sentences for the reader.
        estimator: its name.
        rows: name of the row family, if the estimator has one.
        spacecraft: the model that was used.
        intervals: (10, 2) 95 % intervals of `parameters`; None if the file has none. In files:
            `interval_95`.
        infeasibilities: why no rigid body has `parameters`; empty if one has.
        principal_moments: (3,) of `feasible`, ascending [kg·m²]; None if not known.
        principal_axes: (3, 3) their axes in C, as columns; None if not known.
        not_observable: what the data leave open, in words.
        singular_values: (10,) of the scaled problem, descending; None if not known.
        whiteness: of the residuals; None if there were none. In files: `residual_whiteness`.
        rejected_by_sensor: `samples_rejected` by sensor. In files: `samples_rejected_by_sensor`.
        source: what the result was made from; None if the file does not say.

    """

    parameters: NDArray[np.float64]
    covariance: NDArray[np.float64]
    feasible: InertialParameters | None
    rank: int
    condition: float
    samples_used: int
    samples_rejected: int
    warnings: tuple[str, ...]
    estimator: str
    rows: str | None
    spacecraft: SpacecraftReference
    intervals: NDArray[np.float64] | None = None
    infeasibilities: tuple[str, ...] = ()
    principal_moments: NDArray[np.float64] | None = None
    principal_axes: NDArray[np.float64] | None = None
    not_observable: str = ""
    singular_values: NDArray[np.float64] | None = None
    whiteness: WhitenessRecord | None = None
    rejected_by_sensor: Mapping[str, int] = field(default_factory=dict)
    source: Source | None = None


def read_result(path: str | Path) -> IdentificationResult:
    """Read a result file.

    Raises:
        InputError: no such file, not JSON, a key that is missing, given twice or of another kind,
            a number that is not finite, or a feasible estimate that no rigid body has.

    """
    path = Path(path)
    try:
        if not path.is_file():  # a pipe would be waited for
            raise InputError(f"{path}: {'not a file' if path.exists() else 'no such file'}")
        if path.stat().st_size > _LARGEST_FILE:
            raise InputError(f"{path}: larger than {_LARGEST_FILE >> 20} MiB: not a result file")
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path!s:.200}: {error.strerror}") from error
    return _parse(data, str(path))


def write_result(path: str | Path, result: IdentificationResult) -> None:
    """Write a result file; `read_result` gives back what was written.

    Raises:
        InputError: as `result_text`, or the file cannot be written.

    """
    text = result_text(result, str(path))
    try:
        Path(path).write_text(text, encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path}: cannot write there: {error.strerror}") from error


def result_text(result: IdentificationResult, where: str) -> str:
    """Return the text of a result file.

    Args:
        result: what it is to hold.
        where: its name, for error messages.

    Raises:
        InputError: `read_result` would refuse the file.

    """
    text = json.dumps(_document(result), indent=2, allow_nan=False) + "\n"
    _parse(text.encode(), where)
    return text


def _document(result: IdentificationResult) -> dict[str, object]:
    parameters, feasible, source = _nulls(result.parameters), result.feasible, result.source
    return {
        "mass": parameters[0],
        "com": parameters[1:4],
        "inertia": parameters[4:],
        "covariance": _table(result.covariance),
        "feasible": feasible and _feasible_document(feasible.to_vector().tolist()),
        "rank": int(result.rank),
        "condition": _nulls([result.condition])[0],
        "samples_used": int(result.samples_used),
        "samples_rejected": int(result.samples_rejected),
        "warnings": list(result.warnings),
        "estimator": result.estimator,
        "rows": result.rows,
        "spacecraft": asdict(result.spacecraft),
        "names": list(PARAMETER_NAMES),
        "units": list(PARAMETER_UNITS),
        "interval_95": _table(result.intervals),
        "infeasibilities": list(result.infeasibilities),
        "principal_moments": _table(result.principal_moments),
        "principal_axes": _table(result.principal_axes),
        "not_observable": result.not_observable,
        "singular_values": _table(result.singular_values),
        "residual_whiteness": result.whiteness and asdict(result.whiteness),
        "samples_rejected_by_sensor": dict(result.rejected_by_sensor),
        "source": source and {_SOURCE_KEYS.get(k, k): v for k, v in asdict(source).items()},
    }


_SOURCE_KEYS = {"start": "from", "end": "to"}


def _table(values: NDArray[np.float64] | None) -> list[float | None] | list[list] | None:
    if values is None:
        return None
    return [_nulls(row) for row in values] if np.ndim(values) == 2 else _nulls(values)


def _feasible_document(parameters: list[float]) -> dict[str, object]:
    return {"mass": parameters[0], "com": parameters[1:4], "inertia": parameters[4:]}


def _nulls(values: ArrayLike) -> list[float | None]:
    """Return numbers as JSON has them: those that are not finite are not known."""
    return [value if np.isfinite(value) else None for value in np.asarray(values, float).tolist()]


# -- reading -------------------------------------------------------------------------------------


def _parse(data: bytes, where: str) -> IdentificationResult:
    try:
        document = json.loads(
            data.decode("utf-8-sig"),
            object_pairs_hook=_object,
            parse_float=_finite,
            parse_constant=_finite,
        )
    except InputError as error:
        raise InputError(f"{where}: {error}") from error
    except ValueError as error:  # of JSON, or of the encoding
        raise InputError(f"{where}: not JSON: {error}") from error
    except RecursionError as error:
        raise InputError(f"{where}: nested too deeply") from error
    section = _Section(document, where)
    spacecraft = _Section(section.take("spacecraft"), where, "spacecraft.")
    result = IdentificationResult(
        parameters=section.ten(unknown=True),
        covariance=section.numbers("covariance", (10, 10), unknown=True),
        feasible=_feasible(section, where),
        rank=section.count("rank", most=10),
        condition=float(section.numbers("condition", (), unknown=True)),
        samples_used=section.count("samples_used"),
        samples_rejected=section.count("samples_rejected"),
        warnings=section.texts("warnings"),
        estimator=section.text("estimator"),
        rows=section.text("rows", optional=True),
        spacecraft=SpacecraftReference(
            model=spacecraft.text("model"),
            base=spacecraft.text("base"),
            capture_frame=spacecraft.text("capture_frame"),
            packages=spacecraft.texts_by_name("packages"),
        ),
        intervals=section.table("interval_95", (10, 2)),
        infeasibilities=section.texts("infeasibilities", optional=True),
        principal_moments=section.table("principal_moments", (3,)),
        principal_axes=section.table("principal_axes", (3, 3)),
        not_observable=section.text("not_observable") if "not_observable" in section else "",
        singular_values=section.table("singular_values", (10,)),
        whiteness=_whiteness(section),
        rejected_by_sensor=section.counts_by_name("samples_rejected_by_sensor"),
        source=_source(section),
    )
    for key, expected in (("names", PARAMETER_NAMES), ("units", PARAMETER_UNITS)):
        if section.texts(key, optional=True) not in ((), expected):
            raise InputError(f"{where}: {key} must be {', '.join(expected)}")
    spacecraft.finish()
    section.finish()
    return result


def _whiteness(section: "_Section") -> WhitenessRecord | None:
    inner = section.inner("residual_whiteness")
    if inner is None:
        return None
    record = WhitenessRecord(
        float(inner.numbers("lag_one_correlation", ())),
        inner.flag("white"),
        float(inner.numbers("correlation_time_samples", ())),
    )
    inner.finish()
    return record


def _source(section: "_Section") -> Source | None:
    inner = section.inner("source")
    if inner is None:
        return None
    source = Source(
        telemetry=inner.text("telemetry"),
        sha256=inner.text("sha256", optional=True),
        sensors=inner.text("sensors", optional=True),
        momentum=inner.text("momentum"),
        topics=inner.texts_by_name("topics"),
        leave_out_bad=inner.flag("leave_out_bad"),
        command=inner.text("command"),
        start=float(inner.numbers("from", ())),
        end=float(inner.numbers("to", ())),
        cpid_drake=inner.text("cpid_drake"),
    )
    if source.momentum not in MOMENTUM_NAMES:
        raise inner.error("momentum", f"must be one of {', '.join(MOMENTUM_NAMES)}")
    inner.finish()
    return source


def _feasible(section: "_Section", where: str) -> InertialParameters | None:
    value = section.take("feasible")
    if value is None:
        return None
    inner = _Section(value, where, "feasible.")
    ten = inner.ten()
    inner.finish()
    if np.abs(ten).max() > _LARGEST:
        raise InputError(f"{where}: feasible: {np.abs(ten).max():g} is too large for a rigid body")
    parameters = InertialParameters.from_vector(ten)
    problems = parameters.infeasibilities()
    if problems:
        raise InputError(f"{where}: feasible: no rigid body has these: {'; '.join(problems)}")
    return parameters


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    seen: dict[str, Any] = {}
    for key, value in pairs:
        if key in seen:
            raise InputError(f"the key {key!r:.60} is given twice")
        seen[key] = value
    return seen


def _finite(literal: str) -> float:
    if not np.isfinite(float(literal)):
        raise InputError(f"{literal:.60} is not a finite number; unknown numbers are null")
    return float(literal)


class _Section:
    """The keys of a JSON object, each taken once and checked."""

    def __init__(self, value: object, where: str, prefix: str = "") -> None:
        self._where, self._prefix = where, prefix
        if not isinstance(value, dict):
            what = prefix.rstrip(".") or "a result"
            raise InputError(f"{where}: {what} must be an object, not {value!r:.60}")
        self._values = dict(value)

    def error(self, key: str, problem: str) -> InputError:
        """Return the error of a key that has this problem."""
        return InputError(f"{self._where}: {self._prefix}{key} {problem}")

    def __contains__(self, key: str) -> bool:
        return key in self._values

    def take(self, key: str) -> Any:
        """Return a value; a key that is missing is an error, and what is never taken the rest."""
        if key not in self._values:
            raise InputError(f"{self._where}: the key '{self._prefix}{key}' is missing")
        return self._values.pop(key)

    def numbers(
        self, key: str, shape: tuple[int, ...], *, unknown: bool = False
    ) -> NDArray[np.float64]:
        """Return finite numbers of this shape; null, if `unknown` allows it, is NaN."""
        value = self.take(key)
        flat = [value]
        for size in shape:
            if not all(isinstance(row, list) and len(row) == size for row in flat):
                size_text = "x".join(map(str, shape))
                raise self.error(key, f"must be a list of {size_text} numbers")
            flat = [item for row in flat for item in row]
        return np.reshape([self._number(key, item, unknown) for item in flat], shape)

    def _number(self, key: str, value: object, unknown: bool) -> float:
        if value is None and unknown:
            return np.nan
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise self.error(key, f"must hold numbers, not {value!r:.60}")
        if not abs(value) <= sys.float_info.max:
            raise self.error(key, "holds a number that is not finite")
        return float(value)

    def inner(self, key: str) -> "_Section | None":
        """Return the object of a key; None if it is null or missing."""
        value = self._values.pop(key, None)
        return None if value is None else _Section(value, self._where, f"{self._prefix}{key}.")

    def table(self, key: str, shape: tuple[int, ...]) -> NDArray[np.float64] | None:
        """Return numbers of this shape, NaN for null; None if the key is null or missing."""
        if self._values.get(key) is None:
            return self._values.pop(key, None)
        return self.numbers(key, shape, unknown=True)

    def flag(self, key: str) -> bool:
        """Return true or false."""
        value = self.take(key)
        if not isinstance(value, bool):
            raise self.error(key, f"must be true or false, not {value!r:.60}")
        return value

    def counts_by_name(self, key: str) -> dict[str, int]:
        """Return an object of whole numbers; empty if it is missing."""
        inner = self.inner(key)
        return {} if inner is None else {name: inner.count(name) for name in list(inner._values)}

    def ten(self, *, unknown: bool = False) -> NDArray[np.float64]:
        """Return `mass`, `com` and `inertia` as a parameter vector (10,)."""
        shapes: dict[str, tuple[int, ...]] = {"mass": (), "com": (3,), "inertia": (6,)}
        return np.hstack([self.numbers(*item, unknown=unknown) for item in shapes.items()])

    def count(self, key: str, most: int | None = None) -> int:
        """Return a whole number that is not negative, nor above `most`."""
        value = self.take(key)
        if not isinstance(value, int) or isinstance(value, bool) or value < 0:
            raise self.error(key, f"must be a whole number, not {value!r:.60}")
        if most is not None and value > most:
            raise self.error(key, f"must be {most} at most")
        return value

    def text(self, key: str, *, optional: bool = False) -> Any:
        """Return a string, or None if that is allowed."""
        value = self.take(key)
        return None if optional and value is None else self._text(key, value)

    def texts(self, key: str, *, optional: bool = False) -> tuple[str, ...]:
        """Return a list of strings; if `optional`, an empty one for a key that is missing."""
        value = self._values.pop(key, []) if optional else self.take(key)
        if not isinstance(value, list):
            raise self.error(key, f"must be a list of strings, not {value!r:.60}")
        return tuple(self._text(key, item) for item in value)

    def texts_by_name(self, key: str) -> dict[str, str]:
        """Return an object of strings; empty if it is left out."""
        value = self._values.pop(key, {})
        if not isinstance(value, dict):
            raise self.error(key, f"must be an object, not {value!r:.60}")
        return {self._text(key, name): self._text(key, item) for name, item in value.items()}

    def _text(self, key: str, value: object) -> str:
        if not isinstance(value, str):
            raise self.error(key, f"must be a string, not {value!r:.60}")
        try:
            value.encode()
        except UnicodeEncodeError as error:  # half of a surrogate pair: it could not be printed
            raise self.error(key, f"is not text: {value!r:.60}") from error
        return value

    def finish(self) -> None:
        """Refuse keys that have not been taken."""
        for key in self._values:
            raise InputError(f"{self._where}: unknown key {self._prefix + key!r:.60}")
