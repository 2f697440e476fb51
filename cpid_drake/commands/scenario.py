"""`cpid scenario`: checks, prints and creates scenario files."""

from pathlib import Path
from typing import Annotated

import typer

from cpid_drake.commands.options import ScenarioArgument
from cpid_drake.errors import InputError, prefix_errors
from cpid_drake.resources import find_scenario

scenario = typer.Typer(no_args_is_help=True, help="Check, print or create a scenario file.")


@scenario.command()
def check(file: ScenarioArgument) -> None:
    """Check a scenario and all that it refers to: model, joint motion, sensors."""
    path = find_scenario(file)
    from cpid_drake.scenario.files import load_scenario

    loaded = load_scenario(path)
    from cpid_drake.scenario.simulation import make_simulation

    with prefix_errors(file):
        simulation = make_simulation(loaded)
    suite, spacecraft = simulation.sensors and simulation.sensors.suite, simulation.spacecraft
    facts = (
        f"spacecraft of {spacecraft.mass:g} kg with {len(spacecraft.joint_names)} joints",
        f"target of {simulation.truth.mass:g} kg",
        f"{type(loaded.joint_motion).__name__} of {simulation.joint_motion.duration:g} s",
        f"simulation of {loaded.simulation.duration:g} s",
        f"sensors: {', '.join(suite.present())}" if suite else "no sensors",
        f"estimator: {loaded.identification.estimator}",
    )
    print(f"{file}: ok, {'; '.join(facts)}")


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
) -> None:
    """Write a template of a scenario; its comments give units and choices."""
    from cpid_drake.resources import models_directory

    text = (models_directory() / "scenario_template.yaml").read_text(encoding="utf-8")
    if out is None:
        print(text, end="")
        return
    try:
        with out.open("x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError as error:
        raise InputError(f"--out {out}: exists already; give another name") from error
    except OSError as error:
        raise InputError(f"--out {out}: cannot write there: {error.strerror}") from error
