"""`cpid accuracy`."""

import os
import time
from typing import Annotated

import typer
from rich.console import Console

from cpid_drake.commands import options
from cpid_drake.commands.forecast import Forecast
from cpid_drake.errors import prefix_errors
from cpid_drake.output_files.drafts import draft_folder
from cpid_drake.output_files.overwriting import PNG, check_folder
from cpid_drake.resources import find_scenario


def accuracy(
    scenario: options.ScenarioArgument,
    out: options.FolderOption,
    trials: Annotated[
        int | None, typer.Option(help="Trials for each preset. Default: the scenario's number.")
    ] = None,
    preset: Annotated[
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
    check_folder("--out", out, [])
    path = find_scenario(scenario)
    if preset:
        from cpid_drake.sensors.presets import load_sensors

        for name in preset:
            load_sensors(name)
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TaskID,
        TextColumn,
        TimeRemainingColumn,
    )

    from cpid_drake.report.accuracy import figure_name, figures, print_tables
    from cpid_drake.report.pages.study import STUDY_FILES, accuracy_report, write_study
    from cpid_drake.scenario.files import files_of, load_scenario
    from cpid_drake.scenario.limits import check_limits
    from cpid_drake.scenario.simulation import make_simulation
    from cpid_drake.studies.accuracy import run_accuracy, summarize

    loaded = load_scenario(path)
    presets = preset or loaded.accuracy.presets
    outputs = [*((figure_name(name), PNG) for name in presets), *STUDY_FILES]
    check_folder("--out", out, outputs, [path, *files_of(loaded), *presets], force=force)
    with prefix_errors(scenario):
        options.print_warnings(check_limits(make_simulation(loaded)).exceeded)
    log = options.log_console(quiet)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
    with Progress(*columns, TimeRemainingColumn(), console=log, disable=not log.is_terminal) as bar:
        tasks: dict[str, TaskID] = {}
        processes = (os.cpu_count() or 1) if jobs is None else jobs
        count = loaded.accuracy.trials if trials is None else trials
        each = f" for each of {len(presets)} sensor suites" if len(presets) > 1 else ""
        forecast = Forecast(
            f"{count} trials{each} take", count * len(presets), log.print, processes
        )

        def progress(name: str, done: int, total: int) -> None:
            if name not in tasks:
                tasks[name] = bar.add_task(name, total=total)
            bar.update(tasks[name], completed=done)
            forecast.update(done + total * (len(tasks) - 1))

        study = run_accuracy(
            loaded,
            trials=trials,
            presets=preset or (),
            estimators=estimator or (),
            seed=seed,
            jobs=processes,
            progress=progress,
        )
    summary = {"scenario": scenario} | summarize(study, time.perf_counter() - start)
    with draft_folder(out) as draft:
        drawn = figures(study)
        write_study(draft, accuracy_report(study, drawn, summary, scenario), drawn)
    if not quiet:
        print_tables(study, Console(markup=False))
    log.print(f"\n{len(outputs)} files in {out}, {summary['wall_seconds']:.1f} s")
