"""`cpid paper`."""

import time
from typing import Annotated

import typer
from rich.console import Console

from cpid_drake.commands.options import (
    FolderOption,
    ForceOption,
    QuietOption,
    log_console,
    print_warnings,
)
from cpid_drake.errors import prefix_errors
from cpid_drake.output_files.drafts import draft_folder
from cpid_drake.output_files.overwriting import PNG, check_folder
from cpid_drake.resources import find_scenario


def paper(
    out: FolderOption,
    scenario: Annotated[
        str,
        typer.Option(
            metavar="SCENARIO", help="A scenario file, or the name of a shipped scenario."
        ),
    ] = "paper",
    force: ForceOption = False,
    quiet: QuietOption = False,
) -> None:
    """Reproduce the study of Ning et al. 2016: simulate, identify, print tables, draw figures."""
    start = time.perf_counter()
    check_folder("--out", out, [])
    path = find_scenario(scenario)
    from cpid_drake.scenario.files import files_of, load_scenario

    log = log_console(quiet)
    with log.status("reading the scenario") as status:
        loaded = load_scenario(path)
        from cpid_drake.report.pages.study import STUDY_FILES, paper_report, write_study
        from cpid_drake.report.paper import FIGURES, figures, print_tables
        from cpid_drake.scenario.limits import check_limits
        from cpid_drake.studies.paper import run_paper_study, summarize
        from cpid_drake.studies.paper_values import EXCITING

        exciting = load_scenario(find_scenario(EXCITING))

        outputs = [*((name, PNG) for name in FIGURES), *STUDY_FILES]
        check_folder("--out", out, outputs, [path, *files_of(loaded)], force=force)
        with prefix_errors(scenario):
            study = run_paper_study(loaded, status.update, exciting)
            print_warnings(check_limits(study.simulation).exceeded)
        status.update("drawing the figures")
        summary = summarize(study, time.perf_counter() - start)
        with draft_folder(out) as draft:
            drawn = figures(study)
            write_study(draft, paper_report(study, drawn, summary, scenario), drawn)
    if not quiet:
        print_tables(study, Console(markup=False))
    log.print(f"\n{len(outputs)} files in {out}, {summary['wall_seconds']:.1f} s")
