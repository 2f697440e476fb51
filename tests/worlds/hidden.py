#!/usr/bin/env python3
"""Errors that nobody declares: what `identify` says about logs of another simulator.

`python tests/worlds/hidden.py [--seeds 2] [--first 0] [--kinds leak5,slosh] [--craft servicer]`
makes logs of 10 to 20 s with one hidden error each (see `hidden_world`), and identifies them as a
user would who states the white noise of the sensors and nothing else. It prints a line for each
log, and a table: of logs at exit 0, the worst error in σ, and median and worst NEES of the ten
parameters. `--write` writes this table into docs/explanation/trust.md.
"""

import argparse
import re
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

PAGE = Path(__file__).resolve().parents[2] / "docs/explanation/trust.md"
MOST_NEES = 36.0
"""NEES of ten parameters that 99.99 % of logs are below."""

LABELS = {
    "none": "nothing",
    "leak0.3": "a leak of 0.3 mN fixed in the base (servicer: 3)",
    "leak2": "of 2 mN (20)",
    "leak5": "of 5 mN (50)",
    "grasp1e3": "a grasp of 10³ N·m/rad",
    "grasp1e4": "of 10⁴",
    "grasp1e5": "of 10⁵",
    "joints2e3": "joints of 2·10³ N·m/rad",
    "joints2e4": "of 2·10⁴",
    "slosh": "2 % of the base on a spring of 0.7 Hz",
    "swing": "0.5 % of the base on it",
    "gyro": "gyro: scale 0.1 %, axes 1 mrad",
    "zeros": "joint zeros of 2 mrad",
    "scale": "scales of the encoders of 0.3 %",
    "turn": "error of the encoders once a turn, 5 mrad",
    "late": "attitude and position 20 ms late",
    "clock": "the gyro's clock 50 ppm fast",
    "wheel": "a wheel of 0.005 N·m·s (0.5)",
    "wheels": "wheels that change by 1 mN·m·s (10)",
    "torque": "a torque that changes, of 1 mN·m (10)",
    "spin": "a rotor in the target, 5 mN·m·s (50)",
    "gradient": "gravity gradient of a low orbit",
    "base": "mass and inertia of the base +1 %",
    "arm": "joints at 0.5 mm and 0.5 mrad from their places",
    "rho0.5": "noise with a correlation of neighbours of 0.5",
    "rho0.9": "of 0.9",
    "half": "half white, half of 0.9",
    "flicker": "half white, half flicker of 0.1 to 10 s",
}
"""Words for each kind of `hidden_world`, in the order of the table."""


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
    """Return a sentence about all logs, and the table of kinds and crafts; see `PAGE`."""
    passed = [each for group in answers.values() for each in group if each.code == 0]
    count = sum(map(len, answers.values()))
    beyond = [sum(each.worst > limit for each in passed) for limit in (3, 4.5)]
    apart = sum(each.nees > MOST_NEES for each in passed)
    crafts = list(dict.fromkeys(craft for craft, _ in answers))
    heads = ["Hidden"]
    for craft in crafts:
        heads += [f"{craft.replace('_', '-')}: at exit 0", "worst error", "NEES: median, worst"]
    lines = [
        f"Of {count} logs, {len(passed)} are at exit 0. Of these, {beyond[0]} have an error beyond "
        f"3 σ, {beyond[1]} beyond 4.5 σ, and {apart} a NEES beyond {MOST_NEES:.0f}.",
        "",
        f"| {' | '.join(heads)} |",
        "|" + len(heads) * "---|",
    ]
    for kind in dict.fromkeys(kind for _, kind in answers):
        cells = [cell for craft in crafts for cell in _cells(answers.get((craft, kind), []))]
        lines.append(f"| {' | '.join([LABELS[kind], *cells])} |")
    return "\n".join(lines)


def _cells(group: Sequence[Answer]) -> tuple[str, str, str]:
    """Return how many logs are at exit 0, and the errors of these."""
    passed = [each for each in group if each.code == 0]
    if not passed:
        return f"0 of {len(group)}", "–", "–"
    nees = [each.nees for each in passed]
    worst = max(each.worst for each in passed)
    count = f"{len(passed)} of {len(group)}"
    return count, f"{worst:.1f} σ", f"{np.median(nees):.0f}, {max(nees):.0f}"


def written(page: str, made: str) -> str:
    """Return the text of the page with another table and the sentence before it."""
    return re.sub(r"(?ms)^Of \d+ logs, .*?\n\n\| Hidden \|.*?\n(?=\n)", lambda _: f"{made}\n", page)


def main() -> None:
    """Simulate and identify logs, and print what is said about them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--kinds", default=",".join(LABELS))
    parser.add_argument("--craft", choices=list(CRAFTS))
    parser.add_argument("--exact", action="store_true", help="errors not stated are zero")
    parser.add_argument("--bodies", action="store_true", help="the bodies are declared exact")
    parser.add_argument("--write", action="store_true", help=f"write the table into {PAGE.name}")
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
    print(made := table(answers))
    if options.write:
        PAGE.write_text(written(PAGE.read_text(encoding="utf-8"), made), encoding="utf-8")


if __name__ == "__main__":
    main()
