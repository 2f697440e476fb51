"""`cpid simulate`."""

import time
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from cpid_drake.commands.folders import make_folder


def simulate(
    scenario: Annotated[
        str, typer.Argument(metavar="SCENARIO", help="A scenario file, or a shipped one's name.")
    ],
    out: Annotated[Path, typer.Option(help="Folder for the run's files; made if needed.")],
    quiet: Annotated[bool, typer.Option("--quiet", help="Print nothing.")] = False,
) -> None:
    """Simulate a scenario: telemetry as its sensors give it, and the truth to compare with."""
    start = time.perf_counter()
    from cpid_drake.scenario.files import load_scenario
    from cpid_drake.scenario.naming import naming
    from cpid_drake.scenario.run_files import identify_command, refuse_other_files, write_run
    from cpid_drake.scenario.shipped import find_scenario
    from cpid_drake.scenario.simulation import make_simulation

    log = Console(stderr=True, quiet=quiet, markup=False)
    with log.status("reading the scenario") as status:
        loaded = load_scenario(find_scenario(scenario))
        with naming(scenario):
            simulation = make_simulation(loaded)
        make_folder(out)
        refuse_other_files(out)

        def progress(simulated: float) -> None:
            status.update(f"simulated {simulated:.1f} of {loaded.simulation.duration:g} s")

        context = simulation.run(progress)
        status.update("writing")
        files = write_run(simulation, context, out, time.perf_counter() - start)
    seconds = time.perf_counter() - start
    log.print(f"{len(files)} files in {out}, {seconds:.1f} s", highlight=False, soft_wrap=True)
    if not quiet:
        print(identify_command(simulation, out))
