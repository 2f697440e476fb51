"""`cpid scenario`: checks, prints and creates scenario files."""

from pathlib import Path
from typing import Annotated

import typer

from cpid_drake.commands.options import ForceOption, ScenarioArgument, print_warnings
from cpid_drake.errors import prefix_errors
from cpid_drake.output_files.drafts import write_text
from cpid_drake.output_files.overwriting import YAML, Output, check_outputs
from cpid_drake.resources import find_scenario

scenario = typer.Typer(no_args_is_help=True, help="Check, print or create a scenario file.")


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


@scenario.command()
def show(file: ScenarioArgument) -> None:
    """Print a scenario as YAML, with the default values of the keys that it leaves out."""
    path = find_scenario(file)
    from cpid_drake.scenario.files import dump_scenario, load_scenario

    print(dump_scenario(load_scenario(path)), end="")


@scenario.command()
def new(
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="File to write. Default: print it.")
    ] = None,
    force: ForceOption = False,
) -> None:
    """Write a template of a scenario; its comments give units and choices."""
    from cpid_drake.resources import models_directory

    text = (models_directory() / "scenario_template.yaml").read_text(encoding="utf-8")
    if out is None:
        print(text, end="")
        return
    check_outputs([Output("--out", out, YAML)], force=force)
    write_text(out, text)
