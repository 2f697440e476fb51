"""`cpid view`."""

from pathlib import Path
from typing import Annotated

import typer
from pydrake.geometry import Meshcat, MeshcatParams
from pydrake.systems.framework import Context

from cpid_drake.commands import options
from cpid_drake.errors import InputError, prefix_errors
from cpid_drake.identification.identify_files import converge, identify_files
from cpid_drake.output_files.drafts import write_text
from cpid_drake.output_files.overwriting import check_outputs
from cpid_drake.report.live_view import serve
from cpid_drake.report.replay import estimate_text, motion_of, replay_html
from cpid_drake.report.run_folder import read_run
from cpid_drake.resources import find_scenario
from cpid_drake.scenario.files import files_of, load_scenario
from cpid_drake.scenario.limits import check_limits
from cpid_drake.scenario.simulation import make_simulation


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
    if log is not None and run is not None:
        raise InputError("give one of LOG and --run FOLDER")
    is_log = log is not None or run is not None
    if not is_log and (
        chosen.scenario is None or chosen != options.LogOptions(scenario=chosen.scenario)
    ):
        raise InputError("give --scenario alone, a log, or --run FOLDER")
    if is_log and out is None:
        raise InputError("a log has no live view: give --out FILE")
    outputs = [] if out is None else [("--out", out)]
    check_outputs(outputs, [log or run or "", *chosen.files()], force=force)
    console = options.log_console(quiet)
    with console.status("reading") as status:
        if is_log:
            if run is not None:
                read_run(run)
                chosen, log = chosen.of_run(run), str(run / "telemetry.csv")
            evidence = identify_files([chosen.request(str(log))], status.update)
            options.print_warnings(evidence.found.warnings)
            text, title = estimate_text(evidence.found), Path(str(log)).name
            estimates, craft = converge(evidence, status.update), evidence.inputs.spacecraft
            page = replay_html(craft, motion_of(evidence), estimates, title=title)
        else:
            name = str(chosen.scenario)
            scenario = load_scenario(find_scenario(name))
            check_outputs(outputs, files_of(scenario), force=force)
            duration = scenario.simulation.duration
            with prefix_errors(name):
                simulation = make_simulation(scenario)  # finds errors before a page is opened
                options.print_warnings(check_limits(simulation).exceeded)
            if out is None:
                try:
                    meshcat = Meshcat(MeshcatParams(host="*"))
                except RuntimeError as error:
                    raise InputError(f"Meshcat cannot be opened: {error}") from error
                typer.echo(f"Open {meshcat.web_url()}; Stop is in Open Controls", err=True)
                status.update("the page shows the simulation")
                serve(make_simulation(scenario, meshcat=meshcat), meshcat, rate)
                return
            estimates, period = [], max(0.25, duration / 60)  # of the numbers, [s]

            def record(root_context: Context) -> None:
                now = root_context.get_time()
                status.update(f"simulated {now:.1f} of {duration:g} s")
                if now + 1e-9 >= period * (len(estimates) + 1):
                    estimates.append((now, simulation.identification(root_context)))

            context = simulation.run(record)
            estimates.append((context.get_time(), simulation.identification(context)))
            truth, title = simulation.truth, Path(name).stem
            text = estimate_text(estimates[-1][1], truth)
            look = scenario.target.visual_model
            page = replay_html(
                simulation.spacecraft,
                simulation.telemetry(context),
                estimates,
                truth=truth,
                visual_model=look,
                title=title,
            )
    assert out is not None
    write_text(out, page)
    console.print(f"{out}, {len(page.encode()) / 1e6:.1f} MB")
    if not quiet:
        print(text)
