"""`cpid paper`."""

import json
import time
from typing import Annotated

import typer
from rich.console import Console

from cpid_drake.commands.options import FolderOption, QuietOption, log_console, make_folder
from cpid_drake.errors import prefix_errors
from cpid_drake.resources import find_scenario


def paper(
    out: FolderOption,
    scenario: Annotated[
        str,
        typer.Option(
            metavar="SCENARIO", help="A scenario file, or the name of a shipped scenario."
        ),
    ] = "paper",
    quiet: QuietOption = False,
) -> None:
    """Reproduce the study of Ning et al. 2016: simulate, identify, print tables, draw figures."""
    start = time.perf_counter()
    make_folder(out)
    path = find_scenario(scenario)
    from cpid_drake.scenario.files import load_scenario

    log = log_console(quiet)
    with log.status("reading the scenario") as status:
        loaded = load_scenario(path)
        from cpid_drake.report.pages.study import paper_report
        from cpid_drake.report.paper import print_tables, write_figures
        from cpid_drake.studies.paper import run_paper_study, summarize

        with prefix_errors(scenario):
            study = run_paper_study(loaded, status.update)
        status.update("drawing the figures")
        figures = write_figures(study, out)
        summary = summarize(study, time.perf_counter() - start)
        page = out / "report.html"
        paper_report(study, figures, summary, scenario).write(page)
    files = [*figures, page, out / "summary.json"]
    files[-1].write_text(json.dumps(summary, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    if not quiet:
        print_tables(study, Console(markup=False))
    log.print(f"\n{len(files)} files in {out}, {summary['wall_seconds']:.1f} s")
