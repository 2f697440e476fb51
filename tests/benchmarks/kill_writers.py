#!/usr/bin/env python3
"""Kill every command that writes at random instants, and count the states of its outputs.

Every second instant is soon after the first draft appears, while the command writes.
"""

import argparse
import json
import random
import sys
from collections import Counter
from pathlib import Path
from tempfile import TemporaryDirectory

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from killed_writers import WRITERS, Bench


def main() -> None:
    """Kill the commands and print the counts as JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--instants", type=int, default=10, help="for each command")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--command", action="append", choices=[*WRITERS])
    args = parser.parse_args()
    random_numbers, names = random.Random(args.seed), tuple(args.command or WRITERS)
    counts: dict[str, Counter[str]] = {name: Counter() for name in names}
    with TemporaryDirectory() as folder:
        bench = Bench(Path(folder), names)
        for k in range(args.instants):
            for name in names:
                states = bench.kill(name, random_numbers, at_draft=k % 2 == 1)
                counts[name].update(states)
                print(name, *states, file=sys.stderr, flush=True)
    print(json.dumps(counts, indent=2))
    found = {state for count in counts.values() for state in count}
    sys.exit(bool(found - {"old", "new", "unfinished"}))


if __name__ == "__main__":
    main()
