"""`cpid report`."""

from pathlib import Path
from typing import Annotated

import typer

from cpid_drake.commands.log_options import LogOptions, with_log_options
from cpid_drake.commands.options import ForceOption, QuietOption, log_console
from cpid_drake.errors import InputError
from cpid_drake.output_files.drafts import draft_folder
from cpid_drake.output_files.overwriting import PAGE, PNG, SVG, Output, check_folder, check_outputs


@with_log_options
def report(
    source: Annotated[
        str,
        typer.Argument(
            metavar="RESULT|RUN|TELEMETRY",
            help="A result file of `cpid identify`, an output folder of `cpid simulate`, or a log.",
        ),
    ],
    out: Annotated[Path, typer.Option(metavar="FILE", help="HTML file to write.")],
    log: LogOptions,
    figures: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help="Write the figures there too, as PNG and SVG."),
    ] = None,
    force: ForceOption = False,
    quiet: QuietOption = False,
) -> None:
    """Write the report of an identification or of a simulated run, one self-contained HTML page.

    A log needs the options from --spacecraft to --capture-frame. A run can be identified with
    other options than its own. A result file has its own options.
    """
    inputs: list[str | Path] = [source, *log.files()]
    check_outputs([Output("--out", out, PAGE)], inputs, force=force)
    if not Path(source).exists():
        raise InputError(f"{source}: no such file or folder")
    request = log.request(source) if log.is_log(source) else None
    is_run = Path(source).is_dir()
    if request is None and not is_run and log.given():
        raise InputError(f"{log.given()[0]} is for logs and runs; a result has its own options")
    import logging

    from cpid_drake.identification.requests import identify_files
    from cpid_drake.report.figures import FIGURE_FILES, write_figures
    from cpid_drake.report.findings import findings_of, findings_of_file
    from cpid_drake.report.pages.identification import identification_report
    from cpid_drake.report.pages.run import run_report

    pictures = [(name, PNG if name.endswith("png") else SVG) for name in FIGURE_FILES]
    if figures is not None:
        check_folder("--figures", figures, pictures, inputs, force=force)
    logging.getLogger("drake").setLevel(logging.WARNING)
    console = log_console(quiet)
    with console.status("reading") as status:
        if request is None and is_run:
            page, findings = run_report(Path(source), status.update, log.applied_to)
        else:
            findings = (
                findings_of_file(source, status.update)
                if request is None
                else findings_of(identify_files([request], status.update), status.update)
            )
            page = identification_report(findings, progress=status.update)
        inputs += findings.files()
        check_outputs([Output("--out", out, PAGE)], inputs, force=force)
        if figures is not None:
            check_folder("--figures", figures, pictures, inputs, force=force)
        status.update("drawing")
        page.write(out)
        count = 0
        if figures is not None and findings.log is not None:
            with draft_folder(figures) as draft:
                count = len(write_figures(draft, findings.log, findings.truth))
    if findings.missing:
        console.print(f"note: the report has no sections that need the log: {findings.missing}")
    console.print(f"{out}" + (f", {count} figures in {figures}" if figures else ""))
