"""`cpid campaign`: runs many simulated trials, and reports them."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from cpid_drake.commands import options
from cpid_drake.commands.groups import group
from cpid_drake.files.overwriting import check_outputs

campaign = group("campaign")


@campaign.command
def run(
    campaign: options.FileName,
    /,
    *,
    out: options.OutFolder,
    resume: bool = False,
    workers: options.Count | None = None,
    scheduler: Annotated[str | None, Parameter(metavar="ADDRESS")] = None,
    chunk: options.Count | None = None,
    quiet: options.Quiet = False,
) -> None:
    """Run many simulated trials, on this machine or on a cluster; nothing finished is lost.

    Args:
        campaign: YAML file of a campaign; see models/campaigns.
        resume: Continue the campaign in the folder.
        workers: Number of processes. Default: one for each processor.
        scheduler: A running scheduler of dask.distributed, such as tcp://…
        chunk: Trials of a task and of a file.

    """
    with options.extra("campaign"):
        from cpid_drake.campaign.run import CHUNK, State, run_campaign
    log = options.log_console(quiet)
    with log.status("starting workers") as status:

        def progress(state: State) -> None:
            if not state.new and state.dashboard:
                log.print(f"dashboard: {state.dashboard}")
            rate = f"{state.new / state.seconds:.3g} trials/s, " if state.new else ""
            status.update(
                f"{state.done} of {state.total} trials, {rate}{state.failed} without estimate"
            )

        ended = run_campaign(
            campaign,
            out,
            resume=resume,
            workers=workers,
            scheduler=scheduler,
            chunk=CHUNK if chunk is None else chunk,
            progress=progress,
        )
    failed = f", {ended.failed} without estimate" if ended.failed else ""
    log.print(f"{out}: {ended.done} trials, {ended.new} now in {ended.seconds:.1f} s{failed}")
    log.print(f"report: cpid campaign report {out}")


@campaign.command(name="report")
def write_report(
    folder: Path, /, *, force: options.Force = False, quiet: options.Quiet = False
) -> None:
    """Report a campaign: errors, coverage, checks, worst cases, verdicts on its requirements.

    Args:
        folder: The folder of a campaign.

    """
    with options.extra("campaign"):
        from cpid_drake.campaign.statistics import statistics_of
        from cpid_drake.report.pages.campaign_page import campaign_report
        from cpid_drake.report.terminal import print_tables
    check_outputs([("", folder / "report.html")], force=force)
    page = campaign_report(statistics_of(folder), folder)
    page.write_folder(folder)
    if not quiet:
        print_tables(page)
