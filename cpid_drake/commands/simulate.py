"""`cpid simulate`."""

import time

from cpid_drake.commands.options import (
    FolderOption,
    QuietOption,
    ScenarioArgument,
    log_console,
    make_folder,
)
from cpid_drake.errors import prefix_errors
from cpid_drake.scenario.shipped import find_scenario


def simulate(scenario: ScenarioArgument, out: FolderOption, quiet: QuietOption = False) -> None:
    """Simulate a scenario; write the telemetry of its sensors and the true parameters."""
    start = time.perf_counter()
    path = find_scenario(scenario)
    from cpid_drake.scenario.files import load_scenario

    log = log_console(quiet)
    with log.status("reading the scenario") as status:
        loaded = load_scenario(path)
        from cpid_drake.scenario.run_files import identify_command, refuse_other_files, write_run
        from cpid_drake.scenario.simulation import make_simulation

        with prefix_errors(scenario):
            simulation = make_simulation(loaded)
        make_folder(out)
        refuse_other_files(out)

        def progress(simulated: float) -> None:
            status.update(f"simulated {simulated:.1f} of {loaded.simulation.duration:g} s")

        context = simulation.run(progress)
        status.update("writing")
        files = write_run(simulation, context, out, time.perf_counter() - start)
    seconds = time.perf_counter() - start
    log.print(f"{len(files)} files in {out}, {seconds:.1f} s")
    if not quiet:
        print(identify_command(simulation, out))
