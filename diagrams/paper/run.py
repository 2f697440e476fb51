#!/usr/bin/env python3
"""Reproduce the study of Ning et al. 2016: simulate, identify, print tables, draw figures.

`make demo` runs this. The folder gets a page, `report.html`, and `summary.json`.
"""

import argparse
import json
import logging
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from cpid_drake import InputError, find_scenario, load_scenario
from cpid_drake.files.overwriting import check_folder
from cpid_drake.report.page import Report, Section
from cpid_drake.report.pages.study import study_report
from cpid_drake.report.terminal import print_tables
from cpid_drake.simulation.limits import check_limits
from cpid_drake.simulation.scenario_files import files_of
from paper import figures, tables
from paper.study import PaperStudy, run_paper_study, summarize
from paper.values import EXCITING


def page_of(study: PaperStudy, scenario: str, summary: dict[str, Any]) -> Report:
    """Return the page of a study on a scenario of this name or path."""
    words = ["python", "diagrams/paper/run.py", "--scenario", scenario, "--out", "OUT"]
    mass, *others = figures.sections(study)
    introduction = Section("The paper and this study", texts=tables.INTRODUCTION)
    folded = [replace(each, folded=True) for each in others]
    sections = [mass, introduction, *tables.sections(study), *folded]
    files = {"summary.json": json.dumps(summary, indent=2, allow_nan=False) + "\n"}
    title, facts = "Study of Ning et al. 2016", [("Scenario", scenario)]
    return study_report(title, f"Scenario {scenario}", sections, facts, words, files)


def run(scenario: str, out: Path, *, force: bool = False, quiet: bool = False) -> PaperStudy:
    """Run the study of a scenario, and write its page and numbers into a folder."""
    start = time.perf_counter()
    path = find_scenario(scenario)
    loaded, exciting = load_scenario(path), load_scenario(find_scenario(EXCITING))
    check_folder("--out", out, [path, *files_of(loaded)], force=force)

    def show(text: str) -> None:
        if not quiet:
            print(text, file=sys.stderr)

    try:
        study = run_paper_study(loaded, show, exciting)
    except InputError as error:
        raise InputError(f"{scenario}: {error}") from error
    for text in check_limits(study.simulation).exceeded:
        print(f"warning: {text}", file=sys.stderr)
    show("drawing the figures")
    summary = summarize(study, time.perf_counter() - start)
    page = page_of(study, scenario, summary)
    page.write_folder(out)
    if not quiet:
        print_tables(page)
    show(f"{summary['wall_seconds']:.1f} s; open {out / 'report.html'}")
    return study


def main() -> None:
    """Read the command line; an error or Ctrl-C is one line; code 2 or 130."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, help="folder to write")
    parser.add_argument("--scenario", default="paper", help="a scenario file, or a shipped one")
    parser.add_argument("--force", action="store_true", help="replace files that exist")
    parser.add_argument("--quiet", action="store_true", help="print only warnings and errors")
    args = parser.parse_args()
    logging.getLogger("drake").setLevel(logging.WARNING)
    try:
        run(args.scenario, args.out, force=args.force, quiet=args.quiet)
    except InputError as error:
        parser.exit(2, f"{parser.prog}: error: {error}\n")
    except KeyboardInterrupt:
        parser.exit(130, f"{parser.prog}: interrupted\n")


if __name__ == "__main__":
    main()
