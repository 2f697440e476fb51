"""`cpid simulate`."""

import time
from typing import TYPE_CHECKING

from cpid_drake.commands import options
from cpid_drake.commands.forecast import Forecast
from cpid_drake.errors import prefix_errors
from cpid_drake.output_files.overwriting import check_folder
from cpid_drake.resources import find_scenario

if TYPE_CHECKING:
    from pydrake.systems.framework import Context


def simulate(
    scenario: options.ScenarioArgument,
    out: options.FolderOption,
    force: options.ForceOption = False,
    quiet: options.QuietOption = False,
) -> None:
    """Simulate a scenario; write the telemetry of its sensors and the true parameters.

    Warnings name the limits of the spacecraft's model that the joint motion exceeds.
    """
    start = time.perf_counter()
    path = find_scenario(scenario)
    check_folder("--out", out, [], [path])
    from cpid_drake.scenario.files import files_of, load_scenario

    log = options.log_console(quiet)
    with log.status("reading the scenario") as status:
        loaded = load_scenario(path)
        from cpid_drake.scenario.limits import check_limits
        from cpid_drake.scenario.run_files import request_of_run, run_outputs, write_run
        from cpid_drake.scenario.simulation import make_simulation

        inputs = [path, *files_of(loaded)]
        check_folder("--out", out, run_outputs(out), inputs, force=force)
        with prefix_errors(scenario):
            simulation = make_simulation(loaded)
            limits = check_limits(simulation)
        options.print_warnings(limits.exceeded)
        duration = loaded.simulation.duration
        forecast = Forecast(f"{duration:g} s of motion take", duration, log.print)

        def progress(now: "Context") -> None:
            status.update(f"simulated {now.get_time():.1f} of {duration:g} s")
            forecast.update(now.get_time())

        context = simulation.run(progress)
        status.update("writing")
        files = write_run(simulation, context, out, time.perf_counter() - start, limits)
    seconds = time.perf_counter() - start
    log.print(f"{len(files)} files in {out}, {seconds:.1f} s")
    if not quiet:
        print(request_of_run(loaded, out).command())
