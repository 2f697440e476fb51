"""`cpid scenario check`."""

from typing import Annotated

import typer

from cpid_drake.commands.options import ScenarioArgument, print_warnings
from cpid_drake.errors import prefix_errors
from cpid_drake.resources import find_scenario

scenario = typer.Typer(no_args_is_help=True, help="Check a scenario file.")


@scenario.callback()
def _only_commands() -> None:
    """Check a scenario file."""


@scenario.command()
def check(
    file: ScenarioArgument,
    strict: Annotated[
        bool, typer.Option("--strict", help="Exit with code 1 if a limit is exceeded.")
    ] = False,
) -> None:
    """Check a scenario and all that it refers to: model, joint motion, sensors, limits.

    The limits are those of the joints' positions, rates and efforts in the model, and the distances
    between bodies. A scenario that exceeds a limit can be simulated all the same.
    """
    path = find_scenario(file)
    from cpid_drake.scenario.files import load_scenario

    loaded = load_scenario(path)
    from cpid_drake.scenario.limits import check_limits
    from cpid_drake.scenario.simulation import make_simulation

    with prefix_errors(file):
        simulation = make_simulation(loaded)
        limits = check_limits(simulation)
    suite, spacecraft = simulation.sensors and simulation.sensors.suite, simulation.spacecraft
    facts = (
        f"spacecraft of {spacecraft.mass:g} kg with {len(spacecraft.joint_names)} joints",
        f"target of {simulation.truth.mass:g} kg",
        f"{type(loaded.joint_motion).__name__} of {simulation.joint_motion.duration:g} s",
        f"simulation of {loaded.simulation.duration:g} s",
        f"sensors: {', '.join(suite.present())}" if suite else "no sensors",
        f"estimator: {loaded.online_estimator}",
        *([f"closest bodies: {limits.closest}"] if limits.closest else []),
        *(f"not checked: {what}" for what in limits.unchecked),
    )
    count = len(limits.exceeded)
    verdict = "ok" if not count else f"{count} limit{'s' * (count > 1)} exceeded"
    print(f"{file}: {verdict}, {'; '.join(facts)}")
    print_warnings(limits.exceeded)
    if strict and limits.exceeded:
        raise typer.Exit(1)
