"""`cpid study`: the paper's study, many trials of all estimators, other techniques."""

import os
import time
from typing import Annotated

import typer
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from cpid_drake.commands import options
from cpid_drake.errors import prefix_errors
from cpid_drake.output_files.drafts import draft_folder
from cpid_drake.output_files.overwriting import check_folder
from cpid_drake.report.page import Report
from cpid_drake.report.pages.study import (
    accuracy_report,
    paper_report,
    technique_report,
    write_study,
    write_techniques,
)
from cpid_drake.report.terminal import print_table
from cpid_drake.resources import find_scenario
from cpid_drake.scenario.files import files_of, load_scenario
from cpid_drake.scenario.limits import check_limits
from cpid_drake.scenario.simulation import make_simulation
from cpid_drake.studies.accuracy import run_accuracy
from cpid_drake.studies.accuracy import summarize as summarize_accuracy
from cpid_drake.studies.paper import run_paper_study, summarize
from cpid_drake.studies.paper_values import EXCITING
from cpid_drake.studies.techniques.comparison import run_comparison
from cpid_drake.studies.techniques.force_sensors import SHIPPED, load_force_sensors

study = typer.Typer(
    no_args_is_help=True,
    help="Reproduce the paper's study, or compare estimators and techniques on many noisy logs.",
)


@study.command()
def paper(
    out: options.OutFolder,
    scenario: Annotated[
        str,
        typer.Option(
            metavar="SCENARIO", help="A scenario file, or the name of a shipped scenario."
        ),
    ] = "paper",
    force: options.ForceOption = False,
    quiet: options.QuietOption = False,
) -> None:
    """Reproduce the study of Ning et al. 2016: simulate, identify, print tables, draw figures."""
    start = time.perf_counter()
    path = find_scenario(scenario)
    loaded, exciting = load_scenario(path), load_scenario(find_scenario(EXCITING))
    check_folder("--out", out, [path, *files_of(loaded)], force=force)
    log = options.log_console(quiet)
    with log.status("simulating") as status:
        with prefix_errors(scenario):
            found = run_paper_study(loaded, status.update, exciting)
            options.print_warnings(check_limits(found.simulation).exceeded)
        status.update("drawing the figures")
        summary = summarize(found, time.perf_counter() - start)
        page = paper_report(found, scenario)
        with draft_folder(out) as draft:
            write_study(draft, page, summary)
    _print(page, quiet)
    log.print(f"{out}: {summary['wall_seconds']:.1f} s")


@study.command()
def accuracy(
    scenario: options.ScenarioArgument,
    out: options.OutFolder,
    trials: Annotated[
        int | None, typer.Option(help="Trials for each suite. Default: the scenario's number.")
    ] = None,
    sensors: Annotated[
        list[str] | None,
        typer.Option(
            metavar="PRESET|YAML", help="Sensors; may be repeated. Default: the scenario's presets."
        ),
    ] = None,
    estimator: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="Estimator; may be repeated. Default: all estimators."),
    ] = None,
    seed: Annotated[
        int | None, typer.Option(help="Seed of the noise. Default: the scenario's seed.")
    ] = None,
    jobs: Annotated[
        int | None, typer.Option(help="Number of processes. Default: one for each processor.")
    ] = None,
    force: options.ForceOption = False,
    quiet: options.QuietOption = False,
) -> None:
    """Compare the estimators on many simulated logs with sensor noise.

    Reports the error, the Cramér-Rao bound, the bias and the coverage of the 95 % intervals.
    """
    start = time.perf_counter()
    path = find_scenario(scenario)
    loaded = load_scenario(path)
    suites = sensors or loaded.accuracy.presets
    check_folder("--out", out, [path, *files_of(loaded), *suites], force=force)
    with prefix_errors(scenario):
        options.print_warnings(check_limits(make_simulation(loaded)).exceeded)
    log = options.log_console(quiet)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
    with Progress(*columns, TimeRemainingColumn(), console=log, disable=not log.is_terminal) as bar:
        tasks = {name: bar.add_task(name) for name in suites}
        found = run_accuracy(
            loaded,
            trials=trials,
            presets=suites,
            estimators=estimator or (),
            seed=seed,
            jobs=(os.cpu_count() or 1) if jobs is None else jobs,
            progress=lambda name, done, total: bar.update(tasks[name], completed=done, total=total),
        )
    summary = {"scenario": scenario} | summarize_accuracy(found, time.perf_counter() - start)
    page = accuracy_report(found, scenario)
    with draft_folder(out) as draft:
        write_study(draft, page, summary)
    _print(page, quiet)
    log.print(f"{out}: {summary['wall_seconds']:.1f} s")


@study.command(name="techniques")
def compare_techniques(
    out: options.OutFolder,
    scenario: Annotated[
        str | None,
        typer.Argument(
            metavar="SCENARIO",
            help="A scenario file, or the name of a shipped scenario. Default: the paper's, "
            "exciting_motion and uncertain_spacecraft.",
        ),
    ] = None,
    trials: Annotated[int, typer.Option(help="Draws of the noise in each case.")] = 20,
    force_sensors: Annotated[
        str,
        typer.Option(metavar="YAML", help="Sensors of forces; see models/force_sensors."),
    ] = SHIPPED,
    fast: Annotated[
        bool, typer.Option("--fast", help="Leave out the neural network and adaptive control.")
    ] = False,
    seed: Annotated[int, typer.Option(help="Seed of all random numbers.")] = 2016,
    jobs: Annotated[
        int | None, typer.Option(help="Number of processes. Default: one for each processor.")
    ] = None,
    force: options.ForceOption = False,
    quiet: options.QuietOption = False,
) -> None:
    """Compare momentum with accelerations, force sensors, adaptive control and a neural network.

    All get the same motion, target and noise. Reports errors, bounds, and which of the claims of
    Ning et al. 2016 the numbers uphold.
    """
    start = time.perf_counter()
    names = (scenario,) if scenario else ("paper", EXCITING, "uncertain_spacecraft")
    paths = [find_scenario(name) for name in names]
    scenarios = {name: load_scenario(path) for name, path in zip(names, paths)}
    inputs = [*paths, *(each for loaded in scenarios.values() for each in files_of(loaded))]
    if force_sensors != SHIPPED:
        inputs.append(force_sensors)
    check_folder("--out", out, inputs, force=force)
    sensors = load_force_sensors(force_sensors)
    log = options.log_console(quiet)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
    with Progress(*columns, TimeRemainingColumn(), console=log, disable=not log.is_terminal) as bar:
        task = bar.add_task("comparing")
        found = run_comparison(
            scenarios,
            sensors,
            trials=trials,
            seed=seed,
            jobs=(os.cpu_count() or 1) if jobs is None else jobs,
            is_fast=fast,
            progress=lambda done, total: bar.update(task, completed=done, total=total),
        )
    words = ["cpid", "study", "techniques", *([scenario] if scenario else [])]
    words += ["--trials", str(trials), "--seed", str(seed), *(["--fast"] if fast else [])]
    if force_sensors != SHIPPED:
        words += ["--force-sensors", force_sensors]
    page = technique_report(found, names, words)
    seconds = time.perf_counter() - start
    with draft_folder(out) as draft:
        write_techniques(draft, page, found)
    _print(page, quiet)
    log.print(f"{out}: {seconds:.1f} s")


def _print(page: Report, quiet: bool) -> None:
    for table in (each for section in page.sections for each in section.tables):
        if not quiet:
            print_table(table)
