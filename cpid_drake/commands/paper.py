"""`cpid paper`."""

import json
import time
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from cpid_drake.commands.folders import make_folder


def paper(
    out: Annotated[Path, typer.Option(help="Folder for figures and summary.json; made if needed.")],
    scenario: Annotated[
        str | None,
        typer.Option(
            metavar="SCENARIO", help="A scenario file, or a shipped one's name. Default: paper."
        ),
    ] = None,
    quiet: Annotated[
        bool, typer.Option("--quiet", help="Print no tables and no progress.")
    ] = False,
) -> None:
    """Run the study of Ning et al. 2016: simulate, identify, print its tables, draw its figures."""
    start = time.perf_counter()
    # Imported here so that `cpid --help` does not wait for Drake.
    from cpid_drake.report.pages.study import paper_report
    from cpid_drake.report.paper import print_tables, write_figures
    from cpid_drake.scenario.files import load_scenario
    from cpid_drake.scenario.naming import naming
    from cpid_drake.scenario.shipped import find_scenario
    from cpid_drake.studies.paper import run_paper_study, summarize

    make_folder(out)
    log = Console(stderr=True, quiet=quiet, markup=False)
    with log.status("reading the scenario") as status:

        def progress(step: str) -> None:
            status.update(step)

        name = scenario or "paper"
        loaded = load_scenario(find_scenario(name))
        with naming(name):
            study = run_paper_study(loaded, progress)
        progress("drawing the figures")
        figures = write_figures(study, out)
        summary = summarize(study, time.perf_counter() - start)
        page = out / "report.html"
        paper_report(study, figures, summary, name).write(page)
    files = [*figures, page, out / "summary.json"]
    files[-1].write_text(json.dumps(summary, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    if not quiet:
        print_tables(study, Console(markup=False))
    log.print(f"\n{len(files)} files in {out}, {summary['wall_seconds']:.1f} s", highlight=False)
