"""`cpid simulate`."""

import shlex
import time

from pydrake.systems.framework import Context

from cpid_drake.commands import options
from cpid_drake.commands.options import CHECK_FAILED
from cpid_drake.files.errors import InputError, prefix_errors
from cpid_drake.files.overwriting import check_folder
from cpid_drake.files.resources import find_scenario
from cpid_drake.simulation.limits import LimitCheck, check_limits
from cpid_drake.simulation.run_files import RUN_FILES, write_run
from cpid_drake.simulation.scenario_files import files_of, load_scenario
from cpid_drake.simulation.simulation import Simulation, make_simulation


def simulate(
    scenario: options.Scenario,
    /,
    *,
    out: options.OutFolder | None = None,
    check: bool = False,
    force: options.Force = False,
    quiet: options.Quiet = False,
) -> int:
    """Simulate a scenario; write the log of its sensors and the true parameters.

    Warnings name the limits of the spacecraft's model that the joint motion exceeds: positions,
    rates and efforts of the joints, and distances between bodies.

    Args:
        check: Simulate nothing, but check the scenario with all that it refers to; exit with code 4
            if the joint motion exceeds a limit.

    """
    start = time.perf_counter()
    if (out is None) != check:
        raise InputError("give --out FOLDER, or --check to simulate nothing")
    path = find_scenario(scenario)
    check_folder("--out", out, names=[])
    loaded = load_scenario(path)
    check_folder("--out", out, [path, *files_of(loaded)], names=RUN_FILES, force=force)
    log = options.log_console(quiet)
    with log.status("reading the model") as status:
        with prefix_errors(scenario):
            simulation = make_simulation(loaded)
            limits = check_limits(simulation)
        if out is None:
            print(f"{scenario}: {'; '.join(_facts(simulation, limits))}")
            options.print_warnings([*limits.exceeded, *simulation.left_out])
            return CHECK_FAILED if limits.exceeded else 0
        options.print_warnings([*limits.exceeded, *simulation.left_out])

        def progress(now: Context) -> None:
            status.update(f"simulated {now.get_time():.1f} of {loaded.simulation.duration:g} s")

        context = simulation.run(progress)
        files = write_run(simulation, context, out, time.perf_counter() - start, limits)
    log.print(f"{len(files)} files in {out}, {time.perf_counter() - start:.1f} s")
    if not quiet:
        words = ["cpid", "identify", out / "telemetry.csv", "--spacecraft", out / "scenario.yaml"]
        words += ["--sensors", out / "sensors.yaml"] if simulation.sensors else []
        print(shlex.join(map(str, words)))
    return 0


def _facts(simulation: Simulation, limits: LimitCheck) -> tuple[str, ...]:
    """Return the verdict on a scenario, and what its simulation contains."""
    scenario, spacecraft = simulation.scenario, simulation.spacecraft
    suite, count = simulation.sensors and simulation.sensors.suite, len(limits.exceeded)
    return (
        "ok" if not count else f"{count} limit{'s' * (count > 1)} exceeded",
        f"spacecraft of {spacecraft.mass:g} kg with {len(spacecraft.joint_names)} joints",
        f"target of {simulation.truth.mass:g} kg",
        f"{type(scenario.joint_motion).__name__} of {simulation.joint_motion.duration:g} s",
        f"simulation of {scenario.simulation.duration:g} s",
        f"sensors: {', '.join(suite.present())}" if suite else "no sensors",
        f"estimator: {scenario.online_estimator}",
        *([f"closest bodies: {limits.closest}"] if limits.closest else []),
        *(f"not checked: {what}" for what in limits.unchecked),
    )
