"""`cpid view`."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter
from cyclopts.validators import Number as Within

from cpid_drake.commands import options
from cpid_drake.files.drafts import write_text
from cpid_drake.files.errors import prefix_errors
from cpid_drake.files.overwriting import check_outputs
from cpid_drake.files.resources import find_scenario
from cpid_drake.report.live_page import LivePage
from cpid_drake.report.live_server import LOCAL
from cpid_drake.report.live_view import serve
from cpid_drake.report.replay import estimate_text, simulation_replay
from cpid_drake.simulation.limits import check_limits
from cpid_drake.simulation.scenario_files import files_of, load_scenario
from cpid_drake.simulation.simulation import make_simulation


def view(
    scenario: options.Scenario,
    /,
    *,
    out: options.File | None = None,
    rate: Annotated[options.Number, Parameter(validator=Within(gte=0.1, lte=5.0))] = 1.0,
    host: options.Host = LOCAL,
    force: options.Force = False,
    quiet: options.Quiet = False,
) -> None:
    """Show the simulation of a scenario live in the browser, or write its replay.

    The replay of a log is in its report, see `cpid report`.

    Args:
        out: Write a replay, one HTML file that plays offline.
        rate: Ratio of simulated to real time in the live view.

    """
    path = find_scenario(scenario)
    loaded, console = load_scenario(path), options.log_console(quiet)
    check_outputs([("--out", out)], [path, *files_of(loaded)], force=force)
    with console.status("reading the model") as status:
        with prefix_errors(scenario):
            simulation = make_simulation(loaded)  # finds errors before a page is opened
            options.print_warnings(check_limits(simulation).exceeded)
        if out is None:
            name = Path(scenario).stem
            with LivePage(name, host=host, truth=simulation.truth) as live:
                console.print("Stop is in Open Controls")
                serve(simulation, live, rate)
            return
        page, answer = simulation_replay(simulation, Path(scenario).stem, status.update)
    write_text(out, page)
    console.print(f"{out}, {len(page.encode()) / 1e6:.1f} MB")
    if not quiet:
        print(estimate_text(answer, simulation.truth))
