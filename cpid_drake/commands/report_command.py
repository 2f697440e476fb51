"""`cpid report`."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from cpid_drake.commands import options
from cpid_drake.files.errors import InputError
from cpid_drake.files.overwriting import check_outputs
from cpid_drake.identification.identify_files import identify_files
from cpid_drake.report.contents import collect_contents, collect_contents_of_file
from cpid_drake.report.pages.identification import identification_report
from cpid_drake.report.run_folder import read_run


def report(
    log: options.FileName | None = None,
    /,
    *,
    out: options.File,
    chosen: options.LogOptions = options.LogOptions(),
    result: Annotated[options.FileName | None, Parameter(metavar="FILE")] = None,
    run: options.Folder | None = None,
    force: options.Force = False,
    quiet: options.Quiet = False,
) -> None:
    """Write the report of an identification or of a simulated run, one HTML page.

    A log needs a spacecraft. A run can be identified with other options than its own. A result has
    the options of its identification, and its log is read again if it is still there.

    Args:
        log: A log: CSV, Parquet or ROS bag.
        out: HTML file to write.
        result: In place of a log: a result of `cpid identify --json`.
        run: In place of a log: a folder of `cpid simulate`.

    """
    if sum(each is not None for each in (log, result, run)) != 1:
        raise InputError("give one of LOG, --result FILE and --run FOLDER")
    if result is not None and chosen != options.LogOptions():
        raise InputError("--result has the options of its identification: give no others")

    def check(inputs: Sequence[str | Path | None]) -> None:
        check_outputs([("--out", out)], inputs, force=force)

    simulated = None if run is None else read_run(run)
    options_given = chosen if run is None else chosen.of_run(run)
    requests = [] if result else [options_given.request(log or f"{run}/telemetry.csv")]
    named = [file for each in requests for file in each.existing_files()]
    check([log, result, run, *options_given.files(), *named])
    console = options.log_console(quiet)
    with console.status("reading") as status:
        if result is not None:
            contents = collect_contents_of_file(result, status.update)
        else:
            evidence = identify_files(requests, status.update)
            contents = collect_contents(evidence, status.update, simulated)
        page = identification_report(contents, status.update)
        check([log, result, run, *contents.files()])
        status.update("drawing")
        page.write(out)
    if contents.missing:
        console.print(f"note: the report has no sections that need the log: {contents.missing}")
    console.print(f"{out}")
