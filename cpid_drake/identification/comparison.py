"""Comparison of results: whether they have the same target, and what differs in their requests.

The errors of the results are taken to be independent. Errors of one spacecraft or of its sensors
are not: where the logs are there, identify them together, with these errors in common.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations, product

import numpy as np

from cpid_drake.array import Array
from cpid_drake.dynamics.parameterizations import (
    Parameterization,
    relative_parameterization,
)
from cpid_drake.dynamics.rows import ROW_FAMILIES
from cpid_drake.estimation.gaussian import Gaussian
from cpid_drake.estimation.rigid_bodies import sizes
from cpid_drake.files.digits import significant
from cpid_drake.files.errors import InputError
from cpid_drake.identification.agreement import Sources, largest_difference, most_different
from cpid_drake.identification.arguments import PathLike
from cpid_drake.identification.checks import Check
from cpid_drake.identification.identify_files import file_hash
from cpid_drake.identification.prior import TargetPrior, prior_of_result
from cpid_drake.identification.request import Request, Source, log_names
from cpid_drake.identification.result import Identification
from cpid_drake.identification.result_files import read_result
from cpid_drake.identification.words import LARGER_NOISE

_TARGET = "target"


@dataclass(frozen=True, eq=False)
class Comparison:
    """Results beside each other.

    Attributes:
        results: the results, by name; two or more.
        check: whether they have the same target, if each is right. It has no statistic if no
            combination of the parameters is known from more than one of them.
        checks: the same of each result against all others.
        differences: what differs in logs, requests and checks: the words for each result, in the
            order of `results`.
        warnings: sentences for the reader, such as the failed checks of a result.

    """

    results: Mapping[str, Identification]
    check: Check
    checks: Mapping[str, Check]
    differences: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()

    @property
    def is_same_target(self) -> bool | None:
        """Whether the results agree; None if it is not decided.

        It is not if a result failed its own checks, so that it proves nothing, or if the results
        determine nothing in common.
        """
        return None if self.failed or self.check.statistic is None else self.check.passed

    @property
    def failed(self) -> list[str]:
        """Names of the results that failed their own checks."""
        return [name for name, each in self.results.items() if not each.passed]

    def distances(self) -> Array:
        """Return the differences (n, 10) of the parameters from those of the first result, in σ.

        σ is that of the difference of two independent estimates. NaN where a result does not
        identify a parameter.
        """
        values = np.array([each.parameters for each in self.results.values()])
        variances = np.array([np.diag(each.covariance) for each in self.results.values()])
        # (π − π₁) / √(var(π) + var(π₁))
        return np.asarray((values - values[0]) / np.sqrt(variances + variances[0]))

    def __str__(self) -> str:
        return "\n".join([*(f"warning: {each}" for each in self.warnings), self.verdict])

    def __repr__(self) -> str:
        return f"Comparison({', '.join(self.results)}: {self.verdict})"

    @property
    def verdict(self) -> str:
        """Whether the results have the same target, in a sentence."""
        statistic, limit = self.check.statistic, self.check.limit
        if statistic is None or limit is None:
            return "the results determine nothing in common"
        sentence = self.check.sentence
        if self.check.passed:
            sentence = (
                f"the results agree with one target (χ² {statistic:.3g}; the check fails above "
                f"{limit:.3g})"
            )
        if not self.failed:
            return sentence
        return (
            f"not decided, because {' and '.join(self.failed)} failed checks and may be wrong by "
            f"more than the interval; as they stand, {sentence}"
        )


def compare(
    results: Mapping[str, Identification | PathLike] | Sequence[Identification | PathLike],
) -> Comparison:
    """Compare results: whether they have the same target, and what differs in their requests.

    The differences between the targets have a χ² distribution if the targets are one and the
    errors of the results are independent. Targets that are one fail in one comparison of 10,000.

    Args:
        results: two or more results, or their files. Without names, those of the files are used,
            or numbers from 1 on.

    Raises:
        InputError: there are less than two results, or two of one file; a file cannot be read; the
            results are in several capture frames; they determine only combinations of parameters,
            of unknowns that differ or for spacecraft of different masses.

    """
    if isinstance(results, str) or not isinstance(results, Mapping | Sequence):
        raise InputError(f"compare takes a list or a mapping of results, not {results!r:.80}")
    given = dict(results) if isinstance(results, Mapping) else _named(results)
    if len(given) < 2:
        raise InputError("give two results or more to compare")
    read = {name: _result(name, each) for name, each in given.items()}
    _check_frames(read)
    sources = _sources(read)
    each = sources.checks_of_each()
    worst = most_different(each)
    sentence = "the results do not have the same target"
    if len(read) > 2:
        sentence += f": {worst} differs from the rest"
    else:
        sentence += largest_difference(*read.values())
    return Comparison(
        read,
        sources.check(sentence, *([name] for name in read)),
        each,
        dict(_differences(list(read.values()))),
        (*_failures(read), *_in_common(given, read)),
    )


def _named(results: Sequence[Identification | PathLike]) -> dict[str, Identification | PathLike]:
    """Return results by the names of their files, or by numbers."""
    names = [
        str(each) if isinstance(each, PathLike) else str(k) for k, each in enumerate(results, 1)
    ]
    names = log_names(names)
    for one, other in combinations(names, 2):
        if one == other:
            raise InputError(f"{one}: is given twice")
    return dict(zip(names, results, strict=True))


def _result(name: str, given: Identification | PathLike) -> Identification:
    """Return a result, also from its file."""
    if isinstance(given, Identification):
        return given
    if not isinstance(given, PathLike):
        raise InputError(f"{name}: give a result or its file, not {given!r:.80}")
    return read_result(given)


def _check_frames(results: Mapping[str, Identification]) -> None:
    """Refuse results whose parameters are about different frames."""
    frames = {n: r.spacecraft.capture_frame for n, r in results.items() if r.spacecraft is not None}
    for (one, frame), (other, another) in combinations(frames.items(), 2):
        if frame != another:
            raise InputError(
                f"{other}: is in the capture frame {another}, and {one} in {frame}: identify with "
                "the same frame"
            )


def _sources(results: Mapping[str, Identification]) -> Sources:
    """Return the targets of results as independent sources of knowledge, in the same unknowns."""
    own = [each.combinations for each in results.values() if each.combinations is not None]
    mass = own[0].known_mass if own else 1.0
    form = relative_parameterization(mass)
    if len(own) == len(results) and len({each.unknowns for each in own}) == 1:
        form = ROW_FAMILIES[own[0].unknowns].parameterization(mass)
    # The sizes separate what results determine from what they leave open, 1/NO_PRIOR times as far.
    inertia = np.array([each.parameters[4:7] for each in results.values()])
    masses = np.array([each.parameters[:1] for each in results.values()])
    with np.errstate(invalid="ignore", divide="ignore"):
        # √(I / m)
        radii = np.nan_to_num(np.sqrt(inertia / masses), posinf=0.0)
    scale = sizes(form, mass, float(radii.max()) or 1.0)
    gaussians = {}
    for name, each in results.items():
        target = prior_of_result(each, name, mass, None)
        gaussians[name] = _gaussian(target, form, scale)
    vague = Gaussian.of_rows({_TARGET: 10}, np.column_stack([np.diag(1 / scale), np.zeros(10)]))
    return Sources(vague, gaussians, _TARGET, scale)


def _gaussian(target: TargetPrior, form: Parameterization, scale: Array) -> Gaussian:
    """Return what a result says of the target, linear about its own values."""
    return target.gaussian(_TARGET, form, target.moved(form, 0.1 * scale), scale)


def _failures(results: Mapping[str, Identification]) -> Iterator[str]:
    """Yield the failed checks of results."""
    for name, result in results.items():
        yield from (f"{name}: failed check: {failure}" for failure in result.failures)


def _in_common(
    given: Mapping[str, Identification | PathLike], results: Mapping[str, Identification]
) -> Iterator[str]:
    """Yield which results share a log or a prior, or are the prior of another."""
    priors = {name: {s.sha256.get("prior") for s in each.sources} for name, each in results.items()}
    for name, each in given.items():
        if not isinstance(each, Identification):  # it may be the prior of another
            priors[name].add(file_hash(str(each)))
    for one, other in combinations(results, 2):
        pairs = product(results[one].sources, results[other].sources)
        if (priors[one] & priors[other]) - {None} or any(_overlap(*pair) for pair in pairs):
            yield (
                f"{one} and {other} have a log or a prior in common: their errors are not "
                "independent, and they agree better than this test assumes"
            )


def _overlap(one: Source, other: Source) -> bool:
    """Return whether two sources are parts of one log that overlap."""
    is_same = None is not one.sha256.get("telemetry") == other.sha256.get("telemetry")
    return is_same and one.start < other.end and other.start < one.end


def _request_words(part: Callable[[Request], object]) -> Callable[[Identification], str]:
    """Return a function from a result to a part of its requests, in words."""

    def words(result: Identification) -> str:
        parts = (part(source.request) for source in result.sources)
        shown = ("yes" if x is True else "no" if x is False else str(x or "") for x in parts)
        return ", ".join(filter(None, dict.fromkeys(shown)))

    return words


def _larger_noise(result: Identification) -> str:
    larger = ((name, factor) for name, factor in result.noise.items() if factor > LARGER_NOISE)
    return ", ".join(f"{name} {significant(factor)} times" for name, factor in larger)


_COMPARED: dict[str, Callable[[Identification], str]] = {
    "log": _request_words(lambda request: request.telemetry),
    "used [s]": lambda result: ", ".join(
        f"{source.start:.6g} to {source.end:.6g}" for source in result.sources
    ),
    "samples": lambda result: str(result.sample_count),
    "not used": lambda result: ", ".join(f"{n} of {name}" for name, n in result.rejected.items()),
    "columns": _request_words(lambda request: request.columns),
    "spacecraft": _request_words(lambda request: request.spacecraft.model),
    "base": _request_words(lambda request: request.spacecraft.base),
    "known bodies": _request_words(lambda request: request.known_bodies),
    "sensors": _request_words(lambda request: request.sensors or "from the log"),
    "momentum": lambda result: result.momentum,
    "table": _request_words(lambda request: request.planar),
    "prior": _request_words(lambda request: request.prior),
    "estimator": lambda result: result.estimator + (f", {result.rows}" if result.rows else ""),
    "rank": lambda result: str(result.rank),
    "noise above the declared": _larger_noise,
    "changes of the momentum": lambda result: str(len(result.momentum_changes or ())),
    "failed checks": lambda result: ", ".join(
        check.name for check in result.checks if not check.passed
    ),
    "version": lambda result: ", ".join(
        dict.fromkeys(source.cpid_drake for source in result.sources)
    ),
}
"""What is compared, and its words for a result."""


def _differences(results: Sequence[Identification]) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Yield what differs between results, with the words for each."""
    for name, words in _COMPARED.items():
        each = tuple(words(result) or "none" for result in results)
        if len(set(each)) > 1:
            yield name, each
