#!/usr/bin/env python3
"""Compare momentum with accelerations, force sensors, adaptive control and a neural network.

All get the same motion, target and noise. The folder gets a page, `report.html`, with errors,
bounds, and which of the claims of Ning et al. 2016 the numbers uphold; `techniques.csv` has all
numbers.
"""

import argparse
import logging
import os
import sys
import time
from collections.abc import Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from paper.values import EXCITING

from cpid_drake import InputError, find_scenario, load_scenario
from cpid_drake.files.overwriting import check_folder
from cpid_drake.report.page import Report
from cpid_drake.report.pages.study import study_report
from cpid_drake.report.terminal import print_tables
from cpid_drake.simulation.scenario_files import files_of
from techniques import tables
from techniques.comparison import TechniqueComparison, run_comparison
from techniques.force_sensors import LABORATORY, load_force_sensors

SCENARIOS = ("paper", EXCITING, "uncertain_spacecraft")
"""The shipped scenarios that are compared."""


def page_of(found: TechniqueComparison, scenarios: Sequence[str], words: Sequence[str]) -> Report:
    """Return the page of a comparison of techniques on scenarios, made by the command `words`."""
    subtitle = f"{', '.join(scenarios)}, {found.trials} trials, seed {found.seed}"
    files = {
        "techniques.csv": tables.numbers(found).csv(),
        "techniques.md": tables.short_table(found),
    }
    sections, facts = tables.sections(found), [("Scenario", ", ".join(scenarios))]
    return study_report("Techniques side by side", subtitle, sections, facts, words, files)


def run(args: argparse.Namespace) -> None:
    """Compare the techniques, and write the page, its figures and its numbers into a folder."""
    start = time.perf_counter()
    names = (args.scenario,) if args.scenario else SCENARIOS
    paths = [find_scenario(name) for name in names]
    scenarios = {name: load_scenario(path) for name, path in zip(names, paths)}
    inputs = [*paths, *(each for loaded in scenarios.values() for each in files_of(loaded))]
    check_folder("--out", args.out, [*inputs, args.force_sensors], force=args.force)
    sensors = load_force_sensors(args.force_sensors)

    def show(done: int, total: int) -> None:
        if sys.stderr.isatty() and not args.quiet:
            print(f"\r{done} of {total}", end="" if done < total else "\n", file=sys.stderr)

    found = run_comparison(
        scenarios,
        sensors,
        trials=args.trials,
        seed=args.seed,
        jobs=args.jobs,
        is_fast=args.fast,
        progress=show,
    )
    words = ["python", "diagrams/techniques/run.py", *([args.scenario] if args.scenario else [])]
    words += ["--trials", str(args.trials), "--seed", str(args.seed)]
    words += ["--fast"] if args.fast else []
    if args.force_sensors != LABORATORY:
        words += ["--force-sensors", str(args.force_sensors)]
    page = page_of(found, names, [*words, "--out", "OUT"])
    page.write_folder(args.out)
    if not args.quiet:
        print_tables(page)
        print(f"{args.out}: {time.perf_counter() - start:.1f} s", file=sys.stderr)


def main() -> None:
    """Read the command line; an error or Ctrl-C is one line; code 2 or 130."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    several = ", ".join(SCENARIOS)
    parser.add_argument("scenario", nargs="?", help=f"a scenario; default: {several}")
    parser.add_argument("--out", type=Path, required=True, help="folder to write")
    parser.add_argument("--trials", type=int, default=20, help="draws of the noise in each case")
    parser.add_argument(
        "--force-sensors", type=Path, default=LABORATORY, metavar="YAML", help="sensors of forces"
    )
    parser.add_argument("--fast", action="store_true", help="without network, adaptive control")
    parser.add_argument("--seed", type=int, default=2016, help="of all random numbers")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="processes")
    parser.add_argument("--force", action="store_true", help="replace files that exist")
    parser.add_argument("--quiet", action="store_true", help="print only warnings and errors")
    args = parser.parse_args()
    logging.getLogger("drake").setLevel(logging.WARNING)
    try:
        run(args)
    except InputError as error:
        parser.exit(2, f"{parser.prog}: error: {error}\n")
    except KeyboardInterrupt:
        parser.exit(130, f"{parser.prog}: interrupted\n")


if __name__ == "__main__":
    main()
