#!/usr/bin/env python3
"""Errors that nobody declares: what `identify` says about logs of another simulator.

`python tests/reference/hidden.py [--seeds 2] [--first 0] [--kinds leak5,slosh] [--craft servicer]`
makes logs of 10 to 20 s with one hidden error each (see `hidden_world`), and identifies them as a
user would who states the white noise of the sensors and nothing else. It prints a line for each
log, and a table: of logs at exit 0, those with an error beyond 3 and 4.5 σ, the median NEES of 10,
the worst error, and the share of true values in 95 % intervals.
"""

import argparse
import sys
import tempfile
import time
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))  # as pytest does
from hidden_world import CRAFTS, KINDS, Array, Craft, simulate

from cpid_drake import BodyUncertainty, InputError, SensorSuite, Spacecraft, identify
from cpid_drake.logs.log import Log


@dataclass(frozen=True, eq=False)
class Answer:
    """What is said about a log: exit code, errors in σ, NEES of its rank, σ of the mass."""

    code: int
    said: str
    nees: float = np.nan
    rank: int = 0
    in_sigma: Array = field(default_factory=lambda: np.full(10, np.nan))
    inside: float = np.nan
    sigma: float = np.nan
    seconds: float = 0.0

    @property
    def worst(self) -> float:
        """Largest error of a known parameter in σ; zero without one."""
        return float(np.nanmax(np.abs(np.append(self.in_sigma, 0.0))))

    def __str__(self) -> str:
        return (
            f"exit {self.code}, NEES {self.nees:.1f} of {self.rank}, worst {self.worst:.2f} σ, "
            f"σ(m) {self.sigma:.3g} kg, {self.seconds:.0f} s; {self.said[:200]}"
        )


def answer(
    craft: Craft, log: Log, truth: Array, suite: SensorSuite, bodies: BodyUncertainty | None = None
) -> Answer:
    """Identify a log as a user would, and compare with the truth."""
    start = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "craft.xml"
        file.write_text(craft.mjcf())
        spacecraft = Spacecraft(file, base="base", capture_frame="grip")
    try:
        found = identify(spacecraft, log, sensors=suite, known_bodies=bodies)
    except InputError as error:
        return Answer(2, str(error), seconds=time.perf_counter() - start)
    code = 4 if found.failures else 0 if found.is_complete else 3
    said = {0: "", 3: found.not_identifiable, 4: "; ".join(found.failures)}[code]
    sigma = np.sqrt(np.diag(found.covariance))
    in_sigma = (found.parameters - truth) / sigma
    known = np.isfinite(in_sigma)
    inside = (found.intervals[:, 0] <= truth) & (truth <= found.intervals[:, 1])
    made = Answer(code, said, np.nan, found.rank, in_sigma, inside[known].mean(), sigma[0])
    if found.combinations is not None and found.form is not None:
        miss = found.combinations.values - found.form.from_parameters(truth)
        made = replace(made, nees=float(miss @ found.combinations.information @ miss))
    return replace(made, seconds=time.perf_counter() - start)


def table(answers: Mapping[tuple[str, str], Sequence[Answer]]) -> str:
    """Return the table of kinds and crafts."""
    names = "craft", "hidden", "logs", "exit 0", "> 3 σ", "> 4.5 σ", "NEES", "worst σ", "in 95 %"
    lines = [f"| {' | '.join(names)} | σ(m) [kg] |", "|" + 10 * "---|"]
    for (craft, kind), group in answers.items():
        passed = [each for each in group if each.code == 0]
        high = [sum(each.worst > limit for each in passed) for limit in (3, 4.5)]
        figures = (
            f"{np.median([each.nees for each in passed]):.1f} | "
            f"{max(each.worst for each in passed):.1f} | "
            f"{100 * np.mean([each.inside for each in passed]):.0f} | "
            f"{np.median([each.sigma for each in passed]):.2g}"
            if passed
            else " | | | "
        )
        counts = f"{len(group)} | {len(passed)} | {high[0]} | {high[1]}"
        lines.append(f"| {craft} | {kind} | {counts} | {figures} |")
    return "\n".join(lines)


def main() -> None:
    """Simulate and identify logs, and print what is said about them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--kinds", default=",".join(KINDS))
    parser.add_argument("--craft", choices=list(CRAFTS))
    parser.add_argument("--exact", action="store_true", help="errors not stated are zero")
    parser.add_argument("--bodies", action="store_true", help="the bodies are declared exact")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    answers: dict[tuple[str, str], list[Answer]] = {}
    for seed in range(options.first, options.first + options.seeds):
        for kind in options.kinds.split(","):
            for name in [options.craft] if options.craft else CRAFTS:
                craft = CRAFTS[name]
                suite = craft.suite().exact() if options.exact else craft.suite()
                log, truth = simulate(craft, KINDS[kind], seed)
                bodies = BodyUncertainty() if options.bodies else None
                made = answer(craft, log, truth, suite, bodies)
                answers.setdefault((name, kind), []).append(made)
                print(f"{name} {kind} {seed}: {made}", flush=True)
    print(table(answers))


if __name__ == "__main__":
    main()
