"""`cpid scenario`: check, show and begin scenario files."""

from pathlib import Path
from typing import Annotated

import typer

from cpid_drake.errors import InputError

scenario = typer.Typer(no_args_is_help=True, help="Check, show or begin a scenario file.")

_Scenario = Annotated[
    str, typer.Argument(metavar="SCENARIO", help="A scenario file, or a shipped one's name.")
]


@scenario.command()
def check(file: _Scenario) -> None:
    """Read a scenario and all that it names: model, motion, sensors. Say what is wrong, if any."""
    from cpid_drake.scenario.files import load_scenario
    from cpid_drake.scenario.naming import naming
    from cpid_drake.scenario.shipped import find_scenario
    from cpid_drake.scenario.simulation import make_simulation

    loaded = load_scenario(find_scenario(file))
    with naming(file):
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
def show(file: _Scenario) -> None:
    """Print a scenario with the defaults of all that it leaves out, as YAML."""
    from cpid_drake.scenario.files import dump_scenario, load_scenario
    from cpid_drake.scenario.shipped import find_scenario

    print(dump_scenario(load_scenario(find_scenario(file))), end="")


@scenario.command()
def new(
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="File to write; default: print it.")
    ] = None,
) -> None:
    """Write a scenario to start from, with comments that say units and choices."""
    from cpid_drake.resources import models_directory

    text = (models_directory() / "scenario_template.yaml").read_text(encoding="utf-8")
    if out is None:
        print(text, end="")
        return
    try:
        with out.open("x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError as error:
        raise InputError(f"--out {out}: is there already; give another name") from error
    except OSError as error:
        raise InputError(f"--out {out}: cannot write there: {error.strerror}") from error
