"""`cpid report`."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from cpid_drake.errors import InputError


def report(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="RESULT|RUN", help="A result file of `identify`, or a folder of `simulate`."
        ),
    ],
    out: Annotated[Path, typer.Option(metavar="FILE", help="The HTML file to write.")],
    figures: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help="Write the figures there too, as PNG and SVG."),
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", help="Print nothing.")] = False,
) -> None:
    """Report an identification, or a simulated run, as one HTML page that needs nothing else."""
    import logging

    from cpid_drake.commands.folders import make_folder

    logging.getLogger("drake").setLevel(logging.WARNING)
    check_page("--out", out)
    if figures is not None:
        make_folder(figures)
    log = Console(stderr=True, quiet=quiet, markup=False, highlight=False, soft_wrap=True)
    with log.status("reading") as status:
        from cpid_drake.report.figures import write_figures
        from cpid_drake.report.findings import findings_of_file
        from cpid_drake.report.pages.identification import identification_report
        from cpid_drake.report.pages.run import run_report

        if source.is_dir():
            page, findings = run_report(source, status.update)
        else:
            findings = findings_of_file(source, status.update)
            page = identification_report(findings, progress=status.update)
        status.update("drawing")
        page.write(out)
        files = [out]
        if figures is not None and findings.evidence is not None:
            files += write_figures(figures, findings.evidence, findings.convergence, findings.truth)
    if findings.missing:
        log.print(f"note: without what needs the log: {findings.missing}")
    log.print(f"{out}" + (f", {len(files) - 1} figures in {figures}" if figures else ""))


def check_page(option: str, path: Path) -> None:
    """Refuse a page that could not be written, before the work and not after it.

    Raises:
        InputError: there is no such folder, or it is a folder itself.

    """
    if not path.parent.is_dir():
        raise InputError(f"{option} {path}: there is no folder {path.parent}")
    if path.is_dir():
        raise InputError(f"{option} {path}: is a folder; name an HTML file")
