"""`cpid accuracy`."""

import json
import os
import time
from typing import Annotated

import typer
from rich.console import Console

from cpid_drake.commands import options
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
    quiet: options.QuietOption = False,
) -> None:
    """Compare the estimators on many simulated logs with sensor noise.

    Reports the error, the Cramér-Rao bound, the bias and the coverage of the 95 % intervals.
    """
    start = time.perf_counter()
    path = find_scenario(scenario)
    if preset:
        from cpid_drake.sensing.presets import load_sensors

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

    from cpid_drake.report.accuracy import print_table, write_figures
    from cpid_drake.report.pages.study import accuracy_report
    from cpid_drake.scenario.files import load_scenario
    from cpid_drake.studies.accuracy import run_accuracy, summarize

    loaded = load_scenario(path)
    options.make_folder(out)
    log = options.log_console(quiet)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
    with Progress(*columns, TimeRemainingColumn(), console=log, disable=not log.is_terminal) as bar:
        tasks: dict[str, TaskID] = {}

        def progress(name: str, done: int, total: int) -> None:
            if name not in tasks:
                tasks[name] = bar.add_task(name, total=total)
            bar.update(tasks[name], completed=done)

        study = run_accuracy(
            loaded,
            trials=trials,
            presets=preset or (),
            estimators=estimator or (),
            seed=seed,
            jobs=(os.cpu_count() or 1) if jobs is None else jobs,
            progress=progress,
        )
    figures = write_figures(study, out)
    files = [*figures, out / "report.html", out / "summary.json"]
    summary = {"scenario": scenario} | summarize(study, time.perf_counter() - start)
    accuracy_report(study, figures, summary, scenario).write(files[-2])
    files[-1].write_text(json.dumps(summary, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    if not quiet:
        print_table(study, Console(markup=False))
    log.print(f"\n{len(files)} files in {out}, {summary['wall_seconds']:.1f} s")
