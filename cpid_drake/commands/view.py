"""`cpid view`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from cpid_drake.commands import options
from cpid_drake.commands.forecast import Forecast
from cpid_drake.commands.log_options import LogOptions, with_log_options
from cpid_drake.errors import InputError, prefix_errors
from cpid_drake.output_files.drafts import write_text
from cpid_drake.output_files.overwriting import PAGE, Output, check_outputs
from cpid_drake.resources import find_scenario

if TYPE_CHECKING:
    from cpid_drake.identification.result import Identification, Request
    from cpid_drake.scenario.schema import Scenario

LARGE_PAGE = 10_000_000
"""Size [bytes] of a page above which a warning is printed, because a large page is hard to send."""


@with_log_options
def view(
    source: Annotated[
        str,
        typer.Argument(
            metavar="SCENARIO|RUN|TELEMETRY",
            help="A scenario file, the name of a shipped scenario, an output folder of "
            "`cpid simulate`, or a log.",
        ),
    ],
    log: LogOptions,
    html: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Write a replay, one HTML file that plays offline."),
    ] = None,
    live: Annotated[
        bool, typer.Option("--live", help="With --html: show the live view first.")
    ] = False,
    rate: Annotated[
        float, typer.Option(help="Initial ratio of simulated to real time in the live view.")
    ] = 1.0,
    force: options.ForceOption = False,
    quiet: options.QuietOption = False,
) -> None:
    """Show a scenario live in the browser, or write the replay of a scenario, a run or a log.

    A log needs the options from --spacecraft to --capture-frame. The options from --estimator to
    --leave-out-bad are for logs and runs.
    """
    outputs = [] if html is None else [Output("--html", html, PAGE)]
    inputs: list[str | Path] = [source, *log.files()]
    check_outputs(outputs, inputs, force=force)
    if not 0.1 <= rate <= 5:
        raise InputError(f"--rate {rate:g}: must be from 0.1 to 5")
    console = options.log_console(quiet)
    page: str | None
    is_log, is_run = log.is_log(source), Path(source).is_dir()
    if is_log or is_run:
        if is_log:
            request = log.request(source)
        if html is None or live:
            raise InputError(f"{source}: a log has no live view: give --html FILE, not --live")
        if not is_log:
            from cpid_drake.report.run_folder import read_run
            from cpid_drake.scenario.run_files import request_of_run

            request = log.applied_to(request_of_run(read_run(Path(source)).scenario, Path(source)))
        page, text = _replay_log(request, console)
    else:
        if log.given():
            raise InputError(f"{log.given()[0]} is for logs; a scenario file has its own setting")
        path = find_scenario(source)
        from cpid_drake.scenario.files import files_of, load_scenario

        scenario = load_scenario(path)
        check_outputs(outputs, [path, *files_of(scenario)], force=force)
        page, text = _show_scenario(
            scenario, source, html is not None, html is None or live, rate, console
        )
    if html is not None and page is not None:
        write_text(html, page)
        size = html.stat().st_size
        console.print(f"{html}, {size / 1e6:.1f} MB")
        if size > LARGE_PAGE:
            options.log_console().print("warning: the model's meshes make the page large")
    if not quiet:
        print(text)


def _replay_log(request: "Request", console: Console) -> tuple[str, str]:
    """Return the page of a log, and the estimate as text."""
    from cpid_drake.identification.convergence import converge
    from cpid_drake.identification.requests import identify_files
    from cpid_drake.report.replay import estimate_text, replay_html
    from cpid_drake.report.sections.replay import motion_of

    with console.status("identifying") as status:
        evidence = identify_files([request], status.update)
        estimates = converge(evidence, status.update)
        status.update("drawing")
        title = Path(request.telemetry).name
        craft = evidence.inputs.spacecraft
        page = replay_html(craft, motion_of(evidence), estimates, title=title)
    for warning in evidence.found.warnings:
        options.log_console().print(f"warning: {warning}")
    return page, estimate_text(evidence.found)


def _show_scenario(
    scenario: "Scenario", source: str, as_page: bool, as_live: bool, rate: float, console: Console
) -> tuple[str | None, str]:
    """Return the page of a scenario, if it is wanted, and the estimate as text."""
    page, text = None, "no run"
    with console.status("reading the scenario") as status:
        from cpid_drake.report.live_view import LiveView
        from cpid_drake.report.replay import estimate_text, replay_simulation
        from cpid_drake.scenario.limits import check_limits
        from cpid_drake.scenario.simulation import make_simulation
        from cpid_drake.systems.scene_visualizer import open_meshcat

        with prefix_errors(source):
            simulation = make_simulation(scenario)  # finds errors before a page is opened
            options.print_warnings(check_limits(simulation).exceeded)
        duration = scenario.simulation.duration
        if as_live:
            meshcat = open_meshcat("*")
            live = LiveView(make_simulation(scenario, meshcat=meshcat), meshcat, rate)
            typer.echo(
                f"Open {meshcat.web_url()} and use Start and Stop in Open Controls", err=True
            )
            status.update("waiting for Start")

            def on_frame(time: float, identification: "Identification") -> None:
                nonlocal text
                text = estimate_text(identification, simulation.truth)
                line = "; ".join(line.strip() for line in text.splitlines())
                status.update(f"{time:.1f} of {duration:g} s; {line}")

            live.serve(on_frame)
        if as_page:
            forecast = Forecast(f"{duration:g} s of motion take", duration, console.print)

            def progress(time: float) -> None:
                status.update(f"simulated {time:.1f} of {duration:g} s")
                forecast.update(time)

            page, last = replay_simulation(
                simulation,
                progress,
                title=Path(source).stem,
            )
            text = estimate_text(last, simulation.truth)
    return page, text
