"""`cpid report`."""

from pathlib import Path
from typing import Annotated

import typer

from cpid_drake.commands.options import QuietOption, check_output, log_console, make_folder
from cpid_drake.errors import InputError


def report(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="RESULT|RUN",
            help="A result file of `cpid identify`, or an output folder of `cpid simulate`.",
        ),
    ],
    out: Annotated[Path, typer.Option(metavar="FILE", help="HTML file to write.")],
    figures: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help="Write the figures there too, as PNG and SVG."),
    ] = None,
    quiet: QuietOption = False,
) -> None:
    """Write the report of an identification or of a simulated run, one self-contained HTML page."""
    check_output("--out", out)
    if figures is not None:
        make_folder(figures)
    if not source.exists():
        raise InputError(f"{source}: no such file or folder")
    import logging

    from cpid_drake.report.figures import write_figures
    from cpid_drake.report.findings import findings_of_file
    from cpid_drake.report.pages.identification import identification_report
    from cpid_drake.report.pages.run import run_report

    logging.getLogger("drake").setLevel(logging.WARNING)
    log = log_console(quiet)
    with log.status("reading") as status:
        if source.is_dir():
            page, findings = run_report(source, status.update)
        else:
            findings = findings_of_file(source, status.update)
            page = identification_report(findings, progress=status.update)
        status.update("drawing")
        page.write(out)
        files = [out]
        if figures is not None and findings.log is not None:
            files += write_figures(figures, findings.log, findings.truth)
    if findings.missing:
        log.print(f"note: the report has no sections that need the log: {findings.missing}")
    log.print(f"{out}" + (f", {len(files) - 1} figures in {figures}" if figures else ""))
