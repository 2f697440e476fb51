"""Runs `cpid identify` on a log in this process, and judges its answer by the truth."""

import contextlib
import io
import json
import re
import signal
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from unittest.mock import patch

import numpy as np
from log_spoils import Columns
from log_words import names_cause
from numpy.typing import NDArray
from scipy.stats import chi2

from cpid_drake.commands.main import main
from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.parameterizations import PARAMETER_NAMES, parameter_scale
from cpid_drake.scenario.schema import SpacecraftConfig

LONGEST = 30.0
"""Processor time after which a run is stopped [s]."""

STOPPED = 124
"""Exit code of a run that was stopped."""

NOT_TRUSTWORTHY = 4
"""Exit code of `cpid identify` for an answer that its own tests refuse."""

MOST_SIGMA = 5.0
"""Largest error of one parameter that passes for chance, in σ."""

LEAST_PROBABILITY = 1e-6
"""Smallest probability of the joint error that passes for chance."""

ROUNDING = 1e-6
"""Error that is always accepted, relative to the parameter's scale."""


@dataclass(frozen=True, eq=False)
class Answer:
    """What `cpid identify` said about one log.

    Attributes:
        code: exit code.
        text: stderr, then stdout.
        json: the result file, empty if there is none.

    """

    code: int
    text: str
    json: dict

    @property
    def message(self) -> str:
        """The first line of the error, of the verdict or of the warnings; empty without one."""
        lines = [line.strip() for line in self.text.splitlines() if line.strip()]
        marked = [
            line for line in lines if re.match(r"(cpid: error|not trustworthy|warning)", line)
        ]
        lines = [line for line in marked if line.startswith("not trustworthy")] or marked
        return lines[0] if lines else ""

    @property
    def told(self) -> str:
        """All errors, verdicts and warnings, in lower case."""
        # The first line of the result names the capture frame; the table follows.
        head = re.split(r"\nTarget in |\n  ", self.text)[0]
        more = (str(self.json.get(key, "")) for key in ("warnings", "not_observable"))
        return "\n".join([head, *more]).lower()


@dataclass(frozen=True)
class Judgement:
    """The comparison of an answer with the truth.

    Attributes:
        verdict: "FAIL" for exit code 0 with an interval that excludes the truth; "wrong" for exit
            code 3 with such an interval; "right" for intervals that contain the truth; "refused"
            (2); "untrusted" (4); "open" for exit code 3 without an interval; "stopped" for a run
            that took too long; "crash" for others.
        worst: largest error of a shown parameter, in σ of its interval; NaN if none is shown.
        entry: name of that parameter.
        probability: of a joint error as large as that of all shown parameters.
        known: number of shown parameters.
        inside: number of 95 % intervals that contain the truth.
        is_named: whether the text names the cause.

    """

    verdict: str
    worst: float
    entry: str
    probability: float
    known: int
    inside: int
    is_named: bool

    @property
    def is_wrong(self) -> bool:
        """Whether an interval that looks trustworthy excludes the truth."""
        return self.verdict in ("FAIL", "wrong", "crash")


def write_log(path: Path, columns: Columns) -> None:
    """Write columns as an NPZ file, without any check."""
    np.savez(path, **columns)


def run_identify(log: Path, craft: SpacecraftConfig, capture_frame: str, *options: str) -> Answer:
    """Run `cpid identify` on a log in this process."""
    out = log.with_suffix(".json")
    out.unlink(missing_ok=True)
    words = ["cpid", "identify", str(log), "--spacecraft", craft.model, "--base", craft.base]
    words += ["--capture-frame", capture_frame or craft.capture_frame, "--json", str(out), *options]
    stdout, stderr = io.StringIO(), io.StringIO()
    code: int | str | None = 0
    streams = contextlib.redirect_stdout(stdout), contextlib.redirect_stderr(stderr)
    with patch.object(sys, "argv", words), streams[0], streams[1]:
        try:
            with _limited(LONGEST):
                main()
        except SystemExit as ended:
            code = ended.code
        except _StoppedError:
            code = STOPPED
            print(f"cpid: error: stopped after {LONGEST:g} s", file=stderr)
        except Exception as error:  # a crash is a finding, and the bench goes on to the next log
            code = 1
            print(f"cpid: error: crash: {type(error).__name__}: {error}", file=stderr)
    document = json.loads(out.read_text(encoding="utf-8")) if out.is_file() else {}
    return Answer(int(code or 0), f"{stderr.getvalue()}\n{stdout.getvalue()}", document)


