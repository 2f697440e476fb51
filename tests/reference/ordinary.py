#!/usr/bin/env python3
"""Ordinary motions, also weak and noisy ones: what `cpid identify` says about 240 logs.

`python tests/reference/ordinary.py [--count 240] [--first N]` identifies these logs, prints a line
for each, and a summary. See `ordinary_cases` for what the logs are of.
"""

import argparse
import re
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # as pytest does
from ordinary_cases import COUNT, Array, Design, make

from cpid_drake import Identification, InertialParameters, InputError, identify


@dataclass(frozen=True, eq=False)
class Answer:
    """What the identification says about a log, and how it compares with the truth.

    Attributes:
        design: of the log.
        code: exit code that `cpid identify` has.
        said: failed checks, what is open, or why the log is refused.
        converged: whether the fit is the best one.
        sweeps: of each fit, in order.
        seconds: of the simulation, and of the identification.
        nees, rank: squared error of the known combinations in units of their covariance, and their
            number.
        in_sigma: (10,) errors in σ; NaN where not known.
        inside: (10,) whether the 95 % interval has the true value.

    """

    design: Design
    code: int
    said: str
    converged: bool
    sweeps: tuple[int, ...]
    seconds: tuple[float, float]
    nees: float = 0.0
    rank: int = 0
    in_sigma: Array = field(default_factory=lambda: np.full(10, np.nan))
    inside: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(10, dtype=bool))

    @property
    def answered(self) -> bool:
        """Whether all is known, or the answer says what is open."""
        return self.code == 0 or (self.code == 3 and bool(self.said))

    @property
    def known(self) -> int:
        """Number of parameters that are known."""
        return int(np.isfinite(self.in_sigma).sum())

    @property
    def worst(self) -> float:
        """Largest error of a known parameter in σ; zero without one."""
        return float(np.nanmax(np.abs(np.append(self.in_sigma, 0.0))))

    def __str__(self) -> str:
        fits = "+".join(map(str, self.sweeps))
        return (
            f"{self.design.number:3d} {self.design}: exit {self.code}, "
            f"{'' if self.converged else 'NOT CONVERGED, '}sweeps {fits}, known {self.known}, "
            f"NEES {self.nees:.1f} of {self.rank}, worst {self.worst:.1f} σ, "
            f"{self.seconds[0]:.1f} + {self.seconds[1]:.1f} s; {self.said}"
        )


def answer(design: Design) -> Answer:
    """Simulate and identify the log of a design."""
    start = time.perf_counter()
    made = make(design)
    middle, sweeps = time.perf_counter(), [0]

    def progress(step: str) -> None:
        if sweep := re.match(r"fitting: sweep (\d+)", step):  # of each fit from the second on
            number = int(sweep[1])
            if number <= sweeps[-1]:
                sweeps.append(0)
            sweeps[-1] = number

    try:
        planar = True if made.spacecraft.tree.normal_B is not None else None
        found = identify(
            made.spacecraft, made.log, sensors=made.sensors, planar=planar, progress=progress
        )
    except InputError as error:
        seconds = middle - start, time.perf_counter() - middle
        return Answer(design, 2, str(error), False, tuple(sweeps), seconds)
    seconds = middle - start, time.perf_counter() - middle
    code = 4 if found.failures else 0 if found.is_complete else 3
    said = {0: "", 3: found.not_identifiable, 4: "; ".join(found.failures)}[code]
    parts = code, said, found.converged, tuple(sweeps), seconds
    return Answer(design, *parts, *_compared(found, made.truth))


def _compared(
    found: Identification, truth: InertialParameters
) -> tuple[float, int, Array, NDArray[np.bool_]]:
    """Return NEES and rank, errors (10,) in σ, and whether the intervals have the truth."""
    true = truth.to_vector()
    in_sigma = (found.parameters - true) / np.sqrt(np.diag(found.covariance))
    inside = (found.intervals[:, 0] <= true) & (true <= found.intervals[:, 1])
    if found.combinations is None or found.form is None:
        return 0.0, 0, in_sigma, inside
    error = found.combinations.values - found.form.from_parameters(true)
    return float(error @ found.combinations.information @ error), found.rank, in_sigma, inside


def band(freedom: int, tail: float = 1e-3) -> tuple[float, float]:
    """Return the two-sided band of a sum of squares."""
    low, high = chi2.ppf([tail / 2, 1 - tail / 2], freedom)
    return float(low), float(high)


def table(answers: Sequence[Answer], key: Callable[[Answer], str]) -> Iterable[str]:
    """Yield a line of figures for each group of answers."""
    for name in dict.fromkeys(map(key, answers)):
        group = [each for each in answers if key(each) == name]
        first = np.array([each.sweeps[0] for each in group])
        total = np.array([sum(each.sweeps) for each in group])
        rank, known = sum(each.rank for each in group), sum(each.known for each in group)
        inside = sum(int(each.inside[np.isfinite(each.in_sigma)].sum()) for each in group)
        low, high = (x / max(rank, 1) for x in band(max(rank, 1)))
        yield (
            f"{name:<14} {len(group):3d} logs: answered {sum(a.answered for a in group):3d}, "
            f"converged {sum(a.converged for a in group):3d}, sweeps of the first fit "
            f"{np.median(first):.0f} / {np.percentile(first, 95):.0f} / {first.max()}, of all "
            f"{np.median(total):.0f} / {np.percentile(total, 95):.0f} / {total.max()}, "
            f"NEES/rank {sum(a.nees for a in group) / max(rank, 1):.2f} [{low:.2f}, {high:.2f}], "
            f"in 95 % {100 * inside / max(known, 1):.1f} of {known}, "
            f"{max(sum(a.seconds) for a in group):.0f} s at most"
        )


def summary(answers: Sequence[Answer]) -> Iterable[str]:
    """Yield the figures of all answers, by factors, and the answers to look at."""
    yield "sweeps: median / 95 % / most"
    keys: dict[str, Callable[[Answer], str]] = {
        "all": lambda each: "all",
        "craft": lambda each: each.design.craft,
        "motion": lambda each: each.design.motion,
        "sensors": lambda each: each.design.sensors,
        "length": lambda each: f"{each.design.length:g} s",
        "rate": lambda each: f"{each.design.rate:g} Hz",
        "target": lambda each: f"{each.design.share:g} bases",
    }
    for key in keys.values():
        yield from table(answers, key)
    yield "to look at:"
    for each in answers:
        fails = not each.answered or not each.converged
        if fails or sum(each.sweeps) > 20 or each.worst > 4:
            yield str(each)


def main() -> None:
    """Identify logs, and print what is said about them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=COUNT)
    parser.add_argument("--first", type=int, default=0)
    options = parser.parse_args()
    answers = []
    for number in range(options.first, min(options.first + options.count, COUNT)):
        answers.append(answer(Design(number)))
        print(answers[-1], flush=True)
    print("\n".join(summary(answers)))


if __name__ == "__main__":
    main()
