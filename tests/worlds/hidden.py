#!/usr/bin/env python3
"""Errors that nobody declares: what `identify` says about logs of another simulator.

`python tests/worlds/hidden.py [--seeds 2] [--first 0] [--kinds leak5,slosh] [--craft servicer]`
makes logs of 10 to 20 s with one hidden error each (see `hidden_world`), and identifies them as a
user would who states the white noise of the sensors and nothing else. It prints a line for each
log, and a table: of logs at exit 0, those with an error beyond 3 and 4.5 σ, the median NEES of 10,
the worst error, and the share of true values in 95 % intervals.
"""

import argparse
import sys
import tempfile
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # as pytest does
from worlds.answers import Answer, answer
from worlds.hidden_world import CRAFTS, KINDS, Array, Craft, simulate

from cpid_drake import BodyUncertainty, SensorSuite, Spacecraft
from cpid_drake.logs.log import Log


def identified(
    craft: Craft, log: Log, truth: Array, suite: SensorSuite, bodies: BodyUncertainty | None = None
) -> Answer:
    """Identify a log as a user would, and compare with the truth."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "craft.xml"
        file.write_text(craft.mjcf())
        spacecraft = Spacecraft(file, base="base", capture_frame="grip")
    return answer(spacecraft, log, truth, sensors=suite, known_bodies=bodies)


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
                made = identified(craft, log, truth, suite, bodies)
                answers.setdefault((name, kind), []).append(made)
                print(f"{name} {kind} {seed}: {made}", flush=True)
    print(table(answers))


if __name__ == "__main__":
    main()