class _StoppedError(Exception):
    """The run took too long."""


@contextlib.contextmanager
def _limited(seconds: float) -> Iterator[None]:
    """Stop the body after a processor time [s]."""

    def stop(number, frame):
        raise _StoppedError

    before = signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)


def judge(answer: Answer, truth: InertialParameters, words: str = "") -> Judgement:
    """Compare an answer with the truth.

    Args:
        answer: the answer.
        truth: the target.
        words: regular expression that names the cause.

    """
    is_named = bool(words) and names_cause(answer.told, words)
    code = answer.code
    if code not in (0, 3, NOT_TRUSTWORTHY):
        verdict = {2: "refused", STOPPED: "stopped"}.get(code, "crash")
        return Judgement(verdict, np.nan, "", np.nan, 0, 0, is_named)
    true = truth.to_vector()
    floor = ROUNDING * parameter_scale(true)
    document = answer.json
    estimate = _numbers([document["mass"], *document["com"], *document["inertia"]])
    low, high = _numbers(document["interval_95"]).reshape(10, 2).T
    shown = np.isfinite(low) & np.isfinite(high) & np.isfinite(estimate)
    error, half = estimate - true, (high - low) / 2
    sigma = np.hypot(half / 1.96, floor)
    in_sigma = np.where(shown, np.abs(error) / sigma, 0.0)
    inside = int((shown & (np.abs(error) <= half + floor)).sum())
    if not shown.any():
        return Judgement("open" if code == 3 else "untrusted", np.nan, "", np.nan, 0, 0, is_named)
    worst = int(in_sigma.argmax())
    probability = _probability(document, error, sigma, floor, shown)
    is_wrong = in_sigma[worst] > MOST_SIGMA or probability < LEAST_PROBABILITY
    verdict = {0: "FAIL", 3: "wrong"}.get(code, "untrusted") if is_wrong else "right"
    if code == NOT_TRUSTWORTHY:
        verdict = "untrusted"
    return Judgement(
        verdict,
        float(in_sigma[worst]),
        PARAMETER_NAMES[worst],
        probability,
        int(shown.sum()),
        inside,
        is_named,
    )


def _probability(
    document: dict,
    error: NDArray[np.float64],
    sigma: NDArray[np.float64],
    floor: NDArray[np.float64],
    shown: NDArray[np.bool_],
) -> float:
    """Return the probability of a joint error as large, with the correlations of the result."""
    covariance = _numbers(document["covariance"]).reshape(10, 10)[np.ix_(shown, shown)]
    own = np.sqrt(np.diag(covariance))
    with np.errstate(invalid="ignore", divide="ignore"):
        correlation = np.where(own > 0, covariance / np.outer(own, own), 0.0)
    correlation[~np.isfinite(correlation)] = 0.0
    np.fill_diagonal(correlation, 1.0)
    # The scale is that of the intervals: they use Student's t distribution.
    scaled = correlation * np.outer(sigma[shown], sigma[shown]) + np.diag(floor[shown] ** 2)
    size = np.sqrt(np.diag(scaled))
    values, vectors = np.linalg.eigh(scaled / np.outer(size, size))
    along = vectors.T @ (error[shown] / size)
    values = np.maximum(values, 1e-12)
    return float(chi2.sf(np.sum(along**2 / values), shown.sum()))


def _numbers(entries: list) -> NDArray[np.float64]:
    """Return nested lists with null as an array with NaN."""
    return np.array(entries, dtype=float)
