"""`cpid accuracy`."""

import json
import os
import time
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from cpid_drake.commands.folders import make_folder


def accuracy(
    scenario: Annotated[
        str, typer.Argument(metavar="SCENARIO", help="A scenario file, or a shipped one's name.")
    ],
    out: Annotated[Path, typer.Option(help="Folder for figures and summary.json; made if needed.")],
    trials: Annotated[
        int | None, typer.Option(help="Trials for each preset; default: the scenario's.")
    ] = None,
    preset: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="Sensor preset or file; again for more than one."),
    ] = None,
    estimator: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="Estimator; again for more than one. Default: all."),
    ] = None,
    seed: Annotated[int | None, typer.Option(help="Seed; default: the scenario's.")] = None,
    jobs: Annotated[
        int | None, typer.Option(help="Processes; default: one for each processor.")
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", help="Print no table and no progress.")] = False,
) -> None:
    """Try the estimators on noisy sensors many times: error, bound, bias, honesty of intervals."""
    start = time.perf_counter()
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeRemainingColumn,
    )

    from cpid_drake.report.accuracy import print_table, write_figures
    from cpid_drake.report.pages.study import accuracy_report
    from cpid_drake.scenario.files import load_scenario
    from cpid_drake.scenario.shipped import find_scenario
    from cpid_drake.studies.accuracy import run_accuracy, summarize

    loaded = load_scenario(find_scenario(scenario))
    make_folder(out)
    log = Console(stderr=True, quiet=quiet, markup=False)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
    with Progress(*columns, TimeRemainingColumn(), console=log, disable=not log.is_terminal) as bar:
        tasks = {}

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
    log.print(f"\n{len(files)} files in {out}, {summary['wall_seconds']:.1f} s", highlight=False)
