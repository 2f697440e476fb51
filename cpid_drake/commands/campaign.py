"""`cpid campaign`: runs many simulated trials, and reports them."""

from pathlib import Path
from typing import Annotated

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from cpid_drake import report
from cpid_drake.commands import options
from cpid_drake.commands.usage import group
from cpid_drake.files.overwriting import check_outputs


def run_trials(
    campaign: Annotated[str, "CAMPAIGN", "YAML file of a campaign; see models/campaigns."],
    out: options.OutFolder,
    resume: Annotated[bool, "Continue the campaign in the folder."] = False,
    workers: Annotated[int | None, "Number of processes. Default: one for each processor."] = None,
    scheduler: Annotated[
        str | None,
        "--scheduler ADDRESS",
        "A running scheduler of dask.distributed, such as tcp://…",
    ] = None,
    chunk: Annotated[int | None, "Trials of a task and of a file."] = None,
    quiet: options.QuietOption = False,
) -> None:
    """Run many simulated trials, on this machine or on a cluster; nothing finished is lost."""
    with options.extra("campaign"):
        from cpid_drake.campaign import run
    log = options.log_console(quiet)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
    with Progress(*columns, TimeRemainingColumn(), console=log, disable=not log.is_terminal) as bar:
        task = bar.add_task("trials")

        def progress(state: run.State) -> None:
            if not state.new and state.dashboard:
                log.print(f"dashboard: {state.dashboard}")
            rate = f"{state.new / state.seconds:.3g} trials/s" if state.new else "trials"
            text = f"{rate}, {state.failed} without estimate"
            bar.update(task, completed=state.done, total=state.total, description=text)

        ended = run.run_campaign(
            campaign,
            out,
            resume=resume,
            workers=workers,
            scheduler=scheduler,
            chunk=run.CHUNK if chunk is None else chunk,
            progress=progress,
        )
    failed = f", {ended.failed} without estimate" if ended.failed else ""
    log.print(f"{out}: {ended.done} trials, {ended.new} now in {ended.seconds:.1f} s{failed}")
    log.print(f"report: cpid campaign report {out}")


def write_page(
    folder: Annotated[Path, "FOLDER", "The folder of a campaign."],
    force: options.ForceOption = False,
    quiet: options.QuietOption = False,
) -> None:
    """Report a campaign: errors, coverage, checks, worst cases, verdicts on its requirements."""
    with options.extra("campaign"):
        from cpid_drake.campaign.statistics import statistics_of
        from cpid_drake.report.pages.campaign import campaign_report
    check_outputs([("", folder / "report.html")], force=force)
    page = campaign_report(statistics_of(folder), folder)
    page.write_folder(folder)
    if not quiet:
        report.print_tables(page)


campaign = group(
    "Run many simulated trials, and report their errors.", run=run_trials, report=write_page
)
