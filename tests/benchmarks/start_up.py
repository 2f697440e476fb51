#!/usr/bin/env python3
"""Time how long `cpid --help` and errors in the input take, in new interpreters.

Each time is the smallest of several: CPU time, which other work on the machine hardly changes, and
wall-clock time.
"""

import argparse
import json
import os
import subprocess
import sys
import time

OPTIONS = ("--spacecraft", "no.urdf", "--base", "body", "--capture-frame", "frame")
COMMANDS = {
    "help": ["--help"],
    "identify_help": ["identify", "--help"],
    "simulate_help": ["simulate", "--help"],
    "missing_log": ["identify", "no.csv", *OPTIONS],
}


def seconds(arguments: list[str]) -> tuple[float, float]:
    """Return the CPU time and the wall-clock time of one run of `cpid`."""
    start, before = time.perf_counter(), os.times()
    command = [sys.executable, "-m", "cpid_drake", *arguments]
    subprocess.run(command, capture_output=True, check=False)
    after = os.times()
    cpu = after.children_user + after.children_system
    return cpu - before.children_user - before.children_system, time.perf_counter() - start


def main() -> None:
    """Time the commands and print the result as JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=5)
    args = parser.parse_args()
    report = {}
    for name, arguments in COMMANDS.items():
        times = [seconds(arguments) for _ in range(args.repeats)]
        for kind, values in zip(("cpu", "wall"), zip(*times)):
            report[f"{name}_{kind}_seconds"] = round(min(values), 3)
    print(json.dumps(report, indent=2))


if __name__ == "__main__":
    main()
