"""`cpid simulate`."""

import time

from cpid_drake.commands import options
from cpid_drake.errors import prefix_errors
from cpid_drake.resources import find_scenario


def simulate(
    scenario: options.ScenarioArgument,
    out: options.FolderOption,
    quiet: options.QuietOption = False,
) -> None:
    """Simulate a scenario; write the telemetry of its sensors and the true parameters."""
    start = time.perf_counter()
    path = find_scenario(scenario)
    from cpid_drake.scenario.files import load_scenario

    log = options.log_console(quiet)
    with log.status("reading the scenario") as status:
        loaded = load_scenario(path)
        from cpid_drake.scenario.run_files import refuse_other_files, request_of_run, write_run
        from cpid_drake.scenario.simulation import make_simulation

        with prefix_errors(scenario):
            simulation = make_simulation(loaded)
        options.make_folder(out)
        refuse_other_files(out)

        duration = loaded.simulation.duration
        context = simulation.run(
            lambda now: status.update(f"simulated {now.get_time():.1f} of {duration:g} s")
        )
        status.update("writing")
        files = write_run(simulation, context, out, time.perf_counter() - start)
    seconds = time.perf_counter() - start
    log.print(f"{len(files)} files in {out}, {seconds:.1f} s")
    if not quiet:
        print(request_of_run(loaded, out).command())
