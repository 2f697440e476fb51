"""`cpid view`."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from cpid_drake.commands import options
from cpid_drake.errors import InputError, prefix_errors
from cpid_drake.identification.identify_files import converge, identify_files
from cpid_drake.identification.request import Request
from cpid_drake.identification.result import Identification
from cpid_drake.output_files.drafts import write_text
from cpid_drake.output_files.overwriting import check_outputs
from cpid_drake.report.live_view import serve
from cpid_drake.report.replay import estimate_text, record_simulation, replay_html
from cpid_drake.report.run_folder import read_run
from cpid_drake.report.sections.replay import motion_of
from cpid_drake.resources import find_scenario
from cpid_drake.scenario.files import files_of, load_scenario
from cpid_drake.scenario.limits import check_limits
from cpid_drake.scenario.simulation import make_simulation
from cpid_drake.systems.scene_visualizer import open_meshcat


@options.with_options
def view(
    chosen: options.LogOptions,
    log: Annotated[
        str | None, typer.Argument(metavar="[LOG]", help=f"A log: {options.LOG_KINDS}")
    ] = None,
    run: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help="In place of a log: a folder of `cpid simulate`."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Write a replay, one HTML file that plays offline."),
    ] = None,
    rate: Annotated[
        float,
        typer.Option(min=0.1, max=5.0, help="Ratio of simulated to real time in the live view."),
    ] = 1.0,
    force: options.ForceOption = False,
    quiet: options.QuietOption = False,
) -> None:
    """Show a scenario live in the browser, or write the replay of a scenario or a log.

    Without a log, --scenario is simulated: live, or with --out as a replay. A log or a run is
    identified, and needs --out.
    """
    outputs = [] if out is None else [("--out", out)]
    if log is not None and run is not None:
        raise InputError("give one of LOG and --run FOLDER")
    console = options.log_console(quiet)
    page: str | None
    if log is None and run is None:
        if chosen.scenario is None or chosen != options.LogOptions(scenario=chosen.scenario):
            raise InputError("give --scenario alone, a log, or --run FOLDER")
        page, text = _show_scenario(chosen.scenario, outputs, force, rate, console)
    else:
        if out is None:
            raise InputError("a log has no live view: give --out FILE")
        check_outputs(outputs, [log or run or "", *chosen.files()], force=force)
        if run is not None:
            read_run(run)
            request = chosen.of_run(run).request(str(run / "telemetry.csv"))
        else:
            request = chosen.request(str(log))
        page, text = _replay_log(request, console)
    if out is not None and page is not None:
        write_text(out, page)
        console.print(f"{out}, {len(page.encode()) / 1e6:.1f} MB")
    if not quiet:
        print(text)


def _replay_log(request: Request, console: Console) -> tuple[str, str]:
    """Return the page of a log, and the estimate as text."""
    with console.status("identifying") as status:
        evidence = identify_files([request], status.update)
        estimates = converge(evidence, status.update)
        status.update("drawing")
        title = Path(request.telemetry).name
        craft = evidence.inputs.spacecraft
        page = replay_html(craft, motion_of(evidence), estimates, title=title)
    options.print_warnings(evidence.found.warnings)
    return page, estimate_text(evidence.found)


def _show_scenario(
    name: str, outputs: list[tuple[str, Path]], force: bool, rate: float, console: Console
) -> tuple[str | None, str]:
    """Show a scenario live, or return its page; and return the estimate as text."""
    path, text = find_scenario(name), "no run"
    scenario = load_scenario(path)
    check_outputs(outputs, [path, *files_of(scenario)], force=force)
    duration = scenario.simulation.duration
    with console.status("reading the model") as status:
        with prefix_errors(name):
            simulation = make_simulation(scenario)  # finds errors before a page is opened
            options.print_warnings(check_limits(simulation).exceeded)
        if outputs:
            page, last = record_simulation(
                scenario,
                lambda time: status.update(f"simulated {time:.1f} of {duration:g} s"),
                title=Path(name).stem,
            )
            return page, estimate_text(last, simulation.truth)
        meshcat = open_meshcat("*")
        typer.echo(f"Open {meshcat.web_url()} and use Run and Stop in Open Controls", err=True)
        status.update("waiting for Run")

        def on_estimate(time: float, identification: Identification) -> None:
            nonlocal text
            text = estimate_text(identification, simulation.truth)
            line = "; ".join(line.strip() for line in text.splitlines())
            status.update(f"{time:.1f} of {duration:g} s; {line}")

        serve(make_simulation(scenario, meshcat=meshcat), meshcat, rate, on_estimate)
    return None, text
