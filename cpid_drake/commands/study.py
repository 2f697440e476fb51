"""`cpid study`: the paper's study, and other techniques."""

import os
import time
from typing import Annotated

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from cpid_drake.commands import options
from cpid_drake.commands.usage import group
from cpid_drake.errors import prefix_errors
from cpid_drake.output_files.drafts import draft_folder
from cpid_drake.output_files.overwriting import check_folder
from cpid_drake.report.page import Report
from cpid_drake.report.pages.study import paper_report, technique_report
from cpid_drake.report.terminal import print_table
from cpid_drake.resources import find_scenario
from cpid_drake.scenario.files import files_of, load_scenario
from cpid_drake.scenario.limits import check_limits
from cpid_drake.studies.paper import run_paper_study, summarize
from cpid_drake.studies.paper_values import EXCITING
from cpid_drake.studies.techniques.comparison import run_comparison
from cpid_drake.studies.techniques.force_sensors import SHIPPED, load_force_sensors


def paper(
    out: options.OutFolder,
    scenario: Annotated[
        str, "--scenario SCENARIO", "A scenario file, or the name of a shipped scenario."
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
        page = paper_report(found, scenario, summary)
        with draft_folder(out) as draft:
            page.write_folder(draft)
    _print(page, quiet)
    log.print(f"{out}: {summary['wall_seconds']:.1f} s")


def compare_techniques(
    out: options.OutFolder,
    scenario: Annotated[
        str | None,
        "SCENARIO",
        "A scenario file, or the name of a shipped scenario. Default: the paper's, "
        "exciting_motion and uncertain_spacecraft.",
    ] = None,
    trials: Annotated[int, "Draws of the noise in each case."] = 20,
    force_sensors: Annotated[
        str, "--force-sensors YAML", "Sensors of forces; see models/force_sensors."
    ] = SHIPPED,
    fast: Annotated[bool, "Leave out the neural network and adaptive control."] = False,
    seed: Annotated[int, "Seed of all random numbers."] = 2016,
    jobs: Annotated[int | None, "Number of processes. Default: one for each processor."] = None,
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
        page.write_folder(draft)
    _print(page, quiet)
    log.print(f"{out}: {seconds:.1f} s")


def _print(page: Report, quiet: bool) -> None:
    for table in (each for section in page.sections for each in section.tables):
        if not quiet:
            print_table(table)


study = group(
    "Reproduce the paper's study, or compare techniques.",
    paper=paper,
    techniques=compare_techniques,
)
