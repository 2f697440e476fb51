"""`cpid view`."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter
from cyclopts.validators import Number as Within
from pydrake.systems.framework import Context

from cpid_drake.commands import options
from cpid_drake.files.drafts import write_text
from cpid_drake.files.errors import prefix_errors
from cpid_drake.files.overwriting import check_outputs
from cpid_drake.files.resources import find_scenario
from cpid_drake.identification.result import Identification
from cpid_drake.report.live_view import serve
from cpid_drake.report.replay import estimate_text, replay_html
from cpid_drake.simulation.files import files_of, load_scenario
from cpid_drake.simulation.limits import check_limits
from cpid_drake.simulation.simulation import make_simulation


def view(
    scenario: options.Scenario,
    /,
    *,
    out: options.File | None = None,
    rate: Annotated[options.Number, Parameter(validator=Within(gte=0.1, lte=5.0))] = 1.0,
    force: options.Force = False,
    quiet: options.Quiet = False,
) -> None:
    """Show the simulation of a scenario live in the browser, or write its replay.

    The replay of a log is in its report, see `cpid report`.

    Args:
        out: Write a replay, one HTML file that plays offline.
        rate: Ratio of simulated to real time in the live view.

    """
    outputs, path = [("--out", out)], find_scenario(scenario)
    check_outputs(outputs, [path], force=force)
    loaded, console = load_scenario(path), options.log_console(quiet)
    check_outputs(outputs, files_of(loaded), force=force)
    duration, estimates = loaded.simulation.duration, list[tuple[float, Identification]]()
    with console.status("reading the model") as status:
        with prefix_errors(scenario):
            simulation = make_simulation(loaded)  # finds errors before a page is opened
            options.print_warnings(check_limits(simulation).exceeded)
        if out is None:
            meshcat = options.open_meshcat("; Stop is in Open Controls")
            serve(make_simulation(loaded, meshcat=meshcat), meshcat, rate)
            return

        def record(root_context: Context) -> None:
            now = root_context.get_time()
            status.update(f"simulated {now:.1f} of {duration:g} s")
            if now + 1e-9 >= max(0.25, duration / 60) * (len(estimates) + 1):
                estimates.append((now, simulation.identification(root_context)))

        context = simulation.run(record)
        estimates.append((context.get_time(), simulation.identification(context)))
        page = replay_html(
            simulation.spacecraft,
            simulation.motion(context),
            estimates,
            truth=simulation.truth,
            visual_model=loaded.target.visual_model,
            title=Path(scenario).stem,
        )
    write_text(out, page)
    console.print(f"{out}, {len(page.encode()) / 1e6:.1f} MB")
    if not quiet:
        print(estimate_text(estimates[-1][1], simulation.truth))
