"""The result of an identification as a JSON file."""

import json
import sys
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.inertia import InertialParameters
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


@dataclass(frozen=True, eq=False)
class IdentificationResult:
    """What an identification found, and from what. Unknown numbers are NaN here, null in files.

    Attributes:
        parameters: (10,) m [kg], c [m], Ixx, Iyy, Izz, Ixy, Ixz, Iyz [kg·m²] as estimated; in C,
            inertia about the centre of mass. In files: `mass`, `com`, `inertia`.
        covariance: (10, 10) of `parameters`.
        feasible: the physically possible estimate; None unless all ten are known.
        rank: how many of the ten (or combinations of them) the data determine.
        condition: condition number of the rows; NaN where the estimator has none.
        samples_used, samples_rejected: counts of samples.
        warnings: sentences for the reader.
        estimator: its name.
        rows: name of the row family, if the estimator has one.
        spacecraft: the model that was identified with.
        details: further keys and values that JSON can hold, as the estimator likes.

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
    details: dict[str, Any] = field(default_factory=dict)


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
        InputError: a detail has the name of another key or is nothing that JSON can hold, or
            `read_result` would refuse the file.

    """
    document = _document(result)
    clash = sorted(document.keys() & result.details.keys())
    if clash:
        raise InputError(
            f"{where}: a detail cannot be called '{clash[0]}': the result has that key"
        )
    try:
        text = json.dumps(document | result.details, indent=2, allow_nan=False) + "\n"
    except (TypeError, ValueError, RecursionError) as error:
        raise InputError(f"{where}: details that JSON cannot hold: {error}") from error
    _parse(text.encode(), where)
    return text


def _document(result: IdentificationResult) -> dict[str, Any]:
    parameters, feasible = _nulls(result.parameters), result.feasible
    return {
        "mass": parameters[0],
        "com": parameters[1:4],
        "inertia": parameters[4:],
        "covariance": [_nulls(row) for row in result.covariance],
        "feasible": feasible and _feasible_document(feasible.to_vector().tolist()),
        "rank": int(result.rank),
        "condition": _nulls([result.condition])[0],
        "samples_used": int(result.samples_used),
        "samples_rejected": int(result.samples_rejected),
        "warnings": list(result.warnings),
        "estimator": result.estimator,
        "rows": result.rows,
        "spacecraft": asdict(result.spacecraft),
    }


def _feasible_document(parameters: list[float]) -> dict[str, Any]:
    return {"mass": parameters[0], "com": parameters[1:4], "inertia": parameters[4:]}


def _nulls(values: Any) -> list[float | None]:
    """Return numbers as JSON has them: those that are not finite are not known."""
    values = np.asarray(values, dtype=float).tolist()
    return [value if np.isfinite(value) else None for value in values]


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
            *(spacecraft.text(key) for key in ("model", "base", "capture_frame")),
            packages=spacecraft.texts_by_name("packages"),
        ),
        details=section.rest(),
    )
    spacecraft.finish()
    return result


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

    def _error(self, key: str, problem: str) -> InputError:
        return InputError(f"{self._where}: {self._prefix}{key} {problem}")

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
                raise self._error(key, f"must be a list of {size_text} numbers")
            flat = [item for row in flat for item in row]
        return np.reshape([self._number(key, item, unknown) for item in flat], shape)

    def _number(self, key: str, value: object, unknown: bool) -> float:
        if value is None and unknown:
            return np.nan
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise self._error(key, f"must hold numbers, not {value!r:.60}")
        if not abs(value) <= sys.float_info.max:
            raise self._error(key, "holds a number that is not finite")
        return float(value)

    def ten(self, *, unknown: bool = False) -> NDArray[np.float64]:
        """Return `mass`, `com` and `inertia` as a parameter vector (10,)."""
        shapes: dict[str, tuple[int, ...]] = {"mass": (), "com": (3,), "inertia": (6,)}
        return np.hstack([self.numbers(*item, unknown=unknown) for item in shapes.items()])

    def count(self, key: str, most: int | None = None) -> int:
        """Return a whole number that is not negative, nor above `most`."""
        value = self.take(key)
        if not isinstance(value, int) or isinstance(value, bool) or value < 0:
            raise self._error(key, f"must be a whole number, not {value!r:.60}")
        if most is not None and value > most:
            raise self._error(key, f"must be {most} at most")
        return value

    def text(self, key: str, *, optional: bool = False) -> Any:
        """Return a string, or None if that is allowed."""
        value = self.take(key)
        return None if optional and value is None else self._text(key, value)

    def texts(self, key: str) -> tuple[str, ...]:
        """Return a list of strings."""
        value = self.take(key)
        if not isinstance(value, list):
            raise self._error(key, f"must be a list of strings, not {value!r:.60}")
        return tuple(self._text(key, item) for item in value)

    def texts_by_name(self, key: str) -> dict[str, str]:
        """Return an object of strings; empty if it is left out."""
        value = self._values.pop(key, {})
        if not isinstance(value, dict):
            raise self._error(key, f"must be an object, not {value!r:.60}")
        return {self._text(key, name): self._text(key, item) for name, item in value.items()}

    def _text(self, key: str, value: object) -> str:
        if not isinstance(value, str):
            raise self._error(key, f"must be a string, not {value!r:.60}")
        try:
            value.encode()
        except UnicodeEncodeError as error:  # half of a surrogate pair: it could not be printed
            raise self._error(key, f"is not text: {value!r:.60}") from error
        return value

    def rest(self) -> dict[str, Any]:
        """Return the keys that have not been taken."""
        return self._values

    def finish(self) -> None:
        """Refuse keys that have not been taken."""
        for key in self._values:
            raise InputError(f"{self._where}: unknown key {self._prefix + key!r:.60}")
